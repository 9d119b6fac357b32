//! Geosoft's XYZ: a record `//Flight` and a record `Line` before the rows of each line, `*` for a missing value.

use std::{collections::HashSet, io::Write};

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::display::{ArrayFormatter, FormatOptions};
use arrow_schema::{DataType, Field, Schema};
use schemas::Fault;

use super::{TableWriter, write_failed};

/// Names of the columns that become records.
const RECORDS: [&str; 2] = ["flight", "line"];

/// Writer of a table of lines as Geosoft XYZ. Numbers precede strings, because a row must begin with a number. Numbers
/// have as many digits as needed to read the same value. A string of several words is in double quotes.
pub struct GeosoftWriter<W> {
    out: W,
    /// Positions of the written columns.
    order: Vec<usize>,
    begun: bool,
    flight: Option<String>,
    line: Option<(String, String)>,
    written: HashSet<(String, String)>,
    /// The value of each key other than flight and line, by the position of its column.
    keys: Vec<(usize, Option<String>)>,
}

impl<W: Write> GeosoftWriter<W> {
    /// Creates a writer to `out`.
    pub fn new(out: W) -> GeosoftWriter<W> {
        let (order, keys, written) = (vec![], vec![], HashSet::new());
        GeosoftWriter { out, order, begun: false, flight: None, line: None, written, keys }
    }

    /// Writes the comments that name the columns and their units.
    fn begin(&mut self, schema: &Schema) -> Result<(), Fault> {
        self.begun = true;
        if schema.index_of("line").is_err() {
            let fault = Fault::new("the table has no column `line`, so it cannot be written as Geosoft XYZ");
            return Err(fault.help("use the extension .csv or .parquet"));
        }
        let (numbers, texts): (Vec<usize>, Vec<usize>) = (0..schema.fields().len())
            .filter(|i| !RECORDS.contains(&schema.field(*i).name().as_str()))
            .partition(|i| schema.field(*i).data_type().is_numeric());
        if numbers.is_empty() {
            let fault = Fault::new("the table has no column of numbers, so it cannot be written as Geosoft XYZ");
            return Err(fault.help("use the extension .csv or .parquet"));
        }
        self.order = numbers.into_iter().chain(texts).collect();
        let is_key = |field: &Field| field.metadata().get("role").is_some_and(|role| role == "key");
        self.keys = self.order.iter().filter(|i| is_key(schema.field(**i))).map(|i| (*i, None)).collect();
        let fields: Vec<&Field> = self.order.iter().map(|i| schema.field(*i)).collect();
        for field in &fields {
            check(field.name(), "column name")?;
        }
        let unit = |field: &&Field| match field.metadata().get("unit").filter(|unit| !unit.is_empty()) {
            Some(unit) => unit.replace(char::is_whitespace, "_"),
            None => "-".to_owned(),
        };
        let units: Vec<String> = fields.iter().map(unit).collect();
        let names: Vec<&str> = fields.iter().map(|field| field.name().as_str()).collect();
        // The names come last, because readers take the names from the last comment before the data.
        writeln!(self.out, "/ units: {}\n/ {}", units.join(" "), names.join(" ")).map_err(|e| write_failed(&e))
    }

    /// Writes the records of a new line.
    fn enter(&mut self, flight: String, line: String) -> Result<(), Fault> {
        if self.line.as_ref().is_some_and(|(f, l)| *f == flight && *l == line) {
            return Ok(());
        }
        check(&line, "line")?;
        if !line.chars().any(|c| c.is_ascii_digit()) {
            return Err(unusable(&line, "line"));
        }
        if !self.written.insert((flight.clone(), line.clone())) {
            let fault = Fault::new("the rows of the line are not contiguous").in_line(&flight, &line);
            return Err(fault.help("select one combination of axis values with `--where`, or use the extension .csv"));
        }
        if self.flight.as_ref() != Some(&flight) && !flight.is_empty() {
            if flight.trim() != flight || flight.chars().any(char::is_control) {
                return Err(unusable(&flight, "flight"));
            }
            writeln!(self.out, "//Flight {flight}").map_err(|e| write_failed(&e))?;
        }
        writeln!(self.out, "Line {line}").map_err(|e| write_failed(&e))?;
        self.flight = Some(flight.clone());
        self.line = Some((flight, line));
        Ok(())
    }
}

impl<W: Write + Send> TableWriter for GeosoftWriter<W> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Fault> {
        let schema = batch.schema();
        if !self.begun {
            self.begin(&schema)?;
        }
        let options = FormatOptions::new();
        let texts = batch.columns().iter().map(|c| ArrayFormatter::try_new(c.as_ref(), &options));
        let texts = texts.collect::<Result<Vec<_>, _>>().map_err(|e| Fault::bug(e.to_string()))?;
        let text = |column: usize, row: usize| texts[column].value(row).to_string();
        let place = RECORDS.map(|name| schema.index_of(name).ok());
        for row in 0..batch.num_rows() {
            let [flight, line] = place.map(|column| column.map(|column| text(column, row)).unwrap_or_default());
            self.enter(flight, line)?;
            for (column, first) in &mut self.keys {
                let now = text(*column, row);
                let value = first.get_or_insert_with(|| now.clone());
                if *value != now {
                    return Err(several(schema.field(*column).name(), value));
                }
            }
            let mut cells = String::new();
            for column in &self.order {
                let values = batch.column(*column);
                let cell = match values.data_type() {
                    _ if values.is_null(row) => "*".to_owned(),
                    DataType::Float64 => number(values.as_primitive::<Float64Type>().value(row)),
                    kind if kind.is_floating() && text(*column, row) == "NaN" => "*".to_owned(),
                    kind if kind.is_numeric() => text(*column, row),
                    _ => word(text(*column, row))?,
                };
                cells.extend([if cells.is_empty() { "" } else { " " }, &cell]);
            }
            writeln!(self.out, "{cells}").map_err(|e| write_failed(&e))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, schema: &Schema) -> Result<(), Fault> {
        if !self.begun {
            self.begin(schema)?;
        }
        self.out.flush().map_err(|e| write_failed(&e))
    }
}

/// The shortest decimal text that is read as the same value; `*` for NaN and infinities, which are missing values.
fn number(value: f64) -> String {
    let size = value.abs();
    match value {
        _ if !value.is_finite() => "*".to_owned(),
        _ if size != 0.0 && !(1e-5..1e17).contains(&size) => format!("{value:e}"),
        _ => value.to_string(),
    }
}

/// A string as one word, in quotes if necessary.
fn word(text: String) -> Result<String, Fault> {
    if text.is_empty() {
        return Ok("*".to_owned());
    }
    if check(&text, "text").is_ok() {
        return Ok(text);
    }
    if text.contains('"') || text.contains(char::is_control) {
        return Err(unusable(&text, "text"));
    }
    Ok(format!("\"{text}\""))
}

/// Rejects a string that is not one word in the format.
fn check(text: &str, what: &str) -> Result<(), Fault> {
    let special = |c: char| c.is_whitespace() || c.is_control() || matches!(c, ',' | '"');
    let fine = !text.is_empty() && !text.contains(special) && !text.starts_with(['/', '*']);
    if fine { Ok(()) } else { Err(unusable(text, what)) }
}

fn unusable(text: &str, what: &str) -> Fault {
    let fault = Fault::new(format!("the {what} `{text}` cannot be stored in Geosoft XYZ"));
    fault.help("use the extension .csv or .parquet")
}

fn several(key: &str, value: &str) -> Fault {
    let fault =
        Fault::new(format!("the key `{key}` has several values, but Geosoft XYZ can contain each line only once"));
    let (key, value) = (key.replace('"', "\"\""), value.replace('\'', "''"));
    fault.help(format!("select one value with `--where`, such as `\"{key}\" = '{value}'`, or use the extension .csv"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_number_is_read_as_the_same_value() {
        for value in [0.1, -0.0, 1.0 / 3.0, 1e300, 5e-324, 48_123.456_789_012_3, 1e17, 123_456_789_012_345_680.0] {
            assert_eq!(number(value).parse::<f64>().map(f64::to_bits), Ok(value.to_bits()), "{value}");
        }
        assert_eq!(number(f64::NAN), "*");
    }

    #[test]
    fn unit_a_text_of_several_words_is_quoted() {
        let of = |text: &str| word(text.to_owned()).ok();
        assert_eq!(of("tactical").as_deref(), Some("tactical"));
        assert_eq!(of("tactical, new").as_deref(), Some("\"tactical, new\""));
        assert_eq!(of("").as_deref(), Some("*"));
        assert_eq!((of("5\" disk"), of("two\nlines")), (None, None));
    }
}

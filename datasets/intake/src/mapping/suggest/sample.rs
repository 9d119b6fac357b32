//! A sample of the first rows of a table, by column.

use arrow_array::{Array, ArrayRef, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::DataType;
use datasets::{FlightReader, ReadError, formats::name_of_head};
use numerics::regression::statistics::median;
use schemas::flight;

/// Maximum number of rows in the sample.
const ROWS: usize = 200_000;
/// Maximum number of texts of a column in the sample.
const TEXTS: usize = 2_000;

/// Column of a file with a sample of its values.
#[derive(Clone, Debug, Default)]
pub struct ColumnSample {
    /// Name in the file.
    pub name: String,
    /// The unit that the file gives; empty if the file gives no unit.
    pub unit: String,
    /// The first values of a text column, without empty ones.
    pub texts: Vec<String>,
    /// Numbers; empty for a column of text.
    pub values: Vec<f64>,
    /// Whether the numbers are whole.
    pub whole: bool,
}

impl ColumnSample {
    /// Finite values.
    pub fn known(&self) -> impl Iterator<Item = f64> + '_ {
        self.values.iter().copied().filter(|x| x.is_finite())
    }

    /// Whether the column must have numbers, such as `lat`, but has none, such as in `45 06 00 N`.
    pub fn is_unreadable(&self) -> bool {
        let has_unit = !flight::describe(name_of_head(&self.name)).unit.is_empty();
        has_unit && !self.values.is_empty() && self.known().next().is_none()
    }

    /// The smallest and the largest value.
    pub fn range(&self) -> Option<(f64, f64)> {
        let ends = self.known().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        (ends.0 <= ends.1).then_some(ends)
    }

    /// The largest absolute value.
    pub fn largest(&self) -> f64 {
        self.range().map_or(0.0, |(l, h)| l.abs().max(h.abs()))
    }

    /// The median.
    pub fn median(&self) -> Option<f64> {
        let mut all: Vec<f64> = self.known().collect();
        (!all.is_empty()).then(|| median(&mut all))
    }

    /// The words of the column's name, in lower case: `MagX` and `mag_x` are `mag` and `x`, `GPSHeight` is `gps` and
    /// `height`.
    pub fn words(&self) -> Vec<String> {
        let mut words: Vec<String> = vec![String::new()];
        let mut before = ' ';
        let letters: Vec<char> = self.name.chars().collect();
        for (at, c) in letters.iter().copied().enumerate() {
            // Whether a capital after another begins a word, as `H` of `GPSHeight` does; `M` of `UTMx` does not.
            let begins_word = || letters.iter().skip(at + 1).take(2).filter(|next| next.is_lowercase()).count() == 2;
            let breaks = !c.is_alphanumeric()
                || (c.is_uppercase() && (before.is_lowercase() || before.is_uppercase() && begins_word()))
                || (c.is_ascii_digit() != before.is_ascii_digit() && before.is_alphanumeric());
            if breaks {
                words.push(String::new());
            }
            if c.is_alphanumeric() {
                words.iter_mut().last().into_iter().for_each(|w| w.extend(c.to_lowercase()));
            }
            before = c;
        }
        words.retain(|w| !w.is_empty());
        words
    }
}

/// The columns of a table.
pub fn samples(reader: &mut FlightReader) -> Result<Vec<ColumnSample>, ReadError> {
    let schema = reader.schema().clone();
    let mut out: Vec<ColumnSample> = schema
        .fields()
        .iter()
        .map(|f| {
            let kind = match f.data_type() {
                DataType::Dictionary(_, value) => value.as_ref(),
                other => other,
            };
            ColumnSample {
                name: f.name().clone(),
                unit: f.metadata().get("unit").cloned().unwrap_or_default(),
                texts: vec![],
                values: vec![],
                whole: kind.is_integer(),
            }
        })
        .collect();
    let mut rows = 0;
    while rows < ROWS {
        let Some(part) = reader.next_part() else { break };
        // Later damage is reported when the log is read.
        let Ok(part) = part else { break };
        rows += part.batch.num_rows();
        for (sample, column) in out.iter_mut().zip(part.batch.columns()) {
            add(sample, column);
        }
    }
    for sample in &mut out {
        sample.whole |= !sample.values.is_empty() && sample.known().all(|x| x.fract() == 0.0);
    }
    Ok(out)
}

fn add(sample: &mut ColumnSample, column: &ArrayRef) {
    let kind = column.data_type();
    let number = kind.is_numeric() || matches!(kind, DataType::Dictionary(_, v) if v.is_numeric());
    if number {
        if let Ok(numbers) = cast(column, &DataType::Float64) {
            sample.values.extend(numbers.as_primitive::<Float64Type>().iter().map(|x| x.unwrap_or(f64::NAN)));
        }
    } else if sample.texts.len() < TEXTS
        && let Ok(text) = cast(column, &DataType::Utf8)
    {
        let left = TEXTS - sample.texts.len();
        let known = text.as_string::<i32>().iter().flatten().map(str::trim).filter(|text| !text.is_empty());
        sample.texts.extend(known.take(left).map(str::to_owned));
    }
}

#[cfg(test)]
mod tests {
    use super::ColumnSample;

    #[test]
    fn unit_words_of_names_are_separated() {
        let words = |name: &str| ColumnSample { name: name.to_owned(), ..ColumnSample::default() }.words().join(" ");
        for (name, expected) in [
            ("MagX", "mag x"),
            ("mag_x", "mag x"),
            ("GPSHeight", "gps height"),
            ("GPSHeight_m_hae", "gps height m hae"),
            ("UTMx", "utmx"),
            ("TimeUS", "time us"),
            ("Mag1 [nT]", "mag 1 n t"),
            ("UTC", "utc"),
        ] {
            assert_eq!(words(name), expected, "{name}");
        }
    }
}

//! MATLAB MAT-files of level 5, uncompressed. [MathWorks, MAT-File Format, R2025a]
//!
//! Each column is a column vector of the same name. A column of strings is a vector of positions in a cell array
//! `NAME_names`; 0 is a missing string. A time is in seconds since 1970-01-01 UTC, as `datetime` of MATLAB reads it.
//! The cell array `columns` has one row for each vector: its variable, the name of the column, the unit and the
//! description.

use std::{
    collections::{HashMap, HashSet},
    io::Write,
};

use arrow_array::{
    Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, TimestampMicrosecondType},
};
use arrow_cast::{cast, display::ArrayFormatter};
use arrow_schema::{DataType, Field, Schema, TimeUnit};
use schemas::Fault;

use super::{TableWriter, write_failed};

/// Maximum size of a variable for MATLAB to load it from a file of this level, in bytes.
const LARGEST: usize = (1 << 31) - 1;
/// Largest number of characters of a variable's name.
const NAME_LENGTH: usize = 63;

/// Data types and array classes of the format.
mod code {
    pub const INT8: u32 = 1;
    pub const UINT16: u32 = 4;
    pub const INT32: u32 = 5;
    pub const UINT32: u32 = 6;
    pub const DOUBLE: u32 = 9;
    pub const MATRIX: u32 = 14;
    pub const CELL: u32 = 1;
    pub const CHAR: u32 = 4;
    pub const NUMBERS: u32 = 6;
}

/// Writer of a table as a MAT-file. All columns are in memory until the end of the table.
pub struct MatWriter<W> {
    out: W,
    columns: Vec<MatVector>,
    largest: usize,
}

/// Values of a column.
struct MatVector {
    /// Variable, column, unit and description.
    names: [String; 4],
    values: Vec<f64>,
    /// Distinct strings with their positions, for a column of strings.
    texts: Option<DistinctTexts>,
}

#[derive(Default)]
struct DistinctTexts {
    list: Vec<String>,
    known: HashMap<String, usize>,
}

impl DistinctTexts {
    /// Position of a string, from 1.
    fn position(&mut self, text: &str) -> usize {
        if let Some(at) = self.known.get(text) {
            return *at;
        }
        self.list.push(text.to_owned());
        self.known.insert(text.to_owned(), self.list.len());
        self.list.len()
    }
}

impl<W: Write> MatWriter<W> {
    /// Creates a writer to `out`.
    pub fn new(out: W) -> MatWriter<W> {
        MatWriter { out, columns: vec![], largest: LARGEST }
    }

    /// Declares a variable for each column.
    fn begin(&mut self, schema: &Schema) {
        let mut taken: HashSet<String> = HashSet::from(["columns".to_owned()]);
        for field in schema.fields() {
            let of = |key: &str| field.metadata().get(key).cloned().unwrap_or_default();
            let is_text = is_text(field);
            let variable = variable(field.name(), is_text, &mut taken);
            let is_time = matches!(field.data_type(), DataType::Timestamp(..));
            let unit = if is_time { "s since 1970-01-01 UTC".to_owned() } else { of("unit") };
            let names = [variable, field.name().clone(), unit, of("description")];
            self.columns.push(MatVector { names, values: vec![], texts: is_text.then(DistinctTexts::default) });
        }
    }
}

impl<W: Write + Send> TableWriter for MatWriter<W> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Fault> {
        if self.columns.is_empty() {
            self.begin(&batch.schema());
        }
        for (column, array) in self.columns.iter_mut().zip(batch.columns()) {
            column.extend(array)?;
            if column.values.len() > self.largest / 8 {
                let fault =
                    Fault::new(format!("the table has more rows than a MAT-file can hold: {}", self.largest / 8));
                return Err(fault.help("select rows with `--line` or `--where`, or use the extension .parquet"));
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, schema: &Schema) -> Result<(), Fault> {
        if self.columns.is_empty() {
            self.begin(schema);
        }
        let mut head = [b' '; 124];
        let text = b"MATLAB 5.0 MAT-file, written by magline";
        head[..text.len()].copy_from_slice(text);
        // The file has no subsystem data.
        head[116..].fill(0);
        let mut write = |bytes: &[u8]| self.out.write_all(bytes).map_err(|e| write_failed(&e));
        write(&head)?;
        write(&[0x00, 0x01, b'I', b'M'])?;
        for MatVector { names: [variable, ..], values, texts } in &self.columns {
            write(&numbers(variable, values))?;
            if let Some(texts) = texts {
                let list: Vec<&str> = texts.list.iter().map(String::as_str).collect();
                write(&cells(&format!("{variable}_names"), &list, 1))?;
            }
        }
        let words: Vec<&str> =
            (0..4).flat_map(|part| self.columns.iter().map(move |column| column.names[part].as_str())).collect();
        write(&cells("columns", &words, 4))?;
        self.out.flush().map_err(|e| write_failed(&e))
    }
}

impl MatVector {
    fn extend(&mut self, array: &dyn Array) -> Result<(), Fault> {
        if let Some(texts) = &mut self.texts {
            let words = ArrayFormatter::try_new(array, &Default::default()).map_err(|e| Fault::bug(e.to_string()))?;
            let of = |row: usize| if array.is_null(row) { 0 } else { texts.position(&words.value(row).to_string()) };
            self.values.extend((0..array.len()).map(of).map(|at| at as f64));
            return Ok(());
        }
        if let DataType::Timestamp(_, zone) = array.data_type() {
            let micro = DataType::Timestamp(TimeUnit::Microsecond, zone.clone());
            let times = cast(array, &micro).map_err(|e| Fault::bug(e.to_string()))?;
            let times = times.as_primitive::<TimestampMicrosecondType>();
            self.values.extend(times.iter().map(|time| time.map_or(f64::NAN, |time| time as f64 / 1e6)));
            return Ok(());
        }
        let cast = cast(array, &DataType::Float64).map_err(|e| Fault::bug(e.to_string()))?;
        self.values.extend(cast.as_primitive::<Float64Type>().iter().map(|value| value.unwrap_or(f64::NAN)));
        let exact = |value: &f64| !array.data_type().is_integer() || value.is_nan() || value.abs() < 2f64.powi(53);
        if self.values.iter().rev().take(array.len()).all(exact) {
            return Ok(());
        }
        let fault = Fault::new(format!(
            "column `{}` has integers of 2^53 or more, which a double cannot represent exactly",
            self.names[1]
        ));
        Err(fault.help("use the extension .csv or .parquet"))
    }
}

fn is_text(field: &Field) -> bool {
    let kind = field.data_type();
    !(kind.is_numeric() || matches!(kind, DataType::Boolean | DataType::Timestamp(..)))
}

/// Unused name of a variable: letters, digits and `_`, beginning with a letter. The name of a string variable leaves
/// room for the suffix of its list of strings.
fn variable(name: &str, is_text: bool, taken: &mut HashSet<String>) -> String {
    let plain: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let plain = if plain.starts_with(|c: char| c.is_ascii_alphabetic()) { plain } else { format!("x_{plain}") };
    let cut = |suffix: &str| -> String {
        plain.chars().take(NAME_LENGTH - "_names".len() - suffix.len()).chain(suffix.chars()).collect()
    };
    let free = |name: &String, taken: &HashSet<String>| {
        !(taken.contains(name) || is_text && taken.contains(&format!("{name}_names")))
    };
    let mut found = cut("");
    let mut count = 1;
    while !free(&found, taken) {
        count += 1;
        found = cut(&format!("_{count}"));
    }
    taken.insert(found.clone());
    if is_text {
        taken.insert(format!("{found}_names"));
    }
    found
}

/// An element: type, size, and the data padded to a multiple of 8 bytes.
fn element(kind: u32, data: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(data.len() + 16);
    out.extend(kind.to_le_bytes());
    // The callers limit the size.
    out.extend(u32::try_from(data.len()).unwrap_or(u32::MAX).to_le_bytes());
    out.extend(data);
    out.resize(out.len().next_multiple_of(8), 0);
    out
}

/// Bytes of a matrix: its class, dimensions and name, followed by its data.
fn matrix(class: u32, name: &str, [rows, columns]: [usize; 2], data: &[u8]) -> Vec<u8> {
    let dimension = |count: usize| u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes();
    let flags = [class.to_le_bytes(), [0; 4]].concat();
    let parts = [
        element(code::UINT32, &flags),
        element(code::INT32, &[dimension(rows), dimension(columns)].concat()),
        element(code::INT8, name.as_bytes()),
    ];
    element(code::MATRIX, &[&parts.concat(), data].concat())
}

fn numbers(name: &str, values: &[f64]) -> Vec<u8> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    matrix(code::NUMBERS, name, [values.len(), 1], &element(code::DOUBLE, &bytes))
}

/// A cell array of strings, column by column.
fn cells(name: &str, texts: &[&str], columns: usize) -> Vec<u8> {
    let cell = |text: &&str| {
        let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let rows = usize::from(!units.is_empty());
        matrix(code::CHAR, "", [rows, units.len() / 2], &element(code::UINT16, &units))
    };
    let all: Vec<u8> = texts.iter().flat_map(cell).collect();
    matrix(code::CELL, name, [texts.len() / columns, columns], &all)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array, Int64Array, StringArray};

    use super::*;

    #[test]
    fn unit_a_variable_has_a_name_that_matlab_accepts() {
        let mut taken = HashSet::from(["columns".to_owned()]);
        let mut of = |name: &str, is_text: bool| variable(name, is_text, &mut taken);
        assert_eq!([of("tt", false), of("tt", false)], ["tt", "tt_2"]);
        assert_eq!([of("1 mag<b>", false), of("columns", false)], ["x_1_mag_b_", "columns_2"]);
        assert_eq!([of("line", true), of("line_names", false)], ["line", "line_names_2"]);
        assert_eq!([of("\u{202e}", false), of("", false)], ["x__", "x_"]);
        let long = [of(&"a".repeat(80), false), of(&"a".repeat(80), true)];
        assert!(long[0] != long[1] && long.iter().all(|name| name.len() + 6 <= NAME_LENGTH), "{long:?}");
    }

    fn batch(rows: usize) -> RecordBatch {
        let numbers = Arc::new(Float64Array::from(vec![0.5; rows])) as ArrayRef;
        let texts = Arc::new(StringArray::from(vec![Some("1.01"); rows])) as ArrayRef;
        RecordBatch::try_from_iter([("tt", numbers), ("line", texts)]).unwrap()
    }

    #[test]
    fn unit_every_element_begins_at_a_multiple_of_eight_bytes() {
        let mut out = vec![];
        let mut writer = Box::new(MatWriter::new(&mut out));
        writer.write(&batch(3)).unwrap();
        writer.finish(&batch(0).schema()).unwrap();
        assert_eq!((out.len() % 8, &out[124..128]), (0, &[0, 1, b'I', b'M'][..]));
        let (mut at, mut count) = (128, 0);
        while at < out.len() {
            let word = |from: usize| u32::from_le_bytes(out[from..from + 4].try_into().unwrap());
            assert_eq!(word(at), code::MATRIX);
            at += 8 + word(at + 4) as usize;
            count += 1;
        }
        assert_eq!((at, count), (out.len(), 4), "two vectors, the texts, and the list of columns");
    }

    #[test]
    fn unit_what_the_format_cannot_hold_is_an_error() {
        let mut writer = MatWriter { largest: 80, ..MatWriter::new(vec![]) };
        assert!(writer.write(&batch(10)).is_ok());
        assert!(writer.write(&batch(1)).unwrap_err().what.contains("more rows"));
        let large = Arc::new(Int64Array::from(vec![Some(1), None, Some((1 << 53) + 1)])) as ArrayRef;
        let fault = MatWriter::new(vec![]).write(&RecordBatch::try_from_iter([("n", large)]).unwrap()).unwrap_err();
        assert!(fault.what.contains("of 2^53 or more"), "{fault}");
    }
}

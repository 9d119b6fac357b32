//! Conversion of fixed-length records of binary logs to columns of numbers and strings.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use schemas::{Role, field};

use super::{FlightBatch, FlightBatches, topics::TopicColumn};
use crate::ReadError;

/// The type of a value in a record, little endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RecordFieldType {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    /// IEEE 754 half precision.
    F16,
    F32,
    F64,
    /// Text of at most this number of characters, up to a NUL.
    Text(usize),
}

impl RecordFieldType {
    /// Length in bytes.
    pub(super) fn bytes(self) -> usize {
        match self {
            RecordFieldType::I8 | RecordFieldType::U8 => 1,
            RecordFieldType::I16 | RecordFieldType::U16 | RecordFieldType::F16 => 2,
            RecordFieldType::I32 | RecordFieldType::U32 | RecordFieldType::F32 => 4,
            RecordFieldType::I64 | RecordFieldType::U64 | RecordFieldType::F64 => 8,
            RecordFieldType::Text(n) => n,
        }
    }
}

/// A column: its position in a record, and its meaning.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RecordColumn {
    pub(super) name: String,
    pub(super) kind: RecordFieldType,
    /// Offset of its first byte in the record.
    pub(super) offset: usize,
    /// Divisor of the stored number.
    pub(super) divisor: f64,
    /// The unit of the quotient; empty if the file gives none.
    pub(super) unit: String,
}

impl RecordColumn {
    pub(super) fn topic_column(&self) -> TopicColumn {
        TopicColumn { name: self.name.clone(), unit: self.unit.clone(), description: String::new() }
    }
}

/// Column type that represents the 64-bit integers of a column without loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum WideIntegerType {
    /// All integers are exact as Float64.
    #[default]
    Float,
    /// Some integers need 64 bits.
    Whole,
    /// Some integers are beyond the range of an Int64 and become text with all digits.
    Digits,
}

/// Search of each column for 64-bit integers that Float64 cannot represent exactly.
#[derive(Clone, Debug, Default)]
pub(super) struct WideIntegerScan {
    /// The columns of 64-bit integers: index, offset, and whether they are unsigned.
    wide: Vec<(usize, usize, bool)>,
    found: Vec<WideIntegerType>,
}

impl WideIntegerScan {
    pub(super) fn new(columns: &[RecordColumn]) -> WideIntegerScan {
        let wide =
            columns.iter().enumerate().filter(|(_, c)| matches!(c.kind, RecordFieldType::I64 | RecordFieldType::U64));
        let wide = wide.map(|(i, c)| (i, c.offset, c.kind == RecordFieldType::U64)).collect();
        WideIntegerScan { wide, found: vec![WideIntegerType::Float; columns.len()] }
    }

    /// Examines a record.
    #[inline]
    pub(super) fn look(&mut self, record: &[u8]) {
        for (i, offset, unsigned) in &self.wide {
            let Some(bytes) = record.get(*offset..).and_then(|r| r.first_chunk::<8>()) else { continue };
            let width = width(u64::from_le_bytes(*bytes), *unsigned);
            if let Some(found) = self.found.get_mut(*i) {
                *found = width.max(*found);
            }
        }
    }

    fn column_type(&self, i: usize) -> WideIntegerType {
        self.found.get(i).copied().unwrap_or_default()
    }
}

fn width(bits: u64, unsigned: bool) -> WideIntegerType {
    // Integers up to 2^53 are exact as Float64.
    const EXACT: u64 = 1 << 53;
    let magnitude = if unsigned { bits } else { (bits as i64).unsigned_abs() };
    match magnitude {
        m if m <= EXACT => WideIntegerType::Float,
        m if !unsigned || i64::try_from(m).is_ok() => WideIntegerType::Whole,
        _ => WideIntegerType::Digits,
    }
}

/// Records gathered for a batch.
pub(super) struct RecordBuffer {
    columns: Vec<RecordColumn>,
    widths: WideIntegerScan,
    schema: SchemaRef,
    /// The length of a record.
    stride: usize,
    bytes: Vec<u8>,
}

/// Maximum number of values in a batch: 64 k rows of 100 columns take 50 MB.
const CELLS: usize = 6 << 20;
/// Maximum number of rows in a batch.
const ROWS: usize = 65_536;

impl RecordBuffer {
    pub(super) fn new(columns: Vec<RecordColumn>, widths: WideIntegerScan, stride: usize) -> RecordBuffer {
        let of = |(i, c): (usize, &RecordColumn)| {
            let data_type = match (c.kind, widths.column_type(i)) {
                (RecordFieldType::Text(_), _) | (_, WideIntegerType::Digits) => DataType::Utf8,
                (_, WideIntegerType::Whole) => DataType::Int64,
                (_, WideIntegerType::Float) => DataType::Float64,
            };
            field(&c.name, data_type, &c.unit, Role::Aux, "")
        };
        let schema = Arc::new(Schema::new(columns.iter().enumerate().map(of).collect::<Vec<Field>>()));
        RecordBuffer { columns, widths, schema, stride: stride.max(1), bytes: vec![] }
    }

    pub(super) fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    pub(super) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Whether a batch should be taken before more records are added.
    #[inline]
    pub(super) fn is_full(&self) -> bool {
        self.bytes.len() >= ROWS.min((CELLS / self.columns.len().max(1)).max(1)) * self.stride
    }

    /// Adds a record. Excess bytes are dropped; a shorter record is an error of the caller and is ignored.
    #[inline]
    pub(super) fn push(&mut self, record: &[u8]) {
        if let Some(record) = record.get(..self.stride) {
            self.bytes.extend_from_slice(record);
        }
    }

    /// Returns the records as a batch and clears the buffer.
    pub(super) fn take(&mut self, path: &Path) -> Result<RecordBatch, ReadError> {
        let columns =
            self.columns.iter().enumerate().map(|(i, c)| self.column(c, self.widths.column_type(i))).collect();
        let batch = RecordBatch::try_new(self.schema.clone(), columns);
        self.bytes.clear();
        batch.map_err(|e| ReadError::data(path, e.to_string()))
    }

    fn column(&self, column: &RecordColumn, width: WideIntegerType) -> ArrayRef {
        let divisor = column.divisor;
        macro_rules! numbers {
            ($t:ty, $n:literal) => {
                self.numbers(column, divisor, |b: [u8; $n]| <$t>::from_le_bytes(b) as f64)
            };
        }
        match (column.kind, width) {
            (RecordFieldType::I8, _) => numbers!(i8, 1),
            (RecordFieldType::U8, _) => numbers!(u8, 1),
            (RecordFieldType::I16, _) => numbers!(i16, 2),
            (RecordFieldType::U16, _) => numbers!(u16, 2),
            (RecordFieldType::I32, _) => numbers!(i32, 4),
            (RecordFieldType::U32, _) => numbers!(u32, 4),
            (RecordFieldType::F32, _) => numbers!(f32, 4),
            (RecordFieldType::F64, _) => numbers!(f64, 8),
            (RecordFieldType::F16, _) => self.numbers(column, divisor, |b: [u8; 2]| half(u16::from_le_bytes(b))),
            (RecordFieldType::I64, WideIntegerType::Float) => numbers!(i64, 8),
            (RecordFieldType::U64, WideIntegerType::Float) => numbers!(u64, 8),
            (RecordFieldType::I64 | RecordFieldType::U64, WideIntegerType::Whole) => {
                Arc::new(self.cells(column, i64::from_le_bytes).collect::<Int64Array>())
            }
            (RecordFieldType::I64 | RecordFieldType::U64, WideIntegerType::Digits) => {
                let digits = self.cells(column, |b| u64::from_le_bytes(b).to_string());
                Arc::new(digits.collect::<StringArray>())
            }
            (RecordFieldType::Text(n), _) => {
                let texts = self
                    .bytes
                    .chunks_exact(self.stride)
                    .map(|r| Some(text(r.get(column.offset..column.offset + n).unwrap_or_default())));
                Arc::new(texts.collect::<StringArray>())
            }
        }
    }

    /// The decoded values of one column; `None` for a record that is too short.
    fn cells<'a, const N: usize, T>(
        &'a self,
        column: &'a RecordColumn,
        decode: impl Fn([u8; N]) -> T + 'a,
    ) -> impl Iterator<Item = Option<T>> + 'a {
        let at = column.offset;
        self.bytes.chunks_exact(self.stride).map(move |r| r.get(at..)?.first_chunk::<N>().map(|b| decode(*b)))
    }

    fn numbers<const N: usize>(
        &self,
        column: &RecordColumn,
        divisor: f64,
        decode: impl Fn([u8; N]) -> f64,
    ) -> ArrayRef {
        let scaled = |b| if divisor == 1.0 { decode(b) } else { decode(b) / divisor };
        let values: Vec<f64> = self.cells(column, scaled).map(|x| x.unwrap_or(f64::NAN)).collect();
        Arc::new(Float64Array::from(values))
    }
}

/// Text up to a NUL; bytes that are not UTF-8 are read as Latin-1.
pub(super) fn text(bytes: &[u8]) -> String {
    let bytes = bytes.split(|b| *b == 0).next().unwrap_or_default();
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|b| char::from(*b)).collect(),
    }
}

/// A number of half precision. [IEEE 754-2008, binary16]
fn half(bits: u16) -> f64 {
    let (sign, exponent, fraction) = (bits >> 15, (bits >> 10) & 0x1f, f64::from(bits & 0x3ff));
    let magnitude = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        e => (1.0 + fraction / 1024.0) * 2f64.powi(i32::from(e) - 15),
    };
    if sign == 1 { -magnitude } else { magnitude }
}

/// The rows of one topic in batches. `step` reads the next message of the file, adds its record if it belongs to the
/// topic, and returns whether there was a message.
pub(super) fn batches(
    path: &Path,
    mut records: RecordBuffer,
    mut step: impl FnMut(&mut RecordBuffer) -> Result<bool, ReadError> + Send + 'static,
) -> FlightBatches {
    let (path, mut done) = (path.to_path_buf(), false);
    Box::new(std::iter::from_fn(move || {
        while !done && !records.is_full() {
            match step(&mut records) {
                Ok(more) => done = !more,
                Err(fault) => {
                    done = true;
                    return Some(Err(fault));
                }
            }
        }
        (!records.is_empty()).then(|| records.take(&path).map(FlightBatch::whole))
    }))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use arrow_array::{Array, cast::AsArray, types::Float64Type, types::Int64Type};

    use super::*;

    fn column(name: &str, kind: RecordFieldType, offset: usize, divisor: f64) -> RecordColumn {
        RecordColumn { name: name.into(), kind, offset, divisor, unit: String::new() }
    }

    #[test]
    fn unit_every_type_of_a_record() {
        let columns = vec![
            column("i8", RecordFieldType::I8, 0, 1.0),
            column("u16", RecordFieldType::U16, 1, 1.0),
            column("scaled", RecordFieldType::I32, 3, 1e7),
            column("f32", RecordFieldType::F32, 7, 1.0),
            column("f64", RecordFieldType::F64, 11, 1.0),
            column("name", RecordFieldType::Text(4), 19, 1.0),
        ];
        let mut record = vec![0xff];
        record.extend(65535u16.to_le_bytes());
        record.extend((-353_632_621i32).to_le_bytes());
        record.extend(0.1f32.to_le_bytes());
        record.extend(f64::MIN_POSITIVE.to_le_bytes());
        record.extend(b"ab\0d");
        let mut records = RecordBuffer::new(columns, WideIntegerScan::default(), record.len());
        records.push(&record);
        records.push(&record[1..]);
        let batch = records.take(Path::new("a")).unwrap();
        assert_eq!(batch.num_rows(), 1);
        let number = |i: usize| batch.column(i).as_primitive::<Float64Type>().value(0);
        let wanted = [-1.0, 65535.0, -35.3632621, f64::from(0.1f32), f64::MIN_POSITIVE];
        assert_eq!([0, 1, 2, 3, 4].map(number), wanted);
        assert_eq!(batch.column(5).as_string::<i32>().value(0), "ab");
        assert!(records.is_empty());
    }

    #[test]
    fn unit_whole_numbers_beyond_a_float_stay_exact() {
        let columns = vec![column("q", RecordFieldType::I64, 0, 1.0), column("Q", RecordFieldType::U64, 8, 1.0)];
        let of = |q: i64, u: u64| [q.to_le_bytes(), u.to_le_bytes()].concat();
        let read = |rows: &[Vec<u8>]| {
            let mut widths = WideIntegerScan::new(&columns);
            rows.iter().for_each(|r| widths.look(r));
            let mut records = RecordBuffer::new(columns.clone(), widths, 16);
            rows.iter().for_each(|r| records.push(r));
            records.take(Path::new("a")).unwrap()
        };
        let small = read(&[of(-(1 << 53), 1 << 53)]);
        assert!(small.columns().iter().all(|c| c.data_type() == &DataType::Float64));
        let large = read(&[of(i64::MIN, (1 << 53) + 1), of(1, 2)]);
        assert_eq!(large.column(0).as_primitive::<Int64Type>().values(), &[i64::MIN, 1]);
        assert_eq!(large.column(1).as_primitive::<Int64Type>().values(), &[(1 << 53) + 1, 2]);
        let larger = read(&[of(1, u64::MAX)]);
        assert_eq!(larger.column(1).as_string::<i32>().value(0), "18446744073709551615");
    }

    #[test]
    fn ref_half_precision() {
        // Values of IEEE 754-2008, table 3.2, and the usual examples of binary16.
        for (bits, x) in
            [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65504.0), (0x0001, 2f64.powi(-24)), (0x3555, 0.333_251_953_125)]
        {
            assert_eq!(half(bits), x);
        }
        assert!(half(0x7c00) == f64::INFINITY && half(0x7e00).is_nan());
    }
}

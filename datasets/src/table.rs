//! A few columns of one length, before conversion to Arrow arrays.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use schemas::{field, flight};

use crate::{ReadError, row_fault::RowFault};

/// The values of a column.
#[derive(Clone, Debug)]
pub enum ColumnValues {
    /// Numbers; NaN is missing.
    Number(Vec<f64>),
    /// Whole numbers, such as the year.
    Whole(Vec<Option<i64>>),
    /// Text.
    Text(Vec<String>),
}

impl ColumnValues {
    pub(crate) fn len(&self) -> usize {
        match self {
            ColumnValues::Number(x) => x.len(),
            ColumnValues::Whole(x) => x.len(),
            ColumnValues::Text(x) => x.len(),
        }
    }
}

/// Named columns in the file's order, each with the unit of its values.
#[derive(Clone, Debug, Default)]
pub struct ColumnTable {
    columns: Vec<(Field, ColumnValues)>,
}

impl ColumnTable {
    /// Appends a column; an empty unit means the canonical unit.
    pub fn push(&mut self, name: &str, unit: &str, values: ColumnValues) {
        self.push_described(name, unit, flight::describe(name).description, values);
    }

    /// Appends a column with its own description.
    pub fn push_described(&mut self, name: &str, unit: &str, description: &str, values: ColumnValues) {
        let known = flight::describe(name);
        let unit = if unit.is_empty() { known.unit } else { unit };
        let data_type = match values {
            ColumnValues::Number(_) => DataType::Float64,
            ColumnValues::Whole(_) => DataType::Int64,
            ColumnValues::Text(_) => DataType::Utf8,
        };
        self.columns.push((field(name, data_type, unit, known.role, description), values));
    }

    /// Puts a column in front of all others.
    pub fn push_front(&mut self, name: &str, values: ColumnValues) {
        self.push(name, "", values);
        self.columns.rotate_right(1);
    }

    /// The numbers of the column `name`, if it exists and is numeric.
    pub fn numbers(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|(f, _)| f.name() == name).and_then(|(_, v)| match v {
            ColumnValues::Number(x) => Some(x.as_slice()),
            _ => None,
        })
    }

    /// Whether there is a column `name`.
    pub fn has(&self, name: &str) -> bool {
        self.columns.iter().any(|(f, _)| f.name() == name)
    }

    /// Removes the column `name`.
    pub fn take(&mut self, name: &str) -> Option<ColumnValues> {
        let at = self.columns.iter().position(|(f, _)| f.name() == name)?;
        Some(self.columns.remove(at).1)
    }

    /// Number of rows of the first column.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, v)| v.len())
    }

    /// The Arrow schema.
    pub fn schema(&self) -> SchemaRef {
        Arc::new(Schema::new(self.columns.iter().map(|(f, _)| f.clone()).collect::<Vec<_>>()))
    }

    /// The columns as one batch.
    ///
    /// # Errors
    /// Fails for columns of different lengths.
    pub fn into_batch(self, path: &Path) -> Result<RecordBatch, ReadError> {
        let schema = self.schema();
        let columns = self.columns.into_iter().map(|(_, v)| array(v)).collect();
        RecordBatch::try_new(schema, columns).map_err(|e| ReadError::data(path, e.to_string()))
    }
}

/// The values as an Arrow column.
pub(crate) fn array(values: ColumnValues) -> ArrayRef {
    match values {
        ColumnValues::Number(x) => Arc::new(Float64Array::from(x)),
        ColumnValues::Whole(x) => Arc::new(Int64Array::from(x)),
        ColumnValues::Text(x) => Arc::new(StringArray::from(x)),
    }
}

/// Converts numbers that must be whole, such as the year. NaN is a missing value. A number with a fraction also becomes
/// a missing value, and gives a fault.
pub(crate) fn whole(path: &Path, name: &str, numbers: &[f64]) -> (ColumnValues, Vec<RowFault>) {
    let mut faults = vec![];
    let mut one = |(row, x): (usize, &f64)| match *x {
        x if x.is_nan() => None,
        // Beyond 2^53, integers may not be exact as f64.
        x if x.fract() == 0.0 && x.abs() < 9e15 => Some(x as i64),
        x => {
            let fault = ReadError::data(path, format!("must be a whole number, not {x}"));
            faults.push(RowFault { row, fault: fault.in_column(name).in_row(row as u64) });
            None
        }
    };
    let whole = numbers.iter().enumerate().map(&mut one).collect();
    (ColumnValues::Whole(whole), faults)
}

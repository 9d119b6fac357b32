//! The columns of one file as named by a mapping, and the recipes of the output columns.

use arrow_array::{Array, ArrayRef, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::{DataType, Schema};
use schemas::Fault;

use super::{
    declare::{QuaternionFrames, QuaternionOrder},
    document::MappingSpan,
    other_ready,
    position::ProjectedPosition,
    row_value::RowExpression,
    vector::SensorMounting,
};

/// Columns of a file, and the faults of their mapping.
pub struct MappingColumns<'a> {
    /// The Arrow fields of the columns.
    pub source: &'a Schema,
    /// Name of the file and the topic, for messages.
    pub place: String,
    /// All faults.
    pub faults: Vec<Fault>,
}

impl<'a> MappingColumns<'a> {
    /// Columns of a file.
    pub fn new(source: &'a Schema, place: String) -> MappingColumns<'a> {
        MappingColumns { source, place, faults: vec![] }
    }

    /// Adds a fault.
    pub fn push(&mut self, fault: Fault) {
        self.faults.push(fault);
    }

    /// The position of a column.
    pub fn find(&mut self, name: &str, at: MappingSpan) -> Option<usize> {
        let found = self.source.index_of(name).ok();
        if found.is_none() {
            let names: Vec<&str> = self.source.fields().iter().map(|f| f.name().as_str()).collect();
            let fault = Fault::new(format!("there is no column `{name}` in {}", self.place));
            let mut fault = fault.nearest(name, &names);
            if let Some(ready) = other_ready::fitting(self.source) {
                let known = fault.help.unwrap_or_default();
                fault.help = Some(format!("{known}; the built-in mapping `{ready}` reads tables with these columns"));
            }
            self.push(fault.at(at));
        }
        found
    }

    /// The position of a column of numbers.
    pub fn number(&mut self, name: &str, at: MappingSpan) -> Option<usize> {
        let found = self.find(name, at.clone())?;
        let kind = self.source.field(found).data_type();
        if is_number(kind) {
            return Some(found);
        }
        let fault = Fault::new(format!("the column `{name}` of {} contains {kind}, not numbers", self.place));
        self.push(fault.help("convert text to numbers with an expression: `sql = \"cast(... as double)\"`").at(at));
        None
    }

    pub(super) fn expression(&mut self, sql: &str, at: MappingSpan) -> Option<SqlExpression> {
        match RowExpression::new(sql, self.source) {
            Ok(value) => Some(SqlExpression { value, at }),
            Err(fault) => {
                let fault = Fault { what: format!("{} in {}", fault.what, self.place), ..fault };
                self.push(fault.at(at));
                None
            }
        }
    }

    /// The unit that the file states for a column.
    pub(super) fn unit_of_file(&self, at: usize) -> Option<&'a str> {
        self.source.field(at).metadata().get("unit").map(String::as_str).filter(|u| !u.is_empty())
    }
}

/// SQL expression, and its position in the mapping.
#[derive(Clone, Debug)]
pub struct SqlExpression {
    pub(super) value: RowExpression,
    pub(super) at: MappingSpan,
}

impl SqlExpression {
    /// Values.
    ///
    /// # Errors
    /// Fails if the expression cannot be evaluated, with its position in the mapping.
    pub fn evaluate(&self, batch: &RecordBatch) -> Result<ArrayRef, Fault> {
        self.value.evaluate(batch).map_err(|f| f.at(self.at.clone()))
    }
}

/// Source of numbers: a column or an expression.
#[derive(Clone, Debug)]
pub(super) enum NumberSource {
    Column(usize),
    Sql(SqlExpression),
}

impl NumberSource {
    pub(super) fn read(&self, batch: &RecordBatch) -> Result<Vec<f64>, Fault> {
        match self {
            NumberSource::Column(at) => numbers(batch, *at),
            NumberSource::Sql(sql) => as_numbers(&sql.evaluate(batch)?).map_err(|f| f.at(sql.at.clone())),
        }
    }
}

/// Recipe of one, two or three output columns.
#[derive(Clone, Debug)]
pub(super) enum ColumnRecipe {
    /// Unchanged column of the file.
    AsItIs(usize),
    /// Result of an expression.
    AsGiven(SqlExpression),
    Linear {
        numbers: NumberSource,
        scale: f64,
        offset: f64,
    },
    Number(f64),
    Whole(i64),
    Text(String),
    Vector {
        numbers: Box<[NumberSource; 3]>,
        scale: [f64; 3],
        offset: [f64; 3],
        mounting: SensorMounting,
    },
    Quaternion {
        at: [usize; 4],
        order: QuaternionOrder,
        frames: QuaternionFrames,
    },
    Projected {
        at: [usize; 2],
        position: Box<ProjectedPosition>,
    },
}

/// The numbers of a column; NaN for missing values.
///
/// # Errors
/// Fails for a column without numbers, which is an error in the program.
pub fn numbers(batch: &RecordBatch, at: usize) -> Result<Vec<f64>, Fault> {
    as_numbers(column(batch, at)?)
}

/// The strings of a column.
///
/// # Errors
/// Fails for a missing column, which is an error in the program.
pub fn texts(batch: &RecordBatch, at: usize) -> Result<Vec<Option<String>>, Fault> {
    let text = cast(column(batch, at)?, &DataType::Utf8).map_err(|e| Fault::data(e.to_string()))?;
    Ok(text.as_string::<i32>().iter().map(|t| t.map(str::to_owned)).collect())
}

pub(super) fn column(batch: &RecordBatch, at: usize) -> Result<&ArrayRef, Fault> {
    batch.columns().get(at).ok_or_else(|| Fault::bug("a batch lacks a column of the mapping"))
}

pub(super) fn as_numbers(array: &ArrayRef) -> Result<Vec<f64>, Fault> {
    let array = match array.data_type() {
        DataType::Timestamp(..) => &cast(array, &DataType::Int64).map_err(|e| Fault::data(e.to_string()))?,
        _ => array,
    };
    let cast = cast(array, &DataType::Float64).map_err(|e| Fault::data(e.to_string()))?;
    Ok(cast.as_primitive::<Float64Type>().iter().map(|x| x.unwrap_or(f64::NAN)).collect())
}

pub(super) fn is_number(kind: &DataType) -> bool {
    match kind {
        DataType::Dictionary(_, value) => is_number(value),
        DataType::Boolean | DataType::Null => true,
        other => other.is_numeric(),
    }
}

/// Whether a column holds text.
pub fn is_text(source: &Schema, at: usize) -> bool {
    let kind = match source.field(at).data_type() {
        DataType::Dictionary(_, value) => value.as_ref(),
        other => other,
    };
    matches!(kind, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View)
}

//! Lines and tables for the tests of stages.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::{Field, Schema};
use schemas::{Column, Fault, LineInput, LineOutput, SurveyPoint, SurveyStage, Table, TableShape};

/// Columns of numbers: name, unit, values.
pub type StageTestColumns<'a> = Vec<(&'a str, &'a str, Vec<f64>)>;

pub fn batch(columns: StageTestColumns) -> RecordBatch {
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns
        .into_iter()
        .map(|(name, unit, values)| {
            (Column::float(name, unit, "").field(), Arc::new(Float64Array::from(values)) as ArrayRef)
        })
        .unzip();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
}

/// A point of a sweep over a stage that processes all lines together, without models or maps.
pub fn point<S: SurveyStage>(stage: &S) -> SurveyPoint<'_, S> {
    SurveyPoint { stage, inputs: &[] }
}

/// A line with these inputs in order.
pub fn line(inputs: Vec<RecordBatch>) -> LineInput {
    LineInput { flight: "1".into(), line: "1.01".into(), inputs, keep: None }
}

/// The numbers of a stage's output, column by column.
pub fn numbers(made: LineOutput) -> Result<Vec<Vec<f64>>, Fault> {
    Ok(made?.iter().map(|array| array.as_primitive::<Float64Type>().values().to_vec()).collect())
}

/// A table of lines with these columns, each a name and a unit, sampled at `rate_hz`.
pub fn table(columns: &[(&str, &str)], rate_hz: Option<f64>) -> Table {
    let columns = columns
        .iter()
        .map(|(name, unit)| {
            let known = schemas::flight::describe(name);
            Column::float(*name, *unit, "").role(known.role)
        })
        .collect();
    Table::Lines(TableShape { columns, rate_hz })
}

/// Faults as text, each with its parameter.
pub fn fault_texts(faults: Vec<Fault>) -> String {
    let one = |f: &Fault| format!("{f} [{}]", f.param.clone().unwrap_or_default());
    faults.iter().map(one).collect::<Vec<_>>().join("; ")
}

/// `rows` values at `rate_hz`, beginning at `first_s`.
pub fn sampled(first_s: f64, rate_hz: f64, rows: usize, of: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..rows).map(|k| of(first_s + k as f64 / rate_hz)).collect()
}

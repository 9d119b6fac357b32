//! The warnings of the last run, read back from its table.

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use plan::{Plan, SweepPoint};
use schemas::Fault;
use store::{Store, published};

use super::{Warning, WarningKind};
use crate::scores::AxisValues;

const COLUMNS: [&str; 9] = ["flight", "line", "stage", "kind", "value", "limit", "unit", "text", "cause"];
const UNITS: [&str; 4] = ["m", "nT", "s", "1"];

/// The table `warnings` of the last run of `plan`. `None` if the table is missing or incomplete, for example when an
/// axis has the name of one of its columns.
///
/// # Errors
/// Fails if the table exists but cannot be read.
pub fn written(plan: &Plan, store: &Store) -> Result<Option<Vec<Warning>>, Fault> {
    let axes = &plan.spec.axes;
    if axes.iter().any(|a| COLUMNS.contains(&a.name.as_str())) {
        return Ok(None);
    }
    let names: Vec<&str> = axes.iter().map(|a| a.name.as_str()).chain(COLUMNS).collect();
    let Some(batch) = published(&store.table(&plan.spec.name, "warnings"), &names)? else { return Ok(None) };
    let known: Vec<AxisValues> = axes.iter().map(|a| AxisValues::new(&a.values)).collect();
    let cell = |row: usize, name: &str| -> Option<String> {
        let array = batch.column_by_name(name).filter(|a| a.is_valid(row))?;
        arrow_cast::display::array_value_to_string(array, row).ok()
    };
    let number = |row: usize, name: &str| {
        let array = batch.column_by_name(name)?.as_primitive_opt::<Float64Type>()?;
        array.is_valid(row).then(|| array.value(row))
    };
    let one = |row: usize| -> Option<Warning> {
        let mut point = SweepPoint::new();
        for (axis, known) in axes.iter().zip(&known) {
            if let Some(text) = cell(row, &axis.name) {
                point.insert(axis.name.clone(), axis.values.get(known.position(&text)?)?.clone());
            }
        }
        let word = cell(row, "kind")?;
        let unit = cell(row, "unit").unwrap_or_default();
        Some(Warning {
            stage: cell(row, "stage")?,
            point,
            line: cell(row, "flight").zip(cell(row, "line")),
            kind: WarningKind::ALL.into_iter().find(|k| k.as_str() == word)?,
            value: number(row, "value"),
            limit: number(row, "limit"),
            unit: if unit.is_empty() { "" } else { UNITS.into_iter().find(|u| *u == unit)? },
            text: cell(row, "text")?,
            cause: cell(row, "cause"),
        })
    };
    Ok((0..batch.num_rows()).map(one).collect())
}

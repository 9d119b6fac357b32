//! Training curves of models, and the importance of their inputs.

use std::collections::BTreeMap;

use arrow_array::{Array, RecordBatch, StringArray, cast::AsArray};
use schemas::Fault;
use serde_json::{Value, json};

use super::{StoreView, ViewFault, ViewPoint, scores::numbers, table::ViewTable};
use crate::html::LossCurve;

impl StoreView {
    /// Losses of the training of a model at a point, as JSON: pairs of epoch and loss. The list is empty for a model
    /// without epochs.
    ///
    /// # Errors
    /// Fails for an unknown or incomplete point, or for a table that is not a model. Also fails if the store is
    /// damaged.
    pub fn training(&self, name: &str, point: &ViewPoint) -> Result<Value, ViewFault> {
        let (_, table) = self.table(name)?;
        let batch = rows(&table, point, ["term", "value"])?;
        let (terms, values) = (texts(&batch, "term")?, numbers(&batch, "value")?);
        let known = (0..batch.num_rows()).filter(|row| terms.is_valid(*row) && values.is_valid(*row));
        let curve = LossCurve::from_terms(known.map(|row| (terms.value(row), values.value(row))));
        Ok(json!({ "table": table.name, "training": curve.training, "validation": curve.validation }))
    }

    /// Importance of the inputs of a model at a point, as JSON: for each group of inputs, its absolute value on each
    /// line.
    ///
    /// # Errors
    /// Fails for an unknown or incomplete point, or for a table without importance. Also fails if the store is damaged.
    pub fn importance(&self, name: &str, point: &ViewPoint) -> Result<Value, ViewFault> {
        let (_, table) = self.table(name)?;
        let batch = rows(&table, point, ["group", "value", "method", "unit", "flight", "line"])?;
        let [group, method, unit, flight, line] =
            ["group", "method", "unit", "flight", "line"].map(|column| texts(&batch, column));
        let (group, method, unit, flight, line) = (group?, method?, unit?, flight?, line?);
        let values = numbers(&batch, "value")?;
        let mut groups: BTreeMap<&str, Vec<Value>> = BTreeMap::new();
        for row in (0..batch.num_rows()).filter(|row| values.is_valid(*row) && values.value(*row).is_finite()) {
            let one = json!([flight.value(row), line.value(row), values.value(row).abs()]);
            groups.entry(group.value(row)).or_default().push(one);
        }
        let groups: Vec<Value> =
            groups.into_iter().map(|(name, lines)| json!({ "name": name, "lines": lines })).collect();
        let first = |column: &StringArray| if column.is_empty() { String::new() } else { column.value(0).to_owned() };
        Ok(json!({ "table": table.name, "method": first(method), "unit": first(unit), "groups": groups }))
    }
}

/// The rows at a point of a table that must have these columns.
fn rows<const N: usize>(table: &ViewTable, point: &ViewPoint, columns: [&str; N]) -> Result<RecordBatch, ViewFault> {
    let known = table.provider.columns();
    if let Some(missing) = columns.iter().find(|name| known.field_with_name(name).is_err()) {
        return Err(ViewFault::Wrong(Fault::new(format!("`{}` has no column `{missing}`", table.name))));
    }
    table.rows_at(point, &columns)
}

/// The texts of a column; a column of another type is treated as damage.
fn texts<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a StringArray, Fault> {
    let found = batch.column_by_name(name).and_then(|a| a.as_string_opt::<i32>());
    found.ok_or_else(|| Fault::machine(format!("the table has no text column `{name}`")))
}

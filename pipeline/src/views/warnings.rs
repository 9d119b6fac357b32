//! What fits say against themselves, for the end of a run.

use std::path::Path;

use arrow_array::{Array, RecordBatch, cast::AsArray};
use arrow_cast::display::array_value_to_string;
use schemas::Fault;

use crate::{plan::Plan, store::read_columns};

/// As many warnings are told one by one.
const TOLD: usize = 5;

/// The warnings of all fits of a run whose tables are in `folder`: one for each point of a sweep, the first of them in
/// full and the number of the others.
///
/// # Errors
/// When a table cannot be read.
pub fn warnings(plan: &Plan, folder: &Path) -> Result<Vec<String>, Fault> {
    let mut found = vec![];
    for node in plan.tables.iter().filter(|t| t.entry.name == "fit") {
        let file = folder.join(&node.name).join("part-0.parquet");
        if !file.is_file() {
            continue;
        }
        let axes: Vec<&str> =
            node.axes.iter().filter_map(|i| plan.spec.axes.get(*i)).map(|a| a.name.as_str()).collect();
        let columns: Vec<&str> = axes.iter().copied().chain(["warning"]).collect();
        found.extend(of_table(&node.name, &axes, &read_columns(&file, &columns)?)?);
    }
    let more = found.len().saturating_sub(TOLD);
    found.truncate(TOLD);
    if more > 0 {
        let fits = if more == 1 { "fit has a warning" } else { "fits have warnings" };
        found.push(format!("{more} more {fits}; they stand in the column `warning` of the models' tables"));
    }
    Ok(found)
}

/// The rows of a model all bear its warning: each is told once.
fn of_table(table: &str, axes: &[&str], batch: &RecordBatch) -> Result<Vec<String>, Fault> {
    let unreadable = |e: &dyn std::fmt::Display| Fault::machine(format!("cannot read the table {table}: {e}"));
    let Some(texts) = batch.column_by_name("warning").and_then(|a| a.as_string_opt::<i32>()) else { return Ok(vec![]) };
    let mut told: Vec<String> = vec![];
    for row in (0..batch.num_rows()).filter(|i| texts.is_valid(*i) && !texts.value(*i).is_empty()) {
        let mut point = vec![];
        for (column, name) in batch.columns().iter().zip(axes) {
            let value = array_value_to_string(column, row).map_err(|e| unreadable(&e))?;
            point.push(format!("{name} = {value}"));
        }
        let point = if point.is_empty() { String::new() } else { format!(" ({})", point.join(", ")) };
        let text = format!("{table}{point}: {}", texts.value(row));
        // Rows of one point lie one behind the other.
        if told.last() != Some(&text) {
            told.push(text);
        }
    }
    Ok(told)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array, StringArray};

    use super::*;

    #[test]
    fn law_a_model_warns_once_whatever_the_number_of_its_terms() {
        let lambda: ArrayRef = Arc::new(Float64Array::from(vec![0.0, 0.0, 0.5, 0.5]));
        let warning: ArrayRef = Arc::new(StringArray::from(vec!["weak", "weak", "", ""]));
        let batch = RecordBatch::try_from_iter([("lambda", lambda), ("warning", warning)]).unwrap();
        assert_eq!(of_table("model", &["lambda"], &batch).unwrap(), ["model (lambda = 0.0): weak"]);
    }
}

//! Table of the data quality: findings in the columns of each line, made when the line was read.

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{Field, Schema};
use intake::Finding;
use plan::{PlanGraph, sources::LineRecord};
use schemas::{Fault, Role, field};
use store::{ExtraTable, Store};

/// Row of the table: the name of the table of flights, the line, and the finding.
type QualityFindingRow<'a> = (&'a str, &'a LineRecord, &'a Finding);

fn rows<'a>(graph: &'a PlanGraph) -> Vec<QualityFindingRow<'a>> {
    let tables = graph.plan.flights.iter().zip(&graph.records);
    let lines = tables.flat_map(|(flights, records)| records.values().map(|r| (flights.name.as_str(), r)));
    lines.flat_map(|(table, record)| record.findings.iter().map(move |f| (table, record, f))).collect()
}

/// Number of findings, and number of lines with findings.
pub fn count(graph: &PlanGraph) -> (usize, usize) {
    let records = graph.records.iter().flat_map(|r| r.values());
    let of_lines: Vec<usize> = records.map(|r| r.findings.len()).filter(|n| *n > 0).collect();
    (of_lines.iter().sum(), of_lines.len())
}

/// Writes all findings, even if the table is empty.
///
/// # Errors
/// Fails if the store cannot be written.
pub fn table(graph: &PlanGraph, store: &Store) -> Result<ExtraTable, Fault> {
    let rows = rows(graph);
    let text = |f: &dyn Fn(&QualityFindingRow) -> String| -> ArrayRef {
        Arc::new(rows.iter().map(|r| Some(f(r))).collect::<StringArray>())
    };
    let whole = |f: fn(&Finding) -> u64| -> ArrayRef {
        Arc::new(rows.iter().map(|r| i64::try_from(f(r.2)).ok()).collect::<Int64Array>())
    };
    let value: ArrayRef = Arc::new(rows.iter().map(|r| r.2.value()).collect::<Float64Array>());
    let columns = [
        ("source", text(&|r| r.0.to_owned()), Role::Key, "the table of flights"),
        ("flight", text(&|r| r.1.flight.clone()), Role::Key, "flight identifier"),
        ("line", text(&|r| r.1.line.clone()), Role::Key, "line identifier"),
        ("column_name", text(&|r| r.2.column.clone()), Role::Key, "the column or vector magnetometer of the finding"),
        ("finding", text(&|r| r.2.check.as_str().to_owned()), Role::Key, "the finding"),
        ("n", whole(|f| f.n), Role::Derived, "the number of affected samples"),
        (
            "first_row",
            whole(|f| f.first_row),
            Role::Derived,
            "the row of the first affected sample in its line, counted from 0",
        ),
        ("value", value, Role::Derived, "the value of the first affected sample; null if missing or infinite"),
        ("unit", text(&|r| r.2.unit.clone()), Role::Derived, "the unit of the value"),
    ];
    let fields: Vec<Field> = columns
        .iter()
        .map(|(name, array, role, about)| field(name, array.data_type().clone(), "", *role, about))
        .collect();
    let arrays = columns.into_iter().map(|(_, array, ..)| array).collect();
    let batch =
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))?;
    let file = store.temporary();
    store.write_table(&file, &batch, &[])?;
    Ok(ExtraTable { name: "quality".to_owned(), file })
}

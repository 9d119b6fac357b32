//! Recomputation of stored results, to compare them bit by bit.
//!
//! An ordinary run recomputes the results from the same inputs. This run uses a copy of the store without the results,
//! so the store itself does not change.

use std::collections::HashSet;

use arrow_array::{Array, RecordBatch};
use arrow_cast::display::array_value_to_string;
use plan::{Plan, PlanGraph, PlanUnit, spec::SpecFaults};
use schemas::{Fault, keys::HashKey};
use store::Store;

use super::{Failure, Listener, as_planned};

/// Outcome of the recomputation of a table.
#[derive(Clone, Debug)]
pub struct TableComparison {
    /// Name of the table.
    pub table: String,
    /// Number of units that were compared.
    pub units: usize,
    /// Units that differ, with the first difference.
    pub differ: Vec<Failure>,
}

/// Recomputes the table at position `table` of the plan, or all tables, and compares them bit by bit with the store.
/// For a search, the trials of the plan are compared. `None` after an interrupt.
///
/// # Errors
/// Fails if a source cannot be read, or the store cannot be read or written.
pub fn again(
    plan: &Plan,
    store: &Store,
    table: Option<usize>,
    listener: &dyn Listener,
) -> Result<Option<Vec<TableComparison>>, SpecFaults> {
    let fail = |fault: Fault| plan.spec.faults(vec![fault]);
    let graph = PlanGraph::new(plan, store, &|_, _| {})?;
    let tables: Vec<usize> = match table {
        Some(t) => vec![t],
        None => (0..plan.tables.len()).filter(|t| plan.tables.get(*t).is_some_and(|n| n.keep)).collect(),
    };
    let units = tables.iter().flat_map(|t| graph.units(*t));
    // A unit that cannot be computed has no result to compare.
    let keys: HashSet<HashKey> =
        units.filter_map(|u| graph.key(u).ok()).filter(|key| store.find(*key).is_some()).collect();
    let other = store.mirror(&store.temporary(), &keys).map_err(fail)?;
    if as_planned(plan, &other, table, listener)? {
        return Ok(None);
    }
    tables
        .into_iter()
        .map(|t| compared(&graph, t, store, &other, &keys))
        .collect::<Result<_, _>>()
        .map(Some)
        .map_err(fail)
}

fn compared(
    graph: &PlanGraph,
    t: usize,
    one: &Store,
    other: &Store,
    keys: &HashSet<HashKey>,
) -> Result<TableComparison, Fault> {
    let table = graph.plan.table_name(t).to_owned();
    let mut found = TableComparison { table: table.clone(), units: 0, differ: vec![] };
    let mut seen: HashSet<HashKey> = HashSet::new();
    for unit in graph.units(t) {
        // Points with equal settings share one result.
        let Some(key) = graph.key(unit).ok().filter(|key| keys.contains(key) && seen.insert(*key)) else { continue };
        found.units += 1;
        if let Some(what) = difference(graph, unit, key, one, other)? {
            let fault = Fault::machine(what)
                .help("the store is unchanged; another machine or build may have computed the stored result");
            let line = unit.line.and_then(|l| graph.lines.get(l)).cloned();
            let point = graph.plan.instance(unit.table, unit.instance).point();
            found.differ.push(Failure { table: table.clone(), point, line, fault });
        }
    }
    Ok(found)
}

/// First difference between two results of a unit.
fn difference(
    graph: &PlanGraph,
    unit: PlanUnit,
    key: HashKey,
    one: &Store,
    other: &Store,
) -> Result<Option<String>, Fault> {
    match (one.has(key), other.has(key)) {
        (false, false) => return Ok(None),
        (true, true) => {}
        (true, false) => return Ok(Some("the unit cannot be recomputed".to_owned())),
        (false, true) => return Ok(Some("the unit failed before and succeeds now".to_owned())),
    }
    let it = graph.plan.instance(unit.table, unit.instance);
    let names: Vec<&str> = it.yields.columns.iter().map(|c| c.name.as_str()).collect();
    Ok(first(&one.get(key, &names)?, &other.get(key, &names)?))
}

/// First value that differs between two batches, compared bit by bit.
fn first(a: &RecordBatch, b: &RecordBatch) -> Option<String> {
    if a.num_rows() != b.num_rows() {
        return Some(format!("{} rows before, {} now", a.num_rows(), b.num_rows()));
    }
    for ((field, x), y) in a.schema().fields().iter().zip(a.columns()).zip(b.columns()) {
        if x.to_data() == y.to_data() {
            continue;
        }
        let row = (0..x.len()).find(|i| x.slice(*i, 1).to_data() != y.slice(*i, 1).to_data()).unwrap_or(0);
        let shown = |array: &dyn Array| array_value_to_string(array, row).unwrap_or_else(|_| "?".to_owned());
        return Some(format!("column `{}`, row {row}: {} before, {} now", field.name(), shown(x), shown(y)));
    }
    None
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::Float64Array;
    use arrow_schema::{DataType, Field, Schema};

    use super::*;

    #[test]
    fn unit_comparison_is_bitwise_and_nan_equals_itself() {
        let of = |values: Vec<f64>| {
            let schema = Schema::new(vec![Field::new("x", DataType::Float64, true)]);
            RecordBatch::try_new(Arc::new(schema), vec![Arc::new(Float64Array::from(values))]).unwrap()
        };
        let one = of(vec![1.0, f64::NAN, 0.0]);
        assert_eq!(first(&one, &one.clone()), None);
        assert_eq!(first(&one, &of(vec![1.0, f64::NAN, -0.0])).unwrap(), "column `x`, row 2: 0.0 before, -0.0 now");
        assert!(first(&one, &of(vec![1.0 + f64::EPSILON, f64::NAN, 0.0])).unwrap().contains("row 0"));
        assert_eq!(first(&one, &of(vec![1.0])).unwrap(), "3 rows before, 1 now");
    }
}

//! Logical table: a published table completed by the columns that pass through its stage. This module finds, for each
//! row, the units that contain these columns.
//!
//! A published table holds the keys and the columns that its stage made. A column that passes through is in a unit of
//! an ancestor table, which has the same rows. The number of steps to the ancestor is counted along the chain of first
//! inputs. The file of the logical table has one row per unit, with the keys of the units on the unit's chain. A
//! pattern is the number of steps to each column; the metadata of the file hold each distinct pattern once.

use std::{
    collections::{BTreeMap, HashMap},
    path::PathBuf,
    sync::Arc,
};

use arrow_array::{ArrayRef, FixedSizeBinaryArray, Int64Array, RecordBatch, StringArray, new_null_array};
use arrow_ipc::convert::IpcSchemaEncoder;
use arrow_schema::{Field, Schema, SchemaRef};
use plan::{LineId, PlanGraph, PlanUnit, StageVariant, TableNode, TableRef};
use results::logical::{PATTERNS, SCHEMA};
use schemas::{Column, Fault, Role, field};
use store::Store;

use super::{
    cut::{TableAssembler, axis_type, axis_values, one_type},
    layout::TableLayout,
};

/// Columns of a logical table: the axes, then all columns that the table's stage makes or passes through.
///
/// # Errors
/// Fails if the types of a column at different sweep points do not fit one table.
pub fn schema(graph: &PlanGraph, node: &TableNode) -> Result<SchemaRef, Fault> {
    let spec = &graph.plan.spec;
    let axes = node.axes.iter().filter_map(|i| spec.axes.get(*i));
    let axes: Vec<Field> =
        axes.map(|a| field(&a.name, axis_type(&a.values[0]), "", Role::Key, "axis of the sweep")).collect();
    let mut fields = axes;
    for column in node.columns() {
        if !fields.iter().any(|f| f.name() == &column.name) {
            let all: Vec<&Column> = node.variants.iter().filter_map(|v| v.table.shape().get(&column.name)).collect();
            fields.push(one_type(&column, &all)?);
        }
    }
    Ok(Arc::new(Schema::new(fields)))
}

/// Point of a table, followed by its first input, the first input of that input, and so on.
fn chain(graph: &PlanGraph, t: usize, instance: usize) -> Vec<TableRef> {
    let mut chain = vec![TableRef::Stage(t, instance)];
    while let Some(TableRef::Stage(t, i)) = chain.last().copied() {
        match graph.plan.instance(t, i).first_input() {
            Some(up @ (TableRef::Stage(..) | TableRef::Flights(_))) => chain.push(up),
            Some(TableRef::Map(_)) | None => break,
        }
    }
    chain
}

/// Number of steps to each column of a point.
fn pattern(graph: &PlanGraph, chain: &[TableRef], names: &[String]) -> BTreeMap<String, usize> {
    let Some(TableRef::Stage(t, i)) = chain.first().copied() else { return BTreeMap::new() };
    let own = graph.plan.instance(t, i);
    let depth = |name: &String| {
        own.table.shape().get(name)?;
        chain.iter().position(|r| match r {
            TableRef::Stage(t, i) => graph.plan.instance(*t, *i).makes(name).is_some(),
            TableRef::Flights(_) => true,
            TableRef::Map(_) => false,
        })
    };
    names.iter().filter_map(|n| Some((n.clone(), depth(n)?))).collect()
}

/// Patterns in the order of their first occurrence. In a sweep, the columns may differ in shape from point to point,
/// but most of these shapes have the same pattern.
#[derive(Default)]
struct DistinctPatterns {
    all: Vec<BTreeMap<String, usize>>,
    known: HashMap<BTreeMap<String, usize>, usize>,
}

impl DistinctPatterns {
    /// Position of a pattern, which is added if it is new.
    fn position(&mut self, pattern: BTreeMap<String, usize>) -> usize {
        *self.known.entry(pattern).or_insert_with_key(|pattern| {
            self.all.push(pattern.clone());
            self.all.len() - 1
        })
    }
}

/// Writes the file for the table of `cut`; `None` if the published table is complete.
///
/// # Errors
/// Fails if the store cannot be written.
pub fn write(
    graph: &PlanGraph,
    store: &Store,
    cut: &TableAssembler,
    t: usize,
    there: &(dyn Fn(PlanUnit) -> bool + Sync),
) -> Result<Option<PathBuf>, Fault> {
    let plan = graph.plan;
    let node = &plan.tables[t];
    let logical = schema(graph, node)?;
    if node.is_small() || logical.fields().len() == cut.schema.fields().len() {
        return Ok(None);
    }
    let units: Vec<PlanUnit> = TableLayout::new(graph, t, cut).units.into_iter().filter(|u| there(*u)).collect();
    let names: Vec<String> = logical.fields().iter().map(|f| f.name().clone()).collect();
    let mut patterns = DistinctPatterns::default();
    // Points whose chains have the same shapes have the same pattern.
    let mut known: HashMap<Vec<(TableRef, *const StageVariant)>, usize> = HashMap::new();
    let mut of_point: HashMap<usize, (usize, Vec<TableRef>)> = HashMap::new();
    for unit in &units {
        of_point.entry(unit.instance).or_insert_with(|| {
            let chain = chain(graph, t, unit.instance);
            let shape = |r: &TableRef| match r {
                TableRef::Stage(t, i) => {
                    (TableRef::Stage(*t, 0), std::ptr::from_ref(graph.plan.instance(*t, *i).variant))
                }
                other => (*other, std::ptr::null()),
            };
            let shapes = chain.iter().map(shape).collect();
            let of = *known.entry(shapes).or_insert_with(|| patterns.position(pattern(graph, &chain, &names)));
            (of, chain)
        });
    }
    let depth = of_point.values().map(|(_, chain)| chain.len()).max().unwrap_or(0);
    let mut fields = vec![
        field("pattern", arrow_schema::DataType::Int64, "", Role::Key, "which columns lie where"),
        field("flight", arrow_schema::DataType::Utf8, "", Role::Key, "flight identifier"),
        field("line", arrow_schema::DataType::Utf8, "", Role::Key, "line identifier"),
    ];
    let of = |u: &PlanUnit| of_point.get(&u.instance);
    let text = |f: fn(&(String, String)) -> &String| -> ArrayRef {
        Arc::new(units.iter().map(|u| u.line.and_then(|l| graph.lines.get(l)).map(f)).collect::<StringArray>())
    };
    let mut columns: Vec<ArrayRef> = vec![
        Arc::new(units.iter().map(|u| of(u).and_then(|(p, _)| i64::try_from(*p).ok())).collect::<Int64Array>()),
        text(|l| &l.0),
        text(|l| &l.1),
    ];
    for i in &node.axes {
        let Some(axis) = plan.spec.axes.get(*i) else { continue };
        let kind = axis_type(&axis.values[0]);
        let value = |u: &PlanUnit| match plan.instance(t, u.instance).point().get(&axis.name) {
            Some(value) => axis_values(value, 1),
            None => new_null_array(&kind, 1),
        };
        let cells: Vec<ArrayRef> = units.iter().map(value).collect();
        let cells: Vec<&dyn arrow_array::Array> = cells.iter().map(AsRef::as_ref).collect();
        columns.push(if cells.is_empty() {
            new_null_array(&kind, 0)
        } else {
            arrow_select::concat::concat(&cells).map_err(|e| Fault::machine(e.to_string()))?
        });
        // The prefix is needed because a column of a unit may have the name of an axis.
        fields.push(field(&format!("axis {}", axis.name), kind, "", Role::Key, "axis of the sweep"));
    }
    for step in 0..depth {
        let key = |u: &PlanUnit, line: LineId| {
            let r = of(u).and_then(|(_, chain)| chain.get(step))?;
            graph.object(*r, line).ok()
        };
        let keys = units.iter().map(|u| u.line.and_then(|l| key(u, l)));
        let array = FixedSizeBinaryArray::try_from_sparse_iter_with_size(keys, 16);
        columns.push(Arc::new(array.map_err(|e| Fault::machine(e.to_string()))?));
        let kind = arrow_schema::DataType::FixedSizeBinary(16);
        fields.push(field(
            &format!("key {step}"),
            kind,
            "",
            Role::Key,
            "key of the unit, or of a unit upstream; the number in the column name is the number of steps upstream",
        ));
    }
    let batch =
        RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).map_err(|e| Fault::machine(e.to_string()))?;
    let message = IpcSchemaEncoder::new().schema_to_fb(&logical);
    let spelt: String = message.finished_data().iter().map(|b| format!("{b:02x}")).collect();
    let patterns = serde_json::to_string(&patterns.all).map_err(|e| Fault::machine(e.to_string()))?;
    let file = store.temporary();
    store.write_table(&file, &batch, &[(SCHEMA.to_owned(), spelt), (PATTERNS.to_owned(), patterns)])?;
    Ok(Some(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bug_equal_patterns_of_a_sweep_are_stored_once() {
        let of = |steps: usize| BTreeMap::from([("mag".to_owned(), steps), ("lat".to_owned(), 1)]);
        let mut patterns = DistinctPatterns::default();
        let at: Vec<usize> = [2, 3, 2, 2, 3].map(|steps| patterns.position(of(steps))).to_vec();
        assert_eq!((at, patterns.all), (vec![0, 1, 0, 0, 1], vec![of(2), of(3)]));
    }
}

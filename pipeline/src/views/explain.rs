//! `magline explain`: the plan as text.

use std::fmt::Write;

use schemas::{Column, Passes};

use super::snapshots;
use crate::{
    plan::{Graph, Instance, TableNode},
    store::Store,
};

/// Tables, axes, points, what is there and what each stage costs.
pub fn explain(graph: &Graph, store: &Store) -> String {
    let plan = graph.plan;
    let mut out = String::new();
    // Writing into a String cannot fail.
    let _ = writeln!(out, "pipeline {}  seed {}", plan.spec.name, plan.spec.seed);
    for axis in &plan.spec.axes {
        let values: Vec<String> = axis.values.iter().map(ToString::to_string).collect();
        let _ = writeln!(out, "axis {} = {}", axis.name, values.join(" | "));
    }
    for (flights, records) in plan.flights.iter().zip(&graph.records) {
        let rows: usize = records.values().map(|r| r.rows).sum();
        let broken = records.values().filter(|r| r.fault.is_some()).count();
        let wrong = if broken > 0 { format!(", {broken} of them unusable") } else { String::new() };
        let columns = flights.shape.columns.len();
        let _ = writeln!(
            out,
            "\n{}  flights: {} lines{wrong}, {rows} samples, {columns} columns",
            flights.name,
            records.len()
        );
    }
    for map in &plan.maps {
        let _ = writeln!(out, "\n{}  map", map.name);
    }
    let before = snapshots(store.root()).into_iter().find(|s| s.pipeline == plan.spec.name);
    for (t, node) in plan.tables.iter().enumerate() {
        let cost = before.as_ref().and_then(|b| b.tables.iter().find(|x| x.name == node.name)).and_then(|x| x.cost);
        let _ = write!(out, "\n{}", table(graph, store, t, node, cost));
    }
    for note in &plan.notes {
        let _ = writeln!(out, "\nnote: {note}");
    }
    out
}

fn table(graph: &Graph, store: &Store, t: usize, node: &TableNode, cost: Option<(usize, f64)>) -> String {
    let mut out = String::new();
    let plan = graph.plan;
    let Some(first) = node.instances.first() else { return out };
    let mut inputs: Vec<&str> = vec![];
    for r in node.instances.iter().flat_map(|i| &i.inputs) {
        if !inputs.contains(&plan.name_of(*r)) {
            inputs.push(plan.name_of(*r));
        }
    }
    let _ = writeln!(out, "{}  {} v{} <- {}", node.name, node.entry.name, node.entry.version, inputs.join(", "));
    let sizes: Vec<String> = node
        .axes
        .iter()
        .map(|i| format!("{} ({})", plan.spec.axes[*i].name, plan.spec.axes[*i].values.len()))
        .collect();
    let over = if sizes.is_empty() {
        "once".to_owned()
    } else {
        format!("at {} points: {}", node.instances.len(), sizes.join(" x "))
    };
    let lines = (0..node.instances.len()).map(|i| graph.lines_of(t, i).len()).max().unwrap_or(0);
    let _ = writeln!(out, "  runs     {over}; {lines} lines");
    if let Some(decl) = plan.spec.stages.iter().find(|s| s.name == node.name)
        && let Some((text, _)) = &decl.predicate
    {
        let _ = writeln!(out, "  where    {text}");
    }
    let _ = writeln!(out, "  with     {}", parameters(node, first));
    let reads: Vec<String> = first
        .yields
        .reads
        .iter()
        .zip(&first.inputs)
        .filter(|(r, _)| !r.is_empty())
        .map(|(r, i)| format!("{}({})", plan.name_of(*i), r.join(", ")))
        .collect();
    let _ = writeln!(out, "  reads    {}", reads.join("; "));
    let made: Vec<String> = first.yields.columns.iter().map(Column::to_string).collect();
    let verb = if first.yields.passes == Passes::All { "appends" } else { "yields " };
    let _ = writeln!(out, "  {verb}  {}", made.join(", "));
    let units = graph.units(t);
    let there = units.iter().filter(|u| graph.key(**u).is_ok_and(|k| store.has(k))).count();
    let price = cost.map(|(n, s)| format!("; {:.3} s each when last computed", s / n as f64)).unwrap_or_default();
    let _ = writeln!(out, "  store    {there} of {} are there, {} to compute{price}", units.len(), units.len() - there);
    out
}

/// Parameters, with the axis in place of a value that varies.
fn parameters(node: &TableNode, first: &Instance) -> String {
    let value = |i: usize, name: &str, v: &str| {
        let same = node.instances.iter().all(|x| x.params.get(i).is_some_and(|(_, o)| o == v));
        if same { format!("{name}={v}") } else { format!("{name}=(varies)") }
    };
    let all: Vec<String> = first.params.iter().enumerate().map(|(i, (n, v))| value(i, n, v)).collect();
    if all.is_empty() { "no parameters".to_owned() } else { all.join(" ") }
}

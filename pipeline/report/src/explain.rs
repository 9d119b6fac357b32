//! `magline explain`: the plan as text.

use std::fmt::Write;

use plan::{
    PlanGraph, TableNode,
    spec::{SearchSpec, Spec},
};
use results::snapshots;
use schemas::{Column, Grain, Literal, PassThroughColumns};
use store::Store;

/// Tables, axes, points, the results in the store and the cost of each stage.
pub fn explain(graph: &PlanGraph, store: &Store) -> String {
    let plan = graph.plan;
    let mut out = String::new();
    // Writing into a String cannot fail.
    let _ = writeln!(out, "pipeline {}  seed {}", plan.spec.name, plan.spec.seed);
    for axis in plan.spec.axes.iter().take(plan.spec.searched.start) {
        let _ = writeln!(out, "axis {} = {}", axis.name, listed(&axis.values));
    }
    if let Some(search) = &plan.spec.search {
        out.push_str(&searched(&plan.spec, search));
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
        let _ = writeln!(out, "\n{}  {}", map.name, map.word());
    }
    let before = snapshots(store.root()).into_iter().find(|s| s.pipeline == plan.spec.name);
    for (t, node) in plan.tables.iter().enumerate() {
        let cost = before.as_ref().and_then(|b| b.tables.iter().find(|x| x.name == node.name)).and_then(|x| x.cost);
        let _ = write!(out, "\n{}", table(graph, store, t, node, cost));
    }
    if plan.spec.search.is_some() {
        let most = |(t, node): (usize, &TableNode)| {
            graph.unit_count(t).saturating_mul(plan.most_points(node)) / node.len().max(1)
        };
        let all = plan.tables.iter().enumerate().map(most).fold(0, usize::saturating_add);
        let _ = writeln!(out, "\nthe complete search has at most {all} units");
    }
    for note in &plan.notes {
        let _ = writeln!(out, "\nnote: {note}");
    }
    out
}

/// A search: its method, its goal, its axes.
fn searched(spec: &Spec, search: &SearchSpec) -> String {
    let mut out = String::new();
    let mut known: Vec<String> =
        spec.axes.get(spec.searched.start).into_iter().flat_map(|a| &a.values).map(ToString::to_string).collect();
    known.dedup();
    let together =
        if search.generation < search.trials { format!(", {} at a time", search.generation) } else { String::new() };
    let direction = search.direction.map(|d| format!(" ({})", d.word())).unwrap_or_default();
    let lines = search.predicate.as_ref().map(|(text, _)| format!(" where {text}")).unwrap_or_default();
    let _ = writeln!(
        out,
        "search {} for {}.{}{direction}{lines}: {} trials{together}, {} of them planned, seed {}",
        search.named.word(),
        search.table,
        search.metric,
        search.trials,
        known.len(),
        search.seed
    );
    if let Some(halving) = &search.halving {
        let of = format!("1 of {} trials is promoted to the next rung", halving.eta);
        let _ = writeln!(out, "rungs {} = {}; {of}", halving.axis, listed(&halving.values));
    }
    for axis in &search.axes {
        let _ = writeln!(out, "axis {} = searched: {}", axis.name, axis.words());
    }
    out
}

/// The values of an axis; of a long list, the first values and the last value.
fn listed(values: &[Literal]) -> String {
    const SHOWN: usize = 40;
    let words: Vec<String> = values.iter().take(SHOWN).map(ToString::to_string).collect();
    match values.last() {
        Some(last) if values.len() > SHOWN => format!("{} | ... | {last} ({} values)", words.join(" | "), values.len()),
        _ => words.join(" | "),
    }
}

fn table(graph: &PlanGraph, store: &Store, t: usize, node: &TableNode, cost: Option<(usize, f64)>) -> String {
    let mut out = String::new();
    let plan = graph.plan;
    let first = plan.instance(t, 0);
    let inputs: Vec<&str> = node.sources().into_iter().map(|r| plan.name_of(r)).collect();
    let _ = writeln!(out, "{}  {} v{} <- {}", node.name, node.entry.name, node.entry.version, inputs.join(", "));
    let searched = &plan.spec.searched;
    let is_own_axis = |i: &&usize| !searched.contains(i) || **i == searched.start;
    let sizes: Vec<String> = node
        .axes
        .iter()
        .filter(is_own_axis)
        .map(|i| format!("{} ({})", plan.spec.axes[*i].name, plan.spec.axes[*i].values.len()))
        .collect();
    let over =
        if sizes.is_empty() { "once".to_owned() } else { format!("at {} points: {}", node.len(), sizes.join(" x ")) };
    let of = match node.entry.grain {
        Grain::Line | Grain::Survey => format!("; {} lines", graph.most_lines_of(t)),
        Grain::Map => String::new(),
    };
    let most = plan.most_points(node);
    let most = if most > node.len() { format!(", at most {most} after the search") } else { String::new() };
    let _ = writeln!(out, "  runs     {over}{most}{of}");
    if let Some((text, _)) = plan.decl(t).and_then(|d| d.predicate.as_ref()) {
        let _ = writeln!(out, "  where    {text}");
    }
    let _ = writeln!(out, "  with     {}", parameters(graph, t));
    let reads: Vec<String> = first
        .yields
        .reads
        .iter()
        .zip(first.inputs())
        .filter(|(r, _)| !r.is_empty())
        .map(|(r, i)| format!("{}({})", plan.name_of(i), r.join(", ")))
        .collect();
    let _ = writeln!(out, "  reads    {}", reads.join("; "));
    let made: Vec<String> = first.yields.columns.iter().map(Column::to_string).collect();
    let verb = if first.yields.passes == PassThroughColumns::All { "appends" } else { "yields " };
    let _ = writeln!(out, "  {verb}  {}", made.join(", "));
    let units = graph.unit_count(t);
    let there = graph.units(t).filter(|u| graph.key(*u).is_ok_and(|k| store.has(k))).count();
    let price = cost.map(|(n, s)| format!("; {:.3} s each in the last run", s / n as f64)).unwrap_or_default();
    let _ = writeln!(out, "  store    {there} of {units} stored, {} to compute{price}", units - there);
    out
}

/// Maximum number of combinations of parameters that are compared one by one.
const LOOKED_AT: usize = 10_000;

/// Parameters over all points. If the values of a parameter differ between points, a word replaces them.
fn parameters(graph: &PlanGraph, t: usize) -> String {
    let mut all: Vec<(&str, Option<String>)> = vec![];
    for i in graph.plan.tables[t].parameter_points(LOOKED_AT) {
        for (name, value) in graph.plan.instance(t, i).params() {
            match all.iter_mut().find(|(known, _)| *known == name) {
                Some((_, same)) => *same = same.take().filter(|same| *same == value),
                None => all.push((name, Some(value))),
            }
        }
    }
    let word = |(name, same): &(&str, Option<String>)| format!("{name}={}", same.as_deref().unwrap_or("(varies)"));
    let all: Vec<String> = all.iter().map(word).collect();
    if all.is_empty() { "no parameters".to_owned() } else { all.join(" ") }
}

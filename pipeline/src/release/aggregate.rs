//! Rules by which scores and models computed from restricted columns count as aggregates, which may be published.
//!
//! A table is an aggregate if four conditions hold. First, it is not a learned model that can reproduce single samples.
//! Second, no expression of the spec selects or weights the samples. Third, each value is computed from at least
//! `least_samples` samples. Fourth, there are at least `least_ratio` samples per number in a model or in the scores of
//! a line. In addition, aggregates that are published together must not differ by only a few samples.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use arrow_array::{Array, cast::AsArray, types::Int64Type};
use expressions::is_linear;
use plan::{PlanGraph, PlanUnit, spec::publish::ProtectionKeys};
use schemas::{Fault, TableKind};
use store::Store;

use super::protect::LineageColumn;

/// Maximum number of points whose parameters are checked one by one. With more points, each value of an axis is checked
/// instead.
const POINTS: usize = 1000;

/// Numbers of samples from which an aggregate is computed.
pub struct Aggregate {
    /// Smallest number of samples from which any of its values is computed.
    samples: i64,
    /// Smallest number of samples per published number, over all units.
    ratio: f64,
    least_samples: i64,
    least_ratio: f64,
    /// Numbers of samples, by group; the values of a group differ only in the samples from which they are computed.
    counts: BTreeMap<String, BTreeSet<i64>>,
    /// Number of published numbers, and largest number of samples of one of them, by line or set of lines.
    numbers: BTreeMap<String, (usize, i64)>,
}

impl Aggregate {
    /// The figures and a description of the rule.
    pub fn words(&self) -> String {
        format!(
            "at least {} samples per value and {:.0} per published number (minimum {} and {})",
            self.samples, self.ratio, self.least_samples, self.least_ratio
        )
    }
}

/// The small table `t`, which is made from the columns `reached`, as an aggregate; or the reason why the table is not
/// an aggregate.
///
/// # Errors
/// Fails if the store is damaged.
pub fn judge(
    graph: &PlanGraph,
    store: &Store,
    t: usize,
    reached: &HashSet<LineageColumn>,
    protections: &[&ProtectionKeys],
) -> Result<Result<Aggregate, String>, Fault> {
    if let Some(why) = chosen(graph, t, reached) {
        return Ok(Err(why));
    }
    let plan = graph.plan;
    let node = plan.tables.get(t).ok_or_else(|| Fault::bug("a table is not in the plan"))?;
    let least_samples = protections.iter().map(|p| p.least_samples).max().unwrap_or(0);
    let mut found = Aggregate {
        samples: i64::MAX,
        ratio: f64::INFINITY,
        least_samples: i64::try_from(least_samples).unwrap_or(i64::MAX),
        least_ratio: protections.iter().map(|p| p.least_ratio).fold(1.0, f64::max),
        counts: BTreeMap::new(),
        numbers: BTreeMap::new(),
    };
    let mut few: BTreeMap<String, i64> = BTreeMap::new();
    for unit in graph.units(t) {
        let Ok(key) = graph.key(unit) else { continue };
        if store.find(key).is_none_or(|place| place.rows.is_none()) {
            continue;
        }
        let columns = store.columns(key)?;
        let has = |name: &str| columns.index_of(name).is_ok();
        if !has("n") {
            return Ok(Err("the number of samples behind its values is unknown".to_owned()));
        }
        let names: Vec<&str> = ["n", "metric", "value"].into_iter().filter(|name| has(name)).collect();
        let batch = store.get(key, &names)?;
        let samples = batch.column_by_name("n").and_then(|a| a.as_primitive_opt::<Int64Type>());
        let Some(samples) = samples else { return Ok(Err("its column `n` does not contain whole numbers".to_owned())) };
        let metric = batch.column_by_name("metric").and_then(|a| a.as_string_opt::<i32>());
        let value = batch.column_by_name("value");
        let rows: Vec<usize> = (0..batch.num_rows()).filter(|i| value.is_none_or(|v| v.is_valid(*i))).collect();
        let place = place(graph, unit);
        let reads = format!("{:?}", plan.instance(t, unit.instance).yields.reads);
        for row in &rows {
            let n = if samples.is_valid(*row) { samples.value(*row) } else { 0 };
            let name = metric.filter(|m| m.is_valid(*row)).map_or("", |m| m.value(*row));
            if n < found.least_samples {
                let least = few.entry(name.to_owned()).or_insert(n);
                *least = n.min(*least);
            }
            found.samples = found.samples.min(n);
            found.ratio = found.ratio.min(n as f64 / rows.len() as f64);
            // Filters use different samples, so differences between their scores do not reveal single samples.
            if name.is_empty() || plan.metric(name).is_some_and(|m| m.unit == "nT") {
                found.counts.entry(format!("{place} {name} {reads}")).or_default().insert(n);
            }
            let (numbers, most) = found.numbers.entry(place.clone()).or_insert((0, 0));
            *numbers += 1;
            *most = n.max(*most);
        }
    }
    if let Some((name, n)) = few.iter().next() {
        let what = if name.is_empty() { String::new() } else { format!(" of `{name}`") };
        let least = found.least_samples;
        return Ok(Err(format!("a value{what} is computed from only {n} samples; `least_samples` is {least}")));
    }
    if found.ratio < found.least_ratio {
        let numbers = if node.entry.yields == TableKind::Model { "row of a model" } else { "score of a line" };
        let (ratio, least) = (found.ratio, found.least_ratio);
        return Ok(Err(format!("there are only {ratio:.1} samples for each {numbers}; `least_ratio` is {least}")));
    }
    let own = together(&[(node.name.as_str(), &found)]);
    Ok(own.map(|()| found))
}

/// Reason why the author of the spec could have selected the samples for the values of the table `t`; `None` if that is
/// impossible.
fn chosen(graph: &PlanGraph, t: usize, reached: &HashSet<LineageColumn>) -> Option<String> {
    let plan = graph.plan;
    let tables: HashSet<&str> = reached.iter().map(|(table, _)| table.as_str()).collect();
    for (i, node) in plan.tables.iter().enumerate() {
        let own = i == t;
        if !own && !tables.contains(node.name.as_str()) {
            continue;
        }
        let predicates = node.variants.iter().filter_map(|v| v.predicate.as_ref());
        if let Some(rows) = predicates.into_iter().find(|p| !p.is_of_lines()) {
            return Some(format!("`where` of `{}` selects samples: `{}`", node.name, rows.canonical));
        }
        for point in node.parameter_points(POINTS) {
            let Ok(stage) = plan.instance(i, point).stage() else { continue };
            if own && stage.memorises() {
                return Some(format!("a model of the stage `{}` can contain single samples", node.entry.name));
            }
            let made = |column: Option<&str>| {
                column.is_none_or(|c| own || reached.contains(&(node.name.clone(), c.to_owned())))
            };
            let all = stage.expressions();
            if let Some((_, sql)) = all.into_iter().find(|(column, sql)| made(*column) && !is_linear(sql)) {
                return Some(format!("an expression of `{}` selects or weights samples: `{sql}`", node.name));
            }
        }
    }
    None
}

/// The line of a unit or, for a survey stage, its set of lines.
fn place(graph: &PlanGraph, unit: PlanUnit) -> String {
    let line = |id: usize| graph.lines.get(id).map(|(flight, line)| format!("{flight}/{line}")).unwrap_or_default();
    match unit.line {
        Some(id) => line(id),
        None => {
            let lines = graph.line_inputs(&graph.plan.instance(unit.table, unit.instance));
            let of = lines.first().map(|(_, r)| graph.lines_in(*r)).unwrap_or_default();
            of.into_iter().map(line).collect::<Vec<_>>().join(", ")
        }
    }
}

/// Checks aggregates that are published together.
///
/// # Errors
/// Fails if the samples of two values differ by fewer than the minimum number, or if more numbers than samples would be
/// published.
pub fn together(all: &[(&str, &Aggregate)]) -> Result<(), String> {
    let least = all.iter().map(|(_, a)| a.least_samples).max().unwrap_or(0);
    let names = || all.iter().map(|(name, _)| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let mut counts: BTreeMap<&str, BTreeSet<i64>> = BTreeMap::new();
    let mut numbers: BTreeMap<&str, (usize, i64)> = BTreeMap::new();
    for (_, aggregate) in all {
        for (group, found) in &aggregate.counts {
            counts.entry(group).or_default().extend(found);
        }
        for (place, (count, most)) in &aggregate.numbers {
            let (sum, samples) = numbers.entry(place).or_insert((0, 0));
            *sum += count;
            *samples = (*samples).max(*most);
        }
    }
    for found in counts.values() {
        let sorted: Vec<i64> = found.iter().copied().collect();
        if let Some([a, b]) = sorted.array_windows::<2>().find(|[a, b]| b - a < least) {
            let what = format!(
                "{}: two values are computed from sets of {a} and {b} samples, which differ by fewer than {least} \
                 samples",
                names()
            );
            return Err(format!("{what} (`least_samples`), so single samples can be derived from the two values"));
        }
    }
    let more = |(_, (sum, most)): &(_, &(usize, i64))| i64::try_from(*sum).is_ok_and(|sum| sum > *most);
    if let Some((place, (sum, most))) = numbers.iter().find(more) {
        return Err(format!("{}: {sum} numbers are computed from only {most} samples of {place}", names()));
    }
    Ok(())
}

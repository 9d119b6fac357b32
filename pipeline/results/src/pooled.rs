//! Scores pooled over the lines of each point: the rows of the table `scores_pooled`, from which the terminal, the
//! report and `--json` take their figures.

use std::{collections::HashMap, ops::Range};

use arrow_array::{
    Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use plan::{
    IN_SAMPLE, InSampleColumn, InSampleLines, Plan, PlanGraph, PlanUnit, TableNode,
    spec::{Spec, SweepAxis},
};
use rayon::prelude::*;
use schemas::{
    Fault, Grain, Literal, StageRole,
    metric::{Metric, WeightedScore},
};
use stages::score::{SPREAD, is_pooled_in_sample, spread_at};
use store::{Store, published};

use super::scores::AxisValues;

/// The name of the table.
pub const TABLE: &str = "scores_pooled";

/// One metric at one point of a table of scores.
#[derive(Clone, Debug, PartialEq)]
pub struct PooledMetric {
    /// The table of scores, as a position in the plan.
    pub table: usize,
    /// Point.
    pub instance: usize,
    /// The metric.
    pub metric: Metric,
    /// Value over the lines that are not in sample.
    pub held_out: PooledValue,
    /// Value over the lines that are in sample.
    pub in_sample: PooledValue,
}

/// A metric pooled over some lines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PooledValue {
    /// The value, in the metric's unit; `None` if no line has a value.
    pub value: Option<f64>,
    /// Number of samples or pairs of samples from which the value is computed.
    pub n: i64,
    /// Number of lines with a value.
    pub lines: usize,
}

impl PooledMetric {
    /// Whether only lines that are in sample have a value.
    pub fn is_in_sample(&self) -> bool {
        is_pooled_in_sample(self.held_out.lines, self.in_sample.lines)
    }

    /// The displayed value: over the held-out lines, or over the in-sample lines if only the in-sample lines have a
    /// value.
    pub fn shown(&self) -> PooledValue {
        if self.is_in_sample() { self.in_sample } else { self.held_out }
    }
}

/// The published tables of scores of a plan.
pub fn tables(plan: &Plan) -> impl Iterator<Item = usize> + '_ {
    let published = |t: &usize| plan.decl(*t).is_some_and(|decl| decl.publish);
    plan.tables_of(StageRole::Scores).filter(published)
}

/// The pooled scores of all units that `done` accepts: tables in the plan's order, then points, then metrics in the
/// order of their declaration.
///
/// # Errors
/// Fails if the store cannot be read.
pub fn find(
    graph: &PlanGraph,
    store: &Store,
    done: &(dyn Fn(PlanUnit) -> bool + Sync),
) -> Result<Vec<PooledMetric>, Fault> {
    let mut all = vec![];
    for t in tables(graph.plan) {
        let seen = graph.seen(t)?;
        let points = (0..graph.plan.tables[t].len()).into_par_iter();
        let found: Vec<Vec<PooledMetric>> =
            points.map(|i| of_point(graph, store, done, (t, i), seen)).collect::<Result<_, _>>()?;
        all.extend(found.into_iter().flatten());
    }
    Ok(all)
}

/// The pooled scores of the results in the store.
///
/// # Errors
/// Fails if the store cannot be read.
pub fn present(graph: &PlanGraph, store: &Store) -> Result<Vec<PooledMetric>, Fault> {
    find(graph, store, &|unit| graph.key(unit).is_ok_and(|key| store.has(key)))
}

/// The score of one line.
struct LineMetricScore {
    metric: usize,
    in_sample: bool,
    /// Value and weight; `None` without a value.
    score: Option<(f64, i64)>,
    spread: Vec<f64>,
}

fn of_point(
    graph: &PlanGraph,
    store: &Store,
    done: &(dyn Fn(PlanUnit) -> bool + Sync),
    (table, instance): (usize, usize),
    seen: &InSampleLines,
) -> Result<Vec<PooledMetric>, Fault> {
    let declared = &graph.plan.tables[table].entry.metrics;
    let mut scores: Vec<LineMetricScore> = vec![];
    for line in graph.lines_of(table, instance) {
        let unit = PlanUnit { table, instance, line: Some(*line) };
        if done(unit) {
            let batch = store.get(graph.key(unit)?, &["metric", "value", "n", SPREAD])?;
            read(&batch, declared, seen.has(instance, *line), &mut scores);
        }
    }
    let pooled = |(at, metric): (usize, &Metric)| {
        let mut own = scores.iter().filter(|one| one.metric == at).peekable();
        own.peek()?;
        let own: Vec<&LineMetricScore> = own.collect();
        let share = |in_sample: bool| {
            let lines = own.iter().filter(|one| one.in_sample == in_sample);
            let valued: Vec<(WeightedScore, i64)> = lines
                .filter_map(|one| {
                    let (value, n) = one.score?;
                    Some((WeightedScore { value, n: n as f64, spread: &one.spread }, n))
                })
                .collect();
            let value = metric.pool.value(valued.iter().map(|(weighed, _)| *weighed));
            PooledValue {
                value: Some(value).filter(|v| v.is_finite()),
                n: valued.iter().map(|(_, n)| n).sum(),
                lines: valued.len(),
            }
        };
        Some(PooledMetric { table, instance, metric: *metric, held_out: share(false), in_sample: share(true) })
    };
    Ok(declared.iter().enumerate().filter_map(pooled).collect())
}

/// Adds the scores of one line.
fn read(batch: &RecordBatch, declared: &[Metric], in_sample: bool, scores: &mut Vec<LineMetricScore>) {
    let column = |name: &str| batch.column_by_name(name);
    let (Some(names), Some(values), Some(n)) = (
        column("metric").and_then(|a| a.as_string_opt::<i32>()),
        column("value").and_then(|a| a.as_primitive_opt::<Float64Type>()),
        column("n").and_then(|a| a.as_primitive_opt::<Int64Type>()),
    ) else {
        return;
    };
    let spreads = column(SPREAD).and_then(|a| a.as_list_opt::<i32>());
    for i in (0..batch.num_rows()).filter(|i| names.is_valid(*i)) {
        let Some(metric) = declared.iter().position(|m| m.name == names.value(i)) else { continue };
        let score = (values.is_valid(i) && n.is_valid(i)).then(|| (values.value(i), n.value(i)));
        scores.push(LineMetricScore { metric, in_sample, score, spread: spread_at(spreads, i) });
    }
}

/// The table's columns after the axes, and their meanings.
pub const COLUMNS: [(&str, &str); 11] = [
    ("stage", "the table of scores"),
    ("metric", "the metric"),
    ("value", "pooled over the lines that are not in sample, or over all lines if every line is in sample"),
    ("unit", "the unit of the value"),
    ("n", "number of samples or pairs that `value` is computed from"),
    ("lines", "number of lines that `value` is computed from"),
    (
        "in_sample",
        "true if every line of `value` is in sample: used for a model, noise estimate or map, or to choose a parameter",
    ),
    ("value_in_sample", "pooled over the in-sample lines; null if there are none"),
    ("n_in_sample", "number of samples or pairs that `value_in_sample` is computed from"),
    ("lines_in_sample", "number of lines that `value_in_sample` is computed from"),
    ("pooled_as", "the rule that pools the values of several lines"),
];

/// Name of the type of the column `name`, and the columns of the tables of scores from which it is computed.
pub fn made_of(name: &str) -> (&'static str, &'static [&'static str]) {
    match name {
        "value" | "value_in_sample" => ("Float64", &["metric", "value", "n", SPREAD, IN_SAMPLE]),
        "n" | "lines" | "n_in_sample" | "lines_in_sample" => ("Int64", &["metric", "value", "n", IN_SAMPLE]),
        "in_sample" => ("Boolean", &["metric", "value", IN_SAMPLE]),
        "unit" => ("Utf8", &["unit"]),
        _ => ("Utf8", &["metric"]),
    }
}

/// The pooled scores that the last run of `plan` published. `None` if there are no pooled scores, or if an axis has the
/// name of one of their columns. Points that the spec no longer has are skipped.
///
/// # Errors
/// Fails if the scores exist but cannot be read.
pub fn written(plan: &Plan, store: &Store) -> Result<Option<Vec<PooledMetric>>, Fault> {
    let axes = &plan.spec.axes;
    let columns = || COLUMNS.iter().map(|(name, _)| *name);
    if axes.iter().any(|a| columns().any(|name| name == a.name)) {
        return Ok(None);
    }
    let folder = store.table(&plan.spec.name, TABLE);
    let names: Vec<&str> = axes.iter().map(|a| a.name.as_str()).chain(columns()).collect();
    // The axes of the spec may have changed since the run.
    let Ok(Some(batch)) = published(&folder, &names) else { return Ok(None) };
    let cell = |row: usize, name: &str| -> Option<String> {
        let array = batch.column_by_name(name).filter(|a| a.is_valid(row))?;
        arrow_cast::display::array_value_to_string(array, row).ok()
    };
    let number = |row: usize, name: &str| cell(row, name).and_then(|text| text.parse::<f64>().ok());
    let count = |row: usize, name: &str| cell(row, name).and_then(|text| text.parse::<i64>().ok()).unwrap_or(0);
    let places: HashMap<&str, (usize, SweepPointIndex)> =
        tables(plan).map(|t| (plan.table_name(t), (t, SweepPointIndex::new(plan, &plan.tables[t])))).collect();
    let one = |row: usize| -> Option<PooledMetric> {
        let (table, places) = places.get(cell(row, "stage")?.as_str())?;
        let node = &plan.tables[*table];
        let own = node.axes.iter().filter_map(|i| axes.get(*i));
        let words: Vec<String> = own.map(|axis| cell(row, &axis.name)).collect::<Option<_>>()?;
        let instance = places.instance(node, &words)?;
        let metric = cell(row, "metric")?;
        let metric = *node.entry.metrics.iter().find(|m| m.name == metric)?;
        let share = |value: &str, n: &str, lines: &str| PooledValue {
            value: number(row, value),
            n: count(row, n),
            lines: usize::try_from(count(row, lines)).unwrap_or(0),
        };
        let in_sample = share("value_in_sample", "n_in_sample", "lines_in_sample");
        let shown = share("value", "n", "lines");
        let held_out = if cell(row, "in_sample")? == "true" { PooledValue::default() } else { shown };
        Some(PooledMetric { table: *table, instance, metric, held_out, in_sample })
    };
    Ok(Some((0..batch.num_rows()).filter_map(one).collect()))
}

/// Index of the points of a table by their axis values as text.
struct SweepPointIndex(Vec<AxisValueIndex>);

impl SweepPointIndex {
    fn new(plan: &Plan, node: &TableNode) -> SweepPointIndex {
        SweepPointIndex(node.grid().sides().map(|side| AxisValueIndex::new(&plan.spec, side)).collect())
    }

    fn instance(&self, node: &TableNode, words: &[String]) -> Option<usize> {
        let mut words = words;
        let place: Vec<usize> = self.0.iter().map(|side| side.position(&mut words)).collect::<Option<_>>()?;
        words.is_empty().then(|| node.grid().number(&place)).flatten()
    }
}

/// Index of the values of an axis, or of axes that are searched together.
struct AxisValueIndex {
    axes: Vec<AxisValues>,
    /// For axes that are searched together, the position of each combination of values.
    together: HashMap<Vec<usize>, usize>,
}

impl AxisValueIndex {
    fn new(spec: &Spec, axes: Range<usize>) -> AxisValueIndex {
        let axes = spec.axes.get(axes).unwrap_or_default();
        let known: Vec<AxisValues> = axes.iter().map(|a| AxisValues::new(&a.values)).collect();
        let mut together = HashMap::new();
        if axes.len() > 1 {
            for i in 0..axes.iter().map(|a| a.values.len()).min().unwrap_or(0) {
                let place = |(axis, known): (&SweepAxis, &AxisValues)| known.position(&axis.values[i].to_string());
                together.extend(axes.iter().zip(&known).map(place).collect::<Option<Vec<usize>>>().map(|p| (p, i)));
            }
        }
        AxisValueIndex { axes: known, together }
    }

    /// Removes the values of these axes from the start of `words`, and returns their position.
    fn position(&self, words: &mut &[String]) -> Option<usize> {
        let (own, rest) = words.split_at_checked(self.axes.len())?;
        *words = rest;
        let places: Vec<usize> =
            own.iter().zip(&self.axes).map(|(word, axis)| axis.position(word)).collect::<Option<_>>()?;
        if let [one] = places.as_slice() { Some(*one) } else { self.together.get(&places).copied() }
    }
}

/// Notes, one for each table that combines in-sample lines with other lines.
///
/// # Errors
/// Fails if the goal of the search selects no line.
pub fn mixed(graph: &PlanGraph) -> Result<Vec<String>, Fault> {
    let mut notes = vec![];
    for (t, node) in graph.plan.tables.iter().enumerate().filter(|(_, node)| node.entry.grain == Grain::Survey) {
        let Some(in_sample) = InSampleColumn::new(graph, t)? else { continue };
        let most = graph.units(t).map(|unit| in_sample.lines(unit)).filter(|(seen, all)| 0 < *seen && seen < all).max();
        if let Some((seen, all)) = most {
            notes.push(format!(
                "`{}` pools {seen} in-sample lines with {} other lines, so its column `in_sample` is true. Select \
                 lines with a `where` on `line`; `{TABLE}` pools the two groups separately",
                node.name,
                all - seen
            ));
        }
    }
    Ok(notes)
}

/// Notes, one for each table of scores in which several points are the same computation, because they differ only in an
/// axis that has no effect there.
pub fn repeats(graph: &PlanGraph) -> Vec<String> {
    tables(graph.plan).filter_map(|t| repeated(graph, t)).collect()
}

fn repeated(graph: &PlanGraph, t: usize) -> Option<String> {
    let (plan, node) = (graph.plan, &graph.plan.tables[t]);
    let mut groups: HashMap<Vec<String>, Vec<usize>> = HashMap::new();
    for i in 0..node.len() {
        let unit = |line: &usize| PlanUnit { table: t, instance: i, line: Some(*line) };
        let keys = graph.lines_of(t, i).iter().map(|line| graph.key(unit(line)).map(|key| key.to_string()));
        // A line without a key lacks a required column, and lacks it at all points.
        let keys: Vec<String> = keys.filter_map(Result::ok).collect();
        if !keys.is_empty() {
            groups.entry(keys).or_default().push(i);
        }
    }
    let mut several: Vec<Vec<usize>> = groups.into_values().filter(|group| group.len() > 1).collect();
    several.sort_unstable();
    let first: Vec<Vec<(&str, &Literal)>> =
        several.first()?.iter().map(|i| node.axis_columns(&plan.instance(t, *i), &plan.spec)).collect();
    let (mut without_value, mut fixed) = (vec![], vec![]);
    for (at, (axis, value)) in first.first()?.iter().enumerate() {
        let same = first.iter().all(|point| point.get(at).is_some_and(|(_, other)| other == value));
        if same { fixed.push(format!("{axis} = {value}")) } else { without_value.push(format!("`{axis}`")) }
    }
    let (points, without_value) = (first.len(), without_value.join(", "));
    let place = if fixed.is_empty() { String::new() } else { format!(" at {}", fixed.join(", ")) };
    let more = match several.len() - 1 {
        0 => String::new(),
        n => format!(", and at {n} more combinations of the other axes"),
    };
    Some(format!(
        "`{}`: {without_value} has no effect{place}{more}; the {points} points that differ only in {without_value} are \
         computed once",
        node.name
    ))
}

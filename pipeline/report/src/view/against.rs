//! Comparison of the scores of two runs, from the versions of the tables that the store keeps.
//!
//! Two values are comparable if they come from the same rows: the same held-out lines, with the same data and numbers
//! of samples, scored by the same stage. Otherwise, the answer contains the reason.

use std::{
    collections::{BTreeSet, HashMap},
    sync::Mutex,
};

use arrow_array::{Array, RecordBatch};
use plan::{IN_SAMPLE, PlanGraph};
use results::{
    Snapshot,
    history::{self, RunRecord},
    pooled,
    run_changes::{ChangeKind, changed_lines, changes},
};
use schemas::{Fault, metric::Metric};
use serde_json::{Value, json};
use store::{Store, Version, versions};

use super::{
    PublishedPipeline, StoreView, ViewFault,
    notes::{NotedTable, PipelineNotes},
    scores::{PooledScores, counts, flagged, numbers, texts, truths},
    table::{ViewTable, Words},
};
use crate::html::{is_current, metric_json};

/// Maximum number of values of each run.
const MOST_CELLS: usize = 400_000;
/// Lines are compared only if the table of scores has at most this number of rows.
const MOST_ROWS: usize = 1_000_000;
/// Maximum length of the list of points that only one run has, and of a list of lines.
const LISTED: usize = 20;
const LISTED_LINES: usize = 3;

/// Axis values of a point, in the order of the compared axes.
type PointKey = Vec<String>;

/// Position of a point among the points of a run, and position of a metric among the metric names of both runs.
type CellKey = (usize, u32);

/// Rows of one value.
type CellRows = Vec<CellRow>;

/// The score of one line.
struct CellRow {
    line: u32,
    n: i64,
    in_sample: bool,
    value: f64,
}

/// One value of a run.
#[derive(Default)]
struct RunCell {
    value: Option<f64>,
    n: usize,
    lines: usize,
    in_sample: bool,
    interval: Option<(f64, f64)>,
}

/// Names of the lines and metrics of both runs, each with one position that is valid for both.
#[derive(Default)]
struct RunNames {
    /// Lines, as `flight/line`.
    lines: Words,
    /// Metrics.
    metrics: Words,
}

/// The scores of one run.
struct ComparedRun {
    record: RunRecord,
    snapshot: Snapshot,
    axes: Vec<String>,
    points: Vec<PointKey>,
    /// Whether each point has flagged lines.
    flagged: Vec<bool>,
    cells: HashMap<CellKey, RunCell>,
    /// `None` if there are too many rows.
    rows: Option<HashMap<CellKey, CellRows>>,
}

impl StoreView {
    /// The scores of the table `name` in the run `run` (the newest by default) and in the run `against`, as JSON.
    ///
    /// # Errors
    /// Fails for an unknown table or run, or for a run whose tables were removed. Also fails if the store is damaged.
    pub fn against(&self, name: &str, against: &str, run: Option<&str>) -> Result<Value, ViewFault> {
        let (pipeline, table) = name.split_once('.').unwrap_or((name, ""));
        let find = |run: &str| history::find(self.root(), pipeline, run).map_err(ViewFault::Missing);
        let newest = || {
            let all = history::past(self.root(), pipeline);
            let none = || ViewFault::Missing(Fault::new(format!("the store has no run of `{pipeline}`")));
            all.last().cloned().ok_or_else(none)
        };
        let (before, after) = (find(against)?, run.map_or_else(newest, find)?);
        let mut names = RunNames::default();
        let before = self.run_scores(pipeline, table, before, &mut names)?;
        let after = self.run_scores(pipeline, table, after, &mut names)?;
        Ok(RunComparison::new(table, before, after, &names).json(pipeline, &self.metrics))
    }

    fn run_scores(
        &self,
        pipeline: &str,
        table: &str,
        record: RunRecord,
        names: &mut RunNames,
    ) -> Result<ComparedRun, ViewFault> {
        let snapshot = history::snapshot(self.root(), pipeline, &record)?;
        let tables = self.published_by(pipeline, &record)?;
        let scored = tables.notes.table(table).is_some_and(NotedTable::is_scores);
        if !scored {
            let fault = Fault::new(format!("run {} of `{pipeline}` has no table of scores `{table}`", record.number));
            return Err(ViewFault::Missing(fault));
        }
        let own = tables.table(table)?;
        let pooled = PooledScores::read(&*tables.table(pooled::TABLE)?, &own.axes, table)?;
        let flags = flagged(&tables, &pooled, &own.axes, table)?;
        let word = |(axis, at): (&Words, &u32)| axis.words.get(*at as usize).cloned().unwrap_or_default();
        let points: Vec<PointKey> =
            pooled.points.iter().map(|key| pooled.axes.iter().zip(key).map(word).collect()).collect();
        let mut marked = vec![false; points.len()];
        flags.keys().for_each(|(point, ..)| marked[*point] = true);
        let rows = rows(&own, &pooled, names)?;
        let mut cells = HashMap::new();
        for cell in &pooled.cells {
            let name = pooled.metrics.words.get(cell.metric).map_or("", String::as_str);
            let metric = names.metrics.position(name);
            let (value, n, lines, in_sample) = (cell.value, cell.n, cell.lines, cell.in_sample);
            cells.insert((cell.point, metric), RunCell { value, n, lines, in_sample, interval: None });
        }
        for summary in tables.notes.tables.iter().filter(|t| t.is_summary()) {
            if summary.inputs.iter().any(|input| input == table) && tables.tables().contains(&summary.name) {
                add_intervals(&*tables.table(&summary.name)?, &own.axes, &pooled, (&names.metrics, &mut cells))?;
            }
        }
        let axes = own.axes.clone();
        Ok(ComparedRun { record, snapshot, axes, points, flagged: marked, cells, rows })
    }

    /// The tables that a run published.
    fn published_by(&self, pipeline: &str, record: &RunRecord) -> Result<PublishedPipeline, ViewFault> {
        let folder = versions(self.root(), pipeline).into_iter().find(|(number, _)| *number == record.tables);
        let removed = || {
            let what = format!("the tables of run {} of `{pipeline}` are no longer in the store", record.number);
            ViewFault::Missing(
                Fault::new(what).help("repeat that run; `magline gc --keep N` keeps the tables of N versions"),
            )
        };
        let version = folder.and_then(|(_, folder)| Version::open(&folder)).ok_or_else(removed)?;
        self.objects.refresh();
        let notes = PipelineNotes::of_file(&self.root().join("runs").join(&record.snapshot));
        let (root, objects) = (self.root().to_owned(), self.objects.clone());
        Ok(PublishedPipeline { version, notes, root, objects, tables: Mutex::default() })
    }
}

/// The rows of each value; `None` if there are too many.
fn rows(
    table: &ViewTable,
    pooled: &PooledScores,
    names: &mut RunNames,
) -> Result<Option<HashMap<CellKey, CellRows>>, Fault> {
    let groups = table.provider.groups();
    if (0..groups).map(|group| table.provider.group_rows(group)).sum::<usize>() > MOST_ROWS {
        return Ok(None);
    }
    let seen = table.provider.columns().field_with_name(IN_SAMPLE).is_ok().then_some(IN_SAMPLE);
    let fixed = ["flight", "line", "metric", "value", "n"];
    let columns: Vec<&str> = table.axes.iter().map(String::as_str).chain(fixed).chain(seen).collect();
    let mut found: HashMap<CellKey, CellRows> = HashMap::new();
    for group in 0..groups {
        let batch = table.provider.read_group(group, &columns)?;
        let column = |name: &str| -> Result<Vec<String>, Fault> { words(&batch, name) };
        let (flight, line, metric) = (column("flight")?, column("line")?, column("metric")?);
        let axes = table.axes.iter().map(|axis| column(axis)).collect::<Result<Vec<_>, Fault>>()?;
        let (value, n) = (numbers(&batch, "value")?, counts(&batch, "n")?);
        let in_sample = seen.map(|name| truths(&batch, name)).transpose()?;
        for row in (0..batch.num_rows()).filter(|row| value.is_valid(*row) && n.is_valid(*row)) {
            let point: PointKey = axes.iter().map(|axis| axis[row].clone()).collect();
            let Some(point) = pooled.find(&point) else { continue };
            let at = names.lines.position(&format!("{}/{}", flight[row], line[row]));
            let metric = names.metrics.position(&metric[row]);
            let is_seen = in_sample.is_some_and(|marks| marks.is_valid(row) && marks.value(row));
            let own = CellRow { line: at, n: n.value(row), in_sample: is_seen, value: value.value(row) };
            found.entry((point, metric)).or_default().push(own);
        }
    }
    found.values_mut().for_each(|rows| rows.sort_by_key(|row| (row.line, row.n, row.in_sample)));
    Ok(Some(found))
}

/// The rows that contribute to a pooled value.
fn counted<'a>(rows: Option<&'a CellRows>, side: &RunCell) -> impl Iterator<Item = &'a CellRow> {
    let in_sample = side.in_sample;
    rows.into_iter().flatten().filter(move |row| row.in_sample == in_sample)
}

/// The values of a column as text.
fn words(batch: &RecordBatch, name: &str) -> Result<Vec<String>, Fault> {
    let mut known = Words::default();
    let at = texts(batch, name, &mut known)?;
    Ok(at.into_iter().map(|at| known.words[at as usize].clone()).collect())
}

/// Adds the confidence intervals from a table of `summary` if it has the same axes.
fn add_intervals(
    table: &ViewTable,
    axes: &[String],
    pooled: &PooledScores,
    (metrics, cells): (&Words, &mut HashMap<CellKey, RunCell>),
) -> Result<(), Fault> {
    let sorted = |axes: &[String]| axes.iter().cloned().collect::<BTreeSet<_>>();
    if sorted(&table.axes) != sorted(axes) {
        return Ok(());
    }
    let seen = table.provider.columns().field_with_name(IN_SAMPLE).is_ok().then_some(IN_SAMPLE);
    let names: Vec<&str> = axes.iter().map(String::as_str).chain(["metric", "low", "high"]).chain(seen).collect();
    for group in 0..table.provider.groups() {
        let batch = table.provider.read_group(group, &names)?;
        let metric = words(&batch, "metric")?;
        let keys = axes.iter().map(|axis| words(&batch, axis)).collect::<Result<Vec<_>, Fault>>()?;
        let (low, high) = (numbers(&batch, "low")?, numbers(&batch, "high")?);
        let in_sample = seen.map(|name| truths(&batch, name)).transpose()?;
        for row in (0..batch.num_rows()).filter(|row| low.is_valid(*row) && high.is_valid(*row)) {
            let point: PointKey = keys.iter().map(|axis| axis[row].clone()).collect();
            let Some(point) = pooled.find(&point) else { continue };
            let is_seen = in_sample.is_some_and(|marks| marks.is_valid(row) && marks.value(row));
            let cell = metrics.find(&metric[row]).and_then(|metric| cells.get_mut(&(point, metric)));
            if let Some(cell) = cell.filter(|cell| in_sample.is_none() || cell.in_sample == is_seen) {
                cell.interval = Some((low.value(row), high.value(row)));
            }
        }
    }
    Ok(())
}

/// Two runs, and the points that both have.
struct RunComparison<'a> {
    table: &'a str,
    names: &'a RunNames,
    runs: [ComparedRun; 2],
    axes: Vec<String>,
    /// Positions of each shared point in the two runs, and its axis values.
    shared: Vec<([usize; 2], PointKey)>,
    /// Points that only one run has.
    only: [Vec<PointKey>; 2],
    /// Lines with other data.
    changed: BTreeSet<String>,
    /// Difference between the two runs in the stage that computes the scores.
    scoring: Option<String>,
}

impl<'a> RunComparison<'a> {
    fn new(table: &'a str, before: ComparedRun, after: ComparedRun, names: &'a RunNames) -> RunComparison<'a> {
        let changed = changed_lines(&before.snapshot, &after.snapshot);
        let stage = changes(&before.snapshot, &after.snapshot).into_iter().find(|change| {
            let kind = matches!(change.kind, ChangeKind::Version | ChangeKind::Parameter);
            change.table == table && kind && change.what != "metrics"
        });
        let scoring = stage.map(|change| format!("the scores were computed differently: {change}"));
        let runs = [before, after];
        let varies = |run: &ComparedRun, axis: &String| {
            let at = run.axes.iter().position(|own| own == axis);
            at.is_some_and(|at| run.points.iter().any(|key| key[at] != run.points[0][at]))
        };
        let both = |axis: &String| runs.iter().all(|run| run.axes.contains(axis));
        let all = runs[1].axes.iter().chain(runs[0].axes.iter().filter(|axis| !runs[1].axes.contains(axis)));
        let axes: Vec<String> =
            all.filter(|axis| both(axis) || runs.iter().any(|run| varies(run, axis))).cloned().collect();
        let keys = |run: &ComparedRun| -> Vec<PointKey> {
            let at: Vec<Option<usize>> = axes.iter().map(|axis| run.axes.iter().position(|own| own == axis)).collect();
            let word = |key: &PointKey, at: &Option<usize>| at.map_or_else(String::new, |at| key[at].clone());
            run.points.iter().map(|key| at.iter().map(|at| word(key, at)).collect()).collect()
        };
        let (first, second) = (keys(&runs[0]), keys(&runs[1]));
        let known: HashMap<&PointKey, usize> = first.iter().enumerate().map(|(at, key)| (key, at)).collect();
        let (mut shared, mut found, mut only) = (vec![], vec![false; first.len()], [vec![], vec![]]);
        for (b, key) in second.into_iter().enumerate() {
            match known.get(&key) {
                Some(a) => {
                    found[*a] = true;
                    shared.push(([*a, b], key));
                }
                None => only[1].push(key),
            }
        }
        only[0] = first.iter().zip(found).filter(|(_, found)| !found).map(|(key, _)| key.clone()).collect();
        RunComparison { table, names, runs, axes, shared, only, changed, scoring }
    }

    /// Reason why two values do not come from the same rows; `None` for equal rows.
    fn reason(&self, at: [usize; 2], metric: &str) -> Option<String> {
        if let Some(scoring) = &self.scoring {
            return Some(scoring.clone());
        }
        let metric = self.names.metrics.find(metric)?;
        let key = |side: usize| (at[side], metric);
        let cells = [0, 1].map(|side| self.runs[side].cells.get(&key(side)));
        let (Some(a), Some(b)) = (cells[0], cells[1]) else { return None };
        if a.in_sample != b.in_sample {
            let run = self.runs[usize::from(b.in_sample)].record.number;
            return Some(format!("the value is in sample only in run {run}"));
        }
        let (Some(one), Some(two)) = (&self.runs[0].rows, &self.runs[1].rows) else {
            return Some("the runs have too many rows to compare".to_owned());
        };
        let counted = |rows: Option<&CellRows>, side: &RunCell| -> Vec<(u32, i64)> {
            counted(rows, side).map(|row| (row.line, row.n)).collect()
        };
        let (one, two) = (counted(one.get(&key(0)), a), counted(two.get(&key(1)), b));
        self.difference(&one, &two)
    }

    /// Difference between the rows of two values.
    fn difference(&self, one: &[(u32, i64)], two: &[(u32, i64)]) -> Option<String> {
        let name = |line: &u32| self.names.lines.words.get(*line as usize).map_or("", String::as_str);
        let missing = |own: &[(u32, i64)], other: &[(u32, i64)]| -> Vec<u32> {
            own.iter().map(|(line, _)| *line).filter(|line| !other.iter().any(|(l, _)| l == line)).collect()
        };
        let listed = |lines: &[u32]| {
            let more = lines.len().saturating_sub(LISTED_LINES);
            let names = lines.iter().take(LISTED_LINES).map(name).collect::<Vec<_>>().join(", ");
            if more == 0 { names } else { format!("{names} and {more} more") }
        };
        let gone = [(0, missing(one, two)), (1, missing(two, one))];
        let words: Vec<String> = gone
            .iter()
            .filter(|(_, lines)| !lines.is_empty())
            .map(|(side, lines)| format!("run {} only: {}", self.runs[*side].record.number, listed(lines)))
            .collect();
        if !words.is_empty() {
            return Some(format!("different lines: {}", words.join("; ")));
        }
        let other_n = one.iter().zip(two).find(|((_, a), (_, b))| a != b);
        if let Some(((line, a), (_, b))) = other_n {
            return Some(format!("different n: {a} and {b} on line {}", name(line)));
        }
        let changed: Vec<u32> = one.iter().map(|(line, _)| *line).filter(|l| self.changed.contains(name(l))).collect();
        (!changed.is_empty()).then(|| format!("different data on {}", listed(&changed)))
    }

    /// Differences of a metric on each line, in the order of the lines; empty if the values come from different rows.
    fn paired(&self, at: [usize; 2], metric: &str) -> Vec<f64> {
        let Some(name) = self.names.metrics.find(metric).filter(|_| self.reason(at, metric).is_none()) else {
            return vec![];
        };
        let own = |side: usize| -> Option<Vec<f64>> {
            let (run, key) = (&self.runs[side], (at[side], name));
            Some(counted(run.rows.as_ref()?.get(&key), run.cells.get(&key)?).map(|row| row.value).collect())
        };
        let (Some(one), Some(two)) = (own(0), own(1)) else { return vec![] };
        one.iter().zip(two).map(|(a, b)| b - a).filter(|d| d.is_finite()).collect()
    }

    fn json(&self, pipeline: &str, declared: &[Metric]) -> Value {
        let with_value = |run: &ComparedRun| -> Vec<u32> {
            run.cells.iter().filter(|(_, cell)| cell.value.is_some()).map(|((_, metric), _)| *metric).collect()
        };
        let known: BTreeSet<u32> = self.runs.iter().flat_map(with_value).collect();
        let has = |metric: &&Metric| self.names.metrics.find(metric.name).is_some_and(|at| known.contains(&at));
        let mut metrics: Vec<&Metric> = vec![];
        for metric in declared.iter().filter(has) {
            if !metrics.iter().any(|known| known.name == metric.name) {
                metrics.push(metric);
            }
        }
        metrics.sort_by_key(|m| (m.shown.column.is_none(), m.shown.column));
        let headline = (0..metrics.len()).filter(|m| metrics[*m].shown.rank.is_some());
        let headline = headline.min_by_key(|m| metrics[*m].shown.rank).unwrap_or(0);
        let most = (MOST_CELLS / metrics.len().max(1)).max(1);
        let shared = &self.shared[..self.shared.len().min(most)];
        let mut reasons = vec![String::new()];
        let mut known: HashMap<String, usize> = HashMap::from([(String::new(), 0)]);
        let mut code = |reason: Option<String>| {
            let reason = reason.unwrap_or_default();
            let next = reasons.len();
            let at = *known.entry(reason.clone()).or_insert(next);
            if at == next {
                reasons.push(reason);
            }
            at
        };
        let rows: Vec<Vec<usize>> =
            metrics.iter().map(|m| shared.iter().map(|(at, _)| code(self.reason(*at, m.name))).collect()).collect();
        let sides = [0, 1].map(|side| self.side(side, &metrics, shared));
        let mut pairs: Vec<Vec<Vec<f64>>> =
            metrics.iter().map(|m| shared.iter().map(|(at, _)| self.paired(*at, m.name)).collect()).collect();
        let mut omitted = vec![];
        if pairs.iter().flatten().map(Vec::len).sum::<usize>() > MOST_CELLS {
            pairs.clear();
            omitted.push("the runs have too many lines to compare single lines".to_owned());
        }
        if shared.len() < self.shared.len() {
            omitted.push(format!("{} of {} shared points: the first", shared.len(), self.shared.len()));
        }
        let only = self.only.each_ref().map(|points| {
            let text = |key: &PointKey| {
                let pairs = self.axes.iter().zip(key).filter(|(_, value)| !value.is_empty());
                pairs.map(|(axis, value)| format!("{axis} = {value}")).collect::<Vec<_>>().join(", ")
            };
            json!({ "count": points.len(), "points": points.iter().take(LISTED).map(text).collect::<Vec<_>>() })
        });
        let runs = self.runs.each_ref().map(|run| {
            let RunRecord { number, time, run, version, tables, .. } = &run.record;
            json!({ "number": number, "time": time, "run": run, "version": version, "tables": tables })
        });
        json!({
            "pipeline": pipeline, "table": self.table, "runs": runs, "axes": self.axis_values(shared),
            "at": self.axis_codes(shared), "points": shared.len(), "headline": headline,
            "metrics": metrics.into_iter().map(metric_json).collect::<Vec<_>>(), "sides": sides, "reasons": reasons,
            "rows": rows, "pairs": pairs, "only": only, "omitted": omitted,
            "changes": changes(&self.runs[0].snapshot, &self.runs[1].snapshot),
        })
    }

    /// The values of one run, a column for each metric.
    fn side(&self, side: usize, metrics: &[&Metric], shared: &[([usize; 2], PointKey)]) -> Value {
        let run = &self.runs[side];
        let empty = RunCell::default();
        let column = |metric: &&Metric| -> Vec<&RunCell> {
            let name = self.names.metrics.find(metric.name);
            let cell = |(at, _): &([usize; 2], PointKey)| run.cells.get(&(at[side], name?));
            shared.iter().map(|point| cell(point).unwrap_or(&empty)).collect()
        };
        let columns: Vec<Vec<&RunCell>> = metrics.iter().map(column).collect();
        let all = |of: &dyn Fn(&RunCell) -> Value| -> Vec<Vec<Value>> {
            columns.iter().map(|column| column.iter().map(|cell| of(cell)).collect()).collect()
        };
        let finite = |v: f64| v.is_finite().then_some(v);
        let flagged: Vec<bool> = shared.iter().map(|(at, _)| run.flagged[at[side]]).collect();
        json!({
            "values": all(&|cell| cell.value.and_then(finite).into()),
            "n": all(&|cell| cell.n.into()), "lines": all(&|cell| cell.lines.into()),
            "in_sample": all(&|cell| cell.in_sample.into()),
            "low": all(&|cell| cell.interval.and_then(|(low, _)| finite(low)).into()),
            "high": all(&|cell| cell.interval.and_then(|(_, high)| finite(high)).into()), "flagged": flagged,
        })
    }

    /// The axes, with the values of the shared points in the order of their appearance.
    fn axis_values(&self, shared: &[([usize; 2], PointKey)]) -> Vec<Value> {
        let one = |(a, name): (usize, &String)| {
            let values = self.axis_words(shared, a).words;
            let numeric = values.iter().all(|v| v.parse::<f64>().is_ok_and(f64::is_finite));
            json!({ "name": name, "numeric": numeric, "values": values })
        };
        self.axes.iter().enumerate().map(one).collect()
    }

    fn axis_words(&self, shared: &[([usize; 2], PointKey)], axis: usize) -> Words {
        let mut words = Words::default();
        shared.iter().for_each(|(_, key)| {
            words.position(&key[axis]);
        });
        words
    }

    fn axis_codes(&self, shared: &[([usize; 2], PointKey)]) -> Vec<Vec<u32>> {
        let one = |a: usize| {
            let mut words = self.axis_words(shared, a);
            shared.iter().map(|(_, key)| words.position(&key[a])).collect()
        };
        (0..self.axes.len()).map(one).collect()
    }
}

/// The comparison of the newest run of a plan with an earlier run, as JSON: one block for each table of scores.
///
/// # Errors
/// Fails for an unknown run, for the newest run, for a run whose tables were removed, or for results of another version
/// of the spec. Also fails if the store is damaged.
pub fn report_against(graph: &PlanGraph, store: &Store, against: &str) -> Result<Vec<Value>, Fault> {
    let (plan, root) = (graph.plan, store.root());
    let pipeline = &plan.spec.name;
    let record = history::find(root, pipeline, against)?;
    if history::past(root, pipeline).last().is_some_and(|last| last.number == record.number) {
        let fault = Fault::new(format!("run {against} is the newest run, which the report shows"));
        return Err(fault.help(format!("give an earlier run; `magline runs {pipeline}` lists them")));
    }
    let tables: Vec<usize> = pooled::tables(plan).collect();
    if tables.is_empty() || !is_current(graph, store) {
        let fault = Fault::new("a comparison of runs needs scores of this spec, and the newest run has none");
        return Err(fault.help(format!("run the spec first: `magline run {}`", plan.spec.file)));
    }
    let metrics = tables.iter().flat_map(|t| plan.tables[*t].entry.metrics.iter().copied()).collect();
    let view = StoreView::new(root, metrics)?;
    let one = |t: usize| view.against(&format!("{pipeline}.{}", plan.table_name(t)), against, None);
    tables.into_iter().map(|t| one(t).map_err(|fault| fault.fault().clone())).collect()
}

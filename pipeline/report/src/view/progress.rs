//! Progress of a run: units in the store, failures, and the best point so far.

use std::{
    collections::{BTreeMap, HashSet},
    fs,
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError, TryLockError},
    time::{Duration, Instant, SystemTime},
};

use plan::{PlanGraph, PlanUnit};
use results::{
    history,
    pooled::{self, PooledMetric},
    scores::Scores,
    warnings,
};
use schemas::{Fault, StageRole, keys::HashKey};
use serde_json::{Value, json};
use store::{Store, generation};

use super::StoreView;
use crate::html::is_current;

/// Minimum time between two counts of the units.
const COUNT_EVERY: Duration = Duration::from_secs(1);
/// Minimum time between two poolings of scores.
const POOL_EVERY: Duration = Duration::from_secs(5);
/// Pause after a count or pooling, as a multiple of the duration of the count or pooling.
const PAUSE: u32 = 5;
/// A lease whose last renewal is older than this no longer counts as a run in progress.
const SILENT: Duration = Duration::from_secs(35);
/// Maximum number of distinct failures that are listed.
const MOST_FAILURES: usize = 200;

/// Progress of the runs of one spec.
pub struct RunProgress<'a> {
    graph: &'a PlanGraph<'a>,
    store: &'a Store,
    state: Mutex<ProgressCount>,
    /// The last answer, which is returned to requests that arrive during a count.
    last: Mutex<Option<Value>>,
}

/// Size and time of a file; `None` without the file.
type RecordStamp = Option<(u64, SystemTime)>;

#[derive(Default)]
struct ProgressCount {
    counted: Option<TimedValue<Vec<TableCount>>>,
    best: Option<TimedValue<(usize, Vec<Value>)>>,
    /// Size and time of the record of the last run, and whether that run was of this plan and data.
    current: Option<(RecordStamp, bool)>,
    failures: BTreeMap<(String, String), (usize, String)>,
    /// Failed units that are already counted in `failures`.
    known: HashSet<HashKey>,
}

/// A value, its time and the duration of its computation.
struct TimedValue<T> {
    value: T,
    at: Instant,
    took: Duration,
}

impl<T> TimedValue<T> {
    fn of(make: impl FnOnce() -> Result<T, Fault>) -> Result<TimedValue<T>, Fault> {
        let begun = Instant::now();
        let value = make()?;
        let at = Instant::now();
        Ok(TimedValue { value, at, took: at - begun })
    }

    fn is_fresh(&self, every: Duration) -> bool {
        self.at.elapsed() < every.max(self.took * PAUSE)
    }
}

/// Units of one table.
struct TableCount {
    table: usize,
    done: usize,
    failed: usize,
    total: usize,
}

impl<'a> RunProgress<'a> {
    /// The runs of `graph` in `store`.
    pub fn new(graph: &'a PlanGraph<'a>, store: &'a Store) -> RunProgress<'a> {
        RunProgress { graph, store, state: Mutex::default(), last: Mutex::default() }
    }

    /// State of the run as JSON; the previous state while another thread counts the units.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn json(&self) -> Result<Value, Fault> {
        let held = match self.state.try_lock() {
            Ok(state) => Some(state),
            Err(TryLockError::Poisoned(e)) => Some(e.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        };
        let last = || self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let known = last().clone();
        let state = match (held, known) {
            (Some(state), _) => state,
            (None, Some(known)) => return Ok(known),
            (None, None) => self.state.lock().unwrap_or_else(PoisonError::into_inner),
        };
        let made = self.state(state)?;
        *last() = Some(made.clone());
        Ok(made)
    }

    fn state(&self, mut state: MutexGuard<ProgressCount>) -> Result<Value, Fault> {
        let (graph, store) = (self.graph, self.store);
        let spec = &graph.plan.spec;
        let running = is_running(store.root(), &spec.name);
        if !state.counted.as_ref().is_some_and(|counted| counted.is_fresh(COUNT_EVERY)) {
            let counted = TimedValue::of(|| {
                store.refresh();
                self.count(&mut state)
            })?;
            state.counted = Some(counted);
        }
        let tables = state.counted.as_ref().map(|c| c.value.as_slice()).unwrap_or_default();
        let sum = |of: fn(&TableCount) -> usize| tables.iter().map(of).sum::<usize>();
        let (done, failed, total) = (sum(|t| t.done), sum(|t| t.failed), sum(|t| t.total));
        let listed: Vec<Value> = tables.iter().map(|t| self.table(t)).collect();
        let scored: usize = tables.iter().filter(|t| self.is_scores(t.table)).map(|t| t.done).sum();
        let fresh = |best: &TimedValue<(usize, Vec<Value>)>| best.value.0 == scored || best.is_fresh(POOL_EVERY);
        let current = self.is_current(&mut state);
        if !state.best.as_ref().is_some_and(fresh) {
            state.best = Some(TimedValue::of(|| Ok((scored, self.best(current)?)))?);
        }
        let word = match (running, done + failed) {
            (true, _) => "running",
            (false, 0) => "none",
            (false, n) if n == total => "done",
            (false, _) => "incomplete",
        };
        Ok(json!({
            "pipeline": spec.name, "spec": spec.file, "state": word, "current": current,
            "units": { "done": done, "failed": failed, "total": total }, "tables": listed,
            "failures": failures(&state.failures),
            "best": state.best.as_ref().map(|b| b.value.1.as_slice()).unwrap_or_default(),
            "runs": runs(store.root(), &spec.name),
        }))
    }

    /// Whether the last run was of this plan and data. The comparison is repeated only after another run.
    fn is_current(&self, state: &mut ProgressCount) -> bool {
        let record = self.store.root().join("plans").join(format!("{}.json", self.graph.plan.spec.name));
        let stamp = fs::metadata(record).and_then(|m| Ok((m.len(), m.modified()?))).ok();
        match state.current {
            Some((known, current)) if known == stamp => current,
            _ => {
                let current = is_current(self.graph, self.store);
                state.current = Some((stamp, current));
                current
            }
        }
    }

    fn is_scores(&self, table: usize) -> bool {
        self.graph.plan.tables.get(table).is_some_and(|node| node.entry.role == Some(StageRole::Scores))
    }

    fn table(&self, progress: &TableCount) -> Value {
        let plan = self.graph.plan;
        json!({
            "table": format!("{}.{}", plan.spec.name, plan.table_name(progress.table)),
            "stage": plan.tables[progress.table].entry.name,
            "done": progress.done, "failed": progress.failed, "total": progress.total,
        })
    }

    /// Counts the units of all tables. Adds new failures.
    fn count(&self, state: &mut ProgressCount) -> Result<Vec<TableCount>, Fault> {
        let plan = self.graph.plan;
        let mut found = vec![];
        for table in 0..plan.tables.len() {
            let mut progress = TableCount { table, done: 0, failed: 0, total: self.graph.unit_count(table) };
            for unit in self.graph.units(table) {
                let Ok(key) = self.graph.key(unit) else { continue };
                match self.store.find(key).map(|place| place.rows.is_some()) {
                    Some(true) => progress.done += 1,
                    Some(false) => {
                        progress.failed += 1;
                        self.failure(state, unit, key);
                    }
                    None => {}
                }
            }
            found.push(progress);
        }
        Ok(found)
    }

    fn failure(&self, state: &mut ProgressCount, unit: PlanUnit, key: HashKey) {
        if !state.known.insert(key) {
            return;
        }
        let Ok(Some(fault)) = self.store.failed(key) else { return };
        let plan = self.graph.plan;
        let point = plan.instance(unit.table, unit.instance).point();
        let mut place: Vec<String> = point.iter().map(|(axis, value)| format!("{axis} {value}")).collect();
        if let Some((flight, line)) = unit.line.and_then(|line| self.graph.lines.get(line)) {
            place.push(format!("flight {flight}, line {line}"));
        }
        let kind = (plan.table_name(unit.table).to_owned(), fault.what);
        state.failures.entry(kind).or_insert_with(|| (0, place.join(", "))).0 += 1;
    }

    /// The best point of each table of scores, from the results in the store.
    fn best(&self, is_current: bool) -> Result<Vec<Value>, Fault> {
        let (graph, store) = (self.graph, self.store);
        let written = if is_current { pooled::written(graph.plan, store)? } else { None };
        let marks = if written.is_some() { warnings::written(graph.plan, store)? } else { None };
        let marks = marks.map_or_else(|| warnings::present(graph, store), Ok)?;
        let pooled = written.map_or_else(|| pooled::present(graph, store), Ok)?;
        let one = |t: usize| best(self, t, &pooled, &marks);
        Ok(pooled::tables(graph.plan).filter_map(one).collect())
    }
}

fn best(progress: &RunProgress, t: usize, pooled: &[PooledMetric], marks: &[warnings::Warning]) -> Option<Value> {
    let plan = progress.graph.plan;
    let (mut scores, _) = Scores::new(plan, t, pooled);
    scores.mark(plan.table_name(t), marks);
    let metric = scores.headline()?;
    let row = scores.best(metric).or_else(|| scores.ranked(metric).first().copied())?;
    let declared = scores.metrics[metric];
    let (key, _) = scores.rows.get(row)?;
    let point: serde_json::Map<String, Value> = scores.axes.iter().cloned().zip(key.iter().map(|v| json!(v))).collect();
    let other = declared.baseline.and_then(|b| Some((b.metric, scores.value(row, scores.metric(b.metric)?)?)));
    Some(json!({
        "table": format!("{}.{}", plan.spec.name, plan.table_name(t)), "metric": declared.name, "unit": declared.unit,
        "value": scores.value(row, metric), "point": point, "points": scores.rows.len(),
        "in_sample": scores.is_in_sample(row, metric), "flagged": scores.is_marked(row),
        "baseline": other.map(|(name, value)| json!({ "metric": name, "value": value })),
    }))
}

fn failures(found: &BTreeMap<(String, String), (usize, String)>) -> Vec<Value> {
    let mut all: Vec<_> = found.iter().collect();
    all.sort_by(|a, b| b.1.0.cmp(&a.1.0).then(a.0.cmp(b.0)));
    all.truncate(MOST_FAILURES);
    let one = |((stage, error), (times, example)): (&(String, String), &(usize, String))| {
        json!({
            "stage": stage, "error": error, "times": times, "example": example,
        })
    };
    all.into_iter().map(one).collect()
}

/// Whether a run of the pipeline is in progress, according to the lease of the pipeline.
fn is_running(root: &Path, pipeline: &str) -> bool {
    if generation(root, pipeline).is_some() {
        return false;
    }
    let start = format!("{pipeline}.lease-");
    let leases = fs::read_dir(root.join("locks")).into_iter().flatten().flatten();
    let own = leases.filter(|e| e.file_name().to_str().is_some_and(|name| name.starts_with(&start)));
    let newest = own.filter_map(|e| e.metadata().and_then(|m| m.modified()).ok()).max();
    // A lease in an object store has no file in the cache.
    newest.is_none_or(|time| SystemTime::now().duration_since(time).is_ok_and(|age| age < SILENT))
}

/// The runs of a pipeline, the newest first.
pub fn runs(root: &Path, pipeline: &str) -> Vec<Value> {
    let one = |run: history::RunRecord| {
        let [computed, reused, failed, skipped] = run.units;
        json!({
            "number": run.number, "time": run.time, "run": run.run, "version": run.version, "tables": run.tables,
            "computed": computed, "reused": reused, "failed": failed, "skipped": skipped, "seconds": run.seconds,
        })
    };
    history::past(root, pipeline).into_iter().rev().map(one).collect()
}

impl StoreView {
    /// State of the runs of a spec whose plan is not made yet, as JSON.
    pub fn before_plan(&self, pipeline: &str, spec: &str) -> Value {
        json!({
            "pipeline": pipeline, "spec": spec, "state": "planning", "current": false,
            "units": { "done": 0, "failed": 0, "total": 0 }, "tables": [], "failures": [], "best": [],
            "runs": runs(&self.root, pipeline), "changed": self.changed(),
        })
    }

    /// The tables of scores and the hash of the last run, of one pipeline or of all.
    pub fn sections(&self, pipeline: Option<&str>) -> Value {
        let names = pipeline.map_or_else(|| self.pipelines(), |name| vec![name.to_owned()]);
        let last = |name: &String| Some(json!({ "pipeline": name, "run": history::past(&self.root, name).pop()?.run }));
        let scores: Vec<String> = names.iter().flat_map(|name| self.score_tables(name)).collect();
        json!({ "scores": scores, "runs": names.iter().filter_map(last).collect::<Vec<_>>() })
    }

    /// The runs of all pipelines.
    pub fn runs(&self) -> Value {
        let one = |name: &String| json!({ "pipeline": name, "runs": runs(&self.root, name) });
        json!({ "pipelines": self.pipelines().iter().map(one).collect::<Vec<_>>(), "changed": self.changed() })
    }
}

//! Execution of a plan: missing results are computed, stored ones are reused, and failures are isolated.

mod again;
#[cfg(feature = "cluster")]
pub mod ballista;
mod children;
mod compute;
pub mod cost;
mod cut;
mod engine;
pub mod events;
mod failure;
mod held;
mod interrupt;
mod layout;
mod list;
mod logical;
#[cfg(test)]
mod object_store_tests;
mod processes;
mod publish;
mod quality;
mod remote;
mod runner;
mod search;
mod states;
mod table;
mod task;
mod trials;
mod until;
mod work;

use std::{sync::atomic::Ordering, time::Instant};

use schemas::Fault;

pub use again::{TableComparison, again};
pub use engine::{EngineCapacity, LocalEngine, TaskEngine, TaskWave};
pub use events::{Event, Listener, OutcomeCounts, SilentListener, UnitOutcome};
pub use failure::{Failure, deduplicated};
pub use interrupt::{INTERRUPTED, STARTED};
pub use list::{TaskList, list};
pub use processes::ProcessEngine;
pub use remote::{WorkerLimits, WorkerTally, serve};
pub use search::search;
pub use task::{Receipt, Task, TaskUnit, UnitAnswer};
/// Checks of the records of runs and costs, for the verification of a store.
pub const RECORD_CHECKS: RecordChecks = RecordChecks { runs: history::is_whole, costs: cost::is_whole };

pub use trials::{SourceReadCallback, plan_all_trials, settled};

use cut::TableAssembler;
use layout::TableLayout;
use runner::PlanRunner;
use states::UnitState;
use work::UnitWorker;

use crate::cost::CostMeter;
use plan::{
    Plan, PlanGraph, PlanUnit, RecordedPlan,
    sources::ReadProgress,
    spec::{SearchState, SearchTrial, SearchTrialScore, SpecFaults, best},
};
use results::{
    history::{self, RunRecord},
    pooled::{self, PooledMetric},
    scores::{self, Scores},
    warnings::{self, Warning},
};
use schemas::keys::HashKey;
use store::{PipelineLock, Store, clock, current, scrub::RecordChecks, tend};

/// Summary of a run.
pub struct RunSummary {
    /// Outcomes of each table, in the plan's order.
    pub tables: Vec<(String, OutcomeCounts)>,
    /// Failures, in a fixed order.
    pub failures: Vec<Failure>,
    /// Number of findings in the data: rows of the table `quality`.
    pub quality: usize,
    /// Number of lines with findings.
    pub quality_lines: usize,
    /// Warnings about results; none for an interrupted run.
    pub warnings: Vec<Warning>,
    /// Pooled scores of each table of scores.
    pub scores: Vec<(String, Scores)>,
    /// Trials of a search, by trial and rung.
    pub trials: Vec<SearchTrialScore>,
    /// Choices made automatically.
    pub notes: Vec<String>,
    /// Duration of each table, s, in the order of `tables`.
    pub seconds: Vec<f64>,
    /// Hash of the computation and its data: equal for the same spec and inputs.
    pub run: String,
    /// Whether it was interrupted.
    pub interrupted: bool,
    /// Folder of the tables.
    pub folder: std::path::PathBuf,
    /// Tables that were not requested and are unchanged.
    pub left: Vec<String>,
    /// Outcomes of the recomputation of stored tables.
    pub compared: Vec<TableComparison>,
    /// Size of the earlier results that `gc` would remove, bytes.
    pub unused: u64,
}

impl RunSummary {
    /// Sum over all tables.
    pub fn total(&self) -> OutcomeCounts {
        self.tables.iter().fold(OutcomeCounts::default(), |sum, (_, c)| sum + *c)
    }
}

/// Options of a run.
#[derive(Clone, Copy)]
pub struct RunOptions<'a> {
    /// Wait for another run of the pipeline.
    pub wait: bool,
    /// Merge the packs of a sweep that has grown, as if it had been run at once.
    pub compact: bool,
    /// Maximum number of retries of a unit whose worker was lost.
    pub retries: usize,
    /// Engine that computes the tasks.
    pub engine: &'a dyn TaskEngine,
    /// Compute only the table at this position of the plan, and its inputs. Not for a search.
    pub until: Option<usize>,
}

/// Default maximum number of retries of a unit whose worker was lost.
pub const RETRIES: usize = 2;

impl Default for RunOptions<'_> {
    fn default() -> Self {
        RunOptions { wait: false, compact: false, retries: RETRIES, engine: &LocalEngine, until: None }
    }
}

/// Maximum number of restarts of a run after it finds damage in the store.
const MAX_REPAIRS: usize = 5;

/// Runs `plan` in `store`, on rayon's current thread pool. Damaged files are quarantined and recomputed. For a search,
/// runs only the trials of the plan; [`search()`] runs it to its end.
///
/// # Errors
/// Fails when a source cannot be read, the store cannot be written, or another run holds the lock of the pipeline. No
/// task has been computed then.
pub fn run(
    plan: &Plan,
    store: &Store,
    options: RunOptions<'_>,
    listener: &dyn Listener,
) -> Result<RunSummary, SpecFaults> {
    let publisher = store.publisher(&plan.spec.name, options.wait).map_err(|f| plan.spec.faults(vec![f]))?;
    run_locked(plan, store, &publisher, options, listener)
}

/// [`run`] by a process that has the lock of the pipeline.
fn run_locked(
    plan: &Plan,
    store: &Store,
    publisher: &PipelineLock,
    options: RunOptions,
    listener: &dyn Listener,
) -> Result<RunSummary, SpecFaults> {
    let rows = plan.spec.search.as_ref().map(|search| SearchState::new(search).rows()).unwrap_or_default();
    let pass = PlanPass { last: true, rows: &rows, known: None, relay: None };
    let summary = run_with_repair(plan, store, options, publisher, listener, &pass)?;
    if let Some(search) = plan.spec.search.as_ref().filter(|_| !summary.trials.is_empty()) {
        listener.on_event(&Event::Trials { search, scored: &summary.trials, best: best(&summary.trials) });
    }
    listener.on_event(&Event::Finished { summary: &summary });
    Ok(summary)
}

/// Computes the points of `plan` once, including those of a search for any scores. Returns whether it was interrupted.
fn as_planned(plan: &Plan, store: &Store, until: Option<usize>, listener: &dyn Listener) -> Result<bool, SpecFaults> {
    let publisher = store.publisher(&plan.spec.name, false).map_err(|f| plan.spec.faults(vec![f]))?;
    let pass = PlanPass { last: true, rows: &[], known: Some(&[]), relay: None };
    let options = RunOptions { until, ..RunOptions::default() };
    Ok(run_with_repair(plan, store, options, &publisher, listener, &pass)?.interrupted)
}

/// Purpose of a pass over a plan.
struct PlanPass<'a> {
    /// Whether the tables of this pass are published.
    last: bool,
    /// Trials of the plan.
    rows: &'a [SearchTrial],
    /// Goals of the trials, if already known.
    known: Option<&'a [SearchTrialScore]>,
    /// Events of the previous passes.
    relay: Option<&'a search::EventRelay<'a>>,
}

/// Pass, repeated while it finds damaged parts of the store.
fn run_with_repair(
    plan: &Plan,
    store: &Store,
    options: RunOptions<'_>,
    publisher: &PipelineLock,
    listener: &dyn Listener,
    pass: &PlanPass,
) -> Result<RunSummary, SpecFaults> {
    let mut passes = 0;
    let mut summary = loop {
        let before = store.damaged().len();
        let summary = run_pass(plan, store, options, publisher, listener, pass)?;
        passes += 1;
        if summary.interrupted || store.damaged().len() == before || passes > MAX_REPAIRS {
            break summary;
        }
    };
    let recomputed =
        |what| format!("{what}; it was moved to {} and recomputed", store.root().join("damaged").display());
    summary.notes.extend(store.damaged().into_iter().map(recomputed));
    if let Err(fault) = store.write_index() {
        summary.failures.push(unpublished(fault));
    }
    if pass.last {
        summary.unused = tend::unused(store);
    }
    Ok(summary)
}

fn unpublished(fault: Fault) -> Failure {
    Failure { table: "publish".into(), point: Default::default(), line: None, fault }
}

/// Single pass over an intact store.
fn run_pass(
    plan: &Plan,
    store: &Store,
    options: RunOptions<'_>,
    publisher: &PipelineLock,
    listener: &dyn Listener,
    pass: &PlanPass,
) -> Result<RunSummary, SpecFaults> {
    let (damaged, begun) = (store.damaged().len(), Instant::now());
    let tick = |table: &str, step: &ReadProgress| listener.on_event(&Event::Reading { table, step });
    let graph = PlanGraph::new(plan, store, &tick)?;
    trials::check(&graph).map_err(|f| plan.spec.faults(vec![f]))?;
    STARTED.store(true, Ordering::SeqCst);
    let mut asked = until::TargetTables::new(plan, options.until);
    let units: usize = (0..plan.tables.len()).filter(|t| asked.is(*t)).map(|t| graph.unit_count(t)).sum();
    let run = run_id(&graph);
    let pipeline = &plan.spec.name;
    listener.on_event(&Event::Started { pipeline, units, run: &run, notes: &plan.notes, graph: &graph });
    let recorded = if options.engine.is_local() { None } else { Some(recorded(&graph, store)?) };
    let worker = UnitWorker::new(&graph, store, listener);
    let mut runner = PlanRunner::new(&worker, listener, options, recorded);
    runner.sources();
    let mut watch = CostMeter::new(&graph, store);
    let (mut tables, mut packs) = (vec![], vec![]);
    for (t, node) in plan.tables.iter().enumerate() {
        if INTERRUPTED.load(Ordering::Relaxed) {
            break;
        }
        if !asked.is(t) && runner.is_left(t, &asked.left) {
            asked.left.push(t);
            packs.push(vec![]);
            runner.seconds.push((0, 0.0));
            continue;
        }
        // This process cannot measure the resources of other processes.
        let before = if options.engine.is_local() { watch.table(t) } else { None };
        let started = Instant::now();
        let (count, found) = runner.table(t);
        packs.push(found);
        let seconds = started.elapsed().as_secs_f64();
        watch.done(before, count, packs.last().map_or(&[], Vec::as_slice));
        runner.seconds.push((count.computed, seconds));
        listener.on_event(&Event::Table { table: &node.name, count, seconds });
        tables.push((node.name.clone(), count));
    }
    store.drop_attempts(|key| store.find(key).is_some(), None);
    store.drop_checkpoints(|name| HashKey::parse(name).is_some_and(|key| store.has(key)), None);
    let interrupted = INTERRUPTED.load(Ordering::Relaxed);
    let PlanRunner { failures, mut seconds, states, .. } = runner;
    let mut failures: Vec<Failure> = failures.into_iter().map(|(_, failure)| failure).collect();
    if let Some(relay) = pass.relay {
        let sums = relay.sums(tables.iter().map(|(name, _)| name.as_str()));
        tables.iter_mut().zip(&sums).for_each(|((_, count), (sum, _))| *count = *sum);
        seconds = sums.into_iter().map(|(count, seconds)| (count.computed, seconds)).collect();
    }
    let mut trials = vec![];
    if !interrupted {
        match pass.known.map_or_else(|| trials::scored(&graph, store, pass.rows, true), |t| Ok(Some(t.to_vec()))) {
            Ok(found) => trials = found.unwrap_or_default(),
            Err(fault) => failures.push(unpublished(fault)),
        }
    }
    if pass.last {
        failures.extend(trials::no_trial_succeeded(plan, &trials));
    }
    let (mut warnings, mut pooled) = (vec![], vec![]);
    if pass.last && !interrupted && store.damaged().len() == damaged {
        let there = |unit: PlanUnit| states.get(unit) == UnitState::Done;
        let last = warnings::find(&graph, store, &there).and_then(|found| {
            let (failed, found) = failure::of_metrics(plan, found);
            failures.extend(failed);
            warnings = found;
            pooled = pooled::find(&graph, store, &there)?;
            if store.damaged().len() > damaged {
                return Ok(());
            }
            // Tables that were not requested and their pooled scores stay unchanged.
            let before = if asked.left.is_empty() { None } else { pooled::written(plan, store)? };
            let left = before.into_iter().flatten().filter(|p| asked.left.contains(&p.table));
            let published: Vec<PooledMetric> = pooled.iter().cloned().chain(left).collect();
            plan.tables.iter().for_each(|node| listener.on_event(&Event::Publishing { table: &node.name }));
            let left = &asked.left;
            let publication =
                publish::Publication { graph: &graph, store, run: &run, packs: &packs, left, there: &there };
            publication.publish(publisher, &failures, &warnings, &published, &trials)?;
            let snapshot = results::record(&graph, store, &seconds, &asked.left)?;
            let total = tables.iter().fold(OutcomeCounts::default(), |sum, (_, c)| sum + *c);
            let past = RunRecord {
                time: clock::now(),
                run: run.clone(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                tables: current(store.root(), &plan.spec.name).map_or(0, |v| v.number),
                seconds: begun.elapsed().as_secs_f64(),
                units: [total.computed, total.reused, total.failed, total.skipped],
                ..RunRecord::default()
            };
            history::add(store, &plan.spec.name, past, &snapshot)
        });
        failures.extend(last.err().map(unpublished));
    }
    watch.keep(pass.last && !interrupted);
    let (quality, quality_lines) = quality::count(&graph);
    let folder = store.root().join("tables").join(&plan.spec.name);
    let mut scores = scores::all(plan, &pooled, &warnings);
    let left: Vec<String> = asked.names(plan).map(str::to_owned).collect();
    scores.retain(|(name, _)| !left.contains(name));
    let spent = seconds.into_iter().enumerate().filter(|(t, _)| !asked.left.contains(t));
    let seconds = spent.map(|(_, (_, s))| s).collect();
    let mut notes: Vec<String> = plan.notes.iter().cloned().chain(asked.note(plan).filter(|_| !interrupted)).collect();
    if !scores.is_empty() {
        notes.extend(pooled::repeats(&graph));
        notes.extend(pooled::mixed(&graph).unwrap_or_default());
    }
    for (name, found) in &scores {
        notes.extend(found.at_edges().into_iter().map(|text| format!("`{name}`: {text}")));
    }
    Ok(RunSummary {
        tables,
        failures,
        quality,
        quality_lines,
        warnings,
        scores,
        trials,
        notes,
        seconds,
        run,
        interrupted,
        folder,
        left,
        compared: vec![],
        unused: 0,
    })
}

/// Writes the plan for worker processes, and the index from which they open the store.
fn recorded(graph: &PlanGraph, store: &Store) -> Result<HashKey, SpecFaults> {
    let written = RecordedPlan::keep(graph, store).and_then(|key| store.write_index().map(|()| key));
    written.map_err(|fault| graph.plan.spec.faults(vec![fault]))
}

/// Hash of the computation and its data, in 16 hexadecimal digits: pipeline, seed, and the key of every unit of every
/// table. It is independent of comments in the spec, the number of threads and the contents of the store.
pub fn run_id(graph: &PlanGraph) -> String {
    let spec = &graph.plan.spec;
    let mut parts = vec!["run".to_owned(), spec.name.clone(), spec.seed.to_string()];
    for (t, node) in graph.plan.tables.iter().enumerate() {
        parts.push(node.name.clone());
        let key = |unit: PlanUnit| graph.key(unit).map_or_else(|_| "none".to_owned(), |key| key.to_string());
        parts.extend(graph.units(t).map(key));
    }
    HashKey::from_parts(parts).to_string().chars().take(16).collect()
}

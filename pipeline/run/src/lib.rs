//! Execution of a plan: missing results are computed, stored results are reused, and failures are isolated.

mod again;
#[cfg(feature = "cluster")]
pub mod ballista;
mod children;
mod compute;
pub mod confine;
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
mod pass;
mod processes;
mod publish;
mod quality;
mod remedies;
mod remote;
mod runner;
mod search;
mod states;
mod table;
mod task;
mod trials;
mod until;
mod work;

use plan::{
    Plan, PlanGraph, PlanUnit,
    spec::{SearchState, SearchTrialScore, SpecFaults, best},
};
use results::{history, scores::Scores, warnings::Warning};
use schemas::keys::HashKey;
use store::{PipelineLock, Store, scrub::RecordChecks};

pub use again::{TableComparison, again};
pub use engine::{EngineCapacity, LocalEngine, TaskEngine, TaskWave};
pub use events::{Event, Listener, OutcomeCounts, SilentListener, UnitOutcome};
pub use failure::{Failure, deduplicated};
pub use interrupt::{INTERRUPTED, STARTED};
pub use list::{TaskList, list};
use pass::{PlanPass, run_with_repair};
pub use processes::ProcessEngine;
pub use remote::{WorkerLimits, WorkerTally, serve};
pub use search::search;
pub use task::{Receipt, Task, TaskUnit, UnitAnswer};
pub use trials::{SourceReadCallback, plan_all_trials, settled};

/// Checks of the records of runs and costs, for the verification of a store.
pub const RECORD_CHECKS: RecordChecks = RecordChecks { runs: history::is_whole, costs: cost::is_whole };

/// Summary of a run.
pub struct RunSummary {
    /// Outcomes of each table, in the plan's order.
    pub tables: Vec<(String, OutcomeCounts)>,
    /// Failures, in a fixed order.
    pub failures: Vec<Failure>,
    /// Number of findings about the quality of the data, which are the rows of the table `quality`.
    pub quality: usize,
    /// Number of lines with findings.
    pub quality_lines: usize,
    /// Warnings about results; none for an interrupted run.
    pub warnings: Vec<Warning>,
    /// Pooled scores of each table of scores.
    pub scores: Vec<(String, Scores)>,
    /// Trials of a search, in the order of trial and rung.
    pub trials: Vec<SearchTrialScore>,
    /// Choices made automatically.
    pub notes: Vec<String>,
    /// Duration of each table, in seconds, in the order of `tables`.
    pub seconds: Vec<f64>,
    /// Hash of the computation and its data: equal for the same spec and inputs.
    pub run: String,
    /// Whether the run was interrupted.
    pub interrupted: bool,
    /// Folder of the tables.
    pub folder: std::path::PathBuf,
    /// Tables that were not requested and stay unchanged.
    pub left: Vec<String>,
    /// Outcomes of the recomputation of stored tables.
    pub compared: Vec<TableComparison>,
    /// Size of the earlier results that `gc` would remove, in bytes.
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
    /// Merge the packs of a sweep that has grown. The result equals the result of a single run of the whole sweep.
    pub compact: bool,
    /// Maximum number of retries of a unit whose worker was lost.
    pub retries: usize,
    /// Engine that computes the tasks.
    pub engine: &'a dyn TaskEngine,
    /// Compute only the table at this position of the plan, and its inputs. Not permitted for a search.
    pub until: Option<usize>,
}

/// Default maximum number of retries of a unit whose worker was lost.
pub const RETRIES: usize = 2;

impl Default for RunOptions<'_> {
    fn default() -> Self {
        RunOptions { wait: false, compact: false, retries: RETRIES, engine: &LocalEngine, until: None }
    }
}

/// Runs `plan` in `store`, on rayon's current thread pool. Damaged files are quarantined and recomputed. For a search,
/// runs only the trials of the plan; [`search()`] runs the search to its end.
///
/// # Errors
/// Fails if a source cannot be read, the store cannot be written, or another run holds the lock of the pipeline. No
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

/// Same as [`run`], in a process that has the lock of the pipeline.
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

/// Computes the points of `plan` in one pass. For a search, these are the trials in `plan`, independent of their
/// scores. Returns whether the pass was interrupted.
fn as_planned(plan: &Plan, store: &Store, until: Option<usize>, listener: &dyn Listener) -> Result<bool, SpecFaults> {
    let publisher = store.publisher(&plan.spec.name, false).map_err(|f| plan.spec.faults(vec![f]))?;
    let pass = PlanPass { last: true, rows: &[], known: Some(&[]), relay: None };
    let options = RunOptions { until, ..RunOptions::default() };
    Ok(run_with_repair(plan, store, options, &publisher, listener, &pass)?.interrupted)
}

/// Hash of the computation and its data, in 16 hexadecimal digits: pipeline, seed, and the key of every unit of every
/// table. It does not depend on comments in the spec, the number of threads or the contents of the store.
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

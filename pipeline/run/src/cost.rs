//! Cost of a run before it starts: rows, bytes, processor time and memory of each table that it would compute.
//!
//! Runs measure their tables ([`CostMeter`]) and keep the figures in the store. Keys do not depend on these figures. An
//! estimate multiplies the amounts of work of a plan (`work`) by prices (`fit`). The prices are fitted to these figures
//! and the built-in ones. There are prices per unit, per row and per number read, for each stage and each named choice
//! of a stage, such as its filter. Processor time refers to a machine of speed 1, and is divided by the speed of this
//! machine.

mod fit;
mod machine;
mod observed;
pub mod view;
mod watch;
mod work;

use plan::PlanGraph;
use schemas::Fault;
use store::Store;

pub use observed::is_whole;
pub use watch::CostMeter;

use observed::CostModel;
use work::WorkEstimator;

/// The cost of a table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableCost {
    /// Name.
    pub table: String,
    /// Stage.
    pub stage: String,
    /// Whether its results are kept; otherwise the work is counted in the tables that need the results.
    pub kept: bool,
    /// Units to compute.
    pub units: usize,
    /// Units that are in the store already.
    pub there: usize,
    /// Rows to make.
    pub rows: f64,
    /// Rows that are in the store already.
    pub rows_there: usize,
    /// Bytes to add to the store.
    pub bytes: f64,
    /// Processor time, in seconds.
    pub seconds: f64,
    /// Elapsed time, in seconds.
    pub clock: f64,
    /// Peak memory of the process, in bytes; 0 if nothing is computed.
    pub memory: f64,
}

/// The cost of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunCost {
    /// Tables, in the order of the plan.
    pub tables: Vec<TableCost>,
    /// Processor time outside the tables: keys, scores, publishing, in seconds.
    pub overhead_s: f64,
    /// Elapsed time outside the tables, in seconds.
    pub overhead_clock_s: f64,
    /// The number of threads.
    pub threads: usize,
    /// Speed of this machine relative to the reference machine, whose speed is 1.
    pub speed: f64,
    /// Number of measurements of tables that runs have kept in this store.
    pub measured: usize,
    /// Number of trials of a search that are only assumed, because they depend on unknown scores.
    pub assumed: usize,
}

impl RunCost {
    /// Processor time, in seconds.
    pub fn seconds(&self) -> f64 {
        self.tables.iter().map(|t| t.seconds).sum::<f64>() + self.overhead_s
    }

    /// Elapsed time, in seconds.
    pub fn clock(&self) -> f64 {
        self.tables.iter().map(|t| t.clock).sum::<f64>() + self.overhead_clock_s
    }

    /// Bytes to add to the store.
    pub fn bytes(&self) -> f64 {
        self.tables.iter().map(|t| t.bytes).sum()
    }

    /// Rows to make.
    pub fn rows(&self) -> f64 {
        self.tables.iter().map(|t| t.rows).sum()
    }

    /// Peak memory, in bytes.
    pub fn memory(&self) -> f64 {
        self.tables.iter().map(|t| t.memory).fold(0.0, f64::max)
    }
}

/// Estimates a run of the plan of `graph` in `store` on `threads` threads. The estimate excludes the reading of the
/// sources, because a graph exists only after they are read. For a search, the cost covers the trials of the plan;
/// [`crate::plan_all_trials`] adds the missing trials.
///
/// # Errors
/// Fails for a table whose columns have types that no file can hold.
pub fn estimate(graph: &PlanGraph, store: &Store, threads: usize) -> Result<RunCost, Fault> {
    let known = CostModel::new(store.root());
    let threads = threads.max(1);
    let (speed, sync_s) = (machine::speed(), machine::sync_s(&store.temporary()));
    let amounts = WorkEstimator::new(graph, store, &known.rows, threads);
    let (mut tables, mut numbers) = (vec![], 0.0);
    for (t, node) in graph.plan.tables.iter().enumerate() {
        let asked = amounts.missing_work(t)?;
        let mut one = TableCost {
            table: node.name.clone(),
            stage: node.entry.name.to_owned(),
            kept: node.keep,
            units: asked.missing.len(),
            there: asked.there,
            rows_there: asked.rows_there,
            ..TableCost::default()
        };
        if !asked.missing.is_empty() {
            let work = &asked.work;
            numbers += asked.rows * work.width;
            one.rows = asked.rows;
            one.bytes = known.bytes.total(&work.bytes(asked.rows));
            one.seconds = known.seconds.total(&work.time(asked.rows)) / speed;
            let at_once = threads.min(asked.tasks).max(1) as f64;
            let files_at_once = at_once.min(work.packs).max(1.0);
            one.clock = one.seconds / at_once + work.packs * SYNCS_A_FILE * sync_s / files_at_once;
            one.memory = known.memory.total(&work.memory());
        }
        tables.push(one);
    }
    let (mut overhead_s, mut overhead_clock_s) = (0.0, 0.0);
    if tables.iter().any(|t| t.units > 0) {
        overhead_s = (START_S + known.seconds.total(&watch::of_run(graph, numbers).time(0.0))) / speed;
        overhead_clock_s = overhead_s + SYNCS_A_TABLE * tables.len() as f64 * sync_s;
    }
    Ok(RunCost { tables, overhead_s, overhead_clock_s, threads, speed, measured: known.own, assumed: 0 })
}

/// Expected times of units; the size of a task follows from them.
pub struct UnitTimeModel {
    known: CostModel,
    speed: f64,
}

impl UnitTimeModel {
    /// Creates the model from the built-in records and the records of `store`.
    pub fn new(store: &Store) -> UnitTimeModel {
        UnitTimeModel { known: CostModel::new(store.root()), speed: machine::speed() }
    }

    /// Mean processor time of the missing units of the table `t` on this machine, in seconds; 0 if no unit is missing.
    pub fn unit_s(&self, graph: &PlanGraph, store: &Store, t: usize) -> f64 {
        let asked = WorkEstimator::new(graph, store, &self.known.rows, 1).missing_work(t).unwrap_or_default();
        match asked.missing.len() {
            0 => 0.0,
            n => self.known.seconds.total(&asked.work.time(asked.rows)) / self.speed / n as f64,
        }
    }
}

/// Start-up time of the program, including the reading of its plan, on a machine of speed 1, in seconds; used until it
/// is measured.
const START_S: f64 = 0.03;
/// Number of disk syncs per file: one for the content, one for the name.
const SYNCS_A_FILE: f64 = 2.0;
/// Number of disk syncs per published table, for its folders and its list of units.
const SYNCS_A_TABLE: f64 = 4.0;

//! Lists the next tasks for workers of other processes.

use schemas::{Fault, FaultOwner};

use super::{
    OutcomeCounts, RunOptions, SilentListener, engine::EngineCapacity, recorded, runner::PlanRunner, table::LayoutTask,
    task::Task, trials, work::UnitWorker,
};
use crate::{
    plan::{Plan, PlanGraph},
    sources::ReadProgress,
    spec::SpecFaults,
    store::Store,
};

/// The tasks of the next wave, with counts of omitted units.
pub struct TaskList {
    /// The tasks, in the plan's order.
    pub tasks: Vec<Task>,
    /// The units of each table that has any in them.
    pub units: Vec<(String, usize)>,
    /// Units that wait for others, or cannot be computed.
    pub skipped: usize,
    /// Units that the machine has failed on too often.
    pub given_up: usize,
}

/// Overhead of a task in a process that computes only this task, s, as measured in `pipeline/benches/README.md`.
const TASK_S: f64 = 0.1;

/// Lists what can be computed with what is in `store`, in tasks of at most `most` units, or of as many as a process of
/// its own is worth; with `only` that of one table. The
/// plan and the index are in the store when this returns. Nothing is computed, but sources that are new are read.
///
/// # Errors
/// Fails when a source cannot be read, there is no table `only`, or the store cannot be written.
pub fn list(
    plan: &Plan,
    store: &Store,
    options: RunOptions<'_>,
    most: Option<usize>,
    only: Option<&str>,
    tick: &(dyn Fn(&str, &ReadProgress) + Sync),
) -> Result<TaskList, SpecFaults> {
    let fail = |fault: Fault| plan.spec.faults(vec![fault]);
    let only = only.map(|name| plan.table(name)).transpose().map_err(fail)?;
    let graph = PlanGraph::new(plan, store, tick)?;
    trials::check(&graph).map_err(fail)?;
    let worker = UnitWorker::new(&graph, store, &SilentListener);
    let mut runner = PlanRunner::new(&worker, &SilentListener, options, None);
    runner.abroad = true;
    let (mut tasks, mut units, mut count) = (vec![], vec![], OutcomeCounts::default());
    for (t, node) in plan.tables.iter().enumerate() {
        let Some(sheet) = runner.sheet(t, &mut count) else { continue };
        if only.is_some_and(|only| only != t) {
            continue;
        }
        let cover = runner.cover(&sheet);
        let pace = EngineCapacity { task_s: TASK_S, at_once: 0 };
        let most = most.unwrap_or_else(|| pace.units(sheet.pending(), runner.unit_s(&sheet)));
        let found = runner.tasks_abroad(&sheet, &cover, most, None);
        let of_table: usize = found.iter().map(|h| h.task.units.len()).sum();
        if of_table > 0 {
            units.push((node.name.clone(), of_table));
        }
        tasks.extend(found.into_iter().map(|LayoutTask { task, .. }| task));
    }
    if !tasks.is_empty() {
        let key = recorded(&graph, store)?;
        tasks.iter_mut().for_each(|task| task.plan = Some(key));
    }
    let given_up = runner.failures.iter().filter(|(_, f)| f.fault.owner == FaultOwner::Machine).count();
    Ok(TaskList { tasks, units, skipped: count.skipped, given_up })
}

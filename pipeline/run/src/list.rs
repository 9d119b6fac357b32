//! Listing of the next tasks for worker processes.

use plan::{Plan, PlanGraph, sources::ReadProgress, spec::SpecFaults};
use schemas::{Fault, FaultOwner};
use store::Store;

use super::{
    OutcomeCounts, RunOptions, SilentListener, engine::EngineCapacity, pass::recorded, runner::PlanRunner,
    table::LayoutTask, task::Task, trials, work::UnitWorker,
};

/// Tasks of the next wave, with counts of skipped units.
pub struct TaskList {
    /// Tasks, in the plan's order.
    pub tasks: Vec<Task>,
    /// Number of units in these tasks, for each table that occurs in them.
    pub units: Vec<(String, usize)>,
    /// Number of units that wait for others, or cannot be computed.
    pub skipped: usize,
    /// Number of units that are not retried, because too many attempts failed for reasons of the machine.
    pub given_up: usize,
}

/// Overhead of a task in a process that computes only this task, in seconds, as measured in
/// `pipeline/benches/README.md`.
const TASK_S: f64 = 0.1;

/// Lists the units that can be computed from the results in `store`, in tasks of at most `most` units. The default size
/// gives a separate process an acceptable overhead. With `only`, lists the tasks of one table. The plan and the index
/// are in the store on return. Computes nothing, but reads new sources.
///
/// # Errors
/// Fails if a source cannot be read, the table `only` is unknown, or the store cannot be written.
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
    runner.is_remote = true;
    let (mut tasks, mut units, mut count) = (vec![], vec![], OutcomeCounts::default());
    for (t, node) in plan.tables.iter().enumerate() {
        let Some(sheet) = runner.sheet(t, &mut count) else { continue };
        if only.is_some_and(|only| only != t) {
            continue;
        }
        let cover = runner.cover(&sheet);
        let pace = EngineCapacity { task_s: TASK_S, at_once: 0 };
        let most = most.unwrap_or_else(|| pace.units(sheet.pending(), runner.unit_s(&sheet)));
        let found = runner.tasks_for_workers(&sheet, &cover, most, None);
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

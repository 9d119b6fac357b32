//! Engines, which compute the tasks that a driver dispatches.

use plan::PlanUnit;
use rayon::prelude::*;
use schemas::{Fault, Grain};

use super::{
    compute::compute,
    events::UnitOutcome,
    task::{Receipt, Task},
    work::UnitWorker,
};

/// Callback for the outcome of each unit, called from any thread.
pub type OutcomeCallback<'a> = dyn Fn(PlanUnit, UnitOutcome, Option<&Fault>) + Sync + 'a;

/// Tasks of one table; no task depends on the results of another.
pub struct TaskWave<'a> {
    /// Plan, store and stages in this process.
    pub worker: &'a UnitWorker<'a>,
    /// Position of the table.
    pub table: usize,
    /// Tasks of the wave.
    pub tasks: &'a [Task],
    /// Expected time of a unit, in seconds; 0 if unknown.
    #[cfg_attr(not(feature = "cluster"), allow(dead_code))]
    pub unit_s: f64,
    /// Callback for the outcome of each unit.
    pub on_outcome: &'a OutcomeCallback<'a>,
}

impl TaskWave<'_> {
    /// Reports the outcomes of a task.
    pub fn report_outcomes(&self, task: &Task, receipt: &Receipt) {
        for answer in &receipt.units {
            let unit = task.units.iter().find(|u| (u.point, u.line) == (answer.point, answer.line));
            let unit = unit.map(|u| u.unit(self.table));
            unit.into_iter().for_each(|unit| (self.on_outcome)(unit, answer.outcome, answer.fault.as_ref()));
        }
    }
}

/// Capacity of an engine, from which the sizes of tasks follow.
#[derive(Clone, Copy, Debug)]
pub struct EngineCapacity {
    /// Overhead of a task, in seconds.
    pub task_s: f64,
    /// Number of simultaneous tasks; 0 if unknown.
    pub at_once: usize,
}

/// Maximum overhead caused by the division into tasks, as a fraction of the work.
const MAX_OVERHEAD: f64 = 0.05;
/// Maximum number of units of a task. All of these units are lost if their worker is lost.
const MOST_UNITS: usize = 4096;

impl EngineCapacity {
    /// Number of units of a task, for a wave of `units` units of `unit_s` seconds each. With this number, the overhead
    /// of a task is 5 % of its work. A wave with too little work for such tasks is divided into as many tasks as the
    /// engine can compute at a time, unless the overhead of a task would then exceed its work.
    pub fn units(self, units: usize, unit_s: f64) -> usize {
        let of = |task_s: f64| (task_s / unit_s.max(1e-9)).ceil().clamp(1.0, MOST_UNITS as f64) as usize;
        let enough = of(self.task_s / MAX_OVERHEAD);
        match self.at_once {
            0 => enough,
            n => enough.min(units.div_ceil(n).max(of(self.task_s))),
        }
    }
}

/// Component that computes tasks. The driver plans, searches the store, lays out and publishes in the same way for
/// every engine.
pub trait TaskEngine: Sync {
    /// Whether tasks are computed in this process. The tasks then need no plan in the store, and their results are in
    /// the catalogue.
    fn is_local(&self) -> bool;

    /// Capacity of this engine.
    fn pace(&self) -> EngineCapacity;

    /// Computes the tasks of a wave and returns their receipts in the same order; `None` for a task that an interrupt
    /// skips. A unit whose worker was lost also has an answer: a fault of the machine.
    fn run(&self, wave: &TaskWave) -> Vec<Option<Receipt>>;
}

/// Engine with the threads of this process: rayon's current pool.
pub struct LocalEngine;

impl TaskEngine for LocalEngine {
    fn is_local(&self) -> bool {
        true
    }

    fn pace(&self) -> EngineCapacity {
        EngineCapacity { task_s: 0.0, at_once: rayon::current_num_threads() }
    }

    fn run(&self, wave: &TaskWave) -> Vec<Option<Receipt>> {
        prepare(wave.worker, wave.table, wave.tasks);
        wave.tasks
            .par_iter()
            .with_max_len(1)
            .map(|task| Some(compute(wave.worker, wave.table, task, wave.on_outcome)))
            .collect()
    }
}

/// Builds, only once, the data that all lines of these tasks share.
pub fn prepare(worker: &UnitWorker, table: usize, tasks: &[Task]) {
    if worker.grain(table) != Grain::Map {
        let to_do = tasks.iter().flat_map(Task::wanted);
        worker.prepare_all(to_do.map(|u| u.unit(table)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_task_overhead_is_at_most_five_percent_given_enough_work() {
        for (task_s, unit_s) in [(0.012, 0.3e-3), (0.012, 0.02), (0.1, 0.3e-3), (0.1, 7.0), (0.02, 0.1)] {
            for at_once in [0, 1, 2, 64] {
                for units in [1usize, 10, 1000, 1_000_000] {
                    let n = EngineCapacity { task_s, at_once }.units(units, unit_s);
                    let relative_overhead = |n: usize| task_s / (n as f64 * unit_s);
                    let few = at_once > 0 && n >= units.div_ceil(at_once) && relative_overhead(n) <= 1.0 + 1e-9;
                    assert!(
                        relative_overhead(n) <= MAX_OVERHEAD || few || n == MOST_UNITS,
                        "{task_s} {unit_s} {at_once} {units}: {n}"
                    );
                    // A task with one unit fewer would have too large an overhead.
                    assert!(
                        n == 1 || relative_overhead(n - 1) > MAX_OVERHEAD,
                        "{task_s} {unit_s} {at_once} {units}: {n}"
                    );
                }
            }
        }
        assert_eq!(EngineCapacity { task_s: 0.1, at_once: 0 }.units(10, 0.0), MOST_UNITS);
        assert_eq!(EngineCapacity { task_s: 0.1, at_once: 0 }.units(10, f64::NAN), MOST_UNITS);
    }
}

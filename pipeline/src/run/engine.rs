//! Engines: what computes the tasks that a driver hands out.

use rayon::prelude::*;
use schemas::{Fault, Grain};

use super::{
    compute::compute,
    events::Outcome,
    task::{Receipt, Task},
    work::Worker,
};
use crate::plan::Unit;

/// Is told the outcome of each unit as it comes, from any thread.
pub type Told<'a> = dyn Fn(Unit, Outcome, Option<&Fault>) + Sync + 'a;

/// The tasks of one table, none of which needs the result of another.
pub struct Wave<'a> {
    /// The plan, the store and the stages, in this process.
    pub worker: &'a Worker<'a>,
    /// The table.
    pub table: usize,
    /// The tasks.
    pub tasks: &'a [Task],
    /// Hears of each unit.
    pub told: &'a Told<'a>,
}

/// What computes tasks. Whatever it is, the driver plans, looks into the store, lays out and publishes the same.
pub trait Engine: Sync {
    /// Whether tasks are computed in this process: they need no plan in the store, and their results are in the catalogue.
    fn is_local(&self) -> bool;

    /// The most units that a task should have.
    fn most_units(&self) -> usize;

    /// Computes the tasks of a wave; the answers of each, in their order. None for a task that an interrupt left out. A unit
    /// that was lost has an answer too: a fault of the machine.
    fn run(&self, wave: &Wave) -> Vec<Option<Receipt>>;
}

/// The threads of this process: rayon's current pool.
pub struct Local;

impl Engine for Local {
    fn is_local(&self) -> bool {
        true
    }

    fn most_units(&self) -> usize {
        usize::MAX
    }

    fn run(&self, wave: &Wave) -> Vec<Option<Receipt>> {
        prepare(wave.worker, wave.table, wave.tasks);
        wave.tasks
            .par_iter()
            .with_max_len(1)
            .map(|task| Some(compute(wave.worker, wave.table, task, wave.told)))
            .collect()
    }
}

/// Builds what all lines of these tasks share, each once.
pub fn prepare(worker: &Worker, table: usize, tasks: &[Task]) {
    if worker.grain(table) != Grain::Map {
        let to_do = tasks.iter().flat_map(|task| task.units.iter().filter(|u| !u.have));
        worker.prepare_all(to_do.map(|u| u.unit(table)));
    }
}

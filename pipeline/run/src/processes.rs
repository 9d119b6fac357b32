//! Engine `processes`: workers are processes of this program, on this machine.

use std::{
    path::PathBuf,
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use schemas::Fault;

use super::{
    children::{ProcessStopHandle, WorkerCommand},
    engine::{EngineCapacity, TaskEngine, TaskWave},
    interrupt::INTERRUPTED,
    task::Receipt,
};

/// Overhead of a task in a running process, in seconds, as measured in `pipeline/CLUSTER.md`.
const TASK_S: f64 = 0.012;

/// Worker processes, which live for one wave.
pub struct ProcessEngine {
    /// Path of this program.
    pub program: PathBuf,
    /// Number of processes; each has one thread.
    pub count: usize,
    /// Maximum number of retries of a unit whose worker was lost.
    pub retries: usize,
    /// Maximum time of a unit.
    pub unit_timeout: Option<Duration>,
}

impl TaskEngine for ProcessEngine {
    fn is_local(&self) -> bool {
        false
    }

    fn pace(&self) -> EngineCapacity {
        EngineCapacity { task_s: TASK_S, at_once: self.count }
    }

    fn run(&self, wave: &TaskWave) -> Vec<Option<Receipt>> {
        let children = WorkerCommand {
            program: self.program.clone(),
            store: wave.worker.store().root().to_owned(),
            retries: self.retries,
            unit_timeout: self.unit_timeout,
        };
        let next = AtomicUsize::new(0);
        let receipts: Vec<Mutex<Option<Receipt>>> = wave.tasks.iter().map(|_| Mutex::new(None)).collect();
        let attend = || {
            let mut worker = None;
            while !INTERRUPTED.load(Ordering::Relaxed) {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let (Some(task), Some(place)) = (wave.tasks.get(i), receipts.get(i)) else { break };
                let Some(mut receipt) = children.receipt(&mut worker, task, &ProcessStopHandle::default()) else {
                    break;
                };
                if let Some(why) = receipt.refused {
                    receipt = task.failure(&Fault::machine(format!("the worker rejected the task: {why}")));
                }
                wave.report_outcomes(task, &receipt);
                if let Ok(mut place) = place.lock() {
                    *place = Some(receipt);
                }
            }
        };
        thread::scope(|scope| {
            for _ in 0..self.count.clamp(1, wave.tasks.len().max(1)) {
                scope.spawn(attend);
            }
        });
        receipts.into_iter().map(|place| place.into_inner().unwrap_or_default()).collect()
    }
}

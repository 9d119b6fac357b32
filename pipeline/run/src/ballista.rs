//! Engine `ballista`: tasks run on the workers of a cluster, through Ballista's scheduler.
//!
//! Ballista places tasks, detects lost workers and reassigns their tasks. All other cases are handled here. Nothing is
//! dispatched while there is no worker. A job has a few tasks of one wave, so that receipts arrive continuously and a
//! failed job does not affect others. Failed tasks are dispatched again. If an answer is lost, the results of its tasks
//! are found in the store. `pipeline/CLUSTER.md` lists all cases.

mod client;
mod closed;
mod executor;
mod flight;
mod job_size;
mod key;
mod scheduler;
mod units;
mod verdict;
mod wave;
mod worker;

use std::time::{Duration, Instant};

use ballista_core::ids::new_instance_id;
use schemas::Fault;
use tokio::runtime::{Builder, Runtime};

use self::{
    client::{ClusterSnapshot, SchedulerClient, SchedulerFault},
    wave::WaveDispatcher,
};
pub use self::{
    closed::JobPlan,
    key::ClusterTrust,
    scheduler::{BoundScheduler, listen},
    units::TaskPlanCodec,
    worker::{ReceiptHandler, WorkerConfig, WorkerExit, work},
};
use super::{
    engine::{EngineCapacity, TaskEngine, TaskWave},
    task::Receipt,
};

/// Overhead of a task in a worker, in seconds, as measured in `pipeline/CLUSTER.md`.
const TASK_S: f64 = 0.012;

/// Cluster of a scheduler.
pub struct BallistaEngine {
    scheduler: SchedulerClient,
    runtime: Runtime,
    /// Identifier of this driver at the scheduler.
    session: String,
    seen: ClusterSnapshot,
    limits: DispatchLimits,
}

/// Limits for dispatched tasks: number of retries, time of a unit, and waiting time.
#[derive(Clone, Copy, Debug)]
pub struct DispatchLimits {
    /// Maximum number of retries of a unit whose worker was lost.
    pub retries: usize,
    /// Maximum time of a unit.
    pub unit_timeout: Option<Duration>,
    /// Maximum waiting time for a worker or for the scheduler.
    pub patience: Duration,
}

impl BallistaEngine {
    /// Connects to the scheduler at HOST:PORT. Calls `waits` once if no scheduler answers at first.
    ///
    /// # Errors
    /// Fails if the scheduler does not answer for [`DispatchLimits::patience`], or has another version or another key.
    pub fn connect(
        authority: &str,
        trust: &ClusterTrust,
        limits: DispatchLimits,
        waits: impl FnOnce(&str),
    ) -> Result<BallistaEngine, Fault> {
        let scheduler = await_scheduler(authority, trust, Some(limits.patience), waits)?;
        let seen = scheduler.look().map_err(|why| why.fault(authority))?;
        Ok(BallistaEngine { scheduler, runtime: runtime()?, session: new_instance_id(), seen, limits })
    }
}

impl TaskEngine for BallistaEngine {
    fn is_local(&self) -> bool {
        false
    }

    fn pace(&self) -> EngineCapacity {
        EngineCapacity { task_s: TASK_S, at_once: self.seen.cores }
    }

    fn run(&self, wave: &TaskWave) -> Vec<Option<Receipt>> {
        WaveDispatcher::new(self, wave).run()
    }
}

/// Waits until a scheduler of this version answers, at most for `patience`, and returns its client. Calls `waits` once
/// if no scheduler answers at first.
///
/// # Errors
/// Fails if the scheduler has another version or another key, or does not answer.
pub fn await_scheduler(
    authority: &str,
    trust: &ClusterTrust,
    patience: Option<Duration>,
    waits: impl FnOnce(&str),
) -> Result<SchedulerClient, Fault> {
    const AGAIN_AFTER: Duration = Duration::from_millis(500);
    let scheduler = SchedulerClient::at(authority, trust)?;
    let (begun, mut waits) = (ObservationTimer::now(), Some(waits));
    loop {
        match scheduler.name() {
            Ok(_) => return Ok(scheduler),
            Err(SchedulerFault::Silent(why)) if !patience.is_some_and(|most| begun.longer_than(most)) => {
                waits.take().into_iter().for_each(|waits| waits(&why));
                std::thread::sleep(AGAIN_AFTER);
            }
            Err(why) => return Err(why.fault(authority)),
        }
    }
}

fn runtime() -> Result<Runtime, Fault> {
    let runtime = Builder::new_multi_thread().enable_all().build();
    runtime.map_err(|e| Fault::machine(format!("cannot start threads: {e}")))
}

/// Completes when the process receives a stop signal.
async fn stop_signal() {
    use tokio::signal::unix::{SignalKind, signal};
    let received = |kind: SignalKind| async move {
        match signal(kind) {
            Ok(mut stream) => stream.recv().await,
            // Without a handler, the signal ends the process.
            Err(_) => std::future::pending().await,
        }
    };
    tokio::select! {
        _ = received(SignalKind::interrupt()) => {}
        _ = received(SignalKind::terminate()) => {}
    }
}

/// Timer that measures the time since the last observation.
#[derive(Clone, Copy, Debug)]
struct ObservationTimer(Instant);

impl ObservationTimer {
    fn now() -> ObservationTimer {
        ObservationTimer(Instant::now())
    }

    fn seen(&mut self) {
        *self = ObservationTimer::now();
    }

    fn longer_than(self, time: Duration) -> bool {
        self.0.elapsed() > time
    }
}

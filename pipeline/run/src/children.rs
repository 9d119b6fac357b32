//! Worker processes that this process starts. Each runs `magline task` with tasks as input and receipts as output. A
//! unit that kills its worker, or takes too long, affects no other unit.

use std::{
    fmt::Display,
    io::{BufRead, BufReader, Write},
    path::PathBuf,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::Ordering},
    time::Duration,
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use schemas::Fault;
use store::Store;

use super::{
    events::UnitOutcome,
    interrupt::INTERRUPTED,
    task::{Receipt, Task},
};

/// Command line and limits of worker processes.
#[derive(Clone, Debug)]
pub struct WorkerCommand {
    /// Path of this program.
    pub program: PathBuf,
    /// Folder of the store.
    pub store: PathBuf,
    /// Maximum number of retries of a unit whose worker was lost.
    pub retries: usize,
    /// Maximum time of a unit.
    pub unit_timeout: Option<Duration>,
}

/// Handle that stops the worker process of a task from another thread.
#[derive(Clone, Debug, Default)]
pub struct ProcessStopHandle(Arc<Mutex<ProcessStopState>>);

#[derive(Debug, Default)]
struct ProcessStopState {
    stopped: bool,
    /// Running process; `None` before the start and after the end of the process.
    process: Option<Pid>,
}

#[cfg_attr(not(feature = "cluster"), allow(dead_code))]
impl ProcessStopHandle {
    fn held(&self) -> MutexGuard<'_, ProcessStopState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the process after its current units, and starts no other units.
    pub fn stop(&self) {
        let mut held = self.held();
        held.stopped = true;
        // A process that has ended needs no signal.
        let _ = held.process.map(|process| kill(process, Signal::SIGTERM));
    }

    /// Ends the process at once.
    pub fn kill(&self) {
        let mut held = self.held();
        held.stopped = true;
        let _ = held.process.map(|process| kill(process, Signal::SIGKILL));
    }

    fn is_stopped(&self) -> bool {
        self.held().stopped || INTERRUPTED.load(Ordering::Relaxed)
    }

    fn holds(&self, process: Option<Pid>) {
        self.held().process = process;
    }
}

/// Worker process.
pub struct WorkerProcess {
    child: Child,
    tasks: Option<ChildStdin>,
    receipts: BufReader<ChildStdout>,
}

impl WorkerProcess {
    /// Sends a task to the worker and waits for the receipt; `None` if the worker is lost.
    fn ask(&mut self, task: &str, leash: &ProcessStopHandle) -> Option<Receipt> {
        leash.holds(i32::try_from(self.child.id()).ok().map(Pid::from_raw));
        let answer = self.asked(task);
        leash.holds(None);
        answer
    }

    fn asked(&mut self, task: &str) -> Option<Receipt> {
        let tasks = self.tasks.as_mut()?;
        tasks.write_all(format!("{task}\n").as_bytes()).and_then(|()| tasks.flush()).ok()?;
        let mut line = String::new();
        self.receipts.read_line(&mut line).ok()?;
        Receipt::parse(&line).ok()
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        // A worker ends when its input is closed; a lost worker has ended already.
        self.tasks.take();
        let _ = self.child.wait();
    }
}

impl WorkerCommand {
    /// Computes a task in `worker` or, if it is `None`, in a new worker. Replaces a lost worker. On return, `worker`
    /// holds the last worker. If this process receives a stop signal, the receipt is partial or `None`. A task that the
    /// workers reject has a receipt with the reason.
    pub fn receipt(
        &self,
        worker: &mut Option<WorkerProcess>,
        task: &Task,
        leash: &ProcessStopHandle,
    ) -> Option<Receipt> {
        let text = match serde_json::to_string(task) {
            Ok(text) => text,
            Err(e) => return Some(task.failure(&Fault::machine(e.to_string()))),
        };
        let wanted = task.wanted().count();
        // Each loss of a worker, except for the first few, counts as an attempt at one or more units.
        let most = task.units.len().saturating_mul(self.retries + 1) + self.retries + 2;
        for loss in 0..most {
            if leash.is_stopped() {
                return None;
            }
            let running = match worker.take().map_or_else(|| self.start(), Ok) {
                Ok(running) => running,
                Err(fault) => return Some(task.failure(&fault)),
            };
            let answer = worker.insert(running).ask(&text, leash);
            // A stopped worker skips units.
            let whole = |r: &Receipt| r.refused.is_some() || !r.ended && r.units.len() >= wanted;
            match answer {
                Some(mut receipt) if whole(&receipt) || !receipt.ended && leash.is_stopped() => {
                    // A result that is found in the store after a loss was computed by the lost worker.
                    let found = receipt.units.iter_mut().filter(|a| loss > 0 && a.outcome == UnitOutcome::Reused);
                    found.for_each(|a| a.outcome = UnitOutcome::Computed);
                    return Some(receipt);
                }
                Some(_) => *worker = None,
                None => {
                    *worker = None;
                    if let Err(fault) = Store::join(&self.store) {
                        return Some(task.refusal(&fault));
                    }
                }
            }
        }
        Some(task.failure(&Fault::machine(format!("{most} workers ended without a receipt"))))
    }

    fn start(&self) -> Result<WorkerProcess, Fault> {
        let fail = |e: &dyn Display| Fault::machine(format!("cannot start {}: {e}", self.program.display()));
        let mut command = Command::new(&self.program);
        command.args(["task", "--quiet", "--threads", "1", "--retries", &self.retries.to_string(), "--store"]);
        command.arg(&self.store).args(["--parent", &std::process::id().to_string()]);
        if let Some(limit) = self.unit_timeout {
            command.args(["--unit-timeout", &format!("{}s", limit.as_secs().max(1))]);
        }
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(|e| fail(&e))?;
        match (child.stdin.take(), child.stdout.take()) {
            (tasks @ Some(_), Some(receipts)) => Ok(WorkerProcess { child, tasks, receipts: BufReader::new(receipts) }),
            _ => Err(fail(&"the process has no standard streams")),
        }
    }
}

//! The engine `processes`: workers are processes of this program, on this machine. A unit that kills its worker, or takes
//! too long, takes nothing else with it.

use std::{
    io::{BufRead, BufReader, Write},
    path::PathBuf,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use schemas::Fault;

use super::{
    engine::{Engine, Wave},
    events::Outcome,
    interrupt::INTERRUPTED,
    task::{Answer, Receipt, Task},
};

/// The most units of a task: a worker that is lost takes that many with it, until each is tried by itself.
const UNITS: usize = 12;

/// Worker processes, which live as long as a wave.
pub struct Processes {
    /// This program.
    pub program: PathBuf,
    /// The number of processes; each has one thread.
    pub count: usize,
    /// How often a unit is tried again after its worker was lost.
    pub retries: usize,
    /// The longest time of a unit.
    pub unit_timeout: Option<Duration>,
}

/// A worker process.
struct Running {
    child: Child,
    tasks: Option<ChildStdin>,
    receipts: BufReader<ChildStdout>,
}

impl Running {
    /// Hands a task to the worker, and waits for the receipt; none where the worker is lost.
    fn ask(&mut self, task: &str) -> Option<Receipt> {
        let tasks = self.tasks.as_mut()?;
        tasks.write_all(format!("{task}\n").as_bytes()).and_then(|()| tasks.flush()).ok()?;
        let mut line = String::new();
        self.receipts.read_line(&mut line).ok()?;
        Receipt::parse(&line).ok()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A worker whose tasks have come to their end ends too; one that is lost has ended.
        self.tasks.take();
        let _ = self.child.wait();
    }
}

impl Engine for Processes {
    fn is_local(&self) -> bool {
        false
    }

    fn most_units(&self) -> usize {
        UNITS
    }

    fn run(&self, wave: &Wave) -> Vec<Option<Receipt>> {
        let next = AtomicUsize::new(0);
        let receipts: Vec<Mutex<Option<Receipt>>> = wave.tasks.iter().map(|_| Mutex::new(None)).collect();
        let attend = || {
            let mut worker = None;
            while !INTERRUPTED.load(Ordering::Relaxed) {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let (Some(task), Some(place)) = (wave.tasks.get(i), receipts.get(i)) else { break };
                let Some(receipt) = self.receipt(&mut worker, wave, task) else { break };
                for answer in &receipt.units {
                    let unit = task.units.iter().find(|u| (u.point, u.line) == (answer.point, answer.line));
                    let outcome = answer.outcome;
                    unit.into_iter().for_each(|u| (wave.told)(u.unit(wave.table), outcome, answer.fault.as_ref()));
                }
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

impl Processes {
    /// Has a task computed, by one worker after another while these are lost; none where the run is interrupted.
    fn receipt(&self, worker: &mut Option<Running>, wave: &Wave, task: &Task) -> Option<Receipt> {
        let failed = |fault: &Fault| {
            let wanted = task.units.iter().filter(|u| !u.have);
            Some(task.receipt(wanted.map(|u| Answer::of(u, Outcome::Failed, Some(fault.clone()))).collect()))
        };
        let text = match serde_json::to_string(task) {
            Ok(text) => text,
            Err(e) => return failed(&Fault::machine(e.to_string())),
        };
        // Each loss is an attempt at one unit at least, after the first ones.
        let most = task.units.len().saturating_mul(self.retries + 1) + self.retries + 2;
        for loss in 0..most {
            let running = match worker.take().map_or_else(|| self.start(wave), Ok) {
                Ok(running) => running,
                Err(fault) => return failed(&fault),
            };
            let answer = worker.insert(running).ask(&text);
            let lost = answer.as_ref().is_none_or(|receipt| receipt.ended);
            if lost {
                *worker = None;
            }
            match answer {
                Some(Receipt { refused: Some(why), .. }) => {
                    return failed(&Fault::machine(format!("the worker refused the task: {why}")));
                }
                Some(mut receipt) if !lost => {
                    // What is found after a loss was computed by the worker that was lost.
                    let found = receipt.units.iter_mut().filter(|a| loss > 0 && a.outcome == Outcome::Reused);
                    found.for_each(|a| a.outcome = Outcome::Computed);
                    return Some(receipt);
                }
                Some(_) | None => {}
            }
            if INTERRUPTED.load(Ordering::Relaxed) {
                return None;
            }
        }
        failed(&Fault::machine(format!("{most} workers ended before they answered")))
    }

    fn start(&self, wave: &Wave) -> Result<Running, Fault> {
        let fail = |e: &dyn std::fmt::Display| Fault::machine(format!("cannot start {}: {e}", self.program.display()));
        let mut command = Command::new(&self.program);
        command.args(["task", "--quiet", "--threads", "1", "--retries", &self.retries.to_string(), "--store"]);
        command.arg(wave.worker.store().root());
        if let Some(limit) = self.unit_timeout {
            command.args(["--unit-timeout", &format!("{}s", limit.as_secs())]);
        }
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(|e| fail(&e))?;
        match (child.stdin.take(), child.stdout.take()) {
            (tasks @ Some(_), Some(receipts)) => Ok(Running { child, tasks, receipts: BufReader::new(receipts) }),
            _ => Err(fail(&"it has no streams")),
        }
    }
}

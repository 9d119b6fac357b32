//! Worker process: it reads the plan from the store, rejects tasks that do not match the plan, finds finished units,
//! and counts attempts. A unit that kills its workers thus fails after several attempts, and the other units of its
//! task are computed.

use std::{
    collections::HashMap,
    sync::{
        atomic::Ordering,
        mpsc::{RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use plan::{LineId, Plan, PlanGraph, RecordedPlan, spec::SpecFaults};
use schemas::{Fault, Grain, StageEntry, keys::HashKey};
use store::{Store, attempts::UnitAttempts, kernel};

use super::{
    compute::{compute, pack_of},
    engine::prepare,
    events::SilentListener,
    interrupt::{INTERRUPTED, STARTED},
    task::{Receipt, Task, TaskUnit, UnitAnswer, VERSION},
    work::UnitWorker,
};

/// Limits of a worker.
#[derive(Clone, Copy, Debug)]
pub struct WorkerLimits {
    /// Maximum number of retries of a unit whose worker was lost.
    pub retries: usize,
    /// Maximum time of a unit. The limit of a group of units is the sum of the limits of its units.
    pub unit_timeout: Option<Duration>,
}

/// Counts of failed work of a worker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerTally {
    /// Number of rejected tasks.
    pub refused: usize,
    /// Number of units that have no answer, or a fault that may be temporary.
    pub unanswered: usize,
}

/// Callback for a receipt.
pub type ReceiptCallback<'a> = dyn Fn(&Receipt) + Sync + 'a;

/// Computes `tasks` one after another, on rayon's current thread pool. `answered` receives each receipt. `overdue`
/// receives the receipt of a task that exceeds its time limit. The function should end the process, since a thread
/// cannot be stopped.
pub fn serve(
    store: &Store,
    catalogue: &[StageEntry],
    tasks: &mut dyn Iterator<Item = Task>,
    limits: WorkerLimits,
    answered: &ReceiptCallback,
    overdue: &ReceiptCallback,
) -> WorkerTally {
    let mut served = WorkerTally::default();
    let mut next = tasks.next();
    while let Some(task) = next.take() {
        match opened(store, catalogue, &task) {
            Err(fault) => {
                served.refuse(&task, &fault, answered);
                next = tasks.next();
            }
            Ok((recorded, plan)) => match recorded.graph(&plan) {
                Err(faults) => {
                    served.refuse(&task, &Fault::new(faults.to_string()), answered);
                    next = tasks.next();
                }
                Ok(graph) => {
                    let bench =
                        PlanSession { worker: &UnitWorker::new(&graph, store, &SilentListener), limits, overdue };
                    next = bench.serve(task, tasks, &mut served, answered);
                }
            },
        }
        if INTERRUPTED.load(Ordering::Relaxed) {
            break;
        }
    }
    served
}

/// Plan of a task.
fn opened(store: &Store, catalogue: &[StageEntry], task: &Task) -> Result<(RecordedPlan, Plan), Fault> {
    if task.magline != VERSION {
        let what = format!("the task was written by magline {}, but this is magline {VERSION}", task.magline);
        return Err(Fault::new(what).help("use the same version for tasks and workers"));
    }
    let key = task.plan.ok_or_else(|| Fault::new("the task has no plan"))?;
    let recorded = RecordedPlan::find(store, key)?;
    let plan = recorded.plan(catalogue).map_err(|faults: SpecFaults| {
        let what = format!("this program cannot plan the task: {faults}");
        Fault::new(what).help("use the same version for tasks and workers")
    })?;
    Ok((recorded, plan))
}

/// Fault of a unit after too many attempts.
pub fn given_up(tries: &UnitAttempts) -> Fault {
    let times = |n: usize| if n == 1 { "once".to_owned() } else { format!("{n} times") };
    let lost = "its worker was lost";
    let what = match (&tries.why, tries.lost) {
        (Some(why), 0) => format!("{why} ({} in a worker)", times(tries.failed)),
        (Some(why), n) => format!("{why} ({} in a worker), and {lost} {}", times(tries.failed), times(n)),
        (None, n) => {
            format!(
                "{lost} {} during this computation: it was killed, ran out of memory, or exceeded the time limit",
                times(n)
            )
        }
    };
    Fault::machine(what).help(format!("to try again, use `--retries {}`", tries.all()))
}

impl WorkerTally {
    fn refuse(&mut self, task: &Task, fault: &Fault, answered: &ReceiptCallback) {
        *(if fault.owner.is_lasting() { &mut self.refused } else { &mut self.unanswered }) += 1;
        answered(&named(task.refusal(fault), Instant::now()));
    }
}

fn named(mut receipt: Receipt, begun: Instant) -> Receipt {
    receipt.seconds = begun.elapsed().as_secs_f64();
    receipt.worker = format!("{} process {}", kernel(), std::process::id());
    receipt
}

/// Execution of the tasks of one plan.
struct PlanSession<'a> {
    worker: &'a UnitWorker<'a>,
    limits: WorkerLimits,
    overdue: &'a ReceiptCallback<'a>,
}

impl PlanSession<'_> {
    /// Computes `first` and the following tasks of the same plan; returns the first task of another plan.
    fn serve(
        &self,
        first: Task,
        tasks: &mut dyn Iterator<Item = Task>,
        served: &mut WorkerTally,
        answered: &ReceiptCallback,
    ) -> Option<Task> {
        let plan = first.plan;
        let (mut next, mut last) = (Some(first), None);
        while let Some(task) = next.take() {
            if task.plan != plan || task.magline != VERSION {
                return Some(task);
            }
            // While the process waits for tasks, an interrupt ends the process at once.
            STARTED.store(true, Ordering::SeqCst);
            let begun = Instant::now();
            match checked(self.worker.graph(), &task) {
                Err(fault) => served.refuse(&task, &fault, answered),
                Ok(table) => {
                    last.replace(table).filter(|last| *last != table).into_iter().for_each(|t| self.worker.forget(t));
                    let receipt = self.receipt(table, &task, self.answers(table, &task, begun), begun);
                    let left = task.wanted().count().saturating_sub(receipt.units.len());
                    let passing = receipt.units.iter().filter_map(|a| a.fault.as_ref());
                    served.unanswered += left + passing.filter(|f| !f.owner.is_lasting()).count();
                    answered(&receipt);
                }
            }
            if INTERRUPTED.load(Ordering::Relaxed) {
                break;
            }
            STARTED.store(false, Ordering::SeqCst);
            next = tasks.next();
        }
        None
    }

    /// Receipt of a task, with its answers in the order of its units.
    fn receipt(&self, table: usize, task: &Task, mut answers: Vec<UnitAnswer>, begun: Instant) -> Receipt {
        let places = task.units.iter().enumerate().map(|(i, u)| ((u.point, u.line), i));
        let places: HashMap<(usize, Option<LineId>), usize> = places.collect();
        answers.sort_by_key(|a| places.get(&(a.point, a.line)).copied());
        let mut receipt = task.receipt(answers);
        receipt.name(self.worker.graph(), table);
        named(receipt, begun)
    }

    fn answers(&self, table: usize, task: &Task, begun: Instant) -> Vec<UnitAnswer> {
        let wanted: Vec<&TaskUnit> = task.wanted().collect();
        let store = self.worker.store();
        match self.worker.cut(table) {
            Ok(cut) => {
                let all: Vec<&TaskUnit> = task.units.iter().collect();
                store.adopt(pack_of(cut, table, task.part, &all));
            }
            Err(fault) => return task.failure(&fault).units,
        }
        let tries = store.attempts_at(&wanted.iter().map(|u| u.key).collect::<Vec<_>>());
        if tries.iter().any(|t| t.all() > 0) {
            // A lost worker may have written some results, under names that depend on its earlier progress.
            store.refresh();
        }
        let (mut answers, mut fresh, mut tried) = (vec![], vec![], vec![]);
        for (unit, tries) in wanted.into_iter().zip(tries) {
            match UnitAnswer::stored(unit, store) {
                Some(answer) => answers.push(answer),
                None if tries.all() == 0 => fresh.push(unit.clone()),
                None => tried.push((tries, unit.clone())),
            }
        }
        if !fresh.is_empty() {
            let whole = tried.is_empty() && answers.is_empty();
            let together = if whole { task.clone() } else { task.part_of(fresh) };
            answers.extend(self.attempt(table, task, &together, &answers, begun));
        }
        // Units with the fewest losses come first, so that a unit that kills its workers delays no other unit.
        tried.sort_by_key(|(tries, _)| tries.all());
        for (tries, unit) in tried {
            if INTERRUPTED.load(Ordering::Relaxed) {
                break;
            }
            let answer = match UnitAnswer::stored(&unit, store) {
                Some(answer) => vec![answer],
                None if tries.all() > self.limits.retries => vec![UnitAnswer::failed(&unit, &given_up(&tries))],
                None => self.attempt(table, task, &task.part_of(vec![unit]), &answers, begun),
            };
            answers.extend(answer);
        }
        answers
    }

    /// Computes `together`, some units of `task`, within their time limit.
    fn attempt(
        &self,
        table: usize,
        task: &Task,
        together: &Task,
        before: &[UnitAnswer],
        begun: Instant,
    ) -> Vec<UnitAnswer> {
        let store = self.worker.store();
        let mut keys: Vec<HashKey> = together.wanted().map(|u| u.key).collect();
        keys.sort_unstable();
        keys.dedup();
        let all = |fault: &Fault| together.failure(fault).units;
        let attempt = match store.attempt(&keys) {
            Ok(attempt) => attempt,
            Err(fault) => return all(&fault),
        };
        let units = u32::try_from(keys.len()).unwrap_or(u32::MAX);
        let limit = self.limits.unit_timeout.map(|limit| limit.saturating_mul(units));
        let late = || {
            let answers = before.iter().cloned().chain(all(&overdue(limit.unwrap_or_default(), keys.len())));
            let mut receipt = self.receipt(table, task, answers.collect(), begun);
            receipt.ended = true;
            (self.overdue)(&receipt);
        };
        let work = || {
            prepare(self.worker, table, std::slice::from_ref(together));
            compute(self.worker, table, together, &|_, _, _| ())
        };
        let receipt = in_time(limit, work, late);
        let passing = receipt.units.iter().filter_map(|a| Some((a.key, a.fault.as_ref()?)));
        let passing: HashMap<HashKey, &Fault> = passing.filter(|(_, fault)| !fault.owner.is_lasting()).collect();
        attempt.end(store, &passing);
        receipt.units
    }
}

fn overdue(limit: Duration, units: usize) -> Fault {
    let seconds = limit.as_secs_f64();
    let fault = match units {
        1 => Fault::machine(format!("the unit exceeded its time limit of {seconds} s")),
        n => Fault::machine(format!("the unit and {} other units exceeded their time limit of {seconds} s", n - 1)),
    };
    fault.help(if units == 1 { "increase `--unit-timeout`" } else { "the next run retries each unit separately" })
}

/// Runs `work`, and calls `late` from another thread when it takes longer than `limit`.
fn in_time<T>(limit: Option<Duration>, work: impl FnOnce() -> T, late: impl FnOnce() + Send) -> T {
    let Some(limit) = limit else { return work() };
    let (done, wait) = channel::<()>();
    thread::scope(|scope| {
        scope.spawn(move || {
            if wait.recv_timeout(limit) == Err(RecvTimeoutError::Timeout) {
                late();
            }
        });
        let made = work();
        drop(done);
        made
    })
}

/// Checks that all units of a task match the plan, and returns the task's table.
fn checked(graph: &PlanGraph, task: &Task) -> Result<usize, Fault> {
    let table = graph.plan.table(&task.table)?;
    let node = &graph.plan.tables[table];
    let strange = |what: String| Fault::new(what).help("write the tasks again with `magline tasks`");
    if !node.keep {
        return Err(strange(format!("`{}` has `keep = false`, so its results are not stored", task.table)));
    }
    for unit in &task.units {
        let place = match unit.line {
            Some(line) => format!("point {}, line {line} of `{}`", unit.point, task.table),
            None => format!("point {} of `{}`", unit.point, task.table),
        };
        let there = unit.point < node.len()
            && match (node.entry.grain, unit.line) {
                (Grain::Line, Some(line)) => graph.lines_of(table, unit.point).binary_search(&line).is_ok(),
                (Grain::Survey | Grain::Map, None) => true,
                (Grain::Line, None) | (Grain::Survey | Grain::Map, Some(_)) => false,
            };
        if !there || unit.without.iter().any(|line| *line >= graph.lines.len()) {
            return Err(strange(format!("the plan has no unit at {place}")));
        }
        let key = graph.key(unit.unit(table)).map_err(|fault| strange(format!("{place}: {fault}")))?;
        if key != unit.key {
            let what = format!("{place} has the key {} in the task, but {key} in this program", unit.key);
            return Err(Fault::new(what).help("use the same version for tasks and workers"));
        }
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_only_late_work_is_reported_and_only_once() {
        let expired = std::sync::Mutex::new(0);
        let late = || *expired.lock().unwrap() += 1;
        assert_eq!(in_time(None, || 1, late), 1);
        assert_eq!(in_time(Some(Duration::from_secs(600)), || 2, late), 2);
        assert_eq!(*expired.lock().unwrap(), 0);
        let slow = || {
            while *expired.lock().unwrap() == 0 {
                thread::sleep(Duration::from_millis(1));
            }
            3
        };
        assert_eq!(in_time(Some(Duration::from_millis(5)), slow, late), 3);
        assert_eq!(*expired.lock().unwrap(), 1);
    }
}

//! Dispatch of the tasks of a wave to a cluster until all have answers.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{
        atomic::Ordering,
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    time::{Duration, Instant},
};

use schemas::Fault;
use store::shown;
use uuid::Uuid;

use super::{
    BallistaEngine, ObservationTimer,
    client::{ClusterSnapshot, SchedulerFault, job},
    job_size::{JOBS_A_CORE, size},
    units::{AnswerMessage, TaskMessage},
    verdict::{JobAction, JobObservation, STALL},
};
use crate::{
    compute::pack_of,
    engine::TaskWave,
    interrupt::INTERRUPTED,
    task::{Receipt, Task, TaskUnit, UnitAnswer},
};

/// Maximum number of tasks of a job before the first answer, and maximum size of the text of a job's tasks, in bytes.
const MOST_UNSEEN: usize = 8;
const MOST_BYTES: usize = 1 << 20;
/// Maximum number of failed attempts per task.
const MOST_TRIES: usize = 4;
/// Maximum number of restarts of the scheduler during a wave.
const MOST_RESTARTS: usize = 20;
/// Interval of checks of the cluster.
const LOOKS_EVERY: Duration = Duration::from_secs(2);
/// Interval of checks of long jobs, and age from which a job counts as long.
const LONG: Duration = Duration::from_secs(15);
/// Delay between a failed job and the next job.
const AGAIN_AFTER: Duration = Duration::from_millis(500);
/// Delay before missing workers are reported.
const REPORT_MISSING_AFTER: Duration = Duration::from_secs(3);
/// Polling interval for events.
const TICK: Duration = Duration::from_millis(100);

/// Job in progress.
struct WaveJob {
    tasks: Vec<usize>,
    begun: Instant,
    looked: Instant,
    /// Whether all results were in the store at the last check.
    there: bool,
    /// Start of the period in which no worker computes the job; `None` while a worker computes it.
    idle: Option<Instant>,
}

/// Number of a job, and the job's answers or its error.
type WaveJobResult = (usize, Result<Vec<AnswerMessage>, String>);

/// Dispatch of a wave to a cluster, with its jobs and receipts.
pub struct WaveDispatcher<'a> {
    engine: &'a BallistaEngine,
    wave: &'a TaskWave<'a>,
    id: String,
    tasks: BTreeMap<String, usize>,
    waiting: VecDeque<usize>,
    jobs: BTreeMap<usize, WaveJob>,
    receipts: Vec<Option<Receipt>>,
    /// Number of failed attempts of each task.
    tries: Vec<usize>,
    number: usize,
    /// Number of answered tasks, and their total time, in seconds.
    answered: (usize, f64),
    /// Number of tasks rejected since the last answer.
    refused: usize,
    restarts: usize,
    seen: ClusterSnapshot,
    looked: Option<Instant>,
    /// Times since the scheduler last answered, since a worker was last seen, and since the last job failed.
    scheduler_seen: ObservationTimer,
    worker_seen: ObservationTimer,
    failed_since: Option<ObservationTimer>,
    last_error: String,
    waits: bool,
}

impl<'a> WaveDispatcher<'a> {
    /// Dispatcher without any dispatched job.
    pub fn new(engine: &'a BallistaEngine, wave: &'a TaskWave<'a>) -> WaveDispatcher<'a> {
        let count = wave.tasks.len();
        WaveDispatcher {
            engine,
            wave,
            id: Uuid::new_v4().simple().to_string(),
            tasks: wave.tasks.iter().enumerate().map(|(i, task)| (task.id().to_string(), i)).collect(),
            waiting: (0..count).collect(),
            jobs: BTreeMap::new(),
            receipts: vec![None; count],
            tries: vec![0; count],
            number: 0,
            answered: (0, 0.0),
            refused: 0,
            restarts: 0,
            seen: engine.seen.clone(),
            looked: None,
            scheduler_seen: ObservationTimer::now(),
            worker_seen: ObservationTimer::now(),
            failed_since: None,
            last_error: String::new(),
            waits: false,
        }
    }

    /// Dispatches tasks and collects receipts until each task has a receipt, or the run is interrupted.
    pub fn run(mut self) -> Vec<Option<Receipt>> {
        let (sender, receiver) = channel();
        while !(self.waiting.is_empty() && self.jobs.is_empty()) {
            if INTERRUPTED.load(Ordering::Relaxed) {
                self.cancel(None);
                break;
            }
            let end_reason = self.look().or_else(|| self.end_reason());
            if let Some(fault) = end_reason {
                self.cancel(None);
                let rest: Vec<usize> = (0..self.receipts.len()).filter(|i| self.receipts[*i].is_none()).collect();
                rest.into_iter().for_each(|i| self.settle(i, self.wave.tasks[i].failure(&fault)));
                break;
            }
            self.dispatch_jobs(&sender);
            self.listen(&receiver);
            self.look_after();
        }
        if self.waits {
            self.wave.worker.waits(None);
        }
        self.receipts
    }

    /// Receives the results of a job, if there are any.
    fn listen(&mut self, receiver: &Receiver<WaveJobResult>) {
        match receiver.recv_timeout(TICK) {
            Ok((number, answers_of_job)) => {
                let Some(job) = self.jobs.remove(&number) else { return };
                match answers_of_job {
                    Ok(answers) => self.process_answers(&job.tasks, answers),
                    Err(why) => self.process_failed_job(&job.tasks, &why),
                }
            }
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
    }

    /// Checks scheduler and workers periodically. Returns a fault that ends the wave.
    fn look(&mut self) -> Option<Fault> {
        if self.looked.is_some_and(|at| at.elapsed() < LOOKS_EVERY) {
            return None;
        }
        self.looked = Some(Instant::now());
        match self.engine.scheduler.look() {
            Ok(seen) => {
                self.scheduler_seen.seen();
                if seen.scheduler != self.seen.scheduler {
                    self.restarts += 1;
                }
                if seen.cores > 0 {
                    self.worker_seen.seen();
                }
                self.seen = seen;
            }
            Err(why @ (SchedulerFault::Other(_) | SchedulerFault::Stranger)) => {
                return Some(why.fault(&self.engine.scheduler.authority));
            }
            Err(SchedulerFault::Silent(why)) => {
                self.seen.cores = 0;
                self.last_error = why;
            }
        }
        let missing = self.seen.cores == 0 && self.worker_seen.longer_than(REPORT_MISSING_AFTER);
        if missing != self.waits {
            self.waits = missing;
            let what = format!("a worker of {}", self.engine.scheduler.authority);
            self.wave.worker.waits(missing.then_some(what.as_str()));
        }
        None
    }

    /// Reason to end the wave.
    fn end_reason(&self) -> Option<Fault> {
        let (authority, patience) = (&self.engine.scheduler.authority, self.engine.limits.patience);
        let seconds = patience.as_secs();
        if self.scheduler_seen.longer_than(patience) {
            let what = format!("the scheduler at {authority} has not answered for {seconds} s: {}", self.last_error);
            return Some(Fault::machine(what).help("restart the scheduler, then run the spec again to resume"));
        }
        if self.restarts > MOST_RESTARTS {
            let what = format!("the scheduler at {authority} restarted more than {MOST_RESTARTS} times");
            return Some(Fault::machine(what).help("see the error output of the scheduler for the reason"));
        }
        if self.worker_seen.longer_than(patience) {
            let others = match self.seen.others.as_slice() {
                [] => String::new(),
                others => format!("; workers of another version: {}", others.join(", ")),
            };
            let last = if self.refused > 0 {
                format!("; the last worker rejected its task: {}", self.last_error)
            } else {
                String::new()
            };
            let what =
                format!("no worker has been registered with the scheduler {authority} for {seconds} s{others}{last}");
            return Some(Fault::machine(what).help(format!(
                "start workers with `magline worker --scheduler {authority} --store {}`, or increase `--patience`",
                shown(self.wave.worker.store().root())
            )));
        }
        let most = 2 * self.seen.cores.max(1) + MOST_TRIES;
        (self.refused >= most).then(|| self.refusal())
    }

    /// Dispatches jobs up to the capacity of the cluster.
    fn dispatch_jobs(&mut self, sender: &Sender<WaveJobResult>) {
        if self.failed_since.is_some_and(|since| !since.longer_than(AGAIN_AFTER)) {
            return;
        }
        let room = (JOBS_A_CORE * self.seen.cores).saturating_sub(self.jobs.len());
        for _ in 0..room {
            let (tasks, handed) = self.bundle();
            if tasks.is_empty() {
                break;
            }
            self.number += 1;
            let (number, sender) = (self.number, sender.clone());
            let now = Instant::now();
            self.jobs.insert(number, WaveJob { tasks, begun: now, looked: now, there: false, idle: None });
            let made = job(self.engine.scheduler.place(), self.engine.session.clone(), self.name(number), vec![handed]);
            self.engine.runtime.spawn(async move {
                // Sending fails after an interrupt, because there is no receiver then.
                let _ = sender.send((number, made.await.map_err(|e| e.to_string())));
            });
        }
    }

    fn name(&self, number: usize) -> String {
        format!("magline {} {number}", self.id)
    }

    /// Number of tasks of the next job.
    fn most(&self) -> usize {
        let (all, waiting, cores) = (self.receipts.len(), self.waiting.len(), self.seen.cores.max(1));
        match self.answered {
            (0, _) => {
                let units: usize = self.wave.tasks.iter().map(|task| task.units.len()).sum();
                let expected_s = self.wave.unit_s * units as f64 / all.max(1) as f64;
                if expected_s > 0.0 { size(expected_s, all, waiting, cores).min(MOST_UNSEEN) } else { 1 }
            }
            (n, seconds) => size(seconds / n as f64, all, waiting, cores),
        }
    }

    /// Next tasks to dispatch together.
    fn bundle(&mut self) -> (Vec<usize>, Vec<TaskMessage>) {
        let most = self.most();
        let (mut tasks, mut handed, mut bytes) = (vec![], vec![], 0);
        while tasks.len() < most && bytes < MOST_BYTES {
            let Some(i) = self.waiting.pop_front() else { break };
            // A task that has failed is dispatched alone, so that it does not affect others.
            if self.tries[i] > 0 && !tasks.is_empty() {
                self.waiting.push_front(i);
                break;
            }
            match self.handed(i) {
                Ok(one) => {
                    bytes += one.task.len();
                    handed.push(one);
                    tasks.push(i);
                }
                Err(fault) => self.settle(i, self.wave.tasks[i].failure(&fault)),
            }
            if self.tries[i] > 0 {
                break;
            }
        }
        (tasks, handed)
    }

    fn handed(&self, i: usize) -> Result<TaskMessage, Fault> {
        let task: &Task = &self.wave.tasks[i];
        let limits = self.engine.limits;
        Ok(TaskMessage {
            id: task.id().to_string(),
            wave: self.id.clone(),
            retries: limits.retries as u64,
            unit_timeout_s: limits.unit_timeout.map_or(0, |limit| limit.as_secs().max(1)),
            task: serde_json::to_string(task).map_err(|e| Fault::machine(e.to_string()))?,
        })
    }

    /// Records the receipt of a task.
    fn settle(&mut self, i: usize, receipt: Receipt) {
        self.wave.report_outcomes(&self.wave.tasks[i], &receipt);
        self.receipts[i] = Some(receipt);
    }

    /// Dispatches a failed task again, up to the maximum number of attempts.
    fn again(&mut self, i: usize, why: Fault) {
        self.tries[i] += 1;
        if self.tries[i] >= MOST_TRIES {
            self.settle(i, self.wave.tasks[i].failure(&why));
        } else {
            self.waiting.push_back(i);
        }
    }

    fn refusal(&self) -> Fault {
        let store = shown(self.wave.worker.store().root());
        Fault::machine(format!("the workers reject the tasks: {}", self.last_error))
            .help(format!("the `--store` of each worker must be the store of this run, {store}"))
    }

    /// Processes the answers of a job.
    fn process_answers(&mut self, tasks: &[usize], answers: Vec<AnswerMessage>) {
        let mut left: Vec<usize> = tasks.to_vec();
        for AnswerMessage { id, worker, receipt, refused: why } in answers {
            let Some(at) = self.tasks.get(&id).and_then(|i| left.iter().position(|l| l == i)) else {
                // Duplicate or foreign answer: it does not match a dispatched task.
                let fault = Fault::bug(format!(
                    "the worker {worker} returned a receipt for a task that it does not have, or a duplicate receipt"
                ));
                tasks.iter().for_each(|i| self.settle(*i, self.wave.tasks[*i].failure(&fault)));
                return;
            };
            let i = left.swap_remove(at);
            match (receipt.map(|text| Receipt::parse(&text)), why) {
                (Some(Ok(receipt)), None) => self.receipt(i, receipt),
                (Some(Err(fault)), _) => self.again(i, fault),
                (_, why) => {
                    self.refused += 1;
                    self.last_error = format!("{worker}: {}", why.unwrap_or_default());
                    self.again(i, self.refusal());
                }
            }
        }
        // Tasks that a worker skipped after a stop signal.
        self.waiting.extend(left);
    }

    fn receipt(&mut self, i: usize, receipt: Receipt) {
        let task = &self.wave.tasks[i];
        let same = |(u, a): (&TaskUnit, &UnitAnswer)| (u.point, u.line, u.key) == (a.point, a.line, a.key);
        let known = || task.wanted();
        if receipt.units.len() == known().count() && known().zip(&receipt.units).all(same) {
            self.answered = (self.answered.0 + 1, self.answered.1 + receipt.seconds);
            self.refused = 0;
            self.settle(i, receipt);
        } else {
            self.again(i, Fault::machine("its worker was stopped in each attempt"));
        }
    }

    /// Processes a failed job: its scheduler or worker was lost, or the job was cancelled.
    fn process_failed_job(&mut self, tasks: &[usize], why: &str) {
        let before = self.seen.scheduler.clone();
        self.looked = None;
        let lost = self.look().is_some() || self.seen.cores == 0 || self.seen.scheduler != before;
        self.failed_since = Some(ObservationTimer::now());
        if lost {
            // The tasks did not cause this failure.
            self.waiting.extend(tasks);
        } else {
            let fault = Fault::machine(format!("the cluster could not compute the task: {why}"));
            tasks.iter().for_each(|i| self.again(*i, fault.clone()));
        }
    }

    /// Cancels one job, or all jobs.
    fn cancel(&mut self, number: Option<usize>) {
        let name = number.map(|number| self.name(number));
        let begins = format!("magline {} ", self.id);
        let is_wanted = |of: &str| name.as_ref().map_or_else(|| of.starts_with(&begins), |name| of == name);
        let scheduler = &self.engine.scheduler;
        scheduler.jobs(is_wanted).iter().for_each(|(id, _)| scheduler.cancel(id));
        match number {
            Some(number) => drop(self.jobs.remove(&number)),
            None => self.jobs.clear(),
        }
    }

    /// Checks long jobs: an answer may have been lost, which neither the scheduler nor the worker detects.
    fn look_after(&mut self) {
        let long = |job: &WaveJob| job.begun.elapsed() > LONG && job.looked.elapsed() > LONG;
        let due: Vec<usize> = self.jobs.iter().filter(|(_, job)| long(job)).map(|(n, _)| *n).collect();
        if due.is_empty() {
            return;
        }
        let begins = format!("magline {} ", self.id);
        let going = self.engine.scheduler.jobs(|name| name.starts_with(&begins));
        for number in due {
            let Some(job) = self.jobs.get(&number) else { continue };
            let (tasks, found) = (job.tasks.clone(), self.found(&job.tasks));
            let name = self.name(number);
            let id = going.iter().find(|(_, of)| *of == name).map(|(id, _)| id);
            let facts = JobObservation {
                there: found.is_some(),
                were_there: job.there,
                is_handed: id.is_some_and(|id| self.engine.scheduler.is_at_work(id)),
                is_at_work: found.is_some() || self.is_at_work(&tasks),
                idle: job.idle.map(|since| since.elapsed()),
            };
            let verdict = facts.verdict();
            if let Some(job) = self.jobs.get_mut(&number) {
                job.looked = Instant::now();
                job.there = facts.there;
                job.idle = if facts.is_idle() { job.idle.or_else(|| Some(Instant::now())) } else { None };
            }
            match (verdict, found) {
                (JobAction::Wait, _) => {}
                (JobAction::Take, Some(receipts)) => {
                    self.cancel(Some(number));
                    tasks.into_iter().zip(receipts).for_each(|(i, receipt)| self.settle(i, receipt));
                }
                (JobAction::Again | JobAction::Take, _) => {
                    self.cancel(Some(number));
                    let why = format!("no worker computed the task or returned a receipt for {} s", STALL.as_secs());
                    tasks.into_iter().for_each(|i| self.again(i, Fault::machine(why.clone())));
                }
            }
        }
    }

    /// Receipts of tasks whose units all have a result in the store; `None` if a unit lacks a result.
    fn found(&self, tasks: &[usize]) -> Option<Vec<Receipt>> {
        let store = self.wave.worker.store();
        let cut = self.wave.worker.cut(self.wave.table).ok()?;
        let one = |i: &usize| {
            let task = &self.wave.tasks[*i];
            let all: Vec<&TaskUnit> = task.units.iter().collect();
            store.adopt(pack_of(cut, self.wave.table, task.part, &all));
            let units: Option<Vec<UnitAnswer>> = task.wanted().map(|unit| UnitAnswer::stored(unit, store)).collect();
            Some(task.receipt(units?))
        };
        tasks.iter().map(one).collect()
    }

    /// Whether a worker computes a unit of these tasks, by the attempts in the store.
    fn is_at_work(&self, tasks: &[usize]) -> bool {
        let store = self.wave.worker.store();
        let units = tasks.iter().flat_map(|i| self.wave.tasks[*i].wanted());
        store.attempts_at(&units.map(|unit| unit.key).collect::<Vec<_>>()).iter().any(|tries| tries.lost > 0)
    }
}

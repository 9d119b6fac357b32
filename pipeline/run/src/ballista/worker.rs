//! Worker: Ballista's executor, which receives tasks from the scheduler, and one process of this program per core,
//! which computes them. A crash, a hang or excessive memory use affects only the process of the unit. The executor then
//! continues to report to the scheduler.

use std::{
    fs::{self, DirBuilder},
    net::{IpAddr, SocketAddr, TcpListener},
    os::unix::fs::DirBuilderExt,
    path::{Path, PathBuf},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, sleep},
    time::{Duration, Instant},
};

use nix::sys::signal::{Signal, raise};
use schemas::Fault;
use store::{kernel, shown};
use uuid::Uuid;

use super::{
    client::{SchedulerClient, SchedulerFault, named},
    executor::ExecutorSettings,
    key::ClusterTrust,
    runtime,
    scheduler::name_of,
    stop_signal,
    units::{AnswerMessage, COMPUTE, TaskComputer, TaskMessage},
};
use crate::{
    children::{ProcessStopHandle, WorkerCommand, WorkerProcess},
    interrupt::INTERRUPTED,
    task::{Receipt, Task, VERSION},
};

/// Lifetime of a process without a task. The process holds the shared lock of the store while it lives.
const RESTS: Duration = Duration::from_secs(5);
/// A rejected task is retried for this time, because a shared folder may show new files late.
const PATIENCE: Duration = Duration::from_secs(5);
/// Interval of checks of the scheduler.
const LOOKS_EVERY: Duration = Duration::from_secs(5);
/// Time that a run has to fetch an answer before the worker ends.
const FETCHED_AFTER: Duration = Duration::from_secs(2);

/// Configuration of a worker.
#[derive(Clone, Debug)]
pub struct WorkerConfig {
    /// Host of the scheduler.
    pub host: String,
    /// Port of the scheduler.
    pub port: u16,
    /// This program.
    pub program: PathBuf,
    /// The store.
    pub store: PathBuf,
    /// Number of simultaneous tasks.
    pub cores: usize,
    /// Parent of the worker's folder.
    pub work: PathBuf,
    /// Address to listen on.
    pub bind: IpAddr,
    /// First of two ports to listen on; 0 selects two free ports.
    pub ports: u16,
    /// Name by which the scheduler reaches this worker.
    pub advertise: Option<String>,
    /// Interval between reports to the scheduler.
    pub heartbeat: Duration,
    /// Authentication of scheduler and worker.
    pub trust: ClusterTrust,
}

/// Reason for the end of a worker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WorkerExit {
    /// Stop request.
    Requested,
    /// Scheduler that does not answer or has lost this worker; the worker may restart.
    Alone,
}

/// Callback for receipts.
pub type ReceiptHandler = Box<dyn Fn(&Receipt) + Send + Sync>;

/// Fault that ends this worker: the scheduler has another version, or the runs use another store.
static AT_ODDS: OnceLock<Fault> = OnceLock::new();

/// Ends this worker after a delay. Answers that the run has not fetched by then are lost.
fn leave(why: Fault, after: Duration) {
    if AT_ODDS.set(why).is_ok() {
        thread::spawn(move || {
            sleep(after);
            // The executor handles this signal like any other stop request: it finishes its current tasks.
            raise(Signal::SIGTERM)
        });
    }
}

/// Computes dispatched tasks until a stop signal arrives or the scheduler is lost.
///
/// # Errors
/// Fails if the scheduler has another version or cannot reach this worker, or a port or folder is unavailable.
pub fn work(config: &WorkerConfig, on_receipt: ReceiptHandler) -> Result<WorkerExit, Fault> {
    config.trust.admits(config.bind)?;
    let scheduler = SchedulerClient::at(&format!("{}:{}", config.host, config.port), &config.trust)?;
    let name = named(&format!("{}-{}-{}", kernel(), std::process::id(), short()));
    let crew = WorkerPool::new(config, name.clone(), scheduler.authority.clone(), on_receipt);
    if COMPUTE.set(Box::new(crew.clone())).is_err() {
        return Err(Fault::bug("two workers run in one process"));
    }
    let own = config.work.join(format!("magline-worker-{}-{}", std::process::id(), short()));
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(&own)
        .map_err(|e| Fault::machine(format!("cannot make the folder {}: {e}", own.display())))?;
    // `None` if the scheduler was lost after the caller had connected to it.
    let started = scheduler.name().ok();
    let is_lost = || started.is_none() || scheduler.name().ok() != started;
    let ended = crew.attended(&scheduler, || executed(config, name, &own, is_lost));
    // The run has fetched the receipts; remaining files are in a temporary folder.
    let _ = fs::remove_dir_all(&own);
    match (AT_ODDS.get(), ended) {
        (Some(why), _) => Err(why.clone()),
        (None, ended) => ended,
    }
}

fn short() -> String {
    Uuid::new_v4().simple().to_string().chars().take(8).collect()
}

/// Executes tasks in `folder` until the end of this worker. `is_lost` returns whether the scheduler has ended since
/// this worker started.
fn executed(
    config: &WorkerConfig,
    name: String,
    folder: &Path,
    is_lost: impl Fn() -> bool,
) -> Result<WorkerExit, Fault> {
    let listeners = listeners(config)?;
    let port = |listener: &TcpListener| listener.local_addr().map_or(0, |a| a.port());
    let ports = (port(&listeners.0), port(&listeners.1));
    let own = config.advertise.clone().unwrap_or_else(|| name_of(SocketAddr::new(config.bind, ports.0)));
    let executor = ExecutorSettings {
        id: name,
        scheduler: format!("{}:{}", config.host, config.port),
        trust: config.trust.clone(),
        host: own.clone(),
        listeners,
        cores: config.cores,
        work: folder.to_owned(),
        heartbeat: config.heartbeat.max(Duration::from_secs(1)),
    };
    let ended = runtime()?.block_on(async {
        tokio::spawn(async {
            stop_signal().await;
            INTERRUPTED.store(true, Ordering::SeqCst);
        });
        executor.run().await
    });
    match ended {
        Ok(()) if INTERRUPTED.load(Ordering::SeqCst) => Ok(WorkerExit::Requested),
        Ok(()) => Ok(WorkerExit::Alone),
        // The worker is not rejected if the scheduler ends during the registration.
        Err(_) if is_lost() => Ok(WorkerExit::Alone),
        Err(e) => {
            let what = format!("the scheduler at {}:{} rejects this worker: {e}", config.host, config.port);
            Err(Fault::machine(what).help(format!(
                "the scheduler connects to this worker at {own}, ports {} and {}; change them with `--bind`, `--port` \
                 and `--advertise`",
                ports.0, ports.1
            )))
        }
    }
}

/// Binds the two requested ports, or two free ports.
fn listeners(config: &WorkerConfig) -> Result<(TcpListener, TcpListener), Fault> {
    let next = match config.ports {
        0 => 0,
        port => port
            .checked_add(1)
            .ok_or_else(|| Fault::new("`--port` must be below 65535, because two consecutive ports are used"))?,
    };
    let listen = |port: u16| {
        let listener = TcpListener::bind((config.bind, port))?;
        listener.set_nonblocking(true)?;
        Ok(listener)
    };
    let fail = |e: std::io::Error| Fault::machine(format!("cannot listen on {}: {e}", config.bind));
    Ok((listen(config.ports).map_err(fail)?, listen(next).map_err(fail)?))
}

/// Worker processes, at most one per core.
#[derive(Clone)]
struct WorkerPool(Arc<WorkerPoolState>);

struct WorkerPoolState {
    name: String,
    /// Address of the scheduler.
    authority: String,
    /// Whether the worker has computed a unit, which shows that the runs use its store.
    proven: AtomicBool,
    program: PathBuf,
    store: PathBuf,
    places: Mutex<WorkerSlots>,
    freed: Condvar,
    on_receipt: ReceiptHandler,
}

struct WorkerSlots {
    free: usize,
    resting: Vec<IdleProcess>,
}

/// A process without a task, with a view of the store from the start of its wave.
struct IdleProcess {
    wave: String,
    since: Instant,
    process: WorkerProcess,
}

impl WorkerPool {
    fn new(config: &WorkerConfig, name: String, authority: String, on_receipt: ReceiptHandler) -> WorkerPool {
        let places = Mutex::new(WorkerSlots { free: config.cores, resting: vec![] });
        let (program, store, freed) = (config.program.clone(), config.store.clone(), Condvar::new());
        let proven = AtomicBool::new(false);
        WorkerPool(Arc::new(WorkerPoolState { name, authority, proven, program, store, places, freed, on_receipt }))
    }

    fn places(&self) -> MutexGuard<'_, WorkerSlots> {
        self.0.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `work`. Meanwhile, another thread ends idle processes and checks the scheduler.
    fn attended<T>(&self, scheduler: &SchedulerClient, work: impl FnOnce() -> T) -> T {
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                let mut looked = Instant::now();
                while !over.load(Ordering::Relaxed) {
                    sleep(Duration::from_millis(200));
                    let old = self.old();
                    drop(old);
                    if looked.elapsed() >= LOOKS_EVERY {
                        looked = Instant::now();
                        // A scheduler that does not answer may come back, so only another fault ends the worker.
                        if let Err(why @ SchedulerFault::Other(_)) = scheduler.name() {
                            leave(why.fault(&self.0.authority), Duration::ZERO);
                        }
                    }
                }
            });
            let done = work();
            over.store(true, Ordering::Relaxed);
            let resting = std::mem::take(&mut self.places().resting);
            drop(resting);
            done
        })
    }

    /// Removes and returns the processes that have been idle too long.
    fn old(&self) -> Vec<IdleProcess> {
        let mut places = self.places();
        let (old, young) = std::mem::take(&mut places.resting).into_iter().partition(|r| r.since.elapsed() > RESTS);
        places.resting = young;
        old
    }

    /// Takes a place. Returns the idle process of the wave, if there is one. Waits until a place is free: a cancelled
    /// task keeps its place until its process has ended.
    fn enter(&self, wave: &str) -> Option<WorkerProcess> {
        let mut places = self.places();
        while places.free == 0 {
            places = self.0.freed.wait(places).unwrap_or_else(PoisonError::into_inner);
        }
        places.free -= 1;
        let own = places.resting.iter().position(|r| r.wave == wave);
        let found = own.map(|i| places.resting.swap_remove(i).process);
        // Processes of other waves are ended, so that there are at most as many processes as places.
        let most = places.free;
        let surplus = places.resting.len().saturating_sub(most);
        let gone: Vec<IdleProcess> = places.resting.drain(..surplus).collect();
        drop(places);
        drop(gone);
        found
    }

    fn rest(&self, wave: &str, process: Option<WorkerProcess>) {
        let mut places = self.places();
        places.free += 1;
        let resting = process.map(|process| IdleProcess { wave: wave.to_owned(), since: Instant::now(), process });
        places.resting.extend(resting);
        drop(places);
        self.0.freed.notify_one();
    }

    fn answer(
        &self,
        handed: &TaskMessage,
        process: &mut Option<WorkerProcess>,
        leash: &ProcessStopHandle,
    ) -> Option<AnswerMessage> {
        let answered =
            |receipt, refused| AnswerMessage { id: handed.id.clone(), worker: self.0.name.clone(), receipt, refused };
        let refused = |why: String| Some(answered(None, Some(why)));
        let task = match Task::parse(&handed.task) {
            Ok(task) => task,
            Err(fault) => return refused(fault.to_string()),
        };
        let children = WorkerCommand {
            program: self.0.program.clone(),
            store: self.0.store.clone(),
            retries: usize::try_from(handed.retries).unwrap_or(usize::MAX - 1),
            unit_timeout: (handed.unit_timeout_s > 0).then(|| Duration::from_secs(handed.unit_timeout_s)),
        };
        let begun = Instant::now();
        loop {
            let receipt = children.receipt(process, &task, leash)?;
            match &receipt.refused {
                Some(_) if begun.elapsed() < PATIENCE => {
                    *process = None;
                    sleep(Duration::from_secs(1));
                }
                Some(why) => {
                    (self.0.on_receipt)(&receipt);
                    let why = format!("{why} (its store is {})", shown(&self.0.store));
                    // If this worker stayed, it would take tasks away from workers that can compute them.
                    if !self.0.proven.load(Ordering::Relaxed) {
                        let fault = Fault::machine(format!("this worker rejects its first task: {why}"));
                        leave(fault.help("`--store` must be the `store` of the runs"), FETCHED_AFTER);
                    }
                    return refused(why);
                }
                None => {
                    self.0.proven.store(true, Ordering::Relaxed);
                    (self.0.on_receipt)(&receipt);
                    return match serde_json::to_string(&receipt) {
                        Ok(text) => Some(answered(Some(text), None)),
                        Err(e) => refused(e.to_string()),
                    };
                }
            }
        }
    }
}

impl TaskComputer for WorkerPool {
    fn answers(&self, tasks: Vec<TaskMessage>, version: &str, leash: &ProcessStopHandle) -> Vec<AnswerMessage> {
        if version != VERSION {
            leave(SchedulerFault::Other(format!("magline {version}")).fault(&self.0.authority), FETCHED_AFTER);
            let why = format!("the worker is magline {VERSION}, but the run is magline {version}");
            let one = |h: TaskMessage| AnswerMessage {
                id: h.id,
                worker: self.0.name.clone(),
                receipt: None,
                refused: Some(why.clone()),
            };
            return tasks.into_iter().map(one).collect();
        }
        let Some(first) = tasks.first() else { return vec![] };
        let mut process = self.enter(&first.wave);
        let mut answers = vec![];
        for handed in &tasks {
            // The run dispatches the skipped tasks again.
            if INTERRUPTED.load(Ordering::Relaxed) && !answers.is_empty() {
                break;
            }
            match self.answer(handed, &mut process, leash) {
                Some(answer) => answers.push(answer),
                None => break,
            }
        }
        self.rest(&first.wave, process);
        answers
    }
}

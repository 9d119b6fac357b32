//! Runs each query in a separate process. A query that exceeds its time or memory is ended without an effect on other
//! queries.

use std::{
    collections::BTreeMap,
    io::{BufReader, Write},
    path::PathBuf,
    process::{Child, Stdio},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    time::Duration,
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use report::sql::{VersionPins, memory};
use run::confine;
use tokio::{
    runtime::Handle,
    sync::{OwnedSemaphorePermit, Semaphore, oneshot},
    time::{Instant, interval, sleep_until, timeout_at},
};
use tonic::Status;

use super::{
    ServerSettings,
    child::{QueryChunk, QueryFailure, QueryHeader, QueryRequest, UNCOUNTED_BYTES},
    spool::{SpoolReader, SpoolWriter},
};

/// Interval of checks of the memory of a query.
const LOOKS_EVERY: Duration = Duration::from_millis(20);
/// Memory of a process without a query: its program and threads, in bytes.
const OWN: usize = 64 << 20;
/// Maximum number of waiting queries; further queries are rejected at once.
const MOST_WAITING: usize = 256;

/// Input of a query: text, values of parameters, versions of the tables.
#[derive(Clone)]
pub struct QueryInput {
    /// Text of the query.
    pub query: String,
    /// Values of the parameters: one batch, as an IPC stream in base64.
    pub parameters: Option<String>,
    /// Versions of the tables; `None` for the current ones.
    pub pins: Option<VersionPins>,
}

/// All processes that compute queries.
#[derive(Clone)]
pub struct QueryProcessPool(Arc<QueryProcessPoolState>);

struct QueryProcessPoolState {
    program: PathBuf,
    store: PathBuf,
    spill: PathBuf,
    memory: usize,
    at_most: usize,
    timeout: Duration,
    at_once: Arc<Semaphore>,
    waiting: AtomicUsize,
    next: AtomicU64,
    running: Mutex<BTreeMap<u64, QueryProcess>>,
    runtime: Handle,
}

/// Running process.
struct QueryProcess {
    process: u32,
    bytes: usize,
    /// Reason for its end.
    ended: Option<Status>,
}

/// Guard that counts a query as waiting until the guard is dropped.
struct QueueGuard<'a>(&'a AtomicUsize);

impl Drop for QueueGuard<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl QueryProcessPool {
    /// Pool without processes.
    pub fn new(settings: &ServerSettings, runtime: Handle) -> QueryProcessPool {
        QueryProcessPool(Arc::new(QueryProcessPoolState {
            program: settings.program.clone(),
            store: settings.store.clone(),
            spill: settings.spill.clone(),
            memory: settings.memory,
            at_most: settings.queries.max(1),
            timeout: settings.timeout,
            at_once: Arc::new(Semaphore::new(settings.queries.max(1))),
            waiting: AtomicUsize::new(0),
            next: AtomicU64::new(1),
            running: Mutex::default(),
            runtime,
        }))
    }

    fn running(&self) -> MutexGuard<'_, BTreeMap<u64, QueryProcess>> {
        self.0.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn late(&self) -> Status {
        Status::deadline_exceeded(format!("the query exceeded its time limit of {} s", self.0.timeout.as_secs()))
    }

    fn too_much(&self, share: usize) -> Status {
        Status::invalid_argument(format!(
            "error: {}\n  help: select fewer rows or columns, or start the server with a larger `--memory-limit`",
            memory::exceeded(share)
        ))
    }

    /// Columns of a query.
    ///
    /// # Errors
    /// Fails if the query is invalid, is not read-only, or exceeds its time or memory.
    pub async fn plan(&self, asked: QueryInput) -> Result<QueryHeader, Status> {
        let (head, reader) = self.begin(asked, false).await?;
        // The answer is read to its end, because the slot and the memory of the process are free only then.
        while let Some(piece) = reader.next().await {
            piece?;
        }
        Ok(head)
    }

    /// Columns of a query, and the stream of its rows.
    ///
    /// # Errors
    /// Returns the errors of [`QueryProcessPool::plan`].
    pub async fn answer(&self, asked: QueryInput) -> Result<(QueryHeader, SpoolReader), Status> {
        self.begin(asked, true).await
    }

    async fn begin(&self, asked: QueryInput, rows: bool) -> Result<(QueryHeader, SpoolReader), Status> {
        let deadline = Instant::now() + self.0.timeout;
        let permit = self.place(deadline).await?;
        let spool = SpoolWriter::default();
        let reader = spool.reader();
        let (head_sender, head) = oneshot::channel();
        let (this, number) = (self.clone(), self.0.next.fetch_add(1, Ordering::Relaxed));
        let (own, question) = (spool.clone(), self.question(asked, rows));
        self.0.runtime.spawn_blocking(move || {
            let end = this.computed(number, &question, &own, head_sender);
            // The slot is released now, so that other queries may run while a slow client reads.
            drop(permit);
            own.end(end);
        });
        self.0.runtime.spawn(self.clone().watch(number, spool, deadline));
        match head.await {
            Ok(head) => Ok((head, reader)),
            // The process ended early; its exit state gives the reason.
            Err(_) => match reader.next().await {
                Some(Err(why)) => Err(why),
                Some(Ok(_)) | None => Err(Status::internal("the query ended without a result")),
            },
        }
    }

    /// Takes a place among the simultaneous queries.
    async fn place(&self, deadline: Instant) -> Result<OwnedSemaphorePermit, Status> {
        let busy = || Status::resource_exhausted("too many queries are running; repeat the query later");
        let before = self.0.waiting.fetch_add(1, Ordering::Relaxed);
        let _turn = QueueGuard(&self.0.waiting);
        if before >= MOST_WAITING {
            return Err(busy());
        }
        let permit = timeout_at(deadline, self.0.at_once.clone().acquire_owned()).await.map_err(|_| busy())?;
        permit.map_err(|_| Status::unavailable("the server is shutting down"))
    }

    fn question(&self, asked: QueryInput, rows: bool) -> QueryRequest {
        let at_once = (self.running().len() + 1).min(self.0.at_most);
        let memory = self.0.memory / at_once;
        QueryRequest {
            store: self.0.store.clone(),
            spill: self.0.spill.clone(),
            memory,
            most: memory + UNCOUNTED_BYTES,
            query: asked.query,
            parameters: asked.parameters,
            pins: asked.pins,
            rows,
        }
    }

    /// Runs the process of a request to its end.
    fn computed(
        &self,
        number: u64,
        question: &QueryRequest,
        spool: &SpoolWriter,
        head_sender: oneshot::Sender<QueryHeader>,
    ) -> Result<(), Status> {
        let machine = |e: std::io::Error| Status::internal(format!("cannot start the process of a query: {e}"));
        let mut command = confine::command(&self.0.program);
        command.arg(COMMAND).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(machine)?;
        self.running().insert(number, QueryProcess { process: child.id(), bytes: 0, ended: None });
        let read = self.read(&mut child, question, spool, head_sender);
        // From here on, no other thread sends a signal to the process: after `wait`, its id may belong to another
        // process.
        let ended = self.running().remove(&number).and_then(|running| running.ended);
        let _ = child.kill();
        let status = child.wait();
        match (read, ended) {
            (Some(end), None) => end,
            (_, Some(why)) => Err(why),
            (None, None) if status.as_ref().is_ok_and(|s| confine::ran_out(*s)) => Err(self.too_much(question.memory)),
            (None, None) => Err(Status::internal("the query ended before its last row")),
        }
    }

    /// Reads the answer of a process; `None` if it stops before its end.
    fn read(
        &self,
        child: &mut Child,
        question: &QueryRequest,
        spool: &SpoolWriter,
        head_sender: oneshot::Sender<QueryHeader>,
    ) -> Option<Result<(), Status>> {
        let (mut to, from) = (child.stdin.take()?, child.stdout.take()?);
        to.write_all(&serde_json::to_vec(question).ok()?).ok()?;
        drop(to);
        let (mut from, mut head_sender) = (BufReader::new(from), Some(head_sender));
        loop {
            match QueryChunk::read(&mut from)? {
                QueryChunk::Head(head) => drop(head_sender.take().map(|head_sender| head_sender.send(head))),
                QueryChunk::Rows(rows) => match spool.put(rows, &self.0.spill) {
                    Ok(true) => {}
                    Ok(false) => return Some(Err(Status::cancelled("the client has disconnected"))),
                    Err(e) => return Some(Err(Status::internal(format!("cannot store a result: {e}")))),
                },
                QueryChunk::End => return Some(Ok(())),
                QueryChunk::Failed(QueryFailure { text, lasting: true }) => {
                    return Some(Err(Status::invalid_argument(text)));
                }
                QueryChunk::Failed(QueryFailure { text, lasting: false }) => return Some(Err(Status::internal(text))),
            }
        }
    }

    /// Ends a query that exceeds its time or memory, or whose client has disconnected. Ends the answer to a client that
    /// reads it too slowly.
    async fn watch(self, number: u64, spool: SpoolWriter, deadline: Instant) {
        let looked = async {
            let mut looks = interval(LOOKS_EVERY);
            loop {
                looks.tick().await;
                self.look(number);
            }
        };
        let why = tokio::select! {
            () = sleep_until(deadline) => self.late(),
            () = spool.left() => Status::cancelled("the client has disconnected"),
            () = looked => return,
        };
        self.end_one(number, why.clone());
        spool.cut(why);
    }

    fn look(&self, number: u64) {
        let mut running = self.running();
        let Some(one) = running.get_mut(&number) else { return };
        one.bytes = confine::used(one.process).unwrap_or(0);
        let own = one.bytes;
        let all: usize = running.values().map(|r| r.bytes).sum();
        let count = running.len();
        let most = self.0.memory + count * (UNCOUNTED_BYTES + OWN);
        let is_largest = running.values().all(|r| r.bytes <= own);
        drop(running);
        if own > self.0.memory + UNCOUNTED_BYTES + OWN || (all > most && is_largest) {
            self.end_one(number, self.too_much(self.0.memory));
        }
    }

    fn end_one(&self, number: u64, why: Status) {
        if let Some(running) = self.running().get_mut(&number) {
            running.ended.get_or_insert(why);
            stop(running.process);
        }
    }

    /// Ends all processes.
    pub fn end(&self) {
        self.0.at_once.close();
        for running in self.running().values_mut() {
            running.ended.get_or_insert(Status::unavailable("the server is shutting down"));
            stop(running.process);
        }
    }
}

fn stop(process: u32) {
    // A process that has ended needs no signal.
    let _ = i32::try_from(process).map(|process| kill(Pid::from_raw(process), Signal::SIGKILL));
}

/// Subcommand of this program that answers one query.
pub const COMMAND: &str = "answer-query";

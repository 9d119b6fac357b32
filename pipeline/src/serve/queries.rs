//! Queries under way: planned over one state of the store, limited in number, memory and time, answered piece by piece.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll},
    time::{Duration, SystemTime},
};

use arrow_array::RecordBatch;
use arrow_flight::error::FlightError;
use arrow_schema::{DataType, Schema, SchemaRef};
use datafusion::{error::DataFusionError, logical_expr::LogicalPlan};
use futures::{Stream, StreamExt};
use schemas::Fault;
use tokio::{
    runtime::Handle,
    sync::{Semaphore, mpsc},
    time::{Instant, timeout_at},
};
use tonic::Status;
use uuid::Uuid;

use super::{Settings, parameters};
use crate::{deep, store::pulled, views::sql::Session};

/// Plans that wait to be asked for, and prepared statements: more than these, and the oldest are forgotten.
const WAITING: u64 = 1024;
const PREPARED: u64 = 4096;
/// A plan that was not asked for is forgotten after this time.
const FORGOTTEN: Duration = Duration::from_secs(600);
/// Pieces of an answer that are ready before the client takes them.
const READY: usize = 2;

/// A query over one state of the store.
pub struct Planned {
    session: Arc<Session>,
    query: String,
    plan: LogicalPlan,
    /// Its columns.
    pub schema: SchemaRef,
}

impl Planned {
    /// Its open parameters in their order; the type `Null` stands for one that is not known.
    pub fn parameters(&self) -> Schema {
        parameters::open(&self.plan)
    }
}

/// A prepared statement.
#[derive(Clone)]
struct Prepared {
    query: String,
    parameters: Option<RecordBatch>,
}

/// A pipeline, the version that its link points at, and when and how long that version was written.
type Link = (String, PathBuf, Option<(SystemTime, u64)>);

/// The tables of a store at one moment, which later queries share while nothing is published.
struct Seen {
    links: Vec<Link>,
    session: Arc<Session>,
}

/// The tables of a store, now and later.
struct Tables {
    store: PathBuf,
    memory: usize,
    spill: PathBuf,
    seen: Mutex<Option<Seen>>,
}

impl Tables {
    /// The versions that the pipelines' links point at. A pipeline that was removed and run again begins with the same number.
    fn links(&self) -> Vec<Link> {
        let tables = self.store.join("tables");
        let entries = std::fs::read_dir(&tables).into_iter().flatten().flatten();
        let link = |e: std::fs::DirEntry| {
            let to = std::fs::read_link(e.path()).ok()?;
            let about = std::fs::metadata(tables.join(&to).join("../version.json")).ok();
            let about = about.and_then(|m| Some((m.modified().ok()?, m.len())));
            Some((e.file_name().into_string().ok()?, to, about))
        };
        let mut links: Vec<Link> = entries.filter_map(link).collect();
        links.sort();
        links
    }

    /// The tables as they are now.
    ///
    /// # Errors
    /// Fails when the store cannot be read.
    fn session(&self) -> Result<Arc<Session>, Fault> {
        pulled(&self.store)?;
        let links = self.links();
        // One query opens them; those that come meanwhile wait for it.
        let mut seen = locked(&self.seen);
        if let Some(seen) = seen.as_ref().filter(|seen| seen.links == links) {
            return Ok(seen.session.clone());
        }
        let session = Arc::new(Session::new(&self.store, self.memory, &self.spill)?);
        // Something may be published while it is opened: it is then opened again for the next query.
        *seen = Some(Seen { links, session: session.clone() });
        Ok(session)
    }
}

/// All queries.
pub struct Queries {
    tables: Arc<Tables>,
    timeout: Duration,
    at_once: Arc<Semaphore>,
    runtime: Handle,
    /// What this server's handles begin with: those of a server before it stand for nothing here.
    own: Uuid,
    next: AtomicU64,
    planned: Mutex<BTreeMap<u64, (Instant, Arc<Planned>)>>,
    prepared: Mutex<BTreeMap<u64, Prepared>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A fault as a client is told it.
pub fn told(fault: &Fault) -> Status {
    let text = fault.to_string();
    if fault.owner.is_lasting() { Status::invalid_argument(text) } else { Status::internal(text) }
}

fn gone(what: &str) -> Status {
    Status::not_found(format!("{what} is not known any more: ask again"))
}

impl Queries {
    /// None yet; they are computed on `runtime`.
    pub fn new(settings: &Settings, runtime: Handle) -> Queries {
        let tables = Tables {
            store: settings.store.clone(),
            memory: settings.memory,
            spill: settings.spill.clone(),
            seen: Mutex::default(),
        };
        Queries {
            tables: Arc::new(tables),
            timeout: settings.timeout,
            at_once: Arc::new(Semaphore::new(settings.queries.max(1))),
            runtime,
            own: Uuid::new_v4(),
            next: AtomicU64::new(1),
            planned: Mutex::default(),
            prepared: Mutex::default(),
        }
    }

    /// The tables as they are now.
    ///
    /// # Errors
    /// Fails when the store cannot be read.
    pub async fn session(&self) -> Result<Arc<Session>, Status> {
        let tables = self.tables.clone();
        self.deep(move |_| tables.session()).await?.map_err(|fault| told(&fault))
    }

    /// Runs `work`, which may recurse deep, beside the connections.
    async fn deep<T: Send + 'static>(&self, work: impl FnOnce(&Handle) -> T + Send + 'static) -> Result<T, Status> {
        let handle = self.runtime.clone();
        let done = self.runtime.spawn_blocking(move || deep::deep(|| work(&handle))).await;
        done.map_err(|_| Status::internal("the query ended with a panic"))?.map_err(|fault| told(&fault))
    }

    /// Plans `query` with its parameters, if it has any.
    ///
    /// # Errors
    /// Fails when the query is wrong, or does anything but ask.
    pub async fn plan(&self, query: String, parameters: Option<RecordBatch>) -> Result<Arc<Planned>, Status> {
        let tables = self.tables.clone();
        let planned = self.deep(move |handle| -> Result<Planned, Fault> {
            deep::over(&query, || ())?;
            let session = tables.session()?;
            let mut plan = handle.block_on(session.plan(&query))?;
            if let Some(values) = parameters {
                let values = parameters::values(&plan, &values)?;
                plan = plan.with_param_values(values).map_err(|e| session.fault(&e, &query))?;
            }
            let open = !parameters::open(&plan).fields().is_empty();
            let columns = if open { Ok(plan.schema().as_arrow().clone()) } else { session.columns(&plan) };
            let schema = columns.map(|s| Arc::new(plain(&s))).map_err(|e| session.fault(&e, &query))?;
            Ok(Planned { session, query, plan, schema })
        });
        planned.await?.map(Arc::new).map_err(|fault| told(&fault))
    }

    fn spelt(&self, number: u64) -> Vec<u8> {
        [self.own.as_bytes().as_slice(), &number.to_be_bytes()].concat()
    }

    fn read(&self, handle: &[u8]) -> Option<u64> {
        handle.strip_prefix(self.own.as_bytes().as_slice())?.try_into().ok().map(u64::from_be_bytes)
    }

    fn number(&self) -> u64 {
        self.next.fetch_add(1, Ordering::Relaxed)
    }

    /// Keeps a plan until it is asked for; returns its handle.
    pub fn keep(&self, plan: Arc<Planned>) -> Vec<u8> {
        let (number, now) = (self.number(), Instant::now());
        let mut planned = locked(&self.planned);
        planned.retain(|n, (since, _)| now - *since < FORGOTTEN && n + WAITING > number);
        planned.insert(number, (now, plan));
        self.spelt(number)
    }

    /// The plan of a handle. It may be asked for more than once, and gives the same rows.
    ///
    /// # Errors
    /// Fails when it was forgotten.
    pub fn planned(&self, handle: &[u8]) -> Result<Arc<Planned>, Status> {
        let found = self.read(handle).and_then(|number| locked(&self.planned).get(&number).map(|(_, p)| p.clone()));
        found.ok_or_else(|| gone("the result"))
    }

    /// Keeps a statement; returns its handle.
    pub fn prepare(&self, query: String) -> Vec<u8> {
        let number = self.number();
        let mut prepared = locked(&self.prepared);
        prepared.retain(|n, _| n + PREPARED > number);
        prepared.insert(number, Prepared { query, parameters: None });
        self.spelt(number)
    }

    /// The statement of a handle, and its parameters.
    ///
    /// # Errors
    /// Fails when it was closed or forgotten.
    pub fn prepared(&self, handle: &[u8]) -> Result<(String, Option<RecordBatch>), Status> {
        let found = self.read(handle).and_then(|number| locked(&self.prepared).get(&number).cloned());
        found.map(|p| (p.query, p.parameters)).ok_or_else(|| gone("the prepared statement"))
    }

    /// Gives a prepared statement its parameters.
    ///
    /// # Errors
    /// Fails when it was closed or forgotten.
    pub fn bind(&self, handle: &[u8], parameters: RecordBatch) -> Result<(), Status> {
        let mut prepared = locked(&self.prepared);
        let found = self.read(handle).and_then(|number| prepared.get_mut(&number));
        found.ok_or_else(|| gone("the prepared statement"))?.parameters = Some(parameters);
        Ok(())
    }

    /// Forgets a prepared statement.
    pub fn close(&self, handle: &[u8]) {
        if let Some(number) = self.read(handle) {
            locked(&self.prepared).remove(&number);
        }
    }

    /// Fails for a plan of which parameters have no value.
    ///
    /// # Errors
    /// Names the parameters.
    pub fn bound(&self, planned: &Planned) -> Result<(), Status> {
        parameters::bound(&planned.plan).map_err(|fault| told(&fault))
    }

    /// Answers a plan: the pieces as they are computed, then their end; an answer that stops before that is an error.
    ///
    /// # Errors
    /// Fails when too many queries are under way for too long, or the query cannot be begun.
    pub async fn answer(&self, planned: Arc<Planned>) -> Result<Pieces, Status> {
        self.bound(&planned)?;
        let (deadline, timeout) = (Instant::now() + self.timeout, self.timeout);
        let late = move || Status::deadline_exceeded(format!("the query took longer than {} s", timeout.as_secs()));
        let busy = |_| Status::resource_exhausted("too many queries are under way: ask again later");
        let permit = timeout_at(deadline, self.at_once.clone().acquire_owned()).await.map_err(busy)?;
        let permit = permit.map_err(|_| Status::unavailable("the server ends"))?;
        let asked = planned.clone();
        let begun = self.deep(move |handle| handle.block_on(asked.session.run(asked.plan.clone())));
        let wrong = move |e: &DataFusionError| told(&planned.session.fault(e, &planned.query));
        let stream = timeout_at(deadline, begun).await.map_err(|_| late())??;
        let mut stream = stream.map_err(|e| wrong(&e))?;
        let (send, pieces) = mpsc::channel(READY);
        self.runtime.spawn(async move {
            let all = async {
                while let Some(piece) = stream.next().await {
                    let failed = piece.is_err();
                    let piece = piece.map(Piece::Rows).map_err(|e| wrong(&e));
                    if send.send(piece).await.is_err() || failed {
                        return;
                    }
                }
                let _ = send.send(Ok(Piece::End)).await;
            };
            let in_time = tokio::select! {
                // The client has gone away.
                () = send.closed() => return,
                done = timeout_at(deadline, all) => done.is_ok(),
            };
            // Others may compute while a slow client is told.
            drop((stream, permit));
            if !in_time {
                let _ = send.send(Err(late())).await;
            }
        });
        Ok(Pieces { pieces, ended: false })
    }
}

/// The columns as they are sent: no dictionaries.
fn plain(schema: &Schema) -> Schema {
    let one = |field: &arrow_schema::FieldRef| match field.data_type() {
        DataType::Dictionary(_, values) => Arc::new(field.as_ref().clone().with_data_type(values.as_ref().clone())),
        _ => field.clone(),
    };
    Schema::new_with_metadata(schema.fields().iter().map(one).collect::<Vec<_>>(), schema.metadata().clone())
}

enum Piece {
    Rows(RecordBatch),
    End,
}

/// An answer on its way.
pub struct Pieces {
    pieces: mpsc::Receiver<Result<Piece, Status>>,
    ended: bool,
}

impl Stream for Pieces {
    type Item = Result<RecordBatch, FlightError>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<Option<Self::Item>> {
        if self.ended {
            return Poll::Ready(None);
        }
        let piece = match self.pieces.poll_recv(context) {
            Poll::Pending => return Poll::Pending,
            Poll::Ready(piece) => piece,
        };
        let (item, ended) = match piece {
            Some(Ok(Piece::Rows(rows))) => (Some(Ok(rows)), false),
            Some(Ok(Piece::End)) => (None, true),
            Some(Err(status)) => (Some(Err(status.into())), true),
            None => (Some(Err(Status::internal("the query ended before its last row").into())), true),
        };
        self.ended = ended;
        Poll::Ready(item)
    }
}

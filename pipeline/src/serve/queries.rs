//! Queries in progress: planned over one state of the store, limited in number, memory and time, and answered in
//! chunks.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, SystemTime},
};

use arrow_array::RecordBatch;
use arrow_flight::error::FlightError;
use arrow_schema::SchemaRef;
use futures::{Stream, StreamExt, stream};
use report::sql::SqlSession;
use schemas::Fault;
use store::pulled;
use tokio::{runtime::Handle, time::Instant};
use tonic::Status;
use uuid::Uuid;

use super::{
    ServerSettings, child, parameters,
    process::{QueryInput, QueryProcessPool},
};

/// Maximum number of unused plans, and of prepared statements. Beyond this number, the oldest are dropped.
const WAITING: u64 = 1024;
const PREPARED: u64 = 4096;
/// An unused plan is dropped after this time.
const FORGOTTEN: Duration = Duration::from_secs(600);

/// Query over one state of the store.
pub struct PlannedQuery {
    asked: QueryInput,
    /// Columns.
    pub schema: SchemaRef,
    /// Parameters that have no value yet, in order of position. A parameter of unknown type has the type `Null`.
    pub parameters: SchemaRef,
}

/// Prepared statement.
#[derive(Clone)]
struct PreparedStatement {
    query: String,
    parameters: Option<RecordBatch>,
}

/// Pipeline, target of its link (a version), and time and size of that version.
type PipelineLink = (String, PathBuf, Option<(SystemTime, u64)>);

/// Tables of a store at one time, shared by queries until the next publication.
struct StoreTablesSnapshot {
    links: Vec<PipelineLink>,
    session: Arc<SqlSession>,
}

/// Tables of a store, reopened after each publication.
struct ServedTables {
    store: PathBuf,
    memory: usize,
    spill: PathBuf,
    seen: Mutex<Option<StoreTablesSnapshot>>,
}

impl ServedTables {
    /// Versions to which the links of the pipelines point. If a pipeline is removed and run again, its versions are
    /// numbered from 1 again, so a number alone does not identify a version.
    fn links(&self) -> Vec<PipelineLink> {
        let tables = self.store.join("tables");
        let entries = std::fs::read_dir(&tables).into_iter().flatten().flatten();
        let link = |e: std::fs::DirEntry| {
            let to = std::fs::read_link(e.path()).ok()?;
            let about = std::fs::metadata(tables.join(&to).join("../version.json")).ok();
            let about = about.and_then(|m| Some((m.modified().ok()?, m.len())));
            Some((e.file_name().into_string().ok()?, to, about))
        };
        let mut links: Vec<PipelineLink> = entries.filter_map(link).collect();
        links.sort();
        links
    }

    /// Current tables.
    ///
    /// # Errors
    /// Fails if the store cannot be read.
    fn session(&self) -> Result<Arc<SqlSession>, Fault> {
        pulled(&self.store)?;
        let links = self.links();
        // The first query opens the tables; concurrent queries wait for it.
        let mut seen = locked(&self.seen);
        if let Some(seen) = seen.as_ref().filter(|seen| seen.links == links) {
            return Ok(seen.session.clone());
        }
        let session = Arc::new(SqlSession::new(&self.store, self.memory, &self.spill)?);
        // If a run publishes while the tables are opened, the next query opens them again.
        *seen = Some(StoreTablesSnapshot { links, session: session.clone() });
        Ok(session)
    }
}

/// Planned queries and prepared statements of a server.
pub struct QueryRegistry {
    tables: Arc<ServedTables>,
    processes: QueryProcessPool,
    runtime: Handle,
    /// Prefix of this server's handles. The handles of an earlier server are invalid here.
    own: Uuid,
    next: AtomicU64,
    planned: Mutex<BTreeMap<u64, (Instant, Arc<PlannedQuery>)>>,
    prepared: Mutex<BTreeMap<u64, PreparedStatement>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Status that reports a fault to a client.
pub fn fault_status(fault: &Fault) -> Status {
    let text = fault.to_string();
    if fault.owner.is_lasting() { Status::invalid_argument(text) } else { Status::internal(text) }
}

fn gone(what: &str) -> Status {
    Status::not_found(format!("{what} has expired; repeat the request"))
}

impl QueryRegistry {
    /// Empty registry of queries. Later queries are computed on `runtime`.
    pub fn new(settings: &ServerSettings, runtime: Handle) -> QueryRegistry {
        let tables = ServedTables {
            store: settings.store.clone(),
            memory: settings.memory,
            spill: settings.spill.clone(),
            seen: Mutex::default(),
        };
        QueryRegistry {
            tables: Arc::new(tables),
            processes: QueryProcessPool::new(settings, runtime.clone()),
            runtime,
            own: Uuid::new_v4(),
            next: AtomicU64::new(1),
            planned: Mutex::default(),
            prepared: Mutex::default(),
        }
    }

    /// Processes of the queries.
    pub fn processes(&self) -> QueryProcessPool {
        self.processes.clone()
    }

    /// Current tables.
    ///
    /// # Errors
    /// Fails if the store cannot be read.
    pub async fn session(&self) -> Result<Arc<SqlSession>, Status> {
        let tables = self.tables.clone();
        let done = self.runtime.spawn_blocking(move || tables.session()).await;
        done.map_err(|_| Status::internal("the store is unreadable"))?.map_err(|fault| fault_status(&fault))
    }

    /// Plans `query` with its parameters, if it has any.
    ///
    /// # Errors
    /// Fails if the query is invalid, is not read-only, or its planning exceeds the time or memory.
    pub async fn plan(&self, query: String, parameters: Option<RecordBatch>) -> Result<Arc<PlannedQuery>, Status> {
        let parameters = parameters.map(|row| child::spelt(&row.schema(), Some(&row))).transpose();
        let parameters = parameters.map_err(|e| broken(&e))?;
        let asked = QueryInput { query, parameters, pins: None };
        let head = self.processes.plan(asked.clone()).await?;
        let schema = |text: &str| child::read(text).map(|(schema, _)| schema).map_err(|e| broken(&e));
        Ok(Arc::new(PlannedQuery {
            schema: schema(&head.columns)?,
            parameters: schema(&head.parameters)?,
            asked: QueryInput { pins: Some(head.pins), ..asked },
        }))
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

    /// Stores a plan until it is used; returns its handle.
    pub fn keep(&self, plan: Arc<PlannedQuery>) -> Vec<u8> {
        let (number, now) = (self.number(), Instant::now());
        let mut planned = locked(&self.planned);
        planned.retain(|n, (since, _)| now - *since < FORGOTTEN && n + WAITING > number);
        planned.insert(number, (now, plan));
        self.spelt(number)
    }

    /// Plan of a handle. A plan may be requested repeatedly and gives the same rows each time.
    ///
    /// # Errors
    /// Fails if the plan was dropped.
    pub fn planned(&self, handle: &[u8]) -> Result<Arc<PlannedQuery>, Status> {
        let found = self.read(handle).and_then(|number| locked(&self.planned).get(&number).map(|(_, p)| p.clone()));
        found.ok_or_else(|| gone("the result"))
    }

    /// Stores a statement; returns its handle.
    pub fn prepare(&self, query: String) -> Vec<u8> {
        let number = self.number();
        let mut prepared = locked(&self.prepared);
        prepared.retain(|n, _| n + PREPARED > number);
        prepared.insert(number, PreparedStatement { query, parameters: None });
        self.spelt(number)
    }

    /// Statement of a handle, and its parameters.
    ///
    /// # Errors
    /// Fails if it was closed or dropped.
    pub fn prepared(&self, handle: &[u8]) -> Result<(String, Option<RecordBatch>), Status> {
        let found = self.read(handle).and_then(|number| locked(&self.prepared).get(&number).cloned());
        found.map(|p| (p.query, p.parameters)).ok_or_else(|| gone("the prepared statement"))
    }

    /// Sets the parameters of a prepared statement.
    ///
    /// # Errors
    /// Fails if it was closed or dropped.
    pub fn bind(&self, handle: &[u8], parameters: RecordBatch) -> Result<(), Status> {
        let mut prepared = locked(&self.prepared);
        let found = self.read(handle).and_then(|number| prepared.get_mut(&number));
        found.ok_or_else(|| gone("the prepared statement"))?.parameters = Some(parameters);
        Ok(())
    }

    /// Drops a prepared statement.
    pub fn close(&self, handle: &[u8]) {
        if let Some(number) = self.read(handle) {
            locked(&self.prepared).remove(&number);
        }
    }

    /// Checks that all parameters of a plan have values.
    ///
    /// # Errors
    /// Fails with the names of the parameters.
    pub fn bound(&self, planned: &PlannedQuery) -> Result<(), Status> {
        parameters::valued(&planned.parameters).map_err(|fault| fault_status(&fault))
    }

    /// Answers a plan: the chunks as they are computed, then their end. An answer that stops without this end is an
    /// error.
    ///
    /// # Errors
    /// Fails if too many queries are in progress for too long, or the query cannot be started.
    pub async fn answer(&self, planned: Arc<PlannedQuery>) -> Result<QueryBatchStream, Status> {
        self.bound(&planned)?;
        let (_, reader) = self.processes.answer(planned.asked.clone()).await?;
        let pieces = stream::unfold(reader, |reader| async move { Some((reader.next().await?, reader)) });
        Ok(Box::pin(pieces.flat_map(|piece| stream::iter(rows(piece)))))
    }
}

/// Rows of a chunk.
fn rows(piece: Result<Vec<u8>, Status>) -> Vec<Result<RecordBatch, FlightError>> {
    match piece.map(|bytes| child::unpacked(&bytes)) {
        Ok(Ok((_, batches))) => batches.into_iter().map(Ok).collect(),
        Ok(Err(e)) => vec![Err(broken(&e).into())],
        Err(status) => vec![Err(status.into())],
    }
}

fn broken(e: &dyn std::fmt::Display) -> Status {
    Status::internal(e.to_string())
}

/// Stream of the record batches of an answer.
pub type QueryBatchStream = Pin<Box<dyn Stream<Item = Result<RecordBatch, FlightError>> + Send>>;

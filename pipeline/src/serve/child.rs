//! Process of one query: plans and computes it, and is ended when it exceeds its time or memory. It reads the request
//! from standard input and writes the answer in chunks to standard output.

use std::{
    fs::File,
    io::{Read, Write, stdin, stdout},
    os::fd::AsFd,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    thread::available_parallelism,
};

use arrow_array::RecordBatch;
use arrow_ipc::{
    reader::StreamReader,
    writer::{IpcWriteOptions, StreamWriter},
};
use arrow_schema::{ArrowError, DataType, Schema, SchemaRef};
use base64::{Engine, prelude::BASE64_STANDARD};
use futures::StreamExt;
use report::sql::{SqlSession, VersionPins, WORKER_STACK, memory};
use run::confine;
use schemas::Fault;
use serde::{Deserialize, Serialize};
use store::pulled;

use super::parameters;
use crate::deep;

/// Maximum number of threads that compute a query, and number of threads that wait for its files.
const MOST_THREADS: usize = 8;
const FILE_THREADS: usize = 4;
/// Memory of a query that its operators do not count, such as batches in transit, in bytes.
pub const UNCOUNTED_BYTES: usize = 96 << 20;

/// Request to a process.
#[derive(Serialize, Deserialize)]
pub struct QueryRequest {
    /// Folder of the store.
    pub store: PathBuf,
    /// Folder for spilled data.
    pub spill: PathBuf,
    /// Memory for the operators of the query, in bytes.
    pub memory: usize,
    /// Memory limit that the kernel enforces, in bytes.
    pub most: usize,
    /// Text of the query.
    pub query: String,
    /// Values of the query's parameters: one batch, as an IPC stream in base64.
    pub parameters: Option<String>,
    /// Versions of the tables; `None` for the current ones.
    pub pins: Option<VersionPins>,
    /// Whether the rows are requested in addition to the columns.
    pub rows: bool,
}

/// Schema and notes of a query, before its rows.
#[derive(Serialize, Deserialize)]
pub struct QueryHeader {
    /// Columns: an IPC stream in base64.
    pub columns: String,
    /// Parameters without a value, also as an IPC stream in base64.
    pub parameters: String,
    /// Versions of the tables.
    pub pins: VersionPins,
}

/// Error of a query.
#[derive(Serialize, Deserialize)]
pub struct QueryFailure {
    /// The message.
    pub text: String,
    /// Whether the query itself is invalid; otherwise the machine failed.
    pub lasting: bool,
}

/// Message of a query process: header, rows, end or failure.
pub enum QueryChunk {
    /// Schema and notes, before the rows.
    Head(QueryHeader),
    /// Rows, as an IPC stream.
    Rows(Vec<u8>),
    /// End after all rows.
    End,
    /// Failure.
    Failed(QueryFailure),
}

const HEAD: u8 = b'h';
const ROWS: u8 = b'r';
const END: u8 = b'e';
const FAILED: u8 = b'f';

/// Maximum size of a message, in bytes.
const LONGEST: usize = 1 << 31;

impl QueryChunk {
    /// Writes the message.
    fn write(&self, to: &mut impl Write) -> std::io::Result<()> {
        let (kind, bytes) = match self {
            QueryChunk::Head(head) => (HEAD, serde_json::to_vec(head)?.into()),
            QueryChunk::Rows(rows) => (ROWS, std::borrow::Cow::Borrowed(rows.as_slice())),
            QueryChunk::End => (END, vec![].into()),
            QueryChunk::Failed(refusal) => (FAILED, serde_json::to_vec(refusal)?.into()),
        };
        to.write_all(&[kind])?;
        to.write_all(&(bytes.len() as u64).to_be_bytes())?;
        to.write_all(&bytes)?;
        to.flush()
    }

    /// Reads the next message; `None` after the process has ended.
    pub fn read(from: &mut impl Read) -> Option<QueryChunk> {
        let (mut kind, mut length) = ([0], [0; 8]);
        from.read_exact(&mut kind).ok()?;
        from.read_exact(&mut length).ok()?;
        let length = usize::try_from(u64::from_be_bytes(length)).ok().filter(|n| *n <= LONGEST)?;
        let mut bytes = vec![0; length];
        from.read_exact(&mut bytes).ok()?;
        match kind[0] {
            HEAD => serde_json::from_slice(&bytes).ok().map(QueryChunk::Head),
            ROWS => Some(QueryChunk::Rows(bytes)),
            END => Some(QueryChunk::End),
            FAILED => serde_json::from_slice(&bytes).ok().map(QueryChunk::Failed),
            _ => None,
        }
    }
}

/// Schema, or a batch with its schema, as an IPC stream.
///
/// # Errors
/// Fails if Arrow cannot write it.
pub fn packed(schema: &Schema, batch: Option<&RecordBatch>) -> Result<Vec<u8>, ArrowError> {
    let mut bytes = vec![];
    let mut writer = StreamWriter::try_new_with_options(&mut bytes, schema, IpcWriteOptions::default())?;
    batch.map_or(Ok(()), |batch| writer.write(batch))?;
    writer.finish()?;
    drop(writer);
    Ok(bytes)
}

/// Schema and batches of an IPC stream.
///
/// # Errors
/// Fails if it is not an IPC stream.
pub fn unpacked(bytes: &[u8]) -> Result<(SchemaRef, Vec<RecordBatch>), ArrowError> {
    let reader = StreamReader::try_new(bytes, None)?;
    Ok((reader.schema(), reader.collect::<Result<_, _>>()?))
}

/// Same as [`packed`], as text.
///
/// # Errors
/// Returns the errors of [`packed`].
pub fn spelt(schema: &Schema, batch: Option<&RecordBatch>) -> Result<String, ArrowError> {
    Ok(BASE64_STANDARD.encode(packed(schema, batch)?))
}

/// Reads the text of [`spelt`].
///
/// # Errors
/// Fails for any other text.
pub fn read(text: &str) -> Result<(SchemaRef, Vec<RecordBatch>), ArrowError> {
    let bytes = BASE64_STANDARD.decode(text).map_err(|e| ArrowError::ParseError(e.to_string()))?;
    unpacked(&bytes)
}

/// Columns in the form in which they are sent, without dictionaries.
fn plain(schema: &Schema) -> Schema {
    let one = |field: &arrow_schema::FieldRef| match field.data_type() {
        DataType::Dictionary(_, values) => {
            std::sync::Arc::new(field.as_ref().clone().with_data_type(values.as_ref().clone()))
        }
        _ => field.clone(),
    };
    Schema::new_with_metadata(schema.fields().iter().map(one).collect::<Vec<_>>(), schema.metadata().clone())
}

/// Answers the request on standard input; an invalid request is reported in the answer.
///
/// # Errors
/// Fails if nobody reads the answer.
pub fn answer() -> Result<(), Fault> {
    let lost = |e: std::io::Error| Fault::machine(format!("the server has ended: {e}"));
    confine::end_with_parent();
    let mut text = String::new();
    stdin().read_to_string(&mut text).map_err(lost)?;
    let question: QueryRequest = serde_json::from_str(&text).map_err(|e| Fault::bug(format!("no question: {e}")))?;
    // The file bypasses the line buffer of standard output.
    let mut out = File::from(stdout().as_fd().try_clone_to_owned().map_err(lost)?);
    let mut send = |piece: QueryChunk| piece.write(&mut out).map_err(lost);
    // A string that is too long for DataFusion's offsets causes a panic of DataFusion.
    let too_long = |_| {
        let what = format!("{}, or its text exceeds 2 GiB", memory::exceeded(question.memory));
        Err(Fault::new(what).help("select fewer rows or shorter texts"))
    };
    let end = match catch_unwind(AssertUnwindSafe(|| answered(&question, &mut send))).unwrap_or_else(too_long) {
        Ok(()) => QueryChunk::End,
        Err(fault) => QueryChunk::Failed(QueryFailure { text: fault.to_string(), lasting: fault.owner.is_lasting() }),
    };
    send(end)
}

type QueryChunkSink<'a> = dyn FnMut(QueryChunk) -> Result<(), Fault> + std::marker::Send + 'a;

fn answered(question: &QueryRequest, send: &mut QueryChunkSink) -> Result<(), Fault> {
    deep::over(&question.query, || ())?;
    let threads = available_parallelism().map_or(1, |n| n.get().min(MOST_THREADS));
    let mut runtime = tokio::runtime::Builder::new_multi_thread();
    runtime.worker_threads(threads).max_blocking_threads(FILE_THREADS).thread_stack_size(WORKER_STACK).enable_all();
    let runtime = runtime.build().map_err(|e| Fault::machine(format!("cannot start threads: {e}")))?;
    deep::deep(|| {
        // The limit includes the stacks of the threads that are started later.
        confine::limit_memory(question.most + FILE_THREADS * WORKER_STACK)?;
        runtime.block_on(rows(question, send))
    })?
}

async fn rows(question: &QueryRequest, send: &mut QueryChunkSink<'_>) -> Result<(), Fault> {
    let QueryRequest { store, spill, query, .. } = question;
    pulled(store)?;
    let session = SqlSession::at(store, question.memory, spill, question.pins.as_ref())?;
    let wrong = |e| session.fault(&e, query);
    let bug = |e: ArrowError| Fault::bug(format!("cannot send the result: {e}"));
    let mut plan = session.plan(query).await?;
    if let Some(text) = &question.parameters {
        let (schema, batches) = read(text).map_err(bug)?;
        let row = arrow_select::concat::concat_batches(&schema, &batches).map_err(bug)?;
        let values = parameters::values(&plan, &row)?;
        plan = plan.with_param_values(values).map_err(wrong)?;
    }
    let open = parameters::open(&plan);
    let columns = if open.fields().is_empty() {
        session.columns(&plan).map_err(wrong)?
    } else {
        plan.schema().as_arrow().clone()
    };
    let columns = spelt(&plain(&columns), None).map_err(bug)?;
    let head = QueryHeader { columns, parameters: spelt(&open, None).map_err(bug)?, pins: session.pins().clone() };
    send(QueryChunk::Head(head))?;
    if !question.rows {
        return Ok(());
    }
    parameters::bound(&plan)?;
    let mut stream = session.run(plan).await.map_err(wrong)?;
    while let Some(batch) = stream.next().await {
        let batch = batch.map_err(wrong)?;
        send(QueryChunk::Rows(packed(&batch.schema(), Some(&batch)).map_err(bug)?))?;
    }
    Ok(())
}

//! The process of one query: it plans and computes, and is ended when it takes too long or too much memory. The
//! question comes by standard input, the answer goes by standard output, in pieces.

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
use schemas::Fault;
use serde::{Deserialize, Serialize};

use super::parameters;
use crate::{
    confine, deep,
    store::pulled,
    views::sql::{SqlSession, VersionPins, WORKER_STACK, memory},
};

/// The most threads that compute a query, and that wait for its files.
const MOST_THREADS: usize = 8;
const FILE_THREADS: usize = 4;
/// Memory of a query that its operators do not count, such as batches in transit.
pub const BESIDE: usize = 96 << 20;

/// A request to a process.
#[derive(Serialize, Deserialize)]
pub struct QueryRequest {
    /// The store's folder.
    pub store: PathBuf,
    /// The folder to spill to.
    pub spill: PathBuf,
    /// The memory for its operators.
    pub memory: usize,
    /// The memory that the kernel allows it.
    pub most: usize,
    /// The query.
    pub query: String,
    /// The values of its parameters: one batch, as an IPC stream in base64.
    pub parameters: Option<String>,
    /// The versions of the tables; those of now where there are none.
    pub pins: Option<VersionPins>,
    /// Whether rows are wanted, and not only columns.
    pub rows: bool,
}

/// The schema and notes of a query, before its rows.
#[derive(Serialize, Deserialize)]
pub struct QueryHeader {
    /// Its columns: an IPC stream in base64.
    pub columns: String,
    /// Its open parameters: the same.
    pub parameters: String,
    /// The versions of the tables.
    pub pins: VersionPins,
}

/// The error of a query.
#[derive(Serialize, Deserialize)]
pub struct QueryFailure {
    /// The message.
    pub text: String,
    /// Whether the query is wrong, and not the machine.
    pub lasting: bool,
}

/// A message of a query process: header, rows, end or failure.
pub enum QueryChunk {
    /// The schema and notes, before the rows.
    Head(QueryHeader),
    /// Rows, as an IPC stream.
    Rows(Vec<u8>),
    /// All rows were sent.
    End,
    /// It failed.
    Failed(QueryFailure),
}

const HEAD: u8 = b'h';
const ROWS: u8 = b'r';
const END: u8 = b'e';
const FAILED: u8 = b'f';

/// The longest piece.
const LONGEST: usize = 1 << 31;

impl QueryChunk {
    /// Writes it.
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

    /// Reads the next one; none where the process has ended.
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

/// A schema, or a batch with its schema, as an IPC stream.
///
/// # Errors
/// Fails when Arrow cannot write it.
pub fn packed(schema: &Schema, batch: Option<&RecordBatch>) -> Result<Vec<u8>, ArrowError> {
    let mut bytes = vec![];
    let mut writer = StreamWriter::try_new_with_options(&mut bytes, schema, IpcWriteOptions::default())?;
    batch.map_or(Ok(()), |batch| writer.write(batch))?;
    writer.finish()?;
    drop(writer);
    Ok(bytes)
}

/// The schema and the batches of an IPC stream.
///
/// # Errors
/// Fails when it is none.
pub fn unpacked(bytes: &[u8]) -> Result<(SchemaRef, Vec<RecordBatch>), ArrowError> {
    let reader = StreamReader::try_new(bytes, None)?;
    Ok((reader.schema(), reader.collect::<Result<_, _>>()?))
}

/// The same in text.
///
/// # Errors
/// The same as [`packed`].
pub fn spelt(schema: &Schema, batch: Option<&RecordBatch>) -> Result<String, ArrowError> {
    Ok(BASE64_STANDARD.encode(packed(schema, batch)?))
}

/// Reads the text of [`spelt`].
///
/// # Errors
/// Fails when it is none.
pub fn read(text: &str) -> Result<(SchemaRef, Vec<RecordBatch>), ArrowError> {
    let bytes = BASE64_STANDARD.decode(text).map_err(|e| ArrowError::ParseError(e.to_string()))?;
    unpacked(&bytes)
}

/// The columns as they are sent: no dictionaries.
fn plain(schema: &Schema) -> Schema {
    let one = |field: &arrow_schema::FieldRef| match field.data_type() {
        DataType::Dictionary(_, values) => {
            std::sync::Arc::new(field.as_ref().clone().with_data_type(values.as_ref().clone()))
        }
        _ => field.clone(),
    };
    Schema::new_with_metadata(schema.fields().iter().map(one).collect::<Vec<_>>(), schema.metadata().clone())
}

/// Answers the question of standard input; what is wrong with it is a piece of the answer.
///
/// # Errors
/// Fails when nobody listens.
pub fn answer() -> Result<(), Fault> {
    let lost = |e: std::io::Error| Fault::machine(format!("the server has ended: {e}"));
    confine::end_with_parent();
    let mut text = String::new();
    stdin().read_to_string(&mut text).map_err(lost)?;
    let question: QueryRequest = serde_json::from_str(&text).map_err(|e| Fault::bug(format!("no question: {e}")))?;
    // Not line by line.
    let mut out = File::from(stdout().as_fd().try_clone_to_owned().map_err(lost)?);
    let mut send = |piece: QueryChunk| piece.write(&mut out).map_err(lost);
    // A text that is longer than its offsets can count ends DataFusion with a panic.
    let too_long = |_| {
        let what = format!("{}, or its texts exceed 2 GiB", memory::exceeded(question.memory));
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
        // The stacks of later threads are added to this limit.
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

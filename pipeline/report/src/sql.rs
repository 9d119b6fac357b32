//! `magline sql`: DataFusion over every table of a store, as `<pipeline>.<table>`.
//!
//! A query reads only the published tables of one store, and writes nothing. Statements that change anything are
//! rejected by their kind, by their plan, and by read-only tables. The memory of a query is limited; a query that needs
//! more spills data to a temporary folder.

mod explain;
mod functions;
pub mod memory;
mod refuse;
mod scan;
mod session;
mod tables;

use std::{
    future::poll_fn,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use datafusion::error::DataFusionError;
use expressions::deep;
use schemas::Fault;

pub(crate) use scan::PublishedTableProvider;
pub use session::SqlSession;
pub use tables::{VersionPins, parts};
pub(crate) use tables::{leads_out, names as pipeline_names};

/// Stack size of the worker threads, in bytes. These threads evaluate deeply nested expressions recursively.
pub const WORKER_STACK: usize = 64 << 20;

/// Query of a store, with its memory limit.
pub struct StoreQuery<'a> {
    /// The store's folder.
    pub store: &'a Path,
    /// The query.
    pub query: &'a str,
    /// Memory limit, in bytes.
    pub memory: usize,
    /// Private folder for spilled data.
    pub spill: PathBuf,
}

/// Receiver of a query result, batch by batch.
pub trait BatchSink: Send {
    /// Receives the next batch and returns whether to continue. All batches have the same schema.
    ///
    /// # Errors
    /// Fails if the batch cannot be written.
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault>;

    /// Number of bytes of this batch that the receiver will keep.
    fn keeps(&self, batch: &RecordBatch) -> usize;

    /// Ends the result, even if there were no batches.
    ///
    /// # Errors
    /// Fails if it cannot be written.
    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault>;
}

/// Runs a query.
///
/// # Errors
/// Fails if the query is wrong, refers to an unknown table, is not read-only, or exceeds its memory limit.
pub fn sql(question: &StoreQuery, sink: &mut dyn BatchSink) -> Result<(), Fault> {
    query(question, sink, false)
}

/// Runs a query in one partition, so that the rows of a table keep their order.
///
/// # Errors
/// Returns the errors of [`sql`].
pub fn sql_in_order(question: &StoreQuery, sink: &mut dyn BatchSink) -> Result<(), Fault> {
    query(question, sink, true)
}

fn query(question: &StoreQuery, sink: &mut dyn BatchSink, in_order: bool) -> Result<(), Fault> {
    deep::over(question.query, || ())?;
    deep::deep(|| {
        let runtime = tokio::runtime::Builder::new_multi_thread().thread_stack_size(WORKER_STACK).enable_all().build();
        let runtime = runtime.map_err(|e| Fault::machine(e.to_string()))?;
        runtime.block_on(ask(question, sink, in_order))
    })?
}

async fn ask(question: &StoreQuery<'_>, sink: &mut dyn BatchSink, in_order: bool) -> Result<(), Fault> {
    let session = SqlSession::new(question.store, question.memory, &question.spill)?;
    if in_order {
        session.use_one_partition();
    }
    let plan = session.plan(question.query).await?;
    let wrong = |e: DataFusionError| session.fault(&e, question.query);
    let schema: SchemaRef = Arc::new(plan.schema().as_arrow().clone());
    let mut stream = session.run(plan).await.map_err(wrong)?;
    let kept = session.reserve("answer");
    let mut last = None;
    while let Some(batch) = poll_fn(|cx| stream.as_mut().poll_next(cx)).await {
        let batch = batch.map_err(wrong)?;
        kept.try_grow(sink.keeps(&batch)).map_err(wrong)?;
        last = Some(batch.schema());
        if !sink.take(batch)? {
            return Ok(());
        }
    }
    sink.finish(&last.unwrap_or(schema))
}

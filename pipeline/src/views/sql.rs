//! `magline sql`: DataFusion over every table of a store, as `<pipeline>.<table>`.
//!
//! A question reads the published tables of one store and nothing else, and writes nothing: statements that do anything
//! but ask are refused by their kind, by their plan, and by tables that cannot be written. Its memory is limited, and
//! it spills to a temporary folder.

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
use schemas::Fault;

use crate::deep;
pub use session::SqlSession;
pub use tables::VersionPins;

/// Operators are evaluated on these threads, by recursion over expressions that may be nested deep.
pub const WORKER_STACK: usize = 64 << 20;

/// Query of a store, with its memory limit.
pub struct StoreQuery<'a> {
    /// The store's folder.
    pub store: &'a Path,
    /// The query.
    pub query: &'a str,
    /// How many bytes it may take.
    pub memory: usize,
    /// A folder of its own for what does not fit.
    pub spill: PathBuf,
}

/// Receiver of a query result, batch by batch.
pub trait BatchSink: Send {
    /// Takes one piece more; all have this schema. Says whether more are wanted.
    ///
    /// # Errors
    /// Fails when it cannot be written.
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault>;

    /// The bytes that it will keep of this piece.
    fn keeps(&self, batch: &RecordBatch) -> usize;

    /// All pieces were taken; there may have been none.
    ///
    /// # Errors
    /// Fails when it cannot be written.
    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault>;
}

/// Answers a question.
///
/// # Errors
/// Fails when the query is wrong, asks for a table that the store does not have, does anything but ask, or needs more
/// memory than it may take.
pub fn sql(question: &StoreQuery, sink: &mut dyn BatchSink) -> Result<(), Fault> {
    deep::over(question.query, || ())?;
    deep::deep(|| {
        let runtime = tokio::runtime::Builder::new_multi_thread().thread_stack_size(WORKER_STACK).enable_all().build();
        let runtime = runtime.map_err(|e| Fault::machine(e.to_string()))?;
        runtime.block_on(ask(question, sink))
    })?
}

async fn ask(question: &StoreQuery<'_>, sink: &mut dyn BatchSink) -> Result<(), Fault> {
    let session = SqlSession::new(question.store, question.memory, &question.spill)?;
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

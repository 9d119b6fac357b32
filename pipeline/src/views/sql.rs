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
mod tables;

use std::{
    future::poll_fn,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use datafusion::{
    dataframe::DataFrame,
    error::DataFusionError,
    execution::{
        disk_manager::{DiskManagerBuilder, DiskManagerMode},
        memory_pool::{FairSpillPool, MemoryConsumer, MemoryPool},
        runtime_env::RuntimeEnvBuilder,
    },
    prelude::{SQLOptions, SessionConfig, SessionContext},
};
use schemas::Fault;

use crate::deep;
use tables::Known;

/// Operators are evaluated on these threads, by recursion over expressions that may be nested deep.
const WORKER_STACK: usize = 64 << 20;

/// A question to a store.
pub struct Question<'a> {
    /// The store's folder.
    pub store: &'a Path,
    /// The query.
    pub query: &'a str,
    /// How many bytes it may take.
    pub memory: usize,
    /// A folder of its own for what does not fit.
    pub spill: PathBuf,
}

/// Whoever takes an answer, piece by piece.
pub trait Sink: Send {
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
pub fn sql(question: &Question, sink: &mut dyn Sink) -> Result<(), Fault> {
    deep::over(question.query, || ())?;
    deep::deep(|| {
        let runtime = tokio::runtime::Builder::new_multi_thread().thread_stack_size(WORKER_STACK).enable_all().build();
        let runtime = runtime.map_err(|e| Fault::machine(e.to_string()))?;
        runtime.block_on(ask(question, sink))
    })?
}

async fn ask(question: &Question<'_>, sink: &mut dyn Sink) -> Result<(), Fault> {
    let pool: Arc<dyn MemoryPool> = Arc::new(FairSpillPool::new(question.memory));
    let disk = DiskManagerBuilder::default().with_mode(DiskManagerMode::Directories(vec![question.spill.clone()]));
    let runtime = RuntimeEnvBuilder::new()
        .with_memory_pool(pool.clone())
        .with_disk_manager_builder(disk)
        .with_object_store_registry(Arc::new(tables::Nowhere))
        .build_arc()
        .map_err(|e| Fault::machine(e.to_string()))?;
    let context = SessionContext::new_with_config_rt(SessionConfig::new().with_information_schema(true), runtime);
    functions::register(&context);
    let known = tables::register(&context, question.store)?;
    let wrong = |e: DataFusionError| explain::fault(&e, &known, question, &context);
    let frame = plan(&context, question.query, &known, question).await?;
    let schema: SchemaRef = Arc::new(frame.schema().as_arrow().clone());
    let mut stream = frame.execute_stream().await.map_err(wrong)?;
    let kept = MemoryConsumer::new("answer").register(&pool);
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

/// The plan of a query that only asks.
async fn plan(
    context: &SessionContext,
    query: &str,
    known: &Known,
    question: &Question<'_>,
) -> Result<DataFrame, Fault> {
    let wrong = |e: DataFusionError| explain::fault(&e, known, question, context);
    let state = context.state();
    let statement = state.sql_to_statement(query, &state.config().options().sql_parser.dialect).map_err(wrong)?;
    refuse::statement(&statement)?;
    let plan = state.statement_to_plan(statement).await.map_err(wrong)?;
    refuse::plan(&plan)?;
    let nothing = SQLOptions::new().with_allow_ddl(false).with_allow_dml(false).with_allow_statements(false);
    nothing.verify_plan(&plan).map_err(wrong)?;
    context.execute_logical_plan(plan).await.map_err(wrong)
}

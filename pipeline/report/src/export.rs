//! Export of a table of a store: lists spread over columns, rows in the order of the table.

mod spread;
mod xyz;

use std::{future::poll_fn, sync::Arc};

use arrow_array::RecordBatch;
use arrow_schema::{Field, Schema, SchemaRef};
use datafusion::error::DataFusionError;
use expressions::deep;
use schemas::Fault;

pub use xyz::GeosoftWriter;

use crate::sql::{BatchSink, SqlSession, StoreQuery, WORKER_STACK};
use spread::spread;

/// The query of the rows of `table`, a name PIPELINE.TABLE, that `lines` and the SQL condition `condition` select.
///
/// # Errors
/// Fails when the name has another form.
pub fn query(table: &str, lines: &[String], condition: Option<&str>) -> Result<String, Fault> {
    let name = |part: &str| format!("\"{}\"", part.trim_matches('"').replace('"', "\"\""));
    let Some((pipeline, own)) = table.split_once('.').filter(|(a, b)| !a.is_empty() && !b.is_empty()) else {
        let fault = Fault::new(format!("`{table}` is not the name of a table of a store"));
        return Err(fault.help("write PIPELINE.TABLE; `magline ls` lists the tables"));
    };
    let mut conditions = vec![];
    if !lines.is_empty() {
        let texts: Vec<String> = lines.iter().map(|line| format!("'{}'", line.replace('\'', "''"))).collect();
        conditions.push(format!("\"line\" IN ({})", texts.join(", ")));
    }
    // A comment in the condition ends with its line.
    conditions.extend(condition.map(|text| format!("({text}\n)")));
    let conditions = if conditions.is_empty() { String::new() } else { format!(" WHERE {}", conditions.join(" AND ")) };
    Ok(format!("SELECT * FROM {}.{}{conditions}", name(pipeline), name(own)))
}

/// Sends the rows of a query to `sink`, batch by batch, in the order of the table. Fields keep their metadata.
///
/// # Errors
/// Fails when the query fails, and for a list that cannot be spread over columns.
pub fn export(question: &StoreQuery, sink: &mut dyn BatchSink) -> Result<(), Fault> {
    deep::over(question.query, || ())?;
    deep::deep(|| {
        let runtime = tokio::runtime::Builder::new_multi_thread().thread_stack_size(WORKER_STACK).enable_all().build();
        let runtime = runtime.map_err(|e| Fault::machine(e.to_string()))?;
        runtime.block_on(send(question, sink))
    })?
}

async fn send(question: &StoreQuery<'_>, sink: &mut dyn BatchSink) -> Result<(), Fault> {
    let session = SqlSession::new(question.store, question.memory, &question.spill)?;
    // Several partitions would mix the rows of different lines.
    session.context().state_ref().write().config_mut().options_mut().execution.target_partitions = 1;
    let plan = session.plan(question.query).await?;
    let wrong = |e: DataFusionError| session.fault(&e, question.query);
    let described: SchemaRef = Arc::new(plan.schema().as_arrow().clone());
    let mut stream = session.run(plan).await.map_err(wrong)?;
    let mut schema = spread(&RecordBatch::new_empty(described.clone()))?.schema();
    while let Some(batch) = poll_fn(|cx| stream.as_mut().poll_next(cx)).await {
        let batch = spread(&with_metadata(&batch.map_err(wrong)?, &described)?)?;
        schema = batch.schema();
        if !sink.take(batch)? {
            return Ok(());
        }
    }
    sink.finish(&schema)
}

/// The batch with the metadata of the fields of `described`. Operators of DataFusion may drop metadata.
fn with_metadata(batch: &RecordBatch, described: &Schema) -> Result<RecordBatch, Fault> {
    let fields = batch.schema();
    let field = |(old, new): (&Arc<Field>, &Arc<Field>)| {
        Field::new(old.name(), old.data_type().clone(), true).with_metadata(new.metadata().clone())
    };
    let fields: Vec<Field> = fields.fields().iter().zip(described.fields()).map(field).collect();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), batch.columns().to_vec()).map_err(|e| Fault::bug(e.to_string()))
}

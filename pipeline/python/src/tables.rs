//! Queries of the tables of a store, as Arrow data.

use std::{
    ffi::CStr,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use arrow_array::{RecordBatch, RecordBatchIterator, ffi_stream::FFI_ArrowArrayStream};
use arrow_cast::display::{ArrayFormatter, FormatOptions};
use arrow_schema::{ArrowError, SchemaRef, ffi::FFI_ArrowSchema};
use pipeline::{
    report::sql::{BatchSink, SqlSession, StoreQuery, memory},
    store::pulled,
};
use pyo3::{prelude::*, types::PyCapsule};
use schemas::Fault;

use crate::{
    attended::attended,
    faults::{exception, value_error},
};

/// Name of a capsule with an Arrow C stream.
const STREAM: &CStr = c"arrow_array_stream";
/// Name of a capsule with an Arrow C schema.
const SCHEMA: &CStr = c"arrow_schema";

/// The tables of a store, each as `pipeline.table`.
#[pyfunction]
pub fn tables(py: Python<'_>, store: PathBuf) -> PyResult<Vec<String>> {
    let found = py.detach(|| -> Result<Vec<String>, Fault> {
        pulled(&store)?;
        let session = SqlSession::new(&store, memory::by_default(), &std::env::temp_dir())?;
        Ok(session.known().tables.clone())
    });
    found.map_err(|fault| exception(py, &fault))
}

/// One row for each part of the table `table` (a name `pipeline.table`), with the columns that have a single value in
/// each part. A query reads or skips a part as a whole.
#[pyfunction]
pub fn table_parts(py: Python<'_>, store: PathBuf, table: String) -> PyResult<QueryResult> {
    let found = py.detach(|| {
        pulled(&store)?;
        pipeline::report::sql::parts(&store, &table)
    });
    let batch = found.map_err(|fault| exception(py, &fault))?;
    Ok(QueryResult { schema: batch.schema(), batches: vec![batch] })
}

/// Result of a query over a store. `spill` is a private folder for temporary files. The memory limit does not count the
/// result, which the caller keeps. With `in_order`, the rows of a table keep the order of the store.
#[pyfunction]
#[pyo3(signature = (store, query, spill, memory_limit, in_order))]
pub fn sql(
    py: Python<'_>,
    store: PathBuf,
    query: String,
    spill: PathBuf,
    memory_limit: Option<usize>,
    in_order: bool,
) -> PyResult<QueryResult> {
    let stopped = Arc::new(AtomicBool::new(false));
    let seen = stopped.clone();
    let asked = move || -> Result<Option<QueryResult>, Fault> {
        pulled(&store)?;
        let memory = memory_limit.unwrap_or_else(memory::by_default);
        let mut collector = Collector { batches: vec![], schema: None, stopped: seen };
        let question = StoreQuery { store: &store, query: &query, memory, spill };
        let ask = if in_order { pipeline::report::sql::sql_in_order } else { pipeline::report::sql::sql };
        ask(&question, &mut collector)?;
        let Collector { batches, schema, .. } = collector;
        Ok(schema.map(|schema| QueryResult { schema, batches }))
    };
    let found = attended(py, asked, || stopped.store(true, Ordering::SeqCst))?;
    found.and_then(|found| found.ok_or_else(|| Fault::bug("a query has no schema"))).map_err(|f| exception(py, &f))
}

/// Receiver that keeps all batches.
struct Collector {
    batches: Vec<RecordBatch>,
    schema: Option<SchemaRef>,
    stopped: Arc<AtomicBool>,
}

impl BatchSink for Collector {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        self.batches.push(batch);
        Ok(!self.stopped.load(Ordering::SeqCst))
    }

    fn keeps(&self, _: &RecordBatch) -> usize {
        0
    }

    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault> {
        self.schema = Some(schema.clone());
        Ok(())
    }
}

/// Rows of a query, in Arrow format.
#[pyclass(frozen, module = "magline._magline")]
pub struct QueryResult {
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
}

#[pymethods]
impl QueryResult {
    /// Capsule of an Arrow C stream over the rows. `requested_schema` has no effect.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let batches: Vec<Result<RecordBatch, ArrowError>> = self.batches.iter().cloned().map(Ok).collect();
        let reader = RecordBatchIterator::new(batches, self.schema.clone());
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(Box::new(reader)), STREAM)
    }

    /// Capsule of the Arrow C schema.
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema = FFI_ArrowSchema::try_from(self.schema.as_ref()).map_err(value_error)?;
        PyCapsule::new_with_value(py, schema, SCHEMA)
    }

    /// Number of rows.
    fn __len__(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Names of the columns, in order.
    #[getter]
    fn columns(&self) -> Vec<String> {
        self.schema.fields().iter().map(|field| field.name().clone()).collect()
    }

    /// The first `limit` rows as text; `None` for a missing value.
    fn rows(&self, limit: usize) -> PyResult<Vec<Vec<Option<String>>>> {
        let mut rows = vec![];
        for batch in &self.batches {
            let options = FormatOptions::default();
            let columns = batch.columns().iter().map(|column| ArrayFormatter::try_new(column, &options));
            let columns: Vec<ArrayFormatter<'_>> = columns.collect::<Result<_, _>>().map_err(value_error)?;
            let cell = |row: usize, column: usize, formatter: &ArrayFormatter<'_>| {
                batch.column(column).is_valid(row).then(|| formatter.value(row).to_string())
            };
            let left = limit.saturating_sub(rows.len()).min(batch.num_rows());
            rows.extend((0..left).map(|row| columns.iter().enumerate().map(|(i, f)| cell(row, i, f)).collect()));
        }
        Ok(rows)
    }
}

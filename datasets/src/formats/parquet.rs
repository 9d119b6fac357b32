//! Flight tables in Parquet, whoever wrote them: one batch after another, whatever the row groups.

use std::{fs::File, path::Path};

use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::{FlightFormat, FlightOptions, Head, Part, Raw, Reading, guarded};
use crate::ReadError;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "parquet",
    about: "Apache Parquet, one row per sample",
    extensions: &["parquet", "pq"],
    recognise: |head: &Head| head.starts_with(MAGIC),
    open,
    topics: None,
    made_from: None,
};

pub(super) const MAGIC: &[u8] = b"PAR1";

/// Rows to a batch: 64 k rows of 100 columns are 50 MB.
const BATCH_ROWS: usize = 65_536;

fn open(path: &Path, _: &FlightOptions, _: &Reading) -> Result<Raw, ReadError> {
    let builder = builder(path)?;
    let schema = builder.schema().clone();
    let reader = guarded(path, || {
        let reader = builder.with_batch_size(BATCH_ROWS).build();
        reader.map_err(|e| damaged(path, &e.to_string()))
    })?;
    let path = path.to_path_buf();
    let mut reader = Some(reader);
    let parts = std::iter::from_fn(move || {
        let inner = reader.as_mut()?;
        let next = guarded(&path, || inner.next().transpose().map_err(|e| damaged(&path, &e.to_string()))).transpose();
        // Nothing after a damaged page can be trusted.
        if matches!(next, None | Some(Err(_))) {
            reader = None;
        }
        next.map(|batch| batch.map(Part::whole))
    });
    // The writer's own schema metadata (such as pandas') is dropped: it describes another table.
    let schema = std::sync::Arc::new(arrow_schema::Schema::new(schema.fields().clone()));
    Ok(Raw { fillers: true, ..Raw::new(schema, Box::new(parts)) })
}

/// A Parquet file with its footer read.
pub(super) fn builder(path: &Path) -> Result<ParquetRecordBatchReaderBuilder<File>, ReadError> {
    let file = File::open(path).map_err(|e| ReadError::io(path, &e))?;
    guarded(path, || ParquetRecordBatchReaderBuilder::try_new(file).map_err(|e| damaged(path, &e.to_string())))
}

pub(super) fn damaged(path: &Path, what: &str) -> ReadError {
    ReadError::data(path, format!("not a whole Parquet file: {what}"))
}

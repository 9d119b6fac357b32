//! Flight tables in Parquet from any program, read in batches that do not depend on the row groups.

use std::{fs::File, path::Path, sync::Arc};

use arrow_array::{Array, ArrayRef, BinaryViewArray, RecordBatch, StringViewArray};
use arrow_cast::cast;
use arrow_schema::{ArrowError, DataType, Schema, SchemaRef};
use parquet::{
    arrow::arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder},
    basic::Type,
    file::metadata::{ColumnChunkMetaData, ParquetMetaData},
};

use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, RawFlight, ReadHints, guarded,
    limits::{DecodeLimit, check_columns},
};
use crate::ReadError;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "parquet",
    about: "Apache Parquet, one row per sample",
    extensions: &["parquet", "pq"],
    recognise: |head: &FileHead| head.starts_with(MAGIC),
    open,
    topics: None,
    made_from: None,
};

pub(super) const MAGIC: &[u8] = b"PAR1";

/// Rows per batch: 64 k rows of 100 columns are 50 MB.
const BATCH_ROWS: usize = 65_536;
/// Maximum bytes of all strings of a batch.
const MOST_TEXT: u64 = 256 << 20;

fn open(path: &Path, _: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let file = ParquetSource::new(path)?;
    let schema = file.schema.clone();
    let parts = file.batches(path)?.map(|batch| batch.map(FlightBatch::whole));
    // The schema metadata of the writer (such as pandas) are dropped, because they describe another table.
    let schema = Arc::new(Schema::new(schema.fields().clone()));
    Ok(RawFlight { fillers: true, ..RawFlight::new(schema, Box::new(parts)) })
}

/// A Parquet file with its footer read.
pub(super) struct ParquetSource {
    /// Reader of the file's batches; [`plain`] converts a batch to `schema`.
    builder: ParquetRecordBatchReaderBuilder<File>,
    /// The schema of the file.
    pub(super) schema: SchemaRef,
}

impl ParquetSource {
    /// Opens a file and checks the size that it declares.
    ///
    /// # Errors
    /// Fails for an incomplete file, or for one that declares more bytes than its size permits.
    pub(super) fn new(path: &Path) -> Result<ParquetSource, ReadError> {
        let file = File::open(path).map_err(|e| ReadError::io(path, &e))?;
        let bytes = file.metadata().map_err(|e| ReadError::io(path, &e))?.len();
        guarded(path, || {
            let loaded = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new());
            let metadata = loaded.map_err(|e| damaged(path, &e.to_string()))?;
            let schema = metadata.schema().clone();
            check_columns(path, schema.fields().len())?;
            DecodeLimit::new(bytes).check(path, declared(metadata.metadata()))?;
            let views = ArrowReaderOptions::new().with_schema(views(&schema));
            let metadata = ArrowReaderMetadata::try_new(metadata.metadata().clone(), views).unwrap_or(metadata);
            Ok(ParquetSource { builder: ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata), schema })
        })
    }

    /// The batches of the file up to the first error, because data after a damaged page are unreliable.
    ///
    /// # Errors
    /// Fails for a file that cannot be read.
    pub(super) fn batches(
        self,
        path: &Path,
    ) -> Result<impl Iterator<Item = Result<RecordBatch, ReadError>> + Send + use<>, ReadError> {
        let ParquetSource { builder, schema } = self;
        let reader = guarded(path, || {
            let reader = builder.with_batch_size(BATCH_ROWS).build();
            reader.map_err(|e| damaged(path, &e.to_string()))
        })?;
        let (path, mut reader) = (path.to_path_buf(), Some(reader));
        Ok(std::iter::from_fn(move || {
            let inner = reader.as_mut()?;
            let next = guarded(&path, || {
                let batch = inner.next().transpose().map_err(|e| damaged(&path, &e.to_string()))?;
                batch.map(|batch| plain(&path, &batch, &schema)).transpose()
            });
            if !matches!(next, Ok(Some(_))) {
                reader = None;
            }
            next.transpose()
        }))
    }
}

/// Memory of all values, in bytes; `None` for 2^64 or more. A string in a dictionary counts once.
fn declared(metadata: &ParquetMetaData) -> Option<u64> {
    let chunk = |chunk: &ColumnChunkMetaData| {
        let values = u64::try_from(chunk.num_values()).ok()?;
        let width = match chunk.column_type() {
            Type::BOOLEAN => 1,
            Type::INT32 | Type::FLOAT => 4,
            Type::INT64 | Type::DOUBLE => 8,
            Type::INT96 => 12,
            // A string view has 16 bytes.
            Type::BYTE_ARRAY => 16,
            Type::FIXED_LEN_BYTE_ARRAY => u64::try_from(chunk.column_descr().type_length()).ok()?,
        };
        let stored = match chunk.column_type() {
            Type::BYTE_ARRAY => u64::try_from(chunk.uncompressed_size()).ok()?,
            _ => 0,
        };
        values.checked_mul(width)?.checked_add(stored)
    };
    let groups = metadata.row_groups().iter().flat_map(|group| group.columns());
    groups.map(chunk).try_fold(0_u64, |sum, bytes| sum.checked_add(bytes?))
}

/// The schema with string views instead of strings: a long string in a dictionary is then in memory only once.
fn views(schema: &SchemaRef) -> SchemaRef {
    let view = |kind: &DataType| match kind {
        DataType::Utf8 | DataType::LargeUtf8 => DataType::Utf8View,
        DataType::Binary | DataType::LargeBinary => DataType::BinaryView,
        other => other.clone(),
    };
    let fields = schema.fields().iter().map(|f| Arc::new(f.as_ref().clone().with_data_type(view(f.data_type()))));
    Arc::new(Schema::new_with_metadata(fields.collect::<Vec<_>>(), schema.metadata().clone()))
}

/// A batch in the schema of its file.
///
/// # Errors
/// Fails if the total length of the strings exceeds the limit of a batch.
fn plain(path: &Path, batch: &RecordBatch, to: &SchemaRef) -> Result<RecordBatch, ReadError> {
    let wrong = |e: ArrowError| damaged(path, &e.to_string());
    let mut texts = 0_u64;
    let mut columns: Vec<ArrayRef> = vec![];
    for (column, field) in batch.columns().iter().zip(to.fields()) {
        let any = column.as_any();
        let lengths = any.downcast_ref::<StringViewArray>().map(|a| a.views());
        let views = lengths.or_else(|| any.downcast_ref::<BinaryViewArray>().map(|a| a.views()));
        // The lower 32 bits of a view are its length.
        texts += views.map_or(0, |views| views.iter().map(|view| u64::from(*view as u32)).sum::<u64>());
        if texts > MOST_TEXT {
            let what = format!("the text in {} rows exceeds {} MB", batch.num_rows(), MOST_TEXT >> 20);
            return Err(ReadError::data(path, what).in_column(field.name()).help("remove the column from the file"));
        }
        let same = column.data_type() == field.data_type();
        columns.push(if same { column.clone() } else { cast(column, field.data_type()).map_err(wrong)? });
    }
    let fields = Schema::new(to.fields().clone());
    RecordBatch::try_new(Arc::new(fields), columns).map_err(wrong)
}

fn damaged(path: &Path, what: &str) -> ReadError {
    ReadError::data(path, format!("the file is not a complete Parquet file: {what}"))
}

//! Parquet files of a set: zstd, statistics per page, and ascending rows, in an encoding that the default readers of
//! all engines support. The same rows give the same bytes.

use std::{fs::File, path::Path, sync::Arc};

use arrow_array::{
    Array, ArrayRef, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use arrow_select::concat::concat_batches;
use parquet::{
    arrow::{ArrowWriter, arrow_reader::ParquetRecordBatchReaderBuilder},
    basic::{Compression, ZstdLevel},
    file::{
        metadata::SortingColumn,
        properties::{EnabledStatistics, WriterProperties},
    },
    schema::types::ColumnPath,
};
use schemas::{Fault, paths};

use super::{
    set::{ColumnKind, ColumnValueStatistics, ReleaseColumn},
    words::cannot,
};

/// Rows of a row group.
const GROUP_ROWS: usize = 100_000;

/// Name of the writer in Parquet files. It has no version, so that files differ only in their rows.
const WRITER: &str = "magline";

/// File in progress.
pub struct ReleaseFileWriter<'a> {
    path: &'a Path,
    schema: SchemaRef,
    writer: ArrowWriter<File>,
    waiting: Vec<RecordBatch>,
    rows: usize,
    written: u64,
}

impl<'a> ReleaseFileWriter<'a> {
    /// Creates a file at `path` whose rows ascend by `sorted_by`.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn new(path: &'a Path, schema: &SchemaRef, sorted_by: &[String]) -> Result<ReleaseFileWriter<'a>, Fault> {
        let fail = |e: &dyn std::fmt::Display| cannot("write", path, e);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|e| fail(&e))?;
        }
        let file = File::options().write(true).create_new(true).open(path).map_err(|e| fail(&e))?;
        let properties = properties(schema, sorted_by);
        let writer = ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(|e| fail(&e))?;
        Ok(ReleaseFileWriter { path, schema: schema.clone(), writer, waiting: vec![], rows: 0, written: 0 })
    }

    /// Adds rows, in the columns of the schema.
    ///
    /// # Errors
    /// Fails if they have other columns, or the file system reports an error.
    pub fn add(&mut self, rows: RecordBatch) -> Result<(), Fault> {
        self.rows += rows.num_rows();
        self.waiting.push(rows);
        while self.rows >= GROUP_ROWS {
            self.group(GROUP_ROWS)?;
        }
        Ok(())
    }

    /// Writes the first `rows` waiting rows as a row group. The bytes of the group do not depend on the batches in
    /// which the rows arrived.
    fn group(&mut self, rows: usize) -> Result<(), Fault> {
        let fail = |e: &dyn std::fmt::Display| cannot("write", self.path, e);
        let all = concat_batches(&self.schema, &self.waiting).map_err(|e| fail(&e))?;
        let rest = all.slice(rows, all.num_rows() - rows);
        self.writer.write(&all.slice(0, rows)).and_then(|()| self.writer.flush()).map_err(|e| fail(&e))?;
        self.written += rows as u64;
        self.rows = rest.num_rows();
        self.waiting = vec![rest];
        Ok(())
    }

    /// Writes the remaining rows and returns the number of rows in the file. The file is on the disk on return.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn finish(mut self) -> Result<u64, Fault> {
        if self.rows > 0 {
            self.group(self.rows)?;
        }
        let ReleaseFileWriter { path, writer, written, .. } = self;
        let file = writer.into_inner().map_err(|e| cannot("write", path, &e))?;
        file.sync_all().map_err(|e| cannot("write", path, &e))?;
        Ok(written)
    }
}

fn properties(schema: &Schema, sorted_by: &[String]) -> WriterProperties {
    let mut properties = WriterProperties::builder()
        .set_created_by(WRITER.to_owned())
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        .set_statistics_enabled(EnabledStatistics::Page)
        .set_max_row_group_row_count(None);
    let leaves = leaves(schema);
    let place = |name: &String| leaves.iter().position(|(root, _)| *root == name.as_str());
    let sorting: Option<Vec<SortingColumn>> = sorted_by
        .iter()
        .map(|name| {
            let column_idx = i32::try_from(place(name)?).ok()?;
            Some(SortingColumn { column_idx, descending: false, nulls_first: false })
        })
        .collect();
    properties = properties.set_sorting_columns(sorting.filter(|s| !s.is_empty()));
    for field in schema.fields() {
        let role = field.metadata().get("role").map(String::as_str);
        let measured = field.data_type() == &DataType::Float64 && !matches!(role, Some("key" | "time"));
        if measured || is_list(field.data_type()) {
            for (_, leaf) in leaves.iter().filter(|(root, _)| *root == field.name().as_str()) {
                properties = properties.set_column_dictionary_enabled(leaf.clone(), false);
                if is_list(field.data_type()) {
                    properties = properties.set_column_statistics_enabled(leaf.clone(), EnabledStatistics::None);
                }
            }
        }
    }
    properties.build()
}

/// Columns of a table, each with the path of its Parquet column.
fn leaves(schema: &Schema) -> Vec<(&str, ColumnPath)> {
    let leaf = |field: &'_ Arc<Field>| match field.data_type() {
        DataType::FixedSizeList(item, _) | DataType::List(item) => {
            ColumnPath::new(vec![field.name().clone(), "list".into(), item.name().clone()])
        }
        _ => ColumnPath::from(field.name().as_str()),
    };
    schema.fields().iter().map(|field| (field.name().as_str(), leaf(field))).collect()
}

fn is_list(kind: &DataType) -> bool {
    matches!(kind, DataType::FixedSizeList(..) | DataType::List(_))
}

/// Reads a whole file: calls `each` with every batch, and returns the schema.
///
/// # Errors
/// Fails if it is not Parquet, is damaged, or `each` fails.
pub fn read(path: &Path, mut each: impl FnMut(&RecordBatch) -> Result<(), String>) -> Result<SchemaRef, String> {
    let file = paths::open_regular(path).map_err(|e| e.to_string())?;
    let reader = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|e| e.to_string())?;
    let schema = reader.schema().clone();
    for batch in reader.with_batch_size(GROUP_ROWS).build().map_err(|e| e.to_string())? {
        each(&batch.map_err(|e| e.to_string())?)?;
    }
    Ok(Arc::new(Schema::new(schema.fields().clone())))
}

/// Columns of a schema as in the dictionary, without their values.
pub fn columns(schema: &Schema) -> Vec<ReleaseColumn> {
    let column = |field: &Arc<Field>| {
        let about = |key: &str| field.metadata().get(key).cloned().unwrap_or_default();
        let terms = about("terms");
        ReleaseColumn {
            name: field.name().clone(),
            kind: kind(field.data_type()),
            unit: about("unit"),
            role: about("role"),
            description: about("description"),
            terms: terms.split(',').filter(|t| !t.is_empty()).map(str::to_owned).collect(),
            from: vec![],
            values: ColumnValueStatistics::default(),
        }
    };
    schema.fields().iter().map(column).collect()
}

fn kind(kind: &DataType) -> ColumnKind {
    match kind {
        DataType::Float64 => ColumnKind::Number,
        DataType::Int64 => ColumnKind::Integer,
        DataType::Utf8 => ColumnKind::Text,
        DataType::Boolean => ColumnKind::Boolean,
        DataType::FixedSizeList(item, _) | DataType::List(item) if item.data_type() == &DataType::Float64 => {
            ColumnKind::Numbers
        }
        other => ColumnKind::Other(other.to_string()),
    }
}

/// Adds the values of a column to its statistics.
pub fn count(values: &mut ColumnValueStatistics, array: &ArrayRef) {
    let mut number = |x: f64| {
        if x.is_finite() {
            values.min = Some(values.min.map_or(x, |m| m.min(x)));
            values.max = Some(values.max.map_or(x, |m| m.max(x)));
        }
    };
    values.missing += match (array.as_primitive_opt::<Float64Type>(), array.as_primitive_opt::<Int64Type>()) {
        (Some(floats), _) => floats
            .iter()
            .filter(|x| {
                x.iter().for_each(|x| number(*x));
                x.is_none_or(f64::is_nan)
            })
            .count() as u64,
        (None, Some(whole)) => {
            whole.iter().flatten().for_each(|x| number(x as f64));
            whole.null_count() as u64
        }
        (None, None) => array.null_count() as u64,
    };
}

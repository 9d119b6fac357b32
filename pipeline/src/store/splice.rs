//! Tables from objects without decoding: column chunks are copied, and shared where they are the same.
//!
//! A sweep point adds a few columns to a line that all points share. In the published file of that line every point is
//! a row group, and the row groups' metadata point at one copy of the shared chunks. Readers seek to the offsets in
//! the metadata, so to them it is an ordinary Parquet file; on disk a hundred points cost little more than one.

use std::{
    collections::HashMap,
    fs::File,
    io::{self, BufWriter, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{Schema, SchemaRef};
use parquet::{
    arrow::{ARROW_SCHEMA_META_KEY, ArrowSchemaConverter, encode_arrow_schema},
    file::metadata::{
        ColumnChunkMetaData, FileMetaData, KeyValue, ParquetMetaData, ParquetMetaDataReader, ParquetMetaDataWriter,
        RowGroupMetaData,
    },
    schema::types::{SchemaDescPtr, SchemaDescriptor},
};
use schemas::Fault;

use super::{properties, trouble};

/// Where the values of one column of one row group come from.
#[derive(Clone, Debug)]
pub enum Piece {
    /// The column `column` of an object's only row group.
    Chunk {
        /// The object's file.
        object: PathBuf,
        /// The column's name there.
        column: String,
    },
    /// Values that no object holds, such as an axis value.
    Values(ArrayRef),
}

/// One row group: a piece for each field of the schema.
#[derive(Clone, Debug)]
pub struct RowGroup {
    /// How many rows.
    pub rows: usize,
    /// In the order of the schema's fields.
    pub pieces: Vec<Piece>,
}

/// Writes `groups` as one Parquet file at `path`.
///
/// # Errors
/// When an object cannot be read, has another type than the schema says, or the file system refuses.
pub fn splice(path: &Path, schema: &SchemaRef, groups: &[RowGroup]) -> Result<(), Fault> {
    let fail = |e: &dyn std::fmt::Display| trouble("write", path, e);
    let descriptor = Arc::new(ArrowSchemaConverter::new().convert(schema).map_err(|e| fail(&e))?);
    let out = BufWriter::with_capacity(1 << 20, File::create(path).map_err(|e| fail(&e))?);
    let mut splicer = Splicer { out, at: 0, objects: HashMap::new(), copied: HashMap::new(), made: HashMap::new() };
    splicer.emit(b"PAR1").map_err(|e| fail(&e))?;
    let mut metas = Vec::with_capacity(groups.len());
    let mut total = 0i64;
    for (ordinal, group) in groups.iter().enumerate() {
        metas.push(splicer.group(schema, &descriptor, group, ordinal).map_err(|e| fail(&e))?);
        total += group.rows as i64;
    }
    let arrow = KeyValue::new(ARROW_SCHEMA_META_KEY.to_owned(), encode_arrow_schema(schema));
    let file = FileMetaData::new(1, total, Some("magline".to_owned()), Some(vec![arrow]), descriptor, None);
    let metadata = ParquetMetaData::new(file, metas);
    ParquetMetaDataWriter::new(&mut splicer.out, &metadata).finish().map_err(|e| fail(&e))?;
    splicer.out.flush().map_err(|e| fail(&e))
}

type Failure = Box<dyn std::error::Error>;

struct Object {
    file: File,
    metadata: ParquetMetaData,
}

struct Splicer {
    out: BufWriter<File>,
    at: u64,
    objects: HashMap<PathBuf, Object>,
    /// Chunks already in the file, by object and leaf column.
    copied: HashMap<(PathBuf, String), ColumnChunkMetaData>,
    /// Chunks made here, by their encoded bytes.
    made: HashMap<Vec<u8>, Vec<ColumnChunkMetaData>>,
}

impl Splicer {
    fn emit(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    fn group(
        &mut self,
        schema: &SchemaRef,
        descriptor: &SchemaDescPtr,
        group: &RowGroup,
        ordinal: usize,
    ) -> Result<RowGroupMetaData, Failure> {
        let mut chunks = vec![];
        for (field, piece) in schema.fields().iter().zip(&group.pieces) {
            match piece {
                Piece::Chunk { object, column } => {
                    for leaf in leaves(descriptor, field.name()) {
                        let under = leaf.strip_prefix(field.name().as_str()).unwrap_or("");
                        chunks.push(self.copy(object, &format!("{column}{under}"))?);
                    }
                }
                Piece::Values(array) => {
                    let one = Schema::new(vec![field.as_ref().clone()]);
                    let batch = RecordBatch::try_new(Arc::new(one), vec![array.clone()])?;
                    chunks.extend(self.make(&batch)?);
                }
            }
        }
        let described = chunks.into_iter().zip(descriptor.columns()).map(|(chunk, column)| {
            if chunk.column_descr().physical_type() != column.physical_type() {
                return Err(format!("column `{}` changed its type", column.path()));
            }
            Ok(redescribe(&chunk, column.clone()))
        });
        let chunks = described.collect::<Result<Result<Vec<_>, _>, String>>()??;
        let bytes = chunks.iter().map(ColumnChunkMetaData::uncompressed_size).sum();
        Ok(RowGroupMetaData::builder(descriptor.clone())
            .set_num_rows(group.rows as i64)
            .set_total_byte_size(bytes)
            .set_column_metadata(chunks)
            .set_ordinal(i16::try_from(ordinal).unwrap_or(i16::MAX))
            .build()?)
    }

    /// The chunk of an object, copied at its first use.
    fn copy(&mut self, object: &Path, leaf: &str) -> Result<ColumnChunkMetaData, Failure> {
        let key = (object.to_owned(), leaf.to_owned());
        if let Some(chunk) = self.copied.get(&key) {
            return Ok(chunk.clone());
        }
        if !self.objects.contains_key(object) {
            let file = File::open(object)?;
            let metadata = ParquetMetaDataReader::new().parse_and_finish(&file)?;
            self.objects.insert(object.to_owned(), Object { file, metadata });
        }
        let held = self.objects.get(object).ok_or("lost an open object")?;
        let group = held.metadata.row_groups().first().ok_or("an object without rows")?;
        let found = group.columns().iter().find(|c| c.column_path().string() == leaf);
        let chunk = found.ok_or_else(|| format!("{} has no column `{leaf}`", object.display()))?.clone();
        let (start, length) = chunk.byte_range();
        let mut bytes = vec![0; usize::try_from(length)?];
        let mut file = &held.file;
        file.seek(SeekFrom::Start(start))?;
        file.read_exact(&mut bytes)?;
        let moved = shifted(chunk, i64::try_from(self.at)? - i64::try_from(start)?)?;
        self.emit(&bytes)?;
        self.copied.insert(key, moved.clone());
        Ok(moved)
    }

    /// Chunks for values that no object holds, encoded as an object would be.
    fn make(&mut self, batch: &RecordBatch) -> Result<Vec<ColumnChunkMetaData>, Failure> {
        let mut bytes = vec![];
        let mut writer =
            parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties(&batch.schema())))?;
        writer.write(batch)?;
        writer.close()?;
        if let Some(chunks) = self.made.get(&bytes) {
            return Ok(chunks.clone());
        }
        let source = bytes::Bytes::from(bytes.clone());
        let metadata = ParquetMetaDataReader::new().parse_and_finish(&source)?;
        let group = metadata.row_groups().first().ok_or("no rows to write")?;
        let mut chunks = vec![];
        for chunk in group.columns() {
            let (start, length) = chunk.byte_range();
            let moved = shifted(chunk.clone(), i64::try_from(self.at)? - i64::try_from(start)?)?;
            let (from, to) = (usize::try_from(start)?, usize::try_from(start + length)?);
            self.emit(bytes.get(from..to).ok_or("a chunk outside of its file")?)?;
            chunks.push(moved);
        }
        self.made.insert(bytes, chunks.clone());
        Ok(chunks)
    }
}

/// The leaf columns under the field `name`.
fn leaves(descriptor: &SchemaDescriptor, name: &str) -> Vec<String> {
    let under =
        |c: &&Arc<parquet::schema::types::ColumnDescriptor>| c.path().parts().first().map(String::as_str) == Some(name);
    descriptor.columns().iter().filter(under).map(|c| c.path().string()).collect()
}

/// The chunk, with its offsets moved.
fn shifted(chunk: ColumnChunkMetaData, by: i64) -> parquet::errors::Result<ColumnChunkMetaData> {
    let (data, dictionary) = (chunk.data_page_offset() + by, chunk.dictionary_page_offset().map(|o| o + by));
    chunk
        .into_builder()
        .set_data_page_offset(data)
        .set_dictionary_page_offset(dictionary)
        .set_offset_index_offset(None)
        .set_offset_index_length(None)
        .set_column_index_offset(None)
        .set_column_index_length(None)
        .build()
}

/// The chunk under the column descriptor of the file it now lies in.
fn redescribe(
    chunk: &ColumnChunkMetaData,
    column: Arc<parquet::schema::types::ColumnDescriptor>,
) -> parquet::errors::Result<ColumnChunkMetaData> {
    let mut builder = ColumnChunkMetaData::builder(column)
        .set_encodings(chunk.encodings().collect())
        .set_num_values(chunk.num_values())
        .set_compression(chunk.compression())
        .set_total_compressed_size(chunk.compressed_size())
        .set_total_uncompressed_size(chunk.uncompressed_size())
        .set_data_page_offset(chunk.data_page_offset())
        .set_dictionary_page_offset(chunk.dictionary_page_offset());
    if let Some(statistics) = chunk.statistics() {
        builder = builder.set_statistics(statistics.clone());
    }
    builder.build()
}

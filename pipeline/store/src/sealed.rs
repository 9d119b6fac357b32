//! Sealed file of the store: ordinary Parquet, with checksums that its reader verifies.
//!
//! The footer's metadata contain a CRC-32 of every column chunk (`magline.crc`). The seal is between the last row group
//! and the footer, in bytes that Parquet does not use. It consists of a mark, a CRC-32 of all bytes before the seal,
//! and a CRC-32 of the footer. Reading a column verifies only the footer and the decoded chunks.

use std::{
    fmt::Display,
    fs::{self, File},
    io::{self, Read, Seek, SeekFrom, Write},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    time::SystemTime,
};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Schema, SchemaRef};
use bytes::{Buf, Bytes};
use parquet::{
    arrow::{
        ArrowWriter, ProjectionMask,
        arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder},
    },
    basic::Compression,
    errors::ParquetError,
    file::{
        metadata::{KeyValue, RowGroupMetaData},
        properties::{EnabledStatistics, WriterProperties},
        reader::{ChunkReader, Length},
    },
    schema::types::{ColumnPath, SchemaDescriptor},
};
use schemas::{Fault, paths};

/// Mark of a seal.
const MARK: &[u8; 8] = b"MAGLSEAL";
/// Size of a seal, in bytes: mark, checksum of the data, checksum of the footer.
const SEAL: usize = 16;
/// Size of the footer length and Parquet's own mark, in bytes.
const TAIL: usize = 8;
/// Metadata key of the checksums of the column chunks.
const CRC: &str = "magline.crc";

/// Reason why a file of the store is unreadable.
#[derive(Debug)]
pub enum StoreFileFault {
    /// The bytes differ from the written bytes.
    Damaged(String),
    /// Existing file that cannot be read.
    Machine(String),
    /// Missing file.
    Gone,
}

impl StoreFileFault {
    fn io(error: &io::Error) -> StoreFileFault {
        match error.kind() {
            io::ErrorKind::NotFound => StoreFileFault::Gone,
            io::ErrorKind::UnexpectedEof => StoreFileFault::Damaged("it is truncated".to_owned()),
            // A pipe, a socket or a device.
            io::ErrorKind::InvalidInput => StoreFileFault::Damaged(error.to_string()),
            _ => StoreFileFault::Machine(error.to_string()),
        }
    }

    fn damaged(what: impl Display) -> StoreFileFault {
        StoreFileFault::Damaged(what.to_string())
    }
}

/// Fault of a file. If the file is damaged, its modification time is changed. A reader that only checks size and time,
/// such as a run, then verifies the whole file.
fn doubted(path: &Path, fault: StoreFileFault) -> StoreFileFault {
    if matches!(fault, StoreFileFault::Damaged(_)) {
        // A read-only store and the target of a link stay unchanged.
        let is_link = fs::symlink_metadata(path).is_ok_and(|about| about.is_symlink());
        if !is_link {
            let _ = File::options().append(true).open(path).and_then(|file| file.set_modified(SystemTime::now()));
        }
    }
    fault
}

impl Display for StoreFileFault {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            StoreFileFault::Damaged(what) | StoreFileFault::Machine(what) => f.write_str(what),
            StoreFileFault::Gone => f.write_str("it does not exist"),
        }
    }
}

/// Encoding of all files in the store, which the default readers of all engines support. Repeated values (identifiers,
/// axes, times that the points of a sweep share) are dictionary-encoded, measured numbers are plain.
fn properties(schema: &Schema) -> WriterProperties {
    let mut properties = WriterProperties::builder()
        .set_created_by("magline".to_owned())
        .set_compression(Compression::SNAPPY)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true)
        .set_max_row_group_row_count(None);
    for field in schema.fields() {
        let name = field.name();
        let (leaf, repeats) = match field.data_type() {
            DataType::Float64 => (ColumnPath::from(name.as_str()), repeats(field)),
            DataType::FixedSizeList(item, _) | DataType::List(item) => {
                let leaf = ColumnPath::new(vec![name.clone(), "list".into(), item.name().clone()]);
                properties = properties.set_column_statistics_enabled(leaf.clone(), EnabledStatistics::None);
                (leaf, false)
            }
            _ => continue,
        };
        properties = properties.set_column_dictionary_enabled(leaf, repeats);
    }
    properties.build()
}

/// Whether the values of a numeric column are often repeated, as in axes and times.
fn repeats(field: &arrow_schema::Field) -> bool {
    let role = field.metadata().get("role").map(String::as_str);
    matches!(role, Some("key" | "time"))
}

/// Writes `groups`, each as one row group, and the metadata `about`, as a Parquet file. The same groups give the same
/// bytes. The file is on the disk on return.
///
/// # Errors
/// Fails if a group cannot be created, or the file system reports an error.
pub fn write(
    path: &Path,
    schema: &SchemaRef,
    about: &[(String, String)],
    groups: impl IntoIterator<Item = Result<RecordBatch, Fault>>,
) -> Result<(), Fault> {
    let fail = |e: &dyn Display| Fault::machine(format!("cannot write {}: {e}", path.display()));
    let file = File::options().create(true).truncate(true).read(true).write(true).open(path).map_err(|e| fail(&e))?;
    let mut writer = ArrowWriter::try_new(ParquetTarget::File(&file), schema.clone(), Some(properties(schema)))
        .map_err(|e| fail(&e))?;
    let mut chunks = String::new();
    for group in groups {
        writer.write(&group?).map_err(|e| fail(&e))?;
        writer.flush().and_then(|()| Ok(writer.sync()?)).map_err(|e| fail(&e))?;
        for chunk in writer.flushed_row_groups().last().into_iter().flat_map(|g| g.columns()) {
            let (start, length) = chunk.byte_range();
            let sum = sum_of(&file, start, length).map_err(|e| fail(&e))?;
            chunks.push_str(&format!("{sum:08x}"));
        }
    }
    for (key, value) in about {
        writer.append_key_value_metadata(KeyValue::new(key.clone(), value.clone()));
    }
    writer.append_key_value_metadata(KeyValue::new(CRC.to_owned(), chunks));
    // The next bytes are the footer, which follows the seal.
    writer.sync().map_err(|e| fail(&e))?;
    let before = std::mem::replace(writer.inner_mut(), ParquetTarget::Memory(vec![]));
    drop(before);
    let ParquetTarget::Memory(rest) = writer.into_inner().map_err(|e| fail(&e))? else {
        return Err(fail(&"no footer"));
    };
    let length = rest.len().checked_sub(TAIL).and_then(|i| rest.get(i..i + 4)).and_then(|b| b.try_into().ok());
    let footer = length.map_or(0, |b| u32::from_le_bytes(b) as usize + TAIL);
    let (data, footer) = rest.split_at_checked(rest.len().wrapping_sub(footer)).ok_or_else(|| fail(&"no footer"))?;
    let mut file = file;
    file.write_all(data).map_err(|e| fail(&e))?;
    let end = file.stream_position().map_err(|e| fail(&e))?;
    let whole = sum_of(&file, 0, end).map_err(|e| fail(&e))?;
    let mut seal = MARK.to_vec();
    seal.extend(whole.to_le_bytes());
    seal.extend(crc32fast::hash(footer).to_le_bytes());
    [&seal, footer].into_iter().try_for_each(|part| file.write_all(part)).map_err(|e| fail(&e))?;
    file.sync_all().map_err(|e| fail(&e))
}

/// Target of a Parquet writer: row groups to the file, the footer to memory.
enum ParquetTarget<'a> {
    File(&'a File),
    Memory(Vec<u8>),
}

impl Write for ParquetTarget<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            ParquetTarget::File(file) => file.write(bytes),
            ParquetTarget::Memory(all) => all.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Checksum of a part of a file.
fn sum_of(file: &File, start: u64, length: u64) -> io::Result<u32> {
    let (mut hasher, mut at, mut buffer) = (crc32fast::Hasher::new(), start, vec![0; 1 << 16]);
    while at < start + length {
        let most = usize::try_from(start + length - at).unwrap_or(usize::MAX).min(buffer.len());
        match file.read_at(&mut buffer[..most], at)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            n => {
                hasher.update(&buffer[..n]);
                at += n as u64;
            }
        }
    }
    Ok(hasher.finalize())
}

/// File with a verified footer.
pub struct SealedFile {
    path: PathBuf,
    metadata: ArrowReaderMetadata,
    schema: SchemaRef,
    /// Checksum of each leaf column of each row group.
    crcs: Vec<u32>,
    /// First row of each row group, then the total number of rows.
    starts: Vec<usize>,
}

impl SealedFile {
    /// Reads and verifies the footer.
    ///
    /// # Errors
    /// Fails if the file is missing, unreadable or damaged.
    pub fn open(path: &Path) -> Result<SealedFile, StoreFileFault> {
        SealedFile::opened(path).map_err(|e| doubted(path, e))
    }

    fn opened(path: &Path) -> Result<SealedFile, StoreFileFault> {
        let mut file = paths::open_regular(path).map_err(|e| StoreFileFault::io(&e))?;
        footer(&mut file)?;
        let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new()).map_err(StoreFileFault::damaged)?;
        let hex = text_of(&metadata, CRC).unwrap_or_default();
        let crcs: Option<Vec<u32>> = (0..hex.len() / 8)
            .map(|i| hex.get(8 * i..8 * i + 8).and_then(|h| u32::from_str_radix(h, 16).ok()))
            .collect();
        let groups = metadata.metadata().row_groups();
        let leaves: usize = groups.iter().map(|g| g.columns().len()).sum();
        let crcs =
            crcs.filter(|c| c.len() == leaves).ok_or_else(|| StoreFileFault::damaged("its checksums are missing"))?;
        let mut starts = vec![0];
        for group in groups {
            let rows = usize::try_from(group.num_rows()).map_err(StoreFileFault::damaged)?;
            starts.push(starts.last().copied().unwrap_or(0) + rows);
        }
        // The schema of the columns does not contain the other metadata of the footer.
        let schema = Schema::new(metadata.schema().fields().clone()).into();
        Ok(SealedFile { path: path.to_owned(), metadata, schema, crcs, starts })
    }

    /// Arrow schema.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// Metadata `key` of the footer.
    pub fn text(&self, key: &str) -> Option<&str> {
        text_of(&self.metadata, key)
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Metadata of each row group.
    pub fn row_groups(&self) -> &[RowGroupMetaData] {
        self.metadata.metadata().row_groups()
    }

    /// Parquet schema.
    pub fn parquet_schema(&self) -> &SchemaDescriptor {
        self.metadata.metadata().file_metadata().schema_descr()
    }

    /// First row of each row group, then the total number of rows.
    pub fn starts(&self) -> &[usize] {
        &self.starts
    }

    /// Values of one column of one row group, verified.
    ///
    /// # Errors
    /// Fails if the file is unreadable or damaged.
    pub fn column(&self, group: usize, column: usize) -> Result<ArrayRef, StoreFileFault> {
        self.values(group, column).map_err(|e| doubted(&self.path, e))
    }

    fn values(&self, group: usize, column: usize) -> Result<ArrayRef, StoreFileFault> {
        let metadata = self.metadata.metadata();
        let chunks =
            metadata.row_groups().get(group).ok_or_else(|| StoreFileFault::damaged("a row group is missing"))?;
        let descriptor = metadata.file_metadata().schema_descr();
        let before: usize = metadata.row_groups().iter().take(group).map(|g| g.columns().len()).sum();
        let mut file = File::open(&self.path).map_err(|e| StoreFileFault::io(&e))?;
        let mut windows =
            FileWindows { windows: vec![], size: file.metadata().map_err(|e| StoreFileFault::io(&e))?.len() };
        for (leaf, chunk) in chunks.columns().iter().enumerate() {
            if descriptor.get_column_root_idx(leaf) != column {
                continue;
            }
            let (start, length) = chunk.byte_range();
            if start.checked_add(length).is_none_or(|end| end > windows.size) {
                return Err(StoreFileFault::damaged("it is truncated"));
            }
            let mut bytes = vec![0; usize::try_from(length).map_err(StoreFileFault::damaged)?];
            file.seek(SeekFrom::Start(start)).map_err(|e| StoreFileFault::io(&e))?;
            file.read_exact(&mut bytes).map_err(|e| StoreFileFault::io(&e))?;
            if self.crcs.get(before + leaf) != Some(&crc32fast::hash(&bytes)) {
                return Err(StoreFileFault::damaged(format!(
                    "the checksum of `{}` is wrong",
                    chunk.column_path().string()
                )));
            }
            windows.windows.push((start, bytes.into()));
        }
        let rows = usize::try_from(chunks.num_rows()).map_err(StoreFileFault::damaged)?;
        let mut reader = ParquetRecordBatchReaderBuilder::new_with_metadata(windows, self.metadata.clone())
            .with_projection(ProjectionMask::roots(descriptor, [column]))
            .with_row_groups(vec![group])
            .with_batch_size(rows.max(1))
            .build()
            .map_err(StoreFileFault::damaged)?;
        match reader.next() {
            Some(Ok(batch)) if batch.num_rows() == rows && batch.num_columns() == 1 => Ok(batch.column(0).clone()),
            Some(Err(e)) => Err(StoreFileFault::damaged(e)),
            _ => Err(StoreFileFault::damaged("the number of rows of a row group is wrong")),
        }
    }
}

/// Verified metadata `key` of a file of `size` bytes that ends in `tail`; or, if `tail` is too short, the number of
/// bytes required from the end of the file.
///
/// # Errors
/// Fails if the file is damaged.
pub fn tail_text(tail: Bytes, size: u64, key: &str) -> Result<Result<Option<String>, u64>, StoreFileFault> {
    let cut = || StoreFileFault::damaged("it is truncated");
    let (body, end) = tail.split_last_chunk::<TAIL>().ok_or_else(cut)?;
    let ([a, b, c, d], mark) = end.split_first_chunk::<4>().ok_or_else(cut)?;
    let length = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
    if mark != b"PAR1" {
        return Err(cut());
    }
    let whole = SEAL + length + TAIL;
    let Some(seal) = body.len().checked_sub(SEAL + length) else { return Ok(Err(whole as u64)) };
    let (seal, _) = tail.get(seal..).and_then(|rest| rest.split_first_chunk::<SEAL>()).ok_or_else(cut)?;
    let footer = tail.get(tail.len() - length - TAIL..).ok_or_else(cut)?;
    if &seal[..8] != MARK || seal[12..] != crc32fast::hash(footer).to_le_bytes() {
        return Err(StoreFileFault::damaged("the checksum of its footer is wrong"));
    }
    let start = size.checked_sub(tail.len() as u64).ok_or_else(cut)?;
    let windows = FileWindows { windows: vec![(start, tail.clone())], size };
    let metadata = ArrowReaderMetadata::load(&windows, ArrowReaderOptions::new()).map_err(StoreFileFault::damaged)?;
    Ok(Ok(text_of(&metadata, key).map(str::to_owned)))
}

fn text_of<'a>(metadata: &'a ArrowReaderMetadata, key: &str) -> Option<&'a str> {
    let pairs = metadata.metadata().file_metadata().key_value_metadata()?;
    pairs.iter().find(|kv| kv.key == key)?.value.as_deref()
}

/// Verifies the footer. Returns the number of bytes before the seal and their checksum.
fn footer(file: &mut File) -> Result<(u64, u32), StoreFileFault> {
    let io = |e: io::Error| StoreFileFault::io(&e);
    let size = file.metadata().map_err(io)?.len();
    let cut = || StoreFileFault::damaged(if size == 0 { "it is empty" } else { "it is truncated" });
    let back = |n: usize| i64::try_from(n).map(|n| SeekFrom::End(-n)).map_err(StoreFileFault::damaged);
    if size < (SEAL + TAIL) as u64 {
        return Err(cut());
    }
    let mut tail = [0; TAIL];
    file.seek(back(TAIL)?).map_err(io)?;
    file.read_exact(&mut tail).map_err(io)?;
    let length = u32::from_le_bytes([tail[0], tail[1], tail[2], tail[3]]) as usize;
    let whole = SEAL + length + TAIL;
    if &tail[4..] != b"PAR1" || whole as u64 > size {
        return Err(cut());
    }
    let mut bytes = vec![0; whole];
    file.seek(back(whole)?).map_err(io)?;
    file.read_exact(&mut bytes).map_err(io)?;
    let (seal, footer) = bytes.split_at(SEAL);
    let number = |i: usize| u32::from_le_bytes([seal[i], seal[i + 1], seal[i + 2], seal[i + 3]]);
    if &seal[..8] != MARK || number(12) != crc32fast::hash(footer) {
        return Err(StoreFileFault::damaged("the checksum of its footer is wrong"));
    }
    Ok((size - whole as u64, number(8)))
}

/// Verifies every byte of a file.
///
/// # Errors
/// Fails if the file is missing, unreadable or damaged.
pub fn verify(path: &Path) -> Result<(), StoreFileFault> {
    verified(path).map_err(|e| doubted(path, e))
}

fn verified(path: &Path) -> Result<(), StoreFileFault> {
    let io = |e: io::Error| StoreFileFault::io(&e);
    let mut file = paths::open_regular(path).map_err(io)?;
    let (data, expected) = footer(&mut file)?;
    if sum_of(&file, 0, data).map_err(io)? == expected {
        Ok(())
    } else {
        Err(StoreFileFault::damaged("the checksum of its data is wrong"))
    }
}

/// Parts of a file in memory.
struct FileWindows {
    windows: Vec<(u64, Bytes)>,
    size: u64,
}

impl FileWindows {
    fn from(&self, start: u64) -> parquet::errors::Result<Bytes> {
        let inside = |(from, bytes): &&(u64, Bytes)| (*from..=*from + bytes.len() as u64).contains(&start);
        let found = self.windows.iter().rev().find(inside);
        let (from, bytes) = found
            .ok_or_else(|| ParquetError::General(format!("byte {start} is in none of the columns that were read")))?;
        Ok(bytes.slice(usize::try_from(start - from).unwrap_or(usize::MAX).min(bytes.len())..))
    }
}

impl Length for FileWindows {
    fn len(&self) -> u64 {
        self.size
    }
}

impl ChunkReader for FileWindows {
    type T = bytes::buf::Reader<Bytes>;

    fn get_read(&self, start: u64) -> parquet::errors::Result<Self::T> {
        Ok(self.from(start)?.reader())
    }

    fn get_bytes(&self, start: u64, length: usize) -> parquet::errors::Result<Bytes> {
        let rest = self.from(start)?;
        if rest.len() < length {
            return Err(ParquetError::EOF(format!("{length} bytes at {start}")));
        }
        Ok(rest.slice(..length))
    }
}

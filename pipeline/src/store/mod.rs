//! The store: objects addressed by what they were computed from, and the tables made of them.
//!
//! ```text
//! objects/ab/<key>.parquet   one line of one stage at one sweep point: the columns it made, one row group
//! sources/<key>.json         what a file was found to hold: lines, columns, hashes, faults
//! tables/<pipeline>/<table>/ the published tables, plain Parquet data sets
//! plans/<pipeline>.json      what the tables were last computed from
//! tmp/                       files being written; renamed when they are whole
//! ```
//!
//! A file appears under its final name only when it is complete, so that a run killed at any moment leaves nothing
//! half-written to be read.

mod splice;

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use arrow_array::RecordBatch;
use arrow_schema::{DataType, Schema};
use parquet::{
    arrow::{
        ArrowWriter, ProjectionMask,
        arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder},
    },
    basic::{Compression, Encoding},
    file::properties::{EnabledStatistics, WriterProperties},
    schema::types::ColumnPath,
};
use schemas::Fault;

use crate::keys::Key;
pub use splice::{Piece, RowGroup, splice};

/// The layout of the store; a store of another layout is refused.
const LAYOUT: &str = "magline store 1\n";

/// The folders of a store.
const PARTS: [&str; 5] = ["objects", "sources", "tables", "plans", "tmp"];

/// A store that this process may write to.
pub struct Store {
    root: PathBuf,
    tmp: PathBuf,
    next: AtomicU64,
    // Held as long as the process lives; another process may then sweep the folder.
    _lock: File,
}

fn trouble(doing: &str, path: &Path, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("cannot {doing} {}: {e}", path.display()))
}

impl Store {
    /// Opens the store at `root`, making it where there is none.
    ///
    /// # Errors
    /// When the folder cannot be written or holds something else.
    pub fn open(root: &Path) -> Result<Store, Fault> {
        let fail = |e: io::Error| trouble("open the store", root, &e);
        fs::create_dir_all(root).map_err(fail)?;
        let mark = root.join("STORE");
        match fs::read_to_string(&mark) {
            Ok(text) if text == LAYOUT => {}
            Ok(_) => {
                let fault = Fault::new(format!("{} is a store of another version of magline", root.display()));
                return Err(fault.help("name another folder as `store`"));
            }
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                // A run killed while it made the store leaves some of these folders and no mark.
                let ours = |name: &str| PARTS.contains(&name);
                let entries = fs::read_dir(root).map_err(fail)?.flatten();
                let strange = entries.into_iter().any(|e| !e.file_name().to_str().is_some_and(ours));
                if strange {
                    let fault = Fault::new(format!("{} is a folder, but not a magline store", root.display()));
                    return Err(fault.help("name a new or empty folder as `store`"));
                }
            }
            Err(e) => return Err(fail(e)),
        }
        for part in PARTS {
            fs::create_dir_all(root.join(part)).map_err(fail)?;
        }
        sweep(&root.join("tmp"));
        let (tmp, lock) = own_folder(&root.join("tmp")).map_err(fail)?;
        let store = Store { root: root.to_owned(), tmp, next: AtomicU64::new(0), _lock: lock };
        if !mark.exists() {
            store.write(&mark, LAYOUT.as_bytes())?;
        }
        Ok(store)
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where the object `key` lies or would lie.
    pub fn object(&self, key: Key) -> PathBuf {
        let name = key.to_string();
        self.root.join("objects").join(&name[..2]).join(format!("{name}.parquet"))
    }

    /// Whether the object `key` is there.
    pub fn has(&self, key: Key) -> bool {
        self.object(key).is_file()
    }

    /// The folder of one published table.
    pub fn table(&self, pipeline: &str, table: &str) -> PathBuf {
        self.root.join("tables").join(pipeline).join(table)
    }

    /// A name for a file being written.
    pub fn temporary(&self) -> PathBuf {
        self.tmp.join(self.next.fetch_add(1, Ordering::Relaxed).to_string())
    }

    /// Gives a file that is whole its final name.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn settle(&self, from: &Path, to: &Path) -> Result<(), Fault> {
        let fail = |e: io::Error| trouble("write", to, &e);
        if let Some(folder) = to.parent() {
            fs::create_dir_all(folder).map_err(fail)?;
        }
        fs::rename(from, to).map_err(fail)
    }

    /// Writes a small file whole.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn write(&self, to: &Path, bytes: &[u8]) -> Result<(), Fault> {
        let tmp = self.temporary();
        File::create(&tmp).and_then(|mut f| f.write_all(bytes)).map_err(|e| trouble("write", &tmp, &e))?;
        self.settle(&tmp, to)
    }

    /// Writes one batch as the object `key`: one row group.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn put(&self, key: Key, batch: &RecordBatch) -> Result<(), Fault> {
        let tmp = self.temporary();
        write_parquet(&tmp, batch)?;
        self.settle(&tmp, &self.object(key))
    }

    /// The columns `columns` of the object `key`, as one contiguous batch.
    ///
    /// # Errors
    /// When the object is missing, damaged or lacks a column.
    pub fn get<S: AsRef<str>>(&self, key: Key, columns: &[S]) -> Result<RecordBatch, Fault> {
        read_columns(&self.object(key), columns)
    }

    /// All columns of the object `key`, as one contiguous batch, with what their fields say.
    ///
    /// # Errors
    /// When the object is missing or damaged.
    pub fn whole(&self, key: Key) -> Result<RecordBatch, Fault> {
        let path = self.object(key);
        let fail = |e: &dyn std::fmt::Display| trouble("read", &path, e).help(DAMAGED);
        let file = File::open(&path).map_err(|e| fail(&e))?;
        let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new()).map_err(|e| fail(&e))?;
        let names: Vec<String> = metadata.schema().fields().iter().map(|f| f.name().clone()).collect();
        read_columns(&path, &names)
    }
}

/// The way out of a damaged store.
const DAMAGED: &str = "the store is damaged; remove the file, and it is computed again";

impl Drop for Store {
    fn drop(&mut self) {
        // What is left there was never given a name; a sweep by the next process does the same.
        let _ = fs::remove_dir_all(&self.tmp);
    }
}

/// A folder for this process' unfinished files, marked by a lock it holds.
fn own_folder(tmp: &Path) -> io::Result<(PathBuf, File)> {
    for n in 0..1000u32 {
        let folder = tmp.join(format!("{}-{n}", std::process::id()));
        match fs::create_dir(&folder) {
            Ok(()) => {
                // Another process may sweep the folder away until the lock is held; then the next name is tried.
                let Ok(lock) = File::create(folder.join("lock")) else { continue };
                lock.lock()?;
                if folder.join("lock").exists() {
                    return Ok((folder, lock));
                }
            }
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e),
        }
    }
    Err(io::Error::other("no free name"))
}

/// Removes what killed processes left: folders whose lock nobody holds.
fn sweep(tmp: &Path) {
    for folder in fs::read_dir(tmp).into_iter().flatten().flatten() {
        match File::open(folder.path().join("lock")) {
            Ok(lock) if lock.try_lock().is_ok() => {
                let _ = fs::remove_dir_all(folder.path());
            }
            Ok(_) => {}
            // Killed before it made the lock: the folder is empty, and only then it goes.
            Err(_) => {
                let _ = fs::remove_dir(folder.path());
            }
        }
    }
}

/// Writes one batch as a Parquet file of one row group; the same batch gives the same bytes.
///
/// # Errors
/// When the file system refuses.
pub fn write_parquet(path: &Path, batch: &RecordBatch) -> Result<(), Fault> {
    let fail = |e: &dyn std::fmt::Display| trouble("write", path, e);
    let file = File::create(path).map_err(|e| fail(&e))?;
    let mut writer = ArrowWriter::try_new(io::BufWriter::new(file), batch.schema(), Some(properties(&batch.schema())))
        .map_err(|e| fail(&e))?;
    writer.write(batch).map_err(|e| fail(&e))?;
    let file = writer.into_inner().map_err(|e| fail(&e))?;
    file.into_inner().map_err(|e| fail(&e))?;
    Ok(())
}

/// How everything in the store is encoded: identifiers by dictionary, numbers with their bytes split into streams, which
/// makes the slow columns of a flight a third smaller at the speed of a copy.
fn properties(schema: &Schema) -> WriterProperties {
    let mut properties = WriterProperties::builder()
        .set_created_by("magline".to_owned())
        .set_compression(Compression::LZ4_RAW)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true)
        .set_max_row_group_row_count(None);
    for field in schema.fields() {
        match field.data_type() {
            DataType::Float64 => {
                let leaf = ColumnPath::from(field.name().as_str());
                properties = properties
                    .set_column_dictionary_enabled(leaf.clone(), false)
                    .set_column_encoding(leaf, Encoding::BYTE_STREAM_SPLIT);
            }
            DataType::FixedSizeList(_, _) => {
                let leaf = ColumnPath::new(vec![field.name().clone(), "list".into(), "item".into()]);
                properties = properties
                    .set_column_dictionary_enabled(leaf.clone(), false)
                    .set_column_encoding(leaf.clone(), Encoding::BYTE_STREAM_SPLIT)
                    .set_column_statistics_enabled(leaf, EnabledStatistics::None);
            }
            _ => {}
        }
    }
    properties.build()
}

/// The columns `columns` of a Parquet file, in that order, as one batch.
///
/// # Errors
/// When the file is missing or damaged, or lacks a column.
pub fn read_columns<S: AsRef<str>>(path: &Path, columns: &[S]) -> Result<RecordBatch, Fault> {
    let fail = |e: &dyn std::fmt::Display| trouble("read", path, e).help(DAMAGED);
    let file = File::open(path).map_err(|e| fail(&e))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new()).map_err(|e| fail(&e))?;
    let rows = usize::try_from(metadata.metadata().file_metadata().num_rows()).unwrap_or(0);
    let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata);
    let schema = builder.schema().clone();
    // By position: a mask of names takes the dots of a name for a path.
    let wanted = columns.iter().filter_map(|c| schema.index_of(c.as_ref()).ok());
    let mask = ProjectionMask::roots(builder.parquet_schema(), wanted);
    let reader = builder.with_projection(mask).with_batch_size(rows.max(1)).build().map_err(|e| fail(&e))?;
    let batches = reader.collect::<Result<Vec<_>, _>>().map_err(|e| fail(&e))?;
    let whole = match batches.as_slice() {
        [one] => one.clone(),
        many => {
            let schema = many.first().map_or(schema, RecordBatch::schema);
            arrow_select::concat::concat_batches(&schema, many).map_err(|e| fail(&e))?
        }
    };
    let order = columns.iter().map(|c| whole.schema().index_of(c.as_ref())).collect::<Result<Vec<_>, _>>();
    whole.project(&order.map_err(|e| fail(&e))?).map_err(|e| fail(&e))
}

//! Store: results, addressed by their inputs, and the tables built from them.
//!
//! ```text
//! objects/ab/<id>.parquet     packs: the rows of several units of one table, ordinary Parquet with checksums
//! index                       the pack of each unit; only saves reading the packs' footers
//! sources/<key>.json          the contents of a file: lines, columns, hashes, faults
//! quality/<key>/              quality measures of the file
//! versions/<pipeline>/<n>/    one published state: a folder per table, its files linked from the packs
//! tables/<pipeline>           a link to the newest version, replaced in one step
//! plans/<pipeline>.json       the inputs of the last computation of the tables
//! plans/<hash>                a plan with its lines and keys, for workers of other processes
//! runs/<pipeline>.jsonl       the history of its runs
//! costs/<pipeline>.json        measured costs of its tables, for `explain --cost`; keys do not depend on them
//! checkpoints/<key>           the state of a unit that takes minutes, until it is done
//! attempts/<name>             units that another process computes, or during which its worker was lost
//! damaged/                    packs whose verification failed
//! locks/                      per pipeline a file that its run locks, and the lease that names the holder
//! tmp/                        files being written; renamed when complete
//! ```
//!
//! A file gets its final name only when it is complete and on the disk. Partial files that a killed run or a power loss
//! leaves are therefore never read. Only `tables/<pipeline>` is ever replaced under the same name, so a reader keeps
//! the version it opened.
//!
//! A store in an object store has the same layout below an address. The folder of such a store is a copy: see `remote`.

pub mod arithmetic;
pub mod attempts;
mod catalogue;
mod checkpoints;
pub mod checksums;
pub mod clock;
mod folders;
mod lock;
mod mirror;
pub mod note;
mod objects;
mod plans;
mod remote;
pub mod scrub;
mod sealed;
pub mod tend;
#[cfg(test)]
mod tests;
mod unfinished;
mod version;

use std::{
    fs::{self, File},
    io::{self, Write},
    ops::Deref,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use arrow_array::RecordBatch;
use arrow_schema::{DataType, SchemaRef};
use arrow_select::concat::concat_batches;
use schemas::{Fault, FaultOwner, keys::HashKey, paths};

pub use catalogue::{FAILED, PackCatalogue, PackedUnit, RowLocation, StorePack};
use catalogue::{UNITS, stamp};
pub use folders::{make_folder, own_file, sync_folder};
pub use lock::{ForeignLock, LockHolder, LockOutcome, PipelineLock, generation, host};
use objects::{NOTES, UnitNote};
pub use objects::{PackReader, Remarks};
use remote::RemoteStore;
pub use remote::{attach, is_copy, located, prepared, shown, shown_below};
pub use sealed::{SealedFile, verify};
use unfinished::keep_lock;
pub use unfinished::kernel;
pub use unfinished::{own_folder, sweep};
pub use version::{ExtraTable, Manifest, ManifestTable, TableFiles, Version, current, parts, published, versions};

/// Folder of the costs of runs.
pub const COSTS: &str = "costs";

/// Layout of the store; a store of another layout is rejected.
const LAYOUT: &str = "magline store 3\n";

/// Folders of a store.
const PARTS: [&str; 13] = [
    "objects",
    "sources",
    "quality",
    "tables",
    "versions",
    "plans",
    "runs",
    attempts::FOLDER,
    checkpoints::FOLDER,
    COSTS,
    "damaged",
    "locks",
    "tmp",
];

/// Number of rows of a row group; a group has fewer if it holds a single unit or if its rows are wide.
pub const GROUP_ROWS: usize = 100_000;
/// Size of a row group in memory, in bytes.
const GROUP_BYTES: usize = 32 << 20;

/// Store that this process may write to.
pub struct Store {
    root: PathBuf,
    objects: PackReader,
    tmp: PathBuf,
    next: AtomicU64,
    // Shared lock of all processes that use the store.
    shared: File,
    // Lock on the folder `tmp`; after the end of the process, another process may remove the folder.
    _lock: File,
}

impl Deref for Store {
    type Target = PackReader;
    fn deref(&self) -> &PackReader {
        &self.objects
    }
}

/// Unit to write into a pack.
pub struct NewUnit {
    /// Key of the unit.
    pub key: HashKey,
    /// Hash of the unit's other columns: see [`PackedUnit`].
    pub passthrough_hash: u64,
    /// Rows in the schema of the pack, or the fault of the computation.
    pub rows: Result<RecordBatch, Fault>,
    /// Notes attached to the result: skipped lines and warnings.
    pub remarks: Remarks,
}

/// Exclusive lock of one process on a store.
pub struct ExclusiveStoreLock<'a>(&'a File);

impl Drop for ExclusiveStoreLock<'_> {
    fn drop(&mut self) {
        // If the change to a shared lock fails, the lock stays exclusive until the process ends.
        let _ = self.0.lock_shared();
    }
}

/// Checks the name of a pipeline, which is used in paths of the store.
///
/// # Errors
/// Fails for a name that is invalid in a spec.
pub fn pipeline_name(name: &str) -> Result<(), Fault> {
    paths::check_name(name).map_err(|why| Fault::new(format!("`{name}` is not a valid name of a pipeline")).help(why))
}

fn io_fault(doing: &str, path: &Path, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("cannot {doing} {}: {e}", path.display()))
}

impl Store {
    /// Opens the store at `root`; creates it if absent.
    ///
    /// # Errors
    /// Fails if the folder cannot be written or is not a store.
    pub fn open(root: &Path) -> Result<Store, Fault> {
        if let Some(remote) = RemoteStore::from_cache(root)?
            && !remote.pull()?
        {
            remote.only_ours()?;
        }
        Store::opened(root, PackReader::open)
    }

    /// Opens the store at `root` for a worker, with the packs that the driver has listed in the index.
    /// [`PackReader::adopt`] adds packs that the index does not list.
    ///
    /// # Errors
    /// Fails if there is no store, or the folder cannot be written.
    pub fn join(root: &Path) -> Result<Store, Fault> {
        // A worker does not use the files that change, so they are not copied.
        let there = match RemoteStore::from_cache(root)? {
            Some(remote) => remote.is_there()?,
            None => root.join("STORE").is_file(),
        };
        if !there {
            let fault = Fault::new(format!("there is no store {}", shown(root)));
            return Err(fault.help("give its folder or address with `--store`"));
        }
        Store::opened(root, PackReader::indexed)
    }

    fn opened(root: &Path, packs: fn(&Path) -> Result<PackReader, Fault>) -> Result<Store, Fault> {
        let fail = |e: io::Error| io_fault("open the store", root, &e);
        fs::create_dir_all(root).map_err(fail)?;
        let mark = root.join("STORE");
        let marked = match paths::read_regular(&mark) {
            Ok(bytes) if bytes == LAYOUT.as_bytes() => true,
            Ok(bytes) if is_other_layout(&bytes) => {
                let fault = Fault::new(format!("{} is a store of another version of magline", root.display()));
                return Err(fault.help("use another folder as `store`"));
            }
            // A damaged mark is rewritten if everything else matches a store.
            Ok(_) => false,
            Err(e) if e.kind() == io::ErrorKind::NotFound => false,
            Err(e) => return Err(fail(e)),
        };
        if !marked {
            // A run killed while creating the store leaves some of these folders and no mark.
            let ours = |name: &str| PARTS.contains(&name) || ["STORE", "index", remote::MARK].contains(&name);
            let entries = fs::read_dir(root).map_err(fail)?.flatten();
            let strange = entries.into_iter().any(|e| !e.file_name().to_str().is_some_and(ours));
            if strange {
                let fault = Fault::new(format!("{} is a folder, but not a magline store", root.display()));
                return Err(fault.help("use a new or empty folder as `store`"));
            }
        }
        // A link may lead to a folder that must not be written to.
        for part in PARTS {
            let folder = root.join(part);
            paths::check_no_link(root, &folder).and_then(|()| fs::create_dir_all(&folder)).map_err(fail)?;
        }
        sweep(&root.join("tmp"));
        let (tmp, lock) = own_folder(&root.join("tmp")).map_err(fail)?;
        let shared = root.join("locks").join("store");
        let shared = own_file(root, &shared, File::options().write(true).create(true).truncate(true));
        let shared = shared.and_then(|f| keep_lock(&f, true).map(|()| f)).map_err(fail)?;
        let objects = packs(root)?;
        let store = Store { root: root.to_owned(), objects, tmp, next: AtomicU64::new(0), shared, _lock: lock };
        if !marked {
            store.write(&mark, LAYOUT.as_bytes())?;
        }
        Ok(store)
    }

    /// Takes the exclusive lock on the store until the result is dropped; `None` if another process uses the store.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn alone(&self) -> Result<Option<ExclusiveStoreLock<'_>>, Fault> {
        // The shared lock becomes exclusive. If that fails, the shared lock may be lost, so it is taken again.
        match self.shared.try_lock() {
            Ok(()) => Ok(Some(ExclusiveStoreLock(&self.shared))),
            Err(fs::TryLockError::WouldBlock) => {
                self.shared.lock_shared().map_err(|e| io_fault("lock", &self.root, &e))?;
                Ok(None)
            }
            // Without locks, other processes cannot be detected.
            Err(fs::TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => Ok(None),
            Err(fs::TryLockError::Error(e)) => Err(io_fault("lock", &self.root, &e)),
        }
    }

    /// Folder of the store.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Folder of one published table.
    pub fn table(&self, pipeline: &str, table: &str) -> PathBuf {
        self.root.join("tables").join(pipeline).join(table)
    }

    /// Name for a temporary file.
    pub fn temporary(&self) -> PathBuf {
        self.tmp.join(self.next.fetch_add(1, Ordering::Relaxed).to_string())
    }

    /// Object store of which the folder is a copy; `None` for a store on disk.
    fn remote(&self) -> Option<&Arc<RemoteStore>> {
        self.objects.remote()
    }

    /// Whether the folder is the copy of an object store.
    pub fn is_copy(&self) -> bool {
        self.remote().is_some()
    }

    /// Copies a file of the store, if it exists, into the folder.
    ///
    /// # Errors
    /// Fails if an object store cannot be reached or reports an error.
    pub fn bring(&self, file: &Path) -> Result<(), Fault> {
        let key = file.strip_prefix(&self.root).ok().and_then(RemoteStore::key);
        self.remote().zip(key).map_or(Ok(()), |(remote, key)| remote.bring_file(&key).map(drop))
    }

    /// Renames a complete file to its final name. The name is on the disk on return.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn settle(&self, from: &Path, to: &Path) -> Result<(), Fault> {
        let fail = |e: io::Error| io_fault("write", to, &e);
        if let (Some(remote), Some(key)) = (self.remote(), to.strip_prefix(&self.root).ok().and_then(RemoteStore::key))
        {
            remote.bucket().put_file(&key, from)?;
        }
        if let Some(folder) = to.parent() {
            if folder.starts_with(&self.root) {
                paths::check_no_link(&self.root, folder).map_err(fail)?;
            }
            make_folder(folder).map_err(fail)?;
            fs::rename(from, to).map_err(fail)?;
            return sync_folder(folder).map_err(fail);
        }
        fs::rename(from, to).map_err(fail)
    }

    /// Writes a small file atomically.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn write(&self, to: &Path, bytes: &[u8]) -> Result<(), Fault> {
        let tmp = self.temporary();
        let written = File::create(&tmp).and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_all()));
        written.map_err(|e| io_fault("write", &tmp, &e))?;
        self.settle(&tmp, to)
    }

    /// Writes one batch as a Parquet file at `to`, one row group per [`GROUP_ROWS`].
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn write_table(&self, to: &Path, batch: &RecordBatch, about: &[(String, String)]) -> Result<(), Fault> {
        let step = GROUP_ROWS;
        let groups = (0..batch.num_rows()).step_by(step).map(|i| Ok(batch.slice(i, step.min(batch.num_rows() - i))));
        sealed::write(to, &batch.schema(), about, groups)
    }

    /// Writes one batch as the unit `key`, in a separate pack.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn put(&self, key: HashKey, batch: &RecordBatch) -> Result<(), Fault> {
        self.put_all(&[(key, batch.clone())])
    }

    /// Writes some batches of one schema as units, in one separate pack.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn put_all(&self, batches: &[(HashKey, RecordBatch)]) -> Result<(), Fault> {
        let Some((_, first)) = batches.first() else { return Ok(()) };
        let unit = |(key, batch): &(HashKey, RecordBatch)| NewUnit {
            key: *key,
            passthrough_hash: 0,
            rows: Ok(batch.clone()),
            remarks: Remarks::default(),
        };
        let id = HashKey::from_parts(
            std::iter::once("source".to_owned()).chain(batches.iter().map(|(key, _)| key.to_string())),
        );
        self.pack(id, HashKey::from_parts(["source"]), &first.schema(), &[], batches.iter().map(unit).collect())
    }

    /// Writes a pack: the rows of its units one after another, in row groups that end at the end of a unit if possible.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn pack(
        &self,
        id: HashKey,
        kind: HashKey,
        schema: &SchemaRef,
        about: &[(String, String)],
        units: Vec<NewUnit>,
    ) -> Result<(), Fault> {
        let rows_of = |unit: &NewUnit| unit.rows.as_ref().map_or(Ok(FAILED), |b| u32::try_from(b.num_rows()));
        let listed = units.iter().map(|u| {
            let rows = rows_of(u).map_err(|_| Fault::data("more than 4,294,967,294 rows"))?;
            Ok(PackedUnit { key: u.key, passthrough_hash: u.passthrough_hash, rows })
        });
        let listed: Vec<PackedUnit> = listed.collect::<Result<_, Fault>>()?;
        let notes: Vec<UnitNote> = units.iter().enumerate().filter_map(|(i, u)| note(i, u)).collect();
        let mut about = about.to_vec();
        about.push((UNITS.to_owned(), catalogue::spell(kind, &listed)));
        if !notes.is_empty() {
            let text = serde_json::to_string(&notes).map_err(|e| Fault::machine(e.to_string()))?;
            about.push((NOTES.to_owned(), text));
        }
        let batches: Vec<RecordBatch> = units.into_iter().filter_map(|u| u.rows.ok()).collect();
        let tmp = self.temporary();
        let mut group = 0;
        let groups = grouped(schema, batches).inspect(|batch: &Result<RecordBatch, Fault>| {
            if let Ok(batch) = batch {
                for (column, array) in batch.columns().iter().enumerate() {
                    self.objects.hold(id, group, column, array);
                }
                group += 1;
            }
        });
        sealed::write(&tmp, schema, &about, groups)?;
        let to = self.objects.file(id);
        self.settle(&tmp, &to)?;
        let about = fs::metadata(&to).map_err(|e| io_fault("read", &to, &e))?;
        let (size, modified_ns) = stamp(&about);
        // The modification time of a copy has no meaning.
        let modified_ns = if self.remote().is_some() { 0 } else { modified_ns };
        self.objects.add(StorePack { id, size, modified_ns, kind, units: listed });
        Ok(())
    }

    /// Writes the index if packs were added or removed.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn write_index(&self) -> Result<(), Fault> {
        let bytes = self.objects.catalogue_mut().to_write();
        bytes.map_or(Ok(()), |bytes| self.write(&self.root.join("index"), &bytes))
    }
}

/// Updates the copy of an object store in the folder `root`, before the folder is read. Does nothing for other stores.
///
/// # Errors
/// Fails if the object store cannot be reached or reports an error.
pub fn pulled(root: &Path) -> Result<(), Fault> {
    RemoteStore::from_cache(root)?.map_or(Ok(()), |remote| remote.pull().map(drop))
}

/// Whether a mark belongs to another layout. A mark with one flipped bit counts as damaged, not as another layout.
fn is_other_layout(bytes: &[u8]) -> bool {
    let differ = bytes.iter().zip(LAYOUT.as_bytes()).map(|(a, b)| (a ^ b).count_ones()).sum::<u32>();
    let number = bytes.strip_prefix(b"magline store ").and_then(|n| n.strip_suffix(b"\n"));
    bytes.len() != LAYOUT.len() || differ > 1 || number.is_some_and(|n| n == b"1")
}

fn note(unit: usize, new: &NewUnit) -> Option<UnitNote> {
    // A later run reports a stored fault as a fault of the data.
    let stored = |fault: &Fault| Fault { owner: FaultOwner::Data, ..fault.clone() };
    let failed = new.rows.as_ref().err().map(stored);
    let left_out = new.remarks.left_out.iter().map(stored).collect::<Vec<_>>();
    let warnings = new.remarks.warnings.clone();
    let any = failed.is_some() || !left_out.is_empty() || !warnings.is_empty();
    any.then_some(UnitNote { unit, failed, left_out, warnings })
}

/// Approximate size of a row in memory, in bytes.
pub fn row_bytes(schema: &SchemaRef) -> usize {
    let one = |kind: &DataType| match kind {
        DataType::FixedSizeList(_, n) => 8 * usize::try_from(*n).unwrap_or(0),
        DataType::List(_) => 256,
        DataType::Utf8 => 16,
        _ => 8,
    };
    schema.fields().iter().map(|f| one(f.data_type())).sum::<usize>().max(1)
}

/// Batches merged or split into row groups.
fn grouped(schema: &SchemaRef, batches: Vec<RecordBatch>) -> impl Iterator<Item = Result<RecordBatch, Fault>> {
    let most = (GROUP_BYTES / row_bytes(schema)).clamp(1, GROUP_ROWS);
    let mut groups: Vec<Vec<RecordBatch>> = vec![];
    let mut rows = 0;
    for batch in batches.into_iter().filter(|b| b.num_rows() > 0) {
        let n = batch.num_rows();
        for from in (0..n).step_by(most) {
            let part = batch.slice(from, most.min(n - from));
            if groups.is_empty() || rows + part.num_rows() > most {
                groups.push(vec![]);
                rows = 0;
            }
            rows += part.num_rows();
            groups.last_mut().into_iter().for_each(|g| g.push(part.clone()));
        }
    }
    let schema = Arc::clone(schema);
    groups.into_iter().map(move |g| match g.as_slice() {
        [one] => Ok(one.clone()),
        many => concat_batches(&schema, many).map_err(|e| Fault::machine(e.to_string())),
    })
}

impl Drop for Store {
    fn drop(&mut self) {
        // The files in this folder never got a final name; otherwise, the next process would remove them.
        unfinished::remove(&self.tmp);
    }
}

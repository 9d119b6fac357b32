//! Reading of results: columns of units, from the packs that hold them.
//!
//! Every decoded byte is verified with its checksum. A pack whose verification fails is moved to the folder `damaged`
//! and removed from the catalogue; its units are recomputed.

use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard},
};

use arrow_array::{Array, ArrayRef, RecordBatch, RecordBatchOptions};
use arrow_schema::{Field, Schema, SchemaRef};
use buckets::each;
use schemas::{Fault, keys::HashKey};
use serde::{Deserialize, Serialize};

use super::{
    catalogue::{self, PackCatalogue, RowLocation, StorePack},
    remote::RemoteStore,
    sealed::{SealedFile, StoreFileFault},
};

/// Size of the cache of decoded columns, in bytes.
const HELD_BYTES: usize = 16 << 20;
/// Number of cached footers.
const HELD_FOOTERS: usize = 64;
/// Metadata key of the notes on units in a pack's footer.
pub const NOTES: &str = "magline.notes";

/// Note on a unit, in the footer of its pack.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct UnitNote {
    /// Position of the unit in the pack.
    pub unit: usize,
    /// Fault of a unit that could not be computed.
    pub failed: Option<Fault>,
    /// Lines that a survey stage skipped, with the reasons.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<Fault>,
    /// Warnings about untrustworthy results, one sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// Notes attached to the result of a unit.
#[derive(Clone, Debug, Default)]
pub struct Remarks {
    /// Lines that a survey stage skipped, with the reasons.
    pub left_out: Vec<Fault>,
    /// Warnings about untrustworthy results, one sentence each.
    pub warnings: Vec<String>,
}

/// Decoded columns by pack, row group and column.
#[derive(Default)]
struct PackColumnCache {
    columns: HashMap<(HashKey, usize, usize), ArrayRef>,
    bytes: usize,
}

/// Verified footer of a pack, with the notes on its units.
struct PackFooter {
    sealed: SealedFile,
    notes: HashMap<usize, UnitNote>,
}

/// Reader of the packs of a store.
pub struct PackReader {
    root: PathBuf,
    /// Object store of which the folder is a copy.
    remote: Option<Arc<RemoteStore>>,
    catalogue: RwLock<PackCatalogue>,
    footers: Mutex<HashMap<HashKey, Arc<PackFooter>>>,
    held: Mutex<PackColumnCache>,
    damaged: Mutex<Vec<String>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PackReader {
    /// Opens the packs of the store at `root`.
    ///
    /// # Errors
    /// Fails if the folder cannot be read.
    pub fn open(root: &Path) -> Result<PackReader, Fault> {
        let remote = RemoteStore::from_cache(root)?;
        let (catalogue, damaged) = match &remote {
            Some(remote) => PackCatalogue::of_remote(root, remote)?,
            None => PackCatalogue::open(root)
                .map_err(|e| Fault::machine(format!("cannot read the store {}: {e}", root.display())))?,
        };
        let objects = PackReader::new(root, catalogue, remote);
        damaged.into_iter().for_each(|(id, why)| objects.set_aside(id, &why));
        Ok(objects)
    }

    /// Opens the packs in the index of the store at `root`, or all packs if it has no index.
    ///
    /// # Errors
    /// Fails if the folder cannot be read.
    pub fn indexed(root: &Path) -> Result<PackReader, Fault> {
        let remote = RemoteStore::from_cache(root)?;
        let known = match &remote {
            Some(remote) => remote.index()?.map(PackCatalogue::of_packs),
            None => PackCatalogue::indexed(root),
        };
        known.map_or_else(|| PackReader::open(root), |known| Ok(PackReader::new(root, known, remote)))
    }

    fn new(root: &Path, catalogue: PackCatalogue, remote: Option<Arc<RemoteStore>>) -> PackReader {
        PackReader {
            root: root.to_owned(),
            remote,
            catalogue: RwLock::new(catalogue),
            footers: Mutex::default(),
            held: Mutex::default(),
            damaged: Mutex::default(),
        }
    }

    /// Object store of which the folder is a copy, if any.
    pub(super) fn remote(&self) -> Option<&Arc<RemoteStore>> {
        self.remote.as_ref()
    }

    /// Copies the file of a pack into the folder if the file is missing.
    ///
    /// # Errors
    /// Fails if an object store cannot be reached or reports an error, or holds different bytes.
    pub(super) fn at_hand(&self, id: HashKey) -> Result<(), Fault> {
        self.reading(id, || Ok(()))
    }

    /// Reads from the file of a pack. For an object store, copies the file first, and again if the copy is damaged.
    fn reading<T>(&self, id: HashKey, read: impl Fn() -> Result<T, StoreFileFault>) -> Result<T, Fault> {
        let Some(remote) = &self.remote else { return read().map_err(|e| self.fault(id, &e)) };
        let size = self.catalogue().by_id(id).map(|pack| pack.size);
        let first = remote.bring(id, size).and_then(|()| read());
        let done = match first {
            Err(StoreFileFault::Damaged(_) | StoreFileFault::Gone) => remote.bring_again(id).and_then(|()| read()),
            done => done,
        };
        done.map_err(|e| self.fault(id, &e))
    }

    /// Adds the pack `id` of another process to the catalogue. Returns whether the pack exists and is intact.
    pub fn adopt(&self, id: HashKey) -> bool {
        if self.catalogue().by_id(id).is_some() {
            return true;
        }
        let found = match &self.remote {
            Some(remote) => remote.pack(id, None),
            None => match fs::metadata(self.file(id)) {
                Ok(about) => catalogue::read(&self.root, id, catalogue::stamp(&about)),
                Err(_) => return false,
            },
        };
        match found {
            Ok(pack) => {
                self.add(pack);
                true
            }
            Err(StoreFileFault::Damaged(why)) => {
                self.set_aside(id, &why);
                false
            }
            Err(StoreFileFault::Gone | StoreFileFault::Machine(_)) => false,
        }
    }

    /// Adds all packs of other processes to the catalogue.
    pub fn refresh(&self) {
        if let Some(remote) = &self.remote {
            let mut unknown: Vec<HashKey> = remote.packs().unwrap_or_default().into_iter().map(|(id, _)| id).collect();
            unknown.retain(|id| self.catalogue().by_id(*id).is_none());
            // Unreadable packs are not added.
            let _ = each(&unknown, |id| Ok(self.adopt(*id)));
            return;
        }
        let folders = fs::read_dir(self.root.join("objects")).into_iter().flatten().flatten();
        for file in folders.flat_map(|folder| fs::read_dir(folder.path()).into_iter().flatten().flatten()) {
            let name = file.file_name();
            if let Some(id) = name.to_str().and_then(|n| n.strip_suffix(".parquet")).and_then(HashKey::parse) {
                self.adopt(id);
            }
        }
    }

    /// Catalogue, for reading.
    pub fn catalogue(&self) -> RwLockReadGuard<'_, PackCatalogue> {
        self.catalogue.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Catalogue, for changes.
    pub(super) fn catalogue_mut(&self) -> RwLockWriteGuard<'_, PackCatalogue> {
        self.catalogue.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// File of a pack.
    pub fn file(&self, id: HashKey) -> PathBuf {
        catalogue::path(&self.root, id)
    }

    /// Whether the unit `key` was computed and is available.
    pub fn has(&self, key: HashKey) -> bool {
        self.find(key).is_some_and(|p| p.rows.is_some())
    }

    /// Location of the unit `key`.
    pub fn find(&self, key: HashKey) -> Option<RowLocation> {
        self.catalogue().find(key)
    }

    /// Packs whose verification has failed since the store was opened.
    pub fn damaged(&self) -> Vec<String> {
        locked(&self.damaged).clone()
    }

    /// Quarantines a pack and removes it from the catalogue.
    pub fn set_aside(&self, id: HashKey, why: &str) {
        let from = self.file(id);
        let aside = self.root.join("damaged");
        let moved = fs::create_dir_all(&aside).and_then(|()| fs::rename(&from, aside.join(format!("{id}.parquet"))));
        self.catalogue_mut().remove(id);
        if let Some(remote) = &self.remote {
            remote.set_aside(id);
        }
        locked(&self.footers).remove(&id);
        locked(&self.held).columns.retain(|(pack, ..), _| *pack != id);
        // Another thread may have found the same damage.
        if moved.is_ok() || from.exists() || self.remote.is_some() {
            let text = format!("{}: {why}", from.display());
            let mut damaged = locked(&self.damaged);
            if !damaged.contains(&text) {
                damaged.push(text);
            }
        }
    }

    /// Fault for an unreadable pack; a damaged or missing pack is removed from the catalogue.
    fn fault(&self, id: HashKey, reason: &StoreFileFault) -> Fault {
        let path = self.file(id);
        match reason {
            StoreFileFault::Damaged(why) => self.set_aside(id, why),
            StoreFileFault::Gone => {
                self.catalogue_mut().remove(id);
                locked(&self.damaged).push(format!("{}: {reason}", path.display()));
            }
            StoreFileFault::Machine(_) => {}
        }
        Fault::machine(format!("cannot read {}: {reason}", path.display()))
            .help("run the spec again to recompute damaged results")
    }

    /// Footer of a pack.
    fn footer(&self, id: HashKey) -> Result<Arc<PackFooter>, Fault> {
        if let Some(known) = locked(&self.footers).get(&id) {
            return Ok(known.clone());
        }
        let sealed = self.reading(id, || SealedFile::open(&self.file(id)))?;
        let notes: Vec<UnitNote> = match sealed.text(NOTES) {
            Some(text) => serde_json::from_str(text).map_err(|e| Fault::machine(e.to_string()))?,
            None => vec![],
        };
        let opened = Arc::new(PackFooter { sealed, notes: notes.into_iter().map(|n| (n.unit, n)).collect() });
        let mut footers = locked(&self.footers);
        if footers.len() >= HELD_FOOTERS {
            footers.clear();
        }
        footers.insert(id, opened.clone());
        Ok(opened)
    }

    /// Pack and location of a unit.
    fn place(&self, key: HashKey) -> Result<(HashKey, RowLocation), Fault> {
        let look = || {
            let catalogue = self.catalogue();
            catalogue.find(key).and_then(|p| Some((catalogue.pack(p.pack)?.id, p)))
        };
        let found = look().or_else(|| {
            // The index in an object store lists only the packs that its last writer knew.
            self.remote.is_some().then(|| self.refresh()).and_then(|()| look())
        });
        found.ok_or_else(|| {
            Fault::machine(format!("the store no longer contains {key}"))
                .help("run the spec again to recompute missing results")
        })
    }

    fn column(&self, id: HashKey, sealed: &SealedFile, group: usize, column: usize) -> Result<ArrayRef, Fault> {
        if let Some(array) = locked(&self.held).columns.get(&(id, group, column)) {
            return Ok(array.clone());
        }
        let array = self.reading(id, || sealed.column(group, column))?;
        self.hold(id, group, column, &array);
        Ok(array)
    }

    /// Caches a decoded column.
    pub(super) fn hold(&self, id: HashKey, group: usize, column: usize, array: &ArrayRef) {
        let mut held = locked(&self.held);
        let bytes = array.get_array_memory_size();
        if held.bytes + bytes > HELD_BYTES {
            *held = PackColumnCache::default();
        }
        if bytes <= HELD_BYTES {
            held.bytes += bytes;
            held.columns.insert((id, group, column), array.clone());
        }
    }

    /// Reads `rows` rows of a column of a pack, from row `first`.
    fn rows(
        &self,
        id: HashKey,
        sealed: &SealedFile,
        column: usize,
        first: usize,
        rows: usize,
    ) -> Result<ArrayRef, Fault> {
        let starts = sealed.starts();
        let mut parts = vec![];
        let begin = starts.partition_point(|s| *s <= first).saturating_sub(1);
        for (group, span) in starts.windows(2).enumerate().skip(begin) {
            let (from, to) = (first.max(span[0]), (first + rows).min(span[1]));
            if from < to {
                parts.push(self.column(id, sealed, group, column)?.slice(from - span[0], to - from));
            } else if span[0] >= first + rows {
                break;
            }
        }
        match parts.as_slice() {
            [one] => Ok(one.clone()),
            [] => Ok(arrow_array::new_empty_array(sealed.schema().field(column).data_type())),
            many => {
                let parts: Vec<&dyn Array> = many.iter().map(AsRef::as_ref).collect();
                arrow_select::concat::concat(&parts).map_err(|e| Fault::machine(e.to_string()))
            }
        }
    }

    /// Columns `columns` of the unit `key`, each as one array.
    ///
    /// # Errors
    /// Fails if the unit does not exist, is damaged or lacks a column.
    pub fn get<S: AsRef<str>>(&self, key: HashKey, columns: &[S]) -> Result<RecordBatch, Fault> {
        let (id, place) = self.place(key)?;
        let footer = self.footer(id)?;
        let sealed = &footer.sealed;
        let names = columns.iter().map(|c| {
            let at = sealed.schema().index_of(c.as_ref());
            at.map_err(|_| Fault::machine(format!("{} has no column `{}`", self.file(id).display(), c.as_ref())))
        });
        self.batch(id, sealed, place, &names.collect::<Result<Vec<_>, _>>()?)
    }

    /// Columns of the pack that holds the unit `key`.
    ///
    /// # Errors
    /// Fails if the unit does not exist or is damaged.
    pub fn columns(&self, key: HashKey) -> Result<SchemaRef, Fault> {
        let (id, _) = self.place(key)?;
        Ok(self.footer(id)?.sealed.schema().clone())
    }

    /// All columns of the unit `key`, with their fields.
    ///
    /// # Errors
    /// Fails if the unit does not exist or is damaged.
    pub fn whole(&self, key: HashKey) -> Result<RecordBatch, Fault> {
        let (id, place) = self.place(key)?;
        let footer = self.footer(id)?;
        let all: Vec<usize> = (0..footer.sealed.schema().fields().len()).collect();
        self.batch(id, &footer.sealed, place, &all)
    }

    fn batch(
        &self,
        id: HashKey,
        sealed: &SealedFile,
        place: RowLocation,
        columns: &[usize],
    ) -> Result<RecordBatch, Fault> {
        let rows = place.rows.ok_or_else(|| Fault::bug("a unit that could not be computed has no rows"))?;
        let fields: Vec<Arc<Field>> = columns.iter().map(|c| sealed.schema().fields()[*c].clone()).collect();
        let arrays: Result<Vec<ArrayRef>, Fault> =
            columns.iter().map(|c| self.rows(id, sealed, *c, place.first, rows)).collect();
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), arrays?, &options)
            .map_err(|e| Fault::machine(e.to_string()))
    }

    fn note(&self, key: HashKey) -> Result<Option<UnitNote>, Fault> {
        let (id, place) = self.place(key)?;
        Ok(self.footer(id)?.notes.get(&place.unit).cloned())
    }

    /// Fault of the unit `key` that prevents its computation, if known.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn failed(&self, key: HashKey) -> Result<Option<Fault>, Fault> {
        match self.find(key) {
            Some(RowLocation { rows: None, .. }) => Ok(self.note(key)?.and_then(|n| n.failed)),
            _ => Ok(None),
        }
    }

    /// Notes attached to the result of the unit `key`.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn remarks(&self, key: HashKey) -> Result<Remarks, Fault> {
        let of = |note: UnitNote| Remarks { left_out: note.left_out, warnings: note.warnings };
        Ok(self.note(key)?.map(of).unwrap_or_default())
    }

    /// Adds a pack that was just written.
    pub(super) fn add(&self, pack: StorePack) {
        locked(&self.footers).remove(&pack.id);
        self.catalogue_mut().insert(pack);
    }
}

//! Store in an object store, and its copy in a folder of this machine: the cache.
//!
//! The objects are the store. The cache has the layout of a store in a folder, with the files that this machine has
//! written or read. Immutable files (packs, sources, plans, the files of a version) are written to the object store
//! first and then to the cache. These files are copied into the cache when they are first read, and their checksums are
//! verified. The other files are small and are copied when the store is opened: the plans, runs and costs of pipelines,
//! and `tables/<pipeline>`. The object `tables/<pipeline>` names the newest version. The object is replaced only if it
//! is unchanged since it was read. Packs of a version are not written again: `versions/<pipeline>/<n>/version.json`
//! lists them by name.
//!
//! Locks are leases, that is, objects that only one process can create and renew. Hosts that share a folder use the
//! same method.

mod lease;
mod pull;
mod tend;
#[cfg(test)]
mod tests;

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Write},
    path::{Component, Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use buckets::{Bucket, ObjectAddress, ObjectEntry, StorageLocation, cache, connect, each, place, supported};
use bytes::Bytes;
use schemas::{Fault, keys::HashKey};
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::{
    LAYOUT,
    catalogue::{self, StorePack},
    checkpoints, io_fault, is_other_layout, make_folder,
    sealed::{self, StoreFileFault},
    unfinished::own_folder,
};
pub use lease::RemoteLease;
pub use tend::is_object_old;

/// File of a cache that holds the address of its store.
pub const MARK: &str = "REMOTE";
/// Maximum number of attempts to read a pack whose bytes differ from the written bytes.
const TRIALS: usize = 3;
/// Bytes at the end of a pack that are read first; most footers are shorter.
const TAIL: u64 = 64 << 10;

/// Content of the file [`MARK`].
#[derive(Serialize, Deserialize)]
struct CacheMarker {
    address: String,
    /// Identifier of this cache.
    cache: String,
}

impl CacheMarker {
    /// The mark of the folder `root`; `None` if the folder has no mark.
    fn read(root: &Path) -> Result<Option<CacheMarker>, Fault> {
        let path = root.join(MARK);
        match fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|_| CacheMarker::damaged(root)),
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => Ok(None),
            Err(e) => Err(io_fault("read", &path, &e)),
        }
    }

    fn damaged(root: &Path) -> Fault {
        Fault::machine(format!("{} is damaged", root.join(MARK).display()))
            .help(format!("remove the folder {}; it is only a copy", root.display()))
    }
}

/// Store in an object store.
pub struct RemoteStore {
    bucket: Bucket,
    root: PathBuf,
    cache: String,
    tmp: Mutex<Option<(PathBuf, File)>>,
    next: AtomicU64,
}

/// Stores that this process uses, by the folder of their cache.
static OPEN: Mutex<BTreeMap<PathBuf, Arc<RemoteStore>>> = Mutex::new(BTreeMap::new());

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Folder of the store that `text` names: a path, or an address. Creates the cache of an address.
///
/// # Errors
/// Fails for other addresses. Also fails if this program is built without object stores, or if the cache cannot be
/// created.
pub fn located(text: &str) -> Result<PathBuf, Fault> {
    match place(text)? {
        StorageLocation::Path(path) => Ok(path),
        StorageLocation::Object(address) => prepared(&address),
    }
}

/// Cache of the store at `address`; creates it if absent.
///
/// # Errors
/// Fails if this program is built without object stores, or if the cache cannot be created.
pub fn prepared(address: &ObjectAddress) -> Result<PathBuf, Fault> {
    supported()?;
    let root = cache::of_store(address)?;
    mark_cache(&root, address)?;
    Ok(root)
}

/// Makes the folder `root` a cache of the store in `bucket`, for any implementation of an object store.
///
/// # Errors
/// Fails if the folder cannot be written. Also fails for a folder that is a cache of another address.
pub fn attach(root: &Path, bucket: Bucket) -> Result<(), Fault> {
    mark_cache(root, bucket.address())?;
    let root = root.canonicalize().map_err(|e| io_fault("read", root, &e))?;
    let mark = CacheMarker::read(&root)?.filter(|mark| mark.address == bucket.address().to_string());
    let mark = mark.ok_or_else(|| Fault::new(format!("{} is the cache of another store", root.display())))?;
    RemoteStore::over(&root, bucket, mark.cache);
    Ok(())
}

/// Marks the folder `root` as a cache of the store at `address`, if it has no mark.
fn mark_cache(root: &Path, address: &ObjectAddress) -> Result<(), Fault> {
    let mark = root.join(MARK);
    if !mark.is_file() {
        let cache = Uuid::new_v4().to_string();
        let text = serde_json::to_string(&CacheMarker { address: address.to_string(), cache: cache.clone() });
        let text = text.map_err(|e| Fault::machine(e.to_string()))? + "\n";
        let unfinished = root.join("tmp").join(format!("{MARK}-{cache}"));
        let made = make_folder(&root.join("tmp"))
            .and_then(|()| File::create(&unfinished))
            .and_then(|mut f| f.write_all(text.as_bytes()).and_then(|()| f.sync_all()))
            .and_then(|()| match fs::hard_link(&unfinished, &mark) {
                // Another process has created the mark.
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(()),
                Err(_) => fs::copy(&unfinished, &mark).map(drop),
                Ok(()) => Ok(()),
            });
        let _ = fs::remove_file(&unfinished);
        made.map_err(|e| io_fault("make", root, &e))?;
    }
    Ok(())
}

/// Name of the store in the folder `root`: the path of the folder, or the address of an object store.
pub fn shown(root: &Path) -> String {
    match RemoteStore::from_cache(root) {
        Ok(Some(remote)) => remote.bucket.address().to_string(),
        Ok(None) | Err(_) => root.display().to_string(),
    }
}

/// Name of a folder `tables/<pipeline>`; in the copy of an object store, the name begins with the address of the store.
pub fn shown_below(folder: &Path) -> String {
    let root = folder.ancestors().nth(2).filter(|root| is_copy(root));
    let below = |root: &Path| folder.strip_prefix(root).ok().map(|p| format!("{}/{}", shown(root), p.display()));
    root.and_then(below).unwrap_or_else(|| folder.display().to_string())
}

/// Whether a folder is the copy of an object store.
pub fn is_copy(root: &Path) -> bool {
    root.join(MARK).is_file()
}

impl RemoteStore {
    /// Store with the cache `root`; `None` if `root` is a store itself, or does not exist.
    ///
    /// # Errors
    /// Fails if the cache cannot be read, or if the environment lacks the settings of the store.
    pub fn from_cache(root: &Path) -> Result<Option<Arc<RemoteStore>>, Fault> {
        let Ok(root) = root.canonicalize() else { return Ok(None) };
        if let Some(known) = locked(&OPEN).get(&root) {
            return Ok(Some(known.clone()));
        }
        let Some(mark) = CacheMarker::read(&root)? else { return Ok(None) };
        let StorageLocation::Object(address) = place(&mark.address)? else { return Err(CacheMarker::damaged(&root)) };
        Ok(Some(RemoteStore::over(&root, connect(&address)?, mark.cache)))
    }

    /// Store in `bucket` with the cache `root`.
    fn over(root: &Path, bucket: Bucket, cache: String) -> Arc<RemoteStore> {
        let new = RemoteStore { bucket, root: root.to_owned(), cache, tmp: Mutex::default(), next: AtomicU64::new(0) };
        locked(&OPEN).entry(root.to_owned()).or_insert_with(|| Arc::new(new)).clone()
    }

    /// Objects of the store.
    pub fn bucket(&self) -> &Bucket {
        &self.bucket
    }

    /// Name of the object that corresponds to the file `relative` of the cache; `None` if no such object exists in any
    /// store.
    pub fn key(relative: &Path) -> Option<String> {
        let parts: Vec<&str> = relative.components().filter_map(|c| c.as_os_str().to_str()).collect();
        let shared = match parts.as_slice() {
            ["STORE" | "index"] => true,
            ["sources", name] => name.ends_with(".json"),
            ["objects" | "quality" | "plans" | "runs" | crate::COSTS | checkpoints::FOLDER, ..] => true,
            _ => false,
        };
        shared.then(|| parts.join("/"))
    }

    /// Checks that all objects, if any, belong to a store.
    ///
    /// # Errors
    /// Fails if there are other objects, or if the server cannot be reached or reports an error.
    pub fn only_ours(&self) -> Result<(), Fault> {
        let ours = |key: &str| {
            let first = key.split('/').next().unwrap_or_default();
            super::PARTS.contains(&first) || matches!(first, "STORE" | "index")
        };
        match self.bucket.list("")?.iter().find(|o| !ours(&o.key)) {
            None => Ok(()),
            Some(other) => {
                let what = format!("{} is not a magline store: it contains {}", self.bucket.address(), other.key);
                Err(Fault::new(what).help("use a new or empty prefix as `store`"))
            }
        }
    }

    /// Whether there is a store of this version of magline; if so, writes the mark of the cache.
    ///
    /// # Errors
    /// Fails for a store of another version. Also fails if the server cannot be reached or reports an error.
    pub fn is_there(&self) -> Result<bool, Fault> {
        let mark = self.bucket.get("STORE")?;
        if let Some(bytes) = mark.as_ref().filter(|bytes| is_other_layout(bytes)) {
            let start_of_text = String::from_utf8_lossy(bytes).trim().chars().take(40).collect::<String>();
            let what = format!("{} is a store of another version of magline ({start_of_text})", self.bucket.address());
            return Err(Fault::new(what).help("use another prefix as `store`"));
        }
        let local = self.root.join("STORE");
        if mark.is_some() && fs::read(&local).ok().as_deref() != Some(LAYOUT.as_bytes()) {
            self.keep(&local, LAYOUT.as_bytes())?;
        }
        Ok(mark.is_some())
    }

    /// Removes the objects of a folder for which `gone` is true. The arguments of `gone` are the first part of the
    /// object's name below the folder, and the age of the object by the server's clock.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn drop_objects(&self, folder: &str, gone: &dyn Fn(&str, Duration) -> bool) -> Result<(), Fault> {
        let name = |key: &str| key.split('/').nth(1).unwrap_or_default().to_owned();
        let all = self.bucket.list(folder)?;
        if all.is_empty() {
            return Ok(());
        }
        let now = self.time()?;
        let age = |o: &ObjectEntry| now.duration_since(o.modified).unwrap_or_default();
        let wanted: Vec<String> = all.into_iter().filter(|o| gone(&name(&o.key), age(o))).map(|o| o.key).collect();
        each(&wanted, |key| self.bucket.remove(key)).map(drop)
    }

    /// Name for a temporary copy of a file.
    fn temporary(&self) -> Result<PathBuf, Fault> {
        let mut tmp = locked(&self.tmp);
        if tmp.is_none() {
            let all = self.root.join("tmp");
            let own = make_folder(&all).and_then(|()| own_folder(&all)).map_err(|e| io_fault("write", &all, &e))?;
            *tmp = Some(own);
        }
        let folder = tmp.as_ref().map(|(folder, _)| folder.clone()).unwrap_or_default();
        Ok(folder.join(self.next.fetch_add(1, Ordering::Relaxed).to_string()))
    }

    /// Moves a file to its place in the cache.
    fn settle(&self, from: &Path, to: &Path) -> Result<(), Fault> {
        let moved = to.parent().map_or(Ok(()), make_folder).and_then(|()| fs::rename(from, to));
        moved.map_err(|e| io_fault("write", to, &e))
    }

    /// Writes `bytes` to the cache.
    fn keep(&self, to: &Path, bytes: &[u8]) -> Result<(), Fault> {
        let tmp = self.temporary()?;
        fs::write(&tmp, bytes).map_err(|e| io_fault("write", &tmp, &e))?;
        self.settle(&tmp, to)
    }

    /// Copies the object `key` into the cache unless the cache contains it. Returns whether the object exists.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error, or the file cannot be written.
    pub fn bring_file(&self, key: &str) -> Result<bool, Fault> {
        let file = self.path(key)?;
        if file.is_file() {
            return Ok(true);
        }
        let tmp = self.temporary()?;
        let there = self.bucket.fetch(key, &tmp, None)?;
        if there {
            self.settle(&tmp, &file)?;
        }
        Ok(there)
    }

    /// File of an object in the cache.
    fn path(&self, key: &str) -> Result<PathBuf, Fault> {
        let relative = Path::new(key);
        if key.is_empty() || !relative.components().all(|c| matches!(c, Component::Normal(_))) {
            return Err(Fault::machine(format!("{} has an object with an invalid name: {key}", self.bucket.address())));
        }
        Ok(self.root.join(relative))
    }

    /// Name of the object of a pack.
    fn pack_key(id: HashKey) -> String {
        let name = id.to_string();
        format!("objects/{}/{name}.parquet", name.get(..2).unwrap_or_default())
    }

    /// Copies the pack `id` into the cache unless it is there. `size` is its size in bytes, if known.
    ///
    /// # Errors
    /// Fails if it is missing or unreadable, or its bytes differ from the written ones.
    pub fn bring(&self, id: HashKey, size: Option<u64>) -> Result<(), StoreFileFault> {
        let file = catalogue::path(&self.root, id);
        if fs::metadata(&file).is_ok_and(|about| size.is_none_or(|size| size == about.len())) {
            return Ok(());
        }
        let machine = |fault: Fault| StoreFileFault::Machine(fault.to_string());
        let mut why = String::new();
        for _ in 0..TRIALS {
            let tmp = self.temporary().map_err(machine)?;
            if !self.bucket.fetch(&RemoteStore::pack_key(id), &tmp, None).map_err(machine)? {
                return Err(StoreFileFault::Gone);
            }
            match sealed::verify(&tmp) {
                Ok(()) => return self.settle(&tmp, &file).map_err(machine),
                Err(StoreFileFault::Damaged(what)) => why = what,
                Err(other) => return Err(other),
            }
            let _ = fs::remove_file(&tmp);
        }
        Err(StoreFileFault::Damaged(why))
    }

    /// Copies the pack `id` into the cache in place of a damaged or removed copy.
    ///
    /// # Errors
    /// Returns the errors of [`RemoteStore::bring`].
    pub fn bring_again(&self, id: HashKey) -> Result<(), StoreFileFault> {
        // A copy that cannot be removed is replaced.
        let _ = fs::remove_file(catalogue::path(&self.root, id));
        self.bring(id, None)
    }

    /// All packs, each with its size in bytes.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn packs(&self) -> Result<Vec<(HashKey, u64)>, Fault> {
        let id = |key: &str| {
            let id = key.rsplit('/').next()?.strip_suffix(".parquet").and_then(HashKey::parse)?;
            (RemoteStore::pack_key(id) == key).then_some(id)
        };
        let all = self.bucket.list("objects")?;
        Ok(all.iter().filter_map(|o| Some((id(&o.key)?, o.size))).collect())
    }

    /// Packs in the index; `None` if the index is missing or damaged.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn index(&self) -> Result<Option<Vec<StorePack>>, Fault> {
        let bytes = self.bucket.get("index")?;
        Ok(bytes.and_then(|bytes| catalogue::parse(&bytes)))
    }

    /// Pack `id`, from its footer alone.
    ///
    /// # Errors
    /// Fails if it is missing or unreadable, or its footer is damaged.
    pub fn pack(&self, id: HashKey, size: Option<u64>) -> Result<StorePack, StoreFileFault> {
        let machine = |fault: Fault| StoreFileFault::Machine(fault.to_string());
        let key = RemoteStore::pack_key(id);
        let size = match size {
            Some(size) => size,
            None => self.bucket.about(&key).map_err(machine)?.ok_or(StoreFileFault::Gone)?.size,
        };
        let mut want = TAIL.min(size);
        let mut why = StoreFileFault::Damaged("it is empty".to_owned());
        for _ in 0..TRIALS {
            if want == 0 {
                break;
            }
            let tail =
                self.bucket.range(&key, size - want..size, None).map_err(machine)?.ok_or(StoreFileFault::Gone)?;
            match sealed::tail_text(Bytes::from(tail), size, catalogue::UNITS) {
                Ok(Ok(text)) => {
                    let (kind, units) = catalogue::units_of(text.as_deref())?;
                    return Ok(StorePack { id, size, modified_ns: 0, kind, units });
                }
                Ok(Err(more)) if more <= size && more > want => want = more,
                Ok(Err(_)) => return Err(StoreFileFault::Damaged("it is truncated".to_owned())),
                Err(wrong) => why = wrong,
            }
        }
        Err(why)
    }

    /// Quarantines a damaged pack.
    pub fn set_aside(&self, id: HashKey) {
        // Without write permission, the pack stays and is reported again.
        let _ = self.bucket.rename(&RemoteStore::pack_key(id), &format!("damaged/{id}.parquet"));
    }
}

//! A store in an object store, and its copy in a folder of this machine: the cache.
//!
//! The objects are the store; the cache has the layout of a store in a folder, with the files that this machine has
//! written or read. Files that never change under their names (packs, sources, plans, the files of a version) are
//! written to the object store first and then to the cache, and copied when they are first read, with their checksums.
//! The others are small, and copied when the store is opened: the plans, runs and costs of pipelines, and
//! `tables/<pipeline>`, which names the newest version and is replaced on the condition that it is still the object
//! that was read. The files of a version that are packs are not written again: `versions/<pipeline>/<n>/version.json`
//! lists them by name.
//!
//! Locks are leases, as between hosts that share a folder: objects that only one can create, written to again and
//! again.

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

use bytes::Bytes;
use schemas::Fault;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::{
    LAYOUT,
    catalogue::{self, StorePack},
    checkpoints, is_other_layout, make_folder,
    sealed::{self, StoreFileFault},
    trouble,
    unfinished::own_folder,
};
use crate::{
    keys::HashKey,
    remote::{Bucket, ObjectAddress, ObjectEntry, StorageLocation, cache, connect, each, place, supported},
};
pub use lease::RemoteLease;
pub use tend::is_object_old;

/// The file of a cache that says of which store it is.
pub const MARK: &str = "REMOTE";
/// Maximum number of reads of a pack whose bytes differ from the written ones.
const TRIALS: usize = 3;
/// The end of a pack that is read at first: most footers are shorter.
const TAIL: u64 = 64 << 10;

/// The content of the file [`MARK`].
#[derive(Serialize, Deserialize)]
struct CacheMarker {
    address: String,
    /// Identifier of this cache.
    cache: String,
}

/// A store in an object store.
pub struct RemoteStore {
    bucket: Bucket,
    root: PathBuf,
    cache: String,
    tmp: Mutex<Option<(PathBuf, File)>>,
    next: AtomicU64,
}

/// Those that this process uses, by the folder of their cache.
static OPEN: Mutex<BTreeMap<PathBuf, Arc<RemoteStore>>> = Mutex::new(BTreeMap::new());

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The folder of the store that `text` names: a path, or an address, whose cache is made.
///
/// # Errors
/// Fails for other addresses, where this program is built without object stores, and when the cache cannot be made.
pub fn located(text: &str) -> Result<PathBuf, Fault> {
    match place(text)? {
        StorageLocation::Path(path) => Ok(path),
        StorageLocation::Object(address) => prepared(&address),
    }
}

/// The cache of the store at `address`, which is made where there is none.
///
/// # Errors
/// Fails where this program is built without object stores, and when the cache cannot be made.
pub fn prepared(address: &ObjectAddress) -> Result<PathBuf, Fault> {
    supported()?;
    let root = cache::of_store(address)?;
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
                // Another process has made it.
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(()),
                Err(_) => fs::copy(&unfinished, &mark).map(drop),
                Ok(()) => Ok(()),
            });
        let _ = fs::remove_file(&unfinished);
        made.map_err(|e| trouble("make", &root, &e))?;
    }
    Ok(root)
}

/// Name of the store in the folder `root`: its address, where it is in an object store.
pub fn shown(root: &Path) -> String {
    match RemoteStore::from_cache(root) {
        Ok(Some(remote)) => remote.bucket.address().to_string(),
        Ok(None) | Err(_) => root.display().to_string(),
    }
}

/// The same of a folder of tables, `tables/<pipeline>` of a store.
pub fn shown_below(folder: &Path) -> String {
    let root = folder.ancestors().nth(2).filter(|root| is_copy(root));
    let below = |root: &Path| folder.strip_prefix(root).ok().map(|p| format!("{}/{}", shown(root), p.display()));
    root.and_then(below).unwrap_or_else(|| folder.display().to_string())
}

/// Whether a folder is the copy of a store in an object store.
pub fn is_copy(root: &Path) -> bool {
    root.join(MARK).is_file()
}

impl RemoteStore {
    /// The store whose cache is the folder `root`; `None` where that is a store itself, or nothing.
    ///
    /// # Errors
    /// Fails when the cache cannot be read, and where the environment does not say how to reach the store.
    pub fn from_cache(root: &Path) -> Result<Option<Arc<RemoteStore>>, Fault> {
        let Ok(root) = root.canonicalize() else { return Ok(None) };
        if let Some(known) = locked(&OPEN).get(&root) {
            return Ok(Some(known.clone()));
        }
        let path = root.join(MARK);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(None),
            Err(e) => return Err(trouble("read", &path, &e)),
        };
        let damaged = || {
            Fault::machine(format!("{} is damaged", path.display()))
                .help(format!("remove the folder {}; it is only a copy", root.display()))
        };
        let mark: CacheMarker = serde_json::from_slice(&bytes).map_err(|_| damaged())?;
        let StorageLocation::Object(address) = place(&mark.address)? else { return Err(damaged()) };
        Ok(Some(RemoteStore::over(&root, connect(&address)?, mark.cache)))
    }

    /// The store in `bucket` whose cache is the folder `root`.
    fn over(root: &Path, bucket: Bucket, cache: String) -> Arc<RemoteStore> {
        let new = RemoteStore { bucket, root: root.to_owned(), cache, tmp: Mutex::default(), next: AtomicU64::new(0) };
        locked(&OPEN).entry(root.to_owned()).or_insert_with(|| Arc::new(new)).clone()
    }

    /// Its objects.
    pub fn bucket(&self) -> &Bucket {
        &self.bucket
    }

    /// The name of an object for the file `relative` of the cache, where it is one that all share.
    pub fn key(relative: &Path) -> Option<String> {
        let parts: Vec<&str> = relative.components().filter_map(|c| c.as_os_str().to_str()).collect();
        let shared = match parts.as_slice() {
            ["STORE" | "index"] => true,
            ["sources", name] => name.ends_with(".json"),
            ["objects" | "quality" | "plans" | "runs" | crate::cost::FOLDER | checkpoints::FOLDER, ..] => true,
            _ => false,
        };
        shared.then(|| parts.join("/"))
    }

    /// Whether the objects are those of a store, or there are none.
    ///
    /// # Errors
    /// Fails where there are others, and when the server cannot be reached or refuses.
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

    /// Whether there is a store, of this version of magline; the cache then says so too.
    ///
    /// # Errors
    /// Fails where there is one of another version, and when the server cannot be reached or refuses.
    pub fn is_there(&self) -> Result<bool, Fault> {
        let mark = self.bucket.get("STORE")?;
        if let Some(bytes) = mark.as_ref().filter(|bytes| is_other_layout(bytes)) {
            let said = String::from_utf8_lossy(bytes).trim().chars().take(40).collect::<String>();
            let what = format!("{} is a store of another version of magline ({said})", self.bucket.address());
            return Err(Fault::new(what).help("use another prefix as `store`"));
        }
        let local = self.root.join("STORE");
        if mark.is_some() && fs::read(&local).ok().as_deref() != Some(LAYOUT.as_bytes()) {
            self.keep(&local, LAYOUT.as_bytes())?;
        }
        Ok(mark.is_some())
    }

    /// Removes the objects of a folder for which `gone` is true. It is given the first part of their names below the
    /// folder, and their age by the server's clock.
    ///
    /// # Errors
    /// Fails when the server cannot be reached or refuses.
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

    /// A name for a file being copied.
    fn temporary(&self) -> Result<PathBuf, Fault> {
        let mut tmp = locked(&self.tmp);
        if tmp.is_none() {
            let all = self.root.join("tmp");
            let own = make_folder(&all).and_then(|()| own_folder(&all)).map_err(|e| trouble("write", &all, &e))?;
            *tmp = Some(own);
        }
        let folder = tmp.as_ref().map(|(folder, _)| folder.clone()).unwrap_or_default();
        Ok(folder.join(self.next.fetch_add(1, Ordering::Relaxed).to_string()))
    }

    /// Puts a file into its place in the cache.
    fn settle(&self, from: &Path, to: &Path) -> Result<(), Fault> {
        let moved = to.parent().map_or(Ok(()), make_folder).and_then(|()| fs::rename(from, to));
        moved.map_err(|e| trouble("write", to, &e))
    }

    /// Puts `bytes` into the cache.
    fn keep(&self, to: &Path, bytes: &[u8]) -> Result<(), Fault> {
        let tmp = self.temporary()?;
        fs::write(&tmp, bytes).map_err(|e| trouble("write", &tmp, &e))?;
        self.settle(&tmp, to)
    }

    /// Copies the object `key` into the cache, where it is not there yet; whether there is one.
    ///
    /// # Errors
    /// Fails when the server cannot be reached or refuses, or the file cannot be written.
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

    /// The file of an object in the cache.
    fn path(&self, key: &str) -> Result<PathBuf, Fault> {
        let relative = Path::new(key);
        if key.is_empty() || !relative.components().all(|c| matches!(c, Component::Normal(_))) {
            return Err(Fault::machine(format!("{} has an object with an invalid name: {key}", self.bucket.address())));
        }
        Ok(self.root.join(relative))
    }

    /// The name of the object of a pack.
    fn pack_key(id: HashKey) -> String {
        let name = id.to_string();
        format!("objects/{}/{name}.parquet", name.get(..2).unwrap_or_default())
    }

    /// Copies the pack `id`, of `size` bytes where that is known, into the cache, where it is not there yet.
    ///
    /// # Errors
    /// Fails when it is not there, cannot be read, or its bytes are not those that were written.
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

    /// Copies the pack `id` into the cache in place of the copy there, which is damaged or was removed.
    ///
    /// # Errors
    /// The same as [`RemoteStore::bring`].
    pub fn bring_again(&self, id: HashKey) -> Result<(), StoreFileFault> {
        // Where it cannot be removed it is replaced.
        let _ = fs::remove_file(catalogue::path(&self.root, id));
        self.bring(id, None)
    }

    /// The packs that there are, each with its bytes.
    ///
    /// # Errors
    /// Fails when the server cannot be reached or refuses.
    pub fn packs(&self) -> Result<Vec<(HashKey, u64)>, Fault> {
        let id = |key: &str| {
            let id = key.rsplit('/').next()?.strip_suffix(".parquet").and_then(HashKey::parse)?;
            (RemoteStore::pack_key(id) == key).then_some(id)
        };
        let all = self.bucket.list("objects")?;
        Ok(all.iter().filter_map(|o| Some((id(&o.key)?, o.size))).collect())
    }

    /// The packs of the index; none where it is missing or damaged.
    ///
    /// # Errors
    /// Fails when the server cannot be reached or refuses.
    pub fn index(&self) -> Result<Option<Vec<StorePack>>, Fault> {
        let bytes = self.bucket.get("index")?;
        Ok(bytes.and_then(|bytes| catalogue::parse(&bytes)))
    }

    /// The pack `id`, from its footer alone.
    ///
    /// # Errors
    /// Fails when it is not there, cannot be read, or its footer is damaged.
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

    /// Sets a damaged pack aside.
    pub fn set_aside(&self, id: HashKey) {
        // Without the permission to write it stays, and is found damaged again.
        let _ = self.bucket.rename(&RemoteStore::pack_key(id), &format!("damaged/{id}.parquet"));
    }
}

//! Copies of changing objects in the cache, and versions of published tables.

use std::{
    collections::BTreeSet,
    fs, io,
    os::unix,
    path::{Component, Path},
};

use buckets::each;
use schemas::{Fault, keys::HashKey};

use super::{
    super::{
        PARTS,
        version::{Manifest, ManifestFile, ManifestTable, Version, current, link, newest},
    },
    RemoteStore, io_fault, make_folder,
};

/// Folders with changing files, each with the extension of these files.
const CHANGING: [(&str, &str); 3] = [("plans", ".json"), ("runs", ".jsonl"), (crate::COSTS, ".json")];

/// Content of the object `tables/<pipeline>`: the path of the newest version, as in the link of a store on disk, and a
/// checksum.
fn pointer(pipeline: &str, number: u64, sum: &str) -> String {
    format!("../versions/{pipeline}/{number}/tables\n{sum}\n")
}

fn read_pointer(pipeline: &str, text: &[u8]) -> Option<(u64, String)> {
    let text = std::str::from_utf8(text).ok()?;
    let (target, sum) = text.trim_end().split_once('\n')?;
    let number = target.strip_prefix(&format!("../versions/{pipeline}/"))?.strip_suffix("/tables")?.parse().ok()?;
    Some((number, sum.to_owned()))
}

fn folder_of(pipeline: &str, number: u64) -> String {
    format!("versions/{pipeline}/{number}")
}

/// Whether the name is a single path component, so that the file is inside its folder.
fn is_plain(name: &str) -> bool {
    let parts: Vec<Component> = Path::new(name).components().collect();
    matches!(parts.as_slice(), [Component::Normal(part)] if *part == name)
}

impl RemoteStore {
    /// Copies the changing objects into the cache. Returns whether there is a store.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error, the store is of another version of magline, or the
    /// cache cannot be written.
    pub fn pull(&self) -> Result<bool, Fault> {
        for part in PARTS {
            let folder = self.root.join(part);
            make_folder(&folder).map_err(|e| io_fault("make", &folder, &e))?;
        }
        let there = self.is_there()?;
        if !there {
            // The store was removed, so the mark of its copy is removed too.
            remove(&self.root.join("STORE"))?;
        }
        self.pull_tables()?;
        for (folder, ending) in CHANGING {
            self.pull_changing(folder, ending)?;
        }
        Ok(there)
    }

    fn pull_changing(&self, folder: &str, ending: &str) -> Result<(), Fault> {
        let listed = self.bucket.list_flat(folder)?;
        let of = |name: &str| name.rsplit('/').next().unwrap_or_default().to_owned();
        // The files of `runs` that end in `.json` are immutable, so only missing ones are copied.
        let changing = |key: &str| key.ends_with(ending) && is_plain(&of(key));
        let names: BTreeSet<String> = listed.iter().filter(|o| changing(&o.key)).map(|o| of(&o.key)).collect();
        let fixed = |key: &str| folder == "runs" && key.ends_with(".json") && is_plain(&of(key));
        let keys: Vec<(&str, bool)> = listed
            .iter()
            .map(|o| o.key.as_str())
            .filter(|key| changing(key) || fixed(key))
            .map(|key| (key, changing(key)))
            .collect();
        each(&keys, |(key, changes)| {
            if !changes {
                return self.bring_file(key).map(drop);
            }
            let path = self.path(key)?;
            match self.bucket.get(key)? {
                Some(bytes) if fs::read(&path).ok().as_ref() != Some(&bytes) => self.keep(&path, &bytes),
                Some(_) | None => Ok(()),
            }
        })?;
        for entry in fs::read_dir(self.root.join(folder)).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.ends_with(ending) && !names.contains(&name) {
                remove(&entry.path())?;
            }
        }
        Ok(())
    }

    /// Updates the versions in the cache to the newest versions of the store.
    fn pull_tables(&self) -> Result<(), Fault> {
        let listed = self.bucket.list_flat("tables")?;
        let names: Vec<String> = listed
            .iter()
            .filter_map(|o| o.key.strip_prefix("tables/"))
            .filter(|n| is_plain(n))
            .map(str::to_owned)
            .collect();
        each(&names, |name| self.pull_table(name))?;
        for entry in fs::read_dir(self.root.join("tables")).into_iter().flatten().flatten() {
            let known = entry.file_name().to_str().is_some_and(|name| names.iter().any(|n| n == name));
            if !known && entry.file_type().is_ok_and(|kind| kind.is_symlink()) {
                remove(&entry.path())?;
            }
        }
        Ok(())
    }

    fn pull_table(&self, pipeline: &str) -> Result<(), Fault> {
        let name = format!("tables/{pipeline}");
        let damaged = |what: &str| {
            Fault::machine(format!("{}/{what} is damaged", self.bucket.address())).help(format!(
                "remove the object tables/{pipeline}, and run the spec again to publish its tables again"
            ))
        };
        let Some(mut text) = self.bucket.get(&name)? else { return Ok(()) };
        let (number, bytes, manifest) = loop {
            let (number, sum) = read_pointer(pipeline, &text).ok_or_else(|| damaged(&name))?;
            let here = current(&self.root, pipeline);
            if here.is_some_and(|v| v.number == number && v.manifest.sum() == sum) {
                return Ok(());
            }
            let key = format!("{}/version.json", folder_of(pipeline, number));
            let bytes = self.bucket.get(&key)?.unwrap_or_default();
            if let Some(manifest) = Manifest::read(&bytes).filter(|m| m.sum() == sum) {
                break (number, bytes, manifest);
            }
            // Another run may have published in the meantime, and `gc` may have dropped this version.
            match self.bucket.get(&name)? {
                Some(now) if now != text => text = now,
                Some(_) => return Err(damaged(&key)),
                None => return Ok(()),
            }
        };
        let folder = self.temporary()?;
        let fail = |e: io::Error| io_fault("write", &folder, &e);
        make_folder(&folder.join("units")).map_err(fail)?;
        for table in manifest.tables.iter().filter(|t| is_plain(&t.name)) {
            make_folder(&folder.join("tables").join(&table.name)).map_err(fail)?;
        }
        fs::write(folder.join("version.json"), &bytes).map_err(fail)?;
        self.place(pipeline, number, &folder)
    }

    /// Moves the folder of a version to its place in the cache, and points the link to it.
    fn place(&self, pipeline: &str, number: u64, folder: &Path) -> Result<(), Fault> {
        let to = self.root.join(folder_of(pipeline, number));
        let same = |a: &Path, b: &Path| {
            let sum = |path: &Path| fs::read(path.join("version.json")).ok();
            sum(a).is_some() && sum(a) == sum(b)
        };
        if to.exists() && !same(&to, folder) {
            // The folder of a removed store or an unpublished version is moved aside.
            let aside = self.temporary()?;
            fs::rename(&to, &aside).map_err(|e| io_fault("write", &to, &e))?;
            let _ = fs::remove_dir_all(&aside);
        }
        if !to.exists() {
            let moved = self.settle(folder, &to);
            // Another process may have moved the version there.
            if !same(&to, folder) && moved.is_err() && !to.exists() {
                return moved;
            }
        }
        let link = self.temporary()?;
        let target = format!("../{}/tables", folder_of(pipeline, number));
        unix::fs::symlink(target, &link).map_err(|e| io_fault("write", &link, &e))?;
        self.settle(&link, &self.root.join("tables").join(pipeline))
    }

    /// Copies the files of a table into the cache.
    ///
    /// # Errors
    /// Fails if a file is missing or damaged, the server cannot be reached or reports an error, or the cache cannot be
    /// written.
    pub fn at_hand(&self, version: &Version, table: &ManifestTable) -> Result<(), Fault> {
        let files: Vec<&ManifestFile> = table.files.iter().chain(&table.units).collect();
        each(&files, |file| self.file_at_hand(version, file)).map(drop)
    }

    /// Copies into the cache the files of a version that are not packs.
    ///
    /// # Errors
    /// Returns the errors of [`RemoteStore::at_hand`].
    pub fn own_at_hand(&self, version: &Version) -> Result<(), Fault> {
        let files = version.manifest.tables.iter().flat_map(|t| t.files.iter().chain(&t.units));
        let files: Vec<&ManifestFile> = files.filter(|f| f.pack.is_none()).collect();
        each(&files, |file| self.file_at_hand(version, file)).map(drop)
    }

    fn file_at_hand(&self, version: &Version, file: &ManifestFile) -> Result<(), Fault> {
        let key = format!("{}/{}", folder_of(&version.manifest.pipeline, version.number), file.name);
        let path = self.path(&key)?;
        if fs::metadata(&path).is_ok_and(|about| about.len() == file.size) {
            return Ok(());
        }
        let wrong = |what: &str| {
            Fault::machine(format!("{}/{key} {what}", self.bucket.address()))
                .help("run the spec again to recompute and publish damaged results")
        };
        if let Some(id) = file.pack.as_deref().and_then(HashKey::parse) {
            self.bring(id, Some(file.size)).map_err(|e| {
                let what = format!("cannot read {}/{}: {e}", self.bucket.address(), RemoteStore::pack_key(id));
                Fault::machine(what).help("run the spec again to recompute and publish damaged results")
            })?;
            remove(&path)?;
            return match link(&super::catalogue::path(&self.root, id), &path) {
                Err(e) if e.kind() != io::ErrorKind::AlreadyExists => Err(io_fault("write", &path, &e)),
                _ => Ok(()),
            };
        }
        let bytes = self.bucket.get(&key)?.ok_or_else(|| wrong("is missing"))?;
        if Some(HashKey::from_parts([&bytes]).to_string()) != file.hash {
            return Err(wrong("has changed since it was written"));
        }
        self.keep(&path, &bytes)
    }

    /// Publishes the version in `folder`: uploads its files except for packs, and moves the version to its place in the
    /// cache. `check` fails if this process may no longer publish.
    ///
    /// # Errors
    /// Fails if `check` fails, if another process has published in the meantime, or if the server cannot be reached or
    /// reports an error. The previous version then stays the newest.
    pub fn publish(
        &self,
        pipeline: &str,
        folder: &Path,
        manifest: &Manifest,
        check: &dyn Fn() -> Result<(), Fault>,
    ) -> Result<(), Fault> {
        let name = format!("tables/{pipeline}");
        // The object is read before the lock is checked. If another process takes the lock after the check and
        // publishes, the object has changed and is not replaced here.
        let before = self.bucket.get_tagged(&name)?.map(|(_, tag)| tag);
        check()?;
        let path = folder.join("version.json");
        let bytes = fs::read(&path).map_err(|e| io_fault("read", &path, &e))?;
        let mut number = self.numbers(pipeline)?.last().map_or(1, |n| n + 1);
        // A version number belongs to the process that creates its manifest.
        while !self.bucket.create(&format!("{}/version.json", folder_of(pipeline, number)), &bytes)? {
            number += 1;
        }
        let files = manifest.tables.iter().flat_map(|t| t.files.iter().chain(&t.units));
        let own: Vec<&ManifestFile> = files.filter(|f| f.pack.is_none()).collect();
        each(&own, |file| {
            self.bucket.put_file(&format!("{}/{}", folder_of(pipeline, number), file.name), &folder.join(&file.name))
        })?;
        if !self.bucket.replace(&name, pointer(pipeline, number, manifest.sum()).as_bytes(), before)? {
            let what = format!("another run published `{pipeline}` in {} during this run", self.bucket.address());
            return Err(
                Fault::machine(what).help("nothing was published; finished results are stored; run the spec again")
            );
        }
        self.place(pipeline, number, folder)
    }

    /// Numbers of all versions of `pipeline`, sorted.
    pub(super) fn numbers(&self, pipeline: &str) -> Result<Vec<u64>, Fault> {
        let start = format!("versions/{pipeline}");
        let all = self.bucket.list(&start)?;
        let number = |key: &str| key.strip_prefix(&start)?.trim_start_matches('/').split('/').next()?.parse().ok();
        let numbers: BTreeSet<u64> = all.iter().filter_map(|o| number(&o.key)).collect();
        Ok(numbers.into_iter().collect())
    }

    /// Removes a pipeline from the published tables.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn unpublish(&self, pipeline: &str) -> Result<(), Fault> {
        self.bucket.remove(&format!("tables/{pipeline}"))?;
        self.bucket.remove(&format!("plans/{pipeline}.json"))
    }

    /// Manifest of a version; `None` if it is missing or damaged.
    pub(super) fn manifest(&self, pipeline: &str, number: u64) -> Result<Option<Manifest>, Fault> {
        let bytes = self.bucket.get(&format!("{}/version.json", folder_of(pipeline, number)))?;
        Ok(bytes.and_then(|bytes| Manifest::read(&bytes)))
    }

    /// Number of the newest version of `pipeline`.
    pub(super) fn newest(&self, pipeline: &str) -> Result<Option<u64>, Fault> {
        let text = self.bucket.get(&format!("tables/{pipeline}"))?;
        Ok(text.and_then(|text| read_pointer(pipeline, &text)).map(|(number, _)| number))
    }

    /// Removes a version, except for its packs.
    pub(super) fn drop_version(&self, pipeline: &str, number: u64) -> Result<(), Fault> {
        let folder = folder_of(pipeline, number);
        // The manifest is removed last, so a partly removed version is found again.
        let mut all: Vec<String> = self.bucket.list(&folder)?.into_iter().map(|o| o.key).collect();
        all.sort_by_key(|key| key.ends_with("/version.json"));
        all.iter().try_for_each(|key| self.bucket.remove(key))?;
        let here = self.root.join(&folder);
        if newest(&self.root, pipeline).as_ref() != Some(&here) {
            // A copy that cannot be removed only costs space.
            let _ = fs::remove_dir_all(&here);
        }
        Ok(())
    }
}

fn remove(path: &Path) -> Result<(), Fault> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(io_fault("remove", path, &e)),
        _ => Ok(()),
    }
}

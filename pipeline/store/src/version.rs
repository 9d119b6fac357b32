//! Published results: versions of a pipeline's tables, one of which is the newest.
//!
//! A version is written under another name, and appears atomically when its folder is renamed. A version is the newest
//! when the link `tables/<pipeline>` points to it. Unchanged files are linked from the packs and use no space. A reader
//! that has resolved the link keeps its version until `gc` drops it. An object store has no links: a version is a
//! prefix of object names, and a conditionally written object points to the newest version.

mod manifest;

use std::{
    collections::HashSet,
    fs::{self, File},
    io,
    os::unix,
    path::{Component, Path, PathBuf},
    sync::Arc,
};

use arrow_array::RecordBatch;
use arrow_select::concat::concat_batches;
use schemas::{Fault, keys::HashKey, paths};

use manifest::sum_of;
pub use manifest::{Manifest, ManifestFile, ManifestTable};

use super::{
    PipelineLock, Store,
    catalogue::stamp,
    io_fault, make_folder,
    remote::RemoteStore,
    sealed::{self, SealedFile},
    sync_folder,
};

/// Packs that contain the rows of a table, in the order of the rows.
pub struct TableFiles {
    /// Name of the table.
    pub name: String,
    /// Packs of the table.
    pub packs: Vec<HashKey>,
    /// File with the origin of each row of the table; see `logical`.
    pub units: Option<PathBuf>,
}

/// Table that no stage makes, such as the failures.
pub struct ExtraTable {
    /// Name of the table.
    pub name: String,
    /// File of the table, under a temporary name.
    pub file: PathBuf,
}

/// Published version.
pub struct Version {
    /// Folder of the version.
    pub folder: PathBuf,
    /// Number, from 1.
    pub number: u64,
    /// Manifest of the version.
    pub manifest: Manifest,
}

impl Version {
    /// Copies the missing files of a table of this version into the version's folder.
    ///
    /// # Errors
    /// Fails if an object store cannot be reached or reports an error, or holds different bytes.
    pub fn at_hand(&self, table: &ManifestTable) -> Result<(), Fault> {
        let root = self.folder.ancestors().nth(3);
        let remote = root.map_or(Ok(None), RemoteStore::from_cache)?;
        remote.map_or(Ok(()), |remote| remote.at_hand(self, table))
    }

    /// Version in `folder`, named by its number.
    pub fn open(folder: &Path) -> Option<Version> {
        Version::with_links(folder).filter(Version::has_no_link)
    }

    /// Version in `folder`, whose folders and files may be links.
    fn with_links(folder: &Path) -> Option<Version> {
        let number = folder.file_name()?.to_str()?.parse().ok()?;
        let manifest = Manifest::read(&paths::read_regular(&folder.join("version.json")).ok()?)?;
        Some(Version { folder: folder.to_owned(), number, manifest })
    }

    /// Whether none of the version's folders and files is a link, because a link may lead out of the store.
    fn has_no_link(&self) -> bool {
        let is_link = |path: &Path| fs::symlink_metadata(path).is_ok_and(|about| about.is_symlink());
        let tables = self.manifest.tables.iter().map(|t| self.folder.join("tables").join(&t.name));
        let folders = ["tables", "units"].map(|name| self.folder.join(name)).into_iter().chain(tables);
        let files = self.manifest.tables.iter().flat_map(|t| t.files.iter().chain(&t.units));
        let above = self.folder.parent().into_iter().chain([self.folder.as_path()]);
        !above.into_iter().any(is_link)
            && !folders.into_iter().any(|folder| is_link(&folder))
            && !files.into_iter().any(|file| is_link(&self.folder.join(&file.name)))
    }
}

/// Folder of the newest version of `pipeline` in the store at `root`.
pub fn newest(root: &Path, pipeline: &str) -> Option<PathBuf> {
    let link = fs::read_link(root.join("tables").join(pipeline)).ok()?;
    let parts: Vec<&str> = link.components().filter_map(|c| c.as_os_str().to_str()).collect();
    match parts.as_slice() {
        ["..", "versions", name, number, "tables"] if *name == pipeline => {
            Some(root.join("versions").join(name).join(number))
        }
        _ => None,
    }
}

/// Newest version of `pipeline` in the store at `root`, if it is intact.
pub fn current(root: &Path, pipeline: &str) -> Option<Version> {
    Version::open(&newest(root, pipeline)?)
}

/// Files of a published table, in the order of its rows. Foreign files in the folder of the table are ignored.
///
/// # Errors
/// Fails if the folder is a copy, and the object store cannot be reached or reports an error.
pub fn parts(folder: &Path) -> Result<Vec<PathBuf>, Fault> {
    bring(folder)?;
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    let ours = |p: &PathBuf| {
        let name = p.file_name().and_then(|n| n.to_str());
        name.is_some_and(|n| n.starts_with("part-") && n.ends_with(".parquet"))
    };
    let mut found: Vec<PathBuf> = entries.filter(ours).collect();
    found.sort();
    Ok(found)
}

/// Copies the missing files of a folder of a store: `tables/<pipeline>/<table>` or `quality/<key>`.
fn bring(folder: &Path) -> Result<(), Fault> {
    let above: Vec<&str> = folder.ancestors().take(3).filter_map(|p| p.file_name()?.to_str()).collect();
    let root = |n: usize| folder.ancestors().nth(n).map_or(Ok(None), RemoteStore::from_cache);
    match above.as_slice() {
        [table, pipeline, "tables"] => {
            let Some(remote) = root(3)? else { return Ok(()) };
            let version = folder.ancestors().nth(3).and_then(|root| current(root, pipeline));
            let listed = version.as_ref().and_then(|v| Some((v, v.manifest.tables.iter().find(|t| t.name == *table)?)));
            listed.map_or(Ok(()), |(version, table)| remote.at_hand(version, table))
        }
        [key, "quality", ..] => match root(2)? {
            Some(remote) => remote.bring_file(&format!("quality/{key}/part-0.parquet")).map(drop),
            None => Ok(()),
        },
        _ => Ok(()),
    }
}

/// Columns `columns` of a small published table, verified; `None` if the table does not exist.
///
/// # Errors
/// Fails if the table cannot be read.
pub fn published(folder: &Path, columns: &[&str]) -> Result<Option<RecordBatch>, Fault> {
    let mut batches = vec![];
    for file in parts(folder)? {
        let fail = |e: &dyn std::fmt::Display| io_fault("read", &file, e);
        let sealed = SealedFile::open(&file).map_err(|e| fail(&e))?;
        let at = columns.iter().map(|c| sealed.schema().index_of(c)).collect::<Result<Vec<_>, _>>();
        let at = at.map_err(|e| fail(&e))?;
        let schema = Arc::new(sealed.schema().project(&at).map_err(|e| fail(&e))?);
        batches.push(RecordBatch::new_empty(schema.clone()));
        for group in 0..sealed.starts().len() - 1 {
            let arrays = at.iter().map(|c| sealed.column(group, *c)).collect::<Result<Vec<_>, _>>();
            let batch = RecordBatch::try_new(schema.clone(), arrays.map_err(|e| fail(&e))?);
            batches.push(batch.map_err(|e| fail(&e))?);
        }
    }
    let Some(first) = batches.first() else { return Ok(None) };
    let whole = concat_batches(&first.schema(), &batches).map_err(|e| io_fault("read", folder, &e))?;
    Ok(Some(whole))
}

/// All versions of `pipeline`, oldest first.
pub fn versions(root: &Path, pipeline: &str) -> Vec<(u64, PathBuf)> {
    let folder = root.join("versions").join(pipeline);
    if paths::check_no_link(root, &folder).is_err() {
        return vec![];
    }
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<(u64, PathBuf)> =
        entries.filter_map(|e| Some((e.file_name().to_str()?.parse().ok()?, e.path()))).collect();
    found.sort();
    found
}

impl Store {
    /// Publishes `tables` and the reserved tables as the newest version, unless the newest version is equal. The tables
    /// `kept` are copied from the previous version. Returns whether there is a new version.
    ///
    /// # Errors
    /// Fails if the file system reports an error; the previous version then stays the newest.
    pub fn publish(
        &self,
        publisher: &PipelineLock,
        run: &str,
        tables: &[TableFiles],
        reserved_tables: &[ExtraTable],
        rests_on: &[HashKey],
        kept: &[String],
    ) -> Result<bool, Fault> {
        let pipeline = publisher.pipeline();
        publisher.check()?;
        inside(self.root(), pipeline)?;
        let mut manifest = Manifest { pipeline: pipeline.to_owned(), run: run.to_owned(), ..Manifest::default() };
        manifest.packs = rests_on.iter().map(HashKey::to_string).collect();
        // Each file of the version, and its current path.
        let mut from: Vec<(PathBuf, String)> = vec![];
        for table in tables {
            let mut listed = ManifestTable { name: table.name.clone(), ..ManifestTable::default() };
            for (i, id) in table.packs.iter().enumerate() {
                let (file, spelt) = (self.file(*id), id.to_string());
                let name = format!("tables/{}/part-{i:05}-{}.parquet", table.name, &spelt[..8]);
                listed.files.push(self.pack_entry(*id, &file, &name)?);
                from.push((file, name));
            }
            if let Some(units) = &table.units {
                let name = format!("units/{}.parquet", table.name);
                listed.units = Some(described(units, &name, None)?);
                from.push((units.clone(), name));
            }
            manifest.tables.push(listed);
        }
        for one in reserved_tables {
            let plain = described(&one.file, "", None)?;
            let hash = plain.hash.clone().unwrap_or_default();
            let name = format!("tables/{}/part-00000-{}.parquet", one.name, hash.get(..8).unwrap_or_default());
            let file = ManifestFile { name: name.clone(), ..plain };
            manifest.tables.push(ManifestTable { name: one.name.clone(), files: vec![file], units: None });
            from.push((one.file.clone(), name));
        }
        let before = newest(self.root(), pipeline).and_then(|folder| Version::with_links(&folder));
        if let Some(version) = &before {
            keep(version, kept, &mut manifest, &mut from);
            if let Some(remote) = self.remote().filter(|_| !kept.is_empty()) {
                remote.own_at_hand(version)?;
            }
        }
        for table in before.iter().flat_map(|v| v.manifest.tables.iter().map(|t| v.folder.join("tables").join(&t.name)))
        {
            if fs::symlink_metadata(&table).is_ok_and(|m| m.is_symlink()) {
                let what =
                    format!("the folder of the table, {}, is a link to a place outside the store", table.display());
                return Err(Fault::machine(what).help("remove the link; the next run publishes the table again"));
            }
        }
        let before = before.filter(Version::has_no_link);
        if before.as_ref().is_some_and(|v| holds(self, v, &manifest)) {
            return Ok(false);
        }
        self.switch(publisher, &manifest, &from, before.as_ref())?;
        Ok(true)
    }

    /// Publishes `version` without one table.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub(super) fn publish_without(
        &self,
        publisher: &PipelineLock,
        version: &Version,
        table: &str,
    ) -> Result<(), Fault> {
        let mut manifest = version.manifest.clone();
        manifest.tables.retain(|t| t.name != table);
        manifest.sum = String::new();
        if let Some(remote) = self.remote() {
            remote.own_at_hand(version)?;
        }
        let files = manifest.tables.iter().flat_map(|t| t.files.iter().chain(&t.units));
        let from: Vec<(PathBuf, String)> = files.map(|f| (version.folder.join(&f.name), f.name.clone())).collect();
        self.switch(publisher, &manifest, &from, Some(version))
    }

    /// Manifest entry of a pack. In the copy of an object store, the file of the pack may be missing.
    fn pack_entry(&self, id: HashKey, file: &Path, name: &str) -> Result<ManifestFile, Fault> {
        if self.remote().is_none() {
            return described(file, name, Some(id.to_string()));
        }
        let size = self.catalogue().by_id(id).map(|pack| pack.size);
        let size = size.ok_or_else(|| Fault::machine(format!("the store no longer contains the pack {id}")))?;
        Ok(ManifestFile { name: name.to_owned(), pack: Some(id.to_string()), hash: None, size, modified_ns: 0 })
    }

    /// Creates a version and points the pipeline's link to it.
    fn switch(
        &self,
        publisher: &PipelineLock,
        manifest: &Manifest,
        from: &[(PathBuf, String)],
        before: Option<&Version>,
    ) -> Result<(), Fault> {
        let (pipeline, folder) = (publisher.pipeline(), self.temporary());
        let sum =
            sum_of(manifest).ok_or_else(|| Fault::machine("the manifest of the version cannot be written as JSON"))?;
        let manifest = &Manifest { sum, ..manifest.clone() };
        self.build(&folder, manifest, from, before)?;
        if let Some(remote) = self.remote() {
            return remote.publish(pipeline, &folder, manifest, &|| publisher.check());
        }
        let number = versions(self.root(), pipeline).last().map_or(1, |(n, _)| n + 1);
        let to = self.root().join("versions").join(pipeline).join(number.to_string());
        self.settle(&folder, &to)?;
        let tables = self.root().join("tables");
        let link = self.temporary();
        let target = format!("../versions/{pipeline}/{number}/tables");
        unix::fs::symlink(target, &link).map_err(|e| io_fault("write", &link, &e))?;
        self.settle(&link, &tables.join(pipeline))
    }

    /// Creates the folder of a version, under a temporary name.
    fn build(
        &self,
        folder: &Path,
        manifest: &Manifest,
        from: &[(PathBuf, String)],
        before: Option<&Version>,
    ) -> Result<(), Fault> {
        let fail = |e: io::Error| io_fault("write", folder, &e);
        make_folder(&folder.join("units")).map_err(fail)?;
        for table in &manifest.tables {
            make_folder(&folder.join("tables").join(&table.name)).map_err(fail)?;
        }
        for (file, name) in from {
            if self.remote().is_some() && is_pack(manifest, name) && !file.exists() {
                continue;
            }
            link(file, &folder.join(name)).map_err(|e| io_fault("write", &folder.join(name), &e))?;
        }
        if let Some(before) = before.filter(|_| self.remote().is_none()) {
            carry(before, folder, manifest).map_err(fail)?;
        }
        let bytes = serde_json::to_vec(manifest).map_err(|e| Fault::machine(e.to_string()))?;
        self.write(&folder.join("version.json"), &bytes)?;
        let folders = manifest.tables.iter().map(|t| folder.join("tables").join(&t.name));
        for one in folders.chain(["tables", "units", ""].map(|name| folder.join(name))) {
            sync_folder(&one).map_err(fail)?;
        }
        Ok(())
    }
}

/// Whether the file `name` of a version is a pack.
fn is_pack(manifest: &Manifest, name: &str) -> bool {
    manifest.tables.iter().flat_map(|t| t.files.iter().chain(&t.units)).any(|f| f.name == name && f.pack.is_some())
}

/// Creates a hard link to a file, or a copy on a file system without hard links.
pub(super) fn link(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        Ok(()) => Ok(()),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Err(e),
        Err(_) => {
            fs::copy(from, to)?;
            let copy = File::options().append(true).open(to)?;
            copy.set_modified(fs::metadata(from)?.modified()?)?;
            copy.sync_all()
        }
    }
}

/// Manifest entry of a file.
fn described(file: &Path, name: &str, pack: Option<String>) -> Result<ManifestFile, Fault> {
    let fail = |e: io::Error| io_fault("read", file, &e);
    let (size, modified_ns) = stamp(&fs::metadata(file).map_err(fail)?);
    let hash = match &pack {
        Some(_) => None,
        None => Some(HashKey::from_parts([fs::read(file).map_err(fail)?]).to_string()),
    };
    Ok(ManifestFile { name: name.to_owned(), pack, hash, size, modified_ns })
}

/// Whether a version contains exactly the files in `manifest`, all intact.
fn holds(store: &Store, version: &Version, manifest: &Manifest) -> bool {
    let old = &version.manifest;
    let pairs = || old.tables.iter().zip(&manifest.tables);
    let files = |t: &ManifestTable| t.files.iter().chain(&t.units).cloned().collect::<Vec<_>>();
    let same = old.packs == manifest.packs
        && old.tables.len() == manifest.tables.len()
        && pairs().all(|(a, b)| {
            let (x, y) = (files(a), files(b));
            a.name == b.name && x.len() == y.len() && x.iter().zip(&y).all(|(x, y)| x.same(y))
        });
    let whole = |file: &ManifestFile| {
        let path = version.folder.join(&file.name);
        if store.remote().is_some() {
            // The catalogue contains all packs; other files are read whole when they are copied.
            return match file.pack.as_deref().and_then(HashKey::parse) {
                Some(id) => store.catalogue().by_id(id).is_some_and(|pack| pack.size == file.size),
                None => true,
            };
        }
        let Ok(about) = fs::metadata(&path) else { return false };
        let now = stamp(&about);
        match file.pack.as_deref().and_then(HashKey::parse) {
            Some(id) => fs::metadata(store.file(id)).is_ok_and(|pack| stamp(&pack) == now),
            None => now == (file.size, file.modified_ns) || sealed::verify(&path).is_ok(),
        }
    };
    same && old.tables.iter().flat_map(files).all(|f| whole(&f))
}

/// Copies the tables `names` from the previous version, with the packs that they reference.
fn keep(before: &Version, names: &[String], manifest: &mut Manifest, from: &mut Vec<(PathBuf, String)>) {
    for table in before.manifest.tables.iter().filter(|t| names.contains(&t.name)) {
        let files = table.files.iter().chain(&table.units);
        from.extend(files.map(|f| (before.folder.join(&f.name), f.name.clone())));
        manifest.tables.push(table.clone());
    }
    if before.manifest.tables.iter().any(|t| names.contains(&t.name)) {
        manifest.packs.extend(before.manifest.packs.iter().cloned());
        manifest.packs.sort();
        manifest.packs.dedup();
    }
}

/// Links the foreign files of the previous version into `folder`, the folder of the new version.
fn carry(before: &Version, folder: &Path, manifest: &Manifest) -> io::Result<()> {
    let ours: HashSet<PathBuf> = before
        .manifest
        .tables
        .iter()
        .flat_map(|t| &t.files)
        .map(|f| before.folder.join(&f.name))
        .chain(before.manifest.tables.iter().map(|t| before.folder.join("tables").join(&t.name)))
        .collect();
    let tables = manifest.tables.iter().map(|t| format!("tables/{}", t.name));
    for part in tables.chain(["tables".to_owned()]) {
        for entry in fs::read_dir(before.folder.join(&part)).into_iter().flatten().flatten() {
            let to = folder.join(&part).join(entry.file_name());
            if entry.file_type()?.is_file() && !ours.contains(&entry.path()) && !to.exists() {
                link(&entry.path(), &to)?;
            }
        }
    }
    Ok(())
}

/// Checks that the name of a pipeline is a link into the store, or does not exist.
fn inside(root: &Path, pipeline: &str) -> Result<(), Fault> {
    let path = root.join("tables").join(pipeline);
    let parts: Vec<Component> = Path::new(pipeline).components().collect();
    let plain = matches!(parts.as_slice(), [Component::Normal(part)] if *part == pipeline);
    let free = fs::symlink_metadata(&path).is_err();
    let folder = root.join("tables");
    let real = fs::symlink_metadata(&folder).is_ok_and(|m| m.is_dir());
    if plain && real && (free || newest(root, pipeline).is_some()) {
        return Ok(());
    }
    let what = format!("{} is not a link to a version of its tables in the store", path.display());
    Err(Fault::machine(what).help("move this file or folder away; the next run publishes the tables again"))
}

//! Maintenance of a store: listing, garbage collection and removal.

use std::{
    collections::HashSet,
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use schemas::{Fault, keys::HashKey};

use super::{
    Store, catalogue, io_fault, pipeline_name,
    version::{Version, current, newest, versions},
};

/// Published table in the listing of a store.
pub struct StoreTableEntry {
    /// Name of the pipeline.
    pub pipeline: String,
    /// Name of the table.
    pub table: String,
    /// Number of rows.
    pub rows: u64,
    /// Number of files.
    pub files: usize,
    /// Size, in bytes.
    pub bytes: u64,
    /// Number of the pipeline's version.
    pub version: u64,
}

/// Names of the pipelines that are published in the store at `root`.
pub fn pipelines(root: &Path) -> Vec<String> {
    let entries = fs::read_dir(root.join("tables")).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
    names.retain(|name| newest(root, name).is_some());
    names.sort();
    names
}

/// All published tables of the store at `root`.
///
/// # Errors
/// Fails if a file cannot be read.
pub fn list(root: &Path) -> Result<Vec<StoreTableEntry>, Fault> {
    let mut found = vec![];
    for pipeline in pipelines(root) {
        let Some(version) = current(root, &pipeline) else { continue };
        for table in &version.manifest.tables {
            let mut rows = 0;
            for file in &table.files {
                let path = version.folder.join(&file.name);
                version.at_hand(table)?;
                let sealed = super::SealedFile::open(&path).map_err(|e| io_fault("read", &path, &e))?;
                rows += sealed.starts().last().copied().unwrap_or(0) as u64;
            }
            found.push(StoreTableEntry {
                pipeline: pipeline.clone(),
                table: table.name.clone(),
                rows,
                files: table.files.len(),
                bytes: table.files.iter().map(|f| f.size).sum(),
                version: version.number,
            });
        }
    }
    Ok(found)
}

/// Options of garbage collection.
#[derive(Clone, Copy, Debug)]
pub struct GcOptions {
    /// Number of versions to keep per pipeline, including the newest.
    pub keep: usize,
    /// Minimum age of removed results.
    pub older_than: Duration,
    /// Whether to report only and remove nothing.
    pub dry: bool,
}

/// Result or preview of garbage collection.
#[derive(Debug, Default)]
pub struct GcReport {
    /// Number of packs.
    pub packs: usize,
    /// Size of the packs, in bytes.
    pub bytes: u64,
    /// Versions, as `pipeline/number`.
    pub versions: Vec<String>,
    /// Number of files whose verification failed.
    pub damaged: usize,
    /// Folders that are kept because they contain files that magline did not write.
    pub foreign: Vec<PathBuf>,
    /// Whether packs are kept because a run holds a lock.
    pub busy: bool,
}

pub(super) fn is_old(path: &Path, than: Duration) -> bool {
    let written = fs::symlink_metadata(path).and_then(|m| m.modified());
    written.is_ok_and(|t| SystemTime::now().duration_since(t).is_ok_and(|age| age >= than))
}

/// Error of `gc` if the manifest of a pipeline's newest version is damaged, because any pack may belong to that
/// version.
pub(super) fn packs_unknown(list: &dyn std::fmt::Display, remedy: &str) -> Fault {
    let help = format!("{remedy} to publish its tables again; then run `magline gc`");
    Fault::machine(format!("{list} is damaged, so the packs that it lists are unknown")).help(help)
}

/// Drops the versions that [`GcOptions`] does not keep, and packs that no version references.
///
/// While another run is in progress, no pack is removed, because the run may reference any pack.
///
/// # Errors
/// Fails if the file system reports an error, or if the newest version's manifest is damaged.
pub fn collect(store: &Store, what: GcOptions) -> Result<GcReport, Fault> {
    if let Some(remote) = store.remote() {
        return remote.collect(store, what);
    }
    let root = store.root();
    let mut done = GcReport::default();
    let alone = store.alone()?;
    done.busy = alone.is_none();
    let mut live: HashSet<String> = HashSet::new();
    let entries = folders_of(&root.join("versions"));
    let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
    names.sort();
    for name in names {
        let now = newest(root, &name);
        // All versions of a removed pipeline are dropped.
        let kept = if now.is_some() { what.keep.max(1) } else { 0 };
        let all = versions(root, &name);
        let spare = all.len().saturating_sub(kept);
        for (i, (number, folder)) in all.into_iter().enumerate() {
            let goes = i < spare && now.as_deref() != Some(&folder) && is_old(&folder, what.older_than);
            if !goes {
                match Version::open(&folder) {
                    Some(version) => live.extend(version.manifest.packs),
                    None if now.as_deref() == Some(&folder) => {
                        let list = folder.join("version.json");
                        return Err(packs_unknown(&list.display(), "run the spec again"));
                    }
                    // No table is read from this version.
                    None => {}
                }
                continue;
            }
            done.versions.push(format!("{name}/{number}"));
            if !what.dry && !drop_version(&folder).map_err(|e| io_fault("remove", &folder, &e))? {
                done.foreign.push(folder);
            }
        }
    }
    for file in fs::read_dir(root.join("damaged")).into_iter().flatten().flatten() {
        if is_old(&file.path(), what.older_than) {
            done.damaged += 1;
            if !what.dry {
                fs::remove_file(file.path()).map_err(|e| io_fault("remove", &file.path(), &e))?;
            }
        }
    }
    if done.busy {
        return Ok(done);
    }
    if !what.dry {
        store.drop_checkpoints(|_| false, Some(what.older_than));
        store.drop_attempts(|_| false, Some(what.older_than));
        store.drop_plans(what.older_than);
    }
    let dead: Vec<(HashKey, u64)> = {
        let catalogue = store.catalogue();
        let unused = catalogue.packs().filter(|p| !live.contains(&p.id.to_string()));
        unused.map(|p| (p.id, p.size)).collect()
    };
    for (id, size) in dead {
        let file = catalogue::path(root, id);
        if !is_old(&file, what.older_than) {
            continue;
        }
        done.packs += 1;
        done.bytes += size;
        if !what.dry {
            fs::remove_file(&file).map_err(|e| io_fault("remove", &file, &e))?;
            store.catalogue_mut().remove(id);
        }
    }
    if !what.dry {
        store.write_index()?;
    }
    Ok(done)
}

/// Size of the results that `gc` would remove now, in bytes. 0 while another run may use them, and for a copy of an
/// object store, which would require many requests.
pub fn unused(store: &Store) -> u64 {
    if store.is_copy() {
        return 0;
    }
    // Errors are ignored here, because `gc` reports them.
    collect(store, GcOptions { keep: 1, older_than: Duration::ZERO, dry: true }).map_or(0, |found| found.bytes)
}

/// Subfolders of a folder, without links.
pub(super) fn folders_of(folder: &Path) -> impl Iterator<Item = fs::DirEntry> + use<> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
}

/// Removes the files that a version lists, and its folders if they are then empty.
fn drop_version(folder: &Path) -> io::Result<bool> {
    let Some(version) = Version::open(folder) else {
        // The contents of this version are unknown; it was never complete.
        return fs::remove_dir_all(folder).map(|()| true);
    };
    let files = version.manifest.tables.iter().flat_map(|t| t.files.iter().chain(&t.units));
    for path in files.map(|f| folder.join(&f.name)).chain([folder.join("version.json")]) {
        match fs::remove_file(&path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
    }
    let tables = version.manifest.tables.iter().map(|t| folder.join("tables").join(&t.name));
    let folders: Vec<PathBuf> =
        tables.chain([folder.join("tables"), folder.join("units"), folder.to_owned()]).collect();
    let mut empty = true;
    for one in &folders {
        match fs::remove_dir(one) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            Err(_) => empty = false,
            Ok(()) => {}
        }
    }
    Ok(empty)
}

/// Removes a published pipeline, or one of its tables. Computed results stay until `gc`.
///
/// # Errors
/// Fails if the pipeline or table does not exist, a run holds the lock of the pipeline, or the file system reports an
/// error.
pub fn remove(store: &Store, pipeline: &str, table: Option<&str>) -> Result<(), Fault> {
    let root = store.root();
    let names = pipelines(root);
    let unknown = || Fault::new(format!("there is no pipeline `{pipeline}` in the store")).nearest(pipeline, &names);
    // Nothing is locked for an unknown name.
    if pipeline_name(pipeline).is_err() || !names.iter().any(|name| name == pipeline) {
        return Err(unknown());
    }
    let publisher = store.publisher(pipeline, false)?;
    let version = current(root, pipeline).ok_or_else(unknown)?;
    let Some(table) = table else {
        if let Some(remote) = store.remote() {
            remote.unpublish(pipeline)?;
        }
        let link = root.join("tables").join(pipeline);
        fs::remove_file(&link).map_err(|e| io_fault("remove", &link, &e))?;
        let plan = root.join("plans").join(format!("{pipeline}.json"));
        return match fs::remove_file(&plan) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(io_fault("remove", &plan, &e)),
            _ => Ok(()),
        };
    };
    let known: Vec<&str> = version.manifest.tables.iter().map(|t| t.name.as_str()).collect();
    if !known.contains(&table) {
        return Err(Fault::new(format!("there is no table `{pipeline}.{table}`")).nearest(table, &known));
    }
    store.publish_without(&publisher, &version, table)
}

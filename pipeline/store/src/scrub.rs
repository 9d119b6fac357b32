//! Verification of a store: every byte that a run has written, against its checksum.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use schemas::{Fault, keys::HashKey, paths};

use super::{
    COSTS, LAYOUT, PackReader, Store, catalogue, checkpoints, io_fault, lock, note, pipeline_name, plans,
    sealed::{StoreFileFault, verify},
    tend::folders_of,
    version::{Version, newest, versions},
};

/// Note for a damaged file that the next run does not repair.
const OLDER: &str = "; it belongs to an older version, which `magline gc --yes` removes";

/// Functions that check whether the records that other crates write into a store are intact.
#[derive(Clone, Copy, Debug)]
pub struct RecordChecks {
    /// Check of a file of `runs`, the history of a pipeline.
    pub runs: fn(&[u8]) -> bool,
    /// Check of a file of `costs`.
    pub costs: fn(&[u8]) -> bool,
}

/// Result of the verification of a store.
#[derive(Debug, Default)]
pub struct ScrubReport {
    /// Number of files read.
    pub files: usize,
    /// Bytes read.
    pub bytes: u64,
    /// Damaged files, with the reason.
    pub damaged: BTreeMap<PathBuf, String>,
}

/// Whether the mark of the store at `root` is damaged; opening a store for writing rewrites a damaged mark.
pub fn mark_is_damaged(root: &Path) -> bool {
    paths::read_regular(&root.join("STORE")).is_ok_and(|bytes| bytes != LAYOUT.as_bytes())
}

/// Reads every byte of a store. Quarantines packs whose verification fails. The next run recomputes the results in
/// these packs, and republishes damaged tables.
///
/// # Errors
/// Fails if a file cannot be read.
pub fn scrub(store: &Store, checks: RecordChecks, tick: &(dyn Fn(usize, usize) + Sync)) -> Result<ScrubReport, Fault> {
    if let Some(remote) = store.remote() {
        return remote.scrub(store, checks, tick);
    }
    let found = read(store.root(), store, checks, tick)?;
    store.write_index()?;
    Ok(found)
}

/// Reads every byte of the store at `root` and changes nothing, for a read-only store.
///
/// # Errors
/// Fails if a file cannot be read.
pub fn scrub_read_only(
    root: &Path,
    checks: RecordChecks,
    tick: &(dyn Fn(usize, usize) + Sync),
) -> Result<ScrubReport, Fault> {
    read(root, &PackReader::open(root)?, checks, tick)
}

fn read(
    root: &Path,
    objects: &PackReader,
    checks: RecordChecks,
    tick: &(dyn Fn(usize, usize) + Sync),
) -> Result<ScrubReport, Fault> {
    let mut found = ScrubReport::default();
    for text in objects.damaged() {
        let (path, why) = text.split_once(": ").unwrap_or((&text, ""));
        found.damaged.insert(PathBuf::from(path), why.to_owned());
    }
    small(root, checks, &mut found)?;
    let packs: Vec<HashKey> = objects.catalogue().packs().map(|p| p.id).collect();
    // Each file, its key if it is a pack, and a note for the report.
    let mut files: Vec<(PathBuf, Option<HashKey>, &str)> =
        packs.iter().map(|id| (objects.file(*id), Some(*id), "")).collect();
    for pipeline in folders_of(&root.join("versions")) {
        let name = pipeline.file_name();
        let Some(name) = name.to_str() else { continue };
        let now = newest(root, name);
        for (_, folder) in versions(root, name) {
            // No run republishes an older version.
            let more = if now.as_ref() == Some(&folder) { "" } else { OLDER };
            let Some(version) = Version::open(&folder) else {
                let why = format!("its checksum is wrong, or it is a link to a place outside the store{more}");
                found.damaged.insert(folder.join("version.json"), why);
                continue;
            };
            // Links to packs are checked with the packs; copies of packs are checked here.
            let own = version.manifest.tables.iter().flat_map(|t| t.files.iter().chain(&t.units));
            let is_link = |pack: &Option<String>, file: &Path| {
                let id = pack.as_deref().and_then(HashKey::parse);
                id.is_some_and(|id| same_file(file, &objects.file(id)))
            };
            let own = own.map(|f| (folder.join(&f.name), &f.pack)).filter(|(file, pack)| !is_link(pack, file));
            files.extend(own.map(|(file, _)| (file, None, more)));
        }
    }
    for folder in entries(&root.join("quality")) {
        files.extend(entries(&folder).into_iter().map(|file| (file, None, "")));
    }
    let all = files.len();
    for (i, (file, pack, more)) in files.into_iter().enumerate() {
        tick(i, all);
        found.files += 1;
        found.bytes += fs::metadata(&file).map_or(0, |m| m.len());
        match verify(&file) {
            Ok(()) => {}
            Err(StoreFileFault::Machine(why)) => return Err(io_fault("read", &file, &why)),
            Err(other) => {
                if let Some(id) = pack {
                    objects.set_aside(id, &other.to_string());
                }
                found.damaged.insert(file, format!("{other}{more}"));
            }
        }
    }
    Ok(found)
}

/// Checks the small files of a store, each of which is read whole and can be verified without other files.
fn small(root: &Path, checks: RecordChecks, found: &mut ScrubReport) -> Result<(), Fault> {
    let mut check = |file: PathBuf, is_whole: &dyn Fn(&str, &[u8]) -> bool| -> Result<(), Fault> {
        let bytes = match paths::read_regular(&file) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            Err(e) if e.kind() == std::io::ErrorKind::InvalidInput => {
                found.damaged.insert(file, e.to_string());
                return Ok(());
            }
            Err(e) => return Err(io_fault("read", &file, &e)),
        };
        let name = file.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
        found.files += 1;
        found.bytes += bytes.len() as u64;
        if !is_whole(&name, &bytes) {
            found.damaged.insert(file, "its checksum is wrong".to_owned());
        }
        Ok(())
    };
    check(root.join("index"), &|_, bytes| catalogue::parse(bytes).is_some())?;
    for folder in SMALL {
        for file in entries(&root.join(folder)) {
            check(file, &|name, bytes| is_whole(folder, name, bytes, checks))?;
        }
    }
    for file in entries(&root.join("locks")) {
        check(file, &lock::is_whole)?;
    }
    Ok(())
}

/// Folders of small files, each of which can be verified without other files. Stores on disk and in object stores have
/// the same folders.
pub(super) const SMALL: [&str; 5] = ["sources", "plans", "runs", COSTS, checkpoints::FOLDER];

/// Whether the file `name` of one of the folders [`SMALL`] is intact.
pub(super) fn is_whole(folder: &str, name: &str, bytes: &[u8], checks: RecordChecks) -> bool {
    match folder {
        "sources" => note::is_whole(bytes),
        "plans" => match name.strip_suffix(".json") {
            Some(pipeline) => pipeline_name(pipeline).is_ok() && note::is_whole(bytes),
            None => plans::is_whole(name, bytes),
        },
        "runs" => match name.strip_suffix(".jsonl") {
            Some(pipeline) => pipeline_name(pipeline).is_ok() && (checks.runs)(bytes),
            None => name == format!("{}.json", HashKey::from_parts([bytes])),
        },
        COSTS => (checks.costs)(bytes),
        checkpoints::FOLDER => checkpoints::is_whole(bytes),
        _ => true,
    }
}

/// Entries of a folder, sorted.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    found.sort();
    found
}

fn same_file(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    match (fs::metadata(a), fs::metadata(b)) {
        (Ok(a), Ok(b)) => (a.dev(), a.ino()) == (b.dev(), b.ino()),
        _ => false,
    }
}

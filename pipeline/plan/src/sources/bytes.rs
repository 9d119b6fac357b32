//! Hash of a file's bytes, and the conditions under which a recorded hash is reused.

use std::{
    fs,
    io::{self, Read},
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use schemas::{Fault, keys::HashKey, paths};
use serde::{Deserialize, Serialize};
use store::{Store, note};

use super::files::walk;

/// File or folder, and the hash of its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileDigest {
    /// Path, as written in the spec.
    pub path: PathBuf,
    /// Hash of all bytes of the file or folder.
    pub hash: HashKey,
}

/// Policy for reusing recorded data of unchanged files.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReusePolicy<'a> {
    /// Store with cached facts of the files.
    pub store: Option<&'a Path>,
    /// Whether the bytes of every file are read, even if it appears unchanged.
    pub read_all: bool,
    /// Minimum time since the last change of a file. A more recently changed file is skipped, because another program
    /// may still be writing it.
    pub settle: Option<Duration>,
}

/// The properties that identify a version of a file, so that its bytes need not be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct FileStamp {
    size: u64,
    modified_ns: i64,
    /// Time at which the file system last wrote the file or its metadata; no program can set it.
    changed_ns: i64,
    inode: u64,
}

/// Fact about a file, and the time at which the file was read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct FileFact {
    stamp: FileStamp,
    /// The time at which reading of the file began.
    at_ns: i64,
    /// The fact, such as the hash of the file.
    pub(super) found: String,
}

/// Minimum time between change and reading of a trusted file, in nanoseconds. File-system clocks may stand still for up
/// to 2 s, so a later change could have the same change time.
const RACY_NS: i64 = 2_000_000_000;

impl FileStamp {
    #[cfg(unix)]
    pub(super) fn from_path(path: &Path) -> io::Result<FileStamp> {
        use std::os::unix::fs::MetadataExt;
        let about = fs::metadata(path)?;
        let ns = |s: i64, ns: i64| s.saturating_mul(1_000_000_000).saturating_add(ns);
        Ok(FileStamp {
            size: about.len(),
            modified_ns: ns(about.mtime(), about.mtime_nsec()),
            changed_ns: ns(about.ctime(), about.ctime_nsec()),
            inode: about.ino(),
        })
    }

    #[cfg(not(unix))]
    pub(super) fn from_path(path: &Path) -> io::Result<FileStamp> {
        let about = fs::metadata(path)?;
        let modified_ns = ns_of(about.modified()?);
        Ok(FileStamp { size: about.len(), modified_ns, changed_ns: modified_ns, inode: 0 })
    }
}

fn ns_of(time: SystemTime) -> i64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}

impl FileFact {
    /// The result of `find` on a file; it is not cached if the file changes meanwhile.
    pub(super) fn by<T, E>(
        path: &Path,
        find: impl FnOnce() -> Result<T, E>,
        found: impl FnOnce(&T) -> Option<String>,
    ) -> Result<(T, Option<FileFact>), E> {
        let (at_ns, before) = (ns_of(SystemTime::now()), FileStamp::from_path(path).ok());
        let value = find()?;
        let stamp = before.filter(|stamp| FileStamp::from_path(path).is_ok_and(|after| after == *stamp));
        let seen = stamp.zip(found(&value)).map(|(stamp, found)| FileFact { stamp, at_ns, found });
        Ok((value, seen))
    }

    /// Whether the file is unchanged, as far as can be determined without reading it.
    pub(super) fn is_of(&self, path: &Path) -> bool {
        FileStamp::from_path(path).is_ok_and(|now| now == self.stamp)
    }

    /// Same check for a fact that an earlier process recorded. In addition, the file must have been unchanged for
    /// `RACY_NS` when it was read.
    fn still_is_of(&self, path: &Path) -> bool {
        self.is_of(path) && self.stamp.changed_ns.saturating_add(RACY_NS) <= self.at_ns
    }

    /// The cached fact `key` of an unchanged file.
    pub(super) fn known(store: &Path, key: HashKey, path: &Path) -> Option<FileFact> {
        let seen: FileFact = paths::read_regular(&note(store, key)).ok().and_then(|bytes| note::unsealed(&bytes))?;
        seen.still_is_of(path).then_some(seen)
    }

    /// The same fact, with a much later time of reading.
    #[cfg(test)]
    pub(super) fn older(mut self) -> FileFact {
        self.at_ns += 10 * RACY_NS;
        self
    }

    /// Caches the fact under `key`. If this fails, the file is read again next time.
    pub(super) fn keep(&self, store: &Store, key: HashKey) {
        if let Ok(text) = note::sealed(self) {
            let _ = store.write(&note(store.root(), key), &text);
        }
    }
}

fn note(store: &Path, key: HashKey) -> PathBuf {
    store.join("sources").join(format!("{key}.seen"))
}

/// The key of all bytes of a file or folder. An unchanged file is not read again, unless
/// `read_all` is set.
///
/// # Errors
/// Fails if the file cannot be read.
pub fn fingerprint(store: &Store, path: &Path, read_all: bool) -> Result<FileDigest, Fault> {
    let fail = |e: io::Error| Fault::machine(format!("cannot read {}: {e}", path.display()));
    let hash = if path.is_dir() {
        let mut files = vec![];
        walk(path, &mut files).map_err(fail)?;
        let mut parts = vec![];
        for file in files {
            parts.push(file.strip_prefix(path).unwrap_or(&file).to_string_lossy().into_owned());
            parts.push(one(store, &file, read_all).map_err(fail)?.to_string());
        }
        HashKey::from_parts(parts)
    } else {
        one(store, path, read_all).map_err(fail)?
    };
    Ok(FileDigest { path: path.to_owned(), hash })
}

fn one(store: &Store, path: &Path, read_all: bool) -> io::Result<HashKey> {
    let full = path.canonicalize()?;
    let key = HashKey::from_parts([full.to_string_lossy().as_bytes()]);
    let known = if read_all { None } else { FileFact::known(store.root(), key, path) };
    if let Some(hash) = known.and_then(|seen| HashKey::parse(&seen.found)) {
        return Ok(hash);
    }
    let (hash, seen) = FileFact::by(path, || hash_file(path), |hash| Some(hash.to_string()))?;
    if let Some(seen) = seen {
        seen.keep(store, key);
    }
    Ok(hash)
}

/// The key of the bytes of a file.
///
/// # Errors
/// Fails if the file cannot be read.
pub(super) fn hash_file(path: &Path) -> io::Result<HashKey> {
    let mut hasher = blake3::Hasher::new();
    let mut file = fs::File::open(path)?;
    let mut buffer = vec![0; 1 << 20];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(HashKey::finish(&hasher)),
            n => hasher.update(&buffer[..n]),
        };
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::Duration;

    use tempfile::TempDir;

    use super::*;

    fn aged(path: &Path) {
        // Sets a later time of reading, instead of waiting for 2 s.
        for entry in fs::read_dir(path.join("sources")).unwrap().flatten() {
            let seen: FileFact = note::unsealed(&fs::read(entry.path()).unwrap()).unwrap();
            fs::write(entry.path(), note::sealed(&seen.older()).unwrap()).unwrap();
        }
    }

    fn touched(path: &Path, time: SystemTime) {
        fs::File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
    }

    #[test]
    fn unit_a_changed_file_of_equal_size_and_time_is_recognised() {
        let folder = TempDir::new().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        let path = folder.path().join("a.csv");
        let hash = |read_all| fingerprint(&store, &path, read_all).unwrap().hash;
        for trial in 0..5 {
            fs::write(&path, format!("old {trial}")).unwrap();
            let time = fs::metadata(&path).unwrap().modified().unwrap();
            let old = hash(false);
            if trial % 2 == 0 {
                // If a file is read long after it was written, its change time distinguishes it from later versions.
                aged(store.root());
                std::thread::sleep(Duration::from_millis(20));
            }
            if trial == 4 {
                let other = folder.path().join("b.csv");
                fs::write(&other, format!("new {trial}")).unwrap();
                fs::rename(&other, &path).unwrap();
            } else {
                fs::write(&path, format!("new {trial}")).unwrap();
            }
            touched(&path, time);
            assert_ne!(hash(false), old, "{trial}");
        }
    }

    #[test]
    fn unit_an_unchanged_file_is_read_again_only_when_young_or_on_request() {
        let folder = TempDir::new().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        let path = folder.path().join("a.csv");
        fs::write(&path, "text").unwrap();
        let right = fingerprint(&store, &path, false).unwrap().hash;
        let note = fs::read_dir(store.root().join("sources")).unwrap().flatten().next().unwrap().path();
        let wrong = HashKey::from_parts(["wrong"]);
        let lie = |later_ns: i64| {
            let mut seen: FileFact = note::unsealed(&fs::read(&note).unwrap()).unwrap();
            (seen.found, seen.at_ns) = (wrong.to_string(), seen.at_ns + later_ns);
            fs::write(&note, note::sealed(&seen).unwrap()).unwrap();
        };
        lie(0);
        assert_eq!(fingerprint(&store, &path, false).unwrap().hash, right, "too young to be trusted");
        lie(2 * RACY_NS);
        assert_eq!(fingerprint(&store, &path, false).unwrap().hash, wrong, "known, and not read");
        assert_eq!(fingerprint(&store, &path, true).unwrap().hash, right, "read, as asked for");
    }

    #[test]
    fn unit_damaged_notes_are_ignored() {
        let folder = TempDir::new().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        let path = folder.path().join("a.csv");
        fs::write(&path, "text").unwrap();
        let right = fingerprint(&store, &path, false).unwrap().hash;
        aged(store.root());
        let note = fs::read_dir(store.root().join("sources")).unwrap().flatten().next().unwrap().path();
        let whole = fs::read(&note).unwrap();
        for at in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[at] ^= 1 << (at % 8);
            fs::write(&note, flipped).unwrap();
            assert_eq!(fingerprint(&store, &path, false).unwrap().hash, right, "{at}");
        }
        fs::write(&note, "").unwrap();
        assert_eq!(fingerprint(&store, &path, false).unwrap().hash, right);
    }
}

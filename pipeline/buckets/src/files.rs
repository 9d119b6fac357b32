//! Inputs in object stores: copied into the cache under their own names, and copied again when the server reports
//! another version. Results depend only on the bytes of the inputs, as with local files.

use std::{
    collections::BTreeSet,
    fs::{self, File},
    io::Write,
    path::{Component, Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
};

use schemas::Fault;

use super::{
    address::{ObjectAddress, StorageLocation, place},
    bucket::{Bucket, ObjectEntry, each},
    cache,
    connect::connect,
};

/// Special characters of a pattern.
const WILD: [char; 3] = ['*', '?', '['];

/// Bucket, and the folder of its copies.
struct BucketCache {
    bucket: Bucket,
    folder: PathBuf,
}

fn io_fault(doing: &str, path: &Path, e: &std::io::Error) -> Fault {
    Fault::machine(format!("cannot {doing} {}: {e}", path.display()))
}

/// Folder and name of an object.
fn parts(key: &str) -> (&str, &str) {
    key.rsplit_once('/').unwrap_or(("", key))
}

/// Name without its extension.
fn stem(key: &str) -> &str {
    let (folder, name) = parts(key);
    let cut = name.rfind('.').filter(|at| *at > 0).unwrap_or(name.len());
    let before = if folder.is_empty() { 0 } else { folder.len() + 1 };
    key.get(..before + cut).unwrap_or(key)
}

/// Whether an object is a companion of `key`, such as the header of a grid: it is in the same folder, and its name is
/// the stem of `key`, alone or followed by a dot.
fn is_companion(key: &str, other: &str) -> bool {
    parts(key).0 == parts(other).0
        && other.strip_prefix(stem(key)).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

impl BucketCache {
    fn from_address(address: &ObjectAddress) -> Result<BucketCache, Fault> {
        let folder = cache::of_files(address)?;
        let root = ObjectAddress { key: String::new(), ..address.clone() };
        Ok(BucketCache { bucket: connect(&root)?, folder })
    }

    /// File of an object.
    fn file(&self, key: &str) -> Result<PathBuf, Fault> {
        let relative = Path::new(key);
        let plain = relative.components().all(|c| matches!(c, Component::Normal(_)));
        if !plain || key.is_empty() || key.contains('\\') {
            return Err(Fault::new(format!("{} is not a valid file name", self.bucket.address().below(key))));
        }
        Ok(self.folder.join(relative))
    }

    /// Copies an object, unless its copy has the same version.
    fn bring(&self, about: &ObjectEntry) -> Result<PathBuf, Fault> {
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        let file = self.file(&about.key)?;
        let (folder, name) = match (file.parent(), file.file_name()) {
            (Some(folder), Some(name)) => (folder, name.to_string_lossy().into_owned()),
            _ => return Err(Fault::bug("an object has no name")),
        };
        let note = folder.join(format!(".{name}.etag"));
        let version = match &about.tag {
            Some(tag) => format!("{} {tag}\n", about.size),
            None => format!("{} {:?}\n", about.size, about.modified),
        };
        let same = || fs::metadata(&file).is_ok_and(|m| m.is_file() && m.len() == about.size);
        if fs::read_to_string(&note).is_ok_and(|known| known == version) && same() {
            return Ok(file);
        }
        fs::create_dir_all(folder).map_err(|e| io_fault("make", folder, &e))?;
        let unfinished =
            folder.join(format!(".{name}.{}-{}.new", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed)));
        let fetched = self.bucket.fetch(&about.key, &unfinished, Some(about.size)).and_then(|there| {
            if there {
                return Ok(());
            }
            let what = format!("{} was removed during reading", self.bucket.address().below(&about.key));
            Err(Fault::machine(what).help("run again"))
        });
        // The note on the copy is removed before the copy is replaced, so that a note never names the version of
        // another copy.
        let settled = fetched.and_then(|()| {
            match fs::remove_file(&note) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(io_fault("remove", &note, &e)),
                _ => {}
            }
            fs::rename(&unfinished, &file).map_err(|e| io_fault("write", &file, &e))?;
            let written = File::create(&unfinished)
                .and_then(|mut f| f.write_all(version.as_bytes()))
                .and_then(|()| fs::rename(&unfinished, &note));
            written.map_err(|e| io_fault("write", &note, &e))
        });
        if settled.is_err() {
            let _ = fs::remove_file(&unfinished);
        }
        settled.map(|()| file)
    }

    fn bring_all(&self, wanted: &[&ObjectEntry]) -> Result<Vec<PathBuf>, Fault> {
        each(wanted, |about| self.bring(about))
    }

    /// Removes copies whose objects no longer exist: all copies below `folder` that belong to an input according to
    /// `are_of`, except those in `known`.
    fn forget(&self, folder: &Path, known: &BTreeSet<PathBuf>, are_of: &dyn Fn(&Path) -> bool) {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                self.forget(&path, known, are_of);
            } else if !known.contains(&path) && are_of(&path) && !entry.file_name().to_string_lossy().starts_with('.') {
                // A copy that cannot be removed does no harm: only the objects of the listing are read as inputs.
                let _ = fs::remove_file(&path);
            }
        }
    }
}

/// Whether a part of a name below `folder` is hidden, as in a folder of files.
fn is_hidden(key: &str, folder: &str) -> bool {
    let below = key.strip_prefix(folder).unwrap_or(key).trim_start_matches('/');
    below.split('/').any(|part| part.starts_with(['.', '_']))
}

/// Copies of the flights at an address: one object, objects that match a pattern, or objects of a folder whose names
/// `fit` accepts. Companions of the same name are copied too.
///
/// # Errors
/// Fails if no object matches, or the server cannot be reached or reports an error.
pub fn find(address: &ObjectAddress, fit: &dyn Fn(&str) -> bool) -> Result<Vec<PathBuf>, Fault> {
    let copies = BucketCache::from_address(address)?;
    let key = address.key.as_str();
    let exact = if key.is_empty() { None } else { copies.bucket.about(key)? };
    let (all, wanted): (Vec<ObjectEntry>, Vec<String>) = match exact {
        Some(about) => {
            let all = copies.bucket.list_flat(parts(key).0)?;
            (if all.is_empty() { vec![about] } else { all }, vec![key.to_owned()])
        }
        None if key.contains(WILD) => {
            let pattern =
                glob::Pattern::new(key).map_err(|e| Fault::new(format!("`{address}` is not a pattern: {e}")))?;
            let plain = key.split(WILD).next().unwrap_or_default();
            let all = copies.bucket.list(parts(plain).0)?;
            let options = glob::MatchOptions { require_literal_separator: true, ..glob::MatchOptions::new() };
            let wanted = all.iter().filter(|o| pattern.matches_with(&o.key, options)).map(|o| o.key.clone()).collect();
            (all, wanted)
        }
        None => {
            let all = copies.bucket.list(key)?;
            let wanted = all.iter().filter(|o| o.key != key && !is_hidden(&o.key, key) && fit(&o.key));
            let wanted = wanted.map(|o| o.key.clone()).collect();
            (all, wanted)
        }
    };
    if all.is_empty() {
        return Err(Fault::new(format!("there is no object or folder {address}")));
    }
    let stems: BTreeSet<&str> = wanted.iter().map(|key| stem(key)).collect();
    // The stem of a companion may include a further extension: `a.tif` and `a.tif.aux.xml`.
    let is_wanted =
        |o: &&ObjectEntry| stems.contains(stem(&o.key)) || wanted.iter().any(|key| is_companion(key, &o.key));
    let brought: Vec<&ObjectEntry> = all.iter().filter(is_wanted).collect();
    copies.bring_all(&brought)?;
    wanted.iter().map(|key| copies.file(key)).collect()
}

/// Copy of one object.
///
/// # Errors
/// Fails if the object does not exist, or the server cannot be reached or reports an error.
pub fn fixed(address: &ObjectAddress) -> Result<PathBuf, Fault> {
    let copies = BucketCache::from_address(address)?;
    match copies.bucket.about(&address.key)? {
        Some(about) => copies.bring(&about),
        None => Err(Fault::new(format!("there is no object {address}"))),
    }
}

/// Copy of an object with its companions of the same name, or of a folder.
///
/// # Errors
/// Fails if the object does not exist, or the server cannot be reached or reports an error.
pub fn whole(address: &ObjectAddress) -> Result<PathBuf, Fault> {
    let copies = BucketCache::from_address(address)?;
    let key = address.key.as_str();
    let flat = copies.bucket.list_flat(parts(key).0)?;
    if flat.iter().any(|o| o.key == key) {
        let wanted: Vec<&ObjectEntry> = flat.iter().filter(|o| is_companion(key, &o.key)).collect();
        let known: BTreeSet<PathBuf> = copies.bring_all(&wanted)?.into_iter().collect();
        let file = copies.file(key)?;
        if let Some(folder) = file.parent() {
            let relative = |path: &Path| path.strip_prefix(&copies.folder).map(|p| p.to_string_lossy().into_owned());
            copies.forget(folder, &known, &|path| relative(path).is_ok_and(|other| is_companion(key, &other)));
        }
        return Ok(file);
    }
    let all = copies.bucket.list(key)?;
    let wanted: Vec<&ObjectEntry> = all.iter().filter(|o| o.key != key && !is_hidden(&o.key, key)).collect();
    if wanted.is_empty() {
        return Err(Fault::new(format!("there is no object or folder {address}")));
    }
    let known: BTreeSet<PathBuf> = copies.bring_all(&wanted)?.into_iter().collect();
    let folder = copies.file(key)?;
    copies.forget(&folder, &known, &|_| true);
    Ok(folder)
}

/// Copies the object that belongs to `path`, a file of the cache to which another file of the cache refers. Ignores
/// paths outside the cache.
///
/// # Errors
/// Fails if the server cannot be reached or reports an error.
pub fn fetch_companion(path: &Path) -> Result<(), Fault> {
    match place(&cache::shown(path))? {
        StorageLocation::Object(address) => {
            let copies = BucketCache::from_address(&address)?;
            copies.bucket.about(&address.key)?.map_or(Ok(()), |about| copies.bring(&about).map(drop))
        }
        StorageLocation::Path(_) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use object_store::memory::InMemory;

    use super::*;
    use crate::address::ObjectStoreScheme;

    fn copies(folder: &Path) -> BucketCache {
        let address = ObjectAddress { scheme: ObjectStoreScheme::S3, bucket: "b".to_owned(), key: String::new() };
        BucketCache { bucket: Bucket::new(Arc::new(InMemory::new()), address), folder: folder.to_owned() }
    }

    #[test]
    fn unit_copy_is_replaced_only_for_another_version() {
        let folder = tempfile::tempdir().unwrap();
        let copies = copies(folder.path());
        let listed = || copies.bucket.list("").unwrap();
        copies.bucket.put("f/a.csv", b"one".to_vec()).unwrap();
        let file = copies.bring(&listed()[0]).unwrap();
        assert_eq!(
            (fs::read(&file).unwrap(), file.strip_prefix(folder.path()).unwrap()),
            (b"one".to_vec(), Path::new("f/a.csv"))
        );
        // A copy of the correct size is kept, a truncated copy is not.
        fs::write(&file, "ONE").unwrap();
        copies.bring(&listed()[0]).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"ONE");
        fs::write(&file, "o").unwrap();
        copies.bring(&listed()[0]).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"one");
        // Another version with the same length.
        copies.bucket.put("f/a.csv", b"two".to_vec()).unwrap();
        copies.bring(&listed()[0]).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"two");
        // An object that was written between listing and reading is detected by its length.
        copies.bucket.put("f/a.csv", b"four".to_vec()).unwrap();
        let before = listed();
        copies.bucket.put("f/a.csv", b"three".to_vec()).unwrap();
        assert!(copies.bring(&before[0]).unwrap_err().to_string().contains("truncated"));
        assert_eq!(fs::read(&file).unwrap(), b"two");
        copies.bring(&listed()[0]).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"three");
    }

    #[test]
    fn unit_object_names_stay_inside_the_cache() {
        let folder = tempfile::tempdir().unwrap();
        let copies = copies(folder.path());
        for wrong in ["../x", "a/../../x", "/x", "", "a\\..\\x"] {
            assert!(copies.file(wrong).is_err(), "{wrong}");
        }
        assert_eq!(copies.file("a/b=1/c").unwrap(), folder.path().join("a/b=1/c"));
    }

    #[test]
    fn unit_companions_share_the_name_of_their_file() {
        assert!(
            is_companion("m/a.ers", "m/a")
                && is_companion("m/a.tif", "m/a.tif.aux.xml")
                && is_companion("m/a.asc", "m/a.prj")
        );
        assert!(
            !is_companion("m/a.tif", "m/ab.tif")
                && !is_companion("m/a.tif", "a.tif")
                && !is_companion("m/a.tif", "m/a/b.tif")
        );
        assert_eq!((stem("x/.a"), stem("x.y/a"), stem("a.b.c")), ("x/.a", "x.y/a", "a.b"));
    }
}

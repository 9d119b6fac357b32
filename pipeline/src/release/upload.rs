//! Published set at an address of an object store: the set is written to a folder first, and the folder is then copied.
//!
//! `SHA256SUMS` is written last. Before one set replaces another, the old list is removed first. Verification thus
//! finds a complete set, or none.

use std::{collections::BTreeMap, path::Path};

use buckets::{Bucket, ObjectAddress, connect, each};
use schemas::Fault;

use super::{checksums, folder::files, set::FORMAT, words::DICTIONARY};

/// Copies the set in `folder` to `address`. Returns `false` if the same set already exists, which then stays unchanged.
///
/// # Errors
/// Fails if there are other objects that must be kept, the set cannot be read, or the server cannot be reached or
/// reports an error.
pub fn upload(folder: &Path, address: &ObjectAddress, replace: bool) -> Result<bool, Fault> {
    copied(folder, &connect(address)?, replace)
}

fn copied(folder: &Path, bucket: &Bucket, replace: bool) -> Result<bool, Fault> {
    let address = bucket.address();
    let fail = |e: std::io::Error| Fault::machine(format!("cannot read {}: {e}", folder.display()));
    let own = files(folder).map_err(fail)?;
    let sums = std::fs::read(folder.join(checksums::NAME)).map_err(fail)?;
    let there: Vec<String> = bucket.list("")?.into_iter().map(|o| o.key).collect();
    let known = if there.is_empty() { BTreeMap::new() } else { set_at(bucket, &there)? };
    if !there.is_empty() {
        if bucket.get(checksums::NAME)?.as_ref() == Some(&sums) && own.iter().all(|name| there.contains(name)) {
            return Ok(false);
        }
        if !replace {
            let fault = Fault::new(format!("{address} already holds another published set"));
            return Err(fault.help("give another address, or replace that set with `--replace`"));
        }
        bucket.remove(checksums::NAME)?;
    }
    let data: Vec<&String> = own.iter().filter(|name| *name != checksums::NAME && !name.ends_with('/')).collect();
    each(&data, |name| bucket.put_file(name, &folder.join(name)))?;
    let old: Vec<&String> = known.keys().filter(|name| !own.contains(name)).collect();
    each(&old, |name| bucket.remove(name))?;
    bucket.put(checksums::NAME, sums)?;
    Ok(true)
}

/// Files of the existing set, from its list of checksums.
fn set_at(bucket: &Bucket, there: &[String]) -> Result<BTreeMap<String, String>, Fault> {
    let text = |name: &str| -> Result<String, Fault> {
        Ok(bucket.get(name)?.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default())
    };
    let dictionary = text(DICTIONARY)?;
    let is_set = serde_json::from_str::<serde_json::Value>(&dictionary).is_ok_and(|d| d["format"] == FORMAT);
    let other = |what: String| {
        let fault = Fault::new(format!("{} {what}", bucket.address()));
        fault.help("give a new or empty address; `--replace` replaces only a published set")
    };
    let sums = text(checksums::NAME)?;
    if !is_set {
        return Err(other("contains objects that are not a published set".to_owned()));
    }
    // After an interrupted replacement there is no list, and all files are written again.
    let sums = checksums::read(&sums).unwrap_or_default();
    let foreign = there.iter().find(|name| *name != checksums::NAME && !sums.is_empty() && !sums.contains_key(*name));
    match foreign {
        Some(name) => Err(other(format!("contains {name}, which does not belong to the published set"))),
        None => Ok(sums),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::{fs, sync::Arc};

    use object_store::memory::InMemory;

    use super::*;
    use buckets::{StorageLocation, place};

    #[test]
    fn unit_set_is_copied_once_and_replaces_only_another_set() {
        let Ok(StorageLocation::Object(address)) = place("s3://b/set") else { unreachable!("an address") };
        let bucket = Bucket::new(Arc::new(InMemory::new()), address);
        let folder = tempfile::tempdir().unwrap();
        let written = |files: &[(&str, &str)]| {
            fs::remove_dir_all(folder.path()).unwrap();
            fs::create_dir_all(folder.path().join("data")).unwrap();
            let dictionary = format!("{{\"format\": \"{FORMAT}\"}}");
            let mut sums = BTreeMap::new();
            for (name, text) in files.iter().chain([&(DICTIONARY, dictionary.as_str())]) {
                fs::write(folder.path().join(name), text).unwrap();
                sums.insert((*name).to_owned(), checksums::of_bytes(text.as_bytes()));
            }
            fs::write(folder.path().join(checksums::NAME), checksums::write(&sums)).unwrap();
        };
        let names = || bucket.list("").unwrap().into_iter().map(|o| o.key).collect::<Vec<_>>();
        written(&[("data/a", "1"), ("README.md", "x")]);
        assert!(copied(folder.path(), &bucket, false).unwrap());
        assert_eq!(names(), ["README.md", "SHA256SUMS", "data/a", DICTIONARY]);
        assert!(!copied(folder.path(), &bucket, false).unwrap());
        written(&[("data/b", "2")]);
        let fault = copied(folder.path(), &bucket, false).unwrap_err().to_string();
        assert!(fault.contains("another published set"), "{fault}");
        assert!(copied(folder.path(), &bucket, true).unwrap());
        assert_eq!(names(), ["SHA256SUMS", "data/b", DICTIONARY]);
        bucket.put("notes.txt", b"mine".to_vec()).unwrap();
        let fault = copied(folder.path(), &bucket, true).map(drop).unwrap_err().to_string();
        assert!(fault.contains("contains notes.txt"), "{fault}");
        bucket.remove(DICTIONARY).unwrap();
        assert!(copied(folder.path(), &bucket, true).is_err());
        assert_eq!(bucket.get("notes.txt").unwrap().unwrap(), b"mine");
    }
}

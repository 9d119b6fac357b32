//! Saved states of units that take minutes. After a run is killed, the next run resumes from these states.
//!
//! Each state is a file named by the key of its unit. The file holds the hash of the state, then the state. A file
//! whose hash does not match is ignored, because the unit can be recomputed.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use schemas::{Fault, keys::HashKey, paths};

use super::{Store, tend::is_old};

/// Folder of the states in a store.
pub const FOLDER: &str = "checkpoints";

fn path(root: &Path, key: HashKey) -> PathBuf {
    root.join(FOLDER).join(key.to_string())
}

fn hash(state: &[u8]) -> blake3::Hash {
    blake3::hash(state)
}

/// Whether a state matches its hash.
pub(super) fn is_whole(bytes: &[u8]) -> bool {
    bytes.split_at_checked(blake3::OUT_LEN).is_some_and(|(sum, state)| hash(state).as_bytes() == sum)
}

impl Store {
    /// State of a unit that an earlier run has not finished.
    pub fn checkpoint(&self, key: HashKey) -> Option<Vec<u8>> {
        let bytes = match self.remote() {
            // Another machine may have a later state.
            Some(remote) => remote.bucket().get(&format!("{FOLDER}/{key}")).ok()??,
            None => paths::read_regular(&path(self.root(), key)).ok()?,
        };
        let (sum, state) = bytes.split_at_checked(blake3::OUT_LEN)?;
        (hash(state).as_bytes() == sum).then(|| state.to_vec())
    }

    /// Stores the state of a unit, in place of the previous state.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn set_checkpoint(&self, key: HashKey, state: &[u8]) -> Result<(), Fault> {
        self.write(&path(self.root(), key), &[hash(state).as_bytes(), state].concat())
    }

    /// Removes the states of units that are `done`, and states last written at least `older_than` ago.
    pub fn drop_checkpoints(&self, done: impl Fn(&str) -> bool, older_than: Option<Duration>) {
        if let Some(remote) = self.remote() {
            // Objects that cannot be removed now are removed later.
            let _ = remote.drop_objects(FOLDER, &|name, age| done(name) || older_than.is_some_and(|than| age >= than));
        }
        for file in fs::read_dir(self.root().join(FOLDER)).into_iter().flatten().flatten() {
            let old = || older_than.is_some_and(|than| is_old(&file.path(), than));
            if file.file_name().to_str().is_some_and(&done) || old() {
                // Files that cannot be removed now are removed later.
                let _ = fs::remove_file(file.path());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_checkpoint_is_readable_until_its_unit_is_done_and_damage_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let (one, two) = (HashKey::from_parts(["one"]), HashKey::from_parts(["two"]));
        assert_eq!(store.checkpoint(one), None);
        store.set_checkpoint(one, b"first").unwrap();
        store.set_checkpoint(one, b"second").unwrap();
        store.set_checkpoint(two, b"other").unwrap();
        assert_eq!(store.checkpoint(one).unwrap(), b"second");
        let file = path(folder.path(), two);
        let mut bytes = fs::read(&file).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&file, &bytes).unwrap();
        assert_eq!(store.checkpoint(two), None);
        fs::write(&file, b"cut").unwrap();
        assert_eq!(store.checkpoint(two), None);
        store.drop_checkpoints(|name| name == two.to_string(), None);
        assert!(!file.exists() && store.checkpoint(one).is_some());
        store.drop_checkpoints(|_| false, Some(Duration::ZERO));
        assert_eq!(store.checkpoint(one), None);
    }
}

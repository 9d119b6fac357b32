//! Plans for worker processes, each named by the hash of its content.

use std::{fs, io, path::PathBuf, time::Duration};

use schemas::{Fault, keys::HashKey, paths};

use super::{Store, io_fault, shown, tend::is_old};

/// Folder of the plans in a store.
const FOLDER: &str = "plans";

fn name_of(bytes: &[u8]) -> HashKey {
    HashKey::from_parts([b"plan", bytes])
}

/// Whether the hash of the plan in the file `name` equals its name.
pub(super) fn is_whole(name: &str, bytes: &[u8]) -> bool {
    HashKey::parse(name) == Some(name_of(bytes))
}

impl Store {
    fn plan_at(&self, key: HashKey) -> PathBuf {
        self.root().join(FOLDER).join(key.to_string())
    }

    /// Writes a plan and returns its name.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn keep_plan(&self, bytes: &[u8]) -> Result<HashKey, Fault> {
        let key = name_of(bytes);
        let file = self.plan_at(key);
        if self.remote().is_none() && paths::read_regular(&file).is_ok_and(|there| there == bytes) {
            return Ok(key);
        }
        self.write(&file, bytes).map(|()| key)
    }

    /// Plan with the name `key`.
    ///
    /// # Errors
    /// Fails if the plan is missing, damaged or unreadable.
    pub fn plan(&self, key: HashKey) -> Result<Vec<u8>, Fault> {
        const HELP: &str = "write the plan and the tasks again with `magline tasks`";
        let file = self.plan_at(key);
        self.bring(&file)?;
        let bytes = paths::read_regular(&file).map_err(|e| match e.kind() {
            io::ErrorKind::NotFound => {
                let what = format!("the store {} does not contain the plan {key}", shown(self.root()));
                Fault::new(what).help(HELP)
            }
            _ => io_fault("read", &file, &e),
        })?;
        if name_of(&bytes) != key {
            return Err(Fault::new(format!("the plan {} is damaged", file.display())).help(HELP));
        }
        Ok(bytes)
    }

    /// Removes plans that are at least as old as `older_than`, except the plans of the last computation of the tables.
    pub fn drop_plans(&self, older_than: Duration) {
        if let Some(remote) = self.remote() {
            let _ = remote.drop_objects(FOLDER, &|name, age| HashKey::parse(name).is_some() && age >= older_than);
        }
        for file in fs::read_dir(self.root().join(FOLDER)).into_iter().flatten().flatten() {
            let named = file.file_name().to_str().and_then(HashKey::parse).is_some();
            if named && is_old(&file.path(), older_than) {
                // Files that cannot be removed now are removed later.
                let _ = fs::remove_file(file.path());
            }
        }
    }
}

//! Files that are removed when a command ends early.

use std::{
    path::{Path, PathBuf},
    sync::Mutex,
};

/// The files that are removed when the command ends early.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(vec![]);

/// A temporary file: removed when it goes out of scope, or when the command is interrupted.
pub struct Temporary(PathBuf);

impl Temporary {
    /// Whatever will be made at `path`.
    pub fn new(path: PathBuf) -> Temporary {
        if let Ok(mut list) = UNFINISHED.lock() {
            list.push(path.clone());
        }
        Temporary(path)
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        remove(&self.0);
    }
}

fn remove(path: &Path) {
    // It may not exist; a failure to remove it is ignored.
    let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
}

/// Removes all that are unfinished.
pub fn remove_all() {
    if let Ok(list) = UNFINISHED.lock() {
        list.iter().for_each(|path| remove(path));
    }
}

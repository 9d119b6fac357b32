//! Files that are removed when a command ends early.

use std::{
    env,
    fs::{self, DirBuilder, File},
    io,
    os::unix::fs::{DirBuilderExt, MetadataExt},
    path::{Path, PathBuf},
    sync::Mutex,
};

use nix::unistd::getuid;
use schemas::Fault;
use store::{own_folder, sweep};
use uuid::Uuid;

/// The files that are removed when the command ends early.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(vec![]);

/// A temporary file: removed when it goes out of scope, or when the command is interrupted.
pub struct TemporaryFile(PathBuf);

impl TemporaryFile {
    /// Registers a file or folder that will be made at `path`.
    pub fn new(path: PathBuf) -> TemporaryFile {
        if let Ok(mut list) = UNFINISHED.lock() {
            list.push(path.clone());
        }
        TemporaryFile(path)
    }

    /// Path.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Keeps the file.
    pub fn keep(self) {
        if let Ok(mut list) = UNFINISHED.lock() {
            list.retain(|path| *path != self.0);
        }
        std::mem::forget(self);
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        remove(&self.0);
    }
}

/// A private folder for temporary files, below the system's temporary folder: other users can neither read nor create
/// it. It is removed when it goes out of scope. After a kill, the next command of the same user removes it.
pub struct TemporaryFolder {
    folder: TemporaryFile,
    base: PathBuf,
    // This file is locked while the folder is used, so that other commands do not remove the folder.
    _lock: File,
}

impl TemporaryFolder {
    /// Creates a folder.
    ///
    /// # Errors
    /// Fails on errors of the file system.
    pub fn new() -> Result<TemporaryFolder, Fault> {
        let temporary = env::temp_dir();
        let make = || {
            let base = base(&temporary)?;
            sweep(&base);
            let (path, lock) = own_folder(&base)?;
            Ok(TemporaryFolder { folder: TemporaryFile::new(path), base, _lock: lock })
        };
        let failed = |e: io::Error| Fault::machine(format!("cannot make a folder in {}: {e}", temporary.display()));
        // The attempt is repeated, because another command that ends may remove the common folder.
        make().or_else(|_: io::Error| make()).or_else(|_| make()).map_err(failed)
    }

    /// Path.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        remove(self.folder.path());
        // This has no effect unless the base folder is empty.
        let _ = fs::remove_dir(&self.base);
    }
}

/// Base of this user's private folders in `temporary`: owned by this user and not accessible to others.
fn base(temporary: &Path) -> io::Result<PathBuf> {
    let user = getuid().as_raw();
    let ours =
        |path: &Path| fs::symlink_metadata(path).is_ok_and(|m| m.is_dir() && m.uid() == user && m.mode() & 0o077 == 0);
    let name = format!("magline-{user}");
    let plain = temporary.join(&name);
    match DirBuilder::new().mode(0o700).create(&plain) {
        Ok(()) => return Ok(plain),
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
        Err(e) => return Err(e),
    }
    if ours(&plain) {
        return Ok(plain);
    }
    // Another user owns the folder with this name. Use this user's earlier folder, or a new one with an unpredictable
    // name.
    let start = format!("{name}-");
    let mut found = fs::read_dir(temporary)?.flatten().filter(|e| e.file_name().to_string_lossy().starts_with(&start));
    if let Some(known) = found.find(|e| ours(&e.path())) {
        return Ok(known.path());
    }
    let path = temporary.join(format!("{start}{}", Uuid::new_v4()));
    DirBuilder::new().mode(0o700).create(&path).map(|()| path)
}

fn remove(path: &Path) {
    // The file may be missing; a failure to remove it is ignored.
    let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
}

/// Removes all unfinished files.
pub fn remove_all() {
    if let Ok(list) = UNFINISHED.lock() {
        list.iter().for_each(|path| remove(path));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn unit_the_base_folder_must_be_private() {
        let temporary = tempfile::tempdir().unwrap();
        let user = getuid().as_raw();
        let plain = temporary.path().join(format!("magline-{user}"));
        assert_eq!(base(temporary.path()).unwrap(), plain);
        assert_eq!(fs::metadata(&plain).unwrap().mode() & 0o777, 0o700);
        assert_eq!(base(temporary.path()).unwrap(), plain, "it is used again");
        fs::set_permissions(&plain, fs::Permissions::from_mode(0o777)).unwrap();
        let other = base(temporary.path()).unwrap();
        assert_ne!(other, plain, "others may write to it");
        assert_eq!(fs::metadata(&other).unwrap().mode() & 0o777, 0o700);
        assert_eq!(base(temporary.path()).unwrap(), other);
        fs::remove_dir(&plain).unwrap();
        std::os::unix::fs::symlink(&other, &plain).unwrap();
        assert_eq!(base(temporary.path()).unwrap(), other, "a link is not followed");
    }
}

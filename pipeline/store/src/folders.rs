//! Folders and files of a store on disk.

use std::{
    fs::{self, File},
    io,
    path::Path,
};

use schemas::paths;

/// Creates a folder and its parents; each is on the disk on return.
///
/// # Errors
/// Fails if the file system rejects it.
pub fn make_folder(folder: &Path) -> io::Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    if let Some(above) = folder.parent() {
        make_folder(above)?;
        match fs::create_dir(folder) {
            Err(e) if e.kind() != io::ErrorKind::AlreadyExists => return Err(e),
            _ => return sync_folder(above),
        }
    }
    Ok(())
}

/// Opens a file of the store at `root` for writing.
///
/// # Errors
/// Fails for a link, which may lead out of the store, or for a pipe or a device. Also fails if the file system reports
/// an error.
pub fn own_file(root: &Path, path: &Path, options: &fs::OpenOptions) -> io::Result<File> {
    paths::check_no_link(root, path)?;
    match fs::symlink_metadata(path) {
        Ok(about) if !about.is_file() => {
            Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{} is not a regular file", path.display())))
        }
        _ => options.open(path),
    }
}

/// Syncs the names in a folder to the disk.
///
/// # Errors
/// Fails if the file system rejects it.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

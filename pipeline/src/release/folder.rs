//! Folder of a set: written next to its target under another name, and renamed when it is complete.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use schemas::Fault;

use super::{
    checksums,
    set::FORMAT,
    words::{DICTIONARY, cannot},
};

/// Folder of a set in progress. It is removed unless it gets its final name.
pub struct FolderDraft {
    path: PathBuf,
    to: PathBuf,
    replace: bool,
}

/// Content of the destination folder of a set.
enum DestinationContent {
    Nothing,
    Set,
    Other(String),
}

/// Content of the folder at `path`; it counts as a set only if it holds a published set and nothing else.
fn look(path: &Path) -> Result<DestinationContent, Fault> {
    let about = match fs::symlink_metadata(path) {
        Ok(about) => about,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(DestinationContent::Nothing),
        Err(e) => return Err(cannot("read", path, &e)),
    };
    if !about.is_dir() {
        return Ok(DestinationContent::Other("is not a folder".to_owned()));
    }
    let files = files(path).map_err(|e| cannot("read", path, &e))?;
    if files.is_empty() {
        return Ok(DestinationContent::Nothing);
    }
    let text = |name: &str| fs::read_to_string(path.join(name)).unwrap_or_default();
    let is_set = serde_json::from_str::<serde_json::Value>(&text(DICTIONARY)).is_ok_and(|d| d["format"] == FORMAT);
    match checksums::read(&text(checksums::NAME)).ok().filter(|_| is_set) {
        None => Ok(DestinationContent::Other("is a folder, but not a published set".to_owned())),
        Some(sums) => {
            let foreign = files.iter().find(|f| *f != checksums::NAME && !sums.contains_key(*f));
            Ok(foreign.map_or(DestinationContent::Set, |f| {
                DestinationContent::Other(format!(
                    "contains {f}, which does not belong to the \
                published set"
                ))
            }))
        }
    }
}

/// Paths of all files below a folder, including hidden ones and links, sorted; folders without files end in `/`.
///
/// # Errors
/// Fails if a folder cannot be read.
pub fn files(folder: &Path) -> io::Result<Vec<String>> {
    let mut found = vec![];
    let mut waiting = vec![(folder.to_owned(), String::new())];
    while let Some((folder, prefix)) = waiting.pop() {
        let mut entries = fs::read_dir(&folder)?.collect::<Result<Vec<_>, _>>()?;
        entries.sort_by_key(fs::DirEntry::file_name);
        if entries.is_empty() && !prefix.is_empty() {
            found.push(prefix.clone());
        }
        for entry in entries {
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            // A link is listed as a file, independent of its target.
            if entry.file_type()?.is_dir() {
                waiting.push((entry.path(), format!("{name}/")));
            } else {
                found.push(name);
            }
        }
    }
    found.sort();
    Ok(found)
}

impl FolderDraft {
    /// Begins a folder that is to become `to`.
    ///
    /// # Errors
    /// Fails if `to` holds files that must be kept, or the file system reports an error.
    pub fn begin(to: &Path, replace: bool) -> Result<FolderDraft, Fault> {
        // An existing set is accepted here: only the complete set can be compared with it.
        allowed(to, true)?;
        let name = to.file_name().filter(|n| !n.is_empty());
        let name = name.ok_or_else(|| Fault::new(format!("{} is not a valid folder name", to.display())))?;
        let above = to.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(above).map_err(|e| cannot("make", above, &e))?;
        let path = above.join(format!(".{}.{}.new", name.to_string_lossy(), std::process::id()));
        match fs::create_dir(&path) {
            // The folder is the remainder of a killed process with the same process id.
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
                fs::remove_dir_all(&path)
                    .and_then(|()| fs::create_dir(&path))
                    .map_err(|e| cannot("make", &path, &e))?;
            }
            made => made.map_err(|e| cannot("make", &path, &e))?,
        }
        Ok(FolderDraft { path, to: to.to_owned(), replace })
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Renames the folder to its final name. Returns `false` if the same set already exists, which then stays
    /// unchanged.
    ///
    /// # Errors
    /// Fails if other files have appeared there, or the file system reports an error; the existing set then stays.
    pub fn settle(self) -> Result<bool, Fault> {
        let sums = |folder: &Path| fs::read(folder.join(checksums::NAME)).ok();
        let there = look(&self.to)?;
        if matches!(there, DestinationContent::Set) && sums(&self.to) == sums(&self.path) {
            return Ok(false);
        }
        allowed(&self.to, self.replace)?;
        let fail = |e: io::Error| cannot("write", &self.to, &e);
        sync(&self.path).map_err(fail)?;
        match there {
            DestinationContent::Set => {
                let old = self.path.with_extension("old");
                fs::rename(&self.to, &old).map_err(fail)?;
                if let Err(e) = fs::rename(&self.path, &self.to) {
                    fs::rename(&old, &self.to).map_err(fail)?;
                    return Err(fail(e));
                }
                fs::remove_dir_all(&old).map_err(|e| cannot("remove", &old, &e))?;
            }
            // The renaming also replaces an empty folder.
            DestinationContent::Nothing | DestinationContent::Other(_) => {
                if let Err(e) = fs::rename(&self.path, &self.to) {
                    // Another program may have put its set there in the meantime.
                    if sums(&self.to).is_some_and(|there| Some(there) == sums(&self.path)) {
                        return Ok(false);
                    }
                    allowed(&self.to, false)?;
                    return Err(fail(e));
                }
            }
        }
        let above = self.to.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::File::open(above).and_then(|f| f.sync_all()).map_err(fail)?;
        Ok(true)
    }
}

/// Checks that a set may be put at `to`: an existing set requires `replace`.
fn allowed(to: &Path, replace: bool) -> Result<(), Fault> {
    match look(to)? {
        DestinationContent::Nothing => Ok(()),
        DestinationContent::Set if replace => Ok(()),
        DestinationContent::Set => {
            let fault = Fault::new(format!("{} already holds another published set", to.display()));
            Err(fault.help("give another folder, or replace that set with `--replace`"))
        }
        DestinationContent::Other(what) => {
            let fault = Fault::new(format!("{} {what}", to.display()));
            Err(fault.help("give a new or empty folder; `--replace` replaces only a published set"))
        }
    }
}

/// Syncs the names in all folders to the disk.
fn sync(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync(&entry.path())?;
        }
    }
    fs::File::open(folder)?.sync_all()
}

impl Drop for FolderDraft {
    fn drop(&mut self) {
        // A completed folder was renamed, so nothing is removed here; an incomplete folder is temporary.
        let _ = fs::remove_dir_all(&self.path);
    }
}

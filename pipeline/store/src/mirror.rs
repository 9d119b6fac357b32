//! Copy of a store, made of links to its files, for recomputing its results.

use std::{
    collections::HashSet,
    fs, io,
    path::{Path, PathBuf},
};

use schemas::{Fault, keys::HashKey};

use super::{Store, catalogue, io_fault, make_folder};

/// Folders of stored facts about sources, so that the sources are not read again.
const SHARED: [&str; 2] = ["sources", "quality"];

impl Store {
    /// Creates a store in the folder `to` with all results of this store, except the results of the units in `but`. Its
    /// files are links.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn mirror(&self, to: &Path, but: &HashSet<HashKey>) -> Result<Store, Fault> {
        let ids: Vec<HashKey> = {
            let catalogue = self.catalogue();
            let without = |units: &[super::PackedUnit]| !units.iter().any(|u| but.contains(&u.key));
            catalogue.packs().filter(|p| without(&p.units)).map(|p| p.id).collect()
        };
        for id in ids {
            let file = catalogue::path(to, id);
            self.at_hand(id)?;
            link(&self.file(id), &file).map_err(|e| io_fault("write", &file, &e))?;
        }
        for part in SHARED {
            links(&self.root().join(part), &to.join(part)).map_err(|e| io_fault("write", &to.join(part), &e))?;
        }
        Store::open(to)
    }
}

fn link(from: &Path, to: &Path) -> io::Result<()> {
    to.parent().map_or(Ok(()), make_folder)?;
    match fs::hard_link(from, to) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => fs::copy(from, to).map(|_| ()),
        made => made,
    }
}

/// Links all files below a folder.
fn links(from: &Path, to: &Path) -> io::Result<()> {
    let mut folders: Vec<(PathBuf, PathBuf)> = vec![(from.to_owned(), to.to_owned())];
    while let Some((from, to)) = folders.pop() {
        for entry in fs::read_dir(&from)? {
            let entry = entry?;
            let (from, to) = (entry.path(), to.join(entry.file_name()));
            if entry.file_type()?.is_dir() { folders.push((from, to)) } else { link(&from, &to)? }
        }
    }
    Ok(())
}

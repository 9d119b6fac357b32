//! One file of a table of flights, and what going through all of it has found.

use std::path::{Path, PathBuf};

use datasets::{FlightOptions, FlightReader, ReadError, Reading, formats::SayMadeFrom};

use super::{
    bytes::{Seen, Trust},
    open_flight,
};
use crate::{keys::Key, store::Store};

/// A file and how it is read.
pub(super) struct FlightFile {
    pub(super) path: PathBuf,
    pub(super) options: FlightOptions,
    /// Says what it is made from, where its values are not in it.
    pub(super) made_from: Option<SayMadeFrom>,
    /// What its format had to go through it for, such as the types of columns; good as long as the file is the same.
    found: Option<Seen>,
    /// Whether that came from a store.
    kept: bool,
}

impl FlightFile {
    /// Opens a file for its schema; a reader of it comes out too.
    pub(super) fn open(
        path: &Path,
        options: FlightOptions,
        threads: usize,
        trust: Trust,
    ) -> Result<(FlightFile, FlightReader), ReadError> {
        let store = trust.store.filter(|_| !trust.read_all);
        let known = store.zip(key(path, &options)).and_then(|(store, key)| Seen::known(store, key, path));
        let reading = Reading { found: known.as_ref().map(|seen| seen.found.clone()), threads };
        let open = || open_flight(path, &options, &reading);
        let (reader, seen) = Seen::by(path, open, |reader| reader.found().map(str::to_owned))?;
        let (kept, made_from) = (known.is_some(), reader.made_from());
        Ok((FlightFile { path: path.to_owned(), options, made_from, found: known.or(seen), kept }, reader))
    }

    /// Opens it again, for its rows.
    pub(super) fn read(&self, threads: usize) -> Result<FlightReader, ReadError> {
        let found = self.found.as_ref().filter(|seen| seen.is_of(&self.path)).map(|seen| seen.found.clone());
        open_flight(&self.path, &self.options, &Reading { found, threads })
    }

    /// Keeps what was found for the next time.
    pub(super) fn keep(&self, store: &Store) {
        if let (false, Some(seen), Some(key)) = (self.kept, &self.found, key(&self.path, &self.options)) {
            seen.keep(store, key);
        }
    }
}

fn key(path: &Path, options: &FlightOptions) -> Option<Key> {
    let full = path.canonicalize().ok()?;
    let options = format!("{options:?}");
    Some(Key::of([
        "found".as_bytes(),
        datasets::VERSION.as_bytes(),
        options.as_bytes(),
        full.to_string_lossy().as_bytes(),
    ]))
}

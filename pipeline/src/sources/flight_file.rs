//! One file of a table of flights, and the result of scanning all of it.

use std::path::{Path, PathBuf};

use datasets::{FlightOptions, FlightReader, ReadError, Reading, formats::SayMadeFrom};

use super::{
    bytes::{Seen, Trust},
    open_flight,
};
use crate::{keys::Key, store::Store};

/// A file and its options.
pub(super) struct FlightFile {
    pub(super) path: PathBuf,
    pub(super) options: FlightOptions,
    /// Returns its inputs, where its values are computed from others.
    pub(super) made_from: Option<SayMadeFrom>,
    /// The result of scanning it, such as the types of columns; valid while the file is unchanged.
    found: Option<Seen>,
    /// Whether that came from a store.
    kept: bool,
}

impl FlightFile {
    /// Opens a file for its schema; also returns a reader of it.
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

    /// Caches the result of scanning.
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

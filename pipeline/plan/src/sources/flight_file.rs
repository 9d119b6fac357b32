//! One file of a table of flights, and the result of scanning all of it.

use std::path::{Path, PathBuf};

use datasets::{FlightOptions, ReadError, ReadHints, formats::FlightInputLister};
use intake::{formats::open_log, log_reader::LogReader, mapping::MappingTable};
use schemas::keys::HashKey;
use store::Store;

use super::bytes::{FileFact, ReusePolicy};

/// A file and its options.
pub(super) struct FlightFile {
    pub(super) path: PathBuf,
    pub(super) options: FlightOptions,
    /// Mapping of the file's columns, if any.
    pub(super) mapped: Option<MappingTable>,
    /// Returns the inputs of the file, if its values are computed from other files.
    pub(super) made_from: Option<FlightInputLister>,
    /// The result of the scan of the file, such as the types of columns; valid while the file is unchanged.
    found: Option<FileFact>,
    /// Whether `found` came from a store.
    kept: bool,
}

impl FlightFile {
    /// Opens a file for its schema; also returns a reader of the file.
    pub(super) fn open(
        path: &Path,
        options: FlightOptions,
        mapped: Option<&MappingTable>,
        threads: usize,
        trust: ReusePolicy,
    ) -> Result<(FlightFile, LogReader), ReadError> {
        let store = trust.store.filter(|_| !trust.read_all);
        let known = store.zip(key(path, &options, mapped)).and_then(|(store, key)| FileFact::known(store, key, path));
        let reading = ReadHints { found: known.as_ref().map(|seen| seen.found.clone()), threads };
        let open = || open_log(path, &options, mapped, &reading);
        let (reader, seen) = FileFact::by(path, open, |reader| reader.found.clone())?;
        let (kept, made_from, mapped) = (known.is_some(), reader.made_from, mapped.cloned());
        Ok((FlightFile { path: path.to_owned(), options, mapped, made_from, found: known.or(seen), kept }, reader))
    }

    /// Opens the file again, to read the rows.
    pub(super) fn read(&self, threads: usize) -> Result<LogReader, ReadError> {
        let found = self.found.as_ref().filter(|seen| seen.is_of(&self.path)).map(|seen| seen.found.clone());
        open_log(&self.path, &self.options, self.mapped.as_ref(), &ReadHints { found, threads })
    }

    /// Caches the result of scanning.
    pub(super) fn keep(&self, store: &Store) {
        let key = key(&self.path, &self.options, self.mapped.as_ref());
        if let (false, Some(seen), Some(key)) = (self.kept, &self.found, key) {
            seen.keep(store, key);
        }
    }
}

fn key(path: &Path, options: &FlightOptions, mapped: Option<&MappingTable>) -> Option<HashKey> {
    let full = path.canonicalize().ok()?;
    let options = format!("{options:?}");
    let mut parts = vec![
        "found".as_bytes().to_vec(),
        datasets::VERSION.as_bytes().to_vec(),
        options.into_bytes(),
        full.to_string_lossy().as_bytes().to_vec(),
    ];
    parts.extend(mapped.map(|m| m.key().to_string().into_bytes()));
    Some(HashKey::from_parts(parts))
}

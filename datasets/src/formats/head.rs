//! The start of a file, which identifies its format.

use std::{collections::BTreeMap, fs::File, io::Read, path::Path};

use super::{hdf5, text_end};
use crate::ReadError;

/// Path and first bytes of a file, for recognition of its format.
pub struct FileHead<'a> {
    pub(super) path: &'a Path,
    pub(super) bytes: Vec<u8>,
    pub(super) rename: Option<&'a BTreeMap<String, String>>,
}

impl FileHead<'_> {
    pub(super) fn read(path: &Path) -> Result<FileHead<'_>, ReadError> {
        let mut bytes = vec![];
        refuse_special(path)?;
        if !path.is_dir() {
            let file = File::open(path).map_err(|e| ReadError::io(path, &e))?;
            file.take(4096).read_to_end(&mut bytes).map_err(|e| ReadError::io(path, &e))?;
            if bytes.is_empty() {
                return Err(ReadError::data(path, "the file is empty"));
            }
        }
        Ok(FileHead { path, bytes, rename: None })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        self.path
    }

    /// Whether the file starts with these bytes.
    pub fn starts_with(&self, magic: &[u8]) -> bool {
        self.bytes.starts_with(magic)
    }

    /// Whether the file has these bytes at an offset below 4096.
    pub(super) fn has_at(&self, offset: usize, magic: &[u8]) -> bool {
        self.bytes.get(offset..).is_some_and(|bytes| bytes.starts_with(magic))
    }

    /// The first bytes, without the end-of-file mark that may end a short text.
    pub(super) fn text(&self) -> &[u8] {
        text_end::without_mark(&self.bytes)
    }

    /// The lines at the start of a text file; the last one may be truncated.
    pub(super) fn text_lines(&self) -> impl Iterator<Item = String> {
        let text =
            if self.text().contains(&0) { String::new() } else { String::from_utf8_lossy(self.text()).into_owned() };
        let lines: Vec<String> = text.lines().filter(|l| !l.trim().is_empty()).map(str::to_owned).collect();
        lines.into_iter()
    }

    /// The first line that is not blank, if the start of the file is text.
    pub fn first_line(&self) -> Option<String> {
        if self.text().contains(&0) {
            return None;
        }
        let text = String::from_utf8_lossy(self.text());
        text.trim_start_matches('\u{feff}').lines().find(|l| !l.trim().is_empty()).map(str::to_owned)
    }

    /// The names of the data sets at the root of an HDF5 file.
    pub(super) fn hdf5_names(&self) -> Vec<String> {
        if !self.starts_with(hdf5::MAGIC) {
            return vec![];
        }
        let names = hdf5::Hdf5Source::open(self.path).map(|f| f.names().to_vec()).unwrap_or_default();
        // A format is identified both by the original names and by the names in the options.
        names.iter().flat_map(|n| [n.clone(), self.renamed(n).to_owned()]).collect()
    }

    /// The name that the options give a column.
    pub(super) fn renamed<'a>(&'a self, name: &'a str) -> &'a str {
        self.rename.and_then(|r| r.get(name)).map_or(name, String::as_str)
    }
}

/// Reading a pipe or a device may block, so it is rejected.
fn refuse_special(path: &Path) -> Result<(), ReadError> {
    let about = std::fs::metadata(path).map_err(|e| ReadError::io(path, &e))?;
    if about.is_file() || about.is_dir() {
        return Ok(());
    }
    let what = "is a pipe, socket or device, not a regular file";
    Err(ReadError::options(path, what).help("write its output to a file, and read that file"))
}

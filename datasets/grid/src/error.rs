//! Errors of reading and writing, each with the path of the file.

use std::{fmt, path::Path};

use schemas::{Fault, render};

/// Error of reading a file: the file, the row and column if known, and the remedy.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadError(Box<Fault>);

impl ReadError {
    /// A fault in the bytes of `path`.
    pub fn data(path: &Path, what: impl Into<String>) -> Self {
        let fault = Fault::data(what);
        // A computed map has no file.
        Self(Box::new(if path.as_os_str().is_empty() { fault } else { fault.in_file(&path.display().to_string()) }))
    }

    /// A fault in the options for `path`.
    pub fn options(path: &Path, what: impl Into<String>) -> Self {
        Self(Box::new(Fault::new(what).in_file(&path.display().to_string())))
    }

    /// An operating system error on `path`; a missing file is a fault of the user.
    pub fn io(path: &Path, error: &std::io::Error) -> Self {
        use std::io::ErrorKind::{InvalidData, NotFound, UnexpectedEof};
        match error.kind() {
            NotFound => Self::options(path, "the file does not exist"),
            InvalidData | UnexpectedEof => Self::data(path, error.to_string()),
            _ => Self(Box::new(Fault::machine(error.to_string()).in_file(&path.display().to_string()))),
        }
    }

    /// An operating system error that is not related to a file.
    pub fn machine(path: &Path, what: impl Into<String>) -> Self {
        Self(Box::new(Fault::machine(what).in_file(&path.display().to_string())))
    }

    /// All faults of a spec together, each shown with its file, line and column.
    pub fn spec(path: &Path, text: &str, faults: &[Fault]) -> Self {
        let file = path.display().to_string();
        let shown: Vec<String> = faults.iter().map(|f| render(f, &file, text)).collect();
        let shown = shown.join("\n");
        Self(Box::new(Fault::new(shown.strip_prefix("error: ").unwrap_or(&shown))))
    }

    /// Adds the row, counted from 0.
    pub fn in_row(self, row: u64) -> Self {
        Self(Box::new(self.0.in_row(row)))
    }

    /// Adds the column by its name in the file.
    pub fn in_column(self, column: &str) -> Self {
        Self(Box::new(self.0.in_column(column)))
    }

    /// Adds advice on what to do.
    pub fn help(self, help: impl Into<String>) -> Self {
        Self(Box::new(self.0.help(help)))
    }

    /// Suggests the nearest of `known` to `given`, or lists all known names.
    pub fn nearest<S: AsRef<str>>(self, given: &str, known: &[S]) -> Self {
        Self(Box::new(self.0.nearest(given, known)))
    }

    /// The fault, with its position and the party that has to act.
    pub fn fault(&self) -> &Fault {
        &self.0
    }
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for ReadError {}

impl From<ReadError> for Fault {
    fn from(error: ReadError) -> Fault {
        *error.0
    }
}

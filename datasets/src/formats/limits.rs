//! Limits of the memory that a file can declare, so that a few bytes cannot exhaust the machine.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Mutex, PoisonError},
};

use crate::ReadError;

/// Number of decoded bytes that any file may declare, however small it is. Survey lines of one hour have about 10 MB.
const FREE: u64 = 256 << 20;
/// Number of decoded bytes that a file may declare per byte of its size, if that is more than [`FREE`]. Measured data
/// have 2 to 10; a constant column has thousands, but it is only one of many columns.
const MOST_EXPANSION: u64 = 256;
/// Maximum number of columns of a table. The widest surveys have a few hundred.
pub(super) const MOST_COLUMNS: usize = 16_384;

/// The decoded bytes that a file may declare.
#[derive(Debug)]
pub(super) struct DecodeLimit {
    file: u64,
    /// The declared bytes of each part so far.
    parts: Mutex<BTreeMap<String, u64>>,
}

impl DecodeLimit {
    /// The limit for a file of `file` bytes.
    pub(super) fn new(file: u64) -> DecodeLimit {
        DecodeLimit { file, parts: Mutex::default() }
    }

    /// The largest number of decoded bytes.
    pub(super) fn most(&self) -> u64 {
        self.file.saturating_mul(MOST_EXPANSION).max(FREE)
    }

    /// The value of [`DecodeLimit::most`] as a size in memory.
    pub(super) fn most_here(&self) -> usize {
        usize::try_from(self.most()).unwrap_or(usize::MAX)
    }

    /// Checks the decoded bytes of a file; `None` means 2^64 or more.
    ///
    /// # Errors
    /// Fails for more bytes than the file may declare.
    pub(super) fn check(&self, path: &Path, declared: Option<u64>) -> Result<(), ReadError> {
        if declared.is_some_and(|bytes| bytes <= self.most()) {
            return Ok(());
        }
        Err(refused(path, self.excess(declared)))
    }

    /// Checks the decoded bytes of one of several parts of a file, together with those of earlier parts.
    ///
    /// # Errors
    /// Fails in the cases of [`DecodeLimit::check`].
    pub(super) fn check_part(&self, path: &Path, part: &str, declared: Option<u64>) -> Result<(), ReadError> {
        self.add(part, declared).map_err(|what| refused(path, what))
    }

    /// Checks the decoded bytes of the next part of a file, together with those of earlier parts.
    ///
    /// # Errors
    /// Returns the reason for the rejection if there are more bytes than the file may declare.
    pub(super) fn check_next(&self, declared: Option<u64>) -> Result<(), String> {
        let next = self.parts.lock().unwrap_or_else(PoisonError::into_inner).len().to_string();
        self.add(&next, declared)
    }

    /// Adds a part.
    fn add(&self, part: &str, declared: Option<u64>) -> Result<(), String> {
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let others = parts
            .iter()
            .filter(|(known, _)| **known != part)
            .fold(0, |sum, (_, bytes)| u64::saturating_add(sum, *bytes));
        let all = declared.and_then(|bytes| bytes.checked_add(others));
        if all.is_none_or(|bytes| bytes > self.most()) {
            return Err(self.excess(all));
        }
        parts.insert(part.to_owned(), declared.unwrap_or(0));
        Ok(())
    }

    /// The reason for rejecting a number of bytes.
    fn excess(&self, declared: Option<u64>) -> String {
        let declared = declared.map_or_else(|| "more than 18 EB".to_owned(), megabytes);
        let (file, most) = (megabytes(self.file), megabytes(self.most()));
        format!("declares {declared} of values, but the file has {file}; the limit for this file size is {most}")
    }
}

fn refused(path: &Path, what: String) -> ReadError {
    ReadError::data(path, what).help("the file is probably damaged; split valid data into several files")
}

fn megabytes(bytes: u64) -> String {
    let megabytes = bytes as f64 / 1e6;
    if megabytes < 1.0 { format!("{bytes} bytes") } else { format!("{megabytes:.0} MB") }
}

/// Checks the number of columns of a table.
///
/// # Errors
/// Fails for more than [`MOST_COLUMNS`].
pub(super) fn check_columns(path: &Path, columns: usize) -> Result<(), ReadError> {
    if columns <= MOST_COLUMNS {
        return Ok(());
    }
    let what = format!("has {columns} columns; the limit is {MOST_COLUMNS}");
    Err(ReadError::data(path, what).help("keep only the required columns, or split the table by columns"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_a_file_declares_no_more_than_its_size_permits() {
        let path = Path::new("a.h5");
        let small = DecodeLimit::new(1000);
        assert!(small.check(path, Some(256 << 20)).is_ok() && small.check(path, Some((256 << 20) + 1)).is_err());
        let large = DecodeLimit::new(100 << 20);
        assert!(large.check(path, Some(25 << 30)).is_ok() && large.check(path, Some((25 << 30) + 1)).is_err());
        let message = small.check(path, None).unwrap_err().to_string();
        assert!(
            message.contains(
                "a.h5: declares more than 18 EB of values, but the file has 1000 bytes; the limit for this file"
            ),
            "{message}"
        );
        assert!(check_columns(path, MOST_COLUMNS).is_ok() && check_columns(path, MOST_COLUMNS + 1).is_err());
    }

    #[test]
    fn unit_each_part_counts_once_and_parts_are_summed() {
        let (path, limit) = (Path::new("a.h5"), DecodeLimit::new(1000));
        for part in ["a", "a", "b"] {
            limit.check_part(path, part, Some(100 << 20)).unwrap();
        }
        assert!(limit.check_part(path, "c", Some(100 << 20)).is_err());
        assert!(limit.check_part(path, "c", Some(50 << 20)).is_ok());
    }
}

//! The end of a text file. The DOS end-of-file mark, 0x1a, and any blanks after it are not part of the text.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    path::Path,
};

use crate::ReadError;

/// The DOS end-of-file mark.
const MARK: u8 = 0x1a;
/// The number of bytes at the end of a file that are searched for a mark. CP/M fills records of 128 bytes with marks.
const TAIL: usize = 4096;

/// The length of a string without its end-of-file mark; the full length if it has none.
fn length(text: &[u8]) -> usize {
    let blank = |b: &u8| b.is_ascii_whitespace() || [MARK, 0].contains(b);
    let last = text.iter().rposition(|b| !blank(b)).map_or(0, |at| at + 1);
    let mark = text.get(last..).and_then(|end| end.iter().position(|b| *b == MARK));
    mark.map_or(text.len(), |at| last + at)
}

/// The bytes of a string without its end-of-file mark.
pub(super) fn without_mark(text: &[u8]) -> &[u8] {
    text.get(..length(text)).unwrap_or(text)
}

/// The whole text of a file.
///
/// # Errors
/// Fails for a file that cannot be read.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, ReadError> {
    let mut bytes = std::fs::read(path).map_err(|e| ReadError::io(path, &e))?;
    bytes.truncate(length(&bytes));
    Ok(bytes)
}

/// The text of a file, read forward. An end-of-file mark without a newline before it becomes a newline.
pub(super) struct TextFile {
    file: File,
    /// Number of unread bytes of the text.
    left: u64,
    /// Whether a newline replaces the mark.
    newline: bool,
}

impl TextFile {
    /// Opens a file.
    ///
    /// # Errors
    /// Fails for a file that cannot be read.
    pub(super) fn open(path: &Path) -> Result<TextFile, ReadError> {
        TextFile::from_path(path).map_err(|e| ReadError::io(path, &e))
    }

    fn from_path(path: &Path) -> io::Result<TextFile> {
        let mut file = File::open(path)?;
        let bytes = file.metadata()?.len();
        let from = bytes.saturating_sub(TAIL as u64);
        file.seek(SeekFrom::Start(from))?;
        let mut tail = vec![];
        file.by_ref().take(TAIL as u64).read_to_end(&mut tail)?;
        file.seek(SeekFrom::Start(0))?;
        let length = length(&tail);
        if length == tail.len() {
            // Without a mark, the text has no limit, because the file may grow while it is read.
            return Ok(TextFile { file, left: u64::MAX, newline: false });
        }
        let newline = length.checked_sub(1).is_some_and(|last| !matches!(tail.get(last), Some(b'\n' | b'\r')));
        Ok(TextFile { file, left: from + length as u64, newline })
    }
}

impl Read for TextFile {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let read = self.file.by_ref().take(self.left).read(to)?;
        self.left -= read as u64;
        match to.first_mut() {
            Some(first) if read == 0 && self.newline => {
                (*first, self.newline) = (b'\n', false);
                Ok(1)
            }
            _ => Ok(read),
        }
    }
}

/// Whether a string ends with a newline, or with an end-of-file mark.
///
/// # Errors
/// Fails for a file that cannot be read.
pub(super) fn is_whole(path: &Path) -> io::Result<bool> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::End(-1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    Ok(matches!(last, [b'\n' | b'\r']) || TextFile::from_path(path)?.left < u64::MAX)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn unit_only_an_end_of_file_mark_ends_a_text() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.csv");
        for (bytes, text, whole) in [
            (&b"a,b\r\n1,2\r\n\x1a"[..], &b"a,b\r\n1,2\r\n"[..], true),
            (b"a,b\n1,2\x1a", b"a,b\n1,2\n", true),
            (b"a,b\n1,2\n\x1a\x1a\x1a\r\n", b"a,b\n1,2\n", true),
            (b"a,b\n1\x1a,2\n", b"a,b\n1\x1a,2\n", true),
            (b"a,b\n1,2", b"a,b\n1,2", false),
            (b"\x1a", b"", true),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let mut found = vec![];
            TextFile::open(&path).unwrap().read_to_end(&mut found).unwrap();
            assert_eq!((found.as_slice(), is_whole(&path).unwrap()), (text, whole), "{bytes:?}");
        }
        let long = [vec![b'1'; 10_000], b"\n\x1a".to_vec()].concat();
        std::fs::write(&path, &long).unwrap();
        let mut found = vec![];
        TextFile::open(&path).unwrap().read_to_end(&mut found).unwrap();
        assert_eq!(found.len(), 10_001);
        assert_eq!(read(&path).unwrap().len(), 10_001);
    }
}

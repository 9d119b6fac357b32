//! Forward reading of a file in blocks, for formats that are a sequence of messages. Memory use does not grow with the
//! file.

use std::{
    fmt,
    fs::File,
    io::{self, Read},
    path::Path,
};

use crate::ReadError;

/// Bytes read at a time.
const BLOCK: usize = 4 << 20;

/// Reader of a file; its position only moves forward.
pub(super) struct ForwardReader<R> {
    input: R,
    bytes: Vec<u8>,
    /// The position in `bytes`.
    at: usize,
    /// The position in the file of the first of the `bytes`.
    before: u64,
    ended: bool,
}

impl ForwardReader<File> {
    /// Opens a file at its start.
    ///
    /// # Errors
    /// Fails if the file cannot be opened.
    pub(super) fn open(path: &Path) -> Result<ForwardReader<File>, ReadError> {
        Ok(ForwardReader::new(File::open(path).map_err(|e| ReadError::io(path, &e))?))
    }
}

impl<R: Read> ForwardReader<R> {
    pub(super) fn new(input: R) -> ForwardReader<R> {
        ForwardReader { input, bytes: vec![], at: 0, before: 0, ended: false }
    }

    /// Returns the bytes that follow the position: at least `least` bytes, except at the end of the file.
    #[inline]
    pub(super) fn ahead(&mut self, least: usize) -> io::Result<&[u8]> {
        if self.bytes.len() - self.at < least && !self.ended {
            self.fill(least)?;
        }
        Ok(self.bytes.get(self.at..).unwrap_or_default())
    }

    fn fill(&mut self, least: usize) -> io::Result<()> {
        self.bytes.drain(..self.at);
        self.before += self.at as u64;
        self.at = 0;
        let wanted = least.max(BLOCK);
        let missing = wanted.saturating_sub(self.bytes.len()) as u64;
        let read = self.input.by_ref().take(missing).read_to_end(&mut self.bytes)?;
        self.ended = (read as u64) < missing;
        Ok(())
    }

    /// Moves forward by `bytes` bytes, but not beyond those that [`ForwardReader::ahead`] returned.
    #[inline]
    pub(super) fn skip(&mut self, bytes: usize) {
        self.at = (self.at + bytes).min(self.bytes.len());
    }

    /// The position in the file.
    pub(super) fn position(&self) -> u64 {
        self.before + self.at as u64
    }
}

/// Damaged bytes that were skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Damage {
    /// Number of runs of damaged bytes between messages.
    pub(super) stretches: u64,
    /// Number of damaged bytes.
    pub(super) bytes: u64,
    /// The position of the first damaged byte.
    first: u64,
    /// End of the last run.
    end: u64,
}

impl Damage {
    /// Adds a run of `bytes` bytes at `at` that belong to no message.
    pub(super) fn add(&mut self, at: u64, bytes: u64) {
        if bytes == 0 {
            return;
        }
        if self.stretches == 0 {
            self.first = at;
        }
        if self.stretches == 0 || self.end != at {
            self.stretches += 1;
        }
        (self.bytes, self.end) = (self.bytes + bytes, at + bytes);
    }

    /// A note for the user if there is damage.
    pub(super) fn note(&self) -> Option<String> {
        let places = if self.stretches == 1 { "1 place".to_owned() } else { format!("{} places", self.stretches) };
        let Damage { bytes, first, .. } = self;
        (*bytes > 0)
            .then(|| format!("{bytes} bytes in {places} are damaged and were skipped; the first is byte {first}"))
    }
}

/// `1 message`, `2 messages`.
pub(super) fn counted(n: u64, one: &str) -> impl fmt::Display {
    if n == 1 { format!("1 {one}") } else { format!("{n} {one}s") }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_all_bytes_are_read_once_for_any_block_size() {
        let bytes: Vec<u8> = (0..3 * BLOCK + 17).map(|i| (i % 251) as u8).collect();
        let (mut forward, mut seen) = (ForwardReader::new(bytes.as_slice()), 0);
        loop {
            let ahead = forward.ahead(1000).unwrap();
            let n = ahead.len().min(777);
            if n == 0 {
                break;
            }
            assert_eq!(ahead[..n], bytes[seen..seen + n]);
            forward.skip(n);
            seen += n;
            assert_eq!(forward.position(), seen as u64);
        }
        assert_eq!(seen, bytes.len());
    }

    #[test]
    fn unit_adjacent_damaged_stretches_are_merged() {
        let mut damage = Damage::default();
        assert_eq!(damage.note(), None);
        damage.add(10, 5);
        damage.add(15, 5);
        damage.add(100, 1);
        assert_eq!((damage.stretches, damage.bytes), (2, 11));
        assert_eq!(damage.note().unwrap(), "11 bytes in 2 places are damaged and were skipped; the first is byte 10");
    }
}

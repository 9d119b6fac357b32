//! Text in blocks of whole records.

use std::io::{self, Read};

use super::{
    super::decimal::PAD,
    cells::{CsvCells, ends_record, last_end},
};

/// Approximate size of a block, in bytes.
pub(super) const BLOCK: usize = 1 << 21;

/// Maximum length of a record, in bytes. A longer record has an unclosed quote or is not part of a table.
const LONGEST: usize = 1 << 28;

const MARK: &[u8] = "\u{feff}".as_bytes();

/// Whole records of CSV text, followed by newlines as padding.
pub(super) struct CsvBlock {
    /// The records, then newlines as padding.
    text: Vec<u8>,
    len: usize,
    /// Position of the first record.
    pub(super) start: usize,
    /// Whether the block is the last block of a file that does not end with a newline.
    pub(super) cut: bool,
}

impl CsvBlock {
    /// The records with their terminators, followed by newlines.
    pub(super) fn text(&self) -> &[u8] {
        &self.text
    }

    /// The position after the last record.
    pub(super) fn end(&self) -> usize {
        self.len
    }

    /// The number of newlines between two positions.
    pub(super) fn newlines(&self, from: usize, to: usize) -> u64 {
        let text = self.text.get(from..to.min(self.len)).unwrap_or_default();
        text.iter().filter(|b| **b == b'\n').count() as u64
    }
}

/// Reader of CSV text in blocks; the first record is the one after the header.
pub(super) struct CsvBlockReader<R> {
    input: R,
    size: usize,
    /// The bytes read after the last block.
    rest: Vec<u8>,
    begun: bool,
    done: bool,
}

impl<R: Read> CsvBlockReader<R> {
    pub(super) fn new(input: R, size: usize) -> CsvBlockReader<R> {
        CsvBlockReader { input, size, rest: vec![], begun: false, done: false }
    }

    /// Up to `most` blocks, and the error after them, if any.
    pub(super) fn some(&mut self, most: usize) -> (Vec<CsvBlock>, Option<io::Error>) {
        let mut some = vec![];
        while some.len() < most.max(1) {
            match self.next() {
                Ok(Some(block)) => some.push(block),
                Ok(None) => break,
                Err(error) => return (some, Some(error)),
            }
        }
        (some, None)
    }

    /// The next block.
    ///
    /// # Errors
    /// Fails with the errors of the input, or for a record without an end.
    fn next(&mut self) -> io::Result<Option<CsvBlock>> {
        if self.done {
            return Ok(None);
        }
        let mut text = std::mem::take(&mut self.rest);
        let mut wanted = self.size.max(1);
        let end = loop {
            let missing = wanted.saturating_sub(text.len());
            text.reserve(missing + PAD + 1);
            let read = self.input.by_ref().take(missing as u64).read_to_end(&mut text)?;
            if read < missing {
                self.done = true;
                break text.len();
            }
            match last_end(&text) {
                Some(end) => break end,
                None if text.len() > LONGEST => {
                    let what = "a row is longer than 256 MB: a quote is not closed, or this is not a table";
                    return Err(io::Error::new(io::ErrorKind::InvalidData, what));
                }
                None => wanted = text.len() * 2,
            }
        };
        self.rest = text.get(end..).unwrap_or_default().to_vec();
        text.truncate(end);
        let cut = self.done && !text.last().is_none_or(|b| ends_record(*b));
        let len = text.len();
        text.resize(len + PAD + 1, b'\n');
        let header = if self.begun { Some(0) } else { after_header(&text, len) };
        // Empty lines before the header may fill a block.
        self.begun |= header.is_some();
        let start = header.unwrap_or(len);
        Ok(Some(CsvBlock { text, len: len + usize::from(cut), start, cut }))
    }
}

/// The position of the first record after the header; `None` if the header is not complete yet.
fn after_header(text: &[u8], len: usize) -> Option<usize> {
    let mut at = if text.starts_with(MARK) { MARK.len() } else { 0 };
    while at < len && ends_record(text[at]) {
        at += 1;
    }
    (at < len).then(|| CsvCells::default().take(text, at).min(len))
}

//! Finds the ends of records in CSV text, and the cells of a record. Commas separate cells. Cells that contain commas,
//! newlines or (doubled) quotes are quoted. A carriage return or a newline ends a record.

/// Whether a byte ends a record.
pub(super) fn ends_record(byte: u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

/// The cells of one record, without their quotes.
#[derive(Default)]
pub(super) struct CsvCells {
    bytes: Vec<u8>,
    /// The end of each cell.
    ends: Vec<usize>,
}

impl CsvCells {
    /// Reads the cells of the record at `start`, and returns the position of the next record. An unclosed quote, and a
    /// record without a newline, extend to the end of the text.
    pub(super) fn take(&mut self, text: &[u8], start: usize) -> usize {
        self.bytes.clear();
        self.ends.clear();
        let mut at = start;
        loop {
            at = cell(text, at, |part| self.bytes.extend_from_slice(part));
            self.ends.push(self.bytes.len());
            if text.get(at) != Some(&b',') {
                return (at + 1).min(text.len());
            }
            at += 1;
        }
    }

    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// A cell without surrounding blanks.
    pub(super) fn get(&self, i: usize) -> &[u8] {
        let start = i.checked_sub(1).and_then(|before| self.ends.get(before)).copied().unwrap_or(0);
        let end = self.ends.get(i).copied().unwrap_or(start);
        self.bytes.get(start..end).unwrap_or_default().trim_ascii()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &[u8]> {
        (0..self.len()).map(|i| self.get(i))
    }
}

/// Passes the contents of the cell at `start` to `put`, in chunks; returns the position after it.
fn cell(text: &[u8], start: usize, mut put: impl FnMut(&[u8])) -> usize {
    let mut at = start;
    if text.get(at) == Some(&b'"') {
        at += 1;
        loop {
            let rest = text.get(at..).unwrap_or_default();
            let Some(quote) = rest.iter().position(|b| *b == b'"') else {
                put(rest);
                return text.len();
            };
            at += quote + 1;
            if text.get(at) != Some(&b'"') {
                put(&rest[..quote]);
                break;
            }
            put(&rest[..=quote]);
            at += 1;
        }
    }
    // After a closing quote, and in a cell that does not begin with a quote, a quote is an ordinary character.
    let rest = text.get(at..).unwrap_or_default();
    let length = rest.iter().position(|b| *b == b',' || ends_record(*b)).unwrap_or(rest.len());
    put(&rest[..length]);
    at + length
}

/// The end of the last complete record, including its terminator; `None` if there is no complete record.
pub(super) fn last_end(text: &[u8]) -> Option<usize> {
    if !text.contains(&b'"') {
        let last = |end: u8| text.iter().rposition(|b| *b == end).map(|at| at + 1);
        // The carriage returns of a file are either alone or each followed by a newline.
        return last(b'\n').or_else(|| last(b'\r'));
    }
    let (mut at, mut whole) = (0, None);
    loop {
        at = cell(text, at, |_| ());
        match text.get(at) {
            Some(b',') => at += 1,
            Some(_) => {
                at += 1;
                whole = Some(at);
            }
            None => return whole,
        }
    }
}

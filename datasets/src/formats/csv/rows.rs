//! Conversion of the text of rows to columns of values.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::SchemaRef;

use super::{
    super::{decimal, missing, missing::MissingMarkers},
    CsvColumnKind,
    blocks::CsvBlock,
    cells::{CsvCells, ends_record},
};
use crate::ReadError;

/// The columns of a file, and the treatment of its values.
pub(super) struct CsvLayout {
    pub(super) names: Vec<String>,
    pub(super) kinds: Vec<CsvColumnKind>,
    pub(super) missing: MissingMarkers,
    /// The largest of the numbers that mark missing values.
    pub(super) fillers_to: f64,
    /// Whether the last row is dropped because the end of the file truncates it.
    pub(super) drops_last: bool,
}

/// The values of one column of some rows.
enum CsvColumn {
    Number(Vec<f64>),
    Whole(Vec<Option<i64>>),
    Text(TextBuffer),
}

/// Strings in one buffer, one after another, with the end of each.
#[derive(Default)]
struct TextBuffer {
    all: String,
    /// End of each text in the buffer.
    ends: Vec<usize>,
}

impl TextBuffer {
    fn push(&mut self, text: &str) {
        self.all.push_str(text);
        self.ends.push(self.all.len());
    }

    fn get(&self, row: usize) -> &str {
        let start = row.checked_sub(1).and_then(|before| self.ends.get(before)).copied().unwrap_or(0);
        self.ends.get(row).and_then(|end| self.all.get(start..*end)).unwrap_or_default()
    }

    fn truncate(&mut self, rows: usize) {
        self.ends.truncate(rows);
        self.all.truncate(self.ends.last().copied().unwrap_or(0));
    }
}

impl CsvColumn {
    fn truncate(&mut self, rows: usize) {
        match self {
            CsvColumn::Number(out) => out.truncate(rows),
            CsvColumn::Whole(out) => out.truncate(rows),
            CsvColumn::Text(out) => out.truncate(rows),
        }
    }
}

/// Fault of one row of a block, with its position.
pub(super) struct CsvRowFault {
    /// Row within the block, from 0.
    pub(super) row: usize,
    /// Number of newlines of the block before the row.
    pub(super) newlines: u64,
    what: CsvFaultKind,
}

enum CsvFaultKind {
    /// A wrong number of values.
    Ragged(usize),
    /// The row that the end of the file truncates.
    Cut(usize),
    OtherHeader,
    /// A cell that is not a number, and its column.
    NoNumber(usize, Vec<u8>),
}

impl CsvRowFault {
    /// Whether the fault prevents further reading.
    pub(super) fn is_fatal(&self) -> bool {
        matches!(self.what, CsvFaultKind::OtherHeader)
    }

    /// The fault of the row `row` in the line `line` of the file.
    pub(super) fn fault(&self, path: &Path, layout: &CsvLayout, row: u64, line: u64) -> ReadError {
        let of_row = |what: String| ReadError::data(path, what).in_row(row);
        let ragged = |n: usize| of_row(format!("the row has {n} values, but the header has {}", layout.names.len()));
        match &self.what {
            CsvFaultKind::Ragged(n) => ragged(*n).help(format!("line {line} of the file")),
            CsvFaultKind::Cut(n) => {
                ragged(*n).help(format!("line {line} of the file is cut short: the file ends there without a newline"))
            }
            CsvFaultKind::OtherHeader => {
                let what = "the row looks like another header: the file contains several tables, one after another";
                of_row(what.to_owned()).help(format!("line {line} of the file; put each table into a separate file"))
            }
            CsvFaultKind::NoNumber(column, cell) => {
                let (what, help) = match std::str::from_utf8(cell) {
                    Ok(text)
                        if layout.kinds[*column] == CsvColumnKind::Whole && layout.missing.number(text).is_some() =>
                    {
                        (format!("`{text}` is not a whole number"), format!("line {line} of the file"))
                    }
                    Ok(text) => {
                        let help =
                            format!("line {line} of the file; if the text marks a missing value, add it to `missing`");
                        (format!("`{text}` is not a number"), help)
                    }
                    Err(error) => (format!("is not UTF-8 text: {error}"), format!("line {line} of the file")),
                };
                ReadError::data(path, what).in_column(&layout.names[*column]).in_row(row).help(help)
            }
        }
    }
}

/// The rows of a block.
pub(super) struct CsvRows<'a> {
    layout: &'a CsvLayout,
    columns: Vec<CsvColumn>,
    cells: CsvCells,
    pub(super) rows: usize,
    pub(super) wrong: Vec<CsvRowFault>,
    /// Number of rows at the start of the block that have the flight and the line of the row before the block.
    orphans: usize,
    /// Number of newlines of the block.
    pub(super) newlines: u64,
}

impl<'a> CsvRows<'a> {
    /// Reads the rows of a block, up to a fatal fault.
    pub(super) fn parse(layout: &'a CsvLayout, block: &CsvBlock) -> CsvRows<'a> {
        let text = block.text();
        let room = room(text, block).min(block.end() / layout.kinds.len().max(1) + 8);
        let column = |kind: &CsvColumnKind| match kind {
            CsvColumnKind::Number => CsvColumn::Number(Vec::with_capacity(room)),
            CsvColumnKind::Whole => CsvColumn::Whole(Vec::with_capacity(room)),
            CsvColumnKind::Text | CsvColumnKind::Key => CsvColumn::Text(TextBuffer::default()),
        };
        let columns = layout.kinds.iter().map(column).collect();
        let mut rows =
            CsvRows { layout, columns, cells: CsvCells::default(), rows: 0, wrong: vec![], orphans: 0, newlines: 0 };
        let (mut at, mut counted) = (block.start, 0);
        while at < block.end() {
            if ends_record(text[at]) {
                at += 1;
                continue;
            }
            let start = at;
            let plain = if may_repeat(text, start, &layout.names) { None } else { rows.plain_row(text, start) };
            at = plain.unwrap_or_else(|| rows.cells.take(text, start));
            let ends_file = block.cut && at >= block.end();
            if plain.is_none() || (ends_file && layout.drops_last) {
                rows.columns.iter_mut().for_each(|c| c.truncate(rows.rows));
            }
            if ends_file && layout.drops_last {
                break;
            }
            if plain.is_some() {
                rows.rows += 1;
                continue;
            }
            if repeats(&rows.cells, &layout.names) {
                continue;
            }
            if let Some(what) = rows.any_row(ends_file) {
                rows.newlines += block.newlines(counted, start);
                counted = start;
                let wrong = CsvRowFault { row: rows.rows, newlines: rows.newlines, what };
                let fatal = wrong.is_fatal();
                rows.wrong.push(wrong);
                if fatal {
                    break;
                }
            }
            rows.rows += 1;
        }
        rows.newlines += block.newlines(counted, block.end());
        rows
    }

    /// Appends the row at `start` and returns the row's end, if the row has a value for each column, no quotes and no
    /// fault. Otherwise some of the row's values remain appended.
    #[inline]
    fn plain_row(&mut self, text: &[u8], start: usize) -> Option<usize> {
        let last = self.columns.len().checked_sub(1)?;
        let mut at = start;
        for (i, column) in self.columns.iter_mut().enumerate() {
            let end = match column {
                CsvColumn::Number(out) => {
                    let (x, end) = plain_number(text, at, self.layout)?;
                    out.push(x);
                    end
                }
                CsvColumn::Whole(out) => {
                    let (cell, end) = plain_cell(text, at)?;
                    out.push(self.layout.missing.whole(cell)?);
                    end
                }
                CsvColumn::Text(out) => {
                    let (cell, end) = plain_cell(text, at)?;
                    out.push(cell);
                    end
                }
            };
            match text.get(end)? {
                b',' if i < last => at = end + 1,
                b'\n' | b'\r' if i == last => return Some(end + 1),
                _ => return None,
            }
        }
        None
    }

    /// Appends the row in `cells`, and returns its fault.
    fn any_row(&mut self, cut: bool) -> Option<CsvFaultKind> {
        let layout = self.layout;
        let whole = self.cells.len() == layout.names.len();
        let mut wrong = None;
        for (i, (column, kind)) in self.columns.iter_mut().zip(&layout.kinds).enumerate() {
            let text = if whole { std::str::from_utf8(self.cells.get(i)) } else { Ok("") };
            let read = match (column, &text) {
                (CsvColumn::Number(out), text) => {
                    let number = text.as_ref().ok().and_then(|t| layout.missing.number(t));
                    out.push(number.unwrap_or(f64::NAN));
                    number.is_some()
                }
                (CsvColumn::Whole(out), text) => {
                    let number = text.as_ref().ok().and_then(|t| layout.missing.whole(t));
                    out.push(number.unwrap_or(None));
                    number.is_some()
                }
                (CsvColumn::Text(out), _) if !whole && *kind == CsvColumnKind::Key => {
                    let before = self.rows.checked_sub(1).map(|row| out.get(row).to_owned());
                    out.push(&before.unwrap_or_default());
                    true
                }
                (CsvColumn::Text(out), text) => {
                    out.push(text.as_ref().copied().unwrap_or_default());
                    text.is_ok()
                }
            };
            if !read && wrong.is_none() {
                wrong = Some(i);
            }
        }
        if !whole {
            self.orphans += usize::from(self.orphans == self.rows);
            let n = self.cells.len();
            return Some(if cut { CsvFaultKind::Cut(n) } else { CsvFaultKind::Ragged(n) });
        }
        let column = wrong?;
        if self.is_other_header() {
            return Some(CsvFaultKind::OtherHeader);
        }
        Some(CsvFaultKind::NoNumber(column, self.cells.get(column).to_vec()))
    }

    /// Whether the row in `cells` has a word in every column of numbers, of which there are at least two.
    fn is_other_header(&self) -> bool {
        let CsvLayout { kinds, missing, .. } = self.layout;
        let number = |(kind, _): &(&CsvColumnKind, &[u8])| matches!(kind, CsvColumnKind::Number | CsvColumnKind::Whole);
        let (mut words, mut numbers) = (0, 0);
        for (_, cell) in kinds.iter().zip(self.cells.iter()).filter(number) {
            let is_word = |t: &str| !missing::is_usual_word(t) && missing.number(t).is_none();
            words += usize::from(std::str::from_utf8(cell).is_ok_and(is_word));
            numbers += 1;
        }
        words > 1 && words == numbers
    }

    /// The rows as a batch. `keys` holds the last flight and line before the block, and on return the flight and line
    /// of its last row.
    pub(super) fn into_batch(
        self,
        path: &Path,
        schema: &SchemaRef,
        keys: &mut [String],
    ) -> Result<RecordBatch, ReadError> {
        let rows = self.rows;
        let mut arrays: Vec<ArrayRef> = Vec::with_capacity(self.columns.len());
        for (i, column) in self.columns.into_iter().enumerate() {
            arrays.push(match column {
                CsvColumn::Number(values) => Arc::new(Float64Array::from(values)),
                CsvColumn::Whole(values) => Arc::new(Int64Array::from(values)),
                CsvColumn::Text(texts) => {
                    let is_key = self.layout.kinds.get(i) == Some(&CsvColumnKind::Key);
                    let orphans = if is_key { self.orphans.min(rows) } else { 0 };
                    let before = keys.get(i).cloned().unwrap_or_default();
                    let one = |row| if row < orphans { before.as_str() } else { texts.get(row) };
                    let array = StringArray::from_iter_values((0..rows).map(one));
                    if let (Some(key), Some(last)) = (keys.get_mut(i), rows.checked_sub(1)) {
                        array.value(last).clone_into(key);
                    }
                    Arc::new(array)
                }
            });
        }
        RecordBatch::try_new(schema.clone(), arrays).map_err(|e| ReadError::data(path, e.to_string()))
    }
}

/// Estimated number of rows of a block, from its first row.
fn room(text: &[u8], block: &CsvBlock) -> usize {
    let first = text.get(block.start..block.end()).unwrap_or_default();
    let length = first.iter().position(|b| *b == b'\n').unwrap_or(first.len()).max(1);
    first.len() / length + first.len() / length / 8 + 8
}

/// Whether the row at `start` may repeat the header. The first cell decides this for nearly every row.
pub(super) fn may_repeat(text: &[u8], start: usize, names: &[String]) -> bool {
    let row = text.get(start..).unwrap_or_default();
    let blank = row.iter().take_while(|b| matches!(b, b' ' | b'\t' | b'\x0C')).count();
    let (row, name) = (&row[blank..], names.first().map_or("", String::as_str));
    row.starts_with(name.as_bytes()) || row.first() == Some(&b'"')
}

/// Whether a row repeats the header.
pub(super) fn repeats(cells: &CsvCells, names: &[String]) -> bool {
    cells.len() == names.len() && cells.iter().zip(names).all(|(cell, name)| cell == name.as_bytes())
}

/// The number in the cell at `start` and the position after the cell; `None` for a cell with quotes or without a
/// number.
#[inline(always)]
fn plain_number(text: &[u8], start: usize, layout: &CsvLayout) -> Option<(f64, usize)> {
    let mut at = start;
    while text.get(at) == Some(&b' ') {
        at += 1;
    }
    if let Some((x, mut end)) = decimal::number(text, at) {
        while text.get(end) == Some(&b' ') {
            end += 1;
        }
        if matches!(text.get(end), Some(b',' | b'\n' | b'\r')) {
            return Some((if x > layout.fillers_to { x } else { layout.missing.kept(x) }, end));
        }
    }
    other_number(text, start, layout)
}

/// A number of many digits, or a missing value as a word or an empty cell.
#[inline(never)]
fn other_number(text: &[u8], start: usize, layout: &CsvLayout) -> Option<(f64, usize)> {
    let (cell, end) = plain_cell(text, start)?;
    Some((layout.missing.number(cell)?, end))
}

/// The cell at `start` without surrounding blanks, and the position after it; `None` for a cell with quotes.
#[inline]
pub(super) fn plain_cell(text: &[u8], start: usize) -> Option<(&str, usize)> {
    let rest = text.get(start..)?;
    let length = rest.iter().position(|b| matches!(b, b',' | b'\n' | b'\r'))?;
    let cell = &rest[..length];
    if cell.first() == Some(&b'"') {
        return None;
    }
    Some((std::str::from_utf8(cell.trim_ascii()).ok()?, start + length))
}

//! The properties of a whole file that are needed before its first row: the type of each column, and the skipped rows.
//! No value is converted; columns of known type are skipped.

use std::path::Path;

use rayon::prelude::*;

use super::{
    super::{FlightOptions, decimal, missing::MissingMarkers, text_end::is_whole},
    CsvColumnKind,
    blocks::{CsvBlock, CsvBlockReader},
    cells::{CsvCells, ends_record},
    rows::{may_repeat, plain_cell, repeats},
    separated::CsvText,
    settled_kind,
};
use crate::ReadError;

/// Result of the first pass over a file: column types, repeated headers and truncation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CsvScan {
    pub(super) kinds: Vec<CsvColumnKind>,
    /// Number of rows that repeat the header, and the line of the first of these rows.
    repeated: (u64, u64),
    cut: Option<CsvTruncation>,
}

/// Last value of a file that does not end with a newline. The value may be truncated.
#[derive(Clone, Debug, PartialEq)]
struct CsvTruncation {
    value: String,
    line: u64,
    /// Whether this value is shorter than all other values of its column.
    short: bool,
}

/// Columns to examine in the first pass.
struct CsvScanColumns<'a> {
    names: &'a [String],
    missing: &'a MissingMarkers,
    /// Columns of undetermined type that have only numbers so far.
    open: Vec<bool>,
    /// Whether the lengths of the last values of the rows are recorded.
    widths: bool,
}

/// Result of the first pass for one block.
struct CsvBlockSummary {
    /// Columns in which some cell is not a number.
    words: Vec<usize>,
    /// Number of rows that repeat the header, and number of newlines of the block before the first of these rows.
    repeated: (u64, u64),
    newlines: u64,
    /// Length of the shortest last value of a row, except a row that the end of the file truncates.
    shortest: usize,
    /// The last value of a row that the end of the file truncates, and the number of newlines before the row.
    last: Option<(Vec<u8>, u64)>,
}

impl CsvScan {
    /// Scans a file, several blocks in parallel.
    ///
    /// # Errors
    /// Fails if the file cannot be read.
    pub(super) fn read(
        path: &Path,
        names: &[String],
        options: &FlightOptions,
        (block, threads): (usize, usize),
    ) -> Result<CsvScan, ReadError> {
        let io = |e: std::io::Error| ReadError::io(path, &e);
        let missing = MissingMarkers::from_options(options);
        let settled: Vec<Option<CsvColumnKind>> = names.iter().map(|n| settled_kind(n, options)).collect();
        let mut kinds: Vec<CsvColumnKind> = settled.iter().map(|k| k.unwrap_or(CsvColumnKind::Number)).collect();
        let open = settled.iter().map(Option::is_none).collect();
        let widths = !is_whole(path).unwrap_or(true);
        let mut question = CsvScanColumns { names, missing: &missing, open, widths };
        let mut blocks = CsvBlockReader::new(CsvText::open(path)?, block);
        let (mut repeated, mut line, mut shortest, mut last) = ((0, 0), 1, usize::MAX, None);
        loop {
            let (some, failed) = blocks.some(threads);
            if some.is_empty() && failed.is_none() {
                break;
            }
            for answer in at_once(&some, |block| CsvBlockScanner::scan(&question, block)) {
                for column in answer.words {
                    kinds[column] = CsvColumnKind::Text;
                    question.open[column] = false;
                }
                if repeated.0 == 0 {
                    repeated.1 = line + answer.repeated.1;
                }
                repeated.0 += answer.repeated.0;
                shortest = shortest.min(answer.shortest);
                last = answer.last.map(|(value, newlines)| (value, line + newlines));
                line += answer.newlines;
            }
            if let Some(error) = failed {
                return Err(io(error));
            }
        }
        let numeric = matches!(kinds.last(), Some(CsvColumnKind::Number | CsvColumnKind::Whole));
        let cut = last.map(|(value, line)| CsvTruncation {
            line,
            short: numeric && value.len() < shortest && shortest < usize::MAX,
            value: String::from_utf8_lossy(&value).into_owned(),
        });
        Ok(CsvScan { kinds, repeated, cut })
    }

    /// Whether the last row is dropped, because its last number is truncated.
    pub(super) fn drops_last(&self) -> bool {
        self.cut.as_ref().is_some_and(|c| c.short)
    }

    /// The scan as text, for [`CsvScan::parse`].
    pub(super) fn spelt(&self) -> String {
        let kinds: String = self.kinds.iter().map(|k| k.letter()).collect();
        let (count, line) = self.repeated;
        let mut text = format!("csv 1\n{kinds}\n{count} {line}\n");
        if let Some(CsvTruncation { value, line, short }) = &self.cut {
            text += &format!("{line} {short} {value}");
        }
        text
    }

    /// The inverse of [`CsvScan::spelt`] for a file with this number of columns.
    pub(super) fn parse(text: &str, columns: usize) -> Option<CsvScan> {
        let (kinds, rest) = text.strip_prefix("csv 1\n")?.split_once('\n')?;
        let (repeated, cut) = rest.split_once('\n')?;
        let kinds: Vec<CsvColumnKind> = kinds.chars().map(CsvColumnKind::of_letter).collect::<Option<_>>()?;
        let (count, line) = repeated.split_once(' ')?;
        let repeated = (count.parse().ok()?, line.parse().ok()?);
        let cut = match cut {
            "" => None,
            cut => {
                let mut words = cut.splitn(3, ' ');
                let (line, short) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
                Some(CsvTruncation { line, short, value: words.next()?.to_owned() })
            }
        };
        (kinds.len() == columns).then_some(CsvScan { kinds, repeated, cut })
    }

    pub(super) fn notes(&self, path: &Path, names: &[String]) -> Vec<String> {
        let mut notes = vec![];
        let file = path.display();
        let (repeated, line) = self.repeated;
        if repeated > 0 {
            let rows = if repeated == 1 { "a row repeats".to_owned() } else { format!("{repeated} rows repeat") };
            notes.push(format!("{file}: {rows} the header (first in line {line} of the file); skipped"));
        }
        if let (Some(cut), Some(column)) = (&self.cut, names.last()) {
            let (value, line) = (&cut.value, cut.line);
            let ends = format!("{file}: the file does not end with a newline, so it may be cut short");
            notes.push(if cut.short {
                format!(
                    "{ends}; the last value `{value}` of `{column}` (line {line} of the file) is shorter than all \
                     others of its column, and its row is skipped"
                )
            } else {
                format!("{ends} inside the last value `{value}` of `{column}` (line {line} of the file)")
            });
        }
        notes
    }
}

/// One result per block, computed in parallel.
pub(super) fn at_once<T: Send>(blocks: &[CsvBlock], one: impl Fn(&CsvBlock) -> T + Send + Sync) -> Vec<T> {
    match blocks {
        // A thread pool is not used here, because it would give this thread unrelated work.
        [block] => vec![one(block)],
        blocks => blocks.par_iter().map(one).collect(),
    }
}

impl CsvBlockSummary {
    /// Records the last value of the complete row from `start` to `end`.
    fn width(&mut self, value: &[u8], (block, start): (&CsvBlock, usize), end: usize) {
        if block.cut && end >= block.end() {
            self.last = Some((value.to_vec(), block.newlines(0, start)));
        } else {
            self.shortest = self.shortest.min(value.len());
        }
    }
}

/// State of the first pass over one block: the columns without words, and the result so far.
struct CsvBlockScanner<'a> {
    question: &'a CsvScanColumns<'a>,
    /// Columns without words in this block.
    open: Vec<bool>,
    cells: CsvCells,
    /// Columns of the current row that have words.
    doubts: Vec<usize>,
    /// The start and the end of the last value of the current row.
    last: (usize, usize),
    answer: CsvBlockSummary,
}

impl CsvBlockScanner<'_> {
    fn scan(question: &CsvScanColumns, block: &CsvBlock) -> CsvBlockSummary {
        let text = block.text();
        let answer = CsvBlockSummary { words: vec![], repeated: (0, 0), newlines: 0, shortest: usize::MAX, last: None };
        let (cells, doubts, open) = (CsvCells::default(), vec![], question.open.clone());
        let mut look = CsvBlockScanner { question, open, cells, doubts, last: (0, 0), answer };
        let all_settled = !question.widths && !question.open.contains(&true) && !text.contains(&b'"');
        let mut at = block.start;
        while at < block.end() {
            if ends_record(text[at]) {
                at += 1;
                continue;
            }
            let start = at;
            let plain = if may_repeat(text, start, question.names) {
                None
            } else if all_settled {
                text[start..].iter().position(|b| ends_record(*b)).map(|length| start + length)
            } else {
                look.plain_row(text, start)
            };
            at = plain.unwrap_or_else(|| look.any_row(block, start));
            if plain.is_some() && question.widths {
                let (from, to) = look.last;
                let value = text.get(from..to).unwrap_or_default().trim_ascii();
                // The end of the record follows.
                look.answer.width(value, (block, start), at + 1);
            }
        }
        look.answer.newlines = block.newlines(0, block.end());
        look.answer
    }

    /// Scans the row at `start` and returns the row's end, if the row has a value for each column and no quotes.
    #[inline]
    fn plain_row(&mut self, text: &[u8], start: usize) -> Option<usize> {
        let last = self.open.len().checked_sub(1)?;
        let mut at = start;
        self.doubts.clear();
        for (i, open) in self.open.iter().enumerate() {
            let end = if *open {
                match number_end(text, at) {
                    Some(end) => end,
                    None => {
                        let (cell, end) = plain_cell(text, at)?;
                        if self.question.missing.number(cell).is_none() {
                            self.doubts.push(i);
                        }
                        end
                    }
                }
            } else {
                let rest = text.get(at..)?;
                if rest.first() == Some(&b'"') {
                    return None;
                }
                at + rest.iter().position(|b| matches!(b, b',' | b'\n' | b'\r'))?
            };
            match text.get(end)? {
                b',' if i < last => at = end + 1,
                b'\n' | b'\r' if i == last => {
                    self.last = (at, end);
                    self.settle();
                    return Some(end);
                }
                _ => return None,
            }
        }
        None
    }

    /// Marks the columns that have words in the current row as text, once the row is complete.
    fn settle(&mut self) {
        for column in self.doubts.drain(..) {
            self.open[column] = false;
            self.answer.words.push(column);
        }
    }

    /// Scans any row, and returns the position of the next one.
    #[inline(never)]
    fn any_row(&mut self, block: &CsvBlock, start: usize) -> usize {
        let CsvScanColumns { names, missing, widths, .. } = self.question;
        let end = self.cells.take(block.text(), start);
        if repeats(&self.cells, names) {
            if self.answer.repeated.0 == 0 {
                self.answer.repeated.1 = block.newlines(0, start);
            }
            self.answer.repeated.0 += 1;
            return end;
        }
        if self.cells.len() != names.len() {
            return end;
        }
        self.doubts.clear();
        for (i, cell) in self.cells.iter().enumerate().filter(|(i, _)| self.open[*i]) {
            if !std::str::from_utf8(cell).is_ok_and(|text| missing.number(text).is_some()) {
                self.doubts.push(i);
            }
        }
        self.settle();
        if *widths {
            self.answer.width(self.cells.get(names.len() - 1), (block, start), end);
        }
        end
    }
}

/// The position after the cell at `start`, if it is a plain number.
#[inline(always)]
fn number_end(text: &[u8], start: usize) -> Option<usize> {
    let mut at = start;
    while text.get(at) == Some(&b' ') {
        at += 1;
    }
    let mut end = decimal::end(text, at)?;
    while text.get(end) == Some(&b' ') {
        end += 1;
    }
    matches!(text.get(end), Some(b',' | b'\n' | b'\r')).then_some(end)
}

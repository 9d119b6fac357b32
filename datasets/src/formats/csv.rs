//! Comma-separated text with a header row; other separators are converted. The file is read twice: once for the type of
//! each column, once for the values. Memory use does not depend on the size of the file.
//!
//! A cell that is not a number in a column of numbers, and a row with more or fewer values than the header, are faults
//! of their row. A row that repeats the header, as in concatenated files, is skipped and noted. A row that is a
//! different header is an error, because its columns differ.

use std::{
    collections::{HashSet, VecDeque},
    io::Read,
    path::{Path, PathBuf},
};

use arrow_schema::SchemaRef;
use schemas::{Role, flight};

use self::{
    blocks::{BLOCK, CsvBlockReader},
    rows::{CsvLayout, CsvRowFault, CsvRows},
    scan::{CsvScan, at_once},
    separated::{CsvStyle, CsvText},
};
use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, RawFlight, ReadHints, RowFault, adopt, decimal,
    limits::check_columns, missing, missing::MissingMarkers,
};
use crate::{
    ReadError,
    table::{ColumnTable, ColumnValues},
};

mod blocks;
mod cells;
mod latin_1;
mod rows;
mod scan;
mod separated;
mod unit_row;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "csv",
    about: "values separated by commas, semicolons, tabs or blanks, with a header row",
    extensions: &["csv", "tsv", "txt"],
    recognise: |head: &FileHead| {
        // Comments may stand above the header.
        let header = head.text_lines().find(|line| !line.starts_with('#')).or(head.first_line());
        header.is_some_and(|l| l.contains(',') && !l.starts_with('/'))
    },
    open,
    topics: None,
    made_from: None,
};

/// The type of the values of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
enum CsvColumnKind {
    Number,
    Whole,
    Text,
    /// `flight` or `line`: text. In an unreadable row, the text of the previous row is used.
    Key,
}

impl CsvColumnKind {
    fn letter(self) -> char {
        match self {
            CsvColumnKind::Number => 'n',
            CsvColumnKind::Whole => 'w',
            CsvColumnKind::Text => 't',
            CsvColumnKind::Key => 'k',
        }
    }

    fn of_letter(letter: char) -> Option<CsvColumnKind> {
        [CsvColumnKind::Number, CsvColumnKind::Whole, CsvColumnKind::Text, CsvColumnKind::Key]
            .into_iter()
            .find(|k| k.letter() == letter)
    }
}

fn open(path: &Path, options: &FlightOptions, reading: &ReadHints) -> Result<RawFlight, ReadError> {
    open_in(path, options, reading, BLOCK)
}

/// Opens a file to be read in blocks of `block` bytes. The size of the blocks does not affect the result.
fn open_in(path: &Path, options: &FlightOptions, reading: &ReadHints, block: usize) -> Result<RawFlight, ReadError> {
    let names = header(path)?;
    check_time(path, &names, options)?;
    let known = reading.found.as_deref().and_then(|text| CsvScan::parse(text, names.len()));
    let scan = match known {
        Some(scan) => scan,
        None => CsvScan::read(path, &names, options, (block, reading.threads))?,
    };
    let mut notes = scan.notes(path, &names);
    let style = CsvStyle::of(&FileHead::read(path)?);
    notes.extend(style.notes().iter().map(|note| format!("{}: {note}", path.display())));
    let missing = MissingMarkers::from_options(options);
    let (fillers_to, drops_last) = (missing.highest(), scan.drops_last());
    let layout = CsvLayout { names, kinds: scan.kinds.clone(), missing, fillers_to, drops_last };
    let schema = layout.schema();
    let file = CsvText::open(path)?;
    let parts = CsvBatchReader {
        path: path.to_path_buf(),
        keys: vec![String::new(); layout.names.len()],
        layout,
        schema: schema.clone(),
        blocks: CsvBlockReader::new(file, block),
        threads: reading.threads,
        ready: VecDeque::new(),
        row: 0,
        line: 1,
        done: false,
    };
    Ok(RawFlight { notes, found: Some(scan.spelt()), ..RawFlight::new(schema, Box::new(parts)) })
}

/// The text of a file with semicolons, tabs, a row of units or in Latin-1, converted to comma-separated text in UTF-8,
/// with notes on the conversion. `None` for other text.
pub(super) fn converted(path: &Path) -> Result<Option<(String, Vec<String>)>, ReadError> {
    let style = CsvStyle::of(&FileHead::read(path)?);
    if !style.is_foreign() {
        return Ok(None);
    }
    let mut bytes = vec![];
    CsvText::of_form(path, &style)?.read_to_end(&mut bytes).map_err(|e| ReadError::io(path, &e))?;
    Ok(Some((String::from_utf8_lossy(&bytes).into_owned(), style.notes())))
}

/// The names in the header, distinct and not empty.
pub(super) fn header(path: &Path) -> Result<Vec<String>, ReadError> {
    let head = FileHead::read(path)?;
    if head.starts_with(b"\xff\xfe") || head.starts_with(b"\xfe\xff") {
        return Err(ReadError::data(path, "is UTF-16 text").help("save it as UTF-8"));
    }
    let mut reader = reader(path)?;
    let record = reader.headers().map_err(|e| broken(path, &e))?;
    let names: Vec<String> = record.iter().map(|n| n.trim().trim_start_matches('\u{feff}').to_owned()).collect();
    check_columns(path, names.len())?;
    let mut known = HashSet::new();
    for (i, name) in names.iter().enumerate() {
        if name.is_empty() {
            return Err(ReadError::data(path, format!("the header's column {} has no name", i + 1)));
        }
        if !known.insert(name) {
            return Err(ReadError::data(path, "the header names the column twice").in_column(name));
        }
    }
    if names.is_empty() { Err(ReadError::data(path, "there is no header row")) } else { Ok(names) }
}

/// Rejects a column that becomes `tt` if its first value is text, such as a date: `tt` is a number of seconds.
fn check_time(path: &Path, names: &[String], options: &FlightOptions) -> Result<(), ReadError> {
    let Some(at) = names.iter().position(|name| ours(name, options) == "tt") else { return Ok(()) };
    let (name, missing) = (&names[at], MissingMarkers::from_options(options));
    let first = reader(path)?.into_records().find_map(Result::ok);
    let Some(text) = first.as_ref().and_then(|record| record.get(at)) else { return Ok(()) };
    // Single unreadable numbers are faults of their rows.
    if missing.number(text).is_some() || !is_clock(text) || *name == text {
        return Ok(());
    }
    let what = format!("`{}` is text, but `tt` must be in seconds past midnight UTC", text.escape_debug());
    let help = format!(
        "read the file through a mapping with `time = {{ from = {name:?}, clock = \"text\" }}`; `magline init FILE` \
         writes the mapping and the spec"
    );
    Err(ReadError::options(path, what).in_column(name).help(help))
}

/// Whether a string looks like a date (`2024-06-03`, `3/6/2024`) or a time of day (`14:00:00`).
fn is_clock(text: &str) -> bool {
    let starts = |part: &str| part.starts_with(|c: char| c.is_ascii_digit());
    let parts =
        |separator: char, count: usize| text.split(separator).count() >= count && text.split(separator).all(starts);
    parts(':', 2) || parts('-', 3) || parts('/', 3)
}

fn reader(path: &Path) -> Result<csv::Reader<CsvText>, ReadError> {
    let file = CsvText::open(path)?;
    Ok(csv::ReaderBuilder::new().trim(csv::Trim::All).flexible(true).from_reader(file))
}

/// Name that the column `name` of a file has in the flight table.
fn ours<'a>(name: &'a str, options: &'a FlightOptions) -> &'a str {
    let plain = adopt::name_of_head(name);
    options.rename.get(name).or_else(|| options.rename.get(plain)).map_or(plain, String::as_str)
}

/// Type of a column according to its canonical name or the options; `None` if the values determine it.
fn settled_kind(name: &str, options: &FlightOptions) -> Option<CsvColumnKind> {
    let ours = ours(name, options);
    let known = flight::describe(ours);
    match ours {
        "flight" | "line" => Some(CsvColumnKind::Key),
        "year" | "doy" => Some(CsvColumnKind::Whole),
        _ => {
            let number = known.role != Role::Aux || !known.unit.is_empty() || options.units.contains_key(name);
            number.then_some(CsvColumnKind::Number)
        }
    }
}

impl CsvLayout {
    fn schema(&self) -> SchemaRef {
        let mut table = ColumnTable::default();
        for (name, kind) in self.names.iter().zip(&self.kinds) {
            let values = match kind {
                CsvColumnKind::Number => ColumnValues::Number(vec![]),
                CsvColumnKind::Whole => ColumnValues::Whole(vec![]),
                CsvColumnKind::Text | CsvColumnKind::Key => ColumnValues::Text(vec![]),
            };
            table.push(name, "", values);
        }
        table.schema()
    }
}

/// Reader of the rows of a file, one block at a time.
struct CsvBatchReader {
    path: PathBuf,
    layout: CsvLayout,
    schema: SchemaRef,
    blocks: CsvBlockReader<CsvText>,
    threads: usize,
    /// The next parts.
    ready: VecDeque<Result<FlightBatch, ReadError>>,
    /// Number of rows before the next block, and the line of the file on which the block begins.
    row: u64,
    line: u64,
    /// The last value of each key before the next block.
    keys: Vec<String>,
    done: bool,
}

impl Iterator for CsvBatchReader {
    type Item = Result<FlightBatch, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ready.is_empty() && !self.done {
            self.read();
        }
        self.ready.pop_front()
    }
}

impl CsvBatchReader {
    /// Reads the next blocks.
    fn read(&mut self) {
        let CsvBatchReader { path, layout, schema, keys, ready, .. } = self;
        let (blocks, failed) = self.blocks.some(self.threads);
        self.done = blocks.is_empty() || failed.is_some();
        for rows in at_once(&blocks, |block| CsvRows::parse(layout, block)) {
            let fault = |w: &CsvRowFault| w.fault(path, layout, self.row + w.row as u64, self.line + w.newlines);
            if let Some(fatal) = rows.wrong.last().filter(|w| w.is_fatal()) {
                ready.push_back(Err(fault(fatal)));
                self.done = true;
                return;
            }
            let faults = rows.wrong.iter().map(|w| RowFault { row: w.row, fault: fault(w) }).collect();
            self.row += rows.rows as u64;
            self.line += rows.newlines;
            if rows.rows > 0 {
                ready.push_back(rows.into_batch(path, schema, keys).map(|batch| FlightBatch { batch, faults }));
            }
        }
        ready.extend(failed.map(|e| Err(ReadError::io(path, &e))));
    }
}

/// A number; an empty cell and the usual words are missing values.
pub(super) fn number(text: &str) -> Option<f64> {
    if let Some((x, end)) = decimal::number(text.as_bytes(), 0)
        && end == text.len()
    {
        return Some(x);
    }
    text.parse().ok().or_else(|| missing::is_usual_word(text).then_some(f64::NAN))
}

/// An error of the CSV layer, with the row that contains it.
pub(super) fn broken(path: &Path, error: &csv::Error) -> ReadError {
    match error.kind() {
        csv::ErrorKind::Io(e) => ReadError::io(path, e),
        csv::ErrorKind::Utf8 { pos, err } => {
            let fault = ReadError::data(path, format!("is not UTF-8 text: {err}")).help("save the file as UTF-8");
            pos.as_ref().map_or(fault.clone(), |p| fault.in_row(p.record().saturating_sub(1)))
        }
        _ => ReadError::data(path, error.to_string()),
    }
}

#[cfg(test)]
mod tests;

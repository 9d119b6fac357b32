//! Comma-separated text with a header row. The file is read twice: once to settle the type of each
//! column, once for the values, so that memory does not grow with it.
//!
//! A cell that is not a number in a column of numbers, and a row with more or fewer values than the
//! header, are faults of their row. A row that repeats the header, as in files put one after another, is
//! skipped and noted; a row that is another header is an error, since the columns after it differ.

use std::{
    collections::{HashSet, VecDeque},
    path::{Path, PathBuf},
};

use arrow_schema::SchemaRef;
use schemas::{Role, flight};

use self::{
    blocks::{BLOCK, Blocks},
    rows::{Layout, Rows, Wrong},
    scan::{Scan, at_once},
};
use super::{
    FlightFormat, FlightOptions, Head, Part, Raw, Reading, RowFault, decimal, limits::check_columns, missing,
    missing::Missing, text_end::TextFile,
};
use crate::{
    ReadError,
    table::{Table, Values},
};

mod blocks;
mod cells;
mod rows;
mod scan;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "csv",
    about: "comma-separated values with a header row",
    extensions: &["csv", "txt"],
    recognise: |head: &Head| head.first_line().is_some_and(|l| l.contains(',') && !l.starts_with('/')),
    open,
    topics: None,
    made_from: None,
};

/// The type of the values of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Number,
    Whole,
    Text,
    /// `flight` or `line`: text, which a row that cannot be read takes from the row before.
    Key,
}

impl Kind {
    fn letter(self) -> char {
        match self {
            Kind::Number => 'n',
            Kind::Whole => 'w',
            Kind::Text => 't',
            Kind::Key => 'k',
        }
    }

    fn of_letter(letter: char) -> Option<Kind> {
        [Kind::Number, Kind::Whole, Kind::Text, Kind::Key].into_iter().find(|k| k.letter() == letter)
    }
}

fn open(path: &Path, options: &FlightOptions, reading: &Reading) -> Result<Raw, ReadError> {
    open_in(path, options, reading, BLOCK)
}

/// Opens a file to be read in blocks of this size in bytes, which does not affect the result.
fn open_in(path: &Path, options: &FlightOptions, reading: &Reading, block: usize) -> Result<Raw, ReadError> {
    let names = header(path)?;
    let known = reading.found.as_deref().and_then(|text| Scan::parse(text, names.len()));
    let scan = match known {
        Some(scan) => scan,
        None => Scan::of(path, &names, options, (block, reading.threads))?,
    };
    let notes = scan.notes(path, &names);
    let missing = Missing::of(options);
    let (fillers_to, drops_last) = (missing.highest(), scan.drops_last());
    let layout = Layout { names, kinds: scan.kinds.clone(), missing, fillers_to, drops_last };
    let schema = layout.schema();
    let file = TextFile::open(path)?;
    let parts = Parts {
        path: path.to_path_buf(),
        keys: vec![String::new(); layout.names.len()],
        layout,
        schema: schema.clone(),
        blocks: Blocks::new(file, block),
        threads: reading.threads,
        ready: VecDeque::new(),
        row: 0,
        line: 1,
        done: false,
    };
    Ok(Raw { notes, found: Some(scan.spelt()), ..Raw::new(schema, Box::new(parts)) })
}

/// The names in the header, each once and none empty.
pub(super) fn header(path: &Path) -> Result<Vec<String>, ReadError> {
    let head = Head::read(path)?;
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
    if let [name] = names.as_slice()
        && let Some((character, word)) =
            [(';', "semicolons"), ('\t', "tabs")].into_iter().find(|(c, _)| name.contains(*c))
    {
        let what = format!("its columns are separated by {word}, not by commas");
        let decimal = if character == ';' { ", and with decimal points" } else { "" };
        return Err(ReadError::data(path, what).help(format!("save it with commas{decimal}")));
    }
    if names.is_empty() { Err(ReadError::data(path, "there is no header row")) } else { Ok(names) }
}

fn reader(path: &Path) -> Result<csv::Reader<TextFile>, ReadError> {
    let file = TextFile::open(path)?;
    Ok(csv::ReaderBuilder::new().trim(csv::Trim::All).flexible(true).from_reader(file))
}

/// The type that the contract or the options give a column; `None` infers it from the values.
fn settled_kind(name: &str, options: &FlightOptions) -> Option<Kind> {
    let ours = options.rename.get(name).map_or(name, String::as_str);
    let known = flight::describe(ours);
    match ours {
        "flight" | "line" => Some(Kind::Key),
        "year" | "doy" => Some(Kind::Whole),
        _ => {
            let number = known.role != Role::Aux || !known.unit.is_empty() || options.units.contains_key(name);
            number.then_some(Kind::Number)
        }
    }
}

impl Layout {
    fn schema(&self) -> SchemaRef {
        let mut table = Table::default();
        for (name, kind) in self.names.iter().zip(&self.kinds) {
            let values = match kind {
                Kind::Number => Values::Number(vec![]),
                Kind::Whole => Values::Whole(vec![]),
                Kind::Text | Kind::Key => Values::Text(vec![]),
            };
            table.push(name, "", values);
        }
        table.schema()
    }
}

/// The rows of a file, a block at a time.
struct Parts {
    path: PathBuf,
    layout: Layout,
    schema: SchemaRef,
    blocks: Blocks<TextFile>,
    threads: usize,
    /// The next parts.
    ready: VecDeque<Result<Part, ReadError>>,
    /// Rows before the next block, and the line on which it begins.
    row: u64,
    line: u64,
    /// The last value of each key before it.
    keys: Vec<String>,
    done: bool,
}

impl Iterator for Parts {
    type Item = Result<Part, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ready.is_empty() && !self.done {
            self.read();
        }
        self.ready.pop_front()
    }
}

impl Parts {
    /// Reads the next blocks.
    fn read(&mut self) {
        let Parts { path, layout, schema, keys, ready, .. } = self;
        let (blocks, failed) = self.blocks.some(self.threads);
        self.done = blocks.is_empty() || failed.is_some();
        for rows in at_once(&blocks, |block| Rows::of(layout, block)) {
            let fault = |w: &Wrong| w.fault(path, layout, self.row + w.row as u64, self.line + w.newlines);
            if let Some(fatal) = rows.wrong.last().filter(|w| w.is_fatal()) {
                ready.push_back(Err(fault(fatal)));
                self.done = true;
                return;
            }
            let faults = rows.wrong.iter().map(|w| RowFault { row: w.row, fault: fault(w) }).collect();
            self.row += rows.rows as u64;
            self.line += rows.newlines;
            if rows.rows > 0 {
                ready.push_back(rows.into_batch(path, schema, keys).map(|batch| Part { batch, faults }));
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

/// An error of the CSV layer, with the row it is in.
pub(super) fn broken(path: &Path, error: &csv::Error) -> ReadError {
    match error.kind() {
        csv::ErrorKind::Io(e) => ReadError::io(path, e),
        csv::ErrorKind::Utf8 { pos, err } => {
            let fault = ReadError::data(path, format!("is not UTF-8 text: {err}"));
            pos.as_ref().map_or(fault.clone(), |p| fault.in_row(p.record().saturating_sub(1)))
        }
        _ => ReadError::data(path, error.to_string()),
    }
}

#[cfg(test)]
mod tests;

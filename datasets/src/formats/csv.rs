//! Comma-separated text with a header row. The file is read twice: once to settle the type of each
//! column, once for the values, so that memory does not grow with it.
//!
//! A cell that is no number where the column has numbers, and a row with more or fewer values than the
//! header, are faults of their row. A row that repeats the header, as in files put one after another, is
//! left out and noted; a row that is another header is an error, since nothing after it is in its column.

use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

use csv::ByteRecord;
use schemas::{Role, flight};

use super::{FlightFormat, FlightOptions, Head, Part, Raw, RowFault, missing, missing::Missing};
use crate::{
    ReadError,
    table::{Table, Values},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "csv",
    about: "comma-separated values with a header row",
    extensions: &["csv", "txt"],
    recognise: |head: &Head| head.first_line().is_some_and(|l| l.contains(',') && !l.starts_with('/')),
    open,
};

/// Rows to a batch.
const BATCH_ROWS: usize = 65_536;

/// What the values of a column are.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Number,
    Whole,
    Text,
    /// `flight` or `line`: text, which a row that cannot be read takes from the row before.
    Key,
}

fn open(path: &Path, options: &FlightOptions) -> Result<Raw, ReadError> {
    let names = header(path)?;
    let missing = Missing::of(options);
    let scan = Scan::of(path, &names, &missing, options)?;
    let notes = scan.notes(path, &names);
    let reader = reader(path)?;
    let mut rows =
        Rows { path: path.to_path_buf(), names, missing, reader, row: 0, keep: scan.kept(), kinds: scan.kinds };
    let schema = rows.table(&mut rows.empty())?.schema();
    let mut done = false;
    let parts = std::iter::from_fn(move || {
        if done {
            return None;
        }
        let part = rows.part().transpose();
        done = !matches!(part, Some(Ok(_)));
        part
    });
    Ok(Raw { notes, ..Raw::new(schema, Box::new(parts)) })
}

/// The names in the header, each once and none empty.
pub(super) fn header(path: &Path) -> Result<Vec<String>, ReadError> {
    let mut reader = reader(path)?;
    let record = reader.headers().map_err(|e| broken(path, &e))?;
    let names: Vec<String> = record.iter().map(|n| n.trim().trim_start_matches('\u{feff}').to_owned()).collect();
    for (i, name) in names.iter().enumerate() {
        if name.is_empty() {
            return Err(ReadError::data(path, format!("the header's column {} has no name", i + 1)));
        }
        if names.iter().take(i).any(|n| n == name) {
            return Err(ReadError::data(path, "the header names the column twice").in_column(name));
        }
    }
    if names.is_empty() { Err(ReadError::data(path, "there is no header row")) } else { Ok(names) }
}

fn reader(path: &Path) -> Result<csv::Reader<File>, ReadError> {
    let file = File::open(path).map_err(|e| ReadError::io(path, &e))?;
    Ok(csv::ReaderBuilder::new().trim(csv::Trim::All).flexible(true).from_reader(file))
}

/// Whether a row repeats the header. Its first cell settles that for nearly every row.
fn repeats(record: &ByteRecord, names: &[String]) -> bool {
    record.len() == names.len() && record.iter().zip(names).all(|(cell, name)| cell == name.as_bytes())
}

fn line_of(record: &ByteRecord) -> u64 {
    record.position().map_or(0, csv::Position::line)
}

/// What the first reading finds.
struct Scan {
    kinds: Vec<Kind>,
    rows: u64,
    /// Rows that repeat the header, and the line of the first.
    repeated: (u64, u64),
    cut: Option<Cut>,
}

/// The last value of a file that does not end with a newline: it may be cut.
struct Cut {
    value: String,
    line: u64,
    /// Whether it is shorter than all others of its column.
    short: bool,
}

impl Scan {
    /// The type of each column over the whole file: as the contract says, else numbers if all values are.
    fn of(path: &Path, names: &[String], missing: &Missing, options: &FlightOptions) -> Result<Scan, ReadError> {
        let settled: Vec<Option<Kind>> = names.iter().map(|n| settled_kind(n, options)).collect();
        let mut kinds: Vec<Kind> = settled.iter().map(|k| k.unwrap_or(Kind::Number)).collect();
        let mut open: Vec<usize> = (0..names.len()).filter(|i| settled[*i].is_none()).collect();
        let (mut rows, mut repeated, mut shortest, mut last) = (0, (0, 0), usize::MAX, None);
        let mut reader = reader(path)?;
        let (mut record, mut before) = (ByteRecord::new(), ByteRecord::new());
        while reader.read_byte_record(&mut record).map_err(|e| broken(path, &e))? {
            if repeats(&record, names) {
                last = None;
                repeated = (repeated.0 + 1, if repeated.0 == 0 { line_of(&record) } else { repeated.1 });
                continue;
            }
            rows += 1;
            if record.len() != names.len() {
                last = None;
                continue;
            }
            shortest = last.map_or(shortest, |width: usize| width.min(shortest));
            last = record.get(names.len() - 1).map(<[u8]>::len);
            open.retain(|&i| {
                let number = std::str::from_utf8(&record[i]).is_ok_and(|text| missing.number(text).is_some());
                if !number {
                    kinds[i] = Kind::Text;
                }
                number
            });
            std::mem::swap(&mut record, &mut before);
        }
        let numeric = matches!(kinds.last(), Some(Kind::Number | Kind::Whole));
        let cut = last.filter(|_| !ends_with_newline(path).unwrap_or(true)).map(|width| Cut {
            value: record_text(&before),
            line: line_of(&before),
            short: numeric && width < shortest && shortest < usize::MAX,
        });
        Ok(Scan { kinds, rows, repeated, cut })
    }

    /// The rows to read: all but a last one whose last number is cut.
    fn kept(&self) -> u64 {
        self.rows - u64::from(self.cut.as_ref().is_some_and(|c| c.short))
    }

    fn notes(&self, path: &Path, names: &[String]) -> Vec<String> {
        let mut notes = vec![];
        let file = path.display();
        let (repeated, line) = self.repeated;
        if repeated > 0 {
            let rows = if repeated == 1 { "a row repeats".to_owned() } else { format!("{repeated} rows repeat") };
            notes.push(format!("{file}: {rows} the header (first in line {line} of the file); left out"));
        }
        if let (Some(cut), Some(column)) = (&self.cut, names.last()) {
            let (value, line) = (&cut.value, cut.line);
            let ends = format!("{file}: the file does not end with a newline, so it may be cut short");
            notes.push(if cut.short {
                format!(
                    "{ends}; the last value `{value}` of `{column}` (line {line} of the file) is shorter than all \
                     others of its column, and its row is left out"
                )
            } else {
                format!("{ends} inside the last value `{value}` of `{column}` (line {line} of the file)")
            });
        }
        notes
    }
}

fn record_text(record: &ByteRecord) -> String {
    record.iter().next_back().map(|cell| String::from_utf8_lossy(cell).into_owned()).unwrap_or_default()
}

/// Whether the last byte of a text ends a line.
pub(super) fn ends_with_newline(path: &Path) -> std::io::Result<bool> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::End(-1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    Ok(matches!(last, [b'\n' | b'\r']))
}

/// The type that the contract or the options give a column; `None` leaves it to the values.
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

/// The rows of the file.
struct Rows {
    path: PathBuf,
    names: Vec<String>,
    kinds: Vec<Kind>,
    missing: Missing,
    reader: csv::Reader<File>,
    /// Rows read, and those to read.
    row: u64,
    keep: u64,
}

impl Rows {
    fn empty(&self) -> Vec<Values> {
        let one = |kind: &Kind| match kind {
            Kind::Number => Values::Number(vec![]),
            Kind::Whole => Values::Whole(vec![]),
            Kind::Text | Kind::Key => Values::Text(vec![]),
        };
        self.kinds.iter().map(one).collect()
    }

    fn table(&self, columns: &mut Vec<Values>) -> Result<Table, ReadError> {
        let mut table = Table::default();
        for (name, values) in self.names.iter().zip(columns.drain(..)) {
            table.push(name, "", values);
        }
        Ok(table)
    }

    /// Up to a batch of rows.
    fn part(&mut self) -> Result<Option<Part>, ReadError> {
        let mut columns = self.empty();
        let (mut faults, mut taken) = (vec![], 0);
        let mut record = ByteRecord::new();
        while taken < BATCH_ROWS
            && self.row < self.keep
            && self.reader.read_byte_record(&mut record).map_err(|e| broken(&self.path, &e))?
        {
            if repeats(&record, &self.names) {
                continue;
            }
            if let Err(fault) = self.take(&record, &mut columns)? {
                faults.push(RowFault { row: taken, fault });
            }
            taken += 1;
            self.row += 1;
        }
        if taken == 0 {
            return Ok(None);
        }
        let batch = self.table(&mut columns)?.into_batch(&self.path)?;
        Ok(Some(Part { batch, faults }))
    }

    /// Appends one row to the columns, and says what is wrong with it.
    fn take(&self, record: &ByteRecord, columns: &mut [Values]) -> Result<Result<(), ReadError>, ReadError> {
        let whole = record.len() == self.names.len();
        let mut wrong = None;
        for (i, (column, kind)) in columns.iter_mut().zip(&self.kinds).enumerate() {
            let text = if whole { std::str::from_utf8(&record[i]) } else { Ok("") };
            let read = match (column, &text) {
                (Values::Number(out), text) => {
                    let number = text.as_ref().ok().and_then(|t| self.missing.number(t));
                    out.push(number.unwrap_or(f64::NAN));
                    number.is_some()
                }
                (Values::Whole(out), text) => {
                    let number = text.as_ref().ok().and_then(|t| self.missing.whole(t));
                    out.push(number.unwrap_or(None));
                    number.is_some()
                }
                (Values::Text(out), _) if !whole && *kind == Kind::Key => {
                    out.push(out.last().cloned().unwrap_or_default());
                    true
                }
                (Values::Text(out), text) => {
                    out.push(text.as_ref().map_or(String::new(), |t| (*t).to_owned()));
                    text.is_ok()
                }
            };
            if !read && wrong.is_none() {
                wrong = Some(i);
            }
        }
        if !whole {
            return Ok(Err(self.ragged(record)));
        }
        let Some(column) = wrong else { return Ok(Ok(())) };
        if self.is_other_header(record) {
            let what = "the row looks like another header: the file is several tables, one after another";
            let fault = ReadError::data(&self.path, what).in_row(self.row);
            return Err(fault.help(format!("line {} of the file; put each table into a file", line_of(record))));
        }
        Ok(Err(self.no_number(record, column)))
    }

    /// Whether no number of the row is one, nor a missing value.
    fn is_other_header(&self, record: &ByteRecord) -> bool {
        let numbers = self.kinds.iter().zip(record).filter(|(kind, _)| matches!(kind, Kind::Number | Kind::Whole));
        let words = numbers.clone().filter(|(_, cell)| {
            std::str::from_utf8(cell).is_ok_and(|t| !missing::is_usual_word(t) && self.missing.number(t).is_none())
        });
        let count = words.count();
        count > 1 && count == numbers.count()
    }

    fn ragged(&self, record: &ByteRecord) -> ReadError {
        let what = format!("the row has {} values where the header has {}", record.len(), self.names.len());
        let cut = self.row + 1 == self.keep && !ends_with_newline(&self.path).unwrap_or(true);
        let cut = if cut { ", where the file ends without a newline: it is cut short" } else { "" };
        ReadError::data(&self.path, what).in_row(self.row).help(format!("line {} of the file{cut}", line_of(record)))
    }

    fn no_number(&self, record: &ByteRecord, column: usize) -> ReadError {
        let (cell, name) = (record.get(column).unwrap_or_default(), &self.names[column]);
        let line = line_of(record);
        let (what, help) = match std::str::from_utf8(cell) {
            Ok(text) if self.kinds[column] == Kind::Whole && self.missing.number(text).is_some() => {
                (format!("`{text}` is not a whole number"), format!("line {line} of the file"))
            }
            Ok(text) => {
                let help = format!("line {line} of the file; a word for missing values goes into `missing`");
                (format!("`{text}` is not a number"), help)
            }
            Err(error) => (format!("is not UTF-8 text: {error}"), format!("line {line} of the file")),
        };
        ReadError::data(&self.path, what).in_column(name).in_row(self.row).help(help)
    }
}

/// A number; an empty cell and the usual words are missing values.
pub(super) fn number(text: &str) -> Option<f64> {
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

//! Comma-separated text with a header row. The file is read twice: once to settle the type of each
//! column, once for the values, so that memory does not grow with it.

use std::{fs::File, path::Path};

use schemas::{Role, flight};

use super::{FlightFormat, FlightOptions, Head, Raw};
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
}

fn open(path: &Path, options: &FlightOptions) -> Result<Raw, ReadError> {
    let names = header(path)?;
    let kinds = kinds(path, &names, options)?;
    let schema = table(&names, &kinds, vec![vec![]; names.len()], path, 0)?.schema();
    let mut reader = reader(path)?;
    let (path, mut row, mut done) = (path.to_path_buf(), 0, false);
    let batches = std::iter::from_fn(move || {
        if done {
            return None;
        }
        let first = row;
        let columns = match next_rows(&mut reader, names.len(), &path, &mut row) {
            Ok(columns) => columns,
            Err(error) => {
                done = true;
                return Some(Err(error));
            }
        };
        if row == first {
            return None;
        }
        let batch = table(&names, &kinds, columns, &path, first).and_then(|t| t.into_batch(&path));
        done = batch.is_err();
        Some(batch)
    });
    Ok(Raw { schema, batches: Box::new(batches) })
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
    Ok(csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(file))
}

/// Up to a batch of rows, column by column, as text.
fn next_rows(
    reader: &mut csv::Reader<File>,
    width: usize,
    path: &Path,
    row: &mut u64,
) -> Result<Vec<Vec<String>>, ReadError> {
    let mut columns = vec![vec![]; width];
    let mut record = csv::StringRecord::new();
    for _ in 0..BATCH_ROWS {
        if !reader.read_record(&mut record).map_err(|e| broken(path, &e))? {
            break;
        }
        for (column, value) in columns.iter_mut().zip(&record) {
            column.push(value.to_owned());
        }
        *row += 1;
    }
    Ok(columns)
}

/// The type of each column over the whole file: as the contract says, else numbers if all values are.
fn kinds(path: &Path, names: &[String], options: &FlightOptions) -> Result<Vec<Kind>, ReadError> {
    let settled: Vec<Option<Kind>> = names.iter().map(|n| contract_kind(options.rename.get(n).unwrap_or(n))).collect();
    let mut kinds: Vec<Kind> = settled.iter().map(|k| k.unwrap_or(Kind::Number)).collect();
    let mut reader = reader(path)?;
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).map_err(|e| broken(path, &e))? {
        for ((kind, settled), value) in kinds.iter_mut().zip(&settled).zip(&record) {
            if settled.is_none() && number(value).is_none() {
                *kind = Kind::Text;
            }
        }
    }
    Ok(kinds)
}

/// The type that the contract gives a column; `None` leaves it to the values.
fn contract_kind(name: &str) -> Option<Kind> {
    let known = flight::describe(name);
    match name {
        "flight" | "line" => Some(Kind::Text),
        "year" | "doy" => Some(Kind::Whole),
        _ => (known.role != Role::Aux || !known.unit.is_empty()).then_some(Kind::Number),
    }
}

fn table(
    names: &[String],
    kinds: &[Kind],
    columns: Vec<Vec<String>>,
    path: &Path,
    first: u64,
) -> Result<Table, ReadError> {
    let mut table = Table::default();
    for ((name, kind), column) in names.iter().zip(kinds).zip(columns) {
        let values = match kind {
            Kind::Text => Values::Text(column),
            Kind::Number => Values::Number(parsed(path, name, &column, first, number)?),
            Kind::Whole => Values::Whole(parsed(path, name, &column, first, whole)?),
        };
        table.push(name, "", values);
    }
    Ok(table)
}

/// The values of a column, or an error that names the first that is none.
fn parsed<T>(
    path: &Path,
    name: &str,
    column: &[String],
    first: u64,
    parse: fn(&str) -> Option<T>,
) -> Result<Vec<T>, ReadError> {
    let one = |(i, text): (usize, &String)| {
        parse(text).ok_or_else(|| {
            ReadError::data(path, format!("`{text}` is not a number")).in_column(name).in_row(first + i as u64)
        })
    };
    column.iter().enumerate().map(one).collect()
}

/// A number; empty, `NaN` and `*` are missing.
pub(super) fn number(text: &str) -> Option<f64> {
    if is_missing(text) { Some(f64::NAN) } else { text.parse().ok() }
}

fn whole(text: &str) -> Option<Option<i64>> {
    let x = number(text)?;
    if x.is_nan() {
        return Some(None);
    }
    (x.fract() == 0.0 && x.abs() < 9e15).then_some(Some(x as i64))
}

fn is_missing(text: &str) -> bool {
    text.is_empty() || text == "*" || text.eq_ignore_ascii_case("nan") || text.eq_ignore_ascii_case("null")
}

/// An error of the CSV layer, with the row it is in.
pub(super) fn broken(path: &Path, error: &csv::Error) -> ReadError {
    match error.kind() {
        csv::ErrorKind::Io(e) => ReadError::io(path, e),
        csv::ErrorKind::UnequalLengths { pos, expected_len, len } => {
            let fault = ReadError::data(path, format!("the row has {len} values where the header has {expected_len}"));
            match pos {
                // Record 0 is the header.
                Some(pos) => {
                    fault.in_row(pos.record().saturating_sub(1)).help(format!("line {} of the file", pos.line()))
                }
                None => fault,
            }
        }
        csv::ErrorKind::Utf8 { pos, err } => {
            let fault = ReadError::data(path, format!("is not UTF-8 text: {err}"));
            pos.as_ref().map_or(fault.clone(), |p| fault.in_row(p.record().saturating_sub(1)))
        }
        _ => ReadError::data(path, error.to_string()),
    }
}

//! Geosoft's XYZ exports. Comments follow `/`; the last of them before the data names the columns. A record such as
//! `Line 10` or `Tie T5` precedes the rows of each line, and `//Flight` and `//Date` precede the rows that they apply
//! to. `*` is a missing value. [Seequent, Oasis montaj, Geosoft XYZ file format]
//!
//! Columns keep the file's names; records become `line`, `flight`, `year` and `doy`. The file is read twice: once to
//! find the columns of numbers, once for the values.

use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use arrow_schema::SchemaRef;
use numerics::earth::dates::day_of_year;

use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, RawFlight, ReadHints, RowFault, csv,
    line_records::{GeosoftLineNames, GeosoftLineRecord, LineRecordMatch, read, unknown},
    missing::MissingMarkers,
    text_end::{TextFile, is_whole},
};
use crate::{
    ReadError,
    table::{ColumnTable, ColumnValues},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "geosoft_xyz",
    about: "XYZ export of Geosoft, with a record such as `Line 10` before the rows of each line",
    extensions: &[],
    recognise: |head: &FileHead| {
        let mut kinds = head.text_lines().map(|line| kind(&line, None));
        let first = kinds.next();
        match first {
            Some(GeosoftTextLine::Record(_) | GeosoftTextLine::Flight(_) | GeosoftTextLine::Date(_)) => true,
            // The comments are examined first: the SGL surveys have no line records.
            Some(GeosoftTextLine::Comment(_)) => kinds.any(|k| matches!(k, GeosoftTextLine::Record(_))),
            _ => false,
        }
    },
    open,
    topics: None,
    made_from: None,
};

/// Rows of a batch.
const ROWS: usize = 65_536;

/// A line of text.
#[derive(Debug, PartialEq)]
enum GeosoftTextLine {
    Blank,
    Comment(Vec<String>),
    Flight(String),
    Date(String),
    Record(GeosoftLineRecord),
    /// Text that resembles a line record but is invalid.
    Unknown(Vec<String>),
    Row(Vec<String>),
}

/// The kind of a line of text; `width` is the number of values in a row, where that is known.
fn kind(text: &str, width: Option<usize>) -> GeosoftTextLine {
    let text = text.trim().trim_start_matches('\u{feff}');
    if text.is_empty() {
        return GeosoftTextLine::Blank;
    }
    let stated = |word: &str| {
        let (head, rest) = text.strip_prefix("//")?.trim().split_once(char::is_whitespace)?;
        head.eq_ignore_ascii_case(word).then(|| rest.trim().to_owned())
    };
    if let Some(flight) = stated("flight") {
        return GeosoftTextLine::Flight(flight);
    }
    if let Some(date) = stated("date") {
        return GeosoftTextLine::Date(date);
    }
    let words = words(text.trim_start_matches('/'));
    if text.starts_with('/') {
        return GeosoftTextLine::Comment(words);
    }
    match read(&words, width) {
        LineRecordMatch::Record(record) => GeosoftTextLine::Record(record),
        LineRecordMatch::Unknown => GeosoftTextLine::Unknown(words),
        LineRecordMatch::No => GeosoftTextLine::Row(words),
    }
}

/// The words of a line, separated by commas or tabs if there are any, otherwise by blanks. Text in double quotes is one
/// word.
fn words(text: &str) -> Vec<String> {
    // If the number of quote characters is odd, they are part of words.
    let quotes = text.matches('"').count();
    if quotes > 0 && quotes.is_multiple_of(2) {
        return quoted_words(text);
    }
    let own = |w: &str| w.trim().trim_matches('"').to_owned();
    match [',', '\t'].into_iter().find(|s| text.contains(*s)) {
        Some(separator) => text.split(separator).map(own).collect(),
        None => text.split_whitespace().map(own).collect(),
    }
}

/// Same as [`words`], for a line with double quotes.
fn quoted_words(text: &str) -> Vec<String> {
    let parts: Vec<(bool, &str)> = text.split('"').enumerate().map(|(i, part)| (i % 2 == 0, part)).collect();
    let is_outside = |separator: &char| parts.iter().any(|(outside, part)| *outside && part.contains(*separator));
    let separator = [',', '\t'].into_iter().find(is_outside);
    let (mut words, mut word, mut begun) = (vec![], String::new(), false);
    for (outside, part) in parts {
        if !outside {
            word += part;
            begun = true;
            continue;
        }
        for c in part.chars() {
            let ends = separator.map_or(c.is_whitespace(), |separator| c == separator);
            if !ends {
                word.push(c);
            } else if separator.is_some() || begun || !word.is_empty() {
                words.push(std::mem::take(&mut word).trim().to_owned());
                begun = false;
            }
        }
    }
    if separator.is_some() || begun || !word.is_empty() {
        words.push(word.trim().to_owned());
    }
    words
}

/// Result of the first pass.
#[derive(Default)]
struct GeosoftScan {
    names: Vec<String>,
    /// Whether each column holds numbers.
    numbers: Vec<bool>,
    flights: bool,
    /// The line records.
    lines: GeosoftLineNames,
    /// Invalid line records: the first one with its position in the file, and their number.
    unknown: Option<(u64, Vec<String>, usize)>,
    dates: bool,
    /// A date that cannot be read.
    unread: Option<String>,
}

fn lines(path: &Path) -> Result<impl Iterator<Item = Result<String, ReadError>> + Send + 'static, ReadError> {
    let mut input = BufReader::with_capacity(1 << 20, TextFile::open(path)?);
    let path = path.to_path_buf();
    Ok(std::iter::from_fn(move || {
        let mut bytes = vec![];
        match input.read_until(b'\n', &mut bytes) {
            Ok(0) => None,
            Ok(_) => Some(Ok(String::from_utf8_lossy(&bytes).into_owned())),
            Err(error) => Some(Err(ReadError::io(&path, &error))),
        }
    }))
}

fn scan(path: &Path, missing: &MissingMarkers) -> Result<GeosoftScan, ReadError> {
    let (mut found, mut comments) = (GeosoftScan::default(), vec![]);
    // Text lines of one word and one number, which are unknown line records if the file has other rows.
    let mut pairs = vec![];
    for (at, line) in (1..).zip(lines(path)?) {
        let width = Some(found.numbers.len()).filter(|width| *width > 0);
        match kind(&line?, width) {
            GeosoftTextLine::Blank => {}
            GeosoftTextLine::Comment(words) if found.numbers.is_empty() => comments.push(words),
            GeosoftTextLine::Comment(_) => {}
            GeosoftTextLine::Flight(_) => found.flights = true,
            GeosoftTextLine::Date(text) => match date(&text) {
                Some(_) => found.dates = true,
                None => found.unread = Some(text),
            },
            GeosoftTextLine::Record(record) => found.lines.add(&record),
            GeosoftTextLine::Unknown(words) => found.add_unknown(at, words),
            GeosoftTextLine::Row(words) if width.is_none() && looks_unknown(&words) => {
                numbers(&mut pairs, &words, missing);
                found.add_unknown(at, words);
            }
            GeosoftTextLine::Row(words) => numbers(&mut found.numbers, &words, missing),
        }
    }
    if found.numbers.is_empty() {
        (found.numbers, found.unknown) = (pairs, None);
    }
    if !found.has_numbers_first() {
        found.unknown = None;
    }
    let width = found.numbers.len();
    if width == 0 {
        return Err(ReadError::data(path, "has no rows"));
    }
    // A comment line that underlines the names has the same number of words as the line of names, but no letters.
    let names = |words: &&Vec<String>| {
        let letters = |w: &String| w.chars().any(char::is_alphabetic) && csv::number(w).is_none();
        words.len() == width && words.iter().all(letters)
    };
    let header = comments.iter().rev().find(names);
    found.names = header.cloned().unwrap_or_else(|| (1..=width).map(|i| format!("column_{i}")).collect());
    for (i, name) in found.names.iter().enumerate() {
        if found.names.iter().take(i).any(|n| n == name) {
            return Err(ReadError::data(path, "the header names the column twice").in_column(name));
        }
    }
    Ok(found)
}

/// Whether the words would be an unknown line record in a table of three columns.
fn looks_unknown(words: &[String]) -> bool {
    words.len() == 2 && read(words, Some(3)) == LineRecordMatch::Unknown
}

/// Clears the flag of each column whose value in this row is neither a number nor missing.
fn numbers(columns: &mut Vec<bool>, words: &[String], missing: &MissingMarkers) {
    if columns.is_empty() {
        *columns = vec![true; words.len()];
    }
    if words.len() == columns.len() {
        let one = |(is, word): (&mut bool, &String)| *is = *is && missing.number(word).is_some();
        columns.iter_mut().zip(words).for_each(one);
    }
}

impl GeosoftScan {
    fn has_lines(&self) -> bool {
        !self.lines.is_empty() || self.unknown.is_some()
    }

    /// Whether rows begin with a number. A line of text that begins with a word is then not a row.
    fn has_numbers_first(&self) -> bool {
        self.numbers.first() == Some(&true)
    }

    fn add_unknown(&mut self, at: u64, words: Vec<String>) {
        match &mut self.unknown {
            Some((.., n)) => *n += 1,
            none => *none = Some((at, words, 1)),
        }
    }

    /// Note on invalid line records.
    fn unknown_note(&self) -> Option<String> {
        let (at, words, n) = self.unknown.as_ref()?;
        let more = if *n > 1 { format!("; {n} such lines") } else { String::new() };
        Some(format!("line {at}: {}; the rows below form a line that cannot be used{more}", unknown(words)))
    }
}

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let missing = MissingMarkers::from_options(options);
    let found = scan(path, &missing)?;
    let file = path.display();
    let mut notes = vec![];
    if found.names.first().is_some_and(|n| n == "column_1") {
        notes.push(format!(
            "{file}: no comment names the {} columns, so they are named column_1, column_2 ...",
            found.names.len()
        ));
    }
    notes
        .extend([found.lines.note(), found.unknown_note()].into_iter().flatten().map(|note| format!("{file}: {note}")));
    if let Some(text) = &found.unread {
        notes
            .push(format!("{file}: the date `{text}` cannot be read (valid: 2020/06/29); the rows below have no date"));
    }
    if is_whole(path).is_ok_and(|ends| !ends) {
        notes.push(format!(
            "{file}: the file does not end with a newline, so it may be cut short inside its last value"
        ));
    }
    let empty = GeosoftBatch::new(found.names.len());
    let schema = empty.table(&found).schema();
    let line_types = found.lines.types();
    let rows = GeosoftBatchReader {
        path: path.to_path_buf(),
        lines: Box::new(lines(path)?),
        found,
        missing,
        now: GeosoftRowContext::default(),
        unknown: None,
        row: 0,
        text_line: 0,
        done: false,
        schema: schema.clone(),
    };
    Ok(RawFlight { notes, line_types, ..RawFlight::new(schema, Box::new(rows)) })
}

/// Flight, line and date in force for a row, from the records before it.
#[derive(Clone, Default)]
struct GeosoftRowContext {
    flight: String,
    line: String,
    date: Option<(i32, u32)>,
}

/// Rows of one batch, with their values by column and their faults.
struct GeosoftBatch {
    rows: Vec<GeosoftRowContext>,
    numbers: Vec<Vec<f64>>,
    words: Vec<Vec<String>>,
    faults: Vec<RowFault>,
}

impl GeosoftBatch {
    fn new(width: usize) -> GeosoftBatch {
        GeosoftBatch { rows: vec![], numbers: vec![vec![]; width], words: vec![vec![]; width], faults: vec![] }
    }

    fn table(self, found: &GeosoftScan) -> ColumnTable {
        let mut table = ColumnTable::default();
        let text = |of: fn(&GeosoftRowContext) -> &String| {
            ColumnValues::Text(self.rows.iter().map(|now| of(now).clone()).collect())
        };
        let has = |name: &str| found.names.iter().any(|n| n == name);
        if found.flights && !has("flight") {
            table.push("flight", "", text(|now| &now.flight));
        }
        if found.has_lines() && !has("line") {
            table.push("line", "", text(|now| &now.line));
        }
        if found.dates && !has("year") && !has("doy") {
            let of = |pick: fn((i32, u32)) -> i64| {
                ColumnValues::Whole(self.rows.iter().map(|now| now.date.map(pick)).collect())
            };
            table.push("year", "", of(|(year, _)| i64::from(year)));
            table.push("doy", "", of(|(_, day)| i64::from(day)));
        }
        let columns = found.names.iter().zip(&found.numbers).zip(self.numbers.into_iter().zip(self.words));
        for ((name, number), (numbers, words)) in columns {
            table.push(name, "", if *number { ColumnValues::Number(numbers) } else { ColumnValues::Text(words) });
        }
        table
    }
}

struct GeosoftBatchReader {
    path: PathBuf,
    lines: Box<dyn Iterator<Item = Result<String, ReadError>> + Send>,
    found: GeosoftScan,
    missing: MissingMarkers,
    now: GeosoftRowContext,
    /// The fault of an unknown line record, for the first row after it.
    unknown: Option<ReadError>,
    row: u64,
    text_line: u64,
    done: bool,
    schema: SchemaRef,
}

impl Iterator for GeosoftBatchReader {
    type Item = Result<FlightBatch, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let width = self.found.names.len();
        let mut gathered = GeosoftBatch::new(width);
        while !self.done && gathered.rows.len() < ROWS {
            match self.lines.next() {
                Some(Ok(line)) => {
                    self.text_line += 1;
                    match kind(&line, Some(width)) {
                        GeosoftTextLine::Blank | GeosoftTextLine::Comment(_) => {}
                        GeosoftTextLine::Flight(flight) => self.now.flight = flight,
                        GeosoftTextLine::Date(text) => self.now.date = date(&text),
                        GeosoftTextLine::Record(record) => {
                            (self.now.line, self.unknown) = (self.found.lines.name(&record), None);
                        }
                        GeosoftTextLine::Unknown(words) if self.found.has_numbers_first() => self.begin_unknown(&words),
                        GeosoftTextLine::Unknown(words) => self.gather(&words, &mut gathered),
                        GeosoftTextLine::Row(words) => self.gather(&words, &mut gathered),
                    }
                }
                Some(Err(error)) => {
                    self.done = true;
                    return Some(Err(error));
                }
                None => self.done = true,
            }
        }
        if gathered.rows.is_empty() {
            return None;
        }
        let faults = std::mem::take(&mut gathered.faults);
        let batch = gathered.table(&self.found).into_batch(&self.path);
        debug_assert!(batch.as_ref().is_ok_and(|b| b.schema() == self.schema));
        Some(batch.map(|batch| FlightBatch { batch, faults }))
    }
}

impl GeosoftBatchReader {
    /// Begins a line for an unknown line record, so that the rows after it are not added to another line.
    fn begin_unknown(&mut self, words: &[String]) {
        self.now.line = words.join(" ");
        let fault = ReadError::data(&self.path, unknown(words)).in_row(self.row);
        self.unknown = Some(fault.help(format!("line {} of the file", self.text_line)));
    }

    fn gather(&mut self, words: &[String], to: &mut GeosoftBatch) {
        let width = self.found.names.len();
        let whole = words.len() == width;
        if let Some(fault) = self.unknown.take() {
            to.faults.push(RowFault { row: to.rows.len(), fault });
        }
        if !whole {
            let what = format!("the row has {} values, but the others have {width}", words.len());
            let fault =
                ReadError::data(&self.path, what).in_row(self.row).help(format!("line {} of the file", self.text_line));
            to.faults.push(RowFault { row: to.rows.len(), fault });
        }
        let word = |i: usize| words.get(i).filter(|_| whole).map_or("", String::as_str);
        let columns = self.found.numbers.iter().zip(to.numbers.iter_mut().zip(&mut to.words));
        for (i, (number, (numbers, texts))) in columns.enumerate() {
            if *number {
                numbers.push(self.missing.number(word(i)).unwrap_or(f64::NAN));
            } else {
                texts.push(word(i).to_owned());
            }
        }
        to.rows.push(self.now.clone());
        self.row += 1;
    }
}

/// Year and day of the year of `2020/06/29`, `2020-06-29` or `20200629`.
fn date(text: &str) -> Option<(i32, u32)> {
    let words: Vec<&str> = match text.trim() {
        plain if plain.len() == 8 && plain.bytes().all(|b| b.is_ascii_digit()) => {
            vec![plain.get(..4)?, plain.get(4..6)?, plain.get(6..)?]
        }
        text => text.split(['/', '-']).collect(),
    };
    let [year, month, day] = words.as_slice() else { return None };
    let year = Some(*year).filter(|y| y.len() == 4)?.parse().ok()?;
    Some((year, day_of_year(year, month.parse().ok()?, day.parse().ok()?).ok()?))
}

#[cfg(test)]
mod tests;

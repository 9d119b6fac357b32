//! The ASCII `.xyz` files of the SGL surveys: comment lines start with `/`; the last comment before the data names the
//! columns; blanks separate values; `*` is a missing value. One line of the survey at a time is in memory.

use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, RawFlight, ReadHints, RowFault,
    adopt::{FlightColumnTarget, in_counted_unit, named},
    decimal,
    missing::MissingMarkers,
    sgl,
    text_end::{TextFile, is_whole},
};
use crate::{
    ReadError,
    table::{ColumnTable, ColumnValues},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "sgl_xyz",
    about: "ASCII export of the SGL surveys, blank-separated, header after `/`",
    extensions: &["xyz"],
    recognise: |head: &FileHead| head.first_line().is_some_and(|l| l.starts_with('/')),
    open,
    topics: None,
    made_from: None,
};

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let mut rows = SglXyzReader::open(path, options)?;
    rows.advance()?;
    let Some(first) = &rows.pending else {
        return Err(ReadError::data(path, "has a header and no rows"));
    };
    let value = |name: &str| {
        let at = rows.columns.iter().position(|c| c.meant == name)?;
        rows.missing.number(first.word(at)?)
    };
    let ins_angle = sgl::ins_angle(value("lat"), value("ins_lat"));
    rows.name(ins_angle, options)?;
    let own = rows.columns.iter().flat_map(|c| [c.header.clone(), c.meant.clone()]).collect();
    let empty = rows.table(SglLineBatch::new(rows.columns.len()))?;
    let schema = sgl::finish(path, empty)?.0.schema();
    let notes = match is_whole(path) {
        Ok(false) => {
            let file = path.display();
            vec![format!("{file}: the file does not end with a newline, so it may be cut short inside its last value")]
        }
        _ => vec![],
    };
    let (path, mut done) = (path.to_path_buf(), false);
    let parts = std::iter::from_fn(move || {
        if done {
            return None;
        }
        let part = rows.line().transpose()?.and_then(|(table, mut faults)| {
            let (table, more) = sgl::finish(&path, table)?;
            faults.extend(more);
            faults.sort_by_key(|f| f.row);
            Ok(FlightBatch { batch: table.into_batch(&path)?, faults })
        });
        done = part.is_err();
        Some(part)
    });
    Ok(RawFlight { own: Some(own), notes, ..RawFlight::new(schema, Box::new(parts)) })
}

/// A column of the file.
struct SglXyzColumn {
    /// Name in the header.
    header: String,
    /// Meaning in the surveys.
    meant: String,
    named: FlightColumnTarget,
}

/// A row of text.
#[derive(Default)]
struct SglXyzRow {
    text: String,
    /// Start and end of each word in `text`.
    words: Vec<(usize, usize)>,
    /// Line number in the file, from 1.
    text_line: u64,
}

impl SglXyzRow {
    fn word(&self, i: usize) -> Option<&str> {
        self.words.get(i).and_then(|(start, end)| self.text.get(*start..*end))
    }

    /// Finds the words of the text, which is not empty.
    fn split(&mut self) {
        self.words.clear();
        if self.text.is_ascii() {
            let mut start = None;
            for (at, byte) in self.text.bytes().chain([b' ']).enumerate() {
                match (start, matches!(byte, b' ' | b'\t'..=b'\r')) {
                    (None, false) => start = Some(at),
                    (Some(begun), true) => {
                        self.words.push((begun, at));
                        start = None;
                    }
                    _ => {}
                }
            }
            return;
        }
        let begins = |word: &str| word.as_ptr() as usize - self.text.as_ptr() as usize;
        self.words.extend(self.text.split_whitespace().map(|w| (begins(w), begins(w) + w.len())));
    }
}

/// The rows of one line of the survey, by column.
struct SglLineBatch {
    rows: usize,
    /// The values of each column; empty for flight and line.
    numbers: Vec<Vec<f64>>,
    /// Flight and line, as spelt in the file.
    key: Option<Vec<String>>,
    faults: Vec<RowFault>,
}

impl SglLineBatch {
    fn new(columns: usize) -> SglLineBatch {
        SglLineBatch { rows: 0, numbers: vec![vec![]; columns], key: None, faults: vec![] }
    }
}

/// Reader of the rows of a file, which reads one row ahead.
struct SglXyzReader {
    path: PathBuf,
    input: BufReader<TextFile>,
    columns: Vec<SglXyzColumn>,
    missing: MissingMarkers,
    ins_angle: &'static str,
    /// Positions of the columns `flight` and `line`, if they exist.
    keys: Vec<usize>,
    pending: Option<SglXyzRow>,
    /// The previous row, whose buffer is reused.
    spare: SglXyzRow,
    /// Number of rows and number of lines of text that have been read.
    row: u64,
    text_line: u64,
}

impl SglXyzReader {
    /// Opens the file and reads up to the header.
    fn open(path: &Path, options: &FlightOptions) -> Result<SglXyzReader, ReadError> {
        let input = BufReader::with_capacity(1 << 20, TextFile::open(path)?);
        let (columns, pending, missing) = (vec![], None, MissingMarkers::from_options(options));
        let (path_buf, keys, spare) = (path.to_path_buf(), vec![], SglXyzRow::default());
        let ins_angle = "rad";
        let mut rows = SglXyzReader {
            path: path_buf,
            input,
            columns,
            missing,
            ins_angle,
            keys,
            pending,
            spare,
            row: 0,
            text_line: 0,
        };
        let mut header = None;
        while rows.input.fill_buf().map_err(|e| ReadError::io(path, &e))?.first() == Some(&b'/') {
            let Some(line) = rows.text(String::new())? else { break };
            let words: Vec<String> = line.trim_start_matches('/').split_whitespace().map(str::to_owned).collect();
            if words.len() > 1 {
                header = Some(words);
            }
        }
        let header =
            header.ok_or_else(|| ReadError::data(path, "the file lacks a header line that begins with `/`"))?;
        let column = |header: String| {
            let meant = sgl::name_of_header(&header);
            SglXyzColumn { header, named: FlightColumnTarget { name: meant.clone(), unit: String::new() }, meant }
        };
        rows.columns = header.into_iter().map(column).collect();
        for (i, column) in rows.columns.iter().enumerate() {
            if rows.columns.iter().take(i).any(|c| c.meant == column.meant) {
                return Err(ReadError::data(path, "the header names the column twice").in_column(&column.meant));
            }
        }
        Ok(rows)
    }

    /// Sets the names and units of the columns from the options.
    fn name(&mut self, ins_angle: &'static str, options: &FlightOptions) -> Result<(), ReadError> {
        self.ins_angle = ins_angle;
        for column in &mut self.columns {
            let declared = Some(sgl::unit_of(&column.meant, ins_angle));
            column.named = named(&self.path, &[&column.header, &column.meant], declared, options)?;
        }
        for (i, column) in self.columns.iter().enumerate() {
            let name = &column.named.name;
            if self.columns.iter().take(i).any(|c| c.named.name == *name) {
                return Err(ReadError::options(&self.path, "two columns would have this name").in_column(name));
            }
        }
        let at = |key: &str| self.columns.iter().position(|c| c.named.name == key);
        self.keys = ["flight", "line"].into_iter().filter_map(at).collect();
        Ok(())
    }

    /// The next line of text, in the buffer `room`.
    fn text(&mut self, room: String) -> Result<Option<String>, ReadError> {
        let mut bytes = room.into_bytes();
        bytes.clear();
        let read = self.input.read_until(b'\n', &mut bytes).map_err(|e| ReadError::io(&self.path, &e))?;
        self.text_line += 1;
        let at = self.text_line;
        match String::from_utf8(bytes) {
            Ok(text) if read > 0 => Ok(Some(text)),
            Ok(_) => Ok(None),
            Err(_) => Err(ReadError::data(&self.path, format!("line {at} of the file is not text"))),
        }
    }

    /// Reads the next row of data, if any, into `pending`.
    fn advance(&mut self) -> Result<(), ReadError> {
        self.pending = None;
        let mut row = std::mem::take(&mut self.spare);
        while let Some(text) = self.text(row.text)? {
            row.text = text;
            row.split();
            if row.words.is_empty() || row.text.starts_with('/') {
                continue;
            }
            self.row += 1;
            row.text_line = self.text_line;
            self.pending = Some(row);
            break;
        }
        Ok(())
    }

    /// Flight and line of the next row: they change where a line of the survey begins. `None` for a row with a wrong
    /// number of values, which belongs to the line before it.
    fn key(&self) -> Option<impl Iterator<Item = &str>> {
        let row = self.pending.as_ref().filter(|r| r.words.len() == self.columns.len())?;
        Some(self.keys.iter().filter_map(|i| row.word(*i)))
    }

    /// All rows of the next line of the survey.
    fn line(&mut self) -> Result<Option<(ColumnTable, Vec<RowFault>)>, ReadError> {
        let first = self.row.saturating_sub(1);
        let mut gathered = SglLineBatch::new(self.columns.len());
        while self.pending.is_some() {
            if let Some(next) = self.key() {
                match &gathered.key {
                    Some(key) => {
                        if !next.eq(key.iter()) {
                            break;
                        }
                    }
                    None => gathered.key = Some(next.map(str::to_owned).collect()),
                }
            }
            if let Some(row) = self.pending.take() {
                self.gather(&row, &mut gathered, first);
                self.spare = row;
            }
            self.advance()?;
        }
        if gathered.rows == 0 {
            return Ok(None);
        }
        let faults = std::mem::take(&mut gathered.faults);
        Ok(Some((self.table(gathered)?, faults)))
    }

    /// Adds the values of a row; `first` is the first row of the line.
    fn gather(&self, row: &SglXyzRow, to: &mut SglLineBatch, first: u64) {
        let width = self.columns.len();
        let whole = row.words.len() == width;
        let mut wrong = |fault: ReadError| {
            let fault = fault.in_row(first + to.rows as u64);
            to.faults.push(RowFault { row: to.rows, fault });
        };
        if !whole {
            let what = format!("the row has {} values, but the header has {width}", row.words.len());
            wrong(ReadError::data(&self.path, what).help(format!("line {} of the file", row.text_line)));
        }
        let text = row.text.as_bytes();
        for (i, numbers) in to.numbers.iter_mut().enumerate().filter(|(i, _)| !self.keys.contains(i)) {
            let Some((start, end)) = row.words.get(i).copied().filter(|_| whole) else {
                numbers.push(f64::NAN);
                continue;
            };
            let number = match decimal::number(text, start) {
                Some((x, after)) if after == end => Some(self.missing.kept(x)),
                _ => row.word(i).and_then(|word| self.missing.number(word)),
            };
            if let (None, Some(word), Some(column)) = (number, row.word(i), self.columns.get(i)) {
                let fault = ReadError::data(&self.path, format!("`{word}` is not a number")).in_column(&column.header);
                let help = "if the text marks a missing value, add it to `missing`";
                wrong(fault.help(format!("line {} of the file; {help}", row.text_line)));
            }
            numbers.push(number.unwrap_or(f64::NAN));
        }
        to.rows += 1;
    }

    /// The rows as a table; `flight` and `line` keep their spelling.
    fn table(&self, gathered: SglLineBatch) -> Result<ColumnTable, ReadError> {
        let mut table = ColumnTable::default();
        // The key is missing if no row of the line has the right number of values.
        let key = gathered.key.unwrap_or_default();
        for (i, (SglXyzColumn { header, named, .. }, numbers)) in self.columns.iter().zip(gathered.numbers).enumerate()
        {
            if let Some(k) = self.keys.iter().position(|at| *at == i) {
                let text = key.get(k).cloned().unwrap_or_default();
                table.push(&named.name, "", ColumnValues::Text(vec![text; gathered.rows]));
                continue;
            }
            let counted = sgl::unit_of(&named.name, self.ins_angle);
            let (unit, numbers) = in_counted_unit(&self.path, header, named, counted, numbers)?;
            table.push(&named.name, &unit, ColumnValues::Number(numbers));
        }
        Ok(table)
    }
}

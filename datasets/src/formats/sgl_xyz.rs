//! The ASCII `.xyz` files of the SGL surveys: comment lines start with `/`, the last of them before the
//! data names the columns, values stand between blanks, `*` is missing. One line of the survey at a time
//! is in memory.

use std::{
    fs::File,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use super::{
    FlightFormat, FlightOptions, Head, Part, Raw, RowFault,
    adopt::{Named, in_counted_unit, named},
    csv::ends_with_newline,
    missing::Missing,
    sgl,
};
use crate::{
    ReadError,
    table::{Table, Values},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "sgl_xyz",
    about: "ASCII export of the SGL surveys, blank-separated, header after `/`",
    extensions: &["xyz"],
    recognise: |head: &Head| head.first_line().is_some_and(|l| l.starts_with('/')),
    open,
};

fn open(path: &Path, options: &FlightOptions) -> Result<Raw, ReadError> {
    let mut rows = Rows::open(path, options)?;
    rows.advance()?;
    let Some(first) = &rows.pending else {
        return Err(ReadError::data(path, "holds a header and no rows"));
    };
    let value = |name: &str| {
        let at = rows.columns.iter().position(|c| c.meant == name)?;
        rows.missing.number(first.words.get(at)?)
    };
    let ins_angle = sgl::ins_angle(value("lat"), value("ins_lat"));
    rows.name(ins_angle, options)?;
    let own = rows.columns.iter().flat_map(|c| [c.header.clone(), c.meant.clone()]).collect();
    let empty = rows.table(&[])?.0;
    let schema = sgl::finish(path, empty)?.0.schema();
    let notes = match ends_with_newline(path) {
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
            Ok(Part { batch: table.into_batch(&path)?, faults })
        });
        done = part.is_err();
        Some(part)
    });
    Ok(Raw { own: Some(own), notes, ..Raw::new(schema, Box::new(parts)) })
}

/// A column of the file.
struct Column {
    /// As the header spells it.
    header: String,
    /// What the surveys mean by that.
    meant: String,
    named: Named,
}

/// A row of text.
struct Row {
    words: Vec<String>,
    /// Of the file, from 1.
    text_line: u64,
}

/// The rows of the file, one ahead.
struct Rows {
    path: PathBuf,
    input: BufReader<File>,
    columns: Vec<Column>,
    missing: Missing,
    ins_angle: &'static str,
    pending: Option<Row>,
    /// Rows taken so far, and lines of text.
    row: u64,
    text_line: u64,
}

impl Rows {
    /// Opens the file and reads up to the header.
    fn open(path: &Path, options: &FlightOptions) -> Result<Rows, ReadError> {
        let input = BufReader::new(File::open(path).map_err(|e| ReadError::io(path, &e))?);
        let (columns, pending, missing) = (vec![], None, Missing::of(options));
        let path_buf = path.to_path_buf();
        let mut rows =
            Rows { path: path_buf, input, columns, missing, ins_angle: "rad", pending, row: 0, text_line: 0 };
        let mut header = None;
        while rows.input.fill_buf().map_err(|e| ReadError::io(path, &e))?.first() == Some(&b'/') {
            let Some(line) = rows.text()? else { break };
            let words: Vec<String> = line.trim_start_matches('/').split_whitespace().map(str::to_owned).collect();
            if words.len() > 1 {
                header = Some(words);
            }
        }
        let header = header.ok_or_else(|| ReadError::data(path, "no line after `/` names the columns"))?;
        let column = |header: String| {
            let meant = sgl::name_of_header(&header);
            Column { header, named: Named { name: meant.clone(), unit: String::new() }, meant }
        };
        rows.columns = header.into_iter().map(column).collect();
        for (i, column) in rows.columns.iter().enumerate() {
            if rows.columns.iter().take(i).any(|c| c.meant == column.meant) {
                return Err(ReadError::data(path, "the header names the column twice").in_column(&column.meant));
            }
        }
        Ok(rows)
    }

    /// Gives the columns the names and units of the options.
    fn name(&mut self, ins_angle: &'static str, options: &FlightOptions) -> Result<(), ReadError> {
        self.ins_angle = ins_angle;
        for column in &mut self.columns {
            let said = Some(sgl::unit_of(&column.meant, ins_angle));
            column.named = named(&self.path, &[&column.header, &column.meant], said, options)?;
        }
        for (i, column) in self.columns.iter().enumerate() {
            let name = &column.named.name;
            if self.columns.iter().take(i).any(|c| c.named.name == *name) {
                return Err(ReadError::options(&self.path, "two columns would have this name").in_column(name));
            }
        }
        Ok(())
    }

    /// The next line of text.
    fn text(&mut self) -> Result<Option<String>, ReadError> {
        let mut bytes = vec![];
        let read = self.input.read_until(b'\n', &mut bytes).map_err(|e| ReadError::io(&self.path, &e))?;
        self.text_line += 1;
        let at = self.text_line;
        match String::from_utf8(bytes) {
            Ok(text) if read > 0 => Ok(Some(text)),
            Ok(_) => Ok(None),
            Err(_) => Err(ReadError::data(&self.path, format!("line {at} of the file is not text"))),
        }
    }

    /// Takes the next row of data, if there is one, into `pending`.
    fn advance(&mut self) -> Result<(), ReadError> {
        self.pending = None;
        while let Some(text) = self.text()? {
            if text.trim().is_empty() || text.starts_with('/') {
                continue;
            }
            let words = text.split_whitespace().map(str::to_owned).collect();
            self.row += 1;
            self.pending = Some(Row { words, text_line: self.text_line });
            break;
        }
        Ok(())
    }

    /// What tells one line of the survey from the next; a row that has not one value for each column belongs to the
    /// line before it.
    fn key(&self) -> Option<Vec<&str>> {
        let row = self.pending.as_ref().filter(|r| r.words.len() == self.columns.len())?;
        let at = |key: &str| self.columns.iter().position(|c| c.named.name == key);
        Some(
            ["flight", "line"]
                .into_iter()
                .filter_map(at)
                .filter_map(|i| row.words.get(i).map(String::as_str))
                .collect(),
        )
    }

    /// All rows of the next line of the survey.
    fn line(&mut self) -> Result<Option<(Table, Vec<RowFault>)>, ReadError> {
        let mut key: Option<Vec<String>> = None;
        let first = self.row.saturating_sub(1);
        let mut rows = vec![];
        while self.pending.is_some() {
            if let Some(next) = self.key() {
                match &key {
                    Some(key) if *key != next => break,
                    Some(_) => {}
                    None => key = Some(next.into_iter().map(str::to_owned).collect()),
                }
            }
            rows.extend(self.pending.take());
            self.advance()?;
        }
        if rows.is_empty() {
            return Ok(None);
        }
        let (table, mut faults) = self.table(&rows)?;
        for fault in &mut faults {
            let row = first + fault.row as u64;
            fault.fault = fault.fault.clone().in_row(row);
        }
        Ok(Some((table, faults)))
    }

    /// Rows of text as a table; `flight` and `line` stay as they are spelt.
    fn table(&self, rows: &[Row]) -> Result<(Table, Vec<RowFault>), ReadError> {
        let (mut table, mut faults) = (Table::default(), vec![]);
        let width = self.columns.len();
        for (row, Row { words, text_line }) in rows.iter().enumerate().filter(|(_, r)| r.words.len() != width) {
            let what = format!("the row has {} values where the header has {width}", words.len());
            let fault = ReadError::data(&self.path, what).help(format!("line {text_line} of the file"));
            faults.push(RowFault { row, fault });
        }
        let whole = rows.iter().find(|r| r.words.len() == width);
        for (i, Column { header, named, .. }) in self.columns.iter().enumerate() {
            let word = |r: &Row| (r.words.len() == width).then(|| r.words.get(i).cloned()).flatten();
            if named.name == "flight" || named.name == "line" {
                // A row that cannot be read is of the line of the others.
                let other = whole.and_then(word).unwrap_or_default();
                let texts = rows.iter().map(|r| word(r).unwrap_or_else(|| other.clone())).collect();
                table.push(&named.name, "", Values::Text(texts));
                continue;
            }
            let mut numbers = Vec::with_capacity(rows.len());
            for (row, text) in rows.iter().enumerate() {
                let word = text.words.get(i).filter(|_| text.words.len() == width);
                let number = word.map_or(Some(f64::NAN), |w| self.missing.number(w));
                if let (None, Some(word)) = (number, word) {
                    let fault = ReadError::data(&self.path, format!("`{word}` is not a number")).in_column(header);
                    let help = "a word for missing values goes into `missing`";
                    let fault = fault.help(format!("line {} of the file; {help}", text.text_line));
                    faults.push(RowFault { row, fault });
                }
                numbers.push(number.unwrap_or(f64::NAN));
            }
            let counted = sgl::unit_of(&named.name, self.ins_angle);
            let (unit, numbers) = in_counted_unit(&self.path, header, named, counted, numbers)?;
            table.push(&named.name, &unit, Values::Number(numbers));
        }
        Ok((table, faults))
    }
}

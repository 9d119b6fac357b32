//! The ASCII `.xyz` files of the SGL surveys: comment lines start with `/`, the last of them before the
//! data names the columns, values stand between blanks, `*` is missing. One line of the survey at a time
//! is in memory.

use std::{
    fs::File,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use super::{FlightFormat, FlightOptions, Head, Raw, csv::number, sgl};
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

fn open(path: &Path, _: &FlightOptions) -> Result<Raw, ReadError> {
    let mut rows = Rows::open(path)?;
    rows.advance()?;
    if rows.pending.is_none() {
        return Err(ReadError::data(path, "holds a header and no rows"));
    }
    let value = |name: &str| {
        let at = rows.names.iter().position(|n| n == name)?;
        number(rows.pending.as_ref()?.get(at)?)
    };
    rows.ins_angle = sgl::ins_angle(value("lat"), value("ins_lat"));
    let schema = sgl::finish(path, rows.table(vec![vec![]; rows.names.len()], 0)?)?.schema();
    let (path, mut done) = (path.to_path_buf(), false);
    let batches = std::iter::from_fn(move || {
        if done {
            return None;
        }
        let batch = rows.line().transpose()?.and_then(|t| sgl::finish(&path, t)).and_then(|t| t.into_batch(&path));
        done = batch.is_err();
        Some(batch)
    });
    Ok(Raw { schema, batches: Box::new(batches) })
}

/// The rows of the file, one ahead.
struct Rows {
    path: PathBuf,
    input: BufReader<File>,
    names: Vec<String>,
    ins_angle: &'static str,
    pending: Option<Vec<String>>,
    /// Rows taken so far, and lines of text.
    row: u64,
    text_line: u64,
}

impl Rows {
    /// Opens the file and reads up to the header.
    fn open(path: &Path) -> Result<Rows, ReadError> {
        let input = BufReader::new(File::open(path).map_err(|e| ReadError::io(path, &e))?);
        let (names, pending) = (vec![], None);
        let mut rows = Rows { path: path.to_path_buf(), input, names, ins_angle: "rad", pending, row: 0, text_line: 0 };
        let mut header = None;
        while rows.input.fill_buf().map_err(|e| ReadError::io(path, &e))?.first() == Some(&b'/') {
            let Some(line) = rows.text()? else { break };
            let words: Vec<String> = line.trim_start_matches('/').split_whitespace().map(sgl::name_of_header).collect();
            if words.len() > 1 {
                header = Some(words);
            }
        }
        rows.names = header.ok_or_else(|| ReadError::data(path, "no line after `/` names the columns"))?;
        for (i, name) in rows.names.iter().enumerate() {
            if rows.names.iter().take(i).any(|n| n == name) {
                return Err(ReadError::data(path, "the header names the column twice").in_column(name));
            }
        }
        Ok(rows)
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
            let words: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
            if words.len() != self.names.len() {
                let what = format!("the row has {} values where the header has {}", words.len(), self.names.len());
                let help = format!("line {} of the file", self.text_line);
                return Err(ReadError::data(&self.path, what).in_row(self.row).help(help));
            }
            self.row += 1;
            self.pending = Some(words);
            break;
        }
        Ok(())
    }

    /// What tells one line of the survey from the next.
    fn key(&self) -> Option<Vec<String>> {
        let row = self.pending.as_ref()?;
        let one = |key: &str| self.names.iter().position(|n| n == key).and_then(|i| row.get(i).cloned());
        Some(["flight", "line"].into_iter().filter_map(one).collect())
    }

    /// All rows of the next line of the survey.
    fn line(&mut self) -> Result<Option<Table>, ReadError> {
        let Some(key) = self.key() else { return Ok(None) };
        let first = self.row.saturating_sub(1);
        let mut columns = vec![vec![]; self.names.len()];
        while self.key().as_ref() == Some(&key) {
            for (column, value) in columns.iter_mut().zip(self.pending.take().unwrap_or_default()) {
                column.push(value);
            }
            self.advance()?;
        }
        self.table(columns, first).map(Some)
    }

    /// Text columns as a table; `flight` and `line` stay as they are spelt.
    fn table(&self, columns: Vec<Vec<String>>, first: u64) -> Result<Table, ReadError> {
        let mut table = Table::default();
        for (name, column) in self.names.iter().zip(columns) {
            if name == "flight" || name == "line" {
                table.push(name, "", Values::Text(column));
                continue;
            }
            let one = |(i, text): (usize, &String)| {
                number(text).ok_or_else(|| {
                    let what = format!("`{text}` is not a number");
                    ReadError::data(&self.path, what).in_column(name).in_row(first + i as u64)
                })
            };
            let numbers = column.iter().enumerate().map(one).collect::<Result<_, _>>()?;
            table.push(name, sgl::unit_of(name, self.ins_angle), Values::Number(numbers));
        }
        Ok(table)
    }
}

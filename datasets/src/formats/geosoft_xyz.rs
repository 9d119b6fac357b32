//! Geosoft's XYZ exports: comments after `/`, the last of them before the data names the columns, a record `Line 10` or
//! `Tie T5` before the rows of each line, `//Flight` and `//Date` before those that they are of, `*` for what is missing.
//! [Seequent, Oasis montaj, Geosoft XYZ file format]
//!
//! Columns keep the file's names; records become `line`, `flight`, `year` and `doy`. The file is read twice: once to settle
//! which columns are numbers, once for the values.

use std::{
    fs::File,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use arrow_schema::SchemaRef;
use numerics::earth::dates::day_of_year;

use super::{
    FlightFormat, FlightOptions, Head, Part, Raw, Reading, RowFault, csv, missing::Missing, text_table::record,
};
use crate::{
    ReadError,
    table::{Table, Values},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "geosoft_xyz",
    about: "XYZ export of Geosoft, with a record before each line: `Line 10`",
    extensions: &[],
    recognise: |head: &Head| {
        let mut kinds = head.text_lines().map(|line| kind(&line));
        let first = kinds.next();
        match first {
            Some(Kind::Record(_) | Kind::Flight(_) | Kind::Date(_)) => true,
            // Comments first: those of the SGL surveys have no records.
            Some(Kind::Comment(_)) => kinds.any(|k| matches!(k, Kind::Record(_))),
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
enum Kind {
    Blank,
    Comment(Vec<String>),
    Flight(String),
    Date(String),
    Record(String),
    Row(Vec<String>),
}

fn kind(text: &str) -> Kind {
    let text = text.trim().trim_start_matches('\u{feff}');
    if text.is_empty() {
        return Kind::Blank;
    }
    let stated = |word: &str| {
        let (head, rest) = text.strip_prefix("//")?.trim().split_once(char::is_whitespace)?;
        head.eq_ignore_ascii_case(word).then(|| rest.trim().to_owned())
    };
    if let Some(flight) = stated("flight") {
        return Kind::Flight(flight);
    }
    if let Some(date) = stated("date") {
        return Kind::Date(date);
    }
    let words = words(text.trim_start_matches('/'));
    if text.starts_with('/') {
        return Kind::Comment(words);
    }
    let borrowed: Vec<&str> = words.iter().map(String::as_str).collect();
    match record(&borrowed) {
        Some(name) => Kind::Record(name),
        None => Kind::Row(words),
    }
}

/// The words of a line: between commas or tabs, where there are such, otherwise between blanks.
fn words(text: &str) -> Vec<String> {
    let own = |w: &str| w.trim().trim_matches('"').to_owned();
    match [',', '\t'].into_iter().find(|s| text.contains(*s)) {
        Some(separator) => text.split(separator).map(own).collect(),
        None => text.split_whitespace().map(own).collect(),
    }
}

/// What the first pass finds.
#[derive(Default)]
struct Found {
    names: Vec<String>,
    /// Whether each column is of numbers.
    numbers: Vec<bool>,
    flights: bool,
    lines: bool,
    dates: bool,
    /// A date that cannot be read.
    unread: Option<String>,
}

fn lines(path: &Path) -> Result<impl Iterator<Item = Result<String, ReadError>> + Send + 'static, ReadError> {
    let file = File::open(path).map_err(|e| ReadError::io(path, &e))?;
    let mut input = BufReader::with_capacity(1 << 20, file);
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

fn scan(path: &Path, missing: &Missing) -> Result<Found, ReadError> {
    let (mut found, mut comments) = (Found::default(), vec![]);
    for line in lines(path)? {
        match kind(&line?) {
            Kind::Blank => {}
            Kind::Comment(words) if found.numbers.is_empty() => comments.push(words),
            Kind::Comment(_) => {}
            Kind::Flight(_) => found.flights = true,
            Kind::Date(text) => match date(&text) {
                Some(_) => found.dates = true,
                None => found.unread = Some(text),
            },
            Kind::Record(_) => found.lines = true,
            Kind::Row(words) => {
                if found.numbers.is_empty() {
                    found.numbers = vec![true; words.len()];
                }
                if words.len() == found.numbers.len() {
                    let one = |(is, word): (&mut bool, &String)| *is = *is && missing.number(word).is_some();
                    found.numbers.iter_mut().zip(&words).for_each(one);
                }
            }
        }
    }
    let width = found.numbers.len();
    if width == 0 {
        return Err(ReadError::data(path, "has no rows"));
    }
    // A line of the comment that underlines the names has as many words, and no letters.
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

fn open(path: &Path, options: &FlightOptions, _: &Reading) -> Result<Raw, ReadError> {
    let missing = Missing::of(options);
    let found = scan(path, &missing)?;
    let file = path.display();
    let mut notes = vec![];
    if found.names.first().is_some_and(|n| n == "column_1") {
        notes.push(format!(
            "{file}: no comment names the {} columns; they are column_1, column_2 ...",
            found.names.len()
        ));
    }
    if let Some(text) = &found.unread {
        notes.push(format!("{file}: the date `{text}` cannot be read, as 2020/06/29 can; the rows after it have none"));
    }
    if csv::ends_with_newline(path).is_ok_and(|ends| !ends) {
        notes.push(format!(
            "{file}: the file does not end with a newline, so it may be cut short inside its last value"
        ));
    }
    let empty = Gathered::new(found.names.len());
    let schema = empty.table(&found).schema();
    let rows = Rows {
        path: path.to_path_buf(),
        lines: Box::new(lines(path)?),
        found,
        missing,
        now: Now::default(),
        row: 0,
        text_line: 0,
        done: false,
        schema: schema.clone(),
    };
    Ok(Raw { notes, ..Raw::new(schema, Box::new(rows)) })
}

/// What the records say of the rows after them.
#[derive(Clone, Default)]
struct Now {
    flight: String,
    line: String,
    date: Option<(i32, u32)>,
}

/// The rows of a batch.
struct Gathered {
    rows: Vec<Now>,
    numbers: Vec<Vec<f64>>,
    words: Vec<Vec<String>>,
    faults: Vec<RowFault>,
}

impl Gathered {
    fn new(width: usize) -> Gathered {
        Gathered { rows: vec![], numbers: vec![vec![]; width], words: vec![vec![]; width], faults: vec![] }
    }

    fn table(self, found: &Found) -> Table {
        let mut table = Table::default();
        let text = |of: fn(&Now) -> &String| Values::Text(self.rows.iter().map(|now| of(now).clone()).collect());
        let has = |name: &str| found.names.iter().any(|n| n == name);
        if found.flights && !has("flight") {
            table.push("flight", "", text(|now| &now.flight));
        }
        if found.lines && !has("line") {
            table.push("line", "", text(|now| &now.line));
        }
        if found.dates && !has("year") && !has("doy") {
            let of =
                |pick: fn((i32, u32)) -> i64| Values::Whole(self.rows.iter().map(|now| now.date.map(pick)).collect());
            table.push("year", "", of(|(year, _)| i64::from(year)));
            table.push("doy", "", of(|(_, day)| i64::from(day)));
        }
        let columns = found.names.iter().zip(&found.numbers).zip(self.numbers.into_iter().zip(self.words));
        for ((name, number), (numbers, words)) in columns {
            table.push(name, "", if *number { Values::Number(numbers) } else { Values::Text(words) });
        }
        table
    }
}

struct Rows {
    path: PathBuf,
    lines: Box<dyn Iterator<Item = Result<String, ReadError>> + Send>,
    found: Found,
    missing: Missing,
    now: Now,
    row: u64,
    text_line: u64,
    done: bool,
    schema: SchemaRef,
}

impl Iterator for Rows {
    type Item = Result<Part, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut gathered = Gathered::new(self.found.names.len());
        while !self.done && gathered.rows.len() < ROWS {
            match self.lines.next() {
                Some(Ok(line)) => {
                    self.text_line += 1;
                    match kind(&line) {
                        Kind::Blank | Kind::Comment(_) => {}
                        Kind::Flight(flight) => self.now.flight = flight,
                        Kind::Date(text) => self.now.date = date(&text),
                        Kind::Record(name) => self.now.line = name,
                        Kind::Row(words) => self.gather(&words, &mut gathered),
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
        Some(batch.map(|batch| Part { batch, faults }))
    }
}

impl Rows {
    fn gather(&mut self, words: &[String], to: &mut Gathered) {
        let width = self.found.names.len();
        let whole = words.len() == width;
        if !whole {
            let what = format!("the row has {} values where the others have {width}", words.len());
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
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use std::fs;

    use arrow_array::{Array, cast::AsArray, types::Int64Type};

    use super::super::{log_tests::numbers, open_flight, open_raw};
    use super::*;

    /// As the help of Oasis montaj describes the format.
    const EXPORT: &str = "/ ------------------------------------------------------------------------------\n\
        / XYZ EXPORT [06/29/2020]\n/ DATABASE   [.\\survey.gdb]\n\
        / ------------------------------------------------------------------------------\n\
        /\n/      X            Y       UTC_time    MAG_nT   Note\n/========= ============ ========== ========= ======\n\
        //Flight 7\n//Date 2020/06/29\n\
        Line  L1030:2\n   450110.2  4975100.1   43200.00  54321.12      a\n   450111.2  4975101.1   43200.10         *      b\n\
        Tie   T9010\n   450112.2  4975102.1   43300.00  -99999     *\n\
        //Flight 8\n//Date 2020/06/30\nLine  L1040\n   450113.2  4975103.1   10.00  54000.5      a\n";

    #[test]
    fn ref_an_export_of_oasis_montaj() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.xyz");
        fs::write(&path, EXPORT).unwrap();
        let renamed = [("UTC_time", "tt"), ("MAG_nT", "mag_1_uc")].map(|(a, b)| (a.to_owned(), b.to_owned()));
        let options = FlightOptions { rename: renamed.into(), ..FlightOptions::default() };
        let mut reader = open_flight(&path, &options).unwrap();
        assert_eq!(reader.format(), "geosoft_xyz");
        let flight = reader.next().unwrap().unwrap();
        let texts = |name: &str| {
            let column = flight.column_by_name(name).unwrap().as_string::<i32>();
            (0..column.len()).map(|i| column.value(i).to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(texts("line"), ["L1030:2", "L1030:2", "T9010", "L1040"]);
        assert_eq!(texts("flight"), ["7", "7", "7", "8"]);
        assert_eq!(texts("Note"), ["a", "b", "*", "a"]);
        assert_eq!(flight.column_by_name("doy").unwrap().as_primitive::<Int64Type>().values(), &[181, 181, 181, 182]);
        assert_eq!(numbers(&flight, "tt"), [43_200.0, 43_200.1, 43_300.0, 10.0]);
        let mag = numbers(&flight, "mag_1_uc");
        assert!(mag[0] == 54_321.12 && mag[1].is_nan() && mag[2].is_nan() && mag[3] == 54_000.5, "{mag:?}");
    }

    #[test]
    fn unit_what_is_wrong_is_said_with_its_line() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.xyz");
        fs::write(&path, "//Date 29 June\nLine 10\n1,2,3\n1,2\nL20\n4,5,6").unwrap();
        let mut reader = open_raw(&path, &FlightOptions::default(), &Reading::default()).unwrap();
        let said = reader.notes().join("\n");
        for words in ["column_1, column_2", "the date `29 June` cannot be read", "does not end with a newline"] {
            assert!(said.contains(words), "{said}");
        }
        let part = reader.next_part().unwrap().unwrap();
        assert_eq!(numbers(&part.batch, "column_3")[2], 6.0);
        let fault = part.faults[0].fault.to_string();
        assert!(fault.ends_with("row 1: the row has 2 values where the others have 3 (line 4 of the file)"), "{fault}");
        fs::write(&path, "/ x y\nLine 10\n").unwrap();
        assert!(open_raw(&path, &FlightOptions::default(), &Reading::default()).is_err());
    }
}

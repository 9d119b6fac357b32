//! Plain text in columns, the exchange format of survey points and grids. Columns are separated by commas, semicolons,
//! tabs or blanks. A file may have a header, a row of units, comments and the line records of Geosoft's XYZ files.

use std::path::Path;

use super::{
    csv::{converted, number},
    decimal,
    line_records::{GeosoftLineRecord, LineRecordMatch, read as read_record, unknown},
    missing, text_end,
};
use crate::{ReadError, grid::split_unit, table::ColumnValues};

/// A table of text.
#[derive(Debug)]
pub(super) struct TextTable {
    /// The names in the header; `column_1`, `column_2` ... without a header.
    pub(super) names: Vec<String>,
    /// Whether the file names its columns.
    pub(super) named: bool,
    /// The columns: numbers if all values are numbers, otherwise text.
    pub(super) columns: Vec<ColumnValues>,
    /// The comments, in order, without their mark.
    pub(super) comments: Vec<String>,
    /// The line records, each with the index of the row that follows it.
    pub(super) records: Vec<(usize, GeosoftLineRecord)>,
    /// Notes on the conversion of the text.
    pub(super) notes: Vec<String>,
}

/// The kind of a line.
enum TextTableLine<'t, 'w> {
    /// Any line after the first row of names or values, before it is classified.
    Text(&'t str),
    Comment(&'t str),
    Record(GeosoftLineRecord),
    Names(&'w [&'t str]),
    /// A row, and the number of its line from 1.
    Row(&'w [&'t str], usize),
}

/// Reads a whole table.
///
/// # Errors
/// Fails for a file that cannot be read or has no rows, or rows of unequal length.
pub(super) fn read(path: &Path) -> Result<TextTable, ReadError> {
    let bytes = text_end::read(path)?;
    if bytes.contains(&0) {
        return Err(ReadError::data(path, "the file is not text"));
    }
    let Some((text, notes)) = converted(path)? else { return parse(path, &String::from_utf8_lossy(&bytes)) };
    let table = parse(path, &text)?;
    // The conversion omits the comments above the header.
    let own = String::from_utf8_lossy(&bytes);
    let comments = own.lines().filter_map(|line| Some(line.trim().strip_prefix('#')?.trim().to_owned()));
    Ok(TextTable { notes, comments: comments.collect(), ..table })
}

fn parse(path: &Path, text: &str) -> Result<TextTable, ReadError> {
    let text = text.trim_start_matches('\u{feff}');
    let mut table =
        TextTable { names: vec![], named: false, columns: vec![], comments: vec![], records: vec![], notes: vec![] };
    // The numbers of each column; `None` if the column has a word that is not a number.
    let mut columns: Vec<Option<Vec<f64>>> = vec![];
    let (mut rows, mut numbers) = (0, vec![]);
    scan(text, |line| {
        match line {
            TextTableLine::Text(line) => {
                let width = columns.len();
                if rows == 0 || !plain_numbers(line.as_bytes(), &mut numbers) || numbers.len() != width {
                    return Ok(false);
                }
                if columns.iter().any(Option::is_none) {
                    return Ok(false);
                }
                for (column, x) in columns.iter_mut().flatten().zip(&numbers) {
                    column.push(known(*x));
                }
                rows += 1;
            }
            TextTableLine::Comment(comment) => table.comments.push(comment.to_owned()),
            TextTableLine::Record(record) => table.records.push((rows, record)),
            TextTableLine::Names(names) => table.names = names.iter().map(|n| (*n).to_owned()).collect(),
            TextTableLine::Row(words, at) => {
                if rows == 0 {
                    let width = if table.names.is_empty() { words.len() } else { table.names.len() };
                    columns = vec![Some(vec![]); width];
                }
                if words.len() != columns.len() {
                    return Err(unequal(path, words, columns.len(), rows, at));
                }
                columns.iter_mut().zip(words).for_each(|(column, word)| put(column, word));
                rows += 1;
            }
        }
        Ok(true)
    })?;
    if rows == 0 || columns.is_empty() {
        return Err(ReadError::data(path, "the table has no rows"));
    }
    table.named = !table.names.is_empty();
    if !table.named {
        table.name(columns.len());
    }
    let column = |(i, numbers): (usize, Option<Vec<f64>>)| match numbers {
        Some(numbers) => Ok(ColumnValues::Number(numbers)),
        None => texts(text, i, rows).map(ColumnValues::Text),
    };
    table.columns = columns.into_iter().enumerate().map(column).collect::<Result<_, ReadError>>()?;
    Ok(table)
}

fn unequal(path: &Path, words: &[&str], width: usize, row: usize, at: usize) -> ReadError {
    let what = match read_record(words, Some(width)) {
        LineRecordMatch::Unknown => unknown(words),
        LineRecordMatch::Record(_) | LineRecordMatch::No => {
            format!("the row has {} values, but the others have {width}", words.len())
        }
    };
    ReadError::data(path, what).in_row(row as u64).help(format!("line {at} of the file"))
}

/// Appends a number to a column of numbers.
fn put(column: &mut Option<Vec<f64>>, word: &str) {
    let Some(numbers) = column else { return };
    match missing_or_number(word) {
        Some(number) => numbers.push(number),
        None => *column = None,
    }
}

/// The words of a column.
fn texts(text: &str, column: usize, rows: usize) -> Result<Vec<String>, ReadError> {
    let mut out = Vec::with_capacity(rows);
    scan(text, |line| {
        if let TextTableLine::Row(words, _) = line {
            out.push(words.get(column).copied().unwrap_or_default().to_owned());
        } else if let TextTableLine::Text(_) = line {
            return Ok(false);
        }
        Ok(true)
    })?;
    Ok(out)
}

/// Visits the lines that are not blank. A line after the first row is first passed as text; if `visit` returns `true`,
/// the line is not classified.
fn scan<'t>(
    text: &'t str,
    mut visit: impl FnMut(TextTableLine<'t, '_>) -> Result<bool, ReadError>,
) -> Result<(), ReadError> {
    let mut words: Vec<&'t str> = vec![];
    let (mut begun, mut width) = (false, None);
    for (at, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || (begun && visit(TextTableLine::Text(line))?) {
            continue;
        }
        if line.starts_with(MARKS) {
            visit(TextTableLine::Comment(line.trim_start_matches(MARKS).trim()))?;
            continue;
        }
        split(line, &mut words);
        if let LineRecordMatch::Record(record) = read_record(&words, width) {
            visit(TextTableLine::Record(record))?;
        } else if !begun && is_header(&words) {
            visit(TextTableLine::Names(&words))?;
            (begun, width) = (true, Some(words.len()));
        } else {
            visit(TextTableLine::Row(&words, at + 1))?;
            (begun, width) = (true, width.or(Some(words.len())));
        }
    }
    Ok(())
}

impl TextTable {
    /// Sets the names of columns without a header: from the last comment with the same number of words, otherwise
    /// `column_1`, `column_2`...
    fn name(&mut self, width: usize) {
        let words = |c: &String| -> Vec<String> {
            c.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()).map(str::to_owned).collect()
        };
        let named = self.comments.iter().rev().map(words).find(|w| {
            // A comment holds names only if it has no numbers and at least one known name: prose may have the same
            // number of words by chance.
            w.len() == width && w.iter().all(|w| number(w).is_none()) && w.iter().any(|w| KNOWN.contains(&&*lower(w)))
        });
        self.named = named.is_some();
        self.names = named.unwrap_or_else(|| (1..=width).map(|i| format!("column_{i}")).collect());
    }

    /// The index of the column of one of the names, in the order of the names; case is ignored.
    pub(super) fn find(&self, known: &[&str]) -> Option<usize> {
        known.iter().find_map(|k| self.names.iter().position(|n| lower(n) == *k))
    }

    /// Same as [`TextTable::find`], for a coordinate, whose name may end in a unit.
    pub(super) fn find_axis(&self, known: &[&str]) -> Option<usize> {
        let base = |n: &String| lower(split_unit(n).0);
        self.find(known).or_else(|| known.iter().find_map(|k| self.names.iter().position(|n| base(n) == *k)))
    }

    /// The numbers of a column.
    ///
    /// # Errors
    /// Fails at the first value that is not a number.
    pub(super) fn numbers(&self, path: &Path, column: usize) -> Result<&[f64], ReadError> {
        let name = self.names.get(column).map_or("", String::as_str);
        match self.columns.get(column) {
            Some(ColumnValues::Number(numbers)) => Ok(numbers),
            Some(ColumnValues::Text(words)) => {
                let bad = words.iter().position(|w| missing_or_number(w).is_none()).unwrap_or(0);
                let word = words.get(bad).map_or("", String::as_str);
                let what = format!("`{word}` is not a number");
                Err(ReadError::data(path, what).in_column(name).in_row(bad as u64))
            }
            _ => Err(ReadError::data(path, "there is no such column").in_column(name)),
        }
    }
}

/// Words by which a comment is recognised as a list of column names.
const KNOWN: [&str; 14] = [
    "x",
    "y",
    "z",
    "lat",
    "lon",
    "latitude",
    "longitude",
    "easting",
    "northing",
    "line",
    "fid",
    "mag",
    "tmi",
    "anomaly",
];

pub(super) fn lower(name: &str) -> String {
    name.trim().trim_matches('"').to_ascii_lowercase()
}

/// Characters that begin a comment line.
const MARKS: [char; 5] = ['#', '/', '!', '%', '>'];

/// The words of a line.
fn split<'t>(line: &'t str, words: &mut Vec<&'t str>) {
    words.clear();
    let separator = [',', ';', '\t'].into_iter().find(|s| line.contains(*s));
    match separator {
        Some(separator) => words.extend(line.split(separator).map(|w| w.trim().trim_matches('"'))),
        None => words.extend(line.split_ascii_whitespace().map(|w| w.trim_matches('"'))),
    }
}

/// Whether a row is a header: none of its words is a number, and at least one is not a missing value.
fn is_header(words: &[&str]) -> bool {
    words.iter().all(|w| w.is_empty() || missing_or_number(w).is_none()) && words.iter().any(|w| !w.is_empty())
}

/// A number, or NaN for an empty word and the usual missing-value words and fillers.
fn missing_or_number(word: &str) -> Option<f64> {
    number(word).map(known)
}

/// The number, or NaN for a filler.
fn known(value: f64) -> f64 {
    if missing::NUMBERS.contains(&value) { f64::NAN } else { value }
}

/// Parses a line of plain numbers, which are separated by one kind of separator or by blanks; returns `false` for other
/// lines.
fn plain_numbers(line: &[u8], numbers: &mut Vec<f64>) -> bool {
    numbers.clear();
    let (mut at, mut separator) = (0, None);
    loop {
        let Some((number, end)) = decimal::number(line, at) else { return false };
        numbers.push(number);
        let blanks = line.get(end..).unwrap_or_default().iter().take_while(|b| **b == b' ').count();
        at = end + blanks;
        let found = match line.get(at) {
            None => return true,
            Some(found @ (b',' | b';' | b'\t')) => *found,
            Some(_) if blanks > 0 => b' ',
            Some(_) => return false,
        };
        if *separator.get_or_insert(found) != found {
            return false;
        }
        if found != b' ' {
            at += 1;
            at += line.get(at..).unwrap_or_default().iter().take_while(|b| **b == b' ').count();
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use grids::LineType;

    use super::*;

    fn table(text: &str) -> TextTable {
        parse(Path::new("a.xyz"), text).unwrap()
    }

    #[test]
    fn unit_any_separator_header_and_comment_give_the_same_table() {
        let spellings = [
            "x,y,mag\n1,2,3\n4,5,*\n",
            "# a survey\n\"x\"\t\"y\"\t\"mag\"\n1\t2\t3\n\n4\t5\tNaN\n",
            "/ flown in 1990\n/ X Y MAG\n 1  2 3\n 4  5 -1e32\n",
            "x;y;mag\r\n1;2;3\r\n4;5;\r\n",
            "x y mag\n1 2 3\n4 5 N/A\n",
            "x y mag\n1 2 3\n4 5 -99999\n",
        ];
        for text in spellings {
            let table = table(text);
            assert!(table.named, "{text}");
            assert_eq!(table.find(&["mag"]), Some(2), "{text}");
            let mag = table.numbers(Path::new("a"), 2).unwrap();
            assert!(mag[0] == 3.0 && mag[1].is_nan() && mag.len() == 2, "{text}");
        }
        let bare = table("# x y\n1 2 3\n4 5 6\n");
        assert!(!bare.named && bare.names == ["column_1", "column_2", "column_3"]);
    }

    #[test]
    fn unit_line_records_precede_their_rows() {
        let table = table("/ x y mag\nLine 10\n1 2 3\n1 3 4\nTIE T20\n2 2 2\nL30:1\n5 5 5\n");
        let records = [(0, LineType::Line, "10"), (2, LineType::Tie, "T20"), (3, LineType::Line, "L30:1")];
        assert_eq!(
            table.records,
            records.map(|(row, kind, name)| (row, GeosoftLineRecord { kind, name: name.to_owned() }))
        );
        assert_eq!(table.numbers(Path::new("a"), 0).unwrap(), [1.0, 1.0, 2.0, 5.0]);
    }

    #[test]
    fn gold_faults_of_a_text_table() {
        let fault_text = |text: &str| parse(Path::new("a.xyz"), text).unwrap_err().to_string();
        let short = "a.xyz, row 1: the row has 2 values, but the others have 3 (line 3 of the file)";
        assert_eq!(fault_text("1 2 3\n\n1 2\n"), short);
        assert_eq!(
            fault_text("x,y,z\n1,2\n"),
            "a.xyz, row 0: the row has 2 values, but the others have 3 (line 2 of the file)"
        );
        assert!(fault_text("x y z\nLine 1\n1 2 3\nFoo 2\n4 5 6\n").contains("row 1: `Foo 2` is not a line record"));
        assert_eq!(fault_text("# nothing\n"), "a.xyz: the table has no rows");
        let text = table("x y z\n1 2 3\n1 2 high\n");
        let fault = text.numbers(Path::new("a.xyz"), 2).unwrap_err().to_string();
        assert_eq!(fault, "a.xyz, column `z`, row 1: `high` is not a number");
    }
}

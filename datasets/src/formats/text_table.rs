//! Plain text in columns: what survey points and grids are exchanged in. Separated by commas, tabs or blanks, with
//! or without a header, with comments, and with the line records of Geosoft's XYZ files.

use std::path::Path;

use super::csv::number;
use crate::{ReadError, table::Values};

/// A table of text.
#[derive(Debug)]
pub(super) struct TextTable {
    /// The names in the header; `column_1`, `column_2` ... where there is none.
    pub(super) names: Vec<String>,
    /// Whether the file names its columns.
    pub(super) named: bool,
    /// Numbers where all values are, else text.
    pub(super) columns: Vec<Values>,
    /// The comments, in order, without their mark.
    pub(super) comments: Vec<String>,
    /// The row that each line record stands before, and the name in it.
    pub(super) records: Vec<(usize, String)>,
}

/// What a row is of.
enum Row<'a> {
    Blank,
    Comment(&'a str),
    Record(String),
    Words(Vec<&'a str>),
}

/// Reads a whole table.
///
/// # Errors
/// A file that cannot be read or has no rows, and rows of unequal length.
pub(super) fn read(path: &Path) -> Result<TextTable, ReadError> {
    let bytes = std::fs::read(path).map_err(|e| ReadError::io(path, &e))?;
    if bytes.contains(&0) {
        return Err(ReadError::data(path, "the file is not text"));
    }
    parse(path, &String::from_utf8_lossy(&bytes))
}

fn parse(path: &Path, text: &str) -> Result<TextTable, ReadError> {
    let text = text.trim_start_matches('\u{feff}');
    let mut table = TextTable { names: vec![], named: false, columns: vec![], comments: vec![], records: vec![] };
    let mut rows: Vec<(usize, Vec<&str>)> = vec![];
    for (at, line) in text.lines().enumerate() {
        match row(line) {
            Row::Blank => {}
            Row::Comment(comment) => table.comments.push(comment.to_owned()),
            Row::Record(name) => table.records.push((rows.len(), name)),
            Row::Words(words) if rows.is_empty() && !table.named && is_header(&words) => {
                table.names = words.into_iter().map(str::to_owned).collect();
                table.named = true;
            }
            Row::Words(words) => {
                let width =
                    rows.first().map_or(if table.named { table.names.len() } else { words.len() }, |r| r.1.len());
                if words.len() != width {
                    let what = format!("the row has {} values where the others have {width}", words.len());
                    return Err(ReadError::data(path, what)
                        .in_row(rows.len() as u64)
                        .help(format!("line {} of the file", at + 1)));
                }
                rows.push((at, words));
            }
        }
    }
    let width = rows.first().map_or(0, |r| r.1.len());
    if width == 0 {
        return Err(ReadError::data(path, "the table has no rows"));
    }
    if !table.named {
        table.name(width);
    }
    for column in 0..width {
        let words = || rows.iter().map(|(_, words)| words.get(column).copied().unwrap_or_default());
        let numbers: Option<Vec<f64>> = words().map(missing_or_number).collect();
        table.columns.push(match numbers {
            Some(numbers) => Values::Number(numbers),
            None => Values::Text(words().map(str::to_owned).collect()),
        });
    }
    Ok(table)
}

impl TextTable {
    /// Names for columns that the header does not name: those of the last comment with as many words, else numbers.
    fn name(&mut self, width: usize) {
        let words = |c: &String| -> Vec<String> {
            c.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()).map(str::to_owned).collect()
        };
        let named = self.comments.iter().rev().map(words).find(|w| {
            // A comment of numbers, or of prose that has as many words by chance, names nothing.
            w.len() == width && w.iter().all(|w| number(w).is_none()) && w.iter().any(|w| KNOWN.contains(&&*lower(w)))
        });
        self.named = named.is_some();
        self.names = named.unwrap_or_else(|| (1..=width).map(|i| format!("column_{i}")).collect());
    }

    /// Where a column of one of the names is, in the order of the names; case does not matter.
    pub(super) fn find(&self, known: &[&str]) -> Option<usize> {
        known.iter().find_map(|k| self.names.iter().position(|n| lower(n) == *k))
    }

    /// The numbers of a column.
    ///
    /// # Errors
    /// The first value that is none.
    pub(super) fn numbers(&self, path: &Path, column: usize) -> Result<&[f64], ReadError> {
        let name = self.names.get(column).map_or("", String::as_str);
        match self.columns.get(column) {
            Some(Values::Number(numbers)) => Ok(numbers),
            Some(Values::Text(words)) => {
                let bad = words.iter().position(|w| missing_or_number(w).is_none()).unwrap_or(0);
                let word = words.get(bad).map_or("", String::as_str);
                let what = format!("`{word}` is not a number");
                Err(ReadError::data(path, what).in_column(name).in_row(bad as u64))
            }
            _ => Err(ReadError::data(path, "there is no such column").in_column(name)),
        }
    }
}

/// Words by which a comment is known to name the columns.
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

fn row(line: &str) -> Row<'_> {
    let line = line.trim();
    let Some(first) = line.chars().next() else { return Row::Blank };
    if ['#', '/', '!', '%', '>'].contains(&first) {
        return Row::Comment(line.trim_start_matches(['#', '/', '!', '%', '>']).trim());
    }
    let words = words(line);
    match record(&words) {
        Some(name) => Row::Record(name),
        None => Row::Words(words),
    }
}

fn words(line: &str) -> Vec<&str> {
    let separator = [',', ';', '\t'].into_iter().find(|s| line.contains(*s));
    match separator {
        Some(separator) => line.split(separator).map(|w| w.trim().trim_matches('"')).collect(),
        None => line.split_whitespace().map(|w| w.trim_matches('"')).collect(),
    }
}

/// The name in a line record: `Line 10`, `TIE T5`, or `L10:2` alone.
fn record(words: &[&str]) -> Option<String> {
    match words {
        [kind, name] if ["line", "tie"].contains(&&*lower(kind)) && name.chars().any(|c| c.is_ascii_digit()) => {
            Some((*name).to_owned())
        }
        [name] => {
            let rest = name.strip_prefix(['L', 'T', 'B', 'l', 't', 'b'])?;
            rest.starts_with(|c: char| c.is_ascii_digit()).then(|| (*name).to_owned())
        }
        _ => None,
    }
}

/// A row of names: none is a number, and one is a word that cannot be a missing value.
fn is_header(words: &[&str]) -> bool {
    words.iter().all(|w| w.is_empty() || missing_or_number(w).is_none()) && words.iter().any(|w| !w.is_empty())
}

/// A number; `*`, nothing and NaN are missing, and so is what Geosoft writes for it.
fn missing_or_number(word: &str) -> Option<f64> {
    const DUMMY: f64 = 1e30;
    let value = number(word)?;
    Some(if value.abs() >= DUMMY { f64::NAN } else { value })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    fn table(text: &str) -> TextTable {
        parse(Path::new("a.xyz"), text).unwrap()
    }

    #[test]
    fn law_any_separator_header_and_comment_make_one_table() {
        let spellings = [
            "x,y,mag\n1,2,3\n4,5,*\n",
            "# a survey\n\"x\"\t\"y\"\t\"mag\"\n1\t2\t3\n\n4\t5\tNaN\n",
            "/ flown in 1990\n/ X Y MAG\n 1  2 3\n 4  5 -1e32\n",
            "x;y;mag\r\n1;2;3\r\n4;5;\r\n",
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
    fn law_line_records_stand_before_their_rows() {
        let table = table("/ x y mag\nLine 10\n1 2 3\n1 3 4\nTIE T20\n2 2 2\nL30:1\n5 5 5\n");
        let records = [(0, "10".to_owned()), (2, "T20".to_owned()), (3, "L30:1".to_owned())];
        assert_eq!(table.records, records);
        assert_eq!(table.numbers(Path::new("a"), 0).unwrap(), [1.0, 1.0, 2.0, 5.0]);
    }

    #[test]
    fn gold_what_is_wrong_with_a_table() {
        let said = |text: &str| parse(Path::new("a.xyz"), text).unwrap_err().to_string();
        let short = "a.xyz, row 1: the row has 2 values where the others have 3 (line 3 of the file)";
        assert_eq!(said("1 2 3\n\n1 2\n"), short);
        assert_eq!(
            said("x,y,z\n1,2\n"),
            "a.xyz, row 0: the row has 2 values where the others have 3 (line 2 of the file)"
        );
        assert_eq!(said("# nothing\n"), "a.xyz: the table has no rows");
        let text = table("x y z\n1 2 3\n1 2 high\n");
        let fault = text.numbers(Path::new("a.xyz"), 2).unwrap_err().to_string();
        assert_eq!(fault, "a.xyz, column `z`, row 1: `high` is not a number");
    }
}

//! Text with comments above its header, with a row of units below it, in Latin-1, or with columns separated by
//! semicolons, tabs or blanks and numbers with decimal points or commas. It is converted to comma-separated text in
//! UTF-8 with decimal points while it is read; each record keeps its line number.

use std::{
    io::{self, BufRead, BufReader, Read},
    path::Path,
};

use super::{
    super::{FileHead, text_end::TextFile},
    cells::ends_record,
    latin_1,
    unit_row::heads_with_units,
};
use crate::ReadError;

/// Mark of a comment.
const COMMENT: char = '#';
/// The byte order mark.
const MARK: &[u8] = "\u{feff}".as_bytes();

/// Form of the text of a file, determined from the first lines.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CsvStyle {
    /// Separator of the columns. A blank represents any number of blanks and tabs.
    separator: u8,
    /// Number of lines above the header or, if `header` replaces it, above the first row.
    above: usize,
    /// The names of the header, if it is a comment (`# tt,mag_1_uc`) or has its units in the next row.
    header: Option<Vec<String>>,
    /// Whether the units are in the row below the header.
    has_units: bool,
    /// Whether the text is in Latin-1.
    is_latin_1: bool,
}

impl CsvStyle {
    /// Form of the text of a file.
    pub(super) fn of(head: &FileHead) -> CsvStyle {
        let is_latin_1 = latin_1::is_latin_1(head.text());
        let text =
            if is_latin_1 { latin_1::decoded(head.text()) } else { String::from_utf8_lossy(head.text()).into_owned() };
        let text = text.replace("\r\n", "\n").replace('\r', "\n");
        let text = text.trim_start_matches('\u{feff}');
        let is_above = |line: &&str| line.trim().is_empty() || line.starts_with(COMMENT);
        let above: Vec<&str> = text.lines().take_while(is_above).collect();
        let mut rows = text.lines().skip(above.len());
        let (first, second) = (rows.next().unwrap_or_default(), rows.next().unwrap_or_default());
        let comment = above.iter().rev().find(|line| !line.trim().is_empty());
        // Lines without text need no conversion.
        let skipped = if comment.is_some() { above.len() } else { 0 };
        let mut style = CsvStyle { above: skipped, is_latin_1, ..CsvStyle::new(first) };
        if has_blanks(first, [second, rows.next().unwrap_or_default()]) {
            style.separator = b' ';
        }
        let names = comment.map_or("", |comment| comment.trim_start_matches(COMMENT).trim());
        // The last comment is the header if it has a name for each value of a row of numbers.
        let (row, names) = (style.cells(first), style.cells(names));
        if row.len() > 1 && row.iter().all(|c| is_number(c)) && names.len() == row.len() {
            return CsvStyle { header: Some(names), ..style };
        }
        // A row of units that exceeds the examined start of the file is not whole.
        let is_whole = text.matches('\n').count() >= above.len() + 2;
        let heads = if is_whole { heads_with_units(&row, &style.cells(second)) } else { None };
        if heads.is_some() {
            return CsvStyle { above: above.len() + 2, header: heads, has_units: true, ..style };
        }
        style
    }

    /// The cells of one line, without quotes.
    fn cells(&self, line: &str) -> Vec<String> {
        if self.separator == b' ' {
            return line.split_whitespace().map(|cell| cell.trim_matches('"').to_owned()).collect();
        }
        let mut reader =
            csv::ReaderBuilder::new().has_headers(false).delimiter(self.separator).from_reader(line.as_bytes());
        let record = reader.records().next().and_then(Result::ok).unwrap_or_default();
        record.iter().map(|cell| cell.trim().to_owned()).collect()
    }

    /// Form of text with the header `line`.
    fn new(line: &str) -> CsvStyle {
        let mut quoted = false;
        let mut has = [false; 3];
        let separators = [b',', b';', b'\t'];
        for byte in line.bytes() {
            quoted ^= byte == b'"';
            for (has, separator) in has.iter_mut().zip(separators) {
                *has |= !quoted && byte == separator;
            }
        }
        // Without any separator, the text has a single column.
        let separator = if has[1] && (!has[0] || is_decimal_list(line)) {
            b';'
        } else if has[2] && !has[0] {
            b'\t'
        } else {
            b','
        };
        CsvStyle { separator, above: 0, header: None, has_units: false, is_latin_1: false }
    }

    /// Whether the text is read without conversion.
    fn is_plain(&self) -> bool {
        *self == CsvStyle::new("")
    }

    /// Whether the text has another separator than a comma or blanks, another encoding, or a row of units.
    pub(super) fn is_foreign(&self) -> bool {
        matches!(self.separator, b';' | b'\t') || self.has_units || self.is_latin_1
    }

    /// Notes for the user on the conversion of the text.
    pub(super) fn notes(&self) -> Vec<String> {
        let separator = match self.separator {
            b';' => Some("semicolons"),
            b'\t' => Some("tabs"),
            b' ' => Some("blanks"),
            _ => None,
        };
        let separator = separator.map(|separator| {
            format!("columns are separated by {separator}; a comma in a number is read as a decimal point")
        });
        let units = self.has_units.then(|| "the row below the header is read as the units of the columns".to_owned());
        let latin_1 = self.is_latin_1.then(|| "the text is not UTF-8; it is read as Latin-1".to_owned());
        separator.into_iter().chain(units).chain(latin_1).collect()
    }
}

/// Whether a cell is empty or a number with a decimal point or comma.
fn is_number(cell: &str) -> bool {
    cell.is_empty() || super::number(&cell.replace(',', ".")).is_some()
}

/// Whether blanks separate the columns: the header has no other separator, and one of the next two rows has a value for
/// each name, at least half of them numbers.
fn has_blanks(header: &str, next: [&str; 2]) -> bool {
    let names = header.split_whitespace().count();
    names > 1
        && !header.contains([',', ';', '\t', '"'])
        && next.iter().any(|row| {
            let cells: Vec<&str> = row.split_whitespace().collect();
            cells.len() == names && 2 * cells.iter().filter(|cell| is_number(cell)).count() >= names
        })
}

/// Whether a line without names has decimal commas and semicolons: `0,5;51336,2`.
fn is_decimal_list(line: &str) -> bool {
    line.split(';').all(|cell| super::number(&cell.trim().replace(',', ".")).is_some())
}

/// Comma-separated text of a file.
pub(super) enum CsvText {
    Plain(TextFile),
    Converted(Box<ConvertedText>),
}

impl CsvText {
    /// Opens a file.
    ///
    /// # Errors
    /// Fails for a file that cannot be read.
    pub(super) fn open(path: &Path) -> Result<CsvText, ReadError> {
        CsvText::of_form(path, &CsvStyle::of(&FileHead::read(path)?))
    }

    /// Opens a file whose text has this form.
    ///
    /// # Errors
    /// Fails for a file that cannot be read.
    pub(super) fn of_form(path: &Path, style: &CsvStyle) -> Result<CsvText, ReadError> {
        let file = TextFile::open(path)?;
        if style.is_plain() {
            return Ok(CsvText::Plain(file));
        }
        ConvertedText::new(file, style).map(|t| CsvText::Converted(Box::new(t))).map_err(|e| ReadError::io(path, &e))
    }
}

impl Read for CsvText {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        match self {
            CsvText::Plain(file) => file.read(to),
            CsvText::Converted(text) => text.read(to),
        }
    }
}

/// Decimal sign of the numbers read so far.
enum DecimalSign {
    Unknown,
    Point,
    /// A comma. Holds the first number with a comma, as long as every such number may be a whole number with a
    /// separator of thousands, such as `1,234`.
    Comma(Option<String>),
}

/// Text that is converted while it is read.
pub(super) struct ConvertedText {
    input: BufReader<TextFile>,
    separator: u8,
    is_latin_1: bool,
    /// Whether the current row has a cell before the blanks at the current position.
    after_cell: bool,
    /// The current cell, and whether it has an open quote.
    cell: Vec<u8>,
    quoted: bool,
    /// The converted text, and the position of its next byte.
    out: Vec<u8>,
    at: usize,
    /// The current line.
    line: u64,
    sign: DecimalSign,
    done: bool,
}

impl ConvertedText {
    fn new(file: TextFile, style: &CsvStyle) -> io::Result<ConvertedText> {
        let mut input = BufReader::new(file);
        if input.fill_buf()?.starts_with(MARK) {
            input.consume(MARK.len());
        }
        skip_lines(&mut input, style.above)?;
        let mut text = ConvertedText {
            input,
            separator: style.separator,
            is_latin_1: style.is_latin_1,
            after_cell: false,
            cell: vec![],
            quoted: false,
            out: vec![],
            at: 0,
            line: 1,
            sign: DecimalSign::Unknown,
            done: false,
        };
        let blank = style.above - usize::from(style.header.is_some());
        text.convert(&vec![b'\n'; blank])?;
        if let Some(names) = &style.header {
            let cells: Vec<Vec<u8>> = names.iter().map(|name| comma_cell(name.as_bytes())).collect();
            text.out.extend(cells.join(&b','));
            text.out.push(b'\n');
            text.line += 1;
        }
        Ok(text)
    }

    /// Converts the next part of the file.
    fn part(&mut self) -> io::Result<()> {
        self.out.clear();
        self.at = 0;
        let part = self.input.fill_buf()?.to_vec();
        self.input.consume(part.len());
        if !part.is_empty() {
            return self.convert(&part);
        }
        self.done = true;
        self.end_cell()?;
        match &self.sign {
            DecimalSign::Comma(Some(number)) => Err(wrong(format!(
                "the comma in numbers such as `{number}` may be a decimal comma or a thousands separator"
            ))),
            _ => Ok(()),
        }
    }

    fn convert(&mut self, part: &[u8]) -> io::Result<()> {
        for byte in part {
            let is_quote = *byte == b'"' && (self.cell.is_empty() || self.cell.starts_with(b"\""));
            let by_blanks = self.separator == b' ';
            let separates = *byte == self.separator || by_blanks && *byte == b'\t';
            let ends = separates || ends_record(*byte);
            if is_quote {
                self.quoted = !self.quoted;
            }
            if self.quoted || !ends {
                if by_blanks && self.cell.is_empty() && std::mem::take(&mut self.after_cell) {
                    self.out.push(b',');
                }
                self.cell.push(*byte);
                continue;
            }
            self.after_cell = separates && (self.after_cell || !self.cell.is_empty());
            self.end_cell()?;
            self.line += u64::from(*byte == b'\n');
            if !separates {
                self.out.push(*byte);
            } else if !by_blanks {
                self.out.push(b',');
            }
        }
        Ok(())
    }

    /// Appends the current cell. Text with a comma is quoted.
    fn end_cell(&mut self) -> io::Result<()> {
        let mut cell = std::mem::take(&mut self.cell);
        if self.is_latin_1 && std::str::from_utf8(&cell).is_err() {
            cell = latin_1::decoded(&cell).into_bytes();
        }
        let inner = cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\""));
        match decimal(&mut self.sign, inner.unwrap_or(&cell), self.line)? {
            Some(number) => self.out.extend(number),
            None if inner.is_none() => self.out.extend(comma_cell(&cell)),
            None => self.out.extend(&cell),
        }
        Ok(())
    }
}

impl Read for ConvertedText {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        while self.at == self.out.len() && !self.done {
            self.part()?;
        }
        let rest = self.out.get(self.at..).unwrap_or_default();
        let count = rest.len().min(to.len());
        to[..count].copy_from_slice(&rest[..count]);
        self.at += count;
        Ok(count)
    }
}

/// A cell of comma-separated text: quoted if it contains a comma.
fn comma_cell(cell: &[u8]) -> Vec<u8> {
    if !cell.contains(&b',') {
        return cell.to_vec();
    }
    let doubled = cell.iter().flat_map(|b| std::iter::repeat_n(*b, 1 + usize::from(*b == b'"')));
    std::iter::once(b'"').chain(doubled).chain([b'"']).collect()
}

/// Skips lines that end with a newline, a carriage return, or both.
fn skip_lines(input: &mut impl BufRead, mut lines: usize) -> io::Result<()> {
    let mut returned = false;
    while let Some(byte) = input.fill_buf()?.first().copied() {
        let is_rest = returned && byte == b'\n';
        if lines == 0 && !is_rest {
            break;
        }
        lines -= usize::from(ends_record(byte) && !is_rest);
        returned = byte == b'\r';
        input.consume(1);
    }
    Ok(())
}

fn wrong(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("{what}; write all numbers with decimal points"))
}

/// A number with a decimal comma, converted; `None` for other cells. `line` is its line, for messages.
fn decimal(sign: &mut DecimalSign, cell: &[u8], line: u64) -> io::Result<Option<Vec<u8>>> {
    let number = cell.trim_ascii();
    let mixed = || Err(wrong(format!("line {line} mixes numbers with decimal points and numbers with commas")));
    match decimal_sign(number) {
        None => Ok(None),
        Some(b'.') if matches!(sign, DecimalSign::Comma(_)) => mixed(),
        Some(b'.') => {
            *sign = DecimalSign::Point;
            Ok(None)
        }
        Some(_) => {
            let unsure = may_be_thousands(number).then(|| String::from_utf8_lossy(number).into_owned());
            *sign = match std::mem::replace(sign, DecimalSign::Unknown) {
                DecimalSign::Point => return mixed(),
                DecimalSign::Unknown => DecimalSign::Comma(unsure),
                DecimalSign::Comma(first) => DecimalSign::Comma(first.filter(|_| unsure.is_some())),
            };
            Ok(Some(number.iter().map(|b| if *b == b',' { b'.' } else { *b }).collect()))
        }
    }
}

/// The decimal sign of a number with exactly one point or comma; `None` for other text.
fn decimal_sign(cell: &[u8]) -> Option<u8> {
    let at = cell.iter().position(|b| matches!(b, b'.' | b','))?;
    let number: Vec<u8> = cell.iter().enumerate().map(|(i, b)| if i == at { b'.' } else { *b }).collect();
    let text = std::str::from_utf8(&number).ok()?;
    let plain = text.bytes().all(|b| b.is_ascii_digit() || matches!(b, b'.' | b'+' | b'-' | b'e' | b'E'));
    (plain && text.parse::<f64>().is_ok()).then(|| cell[at])
}

/// Whether a number with a comma may be a whole number with a separator of thousands, such as `51,336`.
fn may_be_thousands(cell: &[u8]) -> bool {
    let digits = cell.strip_prefix(b"-").or(cell.strip_prefix(b"+")).unwrap_or(cell);
    let Some(at) = digits.iter().position(|b| *b == b',') else { return false };
    let (whole, rest) = (&digits[..at], &digits[at + 1..]);
    let all = |part: &[u8]| part.iter().all(u8::is_ascii_digit);
    (1..=3).contains(&whole.len()) && whole.first() != Some(&b'0') && rest.len() == 3 && all(whole) && all(rest)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn converted(text: &str) -> io::Result<String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.csv");
        std::fs::write(&path, text).unwrap();
        let mut out = String::new();
        CsvText::open(&path).unwrap().read_to_string(&mut out).map(|_| out)
    }

    #[test]
    fn gold_semicolons_tabs_and_comments_become_commas() {
        for (text, expected) in [
            ("a;b\n1,5;2\n", "a,b\n1.5,2\n"),
            ("a;b\r\n1,5;2\r\n", "a,b\r\n1.5,2\r\n"),
            ("\u{feff}a;b\n1,5;2\n", "a,b\n1.5,2\n"),
            ("a\tb\n1.5\t-2e3\n", "a,b\n1.5,-2e3\n"),
            ("a;b\n-0,125;x, y\n", "a,b\n-0.125,\"x, y\"\n"),
            ("a;b\n1,5;\"x;\"\"y\"\"\"\n", "a,b\n1.5,\"x;\"\"y\"\"\"\n"),
            ("a;b\n\"1,5\";\"\"\n", "a,b\n1.5,\"\"\n"),
            ("a;b\n1,5;5\" pipe, x\n", "a,b\n1.5,\"5\"\" pipe, x\"\n"),
            ("a;b\n1,5;2", "a,b\n1.5,2"),
            ("a;b\n\n1,5;2\n", "a,b\n\n1.5,2\n"),
            ("# one\n#two, x\na,b\n1,2\n", "\n\na,b\n1,2\n"),
            ("# made by me\n# a,b\n1,2\n3,4\n", "\na,b\n1,2\n3,4\n"),
            ("# one\r\n# two\r\na,b\r\n1,2\r\n", "\n\na,b\r\n1,2\r\n"),
            ("# one\ra,b\r1,2\r", "\na,b\r1,2\r"),
            ("a\r\t3\t\r", "a\r\t3\t\r"),
            ("# a;b\n1,5;2,25\n", "a,b\n1.5,2.25\n"),
            ("a,b\n1,2\n", "a,b\n1,2\n"),
            ("a;b\n2024-06-03T14:00:00.5Z;51336,25\n", "a,b\n2024-06-03T14:00:00.5Z,51336.25\n"),
            // `1,234` may be a whole number until a later number has a decimal comma.
            ("a;b\n1,234;5\n0,5;6\n", "a,b\n1.234,5\n0.5,6\n"),
            ("a  b\n1.5   2\n  -3 4  \n", "a,b\n1.5,2\n-3,4\n"),
            ("a b c\n1,5 x\t2", "a,b,c\n1.5,x,2"),
            (" a b \n 1 2 \n\n3\n", "a,b\n1,2\n\n3\n"),
            // Names with blanks, not columns.
            ("a b\n1\n2\n", "a b\n1\n2\n"),
        ] {
            assert_eq!(converted(text).unwrap(), expected, "{text:?}");
        }
    }

    #[test]
    fn unit_ambiguous_numbers_are_an_error() {
        let fault = converted("a;b\n51,336;1\n51,337;2\n").unwrap_err().to_string();
        assert!(fault.contains("`51,336` may be a decimal comma or a thousands separator"), "{fault}");
        for text in ["a;b\n1,5;2\n3.5;2\n", "a;b\n1.5;2\n3,5;2\n"] {
            let fault = converted(text).unwrap_err().to_string();
            assert!(fault.contains("mixes numbers with decimal points"), "{fault}");
        }
        let fault = converted("a\tb\n1.5\t2\n\n3,5\t2\n").unwrap_err().to_string();
        assert!(fault.contains("line 4"), "{fault}");
    }

    #[test]
    fn gold_units_below_the_header_become_part_of_it() {
        for (text, expected) in [
            ("time,alt,mag\ns,ft,nT\n1,2,3\n", "\ntime [s],alt [ft],mag [nT]\n1,2,3\n"),
            ("# x\na;b\n(\u{b5}T);m\n1,5;2\n", "\n\na [\u{b5}T],b [m]\n1.5,2\n"),
            ("t  a\nhh:mm:ss  nT\n10:00:00  5\n", "\nt,a [nT]\n10:00:00,5\n"),
        ] {
            assert_eq!(converted(text).unwrap(), expected, "{text:?}");
        }
    }

    #[test]
    fn gold_signs_of_units_in_latin_1_become_utf_8() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.csv");
        let read = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let mut out = vec![];
            CsvText::open(&path).unwrap().read_to_end(&mut out).map(|_| out)
        };
        let text = "lat [\u{b0}],mag [\u{b5}T],n\n1,2,\u{fc}ber\n";
        let latin_1: Vec<u8> = text.chars().map(|c| c as u8).collect();
        assert_eq!(read(&latin_1).unwrap(), text.as_bytes());
        assert_eq!(read(text.as_bytes()).unwrap(), text.as_bytes());
        // A byte that no text has remains for the error of its row.
        assert_eq!(read(b"a,b\n1,\xff\n").unwrap(), b"a,b\n1,\xff\n");
    }

    #[test]
    fn unit_records_keep_their_lines() {
        let text = converted("# x\n\na;b\n\n\n1,5;\"p\nq\"\n\n2,5;r\n").unwrap();
        assert_eq!(text, "\n\na,b\n\n\n1.5,\"p\nq\"\n\n2.5,r\n");
    }
}

//! Text with comments above its header, or with columns separated by semicolons or tabs and numbers with decimal points
//! or commas. The text is converted to comma-separated text with decimal points while it is read; each record keeps its
//! line number.

use std::{
    io::{self, BufRead, BufReader, Read},
    path::Path,
};

use super::{
    super::{FileHead, text_end::TextFile},
    cells::ends_record,
};
use crate::ReadError;

/// Mark of a comment.
const COMMENT: char = '#';
/// The byte order mark.
const MARK: &[u8] = "\u{feff}".as_bytes();

/// Form of the text of a file, determined from the first lines.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CsvStyle {
    /// Separator of the columns.
    separator: u8,
    /// Number of lines above the header or, if the header is a comment, above the first row.
    above: usize,
    /// The header, if it is a comment: `# tt,mag_1_uc`.
    header: Option<String>,
}

impl CsvStyle {
    /// Form of the text of a file.
    pub(super) fn of(head: &FileHead) -> CsvStyle {
        let text = String::from_utf8_lossy(head.text()).replace("\r\n", "\n").replace('\r', "\n");
        let text = text.trim_start_matches('\u{feff}');
        let is_above = |line: &&str| line.trim().is_empty() || line.starts_with(COMMENT);
        let above: Vec<&str> = text.lines().take_while(is_above).collect();
        let comment = above.iter().rev().find(|line| !line.trim().is_empty());
        let Some(comment) = comment else { return CsvStyle::new(text.lines().nth(above.len()).unwrap_or_default()) };
        let first = text.lines().nth(above.len()).unwrap_or_default();
        let style = CsvStyle { above: above.len(), ..CsvStyle::new(first) };
        // The last comment is the header if it has a name for each value of a row of numbers.
        let names = comment.trim_start_matches(COMMENT).trim();
        let cells =
            |line: &str| line.split(char::from(style.separator)).map(|c| c.trim().to_owned()).collect::<Vec<_>>();
        let is_number = |cell: &String| cell.is_empty() || super::number(&cell.replace(',', ".")).is_some();
        let row = cells(first);
        let heads = row.len() > 1 && row.iter().all(is_number) && cells(names).len() == row.len();
        CsvStyle { header: heads.then(|| names.to_owned()), ..style }
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
        CsvStyle { separator, above: 0, header: None }
    }

    /// Whether the text is read without conversion.
    fn is_plain(&self) -> bool {
        *self == CsvStyle { separator: b',', above: 0, header: None }
    }

    /// Note for the user on the conversion of the text.
    pub(super) fn note(&self) -> Option<&'static str> {
        match self.separator {
            b';' => Some("columns are separated by semicolons; a comma in a number is read as a decimal point"),
            b'\t' => Some("columns are separated by tabs; a comma in a number is read as a decimal point"),
            _ => None,
        }
    }
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
        let style = CsvStyle::of(&FileHead::read(path)?);
        let file = TextFile::open(path)?;
        if style.is_plain() {
            return Ok(CsvText::Plain(file));
        }
        ConvertedText::new(file, &style).map(|t| CsvText::Converted(Box::new(t))).map_err(|e| ReadError::io(path, &e))
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
            cell: vec![],
            quoted: false,
            out: vec![],
            at: 0,
            line: 1,
            sign: DecimalSign::Unknown,
            done: false,
        };
        let header = style.header.as_deref();
        let blank = style.above - usize::from(header.is_some());
        text.convert(&vec![b'\n'; blank])?;
        if let Some(header) = header {
            text.convert(header.as_bytes())?;
            text.convert(b"\n")?;
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
            let ends = *byte == self.separator || ends_record(*byte);
            if is_quote {
                self.quoted = !self.quoted;
            }
            if self.quoted || !ends {
                self.cell.push(*byte);
                continue;
            }
            self.end_cell()?;
            self.line += u64::from(*byte == b'\n');
            self.out.push(if *byte == self.separator { b',' } else { *byte });
        }
        Ok(())
    }

    /// Appends the current cell. Text with a comma is quoted.
    fn end_cell(&mut self) -> io::Result<()> {
        let cell = std::mem::take(&mut self.cell);
        let inner = cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\""));
        match decimal(&mut self.sign, inner.unwrap_or(&cell), self.line)? {
            Some(number) => self.out.extend(number),
            None if inner.is_none() && cell.contains(&b',') => {
                self.out.push(b'"');
                let doubled = cell.iter().flat_map(|b| std::iter::repeat_n(*b, 1 + usize::from(*b == b'"')));
                self.out.extend(doubled);
                self.out.push(b'"');
            }
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
    fn unit_records_keep_their_lines() {
        let text = converted("# x\n\na;b\n\n\n1,5;\"p\nq\"\n\n2,5;r\n").unwrap();
        assert_eq!(text, "\n\na,b\n\n\n1.5,\"p\nq\"\n\n2.5,r\n");
    }
}

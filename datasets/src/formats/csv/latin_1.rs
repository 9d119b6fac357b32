//! Text in Latin-1 (ISO 8859-1), as loggers and spreadsheets write the signs of degrees and micro.

use super::cells::ends_record;

/// Number of lines with values that are examined: the header, and the row below it.
const LINES: usize = 2;

/// Whether the first lines of a text are in Latin-1: they are not UTF-8, and their bytes above 127 are letters or signs
/// of units.
pub(super) fn is_latin_1(text: &[u8]) -> bool {
    let mut lines = text.split(|b| ends_record(*b)).filter(|line| !line.trim_ascii().is_empty());
    let mut values = 0;
    let first: Vec<&[u8]> = std::iter::from_fn(|| {
        let line = lines.next().filter(|_| values < LINES)?;
        values += usize::from(line.first() != Some(&b'#'));
        Some(line)
    })
    .collect();
    let other = |line: &&[u8]| std::str::from_utf8(line).is_err();
    first.iter().any(other) && first.iter().filter(|line| other(line)).all(|line| line.iter().all(|b| is_usual(*b)))
}

/// ASCII, one of \u{aa}, \u{b0} to \u{b3}, \u{b5}, \u{b7}, \u{b9}, \u{ba}, or a letter.
fn is_usual(byte: u8) -> bool {
    byte.is_ascii()
        || matches!(byte, 0xaa | 0xb0..=0xb3 | 0xb5 | 0xb7 | 0xb9 | 0xba | 0xc0..=0xd6 | 0xd8..=0xf6 | 0xf8..=0xfe)
}

/// Latin-1 bytes as text.
pub(super) fn decoded(text: &[u8]) -> String {
    text.iter().map(|b| char::from(*b)).collect()
}

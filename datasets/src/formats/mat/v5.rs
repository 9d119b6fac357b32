//! MATLAB 5 to 7: variables one after another, each plain or deflated. [MathWorks, MAT-File Format, R2019b]

use std::{
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    path::Path,
};

use flate2::read::ZlibDecoder;

use super::super::limits::DecodeLimit;
use super::tree::{MatContents as Outcome, MatValue, MatVariable};
use crate::{ReadError, table::ColumnValues};

/// Length of the header: the text, the subsystem's offset, the version and the byte-order mark.
const HEADER: u64 = 128;
/// Maximum nesting of structures and cells.
const DEPTH: usize = 16;
/// Maximum length of a name, a list of dimensions or a string, in bytes.
const LONGEST: u64 = 1 << 20;

/// Types of data elements.
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;

/// Reads the variables of a file: the numbers of the variables that `keep` selects, and only the shapes of the others.
///
/// # Errors
/// Fails for a file that is not of this format. A damaged variable is skipped and noted.
pub(super) fn read(path: &Path, keep: &dyn Fn(&str) -> bool) -> Result<Outcome, ReadError> {
    let io = |e: io::Error| ReadError::io(path, &e);
    let mut file = BufReader::with_capacity(1 << 16, File::open(path).map_err(io)?);
    let length = file.seek(SeekFrom::End(0)).map_err(io)?;
    let mut header = [0; HEADER as usize];
    file.rewind().and_then(|()| file.read_exact(&mut header)).map_err(io)?;
    let big = match header.get(126..128) {
        Some(b"IM") => false,
        Some(b"MI") => true,
        _ => {
            return Err(ReadError::data(path, "the file is not a MATLAB 5 file: its header lacks the byte-order mark"));
        }
    };
    let (mut outcome, mut at, limit) = (Outcome::default(), HEADER, DecodeLimit::new(length));
    while at < length {
        file.seek(SeekFrom::Start(at)).map_err(io)?;
        let mut tag = [0; 8];
        if length - at < 8 || file.read_exact(&mut tag).is_err() {
            outcome.notes.push(format!("the last {} bytes of the file are not a variable", length - at));
            break;
        }
        let (kind, bytes) = (word(&tag, 0, big), u64::from(word(&tag, 4, big)));
        let end = at + 8 + bytes;
        let node = match kind {
            _ if end > length => Err(broken(&format!("it is truncated: it has {} of {bytes} bytes", length - at - 8))),
            MATRIX => {
                MatByteReader::new(&mut (&mut file).take(bytes), big, &limit).matrix(bytes, DEPTH, keep, true).map(Some)
            }
            COMPRESSED => deflated((&mut file).take(bytes), big, &limit, keep).map(Some),
            // An element of another type at the root is not a variable.
            _ => Ok(None),
        };
        match node {
            Ok(Some(node)) if node.name.is_empty() => {}
            Ok(Some(node)) => outcome.nodes.push(node),
            Ok(None) => outcome.notes.push(format!("the element at byte {at} is not a variable and is skipped")),
            Err(error) => outcome.notes.push(format!("the variable at byte {at} is damaged and is skipped: {error}")),
        }
        at = end.max(at + 8);
    }
    Ok(outcome)
}

/// Reads the variable in a compressed element.
fn deflated(input: impl Read, big: bool, limit: &DecodeLimit, keep: &dyn Fn(&str) -> bool) -> io::Result<MatVariable> {
    let mut inflated = ZlibDecoder::new(input);
    let mut tag = [0; 8];
    inflated.read_exact(&mut tag)?;
    if word(&tag, 0, big) != MATRIX {
        return Err(broken("it holds no array"));
    }
    let bytes = u64::from(word(&tag, 4, big));
    let node = MatByteReader::new(&mut inflated, big, limit).matrix(bytes, DEPTH, keep, true)?;
    // The checksum is compared at the end of the stream, which is not reached if numbers are skipped.
    if !matches!(node.content, MatValue::Array { values: None, .. }) {
        io::copy(&mut inflated, &mut io::sink())?;
    }
    Ok(node)
}

fn broken(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what.to_owned())
}

/// The 32 bits at an offset; 0 beyond the end.
fn word(bytes: &[u8], at: usize, big: bool) -> u32 {
    let four = bytes.get(at..).and_then(|b| b.first_chunk::<4>()).copied().unwrap_or_default();
    if big { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) }
}

/// The head of a data element.
struct MatElementTag {
    kind: u32,
    bytes: u64,
    /// The data of an element of at most four bytes, stored in the head.
    small: Option<[u8; 4]>,
}

/// Reader of the bytes of a variable.
struct MatByteReader<'a> {
    input: &'a mut dyn Read,
    big: bool,
    at: u64,
    limit: &'a DecodeLimit,
}

impl<'a> MatByteReader<'a> {
    fn new(input: &'a mut dyn Read, big: bool, limit: &'a DecodeLimit) -> MatByteReader<'a> {
        MatByteReader { input, big, at: 0, limit }
    }

    /// Reads `bytes` bytes; memory grows with the bytes read, not with the declared length.
    fn take(&mut self, bytes: u64) -> io::Result<Vec<u8>> {
        let mut out = vec![];
        self.input.take(bytes).read_to_end(&mut out)?;
        self.at += out.len() as u64;
        if (out.len() as u64) < bytes { Err(broken("it is truncated")) } else { Ok(out) }
    }

    fn skip(&mut self, bytes: u64) -> io::Result<()> {
        let skipped = io::copy(&mut self.input.take(bytes), &mut io::sink())?;
        self.at += skipped;
        if skipped < bytes { Err(broken("it is truncated")) } else { Ok(()) }
    }

    fn tag(&mut self, end: u64) -> io::Result<MatElementTag> {
        let head = self.take(8)?;
        let first = word(&head, 0, self.big);
        if first >> 16 != 0 {
            let (kind, bytes) = (first & 0xffff, u64::from(first >> 16));
            let small = head.get(4..).and_then(|b| b.first_chunk::<4>()).copied().unwrap_or_default();
            return if bytes <= 4 {
                Ok(MatElementTag { kind, bytes, small: Some(small) })
            } else {
                Err(broken("a small data element is longer than 4 bytes"))
            };
        }
        let bytes = u64::from(word(&head, 4, self.big));
        if bytes > end.saturating_sub(self.at) {
            return Err(broken("an element is longer than its array"));
        }
        Ok(MatElementTag { kind: first, bytes, small: None })
    }

    /// Reads the data of an element, and skips the padding after it.
    fn data(&mut self, tag: &MatElementTag, most: u64) -> io::Result<Vec<u8>> {
        if tag.bytes > most {
            return Err(broken("an element is too long"));
        }
        if let Some(small) = tag.small {
            return Ok(small.get(..tag.bytes as usize).unwrap_or_default().to_vec());
        }
        let data = self.take(tag.bytes)?;
        self.pad(tag)?;
        Ok(data)
    }

    fn skip_data(&mut self, tag: &MatElementTag) -> io::Result<()> {
        if tag.small.is_some() {
            return Ok(());
        }
        self.skip(tag.bytes)?;
        self.pad(tag)
    }

    /// Skips the padding after an element up to a multiple of 8 bytes; it may be missing after the last element.
    fn pad(&mut self, tag: &MatElementTag) -> io::Result<()> {
        let padding = tag.bytes.next_multiple_of(8) - tag.bytes;
        self.at += io::copy(&mut self.input.take(padding), &mut io::sink())?;
        Ok(())
    }

    fn element(&mut self, end: u64) -> io::Result<Vec<u8>> {
        let tag = self.tag(end)?;
        self.data(&tag, LONGEST)
    }

    /// Reads an array of `bytes` bytes, whose tag has been read. If the array is `outermost`, `keep` decides by its
    /// name whether its numbers and those of its parts are read.
    fn matrix(
        &mut self,
        bytes: u64,
        depth: usize,
        keep: &dyn Fn(&str) -> bool,
        outermost: bool,
    ) -> io::Result<MatVariable> {
        let end = self.at + bytes;
        let depth = depth.checked_sub(1).ok_or_else(|| broken("structures are nested too deeply"))?;
        if bytes == 0 {
            return Ok(MatVariable::skipped("", "empty"));
        }
        let flags = word(&self.element(end)?, 0, self.big);
        const OPAQUE: u32 = 17;
        const COMPLEX: u32 = 0x0800;
        let class = flags & 0xff;
        let dims: Vec<u64> = if class == OPAQUE { vec![] } else { self.dims(end)? };
        let name = String::from_utf8_lossy(&self.element(end)?).trim_end_matches('\0').to_owned();
        let kept = keep(&name);
        let keep: &dyn Fn(&str) -> bool = if !outermost {
            keep
        } else if kept {
            &|_| true
        } else {
            &|_| false
        };
        let count =
            dims.iter().try_fold(1u64, |n, d| n.checked_mul(*d)).ok_or_else(|| broken("its shape is too large"))?;
        let content = match class {
            // Double precision, single precision and the eight integer types.
            6..=15 if flags & COMPLEX != 0 => MatValue::Skipped("complex numbers"),
            6..=15 if dims.len() != 2 => MatValue::Skipped("an array of more than two dimensions"),
            6..=15 => {
                let tag = self.tag(end)?;
                let values = if keep(&name) {
                    // Numbers become Float64.
                    let bytes = count.checked_mul(8).map(|bytes| bytes.max(tag.bytes));
                    self.limit.check_next(bytes).map_err(|what| broken(&what))?;
                    let data = self.data(&tag, u64::MAX)?;
                    Some(numbers(&data, tag.kind, self.big, count)?)
                } else {
                    None
                };
                let (rows, columns) = (dims.first().copied().unwrap_or(0), dims.get(1).copied().unwrap_or(0));
                // Numbers that are not kept are skipped, except at the end of an outermost array, where reading stops.
                if values.is_none() && !outermost {
                    self.skip_data(&tag)?;
                }
                return self.done(name, MatValue::Array { rows, columns, values }, end, outermost && !kept);
            }
            4 => {
                let tag = self.tag(end)?;
                let data = self.data(&tag, LONGEST)?;
                MatValue::Texts(texts(&data, tag.kind, self.big, dims.first().copied().unwrap_or(0))?)
            }
            1 => self.cells(count, end, depth, keep)?,
            2 if count == 1 => MatValue::Struct(self.fields(end, depth, keep)?),
            2 => MatValue::Skipped("an array of structures"),
            3 => MatValue::Skipped("an object"),
            5 => MatValue::Skipped("a sparse matrix"),
            16 => MatValue::Skipped("a function"),
            OPAQUE => MatValue::Skipped("an object of a class"),
            _ => MatValue::Skipped("an array of an unknown class"),
        };
        self.done(name, content, end, outermost && !kept)
    }

    /// Skips the rest of the array, unless `stop` is set, and returns the variable.
    fn done(&mut self, name: String, content: MatValue, end: u64, stop: bool) -> io::Result<MatVariable> {
        if !stop {
            self.skip(end.checked_sub(self.at).ok_or_else(|| broken("its parts are longer than the array"))?)?;
        }
        Ok(MatVariable { name, content })
    }

    fn dims(&mut self, end: u64) -> io::Result<Vec<u64>> {
        let dims = self.element(end)?;
        if dims.len() < 8 || dims.len() % 4 != 0 {
            return Err(broken("it has fewer than two dimensions"));
        }
        Ok((0..dims.len()).step_by(4).map(|at| u64::from(word(&dims, at, self.big))).collect())
    }

    /// A cell array of strings; others are skipped.
    fn cells(&mut self, count: u64, end: u64, depth: usize, keep: &dyn Fn(&str) -> bool) -> io::Result<MatValue> {
        let mut texts = vec![];
        for _ in 0..count {
            match self.nested(end, depth, keep)?.content {
                MatValue::Texts(mut one) if one.len() <= 1 => texts.push(one.pop().unwrap_or_default()),
                _ => return Ok(MatValue::Skipped("a cell array")),
            }
        }
        Ok(MatValue::Texts(texts))
    }

    fn fields(&mut self, end: u64, depth: usize, keep: &dyn Fn(&str) -> bool) -> io::Result<Vec<MatVariable>> {
        let longest = word(&self.element(end)?, 0, self.big) as usize;
        let names = self.element(end)?;
        if longest == 0 {
            return Ok(vec![]);
        }
        let mut fields = vec![];
        for name in names.chunks_exact(longest) {
            let name = super::super::records::text(name);
            fields.push(MatVariable { name, ..self.nested(end, depth, keep)? });
        }
        Ok(fields)
    }

    /// A nested array.
    fn nested(&mut self, end: u64, depth: usize, keep: &dyn Fn(&str) -> bool) -> io::Result<MatVariable> {
        let tag = self.tag(end)?;
        if tag.kind != MATRIX || tag.small.is_some() {
            return Err(broken("an element is not an array"));
        }
        self.matrix(tag.bytes, depth, keep, false)
    }
}

/// The numbers of an element, whose type may be smaller than the array's.
fn numbers(data: &[u8], kind: u32, big: bool, count: u64) -> io::Result<ColumnValues> {
    macro_rules! of {
        ($t:ty, $n:literal) => {
            data.chunks_exact($n)
                .filter_map(|b| b.first_chunk::<$n>())
                .map(|b| if big { <$t>::from_be_bytes(*b) } else { <$t>::from_le_bytes(*b) })
        };
    }
    macro_rules! floats {
        ($t:ty, $n:literal) => {
            ColumnValues::Number(of!($t, $n).map(|x| x as f64).collect())
        };
    }
    let values = match kind {
        1 => floats!(i8, 1),
        2 => floats!(u8, 1),
        3 => floats!(i16, 2),
        4 => floats!(u16, 2),
        5 => floats!(i32, 4),
        6 => floats!(u32, 4),
        7 => floats!(f32, 4),
        9 => floats!(f64, 8),
        12 => exact(of!(i64, 8).map(i128::from)),
        13 => exact(of!(u64, 8).map(i128::from)),
        _ => return Err(broken("its numbers have an unknown type")),
    };
    if values.len() as u64 == count {
        Ok(values)
    } else {
        Err(broken("the number of its values does not match its shape"))
    }
}

/// Converts integers to Float64 if all of them are exact as Float64, otherwise to Int64 if they fit, otherwise to text.
fn exact(numbers: impl Iterator<Item = i128> + Clone) -> ColumnValues {
    const EXACT: u128 = 1 << 53;
    let most = numbers.clone().map(i128::unsigned_abs).max().unwrap_or(0);
    if most <= EXACT {
        return ColumnValues::Number(numbers.map(|x| x as f64).collect());
    }
    let whole: Option<Vec<Option<i64>>> = numbers.clone().map(|x| i64::try_from(x).ok().map(Some)).collect();
    whole.map_or_else(|| ColumnValues::Text(numbers.map(|x| x.to_string()).collect()), ColumnValues::Whole)
}

/// The rows of a matrix of characters, which is stored column by column.
fn texts(data: &[u8], kind: u32, big: bool, rows: u64) -> io::Result<Vec<String>> {
    let pair =
        |b: &[u8]| b.first_chunk::<2>().map(|b| if big { u16::from_be_bytes(*b) } else { u16::from_le_bytes(*b) });
    let characters: Vec<char> = match kind {
        1 | 2 => data.iter().map(|b| char::from(*b)).collect(),
        16 => String::from_utf8_lossy(data).chars().collect(),
        4 | 17 => {
            let units: Vec<u16> = data.chunks_exact(2).filter_map(pair).collect();
            String::from_utf16_lossy(&units).chars().collect()
        }
        _ => return Err(broken("its characters have an unknown type")),
    };
    let rows = usize::try_from(rows).unwrap_or(usize::MAX).min(characters.len());
    let row = |r: usize| characters.iter().skip(r).step_by(rows).collect::<String>().trim_end().to_owned();
    Ok((0..rows).map(row).collect())
}

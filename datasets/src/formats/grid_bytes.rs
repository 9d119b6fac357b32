//! Functions shared by the readers and writers of simple grids: words of text, fields of bytes, and rows in either
//! order.

use std::{io::Write, path::Path};

use super::{
    output::{MapFileSink, MapOutputFiles},
    text_end,
};
use crate::ReadError;
use grids::{AnomalyGrid, GridHeight};

/// The value of blank nodes in Surfer's grids; all larger values are blank too.
pub(super) const SURFER_BLANK: f64 = 1.701_41e38;

/// The content of a text file.
///
/// # Errors
/// Fails for a file that cannot be read or holds binary data.
pub(super) fn text_of(path: &Path) -> Result<String, ReadError> {
    let bytes = text_end::read(path)?;
    if bytes.contains(&0) {
        return Err(ReadError::data(path, "the file is not text"));
    }
    Ok(String::from_utf8_lossy(&bytes).trim_start_matches('\u{feff}').to_owned())
}

/// The content of a file.
///
/// # Errors
/// Fails for a file that cannot be read.
pub(super) fn bytes_of(path: &Path) -> Result<Vec<u8>, ReadError> {
    std::fs::read(path).map_err(|e| ReadError::io(path, &e))
}

/// The numbers of columns and rows, after a check that the file has at least `least` bytes for each node.
///
/// # Errors
/// Fails for counts below two, or for more nodes than the bytes can hold.
pub(super) fn nodes(path: &Path, columns: i64, rows: i64, least: u64, bytes: u64) -> Result<(usize, usize), ReadError> {
    let size = |n: i64| usize::try_from(n).ok().filter(|n| *n >= 2);
    let (Some(width), Some(height)) = (size(columns), size(rows)) else {
        return Err(ReadError::data(path, format!("a map requires at least 2 x 2 nodes, not {columns} x {rows}")));
    };
    let needed = (width as u64).checked_mul(height as u64).and_then(|n| n.checked_mul(least));
    match needed.filter(|n| *n <= bytes) {
        Some(_) => Ok((width, height)),
        None => {
            let what = format!("the file is truncated: it declares {width} x {height} nodes but has {bytes} bytes");
            Err(ReadError::data(path, what))
        }
    }
}

/// The next `count` numbers of the text.
///
/// # Errors
/// Fails for fewer numbers, or for a word that is not a number.
pub(super) fn numbers<'a>(
    path: &Path,
    words: &mut impl Iterator<Item = &'a str>,
    count: usize,
) -> Result<Vec<f64>, ReadError> {
    let mut values = Vec::new();
    for word in words.by_ref().take(count) {
        let value = word.parse::<f64>().ok();
        values.push(value.ok_or_else(|| not_a_number(path, word, values.len()))?);
    }
    if values.len() == count {
        return Ok(values);
    }
    Err(ReadError::data(path, format!("the file is truncated: it has {} of {count} values", values.len())))
}

fn not_a_number(path: &Path, word: &str, at: usize) -> ReadError {
    let word: String = word.chars().take(24).collect();
    ReadError::data(path, format!("`{word}` is not a number")).in_row(at as u64)
}

/// Cursor over bytes that are read field by field.
pub(super) struct FieldCursor<'a> {
    path: &'a Path,
    bytes: &'a [u8],
}

impl<'a> FieldCursor<'a> {
    pub(super) fn new(path: &'a Path, bytes: &'a [u8]) -> FieldCursor<'a> {
        FieldCursor { path, bytes }
    }

    /// The number of bytes left.
    pub(super) fn left(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// The next bytes.
    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], ReadError> {
        match self.bytes.split_at_checked(count) {
            Some((taken, rest)) => {
                self.bytes = rest;
                Ok(taken)
            }
            None => {
                let what =
                    format!("the file is truncated: it should have {count} more bytes, but has {}", self.bytes.len());
                Err(ReadError::data(self.path, what))
            }
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], ReadError> {
        let taken = self.take(N)?;
        taken.try_into().map_err(|_| ReadError::data(self.path, "the file is truncated"))
    }

    pub(super) fn i16(&mut self) -> Result<i16, ReadError> {
        Ok(i16::from_le_bytes(self.array()?))
    }

    pub(super) fn i32(&mut self) -> Result<i32, ReadError> {
        Ok(i32::from_le_bytes(self.array()?))
    }

    pub(super) fn f64(&mut self) -> Result<f64, ReadError> {
        Ok(f64::from_le_bytes(self.array()?))
    }
}

/// The values row by row, from values that are stored by columns of `height` values.
pub(super) fn transposed(values: &[f64], height: usize) -> Vec<f64> {
    (0..height).flat_map(|row| values.iter().skip(row).step_by(height)).copied().collect()
}

/// The rows of a map, in order from the south or from the north.
pub(super) fn rows(map: &AnomalyGrid, north_first: bool) -> impl Iterator<Item = &[f64]> {
    let count = map.y.len;
    (0..count).map(move |j| {
        let row = if north_first { count - 1 - j } else { j };
        map.anomaly_nt.get(row * map.x.len..(row + 1) * map.x.len).unwrap_or_default()
    })
}

/// Writes rows of numbers as text, at most `across` per line; each row begins a line. `blank` represents NaN.
///
/// # Errors
/// Fails for a file that cannot be written.
pub(super) fn write_rows(
    outputs: &MapOutputFiles,
    sink: &mut MapFileSink,
    map: &AnomalyGrid,
    north_first: bool,
    across: usize,
    blank: &str,
) -> Result<(), ReadError> {
    let mut line = String::new();
    for row in rows(map, north_first) {
        for part in row.chunks(across) {
            line.clear();
            for value in part {
                if !line.is_empty() {
                    line.push(' ');
                }
                if value.is_nan() { line.push_str(blank) } else { line.push_str(&text(*value)) }
            }
            line.push('\n');
            sink.write_all(line.as_bytes()).map_err(|e| outputs.io(&e))?;
        }
    }
    Ok(())
}

/// The shortest text of a number that is read back exactly.
pub(super) fn text(value: f64) -> String {
    let plain = value == 0.0 || value.is_nan() || (1e-5..1e16).contains(&value.abs());
    if plain { value.to_string() } else { format!("{value:e}") }
}

/// The smallest and the largest known value.
pub(super) fn range(values: &[f64]) -> (f64, f64) {
    let known = || values.iter().copied().filter(|v| !v.is_nan());
    (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max))
}

/// The height of a level map, for a format that stores a single height.
///
/// # Errors
/// Fails for heights that vary.
pub(super) fn level_m(outputs: &MapOutputFiles, map: &AnomalyGrid, format: &str) -> Result<f64, ReadError> {
    match map.height {
        GridHeight::Level(alt_m) => Ok(alt_m),
        GridHeight::Cells(_) => {
            let what = format!("the height of the map varies, which `{format}` cannot store");
            Err(ReadError::options(outputs.path(), what)
                .help("write parquet, netcdf, xyz or magnav_hdf5, or continue the map to one level first"))
        }
    }
}

/// Surfer's blank for unknown values.
pub(super) fn blanked(value: f64) -> f64 {
    if value >= SURFER_BLANK { f64::NAN } else { value }
}

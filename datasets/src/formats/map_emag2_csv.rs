//! EMAG2 version 3 as text without a header: the indices of a cell, its longitude (0 to 360 degrees) and latitude, the
//! anomaly at sea level, the anomaly at 4 km, a code of the source, and the error. [Meyer, Saltus & Chulliat 2017,
//! doi:10.7289/V5H70CVX]
//!
//! `alt_m` selects the anomaly: 0 at sea level, 4000 at 4 km. 99999 marks an unknown cell. The file is read twice, so
//! that the whole world needs 8 bytes of memory per cell.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader},
    path::Path,
};

use super::{
    FileHead, MapFormat, MapOptions,
    csv::number,
    text_end::{self, TextFile},
};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft},
};
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "emag2_csv",
    about: "EMAG2 version 3 as CSV; `alt_m` 0 or 4000 selects the anomaly",
    // The extension belongs to `xyz`; the content identifies this format.
    extensions: &[],
    recognise,
    companions: None,
    read,
    write: None,
};

/// Number of columns of a row.
const COLUMNS: usize = 8;
/// Cells per degree.
const PER_DEGREE: f64 = 30.0;
/// Largest distance of a coordinate from the middle of its cell, as a fraction of a cell. Six decimals of a degree
/// allow 1.5e-5.
const ROUNDING: f64 = 1e-3;
/// The number that marks an unknown cell.
const UNKNOWN: f64 = 99_999.0;
/// The heights of the two anomalies, with their columns.
const LEVELS: [(f64, usize); 2] = [(0.0, 4), (4000.0, 5)];
/// Maximum ratio of the number of cells of the grid to the number of rows in the file.
const SPARSEST: usize = 64;

/// The largest indices: 360 and 180 degrees with 30 cells per degree, counted from 0 or 1.
const MOST: [u32; 2] = [10_800, 5400];

/// A row of the file.
struct Emag2Row {
    /// Indices of the longitude and the latitude.
    cell: [u32; 2],
    /// Longitude and latitude, degrees.
    place: [f64; 2],
    /// Anomaly of the selected column, nT.
    anomaly_nt: f64,
}

impl Emag2Row {
    /// The row of a line; `None` for a line of another format.
    fn parse(line: &str, column: usize) -> Option<Emag2Row> {
        let mut words = line.split(',').map(str::trim);
        let mut numbers = [0.0; COLUMNS];
        for to in &mut numbers {
            *to = number(words.next()?)?;
        }
        let [i, j, lon, lat, ..] = numbers;
        let index = |x: f64, most: u32| (x.fract() == 0.0 && (0.0..=f64::from(most)).contains(&x)).then_some(x as u32);
        let in_middle = |x: f64| ((x * PER_DEGREE).rem_euclid(1.0) - 0.5).abs() <= ROUNDING;
        let is_place = (0.0..=360.0).contains(&lon) && lat.abs() <= 90.0 && in_middle(lon) && in_middle(lat);
        let cell = [index(i, MOST[0])?, index(j, MOST[1])?];
        (words.next().is_none() && is_place).then_some(Emag2Row {
            cell,
            place: [lon, lat],
            anomaly_nt: *numbers.get(column)?,
        })
    }
}

fn recognise(head: &FileHead) -> bool {
    // The last line may be truncated.
    let lines: Vec<String> = head.text_lines().take(3).collect();
    lines.len() >= 2 && lines.iter().take(2).all(|line| Emag2Row::parse(line, 0).is_some())
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let column = LEVELS.iter().find(|(level_m, _)| options.alt_m == Some(*level_m)).map(|(_, column)| *column);
    let column = column.ok_or_else(|| {
        let what = "the file holds the anomaly at sea level and at 4 km";
        ReadError::options(path, what).help("set `alt_m` to 0 or 4000 to select one")
    })?;
    if !text_end::is_whole(path).map_err(|e| ReadError::io(path, &e))? {
        return Err(ReadError::data(path, "the file is cut short: its last line does not end with a newline"));
    }
    let mut places = [BTreeMap::new(), BTreeMap::new()];
    let mut rows = 0;
    rows_of(path, column, |row| {
        rows += 1;
        for ((places, index), place) in places.iter_mut().zip(row.cell).zip(row.place) {
            if *places.entry(index).or_insert(place) != place {
                return Some(format!(
                    "index {index} has the coordinate {place}, but a different coordinate in an earlier row"
                ));
            }
        }
        None
    })?;
    let axis = |name: &str, of: &BTreeMap<u32, f64>| {
        let coordinates: Vec<f64> = of.values().copied().collect();
        FileAxis::from_coordinates(path, name, &coordinates)
    };
    let [x, y] = [axis("lon", &places[0])?, axis("lat", &places[1])?];
    let nodes = x.len().saturating_mul(y.len());
    if nodes > SPARSEST * rows {
        return Err(ReadError::data(path, "the cells do not form a regular grid").in_column("lon"));
    }
    let mut values = vec![f64::NAN; nodes];
    let mut seen = vec![false; nodes];
    let [first_x, first_y] = places.map(|places| places.first_key_value().map_or(0, |(index, _)| *index));
    let width = x.len();
    rows_of(path, column, |row| {
        let [i, j] = row.cell;
        let node = (j - first_y) as usize * width + (i - first_x) as usize;
        let (Some(value), Some(seen)) = (values.get_mut(node), seen.get_mut(node)) else {
            return Some("the cells do not form a regular grid".to_owned());
        };
        if std::mem::replace(seen, true) {
            return Some("duplicate cell".to_owned());
        }
        *value = if row.anomaly_nt == UNKNOWN { f64::NAN } else { row.anomaly_nt };
        None
    })?;
    let mut draft = MapDraft::new(path, x, y, values, FileCrs::Degrees);
    draft.unit = Some("nT".to_owned());
    let absent = nodes - rows;
    if absent > 0 {
        draft.notes.push(format!("{absent} cells of the region have no row and are unknown"));
    }
    draft.notes.push("heights of EMAG2 are above the geoid, and are used as heights above the ellipsoid".to_owned());
    draft.finish(options)
}

/// Passes each row to the function `take`, which returns a reason if it rejects the row.
fn rows_of(path: &Path, column: usize, mut take: impl FnMut(Emag2Row) -> Option<String>) -> Result<(), ReadError> {
    let mut lines = BufReader::with_capacity(1 << 20, TextFile::open(path)?);
    let mut line = String::new();
    for at in 0.. {
        line.clear();
        if lines.read_line(&mut line).map_err(|e| ReadError::io(path, &e))? == 0 {
            return Ok(());
        }
        let text = line.trim();
        if text.is_empty() {
            continue;
        }
        let row = Emag2Row::parse(text, column).ok_or_else(|| {
            let what = "must have 8 numbers: indices i and j, longitude and latitude of the centre of a cell of 2 \
                        minutes of arc, anomaly at sea level and at 4 km, code, error";
            ReadError::data(path, what).in_row(at)
        })?;
        if let Some(what) = take(row) {
            return Err(ReadError::data(path, what).in_row(at));
        }
    }
    Ok(())
}

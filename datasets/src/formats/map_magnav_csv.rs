//! Maps of MagNav.jl as a folder of CSV files: `map.csv` (rows of one latitude each), `xx.csv`
//! (longitudes), `yy.csv` (latitudes), `alt.csv`; none has a header.

use std::path::{Path, PathBuf};

use super::{
    FileHead, MapFormat, MapOptions,
    csv::number,
    map_magnav_hdf5::{NOTE, unknown_where_zero},
    text_end,
};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft},
};
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "magnav_csv",
    about: "folder of MagNav.jl: map.csv, xx.csv, yy.csv, alt.csv",
    extensions: &["map.csv"],
    recognise: |head: &FileHead| {
        folder(head.path).is_some_and(|f| f.join("xx.csv").is_file() && f.join("yy.csv").is_file())
    },
    companions: None,
    read,
    write: None,
};

/// The folder itself, or the folder of its `map.csv`.
fn folder(path: &Path) -> Option<PathBuf> {
    if path.is_dir() {
        return Some(path.to_path_buf());
    }
    path.file_name().is_some_and(|n| n == "map.csv").then(|| path.parent().map(Path::to_path_buf))?
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let folder = folder(path).ok_or_else(|| ReadError::options(path, "name the folder or its map.csv"))?;
    let all = |name: &str| numbers(&folder.join(name));
    let (lon, lat) = (all("xx.csv")?.concat(), all("yy.csv")?.concat());
    let rows = all("map.csv")?;
    let cells = MagnavCsvShape { folder: &folder, n_lat: lat.len(), n_lon: lon.len() };
    let values = unknown_where_zero(cells.flatten("map.csv", rows)?);
    let (x, y) = (FileAxis::from_coordinates(path, "lon", &lon)?, FileAxis::from_coordinates(path, "lat", &lat)?);
    let mut draft = MapDraft::new(path, x, y, values, FileCrs::Degrees);
    draft.notes.push(NOTE.to_owned());
    if options.alt_m.is_none() && folder.join("alt.csv").is_file() {
        match all("alt.csv")?.as_slice() {
            [row] if row.len() == 1 => draft.level_m = row.first().copied(),
            rows => draft.heights = Some(cells.flatten("alt.csv", rows.to_vec())?),
        }
    }
    draft.finish(options)
}

struct MagnavCsvShape<'a> {
    folder: &'a Path,
    n_lat: usize,
    n_lon: usize,
}

impl MagnavCsvShape<'_> {
    /// The concatenated rows, each with one value per longitude.
    fn flatten(&self, name: &str, rows: Vec<Vec<f64>>) -> Result<Vec<f64>, ReadError> {
        let path = self.folder.join(name);
        if rows.len() != self.n_lat {
            let what = format!("has {} rows, but yy.csv has {} latitudes", rows.len(), self.n_lat);
            return Err(ReadError::data(&path, what));
        }
        if let Some(row) = rows.iter().position(|r| r.len() != self.n_lon) {
            let what = format!("the row has {} values, but xx.csv has {} longitudes", rows[row].len(), self.n_lon);
            return Err(ReadError::data(&path, what).in_row(row as u64));
        }
        Ok(rows.concat())
    }
}

/// A file of numbers without a header, row by row.
fn numbers(path: &Path) -> Result<Vec<Vec<f64>>, ReadError> {
    let bytes = text_end::read(path)?;
    let text = String::from_utf8(bytes).map_err(|_| ReadError::data(path, "the file is not text"))?;
    let lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
    let rows = lines.map(|(row, line)| {
        let one = |word: &str| {
            let word = word.trim();
            number(word).ok_or_else(|| ReadError::data(path, format!("`{word}` is not a number")).in_row(row as u64))
        };
        line.split(',').map(one).collect()
    });
    let rows: Vec<Vec<f64>> = rows.collect::<Result<_, _>>()?;
    if rows.is_empty() { Err(ReadError::data(path, "the file is empty")) } else { Ok(rows) }
}

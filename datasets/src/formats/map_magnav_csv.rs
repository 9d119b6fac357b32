//! Maps of MagNav.jl as a folder of CSV files without headers: `map.csv` (rows of one latitude each), `xx.csv`,
//! `yy.csv`, `alt.csv`; the module `map_magnav` describes the arrays.

use std::path::{Path, PathBuf};

use super::{
    FileHead, MapFormat, MapOptions,
    csv::number,
    map_magnav::{self, MagnavArray, MagnavSource},
    text_end,
};
use crate::ReadError;
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "magnav_csv",
    about: "folder of MagNav.jl: map.csv, or mapX.csv, mapY.csv, mapZ.csv; xx.csv, yy.csv, alt.csv",
    extensions: &["map.csv"],
    recognise: |head: &FileHead| {
        folder(head.path).is_some_and(|folder| {
            let folder = MagnavCsvFolder { folder: &folder };
            map_magnav::is_map(|name| folder.has(name))
        })
    },
    companions: None,
    read,
    write: None,
};

/// The folder of a map: `path` itself, or the folder that contains `path`, its `map.csv`.
fn folder(path: &Path) -> Option<PathBuf> {
    if path.is_dir() {
        return Some(path.to_path_buf());
    }
    path.file_name().is_some_and(|n| n == "map.csv").then(|| path.parent().map(Path::to_path_buf))?
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let folder =
        folder(path).ok_or_else(|| ReadError::options(path, "give the folder, or the file map.csv in the folder"))?;
    map_magnav::read(path, options, &MagnavCsvFolder { folder: &folder }, Vec::new)
}

struct MagnavCsvFolder<'a> {
    folder: &'a Path,
}

impl MagnavCsvFolder<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name).with_extension("csv")
    }
}

impl MagnavSource for MagnavCsvFolder<'_> {
    fn has(&self, name: &str) -> bool {
        self.path(name).is_file()
    }

    fn array(&self, name: &str) -> Result<MagnavArray, ReadError> {
        let path = self.path(name);
        let rows = numbers(&path)?;
        let (n_lat, n_lon) = (rows.len(), rows.first().map_or(0, Vec::len));
        if let Some(row) = rows.iter().position(|row| row.len() != n_lon) {
            let what = format!("the row has {} values where the first row has {n_lon}", rows[row].len());
            return Err(ReadError::data(&path, what).in_row(row as u64));
        }
        Ok(MagnavArray { shape: Some([n_lon, n_lat]), values: rows.concat() })
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

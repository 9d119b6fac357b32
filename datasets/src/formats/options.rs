//! How files are read: what a table of a spec says beside its path.

use std::{collections::BTreeMap, path::Path};

use schemas::{Word, params, plausible::Accept};

use super::missing::Missing;
use crate::ReadError;

params! {
    /// How a flight log is read.
    pub struct FlightOptions, all default;
    /// The name of the format.
    format: Option<String>, unit "", default None, absent "known from the content and the extension";
    /// The message, topic or array of a log that holds several, such as `MAG`, `sensor_mag:1` or `.` (the vectors at the root
    /// of a MATLAB file).
    topic: Option<String>, unit "", default None, absent "the only one";
    /// The file's column names to canonical ones. A unit in the file's name (`GPS Lat (rad)`, `Alt ft`, `Mag_mgauss`) is
    /// taken as the column's unit, and one that does not convert is an error.
    rename: BTreeMap<String, String>, unit "", default BTreeMap::new();
    /// The units of columns, by the file's own names. They take precedence over names and metadata.
    units: BTreeMap<String, String>, unit "", default BTreeMap::new();
    /// Texts and numbers that mean a missing value, in addition to `N/A`, `NA`, `null`, `none`, `NaN`, `-`, `*`, an empty
    /// cell, -99999 and Geosoft's -1e32.
    missing: Vec<Word>, unit "", default Vec::<Word>::new();
    /// The flight, for files that hold none.
    flight: Option<String>, unit "", default None, absent "the file's";
    /// The line, for files that hold none.
    line: Option<String>, unit "", default None, absent "the file's";
    /// The EPSG code of the eastings and northings of survey points (`format = "points"`).
    epsg: Option<u16>, unit "", default None, absent "the file's";
    /// Checks that impossible values may fail.
    accept: Vec<Accept>, unit "", default Vec::<Accept>::new();
}

impl FlightOptions {
    /// Whether a text, such as the identifier of a line, marks a missing value.
    pub fn is_missing(&self, text: &str) -> bool {
        Missing::of(self).is_text(text)
    }
}

params! {
    /// How a map is read.
    pub struct MapOptions, all default;
    /// The name of the format.
    format: Option<String>, unit "", default None, absent "known from the content and the extension";
    /// The EPSG code of the coordinates; it takes precedence over the file.
    epsg: Option<u16>, unit "", default None, absent "the file's; it must be given for eastings and northings in a file without it";
    /// The height of the map above the WGS-84 ellipsoid, for files that hold none.
    alt_m: Option<f64>, unit "m", default None, absent "the file's";
    /// The unit of the anomaly.
    unit: Option<String>, unit "", default None, absent "the file's, or nT";
    /// Numbers that mark an unknown value, in addition to those that the file names and to the usual ones beyond any
    /// field (the largest single-precision number, Surfer's blank, Geosoft's -1e32).
    missing: Vec<Word>, unit "", default Vec::<Word>::new();
    /// Checks that impossible values may fail.
    accept: Vec<Accept>, unit "", default Vec::<Accept>::new();
}

/// The numbers among the words of `missing`.
///
/// # Errors
/// Fails for a word that is not a number: a map has numbers alone.
pub(crate) fn markers(path: &Path, missing: &[Word]) -> Result<Vec<f64>, ReadError> {
    let one = |word: &Word| {
        let number = word.0.trim().parse::<f64>().ok();
        number.ok_or_else(|| ReadError::options(path, format!("`{}` of `missing` is not a number", word.0)))
    };
    missing.iter().map(one).collect()
}

//! Options for reading files: the keys of a table of a spec, except its path.

use std::{collections::BTreeMap, path::Path};

use schemas::{VerbatimText, map::VectorComponent, params, plausible::PlausibilityCheck};

use super::missing::MissingMarkers;
use crate::ReadError;

params! {
    /// Options for reading a flight log.
    pub struct FlightOptions, all default;
    /// Name of the format.
    format: Option<String>, unit "", default None, absent "detected from content and extension";
    /// Message, topic or array to read from a log that holds several, such as `MAG` or `sensor_mag:1`. The value `.`
    /// selects the vectors at the root of a MATLAB file.
    topic: Option<String>, unit "", default None, absent "the only topic of the file";
    /// Name of each column in magline, keyed by its name in the file. If the name in the file contains a unit (`GPS Lat
    /// (rad)`, `Alt ft`, `Mag_mgauss`), the column takes this unit. A unit that cannot be converted is rejected.
    rename: BTreeMap<String, String>, unit "", default BTreeMap::new();
    /// Unit of each column, keyed by its name in the file. It overrides units in names and metadata.
    units: BTreeMap<String, String>, unit "", default BTreeMap::new();
    /// Strings and numbers that mark a missing value, in addition to `N/A`, `NA`, `null`, `none`, `NaN`, `-`, `*`, an
    /// empty cell, -99999 and Geosoft's -1e32.
    missing: Vec<VerbatimText>, unit "", default Vec::<VerbatimText>::new();
    /// Flight identifier, for files without one.
    flight: Option<String>, unit "", default None, absent "read from the file";
    /// Line identifier, for files without one.
    line: Option<String>, unit "", default None, absent "read from the file";
    /// EPSG code of the eastings and northings of survey points (`format = "points"`).
    epsg: Option<u16>, unit "", default None, absent "read from the file";
    /// Plausibility checks that are disabled for this file. `range` rejects values outside the limits of their column,
    /// and columns that contradict each other.
    accept: Vec<PlausibilityCheck>, unit "", default Vec::<PlausibilityCheck>::new();
}

impl FlightOptions {
    /// Whether a string, such as the identifier of a line, marks a missing value.
    pub fn is_missing(&self, text: &str) -> bool {
        MissingMarkers::from_options(self).is_text(text)
    }
}

params! {
    /// Options for reading a map.
    pub struct MapOptions, all default;
    /// Name of the format.
    format: Option<String>, unit "", default None, absent "detected from content and extension";
    /// EPSG code of the coordinates. It overrides the code in the file. It is required for eastings and northings in a
    /// file without a code.
    epsg: Option<u16>, unit "", default None, absent "read from the file";
    /// Height of the map above the WGS-84 ellipsoid. It overrides the height in the file.
    alt_m: Option<f64>, unit "m", default None, absent "read from the file";
    /// Unit of the anomaly. It overrides the unit in the file.
    unit: Option<String>, unit "", default None, absent "read from the file, else nT";
    /// Component to read from a map with three components, such as MagNav.jl's `EMM720_World.h5`. Its values are not a
    /// total-field anomaly.
    field_component: Option<VectorComponent>, unit "", default None, absent "the map holds the total-field anomaly";
    /// Numbers that mark an unknown value, in addition to the file's own markers and the usual markers (the largest
    /// single-precision number, Surfer's blank, Geosoft's -1e32).
    missing: Vec<VerbatimText>, unit "", default Vec::<VerbatimText>::new();
    /// Plausibility checks that are disabled for this map. `range` rejects values outside the limits of their column.
    accept: Vec<PlausibilityCheck>, unit "", default Vec::<PlausibilityCheck>::new();
}

/// The numbers among the words of `missing`.
///
/// # Errors
/// Fails for a word that is not a number, as a map holds only numbers.
pub(crate) fn markers(path: &Path, missing: &[VerbatimText]) -> Result<Vec<f64>, ReadError> {
    let one = |word: &VerbatimText| {
        let number = word.0.trim().parse::<f64>().ok();
        number.ok_or_else(|| ReadError::options(path, format!("`{}` of `missing` is not a number", word.0)))
    };
    missing.iter().map(one).collect()
}

//! Maps of MagNav.jl, shared by its HDF5, MATLAB and CSV formats: `map`, or the three components `mapX`, `mapY` and
//! `mapZ`; `xx` (longitudes), `yy` (latitudes), `alt`, optionally `mask`.
//!
//! `create_flux` of MagNav.jl uses the three components as north, east and down, as the models of NOAA do. The files
//! have no units: MagNav.jl writes coordinates in degrees, unless `file_units = :rad` is set, and fields in nT.

use std::path::Path;

use schemas::map::VectorComponent;

use super::{MapOptions, grid_bytes::transposed};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft},
};
use grids::AnomalyGrid;

/// The note on every map of MagNav.jl.
pub(super) const NOTE: &str = "nodes with the value 0 are treated as unknown, as in MagNav.jl";

/// The names of the components of a vector map, in the order north, east, down.
pub(super) const COMPONENTS: [&str; 3] = ["mapX", "mapY", "mapZ"];

/// The coordinates that every map of MagNav.jl has.
pub(super) const AXES: [&str; 2] = ["xx", "yy"];

/// An array of a map, by rows of one latitude each.
pub(super) struct MagnavArray {
    /// The number of longitudes and the number of latitudes; `None` unless the array has two dimensions.
    pub(super) shape: Option<[usize; 2]>,
    /// The values; in an array of two dimensions, each row has one latitude.
    pub(super) values: Vec<f64>,
}

impl MagnavArray {
    /// An array from values in memory order of a Julia or MATLAB matrix with latitudes as rows: all latitudes of one
    /// longitude are adjacent.
    pub(super) fn by_longitude(shape: Option<[usize; 2]>, stored: Vec<f64>) -> MagnavArray {
        match shape.filter(|[n_lon, n_lat]| n_lon.checked_mul(*n_lat) == Some(stored.len())) {
            Some([_, n_lat]) => MagnavArray { shape, values: transposed(&stored, n_lat) },
            None => MagnavArray { shape: None, values: stored },
        }
    }
}

/// The arrays in a file or folder.
pub(super) trait MagnavSource {
    /// Whether there is an array `name`.
    fn has(&self, name: &str) -> bool;

    /// The array `name`.
    ///
    /// # Errors
    /// Fails for an array that is missing or does not hold numbers.
    fn array(&self, name: &str) -> Result<MagnavArray, ReadError>;
}

/// Whether the arrays of a map of MagNav.jl exist, according to `has`.
pub(super) fn is_map(has: impl Fn(&str) -> bool) -> bool {
    AXES.iter().all(|name| has(name)) && (has("map") || COMPONENTS.iter().all(|name| has(name)))
}

/// The map in a file, with the notes of its reader.
///
/// # Errors
/// Fails for arrays that are missing or of different sizes, for coordinates in radians, and for a vector map if the
/// options name no component.
pub(super) fn read(
    path: &Path,
    options: &MapOptions,
    source: &dyn MagnavSource,
    notes: impl FnOnce() -> Vec<String>,
) -> Result<AnomalyGrid, ReadError> {
    let [lon, lat] = AXES.map(|name| vector(path, source, name));
    let (lon, lat) = (lon?, lat?);
    refuse_radians(path, options, &lon, &lat)?;
    let shape = [lon.len(), lat.len()];
    let (x, y) = (FileAxis::from_coordinates(path, "lon", &lon)?, FileAxis::from_coordinates(path, "lat", &lat)?);
    let (component, mut values) = values(path, options, source, shape)?;
    if source.has("mask") {
        let mask = of_shape(path, "mask", source.array("mask")?, shape)?;
        values.iter_mut().zip(mask).filter(|(_, m)| *m == 0.0).for_each(|(v, _)| *v = f64::NAN);
    }
    let mut draft = MapDraft::new(path, x, y, values, FileCrs::Degrees);
    draft.component = component;
    draft.notes.push(NOTE.to_owned());
    draft.notes.extend(notes());
    if options.alt_m.is_none() && source.has("alt") {
        let alt = source.array("alt")?;
        match alt.values.as_slice() {
            [level_m] => draft.level_m = Some(*level_m),
            [] => return Err(ReadError::data(path, "holds no value").in_column("alt")),
            _ if alt.shape == Some(shape) => draft.heights = Some(alt.values),
            _ => {
                let what = "a map must have one level; extract one level into a file";
                return Err(ReadError::data(path, what).in_column("alt"));
            }
        }
    }
    draft.finish(options)
}

/// The values of the map or of a component, NaN where unknown.
fn values(
    path: &Path,
    options: &MapOptions,
    source: &dyn MagnavSource,
    shape: [usize; 2],
) -> Result<(Option<VectorComponent>, Vec<f64>), ReadError> {
    let array = |name: &str| of_shape(path, name, source.array(name)?, shape);
    let is_vector = COMPONENTS.iter().any(|name| source.has(name));
    let Some(component) = options.field_component.filter(|_| is_vector) else {
        if is_vector && !source.has("map") {
            let what = "the file holds the components `mapX` (north), `mapY` (east) and `mapZ` (down)";
            let help = "set `field_component` to `north`, `east` or `down`";
            return Err(ReadError::options(path, what).help(help));
        }
        let mut values = array("map")?;
        values.iter_mut().filter(|v| **v == 0.0).for_each(|v| *v = f64::NAN);
        return Ok((None, values));
    };
    let [north, east, down] = COMPONENTS.map(array);
    let mut all = [north?, east?, down?];
    // A node is unknown only if all components are 0, because one component may be 0 at a known node.
    let unknown: Vec<usize> = (0..all[0].len()).filter(|node| all.iter().all(|a| a.get(*node) == Some(&0.0))).collect();
    let chosen = match component {
        VectorComponent::North => 0,
        VectorComponent::East => 1,
        VectorComponent::Down => 2,
    };
    let mut values = std::mem::take(&mut all[chosen]);
    for node in unknown {
        if let Some(value) = values.get_mut(node) {
            *value = f64::NAN;
        }
    }
    Ok((Some(component), values))
}

/// The values of an array of the map's size.
fn of_shape(path: &Path, name: &str, array: MagnavArray, shape: [usize; 2]) -> Result<Vec<f64>, ReadError> {
    if array.shape == Some(shape) {
        return Ok(array.values);
    }
    let [n_lon, n_lat] = shape;
    let found = array.shape.map_or_else(
        || format!("an array of {} values", array.values.len()),
        |[lon, lat]| format!("{lon} longitudes and {lat} latitudes"),
    );
    let what = format!("must have the {n_lon} longitudes of `xx` and the {n_lat} latitudes of `yy`, not {found}");
    Err(ReadError::data(path, what).in_column(name))
}

/// The values of an array of one dimension.
fn vector(path: &Path, source: &dyn MagnavSource, name: &str) -> Result<Vec<f64>, ReadError> {
    let MagnavArray { shape, values } = source.array(name)?;
    match shape {
        Some([a, b]) if a == 1 || b == 1 => Ok(values),
        None if values.len() == 1 => Ok(values),
        _ => Err(ReadError::data(path, "must have one dimension").in_column(name)),
    }
}

/// Rejects coordinates that look like radians, unless the options confirm degrees. Coordinates look like radians if all
/// longitudes are within ±pi and all latitudes are within ±pi/2.
fn refuse_radians(path: &Path, options: &MapOptions, lon: &[f64], lat: &[f64]) -> Result<(), ReadError> {
    use std::f64::consts::{FRAC_PI_2, PI};
    let within = |x: &[f64], most: f64| x.iter().all(|x| x.abs() <= most * (1.0 + 1e-9));
    if options.epsg.is_some() || !within(lon, PI) || !within(lat, FRAC_PI_2) {
        return Ok(());
    }
    let what = "the coordinates look like radians: longitudes are within 0 ± 3.14, latitudes within 0 ± 1.57";
    let help = "set `epsg` = 4326 if they are degrees, otherwise convert the map in MagNav.jl: \
                `save_map(get_map(\"map.h5\"; file_units = :rad), \"map_deg.h5\")`";
    Err(ReadError::options(path, what).help(help))
}

//! Maps of MagNav.jl in HDF5: `map`, `xx` (longitude), `yy` (latitude), `alt`, optionally `mask`.
//!
//! Julia stores columns first, so its `map[yy, xx]` appears here with the longitudes first.

use std::path::Path;

use super::{
    FileHead, MapFormat, MapOptions,
    hdf5::{Hdf5Dataset, Hdf5Source},
    map_magnav_write,
};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft},
};
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "magnav_hdf5",
    about: "map of MagNav.jl in HDF5",
    extensions: &["h5", "hdf5"],
    recognise: |head: &FileHead| {
        let names = head.hdf5_names();
        ["map", "xx", "yy"].iter().all(|n| names.iter().any(|m| m == n))
    },
    companions: None,
    read,
    write: Some(map_magnav_write::write),
};

/// The note on every map of MagNav.jl.
pub(super) const NOTE: &str = "nodes of exactly 0 are unknown, as in MagNav.jl";

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let file = Hdf5Source::open(path)?;
    let (lon, lat) = (vector(&file, "xx")?, vector(&file, "yy")?);
    let map = file.need("map")?;
    let (x, y) = (FileAxis::from_coordinates(path, "lon", &lon)?, FileAxis::from_coordinates(path, "lat", &lat)?);
    let mut values = unknown_where_zero(transposed(&map, &lon, &lat)?);
    if file.has("mask") {
        let mask = transposed(&file.need("mask")?, &lon, &lat)?;
        values.iter_mut().zip(mask).filter(|(_, m)| *m == 0.0).for_each(|(v, _)| *v = f64::NAN);
    }
    let mut draft = MapDraft::new(path, x, y, values, FileCrs::Degrees);
    draft.notes.push(NOTE.to_owned());
    draft.notes.extend(file.notes());
    let alt = file.need("alt")?;
    if options.alt_m.is_some() {
        return draft.finish(options);
    }
    if alt.shape == map.shape {
        draft.heights = Some(transposed(&alt, &lon, &lat)?);
    } else if alt.shape.iter().product::<u64>() == 1 {
        draft.level_m = Some(alt.scalar()?);
    } else {
        return Err(alt.damaged("a map must have one level; extract one level into a file"));
    }
    draft.finish(options)
}

/// Replaces zeros by NaN; MagNav.jl has no other marker of unknown nodes.
pub(super) fn unknown_where_zero(mut values: Vec<f64>) -> Vec<f64> {
    values.iter_mut().filter(|v| **v == 0.0).for_each(|v| *v = f64::NAN);
    values
}

fn vector(file: &Hdf5Source, name: &str) -> Result<Vec<f64>, ReadError> {
    let set = file.need(name)?;
    if set.shape.len() > 1 { Err(set.damaged("must have one dimension")) } else { set.all() }
}

/// Values stored with the longitudes first, by rows of one latitude each.
fn transposed(set: &Hdf5Dataset, lon: &[f64], lat: &[f64]) -> Result<Vec<f64>, ReadError> {
    let (n_lon, n_lat) = (lon.len(), lat.len());
    if set.shape != [n_lon as u64, n_lat as u64] {
        let what = format!("must have the shape [{n_lon}, {n_lat}] of `xx` and `yy`, not {:?}", set.shape);
        return Err(set.damaged(&what));
    }
    let stored = set.all()?;
    Ok((0..n_lat).flat_map(|j| (0..n_lon).map(move |i| (i, j))).map(|(i, j)| stored[i * n_lat + j]).collect())
}

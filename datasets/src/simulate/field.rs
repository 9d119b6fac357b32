//! The earth's field along a track: the core field, and the anomaly of a real map at the height flown.

use std::path::Path;

use stages::numerics::{
    continuation::{Padding, masked_like, upward},
    fill::{SmoothFill, smooth},
    map_grid::{AnomalyMap, Interpolation, MapGrid},
};

use crate::{Map, ReadError};

/// Heights that differ by less are one, in metres.
const SAME_LEVEL_M: f64 = 0.5;

/// The anomaly at the height `alt_m`: the map itself at its own height, above it the map continued
/// upward.
///
/// # Errors
/// A map that is not level, or that lies higher than `alt_m`: continuing down would amplify its noise.
pub(super) fn anomaly_at(path: &Path, map: &Map, alt_m: f64) -> Result<AnomalyMap, ReadError> {
    let level_m = map.column("alt").first().copied().unwrap_or(f64::NAN);
    if map.column("alt").iter().any(|a| *a != level_m) {
        return Err(ReadError::data(path, "the simulation needs a map of one height").in_column("alt"));
    }
    let up_m = alt_m - level_m;
    if up_m < -SAME_LEVEL_M {
        let what = format!("the map is {level_m} m high, above the line's {alt_m} m");
        return Err(ReadError::options(path, what).help("fly at the map's height or above"));
    }
    let grid = MapGrid::new(&map.latitudes_deg(), &map.longitudes_deg(), map.column("anomaly"));
    let grid = grid.map_err(|e| ReadError::data(path, e.to_string()))?;
    let grid = if up_m > SAME_LEVEL_M { continued(path, &grid, up_m)? } else { grid };
    Ok(AnomalyMap::new(&grid, Interpolation::Cubic))
}

/// A map continued upward by `up_m` metres; what was unknown stays unknown.
fn continued(path: &Path, grid: &MapGrid, up_m: f64) -> Result<MapGrid, ReadError> {
    let wrong = |e: &dyn std::fmt::Display| ReadError::data(path, e.to_string());
    let plane = grid.plane();
    let full = match plane.unknown() {
        0 => plane.clone(),
        _ => smooth(&plane, &SmoothFill::default()).map_err(|e| wrong(&e))?.0,
    };
    let up = upward(&full, up_m, &Padding::default()).map_err(|e| wrong(&e))?;
    grid.with_values(masked_like(up, &plane).values).map_err(|e| wrong(&e))
}

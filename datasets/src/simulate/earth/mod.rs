//! The earth's field along a track: the core field, and the anomaly of a real map at the height flown.

use std::path::Path;

use nalgebra::Vector3;
use stages::numerics::{
    continuation::{Padding, masked_like, upward},
    core_field::CoreField,
    dates::decimal_year,
    fill::{SmoothFill, smooth},
    map_grid::{AnomalyMap, Interpolation, MapGrid},
};

use super::{line::Scene, trajectory::Trajectory};
use crate::{Map, ReadError};
pub use spec::Earth;

pub(super) mod spec;

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

/// The earth's field along a line, in nT.
pub(super) struct Along {
    /// The magnitude of the core field.
    pub(super) core_nt: Vec<f64>,
    /// The temporal variation.
    pub(super) diurnal_nt: Vec<f64>,
    /// The whole field in the body frame.
    pub(super) body_nt: Vec<Vector3<f64>>,
}

/// The earth's field: core plus anomaly and diurnal variation along the core's direction, so that its
/// magnitude is their exact sum. The core field is that of the line's first sample in time.
///
/// # Errors
/// A line that leaves the known map.
pub(super) fn along(scene: &Scene, truth: &Trajectory, anomaly: &AnomalyMap) -> Result<Along, ReadError> {
    let (year, doy) = scene.spec.date;
    let date = decimal_year(year, doy, scene.line.start_tt_s).map_err(|e| scene.fault(e.to_string()))?;
    let core = CoreField::at(date).map_err(|e| scene.fault(e.to_string()))?;
    let mut random = scene.random("diurnal");
    let diurnal = scene.spec.earth.diurnal.map(|d| d.realisation(&truth.tt_s, || random.normal()));
    let diurnal_nt = diurnal.unwrap_or_else(|| vec![0.0; truth.tt_s.len()]);
    let mut earth = Along { core_nt: vec![], diurnal_nt, body_nt: vec![] };
    for i in 0..truth.tt_s.len() {
        let (lat, lon) = (truth.lat_deg[i], truth.lon_deg[i]);
        let local = anomaly.at(lat, lon).ok_or_else(|| {
            let since = truth.tt_s[i] - scene.line.start_tt_s;
            scene
                .fault(format!("leaves the known map after {since:.1} s, at {lat:.5}, {lon:.5}"))
                .help("move the waypoints inwards or shorten the line")
        })?;
        let core = Vector3::from(core.field_ned_nt(lat, lon, truth.alt_m[i]));
        let total = core.norm() + local.value_nt + earth.diurnal_nt[i];
        earth.core_nt.push(core.norm());
        earth.body_nt.push(truth.attitude(i).transpose() * (core.normalize() * total));
    }
    Ok(earth)
}

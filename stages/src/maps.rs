//! A map as stages look it up: at its own height, or continued to the heights flown.

use arrow_array::RecordBatch;
use schemas::{Fault, map::OwnGrid};

use crate::{
    columns::{data, floats},
    numerics::{
        continuation::{Derivative, MAGNAV_ALPHA_M2, Padding, Spectrum, masked_like},
        fill,
        grid_projection::{Area, GridProjection},
        map_grid::{AnomalyMap, Interpolation, MapGrid, VerticalDerivative},
        map_stack::{FieldMap, MapStack, ProjectedMap, StackOptions},
        plane_grid::{EvenAxis, PlaneGrid},
    },
    projection::Projection,
};

/// The interpolation that a parameter names.
pub fn interpolation(word: &str) -> Interpolation {
    if word == "cubic" { Interpolation::Cubic } else { Interpolation::Linear }
}

/// The map of a table: as it is, or with `levels_m` continued to these heights (metres above the ellipsoid, ascending)
/// and interpolated between them, value and slopes in all three directions. A table of the map's own grid
/// ([`OwnGrid`]) is looked up between the nodes of that.
///
/// # Errors
/// A table that is no grid; a coordinate system that cannot be used; levels of a map that is draped or whose height is
/// unknown, and levels that do not ascend.
pub fn field_map(
    table: &RecordBatch,
    interpolation: Interpolation,
    levels_m: Option<&[f64]>,
) -> Result<FieldMap, Fault> {
    let anomaly = floats(table, "anomaly")?;
    let Some(own) = OwnGrid::of(&table.schema())? else {
        let grid = MapGrid::from_rows(floats(table, "lat")?, floats(table, "lon")?, anomaly).map_err(data)?;
        return Ok(match looked_up(table, &grid, || grid.plane(), interpolation, levels_m)? {
            Looked::Flat(map) => FieldMap::Flat(map),
            Looked::Stack(stack) => FieldMap::Stack(stack),
        });
    };
    let [columns, rows] = own_axes(table)?;
    let grid = MapGrid::of_nodes(rows.len, columns.len, anomaly).map_err(data)?;
    let projection = projected(&own, &rows, &columns)?;
    let in_metres = |axis: &EvenAxis, unit_m: f64| EvenAxis { first: 0.0, step: axis.step * unit_m, len: axis.len };
    let plane = || PlaneGrid {
        east_m: in_metres(&columns, own.unit_m[0]),
        north_m: in_metres(&rows, own.unit_m[1]),
        values: anomaly.to_vec(),
    };
    Ok(FieldMap::Projected(Box::new(match looked_up(table, &grid, plane, interpolation, levels_m)? {
        Looked::Flat(map) => ProjectedMap::flat(projection, map),
        Looked::Stack(stack) => ProjectedMap::stack(projection, stack),
    })))
}

/// A map at one height, or at several.
enum Looked {
    Flat(AnomalyMap),
    Stack(MapStack),
}

fn looked_up(
    table: &RecordBatch,
    grid: &MapGrid,
    plane: impl Fn() -> PlaneGrid,
    interpolation: Interpolation,
    levels_m: Option<&[f64]>,
) -> Result<Looked, Fault> {
    let Some(levels_m) = levels_m else { return Ok(Looked::Flat(AnomalyMap::new(grid, interpolation))) };
    let up_m = above(table, levels_m)?;
    let (maps, slopes) = continued(grid, &plane(), &up_m)?;
    match maps.as_slice() {
        [only] => {
            let vertical = VerticalDerivative { d_alt_nt_per_m: &slopes[0], alt_m: levels_m[0] };
            AnomalyMap::with_vertical(only, vertical, interpolation).map(Looked::Flat).map_err(data)
        }
        _ => {
            let options = StackOptions { interpolation, ..StackOptions::default() };
            MapStack::with_vertical(levels_m, &maps, &slopes, options).map(Looked::Stack).map_err(data)
        }
    }
}

/// The axes of a map on its own grid, eastward and northward, from its rows.
fn own_axes(table: &RecordBatch) -> Result<[EvenAxis; 2], Fault> {
    let (northing, easting) = (floats(table, "northing")?, floats(table, "easting")?);
    let width = northing.iter().take_while(|y| Some(*y) == northing.first()).count();
    let height = northing.len().checked_div(width).unwrap_or(0);
    let axis = |values: &[f64], last: usize, len: usize, name: &str| match (values.first(), values.get(last)) {
        (Some(first), Some(last)) if len > 1 && last > first => {
            Ok(EvenAxis { first: *first, step: (last - first) / (len - 1) as f64, len })
        }
        _ => Err(Fault::data("a map takes at least two rows and two columns that ascend").in_column(name)),
    };
    if width * height != northing.len() || easting.len() != northing.len() {
        return Err(Fault::data("the rows of the map are no complete grid").in_column("northing"));
    }
    Ok([
        axis(easting, width.saturating_sub(1), width, "easting")?,
        axis(northing, northing.len().saturating_sub(1), height, "northing")?,
    ])
}

/// Where latitudes and longitudes are on a map's own grid.
fn projected(own: &OwnGrid, rows: &EvenAxis, columns: &EvenAxis) -> Result<GridProjection, Fault> {
    let system = Projection::new(&own.definition)
        .map_err(|e| Fault::data(format!("the map's coordinate system EPSG:{} cannot be used: {e}", own.epsg)))?;
    let middle_deg = 0.5 * (columns.first + columns.last());
    let project = |lat: f64, lon: f64| {
        let (easting, northing) = system.project(lat, lon)?;
        // Longitudes of another datum go on beyond 180 as the map's do.
        let rounds = if system.is_geographic() { ((middle_deg - easting) / 360.0).round() } else { 0.0 };
        Some((easting + 360.0 * rounds, northing))
    };
    let area = Area { lat_deg: own.lat_deg, lon_deg: own.lon_deg };
    GridProjection::new(project, area, rows, columns).map_err(|e| {
        let help = "bring the map to a UTM zone or to latitude and longitude with `magline map convert`";
        data(e).help(help)
    })
}

/// How far the levels are above the map.
fn above(table: &RecordBatch, levels_m: &[f64]) -> Result<Vec<f64>, Fault> {
    let alt = floats(table, "alt")?;
    let level = alt.first().copied().unwrap_or(f64::NAN);
    if alt.iter().any(|a| *a != level) {
        let what = "a map is continued from one height, but this one has several, or none";
        return Err(Fault::data(what).in_column("alt").help(
            "say its height with `alt_m`, or bring a draped map onto a level with `magline map continue` first",
        ));
    }
    Ok(levels_m.iter().map(|to| to - level).collect())
}

/// The map at each height above itself, and its vertical derivative there.
fn continued(grid: &MapGrid, plane: &PlaneGrid, up_m: &[f64]) -> Result<(Vec<MapGrid>, Vec<Vec<f64>>), Fault> {
    let full = if plane.unknown() > 0 {
        fill::smooth(plane, &fill::SmoothFill::default()).map_err(data)?.0
    } else {
        plane.clone()
    };
    let furthest = up_m.iter().fold(0.0_f64, |most, up| most.max(up.abs()));
    let spectrum = Spectrum::new(&full, furthest, &Padding::default()).map_err(data)?;
    drop(full);
    let (mut maps, mut slopes) = (vec![], vec![]);
    for up in up_m {
        let level = masked_like(spectrum.at_height(*up, MAGNAV_ALPHA_M2).map_err(data)?, plane);
        maps.push(grid.with_values(level.values).map_err(data)?);
        slopes.push(spectrum.derivative(Derivative::Up, *up, MAGNAV_ALPHA_M2).map_err(data)?.values);
    }
    Ok((maps, slopes))
}

/// What is wrong with a parameter that lists heights.
pub fn check_levels(levels_m: Option<&Vec<f64>>, param: &str) -> Option<Fault> {
    let levels = levels_m?;
    if levels.is_empty() || levels.windows(2).any(|pair| pair[1] <= pair[0]) {
        return Some(Fault::new("the heights must be one or more numbers that ascend").of_param(param));
    }
    None
}

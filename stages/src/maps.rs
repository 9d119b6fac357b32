//! Maps in the form that stages interpolate: at the height of the map, or continued to the heights flown.

use arrow_array::RecordBatch;
use numerics::maps::{
    continuation::{MAGNAV_ALPHA_M2, MapDerivative, MapSpectrum, Padding, masked_like},
    fill,
    grid_projection::{GeographicArea, GridProjection},
    map_stack::{FieldMap, MapStack, ProjectedMap, StackOptions},
    map_surface::{GeographicGrid, MapInterpolation, MapSurface, VerticalDerivative},
    plane_grid::{EvenAxis, PlaneGrid},
    projection::Projection,
};
use schemas::{Fault, map::NativeGrid};

use crate::columns::{data, floats};

/// Map of a table, unchanged or continued to the heights `levels_m` (metres above the WGS-84 ellipsoid, ascending). The
/// value and all three slopes are interpolated between these heights. A table with a native grid ([`NativeGrid`]) is
/// interpolated on that grid.
///
/// # Errors
/// Fails if the table is not a grid, the coordinate system cannot be used, or the levels do not ascend. Fails if levels
/// are given for a map that is draped or whose height is unknown.
pub fn field_map(
    table: &RecordBatch,
    interpolation: MapInterpolation,
    levels_m: Option<&[f64]>,
) -> Result<FieldMap, Fault> {
    column_map(table, "anomaly", interpolation, levels_m)
}

/// The same as [`field_map`] for another column of a map, such as the error of each node.
///
/// # Errors
/// Fails in the cases of [`field_map`]. Fails if the table has no such column.
pub fn column_map(
    table: &RecordBatch,
    column: &str,
    interpolation: MapInterpolation,
    levels_m: Option<&[f64]>,
) -> Result<FieldMap, Fault> {
    map_of_values(table, floats(table, column)?, interpolation, levels_m)
}

/// Same as [`column_map`] for given values, one for each row of the table.
///
/// # Errors
/// Fails in the cases of [`field_map`].
pub fn map_of_values(
    table: &RecordBatch,
    values: &[f64],
    interpolation: MapInterpolation,
    levels_m: Option<&[f64]>,
) -> Result<FieldMap, Fault> {
    let Some(own) = NativeGrid::from_schema(&table.schema())? else {
        let grid = GeographicGrid::from_rows(floats(table, "lat")?, floats(table, "lon")?, values).map_err(data)?;
        return Ok(match looked_up(table, &grid, || grid.plane(), interpolation, levels_m)? {
            MapInterpolant::Flat(map) => FieldMap::Flat(map),
            MapInterpolant::Stack(stack) => FieldMap::Stack(stack),
        });
    };
    let [columns, rows] = own_axes(table)?;
    let grid = GeographicGrid::of_nodes(rows.len, columns.len, values).map_err(data)?;
    let projection = projected(&own, &rows, &columns)?;
    let plane = || own_plane(&own, &rows, &columns, values);
    Ok(FieldMap::Projected(Box::new(match looked_up(table, &grid, plane, interpolation, levels_m)? {
        MapInterpolant::Flat(map) => ProjectedMap::flat(projection, map),
        MapInterpolant::Stack(stack) => ProjectedMap::stack(projection, stack),
    })))
}

/// Map of a table on a plane, in metres from its south-west corner.
///
/// # Errors
/// Fails if the table is not a grid.
pub fn plane(table: &RecordBatch) -> Result<PlaneGrid, Fault> {
    let anomaly = floats(table, "anomaly")?;
    let Some(own) = NativeGrid::from_schema(&table.schema())? else {
        let grid = GeographicGrid::from_rows(floats(table, "lat")?, floats(table, "lon")?, anomaly);
        return Ok(grid.map_err(data)?.plane());
    };
    let [columns, rows] = own_axes(table)?;
    Ok(own_plane(&own, &rows, &columns, anomaly))
}

fn own_plane(own: &NativeGrid, rows: &EvenAxis, columns: &EvenAxis, anomaly: &[f64]) -> PlaneGrid {
    let in_metres = |axis: &EvenAxis, unit_m: f64| EvenAxis { first: 0.0, step: axis.step * unit_m, len: axis.len };
    PlaneGrid {
        east_m: in_metres(columns, own.unit_m[0]),
        north_m: in_metres(rows, own.unit_m[1]),
        values: anomaly.to_vec(),
    }
}

/// Map at one height, or at several.
enum MapInterpolant {
    Flat(MapSurface),
    Stack(MapStack),
}

fn looked_up(
    table: &RecordBatch,
    grid: &GeographicGrid,
    plane: impl Fn() -> PlaneGrid,
    interpolation: MapInterpolation,
    levels_m: Option<&[f64]>,
) -> Result<MapInterpolant, Fault> {
    let Some(levels_m) = levels_m else { return Ok(MapInterpolant::Flat(MapSurface::new(grid, interpolation))) };
    let up_m = above(table, levels_m)?;
    let (maps, slopes) = continued(grid, &plane(), &up_m)?;
    match maps.as_slice() {
        [only] => {
            let vertical = VerticalDerivative { d_alt_nt_per_m: &slopes[0], alt_m: levels_m[0] };
            MapSurface::with_vertical(only, vertical, interpolation).map(MapInterpolant::Flat).map_err(data)
        }
        _ => {
            let options = StackOptions { interpolation, ..StackOptions::default() };
            MapStack::with_vertical(levels_m, &maps, &slopes, options).map(MapInterpolant::Stack).map_err(data)
        }
    }
}

/// Eastward and northward axes of a map's native grid, computed from the rows of the map.
fn own_axes(table: &RecordBatch) -> Result<[EvenAxis; 2], Fault> {
    let (northing, easting) = (floats(table, "northing")?, floats(table, "easting")?);
    let width = northing.iter().take_while(|y| Some(*y) == northing.first()).count();
    let height = northing.len().checked_div(width).unwrap_or(0);
    let axis = |values: &[f64], last: usize, len: usize, name: &str| match (values.first(), values.get(last)) {
        (Some(first), Some(last)) if len > 1 && last > first => {
            Ok(EvenAxis { first: *first, step: (last - first) / (len - 1) as f64, len })
        }
        _ => Err(Fault::data("a map requires at least two rows and two columns, in ascending order").in_column(name)),
    };
    if width * height != northing.len() || easting.len() != northing.len() {
        return Err(Fault::data("the rows of the map are not a complete grid").in_column("northing"));
    }
    Ok([
        axis(easting, width.saturating_sub(1), width, "easting")?,
        axis(northing, northing.len().saturating_sub(1), height, "northing")?,
    ])
}

/// Projection of latitudes and longitudes onto a native grid.
fn projected(own: &NativeGrid, rows: &EvenAxis, columns: &EvenAxis) -> Result<GridProjection, Fault> {
    let system = Projection::new(&own.definition)
        .map_err(|e| Fault::data(format!("the map's coordinate system EPSG:{} cannot be used: {e}", own.epsg)))?;
    let middle_deg = 0.5 * (columns.first + columns.last());
    let project = |lat: f64, lon: f64| {
        let (easting, northing) = system.project(lat, lon)?;
        // Longitudes in another datum are shifted by multiples of 360 degrees if the map continues beyond 180 degrees.
        let rounds = if system.is_geographic() { ((middle_deg - easting) / 360.0).round() } else { 0.0 };
        Some((easting + 360.0 * rounds, northing))
    };
    let area = GeographicArea { lat_deg: own.lat_deg, lon_deg: own.lon_deg };
    GridProjection::new(project, area, rows, columns).map_err(|e| {
        let help = "convert the map to a UTM zone or to latitude and longitude with `magline map convert`";
        data(e).help(help)
    })
}

/// Heights of the levels above the map, in metres.
fn above(table: &RecordBatch, levels_m: &[f64]) -> Result<Vec<f64>, Fault> {
    let alt = floats(table, "alt")?;
    let level = alt.first().copied().unwrap_or(f64::NAN);
    if alt.iter().any(|a| *a != level) {
        let what = "continuation requires a map with one height, but this map has several or none";
        return Err(Fault::data(what)
            .in_column("alt")
            .help("set `alt_m` of the map, or continue a draped map to a level first with `magline map continue`"));
    }
    Ok(levels_m.iter().map(|to| to - level).collect())
}

/// Map continued upward by each height, and its vertical derivative there.
fn continued(
    grid: &GeographicGrid,
    plane: &PlaneGrid,
    up_m: &[f64],
) -> Result<(Vec<GeographicGrid>, Vec<Vec<f64>>), Fault> {
    let full = if plane.unknown() > 0 {
        fill::smooth(plane, &fill::SmoothFill::default()).map_err(data)?.0
    } else {
        plane.clone()
    };
    let furthest = up_m.iter().fold(0.0_f64, |most, up| most.max(up.abs()));
    let spectrum = MapSpectrum::new(&full, furthest, &Padding::default()).map_err(data)?;
    drop(full);
    let (mut maps, mut slopes) = (vec![], vec![]);
    for up in up_m {
        let level = masked_like(spectrum.at_height(*up, MAGNAV_ALPHA_M2).map_err(data)?, plane);
        maps.push(grid.with_values(level.values).map_err(data)?);
        slopes.push(spectrum.derivative(MapDerivative::Up, *up, MAGNAV_ALPHA_M2).map_err(data)?.values);
    }
    Ok((maps, slopes))
}

/// Fault of a parameter that lists heights.
pub fn check_levels(levels_m: Option<&Vec<f64>>, param: &str) -> Option<Fault> {
    let levels = levels_m?;
    if levels.is_empty() || levels.windows(2).any(|pair| pair[1] <= pair[0]) {
        return Some(Fault::new("the heights must be one or more numbers in ascending order").of_param(param));
    }
    None
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array};
    use arrow_schema::Schema;

    use super::*;

    const STEP_M: f64 = 250.0;
    const UTM: &str = "+proj=utm +zone=54 +south +datum=WGS84 +units=m +no_defs";
    const ALT_M: f64 = 500.0;

    fn axis(first: f64, len: usize) -> EvenAxis {
        EvenAxis { first, step: STEP_M, len }
    }

    fn axes() -> [EvenAxis; 2] {
        [axis(448_000.0, 61), axis(7_560_000.0, 41)]
    }

    /// A map of 15 by 10 km in UTM zone 54 south with the values of `of` (easting, northing).
    fn table(of: impl Fn(f64, f64) -> f64) -> RecordBatch {
        let [columns, rows] = axes();
        let nodes: Vec<(f64, f64)> =
            rows.coordinates().iter().flat_map(|y| columns.coordinates().into_iter().map(|x| (x, *y))).collect();
        let own = NativeGrid {
            epsg: 32754,
            definition: UTM.to_owned(),
            unit_m: [1.0, 1.0],
            lat_deg: [-22.1, -21.9],
            lon_deg: [140.4, 140.7],
        };
        let column = |of: &dyn Fn(&(f64, f64)) -> f64| -> ArrayRef {
            Arc::new(nodes.iter().map(of).map(Some).collect::<Float64Array>())
        };
        let columns = vec![column(&|n| n.1), column(&|n| n.0), column(&|_| ALT_M), column(&|n| of(n.0, n.1))];
        RecordBatch::try_new(Arc::new(Schema::new(own.fields())), columns).unwrap()
    }

    fn hills(easting: f64, northing: f64) -> f64 {
        300.0 * (easting / 900.0).sin() * (northing / 700.0).cos() + 0.01 * (easting - 448_000.0)
    }

    /// Positions on the map in degrees, away from grid lines.
    fn places() -> Vec<(f64, f64)> {
        let system = Projection::new(UTM).unwrap();
        let [columns, rows] = axes();
        let at = |(x, y): (f64, f64)| system.unproject(columns.at(x), rows.at(y)).unwrap();
        [(0.3, 0.4), (7.7, 31.2), (30.4, 20.6), (59.8, 39.7), (12.21, 3.65)].map(at).to_vec()
    }

    #[test]
    fn law_a_projected_map_is_bilinear_on_its_native_grid() {
        // Bilinear in easting and northing, so the values between nodes are known.
        let plane =
            |x: f64, y: f64| 3.0 + 0.02 * (x - 450_000.0) - 0.05 * (y - 7.56e6) + 1e-6 * (x - 4.5e5) * (y - 7.56e6);
        let map = field_map(&table(plane), MapInterpolation::Linear, None).unwrap();
        let system = Projection::new(UTM).unwrap();
        let [columns, rows] = axes();
        let corners = [(0.0, 0.0), (60.0, 0.0), (0.0, 40.0), (60.0, 40.0), (60.0, 17.5), (22.5, 40.0)];
        let edge = corners.map(|(x, y)| system.unproject(columns.at(x), rows.at(y)).unwrap());
        for (lat, lon) in places().into_iter().chain(edge) {
            let (easting, northing) = system.project(lat, lon).unwrap();
            let found = map.at(lat, lon, ALT_M).unwrap();
            // Northings of 7.6e6 m are rounded by 1e-9 m, at 0.05 nT/m.
            assert!((found.value_nt - plane(easting, northing)).abs() < 1e-9, "{lat} {lon}: {found:?}");
            let turned = map.at(lat, lon - 360.0, ALT_M).unwrap();
            assert!((turned.value_nt - found.value_nt).abs() < 1e-6, "{turned:?} {found:?}");
        }
        for (x, y) in [(-0.01, 20.0), (60.01, 20.0), (30.0, -0.01), (30.0, 40.01), (-359.5, 20.0), (400.0, 20.0)] {
            let (lat, lon) = system.unproject(columns.at(x), rows.at(y)).unwrap();
            assert!(map.at(lat, lon, ALT_M).is_none(), "off the map at column {x}, row {y}");
        }
        assert!(map.at(f64::NAN, 140.5, ALT_M).is_none());
    }

    #[test]
    fn jac_slopes_of_a_projected_map_agree_with_differences() {
        for interpolation in [MapInterpolation::Linear, MapInterpolation::Cubic] {
            for levels in [None, Some(&[ALT_M, ALT_M + 40.0][..])] {
                let map = field_map(&table(hills), interpolation, levels).unwrap();
                for (lat, lon) in places() {
                    let alt_m = ALT_M + 13.0;
                    let at = |d_lat: f64, d_lon: f64, d_alt: f64| {
                        map.at(lat + d_lat, lon + d_lon, alt_m + d_alt).unwrap().value_nt
                    };
                    let found = map.at(lat, lon, alt_m).unwrap();
                    // With a step of 1 cm, rounding of 300 nT causes an error of 1e-12 nT/m; the third derivative
                    // contributes less.
                    let h: f64 = 1e-7;
                    let per_rad = (2.0 * h).to_radians();
                    let lat_slope = (at(h, 0.0, 0.0) - at(-h, 0.0, 0.0)) / per_rad;
                    let lon_slope = (at(0.0, h, 0.0) - at(0.0, -h, 0.0)) / per_rad;
                    let alt_slope = (at(0.0, 0.0, 0.01) - at(0.0, 0.0, -0.01)) / 0.02;
                    // Slopes of 0.4 nT/m, 2.5e6 nT/rad; the position is rounded by 1e-9 m.
                    assert!((found.d_lat_nt_per_rad - lat_slope).abs() < 2.0, "{found:?} {lat_slope}");
                    assert!((found.d_lon_nt_per_rad - lon_slope).abs() < 2.0, "{found:?} {lon_slope}");
                    assert!((found.d_alt_nt_per_m - alt_slope).abs() < 1e-6, "{found:?} {alt_slope}");
                }
            }
        }
    }

    #[test]
    fn unit_many_positions_give_the_same_values_as_single_ones() {
        let map = field_map(&table(hills), MapInterpolation::Cubic, None).unwrap();
        let (lat, lon): (Vec<f64>, Vec<f64>) = places().into_iter().chain([(0.0, 0.0)]).unzip();
        let mut many = numerics::maps::map_surface::FieldColumns::default();
        map.at_many(&lat, &lon, &vec![ALT_M; lat.len()], &mut many).unwrap();
        for i in 0..lat.len() {
            match map.at(lat[i], lon[i], ALT_M) {
                Some(one) => {
                    assert_eq!((one.value_nt, one.d_lat_nt_per_rad), (many.value_nt[i], many.d_lat_nt_per_rad[i]))
                }
                None => assert!(many.value_nt[i].is_nan() && i + 1 == lat.len()),
            }
        }
    }

    #[test]
    fn gold_invalid_native_grids_are_rejected() {
        let whole = table(hills);
        let cut = whole.slice(0, whole.num_rows() - 1);
        let fault = field_map(&cut, MapInterpolation::Linear, None).unwrap_err().to_string();
        assert_eq!(fault, "column `northing`: the rows of the map are not a complete grid");
        let one_row = whole.slice(0, 61);
        let fault = field_map(&one_row, MapInterpolation::Linear, None).unwrap_err().to_string();
        assert!(fault.contains("at least two"), "{fault}");
    }
}

//! A map as stages look it up: at its own height, or continued to the heights flown.

use arrow_array::RecordBatch;
use schemas::Fault;

use crate::{
    columns::{data, floats},
    numerics::{
        continuation::{Derivative, MAGNAV_ALPHA_M2, Padding, Spectrum, masked_like},
        fill,
        map_grid::{AnomalyMap, Interpolation, MapGrid, VerticalDerivative},
        map_stack::{FieldMap, MapStack, StackOptions},
    },
};

/// The interpolation that a parameter names.
pub fn interpolation(word: &str) -> Interpolation {
    if word == "cubic" { Interpolation::Cubic } else { Interpolation::Linear }
}

/// The map of a table: as it is, or with `levels_m` continued to these heights (metres above the ellipsoid, ascending)
/// and interpolated between them, value and slopes in all three directions.
///
/// # Errors
/// A table that is no grid; levels of a map that is draped or whose height is unknown, and levels that do not ascend.
pub fn field_map(
    table: &RecordBatch,
    interpolation: Interpolation,
    levels_m: Option<&[f64]>,
) -> Result<FieldMap, Fault> {
    let grid = MapGrid::from_rows(floats(table, "lat")?, floats(table, "lon")?, floats(table, "anomaly")?);
    let grid = grid.map_err(data)?;
    let Some(levels_m) = levels_m else { return Ok(FieldMap::Flat(AnomalyMap::new(&grid, interpolation))) };
    let up_m = above(table, levels_m)?;
    let (maps, slopes) = continued(&grid, &up_m)?;
    match maps.as_slice() {
        [only] => AnomalyMap::with_vertical(
            only,
            VerticalDerivative { d_alt_nt_per_m: &slopes[0], alt_m: levels_m[0] },
            interpolation,
        )
        .map(FieldMap::Flat)
        .map_err(data),
        _ => {
            let options = StackOptions { interpolation, ..StackOptions::default() };
            MapStack::with_vertical(levels_m, &maps, &slopes, options).map(FieldMap::Stack).map_err(data)
        }
    }
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
fn continued(grid: &MapGrid, up_m: &[f64]) -> Result<(Vec<MapGrid>, Vec<Vec<f64>>), Fault> {
    let plane = grid.plane();
    let full = if plane.unknown() > 0 {
        fill::smooth(&plane, &fill::SmoothFill::default()).map_err(data)?.0
    } else {
        plane.clone()
    };
    let furthest = up_m.iter().fold(0.0_f64, |most, up| most.max(up.abs()));
    let spectrum = Spectrum::new(&full, furthest, &Padding::default()).map_err(data)?;
    drop(full);
    let (mut maps, mut slopes) = (vec![], vec![]);
    for up in up_m {
        let level = masked_like(spectrum.at_height(*up, MAGNAV_ALPHA_M2).map_err(data)?, &plane);
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

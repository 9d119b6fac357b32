//! Crops a map to its known nodes or to limits.

use super::{FillError, check};
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
use std::ops::Range;

/// Limits of a map on the plane, in metres; a side without a limit is infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapLimits {
    /// The smallest and the largest easting.
    pub east_m: (f64, f64),
    /// The smallest and the largest northing.
    pub north_m: (f64, f64),
}

impl Default for MapLimits {
    fn default() -> Self {
        let all = (f64::NEG_INFINITY, f64::INFINITY);
        Self { east_m: all, north_m: all }
    }
}

/// Smallest map that contains every known node, plus up to `pad` rows and columns on each side, within the extent of
/// the map.
///
/// # Errors
/// Fails if no node is known or the map is invalid.
pub fn trim(grid: &PlaneGrid, pad: usize) -> Result<PlaneGrid, FillError> {
    check(grid)?;
    let (rows, columns) = bounding_box(grid, |value| !value.is_nan()).ok_or(FillError::Empty)?;
    let padded =
        |range: Range<usize>, len: usize| range.start.saturating_sub(pad)..range.end.saturating_add(pad).min(len);
    Ok(cut(grid, padded(rows, grid.rows()), padded(columns, grid.columns())))
}

/// The rows and the columns that contain all matching values; `None` if no value matches.
pub(super) fn bounding_box(grid: &PlaneGrid, kind: impl Fn(&f64) -> bool) -> Option<(Range<usize>, Range<usize>)> {
    let mut found: Option<(Range<usize>, Range<usize>)> = None;
    for (row, values) in grid.values.chunks_exact(grid.columns()).enumerate() {
        if let Some((first, last)) = values.iter().position(&kind).zip(values.iter().rposition(&kind)) {
            let (rows, columns) = found.unwrap_or((row..row, first..last));
            found = Some((rows.start..row + 1, columns.start.min(first)..columns.end.max(last + 1)));
        }
    }
    found
}

/// Nodes of a map within or on the limits.
///
/// # Errors
/// Fails if no node lies within the limits or the map is invalid.
pub fn crop(grid: &PlaneGrid, limits: &MapLimits) -> Result<PlaneGrid, FillError> {
    check(grid)?;
    let (rows, columns) = (within(&grid.north_m, limits.north_m), within(&grid.east_m, limits.east_m));
    if rows.is_empty() || columns.is_empty() {
        let (west_m, east_m) = (grid.east_m.first, grid.east_m.last());
        let (south_m, north_m) = (grid.north_m.first, grid.north_m.last());
        return Err(FillError::Outside { west_m, east_m, south_m, north_m });
    }
    Ok(cut(grid, rows, columns))
}

/// The nodes of an axis from the first limit to the second.
fn within(axis: &EvenAxis, (least, greatest): (f64, f64)) -> Range<usize> {
    // Rounding may shift a computed limit slightly past its node.
    const ROUNDING: f64 = 1e-6;
    if least.is_nan() || greatest.is_nan() {
        return 0..0;
    }
    // The cast clamps infinite and negative limits to the axis.
    let start = (axis.node(least) - ROUNDING).ceil() as usize;
    let last = (axis.node(greatest) + ROUNDING).floor();
    start..if last < 0.0 { 0 } else { (last as usize).saturating_add(1).min(axis.len) }
}

fn cut(grid: &PlaneGrid, rows: Range<usize>, columns: Range<usize>) -> PlaneGrid {
    let part = |axis: &EvenAxis, nodes: &Range<usize>| EvenAxis {
        first: axis.at(nodes.start as f64),
        step: axis.step,
        len: nodes.len(),
    };
    let (east_m, north_m) = (part(&grid.east_m, &columns), part(&grid.north_m, &rows));
    let width = grid.columns();
    let values = rows.flat_map(|row| &grid.values[row * width..][columns.clone()]).copied().collect();
    PlaneGrid { east_m, north_m, values }
}

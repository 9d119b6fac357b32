//! Fills the gaps of a map on a plane, and crops it to its known nodes or to limits.
//!
//! [`nearest()`] gives an unknown node the mean of its nearest known nodes, as in MagNav.jl. This method is fast, and
//! its values are within the range of the known values. However, the result has steps inside a gap, which cause ringing
//! when the map is continued. [`smooth()`] computes the surface without sources inside the gap. This surface is
//! continuous, and its values are within the range of the values around the gap.

mod cut;
mod edge;
mod multigrid;
mod nearest;
mod smooth;

pub use cut::{MapLimits, crop, trim};
pub use nearest::{NearestFill, NeighbourWeights, nearest};
pub use smooth::{SmoothFill, SmoothFillReport, smooth};
use thiserror::Error;

use crate::maps::plane_grid::PlaneGrid;

/// Error when a map is filled or cropped.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FillError {
    /// No node is known.
    #[error("every value of the map is unknown, so its gaps cannot be filled")]
    Empty,
    /// The number of values is not the number of nodes.
    #[error("the map has {values} values for {rows} rows x {columns} columns")]
    Size {
        /// The number of values.
        values: usize,
        /// The number of rows.
        rows: usize,
        /// The number of columns.
        columns: usize,
    },
    /// A step is not above zero or not finite.
    #[error("the map's steps are {east_m} m east and {north_m} m north; both must be above zero")]
    Step {
        /// The step eastward.
        east_m: f64,
        /// The step northward.
        north_m: f64,
    },
    /// A value is infinite.
    #[error("the value in row {row}, column {column} of the map is infinite; use NaN for an unknown value")]
    Infinite {
        /// The row, from 0 in the south.
        row: usize,
        /// The column, from 0 in the west.
        column: usize,
    },
    /// The gaps are surrounded by more nodes than can be indexed.
    #[error("the gaps are surrounded by {nodes} known nodes, but the limit is 4 billion")]
    TooMany {
        /// The number of nodes.
        nodes: usize,
    },
    /// The number of neighbours is zero.
    #[error("filling a gap requires at least one neighbour")]
    NoNeighbours,
    /// A parameter is out of its valid range.
    #[error("{name} is {value}; it must be above zero")]
    Parameter {
        /// The parameter.
        name: &'static str,
        /// Value of the parameter.
        value: f64,
    },
    /// The iteration for the smooth surface did not converge.
    #[error(
        "the fill does not converge to {tolerance:e} of the map's range in {iterations} iterations; it reaches \
         {reached:e}"
    )]
    NotReached {
        /// The requested tolerance.
        tolerance: f64,
        /// The remaining error.
        reached: f64,
        /// The number of iterations.
        iterations: usize,
    },
    /// No node is within the limits.
    #[error(
        "no node of the map is within the limits; the map extends from {west_m} to {east_m} m east and from {south_m} \
         to {north_m} m north"
    )]
    Outside {
        /// The westernmost easting of the map.
        west_m: f64,
        /// The easternmost.
        east_m: f64,
        /// The southernmost northing.
        south_m: f64,
        /// The northernmost.
        north_m: f64,
    },
}

pub(super) fn check(grid: &PlaneGrid) -> Result<(), FillError> {
    let (rows, columns, values) = (grid.rows(), grid.columns(), grid.values.len());
    if rows.checked_mul(columns) != Some(values) {
        return Err(FillError::Size { values, rows, columns });
    }
    let (east_m, north_m) = (grid.east_m.step, grid.north_m.step);
    let good = |step: f64| step > 0.0 && step.is_finite();
    if !(good(east_m) && good(north_m)) {
        return Err(FillError::Step { east_m, north_m });
    }
    if let Some(node) = grid.values.iter().position(|value| value.is_infinite()) {
        return Err(FillError::Infinite { row: node / columns, column: node % columns });
    }
    if grid.values.iter().all(|value| value.is_nan()) { Err(FillError::Empty) } else { Ok(()) }
}

#[cfg(test)]
mod tests;

//! An anomaly map on a regular grid of latitude and longitude: value and exact gradient.
//!
//! Missing nodes are NaN. A place has a value when the four nodes of its cell are known, for both
//! interpolations; elsewhere, and off the map, there is none.

mod grid;
mod holes;

use super::field_value::FieldValue;
use super::natural_cubic::{slope_weights, solve, solve_along_rows, weights};
use grid::Axis;
pub use grid::{MapError, MapGrid};

/// How a value between the nodes is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// Bilinear: continuous, with a gradient that jumps from cell to cell.
    #[default]
    Linear,
    /// The natural cubic spline in both directions (MagNav.jl's `cubic`): value, gradient and
    /// curvature are continuous. The gaps of a map are filled from their edges before the spline
    /// is solved, so that a hole is felt in the cells next to it and dies out by a factor of 4 a
    /// cell.
    Cubic,
}

/// An anomaly map that can be looked up quickly.
#[derive(Clone, Debug)]
pub struct AnomalyMap {
    lat: Axis,
    lon: Axis,
    interpolation: Interpolation,
    /// Linear: the node values by rows. Cubic: the B-spline coefficients by rows, with one more
    /// row and column on each side.
    table: Vec<f64>,
    /// Cubic: which cells have an unknown node, by rows; empty where the map is complete.
    unknown_cells: Vec<bool>,
}

/// A cell of the map and the place in it.
#[derive(Clone, Copy)]
struct Cell {
    row: usize,
    column: usize,
    up: f64,
    right: f64,
}

impl AnomalyMap {
    /// Prepares a grid for look-ups.
    pub fn new(grid: &MapGrid, interpolation: Interpolation) -> Self {
        let (table, unknown_cells) = match interpolation {
            Interpolation::Linear => (grid.values().to_vec(), Vec::new()),
            Interpolation::Cubic => (spline_coefficients(grid), holes::unknown_cells(grid)),
        };
        Self { lat: *grid.lat(), lon: *grid.lon(), interpolation, table, unknown_cells }
    }

    /// The interpolation this map was prepared for.
    pub fn interpolation(&self) -> Interpolation {
        self.interpolation
    }

    /// The anomaly and its gradient at a place in degrees; `None` off the map, in a cell with an
    /// unknown node, or where the place is not a number. A longitude may differ from the map's by
    /// a full turn.
    #[inline]
    pub fn at(&self, lat_deg: f64, lon_deg: f64) -> Option<FieldValue> {
        let (row, up) = self.lat.locate(lat_deg)?;
        let (column, right) = self.lon.locate_turning(lon_deg)?;
        let cell = Cell { row, column, up, right };
        let (value_nt, per_row, per_column) = match self.interpolation {
            Interpolation::Linear => self.bilinear(cell)?,
            Interpolation::Cubic => self.bicubic(cell)?,
        };
        Some(FieldValue {
            value_nt,
            d_lat_nt_per_rad: per_row * self.lat.steps_per_rad(),
            d_lon_nt_per_rad: per_column * self.lon.steps_per_rad(),
            d_alt_nt_per_m: 0.0,
        })
    }

    /// Value and slopes per step of latitude and of longitude.
    #[inline]
    fn bilinear(&self, cell: Cell) -> Option<(f64, f64, f64)> {
        let width = self.lon.len();
        let low = self.table.get(cell.row * width + cell.column..)?.get(..2)?;
        let high = self.table.get((cell.row + 1) * width + cell.column..)?.get(..2)?;
        let (low_slope, high_slope) = (low[1] - low[0], high[1] - high[0]);
        let low_value = low[0] + cell.right * low_slope;
        let per_row = high[0] + cell.right * high_slope - low_value;
        let per_column = low_slope + cell.up * (high_slope - low_slope);
        let value = low_value + cell.up * per_row;
        // An unknown node makes every one of the three a NaN.
        (!value.is_nan()).then_some((value, per_row, per_column))
    }

    #[inline]
    fn bicubic(&self, cell: Cell) -> Option<(f64, f64, f64)> {
        let cell_index = cell.row * (self.lon.len() - 1) + cell.column;
        if !self.unknown_cells.is_empty() && *self.unknown_cells.get(cell_index)? {
            return None;
        }
        let (across, across_slope) = (weights(cell.right), slope_weights(cell.right));
        let (along, along_slope) = (weights(cell.up), slope_weights(cell.up));
        let width = self.lon.len() + 2;
        let (mut value, mut per_row, mut per_column) = (0.0, 0.0, 0.0);
        for k in 0..4 {
            let c = self.table.get((cell.row + k) * width + cell.column..)?.get(..4)?;
            let row_value = dot4(c, &across);
            value += along[k] * row_value;
            per_row += along_slope[k] * row_value;
            per_column += along[k] * dot4(c, &across_slope);
        }
        Some((value, per_row, per_column))
    }
}

#[inline]
fn dot4(c: &[f64], weights: &[f64; 4]) -> f64 {
    (c[0] * weights[0] + c[1] * weights[1]) + (c[2] * weights[2] + c[3] * weights[3])
}

/// The B-spline coefficients of a grid with its holes filled, with one more node on every side so
/// that a look-up needs no special case at the edge.
fn spline_coefficients(grid: &MapGrid) -> Vec<f64> {
    let (rows, columns) = (grid.lat().len(), grid.lon().len());
    let mut table = holes::filled(grid);
    solve_along_rows(&mut table, columns);
    table.chunks_exact_mut(columns).for_each(solve);
    let mut padded = Vec::with_capacity((rows + 2) * (columns + 2));
    for row in 0..rows + 2 {
        let start = padded.len();
        padded.extend(
            (0..columns + 2)
                .map(|column| natural_end(row, rows, |r| natural_end(column, columns, |c| table[r * columns + c]))),
        );
        debug_assert_eq!(padded.len() - start, columns + 2);
    }
    padded
}

/// The coefficient at padded position `k`: past an end the straight continuation, which is what
/// no curvature at the end means.
fn natural_end(k: usize, n: usize, inside: impl Fn(usize) -> f64) -> f64 {
    if k == 0 {
        2.0 * inside(0) - inside(1)
    } else if k > n {
        2.0 * inside(n - 1) - inside(n - 2)
    } else {
        inside(k - 1)
    }
}

#[cfg(test)]
pub(crate) mod tests;

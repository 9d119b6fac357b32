//! Node values prepared for look-ups. Several quantities of the same nodes are interleaved, so that a look-up reads few
//! cache lines.

use super::MapInterpolation;
use super::holes::{GridShape, UnknownCells, filled};
use super::quadratic;
use crate::signal::natural_cubic;
use rayon::prelude::*;

/// Cell of the grid, and the position in the cell, as fractions of a step northward and eastward.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CellPosition {
    pub(crate) row: usize,
    pub(crate) column: usize,
    pub(crate) up: f64,
    pub(crate) right: f64,
}

/// Values of all quantities at a position and their slopes per step northward and eastward.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfaceGradient<const QUANTITIES: usize> {
    pub(crate) value: [f64; QUANTITIES],
    pub(crate) per_row: [f64; QUANTITIES],
    pub(crate) per_column: [f64; QUANTITIES],
}

/// Second derivatives per step: northward twice, northward and eastward, and eastward twice.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfaceHessian {
    pub(super) rows: f64,
    pub(super) cross: f64,
    pub(super) columns: f64,
}

/// Grid of interleaved quantities. If the first quantity is unknown at a node, all are unknown there.
#[derive(Clone, Debug)]
pub(crate) struct GridInterpolant<const QUANTITIES: usize> {
    interpolation: MapInterpolation,
    /// Nodes in a row of the table.
    width: usize,
    /// Linear: the node values by rows. Splines: the B-spline coefficients by rows, with one more row and column on
    /// each side, so that a look-up needs no special case at the edge.
    table: Vec<[f64; QUANTITIES]>,
    /// Cells with an unknown node, for splines only; in a linear table, unknown nodes are NaN.
    unknown: UnknownCells,
}

impl<const QUANTITIES: usize> GridInterpolant<QUANTITIES> {
    /// Each quantity has one value per node, by rows; the grid has at least two rows and columns.
    pub(crate) fn new(shape: GridShape, values: [&[f64]; QUANTITIES], interpolation: MapInterpolation) -> Self {
        if interpolation == MapInterpolation::Linear {
            let table = interleaved(shape.rows * shape.columns, values);
            return Self { interpolation, width: shape.columns, table, unknown: UnknownCells::default() };
        }
        let padded = values.map(|values| spline_coefficients(shape, values, interpolation));
        let nodes = (shape.rows + 2) * (shape.columns + 2);
        let table = interleaved(nodes, padded.each_ref().map(Vec::as_slice));
        let unknown = values.first().map(|values| UnknownCells::from_values(shape, values)).unwrap_or_default();
        Self { interpolation, width: shape.columns + 2, table, unknown }
    }

    pub(crate) fn interpolation(&self) -> MapInterpolation {
        self.interpolation
    }

    /// All quantities at a position; `None` in a cell with an unknown node.
    #[inline(always)]
    pub(crate) fn at(&self, cell: CellPosition) -> Option<SurfaceGradient<QUANTITIES>> {
        match self.interpolation {
            MapInterpolation::Linear => self.bilinear(cell),
            MapInterpolation::Cubic => self.spline(cell, natural_cubic_weights, natural_cubic_slopes),
            MapInterpolation::Quadratic => self.spline(cell, quadratic::weights, quadratic::slope_weights),
        }
    }

    /// Reads the first and the last node of each row that [`Self::at`] reads, which prefetches all cache lines of the
    /// row; the sum is not used.
    #[inline(always)]
    pub(crate) fn touch(&self, cell: CellPosition) -> f64 {
        match self.interpolation {
            MapInterpolation::Linear => self.touch_rows::<2>(cell),
            MapInterpolation::Quadratic | MapInterpolation::Cubic => self.touch_rows::<4>(cell),
        }
    }

    #[inline(always)]
    fn touch_rows<const NODES: usize>(&self, cell: CellPosition) -> f64 {
        let mut sum = 0.0;
        for row in 0..NODES {
            let first = (cell.row + row) * self.width + cell.column;
            let Some(nodes) = self.table.get(first..).and_then(|nodes| nodes.first_chunk::<NODES>()) else {
                return sum;
            };
            sum += nodes[0][0] + nodes[NODES - 1][QUANTITIES - 1];
        }
        sum
    }

    #[inline(always)]
    fn bilinear(&self, cell: CellPosition) -> Option<SurfaceGradient<QUANTITIES>> {
        let low = self.table.get(cell.row * self.width + cell.column..)?.get(..2)?;
        let high = self.table.get((cell.row + 1) * self.width + cell.column..)?.get(..2)?;
        let mut jet = SurfaceGradient::ZERO;
        for q in 0..QUANTITIES {
            let (low_slope, high_slope) = (low[1][q] - low[0][q], high[1][q] - high[0][q]);
            let low_value = low[0][q] + cell.right * low_slope;
            let per_row = high[0][q] + cell.right * high_slope - low_value;
            jet.per_row[q] = per_row;
            jet.per_column[q] = low_slope + cell.up * (high_slope - low_slope);
            jet.value[q] = low_value + cell.up * per_row;
        }
        // An unknown node makes value and slopes NaN.
        (!jet.value[0].is_nan()).then_some(jet)
    }

    #[inline(always)]
    fn spline(
        &self,
        cell: CellPosition,
        weights: impl Fn(f64) -> [f64; 4],
        slopes: impl Fn(f64) -> [f64; 4],
    ) -> Option<SurfaceGradient<QUANTITIES>> {
        if self.unknown.contains(cell.row, cell.column) {
            return None;
        }
        let (across, across_slope) = (weights(cell.right), slopes(cell.right));
        let (along, along_slope) = (weights(cell.up), slopes(cell.up));
        let mut jet = SurfaceGradient::ZERO;
        for (k, (along, along_slope)) in along.iter().zip(along_slope).enumerate() {
            let c = self.window(cell, k)?;
            for q in 0..QUANTITIES {
                let row_value = dot4(c, q, &across);
                jet.value[q] += along * row_value;
                jet.per_row[q] += along_slope * row_value;
                jet.per_column[q] += along * dot4(c, q, &across_slope);
            }
        }
        Some(jet)
    }

    /// The four coefficients of a row that affect a cell.
    #[inline(always)]
    fn window(&self, cell: CellPosition, k: usize) -> Option<&[[f64; QUANTITIES]; 4]> {
        self.table.get((cell.row + k) * self.width + cell.column..)?.first_chunk()
    }

    /// The second derivatives of the first quantity; `None` in a cell with an unknown node.
    pub(super) fn bend(&self, cell: CellPosition) -> Option<SurfaceHessian> {
        match self.interpolation {
            MapInterpolation::Linear => {
                self.at(cell)?;
                let slope = |row: usize| {
                    let pair = self.table.get((cell.row + row) * self.width + cell.column..)?.first_chunk::<2>()?;
                    Some(pair[1][0] - pair[0][0])
                };
                Some(SurfaceHessian { rows: 0.0, cross: slope(1)? - slope(0)?, columns: 0.0 })
            }
            MapInterpolation::Cubic => {
                self.spline_bend(cell, [natural_cubic_weights, natural_cubic_slopes, cubic_curvatures])
            }
            MapInterpolation::Quadratic => {
                self.spline_bend(cell, [quadratic::weights, quadratic::slope_weights, quadratic::curvature_weights])
            }
        }
    }

    fn spline_bend(&self, cell: CellPosition, basis: [fn(f64) -> [f64; 4]; 3]) -> Option<SurfaceHessian> {
        if self.unknown.contains(cell.row, cell.column) {
            return None;
        }
        let (across, along) = (basis.map(|w| w(cell.right)), basis.map(|w| w(cell.up)));
        let mut bend = SurfaceHessian { rows: 0.0, cross: 0.0, columns: 0.0 };
        let [along, along_slope, along_bend] = along;
        for (k, ((along, slope), bent)) in along.iter().zip(along_slope).zip(along_bend).enumerate() {
            let c = self.window(cell, k)?;
            bend.rows += bent * dot4(c, 0, &across[0]);
            bend.cross += slope * dot4(c, 0, &across[1]);
            bend.columns += along * dot4(c, 0, &across[2]);
        }
        Some(bend)
    }
}

impl GridInterpolant<1> {
    /// Interpolant of one quantity with values everywhere: in a gap it returns the fill value, which the caller must
    /// mask.
    pub(crate) fn over_gaps(shape: GridShape, values: &[f64], interpolation: MapInterpolation) -> Self {
        let values = filled(shape, values);
        Self::new(shape, [values.as_slice()], interpolation)
    }
}

impl<const QUANTITIES: usize> SurfaceGradient<QUANTITIES> {
    const ZERO: Self = Self { value: [0.0; QUANTITIES], per_row: [0.0; QUANTITIES], per_column: [0.0; QUANTITIES] };
}

#[inline(always)]
fn dot4<const QUANTITIES: usize>(c: &[[f64; QUANTITIES]; 4], q: usize, weights: &[f64; 4]) -> f64 {
    (c[0][q] * weights[0] + c[1][q] * weights[1]) + (c[2][q] * weights[2] + c[3][q] * weights[3])
}

// Always inlined into code that is compiled for a wider vector unit.
#[inline(always)]
fn natural_cubic_weights(t: f64) -> [f64; 4] {
    natural_cubic::weights(t)
}

#[inline(always)]
fn natural_cubic_slopes(t: f64) -> [f64; 4] {
    natural_cubic::slope_weights(t)
}

/// The second derivatives of the cubic weights.
fn cubic_curvatures(t: f64) -> [f64; 4] {
    [1.0 - t, 3.0 * t - 2.0, 1.0 - 3.0 * t, t]
}

fn interleaved<const QUANTITIES: usize>(nodes: usize, values: [&[f64]; QUANTITIES]) -> Vec<[f64; QUANTITIES]> {
    (0..nodes).map(|node| values.map(|values| values.get(node).copied().unwrap_or(f64::NAN))).collect()
}

/// Number of columns added beyond each end of a closed grid when its spline is solved. The effect of an end decreases
/// by a factor of 4 per cell.
const WRAP: usize = 16;

/// B-spline coefficients of a grid with its holes filled, with one additional node on every side.
fn spline_coefficients(shape: GridShape, values: &[f64], interpolation: MapInterpolation) -> Vec<f64> {
    let GridShape { rows, columns, closed } = shape;
    let solve_along_rows: fn(&mut [f64], usize) = match interpolation {
        MapInterpolation::Quadratic => quadratic::solve_along_rows,
        MapInterpolation::Cubic | MapInterpolation::Linear => natural_cubic::solve_along_rows,
    };
    let (wrap, width) = if closed { (WRAP, columns + 2 * WRAP) } else { (0, columns) };
    let solved = GridShape { rows, columns: width, closed: false };
    let mut table = if closed { filled(solved, &wrapped(shape, values)) } else { filled(solved, values) };
    solve_along_rows(&mut table, width);
    table.par_chunks_exact_mut(width).for_each(|row| solve_along_rows(row, 1));
    let mut padded = vec![0.0; (rows + 2) * (columns + 2)];
    padded.par_chunks_exact_mut(columns + 2).enumerate().for_each(|(row, out)| {
        for (column, value) in out.iter_mut().enumerate() {
            *value = natural_cubic::past_ends(row, rows, |r| match closed {
                true => table[r * width + column + wrap - 1],
                false => natural_cubic::past_ends(column, columns, |c| table[r * width + c]),
            });
        }
    });
    padded
}

/// Values of a closed grid with [`WRAP`] additional columns on each side.
fn wrapped(shape: GridShape, values: &[f64]) -> Vec<f64> {
    let round = shape.columns - 1;
    let row = |row: &[f64]| -> Vec<f64> {
        let turned = (0..shape.columns + 2 * WRAP).map(|k| (k + round * WRAP - WRAP) % round);
        turned.map(|column| row.get(column).copied().unwrap_or(f64::NAN)).collect()
    };
    values.chunks(shape.columns).flat_map(row).collect()
}

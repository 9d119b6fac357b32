//! Estimate of the edge error of a continuation from the map itself. The field past the edges is unknown.

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

use super::extension::{EdgeExtension, MOST_PADDING, Padding, PaddingWidth, TrendRemoval};
use super::{ContinuationError, continued, rms};

/// Minimum number of nodes on a side: at least four nodes, but at most a quarter of the side, are cropped at each end.
const LEAST: usize = 16;

/// Error along one edge, caused by the unknown field beyond this edge.
#[derive(Clone, Debug, PartialEq)]
pub struct SideError {
    /// The rms error in nT as a function of the number of nodes from the edge; the last value applies to all nodes
    /// further inside.
    pub rms_nt: Vec<f64>,
}

/// Edge error of a continuation.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeError {
    /// Errors along the western, eastern, southern and northern edges, without the effect of the distant field's level.
    pub sides: [SideError; 4],
    /// Number of `[rows, columns]` cropped on each side.
    pub cropped: [usize; 2],
    /// The estimate at each node, in nT.
    pub map: PlaneGrid,
    /// The rms of the estimate over the map, in nT.
    pub rms_nt: f64,
}

/// Estimates the edge error of a continuation by `up_m` with these settings.
///
/// Two parts are added in quadrature. First, the map is cropped and continued again. The map contains the true field
/// past the edges of the crop. The difference between the two results is therefore the error of the extension at each
/// distance from the edge of the crop. Each edge of the crop represents the adjacent edge of the map, scaled by the
/// variation of the continued field along both edges. The crop removes five continuation distances, but at most a
/// quarter of a side. Second, because the crop does not show the effect of the distant field's level, this effect is
/// estimated separately. A second continuation uses the opposite assumption: the field falls to zero instead of the
/// mean along the edge, or the reverse.
///
/// On fields of dipoles and prisms in and around a map, the rms of the estimate agrees with the rms error within a
/// factor of three. With all sources well inside, where the error is some thousandths of the field, the estimate is up
/// to ten times too large. It does not include errors of the map's own values.
///
/// # Errors
/// Returns the errors of [`super::continued`]. Also fails with [`ContinuationError::TooSmallToMeasure`].
pub fn edge_error(
    grid: &PlaneGrid,
    up_m: f64,
    alpha_m2: f64,
    padding: &Padding,
) -> Result<EdgeError, ContinuationError> {
    let (rows, columns) = (grid.rows(), grid.columns());
    if rows < LEAST || columns < LEAST {
        return Err(ContinuationError::TooSmallToMeasure { rows, columns, least: LEAST });
    }
    let whole = continued(grid, up_m, alpha_m2, padding)?;
    let other = continued(grid, up_m, alpha_m2, &other_level(grid, padding))?;
    let cropped = [&grid.north_m, &grid.east_m].map(|axis| crop_of(axis, up_m));
    let inner = crop(grid, cropped);
    let again = continued(&inner, up_m, alpha_m2, padding)?;
    let expected = crop(&whole, cropped);
    let differences = minus(&again.values, &expected.values);
    let mut sides = by_side(&inner.with(differences));
    let scale = variation(&whole) / variation(&expected);
    if scale.is_finite() {
        sides.iter_mut().flat_map(|side| &mut side.rms_nt).for_each(|rms| *rms *= scale);
    }
    let level = minus(&other.values, &whole.values);
    let map = grid.with(estimates(grid, &sides).iter().zip(level).map(|(a, b)| a.hypot(b)).collect());
    let rms_nt = rms(map.values.iter().copied());
    Ok(EdgeError { sides, cropped, map, rms_nt })
}

/// The same padding, but at least a third of each side wide and with the opposite assumption about the level of the
/// distant field.
fn other_level(grid: &PlaneGrid, padding: &Padding) -> Padding {
    let trend = if padding.trend == TrendRemoval::None { TrendRemoval::EdgeMean } else { TrendRemoval::None };
    let width = PaddingWidth::Nodes([grid.rows(), grid.columns()].map(|side| (side / 3).min(MOST_PADDING)));
    let edge = EdgeExtension::Falling { detail_nodes: 6 };
    let other = Padding { trend, width, edge, ..*padding };
    if other.layout(grid, 0.0).is_ok() { other } else { Padding { width: PaddingWidth::OfDistance, ..other } }
}

fn minus(one: &[f64], other: &[f64]) -> Vec<f64> {
    one.iter().zip(other).map(|(a, b)| a - b).collect()
}

/// Variation of the values along the four sides: the square root of the sum of their variances.
fn variation(grid: &PlaneGrid) -> f64 {
    let (last_row, last_column) = (grid.rows() - 1, grid.columns() - 1);
    let columns = [0, last_column].map(|column| (0..=last_row).map(|row| grid.get(row, column)).collect());
    let rows = [0, last_row].map(|row| (0..=last_column).map(|column| grid.get(row, column)).collect());
    let sides: [[Vec<f64>; 2]; 2] = [columns, rows];
    sides.iter().flatten().map(|side| deviation(side).powi(2)).sum::<f64>().sqrt()
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    rms(values.iter().map(|value| value - mean))
}

fn crop_of(axis: &EvenAxis, up_m: f64) -> usize {
    let wanted = (5.0 * up_m.abs() / axis.step).ceil().min(axis.len as f64) as usize;
    wanted.clamp(4, axis.len / 4)
}

fn crop(grid: &PlaneGrid, [rows, columns]: [usize; 2]) -> PlaneGrid {
    let inner = |axis: &EvenAxis, cropped: usize| EvenAxis {
        first: axis.at(cropped as f64),
        len: axis.len - 2 * cropped,
        ..*axis
    };
    let (north_m, east_m) = (inner(&grid.north_m, rows), inner(&grid.east_m, columns));
    let lines = grid.values.chunks_exact(grid.columns()).skip(rows).take(north_m.len);
    let values = lines.flat_map(|line| line[columns..columns + east_m.len].iter().copied()).collect();
    PlaneGrid { east_m, north_m, values }
}

/// Side of the map that is nearest to a node in metres, and the number of nodes to this side.
fn nearest(grid: &PlaneGrid, row: usize, column: usize) -> (usize, usize) {
    let nodes = [column, grid.columns() - 1 - column, row, grid.rows() - 1 - row];
    let metres = |side: usize| nodes[side] as f64 * if side < 2 { grid.east_m.step } else { grid.north_m.step };
    let side = (1..4).fold(0, |best, side| if metres(side) < metres(best) { side } else { best });
    (side, nodes[side])
}

fn by_side(differences: &PlaneGrid) -> [SideError; 4] {
    let mut sums: [Vec<(f64, usize)>; 4] = Default::default();
    for (node, difference) in differences.values.iter().enumerate() {
        let (row, column) = (node / differences.columns(), node % differences.columns());
        let (side, distance) = nearest(differences, row, column);
        if sums[side].len() <= distance {
            sums[side].resize(distance + 1, (0.0, 0));
        }
        let (sum, count) = &mut sums[side][distance];
        *sum += difference * difference;
        *count += 1;
    }
    sums.map(|sums| SideError {
        rms_nt: sums.iter().filter(|(_, count)| *count > 0).map(|(sum, count)| (sum / *count as f64).sqrt()).collect(),
    })
}

fn estimates(grid: &PlaneGrid, sides: &[SideError; 4]) -> Vec<f64> {
    let at = |node: usize| {
        let (side, distance) = nearest(grid, node / grid.columns(), node % grid.columns());
        let curve = &sides[side].rms_nt;
        curve.get(distance).or(curve.last()).copied().unwrap_or(f64::NAN)
    };
    (0..grid.values.len()).map(at).collect()
}

//! Maps given as a list of nodes, in any order.

use std::{collections::HashSet, path::Path};

use numerics::maps::plane_grid::EvenAxis;

use grids::node_on;

use super::axis::FileAxis;
use crate::ReadError;

/// Maximum ratio of possible nodes to listed nodes; a sparser grid is rejected.
const SPARSEST: usize = 64;

/// A grid listed as one row per node in any order, as ascending axes and values by rows (`y`, then `x`). Each
/// coordinate has its name in the file. Missing nodes are NaN.
///
/// # Errors
/// Fails for coordinates that do not form a regular grid, or for a duplicate node.
pub(crate) fn from_nodes(
    path: &Path,
    (x_name, x): (&str, &[f64]),
    (y_name, y): (&str, &[f64]),
    columns: &[&[f64]],
) -> Result<NodeGrid, ReadError> {
    let (x_axis, y_axis) = (axis_of(path, x_name, x)?, axis_of(path, y_name, y)?);
    let (x_even, y_even) = (x_axis.ascending(), y_axis.ascending());
    let cells = x_even.len.checked_mul(y_even.len).filter(|n| *n <= x.len().saturating_mul(SPARSEST));
    let Some(cells) = cells else {
        return Err(ReadError::data(path, "the coordinates do not form a regular grid").in_column(x_name));
    };
    let mut filled = vec![false; cells];
    let mut values = vec![vec![f64::NAN; cells]; columns.len()];
    let node = |axis: &EvenAxis, c: f64| node_on(axis, c).map(|n| n.round() as usize);
    for (row, (x, y)) in x.iter().zip(y).enumerate() {
        let (Some(i), Some(j)) = (node(&x_even, *x), node(&y_even, *y)) else { continue };
        let cell = j * x_even.len + i;
        if filled.get_mut(cell).is_some_and(|f| std::mem::replace(f, true)) {
            return Err(ReadError::data(path, "duplicate node").in_row(row as u64));
        }
        for (out, column) in values.iter_mut().zip(columns) {
            if let (Some(out), Some(value)) = (out.get_mut(cell), column.get(row)) {
                *out = *value;
            }
        }
    }
    Ok(NodeGrid { x: x_axis, y: y_axis, values })
}

/// The axis of the distinct coordinates.
fn axis_of(path: &Path, name: &str, coordinates: &[f64]) -> Result<FileAxis, ReadError> {
    if let Some(row) = coordinates.iter().position(|c| !c.is_finite()) {
        return Err(ReadError::data(path, "the node has no position").in_column(name).in_row(row as u64));
    }
    // Most coordinates are duplicates: each coordinate of a column occurs once per row.
    let mut seen = HashSet::new();
    let mut before = None;
    let mut unique = vec![];
    for coordinate in coordinates {
        let bits = Some(coordinate.to_bits());
        if bits != before && seen.insert(bits) {
            unique.push(*coordinate);
        }
        before = bits;
    }
    unique.sort_by(f64::total_cmp);
    unique.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * b.abs().max(1.0));
    FileAxis::from_coordinates(path, name, &unique)
}

/// Axes and values of a grid from a list of nodes.
pub(crate) struct NodeGrid {
    pub(crate) x: FileAxis,
    pub(crate) y: FileAxis,
    pub(crate) values: Vec<Vec<f64>>,
}

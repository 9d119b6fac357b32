//! The known nodes that can be a neighbour of an unknown one.

use crate::numerics::plane_grid::PlaneGrid;
use rayon::prelude::*;

/// How many rows and columns around an unknown node a known one may lie and still be among the `neighbours` nearest
/// of any unknown node.
///
/// A known node whose eight neighbours are all known has at least three of them nearer to any unknown node than it is
/// itself: with the unknown node c columns and r rows away, those one step nearer in columns, in rows, and in both,
/// and where r = 0 (so that c is at least 2) the three of the next column, as long as one step of a row is shorter
/// than √3 of a column. So it is not among the nearest three. In general, the chain of nodes that leads from a known
/// node straight to an unknown one is strictly nearer to it, node by node, so that fewer than `neighbours` of the
/// chain are known.
pub(super) fn reach(neighbours: usize, east_m: f64, north_m: f64) -> usize {
    let near_square = east_m < 1.7 * north_m && north_m < 1.7 * east_m;
    if neighbours <= 3 && near_square { 1 } else { neighbours }
}

/// The known nodes within `reach` rows and columns of an unknown one, in the order of the grid.
pub(super) fn edge_nodes(grid: &PlaneGrid, reach: usize) -> Vec<usize> {
    let (rows, width) = (grid.rows(), grid.columns());
    let across: Vec<Vec<bool>> = grid.values.par_chunks_exact(width).map(|row| near_unknown(row, reach)).collect();
    let rows = (0..rows).into_par_iter().flat_map_iter(|row| {
        let band = &across[row.saturating_sub(reach)..=(row + reach).min(rows - 1)];
        let near = (0..width).filter(move |column| band.iter().any(|near| near[*column]));
        near.map(move |column| row * width + column).filter(|node| !grid.values[*node].is_nan())
    });
    rows.collect()
}

/// Which nodes of a row lie within `reach` columns of an unknown one of that row.
fn near_unknown(row: &[f64], reach: usize) -> Vec<bool> {
    let mut near = vec![false; row.len()];
    for unknown in row.iter().enumerate().filter(|(_, value)| value.is_nan()).map(|(column, _)| column) {
        let last = (unknown + reach).min(row.len() - 1);
        near[unknown.saturating_sub(reach)..=last].fill(true);
    }
    near
}

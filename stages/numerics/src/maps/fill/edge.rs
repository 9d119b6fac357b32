//! Known nodes that can be neighbours of an unknown node.

use crate::maps::plane_grid::PlaneGrid;
use rayon::prelude::*;

/// Number of rows and columns around an unknown node that must be searched. A known node farther away cannot be among
/// the `neighbours` known nodes nearest to any unknown node, unless it is on the border of the map.
///
/// Consider a known node whose eight neighbours are all known. At least three of these neighbours are nearer to any
/// unknown node than the known node itself. If the unknown node is c columns and r rows away, the three are one step
/// nearer in columns, in rows, and in both. If r = 0 (so that c is at least 2), they are the three nodes of the next
/// column, provided that the step between rows is shorter than √3 times the step between columns. Such a node is
/// therefore not among the nearest three. In general, every node of the chain that leads straight from a known node to
/// an unknown one is strictly nearer to the unknown node than the previous one. Fewer than `neighbours` nodes of the
/// chain are therefore known.
fn reach(neighbours: usize, east_m: f64, north_m: f64) -> usize {
    let near_square = east_m < 1.7 * north_m && north_m < 1.7 * east_m;
    if neighbours <= 3 && near_square { 1 } else { neighbours }
}

/// Known nodes that can be among the `neighbours` known nodes nearest to an unknown node, in grid order.
pub(super) fn edge_nodes(grid: &PlaneGrid, neighbours: usize) -> Vec<usize> {
    let (rows, width) = (grid.rows(), grid.columns());
    let reach = reach(neighbours, grid.east_m.step, grid.north_m.step);
    let across: Vec<Vec<bool>> = grid.values.par_chunks_exact(width).map(|row| near_unknown(row, reach)).collect();
    let near = (0..rows).into_par_iter().flat_map_iter(|row| {
        let band = &across[row.saturating_sub(reach)..=row.saturating_add(reach).min(rows - 1)];
        let near = (0..width).filter(move |column| band.iter().any(|near| near[*column]));
        near.map(move |column| row * width + column).filter(|node| !grid.values[*node].is_nan())
    });
    let mut nodes: Vec<usize> = near.collect();
    if reach < neighbours {
        nodes.extend(border_nodes(grid, neighbours));
        nodes.par_sort_unstable();
        nodes.dedup();
    }
    nodes
}

/// Known nodes on the four border lines within `reach` of an unknown node of the same line. On a border, only two of
/// the three nodes of the next column or row exist.
fn border_nodes(grid: &PlaneGrid, reach: usize) -> Vec<usize> {
    let (rows, width) = (grid.rows(), grid.columns());
    let lines = [(0, 1, width), ((rows - 1) * width, 1, width), (0, width, rows), (width - 1, width, rows)];
    let line_nodes = |(first, stride, len): (usize, usize, usize)| {
        let nodes: Vec<usize> = (0..len).map(|k| first + k * stride).collect();
        let values: Vec<f64> = nodes.iter().map(|node| grid.values[*node]).collect();
        let near = near_unknown(&values, reach);
        let known = (0..len).filter(move |k| near[*k] && !values[*k].is_nan());
        known.map(move |k| nodes[k]).collect::<Vec<usize>>()
    };
    lines.into_iter().flat_map(line_nodes).collect()
}

/// Nodes of a row within `reach` columns of an unknown node of that row.
fn near_unknown(row: &[f64], reach: usize) -> Vec<bool> {
    let mut near = vec![false; row.len()];
    for unknown in row.iter().enumerate().filter(|(_, value)| value.is_nan()).map(|(column, _)| column) {
        let last = unknown.saturating_add(reach).min(row.len() - 1);
        near[unknown.saturating_sub(reach)..=last].fill(true);
    }
    near
}

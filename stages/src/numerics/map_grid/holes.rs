//! Unknown nodes: which cells they spoil, and what stands in for them when a spline is solved.

use super::grid::MapGrid;

/// Which cells have an unknown node, by rows; empty where every node is known.
pub(super) fn unknown_cells(grid: &MapGrid) -> Vec<bool> {
    let (width, values) = (grid.lon().len(), grid.values());
    if values.iter().all(|value| !value.is_nan()) {
        return Vec::new();
    }
    let pair_unknown = |at: usize| values[at].is_nan() || values[at + 1].is_nan();
    (0..grid.lat().len() - 1)
        .flat_map(|row| (0..width - 1).map(move |column| row * width + column))
        .map(|corner| pair_unknown(corner) || pair_unknown(corner + width))
        .collect()
}

/// The node values with every hole filled from its edge inwards: in each round an unknown node
/// next to known ones takes their mean (of up to eight). What is filled is never handed out; it
/// only keeps the spline smooth beside a hole.
pub(super) fn filled(grid: &MapGrid) -> Vec<f64> {
    let mut values = grid.values().to_vec();
    let mut front: Vec<usize> = (0..values.len())
        .filter(|node| values[*node].is_nan() && neighbour_mean(grid, &values, *node).is_some())
        .collect();
    while !front.is_empty() {
        // All of a round is computed before any of it is written: the order does not matter.
        let means: Vec<Option<f64>> = front.iter().map(|node| neighbour_mean(grid, &values, *node)).collect();
        for (node, mean) in front.iter().zip(means) {
            values[*node] = mean.unwrap_or(f64::NAN);
        }
        front = next_front(grid, &values, &front);
    }
    values
}

fn next_front(grid: &MapGrid, values: &[f64], front: &[usize]) -> Vec<usize> {
    let mut next: Vec<usize> =
        front.iter().flat_map(|node| neighbours(grid, *node)).filter(|node| values[*node].is_nan()).collect();
    next.sort_unstable();
    next.dedup();
    next
}

fn neighbour_mean(grid: &MapGrid, values: &[f64], node: usize) -> Option<f64> {
    let (sum, count) = neighbours(grid, node)
        .map(|neighbour| values[neighbour])
        .filter(|value| !value.is_nan())
        .fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The up to eight nodes around one, in the order of the grid.
fn neighbours(grid: &MapGrid, node: usize) -> impl Iterator<Item = usize> + use<> {
    let (width, height) = (grid.lon().len(), grid.lat().len());
    let (row, column) = (node / width, node % width);
    let rows = row.saturating_sub(1)..=(row + 1).min(height - 1);
    rows.flat_map(move |r| (column.saturating_sub(1)..=(column + 1).min(width - 1)).map(move |c| r * width + c))
        .filter(move |neighbour| *neighbour != node)
}

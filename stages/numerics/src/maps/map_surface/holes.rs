//! Unknown nodes: the affected cells, and the substitute values for the solution of a spline.

/// The rows and columns of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct GridShape {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    /// Whether the last column repeats the first, after a full turn.
    pub(crate) closed: bool,
}

/// Cells with an unknown node, one bit each. Empty if every node is known.
#[derive(Clone, Debug, Default)]
pub(super) struct UnknownCells {
    words: Vec<u64>,
    cells_a_row: usize,
}

impl UnknownCells {
    pub(super) fn from_values(shape: GridShape, values: &[f64]) -> Self {
        if values.iter().all(|value| !value.is_nan()) {
            return Self::default();
        }
        let cells_a_row = shape.columns - 1;
        let mut words = vec![0u64; ((shape.rows - 1) * cells_a_row).div_ceil(64)];
        let pair_unknown = |at: usize| values[at].is_nan() || values[at + 1].is_nan();
        for (row, column) in (0..shape.rows - 1).flat_map(|row| (0..cells_a_row).map(move |column| (row, column))) {
            let corner = row * shape.columns + column;
            if pair_unknown(corner) || pair_unknown(corner + shape.columns) {
                let cell = row * cells_a_row + column;
                words[cell / 64] |= 1 << (cell % 64);
            }
        }
        Self { words, cells_a_row }
    }

    /// Whether the cell has an unknown node.
    #[inline(always)]
    pub(super) fn contains(&self, row: usize, column: usize) -> bool {
        if self.words.is_empty() {
            return false;
        }
        let cell = row * self.cells_a_row + column;
        self.words.get(cell / 64).is_none_or(|word| word >> (cell % 64) & 1 == 1)
    }
}

/// Node values with every hole filled from its edge inwards. In each round, an unknown node next to known nodes takes
/// the mean of its (up to eight) known neighbours. Filled values are never returned; they only keep the spline smooth
/// next to a hole.
pub(super) fn filled(shape: GridShape, values: &[f64]) -> Vec<f64> {
    let mut values = values.to_vec();
    let mut front: Vec<usize> = (0..values.len())
        .filter(|node| values[*node].is_nan() && neighbour_mean(shape, &values, *node).is_some())
        .collect();
    while !front.is_empty() {
        // A round is computed completely before it is stored, so the order does not matter.
        let means: Vec<Option<f64>> = front.iter().map(|node| neighbour_mean(shape, &values, *node)).collect();
        for (node, mean) in front.iter().zip(means) {
            values[*node] = mean.unwrap_or(f64::NAN);
        }
        front = next_front(shape, &values, &front);
    }
    values
}

fn next_front(shape: GridShape, values: &[f64], front: &[usize]) -> Vec<usize> {
    let mut next: Vec<usize> =
        front.iter().flat_map(|node| neighbours(shape, *node)).filter(|node| values[*node].is_nan()).collect();
    next.sort_unstable();
    next.dedup();
    next
}

fn neighbour_mean(shape: GridShape, values: &[f64], node: usize) -> Option<f64> {
    let (sum, count) = neighbours(shape, node)
        .map(|neighbour| values[neighbour])
        .filter(|value| !value.is_nan())
        .fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// Up to eight neighbours of a node, in grid order.
fn neighbours(shape: GridShape, node: usize) -> impl Iterator<Item = usize> {
    let GridShape { rows, columns, .. } = shape;
    let (row, column) = (node / columns, node % columns);
    let around = row.saturating_sub(1)..=(row + 1).min(rows - 1);
    around
        .flat_map(move |r| (column.saturating_sub(1)..=(column + 1).min(columns - 1)).map(move |c| r * columns + c))
        .filter(move |neighbour| *neighbour != node)
}

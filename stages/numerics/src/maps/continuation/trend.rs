//! Level or plane of the values along the edge of a map.

use crate::maps::plane_grid::PlaneGrid;

use super::extension::TrendRemoval;

/// Plane, given by a level and the slopes per row and per column.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TrendPlane {
    level: f64,
    per_row: f64,
    per_column: f64,
}

impl TrendPlane {
    pub(super) fn along_edge(grid: &PlaneGrid, trend: TrendRemoval) -> Self {
        if trend == TrendRemoval::None {
            return Self::default();
        }
        let nodes = edge_nodes(grid);
        let level = mean(nodes.iter().map(|&[row, column]| grid.get(row, column)));
        if trend == TrendRemoval::EdgeMean {
            return Self { level, per_row: 0.0, per_column: 0.0 };
        }
        // The edge of a rectangle is symmetric about its middle, so the three unknowns separate.
        let middle = [0.5 * (grid.rows() - 1) as f64, 0.5 * (grid.columns() - 1) as f64];
        let slope = |axis: usize| {
            let offset = |node: &[usize; 2]| node[axis] as f64 - middle[axis];
            let square: f64 = nodes.iter().map(|node| offset(node).powi(2)).sum();
            nodes.iter().map(|node| offset(node) * grid.get(node[0], node[1])).sum::<f64>() / square
        };
        let [per_row, per_column] = [slope(0), slope(1)];
        Self { level: level - per_row * middle[0] - per_column * middle[1], per_row, per_column }
    }

    pub(super) fn at(&self, row: usize, column: usize) -> f64 {
        self.level + self.per_row * row as f64 + self.per_column * column as f64
    }

    pub(super) fn times(&self, factor: f64) -> Self {
        let Self { level, per_row, per_column } = *self;
        Self { level: level * factor, per_row: per_row * factor, per_column: per_column * factor }
    }

    /// The slopes per column and per row of this plane, each as a constant plane.
    pub(super) fn slopes(&self) -> [Self; 2] {
        [self.per_column, self.per_row].map(|level| Self { level, ..Self::default() })
    }
}

fn edge_nodes(grid: &PlaneGrid) -> Vec<[usize; 2]> {
    let (last_row, last_column) = (grid.rows() - 1, grid.columns() - 1);
    let rows = [0, last_row].into_iter().flat_map(|row| (0..=last_column).map(move |column| [row, column]));
    let columns = [0, last_column].into_iter().flat_map(|column| (1..last_row).map(move |row| [row, column]));
    rows.chain(columns).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    sum / count as f64
}

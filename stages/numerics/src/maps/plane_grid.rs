//! A map on a plane: an even grid of eastings and northings in metres, the input of gridding, filling and continuation.

/// An even, ascending axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvenAxis {
    /// The first coordinate.
    pub first: f64,
    /// The distance between neighbours, above zero.
    pub step: f64,
    /// The number of coordinates.
    pub len: usize,
}

impl EvenAxis {
    /// The coordinate of a node, whose number may be a fraction.
    pub fn at(&self, node: f64) -> f64 {
        self.first + self.step * node
    }

    /// The last coordinate.
    pub fn last(&self) -> f64 {
        self.at(self.len.saturating_sub(1) as f64)
    }

    /// Fractional node of a coordinate; off the axis the result is below zero or above the last node.
    pub fn node(&self, coordinate: f64) -> f64 {
        (coordinate - self.first) / self.step
    }

    /// All coordinates.
    pub fn coordinates(&self) -> Vec<f64> {
        (0..self.len).map(|i| self.at(i as f64)).collect()
    }
}

/// Values at the nodes of an even grid on a plane, NaN where unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneGrid {
    /// Eastings of the columns, in metres.
    pub east_m: EvenAxis,
    /// Northings of the rows, in metres.
    pub north_m: EvenAxis,
    /// Values by rows, the southernmost row first, each from west to east.
    pub values: Vec<f64>,
}

impl PlaneGrid {
    /// The same grid with other values, one per node.
    pub fn with(&self, values: Vec<f64>) -> Self {
        Self { values, ..*self }
    }

    /// The number of rows.
    pub fn rows(&self) -> usize {
        self.north_m.len
    }

    /// The number of columns.
    pub fn columns(&self) -> usize {
        self.east_m.len
    }

    /// Value at a row and a column; NaN outside the grid.
    pub fn get(&self, row: usize, column: usize) -> f64 {
        let inside = row < self.rows() && column < self.columns();
        let value = inside.then(|| self.values.get(row * self.columns() + column)).flatten();
        value.copied().unwrap_or(f64::NAN)
    }

    /// The number of unknown nodes.
    pub fn unknown(&self) -> usize {
        self.values.iter().filter(|v| v.is_nan()).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_nodes_and_coordinates_are_inverse_and_values_off_the_grid_are_nan() {
        let axis = EvenAxis { first: -3.0, step: 0.5, len: 4 };
        assert_eq!(axis.coordinates(), [-3.0, -2.5, -2.0, -1.5]);
        assert_eq!(axis.node(axis.last()), 3.0);
        let grid =
            PlaneGrid { east_m: axis, north_m: EvenAxis { len: 2, ..axis }, values: (0..8).map(f64::from).collect() };
        assert_eq!(grid.get(1, 3), 7.0);
        assert!(grid.get(0, 4).is_nan() && grid.get(2, 0).is_nan());
        assert_eq!(grid.with(vec![f64::NAN; 8]).unknown(), 8);
    }
}

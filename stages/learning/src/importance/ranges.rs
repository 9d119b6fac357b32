//! Ranges of the columns of a global sensitivity analysis.

use super::{ImportanceError, PredictionFunction, answers, group_of};
use crate::rows::{entries, setting};

/// Rows of a model in the unit cube: each column has its lower bound at 0 and its upper bound at 1.
pub(super) struct UnitCube<'a, E> {
    pub(super) model: &'a PredictionFunction<'a, E>,
    pub(super) ranges: &'a [[f64; 2]],
}

impl<E> UnitCube<'_, E> {
    /// Checks ranges and groups. Returns the group of each column.
    pub(super) fn check(&self, groups: &[Vec<usize>]) -> Result<Vec<usize>, ImportanceError<E>> {
        for [least, largest] in self.ranges {
            let is_range = least.is_finite() && largest.is_finite() && least <= largest;
            setting(
                "the width of a range (upper bound minus lower bound)",
                largest - least,
                "finite and at least 0",
                is_range,
            )?;
        }
        group_of(self.ranges.len(), groups)
    }

    /// Predictions at points of the cube.
    pub(super) fn predict(&self, points: &[f64]) -> Result<Vec<f64>, ImportanceError<E>> {
        let width = self.ranges.len();
        entries("the points", points.len() % width.max(1), 0)?;
        let at = |(at, range): (&f64, &[f64; 2])| range[0] + at * (range[1] - range[0]);
        let rows: Vec<f64> =
            points.chunks_exact(width).flat_map(|point| point.iter().zip(self.ranges).map(at)).collect();
        answers(self.model, &rows, width, 1)
    }
}

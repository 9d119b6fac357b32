//! Even axes of a file, ascending or descending, and their conversion to the ascending axis of a map.

use std::path::Path;

use numerics::maps::plane_grid::EvenAxis;

use crate::ReadError;

/// Largest deviation of a coordinate from its evenly spaced position, as a fraction of the step. Single-precision
/// degrees deviate by 0.8 % of a step of 0.001° at 140°.
const EVENNESS: f64 = 0.01;

/// The minimum step that single-precision coordinates resolve, as a fraction of the largest coordinate.
const RESOLUTION: f64 = 1e-12;

/// An even axis of a file: `step` is negative for descending coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FileAxis {
    first: f64,
    step: f64,
    len: usize,
}

impl FileAxis {
    /// An axis from its first coordinate, its step and its length.
    ///
    /// # Errors
    /// Fails for fewer than two coordinates, or for an invalid step.
    pub(crate) fn new(path: &Path, name: &str, first: f64, step: f64, len: usize) -> Result<FileAxis, ReadError> {
        let wrong = |what: String| Err(ReadError::data(path, what).in_column(name));
        if len < 2 {
            return wrong(format!("a map requires at least two nodes along each axis, not {len}"));
        }
        let last = first + step * (len - 1) as f64;
        if !(first.is_finite() && step.is_finite() && last.is_finite()) {
            return wrong(format!("the axis begins at {first} with a step of {step}, which does not define a grid"));
        }
        if step.abs() <= RESOLUTION * first.abs().max(last.abs()) {
            return wrong(format!("the axis has a step of {step}, which does not define a grid"));
        }
        Ok(FileAxis { first, step, len })
    }

    /// The axis between its first and its last coordinate.
    ///
    /// # Errors
    /// Fails in the cases of [`FileAxis::new`].
    pub(crate) fn between(path: &Path, name: &str, first: f64, last: f64, len: usize) -> Result<FileAxis, ReadError> {
        FileAxis::new(path, name, first, (last - first) / (len.max(2) - 1) as f64, len)
    }

    /// The axis of coordinates.
    ///
    /// # Errors
    /// Fails for fewer than two coordinates, duplicates, or uneven spacing.
    pub(crate) fn from_coordinates(path: &Path, name: &str, coordinates: &[f64]) -> Result<FileAxis, ReadError> {
        let first = coordinates.first().copied().unwrap_or(0.0);
        let last = coordinates.last().copied().unwrap_or(0.0);
        if first == last && coordinates.len() > 1 {
            let what = format!("the axis neither ascends nor descends from {first} to {last}");
            return Err(ReadError::data(path, what).in_column(name));
        }
        let axis = FileAxis::between(path, name, first, last, coordinates.len())?;
        for (i, x) in coordinates.iter().enumerate() {
            let even = first + axis.step * i as f64;
            // NaN is rejected too.
            if x.is_nan() || (x - even).abs() > EVENNESS * axis.step.abs() {
                let what = format!("the axis is not evenly spaced: it has {x} instead of {even}");
                return Err(ReadError::data(path, what).in_column(name).in_row(i as u64));
            }
        }
        Ok(axis)
    }

    /// The axis in another unit.
    pub(crate) fn scaled(self, factor: f64) -> FileAxis {
        FileAxis { first: self.first * factor, step: self.step * factor, ..self }
    }

    /// The number of coordinates.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Whether the first coordinate is the largest.
    pub(crate) fn descends(&self) -> bool {
        self.step < 0.0
    }

    /// The same coordinates, ascending.
    pub(crate) fn ascending(&self) -> EvenAxis {
        let first = if self.descends() { self.first + self.step * (self.len - 1) as f64 } else { self.first };
        EvenAxis { first, step: self.step.abs(), len: self.len }
    }
}

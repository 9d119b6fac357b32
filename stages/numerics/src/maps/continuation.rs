//! Anomaly maps at other heights: upward and downward continuation, derivatives, field components, stacks of levels,
//! and maps between a level and a drape.
//!
//! A map is a [`PlaneGrid`] of one harmonic quantity in nT at one height, complete (NaN is refused: fill the map
//! first, and [`masked_like`] takes the filled nodes out again). It is extended past its edges ([`Padding`]),
//! transformed once ([`Spectrum`]) and multiplied for each answer. A field whose sources are all below is, at a
//! height `h` above the map, its spectrum times e^(−k h), with `k` the wavenumber in rad/m [Blakely 1996, eq.
//! 12.8; thesis 000, section 2.3]. Downward, where that grows without bound, the factor is
//! e^(−k h)/(1 + α k² e^(−k h)), with α in m² chosen by an L-curve ([`downward`]).
//!
//! How good an answer is can be measured: [`edge_error()`] says what the unknown field past the edges is worth, and
//! [`is_far`] whether the distance is more than a map of that size bears.

mod components;
mod derivatives;
mod drape;
mod edge_error;
mod extension;
mod l_curve;
mod radial_power;
mod spectrum;
mod transform;
mod trend;
mod upward;

pub use components::Components;
pub use derivatives::Derivative;
pub use drape::{Drape, HeightInterpolation, drape_to_level, level_to_drape};
pub use edge_error::{EdgeError, SideError, edge_error};
pub use extension::{AxisLayout, Edge, Layout, MOST_PADDING, Padding, Trend, Width, expand, seven_smooth};
pub use l_curve::{LCurve, LCurvePoint};
pub use radial_power::RadialPower;
pub use spectrum::Spectrum;
pub use upward::{Downward, Regularisation, continued, downward, stack, upward};

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

/// The α of MagNav.jl, in m².
pub const MAGNAV_ALPHA_M2: f64 = 200.0;

/// What is wrong with a map or with what is asked of it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContinuationError {
    /// Values and axes disagree.
    #[error("{values} values are not a map of {rows} rows and {columns} columns")]
    Shape {
        /// How many values there are.
        values: usize,
        /// How many rows.
        rows: usize,
        /// How many columns.
        columns: usize,
    },
    /// A side has less than two nodes.
    #[error("a map of {rows} rows and {columns} columns is too small: it needs at least 2 of each")]
    TooSmall {
        /// How many rows there are.
        rows: usize,
        /// How many columns.
        columns: usize,
    },
    /// A spacing is not above zero.
    #[error("the spacing must be above 0 m, and it is {step_m} m: give the axes in ascending order")]
    Spacing {
        /// The spacing.
        step_m: f64,
    },
    /// Some nodes have no value.
    #[error(
        "{count} of the map's {nodes} nodes are unknown or infinite, the first in row {row} and column {column}: \
         fill the map first"
    )]
    Unknown {
        /// How many.
        count: usize,
        /// Of how many.
        nodes: usize,
        /// The row of the first one, from 0.
        row: usize,
        /// Its column, from 0.
        column: usize,
    },
    /// A height or a distance is not finite, or has the wrong sign.
    #[error("{what} must be {range}, and it is {value} m")]
    Height {
        /// Which one.
        what: &'static str,
        /// What it may be.
        range: &'static str,
        /// What it is.
        value: f64,
    },
    /// The regularisation is negative or not finite.
    #[error("alpha must be a finite number of square metres of at least 0, and it is {alpha_m2}")]
    Alpha {
        /// What was given.
        alpha_m2: f64,
    },
    /// The padded map would be too large.
    #[error(
        "the padded map has {nodes} nodes and may have {most}: ask for less padding, trim the map or raise the limit"
    )]
    TooLarge {
        /// How many nodes it would have.
        nodes: usize,
        /// How many are allowed.
        most: usize,
    },
    /// The main field has no direction.
    #[error("the main field [{east}, {north}, {up}] has no direction: give a finite vector other than zero")]
    Direction {
        /// Its eastern component.
        east: f64,
        /// Its northern component.
        north: f64,
        /// Its upward component.
        up: f64,
    },
    /// The heights of a drape are not one a node, or not all known.
    #[error("the drape must have {nodes} finite heights, one a node, and {finite} of its {given} are finite")]
    DrapeHeights {
        /// How many nodes the map has.
        nodes: usize,
        /// How many heights were given.
        given: usize,
        /// How many of them are finite.
        finite: usize,
    },
    /// The drape takes too many levels.
    #[error("the drape takes {levels} levels and may take {most}: widen the step of {step_m} m between them")]
    TooManyLevels {
        /// How many levels.
        levels: usize,
        /// How many are allowed.
        most: usize,
        /// The step between them.
        step_m: f64,
    },
    /// The map is too small to be cropped for a measure of its error.
    #[error(
        "a map of {rows} rows and {columns} columns is too small to measure the error of its edges: it needs {least} of each"
    )]
    TooSmallToMeasure {
        /// How many rows there are.
        rows: usize,
        /// How many columns.
        columns: usize,
        /// How many of each are needed.
        least: usize,
    },
}

/// Whether a map can be continued: complete, with ascending axes and at least two rows and columns.
///
/// # Errors
/// Says what is wrong: [`ContinuationError::TooSmall`], [`ContinuationError::Shape`],
/// [`ContinuationError::Spacing`] or [`ContinuationError::Unknown`].
pub fn check(grid: &PlaneGrid) -> Result<(), ContinuationError> {
    let (rows, columns) = (grid.rows(), grid.columns());
    if rows < 2 || columns < 2 {
        return Err(ContinuationError::TooSmall { rows, columns });
    }
    if rows.checked_mul(columns) != Some(grid.values.len()) {
        return Err(ContinuationError::Shape { values: grid.values.len(), rows, columns });
    }
    let usable = |axis: &EvenAxis| axis.step > 0.0 && axis.step.is_finite();
    if let Some(axis) = [&grid.east_m, &grid.north_m].into_iter().find(|axis| !usable(axis)) {
        return Err(ContinuationError::Spacing { step_m: axis.step });
    }
    let count = grid.values.iter().filter(|v| !v.is_finite()).count();
    match grid.values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(first) => {
            let (row, column) = (first / columns, first % columns);
            Err(ContinuationError::Unknown { count, nodes: grid.values.len(), row, column })
        }
    }
}

/// Whether a distance is more than 1/50 of the map's shorter side, beyond which the edges and the map's own errors
/// show: the command line warns. [thesis 000, section 2.3]
pub fn is_far(grid: &PlaneGrid, distance_m: f64) -> bool {
    let side = |axis: &EvenAxis| axis.step * axis.len.saturating_sub(1) as f64;
    50.0 * distance_m.abs() > side(&grid.east_m).min(side(&grid.north_m))
}

/// The map with those nodes unknown that are unknown in `original`, from which it was filled.
pub fn masked_like(mut map: PlaneGrid, original: &PlaneGrid) -> PlaneGrid {
    for (value, known) in map.values.iter_mut().zip(&original.values) {
        if known.is_nan() {
            *value = f64::NAN;
        }
    }
    map
}

fn finite_height(what: &'static str, value: f64) -> Result<(), ContinuationError> {
    let range = "a finite number";
    if value.is_finite() { Ok(()) } else { Err(ContinuationError::Height { what, range, value }) }
}

fn usable_alpha(alpha_m2: f64) -> Result<(), ContinuationError> {
    if alpha_m2 >= 0.0 && alpha_m2.is_finite() { Ok(()) } else { Err(ContinuationError::Alpha { alpha_m2 }) }
}

/// The root of the mean square, summed in the order given.
fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value * value, count + 1));
    if count == 0 { f64::NAN } else { (sum / count as f64).sqrt() }
}

#[cfg(test)]
mod tests;

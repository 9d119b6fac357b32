//! Anomaly maps at other heights: upward and downward continuation, derivatives, field components, stacks of levels,
//! and maps between a level and a drape.
//!
//! A map is a [`PlaneGrid`] of one harmonic quantity in nT at one height. It must be complete: NaN is rejected, so fill
//! the map first. [`masked_like`] removes the filled nodes afterwards. The map is extended past its edges
//! ([`Padding`]), transformed once ([`MapSpectrum`]) and multiplied by one factor per result. If all sources are below,
//! the spectrum at a height `h` above the map is the map's spectrum times e^(−k h), with the wavenumber `k` in rad/m
//! [Blakely 1996, eq. 12.8; Gnadt 2022, section 2.3]. Downward this factor grows without bound, so e^(−k h)/(1 + α k²
//! e^(−k h)) is used instead, with α in m² from an L-curve ([`downward`]).
//!
//! The accuracy of a result can be assessed: [`edge_error()`] estimates the effect of the unknown field past the edges,
//! and [`is_far`] detects a distance that is too large for the map.

mod components;
mod derivatives;
mod drape;
mod edge_error;
mod extension;
mod gain;
mod l_curve;
mod level_error;
mod radial_power;
mod spectrum;
mod transform;
mod trend;
mod upward;

pub use components::AnomalyComponents;
pub use derivatives::MapDerivative;
pub use drape::{DrapeOptions, HeightInterpolation, drape_to_level, level_to_drape};
pub use edge_error::{EdgeError, SideError, edge_error};
pub use extension::{
    AxisLayout, EdgeExtension, MOST_PADDING, PaddedLayout, Padding, PaddingWidth, TrendRemoval, expand, seven_smooth,
};
pub use l_curve::{LCurve, LCurvePoint};
pub use radial_power::RadialPower;
pub use spectrum::MapSpectrum;
pub use upward::{DownwardContinuation, Regularisation, continued, downward, stack, upward};

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

/// The α of MagNav.jl, in m².
pub const MAGNAV_ALPHA_M2: f64 = 200.0;

/// Error of a continuation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContinuationError {
    /// The number of values differs from the number of nodes.
    #[error("{values} values are not a map of {rows} rows and {columns} columns")]
    Shape {
        /// The number of values.
        values: usize,
        /// The number of rows.
        rows: usize,
        /// The number of columns.
        columns: usize,
    },
    /// A side has fewer than two nodes.
    #[error("a map of {rows} rows and {columns} columns is too small; at least 2 of each are required")]
    TooSmall {
        /// The number of rows.
        rows: usize,
        /// The number of columns.
        columns: usize,
    },
    /// A spacing is not above zero.
    #[error("the spacing must be above 0 m, but is {step_m} m; sort the axes in ascending order")]
    Spacing {
        /// The spacing, in metres.
        step_m: f64,
    },
    /// Some nodes have no value.
    #[error(
        "{count} of the map's {nodes} nodes are unknown or infinite, the first in row {row} and column {column}; \
         fill the map first"
    )]
    Unknown {
        /// The number of unknown nodes.
        count: usize,
        /// The number of nodes.
        nodes: usize,
        /// Row of the first unknown node, from 0.
        row: usize,
        /// Column of the first unknown node, from 0.
        column: usize,
    },
    /// A height or a distance is not finite, or has the wrong sign.
    #[error("{what} must be {range}, but is {value} m")]
    Height {
        /// The name of the quantity.
        what: &'static str,
        /// The allowed range.
        range: &'static str,
        /// The value.
        value: f64,
    },
    /// The regularisation is negative or not finite.
    #[error("alpha must be finite and at least 0 m2, but is {alpha_m2}")]
    Alpha {
        /// The given value.
        alpha_m2: f64,
    },
    /// The padded map would be too large.
    #[error(
        "the padded map has {nodes} nodes, but the limit is {most}; reduce the padding, trim the map or raise the limit"
    )]
    TooLarge {
        /// Number of nodes that the padded map would have.
        nodes: usize,
        /// The limit.
        most: usize,
    },
    /// The core field has no direction.
    #[error("the core field [{east}, {north}, {up}] has no direction; give a finite vector other than zero")]
    Direction {
        /// Eastern component of the direction.
        east: f64,
        /// Northern component of the direction.
        north: f64,
        /// Upward component of the direction.
        up: f64,
    },
    /// The number of heights of a drape differs from the number of nodes, or a height is unknown.
    #[error("the drape must have {nodes} finite heights, one per node, but {finite} of its {given} heights are finite")]
    DrapeHeights {
        /// The number of nodes of the map.
        nodes: usize,
        /// The number of given heights.
        given: usize,
        /// The number of finite heights.
        finite: usize,
    },
    /// The drape requires too many levels.
    #[error(
        "the drape requires {levels} levels, but the limit is {most}; increase the step of {step_m} m between the \
         levels"
    )]
    TooManyLevels {
        /// The number of levels.
        levels: usize,
        /// The limit.
        most: usize,
        /// The step between the levels.
        step_m: f64,
    },
    /// The map is too small for an estimate of its edge error.
    #[error(
        "a map of {rows} rows and {columns} columns is too small for its edge error; at least {least} of each are \
         required"
    )]
    TooSmallToMeasure {
        /// The number of rows.
        rows: usize,
        /// The number of columns.
        columns: usize,
        /// The required minimum of rows and of columns.
        least: usize,
    },
}

/// Checks that a map can be continued: complete, with ascending axes and at least two rows and columns.
///
/// # Errors
/// Fails with [`ContinuationError::TooSmall`], [`ContinuationError::Shape`],
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

/// Whether a distance exceeds 1/50 of the map's shorter side. Beyond that, errors of the edges and of the map become
/// significant, and the command line issues a warning. [Gnadt 2022, section 2.3]
pub fn is_far(grid: &PlaneGrid, distance_m: f64) -> bool {
    let side = |axis: &EvenAxis| axis.step * axis.len.saturating_sub(1) as f64;
    50.0 * distance_m.abs() > side(&grid.east_m).min(side(&grid.north_m))
}

/// Map with NaN at the unknown nodes of `original`, the map before filling.
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

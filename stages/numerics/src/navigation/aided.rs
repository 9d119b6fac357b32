//! Kalman filters with further measurements in addition to the scalar field: the difference of two magnetometers, the
//! field vector, and a height. These filters also model a map error that is correlated along the track, and skip
//! samples where the map is too flat.
//!
//! The measurements and their models are described in [`aids`](crate::navigation::aids). [`Linearisation::Unscented`]
//! regresses the slope of the map over the uncertainty of the position, and treats the nonlinearity over this
//! uncertainty as noise [Hostetler & Andreas 1983]. At the top of an anomaly, where the slope vanishes, no other
//! linearisation is consistent.
//!
//! At each sample, the filter uses the aiding positions first, then the scalar field, the difference, the vector and
//! the height. Each scalar value is a separate update. Irregularities are treated as in
//! [`ekf`](crate::navigation::ekf), separately for each measurement. The difference is off the map if either end of the
//! baseline is off the map.

pub(crate) mod filter;
mod slope_error;

use params::{Rule, obeys};

use crate::navigation::ins_error::ParameterError;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::ukf::UkfParameters;

pub use crate::navigation::aids::{
    AidInnovations, Aids, DifferenceAid, HeightAid, Innovations, MapErrorProcess, MapSlope, PermanentChange,
    SampleUsage, SlopeError, VectorAid, field_direction,
};
use filter::AidedFilter;
pub use slope_error::likely_slope_error;

/// Linearisation of a measurement of the field.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Linearisation {
    /// Linearises at the predicted state, as in [`ekf`](crate::navigation::ekf).
    #[default]
    Once,
    /// Linearises again at each iterate, as in [`iekf`](crate::navigation::iekf).
    Iterated {
        /// Maximum number of linearisations.
        iterations: usize,
        /// Position change, in metres, below which the iteration ends.
        tolerance_m: f64,
    },
    /// Linearises over the uncertainty of the position, as in [`ukf`](crate::navigation::ukf). Only α, β and κ of these
    /// parameters are used.
    Unscented(UkfParameters),
}

/// Parameters of the filter and its optional outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AidedParameters {
    /// Linearisation of measurements of the field.
    pub linearisation: Linearisation,
    /// Largest NIS of a measurement; measurements with larger NIS are rejected. `None` uses every measurement.
    pub gate_nis: Option<f64>,
    /// After this number of consecutive rejections of the scalar field, its next measurement is used. `None` sets no
    /// limit.
    pub recover_after: Option<usize>,
    /// Returns the 18 error states of every sample.
    pub keep_states: bool,
    /// Returns the covariance of all states at every sample.
    pub keep_covariance: bool,
}

/// Output of the filter on a line.
#[derive(Clone, Debug, Default)]
pub struct AidedOutput {
    /// Track. Residual and NIS refer to the scalar field, or to the difference if the sample has no scalar measurement.
    /// A flat sample counts as an update.
    pub navigation: NavigationOutput,
    /// Outcome of each sample.
    pub usage: Vec<SampleUsage>,
    /// Horizontal slope of the predicted field at each sample before its measurement, in nT/m; NaN off the map.
    pub slope_nt_per_m: Vec<f64>,
    /// Standard deviation of the nonlinear part of the scalar field, in nT, with [`Linearisation::Unscented`];
    /// otherwise NaN.
    pub nonlinear_sd_nt: Vec<f64>,
    /// Innovations of the further measurements.
    pub aids: AidInnovations,
    /// Lag of the scalar magnetometer at each sample, and its standard deviation, in seconds; empty if the lag is not a
    /// state.
    pub latency_s: [Vec<f64>; 2],
    /// Height bias on the map at each sample, and its standard deviation, in metres; empty if the bias is not a state.
    pub map_height_m: [Vec<f64>; 2],
}

impl AidedOutput {
    /// Number of samples where the map was too flat.
    pub fn flat(&self) -> usize {
        self.usage.iter().filter(|usage| **usage == SampleUsage::Flat).count()
    }
}

impl AidedParameters {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Returns the errors of the parameters of `iekf` and `ukf`.
    pub fn check(&self) -> Result<(), ParameterError> {
        match &self.linearisation {
            Linearisation::Once => {}
            Linearisation::Iterated { iterations, tolerance_m } => {
                obeys(iterations, "iterations", Rule::Positive).map_err(ParameterError)?;
                obeys(tolerance_m, "tolerance_m", Rule::Positive).map_err(ParameterError)?;
            }
            Linearisation::Unscented(parameters) => parameters.check()?,
        }
        self.gate_nis.map_or(Ok(()), |gate| obeys(&gate, "gate_nis", Rule::Positive).map_err(ParameterError))
    }
}

/// Filters one line.
///
/// Costs about 10 µs per sample without a vector.
///
/// # Errors
/// Returns the errors of [`AidedParameters::check`], [`Aids::check`] and [`NavigationLine::check`]. Also fails with
/// [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(
    line: &NavigationLine<'_>,
    aids: &Aids<'_>,
    parameters: &AidedParameters,
) -> Result<AidedOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    aids.check(line.ins.len())?;
    AidedFilter::new(line, aids, parameters).run()
}

#[cfg(test)]
mod tests;

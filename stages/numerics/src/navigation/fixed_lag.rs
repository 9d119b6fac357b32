//! Fixed-lag smoother of the INS errors together with the coefficients of the aircraft field.
//!
//! The states x are the 18 states of [`pinson`](crate::navigation::pinson), truth minus INS, followed by two groups for
//! each magnetometer m. The first group contains the coefficients β_m of any linear model of the aircraft field
//! (Tolles-Lawson terms, heading-error harmonics, a bias), which are constant or follow a random walk. The second is a
//! first-order Gauss-Markov error e_m, because the residual of a linear model is correlated in time. A measurement is
//!
//! ```text
//! z_m = map(INS + x) + core(INS + x) + S + A_m β_m + e_m + white noise
//! ```
//!
//! A cold start is possible: the INS is initially accurate to metres, so the map determines the coefficients before the
//! INS drifts.
//!
//! # Method
//!
//! A window of length `window_s` ends after every stride of `window_s` (1 − `overlap`). All states of a window are
//! estimated together by Gauss-Newton with a line search on the posterior cost. Each step is a forward pass of the
//! filter about the last path (Joseph's form), followed by its adjoint, the modified Bryson-Frazier smoother [Bierman
//! 1973; Bell 1994: the iterated smoother is Gauss-Newton]. No covariance is inverted, so states may have no process
//! noise or a large prior. The path is x₁ = m − P λ₁, xₖ = Φ xₖ₋₁ − Q λₖ, and half the squared distance from prior and
//! process is ½ λ₁ᵀ P λ₁ + ½ Σ λₖᵀ Q λₖ. Robust weights are those of
//! [`TrajectoryLoss`](crate::navigation::loss::TrajectoryLoss) (iteratively reweighted least squares).
//!
//! The first windows begin at the line's start. The prior of a later window is the marginal at its first node given
//! only the dropped measurements, linearised about the last solution. It contains the whole covariance of INS states
//! and coefficients, and no measurement is used twice. Between the ends of windows a filter continues from the end of
//! the last window, linearised at its predictions. The innovations come from this filter, so they are real-time
//! innovations for any lag.
//!
//! Aiding positions ([`NavigationLine::fixes`]) are measurements of the states of their node, with the full weight of
//! least squares even with a robust loss.
//!
//! # Measurements used for the estimate of a sample
//!
//! For `lag_s` = 0, the filter gives the estimate. It uses measurements up to the sample, or up to the end of the
//! sample's `measurement_interval_s`. For a larger lag, the estimate is the smoothed state of the last window that
//! contains the sample and ends at most `lag_s` after it. Without such a window, the filter gives the estimate. If lag
//! and window are as long as the line, the whole line is smoothed. The standard deviations refer to the returned
//! estimate.
//!
//! # Irregularities
//!
//! - a measurement or one of its regressors that is not finite, or a sigma not above 0: that magnetometer is skipped at
//!   the sample, the others are used;
//! - a node whose predicted position is off the map or in an unknown cell for one of its samples: it is not used;
//! - a window whose solution contradicts its prior: [`WindowReport::inconsistent`], counted in
//!   [`FixedLagOutput::inconsistent`];
//! - a window that does not converge: [`WindowReport::converged`];
//! - collinear or constant regressors: the prior determines the result;
//! - a covariance that is not finite and non-negative: an error with the row.

mod nodes;
mod parameters;
mod passage;
pub(crate) mod whole;
mod window;

use crate::navigation::aids::{AidInnovations, AidStates, Aids};
use crate::navigation::gaussian::{Gaussian, StateLayout};
use crate::navigation::pinson::STATES;
use crate::navigation::{NavigationError, NavigationLine, NavigationOutput, ins_series::SeriesError};
use crate::signal::gauss_markov::GaussMarkov;
use params::Params;
use thiserror::Error;

use nodes::LineNodeBuilder;
pub use parameters::{FixedLagParameters, WindowReport};
use passage::FixedLagRun;

/// Linear model A β of the aircraft's field at a magnetometer, with the prior of β.
#[derive(Clone, Copy, Debug, Default)]
pub struct AircraftCoefficients<'a> {
    /// A, row-major, one row per sample and one column per coefficient.
    pub regressors: &'a [f64],
    /// Prior mean of β.
    pub mean: &'a [f64],
    /// Prior covariance of β, row-major, symmetric and positive semidefinite.
    pub covariance: &'a [f64],
    /// Spectral density of the random walk of each coefficient, in its unit squared per second; 0 for a constant.
    pub walk_density: &'a [f64],
}

/// A scalar magnetometer.
#[derive(Clone, Copy, Debug)]
pub struct FixedLagMagnetometer<'a> {
    /// Measured field at each sample, in nT; NaN if missing.
    pub measurement_nt: &'a [f64],
    /// Standard deviation of the white noise of each measurement, in nT. A measurement with a value that is not above 0
    /// counts as missing.
    pub sigma_nt: &'a [f64],
    /// Aircraft field.
    pub coefficients: AircraftCoefficients<'a>,
    /// Additional slow error: standard deviation in nT, and time constant in seconds. A standard deviation of 0 means
    /// no such error.
    pub error: GaussMarkov,
}

impl<'a> FixedLagMagnetometer<'a> {
    /// Measurement of a line, without a model of the aircraft.
    pub fn of_line(line: &NavigationLine<'a>) -> Self {
        Self {
            measurement_nt: line.measurement_nt,
            sigma_nt: line.sigma_nt,
            coefficients: AircraftCoefficients::default(),
            error: GaussMarkov { sigma: 0.0, tau_s: 1.0 },
        }
    }

    /// Inverse variance of a usable measurement, else 0.
    fn precision(&self, row: usize) -> f64 {
        let (value, precision) = (self.measurement_nt[row], self.sigma_nt[row].powi(-2));
        let usable = value.is_finite() && self.sigma_nt[row] > 0.0 && precision > 0.0 && precision.is_finite();
        if usable && self.coefficients.row(row).iter().all(|term| term.is_finite()) { precision } else { 0.0 }
    }
}

impl<'a> AircraftCoefficients<'a> {
    /// Number of coefficients.
    pub fn terms(&self) -> usize {
        self.mean.len()
    }

    /// Regressors of a sample.
    fn row(&self, row: usize) -> &'a [f64] {
        &self.regressors[row * self.terms()..(row + 1) * self.terms()]
    }
}

/// Outcome of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixedLagUsage {
    /// The filter used the measurement of one magnetometer or more.
    Used,
    /// The sample has no measurement.
    Missing,
    /// The predicted position is off the map or in an unknown cell.
    OffMap,
    /// The map is too flat to observe the position; no measurement of the field was used.
    Flat,
}

/// Estimate of a line.
#[derive(Clone, Debug, Default)]
pub struct FixedLagOutput {
    /// Track. Residual and NIS are one-step innovations of the averages over `measurement_interval_s`, at the first
    /// sample of each interval and NaN at the other samples. The residual is the residual of the first magnetometer
    /// with a measurement, and the NIS is the mean over magnetometers, with expected value 1. No sample is gated.
    pub navigation: NavigationOutput,
    /// Outcome of each sample.
    pub usage: Vec<FixedLagUsage>,
    /// Aircraft field A β from the estimate at each sample, in nT. Row-major: one row per sample, one column per
    /// magnetometer.
    pub aircraft_nt: Vec<f64>,
    /// Coefficients at the end of the line, in the order of the magnetometers.
    pub coefficients: Vec<f64>,
    /// Covariance of the coefficients, row-major.
    pub coefficient_covariance: Vec<f64>,
    /// Solution of each window.
    pub windows: Vec<WindowReport>,
    /// Offset subtracted from each magnetometer's measurements, in nT.
    pub offsets_nt: Vec<f64>,
    /// Innovations of the further measurements, as in [`FixedLagOutput::navigation`].
    pub aids: AidInnovations,
    /// Horizontal slope of the predicted field at the first sample of each interval, in nT/m, if there are further
    /// measurements; NaN off the map.
    pub slope_nt_per_m: Vec<f64>,
}

impl FixedLagOutput {
    /// Number of windows whose solution contradicts their prior.
    pub fn inconsistent(&self) -> usize {
        self.windows.iter().filter(|window| window.inconsistent).count()
    }

    /// Number of windows that did not converge.
    pub fn unconverged(&self) -> usize {
        self.windows.iter().filter(|window| !window.converged).count()
    }
}

/// Reason why a line was not smoothed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FixedLagError {
    /// Error that all filters share.
    #[error(transparent)]
    Navigation(#[from] NavigationError),
    /// An array of a magnetometer has the wrong size.
    #[error("magnetometer {magnetometer}: {array} has {found} values, not {expected}")]
    Size {
        /// Index of the magnetometer, from 0.
        magnetometer: usize,
        /// Name of the array.
        array: &'static str,
        /// Size of the array.
        found: usize,
        /// Expected size from the number of samples and coefficients.
        expected: usize,
    },
    /// The prior is invalid.
    #[error("magnetometer {magnetometer}: {what}")]
    Prior {
        /// Index of the magnetometer, from 0.
        magnetometer: usize,
        /// Reason.
        what: &'static str,
    },
}

/// Smooths a line.
///
/// `magnetometers` holds the measurements, each with its model of the aircraft. The line's own measurement is used only
/// if [`FixedLagMagnetometer::of_line`] is among them. The mean of measurement minus prediction over the line's
/// `offset_window_s` is subtracted from each magnetometer.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`] and `FixedLagParameters::check`. Also fails with
/// [`FixedLagError::Size`] and [`FixedLagError::Prior`] for an invalid magnetometer, or with
/// [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(
    parameters: &FixedLagParameters,
    line: &NavigationLine<'_>,
    magnetometers: &[FixedLagMagnetometer<'_>],
    keep: FixedLagOptions,
) -> Result<FixedLagOutput, FixedLagError> {
    run_aided(parameters, line, magnetometers, &Aids::default(), keep)
}

/// Same as [`run`], with further measurements. The further measurements are averaged over an interval like the
/// magnetometers, as measurements of their node's states. A robust loss does not apply to these measurements; like
/// aiding positions, they have the full weight of least squares. A magnetometer is skipped where the map is too flat at
/// the prediction of the filter.
///
/// # Errors
/// Returns the errors of [`run`] and [`Aids::check`].
pub fn run_aided(
    parameters: &FixedLagParameters,
    line: &NavigationLine<'_>,
    magnetometers: &[FixedLagMagnetometer<'_>],
    aids: &Aids<'_>,
    keep: FixedLagOptions,
) -> Result<FixedLagOutput, FixedLagError> {
    parameters.check().map_err(|fault| NavigationError::from(crate::navigation::ins_error::ParameterError(fault)))?;
    line.check()?;
    for (number, magnetometer) in magnetometers.iter().enumerate() {
        check(number, magnetometer, line.ins.len())?;
    }
    aids.check(line.ins.len())?;
    let states = AidStates::new(aids, STATES + magnetometers.len());
    let layout = layout(magnetometers, &states);
    let mut field = line.predicted();
    let offset = |one: &FixedLagMagnetometer| field.offset(line.ins, one.measurement_nt, line.offset_window_s);
    let offsets: Vec<(f64, usize)> = magnetometers.iter().map(offset).collect();
    let offsets_nt: Vec<f64> = offsets.iter().map(|(offset_nt, _)| *offset_nt).collect();
    let mut output = FixedLagOutput {
        navigation: NavigationOutput::with_capacity(line.ins.len(), keep.states, keep.covariance),
        offsets_nt: offsets_nt.clone(),
        ..FixedLagOutput::default()
    };
    if let Some((offset_nt, samples)) = offsets.first() {
        output.navigation.report.offset_nt = *offset_nt;
        output.navigation.report.offset_samples = *samples;
    }
    let nodes = LineNodeBuilder::new(line, magnetometers, &layout, &offsets_nt, parameters.measurement_interval_s);
    let nodes = nodes.with(aids, &states);
    let prior = prior(line, magnetometers, &layout);
    Ok(FixedLagRun::new(parameters, &layout, magnetometers, (aids, &states), nodes, prior, output).run()?)
}

/// Optional outputs in addition to the track.
#[derive(Clone, Copy, Debug, Default)]
pub struct FixedLagOptions {
    /// Returns the 18 error states of every sample (144 bytes each).
    pub states: bool,
    /// Returns the covariance of the states at every sample (2.6 kB each).
    pub covariance: bool,
}

fn layout(magnetometers: &[FixedLagMagnetometer<'_>], states: &AidStates) -> StateLayout {
    let errors = magnetometers.iter().map(|one| one.error).collect();
    let mut layout = StateLayout { errors, ..StateLayout::default() };
    states.extend(&mut layout);
    for one in magnetometers {
        let first = layout.dim();
        layout.walk.extend_from_slice(one.coefficients.walk_density);
        layout.blocks.push(first..layout.dim());
    }
    layout
}

/// States at the first sample, before its measurements are applied.
fn prior(line: &NavigationLine<'_>, magnetometers: &[FixedLagMagnetometer<'_>], layout: &StateLayout) -> Gaussian {
    let mut start = Gaussian::start_of(line, layout);
    for (one, block) in magnetometers.iter().zip(&layout.blocks) {
        start.x[block.clone()].copy_from_slice(one.coefficients.mean);
        let rows = one.coefficients.covariance.chunks_exact(block.len().max(1));
        for (row, entries) in start.p.rows_mut().skip(block.start).zip(rows) {
            row[block.clone()].copy_from_slice(entries);
        }
    }
    start
}

fn check(magnetometer: usize, one: &FixedLagMagnetometer<'_>, rows: usize) -> Result<(), FixedLagError> {
    for (column, found) in [("measurement", one.measurement_nt.len()), ("measurement sigma", one.sigma_nt.len())] {
        if found != rows {
            return Err(NavigationError::from(SeriesError::Length { column, rows: found, expected: rows }).into());
        }
    }
    let AircraftCoefficients { regressors, mean, covariance, walk_density } = one.coefficients;
    let terms = mean.len();
    for (array, found, expected) in [
        ("regressors", regressors.len(), rows * terms),
        ("prior covariance", covariance.len(), terms * terms),
        ("random-walk density", walk_density.len(), terms),
    ] {
        if found != expected {
            return Err(FixedLagError::Size { magnetometer, array, found, expected });
        }
    }
    let fault = |what| Err(FixedLagError::Prior { magnetometer, what });
    if !mean.iter().chain(covariance).all(|value| value.is_finite()) {
        return fault("its prior mean and covariance must be finite");
    }
    if !walk_density.iter().all(|density| density.is_finite() && *density >= 0.0) {
        return fault("its random-walk densities must be finite and not below 0");
    }
    if !(one.error.sigma >= 0.0 && one.error.sigma.is_finite() && one.error.tau_s > 0.0) {
        return fault(
            "its Gauss-Markov error requires a finite standard deviation of at least 0 and a time constant above 0",
        );
    }
    if !is_covariance(covariance, terms) {
        return fault("its prior covariance is not symmetric and positive semidefinite");
    }
    Ok(())
}

/// Whether a matrix is exactly symmetric, and positive semidefinite up to rounding. The test is a Cholesky
/// factorisation of its correlations.
fn is_covariance(p: &[f64], terms: usize) -> bool {
    let sigma: Vec<f64> = (0..terms).map(|k| p[k * (terms + 1)].sqrt()).collect();
    let mut factor = vec![0.0; terms * terms];
    for row in 0..terms {
        for column in 0..=row {
            let entry = p[row * terms + column];
            if entry != p[column * terms + row] || sigma[row].is_nan() {
                return false;
            }
            let scale = sigma[row] * sigma[column];
            if scale == 0.0 {
                if entry != 0.0 {
                    return false;
                }
                continue;
            }
            let known: f64 = (0..column).map(|k| factor[row * terms + k] * factor[column * terms + k]).sum();
            let rest = entry / scale - known;
            if row == column {
                if rest < -1e-9 {
                    return false;
                }
                factor[row * terms + row] = rest.max(0.0).sqrt();
            } else {
                let pivot = factor[column * terms + column];
                // Skips a column that is a linear combination of previous columns.
                if pivot < 1e-7 {
                    if rest.abs() > 1e-6 {
                        return false;
                    }
                } else {
                    factor[row * terms + column] = rest / pivot;
                }
            }
        }
    }
    true
}

#[cfg(test)]
mod tests;

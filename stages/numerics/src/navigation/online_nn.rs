//! In-flight estimation of the aircraft field: an online neural network.
//!
//! The 18 states of the extended Kalman filter are followed by the weights w of a small network, whose output is the
//! aircraft field at the uncompensated scalar magnetometer. [Gnadt 2022, section 5.6, (5.42)-(5.45); Singhal & Wu 1989,
//! for training by the filter]
//!
//! ```text
//! z = map(INS + x) + core(INS + x) + S + m(features; w) + white noise
//! H = [∂h/∂lat, ∂h/∂lon, ∂h/∂alt, 0 … 0, 1, ∂m/∂w],      w ← w,      P_ww ← P_ww + q Δt
//! ```
//!
//! Back-propagation computes ∂m/∂w at each sample. The weights, their covariance and their random walk are given, or
//! come from [`train`], which uses recursive least squares over a calibration. The recursion, including the treatment
//! of irregularities, is the same as in [`online`](super::online). A measurement with a feature that is NaN or infinite
//! counts as missing. The features must not contain a scalar magnetometer
//! ([`check_sources`](super::online::check_sources)).
//!
//! A network of p features and h hidden units has h (p + 2) + 1 weights. The time per step is proportional to the
//! square of 18 plus the number of weights. The network extrapolates beyond the features of its calibration. The
//! covariance of the weights includes the noise of the calibration but not the model error of the network. On a smooth
//! function of three features, the errors are about 2.5 times the predicted standard deviation.

mod network;
mod training;

use crate::navigation::aids::{AidInnovations, Aids, SampleUsage};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{NavigationError, NavigationOutput};

use super::online::augmented::{self, AircraftFieldModel, ExtraStates, refused};
use super::online::{LineModel, MagnetometerTrack, OnlineParameters};
pub use network::{OnlineActivation, OnlineNetwork};
pub use training::{NetworkCalibration, NetworkPrior, TrainingParameters, train};

/// Output of the filter on a line.
#[derive(Clone, Debug, Default)]
pub struct NetworkOutput {
    /// Estimated track.
    pub navigation: NavigationOutput,
    /// Weights after the last sample.
    pub weights: Vec<f64>,
    /// Covariance of the weights, row-major.
    pub covariance: Vec<f64>,
    /// Weights after each sample, row-major; empty unless `keep_coefficients` is set.
    pub weights_by_row: Vec<f64>,
    /// Standard deviations of the weights after each sample.
    pub sigma_by_row: Vec<f64>,
    /// Residuals, the aircraft field, and the use of the samples.
    pub track: MagnetometerTrack,
    /// Outcome of each sample, if there are further measurements.
    pub usage: Vec<SampleUsage>,
    /// Innovations of the further measurements.
    pub aids: AidInnovations,
    /// See [`OnlineOutput`](super::online::OnlineOutput).
    pub slope_nt_per_m: Vec<f64>,
}

/// Filters one line, whose measurement is the uncompensated field, with optional further measurements. `features` are
/// row-major, one row per sample.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`] and [`Aids::check`]. Fails with [`NavigationError::Parameter`] for
/// features, weights, covariances and densities whose size does not match the network or whose values are out of range.
/// Fails with [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(
    line: &NavigationLine<'_>,
    network: &OnlineNetwork,
    features: &[f64],
    prior: &NetworkPrior,
    aids: &Aids<'_>,
    parameters: &OnlineParameters,
) -> Result<NetworkOutput, NavigationError> {
    prior.check(network)?;
    let (rows, width) = (line.ins.len(), network.inputs());
    if features.len() != rows * width {
        let what = format!("{} feature values are given, not {rows} rows of {width}", features.len());
        return Err(refused("features", what).into());
    }
    let states = ExtraStates {
        mean: prior.weights.clone(),
        covariance: prior.covariance.clone(),
        density: prior.walk_density.clone(),
        tau_s: vec![f64::INFINITY; prior.weights.len()],
    };
    let model = NetworkField { network, inputs: network.standardised(features) };
    let readings = [(line.measurement_nt, line.sigma_nt)];
    let mut output = augmented::run(
        &LineModel { aids: *aids, ..LineModel::from_line(line) },
        &readings,
        model,
        &states,
        parameters,
    )?;
    Ok(NetworkOutput {
        navigation: output.navigation,
        weights: output.c,
        covariance: output.c_covariance,
        weights_by_row: output.c_by_row,
        sigma_by_row: output.c_sigma_by_row,
        track: output.magnetometers.pop().unwrap_or_default(),
        usage: output.usage,
        aids: output.aids,
        slope_nt_per_m: output.slope_nt_per_m,
    })
}

/// Network along a line.
struct NetworkField<'a> {
    network: &'a OnlineNetwork,
    /// Standardised features, one row per sample.
    inputs: Vec<f64>,
}

impl NetworkField<'_> {
    #[inline(always)]
    fn inputs(&self, row: usize) -> &[f64] {
        &self.inputs[row * self.network.inputs()..][..self.network.inputs()]
    }
}

impl AircraftFieldModel for NetworkField<'_> {
    #[inline(always)]
    fn linearised(&mut self, _: usize, row: usize, c: &[f64], derivatives: &mut [f64]) -> Option<f64> {
        let field_nt = self.network.value_and_gradient(self.inputs(row), c, derivatives);
        field_nt.is_finite().then_some(field_nt)
    }

    #[inline(always)]
    fn value(&mut self, _: usize, row: usize, c: &[f64]) -> Option<f64> {
        let field_nt = self.network.value(self.inputs(row), c);
        field_nt.is_finite().then_some(field_nt)
    }
}

#[cfg(test)]
mod tests;

//! Initial weights: recursive least squares over a calibration.

use crate::inner_product::dot;
use crate::navigation::gaussian::covariance::{Covariance, add_scaled};
use crate::navigation::ins_error::ParameterError;

use super::super::online::augmented::{check_covariance, refused};
use super::OnlineNetwork;

/// Prior of the weights of a line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NetworkPrior {
    /// Weights.
    pub weights: Vec<f64>,
    /// Covariance of the weights, row-major.
    pub covariance: Vec<f64>,
    /// Spectral density of the random walk of each weight, per s.
    pub walk_density: Vec<f64>,
    /// Root mean square of the network's residual on the calibration, in nT.
    pub misfit_nt: f64,
}

/// Samples with a known aircraft field. The field is the uncompensated measurement minus a compensated magnetometer, or
/// minus the field of map, core field and temporal variation at a known position.
#[derive(Clone, Copy, Debug)]
pub struct NetworkCalibration<'a> {
    /// Times of the samples, in seconds, ascending.
    pub tt_s: &'a [f64],
    /// Features, row-major.
    pub features: &'a [f64],
    /// Aircraft field, in nT. Rows in which the aircraft field or a feature is not finite are skipped.
    pub aircraft_nt: &'a [f64],
}

/// Parameters of the training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingParameters {
    /// Seed of the initial weights.
    pub seed: u64,
    /// Noise of the aircraft field in the calibration, in nT.
    pub sigma_nt: f64,
    /// Number of passes over the calibration. Each pass starts from the weights of the previous pass and the prior
    /// covariance, so the covariance equals the covariance of a single pass.
    pub passes: usize,
    /// Time, in seconds, in which each weight is expected to change by the standard deviation that it has after the
    /// calibration.
    pub memory_s: f64,
}

impl Default for TrainingParameters {
    fn default() -> Self {
        Self { seed: 1, sigma_nt: 5.0, passes: 10, memory_s: 3600.0 }
    }
}

/// Recursion (5.43)-(5.45) of Gnadt 2022, with the regressor φ = ∂m/∂w instead of the printed β:
///
/// ```text
/// K = P φ/(σ² + φᵀ P φ),      w ← w + K (y − m(w)),      P ← (I − K φᵀ) P (I − K φᵀ)ᵀ + K σ² Kᵀ
/// ```
pub(crate) struct NetworkRecursion<'a> {
    network: &'a OnlineNetwork,
    variance_nt2: f64,
    pub(crate) weights: Vec<f64>,
    pub(crate) p: Covariance,
    phi: Vec<f64>,
    gain: Vec<f64>,
    rest: Vec<f64>,
}

impl<'a> NetworkRecursion<'a> {
    pub(crate) fn new(network: &'a OnlineNetwork, sigma_nt: f64, weights: Vec<f64>, covariance: &[f64]) -> Self {
        let p = Covariance::alone(covariance, weights.len());
        let zeros = || vec![0.0; p.stride()];
        let (phi, gain, rest) = (zeros(), zeros(), zeros());
        Self { network, variance_nt2: sigma_nt * sigma_nt, weights, p, phi, gain, rest }
    }

    /// Updates the weights with a row of inputs and the field in this row. Returns the residual before the update, in
    /// nT: the weights change by the gain times this residual.
    pub(crate) fn update(&mut self, inputs: &[f64], field_nt: f64) -> f64 {
        let Self { network, weights, phi, gain, rest, .. } = self;
        let missed_nt = field_nt - network.value_and_gradient(inputs, weights, &mut phi[..weights.len()]);
        self.p.times(phi.iter().copied().enumerate().filter(|(_, h)| *h != 0.0), gain);
        let s = dot(phi, gain) + self.variance_nt2;
        self.p.update(s, gain, rest);
        add_scaled(weights, missed_nt, gain);
        missed_nt
    }

    fn variances(&self) -> Vec<f64> {
        (0..self.weights.len()).map(|state| self.p.at(state, state)).collect()
    }
}

/// Trains a network on a calibration, from random weights or from `start`.
///
/// The covariance is the covariance of the last pass. If the misfit exceeds `sigma_nt`, the covariance is multiplied by
/// the squared ratio of misfit and `sigma_nt`, so the model error of the network is treated as noise. The random walk
/// of weight j over the second half of the calibration, of length T, is
///
/// ```text
/// q = max(0, Σ Δw² − (P_half − P_end), P_end T/memory)/T
/// ```
///
/// If the weights are constant, their changes Δw have the expected squares P_half − P_end; any excess is due to the
/// random walk. `memory_s` sets a lower bound, because many weights have no excess. (MagNav.jl uses the smallest |Δw|
/// of any step, and the covariance from a recursion whose regressor is the weights, as printed in Gnadt 2022.)
///
/// # Errors
/// Fails for columns of different lengths, times that do not ascend, fewer than four usable rows, or parameters that
/// are not above 0. Also fails if the recursion does not stay finite.
pub fn train(
    network: &OnlineNetwork,
    calibration: &NetworkCalibration<'_>,
    start: Option<&[f64]>,
    parameters: &TrainingParameters,
) -> Result<NetworkPrior, ParameterError> {
    let TrainingParameters { seed, sigma_nt, passes, memory_s } = *parameters;
    for (name, value) in [("calibration_sigma_nt", sigma_nt), ("memory_s", memory_s), ("passes", passes as f64)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(refused(name, format!("`{name}` must be above 0, not {value}")));
        }
    }
    let rows = usable(network, calibration)?;
    let weights = match start {
        Some(start) if start.len() == network.weights() && start.iter().all(|w| w.is_finite()) => start.to_vec(),
        Some(start) => {
            let what = format!("{} weights are given, but {} finite ones are required", start.len(), network.weights());
            return Err(refused("weights", what));
        }
        None => network.draw(seed),
    };
    let prior = diagonal(&network.weight_sigma());
    let mut recursion = NetworkRecursion::new(network, sigma_nt, weights, &prior);
    let half = rows.len() / 2;
    let (mut at_half, mut squares) = (vec![], vec![0.0; network.weights()]);
    for pass in 0..passes {
        recursion.p = Covariance::alone(&prior, network.weights());
        let last = pass + 1 == passes;
        for (place, row) in rows.iter().enumerate() {
            if last && place == half {
                at_half = recursion.variances();
            }
            let missed_nt = recursion.update(&row.inputs, row.field_nt);
            if last && place >= half {
                squares.iter_mut().zip(&recursion.gain).for_each(|(sum, gain)| *sum += (gain * missed_nt).powi(2));
            }
        }
    }
    if !(recursion.weights.iter().sum::<f64>().is_finite() && recursion.p.is_sound()) {
        return Err(refused("features", "the training diverged"));
    }
    let missed = |row: &NetworkCalibrationRow| (row.field_nt - network.value(&row.inputs, &recursion.weights)).powi(2);
    let misfit_nt = (rows.iter().map(missed).sum::<f64>() / rows.len() as f64).sqrt();
    let factor = (misfit_nt / sigma_nt).powi(2).max(1.0);
    let lasting_s = rows[rows.len() - 1].tt_s - rows[half].tt_s;
    let states = network.weights();
    let walk = |state: usize| {
        let end = recursion.p.at(state, state);
        let above = squares[state] - factor * (at_half[state] - end);
        (above / lasting_s).max(factor * end / memory_s)
    };
    let covariance = (0..states * states).map(|at| factor * recursion.p.at(at / states, at % states)).collect();
    let walk_density = (0..states).map(walk).collect();
    Ok(NetworkPrior { covariance, walk_density, misfit_nt, weights: recursion.weights })
}

impl NetworkPrior {
    /// Rejects sizes that differ from the network.
    pub(crate) fn check(&self, network: &OnlineNetwork) -> Result<(), ParameterError> {
        let states = network.weights();
        if self.weights.len() != states || self.walk_density.len() != states {
            let (weights, densities) = (self.weights.len(), self.walk_density.len());
            let what =
                format!("{weights} weights and {densities} random-walk densities are given, not {states} of each");
            return Err(refused("weights", what));
        }
        check_covariance(&self.covariance, states)
    }
}

/// A usable row of a calibration.
struct NetworkCalibrationRow {
    tt_s: f64,
    inputs: Vec<f64>,
    field_nt: f64,
}

fn usable(
    network: &OnlineNetwork,
    calibration: &NetworkCalibration<'_>,
) -> Result<Vec<NetworkCalibrationRow>, ParameterError> {
    let NetworkCalibration { tt_s, features, aircraft_nt } = *calibration;
    let (rows, width) = (tt_s.len(), network.inputs());
    if features.len() != rows * width || aircraft_nt.len() != rows {
        let (given, fields) = (features.len(), aircraft_nt.len());
        let what = format!(
            "there are {rows} samples, which require {rows} field values and {width} features per sample, but \
             {fields} field values and {given} feature values are given"
        );
        return Err(refused("features", what));
    }
    if tt_s.windows(2).any(|pair| pair[1].partial_cmp(&pair[0]) != Some(std::cmp::Ordering::Greater)) {
        return Err(refused("features", "the times of the calibration do not ascend"));
    }
    let inputs = network.standardised(features);
    let row = |row: usize| NetworkCalibrationRow {
        tt_s: tt_s[row],
        inputs: inputs[row * width..][..width].to_vec(),
        field_nt: aircraft_nt[row],
    };
    let known = |row: &NetworkCalibrationRow| row.field_nt.is_finite() && row.inputs.iter().all(|x| x.is_finite());
    let rows: Vec<NetworkCalibrationRow> = (0..rows).map(row).filter(known).collect();
    if rows.len() < 4 {
        return Err(refused("features", format!("the calibration has {} usable rows; 4 are required", rows.len())));
    }
    Ok(rows)
}

pub(crate) fn diagonal(sigma: &[f64]) -> Vec<f64> {
    let states = sigma.len();
    let mut covariance = vec![0.0; states * states];
    sigma.iter().enumerate().for_each(|(state, sigma)| covariance[state * (states + 1)] = sigma * sigma);
    covariance
}

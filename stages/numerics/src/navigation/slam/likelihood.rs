//! Likelihood of a measurement: its logarithm for each particle, and the innovation of all particles together.

use super::expected::ParticlePrediction;
use super::parameters::ExpectedMeasurement;
use crate::navigation::output::Innovation;

/// Residual of the mean expected measurement, and the square of this residual over the variance of the mixture.
pub(super) fn innovation(predictions: &[ParticlePrediction], weights: &[f64]) -> Innovation {
    let sound = || predictions.iter().zip(weights).filter(|(prediction, _)| prediction.variance_nt2.is_finite());
    let total: f64 = sound().map(|(_, weight)| weight).sum();
    let residual_nt = sound().map(|(prediction, weight)| weight * prediction.residual_nt).sum::<f64>() / total;
    let square = |(prediction, weight): (&ParticlePrediction, &f64)| {
        weight * (prediction.variance_nt2 + (prediction.residual_nt - residual_nt).powi(2))
    };
    let variance_nt2 = sound().map(square).sum::<f64>() / total;
    Innovation { residual_nt, nis: residual_nt * residual_nt / variance_nt2 }
}

/// Logarithms of the factors by which the weights are multiplied. A particle without a prediction has the mean factor
/// of the particles with a prediction. [Lee 2019, algorithm 3, line 5]
pub(super) fn log_likelihoods(predictions: &[ParticlePrediction], method: ExpectedMeasurement) -> Vec<f64> {
    let of = |prediction: &ParticlePrediction| match method {
        ExpectedMeasurement::NearestNeighbour => prediction.log_likelihood(),
        // The likelihood (76) is not normalised by the variance.
        ExpectedMeasurement::Regression | ExpectedMeasurement::InverseDistance => {
            -0.5 * prediction.residual_nt * prediction.residual_nt / prediction.variance_nt2
        }
    };
    let mut logs: Vec<f64> = predictions.iter().map(of).collect();
    let sound = || logs.iter().filter(|log| log.is_finite());
    let largest = sound().copied().fold(f64::NEG_INFINITY, f64::max);
    let mean = largest + (sound().map(|log| (log - largest).exp()).sum::<f64>() / sound().count() as f64).ln();
    for log in &mut logs {
        if !log.is_finite() {
            *log = mean;
        }
    }
    logs
}

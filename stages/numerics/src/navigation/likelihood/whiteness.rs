//! Correlation of innovations.

use crate::navigation::output::NavigationOutput;

/// Longest lag, in samples.
const LAGS: usize = 60;
/// A factor below this is not distinguished from 1.
const SMALLEST: f64 = 1.3;

/// Variance of a sum of the normalised innovations over that of as many independent ones: 1 + 2 sum of the
/// autocorrelations, up to the first pair of lags whose sum is not positive [Geyer 1992]. At least 1.
pub(super) fn correlation_factor(output: &NavigationOutput) -> f64 {
    let normalised: Vec<f64> = output
        .residual_nt
        .iter()
        .zip(&output.nis)
        .filter(|(_, nis)| nis.is_finite() && **nis <= super::GATE_NIS)
        .map(|(residual, nis)| nis.sqrt().copysign(*residual))
        .collect();
    let n = normalised.len();
    let power: f64 = normalised.iter().map(|z| z * z).sum();
    if n < 2 * LAGS || power <= 0.0 {
        return 1.0;
    }
    let correlation = |lag: usize| normalised.iter().zip(&normalised[lag..]).map(|(a, b)| a * b).sum::<f64>() / power;
    let mut factor = 1.0;
    for lag in (1..LAGS).step_by(2) {
        let pair = correlation(lag) + correlation(lag + 1);
        if pair <= 0.0 {
            break;
        }
        factor += 2.0 * pair;
    }
    if factor < SMALLEST { 1.0 } else { factor }
}

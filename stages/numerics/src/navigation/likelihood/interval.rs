//! Interval between the measurements that a filter uses.
//!
//! White errors average out, so more measurements give a better position. Correlated errors do not: the filter would
//! count one error many times. More measurements are therefore used only if their innovations are white.

use super::{LineNoise, NoiseLikelihood, NoiseSearch, ThinnedLine, accepted_innovations};
use crate::navigation::output::NavigationError;
use crate::regression::consistency::whiteness;

/// Factors on the white noise that are tried for the more numerous measurements.
const FACTORS: [f64; 7] = [0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8];
/// More measurements are used if the ratio of their information n/σ² to that of the fewer measurements is at least
/// this.
const LEAST_GAIN: f64 = 1.5;
/// Number of lags of the whiteness test, and the smallest share of these lags with an autocorrelation within its 95 %
/// bounds. The expected share is 0.95.
const WHITE: (usize, f64) = (20, 0.8);

/// Noise of a line with the measurements of `search`, which are more numerous than the `rows` measurements of `noise`.
/// `None` if the errors of these measurements are correlated, or if they do not add information. The process and the
/// permanent field are those of `noise`.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`](crate::navigation::line::NavigationLine::check).
pub fn denser(search: &NoiseSearch<'_>, noise: &LineNoise, rows: usize) -> Result<Option<LineNoise>, NavigationError> {
    search.line.check()?;
    let thinned = ThinnedLine::new(search.line, search.rows);
    let terms = search.aircraft.map(|aircraft| aircraft.at(search.rows)).unwrap_or_default();
    let likelihood = NoiseLikelihood::with_noise(search, &thinned, &terms, noise);
    let [white_nt, others @ ..] = noise.point();
    let [fogm_nt, tau_s, permanent_nt, permanent_tau_s] = others;
    let point = |by: f64| [by * white_nt, fogm_nt, tau_s, permanent_nt, permanent_tau_s];
    let points = FACTORS.map(|by| likelihood.within_ranges(point(by)));
    let scores = likelihood.scores(&points);
    let best = points.iter().zip(scores).max_by(|a, b| a.1.log.total_cmp(&b.1.log));
    let Some((best, score)) = best.filter(|(_, score)| score.log.is_finite()) else { return Ok(None) };
    let output = likelihood.outputs(&[*best]).pop().and_then(Result::ok).unwrap_or_default();
    let (lags, least) = WHITE;
    let is_white = whiteness(&accepted_innovations(&output), lags).value >= least;
    let information = |count: usize, sigma_nt: f64| count as f64 / (sigma_nt * sigma_nt);
    let gain = information(search.rows.len(), best[0]) / information(rows, noise.sigma_nt.value);
    if !is_white || gain < LEAST_GAIN {
        return Ok(None);
    }
    Ok(Some(LineNoise {
        sigma_nt: noise.sigma_nt.scaled(best[0] / noise.sigma_nt.value),
        map_factor: likelihood.map_factor,
        inflation: 1.0,
        log_likelihood: score.log,
        used: score.used,
        ..*noise
    }))
}

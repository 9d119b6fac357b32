//! Interval of the measurements that a filter uses.
//!
//! White errors average out, so more measurements give a better position. Correlated errors do not. The information of
//! n measurements of variance σ² is n / (σ² g), with the statistical inefficiency g of their innovations.

use super::{LineNoise, NoiseLikelihood, NoiseSearch, ThinnedLine, correlation_factor};
use crate::navigation::output::NavigationError;

/// Factors on the white noise that are tried for other measurements.
const FACTORS: [f64; 7] = [0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8];
/// Smallest ratio of the information of more measurements to that of fewer for which more are used. The statistical
/// inefficiency of some hundreds of innovations has a relative error of about 30 %.
const LEAST_GAIN: f64 = 1.5;

/// Noise of a line with the measurements of `search`, which are more than the `rows` measurements of `noise`. `None` if
/// more measurements do not add information. The process and the permanent field are those of `noise`.
///
/// # Errors
/// Fails as [`NavigationLine::check`](crate::navigation::line::NavigationLine::check).
pub fn denser(search: &NoiseSearch<'_>, noise: &LineNoise, rows: usize) -> Result<Option<LineNoise>, NavigationError> {
    search.line.check()?;
    let thinned = ThinnedLine::new(search.line, search.rows);
    let terms = search.aircraft.map(|aircraft| aircraft.at(search.rows)).unwrap_or_default();
    let likelihood = NoiseLikelihood { search, thinned: &thinned, terms: &terms, map_factor: noise.map_factor };
    let [permanent_nt, permanent_tau_s] = noise.permanent.map_or([0.0; 2], |of| of.map(|estimate| estimate.value));
    let white_nt = noise.sigma_nt.value / noise.inflation;
    let point =
        |by: f64| [by * white_nt, noise.fogm_sigma_nt.value, noise.fogm_tau_s.value, permanent_nt, permanent_tau_s];
    let points = FACTORS.map(|by| likelihood.within_ranges(point(by)));
    let scores = likelihood.scores(&points);
    let best = points.iter().zip(scores).max_by(|a, b| a.1.log.total_cmp(&b.1.log));
    let Some((best, score)) = best.filter(|(_, score)| score.log.is_finite()) else { return Ok(None) };
    let output = likelihood.outputs(&[*best]).pop().and_then(Result::ok).unwrap_or_default();
    let factor = correlation_factor(&output);
    let sigma_nt = best[0] * factor.sqrt();
    let information = |count: usize, sigma_nt: f64| count as f64 / (sigma_nt * sigma_nt);
    if information(search.rows.len(), sigma_nt) < LEAST_GAIN * information(rows, noise.sigma_nt.value) {
        return Ok(None);
    }
    Ok(Some(LineNoise {
        sigma_nt: noise.sigma_nt.scaled(sigma_nt / noise.sigma_nt.value),
        inflation: factor.sqrt(),
        log_likelihood: score.log,
        used: score.used,
        ..*noise
    }))
}

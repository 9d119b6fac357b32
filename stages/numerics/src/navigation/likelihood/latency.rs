//! Search for a lag of the magnetometer's time stamps; late stamps have a positive lag.

use super::{NoiseLikelihood, NoisePoint, PERMANENT};

/// Prior standard deviation of the lag, in s. It covers the delays of loggers and anti-alias filters.
const PRIOR_SIGMA_S: f64 = 1.0;
/// Largest lag, in s. A larger estimate probably comes from a position error.
const LARGEST_S: f64 = 2.0;
/// Smallest increase of the logarithm of the likelihood for which the lag becomes a state. The prior alone decreases this
/// logarithm by ln(1 s / 0.05 s) = 3 for a lag that is known to 0.05 s.
const LEAST_GAIN: f64 = 6.0;
/// Factors on the white noise and on the process that are tried first. Without a state for the lag, the noise contains its
/// effect.
const FACTORS: [[f64; 2]; 5] = [[1.0, 1.0], [1.0, 0.5], [0.7, 1.0], [0.5, 0.5], [0.4, 0.25]];

impl NoiseLikelihood<'_> {
    /// Adds a state for the lag if that gains more than [`LEAST_GAIN`] and the lag is at most [`LARGEST_S`]. Otherwise
    /// returns `best` and this likelihood.
    pub(super) fn with_latency(self, best: (NoisePoint, f64), least_used: usize) -> ((NoisePoint, f64), Self) {
        if self.search.latency_sigma_s.is_some() || self.search.aircraft.is_some() {
            return (best, self);
        }
        let late = Self { latency_sigma_s: Some(PRIOR_SIGMA_S), ..self };
        let mut first: Vec<NoisePoint> = FACTORS.map(|factors| self.quieter(best.0, factors)).to_vec();
        // A change of the permanent field that is found without this state may be an effect of the lag.
        if self.search.given[PERMANENT[0]].is_none() {
            let constant = |mut point: NoisePoint| {
                point[PERMANENT[0]] = 0.0;
                point
            };
            first.extend(first.clone().into_iter().map(constant));
        }
        let scores = late.scores(&first);
        let scored = first.into_iter().zip(scores.iter().map(|score| score.log_likelihood(least_used)));
        let (start, log) = scored.fold(best, |best, one| if one.1 > best.1 { one } else { best });
        if log <= best.1 {
            return (best, self);
        }
        let found = late.best_of([start].into_iter(), least_used);
        let is_late = found.1 > best.1 + LEAST_GAIN && late.lag_s(&found.0).abs() <= LARGEST_S;
        if is_late { (found, late) } else { (best, self) }
    }

    /// Estimate of the lag at the last sample, in s; NaN without an estimate.
    fn lag_s(&self, point: &NoisePoint) -> f64 {
        let output = self.output_with_states(point);
        output.ok().and_then(|output| output.latency_s[0].last().copied()).unwrap_or(f64::NAN)
    }

    /// The point with its white noise and its process times these factors, unless they are given.
    fn quieter(&self, mut point: NoisePoint, factors: [f64; 2]) -> NoisePoint {
        for (at, factor) in factors.into_iter().enumerate().filter(|(at, _)| self.search.given[*at].is_none()) {
            point[at] *= factor;
        }
        self.within_ranges(point)
    }
}

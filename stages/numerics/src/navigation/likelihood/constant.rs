//! Search for constant states: the lag of the magnetometer, and the bias between the height of the INS and the height
//! on the map. The lag of late time stamps is positive. The bias of an aircraft above its assumed height is positive.

use super::{LineNoise, NoiseLikelihood, NoisePoint, NoiseSearch, PERMANENT, ThinnedLine};
use crate::navigation::{aided::AidedOutput, output::NavigationError};

/// Constant state: its prior standard deviation, and the largest estimate for which the state is used.
struct ConstantState {
    prior_sigma: f64,
    largest: f64,
    /// Estimate at each sample of an output.
    values: fn(&AidedOutput) -> &[f64],
}

/// Lag, in seconds. The prior covers the delays of loggers and anti-alias filters. A larger estimate probably comes
/// from a position error.
const LAG: ConstantState = ConstantState { prior_sigma: 1.0, largest: 2.0, values: |output| &output.latency_s[0] };
/// Height bias, in metres. The prior covers the weather (8 m per hPa), the temperature at low heights, and the geoid. A
/// larger estimate probably comes from a wrong map.
const MAP_HEIGHT: ConstantState =
    ConstantState { prior_sigma: 50.0, largest: 250.0, values: |output| &output.map_height_m[0] };
/// Smallest increase of the logarithm of the likelihood for which a constant becomes a state. The prior alone decreases
/// this logarithm by ln(1 s / 0.05 s) = 3 for a lag that is known to 0.05 s, and by as much for a height that is known
/// to 2.5 m.
const LEAST_GAIN: f64 = 6.0;
/// Factors on the white noise and on the process that are tried first. Without a state for the constant, the estimated
/// noise includes the effect of the constant.
const FACTORS: [[f64; 2]; 5] = [[1.0, 1.0], [1.0, 0.5], [0.7, 1.0], [0.5, 0.5], [0.4, 0.25]];

/// Increase of the logarithm of the likelihood by a state for the height bias, compared with `noise`, which has no such
/// state. The likelihood with the state is the best over `noise` and some smaller noises. This is a test without a
/// search: a positive value means that a search may find a bias.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`](crate::navigation::line::NavigationLine::check).
pub fn height_gain(search: &NoiseSearch<'_>, noise: &LineNoise) -> Result<f64, NavigationError> {
    search.line.check()?;
    let thinned = ThinnedLine::new(search.line, search.rows);
    let exact = NoiseLikelihood::with_noise(search, &thinned, &[], noise);
    let biased = NoiseLikelihood { map_height_sigma_m: Some(MAP_HEIGHT.prior_sigma), ..exact };
    let own = exact.scores(&[noise.point()])[0];
    let scores = biased.scores(&exact.quieter_points(noise.point()));
    let logs = scores.iter().map(|score| score.log_likelihood(own.used));
    Ok(logs.fold(f64::NEG_INFINITY, f64::max) - own.log)
}

impl NoiseLikelihood<'_> {
    /// Whether the lag or the height bias is a state.
    pub(super) fn has_constants(&self) -> bool {
        self.latency_sigma_s.is_some() || self.map_height_sigma_m.is_some()
    }

    /// Adds a state for the lag if the likelihood requires it. Otherwise returns `best` and this likelihood.
    pub(super) fn with_latency(self, best: (NoisePoint, f64), least_used: usize) -> ((NoisePoint, f64), Self) {
        if self.search.latency_sigma_s.is_some() || self.search.aircraft.is_some() {
            return (best, self);
        }
        self.with_constant(Self { latency_sigma_s: Some(LAG.prior_sigma), ..self }, &LAG, best, least_used)
    }

    /// Adds a state for the height bias if the likelihood requires it. Otherwise returns `best` and this likelihood.
    pub(super) fn with_map_height(self, best: (NoisePoint, f64), least_used: usize) -> ((NoisePoint, f64), Self) {
        let is_given = self.search.map_height_sigma_m.is_some() || self.search.aircraft.is_some();
        if is_given || !self.search.line.map.has_upward_slope() {
            return (best, self);
        }
        let biased = Self { map_height_sigma_m: Some(MAP_HEIGHT.prior_sigma), ..self };
        // A bias beyond the levels of the map loses measurements, and their terms are then missing from the likelihood.
        let least_used = least_used.max(self.scores(&[best.0])[0].used);
        self.with_constant(biased, &MAP_HEIGHT, best, least_used)
    }

    /// The likelihood `other`, which has one more state, with its best point, if it gains more than [`LEAST_GAIN`] and
    /// the estimate is not too large. Otherwise returns `best` and this likelihood.
    fn with_constant(
        self,
        other: Self,
        state: &ConstantState,
        best: (NoisePoint, f64),
        least_used: usize,
    ) -> ((NoisePoint, f64), Self) {
        let first = self.quieter_points(best.0);
        let scores = other.scores(&first);
        let scored = first.into_iter().zip(scores.iter().map(|score| score.log_likelihood(least_used)));
        let (start, log) = scored.fold(best, |best, one| if one.1 > best.1 { one } else { best });
        if log <= best.1 {
            return (best, self);
        }
        let found = other.best_of([start].into_iter(), least_used);
        let gains = found.1 > best.1 + LEAST_GAIN;
        if gains && other.estimate(state, &found.0).abs() <= state.largest { (found, other) } else { (best, self) }
    }

    /// Estimate of a constant state at the last sample; NaN without an estimate.
    fn estimate(&self, state: &ConstantState, point: &NoisePoint) -> f64 {
        let output = self.output_with_states(point);
        output.ok().and_then(|output| (state.values)(&output).last().copied()).unwrap_or(f64::NAN)
    }

    /// The points that are tried first with a state for the constant.
    fn quieter_points(&self, point: NoisePoint) -> Vec<NoisePoint> {
        let mut first: Vec<NoisePoint> = FACTORS.map(|factors| self.quieter(point, factors)).to_vec();
        // A change of the permanent field that is found without this state may be an effect of the constant.
        if self.search.given[PERMANENT[0]].is_none() {
            let constant = |mut point: NoisePoint| {
                point[PERMANENT[0]] = 0.0;
                point
            };
            first.extend(first.clone().into_iter().map(constant));
        }
        first
    }

    /// The point with its white noise and its process multiplied by these factors; given parameters are unchanged.
    fn quieter(&self, mut point: NoisePoint, factors: [f64; 2]) -> NoisePoint {
        for (at, factor) in factors.into_iter().enumerate().filter(|(at, _)| self.search.given[*at].is_none()) {
            point[at] *= factor;
        }
        self.within_ranges(point)
    }
}

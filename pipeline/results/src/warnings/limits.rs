//! Limits beyond which a figure is flagged. All limits are in this file.
//!
//! The mean over a line of the normalised estimation error squared (NEES, of the horizontal position, two degrees of
//! freedom) is 2 for a consistent filter. The mean of the normalised innovation squared (NIS, one degree of freedom) is
//! 1 [Bar-Shalom, Li & Kirubarajan 2001, section 5.4]. The textbook interval for such a mean assumes independent
//! samples, but the samples of a line are correlated:
//!
//! - Position errors are correlated over minutes, so a line holds few independent samples, at worst a single one.
//!   NEES/2 of a single sample is exponentially distributed. It exceeds ten times its expected value with probability
//!   e⁻¹⁰ (once in 22,000 lines), and is below a tenth with 1 − e⁻⁰·¹ (10 %); with three independent samples, with 0.4
//!   %. A mean beyond a factor of ten is therefore an inconsistent filter, and hardly ever chance.
//! - Innovations are correlated over seconds. A line thus has dozens of independent samples, and chance stays within a
//!   factor of two. The factor of four matters in practice: the predicted sigma is half or twice its correct value.
//!
//! A row of pooled scores is flagged if one of its lines is: a mean of means beyond a limit has a line beyond it.

/// Expected value of a consistency mean, and the factor beyond which it is flagged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencyLimit {
    /// The mean for a consistent filter.
    pub mean: f64,
    /// Factor above or below the mean beyond which a value is flagged.
    pub factor: f64,
}

impl ConsistencyLimit {
    /// Lower limit; below this limit, the filter is far too cautious.
    pub fn low(&self) -> f64 {
        self.mean / self.factor
    }

    /// Upper limit; above this limit, the filter is far overconfident.
    pub fn high(&self) -> f64 {
        self.mean * self.factor
    }

    /// Whether `value` is beyond either limit.
    pub fn is_far(&self, value: f64) -> bool {
        value < self.low() || value > self.high()
    }
}

/// Mean normalised estimation error squared of the horizontal position: 0.2 to 20.
pub const NEES: ConsistencyLimit = ConsistencyLimit { mean: 2.0, factor: 10.0 };

/// Mean normalised innovation squared: 0.25 to 4.
pub const NIS: ConsistencyLimit = ConsistencyLimit { mean: 1.0, factor: 4.0 };

/// Smallest `whiteness` of innovations that count as white; the expected value is 0.95. Four or fewer of 20 lags are
/// outside their band with probability 0.997.
pub const WHITENESS: f64 = 0.8;

/// Largest `correlated_nis` of innovations that are not white; the expected value is 1. If the assumed noise is
/// increased to account for the correlation, the value is 1, although the correlation remains. On 45 lines of nine
/// simulated flights with estimated noise, correlated innovations and a median NEES of 1.9, the statistic is 0.76 to
/// 1.40; with a magnetometer 0.6 s late 2.2 to 2.9, and on a map of sparse lines without its error above 200.
pub const CORRELATED_NIS: f64 = 1.5;

/// Smallest ratio of the initial position's standard deviation to the distance over which the map is linear that is
/// flagged. On flights of another simulator the extended Kalman filter converges at ratios up to 0.8 and loses the
/// aircraft at 1.6; at 1.07 over the Osborne map it converges.
pub const WIDE_START: f64 = 1.5;

/// Lag of the magnetometer that is flagged: in s, and in standard deviations of its estimate.
pub const LAG_S: f64 = 0.05;
/// See [`LAG_S`] and [`HEIGHT_BIAS_M`].
pub const LAG_SIGMAS: f64 = 4.0;

/// Height bias on the map that is flagged: in m, and in [`LAG_SIGMAS`] standard deviations of its estimate. The weather
/// changes the height of a barometer by less within an hour.
pub const HEIGHT_BIAS_M: f64 = 10.0;

/// Minimum anomaly retention of a compensation.
pub const RETENTION: f64 = 0.9;
/// Number of standard errors by which a retention must be below its limit.
pub const RETENTION_ERRORS: f64 = 2.0;

/// Maximum share of a line's samples off the map.
pub const OFF_MAP: f64 = 0.5;

/// Maximum share of a line's samples over which the map is too flat for a position.
pub const FLAT: f64 = 0.5;

/// Minimum share of samples off the map that counts as the cause of an error.
pub const OFF_MAP_CAUSE: f64 = 0.1;

/// Minimum bias of the measurement, in its assumed standard deviations, that counts as a cause. A bias of the
/// measurement biases the position.
pub const BIAS_SIGMAS: f64 = 2.0;

/// Minimum ratio of the compensation error to the assumed measurement noise at which the compensation error counts as a
/// cause.
pub const LEFT_OVER_SIGMA: f64 = 1.5;

/// Maximum difference between two dates of the core field, in years: it changes by up to 100 nT per year.
pub const DATE_A: f64 = 0.25;

/// Error of a map at the wrong height above which it is flagged, nT. It is half the assumed measurement noise, which
/// makes the total error a tenth larger than the filter assumes. It is at most 5 nT, the error of a good map.
pub fn map_height_nt(sigma_nt: Option<f64>) -> f64 {
    sigma_nt.map_or(5.0, |sigma| (0.5 * sigma).min(5.0))
}

#[cfg(test)]
mod tests {
    use schemas::metric::MetricPreference;

    use super::*;
    use crate::scores::declared;

    #[test]
    fn unit_limits_agree_with_the_targets_of_the_metrics() {
        let near = declared(["nees", "nis"]).map(|m| m.better);
        assert_eq!(near, [MetricPreference::Near(NEES.mean), MetricPreference::Near(NIS.mean)]);
    }
}

//! How far a figure may be from its law before it is marked. All limits are here.
//!
//! The mean over a line of the normalised estimation error squared (NEES, of the horizontal position, two degrees of
//! freedom) is 2 for a filter whose covariance is that of its errors, and of the normalised innovation squared (NIS,
//! one degree of freedom) it is 1 [Bar-Shalom, Li & Kirubarajan 2001, section 5.4]. The textbook's interval for such a
//! mean takes independent samples; those of one line are not:
//!
//! - Position errors last for minutes, so a line holds few independent ones, at worst a single one. NEES/2 of a single
//!   one is exponentially distributed: ten times the law is exceeded with probability e⁻¹⁰ (once in 22,000 lines), a
//!   tenth is undercut with 1 − e⁻⁰·¹ (10 %), of three independent ones with 0.4 %. A mean beyond a factor of ten is
//!   therefore a filter that is wrong about itself, and hardly ever chance.
//! - Innovations change within seconds, so that a line has dozens of independent ones and chance stays within a factor
//!   of two. The factor of four is what matters in practice: the predicted sigma is half or twice what it should be.
//!
//! A row of pooled scores is marked where one of its lines is: a mean of means beyond a limit has a line beyond it.

/// Expected value of a consistency mean, and the factor beyond which it is remarked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencyLimit {
    /// The mean of a filter whose covariance is that of its errors.
    pub mean: f64,
    /// How many times more, or less, is far.
    pub factor: f64,
}

impl ConsistencyLimit {
    /// Below this the filter is far too cautious.
    pub fn low(&self) -> f64 {
        self.mean / self.factor
    }

    /// Above this it is far too sure of itself.
    pub fn high(&self) -> f64 {
        self.mean * self.factor
    }

    /// Whether `value` is beyond either.
    pub fn is_far(&self, value: f64) -> bool {
        value < self.low() || value > self.high()
    }
}

/// Mean normalised estimation error squared of the horizontal position: 0.2 to 20.
pub const NEES: ConsistencyLimit = ConsistencyLimit { mean: 2.0, factor: 10.0 };

/// Mean normalised innovation squared: 0.25 to 4.
pub const NIS: ConsistencyLimit = ConsistencyLimit { mean: 1.0, factor: 4.0 };

/// Smallest `whiteness` of innovations that count as white; the expected value is 0.95. Four or fewer of 20 lags outside
/// their band have the probability 0.997.
pub const WHITENESS: f64 = 0.8;

/// Largest `correlated_nis` of innovations that are not white; the expected value is 1. A noise that is increased for the
/// correlation of the innovations makes it 1 and leaves the correlation. On 45 lines of nine simulated flights with
/// estimated noise, correlated innovations and NEES of about 2, it is 0.5 to 1.3.
pub const CORRELATED_NIS: f64 = 1.5;

/// The least part of the geology that compensation should leave.
pub const RETENTION: f64 = 0.9;
/// Standard errors that a retention must be below its limit.
pub const RETENTION_ERRORS: f64 = 2.0;

/// The share of a line's samples that may be off the map.
pub const OFF_MAP: f64 = 0.5;

/// The share of a line's samples over which the map may be too flat to tell a position.
pub const FLAT: f64 = 0.5;

/// The share from which samples off the map are named as a cause of an error.
pub const OFF_MAP_CAUSE: f64 = 0.1;

/// A constant of the measurement, in its sigmas, from which it is named as a cause: the filter takes it for a position.
pub const BIAS_SIGMAS: f64 = 2.0;

/// Minimum ratio of the compensation error to the measurement sigma at which it is named as a cause.
pub const LEFT_OVER_SIGMA: f64 = 1.5;

/// By how much two dates of the core field may differ, in years: it changes by up to 100 nT in one.
pub const DATE_A: f64 = 0.25;

/// The error of a map at the wrong height that is worth a warning, in nT: half the measurement sigma, which makes the
/// total error a tenth larger than the filter expects, and 5 nT at most, which is a good map's own.
pub fn map_height_nt(sigma_nt: Option<f64>) -> f64 {
    sigma_nt.map_or(5.0, |sigma| (0.5 * sigma).min(5.0))
}

#[cfg(test)]
mod tests {
    use schemas::metric::MetricPreference;

    use super::*;
    use crate::views::scores::declared;

    #[test]
    fn unit_the_law_of_a_mean_is_what_its_metric_is_to_be_near() {
        let near = declared(["nees", "nis"]).map(|m| m.better);
        assert_eq!(near, [MetricPreference::Near(NEES.mean), MetricPreference::Near(NIS.mean)]);
    }
}

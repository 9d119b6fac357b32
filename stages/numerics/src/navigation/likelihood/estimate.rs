//! Estimated noise of a line.

use super::NoisePoint;

/// Noise of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineNoise {
    /// White noise of each thinned measurement, in nT, increased to allow for the correlation of the innovations.
    pub sigma_nt: IntervalEstimate,
    /// Standard deviation of the Gauss-Markov process, in nT.
    pub fogm_sigma_nt: IntervalEstimate,
    /// Time constant of the Gauss-Markov process, in seconds.
    pub fogm_tau_s: IntervalEstimate,
    /// Change of the permanent field, if it is given or detected: standard deviation of each component, in nT, and time
    /// constant, in seconds. The time constant is reduced so that the variances of process noise and white noise
    /// increase by the same factor.
    pub permanent: Option<[IntervalEstimate; 2]>,
    /// Prior standard deviation of the lag of the magnetometer, in seconds, if it is given or detected.
    pub latency_sigma_s: Option<f64>,
    /// Prior standard deviation of the bias between the height of the INS and the height on the map, in metres, if it
    /// is given or detected.
    pub map_height_sigma_m: Option<f64>,
    /// Factor on the variance of the map's own error at each sample, increased to allow for the correlation of the
    /// innovations; 0 if no map error is given or detected.
    pub map_factor: f64,
    /// Factor by which `sigma_nt` was increased; 1 for white innovations. `map_factor` contains the square of this
    /// factor.
    pub inflation: f64,
    /// Logarithm of the likelihood, with the prior and without its constant.
    pub log_likelihood: f64,
    /// Number of predicted measurements.
    pub used: usize,
}

impl LineNoise {
    /// Parameters, without the increase for the correlation of the innovations.
    pub(super) fn point(&self) -> NoisePoint {
        let [permanent_nt, permanent_tau_s] = self.permanent.map_or([0.0; 2], |of| of.map(|estimate| estimate.value));
        let white_nt = self.sigma_nt.value / self.inflation;
        [white_nt, self.fogm_sigma_nt.value, self.fogm_tau_s.value, permanent_nt, permanent_tau_s]
    }

    /// Factor on the variance of the map's own error, without the increase for the correlation of the innovations.
    pub(super) fn own_map_factor(&self) -> f64 {
        self.map_factor / (self.inflation * self.inflation)
    }
}

/// Estimated parameter with its 95 % interval; for a given parameter, the interval has zero width. The interval follows
/// from the likelihood and does not include errors of the noise model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalEstimate {
    /// Estimate.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl IntervalEstimate {
    /// Returns the estimate and its interval, multiplied by a factor.
    pub(super) fn scaled(self, by: f64) -> Self {
        Self { value: by * self.value, low: by * self.low, high: by * self.high }
    }
}

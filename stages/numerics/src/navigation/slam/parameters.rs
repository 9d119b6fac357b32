//! Parameters of the filter.

use crate::navigation::ins_error::{InsErrorModel, ParameterError, require};
use params::{Rule, choice};

use super::kernel::{AnomalyKernel, MOST_NEIGHBOURS};
use super::smoother::SlamSmootherParameters;

choice! {
    /// Prediction of a measurement from earlier measurements.
    #[derive(Default)]
    pub enum ExpectedMeasurement {
        /// Gaussian process of the anomaly, the temporal variation and the noise, conditioned on the nearest earlier
        /// samples and on the most recent samples. The product of successive weights is the likelihood of the whole
        /// flight (Vecchia's approximation), because of the conditioning on the most recent samples. [Vecchia 1988;
        /// Datta et al. 2016]
        #[default]
        NearestNeighbour = "nearest_neighbour",
        /// Gaussian-process regression on the earlier samples within a radius, with their mean as the prior mean.
        /// Successive weights are assumed independent. [Lee 2019, (82)-(85)]
        Regression = "regression",
        /// Mean of the earlier samples within a radius, weighted by the inverse squared distance.
        InverseDistance = "inverse_distance",
    }
}

choice! {
    /// Source of the hyper-parameters of the Gaussian process.
    #[derive(Default)]
    pub enum HyperparameterSource {
        /// Maximum likelihood on the first part of the flight. [Lee 2019, (53)]
        #[default]
        Fitted = "fitted",
        /// Values from the spec.
        Fixed = "fixed",
    }
}

/// Parameters of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlamParameters {
    /// Number of particles.
    pub particles: usize,
    /// Seed of all random draws.
    pub seed: u64,
    /// Minimum time between two updates of the particles, in seconds. Samples within this time are averaged.
    pub update_interval_s: f64,
    /// Prediction of a measurement from earlier measurements.
    pub expected: ExpectedMeasurement,
    /// Whether `kernel` is fitted first.
    pub hyperparameters: HyperparameterSource,
    /// Gaussian process of the anomaly; if the kernel is fitted, the start of the search.
    pub kernel: AnomalyKernel,
    /// Duration, in seconds, of the first part of the flight, which the fit uses.
    pub fit_window_s: f64,
    /// Maximum number of earlier samples in a prediction.
    pub neighbours: usize,
    /// Number of most recent samples that a prediction by nearest neighbours also uses.
    pub recent: usize,
    /// Minimum age of earlier samples, in seconds; at least the time of flight over two and a half radii.
    pub ignore_s: f64,
    /// Radius of a revisit for `regression` and `inverse_distance`, in metres: a particle revisits if more than
    /// `trigger_points` earlier samples are within it. `None` is the larger of 18 m and 1.6 times the mean distance
    /// between samples.
    pub trigger_radius_m: Option<f64>,
    /// A revisit requires more than this number of earlier samples within `trigger_radius_m`.
    pub trigger_points: usize,
    /// Radius, in metres, within which earlier samples are used in a prediction; `None` is half the length of the
    /// kernel, but at most 0.4 of the distance flown in `ignore_s`.
    pub interpolation_radius_m: Option<f64>,
    /// Maximum height difference of earlier samples, in metres. A smaller difference adds the variance 2 (sigma_se Δh /
    /// length)², which is the variance of the vertical derivative of a potential field times Δh².
    pub max_height_difference_m: f64,
    /// Standard deviation of an inverse-distance-weighted prediction, in nT. [Lee 2019, section 3.3.3: R = 100 nT²]
    pub interpolant_sigma_nt: f64,
    /// The particles are resampled if their effective number, as a fraction of all particles, is below this value. [Lee
    /// 2019, (77)]
    pub resample_below: f64,
    /// Largest NIS of a measurement; measurements with larger NIS are rejected. `None` uses every measurement.
    pub gate_nis: Option<f64>,
    /// Returns the most probable track of the whole flight in place of the filter's track; see [`super::smoother`].
    pub smoother: Option<SlamSmootherParameters>,
    /// Returns the error states of every sample.
    pub keep_states: bool,
    /// Returns the covariance of every sample; for a smoothed track, only the covariance of the position.
    pub keep_covariance: bool,
}

impl Default for SlamParameters {
    fn default() -> Self {
        Self {
            particles: 1000,
            seed: 0,
            update_interval_s: 1.0,
            expected: ExpectedMeasurement::default(),
            hyperparameters: HyperparameterSource::default(),
            kernel: AnomalyKernel::default(),
            fit_window_s: 600.0,
            neighbours: 12,
            recent: 4,
            ignore_s: 30.0,
            trigger_radius_m: None,
            trigger_points: 2,
            interpolation_radius_m: None,
            max_height_difference_m: 100.0,
            interpolant_sigma_nt: 10.0,
            resample_below: 0.5,
            gate_nis: None,
            smoother: None,
            keep_states: false,
            keep_covariance: false,
        }
    }
}

/// Minimum and maximum number of particles.
const PARTICLES: (f64, f64) = (2.0, 1e6);

impl SlamParameters {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Fails for the first parameter that is out of its valid range. Also returns the errors of
    /// [`InsErrorModel::check`] for `errors`.
    pub fn check(&self, errors: &InsErrorModel) -> Result<(), ParameterError> {
        errors.check()?;
        let within = Rule::Between(PARTICLES.0, PARTICLES.1);
        require("particles", self.particles as f64, within)?;
        require("update_interval_s", self.update_interval_s, Rule::NotNegative)?;
        self.kernel.check()?;
        self.smoother.map_or(Ok(()), |smoother| smoother.check())?;
        require("fit_window_s", self.fit_window_s, Rule::Positive)?;
        let most = (MOST_NEIGHBOURS - self.recent.min(MOST_NEIGHBOURS - 1)) as f64;
        require("neighbours", self.neighbours as f64, Rule::Between(1.0, most))?;
        require("recent", self.recent as f64, Rule::Between(0.0, (MOST_NEIGHBOURS - 1) as f64))?;
        require("ignore_s", self.ignore_s, Rule::NotNegative)?;
        let optional = [
            ("trigger_radius_m", self.trigger_radius_m),
            ("interpolation_radius_m", self.interpolation_radius_m),
            ("gate_nis", self.gate_nis),
        ];
        for (name, value) in optional {
            value.map_or(Ok(()), |value| require(name, value, Rule::Positive))?;
        }
        require("max_height_difference_m", self.max_height_difference_m, Rule::NotNegative)?;
        require("interpolant_sigma_nt", self.interpolant_sigma_nt, Rule::Positive)?;
        require("resample_below", self.resample_below, Rule::Between(0.0, 1.0))
    }
}

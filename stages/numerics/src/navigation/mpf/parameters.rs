//! Parameters of the filter.

use crate::navigation::ins_error::ParameterError;
use params::{Rule, obeys};

/// Parameters of the marginalised particle filter; noise and INS errors are given by the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MpfParameters {
    /// Number of particles, from 1 to [`Self::MOST_PARTICLES`]; with `adapt`, the smallest number.
    pub particles: usize,
    /// Determines the number of particles by KLD-sampling (see [`super::run`]), up to [`Self::MOST_ADAPTED`].
    pub adapt: bool,
    /// Seed of all random numbers. Results are bit-identical for any number of threads.
    pub seed: u64,
    /// Threshold of resampling, as a fraction of the number of particles. The filter resamples when the effective
    /// number 1/Σq² falls below the threshold; 0 never resamples, 1 always resamples.
    pub resample_threshold: f64,
    /// Resamples from a kernel density instead of the particles (see [`super::run`]). Without regularisation, copies of
    /// a few particles remain for a navigation-grade INS, whose position error has almost no driving noise.
    pub regularise: bool,
    /// Distance over which the map is nearly linear, in metres. It is about the height above the sources. A wider cloud
    /// has a separate kernel for each of its cells. For a difference, the slope must be linear over this distance.
    pub smooth_over_m: f64,
    /// Independent noise for the position of each resampled particle, per axis: this number times the range of the
    /// particles over the square root of their number [Gordon, Salmond & Smith 1993, who use 0.2]; 0 adds no noise.
    pub roughening: f64,
    /// Largest NIS of a measurement for the whole cloud; measurements with larger NIS are rejected and counted. `None`
    /// rejects only measurements that contradict every particle.
    pub gate_nis: Option<f64>,
    /// Interval, in samples, at which the modes are returned. The modes of the last sample are always returned.
    pub modes_every: Option<usize>,
    /// Returns the mean of the error states of every sample (144 bytes each).
    pub keep_states: bool,
    /// Returns the covariance of the states at every sample (2.6 kB each).
    pub keep_covariance: bool,
}

impl Default for MpfParameters {
    fn default() -> Self {
        Self {
            particles: 1000,
            adapt: false,
            seed: 0,
            resample_threshold: 0.5,
            regularise: true,
            smooth_over_m: 200.0,
            roughening: 0.0,
            gate_nis: None,
            modes_every: None,
            keep_states: false,
            keep_covariance: false,
        }
    }
}

impl MpfParameters {
    /// Maximum number of particles, which take about half a gigabyte.
    pub const MOST_PARTICLES: usize = 1_000_000;
    /// Maximum number of particles of KLD-sampling, sufficient for a standard deviation of 2.5 km on each axis with
    /// cells of 200 m.
    pub const MOST_ADAPTED: usize = 50_000;

    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Fails for a number of particles outside 1 to [`Self::MOST_PARTICLES`], a threshold outside 0 to 1, a
    /// `smooth_over_m` or a gate that is not a finite number above 0, a roughening that is not a number of at least 0,
    /// or an interval of 0 samples between modes.
    pub fn check(&self) -> Result<(), ParameterError> {
        let require = |name: &str, value: f64, rule: Rule| obeys(&value, name, rule).map_err(ParameterError);
        require("particles", self.particles as f64, Rule::Between(1.0, Self::MOST_PARTICLES as f64))?;
        require("resample_threshold", self.resample_threshold, Rule::Between(0.0, 1.0))?;
        require("smooth_over_m", self.smooth_over_m, Rule::Positive)?;
        require("roughening", self.roughening, Rule::NotNegative)?;
        if let Some(gate) = self.gate_nis {
            require("gate_nis", gate, Rule::Positive)?;
        }
        require("modes_every", self.modes_every.map_or(1.0, |every| every as f64), Rule::Positive)
    }
}

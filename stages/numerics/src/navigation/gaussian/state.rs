//! State estimates: mean and covariance of the 18 states, and of further states.

use std::ops::Range;

use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::{LineStep, NavigationLine};
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix, StateVector};
use crate::signal::gauss_markov::GaussMarkov;

use super::covariance::Covariance;
use super::measured_states;

/// Gaussian over the error states, in the units of `pinson`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StateEstimate {
    /// Mean.
    pub(crate) x: StateVector,
    /// Covariance, exactly symmetric.
    pub(crate) p: StateMatrix,
}

impl StateEstimate {
    /// Zero error of an INS at the first sample, with the initial covariance.
    pub(crate) fn start_of(errors: &InsErrorModel, ins: &InsSeries<'_>) -> Self {
        Self { x: [0.0; STATES], p: errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]) }
    }

    /// Variance of latitude, covariance of latitude and longitude, and variance of longitude, in rad².
    #[inline(always)]
    pub(crate) fn horizontal(&self) -> [f64; 3] {
        [self.p[LAT][LAT], self.p[LAT][LON], self.p[LON][LON]]
    }

    /// Latitude, longitude (rad), height (m) and temporal variation (nT).
    #[inline(always)]
    pub(crate) fn measured(&self) -> [f64; 4] {
        measured_states(&self.x)
    }

    /// Rejects states and variances that are not finite, and negative variances.
    ///
    /// # Errors
    /// Fails with [`NavigationError::Diverged`] at this row and time.
    #[inline(always)]
    pub(crate) fn check(&self, row: usize, tt_s: f64) -> Result<(), NavigationError> {
        // A finite value times zero is zero. A NaN is not equal to anything.
        let (mut finite, mut least) = (0.0, 0.0_f64);
        for state in 0..STATES {
            let variance = self.p[state][state];
            finite += self.x[state] * 0.0 + variance * 0.0;
            least = least.min(variance);
        }
        if finite != 0.0 || least < 0.0 {
            return Err(NavigationError::Diverged { row, tt_s });
        }
        Ok(())
    }
}

/// Order of the states: 18 of the INS and the temporal variation, Gauss-Markov errors (in `fixed_lag` one per
/// magnetometer), and the coefficients of each magnetometer in turn.
#[derive(Clone, Debug, Default)]
pub(crate) struct StateLayout {
    /// Gauss-Markov errors. The time constant of an error with a correlation length is computed for each step; see
    /// [`Self::error_at`].
    pub errors: Vec<GaussMarkov>,
    /// Positions of the errors with a correlation length, and this length in metres.
    pub lengths_m: Vec<(usize, f64)>,
    /// Ranges of the coefficients of each magnetometer.
    pub blocks: Vec<Range<usize>>,
    /// Random-walk densities of all coefficients, per second.
    pub walk: Vec<f64>,
}

impl StateLayout {
    pub fn dim(&self) -> usize {
        self.coefficients() + self.walk.len()
    }

    /// Index of the first coefficient.
    pub fn coefficients(&self) -> usize {
        STATES + self.errors.len()
    }

    /// Propagation of an error at a ground speed.
    pub fn error_at(&self, place: usize, speed_mps: f64) -> GaussMarkov {
        let error = self.errors[place];
        match self.lengths_m.iter().find(|(of, _)| *of == place) {
            Some((_, length_m)) => GaussMarkov { tau_s: length_m / speed_mps, ..error },
            None => error,
        }
    }

    /// Propagation of the errors over a step.
    pub fn errors_of<'a>(&'a self, step: &'a LineStep) -> impl Iterator<Item = GaussMarkov> + 'a {
        (0..self.errors.len()).map(|place| self.error_at(place, step.speed_mps))
    }
}

/// Mean and covariance of the states of a layout.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gaussian {
    pub x: Vec<f64>,
    pub p: Covariance,
}

impl Gaussian {
    /// States of a layout without coefficients before the first sample of a line.
    pub fn start_of(line: &NavigationLine<'_>, layout: &StateLayout) -> Self {
        let dim = layout.dim();
        let mut start = Self { x: vec![0.0; dim], p: Covariance::zero(dim) };
        let first = line.errors.initial_covariance(line.ins.lat_deg[0].to_radians(), line.ins.alt_m[0]);
        start.p.set_ins(&first);
        for (k, error) in layout.errors.iter().enumerate() {
            *start.p.at_mut(STATES + k, STATES + k) = error.sigma * error.sigma;
        }
        start
    }

    pub fn dim(&self) -> usize {
        self.x.len()
    }

    pub fn copy_from(&mut self, other: &Self) {
        self.x.clone_from(&other.x);
        self.p.copy_from(&other.p);
    }

    /// The first 18 states.
    pub fn ins_state(&self) -> StateVector {
        std::array::from_fn(|state| self.x[state])
    }

    /// Whether all values are finite and no variance is negative.
    pub fn is_sound(&self) -> bool {
        let finite = self.x.iter().chain(self.p.rows().flatten()).all(|value| value.is_finite());
        finite && (0..self.dim()).all(|k| self.p.at(k, k) >= 0.0)
    }
}

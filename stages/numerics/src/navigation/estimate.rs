//! Gaussian estimate that a filter propagates along a line: time update, measurement update with a scalar, and the
//! recursion.
//!
//! The functions are inlined into the loop of a filter, which is compiled for each kind of vector unit. Products and
//! sums are not fused, so the results of all units are bit-identical.

use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{LAT, LON, PinsonForm, STATES, StateMatrix, StateVector, TimeConstants, pinson_matrix};
use crate::navigation::position_fixes::StateFix;
use crate::navigation::sensitivity::{MEASURED, Sensitivity, add_scaled, measured_states, mirror};
use crate::navigation::transition::{NoiseDiscretisation, propagate_state, step_covariance, transition_matrix};

/// Process model of a step. Only the INS quantities change along a line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InsProcessModel {
    times: TimeConstants,
    form: PinsonForm,
    density: StateVector,
    noise: NoiseDiscretisation,
}

impl InsProcessModel {
    /// Process model of an error model.
    pub(crate) fn from_error_model(errors: &InsErrorModel) -> Self {
        Self {
            times: errors.time_constants(),
            form: errors.pinson,
            density: errors.noise_density(),
            noise: errors.noise,
        }
    }

    /// Φ of the step from the previous sample to `row`.
    #[inline(always)]
    pub(crate) fn transition(&self, ins: &InsSeries<'_>, row: usize) -> StateMatrix {
        let f = pinson_matrix(&ins.point(row - 1), &self.times, self.form);
        transition_matrix(&f, ins.tt_s[row] - ins.tt_s[row - 1])
    }
}

/// Gaussian over the error states, in the units of `pinson`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StateEstimate {
    /// Mean.
    pub(crate) x: StateVector,
    /// Covariance, exactly symmetric.
    pub(crate) p: StateMatrix,
}

/// Scalar measurement z = H x + v of the states, linearised at an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LinearisedMeasurement {
    /// H.
    pub(crate) h: Sensitivity,
    /// P Hᵀ.
    pub(crate) ph: StateVector,
    /// H P Hᵀ.
    pub(crate) variance: f64,
}

/// Quantities of a measurement update.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MeasurementUpdate {
    /// K.
    pub(crate) gain: StateVector,
    /// z - H x a priori.
    pub(crate) innovation: f64,
    /// 1/(H P Hᵀ + R).
    pub(crate) weight: f64,
}

impl StateEstimate {
    /// Zero error, and the initial covariance at the first sample of an INS.
    pub(crate) fn start_of(errors: &InsErrorModel, ins: &InsSeries<'_>) -> Self {
        Self { x: [0.0; STATES], p: errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]) }
    }

    /// x ← Φ x and P ← Φ P Φᵀ + Q for the step from the previous sample to `row`. Returns Φ.
    #[inline(always)]
    pub(crate) fn propagate(&mut self, model: &InsProcessModel, ins: &InsSeries<'_>, row: usize) -> StateMatrix {
        let dt_s = ins.tt_s[row] - ins.tt_s[row - 1];
        let f = pinson_matrix(&ins.point(row - 1), &model.times, model.form);
        let phi = transition_matrix(&f, dt_s);
        self.x = propagate_state(&phi, &self.x);
        self.p = step_covariance(&self.p, &f, &phi, &model.density, dt_s, model.noise);
        phi
    }

    /// Variance of latitude, covariance of latitude and longitude, and variance of longitude, in rad².
    #[inline(always)]
    pub(crate) fn horizontal(&self) -> [f64; 3] {
        [self.p[LAT][LAT], self.p[LAT][LON], self.p[LON][LON]]
    }

    /// Measurement with the row H.
    #[inline(always)]
    pub(crate) fn linearised(&self, h: Sensitivity) -> LinearisedMeasurement {
        let ph = h.covariance(&self.p);
        LinearisedMeasurement { h, ph, variance: h.dot(&ph) }
    }

    /// x ← x + K r and its covariance, with K = P Hᵀ/(H P Hᵀ + R), the residual r and the variance R of the noise. `at`
    /// belongs to this estimate.
    #[inline(always)]
    pub(crate) fn correct(&mut self, at: &LinearisedMeasurement, residual: f64, noise: f64) -> MeasurementUpdate {
        let weight = 1.0 / (at.variance + noise);
        let gain = at.ph.map(|ph| ph * weight);
        add_scaled(&mut self.x, residual, &gain);
        self.correct_covariance(&at.h, &gain, &at.ph, noise);
        MeasurementUpdate { gain, innovation: residual, weight }
    }

    /// Measurement update with a measured value and the variance of its noise.
    #[inline(always)]
    pub(crate) fn update(&mut self, h: Sensitivity, value: f64, noise: f64) -> MeasurementUpdate {
        let innovation = value - h.dot(&self.x);
        self.correct(&self.linearised(h), innovation, noise)
    }

    /// Updates with the aiding positions of a row, one coordinate after the other.
    #[inline(always)]
    pub(crate) fn aid(&mut self, fixes: [Option<StateFix>; 3]) -> [Option<MeasurementUpdate>; 3] {
        fixes.map(|fix| {
            fix.map(|StateFix { state, error, variance }| self.update(Sensitivity::of_state(state), error, variance))
        })
    }

    /// Joseph's form P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ of the covariance for any gain K, as A = P − K (P Hᵀ)ᵀ and
    /// then A + (R K − A Hᵀ) Kᵀ. One triangle is computed and mirrored. `ph` is P Hᵀ, `noise` is R. [Bucy & Joseph
    /// 1968]
    #[inline(always)]
    pub(crate) fn correct_covariance(&mut self, h: &Sensitivity, gain: &StateVector, ph: &StateVector, noise: f64) {
        let p = &mut self.p;
        let mut rest = [0.0; STATES];
        for state in 0..STATES {
            let after = MEASURED.map(|measured| p[measured][state] - gain[state] * ph[measured]);
            rest[state] = noise * gain[state] - h.of_measured(after);
        }
        for (row, entries) in p.iter_mut().enumerate() {
            for (column, entry) in entries.iter_mut().enumerate() {
                *entry = *entry - gain[row] * ph[column] + rest[row] * gain[column];
            }
        }
        mirror(p);
    }

    /// P ← P + share K (H P Hᵀ + R) Kᵀ with the a priori gain of `at`: restores a share of the covariance decrease by
    /// this measurement.
    #[inline(always)]
    pub(crate) fn give_back(&mut self, at: &LinearisedMeasurement, noise: f64, share: f64) {
        let factor = share / (at.variance + noise);
        for (row, entries) in self.p.iter_mut().enumerate() {
            for (column, entry) in entries.iter_mut().enumerate() {
                // Multiplies the two entries first, so that the matrix stays exactly symmetric.
                *entry += factor * (at.ph[row] * at.ph[column]);
            }
        }
    }

    /// Latitude, longitude (rad), height (m) and temporal variation (nT).
    #[inline(always)]
    pub(crate) fn measured(&self) -> [f64; 4] {
        measured_states(&self.x)
    }

    /// Rejects states and variances that are not finite, and negative variances.
    ///
    /// # Errors
    /// [`NavigationError::Diverged`] at this row and time.
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

/// Recursion of a filter with a single estimate along a line.
pub(crate) trait FilterRecursion {
    /// Output of the estimates.
    fn output(&mut self) -> &mut NavigationOutput;

    /// Modifies the estimate before each step.
    #[inline(always)]
    fn before_step(&mut self, _: &mut StateEstimate) {}

    /// Corrects the estimate with the measurement of a row, if usable, and counts it.
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation;

    /// Filters along an INS. Each row has a step, aiding positions and a measurement.
    ///
    /// # Errors
    /// Fails as [`StateEstimate::check`].
    #[inline(always)]
    fn along(
        &mut self,
        ins: &InsSeries<'_>,
        errors: &InsErrorModel,
        fixes: impl Fn(usize) -> [Option<StateFix>; 3],
    ) -> Result<(), NavigationError> {
        let (mut estimate, model) = (StateEstimate::start_of(errors, ins), InsProcessModel::from_error_model(errors));
        for row in 0..ins.len() {
            if row > 0 {
                self.before_step(&mut estimate);
                estimate.propagate(&model, ins, row);
            }
            estimate.aid(fixes(row));
            let innovation = self.measure(&mut estimate, row);
            estimate.check(row, ins.tt_s[row])?;
            let (x, p) = (&estimate.x, &estimate.p);
            self.output().push(ins, row, |state| x[state], |i, j| p[i][j], innovation, errors.earth);
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests;

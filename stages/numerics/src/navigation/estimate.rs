//! The Gaussian estimate that a filter over one line carries from sample to sample, and its two moves: the step to the
//! next sample and the correction by a scalar measurement.
//!
//! The functions are inlined into the loop of a filter, which is compiled for each kind of vector unit. No product is
//! fused with a sum, so all of them give the same bits.

use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::{
    ALT, InsPoint, LAT, LON, PinsonForm, S, STATES, StateMatrix, StateVector, TimeConstants, pinson_matrix,
};
use crate::navigation::position_fixes::StateFix;
use crate::navigation::transition::{NoiseDiscretisation, propagate_state, step_covariance, transition_matrix};

/// The process model of a step, of which only the INS quantities change along a line.
#[derive(Clone, Debug, PartialEq)]
pub struct StepModel {
    times: TimeConstants,
    form: PinsonForm,
    density: StateVector,
    noise: NoiseDiscretisation,
}

impl StepModel {
    /// The steps of an error model.
    pub fn of(errors: &InsErrorModel) -> Self {
        Self {
            times: errors.time_constants(),
            form: errors.pinson,
            density: errors.noise_density(),
            noise: errors.noise,
        }
    }
}

/// A Gaussian over the error states, in the units of `pinson`.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Its mean.
    pub x: StateVector,
    /// Its covariance, exactly symmetric.
    pub p: StateMatrix,
}

/// A scalar measurement z = H x + v of the states, H = [slope, 0 … 0, 1], beside an estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearised {
    /// The change of the field with latitude, longitude (nT/rad) and height (nT/m). [thesis 000 (5.37), with the 1 of S
    /// that is missing in print]
    pub slope: [f64; 3],
    /// P Hᵀ.
    pub ph: StateVector,
    /// H P Hᵀ, in nT².
    pub variance_nt2: f64,
}

/// H times a vector of which the entries for position and S are given.
#[inline(always)]
fn dot(slope: &[f64; 3], [lat, lon, alt, s]: [f64; 4]) -> f64 {
    slope[0] * lat + slope[1] * lon + slope[2] * alt + s
}

impl Estimate {
    /// No error, and the initial covariance at a latitude (rad) and a height (m).
    pub fn initial(errors: &InsErrorModel, lat_rad: f64, alt_m: f64) -> Self {
        Self { x: [0.0; STATES], p: errors.initial_covariance(lat_rad, alt_m) }
    }

    /// No error, and the initial covariance at the first sample of an INS.
    pub fn start_of(errors: &InsErrorModel, ins: &InsSeries<'_>) -> Self {
        Self::initial(errors, ins.lat_deg[0].to_radians(), ins.alt_m[0])
    }

    /// x ← Φ x, P ← Φ P Φᵀ + Q over a step of `dt_s` seconds from a point of the flight.
    #[inline(always)]
    pub fn propagate(&mut self, model: &StepModel, from: &InsPoint, dt_s: f64) {
        let f = pinson_matrix(from, &model.times, model.form);
        let phi = transition_matrix(&f, dt_s);
        self.x = propagate_state(&phi, &self.x);
        self.p = step_covariance(&self.p, &f, &phi, &model.density, dt_s, model.noise);
    }

    /// The measurement of a field of this slope plus S.
    #[inline(always)]
    pub fn linearised(&self, slope: [f64; 3]) -> Linearised {
        let p = &self.p;
        let ph: StateVector = std::array::from_fn(|i| dot(&slope, [p[LAT][i], p[LON][i], p[ALT][i], p[S][i]]));
        let variance_nt2 = dot(&slope, [ph[LAT], ph[LON], ph[ALT], ph[S]]);
        Linearised { slope, ph, variance_nt2 }
    }

    /// x ← x + K r and Joseph's form P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ, with K = P Hᵀ/(H P Hᵀ + R), the residual r in
    /// nT and the variance R of the noise in nT². `at` is of this estimate. [Bucy & Joseph 1968]
    #[inline(always)]
    pub fn correct(&mut self, at: &Linearised, residual_nt: f64, noise_nt2: f64) {
        let weight = 1.0 / (at.variance_nt2 + noise_nt2);
        let (ph, p) = (&at.ph, &mut self.p);
        let (mut gain, mut rest) = ([0.0; STATES], [0.0; STATES]);
        for state in 0..STATES {
            gain[state] = ph[state] * weight;
            self.x[state] += gain[state] * residual_nt;
            // A = P − K (P Hᵀ)ᵀ, and then A + (R K − A Hᵀ) Kᵀ.
            let after = |column: usize| p[column][state] - gain[state] * ph[column];
            rest[state] = noise_nt2 * gain[state] - dot(&at.slope, [after(LAT), after(LON), after(ALT), after(S)]);
        }
        for (row, entries) in p.iter_mut().enumerate() {
            for (column, entry) in entries.iter_mut().enumerate() {
                *entry = *entry - gain[row] * ph[column] + rest[row] * gain[column];
            }
        }
        mirror(p);
    }

    /// The update by the positions from elsewhere of a row, one coordinate after the other.
    #[inline(always)]
    pub(crate) fn aid(&mut self, fixes: [Option<StateFix>; 3]) {
        for StateFix { state, error, variance } in fixes.into_iter().flatten() {
            let ph = self.p[state];
            let weight = 1.0 / (ph[state] + variance);
            let residual = error - self.x[state];
            let gain = ph.map(|ph| ph * weight);
            for (x, gain) in self.x.iter_mut().zip(&gain) {
                *x += gain * residual;
            }
            let rest: StateVector =
                std::array::from_fn(|i| variance * gain[i] - (self.p[i][state] - gain[i] * ph[state]));
            for (row, entries) in self.p.iter_mut().enumerate() {
                for (column, entry) in entries.iter_mut().enumerate() {
                    *entry = *entry - gain[row] * ph[column] + rest[row] * gain[column];
                }
            }
            mirror(&mut self.p);
        }
    }

    /// P ← P + share K (H P Hᵀ + R) Kᵀ with the gain of the prior that `at` is of: gives back a share of what the
    /// correction by this measurement took off the covariance.
    #[inline(always)]
    pub fn give_back(&mut self, at: &Linearised, noise_nt2: f64, share: f64) {
        let factor = share / (at.variance_nt2 + noise_nt2);
        for (row, entries) in self.p.iter_mut().enumerate() {
            for (column, entry) in entries.iter_mut().enumerate() {
                // The product of the two entries first, so that the matrix stays exactly symmetric.
                *entry += factor * (at.ph[row] * at.ph[column]);
            }
        }
    }

    /// Fails where a state or a variance is not finite, or a variance is negative.
    ///
    /// # Errors
    /// [`NavigationError::Diverged`] at this row and time.
    #[inline(always)]
    pub fn check(&self, row: usize, tt_s: f64) -> Result<(), NavigationError> {
        // Anything times zero is zero, unless it is not finite; a NaN is not equal to anything.
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

/// Copies the upper triangle into the lower one.
#[inline(always)]
fn mirror(p: &mut StateMatrix) {
    for row in 1..STATES {
        let (above, below) = p.split_at_mut(row);
        // As many entries as there are rows above.
        below[0].iter_mut().zip(above).for_each(|(entry, above)| *entry = above[row]);
    }
}

#[cfg(test)]
mod tests;

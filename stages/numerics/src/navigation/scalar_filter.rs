//! State and covariance of a filter of scalar measurements: their step and their update, which the filters that
//! linearise the map more than once share.
//!
//! Everything is inlined into the loops of the filters, which are compiled for the vector unit of the machine. No
//! product is fused with a sum, so all machines give the same bits.

pub(crate) mod problem;

use crate::earth::field_value::FieldValue;
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::pinson::{
    ALT, LAT, LON, PinsonForm, S, STATES, StateMatrix, StateVector, TimeConstants, pinson_matrix,
};
use crate::navigation::transition::{NoiseDiscretisation, propagate_state, step_covariance, transition_matrix};

/// The states that a measurement of the scalar field depends on, in the order of [`Sensitivity`].
pub(crate) const MEASURED: [usize; 4] = [LAT, LON, ALT, S];

/// The entries of the row H of a measurement for latitude, longitude (nT/rad), height (nT/m) and the temporal variation
/// (1); the others are 0. [thesis 000 (5.37), with the 1 of S that is missing in print]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sensitivity(pub(crate) [f64; 4]);

impl Sensitivity {
    #[inline(always)]
    pub(crate) fn of(field: &FieldValue) -> Self {
        Self([field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, field.d_alt_nt_per_m, 1.0])
    }

    /// That of a measurement of one of the measured states.
    #[inline(always)]
    pub(crate) fn of_state(state: usize) -> Self {
        Self(MEASURED.map(|measured| f64::from(u8::from(measured == state))))
    }

    /// H x of the measured states of x.
    #[inline(always)]
    pub(crate) fn of_measured(&self, x: [f64; 4]) -> f64 {
        let [lat, lon, alt, s] = self.0;
        lat * x[0] + lon * x[1] + alt * x[2] + s * x[3]
    }

    /// H x.
    #[inline(always)]
    pub(crate) fn dot(&self, x: &StateVector) -> f64 {
        self.of_measured(measured_states(x))
    }

    /// P Hᵀ of a symmetric P.
    #[inline(always)]
    pub(crate) fn covariance(&self, p: &StateMatrix) -> StateVector {
        let mut ph = [0.0; STATES];
        for (factor, state) in self.0.into_iter().zip(MEASURED) {
            add_scaled(&mut ph, factor, &p[state]);
        }
        ph
    }
}

/// The measurement of a row less an offset, in nT, and its variance, in nT²; `None` where it is missing or its sigma is not
/// above 0.
#[inline(always)]
pub(crate) fn measured(line: &NavigationLine<'_>, row: usize, offset_nt: f64) -> Option<(f64, f64)> {
    if line.sigma_nt[row] > 0.0 { line.measured(row, offset_nt) } else { None }
}

/// Latitude, longitude, height and temporal variation of a state.
#[inline(always)]
pub(crate) fn measured_states(x: &StateVector) -> [f64; 4] {
    MEASURED.map(|state| x[state])
}

/// Adds a multiple of a vector to a vector.
#[inline(always)]
pub(crate) fn add_scaled(to: &mut StateVector, factor: f64, from: &StateVector) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += factor * from;
    }
}

/// The inner product of two vectors, as four partial sums that a vector unit keeps apart.
#[inline(always)]
pub(crate) fn inner(a: &StateVector, b: &StateVector) -> f64 {
    let mut sums = [0.0; 4];
    let (a_fours, a_rest) = a.as_chunks::<4>();
    let (b_fours, b_rest) = b.as_chunks::<4>();
    for (a, b) in a_fours.iter().zip(b_fours) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Copies the triangle above the diagonal to that below.
#[inline(always)]
pub(crate) fn mirror(p: &mut StateMatrix) {
    for row in 1..STATES {
        let (above, below) = p.split_at_mut(row);
        for (entry, above) in below[0].iter_mut().zip(above) {
            *entry = above[row];
        }
    }
}

/// What the steps of a line depend on beside the INS.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepModel {
    times: TimeConstants,
    form: PinsonForm,
    noise: NoiseDiscretisation,
    density: StateVector,
}

impl StepModel {
    pub(crate) fn of(errors: &InsErrorModel) -> Self {
        Self {
            times: errors.time_constants(),
            form: errors.pinson,
            noise: errors.noise,
            density: errors.noise_density(),
        }
    }

    /// Φ of the step from the sample before `row` to `row`.
    #[inline(always)]
    pub(crate) fn transition(&self, ins: &InsSeries<'_>, row: usize) -> StateMatrix {
        transition_matrix(
            &pinson_matrix(&ins.point(row - 1), &self.times, self.form),
            ins.tt_s[row] - ins.tt_s[row - 1],
        )
    }
}

/// What an update was made with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corrected {
    /// K.
    pub(crate) gain: StateVector,
    /// z - H x before it.
    pub(crate) innovation: f64,
    /// 1/(H P Hᵀ + R).
    pub(crate) weight: f64,
}

/// A normal distribution of the states.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Belief {
    /// Its mean.
    pub(crate) x: StateVector,
    /// Its covariance.
    pub(crate) p: StateMatrix,
}

impl Belief {
    /// No error, and the initial covariance at the first sample.
    pub(crate) fn initial(errors: &InsErrorModel, ins: &InsSeries<'_>) -> Self {
        Self { x: [0.0; STATES], p: errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]) }
    }

    /// x ← Φ x and P ← Φ P Φᵀ + Q of the step from the sample before `row` to `row`; hands back Φ.
    #[inline(always)]
    pub(crate) fn propagate(&mut self, model: &StepModel, ins: &InsSeries<'_>, row: usize) -> StateMatrix {
        let dt_s = ins.tt_s[row] - ins.tt_s[row - 1];
        let f = pinson_matrix(&ins.point(row - 1), &model.times, model.form);
        let phi = transition_matrix(&f, dt_s);
        self.x = propagate_state(&phi, &self.x);
        self.p = step_covariance(&self.p, &f, &phi, &model.density, dt_s, model.noise);
        phi
    }

    /// Joseph's form (I - K H) P (I - K H)ᵀ + K R Kᵀ of the covariance, as A = P - K (P Hᵀ)ᵀ and then
    /// A + (R K - A Hᵀ) Kᵀ, of which one triangle is mirrored. `gain` is K, `ph` is P Hᵀ, `variance` is R.
    #[inline(always)]
    pub(crate) fn correct_covariance(&mut self, h: &Sensitivity, gain: &StateVector, ph: &StateVector, variance: f64) {
        let mut rest = gain.map(|gain| variance * gain);
        for (factor, measured) in h.0.into_iter().zip(MEASURED) {
            for state in 0..STATES {
                rest[state] -= factor * (self.p[measured][state] - gain[state] * ph[measured]);
            }
        }
        for row in 0..STATES {
            for column in 0..STATES {
                let a = self.p[row][column] - gain[row] * ph[column];
                self.p[row][column] = a + rest[row] * gain[column];
            }
        }
        mirror(&mut self.p);
    }

    /// The update by a measurement of some of the measured states.
    #[inline(always)]
    pub(crate) fn correct(&mut self, h: &Sensitivity, value: f64, variance: f64) -> Corrected {
        let ph = h.covariance(&self.p);
        let weight = 1.0 / (h.dot(&ph) + variance);
        let gain = ph.map(|ph| ph * weight);
        let innovation = value - h.dot(&self.x);
        add_scaled(&mut self.x, innovation, &gain);
        self.correct_covariance(h, &gain, &ph, variance);
        Corrected { gain, innovation, weight }
    }

    /// Whether all states are finite and all variances finite and non-negative.
    #[inline(always)]
    pub(crate) fn is_sound(&self) -> bool {
        let (mut finite, mut least) = (0.0, 0.0_f64);
        for state in 0..STATES {
            // Anything times zero is zero, unless it is not finite; a NaN is not equal to anything.
            finite += self.x[state] * 0.0 + self.p[state][state] * 0.0;
            least = least.min(self.p[state][state]);
        }
        finite == 0.0 && least >= 0.0
    }
}

#[cfg(test)]
pub(crate) mod tests;

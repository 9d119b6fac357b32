//! Measurement updates with scalar measurements, and their rows of H.

use crate::earth::field_value::FieldValue;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector};
use crate::navigation::position_fixes::StateFix;
use crate::navigation::transition::add_scaled as add_scaled_states;

use super::covariance::add_scaled;
use super::{Gaussian, StateEstimate};

/// States in a measurement of the scalar field, in the order of [`Sensitivity`].
pub(crate) const MEASURED: [usize; 4] = [LAT, LON, ALT, S];

/// Entries of the row H of a measurement for latitude, longitude (nT/rad), height (nT/m) and the temporal variation
/// (1); the others are 0. [Gnadt 2022, (5.37), with the 1 of S that is missing in print]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sensitivity(pub(crate) [f64; 4]);

impl Sensitivity {
    #[inline(always)]
    pub(crate) fn from_field(field: &FieldValue) -> Self {
        Self::of_slope([field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, field.d_alt_nt_per_m])
    }

    /// Row of a measurement of one of the measured states.
    #[inline(always)]
    pub(crate) fn of_state(state: usize) -> Self {
        Self(MEASURED.map(|measured| f64::from(u8::from(measured == state))))
    }

    /// Row of a field with this slope: its change with latitude, longitude (nT/rad) and height (nT/m).
    #[inline(always)]
    pub(crate) fn of_slope([lat, lon, alt]: [f64; 3]) -> Self {
        Self([lat, lon, alt, 1.0])
    }

    /// H x from the measured states of x.
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
            add_scaled_states(&mut ph, factor, &p[state]);
        }
        ph
    }
}

/// Latitude, longitude, height and temporal variation of a state.
#[inline(always)]
pub(crate) fn measured_states(x: &StateVector) -> [f64; 4] {
    MEASURED.map(|state| x[state])
}

/// Inner product of two vectors, as four partial sums for the vector unit.
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

/// Copies the triangle above the diagonal to the triangle below.
#[inline(always)]
pub(crate) fn mirror(p: &mut StateMatrix) {
    for row in 1..STATES {
        let (above, below) = p.split_at_mut(row);
        for (entry, above) in below[0].iter_mut().zip(above) {
            *entry = above[row];
        }
    }
}

/// Scalar measurement z = H x + v of the states, with an estimate.
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
    /// Measurement with the row H.
    #[inline(always)]
    pub(crate) fn linearised(&self, h: Sensitivity) -> LinearisedMeasurement {
        let ph = h.covariance(&self.p);
        LinearisedMeasurement { h, ph, variance: h.dot(&ph) }
    }

    /// x ← x + K r and its covariance, with K = P Hᵀ/(H P Hᵀ + R), the residual r and the variance R of the noise. `at`
    /// comes from [`Self::linearised`] of this estimate.
    #[inline(always)]
    pub(crate) fn correct(&mut self, at: &LinearisedMeasurement, residual: f64, noise: f64) -> MeasurementUpdate {
        let weight = 1.0 / (at.variance + noise);
        let gain = at.ph.map(|ph| ph * weight);
        add_scaled_states(&mut self.x, residual, &gain);
        self.correct_covariance(&at.h, &gain, &at.ph, noise);
        MeasurementUpdate { gain, innovation: residual, weight }
    }

    /// Measurement update with a measured value and the variance of its noise.
    #[inline(always)]
    pub(crate) fn update(&mut self, h: Sensitivity, value: f64, noise: f64) -> MeasurementUpdate {
        let innovation = value - h.dot(&self.x);
        self.correct(&self.linearised(h), innovation, noise)
    }

    /// Updates with the aiding positions of a row, one coordinate at a time.
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

    /// P ← P + share K (H P Hᵀ + R) Kᵀ with the a priori gain of `at`: adds back a share of the covariance decrease by
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
}

/// Row of H of one measurement: 18 entries, the error of the measurement, an error common to several measurements, and
/// the coefficients.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AugmentedSensitivity<'a> {
    pub ins: &'a StateVector,
    /// Index of the error, and the entry for the error.
    pub error: (usize, f64),
    /// Index of the common error, and the entry for the common error.
    pub common: (usize, f64),
    /// Index of the first coefficient.
    pub first: usize,
    pub regressors: &'a [f64],
}

impl<'a> AugmentedSensitivity<'a> {
    /// Row of H of a measurement of the 18 states alone.
    pub fn of_ins(ins: &'a StateVector) -> Self {
        Self { ins, error: (0, 0.0), common: (0, 0.0), first: 0, regressors: &[] }
    }

    /// H x.
    #[inline]
    pub fn dot(&self, x: &[f64]) -> f64 {
        let ins: f64 = self.ins.iter().zip(x).map(|(h, x)| h * x).sum();
        let aircraft: f64 = self.regressors.iter().zip(&x[self.first..]).map(|(h, x)| h * x).sum();
        ins + self.error.1 * x[self.error.0] + aircraft + self.common.1 * x[self.common.0]
    }

    /// x ← x + f Hᵀ.
    #[inline]
    pub fn add_to(&self, x: &mut [f64], factor: f64) {
        x.iter_mut().zip(self.ins).for_each(|(x, h)| *x += factor * h);
        x[self.error.0] += factor * self.error.1;
        x[self.common.0] += factor * self.common.1;
        x[self.first..].iter_mut().zip(self.regressors).for_each(|(x, h)| *x += factor * h);
    }

    /// Nonzero entries with their states.
    #[inline]
    pub fn entries(&self) -> impl Iterator<Item = (usize, f64)> {
        let ins = self.ins.iter().copied().enumerate().filter(|(_, h)| *h != 0.0);
        let own = ins.chain([self.error]).chain(self.regressors.iter().enumerate().map(|(k, h)| (self.first + k, *h)));
        own.chain([self.common].into_iter().filter(|(_, h)| *h != 0.0))
    }
}

impl Gaussian {
    /// Variance of a predicted measurement, H P Hᵀ + R; writes P Hᵀ to `out`.
    pub fn predict(&self, h: &AugmentedSensitivity, variance: f64, out: &mut [f64]) -> f64 {
        self.p.times(h.entries(), out);
        h.dot(out) + variance
    }

    /// Updates only the states that `corrects` selects, with an innovation of variance `s`: the consider update
    /// [Schmidt 1966]. P Hᵀ in `gain` becomes K.
    pub fn consider(
        &mut self,
        innovation: f64,
        s: f64,
        gain: &mut [f64],
        spare: &mut Vec<f64>,
        corrects: impl Fn(usize) -> bool,
    ) {
        spare.clear();
        spare.resize(gain.len(), 0.0);
        self.p.consider(s, gain, spare, corrects);
        add_scaled(&mut self.x, innovation, gain);
    }

    /// Updates with an innovation of variance `s`, with P Hᵀ in `gain`, which becomes K.
    pub fn update(&mut self, innovation: f64, s: f64, gain: &mut [f64], spare: &mut Vec<f64>) {
        self.consider(innovation, s, gain, spare, |_| true);
    }
}

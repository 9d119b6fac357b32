//! Row of H for a scalar measurement of the field, with entries only for position and temporal variation, and sums over
//! vectors and matrices of the 18 states.
//!
//! All functions are inlined into the loops of the filters, which are compiled for the machine's vector unit. Products
//! and sums are not fused, so results are bit-identical on all machines.

use crate::earth::field_value::FieldValue;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector};

/// States in a measurement of the scalar field, in the order of [`Sensitivity`].
pub(crate) const MEASURED: [usize; 4] = [LAT, LON, ALT, S];

/// Entries of the row H of a measurement for latitude, longitude (nT/rad), height (nT/m) and the temporal variation
/// (1); the others are 0. [Gnadt 2022, (5.37), with the element 1 for S that is missing in print]
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

    /// Row for a field with this slope: derivatives with respect to latitude, longitude (nT/rad) and height (nT/m).
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
            add_scaled(&mut ph, factor, &p[state]);
        }
        ph
    }
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

/// Inner product of two vectors, in four partial sums for the vector unit.
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

/// Copies the triangle above the diagonal to the one below.
#[inline(always)]
pub(crate) fn mirror(p: &mut StateMatrix) {
    for row in 1..STATES {
        let (above, below) = p.split_at_mut(row);
        for (entry, above) in below[0].iter_mut().zip(above) {
            *entry = above[row];
        }
    }
}

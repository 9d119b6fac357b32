//! Scalar measurements of the filters in the lanes of a register: Jacobians, gains, and the covariances a posteriori.

use pulp::Simd;

use crate::navigation::pinson::{ALT, LAT, LON, S, STATES};
use crate::navigation::transition::lanes::{StateMatrixLanes, StateVectorLanes};

/// Row H of each measurement, which has entries for position and S only. [Gnadt 2022, (5.37), with the 1 of S that is
/// missing in print]
pub(super) struct SensitivityLanes<V> {
    pub(super) d_lat: V,
    pub(super) d_lon: V,
    pub(super) d_alt: V,
}

/// Measurement update of state and covariance.
pub(super) struct EkfCorrection<S: Simd> {
    /// Measurement minus prediction.
    pub(super) residual: S::f64s,
    /// Inverse variance of the residual.
    pub(super) weight: S::f64s,
    /// Variance of the measurement.
    pub(super) variance: S::f64s,
    /// Lanes whose measurement is used; the others are unchanged.
    pub(super) used: S::m64s,
}

/// Updates with a measurement of one state, where H is a row of the identity; otherwise as
/// [`SensitivityLanes::correct`].
#[inline(always)]
pub(super) fn correct_by_state<S: Simd>(
    simd: S,
    state: usize,
    correction: &EkfCorrection<S>,
    x: &mut StateVectorLanes<S>,
    p: &mut StateMatrixLanes<S>,
) {
    let EkfCorrection { residual, weight, variance, used } = *correction;
    let ph = p[state];
    let (mut gain, mut rest) = (ph, ph);
    for row in 0..STATES {
        gain[row] = simd.mul_f64s(ph[row], weight);
        let corrected = simd.add_f64s(x[row], simd.mul_f64s(gain[row], residual));
        x[row] = simd.select_f64s(used, corrected, x[row]);
        let after = simd.sub_f64s(p[row][state], simd.mul_f64s(gain[row], ph[state]));
        rest[row] = simd.sub_f64s(simd.mul_f64s(variance, gain[row]), after);
    }
    correct_covariance(simd, used, [ph, gain, rest], p);
}

/// A + (R K - A Hᵀ) Kᵀ of A = P - K (P Hᵀ)ᵀ, given P Hᵀ, K and R K - A Hᵀ: one triangle is computed and mirrored.
#[inline(always)]
fn correct_covariance<S: Simd>(
    simd: S,
    used: S::m64s,
    [ph, gain, rest]: [StateVectorLanes<S>; 3],
    p: &mut StateMatrixLanes<S>,
) {
    for row in 0..STATES {
        for column in row..STATES {
            let a = simd.sub_f64s(p[row][column], simd.mul_f64s(gain[row], ph[column]));
            let corrected = simd.add_f64s(a, simd.mul_f64s(rest[row], gain[column]));
            let entry = simd.select_f64s(used, corrected, p[row][column]);
            p[row][column] = entry;
            p[column][row] = entry;
        }
    }
}

impl<V: Copy> SensitivityLanes<V> {
    /// H times a vector with the given entries for position and S.
    #[inline(always)]
    fn dot<S: Simd<f64s = V>>(&self, simd: S, [lat, lon, alt, s]: [V; 4]) -> V {
        let horizontal = simd.add_f64s(simd.mul_f64s(self.d_lat, lat), simd.mul_f64s(self.d_lon, lon));
        simd.add_f64s(simd.add_f64s(horizontal, simd.mul_f64s(self.d_alt, alt)), s)
    }

    /// P Hᵀ.
    #[inline(always)]
    pub(super) fn covariances<S: Simd<f64s = V>>(&self, simd: S, p: &StateMatrixLanes<S>) -> StateVectorLanes<S> {
        let mut ph = p[S];
        for state in 0..STATES {
            ph[state] = self.dot(simd, [p[LAT][state], p[LON][state], p[ALT][state], p[S][state]]);
        }
        ph
    }

    /// H P Hᵀ + R from P Hᵀ and R.
    #[inline(always)]
    pub(super) fn innovation_variances<S: Simd<f64s = V>>(&self, simd: S, ph: &StateVectorLanes<S>, variance: V) -> V {
        simd.add_f64s(self.dot(simd, [ph[LAT], ph[LON], ph[ALT], ph[S]]), variance)
    }

    /// x + K r, and Joseph's form (I - K H) P (I - K H)ᵀ + K R Kᵀ, as A = P - K (P Hᵀ)ᵀ and then A + (R K - A Hᵀ) Kᵀ.
    /// One triangle is computed and mirrored. K = P Hᵀ / (H P Hᵀ + R), and `ph` is P Hᵀ.
    #[inline(always)]
    pub(super) fn correct<S: Simd<f64s = V>>(
        &self,
        simd: S,
        correction: &EkfCorrection<S>,
        ph: &StateVectorLanes<S>,
        x: &mut StateVectorLanes<S>,
        p: &mut StateMatrixLanes<S>,
    ) {
        let EkfCorrection { residual, weight, variance, used } = *correction;
        let mut gain = *ph;
        let mut rest = *ph;
        for state in 0..STATES {
            gain[state] = simd.mul_f64s(ph[state], weight);
            let corrected = simd.add_f64s(x[state], simd.mul_f64s(gain[state], residual));
            x[state] = simd.select_f64s(used, corrected, x[state]);
            let after = |column: usize| simd.sub_f64s(p[column][state], simd.mul_f64s(gain[state], ph[column]));
            let a_h = self.dot(simd, [after(LAT), after(LON), after(ALT), after(S)]);
            rest[state] = simd.sub_f64s(simd.mul_f64s(variance, gain[state]), a_h);
        }
        correct_covariance(simd, used, [*ph, gain, rest], p);
    }
}

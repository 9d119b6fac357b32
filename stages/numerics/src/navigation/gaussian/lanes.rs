//! Time and measurement update of several filters at once, one per lane of a vector register.
//!
//! The filters share the transition matrix, except for the temporal variation, which decays independently and drives no
//! other state. Every lane uses the same sums in the same order, and products and sums are not fused. The results of a
//! filter are bit-identical in any lane, for any register width and independent of the other lanes.

use pulp::{Simd, bytemuck};

use crate::navigation::pinson::{ALT, COUPLED, GAUSS_MARKOV, LAT, LON, S, STATES, StateMatrix, StateVector};

/// Vector over the states for each lane.
pub(crate) type StateVectorLanes<S> = [<S as Simd>::f64s; STATES];
/// Matrix over the states for each lane.
pub(crate) type StateMatrixLanes<S> = [StateVectorLanes<S>; STATES];

const COUPLED_STATES: usize = COUPLED.len();
/// Index of the longitude among the coupled states. No other state depends on this state.
const LON_PLACE: usize = 1;

/// Nonzero entries of a transition matrix.
#[derive(Clone, Debug)]
pub(crate) struct TransitionEntries {
    /// Entries of the coupled rows, by column.
    columns: [[f64; COUPLED_STATES]; STATES],
    /// Diagonal of the rows of the Gauss-Markov states.
    decay: StateVector,
}

impl TransitionEntries {
    #[inline(always)]
    pub(crate) fn from_matrix(phi: &StateMatrix) -> Self {
        let (mut columns, mut decay) = ([[0.0; COUPLED_STATES]; STATES], [0.0; STATES]);
        for (place, row) in COUPLED.into_iter().enumerate() {
            for (column, entry) in columns.iter_mut().zip(&phi[row]) {
                column[place] = *entry;
            }
        }
        for state in GAUSS_MARKOV {
            decay[state] = phi[state][state];
        }
        Self { columns, decay }
    }
}

/// Value in one lane of a register.
#[inline(always)]
pub(crate) fn lane<S: Simd>(values: &S::f64s, lane: usize) -> f64 {
    bytemuck::cast_slice::<S::f64s, f64>(std::slice::from_ref(values)).get(lane).copied().unwrap_or(f64::NAN)
}

/// Register with one number per lane.
#[inline(always)]
pub(crate) fn from_lanes<S: Simd>(simd: S, mut of: impl FnMut(usize) -> f64) -> S::f64s {
    let mut values = simd.splat_f64s(0.0);
    let lanes = bytemuck::cast_slice_mut::<S::f64s, f64>(std::slice::from_mut(&mut values));
    lanes.iter_mut().enumerate().for_each(|(lane, value)| *value = of(lane));
    values
}

/// Product of the first `PLACES` coupled rows of Φ with a vector.
#[inline(always)]
fn coupled<S: Simd, const PLACES: usize>(
    simd: S,
    phi: &TransitionEntries,
    x: &StateVectorLanes<S>,
) -> [S::f64s; PLACES] {
    let mut sums = [simd.splat_f64s(0.0); PLACES];
    sums[LON_PLACE] = x[LON];
    add_column(simd, &mut sums, &phi.columns[LAT], x[LAT]);
    for (column, x) in phi.columns[ALT..S].iter().zip(&x[ALT..S]) {
        add_column(simd, &mut sums, column, *x);
    }
    sums
}

#[inline(always)]
fn add_column<S: Simd, const PLACES: usize>(
    simd: S,
    sums: &mut [S::f64s; PLACES],
    factors: &[f64; COUPLED_STATES],
    x: S::f64s,
) {
    for (sum, factor) in sums.iter_mut().zip(factors) {
        *sum = simd.add_f64s(*sum, simd.mul_f64s(simd.splat_f64s(*factor), x));
    }
}

/// Decay factors of all Gauss-Markov states, in their order; the factor of the temporal variation by lane.
#[inline(always)]
fn decays<S: Simd>(simd: S, phi: &TransitionEntries, fogm_decay: S::f64s) -> [S::f64s; GAUSS_MARKOV.len()] {
    let mut decays = [fogm_decay; GAUSS_MARKOV.len()];
    for (decay, state) in decays.iter_mut().zip(GAUSS_MARKOV) {
        if state != S {
            *decay = simd.splat_f64s(phi.decay[state]);
        }
    }
    decays
}

/// x ← Φ x. `fogm_decay` replaces the diagonal entry of the temporal variation.
#[inline(always)]
pub(crate) fn propagate_states<S: Simd>(
    simd: S,
    phi: &TransitionEntries,
    fogm_decay: S::f64s,
    x: &mut StateVectorLanes<S>,
) {
    let moved: [S::f64s; COUPLED_STATES] = coupled(simd, phi, x);
    for (state, moved) in COUPLED.into_iter().zip(moved) {
        x[state] = moved;
    }
    for (state, decay) in GAUSS_MARKOV.into_iter().zip(decays(simd, phi, fogm_decay)) {
        x[state] = simd.mul_f64s(decay, x[state]);
    }
}

/// P ← Φ P Φᵀ of a symmetric P, exactly symmetric. `fogm_decay` replaces the diagonal entry of the temporal variation.
#[inline(always)]
pub(crate) fn propagate_covariances<S: Simd>(
    simd: S,
    phi: &TransitionEntries,
    fogm_decay: S::f64s,
    p: &mut StateMatrixLanes<S>,
) {
    // Coupled rows of Y = Φ P. P is symmetric, so its columns are contiguous as rows.
    let mut y = [[simd.splat_f64s(0.0); STATES]; COUPLED_STATES];
    for (state, p) in p.iter().enumerate() {
        let column: [S::f64s; COUPLED_STATES] = coupled(simd, phi, p);
        for (y, entry) in y.iter_mut().zip(column) {
            y[state] = entry;
        }
    }
    // Y Φᵀ up to the diagonal, in groups of rows. Each group uses as many sums as its longest row requires.
    for (place, y) in y.iter().enumerate() {
        match place {
            0..4 => fill(p, place, &coupled::<S, 4>(simd, phi, y)),
            4..7 => fill(p, place, &coupled::<S, 7>(simd, phi, y)),
            _ => fill(p, place, &coupled::<S, COUPLED_STATES>(simd, phi, y)),
        }
    }
    let decays = decays(simd, phi, fogm_decay);
    for (rank, (state, decay)) in GAUSS_MARKOV.into_iter().zip(decays).enumerate() {
        for (row, y) in COUPLED.into_iter().zip(&y) {
            let entry = simd.mul_f64s(y[state], decay);
            p[row][state] = entry;
            p[state][row] = entry;
        }
        for (other, other_decay) in GAUSS_MARKOV.into_iter().zip(decays).take(rank + 1) {
            let entry = simd.mul_f64s(simd.mul_f64s(decay, p[state][other]), other_decay);
            p[state][other] = entry;
            p[other][state] = entry;
        }
    }
}

/// Writes the entries of a coupled row up to its diagonal, and their mirror images.
#[inline(always)]
fn fill<V: Copy>(p: &mut [[V; STATES]; STATES], place: usize, entries: &[V]) {
    let row = COUPLED[place];
    for (column, entry) in COUPLED.into_iter().zip(entries).take(place + 1) {
        p[row][column] = *entry;
        p[column][row] = *entry;
    }
}

/// Adds a multiple of a vector to the diagonal.
#[inline(always)]
pub(crate) fn add_diagonals<S: Simd>(simd: S, p: &mut StateMatrixLanes<S>, factor: f64, entries: &StateVectorLanes<S>) {
    let factor = simd.splat_f64s(factor);
    for (state, entry) in entries.iter().enumerate() {
        p[state][state] = simd.add_f64s(p[state][state], simd.mul_f64s(*entry, factor));
    }
}

/// Adds the same matrix in every lane.
#[inline(always)]
pub(crate) fn add_to_all<S: Simd>(simd: S, p: &mut StateMatrixLanes<S>, matrix: &StateMatrix) {
    for (p, row) in p.iter_mut().zip(matrix) {
        for (p, entry) in p.iter_mut().zip(row) {
            *p = simd.add_f64s(*p, simd.splat_f64s(*entry));
        }
    }
}

/// Row H of each measurement, which has entries for position and S only. [Gnadt 2022, (5.37), with the 1 of S that is
/// missing in print]
pub(crate) struct SensitivityLanes<V> {
    pub(crate) d_lat: V,
    pub(crate) d_lon: V,
    pub(crate) d_alt: V,
}

/// Measurement update of state and covariance.
pub(crate) struct MeasurementLanes<S: Simd> {
    /// Measurement minus prediction.
    pub(crate) residual: S::f64s,
    /// Inverse variance of the residual.
    pub(crate) weight: S::f64s,
    /// Variance of the measurement.
    pub(crate) variance: S::f64s,
    /// Lanes whose measurement is used; the others are unchanged.
    pub(crate) used: S::m64s,
}

/// Updates with a measurement of one state, where H is a row of the identity; otherwise as
/// [`SensitivityLanes::correct`].
#[inline(always)]
pub(crate) fn correct_by_state<S: Simd>(
    simd: S,
    state: usize,
    correction: &MeasurementLanes<S>,
    x: &mut StateVectorLanes<S>,
    p: &mut StateMatrixLanes<S>,
) {
    let MeasurementLanes { residual, weight, variance, used } = *correction;
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
    pub(crate) fn covariances<S: Simd<f64s = V>>(&self, simd: S, p: &StateMatrixLanes<S>) -> StateVectorLanes<S> {
        let mut ph = p[S];
        for state in 0..STATES {
            ph[state] = self.dot(simd, [p[LAT][state], p[LON][state], p[ALT][state], p[S][state]]);
        }
        ph
    }

    /// H P Hᵀ + R from P Hᵀ and R.
    #[inline(always)]
    pub(crate) fn innovation_variances<S: Simd<f64s = V>>(&self, simd: S, ph: &StateVectorLanes<S>, variance: V) -> V {
        simd.add_f64s(self.dot(simd, [ph[LAT], ph[LON], ph[ALT], ph[S]]), variance)
    }

    /// x + K r, and Joseph's form (I - K H) P (I - K H)ᵀ + K R Kᵀ, as A = P - K (P Hᵀ)ᵀ and then A + (R K - A Hᵀ) Kᵀ.
    /// One triangle is computed and mirrored. K = P Hᵀ / (H P Hᵀ + R), and `ph` is P Hᵀ.
    #[inline(always)]
    pub(crate) fn correct<S: Simd<f64s = V>>(
        &self,
        simd: S,
        correction: &MeasurementLanes<S>,
        ph: &StateVectorLanes<S>,
        x: &mut StateVectorLanes<S>,
        p: &mut StateMatrixLanes<S>,
    ) {
        let MeasurementLanes { residual, weight, variance, used } = *correction;
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

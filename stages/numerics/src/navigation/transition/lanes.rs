//! Simultaneous step of several filters, one per lane of a vector register.
//!
//! The filters share the transition matrix, except for the temporal variation, which decays independently and drives no
//! other state. Every lane computes the same sums in the same order, and products and sums are not fused. The results
//! of a filter are bit-identical in any lane and for any register width, and are independent of the other lanes.

use pulp::{Simd, bytemuck};

use super::{DECAYING, STATES, StateMatrix, StateVector};
use crate::navigation::pinson::{A_HAT, ALT, LAT, LON, S, TILT_D, TILT_E, TILT_N, VD, VE, VN};

/// Vector over the states for each lane.
pub(crate) type StateVectorLanes<S> = [<S as Simd>::f64s; STATES];
/// Matrix over the states for each lane.
pub(crate) type StateMatrixLanes<S> = [StateVectorLanes<S>; STATES];

/// Coupled states.
const COUPLED: [usize; COUPLED_STATES] = [LAT, LON, ALT, VN, VE, VD, TILT_N, TILT_E, TILT_D, A_HAT];
const COUPLED_STATES: usize = 10;
/// Index of the longitude among the coupled states. No other state depends on it.
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
        for state in DECAYING {
            decay[state] = phi[state][state];
        }
        Self { columns, decay }
    }
}

/// One lane of a register.
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

/// Decay factors of all Gauss-Markov states, in order; the factor of the temporal variation is given by lane.
#[inline(always)]
fn decays<S: Simd>(simd: S, phi: &TransitionEntries, fogm_decay: S::f64s) -> [S::f64s; DECAYING.len()] {
    let mut decays = [fogm_decay; DECAYING.len()];
    for (decay, state) in decays.iter_mut().zip(DECAYING) {
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
    for (state, decay) in DECAYING.into_iter().zip(decays(simd, phi, fogm_decay)) {
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
    // Y Φᵀ up to the diagonal, in groups of rows; the longest row of a group determines its number of sums.
    for (place, y) in y.iter().enumerate() {
        match place {
            0..4 => fill(p, place, &coupled::<S, 4>(simd, phi, y)),
            4..7 => fill(p, place, &coupled::<S, 7>(simd, phi, y)),
            _ => fill(p, place, &coupled::<S, COUPLED_STATES>(simd, phi, y)),
        }
    }
    let decays = decays(simd, phi, fogm_decay);
    for (rank, (state, decay)) in DECAYING.into_iter().zip(decays).enumerate() {
        for (row, y) in COUPLED.into_iter().zip(&y) {
            let entry = simd.mul_f64s(y[state], decay);
            p[row][state] = entry;
            p[state][row] = entry;
        }
        for (other, other_decay) in DECAYING.into_iter().zip(decays).take(rank + 1) {
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

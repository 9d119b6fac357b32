//! Covariance of the 18 states and any number of further states, whose transition is diagonal.

use crate::navigation::pinson::{STATES, StateMatrix};

/// Alignment of padded rows, in entries, to fill vector registers of any width.
const LANES: usize = 8;

/// Symmetric matrix, both triangles stored by rows and bit-identical.
///
/// The measurement update is Joseph's form, which is valid for any gain K: with u = P Hᵀ and s = H P Hᵀ + R
///
/// ```text
/// (I − K H) P (I − K H)ᵀ + K R Kᵀ = P + K vᵀ + v Kᵀ,      v = s K/2 − u
/// ```
///
/// An error of K affects the result only to second order. Both products commute, so an entry and its mirror image are
/// the same sum. A scaling of the states does not affect recursions on covariances (for powers of two, results are
/// bit-identical). Using rad and nT together thus loses no digits. A large ratio of H P Hᵀ to R does lose digits, so it
/// is limited by [`WIDEST`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Covariance {
    states: usize,
    /// Length of a row, padded or not.
    stride: usize,
    entries: Vec<f64>,
}

/// Largest ratio of H P Hᵀ to R. An update leaves errors of 2e-16 H P Hᵀ, which at this ratio is a few thousandths of
/// R.
pub(crate) const WIDEST: f64 = 1e13;

impl Covariance {
    /// Zero matrix with rows that are not padded.
    pub(crate) fn zero(states: usize) -> Self {
        Self { states, stride: states, entries: vec![0.0; states * states] }
    }

    /// Zero matrix with padded rows.
    fn padded(states: usize) -> Self {
        let stride = states.next_multiple_of(LANES);
        Self { states, stride, entries: vec![0.0; states * stride] }
    }

    /// Block-diagonal matrix of the 18 states and of the others (row-major), with padded rows.
    pub(crate) fn block_diagonal(ins: &StateMatrix, others: &[f64], other_states: usize) -> Self {
        let mut all = Self::padded(STATES + other_states);
        all.set_ins(ins);
        for row in 0..other_states {
            let to = &mut all.entries[(STATES + row) * all.stride + STATES..][..other_states];
            // The two triangles may come from products with different rounding.
            for (column, to) in to.iter_mut().enumerate() {
                let (one, other) = (others[row * other_states + column], others[column * other_states + row]);
                *to = 0.5 * (one + other);
            }
        }
        all
    }

    /// Matrix without the 18 states, with padded rows.
    pub(crate) fn alone(entries: &[f64], states: usize) -> Self {
        let mut all = Self::padded(states);
        let stride = all.stride.max(1);
        for (to, from) in all.entries.chunks_exact_mut(stride).zip(entries.chunks_exact(states.max(1))) {
            to[..states].copy_from_slice(from);
        }
        all
    }

    /// Copies a matrix without a new allocation.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        (self.states, self.stride) = (other.states, other.stride);
        self.entries.clone_from(&other.entries);
    }

    /// Length of a row, padded or not.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// Entry of the matrix.
    #[inline(always)]
    pub(crate) fn at(&self, row: usize, column: usize) -> f64 {
        self.entries[row * self.stride + column]
    }

    /// Entry of the matrix.
    #[inline(always)]
    pub(crate) fn at_mut(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.entries[row * self.stride + column]
    }

    /// Row of a state, which is P Hᵀ of a measurement of that state.
    #[inline(always)]
    pub(crate) fn row(&self, state: usize) -> &[f64] {
        &self.entries[state * self.stride..][..self.stride]
    }

    /// Rows.
    #[inline(always)]
    pub(crate) fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.entries.chunks_exact(self.stride.max(1))
    }

    /// Rows.
    #[inline(always)]
    pub(crate) fn rows_mut(&mut self) -> impl Iterator<Item = &mut [f64]> {
        self.entries.chunks_exact_mut(self.stride.max(1))
    }

    /// Block of the 18 states.
    #[inline(always)]
    pub(crate) fn ins(&self) -> StateMatrix {
        let mut block = [[0.0; STATES]; STATES];
        for (to, from) in block.iter_mut().zip(self.rows()) {
            to.copy_from_slice(&from[..STATES]);
        }
        block
    }

    /// Replaces the block of the 18 states.
    #[inline(always)]
    pub(crate) fn set_ins(&mut self, block: &StateMatrix) {
        for (to, from) in self.rows_mut().zip(block) {
            to[..STATES].copy_from_slice(from);
        }
    }

    /// Block of the states from `first` on, row-major.
    pub(crate) fn block_from(&self, first: usize) -> Vec<f64> {
        self.rows().skip(first).flat_map(|row| &row[first..self.states]).copied().collect()
    }

    /// Whether the variances are finite and not negative.
    #[inline(always)]
    pub(crate) fn is_sound(&self) -> bool {
        // The sum is finite only if all variances are. An off-diagonal entry that is not finite affects two variances
        // in the next step.
        let sum: f64 = (0..self.states).map(|state| self.at(state, state)).sum();
        let least = (0..self.states).map(|state| self.at(state, state)).fold(0.0, f64::min);
        sum.is_finite() && least >= 0.0
    }

    /// P Hᵀ from the entries of H with their states.
    #[inline(always)]
    pub(crate) fn times(&self, h: impl Iterator<Item = (usize, f64)>, ph: &mut [f64]) {
        ph.fill(0.0);
        for (state, h) in h {
            add_scaled(ph, h, self.row(state));
        }
    }

    /// Measurement update, with P Hᵀ in `gain`, which becomes K, and s = H P Hᵀ + R. Overwrites `rest`.
    #[inline(always)]
    pub(crate) fn update(&mut self, s: f64, gain: &mut [f64], rest: &mut [f64]) {
        let weight = 1.0 / s;
        for (gain, rest) in gain.iter_mut().zip(&mut *rest) {
            let ph = *gain;
            *gain = ph * weight;
            *rest = 0.5 * s * *gain - ph;
        }
        self.correct(gain, rest);
    }

    /// Measurement update of only the states that `corrects` selects: the consider update [Schmidt 1966].
    #[inline(always)]
    pub(crate) fn consider(&mut self, s: f64, gain: &mut [f64], rest: &mut [f64], corrects: impl Fn(usize) -> bool) {
        for (state, (gain, rest)) in gain.iter_mut().zip(&mut *rest).enumerate() {
            let ph = *gain;
            *gain = if corrects(state) { ph / s } else { 0.0 };
            *rest = 0.5 * s * *gain - ph;
        }
        self.correct(gain, rest);
    }

    /// P + K vᵀ + v Kᵀ.
    #[inline(always)]
    fn correct(&mut self, gain: &[f64], rest: &[f64]) {
        let (gain, rest) = (&gain[..self.stride], &rest[..self.stride]);
        for (row, entries) in self.rows_mut().enumerate() {
            let (own_gain, own_rest) = (gain[row], rest[row]);
            for ((entry, gain), rest) in entries.iter_mut().zip(gain).zip(rest) {
                *entry += own_gain * rest + own_rest * gain;
            }
        }
    }

    /// P₁₂ ← Φ P₁₂ D of the 18 states with the other states, whose transition is D, and the mirror image of P₁₂.
    /// `spare` is a buffer.
    #[inline(always)]
    pub(crate) fn propagate_cross(&mut self, phi: &StateMatrix, decay: &[f64], spare: &mut Vec<f64>) {
        let (stride, others) = (self.stride, self.states - STATES);
        spare.clear();
        spare.resize(STATES * others, 0.0);
        for (to, phi) in spare.chunks_exact_mut(others.max(1)).zip(phi) {
            for (phi, from) in phi.iter().zip(self.entries.chunks_exact(stride)) {
                if *phi != 0.0 {
                    add_scaled(to, *phi, &from[STATES..STATES + others]);
                }
            }
        }
        for (to, from) in self.entries.chunks_exact_mut(stride).zip(spare.chunks_exact(others.max(1))) {
            for ((to, from), decay) in to[STATES..].iter_mut().zip(from).zip(decay) {
                *to = from * decay;
            }
        }
        let (above, below) = self.entries.split_at_mut(STATES * stride);
        for (other, to) in below.chunks_exact_mut(stride).enumerate() {
            for (to, from) in to[..STATES].iter_mut().zip(above.chunks_exact(stride)) {
                *to = from[STATES + other];
            }
        }
    }

    /// P₂₂ ← D P₂₂ D of the states beyond the 18, each entry times the product of the decays of its two states. Decays
    /// of 1 do not change P₂₂.
    #[inline(always)]
    pub(crate) fn decay_together(&mut self, decay: &[f64]) {
        if decay.iter().any(|decay| *decay != 1.0) {
            for (own, row) in decay.iter().zip(self.rows_mut().skip(STATES)) {
                for (entry, other) in row[STATES..].iter_mut().zip(decay) {
                    *entry *= own * other;
                }
            }
        }
    }

    /// P₂₂ ← D P₂₂ D, one state at a time. The last bits of the result differ from [`Covariance::decay_together`].
    pub(crate) fn decay_each(&mut self, decay: &[f64]) {
        for (at, decay) in (STATES..).zip(decay) {
            self.entries[at * self.stride + STATES..(at + 1) * self.stride]
                .iter_mut()
                .for_each(|entry| *entry *= decay);
            self.rows_mut().skip(STATES).for_each(|row| row[at] *= decay);
        }
    }
}

/// Adds a multiple of a row.
#[inline(always)]
pub(crate) fn add_scaled(to: &mut [f64], factor: f64, from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += factor * from;
    }
}

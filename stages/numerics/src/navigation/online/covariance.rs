//! Covariance of the 18 states and any number of further states with diagonal transition.

use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::pinson::{STATES, StateMatrix};
use crate::navigation::transition::step_covariance;

/// Alignment of rows, in entries, for vector registers of any width.
const LANES: usize = 8;

/// Symmetric matrix, both triangles stored by rows and bit-identical.
///
/// The update is Joseph's form, which is valid for any gain K: with u = P Hᵀ and s = H P Hᵀ + R
///
/// ```text
/// (I − K H) P (I − K H)ᵀ + K R Kᵀ = P + K vᵀ + v Kᵀ,      v = s K/2 − u
/// ```
///
/// Both products commute, so an entry and its mirror image are the same sum. Recursions on covariances are invariant to
/// the scaling of states (bit-identical for powers of two), so mixing rad and nT loses no precision. The ratio of H P
/// Hᵀ to R reduces the precision and is limited by [`WIDEST`].
#[derive(Clone, Debug)]
pub(crate) struct AugmentedCovariance {
    states: usize,
    stride: usize,
    entries: Vec<f64>,
    /// Workspace for the 18 rows of the cross-covariances during their propagation.
    moved: Vec<f64>,
}

/// Largest ratio of H P Hᵀ to R. An update leaves errors of 2e-16 times H P Hᵀ, here a few thousandths of R.
pub(crate) const WIDEST: f64 = 1e13;

/// One scalar measurement.
pub(crate) struct ScalarUpdate<'a> {
    /// P Hᵀ.
    pub(crate) ph: &'a [f64],
    /// H P Hᵀ + R.
    pub(crate) innovation_variance: f64,
}

impl AugmentedCovariance {
    /// Block-diagonal covariance of the 18 states and of the others (row-major).
    pub(crate) fn new(navigation: &StateMatrix, others: &[f64], other_states: usize) -> Self {
        let states = STATES + other_states;
        let stride = states.next_multiple_of(LANES);
        let mut entries = vec![0.0; states * stride];
        for (row, from) in navigation.iter().enumerate() {
            entries[row * stride..][..STATES].copy_from_slice(from);
        }
        for row in 0..other_states {
            let to = &mut entries[(STATES + row) * stride + STATES..][..other_states];
            // The triangles may come from a product with different rounding.
            for (column, to) in to.iter_mut().enumerate() {
                let (one, other) = (others[row * other_states + column], others[column * other_states + row]);
                *to = 0.5 * (one + other);
            }
        }
        Self { states, stride, entries, moved: vec![0.0; STATES * stride] }
    }

    /// Covariance without the 18 states.
    pub(crate) fn alone(entries: &[f64], states: usize) -> Self {
        let stride = states.next_multiple_of(LANES);
        let mut padded = vec![0.0; states * stride];
        for (to, from) in padded.chunks_exact_mut(stride.max(1)).zip(entries.chunks_exact(states.max(1))) {
            to[..states].copy_from_slice(from);
        }
        Self { states, stride, entries: padded, moved: vec![] }
    }

    /// Length of a padded row.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// Entry of the matrix.
    #[inline(always)]
    pub(crate) fn at(&self, row: usize, column: usize) -> f64 {
        self.entries[row * self.stride + column]
    }

    /// Padded row, which is P Hᵀ of a measurement of one state.
    #[inline(always)]
    pub(crate) fn row(&self, state: usize) -> &[f64] {
        &self.entries[state * self.stride..][..self.stride]
    }

    /// Block of the states beyond the 18, row-major.
    pub(crate) fn others(&self) -> Vec<f64> {
        let of = |row: usize| self.entries[row * self.stride..][STATES..self.states].to_vec();
        (STATES..self.states).flat_map(of).collect()
    }

    /// Whether the variances are finite and not negative.
    #[inline(always)]
    pub(crate) fn is_sound(&self) -> bool {
        // A sum is finite if all its terms are. An off-diagonal entry that is not finite affects two variances in the
        // next step.
        let sum: f64 = (0..self.states).map(|state| self.at(state, state)).sum();
        let least = (0..self.states).map(|state| self.at(state, state)).fold(0.0, f64::min);
        sum.is_finite() && least >= 0.0
    }

    /// P Hᵀ of a padded H, skipping its zeros.
    #[inline(always)]
    pub(crate) fn times(&self, h: &[f64], ph: &mut [f64]) {
        ph.fill(0.0);
        for (h, row) in h.iter().zip(self.entries.chunks_exact(self.stride)) {
            if *h != 0.0 {
                add_scaled(ph, *h, row);
            }
        }
    }

    /// Measurement update; `gain` receives K, and `rest` is overwritten.
    #[inline(always)]
    pub(crate) fn correct(&mut self, by: &ScalarUpdate<'_>, gain: &mut [f64], rest: &mut [f64]) {
        let weight = 1.0 / by.innovation_variance;
        for ((gain, rest), ph) in gain.iter_mut().zip(&mut *rest).zip(by.ph) {
            *gain = ph * weight;
            *rest = 0.5 * by.innovation_variance * *gain - ph;
        }
        self.correct_by(gain, rest);
    }

    /// Measurement update of only the states that `corrects` selects [Schmidt 1966].
    pub(crate) fn consider(
        &mut self,
        by: &ScalarUpdate<'_>,
        gain: &mut [f64],
        rest: &mut [f64],
        corrects: impl Fn(usize) -> bool,
    ) {
        for (state, ((gain, rest), ph)) in gain.iter_mut().zip(&mut *rest).zip(by.ph).enumerate() {
            *gain = if corrects(state) { ph / by.innovation_variance } else { 0.0 };
            *rest = 0.5 * by.innovation_variance * *gain - ph;
        }
        self.correct_by(gain, rest);
    }

    /// P + K vᵀ + v Kᵀ.
    #[inline(always)]
    fn correct_by(&mut self, gain: &[f64], rest: &[f64]) {
        let (gain, rest) = (&gain[..self.stride], &rest[..self.stride]);
        for (row, entries) in self.entries.chunks_exact_mut(self.stride).enumerate() {
            let (own_gain, own_rest) = (gain[row], rest[row]);
            for ((entry, gain), rest) in entries.iter_mut().zip(gain).zip(rest) {
                *entry += own_gain * rest + own_rest * gain;
            }
        }
    }

    /// Time update. Each of the other states is multiplied by its `decay` and its variance increased by `noise`; decays
    /// of 1 do not change their block.
    #[inline(always)]
    pub(crate) fn propagate(&mut self, step: &InsStep<'_>, decay: &[f64], noise: &[f64]) {
        self.propagate_navigation(step);
        self.propagate_cross(step.phi, decay);
        let (stride, others) = (self.stride, self.states - STATES);
        if decay.iter().any(|decay| *decay != 1.0) {
            for (row, own) in decay.iter().enumerate() {
                let entries = &mut self.entries[(STATES + row) * stride + STATES..][..others];
                for (entry, other) in entries.iter_mut().zip(decay) {
                    *entry *= own * other;
                }
            }
        }
        for (other, noise) in noise.iter().enumerate() {
            self.entries[(STATES + other) * (stride + 1)] += noise;
        }
    }

    #[inline(always)]
    fn propagate_navigation(&mut self, step: &InsStep<'_>) {
        let mut p = [[0.0; STATES]; STATES];
        for (to, from) in p.iter_mut().zip(self.entries.chunks_exact(self.stride)) {
            to.copy_from_slice(&from[..STATES]);
        }
        let errors = step.errors;
        let p = step_covariance(&p, step.f, step.phi, step.density, step.dt_s, errors.noise);
        for (to, from) in self.entries.chunks_exact_mut(self.stride).zip(&p) {
            to[..STATES].copy_from_slice(from);
        }
    }

    /// P_nc ← Φ P_nc D over the nonzero entries of Φ, and its mirror image.
    #[inline(always)]
    fn propagate_cross(&mut self, phi: &StateMatrix, decay: &[f64]) {
        let (stride, others) = (self.stride, self.states - STATES);
        for (row, phi) in phi.iter().enumerate() {
            let to = &mut self.moved[row * stride..][..others];
            to.fill(0.0);
            for (phi, from) in phi.iter().zip(self.entries.chunks_exact(stride)) {
                if *phi != 0.0 {
                    add_scaled(to, *phi, &from[STATES..STATES + others]);
                }
            }
        }
        for (row, from) in self.moved.chunks_exact(stride).enumerate() {
            let to = &mut self.entries[row * stride + STATES..][..others];
            for ((to, from), decay) in to.iter_mut().zip(from).zip(decay) {
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
}

/// Step of the 18 states.
pub(crate) struct InsStep<'a> {
    pub(crate) errors: &'a InsErrorModel,
    /// Spectral densities of its process noise.
    pub(crate) density: &'a [f64; STATES],
    pub(crate) f: &'a StateMatrix,
    pub(crate) phi: &'a StateMatrix,
    pub(crate) dt_s: f64,
}

#[inline(always)]
fn add_scaled(to: &mut [f64], factor: f64, from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += factor * from;
    }
}

/// Inner product of two vectors.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

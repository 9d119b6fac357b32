//! Adjoint state λ and its matrix Λ of the backward pass. [Bierman 1973]

use crate::navigation::gaussian::{MEASURED, Sensitivity, inner, mirror};
use crate::navigation::pinson::{COUPLED, GAUSS_MARKOV, STATES, StateMatrix, StateVector};
use crate::navigation::transition::add_scaled;

/// Measurement update of the forward pass.
#[derive(Clone, Copy, Debug)]
pub(super) struct ForwardUpdate {
    pub(super) h: Sensitivity,
    pub(super) gain: StateVector,
    /// ν/s.
    pub(super) force: f64,
    /// 1/s.
    pub(super) weight: f64,
    /// R, with the weight of a robust loss.
    pub(super) variance_nt2: f64,
}

/// Adjoint state λ and its matrix Λ.
#[derive(Clone, Copy, Debug)]
pub(in crate::navigation) struct AdjointState {
    pub(in crate::navigation) state: StateVector,
    pub(in crate::navigation) matrix: StateMatrix,
}

impl AdjointState {
    /// Adjoint state after the last sample.
    pub(in crate::navigation) const END: Self = Self { state: [0.0; STATES], matrix: [[0.0; STATES]; STATES] };

    /// Propagates back through a measurement. Returns the u of the measurement.
    #[inline(always)]
    pub(super) fn through_measurement(&mut self, used: &ForwardUpdate) -> f64 {
        let u = used.force + inner(&used.gain, &self.state);
        // (I - K H)ᵀ Λ (I - K H) + Hᵀ H/s = Λ - Hᵀ gᵀ - g H + Hᵀ H (Kᵀ g + 1/s) with g = Λ K: only four rows and
        // columns change.
        let mut g = [0.0; STATES];
        for (factor, row) in used.gain.iter().zip(&self.matrix) {
            add_scaled(&mut g, *factor, row);
        }
        let half = 0.5 * (inner(&used.gain, &g) + used.weight);
        for (factor, state) in used.h.0.into_iter().zip(MEASURED) {
            g[state] -= half * factor;
        }
        for (factor, state) in used.h.0.into_iter().zip(MEASURED) {
            self.state[state] -= factor * u;
            add_scaled(&mut self.matrix[state], -factor, &g);
            for (row, g) in self.matrix.iter_mut().zip(&g) {
                row[state] -= factor * g;
            }
        }
        u
    }

    /// Propagates back through a step.
    #[inline(always)]
    pub(in crate::navigation) fn through_step(&mut self, phi: &StateMatrix) {
        self.state = transposed_product(phi, &self.state);
        // Y = Λ Φ, whose rows are Φᵀ times the rows of Λ, then Φᵀ Y.
        let y = self.matrix.map(|row| transposed_product(phi, &row));
        let mut out = [[0.0; STATES]; STATES];
        for from in COUPLED {
            for (out, factor) in out.iter_mut().zip(&phi[from]) {
                add_scaled(out, *factor, &y[from]);
            }
        }
        for state in GAUSS_MARKOV {
            add_scaled(&mut out[state], phi[state][state], &y[state]);
        }
        mirror(&mut out);
        self.matrix = out;
    }

    /// Λ b.
    #[inline(always)]
    pub(in crate::navigation) fn product(&self, b: &StateVector) -> StateVector {
        let mut g = [0.0; STATES];
        for (factor, row) in b.iter().zip(&self.matrix) {
            add_scaled(&mut g, *factor, row);
        }
        g
    }

    /// P - P Λ P.
    #[inline(always)]
    pub(super) fn smoothed(&self, p: &StateMatrix) -> StateMatrix {
        let mut out = *p;
        for (out, row) in out.iter_mut().zip(p) {
            let g = self.product(row);
            for (factor, p) in g.iter().zip(p) {
                add_scaled(out, -factor, p);
            }
        }
        mirror(&mut out);
        out
    }
}

/// Φᵀ x, over the nonzero entries of Φ.
#[inline(always)]
fn transposed_product(phi: &StateMatrix, x: &StateVector) -> StateVector {
    let mut out = [0.0; STATES];
    for state in COUPLED {
        add_scaled(&mut out, x[state], &phi[state]);
    }
    for state in GAUSS_MARKOV {
        out[state] += phi[state][state] * x[state];
    }
    out
}

#[cfg(test)]
mod tests;

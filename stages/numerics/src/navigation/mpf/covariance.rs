//! The covariance that all particles share: that of the 16 linear states, given a particle's position.
//!
//! It is kept over all 18 states, with zeros for the position.

use crate::navigation::line::LineStep;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix};
use crate::navigation::transition::propagate_covariance;

/// A pivot below this part of its variance is rounding.
const LEAST_PIVOT: f64 = 1e-13;

/// Two columns over the states, by which two standard normals move a particle.
pub(super) type Spread = [[f64; 2]; STATES];

/// Corrects a covariance by a scalar measurement of `h`·x with a noise of this variance, in Joseph's form; of variance
/// 0, conditions it on that. A combination without variance is left as it is.
pub(super) fn correct(p: &mut StateMatrix, h: [(usize, f64); 2], variance: f64) {
    let ph: [f64; STATES] = std::array::from_fn(|row| h[0].1 * p[row][h[0].0] + h[1].1 * p[row][h[1].0]);
    let total = h[0].1 * ph[h[0].0] + h[1].1 * ph[h[1].0] + variance;
    if total <= 0.0 {
        return;
    }
    let gain = ph.map(|ph| ph / total);
    let rest: [f64; STATES] = std::array::from_fn(|row| {
        let after = |column: usize| p[row][column] - gain[row] * ph[column];
        variance * gain[row] - (h[0].1 * after(h[0].0) + h[1].1 * after(h[1].0))
    });
    for row in 0..STATES {
        let before = p[row][row];
        for column in row..STATES {
            let entry = p[row][column] - gain[row] * ph[column] + rest[row] * gain[column];
            p[row][column] = entry;
            p[column][row] = entry;
        }
        if p[row][row] < LEAST_PIVOT * before && p[row][row] > -LEAST_PIVOT * before {
            clear(p, row);
        }
    }
}

/// Makes a state's row and column zero: one that has no variance left but rounding.
fn clear(p: &mut StateMatrix, state: usize) {
    p[state] = [0.0; STATES];
    p.iter_mut().for_each(|row| row[state] = 0.0);
}

/// Conditions a covariance on the position, and clears the position's rows and columns. The two columns handed back are
/// the first two of its Cholesky factor: spread·ξ is a draw of the position with the mean of the rest that follows it.
pub(super) fn condition_on_position(p: &mut StateMatrix) -> Spread {
    let mut spread = [[0.0; 2]; STATES];
    let variances = [p[LAT][LAT], p[LON][LON]];
    for (place, state) in [LAT, LON].into_iter().enumerate() {
        if p[state][state] > LEAST_PIVOT * variances[place] {
            let root = p[state][state].sqrt();
            for row in 0..STATES {
                spread[row][place] = p[row][state] / root;
            }
            correct(p, [(state, 1.0), (state, 0.0)], 0.0);
        }
        // What is left of its row and column is rounding, or belongs to a state without variance.
        clear(p, state);
    }
    spread
}

/// The step of the common covariance, and how the normals of each particle enter its state: with the covariance
/// Σ = Φ diag(0, P) Φᵀ + Q of the step, x ← Φ x + spread·ξ and P ← Σ given the position.
///
/// [Schön, Gustafsson & Nordlund 2005, (22)-(25), where M is the position's block of Σ, and L M the rest of its
/// columns; noise that position and linear states share, which the paper removes beforehand, is part of Σ]
pub(super) fn predict(p: &mut StateMatrix, step: &LineStep) -> Spread {
    *p = propagate_covariance(&step.phi, p);
    for (row, noise) in p.iter_mut().zip(&step.noise) {
        row.iter_mut().zip(noise).for_each(|(p, noise)| *p += noise);
    }
    condition_on_position(p)
}

/// Sums over the particles that a measurement corrected: weight over innovation variance times 1, the slope with
/// height, and its square.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Information {
    pub(super) s: f64,
    pub(super) alt_s: f64,
    pub(super) alt: f64,
}

/// The mean of the covariances that the particles have after a measurement, P − P (Σ w hᵀh/v) P with h = (slope with
/// height, 1) for altitude and S.
///
/// It is that of the measurement with information J = M (I − P M)⁻¹, M being the sum, over the two states; J is split
/// in two scalar measurements so that each can be in Joseph's form. With one slope for all it is one: the usual
/// update.
pub(super) fn measure(p: &mut StateMatrix, of: Information) {
    let (paa, pas, pss) = (p[ALT][ALT], p[ALT][S], p[S][S]);
    let Information { s: ms, alt_s: mx, alt: ma } = of;
    let (c00, c01) = (1.0 - (paa * ma + pas * mx), -(paa * mx + pas * ms));
    let (c10, c11) = (-(pas * ma + pss * mx), 1.0 - (pas * mx + pss * ms));
    let det = c00 * c11 - c01 * c10;
    let j_s = (ms * c00 - mx * c01) / det;
    let j_x = (mx * c00 - ma * c01) / det;
    let j_a = (ma * c11 - mx * c10) / det;
    if !(j_s > 0.0 && j_s.is_finite()) {
        return;
    }
    let slope = j_x / j_s;
    correct(p, [(S, 1.0), (ALT, slope)], 1.0 / j_s);
    let rest = j_a - j_x * slope;
    if rest > LEAST_PIVOT * j_a {
        correct(p, [(ALT, 1.0), (ALT, 0.0)], 1.0 / rest);
    }
}

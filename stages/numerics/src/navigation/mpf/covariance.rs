//! Covariance of the linear states given a particle's position, common to all particles.
//!
//! The covariance is stored over all `N` states, which are the 18 states of the INS and the states of further
//! measurements, with zeros for the position.

use crate::navigation::line::LineStep;
use crate::navigation::pinson::{ALT, LAT, LON, STATES, StateMatrix};
use crate::navigation::transition::propagate_covariance;

/// A pivot is treated as rounding error if its ratio to the variance of its state is below this.
const LEAST_PIVOT: f64 = 1e-13;

/// Matrix over the states.
pub(super) type ParticleMatrix<const N: usize> = [[f64; N]; N];
/// Two columns over the states, factors of the two standard normals of a particle.
pub(super) type ParticleSpread<const N: usize> = [[f64; 2]; N];

/// Propagation of a further state, a Gauss-Markov process, over a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct GaussMarkovStep {
    /// Decay factor over the step.
    pub(super) decay: f64,
    /// Variance that the step adds.
    pub(super) variance: f64,
}

/// P h of a row h of H, given by its entries.
pub(super) fn times<const N: usize>(p: &ParticleMatrix<N>, h: &[(usize, f64)]) -> [f64; N] {
    std::array::from_fn(|row| h.iter().map(|(state, entry)| entry * p[row][*state]).sum())
}

/// h x of a row h of H, given by its entries.
pub(super) fn dot<const N: usize>(h: &[(usize, f64)], x: &[f64; N]) -> f64 {
    h.iter().map(|(state, entry)| entry * x[*state]).sum()
}

/// Corrects a covariance with a scalar measurement of `h`·x whose noise has this variance, in Joseph's form. With
/// variance 0, conditions the state on the value. A combination with zero variance is not changed.
pub(super) fn correct<const N: usize>(p: &mut ParticleMatrix<N>, h: &[(usize, f64)], variance: f64) {
    let ph = times(p, h);
    let total = dot(h, &ph) + variance;
    if total <= 0.0 {
        return;
    }
    let gain = ph.map(|ph| ph / total);
    let rest: [f64; N] = std::array::from_fn(|row| {
        let after: f64 = h.iter().map(|(state, entry)| entry * (p[row][*state] - gain[row] * ph[*state])).sum();
        variance * gain[row] - after
    });
    for row in 0..N {
        let before = p[row][row];
        for column in row..N {
            let entry = p[row][column] - gain[row] * ph[column] + rest[row] * gain[column];
            p[row][column] = entry;
            p[column][row] = entry;
        }
        if p[row][row] < LEAST_PIVOT * before && p[row][row] > -LEAST_PIVOT * before {
            clear(p, row);
        }
    }
}

/// Sets the row and column of a state to zero if its variance is at the level of rounding.
fn clear<const N: usize>(p: &mut ParticleMatrix<N>, state: usize) {
    p[state] = [0.0; N];
    p.iter_mut().for_each(|row| row[state] = 0.0);
}

/// Conditions a covariance on the position, and clears the position's rows and columns. Returns the first two columns
/// of its Cholesky factor: spread·ξ is a draw of the position with the corresponding mean of the other states.
pub(super) fn condition_on_position<const N: usize>(p: &mut ParticleMatrix<N>) -> ParticleSpread<N> {
    let mut spread = [[0.0; 2]; N];
    let variances = [p[LAT][LAT], p[LON][LON]];
    for (place, state) in [LAT, LON].into_iter().enumerate() {
        if p[state][state] > LEAST_PIVOT * variances[place] {
            let root = p[state][state].sqrt();
            for row in 0..N {
                spread[row][place] = p[row][state] / root;
            }
            correct(p, &[(state, 1.0)], 0.0);
        }
        // The remaining row and column hold rounding errors, or belong to a state without variance.
        clear(p, state);
    }
    spread
}

/// Step of the common covariance, and the factors of each particle's normals. With the covariance Σ = Φ diag(0, P) Φᵀ +
/// Q of the step, x ← Φ x + spread·ξ, and P ← Σ given the position.
///
/// [Schön, Gustafsson & Nordlund 2005, (22)-(25), where M is the position's block of Σ, and L M the remaining part of
/// its columns. The paper first removes the noise that position and linear states share; here it is part of Σ]
pub(super) fn predict<const N: usize>(
    p: &mut ParticleMatrix<N>,
    step: &LineStep,
    further: &[GaussMarkovStep],
) -> ParticleSpread<N> {
    let of_ins: StateMatrix = std::array::from_fn(|row| std::array::from_fn(|column| p[row][column]));
    let of_ins = propagate_covariance(&step.phi, &of_ins);
    for (state, GaussMarkovStep { decay, variance }) in (STATES..).zip(further) {
        let cross: [f64; STATES] = std::array::from_fn(|row| {
            step.phi[row].iter().zip(&p[..STATES]).map(|(phi, before)| phi * before[state]).sum::<f64>() * decay
        });
        for (row, entry) in cross.into_iter().enumerate() {
            p[row][state] = entry;
            p[state][row] = entry;
        }
        for (other, lasting) in (STATES..=state).zip(further) {
            let entry = p[state][other] * (decay * lasting.decay);
            p[state][other] = entry;
            p[other][state] = entry;
        }
        p[state][state] += variance;
    }
    for (row, (of_ins, noise)) in p.iter_mut().zip(of_ins.iter().zip(&step.noise)) {
        for (entry, (propagated, noise)) in row.iter_mut().zip(of_ins.iter().zip(noise)) {
            *entry = propagated + noise;
        }
    }
    condition_on_position(p)
}

/// Three sums over the corrected particles of the weight divided by the innovation variance, multiplied by 1, by the
/// slope with height, and by the square of this slope.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct InformationSums {
    pub(super) common: f64,
    pub(super) alt_common: f64,
    pub(super) alt: f64,
}

/// Mean of the covariances of the particles after a measurement: P − P (Σ w hᵀh/v) P with h = u + slope·e. u is
/// `common` to all particles, and e is the unit row of the altitude.
///
/// The result equals the covariance after a measurement with information J = M (I − P M)⁻¹, with the sum M over u·x and
/// the altitude. J is split into two scalar measurements so that each can be in Joseph's form. With equal slopes there
/// is one measurement: the usual update.
pub(super) fn measure<const N: usize>(p: &mut ParticleMatrix<N>, common: &[(usize, f64)], of: InformationSums) {
    let of_common = times(p, common);
    let (paa, pau, puu) = (p[ALT][ALT], of_common[ALT], dot(common, &of_common));
    let InformationSums { common: mu, alt_common: mx, alt: ma } = of;
    let (c00, c01) = (1.0 - (paa * ma + pau * mx), -(paa * mx + pau * mu));
    let (c10, c11) = (-(pau * ma + puu * mx), 1.0 - (pau * mx + puu * mu));
    let det = c00 * c11 - c01 * c10;
    let j_u = (mu * c00 - mx * c01) / det;
    let j_x = (mx * c00 - ma * c01) / det;
    let j_a = (ma * c11 - mx * c10) / det;
    if !(j_u > 0.0 && j_u.is_finite()) {
        return;
    }
    let slope = j_x / j_u;
    let row: Vec<(usize, f64)> = common.iter().copied().chain([(ALT, slope)]).collect();
    correct(p, &row, 1.0 / j_u);
    let rest = j_a - j_x * slope;
    if rest > LEAST_PIVOT * j_a {
        correct(p, &[(ALT, 1.0)], 1.0 / rest);
    }
}

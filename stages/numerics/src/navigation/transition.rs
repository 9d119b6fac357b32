//! Discrete steps of the continuous error model: Φ = exp(F Δt) and the process noise.
//!
//! The longest functions are compiled once for each vector instruction set; in the loop of every filter, they would
//! take minutes to compile. The others are inlined into the loops. Products and sums are not fused, so the results
//! are bit-identical for all instruction sets.

use params::choice;
use pulp::{Scalar, Simd, WithSimd};

use crate::navigation::gaussian::lanes::{TransitionEntries, propagate_covariances};
use crate::navigation::pinson::{
    A_HAT, ACC, ALT, COUPLED, GAUSS_MARKOV, GYRO, HA, LAT, LON, S, STATES, StateMatrix, StateVector, TILT_D, TILT_E,
    TILT_N, VD, VE, VN,
};

choice! {
    /// Discretisation of the white driving noise over a step.
    #[derive(Default)]
    pub enum NoiseDiscretisation {
        /// Half of q Δt before the step and half after it: second order and positive semidefinite, without additional
        /// cost. With steps of 1 s, the filter's NEES equals the NEES with Van Loan's method to five digits.
        #[default]
        Trapezoidal = "trapezoidal",
        /// q Δt added after the step (MagNav.jl): first order.
        Rectangular = "rectangular",
        /// The integral of Φ(s) Q Φ(s)ᵀ over the step, exact to rounding errors; a filter that uses it takes five times
        /// as long. [Van Loan 1978]
        VanLoan = "van_loan",
    }
}

/// For each coupled state, the other coupled states on which it depends.
const COUPLING: [(usize, &[usize]); COUPLED.len()] = [
    (LAT, &[ALT, VN]),
    (LON, &[LAT, ALT, VE]),
    (ALT, &[ALT, VD]),
    (VN, &[LAT, ALT, VN, VE, VD, TILT_E, TILT_D]),
    (VE, &[LAT, ALT, VN, VE, VD, TILT_N, TILT_D]),
    (VD, &[LAT, ALT, VN, VE, TILT_N, TILT_E, A_HAT]),
    (TILT_N, &[LAT, ALT, VE, TILT_E, TILT_D]),
    (TILT_E, &[ALT, VN, TILT_N, TILT_D]),
    (TILT_D, &[LAT, ALT, VE, TILT_N, TILT_E]),
    (A_HAT, &[ALT]),
];

/// For each coupled state, the Gauss-Markov states that drive it.
const DRIVEN: [(usize, &[usize]); 8] = [
    (ALT, &[HA]),
    (VN, &[ACC, ACC + 1, ACC + 2]),
    (VE, &[ACC, ACC + 1, ACC + 2]),
    (VD, &[ACC, ACC + 1, ACC + 2, HA]),
    (TILT_N, &[GYRO, GYRO + 1, GYRO + 2]),
    (TILT_E, &[GYRO, GYRO + 1, GYRO + 2]),
    (TILT_D, &[GYRO, GYRO + 1, GYRO + 2]),
    (A_HAT, &[HA]),
];

/// Scales that make the coupling between different states comparable: positions in metres, velocities in metres per 30
/// s, and so on along the chain of gyroscope, tilt, velocity and position.
const SCALE: StateVector = {
    const RADIUS: f64 = 6.4e6;
    const T: f64 = 30.0;
    const G: f64 = 9.8;
    let (v, tilt, acc, gyro) = (T, G * T * T, T * T, G * T * T * T);
    [RADIUS, RADIUS, 1.0, v, v, v, tilt, tilt, tilt, acc, acc, acc, gyro, gyro, gyro, 1.0, acc, 1.0]
};

/// Largest remainder of the series, in scaled states.
const REMAINDER: f64 = 1e-16;
/// Largest scaled norm of F Δt for the series; above this norm the step is halved.
const LARGEST: f64 = 0.5;

/// Transition matrix exp(F Δt) of a matrix from `pinson_matrix`.
///
/// The Gauss-Markov states decay by their exponentials. The other states use the Taylor series over the nonzero
/// entries. The order of the series gives a remainder θ^(k+1)/(k+1)! e^θ below 1e-16, where θ is the largest row sum of
/// |F Δt| in scaled states (6 terms at 0.1 s, 8 at 1 s). A step with θ above one half (several seconds) is halved
/// until θ is at most one half.
#[inline(never)]
pub fn transition_matrix(f: &StateMatrix, dt_s: f64) -> StateMatrix {
    pulp::Arch::new().dispatch(Exponential { f, dt_s })
}

/// exp(F Δt), compiled for the vector unit of the machine.
struct Exponential<'a> {
    f: &'a StateMatrix,
    dt_s: f64,
}

impl WithSimd for Exponential<'_> {
    type Output = StateMatrix;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> StateMatrix {
        exponential(self.f, self.dt_s)
    }
}

#[inline(always)]
fn exponential(f: &StateMatrix, dt_s: f64) -> StateMatrix {
    let norm = scaled_norm(f);
    let halvings = halvings(norm * dt_s.abs());
    let mut phi = series(f, norm, dt_s / f64::from(1_u32 << halvings));
    for _ in 0..halvings {
        phi = product(&phi, &phi);
    }
    phi
}

/// Largest row sum of |F|, in 1/s, in scaled states.
#[inline(always)]
fn scaled_norm(f: &StateMatrix) -> f64 {
    let row_sum = |row: usize, columns: &[usize]| -> f64 {
        columns.iter().map(|column| f[row][*column].abs() * SCALE[row] / SCALE[*column]).sum()
    };
    let mut sums = [0.0; STATES];
    for (row, columns) in COUPLING.iter().chain(&DRIVEN) {
        sums[*row] += row_sum(*row, columns);
    }
    for state in GAUSS_MARKOV {
        sums[state] = f[state][state].abs();
    }
    // A NaN must propagate to the matrix; otherwise it would only lead to a wrong order of the series.
    sums.into_iter().fold(0.0, |largest, sum| if sum <= largest { largest } else { sum })
}

#[inline(always)]
fn halvings(theta: f64) -> u32 {
    let mut halvings = 0;
    let mut rest = theta;
    while rest > LARGEST && halvings < 30 {
        rest *= 0.5;
        halvings += 1;
    }
    halvings
}

/// Taylor series of exp(F Δt) over the pattern of F, with the scaled norm `norm`, in 1/s.
#[inline(always)]
fn series(f: &StateMatrix, norm: f64, dt_s: f64) -> StateMatrix {
    let theta = norm * dt_s.abs();
    let mut phi = identity();
    // The two buffers hold alternate terms of the series. Entries outside the pattern are zero from the start and
    // remain zero.
    let (mut term, mut next) = (&mut identity(), &mut [[0.0; STATES]; STATES]);
    let mut bound = theta.exp();
    for order in 1..40_u32 {
        next_term(f, term, dt_s / f64::from(order), next);
        std::mem::swap(&mut term, &mut next);
        for row in COUPLED {
            add_scaled(&mut phi[row], 1.0, &term[row]);
        }
        bound *= theta / f64::from(order);
        if bound * theta <= REMAINDER * f64::from(order + 1) {
            break;
        }
    }
    for state in GAUSS_MARKOV {
        phi[state][state] = (f[state][state] * dt_s).exp();
    }
    phi
}

/// F times a term of the series times `factor`, over the pattern.
#[inline(always)]
fn next_term(f: &StateMatrix, term: &StateMatrix, factor: f64, next: &mut StateMatrix) {
    for (row, columns) in COUPLING {
        let mut sum = [0.0; STATES];
        for column in columns {
            add_scaled(&mut sum, factor * f[row][*column], &term[*column]);
        }
        next[row] = sum;
    }
    for (row, columns) in DRIVEN {
        for column in columns {
            next[row][*column] += factor * f[row][*column] * term[*column][*column];
        }
    }
    for state in GAUSS_MARKOV {
        next[state][state] = factor * f[state][state] * term[state][state];
    }
}

/// Identity matrix.
#[inline(always)]
pub fn identity() -> StateMatrix {
    diagonal(&[1.0; STATES])
}

/// Diagonal matrix.
#[inline(always)]
pub fn diagonal(entries: &StateVector) -> StateMatrix {
    let mut matrix = [[0.0; STATES]; STATES];
    for (state, entry) in entries.iter().enumerate() {
        matrix[state][state] = *entry;
    }
    matrix
}

/// Adds a multiple of a row to a row.
#[inline(always)]
pub(crate) fn add_scaled(to: &mut StateVector, factor: f64, from: &StateVector) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += factor * from;
    }
}

/// Product A B of two transition matrices.
#[inline(always)]
pub(crate) fn product(a: &StateMatrix, b: &StateMatrix) -> StateMatrix {
    let mut out = [[0.0; STATES]; STATES];
    for row in COUPLED {
        for (factor, b_row) in a[row].iter().zip(b) {
            add_scaled(&mut out[row], *factor, b_row);
        }
    }
    for state in GAUSS_MARKOV {
        out[state][state] = a[state][state] * b[state][state];
    }
    out
}

/// Product Φ x, computed over the nonzero entries of a transition matrix.
#[inline(always)]
pub fn propagate_state(phi: &StateMatrix, x: &StateVector) -> StateVector {
    let mut out = [0.0; STATES];
    for row in COUPLED {
        out[row] = phi[row].iter().zip(x).map(|(phi, x)| phi * x).sum();
    }
    for state in GAUSS_MARKOV {
        out[state] = phi[state][state] * x[state];
    }
    out
}

/// Φ P Φᵀ of a symmetric P, exactly symmetric: one triangle is computed and mirrored.
#[inline(never)]
pub fn propagate_covariance(phi: &StateMatrix, p: &StateMatrix) -> StateMatrix {
    pulp::Arch::new().dispatch(Propagation { phi, p })
}

/// Φ P Φᵀ, compiled for the vector unit of the machine.
struct Propagation<'a> {
    phi: &'a StateMatrix,
    p: &'a StateMatrix,
}

impl WithSimd for Propagation<'_> {
    type Output = StateMatrix;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> StateMatrix {
        let mut out = *self.p;
        propagate_covariances(Scalar, &TransitionEntries::from_matrix(self.phi), self.phi[S][S], &mut out);
        out
    }
}

/// Covariance that white noise of spectral density `q` (per state, per second) adds over a step: the integral of exp(F
/// s) Q exp(F s)ᵀ over the step. [Van Loan 1978]
///
/// Four-point Gauss-Legendre quadrature over pieces with a scaled norm of at most one half. The weights of the
/// quadrature are positive, so every result is positive semidefinite.
#[inline(never)]
pub fn van_loan(f: &StateMatrix, q: &StateVector, dt_s: f64) -> StateMatrix {
    pulp::Arch::new().dispatch(NoiseIntegral { f, q, dt_s })
}

/// The integral of exp(F s) Q exp(F s)ᵀ over a step, compiled for the vector unit of the machine.
struct NoiseIntegral<'a> {
    f: &'a StateMatrix,
    q: &'a StateVector,
    dt_s: f64,
}

impl WithSimd for NoiseIntegral<'_> {
    type Output = StateMatrix;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> StateMatrix {
        noise_integral(self.f, self.q, self.dt_s)
    }
}

#[inline(always)]
fn noise_integral(f: &StateMatrix, q: &StateVector, dt_s: f64) -> StateMatrix {
    const NODES: [(f64, f64); 4] = [
        (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
        (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
        (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
        (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
    ];
    let norm = scaled_norm(f);
    let halvings = halvings(norm * dt_s.abs());
    let piece_s = dt_s / f64::from(1_u32 << halvings);
    let mut sum = [[0.0; STATES]; STATES];
    for (node, weight) in NODES {
        let phi = series(f, norm, node * piece_s);
        let noise = diagonal(&q.map(|density| density * weight * piece_s));
        let part = propagate_covariance(&phi, &noise);
        add(&mut sum, &part);
    }
    let mut phi = series(f, norm, piece_s);
    for _ in 0..halvings {
        let earlier = propagate_covariance(&phi, &sum);
        add(&mut sum, &earlier);
        phi = product(&phi, &phi);
    }
    sum
}

/// Adds a matrix to a matrix.
#[inline(always)]
pub(crate) fn add(to: &mut StateMatrix, from: &StateMatrix) {
    for (to, from) in to.iter_mut().zip(from) {
        add_scaled(to, 1.0, from);
    }
}

/// One step of a covariance: Φ P Φᵀ plus the process noise of spectral density `q` (per second).
#[inline(always)]
pub fn step_covariance(
    p: &StateMatrix,
    f: &StateMatrix,
    phi: &StateMatrix,
    q: &StateVector,
    dt_s: f64,
    noise: NoiseDiscretisation,
) -> StateMatrix {
    let share = |part: f64| q.map(|density| density * part * dt_s);
    match noise {
        NoiseDiscretisation::Rectangular => {
            let mut out = propagate_covariance(phi, p);
            add_diagonal(&mut out, &share(1.0));
            out
        }
        NoiseDiscretisation::Trapezoidal => {
            let mut before = *p;
            add_diagonal(&mut before, &share(0.5));
            let mut out = propagate_covariance(phi, &before);
            add_diagonal(&mut out, &share(0.5));
            out
        }
        NoiseDiscretisation::VanLoan => {
            let mut out = propagate_covariance(phi, p);
            add(&mut out, &van_loan(f, q, dt_s));
            out
        }
    }
}

#[inline(always)]
fn add_diagonal(m: &mut StateMatrix, entries: &StateVector) {
    for (state, entry) in entries.iter().enumerate() {
        m[state][state] += entry;
    }
}

#[cfg(test)]
mod tests;

//! Mean and covariance of the 18 states and further ones, with time update and measurement update.

use std::ops::Range;

use crate::navigation::line::{LineStep, NavigationLine};
use crate::navigation::pinson::{A_HAT, ACC, STATES, StateMatrix, StateVector, TILT_D};
use crate::navigation::transition::{propagate_covariance, propagate_state};
use crate::signal::gauss_markov::GaussMarkov;

/// Order of the states: 18 of the INS and the temporal variation, Gauss-Markov errors (in `fixed_lag` one per
/// magnetometer), and the coefficients of each magnetometer in turn.
#[derive(Clone, Debug, Default)]
pub(crate) struct StateLayout {
    /// Gauss-Markov errors. Errors with a correlation length have the correlation time of the step.
    pub errors: Vec<GaussMarkov>,
    /// Positions of the errors with a correlation length, and this length in m.
    pub lengths_m: Vec<(usize, f64)>,
    /// Ranges of the coefficients of each magnetometer.
    pub blocks: Vec<Range<usize>>,
    /// Random-walk densities of all coefficients, per second.
    pub walk: Vec<f64>,
}

impl StateLayout {
    pub fn dim(&self) -> usize {
        self.coefficients() + self.walk.len()
    }

    /// Index of the first coefficient.
    pub fn coefficients(&self) -> usize {
        STATES + self.errors.len()
    }

    /// Propagation of an error at a ground speed.
    pub fn error_at(&self, place: usize, speed_mps: f64) -> GaussMarkov {
        let error = self.errors[place];
        match self.lengths_m.iter().find(|(of, _)| *of == place) {
            Some((_, length_m)) => GaussMarkov { tau_s: length_m / speed_mps, ..error },
            None => error,
        }
    }

    /// Propagation of the errors over a step.
    fn errors_of<'a>(&'a self, step: &'a StateStep) -> impl Iterator<Item = GaussMarkov> + 'a {
        (0..self.errors.len()).map(|place| self.error_at(place, step.speed_mps))
    }
}

/// Step from a node to the next.
#[derive(Clone, Debug)]
pub(crate) struct StateStep {
    pub dt_s: f64,
    /// Mean ground speed.
    pub speed_mps: f64,
    pub phi: StateMatrix,
    pub noise: StateMatrix,
}

impl From<LineStep> for StateStep {
    fn from(LineStep { dt_s, speed_mps, phi, noise }: LineStep) -> Self {
        Self { dt_s, speed_mps, phi, noise }
    }
}

/// States with off-diagonal entries in Φ: all except the Gauss-Markov ones.
const COUPLED: [usize; 10] = [0, 1, 2, 3, 4, 5, 6, 7, TILT_D, A_HAT];

/// A B for transition matrices.
pub(crate) fn product(a: &StateMatrix, b: &StateMatrix) -> StateMatrix {
    let mut out = [[0.0; STATES]; STATES];
    for state in (ACC..A_HAT).chain([STATES - 1]) {
        out[state][state] = a[state][state] * b[state][state];
    }
    for row in COUPLED {
        let mut sum = [0.0; STATES];
        for (factor, from) in a[row].iter().zip(b) {
            for (sum, from) in sum.iter_mut().zip(from) {
                *sum += factor * from;
            }
        }
        out[row] = sum;
    }
    out
}

/// Adds a matrix.
pub(crate) fn add(to: &mut StateMatrix, from: &StateMatrix) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *to += from;
    }
}

/// Row of H of one measurement: 18 entries, its own error, an error common to several measurements, and its
/// coefficients.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AugmentedSensitivity<'a> {
    pub ins: &'a StateVector,
    /// Index of the error, and its entry.
    pub error: (usize, f64),
    /// Index of the common error, and its entry.
    pub common: (usize, f64),
    /// Index of the first coefficient.
    pub first: usize,
    pub regressors: &'a [f64],
}

impl<'a> AugmentedSensitivity<'a> {
    /// Row of H of a measurement of the 18 states alone.
    pub fn of_ins(ins: &'a StateVector) -> Self {
        Self { ins, error: (0, 0.0), common: (0, 0.0), first: 0, regressors: &[] }
    }

    /// H x.
    #[inline]
    pub fn dot(&self, x: &[f64]) -> f64 {
        let ins: f64 = self.ins.iter().zip(x).map(|(h, x)| h * x).sum();
        let aircraft: f64 = self.regressors.iter().zip(&x[self.first..]).map(|(h, x)| h * x).sum();
        ins + self.error.1 * x[self.error.0] + aircraft + self.common.1 * x[self.common.0]
    }

    /// x ← x + f Hᵀ.
    #[inline]
    pub fn add_to(&self, x: &mut [f64], factor: f64) {
        x.iter_mut().zip(self.ins).for_each(|(x, h)| *x += factor * h);
        x[self.error.0] += factor * self.error.1;
        x[self.common.0] += factor * self.common.1;
        x[self.first..].iter_mut().zip(self.regressors).for_each(|(x, h)| *x += factor * h);
    }

    /// Nonzero entries with their states.
    #[inline]
    pub fn entries(&self) -> impl Iterator<Item = (usize, f64)> {
        let ins = self.ins.iter().copied().enumerate().filter(|(_, h)| *h != 0.0);
        let own = ins.chain([self.error]).chain(self.regressors.iter().enumerate().map(|(k, h)| (self.first + k, *h)));
        own.chain([self.common].into_iter().filter(|(_, h)| *h != 0.0))
    }
}

/// Mean and covariance (row-major, exactly symmetric).
#[derive(Clone, Debug, Default)]
pub(crate) struct Gaussian {
    pub x: Vec<f64>,
    pub p: Vec<f64>,
}

/// Adds a multiple of a row.
#[inline]
pub(crate) fn add_scaled(to: &mut [f64], factor: f64, from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
}

impl Gaussian {
    /// States of a layout without coefficients before the first sample of a line.
    pub fn start_of(line: &NavigationLine<'_>, layout: &StateLayout) -> Self {
        let dim = layout.dim();
        let mut start = Self { x: vec![0.0; dim], p: vec![0.0; dim * dim] };
        let first = line.errors.initial_covariance(line.ins.lat_deg[0].to_radians(), line.ins.alt_m[0]);
        for (row, entries) in first.iter().enumerate() {
            start.p[row * dim..row * dim + STATES].copy_from_slice(entries);
        }
        for (k, error) in layout.errors.iter().enumerate() {
            start.p[(STATES + k) * (dim + 1)] = error.sigma * error.sigma;
        }
        start
    }

    pub fn dim(&self) -> usize {
        self.x.len()
    }

    pub fn copy_from(&mut self, other: &Self) {
        self.x.clone_from(&other.x);
        self.p.clone_from(&other.p);
    }

    /// Covariance of the 18 states.
    pub fn ins_covariance(&self) -> StateMatrix {
        let dim = self.dim();
        std::array::from_fn(|row| std::array::from_fn(|column| self.p[row * dim + column]))
    }

    /// The first 18 states.
    pub fn ins_state(&self) -> StateVector {
        std::array::from_fn(|state| self.x[state])
    }

    /// Whether all values are finite and no variance is negative.
    pub fn is_sound(&self) -> bool {
        let dim = self.dim();
        self.x.iter().chain(&self.p).all(|value| value.is_finite()) && (0..dim).all(|k| self.p[k * dim + k] >= 0.0)
    }

    /// x ← Φ x, P ← Φ P Φᵀ + Q. `spare` is a buffer for the cross covariance.
    pub fn propagate(&mut self, layout: &StateLayout, step: &StateStep, spare: &mut Vec<f64>) {
        let dim = self.dim();
        propagate_mean(layout, step, &mut self.x);
        let mut block = propagate_covariance(&step.phi, &self.ins_covariance());
        add(&mut block, &step.noise);
        self.propagate_cross(step, spare);
        for (row, entries) in block.iter().enumerate() {
            self.p[row * dim..row * dim + STATES].copy_from_slice(entries);
        }
        for (k, error) in layout.errors_of(step).enumerate() {
            let (at, decay) = (STATES + k, error.decay(step.dt_s));
            self.p[at * dim..(at + 1) * dim].iter_mut().for_each(|entry| *entry *= decay);
            (0..dim).for_each(|row| self.p[row * dim + at] *= decay);
            self.p[at * dim + at] += error.step_variance(step.dt_s);
        }
        for (k, density) in layout.walk.iter().enumerate() {
            let at = layout.coefficients() + k;
            self.p[at * dim + at] += density * step.dt_s;
        }
    }

    /// Covariance of the 18 states with the others: Φ P₁₂.
    fn propagate_cross(&mut self, step: &StateStep, spare: &mut Vec<f64>) {
        let dim = self.dim();
        let width = dim - STATES;
        spare.clear();
        spare.resize(STATES * width, 0.0);
        for (row, out) in spare.chunks_exact_mut(width.max(1)).enumerate() {
            for (column, factor) in step.phi[row].iter().enumerate() {
                if *factor != 0.0 {
                    add_scaled(out, *factor, &self.p[column * dim + STATES..(column + 1) * dim]);
                }
            }
        }
        for row in 0..STATES {
            let from = &spare[row * width..(row + 1) * width];
            self.p[row * dim + STATES..(row + 1) * dim].copy_from_slice(from);
            from.iter().enumerate().for_each(|(k, entry)| self.p[(STATES + k) * dim + row] = *entry);
        }
    }

    /// Variance of a predicted measurement, H P Hᵀ + R; writes P Hᵀ to `out`.
    pub fn predict(&self, h: &AugmentedSensitivity, variance: f64, out: &mut [f64]) -> f64 {
        let dim = self.dim();
        out.fill(0.0);
        for (state, entry) in h.entries() {
            add_scaled(out, entry, &self.p[state * dim..(state + 1) * dim]);
        }
        h.dot(out) + variance
    }

    /// Updates with an innovation of variance `s` only the states that `corrects` selects, with P Hᵀ in `gain`, which
    /// becomes K: the consider update [Schmidt 1966], in Joseph's form as [`Gaussian::update`].
    pub fn consider(
        &mut self,
        innovation: f64,
        s: f64,
        gain: &mut [f64],
        spare: &mut Vec<f64>,
        corrects: impl Fn(usize) -> bool,
    ) {
        spare.clear();
        for (state, k) in gain.iter_mut().enumerate() {
            let of_state = *k;
            *k = if corrects(state) { of_state / s } else { 0.0 };
            spare.push(of_state - 0.5 * s * *k);
        }
        self.correct(innovation, gain, spare);
    }

    /// Updates with an innovation of variance `s`, with P Hᵀ in `gain`, which becomes K.
    ///
    /// Joseph's form (I − K H) P (I − K H)ᵀ + K R Kᵀ, multiplied out to P − K vᵀ − v Kᵀ with v = P Hᵀ − K s/2. It keeps
    /// the property of Joseph's form: an error of K enters by its square. Both triangles are bit-identical.
    pub fn update(&mut self, innovation: f64, s: f64, gain: &mut [f64], spare: &mut Vec<f64>) {
        self.consider(innovation, s, gain, spare, |_| true);
    }

    /// x ← x + K r, P ← P − K vᵀ − v Kᵀ.
    fn correct(&mut self, innovation: f64, gain: &[f64], half: &[f64]) {
        let dim = self.dim();
        add_scaled(&mut self.x, innovation, gain);
        for (row, (k, v)) in self.p.chunks_exact_mut(dim).zip(gain.iter().zip(half)) {
            for (entry, (gain, half)) in row.iter_mut().zip(gain.iter().zip(half)) {
                *entry -= k * half + v * gain;
            }
        }
    }
}

/// x ← Φ x of all states.
pub(crate) fn propagate_mean(layout: &StateLayout, step: &StateStep, x: &mut [f64]) {
    let mut ins = [0.0; STATES];
    ins.copy_from_slice(&x[..STATES]);
    x[..STATES].copy_from_slice(&propagate_state(&step.phi, &ins));
    for (error, x) in layout.errors_of(step).zip(&mut x[STATES..]) {
        *x *= error.decay(step.dt_s);
    }
}

/// λ ← Φᵀ λ of all states.
pub(crate) fn propagate_adjoint(layout: &StateLayout, step: &StateStep, adjoint: &mut [f64]) {
    let mut ins = [0.0; STATES];
    for (row, entry) in step.phi.iter().zip(adjoint.iter()) {
        add_scaled(&mut ins, *entry, row);
    }
    adjoint[..STATES].copy_from_slice(&ins);
    for (error, entry) in layout.errors_of(step).zip(&mut adjoint[STATES..]) {
        *entry *= error.decay(step.dt_s);
    }
}

/// Q λ of all states.
pub(crate) fn noise_times(layout: &StateLayout, step: &StateStep, adjoint: &[f64], out: &mut [f64]) {
    for (out, row) in out.iter_mut().zip(&step.noise) {
        *out = row.iter().zip(adjoint).map(|(q, adjoint)| q * adjoint).sum();
    }
    for (k, error) in layout.errors_of(step).enumerate() {
        out[STATES + k] = error.step_variance(step.dt_s) * adjoint[STATES + k];
    }
    for (k, density) in layout.walk.iter().enumerate() {
        let at = layout.coefficients() + k;
        out[at] = density * step.dt_s * adjoint[at];
    }
}

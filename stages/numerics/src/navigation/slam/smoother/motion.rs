//! Error of the INS over a whole line in a basis of a few functions of time, with independent unit weights.

use crate::navigation::NavigationError;
use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix, StateVector, pinson_matrix};
use crate::navigation::position_fixes::{PositionFixes, StateFix};
use crate::navigation::slam::resolution::product;
use crate::navigation::slam::samples::{LocalFrame, SlamLine};
use crate::navigation::transition::{identity, propagate_state, step_covariance, transition_matrix};

/// Maximum number of functions.
const MOST_FUNCTIONS: usize = 500;

/// Error states from step to step: x ← Φ x + w, where P is the covariance of x. Axis 0 is north, 1 is east.
pub struct InsErrorTransitions {
    phi: Vec<StateMatrix>,
    p: Vec<StateMatrix>,
    m_per_rad: [f64; 2],
    /// Times of the steps, in seconds.
    tt_s: Vec<f64>,
}

/// Position error at the steps of a line, δ = B u with u ~ N(0, I), and the remaining variance of δ.
///
/// The columns of B are the columns of the pivoted Cholesky factor of the covariance of all δ. A weight is the part of
/// one pivot's error that the previous pivots do not determine. [Harbrecht, Peters & Schneider 2012]
pub struct PositionErrorBasis {
    /// Number of functions.
    pub count: usize,
    /// Matrix B, in the order of the steps; for each step the row for north, then the row for east.
    rows: Vec<f64>,
    /// Omitted variance north and east, in m².
    pub lacking_m2: Vec<[f64; 2]>,
    /// Step and axis of each pivot.
    pivots: Vec<(usize, usize)>,
}

/// Position of a time between two steps: the first step, and the fraction of the interval that has passed.
#[derive(Clone, Copy, Debug)]
pub struct StepInterpolation {
    /// First step.
    pub step: usize,
    /// Fraction, from 0 to 1.
    pub part: f64,
}

fn transposed(phi: &StateMatrix, x: &StateVector) -> StateVector {
    let mut out = [0.0; STATES];
    for (row, x) in phi.iter().zip(x) {
        for (out, phi) in out.iter_mut().zip(row) {
            *out += phi * x;
        }
    }
    out
}

impl InsErrorTransitions {
    /// Computes the transitions along a line that passed [`SlamLine::check`]. `ends` are the last rows of the steps.
    ///
    /// # Errors
    /// Fails with [`NavigationError::Diverged`] if a variance is negative or not finite.
    pub fn along(line: &SlamLine<'_>, ends: &[usize], frame: &LocalFrame) -> Result<Self, NavigationError> {
        let (ins, errors) = (line.ins, &line.errors);
        let (times, density) = (errors.time_constants(), errors.noise_density());
        let mut at = errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let (mut phi, mut p) = (Vec::with_capacity(ends.len()), Vec::with_capacity(ends.len()));
        let mut row = 0;
        for end in ends {
            let mut all = identity();
            while row < *end {
                let dt_s = ins.tt_s[row + 1] - ins.tt_s[row];
                let f = pinson_matrix(&ins.point(row), &times, errors.pinson);
                let one = transition_matrix(&f, dt_s);
                at = step_covariance(&at, &f, &one, &density, dt_s, errors.noise);
                all = product(&one, &all);
                row += 1;
            }
            // The comparison is also false for NaN.
            let sound = (0..STATES).all(|state| at[state][state] >= 0.0 && at[state][state].is_finite());
            if !sound {
                return Err(NavigationError::Diverged { row, tt_s: ins.tt_s[row] });
            }
            phi.push(all);
            p.push(at);
        }
        let tt_s = ends.iter().map(|end| ins.tt_s[*end]).collect();
        Ok(Self { phi, p, m_per_rad: frame.m_per_rad, tt_s })
    }

    /// Covariance, in m², of the position at each step with one coordinate at one step.
    fn column(&self, (pivot, axis): (usize, usize)) -> Vec<[f64; 2]> {
        let [north, east] = self.m_per_rad;
        let in_m = |x: &StateVector| [x[LAT] * north, x[LON] * east];
        let mut out = vec![[0.0; 2]; self.p.len()];
        let state = [LAT, LON][axis];
        let mut x: StateVector = std::array::from_fn(|row| self.p[pivot][row][state] * self.m_per_rad[axis]);
        out[pivot] = in_m(&x);
        for (out, phi) in out.iter_mut().zip(&self.phi).skip(pivot + 1) {
            x = propagate_state(phi, &x);
            *out = in_m(&x);
        }
        let mut adjoint = [0.0; STATES];
        adjoint[state] = self.m_per_rad[axis];
        for step in (0..pivot).rev() {
            adjoint = transposed(&self.phi[step + 1], &adjoint);
            out[step] = [(LAT, north), (LON, east)].map(|(state, m_per_rad)| {
                let row = &self.p[step][state];
                m_per_rad * row.iter().zip(&adjoint).map(|(p, a)| p * a).sum::<f64>()
            });
        }
        out
    }

    /// Basis functions, added until the omitted part of every position has a standard deviation of at most
    /// `tolerance_m`, in metres, or until their number is `MOST_FUNCTIONS`.
    pub fn functions(&self, tolerance_m: f64) -> PositionErrorBasis {
        let steps = self.p.len();
        let [north, east] = self.m_per_rad;
        let mut lacking: Vec<[f64; 2]> =
            self.p.iter().map(|p| [p[LAT][LAT] * north * north, p[LON][LON] * east * east]).collect();
        let mut columns: Vec<Vec<[f64; 2]>> = vec![];
        let mut pivots = vec![];
        while columns.len() < MOST_FUNCTIONS.min(2 * steps) {
            let all = lacking.iter().enumerate().flat_map(|(step, of)| [((step, 0), of[0]), ((step, 1), of[1])]);
            let most = all.fold(((0, 0), 0.0), |most, one| if one.1 > most.1 { one } else { most });
            let ((step, axis), variance) = most;
            if variance <= tolerance_m * tolerance_m {
                break;
            }
            let mut column = self.column((step, axis));
            for before in &columns {
                let factor = before[step][axis];
                for (to, of) in column.iter_mut().zip(before) {
                    to[0] -= factor * of[0];
                    to[1] -= factor * of[1];
                }
            }
            let scale = 1.0 / variance.sqrt();
            for (to, lacking) in column.iter_mut().zip(&mut lacking) {
                for (to, lacking) in to.iter_mut().zip(lacking) {
                    *to *= scale;
                    *lacking = (*lacking - *to * *to).max(0.0);
                }
            }
            lacking[step][axis] = 0.0;
            columns.push(column);
            pivots.push((step, axis));
        }
        let mut rows = Vec::with_capacity(2 * steps * columns.len());
        for step in 0..steps {
            for axis in 0..2 {
                rows.extend(columns.iter().map(|column| column[step][axis]));
            }
        }
        PositionErrorBasis { count: columns.len(), rows, lacking_m2: lacking, pivots }
    }

    /// Expected error states at the steps given the weights of the functions.
    pub fn states(&self, functions: &PositionErrorBasis, weights: &[f64]) -> Vec<StateVector> {
        let steps = self.p.len();
        // K_JJ = L Lᵀ, where L are the pivots' own rows, so that E x = K_xJ L⁻ᵀ u.
        let mut forces = weights.to_vec();
        for j in (0..functions.count).rev() {
            let row = |k: usize| -> f64 {
                let (step, axis) = functions.pivots[k];
                functions.at(step, axis)[j]
            };
            let later: f64 = (j + 1..functions.count).map(|k| row(k) * forces[k]).sum();
            forces[j] = (forces[j] - later) / row(j);
        }
        let mut at_step = vec![[0.0; 2]; steps];
        for ((step, axis), force) in functions.pivots.iter().zip(&forces) {
            at_step[*step][*axis] += force * self.m_per_rad[*axis];
        }
        let mut later = vec![[0.0; STATES]; steps];
        let mut adjoint = [0.0; STATES];
        for step in (0..steps).rev() {
            later[step] = adjoint;
            adjoint[LAT] += at_step[step][0];
            adjoint[LON] += at_step[step][1];
            adjoint = transposed(&self.phi[step], &adjoint);
        }
        let mut earlier = [0.0; STATES];
        let mut out = Vec::with_capacity(steps);
        for step in 0..steps {
            earlier = propagate_state(&self.phi[step], &earlier);
            let p = &self.p[step];
            let [north, east] = at_step[step];
            let x: StateVector = std::array::from_fn(|state| {
                earlier[state] += north * p[state][LAT] + east * p[state][LON];
                earlier[state] + p[state].iter().zip(&later[step]).map(|(p, a)| p * a).sum::<f64>()
            });
            out.push(x);
        }
        out
    }

    /// Position of a time among the steps, limited to the range from the first to the last step.
    pub fn between(&self, tt_s: f64) -> StepInterpolation {
        let after = self.tt_s.partition_point(|step_s| *step_s < tt_s);
        let Some(step) = after.checked_sub(1) else { return StepInterpolation { step: 0, part: 0.0 } };
        match (self.tt_s.get(step), self.tt_s.get(after)) {
            (Some(from_s), Some(to_s)) => {
                StepInterpolation { step, part: ((tt_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0) }
            }
            _ => StepInterpolation { step: self.tt_s.len().saturating_sub(1), part: 0.0 },
        }
    }

    /// Position covariance of the INS alone at a step, in m²: variances north and east, and the covariance of both.
    pub fn alone_m2(&self, step: usize) -> [f64; 3] {
        let ([north, east], p) = (self.m_per_rad, &self.p[step]);
        [north * north * p[LAT][LAT], east * east * p[LON][LON], north * east * p[LAT][LON]]
    }

    /// Number of steps.
    pub fn steps(&self) -> usize {
        self.p.len()
    }

    /// Information on the weights from aiding positions: the information matrix by rows, and its product with the most
    /// probable weights.
    pub fn known(
        &self,
        functions: &PositionErrorBasis,
        line: &SlamLine<'_>,
        fixes: &PositionFixes,
    ) -> (Vec<f64>, Vec<f64>) {
        let count = functions.count;
        let (mut information, mut force) = (vec![0.0; count * count], vec![0.0; count]);
        for row in 0..line.ins.len() {
            for fix in fixes.at(line.ins, row, line.errors.earth).into_iter().flatten() {
                let StateFix { state, error, variance } = fix;
                let axis = match state {
                    LAT => 0,
                    LON => 1,
                    // The height carries no information about the horizontal position.
                    _ => continue,
                };
                let m_per_rad = self.m_per_rad[axis];
                let [north, east] = functions.between(self.between(line.ins.tt_s[row]));
                let h = if axis == 0 { north } else { east };
                let weight = 1.0 / (variance * m_per_rad * m_per_rad);
                for (i, a) in h.iter().enumerate() {
                    force[i] += weight * a * error * m_per_rad;
                    for (to, b) in information[i * count..(i + 1) * count].iter_mut().zip(&h) {
                        *to += weight * a * b;
                    }
                }
            }
        }
        (information, force)
    }
}

impl PositionErrorBasis {
    /// Functions at a step, for one axis, in metres.
    pub fn at(&self, step: usize, axis: usize) -> &[f64] {
        let first = (2 * step + axis) * self.count;
        &self.rows[first..first + self.count]
    }

    /// Functions between two steps, north and east, in metres.
    pub fn between(&self, StepInterpolation { step, part }: StepInterpolation) -> [Vec<f64>; 2] {
        [0, 1].map(|axis| {
            let here = self.at(step, axis);
            if part == 0.0 {
                return here.to_vec();
            }
            let next = self.at(step + 1, axis);
            here.iter().zip(next).map(|(a, b)| a + part * (b - a)).collect()
        })
    }
}

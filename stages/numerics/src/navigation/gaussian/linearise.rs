//! Measurement of a nonlinear field: the most probable state after the measurement, and the regression of the field
//! over sigma points.

use crate::earth::field_value::FieldValue;
use crate::navigation::pinson::StateMatrix;

use super::{MEASURED, Sensitivity, StateEstimate, measured_states};

/// Maximum number of halvings of a step.
const MOST_HALVINGS: u32 = 10;

/// Parameters of the search for the most probable state.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScalarSearch {
    /// Maximum number of linearisations, at least 1. With one iteration, the full step is taken unconditionally.
    pub(crate) iterations: usize,
    /// Change of position, in metres, below which the search ends.
    pub(crate) tolerance_m: f64,
    /// Metres north and east per radian.
    pub(crate) m_per_rad: (f64, f64),
}

/// Most probable state x⁻ + P v.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Optimum {
    /// Entries of v for the measured states; the other entries are 0.
    pub(crate) v: [f64; 4],
    /// H of the last linearisation.
    pub(crate) h: Sensitivity,
    /// Measured states and the field of the last linearisation.
    pub(crate) linearised_at: ([f64; 4], FieldValue),
    pub(crate) linearisations: usize,
    /// Number of halved steps.
    pub(crate) halved: usize,
    /// Whether the last step was below the tolerance; always true for a single linearisation.
    pub(crate) converged: bool,
}

/// State x⁻ + P v, with its field and J.
#[derive(Clone, Copy)]
struct Iterate {
    v: [f64; 4],
    field: FieldValue,
    cost: f64,
}

/// Update with one measurement, restricted to the states on which it depends.
pub(crate) struct ScalarProblem {
    x: [f64; 4],
    p: [[f64; 4]; 4],
    value_nt: f64,
    variance_nt2: f64,
}

impl ScalarProblem {
    #[inline(always)]
    pub(crate) fn from_estimate(estimate: &StateEstimate, value_nt: f64, variance_nt2: f64) -> Self {
        let p = MEASURED.map(|row| MEASURED.map(|column| estimate.p[row][column]));
        Self { x: measured_states(&estimate.x), p, value_nt, variance_nt2 }
    }

    /// Problem with these measured states and the covariance of these states: latitude, longitude, height, and the part
    /// of the measurement that does not come from the field.
    pub(crate) fn new(x: [f64; 4], p: [[f64; 4]; 4], value_nt: f64, variance_nt2: f64) -> Self {
        Self { x, p, value_nt, variance_nt2 }
    }

    /// Gauss-Newton iteration from x⁻, whose field is `field`. `look_up` returns the field for an error in latitude,
    /// longitude (rad) and height (m).
    #[inline(always)]
    pub(crate) fn most_probable(
        &self,
        search: &ScalarSearch,
        field: FieldValue,
        mut look_up: impl FnMut([f64; 3]) -> Option<FieldValue>,
    ) -> Optimum {
        let mut at = Iterate { v: [0.0; 4], field, cost: self.cost(&[0.0; 4], &field) };
        let mut optimum = self.linearised(&at);
        let single = search.iterations == 1;
        while optimum.linearisations < search.iterations {
            optimum =
                Optimum { linearisations: optimum.linearisations + 1, halved: optimum.halved, ..self.linearised(&at) };
            let whole = self.gauss_newton(&at, &optimum.h);
            if single || self.moved_m(&at.v, &whole, search.m_per_rad) < search.tolerance_m {
                return Optimum { v: whole, converged: true, ..optimum };
            }
            let Some((next, halvings)) = self.descend(&at, &whole, &mut look_up) else { break };
            optimum.halved += usize::from(halvings > 0);
            optimum.v = next.v;
            at = next;
        }
        optimum
    }

    /// Iterate as an optimum, with the map linearised there and no step taken.
    #[inline(always)]
    fn linearised(&self, at: &Iterate) -> Optimum {
        Optimum {
            v: at.v,
            h: Sensitivity::from_field(&at.field),
            linearised_at: (self.state(&at.v), at.field),
            linearisations: 0,
            halved: 0,
            converged: false,
        }
    }

    /// P v.
    #[inline(always)]
    fn moved(&self, v: &[f64; 4]) -> [f64; 4] {
        self.p.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2] + row[3] * v[3])
    }

    #[inline(always)]
    fn state(&self, v: &[f64; 4]) -> [f64; 4] {
        let moved = self.moved(v);
        std::array::from_fn(|state| self.x[state] + moved[state])
    }

    /// J.
    #[inline(always)]
    fn cost(&self, v: &[f64; 4], field: &FieldValue) -> f64 {
        let moved = self.moved(v);
        let prior: f64 = v.iter().zip(moved).map(|(v, moved)| v * moved).sum();
        let residual_nt = self.value_nt - (field.value_nt + self.x[3] + moved[3]);
        0.5 * (prior + residual_nt * residual_nt / self.variance_nt2)
    }

    /// v at the minimum of J with the map linearised at an iterate.
    #[inline(always)]
    fn gauss_newton(&self, at: &Iterate, h: &Sensitivity) -> [f64; 4] {
        let moved = self.moved(&at.v);
        let linear_nt = at.field.value_nt + self.x[3] + moved[3] - h.of_measured(moved);
        let variance = h.of_measured(self.moved(&h.0)) + self.variance_nt2;
        let factor = (self.value_nt - linear_nt) / variance;
        h.0.map(|h| h * factor)
    }

    /// Distance between the positions of two v, in metres.
    #[inline(always)]
    fn moved_m(&self, from: &[f64; 4], to: &[f64; 4], (north, east): (f64, f64)) -> f64 {
        let step = self.moved(&std::array::from_fn(|state| to[state] - from[state]));
        ((north * step[0]).powi(2) + (east * step[1]).powi(2) + step[2].powi(2)).sqrt()
    }

    /// Step towards `whole`, halved until J does not rise, and the number of halvings; `None` if no step is accepted.
    #[inline(always)]
    fn descend(
        &self,
        at: &Iterate,
        whole: &[f64; 4],
        look_up: &mut impl FnMut([f64; 3]) -> Option<FieldValue>,
    ) -> Option<(Iterate, u32)> {
        let mut part = 1.0;
        for halvings in 0..=MOST_HALVINGS {
            let v = std::array::from_fn(|state| at.v[state] + part * (whole[state] - at.v[state]));
            let [lat, lon, alt, _] = self.state(&v);
            if let Some(field) = look_up([lat, lon, alt]) {
                let cost = self.cost(&v, &field);
                if cost <= at.cost {
                    return Some((Iterate { v, field, cost }, halvings));
                }
            }
            part *= 0.5;
        }
        None
    }
}

/// Number of states that the field depends on nonlinearly.
pub(crate) const NONLINEAR: usize = 3;

/// Regression of a field over the uncertainty of a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FieldRegression {
    /// Mean of the field, in nT.
    pub(crate) mean_nt: f64,
    /// Change with latitude, longitude (nT/rad) and height (nT/m).
    pub(crate) slope: [f64; NONLINEAR],
    /// Variance of the nonlinear part of the field, in nT².
    pub(crate) remainder_nt2: f64,
}

impl FieldRegression {
    /// First-order expansion of a field at a position.
    #[inline(always)]
    pub(crate) fn at(field: &FieldValue) -> Self {
        let slope = [field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, field.d_alt_nt_per_m];
        Self { mean_nt: field.value_nt, slope, remainder_nt2: 0.0 }
    }
}

/// Distance and weights of the sigma points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SigmaPoints {
    /// Distance c of the points, in standard deviations.
    pub(crate) sigmas: f64,
    /// β − α².
    pub(crate) beyond: f64,
}

/// Limit of a direction's variance given the previous directions, as a share of its variance. Below it, the direction
/// counts as exactly known, because the share is only rounding error.
const ROUNDING: f64 = 1e-13;

impl SigmaPoints {
    /// Sigma points of the scaled unscented transform.
    pub(crate) fn new(alpha: f64, beta: f64, kappa: f64) -> Self {
        Self { sigmas: alpha * (NONLINEAR as f64 + kappa).sqrt(), beyond: beta - alpha * alpha }
    }

    /// Regression of a field with the value `centre_nt` at the position, and `value_at` at an offset from it (rad, rad,
    /// m); `None` if `value_at` returns `None`. `p` is a covariance whose first states are the position.
    #[inline(always)]
    pub(crate) fn regression(
        &self,
        p: &StateMatrix,
        centre_nt: f64,
        mut value_at: impl FnMut([f64; NONLINEAR]) -> Option<f64>,
    ) -> Option<FieldRegression> {
        let root = cholesky(p);
        let (mut first, mut sum, mut squares) = ([0.0; NONLINEAR], 0.0, 0.0);
        for (direction, first) in first.iter_mut().enumerate() {
            if root[direction][direction] > 0.0 {
                let away = root.map(|row| self.sigmas * row[direction]);
                let (ahead, behind) = (value_at(away)?, value_at(away.map(|part| -part))?);
                let second = 0.5 * ((ahead - centre_nt) + (behind - centre_nt));
                *first = (ahead - behind) / (2.0 * self.sigmas);
                sum += second;
                squares += second * second;
            }
        }
        let square = self.sigmas * self.sigmas;
        let shift_nt = sum / square;
        // Non-negative, apart from rounding errors.
        let remainder_nt2 = (squares / square + self.beyond * shift_nt * shift_nt).max(0.0);
        Some(FieldRegression { mean_nt: centre_nt + shift_nt, slope: solve_transposed(&root, first), remainder_nt2 })
    }
}

/// Lower Cholesky factor of the position's covariance; the column of an exactly known direction is 0.
#[inline(always)]
pub(crate) fn cholesky(p: &StateMatrix) -> [[f64; NONLINEAR]; NONLINEAR] {
    let mut root = [[0.0; NONLINEAR]; NONLINEAR];
    for column in 0..NONLINEAR {
        let known: f64 = root[column][..column].iter().map(|entry| entry * entry).sum();
        let left = p[column][column] - known;
        if left > ROUNDING * p[column][column] {
            let pivot = left.sqrt();
            root[column][column] = pivot;
            for row in column + 1..NONLINEAR {
                let shared: f64 = (0..column).map(|before| root[row][before] * root[column][before]).sum();
                root[row][column] = (p[row][column] - shared) / pivot;
            }
        }
    }
    root
}

/// Solution a of Lᵀ a = d; 0 in the directions whose column of L is 0.
#[inline(always)]
fn solve_transposed(root: &[[f64; NONLINEAR]; NONLINEAR], d: [f64; NONLINEAR]) -> [f64; NONLINEAR] {
    let mut a = [0.0; NONLINEAR];
    for row in (0..NONLINEAR).rev() {
        if root[row][row] > 0.0 {
            let later: f64 = (row + 1..NONLINEAR).map(|column| root[column][row] * a[column]).sum();
            a[row] = (d[row] - later) / root[row][row];
        }
    }
    a
}

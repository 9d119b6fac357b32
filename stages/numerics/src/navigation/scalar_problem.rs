//! Most probable state after one scalar measurement of a nonlinear field.

use crate::earth::field_value::FieldValue;
use crate::navigation::estimate::StateEstimate;
use crate::navigation::sensitivity::{MEASURED, Sensitivity, measured_states};

/// Maximum number of halvings of a step.
const MOST_HALVINGS: u32 = 10;

/// Parameters of the search for the most probable state.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScalarSearch {
    /// Maximum number of linearisations, at least 1. With one, the full step is taken unconditionally.
    pub(crate) iterations: usize,
    /// Change of position, in m, below which the search ends.
    pub(crate) tolerance_m: f64,
    /// Metres north and east per radian.
    pub(crate) m_per_rad: (f64, f64),
}

/// Most probable state x⁻ + P v.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Optimum {
    /// v of the measured states; the others are 0.
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

    /// Problem with these measured states and their covariance: latitude, longitude, height, and the part of the
    /// measurement that does not come from the field.
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

    /// Optimum at an iterate before any step from it.
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

    /// Distance between the positions of two v, in m.
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

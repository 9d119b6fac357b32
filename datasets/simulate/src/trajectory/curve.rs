//! Smooth curves through evenly spaced nodes, with exact derivatives.

/// Number of additional nodes before the first and after the last instant at which a curve is evaluated.
pub(super) const MARGIN: usize = 2;

/// Values at the times (k - [`MARGIN`]) h, joined by polynomials of fifth degree that share value and two
/// derivatives at the nodes: twice continuously differentiable.
#[derive(Clone, Debug, Default)]
pub(super) struct QuinticSpline {
    pub(super) nodes: Vec<f64>,
}

/// First and second derivative at node k, in units of the spacing. They are the derivatives of the fourth-degree
/// polynomial through the five nodes around this node.
pub(super) fn slopes(nodes: &[f64], k: usize) -> (f64, f64) {
    let [a, b, c, d, e] =
        [k.wrapping_sub(2), k.wrapping_sub(1), k, k + 1, k + 2].map(|i| nodes.get(i).copied().unwrap_or(f64::NAN));
    ((8.0 * (d - b) - (e - a)) / 12.0, (16.0 * (b + d - 2.0 * c) - (a + e - 2.0 * c)) / 12.0)
}

impl QuinticSpline {
    /// The value and its first two derivatives at the fraction `u` (0 to 1) of the way from node `k` to the next node,
    /// for nodes `h` seconds apart.
    pub(super) fn at(&self, k: usize, u: f64, h: f64) -> [f64; 3] {
        let ((v0, a0), (v1, a1)) = (slopes(&self.nodes, k), slopes(&self.nodes, k + 1));
        let (from, to) = (self.nodes[k], self.nodes[k + 1]);
        let rise = to - from;
        let c3 = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1;
        let c4 = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1;
        let c5 = 6.0 * rise - 3.0 * (v0 + v1) - 0.5 * (a0 - a1);
        let value = from + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5))));
        let first = v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)));
        let second = a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5));
        [value, first / h, second / (h * h)]
    }
}

/// A step from 0 to 1 over 0 to 1 that is twice continuously differentiable.
pub(super) fn smooth_step(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_curves_reproduce_polynomials_and_join_smoothly() {
        let h = 0.1;
        let quartic = |t: f64| 1.0 + t * (2.0 - t * (0.5 + t * (0.25 - 0.1 * t)));
        let time = |k: usize| (k as f64 - MARGIN as f64) * h;
        let curve = QuinticSpline { nodes: (0..20).map(|k| quartic(time(k))).collect() };
        let t = time(8) + 0.37 * h;
        let [value, first, second] = curve.at(8, 0.37, h);
        // Exact for the fourth degree except for rounding, 1e-16 over h².
        assert!((value - quartic(t)).abs() < 1e-14);
        assert!((first - (2.0 - t - 0.75 * t * t + 0.4 * t.powi(3))).abs() < 1e-12);
        assert!((second - (-1.0 - 1.5 * t + 1.2 * t * t)).abs() < 1e-11);
        let rough = QuinticSpline { nodes: (0..20).map(|k| ((k * k * 7919) % 13) as f64).collect() };
        for k in 4..16 {
            let (end, start) = (rough.at(k - 1, 1.0, h), rough.at(k, 0.0, h));
            assert!(end.iter().zip(start).all(|(a, b)| (a - b).abs() < 1e-9 * (1.0 + b.abs())), "node {k}");
        }
    }
}

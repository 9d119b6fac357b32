//! Coordinate descent on covariances, with exact steps over the active terms.

use crate::regression::least_squares::{LeastSquaresError, ScaledFactor, TriangularSystem};

/// Convergence of a coordinate descent.
pub(super) struct DescentResult {
    /// The duality gap, as a fraction of ‖y‖².
    pub(super) gap: f64,
    pub(super) sweeps: usize,
}

pub(super) struct CoordinateDescent<'a> {
    prepared: &'a ScaledFactor,
    z: &'a [f64],
    /// ‖y‖², including the unexplained part.
    squares: f64,
    unexplained: f64,
    gram: Vec<f64>,
    b: Vec<f64>,
    /// Aᵀ (y − A b).
    gradient: Vec<f64>,
}

/// Number of sweeps over the active terms between two checks of the other terms and of the duality gap.
const SWEEPS_BETWEEN: usize = 3;

impl<'a> CoordinateDescent<'a> {
    pub(super) fn new(prepared: &'a ScaledFactor, target: usize) -> Result<Self, LeastSquaresError> {
        let z = prepared.along(target)?;
        Ok(Self {
            prepared,
            z,
            squares: prepared.target_squares(target)?,
            unexplained: prepared.unexplained(target),
            gram: prepared.gram(),
            b: vec![0.0; prepared.terms()],
            gradient: prepared.transposed_times(z),
        })
    }

    pub(super) fn coefficients(&self) -> &[f64] {
        &self.b
    }

    /// Minimises ‖y − A b‖²/2 + l1 ‖b‖₁ + l2 ‖b‖²/2 starting from the last solution.
    ///
    /// Sweeps activate terms; exact steps move active terms to the minimum or deactivate them.
    pub(super) fn run(&mut self, l1: f64, l2: f64, tolerance: f64, most_sweeps: usize) -> DescentResult {
        let all: Vec<usize> = (0..self.b.len()).collect();
        let mut sweeps = 0;
        let mut gap = self.gap(l1, l2);
        while gap > tolerance && sweeps < most_sweeps {
            self.sweep(&all, l1, l2);
            let active = self.active();
            for _ in 0..SWEEPS_BETWEEN {
                self.sweep(&active, l1, l2);
            }
            sweeps += 1 + SWEEPS_BETWEEN;
            gap = self.gap(l1, l2);
            if gap > tolerance {
                self.solve_active(l1, l2);
                gap = self.gap(l1, l2);
            }
        }
        DescentResult { gap, sweeps }
    }

    fn active(&self) -> Vec<usize> {
        (0..self.b.len()).filter(|&j| self.b[j] != 0.0).collect()
    }

    fn sweep(&mut self, terms: &[usize], l1: f64, l2: f64) {
        let p = self.b.len();
        for &j in terms {
            let square = self.gram[j * p + j];
            if square == 0.0 {
                continue;
            }
            let old = self.b[j];
            let pull = self.gradient[j] + square * old;
            let new = shrunk(pull, l1) / (square + l2);
            if new != old {
                self.b[j] = new;
                let step = new - old;
                let column = &self.gram[j * p..(j + 1) * p];
                self.gradient.iter_mut().zip(column).for_each(|(g, c)| *g -= step * c);
            }
        }
    }

    /// Steps to the minimum over the active terms with fixed signs. A term that would change its sign is fixed at zero,
    /// and the step continues with the others. The objective decreases with each step [Lee et al. 2007, "Efficient
    /// sparse coding algorithms", the feature-sign search].
    fn solve_active(&mut self, l1: f64, l2: f64) {
        loop {
            let active = self.active();
            let Some(aim) = self.exactly(&active, l1, l2) else { return };
            let crossing = |(&j, aim): (&usize, &f64)| {
                let b = self.b[j];
                if b * aim < 0.0 { b / (b - aim) } else { 1.0 }
            };
            let step = active.iter().zip(&aim).map(crossing).fold(1.0, f64::min);
            for (&j, aim) in active.iter().zip(&aim) {
                let b = self.b[j];
                let crosses = b * aim < 0.0 && b / (b - aim) <= step;
                self.b[j] = if crosses { 0.0 } else { b + step * (aim - b) };
            }
            if step == 1.0 {
                active.iter().zip(aim).for_each(|(&j, aim)| self.b[j] = aim);
                return;
            }
        }
    }

    /// Solves (Rᵀ R + l2 I) b = Rᵀ z − l1 sign(b) for the active terms, by a QR factorisation of [R; √l2 I].
    fn exactly(&self, terms: &[usize], l1: f64, l2: f64) -> Option<Vec<f64>> {
        let (p, active) = (self.b.len(), terms.len());
        let mut triangular = TriangularSystem::new(active);
        let mut row = vec![0.0; active + 1];
        for (r, z) in self.prepared.factor().chunks_exact(p.max(1)).zip(self.z) {
            for (value, &j) in row.iter_mut().zip(terms) {
                *value = r[j];
            }
            row[active] = *z;
            triangular.push(&row);
        }
        for k in 0..active {
            row.fill(0.0);
            row[k] = l2.sqrt();
            triangular.push(&row);
        }
        let pull: Vec<f64> = terms.iter().map(|&j| -l1.copysign(self.b[j])).collect();
        triangular.solve_with(&pull)
    }

    /// The duality gap over ‖y‖², and the gradient recomputed from the factor. [scikit-learn's `enet_gap`; Kim
    /// et al. 2007]
    fn gap(&mut self, l1: f64, l2: f64) -> f64 {
        let left = self.prepared.left_of(self.z, &self.b);
        self.gradient = self.prepared.transposed_times(&left);
        if self.squares == 0.0 {
            return 0.0;
        }
        let residual = left.iter().map(|r| r * r).sum::<f64>() + self.unexplained;
        let with_target = left.iter().zip(self.z).map(|(r, z)| r * z).sum::<f64>() + self.unexplained;
        let size: f64 = self.b.iter().map(|b| b.abs()).sum();
        let square: f64 = self.b.iter().map(|b| b * b).sum();
        let slope = self.gradient.iter().zip(&self.b).map(|(g, b)| (g - l2 * b).abs());
        let steepest = slope.fold(0.0, f64::max);
        if l1 == 0.0 {
            // Without a first-order penalty the dual is unbounded. The distance from the minimum is then bounded by
            // ‖slope‖²/(2 l2); for plain least squares, by the decrement.
            return self.smooth_gap(l2) / self.squares;
        }
        let shrink = if steepest > l1 { l1 / steepest } else { 1.0 };
        let gap = 0.5 * residual * (1.0 + shrink * shrink) + l1 * size - shrink * with_target
            + 0.5 * l2 * (1.0 + shrink * shrink) * square;
        gap.max(0.0) / self.squares
    }

    /// ‖slope‖²/2 in the metric of the inverse diagonal: an upper bound on the decrease of the objective in one sweep.
    fn smooth_gap(&self, l2: f64) -> f64 {
        let p = self.b.len();
        let gain = |j: usize| {
            let curvature = self.gram[j * p + j] + l2;
            let slope = self.gradient[j] - l2 * self.b[j];
            if self.gram[j * p + j] == 0.0 { 0.0 } else { 0.5 * slope * slope / curvature }
        };
        (0..p).map(gain).sum()
    }
}

/// Soft thresholding: reduces the magnitude of `x` by `by`, but not below zero.
fn shrunk(x: f64, by: f64) -> f64 {
    (x.abs() - by).max(0.0).copysign(x)
}

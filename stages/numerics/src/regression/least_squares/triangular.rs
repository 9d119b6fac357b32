//! Small triangular system, for models that repeatedly solve for a few terms.

use super::panel::QrTriangle;

/// Triangular factor R of [A | y], for the solution of small systems Rᵀ R x = b.
#[derive(Debug, Clone)]
pub(crate) struct TriangularSystem {
    terms: usize,
    triangle: QrTriangle,
}

impl TriangularSystem {
    pub(crate) fn new(terms: usize) -> Self {
        Self { terms, triangle: QrTriangle::new(terms, 1) }
    }

    /// Adds one row: the terms, then the target.
    pub(crate) fn push(&mut self, row: &[f64]) {
        self.triangle.push(row);
    }

    /// Solution of Rᵀ R x = Rᵀ z + `pull`; `None` if R is singular.
    pub(crate) fn solve_with(self, pull: &[f64]) -> Option<Vec<f64>> {
        let (p, width) = (self.terms, self.terms + 1);
        let r = self.triangle.upper();
        // Rᵀ w = pull, by forward substitution.
        let mut x = pull.to_vec();
        for i in 0..p {
            let known: f64 = (0..i).map(|k| r[k * width + i] * x[k]).sum();
            x[i] = divided(x[i] - known, r[i * width + i])?;
        }
        // R x = z + w, by back substitution.
        for i in (0..p).rev() {
            let known: f64 = (i + 1..p).map(|k| r[i * width + k] * x[k]).sum();
            x[i] = divided(x[i] + r[i * width + p] - known, r[i * width + i])?;
        }
        Some(x)
    }
}

fn divided(x: f64, by: f64) -> Option<f64> {
    let value = x / by;
    value.is_finite().then_some(value)
}

//! Sparse linear models by iterative hard thresholding.

use crate::rows::{RowsError, entries, finite_rows, setting};

/// The iteration ends if the relative change of the coefficients is below this value.
const TOLERANCE: f64 = 1e-10;

/// Maximum number of steps.
const STEPS: usize = 100_000;

/// Constants c and κ of the step length of Blumensath and Davies 2010: margin below the longest stable step, and factor
/// by which a step is shortened.
const MARGIN: f64 = 0.01;
const SHORTER: f64 = 2.0;

/// A linear model with few terms.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseLinearModel {
    /// One coefficient per column, in the unit of the target per unit of the column; 0 for omitted columns.
    pub coefficients: Vec<f64>,
    /// The number of steps.
    pub steps: usize,
    /// Whether the last step changed the coefficients by less than 1e-10 of their norm.
    pub converged: bool,
}

/// Fits a linear model without a constant, with at most `keep` terms and a small squared error, by normalised iterative
/// hard thresholding [Blumensath and Davies 2010, "Normalized iterative hard thresholding: guaranteed stability and
/// performance"]. Each step follows the gradient and then sets all but the `keep` largest coefficients to 0. The error
/// never increases, and the coefficients of the kept terms converge to the least-squares solution. Another set of terms
/// may have a smaller error, mainly if columns are correlated. Columns must be standardised and the target centred.
///
/// # Errors
/// Fails for values that are not finite. Also fails if `keep` is not between 1 and the number of columns.
pub fn iterative_hard_thresholding(
    x: &[f64],
    width: usize,
    y: &[f64],
    keep: usize,
) -> Result<SparseLinearModel, RowsError> {
    let rows = finite_rows("the matrix", x, width)?;
    entries("the target", y.len(), rows)?;
    finite_rows("the target", y, 1)?;
    setting("the number of terms to keep", keep as f64, "1 to the number of columns", (1..=width).contains(&keep))?;
    let problem = GramSystem::new(x, width, y);
    let mut b = vec![0.0; width];
    let mut support = largest(&problem.gradient(&b), keep);
    for step in 1..=STEPS {
        let Some((next, on)) = problem.step(&b, &support, keep) else {
            return Ok(SparseLinearModel { coefficients: b, steps: step, converged: true });
        };
        let moved = next.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let size = next.iter().fold(0.0f64, |size, b| size.max(b.abs()));
        (b, support) = (next, on);
        if moved <= TOLERANCE * size {
            return Ok(SparseLinearModel { coefficients: b, steps: step, converged: true });
        }
    }
    Ok(SparseLinearModel { coefficients: b, steps: STEPS, converged: false })
}

/// Normal equations of a least-squares problem: XᵀX and Xᵀy.
struct GramSystem {
    width: usize,
    gram: Vec<f64>,
    along: Vec<f64>,
}

impl GramSystem {
    fn new(x: &[f64], width: usize, y: &[f64]) -> Self {
        let (mut gram, mut along) = (vec![0.0; width * width], vec![0.0; width]);
        for (row, y) in x.chunks_exact(width).zip(y) {
            for ((sums, along), a) in gram.chunks_exact_mut(width).zip(&mut along).zip(row) {
                sums.iter_mut().zip(row).for_each(|(sum, b)| *sum += a * b);
                *along += a * y;
            }
        }
        Self { width, gram, along }
    }

    fn times(&self, b: &[f64]) -> Vec<f64> {
        self.gram.chunks_exact(self.width).map(|row| dot(row, b)).collect()
    }

    fn gradient(&self, b: &[f64]) -> Vec<f64> {
        self.along.iter().zip(self.times(b)).map(|(along, at)| along - at).collect()
    }

    /// ‖X d‖².
    fn square(&self, d: &[f64]) -> f64 {
        dot(d, &self.times(d))
    }

    /// The next coefficients and their support; `None` if the gradient is 0 on the support.
    fn step(&self, b: &[f64], support: &[usize], keep: usize) -> Option<(Vec<f64>, Vec<usize>)> {
        let gradient = self.gradient(b);
        let mut on = vec![0.0; self.width];
        support.iter().for_each(|&j| on[j] = gradient[j]);
        let (size, along) = (dot(&on, &on), self.square(&on));
        if !(along > 0.0 && size > 0.0) {
            return None;
        }
        let mut length = size / along;
        loop {
            let moved: Vec<f64> = b.iter().zip(&gradient).map(|(b, g)| b + length * g).collect();
            let kept = largest(&moved, keep);
            let mut next = vec![0.0; self.width];
            kept.iter().for_each(|&j| next[j] = moved[j]);
            if kept == support {
                return Some((next, kept));
            }
            let change: Vec<f64> = next.iter().zip(b).map(|(a, b)| a - b).collect();
            let (size, along) = (dot(&change, &change), self.square(&change));
            if length * along <= (1.0 - MARGIN) * size {
                return Some((next, kept));
            }
            length /= SHORTER * (1.0 - MARGIN);
        }
    }
}

/// Indices of the `keep` largest absolute values, ascending. Of several equal values, the first is kept.
fn largest(b: &[f64], keep: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..b.len()).collect();
    order.sort_by(|&i, &j| b[j].abs().total_cmp(&b[i].abs()));
    order.truncate(keep);
    order.sort_unstable();
    order
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

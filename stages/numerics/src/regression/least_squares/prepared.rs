//! A factor whose columns are centred and scaled, shared by all models.

use faer::Mat;

use super::ridge::{self, RidgePath};
use super::{LeastSquaresError, LinearFit, expect};

/// The divisor by which each column is scaled before a uniform penalty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ColumnScaling {
    /// No scaling: the columns unchanged.
    #[default]
    None,
    /// Standard deviation (divisor n − 1) of the column.
    Standardise,
    /// Largest absolute value of the column.
    MaxAbs,
    /// Largest minus smallest value of the column.
    MinMax,
}

/// The triangular factor of scaled and optionally centred columns, with the targets.
///
/// The factor is sufficient for a penalised fit: ‖y − A β‖² = ‖z − R b‖² + unexplained, with b in scaled units.
/// [`original`](Self::original) converts coefficients to the columns' own units.
#[derive(Debug, Clone)]
pub struct ScaledFactor {
    rows: usize,
    terms: usize,
    /// Factor R, row-major, `terms` by `terms`.
    r: Vec<f64>,
    /// For each target, the component along the rows of the factor.
    z: Vec<Vec<f64>>,
    unexplained: Vec<f64>,
    term_means: Vec<f64>,
    target_means: Vec<f64>,
    scales: Vec<f64>,
    intercept: bool,
}

/// The singular value decomposition of the scaled factor.
#[derive(Debug, Clone)]
pub struct ScaledFactorSvd {
    /// Singular values, largest first.
    pub values: Vec<f64>,
    /// Right singular vectors, one per value, each with one entry per term.
    pub right: Vec<Vec<f64>>,
    /// For each target, the component along each left singular vector.
    pub projections: Vec<Vec<f64>>,
}

impl ScaledFactor {
    #[expect(clippy::too_many_arguments, reason = "only one function calls it, with the parts of a factor")]
    pub(super) fn new(
        rows: usize,
        targets: usize,
        upper: Vec<f64>,
        unexplained: Vec<f64>,
        term_means: Vec<f64>,
        target_means: Vec<f64>,
        scales: Vec<f64>,
        constant: Vec<bool>,
        intercept: bool,
    ) -> Self {
        let terms = scales.len();
        let width = terms + targets;
        // After subtraction of its mean, a constant column contains only rounding errors.
        let entry = |i: usize, j: usize| {
            if constant[j] && intercept { 0.0 } else { upper[i * width + j] / scales[j] }
        };
        let r = (0..terms * terms).map(|ij| entry(ij / terms, ij % terms)).collect();
        let z = (0..targets).map(|t| (0..terms).map(|i| upper[i * width + terms + t]).collect()).collect();
        Self { rows, terms, r, z, unexplained, term_means, target_means, scales, intercept }
    }

    /// The number of rows of the factor.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The number of terms.
    pub fn terms(&self) -> usize {
        self.terms
    }

    /// The number of targets.
    pub fn targets(&self) -> usize {
        self.z.len()
    }

    /// Whether means were subtracted.
    pub fn intercept(&self) -> bool {
        self.intercept
    }

    /// The divisor of each column, in its unit.
    pub fn scales(&self) -> &[f64] {
        &self.scales
    }

    /// The factor R, row-major, upper triangular, one column per term.
    pub fn factor(&self) -> &[f64] {
        &self.r
    }

    /// The part z of a target that the terms can explain.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::NoSuch`] for an unknown target.
    pub fn along(&self, target: usize) -> Result<&[f64], LeastSquaresError> {
        let count = self.z.len();
        let z = self.z.get(target).ok_or(LeastSquaresError::NoSuch { what: "target", number: target, count })?;
        Ok(z)
    }

    /// The part of the sum of squares of a target that no coefficients explain; NaN for an unknown target.
    pub fn unexplained(&self, target: usize) -> f64 {
        self.unexplained.get(target).copied().unwrap_or(f64::NAN)
    }

    /// Sum of squares of a target (about its mean, if means were subtracted).
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::NoSuch`] for an unknown target.
    pub fn target_squares(&self, target: usize) -> Result<f64, LeastSquaresError> {
        Ok(self.along(target)?.iter().map(|z| z * z).sum::<f64>() + self.unexplained(target))
    }

    /// The covariances Rᵀ R, row-major: sums of products, not divided by the number of rows.
    pub fn gram(&self) -> Vec<f64> {
        let p = self.terms;
        let mut gram = vec![0.0; p * p];
        for row in self.r.chunks_exact(p.max(1)) {
            for (i, a) in row.iter().enumerate().filter(|(_, a)| **a != 0.0) {
                for (sum, b) in gram[i * p..(i + 1) * p].iter_mut().zip(row) {
                    *sum += a * b;
                }
            }
        }
        gram
    }

    /// Residual z − R b for coefficients in scaled units.
    pub fn left_of(&self, z: &[f64], scaled: &[f64]) -> Vec<f64> {
        let rows = self.r.chunks_exact(self.terms.max(1));
        let explained = rows.map(|row| row.iter().zip(scaled).map(|(r, b)| r * b).sum::<f64>());
        z.iter().zip(explained).map(|(z, e)| z - e).collect()
    }

    /// Rᵀ x.
    pub fn transposed_times(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.terms];
        for (row, x) in self.r.chunks_exact(self.terms.max(1)).zip(x) {
            out.iter_mut().zip(row).for_each(|(sum, r)| *sum += r * x);
        }
        out
    }

    /// The sum of squared residuals of coefficients in scaled units.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] if the numbers of coefficients and terms differ, or with
    /// [`LeastSquaresError::NoSuch`] for an unknown target.
    pub fn residual_squares(&self, target: usize, scaled: &[f64]) -> Result<f64, LeastSquaresError> {
        expect("the list of coefficients", scaled.len(), self.terms)?;
        let left = self.left_of(self.along(target)?, scaled);
        Ok(left.iter().map(|r| r * r).sum::<f64>() + self.unexplained(target))
    }

    /// Converts coefficients in scaled units to a model in the columns' own units.
    pub fn original(&self, target: usize, scaled: &[f64]) -> LinearFit {
        let coefficients: Vec<f64> = scaled.iter().zip(&self.scales).map(|(b, s)| b / s).collect();
        let mean: f64 = coefficients.iter().zip(&self.term_means).map(|(b, m)| b * m).sum();
        let intercept = if self.intercept { self.target_means.get(target).map_or(f64::NAN, |y| y - mean) } else { 0.0 };
        LinearFit { coefficients, intercept }
    }

    /// Converts coefficients from the units of the columns to scaled units.
    pub fn scaled(&self, coefficients: &[f64]) -> Vec<f64> {
        coefficients.iter().zip(&self.scales).map(|(b, s)| b * s).collect()
    }

    /// Singular value decomposition, shared by all targets.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::NoConvergence`] if the decomposition does not converge.
    pub fn singular(&self) -> Result<ScaledFactorSvd, LeastSquaresError> {
        let p = self.terms;
        let svd = Mat::from_fn(p, p, |i, j| self.r[i * p + j]).svd().map_err(|_| LeastSquaresError::NoConvergence)?;
        let (u, v) = (svd.U(), svd.V());
        let project = |z: &Vec<f64>| (0..p).map(|k| (0..p).map(|i| u[(i, k)] * z[i]).sum()).collect();
        Ok(ScaledFactorSvd {
            values: svd.S().column_vector().iter().copied().collect(),
            right: (0..p).map(|k| (0..p).map(|j| v[(j, k)]).collect()).collect(),
            projections: self.z.iter().map(project).collect(),
        })
    }

    /// Ridge fits of all targets for all lambdas: min ‖y − A β‖² + λ ‖b‖², where b are the coefficients of the scaled
    /// columns. See van der Meer 2025, (2.31)-(2.32), also for the column scaling β = b / s.
    ///
    /// Coefficients, intercepts and covariances are in the units of the columns; singular values and condition number
    /// refer to the scaled matrix.
    ///
    /// # Errors
    ///
    /// Returns the errors of [`super::QrAccumulator::solve`].
    pub fn ridge<S: AsRef<str>>(&self, lambdas: &[f64], names: &[S]) -> Result<RidgePath, LeastSquaresError> {
        expect("the list of term names", names.len(), self.terms)?;
        super::check_lambdas(lambdas)?;
        let (p, targets) = (self.terms, self.targets());
        let row = |i: usize| {
            let own = self.r[i * p..(i + 1) * p].iter().copied();
            own.chain(self.z.iter().map(move |z| z[i])).collect::<Vec<f64>>()
        };
        let scaled_means = self.term_means.iter().zip(&self.scales).map(|(m, s)| m / s);
        let factor = ridge::RidgeFactor {
            rows: self.rows,
            terms: p,
            targets,
            upper: (0..p).flat_map(row).collect(),
            unexplained: self.unexplained.clone(),
            means: scaled_means.chain(self.target_means.iter().copied()).collect(),
            centred: self.intercept,
        };
        let names = names.iter().map(|name| name.as_ref().to_owned()).collect();
        let mut path = ridge::solve(factor, lambdas, names)?;
        path.unscale(&self.scales);
        path.term_means.clone_from(&self.term_means);
        Ok(path)
    }
}

//! The elastic net: least squares with a penalty on the magnitude and on the number of coefficients.
//!
//! The objective ‖y − A b‖²/(2n) + α ρ ‖b‖₁ + α (1 − ρ) ‖b‖²/2 of the coefficients b of the scaled columns is
//! minimised, as in scikit-learn and glmnet. Gnadt 2022 (3.31)-(3.32) writes the objective with λ₁ = 2 n α ρ and λ₂ = n
//! α (1 − ρ). The problem is solved by cyclic coordinate descent on the covariances [Friedman, Hastie & Tibshirani
//! 2010, "Regularization paths for generalized linear models via coordinate descent", J. Stat. Softw. 33(1)]. The path
//! begins at the α for which all coefficients are zero and descends; each α starts from the previous solution. Rows are
//! never read: all computations use the triangular factor. The factor also gives the exact solution for the active
//! terms, so that ill-conditioned terms do not slow the descent. The descent ends when the duality gap, which bounds
//! the distance from the minimum, is small.

mod descent;

use rayon::prelude::*;

use crate::regression::least_squares::{
    ColumnScaling, LeastSquaresError, LineScoreMeasure, LineScores, LinearFit, RegressionMoments, ScaledFactor,
    leave_line_out, setting,
};
use descent::CoordinateDescent;

/// Settings of an elastic-net path.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticNetOptions {
    /// ρ, the fraction of the penalty that is ‖b‖₁: 0 ridge, 1 lasso. MagNav.jl uses 0.99.
    pub l1_ratio: f64,
    /// Divisor of the columns before the penalty.
    pub scaling: ColumnScaling,
    /// Whether means are subtracted, for an intercept without a penalty.
    pub intercept: bool,
    /// The solution for an α is accepted if its duality gap, as a fraction of ‖y‖², is at most this value.
    pub tolerance: f64,
    /// The maximum number of sweeps over the terms for one α.
    pub sweeps: usize,
}

impl Default for ElasticNetOptions {
    /// ρ = 0.99 with standardised columns and an intercept, as in Gnadt 2022; a gap of 1e-10.
    fn default() -> Self {
        Self { l1_ratio: 0.99, scaling: ColumnScaling::Standardise, intercept: true, tolerance: 1e-10, sweeps: 100_000 }
    }
}

/// An elastic-net fit for one α.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticNetFit {
    /// The strength of the penalty, in the target's unit squared over the unit of b.
    pub alpha: f64,
    /// The model in the units of the columns.
    pub fit: LinearFit,
    /// Indices of the terms with nonzero coefficients, ascending.
    pub active: Vec<usize>,
    /// The sum of squared residuals.
    pub residual_squares: f64,
    /// Upper bound on n times (objective minus its minimum), as a fraction of ‖y‖².
    pub gap: f64,
    /// The number of sweeps.
    pub sweeps: usize,
}

/// An elastic-net path and its leave-one-line-out scores.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticNetPath {
    /// The fits to all lines.
    pub path: Vec<ElasticNetFit>,
    /// The scores, one candidate per α.
    pub scores: LineScores,
}

impl ElasticNetPath {
    /// The fit with the smallest mean score.
    pub fn best(&self) -> Option<&ElasticNetFit> {
        self.path.get(self.scores.best)
    }

    /// Fit with the largest α whose mean score is within one standard error of the smallest.
    pub fn within_one_error(&self) -> Option<&ElasticNetFit> {
        self.path.get(self.scores.within_one_error)
    }
}

impl ElasticNetOptions {
    fn check(&self) -> Result<(), LeastSquaresError> {
        setting("the l1 ratio of an elastic net", self.l1_ratio, "from 0 to 1", (0.0..=1.0).contains(&self.l1_ratio))?;
        let positive = self.tolerance > 0.0 && self.tolerance.is_finite();
        setting("the tolerance of an elastic net", self.tolerance, "above 0", positive)
    }

    /// `count` values of α, evenly spaced in their logarithm. They descend from the smallest α for which all
    /// coefficients are zero, max|Aᵀ y|/(n ρ), to `least` times that value.
    ///
    /// # Errors
    /// Fails for a setting out of its valid range, an l1 ratio of 0, or a `least` that is not between 0 and 1. Also
    /// fails for an unknown target, or if there are no rows.
    pub fn alphas(
        &self,
        moments: &RegressionMoments,
        target: usize,
        count: usize,
        least: f64,
    ) -> Result<Vec<f64>, LeastSquaresError> {
        self.check()?;
        setting("the l1 ratio", self.l1_ratio, "above 0 to derive the path of alpha", self.l1_ratio > 0.0)?;
        setting(
            "the smallest alpha as a fraction of the largest",
            least,
            "between 0 and 1, exclusive",
            least > 0.0 && least < 1.0,
        )?;
        let prepared = moments.prepare(self.scaling, self.intercept)?;
        let products = prepared.transposed_times(prepared.along(target)?);
        let largest = products.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        let largest = largest / prepared.rows() as f64 / self.l1_ratio;
        let last = count.saturating_sub(1).max(1) as f64;
        Ok((0..count).map(|k| largest * least.powf(k as f64 / last)).collect())
    }

    /// Fits for all `alphas`, in the given order; descending order is fastest.
    ///
    /// # Errors
    ///
    /// Fails for a setting out of its valid range or an unknown target, or if there are no rows. Also fails if the
    /// maximum number of sweeps is reached.
    pub fn path(
        &self,
        moments: &RegressionMoments,
        target: usize,
        alphas: &[f64],
    ) -> Result<Vec<ElasticNetFit>, LeastSquaresError> {
        self.check()?;
        if let Some(&alpha) = alphas.iter().find(|a| !(**a >= 0.0 && a.is_finite())) {
            return Err(LeastSquaresError::Setting {
                what: "alpha",
                wanted: "a finite number of at least 0",
                given: alpha,
            });
        }
        self.path_of(&moments.prepare(self.scaling, self.intercept)?, target, alphas)
    }

    /// Paths of several targets in parallel (rayon), one target per task.
    ///
    /// # Errors
    /// Returns the errors of [`Self::path`] for any target.
    pub fn paths(
        &self,
        moments: &RegressionMoments,
        alphas: &[Vec<f64>],
    ) -> Result<Vec<Vec<ElasticNetFit>>, LeastSquaresError> {
        alphas.par_iter().enumerate().map(|(target, alphas)| self.path(moments, target, alphas)).collect()
    }

    fn path_of(
        &self,
        prepared: &ScaledFactor,
        target: usize,
        alphas: &[f64],
    ) -> Result<Vec<ElasticNetFit>, LeastSquaresError> {
        let rows = prepared.rows() as f64;
        let mut descent = CoordinateDescent::new(prepared, target)?;
        let mut path = Vec::with_capacity(alphas.len());
        for &alpha in alphas {
            let (l1, l2) = (rows * alpha * self.l1_ratio, rows * alpha * (1.0 - self.l1_ratio));
            let end = descent.run(l1, l2, self.tolerance, self.sweeps);
            if end.gap.is_nan() || end.gap > self.tolerance {
                return Err(LeastSquaresError::Sweeps { alpha, sweeps: end.sweeps, gap: end.gap });
            }
            let b = descent.coefficients();
            path.push(ElasticNetFit {
                alpha,
                fit: prepared.original(target, b),
                active: (0..b.len()).filter(|&j| b[j] != 0.0).collect(),
                residual_squares: prepared.residual_squares(target, b)?,
                gap: end.gap,
                sweeps: end.sweeps,
            });
        }
        Ok(path)
    }

    /// Path over all lines, and the score of each α at each line when that line is omitted. If `alphas` descend, the
    /// choice within one standard error is the simplest model.
    ///
    /// # Errors
    /// Returns the errors of [`Self::path`] and [`leave_line_out`].
    pub fn choose(
        &self,
        lines: &[RegressionMoments],
        target: usize,
        alphas: &[f64],
        score: LineScoreMeasure,
    ) -> Result<ElasticNetPath, LeastSquaresError> {
        let fits =
            |others: &RegressionMoments| Ok(self.path(others, target, alphas)?.into_iter().map(|f| f.fit).collect());
        let scores = leave_line_out(lines, target, score, fits)?;
        Ok(ElasticNetPath { path: self.path(&RegressionMoments::merged(lines)?, target, alphas)?, scores })
    }
}

#[cfg(test)]
mod tests;

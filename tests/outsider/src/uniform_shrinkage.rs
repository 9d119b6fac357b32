//! Example of a custom model: least squares with all coefficients multiplied by the same factor.

use schemas::{Fault, Rule};
use stages::fit::{FitModel, FitProblem, FitSettings, LinearFitResult, ScaledFactor, model, ridge};

model! {
    /// Least squares whose coefficients are all multiplied by `shrinkage`.
    ///
    /// Source: van Houwelingen & le Cessie 1990, "Predictive value of statistical models", uniform shrinkage.
    UniformShrinkage = "uniform_shrinkage", version 1, scaling None, intercept false, made of Moments, choose [Given],
    takes [], example "shrinkage = 0.9";
    /// Factor of the coefficients.
    shrinkage: f64, unit "1", default 1.0, rule Rule::Between(0.0, 1.0);
}

impl FitModel for UniformShrinkage {
    fn fit(
        &self,
        problem: &FitProblem,
        settings: &FitSettings,
        prepared: &ScaledFactor,
    ) -> Result<LinearFitResult, Fault> {
        let mut answer = ridge(problem, settings, prepared, 0.0)?;
        answer.fit.coefficients.iter_mut().for_each(|coefficient| *coefficient *= self.shrinkage);
        answer.std.iter_mut().for_each(|std| *std *= self.shrinkage);
        Ok(answer)
    }
}

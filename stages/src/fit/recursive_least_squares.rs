//! Least squares row by row in time.

use numerics::regression::{
    least_squares::{ColumnScaling, LinearFit, ScaledFactor},
    recursive_least_squares,
};
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, LinearFitResult, model},
    problem::FitProblem,
    settings::FitSettings,
};
use crate::columns::data;

model! {
    /// Recursive least squares with exponential `forgetting` of older rows. The recursion starts from zero coefficients
    /// with the ridge parameter `lambda`. Columns are divided by their standard deviations.
    ///
    /// Forgotten information is replaced by a ridge penalty centred on the present coefficients. If the flight does not
    /// excite a direction for a long time, the coefficients therefore keep their values in this direction. The textbook
    /// recursion, in contrast, also forgets the initial ridge penalty. With `forgetting = 1.0`, both recursions give
    /// the ridge solution.
    ///
    /// Source: Haykin 2002, "Adaptive Filter Theory", chapter 9.
    RecursiveLeastSquares = "recursive_least_squares", version 1, scaling Standardise, intercept false, made of Rows,
    choose [Given], takes [], example "forgetting = 1.0";
    /// Ridge parameter of the initial coefficients.
    lambda: f64, unit "", default 0.025, rule Rule::NotNegative;
    /// Forgetting factor: weight of a row relative to the next row. With 1 nothing is forgotten.
    forgetting: f64, unit "1", default 1.0, rule Rule::Between(0.9, 1.0);
}

impl FitModel for RecursiveLeastSquares {
    fn fit(&self, problem: &FitProblem, settings: &FitSettings, _: &ScaledFactor) -> Result<LinearFitResult, Fault> {
        let p = problem.terms.len();
        let mut filter = recursive_least_squares::RecursiveLeastSquares::new(
            &vec![0.0; p],
            &self.sigma(problem, settings),
            self.forgetting,
            true,
        )
        .map_err(data)?;
        for (a, y) in problem.rows() {
            for (row, y) in a.chunks_exact(p.max(1)).zip(y) {
                filter.update(row, *y).map_err(data)?;
            }
        }
        let fit = LinearFit { coefficients: filter.coefficients(), intercept: 0.0 };
        let squares = problem.merged.residuals(0, &fit).map_err(data)?.squares;
        Ok(LinearFitResult::without_errors(fit, (squares / problem.free(p, settings)).sqrt(), self.lambda))
    }

    fn faults(&self, settings: &FitSettings) -> Vec<Fault> {
        let constant = "`recursive_least_squares` has no intercept; add `bias` to `terms` of `a_matrix`";
        let penalty = "`recursive_least_squares` requires an initial ridge penalty; set `lambda` above 0";
        let mut faults = vec![];
        faults.extend(settings.intercept.then(|| Fault::new(constant).of_param("intercept")));
        faults.extend((self.lambda == 0.0).then(|| Fault::new(penalty).of_param("lambda")));
        faults
    }

    fn lambda(&self) -> Option<f64> {
        Some(self.lambda)
    }
}

impl RecursiveLeastSquares {
    /// Prior standard deviation of each coefficient. For a ridge of scaled columns it is inversely proportional to the
    /// column's standard deviation.
    fn sigma(&self, problem: &FitProblem, settings: &FitSettings) -> Vec<f64> {
        let scaled = |d: f64| if settings.scaling == ColumnScaling::None || d == 0.0 { 1.0 } else { d };
        problem.merged.term_deviations().iter().map(|d| 1.0 / (self.lambda.sqrt() * scaled(*d))).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{COEFFICIENTS, fitted_to, number, plain, word};

    #[test]
    fn law_the_truth_is_recovered_with_and_without_forgetting() {
        for forgetting in [1.0, 0.99] {
            let keys = [number("lambda", 1e-6), number("forgetting", forgetting), word("scaling", "none")];
            let found = fitted_to(&plain(0.0), "recursive_least_squares", &keys).value;
            assert!(found.iter().zip(COEFFICIENTS).all(|(a, b)| (a - b).abs() < 1e-4 * b.abs()), "{found:?}");
        }
    }
}

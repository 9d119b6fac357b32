//! Partial least squares.

use numerics::regression::{
    least_squares::{LineScoreMeasure, ScaledFactor},
    pls,
};
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, LinearFitResult, model},
    problem::{FitProblem, lines_needed},
    settings::FitSettings,
};
use crate::columns::data;

model! {
    /// Partial least squares: ordinary least squares on components, the linear combinations of the centred features
    /// that have the largest covariance with the target. With `with_targets`, all targets have the same components.
    ///
    /// Source: Wold, Sjöström and Eriksson 2001; Gnadt 2022, (3.19) to (3.43).
    PartialLeastSquares = "pls", version 2, scaling Standardise, intercept true, made of Moments,
    choose [Given, LeaveOneLineOut, LeaveOneFlightOut], takes [one_standard_error, whiten], example "components = 6";
    /// Number of components. If `choose` selects the number, this is the maximum. If the number of components equals
    /// the number of terms, the result is ordinary least squares, and a warning is reported.
    components: usize, unit "", default 18usize, rule Rule::Between(1.0, 10000.0);
    /// Further target columns that are fitted with the same components as `target`. The table holds only the
    /// coefficients of `target`.
    with_targets: Vec<String>, unit "nT", default Vec::<String>::new();
}

impl FitModel for PartialLeastSquares {
    fn fit(&self, problem: &FitProblem, settings: &FitSettings, _: &ScaledFactor) -> Result<LinearFitResult, Fault> {
        let targets: Vec<usize> = (0..problem.merged.targets()).collect();
        let most = self.components.min(problem.terms.len());
        let count = if settings.choose.leaves_out() {
            let groups = problem.groups(settings)?;
            let scores =
                pls::choose_components(&groups, &targets, 0, most, settings.scaling, LineScoreMeasure::Variance);
            1 + settings.pick(&scores.map_err(lines_needed)?)
        } else {
            most
        };
        let mut path = pls::fit(&problem.merged, &targets, count, settings.scaling).map_err(data)?;
        let squares = path.residual_squares.pop().and_then(|s| s.first().copied()).unwrap_or(f64::NAN);
        let used = path.fits.len();
        let fit = path.fits.pop().and_then(|f| f.into_iter().next());
        let fit = fit.ok_or_else(|| Fault::data("the target has no covariance with any feature"))?;
        Ok(LinearFitResult::without_errors(fit, (squares / problem.free(used, settings)).sqrt(), used as f64))
    }

    fn faults(&self, settings: &FitSettings) -> Vec<Fault> {
        let centred = "partial least squares always subtracts means; remove `intercept = false`";
        (!settings.intercept).then(|| Fault::new(centred).of_param("intercept")).into_iter().collect()
    }

    fn with_targets(&self) -> &[String] {
        &self.with_targets
    }

    fn remark(&self, answer: &LinearFitResult, terms: usize) -> Option<String> {
        let all = answer.chosen >= terms as f64;
        let what = "terms give ordinary least squares; reduce `components`";
        all.then(|| format!("{} components for {terms} {what}", answer.chosen))
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{COEFFICIENTS, INTERCEPT_NT, fitted, whole};

    #[test]
    fn law_with_all_components_the_truth_is_recovered() {
        let found = fitted("pls", &[whole("components", 3)]);
        let truth = COEFFICIENTS.into_iter().chain([INTERCEPT_NT]);
        assert!(found.value.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-8 * b.abs()), "{:?}", found.value);
        assert_eq!(found.chosen, 3.0);
        assert!(found.warning.contains("3 components for 3 terms give ordinary least squares"), "{}", found.warning);
        assert_eq!(fitted("pls", &[whole("components", 2)]).warning, "");
    }

    #[test]
    fn law_more_components_reduce_the_residual() {
        let one = fitted("pls", &[whole("components", 1)]);
        let fewer = fitted("pls", &[whole("components", 2)]);
        assert!(one.residual_std > fewer.residual_std && fewer.residual_std > 0.0);
    }
}

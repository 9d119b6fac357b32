//! Least squares on the first principal components.

use numerics::regression::{
    least_squares::{LineScoreMeasure, ScaledFactor},
    truncated_svd,
};
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, LinearFitResult, model},
    problem::{FitProblem, lines_needed},
    settings::FitSettings,
};
use crate::columns::data;

model! {
    /// Least squares on the first `components` principal components of standardised columns. The directions that the
    /// flight excites least are omitted.
    ///
    /// Source: Hansen 1987, "The truncated SVD as a method for regularization".
    TruncatedSvd = "truncated_svd", version 1, scaling Standardise, intercept true, made of Moments,
    choose [Given, LeaveOneLineOut, LeaveOneFlightOut], takes [one_standard_error, whiten], example "components = 6";
    /// Number of components. If `choose` selects the number, this is the maximum.
    components: usize, unit "", default 18usize, rule Rule::Between(1.0, 10000.0);
}

impl FitModel for TruncatedSvd {
    fn fit(
        &self,
        problem: &FitProblem,
        settings: &FitSettings,
        prepared: &ScaledFactor,
    ) -> Result<LinearFitResult, Fault> {
        let most = self.components.min(problem.terms.len());
        let count = if settings.choose.leaves_out() { chosen(problem, settings, most)? } else { most };
        let fits = truncated_svd::path(prepared, 0).map_err(data)?;
        let fit = fits.into_iter().take(count).next_back().ok_or_else(|| Fault::data("all features are constant"))?;
        let free = problem.free(fit.components, settings);
        Ok(LinearFitResult::without_errors(fit.fit, (fit.residual_squares / free).sqrt(), fit.components as f64))
    }
}

/// Number of components with the smallest cross-validation error.
fn chosen(problem: &FitProblem, settings: &FitSettings, most: usize) -> Result<usize, Fault> {
    let (scaling, intercept) = (settings.scaling, settings.intercept);
    let groups = problem.groups(settings)?;
    let scores = truncated_svd::choose_components(&groups, 0, most, scaling, intercept, LineScoreMeasure::Variance);
    Ok(1 + settings.pick(&scores.map_err(lines_needed)?))
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{COEFFICIENTS, INTERCEPT_NT, fitted, whole};

    #[test]
    fn law_with_all_components_the_truth_is_recovered() {
        let found = fitted("truncated_svd", &[whole("components", 3)]);
        let truth = COEFFICIENTS.into_iter().chain([INTERCEPT_NT]);
        assert!(found.value.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-9 * b.abs()), "{:?}", found.value);
    }

    #[test]
    fn unit_more_components_than_features_use_all_components() {
        let [all, more] = [3, 50].map(|n| fitted("truncated_svd", &[whole("components", n)]));
        assert_eq!((all.value, more.chosen), (more.value, 3.0));
    }
}

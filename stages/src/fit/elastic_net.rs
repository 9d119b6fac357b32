//! The elastic net.

use numerics::regression::{
    elastic_net::{self, ElasticNetFit},
    least_squares::{LineScoreMeasure, ScaledFactor},
};
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, LinearFitResult, model},
    problem::{FitProblem, lines_needed},
    ridge::RidgePenalty,
    settings::FitSettings,
};
use crate::columns::data;

/// Number of values on the path of the elastic net, and the ratio of its smallest to its largest value.
const PATH: (usize, f64) = (100, 1e-4);

model! {
    /// Minimises \|y - A b\|^2 / 2n + `lambda` (r \|b\|_1 + (1 - r) \|b\|^2 / 2) with standardised columns, where r is
    /// `l1_ratio`. A coefficient that reduces the error by less than its penalty is exactly 0.
    ///
    /// Source: Zou and Hastie 2005; Gnadt 2022, (3.19) to (3.43).
    ElasticNet = "elastic_net", version 1, scaling Standardise, intercept true, made of Moments,
    choose [Given, LeaveOneLineOut, LeaveOneFlightOut], takes [one_standard_error, whiten],
    groups [penalty: RidgePenalty], example "lambda = 0.025";
    /// Fraction of the penalty that applies to the absolute values of the coefficients.
    l1_ratio: f64, unit "1", default 0.99, rule Rule::Between(0.0, 1.0);
}

impl FitModel for ElasticNet {
    fn fit(&self, problem: &FitProblem, settings: &FitSettings, _: &ScaledFactor) -> Result<LinearFitResult, Fault> {
        let net = elastic_net::ElasticNetOptions {
            l1_ratio: self.l1_ratio,
            scaling: settings.scaling,
            intercept: settings.intercept,
            ..elastic_net::ElasticNetOptions::default()
        };
        let found = if settings.choose.leaves_out() {
            self.chosen(&net, problem, settings)?
        } else {
            net.path(&problem.merged, 0, &[self.penalty.lambda]).map_err(data)?.pop()
        };
        let found = found.ok_or_else(|| Fault::bug("the result of a fit is missing"))?;
        let free = problem.free(found.active.len(), settings);
        Ok(LinearFitResult::without_errors(found.fit, (found.residual_squares / free).sqrt(), found.alpha))
    }

    fn faults(&self, _: &FitSettings) -> Vec<Fault> {
        self.penalty.faults()
    }

    fn lambda(&self) -> Option<f64> {
        Some(self.penalty.lambda)
    }
}

impl ElasticNet {
    fn chosen(
        &self,
        net: &elastic_net::ElasticNetOptions,
        problem: &FitProblem,
        settings: &FitSettings,
    ) -> Result<Option<ElasticNetFit>, Fault> {
        let falling = match &self.penalty.lambdas {
            Some(given) => {
                let mut falling = given.clone();
                falling.sort_by(|a, b| b.total_cmp(a));
                falling
            }
            None => net.alphas(&problem.merged, 0, PATH.0, PATH.1).map_err(data)?,
        };
        let choice =
            net.choose(&problem.groups(settings)?, 0, &falling, LineScoreMeasure::Variance).map_err(lines_needed)?;
        let at = settings.pick(&choice.scores);
        Ok(choice.path.into_iter().nth(at))
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{COEFFICIENTS, fitted, number};

    #[test]
    fn law_a_small_penalty_recovers_the_truth_and_a_large_one_gives_zero() {
        let found = fitted("elastic_net", &[number("lambda", 1e-9)]).value;
        // The solver stops at a given duality gap of the objective, so the coefficients have half as many accurate
        // digits as the objective.
        assert!(found.iter().zip(COEFFICIENTS).all(|(a, b)| (a - b).abs() < 1e-4 * b.abs()), "{found:?}");
        assert_eq!(fitted("elastic_net", &[number("lambda", 1e9), number("l1_ratio", 1.0)]).value[..3], [0.0; 3]);
    }

    #[test]
    fn law_without_the_l1_penalty_it_is_a_ridge() {
        let net = fitted("elastic_net", &[number("lambda", 0.01), number("l1_ratio", 0.0)]);
        let ridge = fitted("ridge", &[number("lambda", 0.01 * net.rows)]).value;
        assert!(net.value.iter().zip(&ridge).all(|(a, b)| (a - b).abs() < 1e-4 * b.abs()), "{:?} {ridge:?}", net.value);
    }
}

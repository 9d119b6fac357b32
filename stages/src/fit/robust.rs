//! Regression that is insensitive to spikes.

use numerics::regression::{
    least_squares::{ColumnScaling, ScaledFactor},
    robust::{self, LineRows},
};
use schemas::{Fault, Rule, choice};

use super::{
    model::{FitModel, LinearFitResult, model},
    problem::FitProblem,
    settings::FitSettings,
};
use crate::columns::data;

choice! {
    /// Loss function of a residual.
    pub enum FitLossFunction {
        /// Huber loss: quadratic up to the threshold, linear beyond it.
        Huber = "huber",
        /// Negative log-likelihood of Student's t distribution.
        StudentT = "student_t",
    }
}

choice! {
    /// Estimator of the scale of the residuals.
    pub enum FitScaleMethod {
        /// Median absolute deviation.
        Mad = "mad",
        /// Estimated together with the coefficients.
        Joint = "joint",
    }
}

model! {
    /// Minimises a loss that grows more slowly than the square of the residual, so that spikes have little influence.
    /// Columns are not scaled. `threshold` is a parameter of the loss `huber`, and `degrees_of_freedom` of `student_t`.
    ///
    /// Source: Huber 1981, "Robust Statistics"; Lange, Little and Taylor 1989.
    Robust = "robust", version 1, scaling None, intercept true, made of Rows, choose [Given], takes [],
    example "loss = \"huber\"";
    /// Ridge parameter.
    lambda: f64, unit "", default 0.025, rule Rule::NotNegative;
    /// Loss function of a residual.
    loss: FitLossFunction, unit "", default FitLossFunction::Huber;
    /// Estimator of the scale of the residuals: their median absolute deviation (`mad`), or an estimate together with
    /// the coefficients (`joint`).
    scale: FitScaleMethod, unit "", default FitScaleMethod::Mad;
    /// Residual at which Huber's loss changes from quadratic to linear, in units of the scale.
    threshold: f64, unit "1", default 1.345, rule Rule::Positive;
    /// Degrees of freedom of Student's t.
    degrees_of_freedom: f64, unit "1", default 4.0, rule Rule::Positive;
}

impl FitModel for Robust {
    fn fit(&self, problem: &FitProblem, settings: &FitSettings, _: &ScaledFactor) -> Result<LinearFitResult, Fault> {
        let rows = problem.rows();
        let rows: Vec<LineRows> = rows.iter().map(|(a, y)| LineRows { a, y }).collect();
        let found = self.numeric(settings).fit(&rows, &problem.terms).map_err(data)?;
        if !found.converged {
            let what = format!("the robust fit did not converge within {} passes over the rows", found.passes);
            return Err(Fault::data(what).help("set `lambda` above 0, or remove features"));
        }
        Ok(LinearFitResult::without_errors(found.fit, found.scale, self.lambda))
    }

    fn faults(&self, settings: &FitSettings) -> Vec<Fault> {
        let unscaled = "`robust` does not scale columns; set `scaling = \"none\"`";
        let wrong = settings.scaling != ColumnScaling::None;
        wrong.then(|| Fault::new(unscaled).of_param("scaling")).into_iter().collect()
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let of = [("threshold", FitLossFunction::Huber), ("degrees_of_freedom", FitLossFunction::StudentT)];
        let (_, loss) = of.into_iter().find(|(k, loss)| *k == key && *loss != self.loss)?;
        let help = format!("remove the key; the loss is `{}`", self.loss.word());
        Some(Fault::new(format!("`{key}` belongs to the loss `{}`", loss.word())).help(help))
    }

    fn lambda(&self) -> Option<f64> {
        Some(self.lambda)
    }
}

impl Robust {
    fn numeric(&self, settings: &FitSettings) -> robust::RobustOptions {
        let loss = match self.loss {
            FitLossFunction::Huber => robust::ResidualLoss::Huber { threshold: self.threshold },
            FitLossFunction::StudentT => robust::ResidualLoss::StudentT { degrees: self.degrees_of_freedom },
        };
        let scale = match self.scale {
            FitScaleMethod::Mad => robust::ResidualScaleEstimator::Mad,
            FitScaleMethod::Joint => robust::ResidualScaleEstimator::Joint,
        };
        robust::RobustOptions {
            loss,
            scale,
            lambda: self.lambda,
            intercept: settings.intercept,
            ..robust::RobustOptions::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{COEFFICIENTS, INTERCEPT_NT, fitted, fitted_to, number, spiked, word};

    #[test]
    fn unit_spikes_affect_it_less_than_least_squares() {
        let truth = || COEFFICIENTS.into_iter().chain([INTERCEPT_NT]);
        let off = |found: &[f64]| found.iter().zip(truth()).map(|(a, b)| ((a - b) / b).abs()).fold(0.0, f64::max);
        let squares = fitted_to(&spiked(), "ridge", &[number("lambda", 0.0)]).value;
        for loss in ["huber", "student_t"] {
            let found = fitted_to(&spiked(), "robust", &[number("lambda", 0.0), word("loss", loss)]).value;
            assert!(off(&found) < 0.02 * off(&squares), "{loss}: {found:?} {squares:?}");
        }
    }

    #[test]
    fn law_without_spikes_a_wide_threshold_is_least_squares() {
        let wide = [number("lambda", 0.0), number("threshold", 1e6), word("scale", "joint")];
        let [one, other] = [fitted("robust", &wide), fitted("ridge", &[number("lambda", 0.0)])];
        assert!(one.value.iter().zip(&other.value).all(|(a, b)| (a - b).abs() < 1e-6 * b.abs()), "{:?}", one.value);
    }
}

//! The ridge model, and the code that it shares with the Tolles-Lawson models.

use std::sync::Arc;

use numerics::regression::{
    choose_lambda::{self, LambdaPoint, by_generalised_cross_validation, by_l_curve, by_lines, curve},
    least_squares::{LineScoreMeasure, LinearFit, RidgePath, ScaledFactor},
};
use schemas::{Fault, Rule, params};

use super::{
    model::{FitModel, LinearFitResult, model},
    problem::{FitProblem, lines_needed},
    settings::{FitSettings, ModelSelection},
};
use crate::columns::data;

/// Number of values on the default grid of ridge parameters, and the ratio of the smallest to the largest value. The
/// largest value equals the largest squared singular value.
const GRID: (usize, f64) = (81, 1e-12);

model! {
    /// Minimises \|y - A b\|^2 + `lambda` \|b\|^2 with standardised columns, where y is the target, A the matrix of the
    /// features and b the coefficients.
    Ridge = "ridge", version 1, scaling Standardise, intercept true, made of Moments,
    choose [Given, Gcv, LCurve, LeaveOneLineOut, LeaveOneFlightOut], takes [one_standard_error, whiten],
    groups [penalty: RidgePenalty], example "lambda = 0.025";
}

impl RidgeModel for Ridge {
    fn penalty(&self) -> &RidgePenalty {
        &self.penalty
    }
}

params! {
    /// Penalty on the squared norm of the coefficients.
    pub struct RidgePenalty;
    /// Ridge parameter.
    lambda: f64, unit "", default 0.025, rule Rule::NotNegative;
    /// Values of `lambda` to choose from.
    lambdas: Option<Vec<f64>>, unit "", absent "a grid computed from the features";
}

/// A ridge model under another name and with other columns.
pub trait RidgeModel: Send + Sync {
    /// Penalty of the model.
    fn penalty(&self) -> &RidgePenalty;
}

impl<M: RidgeModel> FitModel for M {
    fn fit(
        &self,
        problem: &FitProblem,
        settings: &FitSettings,
        prepared: &ScaledFactor,
    ) -> Result<LinearFitResult, Fault> {
        let lambda = self.penalty().found(problem, settings, prepared)?;
        ridge(problem, settings, prepared, lambda)
    }

    fn faults(&self, _: &FitSettings) -> Vec<Fault> {
        self.penalty().faults()
    }

    fn lambda(&self) -> Option<f64> {
        Some(self.penalty().lambda)
    }

    fn is_ridge(&self) -> bool {
        true
    }
}

/// Ridge with the parameter `lambda`. `prepared` holds the columns of `problem` with the scaling of `settings`.
///
/// # Errors
/// Fails if the columns do not determine the solution.
pub fn ridge(
    problem: &FitProblem,
    settings: &FitSettings,
    prepared: &ScaledFactor,
    lambda: f64,
) -> Result<LinearFitResult, Fault> {
    let found = |path: &RidgePath| path.solutions.iter().position(|s| s.lambda.to_bits() == lambda.to_bits());
    let (path, at) = match problem.path(settings).and_then(|path| found(path).map(|at| (path.clone(), at))) {
        Some(known) => known,
        None => (Arc::new(prepared.ridge(&[lambda], &problem.terms).map_err(data)?), 0),
    };
    let solution = path.solutions.get(at).ok_or_else(|| Fault::bug("the result of a fit is missing"))?;
    let coefficients = solution.coefficients.first().cloned().unwrap_or_default();
    let p = coefficients.len();
    let spectra = problem.spectra().zip(path.gain(at));
    let covariance = spectra.and_then(|(s, gain)| s.covariance(&coefficients, &gain, settings.intercept));
    let covariance = covariance.unwrap_or_default();
    let std = (0..p).map(|i| covariance.get(i * p + i).map_or(f64::NAN, |v| v.sqrt())).collect();
    let residual_std = solution.residual_variances.first().map_or(f64::NAN, |v| v.sqrt());
    let intercept = prepared.original(0, &prepared.scaled(&coefficients)).intercept;
    Ok(LinearFitResult { fit: LinearFit { coefficients, intercept }, std, residual_std, chosen: lambda })
}

impl RidgePenalty {
    /// Faults of the ridge parameters to choose from.
    pub fn faults(&self) -> Vec<Fault> {
        let wrong = |l: &Vec<f64>| l.len() < 3 || l.iter().any(|x| !(*x > 0.0 && x.is_finite()));
        let fault = || Fault::new("`lambdas` must be three or more numbers above 0").of_param("lambdas");
        self.lambdas.as_ref().filter(|l| wrong(l)).map(|_| fault()).into_iter().collect()
    }

    /// Ridge parameter that is given or chosen.
    fn found(&self, problem: &FitProblem, settings: &FitSettings, prepared: &ScaledFactor) -> Result<f64, Fault> {
        let curve = || curve(prepared, 0, &self.grid(prepared)?).map_err(data);
        let chosen = |points: &[LambdaPoint], at: Option<usize>, none: &str| {
            let at = at.ok_or_else(|| {
                Fault::data(none).help("set `choose = \"given\"` and `lambda`, or set `lambdas` to another range")
            })?;
            Ok(points[at].lambda)
        };
        match settings.choose {
            ModelSelection::Given => Ok(self.lambda),
            ModelSelection::Gcv => {
                let points = curve()?;
                let none = "generalised cross-validation is undefined, because there are too few rows";
                chosen(&points, by_generalised_cross_validation(&points), none)
            }
            ModelSelection::LCurve => {
                let points = curve()?;
                chosen(&points, by_l_curve(&points), "the L-curve has no corner")
            }
            ModelSelection::LeaveOneLineOut | ModelSelection::LeaveOneFlightOut => {
                by_leaving_out(&self.grid(prepared)?, problem, settings)
            }
        }
    }

    /// Ridge parameters to choose from, ascending.
    fn grid(&self, prepared: &ScaledFactor) -> Result<Vec<f64>, Fault> {
        let Some(given) = &self.lambdas else {
            let singular = prepared.singular().map_err(data)?;
            let largest = singular.values.first().copied().unwrap_or(1.0).powi(2);
            return choose_lambda::grid(GRID.1 * largest, largest, GRID.0).map_err(data);
        };
        let mut grid = given.clone();
        grid.sort_by(f64::total_cmp);
        Ok(grid)
    }
}

fn by_leaving_out(grid: &[f64], problem: &FitProblem, settings: &FitSettings) -> Result<f64, Fault> {
    let falling: Vec<f64> = grid.iter().rev().copied().collect();
    let groups = problem.groups(settings)?;
    let scores = by_lines(&groups, 0, &falling, settings.scaling, settings.intercept, LineScoreMeasure::Variance);
    let at = settings.pick(&scores.map_err(lines_needed)?);
    falling.get(at).copied().ok_or_else(|| Fault::data("the list of ridge parameters to choose from is empty"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use schemas::{Column, Table, TableShape};

    use crate::{
        fit::testing::{COEFFICIENTS, INTERCEPT_NT, fitted, fitted_to, flag, number, stage, word},
        testing::{batch, sampled},
    };

    #[test]
    fn law_without_a_penalty_the_truth_is_recovered_on_every_scale() {
        for scaling in ["none", "standardise", "max_abs", "min_max"] {
            let found = fitted("ridge", &[number("lambda", 0.0), word("scaling", scaling)]).value;
            let truth = COEFFICIENTS.into_iter().chain([INTERCEPT_NT]);
            assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-9 * b.abs()), "{scaling}: {found:?}");
        }
    }

    /// Normally distributed numbers, from a generator that is independent of the generator in `numerics`.
    struct Noise(u64);

    impl Noise {
        fn draw(&mut self) -> f64 {
            let mut uniform = || {
                self.0 ^= self.0 << 13;
                self.0 ^= self.0 >> 7;
                self.0 ^= self.0 << 17;
                (self.0 >> 11) as f64 / (1u64 << 53) as f64
            };
            (0..12).map(|_| uniform()).sum::<f64>() - 6.0
        }
    }

    /// Scatter of the coefficients of many calibrations, divided by their computed standard deviation. It is the root
    /// of the ratio of mean squares, because the mean of squared ratios follows Student's distribution. The noise of a
    /// sample is `memory` times the noise of the previous sample, plus a new random number.
    fn scatter_over_claimed(memory: f64, keys: &[(String, schemas::Literal)]) -> f64 {
        let (calibrations, rows) = (120, 3000);
        let wave = |f: f64| sampled(0.0, 10.0, rows, move |t| (std::f64::consts::TAU * f * t).sin());
        let (a, b, c) = (wave(0.15), wave(0.22), wave(0.31));
        let (mut scatter, mut claimed) = ([0.0; 3], [0.0; 3]);
        for calibration in 0..calibrations {
            let (mut noise, mut last) = (Noise(0x9E37_79B9 + 77 * calibration), 0.0);
            let mut next = || {
                last = memory * last + noise.draw();
                last
            };
            let y = (0..rows).map(|i| 12.0 * a[i] - 7.0 * b[i] + 3.5 * c[i] + next()).collect();
            let columns = [("tt", "s", sampled(0.0, 10.0, rows, |t| t)), ("y", "nT", y)];
            let features = [("a", "nT", a.clone()), ("b", "nT", b.clone()), ("c", "nT", c.clone())];
            let line = batch(columns.into_iter().chain(features).collect());
            let found =
                fitted_to(&[line], "ridge", &[&[number("lambda", 0.0), flag("intercept", false)], keys].concat());
            for (k, truth) in COEFFICIENTS.into_iter().enumerate() {
                scatter[k] += (found.value[k] - truth).powi(2);
                claimed[k] += found.std[k].powi(2);
            }
        }
        (scatter.iter().zip(claimed).map(|(scatter, claimed)| scatter / claimed).sum::<f64>() / 3.0).sqrt()
    }

    #[test]
    fn law_coefficient_scatter_equals_the_computed_standard_deviation() {
        let band = [number("low_hz", 0.1), number("high_hz", 0.9)];
        for (memory, keys) in [(0.0, &band[..]), (0.0, &[]), (0.95, &band[..]), (0.95, &[])] {
            let found = scatter_over_claimed(memory, keys);
            // If samples are assumed independent, the ratio is 2.5 after the filter and 6 in coloured noise.
            assert!((0.9..1.1).contains(&found), "{memory} {}: {found}", keys.len());
        }
    }

    #[test]
    fn unit_a_note_reports_too_many_columns_for_errors() {
        let notes = |model: &str, wide: usize| {
            let names = (0..wide).map(|k| format!("a{k}")).collect();
            let columns = vec![
                Column::list("a", "", "", names),
                Column::float("b", "", ""),
                Column::float("c", "", ""),
                Column::float("y", "nT", ""),
                Column::float("tt", "s", ""),
            ];
            stage(model, &[])
                .unwrap()
                .yields(&[&Table::Lines(TableShape { columns: columns.into(), rate_hz: None })])
                .unwrap()
                .notes
        };
        assert!(notes("ridge", 93).is_empty());
        assert!(notes("ridge", 94)[0].contains("the fit has 96 terms, and `std` is computed for up to 95"));
        assert!(notes("pls", 94).is_empty(), "it has none with fewer terms either");
    }

    #[test]
    fn law_a_strong_penalty_leaves_only_the_mean() {
        let found = fitted("ridge", &[number("lambda", 1e15)]);
        assert!(found.value[..3].iter().all(|b| b.abs() < 1e-6), "{:?}", found.value);
        assert_eq!(found.chosen, 1e15);
    }
}

//! Fitted model of one point, in the form of its table.

use std::ops::Range;

use numerics::{
    compensation::diagnostics::{Excitation, TrivialSolution},
    regression::{least_squares::LinearFit, statistics},
    signal::noise::BlockMeans,
};
use schemas::Fault;

use super::{
    model::LearningResult,
    point::FitPoint,
    problem::FitProblem,
    samples::{FitSamples, LineSamples},
    settings::ModelSelection,
};
use crate::{
    model_columns::INTERCEPT,
    trained::{LearnedModel, TermValue, term},
};

/// Row of a model table.
pub struct ModelTableRow {
    /// Term and value.
    pub term: TermValue,
    /// Standard deviation of the value. NaN if the model provides none.
    pub std: f64,
}

/// Data from which the residual noise of a model is computed.
pub enum ResidualSource {
    /// Coefficients of a linear model, with their terms.
    By(LinearFit, Vec<String>),
    /// Residual of each row of each line.
    Series(Vec<BlockMeans>),
}

/// Fitted model, in the form of its table.
pub struct FitSolution {
    /// Rows of the model table and of the training table.
    pub table: Vec<ModelTableRow>,
    /// Data from which the residual noise is computed.
    pub left: ResidualSource,
    /// Numbers of used and of unused rows of the selected lines.
    pub rows: (usize, usize),
    /// Condition number of the scaled matrix. NaN for a nonlinear model.
    pub condition: f64,
    /// Standard deviation of the residual, which is filtered if the target is filtered.
    pub residual_std: f64,
    /// Ridge parameter, number of components or epoch used.
    pub chosen: f64,
    /// Fraction of the total field attributed to the aircraft. NaN if the terms do not determine it.
    pub trivial_share: f64,
    /// Upper bound on the error of the linear form. NaN if the terms do not determine it.
    pub approximation_bound_nt: f64,
    /// Lines whose rows were used.
    pub lines: String,
    /// Sample rate of the terms that are differences per sample, in Hz.
    pub rate_hz: f64,
    /// Warning about the fit.
    pub warning: String,
}

/// Linear model of one point.
///
/// # Errors
/// Fails in the cases of [`FitModel::fit`](super::FitModel::fit). Also fails if the decomposition does not converge.
pub fn solve(problem: &mut FitProblem, point: &FitPoint) -> Result<FitSolution, Fault> {
    let (prepared, excited) = problem.prepared(&point.settings)?;
    let answer = point.model.fit(problem, &point.settings, &prepared)?;
    let trivial = problem.trivial(&answer.fit, answer.chosen)?;
    let remark = point.model.remark(&answer, problem.terms.len());
    let approximation_bound_nt = problem.approximation_bound_nt(&answer.fit);
    let used = problem.merged.rows();
    let (fit, std, terms) = match &problem.components {
        Some(components) => components.original(&answer.fit),
        None => (answer.fit, answer.std, problem.terms.clone()),
    };
    let row = |((name, value), std): ((&String, &f64), &f64)| ModelTableRow { term: term(name, *value), std: *std };
    let mut table: Vec<ModelTableRow> = terms.iter().zip(&fit.coefficients).zip(&std).map(row).collect();
    if point.settings.intercept {
        table.push(ModelTableRow { term: term(INTERCEPT, fit.intercept), std: f64::NAN });
    }
    Ok(FitSolution {
        table,
        left: ResidualSource::By(fit, terms),
        rows: (used, problem.selected - used),
        condition: excited.condition,
        residual_std: answer.residual_std,
        chosen: answer.chosen,
        approximation_bound_nt,
        trivial_share: trivial.as_ref().map_or(f64::NAN, |t| t.share),
        lines: problem.lines.join(", "),
        rate_hz: problem.rate_hz,
        warning: warning(point, &excited, trivial.as_ref(), remark, &problem.unused),
    })
}

fn warning(
    point: &FitPoint,
    excited: &Excitation,
    trivial: Option<&TrivialSolution>,
    remark: Option<String>,
    unused: &str,
) -> String {
    let nothing_given = point.settings.choose == ModelSelection::Given && point.model.lambda() == Some(0.0);
    let weak = excited.message().filter(|_| nothing_given);
    let trivial = trivial.filter(|t| t.is_trivial()).map(|t| {
        format!(
            "the fit attributes {:.0} % of the total field to the aircraft, which is the trivial solution; increase \
             `lambda`",
            100.0 * t.share
        )
    });
    weak.into_iter().chain(trivial).chain(remark).chain(too_short(unused)).collect::<Vec<_>>().join("; ")
}

fn too_short(unused: &str) -> Option<String> {
    (!unused.is_empty()).then(|| format!("not used because too short for filter and trim: {unused}"))
}

/// Model that learned from samples, with its residual.
///
/// # Errors
/// Fails if the model predicts values that are not finite.
pub fn solved(problem: &FitProblem, samples: &FitSamples, learnt: LearningResult) -> Result<FitSolution, Fault> {
    let LearningResult { model, chosen, curve, warning } = learnt;
    let left = samples.lines.iter().map(|line| residual(samples, line, &model)).collect::<Result<Vec<_>, Fault>>()?;
    let all: Vec<f64> = left.iter().flatten().copied().collect();
    if all.iter().any(|x| !x.is_finite()) {
        return Err(Fault::data("the model predicts values that are not finite").help("reduce `learning_rate`"));
    }
    let series =
        left.iter().zip(&samples.lines).map(|(left, line)| BlockMeans::from_runs(left, line.runs, line.rate_hz));
    let used = problem.merged.rows();
    let table = model.terms().into_iter().chain(curve).map(|term| ModelTableRow { term, std: f64::NAN }).collect();
    let warning = (!warning.is_empty()).then_some(warning);
    Ok(FitSolution {
        table,
        left: ResidualSource::Series(series.collect()),
        rows: (used, problem.selected - used),
        condition: f64::NAN,
        residual_std: statistics::std(&all).value,
        chosen,
        trivial_share: f64::NAN,
        approximation_bound_nt: f64::NAN,
        lines: problem.lines.join(", "),
        rate_hz: problem.rate_hz,
        warning: warning.into_iter().chain(too_short(&problem.unused)).collect::<Vec<_>>().join("; "),
    })
}

/// Residual of the target of a line.
fn residual(samples: &FitSamples, line: &LineSamples, model: &LearnedModel) -> Result<Vec<f64>, Fault> {
    let place = |name: &String| samples.names.iter().position(|n| n == name);
    let at: Option<Vec<usize>> = model.columns().iter().map(place).collect();
    let at = at.ok_or_else(|| Fault::bug("a model uses columns that it did not receive"))?;
    let runs: Vec<usize> = line.runs.iter().map(Range::len).collect();
    let predicted = model.predict(&line.columns(&at, samples.names.len()), &runs)?.field_nt;
    if predicted.len() != line.y.len() {
        return Err(Fault::bug("a model returned predictions for other rows than it received"));
    }
    Ok(line.y.iter().zip(predicted).map(|(y, p)| y - p).collect())
}

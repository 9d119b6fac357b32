//! The model of one point, ready for its table.

use numerics::{
    compensation::diagnostics::{Excitation, TrivialSolution},
    regression::least_squares::LinearFit,
};
use schemas::Fault;

use super::{point::Point, problem::Problem, settings::Choose};

/// A fitted model, ready for its table.
pub struct Solved {
    /// Coefficients in the units of the columns.
    pub fit: LinearFit,
    /// One sigma of each coefficient; NaN where the model knows none.
    pub std: Vec<f64>,
    /// The names of the terms.
    pub terms: Vec<String>,
    /// Rows that were used, and rows of the selected lines that were not.
    pub rows: (usize, usize),
    /// The condition number of the scaled matrix.
    pub condition: f64,
    /// Standard deviation of what is left of the filtered target.
    pub residual_std: f64,
    /// The ridge parameter or number of components that was used.
    pub chosen: f64,
    /// How much of the total field is explained away; NaN where the terms cannot tell.
    pub trivial_share: f64,
    /// What the linear form misses at most; NaN where the terms cannot tell.
    pub approximation_bound_nt: f64,
    /// The lines whose rows were used.
    pub lines: String,
    /// What to know before the fit is trusted.
    pub warning: String,
}

/// The model of one point.
///
/// # Errors
/// As [`FitModel::fit`](super::FitModel::fit), and when the decomposition does not converge.
pub fn solve(problem: &mut Problem, point: &Point) -> Result<Solved, Fault> {
    let (prepared, excited) = problem.prepared(&point.settings)?;
    let answer = point.model.fit(problem, &point.settings, &prepared)?;
    let trivial = problem.trivial(&answer.fit, answer.chosen)?;
    let approximation_bound_nt = problem.approximation_bound_nt(&answer.fit);
    let used = problem.merged.rows();
    let (fit, std, terms) = match &problem.components {
        Some(components) => components.original(&answer.fit),
        None => (answer.fit, answer.std, problem.terms.clone()),
    };
    Ok(Solved {
        fit,
        std,
        terms,
        rows: (used, problem.selected - used),
        condition: excited.condition,
        residual_std: answer.residual_std,
        chosen: answer.chosen,
        approximation_bound_nt,
        trivial_share: trivial.as_ref().map_or(f64::NAN, |t| t.share),
        lines: problem.lines.join(", "),
        warning: warning(point, &excited, trivial.as_ref(), &problem.unused),
    })
}

fn warning(point: &Point, excited: &Excitation, trivial: Option<&TrivialSolution>, unused: &str) -> String {
    let nothing_given = point.settings.choose == Choose::Given && point.model.lambda() == Some(0.0);
    let weak = excited.message().filter(|_| nothing_given);
    let trivial = trivial.filter(|t| t.is_trivial()).map(|t| {
        format!(
            "the fit calls {:.0} % of the total field the aircraft's, which is the trivial solution: take a larger `lambda`",
            100.0 * t.share
        )
    });
    let unused = (!unused.is_empty()).then(|| format!("too short for filter and trim, so not used: {unused}"));
    weak.into_iter().chain(trivial).chain(unused).collect::<Vec<_>>().join("; ")
}

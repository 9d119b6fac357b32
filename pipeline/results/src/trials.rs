//! Summary of a search in a few lines of text.

use plan::{
    Plan,
    spec::{RungOutcome, SearchTrialScore, best},
};
use schemas::Literal;

use super::text::number;

/// Maximum number of trials without a goal value that are listed.
const NAMED: usize = 10;

/// Text with the best of `trials` and the trials without a goal value; empty for a plan without a search.
pub fn trials(plan: &Plan, trials: &[SearchTrialScore]) -> String {
    let (Some(search), Ok(Some(goal))) = (&plan.spec.search, plan.goal()) else { return String::new() };
    let mut numbers: Vec<usize> = trials.iter().map(|t| t.row.trial).collect();
    numbers.dedup();
    let mut out = String::new();
    if let Some(best) = best(trials) {
        let unit = if goal.metric.unit == "1" { String::new() } else { format!(" {}", goal.metric.unit) };
        let names = search.columns().into_iter().map(|(name, _)| name);
        let values = names.zip(best.row.literals(search)).skip(1).map(|(name, v)| format!("{name} = {}", short(&v)));
        out = format!(
            "\nbest of {} trials: trial {}, {}.{} {}{unit}, at {}\n",
            numbers.len(),
            best.row.trial,
            search.table,
            search.metric,
            number(best.goal),
            values.collect::<Vec<_>>().join(", ")
        );
    }
    let mut failed: Vec<usize> =
        trials.iter().filter(|t| t.rung_outcome(search) == RungOutcome::Failed).map(|t| t.row.trial).collect();
    failed.dedup();
    if !failed.is_empty() {
        let named: Vec<String> = failed.iter().take(NAMED).map(usize::to_string).collect();
        let more = if failed.len() > NAMED { " and others" } else { "" };
        let table = format!("{}.trials", plan.spec.name);
        out += &format!("trials without a goal: {}{more}; the table `{table}` has the reasons\n", named.join(", "));
    }
    out
}

/// A value with at most six significant digits.
pub fn short(value: &Literal) -> String {
    match value {
        Literal::Float(x) => format!("{x:.5e}").parse::<f64>().map_or_else(|_| value.to_string(), |x| x.to_string()),
        other => other.to_string(),
    }
}

//! Units and tables that could not be computed.

use std::collections::HashMap;

use plan::Plan;
use results::warnings::{Warning, WarningKind};
use schemas::Fault;

/// Unit that could not be computed.
#[derive(Clone, Debug)]
pub struct Failure {
    /// Table, or source.
    pub table: String,
    /// Sweep point.
    pub point: plan::SweepPoint,
    /// Line; `None` for a survey stage.
    pub line: Option<(String, String)>,
    /// Reason.
    pub fault: Fault,
}

/// Divides warnings into failures and remaining warnings. A metric that could not be computed is a failure if its table
/// sets `metrics`. A default metric is skipped with a warning.
pub fn of_metrics(plan: &Plan, warnings: Vec<Warning>) -> (Vec<Failure>, Vec<Warning>) {
    let named = |w: &Warning| {
        let table = plan.table(&w.stage).ok().and_then(|t| plan.decl(t));
        w.kind == WarningKind::Metric && table.is_some_and(|decl| decl.args.contains_key("metrics"))
    };
    let (failed, others): (Vec<Warning>, Vec<Warning>) = warnings.into_iter().partition(named);
    let failure = |w: Warning| Failure { table: w.stage, point: w.point, line: w.line, fault: Fault::data(w.text) };
    (failed.into_iter().map(failure).collect(), others)
}

/// Failures in the form that is reported. A mistake that occurs in several lines of a file is reported once, with the
/// number of lines.
pub fn deduplicated(failures: &[Failure]) -> Vec<(&Failure, usize)> {
    let shape = |f: &Failure| f.fault.what.chars().filter(|c| !c.is_ascii_digit() && !".,-e".contains(*c)).collect();
    let mistake = |f: &Failure| -> Option<(String, String, String)> {
        // Only faults of a source are merged; each fault of a stage is reported.
        let file = f.fault.place.file.clone()?;
        Some((file, f.fault.place.column.clone()?, shape(f)))
    };
    let mut merged: Vec<(&Failure, usize)> = vec![];
    let mut at: HashMap<(String, String, String), usize> = HashMap::new();
    for failure in failures {
        let Some(mistake) = mistake(failure) else {
            merged.push((failure, 1));
            continue;
        };
        match at.get(&mistake).and_then(|i| merged.get_mut(*i)) {
            Some((_, lines)) => *lines += 1,
            None => {
                at.insert(mistake, merged.len());
                merged.push((failure, 1));
            }
        }
    }
    merged
}

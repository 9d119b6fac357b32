//! `magline check`: checks a spec without a run.

use plan::sources::Flights;
use schemas::{Fault, StageEntry};

use super::{ExitReason, SpecArgs, note, plan, say};

/// Checks a spec and its sources.
pub fn run(catalogue: &[StageEntry], args: &SpecArgs) -> Result<(), ExitReason> {
    let plan = plan(catalogue, args)?;
    let implausible = |f: &Flights| {
        let at = plan.spec.tables.iter().find(|t| t.name == f.name).map(|t| t.path.1.clone());
        f.implausible().into_iter().map(move |fault| at.clone().map_or(fault.clone(), |at| fault.at(at)))
    };
    let unpublishable = plan.spec.publish.iter().filter_map(|facts| facts.as_ref().err()).flatten().cloned();
    let wrong: Vec<Fault> = plan.flights.iter().flat_map(implausible).chain(unpublishable).collect();
    if !wrong.is_empty() {
        return Err(plan.spec.faults(wrong).into());
    }
    let points: usize = plan.tables.iter().map(|t| plan.most_points(t)).sum();
    for text in &plan.notes {
        note(text);
    }
    let most = if plan.spec.search.is_some() { "at most " } else { "" };
    say(format!("{} is valid: {} tables, {most}{points} points\n", plan.spec.file, plan.tables.len()))
}

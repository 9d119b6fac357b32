//! Search by generations: each generation is planned from the scores of the previous generations, and is then run.
//!
//! The store holds only the results of a search, which are addressed by their inputs. A killed search plans its
//! generations again and finds the finished results in the store. After the last generation all trials are published
//! together, as in a sweep.

use std::{
    collections::{BTreeMap, HashSet},
    sync::{Mutex, MutexGuard, PoisonError},
};

use plan::{
    Plan,
    spec::{SearchState, SpecFaults},
};
use schemas::{Fault, FaultOwner, StageEntry, keys::HashKey};
use store::{PipelineLock, Store};

use super::{
    Event, Failure, Listener, OutcomeCounts, RunOptions, RunSummary, UnitOutcome,
    pass::{PlanPass, run_with_repair},
    run_locked,
    trials::in_order,
};

/// Runs `plan` in a process that has the lock of its pipeline; a search is run with all trials that follow from the
/// scores. Returns the plan of all computed trials.
///
/// # Errors
/// Returns the errors of [`super::run`].
pub fn search(
    plan: Plan,
    catalogue: &[StageEntry],
    store: &Store,
    publisher: &PipelineLock,
    options: RunOptions<'_>,
    listener: &dyn Listener,
) -> Result<(Plan, RunSummary), SpecFaults> {
    let found = plan.spec.search.clone();
    let Some((search, mut course)) = found.as_ref().map(|s| (s, SearchState::new(s))).filter(|(_, c)| !c.is_known())
    else {
        let summary = run_locked(&plan, store, publisher, options, listener)?;
        return Ok((plan, summary));
    };
    let relay = EventRelay::new(listener);
    let mut spec = plan.spec;
    while !course.next().is_empty() {
        let rows = course.next().to_vec();
        let plan = Plan::new(spec.with_trials(&rows), catalogue)?;
        // The bytes of the inputs are read only once per search.
        spec.verify_inputs = false;
        listener.on_event(&Event::Searching { rows: &rows, trials: search.trials, best: course.best() });
        let pass = PlanPass { last: false, rows: &rows, known: None, relay: Some(&relay) };
        let one = RunOptions { compact: false, ..options };
        let mut summary = run_with_repair(&plan, store, one, publisher, &relay, &pass)?;
        let refused = summary.failures.iter().any(|f| f.fault.owner == FaultOwner::Machine);
        if summary.interrupted || refused {
            if !summary.interrupted {
                summary.failures.push(stopped(course.done().len()));
            }
            summary.trials.clear();
            listener.on_event(&Event::Finished { summary: &summary });
            return Ok((plan, summary));
        }
        course.record_scores(std::mem::take(&mut summary.trials));
        let scored = course.done().get(course.done().len().saturating_sub(rows.len())..).unwrap_or_default();
        listener.on_event(&Event::Trials { search, scored, best: course.best() });
    }
    let plan = Plan::new(spec.with_trials(&course.rows()), catalogue)?;
    let known = in_order(course.done().to_vec());
    relay.last();
    let pass = PlanPass { last: true, rows: &[], known: Some(&known), relay: Some(&relay) };
    let summary = run_with_repair(&plan, store, RunOptions { compact: true, ..options }, publisher, &relay, &pass)?;
    listener.on_event(&Event::Finished { summary: &summary });
    Ok((plan, summary))
}

/// Failure that stops a search after a fault of the machine. The fault may not recur in a later run, and the next
/// trials would then differ.
fn stopped(done: usize) -> Failure {
    let what =
        format!("the search stopped after {done} trials, because the machine failed during the trials that followed");
    let fault = Fault::machine(what).help("run the spec again to resume; finished results are stored");
    Failure { table: "search".into(), point: Default::default(), line: None, fault }
}

/// Listener that merges the events of several passes into those of one run.
pub struct EventRelay<'a> {
    listener: &'a dyn Listener,
    state: Mutex<EventRelayState>,
}

#[derive(Default)]
struct EventRelayState {
    started: bool,
    last: bool,
    units: HashSet<HashKey>,
    tables: BTreeMap<String, TableTotals>,
}

/// Outcomes of a table summed over all passes, and its total time.
#[derive(Clone, Copy, Default)]
struct TableTotals {
    count: OutcomeCounts,
    seconds: f64,
}

impl<'a> EventRelay<'a> {
    fn new(listener: &'a dyn Listener) -> EventRelay<'a> {
        EventRelay { listener, state: Mutex::default() }
    }

    fn state(&self) -> MutexGuard<'_, EventRelayState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Declares the next pass to be the last.
    fn last(&self) {
        self.state().last = true;
    }

    /// Outcomes and total time, in seconds, of each of these tables over all passes.
    pub fn sums<'t>(&self, tables: impl Iterator<Item = &'t str>) -> Vec<(OutcomeCounts, f64)> {
        let state = self.state();
        let spent = |name: &str| state.tables.get(name).copied().unwrap_or_default();
        tables.map(spent).map(|s| (s.count, s.seconds)).collect()
    }
}

impl Listener for EventRelay<'_> {
    fn on_event(&self, event: &Event) {
        match event {
            Event::Reading { .. } => {
                let started = self.state().started;
                if !started {
                    self.listener.on_event(event);
                }
            }
            Event::Started { .. } => {
                let started = std::mem::replace(&mut self.state().started, true);
                if !started {
                    self.listener.on_event(event);
                }
            }
            Event::Unit { table, point, line, outcome, .. } => {
                let place = line.iter().flat_map(|(flight, line)| [flight.clone(), line.clone()]);
                let point = point.iter().flat_map(|(name, value)| [name.clone(), value.to_string()]);
                let new = {
                    let mut state = self.state();
                    let new = state
                        .units
                        .insert(HashKey::from_parts([(*table).to_owned()].into_iter().chain(point).chain(place)));
                    if new {
                        let count = &mut state.tables.entry((*table).to_owned()).or_default().count;
                        match outcome {
                            UnitOutcome::Computed => count.computed += 1,
                            UnitOutcome::Reused => count.reused += 1,
                            UnitOutcome::Failed => count.failed += 1,
                            UnitOutcome::Skipped => count.skipped += 1,
                        }
                    }
                    new
                };
                if new {
                    self.listener.on_event(event);
                }
            }
            Event::Table { table, seconds, .. } => {
                let (last, spent) = {
                    let mut state = self.state();
                    let last = state.last;
                    let spent = state.tables.entry((*table).to_owned()).or_default();
                    spent.seconds += seconds;
                    (last, *spent)
                };
                if last {
                    self.listener.on_event(&Event::Table { table, count: spent.count, seconds: spent.seconds });
                }
            }
            Event::Computing { .. }
            | Event::Working { .. }
            | Event::Waiting { .. }
            | Event::Searching { .. }
            | Event::Trials { .. }
            | Event::Trying { .. }
            | Event::Publishing { .. }
            | Event::Finished { .. } => self.listener.on_event(event),
        }
    }
}

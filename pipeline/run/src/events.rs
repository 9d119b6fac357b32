//! Events of a run.

use std::ops::Add;

use plan::{
    PlanGraph, SweepPoint,
    sources::ReadProgress,
    spec::{SearchSpec, SearchTrial, SearchTrialScore},
};
use schemas::Fault;
use serde::{Deserialize, Serialize};

use super::RunSummary;

/// Numbers of units of a table by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OutcomeCounts {
    /// Computed now.
    pub computed: usize,
    /// Found in the store.
    pub reused: usize,
    /// Not computable.
    pub failed: usize,
    /// Units that were not tried, because one of their inputs failed.
    pub skipped: usize,
}

impl Add for OutcomeCounts {
    type Output = OutcomeCounts;

    fn add(self, other: OutcomeCounts) -> OutcomeCounts {
        OutcomeCounts {
            computed: self.computed + other.computed,
            reused: self.reused + other.reused,
            failed: self.failed + other.failed,
            skipped: self.skipped + other.skipped,
        }
    }
}

/// Outcome of one unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UnitOutcome {
    /// Computed now.
    Computed,
    /// Found in the store.
    Reused,
    /// Not computable.
    Failed,
    /// Not tried.
    Skipped,
}

impl UnitOutcome {
    /// Name of the outcome.
    pub fn as_str(self) -> &'static str {
        match self {
            UnitOutcome::Computed => "computed",
            UnitOutcome::Reused => "reused",
            UnitOutcome::Failed => "failed",
            UnitOutcome::Skipped => "skipped",
        }
    }
}

/// Event of a run.
pub enum Event<'a> {
    /// A file of a source is being read, or a line of the file is complete.
    Reading {
        /// Name of the source.
        table: &'a str,
        /// Progress of the reading.
        step: &'a ReadProgress<'a>,
    },
    /// Start of the run.
    Started {
        /// Name of the pipeline.
        pipeline: &'a str,
        /// Number of units.
        units: usize,
        /// Hash of the computation and its data: equal for the same spec and inputs.
        run: &'a str,
        /// Choices made automatically.
        notes: &'a [String],
        /// Graph of the run.
        graph: &'a PlanGraph<'a>,
    },
    /// Start of the computation of the missing units of a table.
    Computing {
        /// Name of the table.
        table: &'a str,
        /// Number of missing units that can be computed.
        units: usize,
    },
    /// Progress of a unit that takes minutes.
    Working {
        /// Name of the table.
        table: &'a str,
        /// Sweep point.
        point: &'a SweepPoint,
        /// Progress in a few words.
        progress: &'a str,
    },
    /// Start or end of a wait for a component, such as a worker.
    Waiting {
        /// Reason for waiting, in a few words; `None` when the run resumes.
        what: Option<&'a str>,
    },
    /// End of a unit.
    Unit {
        /// Name of the table.
        table: &'a str,
        /// Sweep point.
        point: &'a SweepPoint,
        /// Line; `None` for a survey stage.
        line: Option<&'a (String, String)>,
        /// Outcome of the unit.
        outcome: UnitOutcome,
        /// Fault of a failed unit.
        fault: Option<&'a Fault>,
    },
    /// Start of trials of a search.
    Searching {
        /// Trials of one generation at one rung.
        rows: &'a [SearchTrial],
        /// Number of trials of the whole search.
        trials: usize,
        /// Best trial so far.
        best: Option<&'a SearchTrialScore>,
    },
    /// Goals of computed trials of a search.
    Trials {
        /// Search of the spec.
        search: &'a SearchSpec,
        /// Computed trials.
        scored: &'a [SearchTrialScore],
        /// Best trial so far.
        best: Option<&'a SearchTrialScore>,
    },
    /// Start of a trial of a remedy for a warning.
    Trying {
        /// Table of the scores.
        table: &'a str,
        /// Changed keys.
        remedy: &'a str,
    },
    /// Start of writing a table as a data set.
    Publishing {
        /// Name of the table.
        table: &'a str,
    },
    /// End of a table, which is then complete and published.
    Table {
        /// Name of the table.
        table: &'a str,
        /// Outcomes of its units.
        count: OutcomeCounts,
        /// Duration, in seconds.
        seconds: f64,
    },
    /// End of the run.
    Finished {
        /// Summary of the run.
        summary: &'a RunSummary,
    },
}

/// Observer of events.
pub trait Listener: Sync {
    /// Receives an event, on the thread where it occurred.
    fn on_event(&self, event: &Event);
}

/// Listener that ignores all events.
pub struct SilentListener;

impl Listener for SilentListener {
    fn on_event(&self, _: &Event) {}
}

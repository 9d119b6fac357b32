//! The events of a run.

use std::ops::Add;

use schemas::Fault;
use serde::{Deserialize, Serialize};

use super::RunSummary;
use crate::{
    plan::{PlanGraph, SweepPoint},
    sources::ReadProgress,
    spec::{SearchSpec, SearchTrial, SearchTrialScore},
};

/// The number of units of a table by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OutcomeCounts {
    /// Computed now.
    pub computed: usize,
    /// Found in the store.
    pub reused: usize,
    /// Not computable.
    pub failed: usize,
    /// Not tried, because one of their inputs failed.
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

/// The outcome of one unit.
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
    /// The word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            UnitOutcome::Computed => "computed",
            UnitOutcome::Reused => "reused",
            UnitOutcome::Failed => "failed",
            UnitOutcome::Skipped => "skipped",
        }
    }
}

/// An event of a run.
pub enum Event<'a> {
    /// A file of a source is being read, or a line of it is complete.
    Reading {
        /// The source.
        table: &'a str,
        /// Its progress.
        step: &'a ReadProgress<'a>,
    },
    /// The run begins.
    Started {
        /// The pipeline.
        pipeline: &'a str,
        /// The number of units.
        units: usize,
        /// The hash of the computation and its data: equal for the same spec and inputs.
        run: &'a str,
        /// Choices made automatically.
        notes: &'a [String],
        /// Graph of the run.
        graph: &'a PlanGraph<'a>,
    },
    /// The missing part of a table is computed now.
    Computing {
        /// The table.
        table: &'a str,
        /// Units that are missing and can be computed.
        units: usize,
    },
    /// A unit that takes minutes says how far it is.
    Working {
        /// The table.
        table: &'a str,
        /// The sweep point.
        point: &'a SweepPoint,
        /// How far, in a few words.
        progress: &'a str,
    },
    /// Nothing can be computed before something else is there; or that has come.
    Waiting {
        /// Reason for waiting, in a few words; none when the run resumes.
        what: Option<&'a str>,
    },
    /// A unit is finished.
    Unit {
        /// The table.
        table: &'a str,
        /// The sweep point.
        point: &'a SweepPoint,
        /// The line; `None` for a survey stage.
        line: Option<&'a (String, String)>,
        /// Its outcome.
        outcome: UnitOutcome,
        /// Why it failed.
        fault: Option<&'a Fault>,
    },
    /// Trials of a search are computed next.
    Searching {
        /// The trials of this generation at this rung.
        rows: &'a [SearchTrial],
        /// The number of trials of the whole search.
        trials: usize,
        /// The best so far.
        best: Option<&'a SearchTrialScore>,
    },
    /// Trials of a search have their goals.
    Trials {
        /// The search.
        search: &'a SearchSpec,
        /// These trials.
        scored: &'a [SearchTrialScore],
        /// The best so far.
        best: Option<&'a SearchTrialScore>,
    },
    /// A table is written as a data set.
    Publishing {
        /// The table.
        table: &'a str,
    },
    /// A table is complete and published.
    Table {
        /// The table.
        table: &'a str,
        /// The outcome of its units.
        count: OutcomeCounts,
        /// Its duration.
        seconds: f64,
    },
    /// The run is over.
    Finished {
        /// Its summary.
        summary: &'a RunSummary,
    },
}

/// An observer of events.
pub trait Listener: Sync {
    /// Receives an event, on the thread where it occurred.
    fn hear(&self, event: &Event);
}

/// No observer.
pub struct SilentListener;

impl Listener for SilentListener {
    fn hear(&self, _: &Event) {}
}

//! What a run tells while it goes on.

use std::ops::Add;

use schemas::Fault;

use super::Summary;
use crate::{plan::Point, sources::ReadStep};

/// How many units of a table had which fate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Computed now.
    pub computed: usize,
    /// Found in the store.
    pub reused: usize,
    /// Not computable.
    pub failed: usize,
    /// Not tried, because something they rest on failed.
    pub skipped: usize,
}

impl Add for Count {
    type Output = Count;

    fn add(self, other: Count) -> Count {
        Count {
            computed: self.computed + other.computed,
            reused: self.reused + other.reused,
            failed: self.failed + other.failed,
            skipped: self.skipped + other.skipped,
        }
    }
}

/// The fate of one unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Computed now.
    Computed,
    /// Found in the store.
    Reused,
    /// Not computable.
    Failed,
    /// Not tried.
    Skipped,
}

impl Outcome {
    /// The word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Outcome::Computed => "computed",
            Outcome::Reused => "reused",
            Outcome::Failed => "failed",
            Outcome::Skipped => "skipped",
        }
    }
}

/// Something that happened.
pub enum Event<'a> {
    /// A file of a source is being read, or a line of it is there.
    Reading {
        /// The source.
        table: &'a str,
        /// How far it has come.
        step: &'a ReadStep<'a>,
    },
    /// The run begins.
    Started {
        /// The pipeline.
        pipeline: &'a str,
        /// Units there are.
        units: usize,
        /// What is asked, and of which data: the same for the same spec and inputs.
        run: &'a str,
        /// Choices made for the user.
        notes: &'a [String],
    },
    /// What is missing of a table is computed now.
    Computing {
        /// The table.
        table: &'a str,
        /// Units that are neither there nor beyond computing.
        units: usize,
    },
    /// A unit is settled.
    Unit {
        /// The table.
        table: &'a str,
        /// The sweep point.
        point: &'a Point,
        /// The line; none for a survey stage.
        line: Option<&'a (String, String)>,
        /// Its fate.
        outcome: Outcome,
        /// Why it failed.
        fault: Option<&'a Fault>,
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
        /// What happened to its units.
        count: Count,
        /// How long it took.
        seconds: f64,
    },
    /// The run is over.
    Finished {
        /// What came of it.
        summary: &'a Summary,
    },
}

/// Somebody who wants to know.
pub trait Listener: Sync {
    /// Is told of an event, on whichever thread it happened.
    fn hear(&self, event: &Event);
}

/// Nobody.
pub struct Quiet;

impl Listener for Quiet {
    fn hear(&self, _: &Event) {}
}

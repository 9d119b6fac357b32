//! The pipeline of magline: the command line, published sets, the server, and the benchmark. It uses the crates of the
//! lower layers.
//!
//! ```text
//! report    views of a plan and its results: HTML, SQL, explain, why, lineage
//! run       tasks, workers, engines, and the cost of a run
//! results   scores, warnings, history
//! plan      spec (text with positions) -> plan (tables, axes, points) -> graph (lines and keys)
//! store     results, addressed by their inputs
//! buckets   object stores
//! ```
//! Each crate uses only the crates below it.
//!
//! [`main`] runs the command line with a catalogue of stages: [`catalogue`], optionally with custom stages.

pub mod bench;
mod cli;
#[cfg_attr(not(feature = "serve"), allow(dead_code))]
pub mod release;
#[cfg(feature = "serve")]
pub mod serve;
mod shell;

use schemas::StageEntry;

pub use cli::{ProgressDisplay, ProgressSnapshot, command, main, run_summary};
pub use expressions::deep;
pub use stages::Catalogue;
pub use {plan, report, results, run, store};

/// The built-in stages.
pub fn catalogue() -> Vec<StageEntry> {
    stages::catalogue()
}

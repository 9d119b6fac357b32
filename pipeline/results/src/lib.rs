//! Results of runs: scores of lines and their pooled values, warnings, the history of runs, and the record of each
//! version's inputs. The terminal and the report present the same results.

pub mod history;
pub mod logical;
mod points;
pub mod pooled;
pub mod record;
pub mod run_changes;
pub mod score_table;
pub mod scores;
pub mod text;
pub mod trials;
pub mod warnings;

pub use points::{SnapshotPoint, SnapshotPoints};
pub use record::{Snapshot, SnapshotTable, described, lifted, made_by_another, record, snapshots};
pub use trials::trials;

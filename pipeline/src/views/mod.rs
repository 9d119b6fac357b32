//! Views of a plan and of the results of a run: explain, lineage, why, the reference, SQL.

pub mod cost;
mod explain;
pub mod history;
mod lineage;
pub mod openlineage;
pub mod pooled;
mod record;
mod reference;
pub mod report;
pub mod score_table;
pub mod scores;
pub mod sql;
pub mod text;
mod trials;
pub mod warnings;
mod why;

pub use explain::explain;
pub use lineage::{LineageFormat, lineage};
pub use record::{Snapshot, SnapshotTable, described, lifted, made_by_another, record, snapshots};
pub use reference::{one as stage_page, overview as stages_overview, page as reference_page};
pub use trials::trials;
pub use why::why;

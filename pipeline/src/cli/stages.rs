//! `magline stages`: the reference of the stages.

use plan::spec::search_reference;
use schemas::StageEntry;

use super::{ExitReason, say};

/// Lists the stages or describes one.
pub fn run(all: &[StageEntry], name: Option<&str>, markdown: bool) -> Result<(), ExitReason> {
    match name {
        // The simulator, mappings and searches are not stages, but have the same kind of reference page.
        Some("synth") => say(simulate::reference()),
        Some("mapping") => say(intake::mapping::reference()),
        Some("search") => say(search_reference()),
        Some(name) => say(::report::stage_page(all, name)?),
        None if markdown => say(::report::reference_page(all)),
        None => say(::report::stages_overview(all)),
    }
}

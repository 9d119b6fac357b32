//! The pipeline of magline: spec, plan, store, run, and the views of them.
//!
//! ```text
//! spec (text with positions) -> plan (tables, axes, points, everything checked) -> graph (lines and keys) -> run
//! ```
//! `explain`, `why`, `lineage`, `sql`, the reference and the report are views of the same plan and store.
//!
//! [`main`] is the command line over a catalogue of stages: [`catalogue`], optionally with custom stages.

pub mod bench;
mod casting;
mod cli;
pub mod clock;
#[cfg_attr(not(feature = "serve"), allow(dead_code))]
mod confine;
pub mod cost;
pub mod keys;
pub mod plan;
#[cfg(feature = "ports")]
mod ports;
pub mod predicate;
pub mod release;
mod remote;
pub mod run;
#[cfg(feature = "serve")]
pub mod serve;
pub mod sources;
pub mod spec;
pub mod store;
pub mod views;

use std::path::{Path, PathBuf};

use schemas::{Fault, StageEntry};
use spec::{Spec, SpecFaults};

/// Reads the spec at `path` and applies the assignments of `--set`.
///
/// # Errors
/// Fails when it cannot be read or its form is wrong.
pub fn read_spec(path: &Path, sets: &[String]) -> Result<Spec, SpecFaults> {
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|e| SpecFaults {
        file: file.clone(),
        text: String::new(),
        sets: vec![],
        faults: vec![Fault::new(format!("cannot read {file}: {e}")).help("give a spec, which is a TOML file")],
    })?;
    let folder =
        path.parent().map(Path::to_owned).filter(|p| !p.as_os_str().is_empty()).unwrap_or_else(|| PathBuf::from("."));
    let spec = Spec::parse(&file, folder, text, sets)?;
    if let Some((address, at)) = &spec.store_at {
        store::prepared(address).map_err(|fault| spec.faults(vec![fault.at(at.clone())]))?;
    }
    Ok(spec)
}

pub use cli::main;
pub use expressions::deep;
pub use stages::Catalogue;

/// The built-in stages.
pub fn catalogue() -> Vec<StageEntry> {
    stages::catalogue()
}

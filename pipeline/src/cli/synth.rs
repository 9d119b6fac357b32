//! `magline synth`: simulated flights.

use std::path::Path;

use schemas::Fault;

use super::{ExitReason, progress::ProgressDisplay, say};

/// Writes the flights of a simulation.
pub fn run(spec: &Path, to: &Path, quiet: bool) -> Result<(), ExitReason> {
    let progress = ProgressDisplay::new(quiet);
    progress.stage("simulating flights");
    progress.detail("lines", "");
    let simulation = simulate::Simulation::open(spec).map_err(Fault::from)?;
    progress.set(0, simulation.spec().flights.iter().map(|f| f.lines.len()).sum());
    let written = simulate::synthesise_with(spec, to, &|done, all| progress.set(done, all)).map_err(Fault::from)?;
    drop(progress);
    say(written.iter().map(|p| format!("{}\n", p.display())).collect())
}

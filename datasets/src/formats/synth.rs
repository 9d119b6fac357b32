//! A synth spec as a flight format: reading it simulates, so that nothing large has to be kept.

use std::path::Path;

use super::{FlightFormat, FlightOptions, Head, Part, Raw, Reading};
use crate::{ReadError, simulate::Simulation};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "synth",
    about: "a synth spec: simulated flights with known truth",
    extensions: &["synth.toml"],
    recognise: |head: &Head| head.path.to_string_lossy().ends_with(".synth.toml"),
    open,
};

fn open(path: &Path, _: &FlightOptions, reading: &Reading) -> Result<Raw, ReadError> {
    let simulation = Simulation::open(path)?;
    let schema = simulation.schema();
    let (path, mut done) = (path.to_path_buf(), false);
    let mut lines = simulation.into_lines(reading.threads);
    let parts = std::iter::from_fn(move || {
        if done {
            return None;
        }
        let batch = lines.next()?.and_then(|line| line.into_batch(&path));
        done = batch.is_err();
        Some(batch.map(Part::whole))
    });
    Ok(Raw::new(schema, Box::new(parts)))
}

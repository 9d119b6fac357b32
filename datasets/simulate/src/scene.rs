//! Inputs for simulating a line.

use std::path::Path;

use datasets::ReadError;

use super::{
    random::RandomStream,
    spec::SynthSpec,
    trajectory::{SynthFlight, SynthLine},
};

/// Inputs of the simulation of one line: the spec, the flight and the line.
pub(super) struct SynthLineContext<'a> {
    pub(super) path: &'a Path,
    pub(super) spec: &'a SynthSpec,
    pub(super) flight: &'a SynthFlight,
    pub(super) line: &'a SynthLine,
}

impl SynthLineContext<'_> {
    /// The stream of random numbers of one component of this line.
    pub(super) fn random(&self, what: &str) -> RandomStream {
        RandomStream::new(self.spec.seed, &["line", &self.flight.name, &self.line.name, what])
    }

    /// A fault that names the line.
    pub(super) fn fault(&self, what: String) -> ReadError {
        ReadError::options(self.path, format!("flight {}, line {}: {what}", self.flight.name, self.line.name))
    }
}

//! The inputs of the simulation of a line.

use std::path::Path;

use datasets::ReadError;

use super::{
    random::Random,
    spec::Spec,
    trajectory::{Flight, Line},
};

/// A line to simulate.
pub(super) struct Scene<'a> {
    pub(super) path: &'a Path,
    pub(super) spec: &'a Spec,
    pub(super) flight: &'a Flight,
    pub(super) line: &'a Line,
}

impl Scene<'_> {
    /// The stream of random numbers of one component of this line.
    pub(super) fn random(&self, what: &str) -> Random {
        Random::of(self.spec.seed, &["line", &self.flight.name, &self.line.name, what])
    }

    /// A fault that names the line.
    pub(super) fn fault(&self, what: String) -> ReadError {
        ReadError::options(self.path, format!("flight {}, line {}: {what}", self.flight.name, self.line.name))
    }
}

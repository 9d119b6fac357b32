//! What a computation that takes minutes is given beside its data.

use std::ops::ControlFlow;

/// What a long computation keeps, says and asks while it runs. A point is its place among those that are gathered.
pub trait Work: Sync {
    /// What [`Work::keep`] was given last for a point, by a run that ended before the point did.
    fn kept(&self, point: usize) -> Option<Vec<u8>>;

    /// Keeps the state of a point, in place of the one before. What cannot be kept is lost with the run and with nothing
    /// else.
    fn keep(&self, point: usize, state: &[u8]);

    /// Says how far a point is, in a few words, and returns whether it goes on: it stops when the run is interrupted,
    /// with a fault of the machine.
    fn goes_on(&self, point: usize, progress: &str) -> ControlFlow<()>;
}

/// Keeps nothing, says nothing, and is never interrupted.
pub struct Unattended;

impl Work for Unattended {
    fn kept(&self, _: usize) -> Option<Vec<u8>> {
        None
    }

    fn keep(&self, _: usize, _: &[u8]) {}

    fn goes_on(&self, _: usize, _: &str) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

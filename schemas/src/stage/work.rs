//! Support for long computations: saved state, progress and interruption.

use std::ops::ControlFlow;

/// Saved state, progress and interruption of a long computation. A point is identified by its position among the
/// gathered points.
pub trait CheckpointMonitor: Sync {
    /// The last state that [`CheckpointMonitor::keep`] saved for a point in an interrupted run.
    fn kept(&self, point: usize) -> Option<Vec<u8>>;

    /// Saves the state of a point and replaces its previous state. If saving fails, an interrupted run cannot resume
    /// this point, but results are unaffected.
    fn keep(&self, point: usize, state: &[u8]);

    /// Reports the progress of a point in a few words, and returns whether to continue. After an interrupt, the
    /// computation must end with a fault of the machine.
    fn report_progress(&self, point: usize, progress: &str) -> ControlFlow<()>;
}

/// Monitor without saved state, progress reports or interruption.
pub struct NullMonitor;

impl CheckpointMonitor for NullMonitor {
    fn kept(&self, _: usize) -> Option<Vec<u8>> {
        None
    }

    fn keep(&self, _: usize, _: &[u8]) {}

    fn report_progress(&self, _: usize, _: &str) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

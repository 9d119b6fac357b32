//! Loss functions.

/// Loss of an error e = ŷ − y, averaged over the samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum NetworkLoss {
    /// e².
    #[default]
    Squared,
    /// |e|.
    Absolute,
    /// e²/2 up to |e| = `delta`, linear above: `delta` (|e| − `delta`/2). [Huber 1964]
    Huber {
        /// Error at which the loss becomes linear, in the scale of the target.
        delta: f64,
    },
}

impl NetworkLoss {
    /// The loss of an error, and its derivative.
    #[inline(always)]
    pub(super) fn at(self, error: f64) -> (f64, f64) {
        match self {
            Self::Squared => (error * error, 2.0 * error),
            Self::Absolute => (error.abs(), if error == 0.0 { 0.0 } else { error.signum() }),
            Self::Huber { delta } if error.abs() < delta => (0.5 * error * error, error),
            Self::Huber { delta } => (delta * (error.abs() - 0.5 * delta), delta * error.signum()),
        }
    }
}

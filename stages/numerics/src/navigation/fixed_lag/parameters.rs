//! Parameters of the smoother, and the report on the windows.

use params::{Rule, params};

use crate::navigation::loss::{RobustLoss, TrajectoryLoss};

params! {
    /// Parameters of the smoother.
    pub struct FixedLagParameters, all default;
    /// Length of a window. The map is linearised anew over the window until the solution converges.
    window_s: f64, unit "s", default 300.0, rule Rule::Positive;
    /// Fraction of a window that the next window shares. A window ends every `window_s` × (1 - `overlap`) seconds,
    /// by default 15 s. This interval has more influence than the length of the windows.
    overlap: f64, unit "1", default 0.95, rule Rule::Between(0.0, 0.999);
    /// Maximum delay: the estimate of a sample uses no measurement later than this after the sample. 0 navigates in
    /// real time.
    lag_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Interval over which measurements are averaged into one. 0 uses every sample.
    measurement_interval_s: f64, unit "s", default 1.0, rule Rule::NotNegative;
    /// Loss function of a residual.
    loss: TrajectoryLoss, unit "", default TrajectoryLoss::None;
    /// Residual above which a robust `loss` departs from least squares, in standard deviations of the measurement.
    loss_scale: f64, unit "1", default 2.5, rule Rule::Positive;
    /// Maximum number of iterations per window.
    iterations: usize, unit "", default 15_usize;
    /// A window is solved if one iteration decreases the cost (half a chi-square) by less than this.
    tolerance: f64, unit "1", default 0.01, rule Rule::Positive;
}

impl Copy for FixedLagParameters {}

impl FixedLagParameters {
    /// Time between the ends of windows, in seconds.
    pub fn stride_s(&self) -> f64 {
        self.window_s * (1.0 - self.overlap)
    }

    /// Loss with its scale.
    pub(super) fn robust(&self) -> RobustLoss {
        RobustLoss::new(self.loss, Some(self.loss_scale))
    }
}

/// Report on the solution of a window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WindowReport {
    /// Time of the first and the last node, in seconds.
    pub span_s: [f64; 2],
    /// Number of nodes, the times at which states are solved for.
    pub nodes: usize,
    /// Number of measurements: averages over `measurement_interval_s` of all magnetometers, and coordinates of aiding
    /// positions.
    pub measurements: usize,
    /// Number of Gauss-Newton iterations.
    pub iterations: usize,
    /// Whether the last iteration lowered the cost by less than the tolerance.
    pub converged: bool,
    /// Smallest fraction of a Gauss-Newton step that was taken; 1 if every step was a full step.
    pub smallest_step: f64,
    /// Largest change of a position in the last full step, in metres; infinite after a single step without an initial
    /// path.
    pub last_step_m: f64,
    /// Twice the cost at the solution; without robust loss, a chi-square with one degree of freedom per measurement.
    pub chi_square: f64,
    /// Squared distance of the solution at the window's start from its prior, normalised by the prior's covariance. The
    /// expected value is smaller than for chi-square with `states` degrees of freedom.
    pub prior_chi_square: f64,
    /// Number of states.
    pub states: usize,
    /// Whether the solution contradicts the prior: its chi-square exceeds the quantile for a probability of 1e-6.
    pub inconsistent: bool,
}

impl WindowReport {
    /// Whether a solution contradicts its prior at this distance. [quantile: Wilson & Hilferty 1931]
    pub(super) fn contradicts(prior_chi_square: f64, states: usize) -> bool {
        let freedom = states as f64;
        let spread = 2.0 / (9.0 * freedom);
        let quantile = freedom * (1.0 - spread + 4.753 * spread.sqrt()).powi(3);
        prior_chi_square.is_nan() || prior_chi_square > quantile
    }
}

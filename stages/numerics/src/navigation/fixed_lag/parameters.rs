//! What the smoother is told, and what it says of its windows.

use params::{Rule, params};

use crate::navigation::loss::{Loss, RobustLoss};

params! {
    /// The parameters of the smoother.
    pub struct FixedLagParameters, all default;
    /// Length of a window. Over one window the map is linearised anew until the solution stays.
    window_s: f64, unit "s", default 300.0, rule Rule::Positive;
    /// The part of a window that it shares with the next; the windows end every `window_s` (1 - `overlap`) seconds. How
    /// often they are solved matters more than their length: 15 s by default.
    overlap: f64, unit "1", default 0.95, rule Rule::Between(0.0, 0.999);
    /// The estimate of a sample uses measurements up to this long after it. 0 navigates in real time.
    lag_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// The measurements within so long are averaged into one; 0 takes each by itself.
    measurement_interval_s: f64, unit "s", default 1.0, rule Rule::NotNegative;
    /// What a residual costs.
    loss: Loss, unit "", default Loss::None;
    /// Where `loss` departs from least squares, in standard deviations of the measurement.
    loss_scale: f64, unit "1", default 2.5, rule Rule::Positive;
    /// Most iterations of a window.
    iterations: usize, unit "", default 15_usize;
    /// A window is solved when an iteration lowers its cost (half a chi-square) by less than this.
    tolerance: f64, unit "1", default 0.01, rule Rule::Positive;
}

impl Copy for FixedLagParameters {}

impl FixedLagParameters {
    /// The time between the ends of windows, in s.
    pub fn stride_s(&self) -> f64 {
        self.window_s * (1.0 - self.overlap)
    }

    /// The loss with its scale.
    pub(super) fn robust(&self) -> RobustLoss {
        RobustLoss::new(self.loss, Some(self.loss_scale))
    }
}

/// How a window was solved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WindowReport {
    /// Time of the first and the last node, in s.
    pub span_s: [f64; 2],
    /// The nodes: instants whose states are solved for.
    pub nodes: usize,
    /// The measurements: averages over `measurement_interval_s` of all magnetometers, and coordinates from elsewhere.
    pub measurements: usize,
    /// The iterations of Gauss-Newton.
    pub iterations: usize,
    /// Whether the last one lowered the cost by less than the tolerance.
    pub converged: bool,
    /// The smallest part of a Gauss-Newton step that was taken; 1 where none needed damping.
    pub smallest_step: f64,
    /// How far the last whole step moves a position at the most, in m; infinite where the first step is the only one and has no
    /// path to start from.
    pub last_step_m: f64,
    /// Twice the cost at the solution: without robust loss a chi-square of as many degrees as measurements.
    pub chi_square: f64,
    /// The squared distance of the solution at the window's start from its prior, over the prior's covariance: less
    /// than a chi-square of `states` degrees.
    pub prior_chi_square: f64,
    /// The states.
    pub states: usize,
    /// The prior is contradicted: its chi-square is above the quantile at one in a million.
    pub inconsistent: bool,
}

impl WindowReport {
    /// Whether a distance contradicts a prior. [quantile: Wilson & Hilferty 1931]
    pub(super) fn contradicts(prior_chi_square: f64, states: usize) -> bool {
        let freedom = states as f64;
        let spread = 2.0 / (9.0 * freedom);
        let quantile = freedom * (1.0 - spread + 4.753 * spread.sqrt()).powi(3);
        prior_chi_square.is_nan() || prior_chi_square > quantile
    }
}

//! The settings that models have in common.

use numerics::regression::least_squares::{LineScores, Scaling};
use schemas::choice;

choice! {
    /// How `lambda` or the number of components is found.
    pub enum Choose {
        /// It is given.
        Given = "given",
        /// By generalised cross-validation.
        Gcv = "gcv",
        /// At the corner of the L-curve.
        LCurve = "l_curve",
        /// By leaving each line out in turn.
        LeaveOneLineOut = "leave_one_line_out",
        /// By leaving each flight out in turn, with all its lines.
        LeaveOneFlightOut = "leave_one_flight_out",
    }
}

impl Choose {
    /// Whether lines or flights are left out.
    pub fn leaves_out(self) -> bool {
        matches!(self, Choose::LeaveOneLineOut | Choose::LeaveOneFlightOut)
    }
}

choice! {
    /// Divisor of the columns before they are penalised, as in the spec.
    pub enum Divisor {
        /// Nothing.
        None = "none",
        /// Their standard deviation over n - 1.
        Standardise = "standardise",
        /// Their largest absolute value.
        MaxAbs = "max_abs",
        /// Their largest less their smallest value.
        MinMax = "min_max",
    }
}

impl Divisor {
    /// Type of the numerics for this divisor.
    pub const fn scaling(self) -> Scaling {
        match self {
            Divisor::None => Scaling::None,
            Divisor::Standardise => Scaling::Standardise,
            Divisor::MaxAbs => Scaling::MaxAbs,
            Divisor::MinMax => Scaling::MinMax,
        }
    }
}

/// Kind of data that a model is fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MadeOf {
    /// The moments of the lines, whose factors a whole sweep shares.
    Moments,
    /// The rows themselves.
    Rows,
    /// The rows as they are, unfiltered: the model is not linear, and learns.
    Samples,
}

/// Common settings of most models, with the model's defaults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Divisor of the columns before they are penalised.
    pub scaling: Scaling,
    /// Whether a constant is fitted too.
    pub intercept: bool,
    /// How `lambda` or the number of components is found.
    pub choose: Choose,
    /// Whether the simplest model within one standard error of the best is taken.
    pub one_standard_error: bool,
    /// How many whitened components take the place of the features, or what part of the variance they hold.
    pub whiten: Option<f64>,
}

impl Settings {
    /// Whether columns stand on the same scale in both.
    pub fn same_scale(&self, other: &Settings) -> bool {
        (self.scaling, self.intercept) == (other.scaling, other.intercept)
    }

    /// The place of the solution to take.
    pub fn pick(&self, scores: &LineScores) -> usize {
        if self.one_standard_error { scores.within_one_error } else { scores.best }
    }
}

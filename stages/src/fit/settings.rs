//! Settings that models share.

use numerics::regression::least_squares::{ColumnScaling, LineScores};
use schemas::choice;

choice! {
    /// Method that selects `lambda` or the number of components.
    pub enum ModelSelection {
        /// The given value.
        Given = "given",
        /// Generalised cross-validation.
        Gcv = "gcv",
        /// Corner of the L-curve.
        LCurve = "l_curve",
        /// Cross-validation that omits each line in turn.
        LeaveOneLineOut = "leave_one_line_out",
        /// Cross-validation that omits each flight in turn, with all its lines.
        LeaveOneFlightOut = "leave_one_flight_out",
    }
}

impl ModelSelection {
    /// Returns whether lines or flights are omitted.
    pub fn leaves_out(self) -> bool {
        matches!(self, ModelSelection::LeaveOneLineOut | ModelSelection::LeaveOneFlightOut)
    }
}

choice! {
    /// Scaling of columns before the penalty is applied, with the names used in the spec.
    pub enum Divisor {
        /// No scaling.
        None = "none",
        /// Standard deviation with divisor n - 1.
        Standardise = "standardise",
        /// Largest absolute value.
        MaxAbs = "max_abs",
        /// Largest minus smallest value.
        MinMax = "min_max",
    }
}

impl Divisor {
    /// The same scaling as a value of the crate `numerics`.
    pub const fn scaling(self) -> ColumnScaling {
        match self {
            Divisor::None => ColumnScaling::None,
            Divisor::Standardise => ColumnScaling::Standardise,
            Divisor::MaxAbs => ColumnScaling::MaxAbs,
            Divisor::MinMax => ColumnScaling::MinMax,
        }
    }
}

/// Data to which a model is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitData {
    /// Moments of the lines. All points of a sweep share the factors of these moments.
    Moments,
    /// Filtered rows.
    Rows,
    /// Unfiltered rows: the model is nonlinear and learns from samples.
    Samples,
}

/// Settings that most models have, including the defaults of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitSettings {
    /// Scaling of columns before the penalty is applied.
    pub scaling: ColumnScaling,
    /// Whether a constant is also fitted.
    pub intercept: bool,
    /// Method that selects `lambda` or the number of components.
    pub choose: ModelSelection,
    /// Whether the simplest model within one standard error of the best is selected.
    pub one_standard_error: bool,
    /// Number of whitened components that replace the features; a value below 1 is the fraction of the variance that
    /// they explain.
    pub whiten: Option<f64>,
}

impl FitSettings {
    /// Returns whether two settings have the same scaling of columns and the same `intercept`.
    pub fn same_scale(&self, other: &FitSettings) -> bool {
        (self.scaling, self.intercept) == (other.scaling, other.intercept)
    }

    /// Index of the selected solution.
    pub fn pick(&self, scores: &LineScores) -> usize {
        if self.one_standard_error { scores.within_one_error } else { scores.best }
    }
}

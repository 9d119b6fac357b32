//! Data requested from each line: the columns of a fit, and their filter.

/// Settings that points of a sweep share: the same matrix, filtered in the same way.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DesignMatrixKey {
    /// Columns of the matrix.
    pub features: Vec<String>,
    /// Lower and upper corner in Hz, as the bits of `f64` values, and the order.
    pub filter: (u64, u64, usize),
    /// Number of samples removed at each end of a run.
    pub trim: usize,
}

/// Columns that are fitted together: a single one, or several for partial least squares.
pub type TargetColumns = Vec<String>;

/// Targets of a matrix, with the targets for which rows or errors of coefficients are required.
#[derive(Default)]
pub struct FitRequest {
    /// All targets.
    pub targets: Vec<TargetColumns>,
    /// Targets whose rows are required.
    pub keeps_rows: Vec<TargetColumns>,
    /// Targets for which the errors of coefficients are requested.
    pub wants_errors: Vec<TargetColumns>,
}

//! Request to each line: the columns of a fit, and their filter.

/// Matrix that the points of a sweep share, filtered in the same way.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Matrix {
    /// The columns.
    pub features: Vec<String>,
    /// The bits of the lower and the upper corner in Hz, and the order.
    pub filter: (u64, u64, usize),
    /// Samples left out at each end of a run.
    pub trim: usize,
}

/// Columns that are explained together; one but for partial least squares of several.
pub type Targets = Vec<String>;

/// The targets of a matrix, and those of them whose rows or errors are needed as well.
#[derive(Default)]
pub struct Question {
    /// All of them.
    pub targets: Vec<Targets>,
    /// Those whose rows are needed.
    pub keeps_rows: Vec<Targets>,
    /// Those of which the errors of coefficients are asked for.
    pub wants_errors: Vec<Targets>,
}

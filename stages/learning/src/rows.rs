//! Checks of rows and settings before any computation.

/// Error of rows or of a setting.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RowsError {
    /// A slice has the wrong length for its rows and columns.
    #[error("{what} has {given} entries, but {expected} are required")]
    Shape {
        /// Name of the argument.
        what: &'static str,
        /// Given number of entries.
        given: usize,
        /// Required number of entries.
        expected: usize,
    },
    /// A value is NaN or infinite.
    #[error("the value in row {row}, column {column} of {what} is not finite; remove such rows")]
    NotFinite {
        /// Name of the argument.
        what: &'static str,
        /// The row, from 0.
        row: usize,
        /// The column, from 0.
        column: usize,
    },
    /// There are no rows, or no columns.
    #[error("{what} has no values")]
    Empty {
        /// Name of the argument.
        what: &'static str,
    },
    /// A setting is out of range.
    #[error("{what} must be {wanted}, but is {given}")]
    Setting {
        /// The setting.
        what: &'static str,
        /// Permitted values.
        wanted: &'static str,
        /// The given value.
        given: f64,
    },
}

/// The number of rows of `x`, of `width` columns each. Fails for values that are not finite.
pub(crate) fn finite_rows(what: &'static str, x: &[f64], width: usize) -> Result<usize, RowsError> {
    if x.is_empty() || width == 0 {
        return Err(RowsError::Empty { what });
    }
    let rows = x.len() / width;
    if rows * width != x.len() {
        return Err(RowsError::Shape { what, given: x.len(), expected: rows.max(1) * width });
    }
    match x.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(RowsError::NotFinite { what, row: at / width, column: at % width }),
        None => Ok(rows),
    }
}

/// Checks that `values` has `expected` entries.
pub(crate) fn entries(what: &'static str, values: usize, expected: usize) -> Result<(), RowsError> {
    if values == expected { Ok(()) } else { Err(RowsError::Shape { what, given: values, expected }) }
}

/// Checks a setting: fails unless it `fits`.
pub(crate) fn setting(what: &'static str, given: f64, wanted: &'static str, fits: bool) -> Result<(), RowsError> {
    if fits { Ok(()) } else { Err(RowsError::Setting { what, wanted, given }) }
}

/// The sum of f(i) over `0..count`: in order within blocks of rows, then in order over the blocks.
pub(crate) fn sum_of(count: usize, value: impl Fn(usize) -> f64) -> f64 {
    const BLOCK: usize = 1024;
    let block = |k: usize| (k * BLOCK..count.min((k + 1) * BLOCK)).map(&value).sum::<f64>();
    (0..count.div_ceil(BLOCK)).map(block).sum()
}

//! Checks of rows and settings before a computation.

/// Error in rows or in a setting.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RowsError {
    /// A slice has not as many entries as its rows and columns say.
    #[error("{what} has {given} entries, but {expected} are needed")]
    Shape {
        /// Which argument.
        what: &'static str,
        /// The number of its entries.
        given: usize,
        /// The number of entries needed.
        expected: usize,
    },
    /// A value is NaN or infinite.
    #[error("the value in row {row}, column {column} of {what} is not finite: leave such rows out")]
    NotFinite {
        /// Which argument.
        what: &'static str,
        /// The row, from 0.
        row: usize,
        /// The column, from 0.
        column: usize,
    },
    /// There are no rows, or no columns.
    #[error("{what} has no values")]
    Empty {
        /// Which argument.
        what: &'static str,
    },
    /// A setting is out of range.
    #[error("{what} must be {wanted}, but is {given}")]
    Setting {
        /// The setting.
        what: &'static str,
        /// Required value.
        wanted: &'static str,
        /// The given value.
        given: f64,
    },
}

/// The number of rows of `x`, of `width` columns each.
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

/// Fails unless `values` has `expected` entries.
pub(crate) fn entries(what: &'static str, values: usize, expected: usize) -> Result<(), RowsError> {
    if values == expected { Ok(()) } else { Err(RowsError::Shape { what, given: values, expected }) }
}

/// Fails unless the setting `fits`.
pub(crate) fn setting(what: &'static str, given: f64, wanted: &'static str, fits: bool) -> Result<(), RowsError> {
    if fits { Ok(()) } else { Err(RowsError::Setting { what, wanted, given }) }
}

/// The sum of f(i) over `0..count`: within blocks of rows in their order, and over the blocks in theirs.
pub(crate) fn sum_of(count: usize, value: impl Fn(usize) -> f64) -> f64 {
    const BLOCK: usize = 1024;
    let block = |k: usize| (k * BLOCK..count.min((k + 1) * BLOCK)).map(&value).sum::<f64>();
    (0..count.div_ceil(BLOCK)).map(block).sum()
}

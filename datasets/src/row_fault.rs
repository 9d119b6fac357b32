//! Faults of single rows of a file.

use crate::ReadError;

/// The fault of one row.
#[derive(Clone, Debug)]
pub struct RowFault {
    /// The row of the batch, from 0.
    pub row: usize,
    /// The fault, which includes the row number in the file.
    pub fault: ReadError,
}

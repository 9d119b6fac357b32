//! An open log.

use arrow_schema::SchemaRef;
use datasets::{
    FlightBatch, ReadError,
    formats::{FlightBatches, FlightInputLister},
};

/// An open log with the column names of the flight table, from its format or through a mapping.
pub struct LogReader {
    /// The name of the log's format.
    pub format: &'static str,
    /// The schema of every batch; metadata `unit` is the unit of the values.
    pub schema: SchemaRef,
    /// Notes for the user on the whole file.
    pub notes: Vec<String>,
    /// The result of scanning the whole file, for `ReadHints::found`.
    pub found: Option<String>,
    /// Returns the inputs of the flight, if its file is not the only input.
    pub made_from: Option<FlightInputLister>,
    /// The rows.
    pub parts: FlightBatches,
}

impl LogReader {
    /// The next rows, with the faults of single rows.
    pub fn next_part(&mut self) -> Option<Result<FlightBatch, ReadError>> {
        self.parts.next()
    }
}

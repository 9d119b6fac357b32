//! Intake of flights: files of any logger become lines of the flight table.
//!
//! [`mapping`] relates the columns of a log to those of the flight table, [`find_lines`] divides a flight into lines,
//! and [`checks`] and [`quality`] report the oddities of the data.

pub mod assemble;
pub mod checks;
pub mod clock_digits;
mod consistency;
pub mod find_lines;
mod finding;
pub mod formats;
pub mod in_order;
pub mod line_table;
pub mod log_reader;
pub mod mapping;
pub mod midnight;
pub mod quality;
mod renamed;

pub use formats::{flight_formats, open_flight, open_log};
pub use line_table::{FlightDivision, LineTable};
pub use log_reader::LogReader;
pub use quality::{Finding, FindingKind};

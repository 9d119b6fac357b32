//! The flight formats that are read: those of files, and synth specs.

use std::{path::Path, sync::LazyLock};

use datasets::{
    FlightOptions, FlightReader, ReadError, Reading,
    formats::{self, FlightFormat},
    open_flight_among,
};

static FORMATS: LazyLock<Vec<FlightFormat>> = LazyLock::new(|| formats::flight_formats(&[simulate::FORMAT]));

/// The flight formats, in the order in which a file is tried.
pub fn flight_formats() -> &'static [FlightFormat] {
    &FORMATS
}

/// Opens a flight log, or a synth spec as one.
///
/// # Errors
/// Fails as [`datasets::open_flight`].
pub fn open_flight(path: &Path, options: &FlightOptions, reading: &Reading) -> Result<FlightReader, ReadError> {
    open_flight_among(flight_formats(), path, options, reading)
}

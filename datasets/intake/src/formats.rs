//! The supported flight formats: file formats and synth specs.

use std::{path::Path, sync::LazyLock};

use datasets::{
    FlightOptions, FlightReader, ReadError, ReadHints,
    formats::{self, FlightFormat},
    open_flight_among,
};

use super::{log_reader::LogReader, mapping::MappingTable, renamed::renamed};

static FORMATS: LazyLock<Vec<FlightFormat>> = LazyLock::new(|| formats::flight_formats(&[simulate::FORMAT]));

/// The flight formats, in the order in which they are tried.
pub fn flight_formats() -> &'static [FlightFormat] {
    &FORMATS
}

/// Opens a flight log, or a synth spec whose simulated flight is read like a log.
///
/// # Errors
/// Returns the errors of [`datasets::open_flight`].
pub fn open_flight(path: &Path, options: &FlightOptions, reading: &ReadHints) -> Result<FlightReader, ReadError> {
    open_flight_among(flight_formats(), path, options, reading)
}

/// Opens a log, through the mapping `mapped` if it is given. With a mapping, the options rename columns of the mapping.
///
/// # Errors
/// Returns the errors of [`open_flight`]. Also fails for a mapping that does not fit the file, or for a wrong new name.
pub fn open_log(
    path: &Path,
    options: &FlightOptions,
    mapped: Option<&MappingTable>,
    reading: &ReadHints,
) -> Result<LogReader, ReadError> {
    if let Some(mapped) = mapped {
        let log = mapped.open(path, options, reading, flight_formats())?;
        return renamed(log, path, &options.rename);
    }
    let mut reader = open_flight(path, options, reading)?;
    Ok(LogReader {
        format: reader.format(),
        schema: reader.schema().clone(),
        notes: reader.notes().to_vec(),
        found: reader.found().map(str::to_owned),
        made_from: reader.made_from(),
        parts: Box::new(std::iter::from_fn(move || reader.next_part())),
    })
}

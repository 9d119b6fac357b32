//! The tables of a log with several tables: their list, the choice of one, and its rows with the file's names.

use std::path::Path;

use super::{
    FLIGHT_FORMATS, FlightFormat, FlightOptions, FlightReader, ReadHints, adopt, format_of, open_format, reader,
};
use crate::ReadError;

/// A table of a file: a message of a log, an array or a structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogTopic {
    /// Name in [`FlightOptions::topic`]; empty for a format with one table.
    pub name: String,
    /// Number of rows.
    pub rows: u64,
    /// Columns, in the file's order.
    pub columns: Vec<TopicColumn>,
    /// The reason why a topic has no rows; empty if it has rows.
    pub note: String,
}

/// A column of a table of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicColumn {
    /// Name of the column in the file.
    pub name: String,
    /// The unit of its values; empty if the file gives none.
    pub unit: String,
    /// The description in the file, or the general meaning of the name.
    pub description: String,
}

/// The rows of one table of a file, with the file's names ([`open_raw`]).
///
/// Formats with a known meaning of columns (the SGL surveys, MagNav.jl, survey points) give them canonical names and
/// units.
pub type RawReader = FlightReader;

/// The tables of a file. A format with one table gives one [`LogTopic`] with an empty name, whose rows are counted by
/// reading.
///
/// # Errors
/// Fails for a file that is missing, empty, unreadable or in no known format.
pub fn topics(path: &Path, options: &FlightOptions) -> Result<Vec<LogTopic>, ReadError> {
    topics_among(FLIGHT_FORMATS, path, options)
}

/// Same as [`topics`], but tries only `formats`, such as those of [`flight_formats`](super::flight_formats).
///
/// # Errors
/// Fails in the cases of [`topics`].
pub fn topics_among(
    formats: &[FlightFormat],
    path: &Path,
    options: &FlightOptions,
) -> Result<Vec<LogTopic>, ReadError> {
    let format = format_of(formats, path, options)?;
    if let Some(list) = format.topics {
        return list(path, options);
    }
    let mut reader = open_raw_among(&[format], path, options, &ReadHints::default())?;
    let column = |f: &arrow_schema::Field| {
        let metadata_of = |key: &str| f.metadata().get(key).cloned().unwrap_or_default();
        TopicColumn { name: f.name().clone(), unit: metadata_of("unit"), description: metadata_of("description") }
    };
    let columns = reader.schema().fields().iter().map(|f| column(f)).collect();
    let mut rows = 0;
    while let Some(part) = reader.next_part() {
        rows += part?.batch.num_rows() as u64;
    }
    Ok(vec![LogTopic { name: String::new(), rows, columns, note: String::new() }])
}

/// Opens one table of a file with the file's names, without the flight and line that
/// [`open_flight`](super::open_flight) requires. The metadata `unit` of each field is the unit in the file. The options
/// `rename`, `units`, `flight` and `line` are ignored; markers of missing values apply.
///
/// # Errors
/// Fails for a file that is missing, empty, unreadable or in no known format, or for a file of several tables if
/// `topic` does not name one of them.
pub fn open_raw(path: &Path, options: &FlightOptions, reading: &ReadHints) -> Result<RawReader, ReadError> {
    open_raw_among(FLIGHT_FORMATS, path, options, reading)
}

/// Same as [`open_raw`], but tries only `formats`, such as those of [`flight_formats`](super::flight_formats).
///
/// # Errors
/// Fails in the cases of [`open_raw`].
pub fn open_raw_among(
    formats: &[FlightFormat],
    path: &Path,
    options: &FlightOptions,
    reading: &ReadHints,
) -> Result<RawReader, ReadError> {
    let (format, raw) = open_format(formats, path, options, reading)?;
    Ok(reader(format, adopt::without_fillers(path, raw, options)))
}

/// The position of the table named in the options; by default the only table.
///
/// `tables` are names and row counts; `asked` is the name in the format's spelling.
///
/// # Errors
/// Fails for an unknown name, or for several tables without a name; the error lists them.
pub(super) fn chosen(path: &Path, asked: Option<&str>, tables: &[(String, u64)]) -> Result<usize, ReadError> {
    let names: Vec<&str> = tables.iter().map(|(name, _)| name.as_str()).collect();
    match (asked, tables) {
        (_, []) => Err(ReadError::data(path, "the file holds no table")),
        (None, [_]) => Ok(0),
        (None, _) => {
            let what = format!("the file holds {} tables; set `topic` to one of them", tables.len());
            Err(ReadError::options(path, what)
                .help(format!("the topics and their numbers of rows: {}", listed(tables))))
        }
        (Some(name), _) => names
            .iter()
            .position(|n| *n == name)
            .ok_or_else(|| ReadError::options(path, format!("the file holds no topic `{name}`")).nearest(name, &names)),
    }
}

/// Names of tables, each with its number of rows.
pub(super) fn listed(tables: &[(String, u64)]) -> String {
    let one = |(name, rows): &(String, u64)| format!("{name} ({rows})");
    tables.iter().map(one).collect::<Vec<_>>().join(", ")
}

//! The contract of a format: an open file as a reader of rows, and the declarations of flight and map formats.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use grids::{AnomalyGrid, LineType};

use super::{FileHead, FlightOptions, LogTopic, MapOptions, RowFault, output::MapOutputFiles};
use crate::ReadError;

/// Hints for reading a flight log that do not affect the result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadHints {
    /// The result of [`FlightReader::found`] for the same file and options: the file is then not scanned again. If the
    /// file has changed since, the values are wrong.
    pub found: Option<String>,
    /// The number of threads of the pool that may work on the file in parallel.
    pub threads: usize,
}

impl Default for ReadHints {
    fn default() -> ReadHints {
        ReadHints { found: None, threads: 1 }
    }
}

/// An open flight log: its schema, and its rows in the file's order.
///
/// Columns have canonical names ([`open_flight`]) or the file's names ([`open_raw`]); each field's metadata `unit` is
/// the unit of its values, which `schemas::canonical` converts. A missing number is NaN or null.
pub struct FlightReader {
    pub(super) format: FlightFormat,
    pub(super) schema: SchemaRef,
    pub(super) notes: Vec<String>,
    pub(super) found: Option<String>,
    pub(super) line_types: BTreeMap<String, LineType>,
    pub(super) parts: FlightBatches,
}

/// Some rows of a flight, and the faults of single rows.
#[derive(Clone, Debug)]
pub struct FlightBatch {
    /// The rows. An unreadable value is missing. A row that cannot be split into columns has only missing values, and
    /// the flight and line of the row before.
    pub batch: RecordBatch,
    /// The faults, in the order of the rows.
    pub faults: Vec<RowFault>,
}

impl FlightBatch {
    /// Rows without faults.
    pub fn whole(batch: RecordBatch) -> FlightBatch {
        FlightBatch { batch, faults: vec![] }
    }
}

/// Iterator over the rows of a file, in batches.
pub type FlightBatches = Box<dyn Iterator<Item = Result<FlightBatch, ReadError>> + Send>;

/// Output of a format, before names and keys are assigned.
pub struct RawFlight {
    /// The schema of every batch.
    pub schema: SchemaRef,
    /// The rows.
    pub parts: FlightBatches,
    /// The names of the columns in the file, if the format has already set names and units.
    pub own: Option<Vec<String>>,
    /// Whether the values still contain numbers that mark missing values.
    pub fillers: bool,
    /// Whether a column without a unit may be in any unit, even if its name is a standard name. For example, `lat` of
    /// an autopilot is in 1e-7 degrees.
    pub unstated: bool,
    /// Notes for the user.
    pub notes: Vec<String>,
    /// The result of scanning the whole file.
    pub found: Option<String>,
    /// The types of the lines by their names, if the file gives them.
    pub line_types: BTreeMap<String, LineType>,
}

impl RawFlight {
    /// Columns under the file's own names.
    pub fn new(schema: SchemaRef, parts: FlightBatches) -> RawFlight {
        RawFlight {
            schema,
            parts,
            own: None,
            fillers: false,
            unstated: false,
            notes: vec![],
            found: None,
            line_types: BTreeMap::new(),
        }
    }
}

impl FlightReader {
    /// Name of the file's format.
    pub fn format(&self) -> &'static str {
        self.format.name
    }

    /// The function that lists the inputs of the flight, if its file is not the only input.
    pub fn made_from(&self) -> Option<FlightInputLister> {
        self.format.made_from
    }

    /// The schema of every batch.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// Notes for the user on the whole file.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The result of scanning the whole file when it was opened, for [`ReadHints::found`]; `None` if no scan was
    /// needed.
    pub fn found(&self) -> Option<&str> {
        self.found.as_deref()
    }

    /// The types of the lines by their names, if the file gives them, as in Geosoft's line records.
    pub fn line_types(&self) -> &BTreeMap<String, LineType> {
        &self.line_types
    }

    /// The next rows, with the faults of single rows, for a caller that tolerates them.
    ///
    /// # Errors
    /// Fails for damage after which reading cannot continue.
    pub fn next_part(&mut self) -> Option<Result<FlightBatch, ReadError>> {
        self.parts.next()
    }
}

/// Batches of valid rows: the first fault is an error.
impl Iterator for FlightReader {
    type Item = Result<RecordBatch, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let part = self.next_part()?;
        Some(part.and_then(|part| match part.faults.into_iter().next() {
            Some(wrong) => Err(wrong.fault),
            None => Ok(part.batch),
        }))
    }
}

impl std::fmt::Debug for FlightReader {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("FlightReader").field("format", &self.format.name).field("schema", &self.schema).finish()
    }
}

/// Input files of a flight that is computed from a spec, and its number of lines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlightInputs {
    /// The files that its values depend on, the spec first.
    pub files: Vec<PathBuf>,
    /// The number of lines.
    pub lines: usize,
}

/// Function that lists the topics of a file.
pub type TopicLister = fn(&Path, &FlightOptions) -> Result<Vec<LogTopic>, ReadError>;

/// Function that lists the inputs of a computed flight.
pub type FlightInputLister = fn(&Path) -> Result<FlightInputs, ReadError>;

/// A flight format: its name, recognition and opening.
#[derive(Clone, Copy)]
pub struct FlightFormat {
    /// The name for [`FlightOptions::format`].
    pub name: &'static str,
    /// Short description.
    pub about: &'static str,
    /// File extensions.
    pub extensions: &'static [&'static str],
    /// Whether a file is of this format, by its start.
    pub recognise: fn(&FileHead) -> bool,
    /// Opens a file.
    pub open: fn(&Path, &FlightOptions, &ReadHints) -> Result<RawFlight, ReadError>,
    /// The tables of a file, for a format whose files hold several tables; `None` for other formats.
    pub topics: Option<TopicLister>,
    /// The inputs of a flight that is computed from a file. Listing them takes far less time than reading.
    pub made_from: Option<FlightInputLister>,
}

/// Function that lists the other files of a map.
type CompanionFileLister = fn(&Path) -> Result<Vec<PathBuf>, ReadError>;

/// Function that writes a map to its files.
type MapWriter = fn(&AnomalyGrid, &mut MapOutputFiles) -> Result<(), ReadError>;

/// A map format: its name, recognition, reading and writing.
pub struct MapFormat {
    /// The name for [`MapOptions::format`].
    pub name: &'static str,
    /// Short description.
    pub about: &'static str,
    /// File extensions.
    pub extensions: &'static [&'static str],
    pub(super) recognise: fn(&FileHead) -> bool,
    /// The companion files of a map, for a format that may have some.
    pub(super) companions: Option<CompanionFileLister>,
    pub(super) read: fn(&Path, &MapOptions) -> Result<AnomalyGrid, ReadError>,
    pub(super) write: Option<MapWriter>,
}

//! The input and output of magline: foreign formats and the embedded samples.
//!
//! The content or name of a file identifies its format. A flight is read as batches with canonical column names
//! ([`open_flight`]) or the file's names ([`open_raw`]). A map is read as an even grid in its coordinates
//! ([`read_grid`]) or in latitude and longitude ([`read_map`]), and can be written in any of a dozen formats
//! ([`write_grid`]). Survey points are read from any table ([`read_points`]). Other crates can add flight formats
//! ([`formats::flight_formats`]), as the simulator does.

pub mod formats;
mod grid;
pub mod mappings;
pub mod motion;
mod row_fault;
pub mod row_groups;
pub mod samples;
pub mod table;

/// Version of the readers and the simulator, part of the key of their cached results. It is increased when the values
/// for the same bytes change.
pub const VERSION: &str = "9";

pub use formats::{
    FlightBatch, FlightOptions, FlightReader, LogTopic, MapOptions, MapTable, PointOptions, RawReader, ReadHints,
    RowFault, SurveyPointSet, TopicColumn, check_output, doubts, flight_format_of, has_map_extension, map_files,
    map_gives_error, open_flight, open_flight_among, open_flight_with, open_raw, open_raw_among, read_grid, read_map,
    read_points, topics, topics_among, write_grid,
};
pub use grid::coordinate_factor;
pub use grids::{
    AnomalyGrid, Crs, GridHeight, LineType, MapSummary, ReadError, Registration, SummaryValue, geographic,
};

//! The input and output of magline: foreign formats and the embedded samples.
//!
//! A flight, in any format that is known by its content or its name, becomes batches with the
//! contract's column names ([`open_flight`]), or keeps the file's own ([`open_raw`]); a map becomes an even grid in its own coordinates
//! ([`read_grid`]) or of latitude and longitude ([`read_map`]), and can be written in any of a dozen
//! formats ([`write_grid`]); survey points come from any table ([`read_points`]). Other crates may add flight
//! formats ([`formats::flight_formats`]), as that of the simulator does.

pub mod formats;
mod grid;
pub mod mappings;
pub mod motion;
mod row_fault;
pub mod row_groups;
pub mod samples;
pub mod table;

/// Changes whenever a reader or the simulator computes other values from the same bytes: part of the key of
/// their cached results.
pub const VERSION: &str = "7";

pub use formats::{
    FlightOptions, FlightReader, MapOptions, MapTable, Part, PointOptions, RawReader, Reading, RowFault, SurveyPoints,
    Topic, TopicColumn, check_output, doubts, map_files, map_gives_error, open_flight, open_flight_among,
    open_flight_with, open_raw, open_raw_among, read_grid, read_map, read_points, topics, topics_among, write_grid,
};
pub use grids::{AnomalyGrid, Crs, Figure, Height, MapSummary, ReadError, Registration, geographic};

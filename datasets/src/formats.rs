//! Foreign formats, one source file each, and the selection of a format for a file.
//!
//! The name in the options selects the format, otherwise the content of the file, otherwise its extension. Damage is
//! therefore reported by the reader of the file's format.

use std::path::{Path, PathBuf};

use crate::ReadError;
pub use crate::row_fault::RowFault;
use grids::AnomalyGrid;

mod adopt;
mod contract;
mod csv;
mod dataflash;
mod decimal;
mod declination;
mod foreign;
mod geosoft_xyz;
mod geotiff_band;
mod geotiff_keys;
mod geotiff_metadata;
mod grid_bytes;
mod guarded;
mod hdf5;
mod hdf5_early;
mod head;
mod iaga2002;
mod imf;
mod limits;
mod line_records;
mod magnav;
mod magnav_csv;
mod magnav_hdf5;
mod map_emag2_csv;
mod map_ers;
mod map_esri;
mod map_geosoft;
mod map_geotiff;
mod map_geotiff_write;
mod map_gxf;
mod map_magnav;
mod map_magnav_csv;
mod map_magnav_hdf5;
mod map_magnav_write;
mod map_netcdf;
mod map_parquet;
mod map_surfer6;
mod map_surfer7;
mod map_surfer_text;
mod map_xyz;
mod mat;
mod mfam;
mod missing;
mod netcdf_values;
mod netcdf_write;
mod observatory;
mod observatory_components;
mod options;
mod output;
mod parquet;
mod points;
mod points_flight;
mod points_table;
mod records;
mod sgl;
mod sgl_hdf5;
mod sgl_xyz;
pub(crate) mod side_files;
mod stream;
mod text_end;
mod text_table;
mod tiff_directories;
mod topics;
mod ulog;
mod unit_name;

pub use adopt::{name_of_head, unit_of_name};
pub use contract::{
    FlightBatch, FlightBatches, FlightFormat, FlightInputLister, FlightInputs, FlightReader, MapFormat, RawFlight,
    ReadHints, TopicLister,
};
pub use grids::{MapTable, ReductionColumns, SurveyPointSet};
pub(crate) use guarded::guarded;
pub use head::FileHead;
pub use iaga2002::{ObservatoryRecord, read_iaga2002};
pub use imf::read_imf;
pub(crate) use options::markers;
pub use options::{FlightOptions, MapOptions};
pub use output::{check_output, write_grid};
pub use points::{PointOptions, doubts, read_points};
pub use topics::{LogTopic, RawReader, TopicColumn, open_raw, open_raw_among, topics, topics_among};

/// The flight formats of files, in the order in which they are tried.
pub const FLIGHT_FORMATS: &[FlightFormat] = &[
    parquet::FORMAT,
    ulog::FORMAT,
    dataflash::FORMAT,
    mat::FORMAT,
    sgl_hdf5::FORMAT,
    magnav_hdf5::FORMAT,
    geosoft_xyz::FORMAT,
    sgl_xyz::FORMAT,
    magnav_csv::FORMAT,
    iaga2002::FORMAT,
    imf::FORMAT,
    mfam::FORMAT,
    csv::FORMAT,
    points_flight::FORMAT,
];

/// The formats of files and the `further` formats, in the order in which they are tried. The `further` formats come
/// after Parquet, whose files are self-describing, and before the formats that are recognised by their text.
pub fn flight_formats(further: &[FlightFormat]) -> Vec<FlightFormat> {
    let (parquet, others) = FLIGHT_FORMATS.split_at(1);
    [parquet, further, others].concat()
}

/// The map formats, in the order in which they are tried.
pub const MAP_FORMATS: &[MapFormat] = &[
    map_parquet::FORMAT,
    map_geotiff::FORMAT,
    map_magnav_hdf5::FORMAT,
    mat::map::FORMAT,
    map_netcdf::FORMAT,
    map_surfer7::FORMAT,
    map_surfer6::FORMAT,
    map_surfer_text::FORMAT,
    map_geosoft::FORMAT,
    map_gxf::FORMAT,
    map_ers::FORMAT,
    map_esri::FORMAT,
    map_magnav_csv::FORMAT,
    map_emag2_csv::FORMAT,
    map_xyz::FORMAT,
];

/// Opens a flight log.
///
/// # Errors
/// Fails for a file that is missing, empty, damaged or in no known format, or for options that do not fit the file. The
/// reader returns later faults of the file.
pub fn open_flight(path: &Path, options: &FlightOptions) -> Result<FlightReader, ReadError> {
    open_flight_with(path, options, &ReadHints::default())
}

/// Same as [`open_flight`], with hints.
///
/// # Errors
/// Fails in the cases of [`open_flight`].
pub fn open_flight_with(path: &Path, options: &FlightOptions, reading: &ReadHints) -> Result<FlightReader, ReadError> {
    open_flight_among(FLIGHT_FORMATS, path, options, reading)
}

/// Same as [`open_flight_with`], but tries only `formats`, such as those of [`flight_formats`].
///
/// # Errors
/// Fails in the cases of [`open_flight`].
pub fn open_flight_among(
    formats: &[FlightFormat],
    path: &Path,
    options: &FlightOptions,
    reading: &ReadHints,
) -> Result<FlightReader, ReadError> {
    let (format, raw) = open_format(formats, path, options, reading)?;
    Ok(reader(format, adopt::adopt(path, raw, options)?))
}

/// The format of a file, and its rows before names and keys are assigned.
fn open_format(
    formats: &[FlightFormat],
    path: &Path,
    options: &FlightOptions,
    reading: &ReadHints,
) -> Result<(FlightFormat, RawFlight), ReadError> {
    let format = format_of(formats, path, options)?;
    if options.topic.is_some() && format.topics.is_none() {
        let what = format!("a file of the format `{}` is one table, without topics", format.name);
        return Err(ReadError::options(path, what).help("remove `topic`"));
    }
    let raw = (format.open)(path, options, reading)?;
    limits::check_columns(path, raw.schema.fields().len())?;
    Ok((format, raw))
}

/// The name of the format of a flight log.
///
/// # Errors
/// Fails for a file that is missing, empty or in no known format.
pub fn flight_format_of(
    formats: &[FlightFormat],
    path: &Path,
    options: &FlightOptions,
) -> Result<&'static str, ReadError> {
    format_of(formats, path, options).map(|format| format.name)
}

/// The format of a file.
fn format_of(formats: &[FlightFormat], path: &Path, options: &FlightOptions) -> Result<FlightFormat, ReadError> {
    let head = FileHead { rename: Some(&options.rename), ..FileHead::read(path)? };
    let entries: Vec<_> = formats.iter().map(|f| FormatCandidate::new(f.name, f.extensions, f.recognise)).collect();
    let chosen = choose(&head, options.format.as_deref(), &entries, "flight")?;
    Ok(formats[chosen])
}

fn reader(format: FlightFormat, raw: RawFlight) -> FlightReader {
    let RawFlight { schema, notes, found, parts, line_types, .. } = raw;
    FlightReader { format, schema, notes, found, line_types, parts }
}

/// Reads a map and resamples it to a regular grid of latitude and longitude.
///
/// # Errors
/// Fails for a file that is missing, empty, damaged or in no known format, a grid that is not regular, or a height or
/// coordinate system that neither the file nor the options give.
pub fn read_map(path: &Path, options: &MapOptions) -> Result<MapTable, ReadError> {
    read_grid(path, options)?.to_geographic()
}

/// Reads a map on its native grid, for any coordinates: rows from the south, columns from the west, in nT.
///
/// # Errors
/// Fails in the cases of [`read_map`].
pub fn read_grid(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let head = FileHead::read(path)?;
    let entries: Vec<_> = MAP_FORMATS.iter().map(|f| FormatCandidate::new(f.name, f.extensions, f.recognise)).collect();
    let chosen = choose(&head, options.format.as_deref(), &entries, "map")?;
    let format = &MAP_FORMATS[chosen];
    let map = (format.read)(path, options)?;
    Ok(AnomalyGrid { format: format.name, ..map })
}

/// Whether a map's file, such as Parquet, has a column with the error of each node ([`schemas::map::ERROR`]).
pub fn map_gives_error(path: &Path, options: &MapOptions) -> bool {
    let parquet = map_parquet::FORMAT;
    let chosen = || FileHead::read(path).is_ok_and(|head| (parquet.recognise)(&head));
    options.format.as_deref().map_or_else(chosen, |format| format == parquet.name) && map_parquet::gives_error(path)
}

/// The files of a map: the map's file, or all files of the map's folder, and companion files with values or the
/// coordinate system.
///
/// # Errors
/// Fails for a header that cannot be read.
pub fn map_files(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let mut files = vec![path.to_path_buf()];
    if path.is_dir() {
        return Ok(files);
    }
    files.extend(side_files::existing(path));
    let head = FileHead::read(path)?;
    for format in MAP_FORMATS {
        if let Some(companions) = format.companions.filter(|_| (format.recognise)(&head)) {
            files.extend(companions(path)?);
        }
    }
    Ok(files)
}

/// Whether the extension of a file belongs to a map format and to no flight format.
pub fn has_map_extension(path: &Path) -> bool {
    let ends = |extensions| has_extension(path, extensions);
    MAP_FORMATS.iter().any(|f| ends(f.extensions)) && !FLIGHT_FORMATS.iter().any(|f| ends(f.extensions))
}

/// Whether the name of a file ends with one of these extensions, in upper or lower case.
fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let lower = path.to_string_lossy().to_ascii_lowercase();
    extensions.iter().any(|e| lower.ends_with(&format!(".{e}")))
}

struct FormatCandidate {
    name: &'static str,
    extensions: &'static [&'static str],
    recognise: fn(&FileHead) -> bool,
}

impl FormatCandidate {
    fn new(name: &'static str, extensions: &'static [&'static str], recognise: fn(&FileHead) -> bool) -> Self {
        Self { name, extensions, recognise }
    }
}

/// The index of the format to use, or an error that lists the known formats.
fn choose(head: &FileHead, named: Option<&str>, known: &[FormatCandidate], kind: &str) -> Result<usize, ReadError> {
    let names: Vec<&str> = known.iter().map(|c| c.name).collect();
    if let Some(name) = named {
        let found = known.iter().position(|c| c.name == name).ok_or_else(|| {
            ReadError::options(head.path, format!("there is no {kind} format `{name}`")).nearest(name, &names)
        })?;
        let foreign = foreign::refused(head).filter(|_| !(known[found].recognise)(head));
        return foreign.map_or(Ok(found), Err);
    }
    let by_extension = |c: &FormatCandidate| has_extension(head.path, c.extensions);
    let recognised = known.iter().position(|c| (c.recognise)(head));
    // A text file in another format may resemble a table of numbers.
    if let Some(foreign) = foreign::refused(head) {
        return Err(foreign);
    }
    let found = recognised.or_else(|| known.iter().position(by_extension));
    found.ok_or_else(|| {
        ReadError::data(head.path, format!("is not in a known {kind} format"))
            .help(format!("known here: {}; choose one with `format`", names.join(", ")))
    })
}

#[cfg(test)]
mod bomb_tests;
#[cfg(test)]
mod log_tests;
#[cfg(test)]
mod map_damage_tests;
#[cfg(test)]
mod map_public_tests;
#[cfg(test)]
mod map_tests;
#[cfg(test)]
mod raster_files;
#[cfg(test)]
mod raster_tests;
#[cfg(test)]
mod tests;

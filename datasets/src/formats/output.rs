//! Writing maps: each file is written under a temporary name and renamed when complete.

use std::{
    fs::{self, File, OpenOptions},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use super::{MAP_FORMATS, MapFormat, has_extension, side_files::refuse_stale};
use crate::ReadError;
use grids::AnomalyGrid;

/// Writes a map, in the given format or the format of the path's extension. An existing file is replaced when the new
/// file is complete; no partial file is left.
///
/// Values are in nT, or in the unit of a derivative if the format can store it. Unknown nodes have the format's own
/// marker. Notes are not stored. Formats store, in addition to the values:
///
/// | format | stored |
/// |---|---|
/// | `parquet`, `netcdf`, `xyz` | the coordinate system and the height, varying or not |
/// | `magnav_hdf5` | the height; WGS-84 degrees only |
/// | `geotiff` | the coordinate system, the registration and a level height |
/// | `gxf`, `er_mapper`, `esri_ascii` (in a `.prj` file) | the coordinate system |
/// | `surfer7`, `surfer6` (in single precision), `surfer6_text` | neither |
///
/// # Errors
/// Fails if the format is unknown, cannot be written, cannot store the map, or is not determined by the extension; also
/// for a path that cannot be written.
pub fn write_grid(path: &Path, map: &AnomalyGrid, format: Option<&str>) -> Result<(), ReadError> {
    let chosen = writer_for(path, format)?;
    let Some(write) = chosen.write else {
        return Err(not_written(path, chosen.name));
    };
    refuse_stale(path)?;
    map.check()?;
    // Without the unit, a reader would treat the values as an anomaly.
    if map.value_unit != "nT" && !KEEP_UNIT.contains(&chosen.name) {
        let what = format!("the map format `{}` cannot store the unit {}", chosen.name, map.value_unit);
        return Err(ReadError::options(path, what).help(format!("use one of {}", KEEP_UNIT.join(", "))));
    }
    let mut outputs = MapOutputFiles { path, made: vec![] };
    write(map, &mut outputs)?;
    outputs.commit()
}

/// Checks, before a map is computed, whether it can be written to a file. The errors are those of [`write_grid`] that
/// do not depend on the map.
///
/// # Errors
/// Fails for a format that is unknown or cannot be written, or a folder that does not exist.
pub fn check_output(path: &Path, format: Option<&str>) -> Result<(), ReadError> {
    let chosen = writer_for(path, format)?;
    if chosen.write.is_none() {
        return Err(not_written(path, chosen.name));
    }
    refuse_stale(path)?;
    match path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
        Some(folder) => Err(ReadError::options(path, format!("the folder `{}` does not exist", folder.display()))),
        None => Ok(()),
    }
}

/// The formats that store the unit of the values.
const KEEP_UNIT: [&str; 5] = ["parquet", "geotiff", "netcdf", "er_mapper", "xyz"];

fn not_written(path: &Path, name: &str) -> ReadError {
    ReadError::options(path, format!("the map format `{name}` can be read, but not written")).help(writers())
}

fn writers() -> String {
    let names: Vec<&str> = MAP_FORMATS.iter().filter(|f| f.write.is_some()).map(|f| f.name).collect();
    format!("the formats that can be written are {}", names.join(", "))
}

fn writer_for(path: &Path, format: Option<&str>) -> Result<&'static MapFormat, ReadError> {
    if let Some(name) = format {
        let names: Vec<&str> = MAP_FORMATS.iter().map(|f| f.name).collect();
        return MAP_FORMATS
            .iter()
            .find(|f| f.name == name)
            .ok_or_else(|| ReadError::options(path, format!("there is no map format `{name}`")).nearest(name, &names));
    }
    let ends = |f: &&MapFormat| f.write.is_some() && has_extension(path, f.extensions);
    let found: Vec<&MapFormat> = MAP_FORMATS.iter().filter(ends).collect();
    match found.as_slice() {
        [one] => Ok(one),
        [] => Err(ReadError::options(path, "the extension belongs to no writable map format").help(writers())),
        several => {
            let names: Vec<&str> = several.iter().map(|f| f.name).collect();
            let what = format!("the extension belongs to several map formats: {}", names.join(", "));
            Err(ReadError::options(path, what).help("choose one with `format`"))
        }
    }
}

/// Output files of a map: temporary files that are renamed when complete.
pub(crate) struct MapOutputFiles<'a> {
    path: &'a Path,
    made: Vec<(PathBuf, PathBuf)>,
}

/// A file being written.
pub(crate) type MapFileSink = BufWriter<File>;

impl MapOutputFiles<'_> {
    /// The target of the map.
    pub(crate) fn path(&self) -> &Path {
        self.path
    }

    /// Begins the map's file.
    pub(crate) fn create(&mut self) -> Result<MapFileSink, ReadError> {
        self.create_at(self.path.to_path_buf())
    }

    /// Begins another file of the map.
    pub(crate) fn create_at(&mut self, path: PathBuf) -> Result<MapFileSink, ReadError> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let io = |e: &std::io::Error| ReadError::io(&path, e);
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
        let Some(name) = name else { return Err(ReadError::options(&path, "the path must end in a file name")) };
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let part = path.with_file_name(format!(".{name}.{}.{count}.part", std::process::id()));
        let file = OpenOptions::new().write(true).read(true).create_new(true).open(&part).map_err(|e| io(&e))?;
        self.made.push((part, path));
        Ok(BufWriter::with_capacity(1 << 16, file))
    }

    /// Completes a file and flushes it to the disk.
    pub(crate) fn finish(&self, sink: MapFileSink) -> Result<(), ReadError> {
        let done = sink.into_inner().map_err(|e| e.into_error()).and_then(|f| f.sync_all());
        done.map_err(|e| self.io(&e))
    }

    /// An error of writing.
    pub(crate) fn io(&self, error: &std::io::Error) -> ReadError {
        ReadError::io(self.path, error)
    }

    /// Writes bytes as the map's file.
    pub(crate) fn whole(&mut self, bytes: &[u8]) -> Result<(), ReadError> {
        let mut sink = self.create()?;
        sink.write_all(bytes).map_err(|e| self.io(&e))?;
        self.finish(sink)
    }

    fn commit(mut self) -> Result<(), ReadError> {
        // Files are renamed in reverse order: a file that refers to others is created first and renamed last.
        while let Some((part, path)) = self.made.pop() {
            if let Err(error) = fs::rename(&part, &path) {
                self.made.push((part, path));
                return Err(self.io(&error));
            }
        }
        Ok(())
    }
}

impl Drop for MapOutputFiles<'_> {
    /// Files that were not renamed are removed.
    fn drop(&mut self) {
        for (part, _) in &self.made {
            let _ = fs::remove_file(part);
        }
    }
}

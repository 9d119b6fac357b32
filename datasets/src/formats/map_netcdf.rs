//! NetCDF grids: classic (CDF-1, 2 and 5) and NetCDF-4, with the COARDS/CF coordinates of GMT, GDAL and xarray, and
//! GMT's oldest grids with ranges instead of coordinates. [CF conventions 1.7; GMT technical reference, "The
//! GMT-specific netCDF grid format"]

use std::path::Path;

use netcdf_reader::{NcFile, NcMetadataMode, NcOpenOptions, NcType, NcVariable};

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{bytes_of, transposed},
    guarded, hdf5,
    limits::DecodeLimit,
    map_parquet::{EASTINGS, LATITUDES, LONGITUDES, NORTHINGS},
    netcdf_values::NetcdfEncoding,
    netcdf_write,
};
use crate::{
    ReadError,
    grid::{AxisUnit, FileAxis, FileCrs, MapDraft},
};
use grids::{AnomalyGrid, Registration, epsg_of_wkt};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "netcdf",
    about: "NetCDF grid of GMT, GDAL or xarray, classic or NetCDF-4",
    extensions: &["nc", "grd", "nc4"],
    recognise: |head: &FileHead| {
        let classic = [b"CDF\x01", b"CDF\x02", b"CDF\x05"].iter().any(|m| head.starts_with(*m));
        let lower = head.path.to_string_lossy().to_ascii_lowercase();
        classic || head.starts_with(hdf5::MAGIC) && FORMAT.extensions.iter().any(|e| lower.ends_with(&format!(".{e}")))
    },
    companions: None,
    read,
    write: Some(netcdf_write::write),
};

/// Usual names of the grid, for a file with several two-dimensional variables; the first name that exists is used.
const GRIDS: [&str; 9] =
    ["z", "anomaly", "magnetic_anomaly", "total_field_anomaly", "tmi", "mag", "map", "band1", "anomaly_nt"];

/// Names of a grid of heights.
const HEIGHTS: [&str; 4] = ["alt", "height", "altitude", "alt_m"];

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let bytes = bytes_of(path)?;
    if bytes.starts_with(hdf5::MAGIC) {
        // Checks that the file is complete.
        hdf5::Hdf5Source::open(path)?;
    }
    let draft = guarded(path, || {
        let size = bytes.len() as u64;
        let most = DecodeLimit::new(size).most_here();
        let limits = NcOpenOptions {
            metadata_mode: NcMetadataMode::Lossy,
            max_chunk_bytes: most,
            max_read_bytes: most,
            max_object_header_bytes: 1 << 24,
            ..NcOpenOptions::default()
        };
        let file = NcFile::from_bytes_with_options(&bytes, limits).map_err(|e| damaged(path, &e))?;
        let grid = NetcdfGridFile { path, file: &file, bytes: size, classic: !bytes.starts_with(hdf5::MAGIC) };
        if grid.find("x_range").is_some() && grid.find("dimension").is_some() { grid.oldest() } else { grid.draft() }
    })?;
    draft.finish(options)
}

fn damaged(path: &Path, error: &netcdf_reader::Error) -> ReadError {
    ReadError::data(path, format!("the file is not a complete NetCDF file: {error}"))
}

/// An open NetCDF file, its size in bytes, and whether it is classic.
struct NetcdfGridFile<'p, 'a> {
    path: &'p Path,
    file: &'a NcFile,
    bytes: u64,
    classic: bool,
}

impl<'p, 'a> NetcdfGridFile<'p, 'a> {
    fn variables(&self) -> &'a [NcVariable] {
        self.file.variables().unwrap_or_default()
    }

    fn find(&self, name: &str) -> Option<&'a NcVariable> {
        self.variables().iter().find(|v| v.name() == name)
    }

    fn need(&self, name: &str) -> Result<&'a NcVariable, ReadError> {
        let names: Vec<&str> = self.variables().iter().map(NcVariable::name).collect();
        self.find(name).ok_or_else(|| {
            ReadError::data(self.path, format!("the file holds no variable `{name}`")).nearest(name, &names)
        })
    }

    /// The stored numbers.
    fn stored(&self, variable: &NcVariable) -> Result<impl Iterator<Item = f64>, ReadError> {
        let wrong = |what: &str| ReadError::data(self.path, what).in_column(variable.name());
        let count = variable.shape().iter().try_fold(1_u64, |n, d| n.checked_mul(*d));
        let size = variable.dtype().size().map_err(|_| wrong("holds no numbers"))? as u64;
        let most = if self.classic { self.bytes } else { DecodeLimit::new(self.bytes).most() };
        if count.and_then(|n| n.checked_mul(size)).is_none_or(|n| n > most) {
            return Err(wrong("its shape requires more data than a file of this size can store"));
        }
        let values = self.file.read_variable_as_f64(variable.name());
        Ok(values.map_err(|e| wrong(&format!("the variable cannot be read: {e}")))?.into_iter())
    }

    /// The numbers of coordinates.
    fn numbers(&self, variable: &NcVariable) -> Result<Vec<f64>, ReadError> {
        Ok(NetcdfEncoding::of_variable(self.path, variable)?.unpacked(self.stored(variable)?))
    }

    /// The stored numbers of the map (NaN where unknown), and their scale and offset.
    fn values(&self, map: &NcVariable, notes: &mut Vec<String>) -> Result<(Vec<f64>, [f64; 2]), ReadError> {
        let storage = NetcdfEncoding::of_variable(self.path, map)?;
        Ok((storage.known(self.stored(map)?, notes), storage.packing))
    }

    /// The heights of the nodes, NaN where unknown.
    fn heights(&self, variable: &NcVariable, notes: &mut Vec<String>) -> Result<Vec<f64>, ReadError> {
        let (values, [scale, offset]) = self.values(variable, notes)?;
        let unit = self.text(Some(variable), "units").unwrap_or_else(|| "m".to_owned());
        let metres = schemas::convert(&unit, "m").ok_or_else(|| {
            let what = format!("the unit `{unit}` does not convert to m");
            ReadError::data(self.path, what).in_column(variable.name())
        })?;
        Ok(values.into_iter().map(|v| (v * scale + offset) * metres).collect())
    }

    fn text(&self, variable: Option<&NcVariable>, name: &str) -> Option<String> {
        let attribute = match variable {
            Some(variable) => variable.attribute(name),
            None => self.file.global_attribute(name).ok(),
        };
        let text = attribute.and_then(|a| a.value.as_string())?;
        let text = text.trim().trim_end_matches('\0').trim().to_owned();
        (!text.is_empty()).then_some(text)
    }

    fn number(&self, variable: Option<&NcVariable>, name: &str) -> Option<f64> {
        let attribute = match variable {
            Some(variable) => variable.attribute(name),
            None => self.file.global_attribute(name).ok(),
        };
        attribute.and_then(|a| a.value.as_f64())
    }

    /// The variable of the map, which has two dimensions, not counting those of length 1.
    fn map(&self) -> Result<&'a NcVariable, ReadError> {
        let flat = |v: &&NcVariable| {
            let long = v.shape().iter().filter(|n| **n > 1).count();
            long == 2 && v.ndim() >= 2 && v.dtype().is_primitive() && !matches!(v.dtype(), NcType::Char)
        };
        let all: Vec<&NcVariable> = self.variables().iter().filter(flat).collect();
        let lower = |v: &NcVariable| v.name().to_ascii_lowercase();
        let known = GRIDS.iter().find_map(|g| all.iter().find(|v| lower(v) == *g));
        let others: Vec<&&NcVariable> = all.iter().filter(|v| !HEIGHTS.contains(&&*lower(v))).collect();
        match (known, others.as_slice()) {
            (Some(one), _) => Ok(one),
            (None, [one]) => Ok(one),
            (None, []) => {
                Err(ReadError::data(self.path, "the file holds no variable with two dimensions of length 2 or more"))
            }
            (None, several) => {
                let names: Vec<&str> = several.iter().map(|v| v.name()).collect();
                Err(ReadError::data(self.path, format!("the file holds several grids: {}", names.join(", ")))
                    .help("keep only one grid in the file, or name one grid `z`"))
            }
        }
    }

    fn draft(&self) -> Result<MapDraft<'p>, ReadError> {
        let map = self.map()?;
        let names: Vec<String> = map.dimensions().iter().filter(|d| d.size > 1).map(|d| d.name.clone()).collect();
        let [outer, inner] = names.as_slice() else {
            return Err(ReadError::data(self.path, "the grid must have two dimensions").in_column(map.name()));
        };
        let (outer, inner) = (self.need(outer)?, self.need(inner)?);
        // Usually each row has one latitude; if the dimensions are in the other order, the values are transposed.
        let swapped = self.is_y(inner) && !self.is_y(outer) || self.is_x(outer) && !self.is_x(inner);
        let (x, y) = if swapped { (outer, inner) } else { (inner, outer) };
        let mut notes = vec![];
        let axis = |v: &NcVariable| FileAxis::from_coordinates(self.path, v.name(), &self.numbers(v)?);
        let (x_axis, y_axis) = (axis(x)?, axis(y)?);
        if y_axis.descends() {
            notes.push("the file's rows run from north to south, so they are reversed".to_owned());
        }
        let ordered = |values: Vec<f64>| if swapped { transposed(&values, y_axis.len()) } else { values };
        let (values, packing) = self.values(map, &mut notes)?;
        let system = self.system(map, x, y);
        let mut draft = MapDraft::new(self.path, x_axis, y_axis, ordered(values), system);
        draft.packing = packing;
        draft.axis_unit = self.axis_unit(x, y)?;
        self.describe(&mut draft, map);
        let height = self.variables().iter().find(|v| HEIGHTS.contains(&v.name()) && v.shape() == map.shape());
        let height = height.filter(|h| h.name() != map.name());
        draft.heights = height.map(|h| self.heights(h, &mut notes)).transpose()?.map(ordered);
        draft.notes.append(&mut notes);
        Ok(draft)
    }

    /// Unit, height and registration.
    fn describe(&self, draft: &mut MapDraft, map: &NcVariable) {
        let at = |name: &str| self.number(Some(map), name).or_else(|| self.number(None, name));
        draft.unit = self.text(Some(map), "units");
        draft.level_m = ["height_m", "level_height_m", "alt_m", "altitude_m"].into_iter().find_map(at);
        if self.number(None, "node_offset") == Some(1.0) {
            draft.registration = Registration::Pixel;
        }
    }

    /// The unit of the coordinates.
    fn axis_unit(&self, x: &NcVariable, y: &NcVariable) -> Result<Option<AxisUnit>, ReadError> {
        let of = |v: &NcVariable| match self.text(Some(v), "units") {
            Some(text) => AxisUnit::read(self.path, v.name(), &text),
            None => Ok(None),
        };
        AxisUnit::of_both(self.path, of(x)?, of(y)?)
    }

    fn is_x(&self, v: &NcVariable) -> bool {
        self.means(v, "x", "X", LONGITUDES, EASTINGS, "degrees_east")
    }

    fn is_y(&self, v: &NcVariable) -> bool {
        self.means(v, "y", "Y", LATITUDES, NORTHINGS, "degrees_north")
    }

    fn means(&self, v: &NcVariable, name: &str, axis: &str, degrees: &[&str], metres: &[&str], unit: &str) -> bool {
        let lower = v.name().to_ascii_lowercase();
        let standard_name = self.text(Some(v), "standard_name").unwrap_or_default();
        lower == name
            || self.text(Some(v), "axis").as_deref() == Some(axis)
            || degrees.contains(&&*lower)
            || metres.contains(&&*lower)
            || degrees.contains(&&*standard_name)
            || standard_name == format!("projection_{name}_coordinate")
            || self.text(Some(v), "units").is_some_and(|u| u.starts_with(unit))
    }

    /// The coordinate system: from the grid mapping, else from the attributes of the file, else from the units of the
    /// coordinates.
    fn system(&self, map: &NcVariable, x: &NcVariable, y: &NcVariable) -> FileCrs {
        let mapping = self.text(Some(map), "grid_mapping").and_then(|n| self.find(n.split([':', ' ']).next()?));
        for from in [mapping, None].into_iter().skip(usize::from(mapping.is_none())) {
            let code = ["epsg_code", "epsg"].into_iter().find_map(|k| self.code(from, k));
            let wkt = || ["crs_wkt", "spatial_ref", "esri_pe_string"].into_iter().find_map(|k| self.text(from, k));
            if let Some(code) = code.or_else(|| epsg_of_wkt(&wkt()?)) {
                return FileCrs::Epsg(code);
            }
        }
        let degrees = |v: &NcVariable| {
            let unit = self.text(Some(v), "units").unwrap_or_default().to_ascii_lowercase();
            unit.starts_with("degree")
        };
        let mapped = mapping.and_then(|m| self.text(Some(m), "grid_mapping_name"));
        match mapped.as_deref() {
            Some(name) if name != "latitude_longitude" => FileCrs::Projected,
            _ if degrees(x) && degrees(y) => FileCrs::Degrees,
            _ => FileCrs::Unknown,
        }
    }

    /// An EPSG code, written as a number or as `EPSG:32630`.
    fn code(&self, from: Option<&NcVariable>, key: &str) -> Option<u16> {
        let text = self.text(from, key).and_then(|t| t.rsplit(':').next()?.trim().parse().ok());
        text.or_else(|| self.number(from, key).filter(|n| (1.0..65536.0).contains(n)).map(|n| n as u16))
    }

    /// GMT's oldest grids: the ends of the axes, and one list of values that begins in the north-west.
    fn oldest(&self) -> Result<MapDraft<'p>, ReadError> {
        let pair = |name: &str| -> Result<(f64, f64), ReadError> {
            let values = self.numbers(self.need(name)?)?;
            match values.as_slice() {
                [a, b, ..] => Ok((*a, *b)),
                _ => Err(ReadError::data(self.path, "must have two values").in_column(name)),
            }
        };
        let z = self.need("z")?;
        let (west, east) = pair("x_range")?;
        let (south, north) = pair("y_range")?;
        let (width, height) = pair("dimension")?;
        let (width, height) = super::grid_bytes::nodes(self.path, width as i64, height as i64, 1, self.bytes)?;
        let pixel = self.number(Some(z), "node_offset").or_else(|| self.number(None, "node_offset")) == Some(1.0);
        let axis = |name: &str, from: f64, to: f64, len: usize| match pixel {
            true => {
                let step = (to - from) / len as f64;
                FileAxis::new(self.path, name, from + 0.5 * step, step, len)
            }
            false => FileAxis::between(self.path, name, from, to, len),
        };
        let (x, y) = (axis("x", west, east, width)?, axis("y", north, south, height)?);
        let degrees = |name: &str| {
            let unit = self.find(name).and_then(|v| self.text(Some(v), "units")).unwrap_or_default();
            unit.to_ascii_lowercase().contains("degree")
        };
        let system = if degrees("x_range") && degrees("y_range") { FileCrs::Degrees } else { FileCrs::Unknown };
        let mut notes = vec![];
        let (values, packing) = self.values(z, &mut notes)?;
        let mut draft = MapDraft::new(self.path, x, y, values, system);
        draft.packing = packing;
        draft.notes = notes;
        let unit = |name: &str| self.find(name).and_then(|v| self.text(Some(v), "units")).unwrap_or_default();
        draft.axis_unit = AxisUnit::read(self.path, "x_range", &unit("x_range"))?;
        self.describe(&mut draft, z);
        let unit = self.find("z_range").and_then(|v| self.text(Some(v), "units"));
        draft.unit = unit.filter(|u| !["z", "user_z_unit"].contains(&u.as_str()));
        if pixel {
            draft.registration = Registration::Pixel;
            draft.notes.push("the axes end at edges of cells, so the nodes are the centres of the cells".to_owned());
        }
        Ok(draft)
    }
}

//! ER Mapper rasters: a header of nested `Begin`/`End` blocks in an `.ers` file, the values in a binary file next to
//! it, rows from the north. [Earth Resource Mapping, ER Mapper customisation guide, ch. 2]
//!
//! The values are written in double precision. The format cannot store the height, which is omitted.

use std::{
    collections::BTreeMap,
    io::Write,
    path::{Path, PathBuf},
};

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{bytes_of, level_m, nodes, rows, text, text_of},
    map_esri::unused,
    output::MapOutputFiles,
};
use crate::{
    ReadError,
    grid::{AxisUnit, FileAxis, FileCrs, MapDraft, is_marker},
};
use grids::{AnomalyGrid, Registration};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "er_mapper",
    about: "ER Mapper raster: .ers header with a binary file of values",
    extensions: &["ers"],
    recognise: |head: &FileHead| {
        head.first_line().is_some_and(|l| l.trim_start().to_ascii_lowercase().starts_with("datasetheader begin"))
    },
    companions: Some(|path| cells_of(path).map(|cells| vec![cells])),
    read,
    write: Some(write),
};

/// Path of the binary file with the values, as named in the header.
///
/// # Errors
/// Fails for a header that cannot be read.
fn cells_of(path: &Path) -> Result<PathBuf, ReadError> {
    let header = ErsHeader::parse(path, &text_of(path)?);
    // A file name in the header refers to the folder of the header; other folders are not searched.
    let named = header.text("datafile").and_then(|n| n.rsplit(['/', '\\']).next().map(str::to_owned));
    Ok(match named.filter(|n| !n.is_empty()) {
        Some(name) => path.with_file_name(name),
        None => path.with_extension(""),
    })
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let header = ErsHeader::parse(path, &text_of(path)?);
    let cells = cells_of(path)?;
    if cells == path {
        return Err(ReadError::data(path, "the header names itself as the file of its values"));
    }
    if header.number_or("rasterinfo.nrofbands", 1.0)? != 1.0 {
        return Err(ReadError::data(path, "a map must have one band, not several"));
    }
    let rotation = header.text("coordinatespace.rotation").map_or(Some(0.0), |t| angle(&t));
    if rotation != Some(0.0) {
        return Err(ReadError::data(path, "the grid is rotated").help("warp the grid to north-up first"));
    }
    let bytes = bytes_of(&cells)?;
    let kind = ErsCellType::from_header(path, &header)?;
    let offset = header.number_or("headeroffset", 0.0)?.max(0.0) as usize;
    let bytes = bytes.get(offset..).unwrap_or_default();
    let (columns, lines) = (header.number("rasterinfo.nrofcellsperline")?, header.number("rasterinfo.nroflines")?);
    let (width, height) = nodes(&cells, columns as i64, lines as i64, kind.size as u64, bytes.len() as u64)?;
    let unknown = header.number_or("rasterinfo.nullcellvalue", f64::NAN)?;
    let known = |v: f64| if is_marker(v, unknown) { f64::NAN } else { v };
    let values = bytes.chunks_exact(kind.size).take(width * height).map(|b| known(kind.value(b))).collect();
    let (x, y) = header.axes(width, height)?;
    let mut draft = MapDraft::new(path, x, y, values, header.system());
    draft.registration = Registration::Pixel;
    draft.axis_unit = header.axis_unit()?;
    draft.unit = header.text("rasterinfo.bandid.units").filter(|u| !u.is_empty());
    draft.finish(options)
}

/// Entries of the header; a key consists of the names of its blocks and of the entry, such as
/// `rasterinfo.cellinfo.xdimension`, in lower case.
struct ErsHeader<'a> {
    path: &'a Path,
    entries: BTreeMap<String, String>,
}

impl<'a> ErsHeader<'a> {
    fn parse(path: &'a Path, text: &str) -> ErsHeader<'a> {
        let mut blocks: Vec<String> = vec![];
        let mut entries = BTreeMap::new();
        for line in text.lines().map(str::trim) {
            let lower = line.to_ascii_lowercase();
            if let Some(name) = lower.strip_suffix("begin") {
                blocks.push(name.trim().to_owned());
            } else if lower.strip_suffix("end").is_some_and(|n| Some(n.trim()) == blocks.last().map(String::as_str)) {
                blocks.pop();
            } else if let Some((key, value)) = line.split_once('=') {
                let key = key.trim().to_ascii_lowercase();
                let path: Vec<&str> = blocks.iter().skip(1).map(String::as_str).chain([key.as_str()]).collect();
                entries.entry(path.join(".")).or_insert_with(|| value.trim().trim_matches('"').to_owned());
            }
        }
        ErsHeader { path, entries }
    }

    fn text(&self, key: &str) -> Option<String> {
        self.entries.get(key).cloned()
    }

    fn number(&self, key: &str) -> Result<f64, ReadError> {
        let text = self.text(key).ok_or_else(|| ReadError::data(self.path, format!("the header lacks `{key}`")))?;
        angle(&text).ok_or_else(|| ReadError::data(self.path, format!("`{text}` of `{key}` is not a number")))
    }

    fn number_or(&self, key: &str, default: f64) -> Result<f64, ReadError> {
        if self.entries.contains_key(key) { self.number(key) } else { Ok(default) }
    }

    /// Axes of the cell centres. The registered coordinate is the north-west corner of its cell, not the centre.
    fn axes(&self, width: usize, height: usize) -> Result<(FileAxis, FileAxis), ReadError> {
        let (dx, dy) = (self.number("rasterinfo.cellinfo.xdimension")?, self.number("rasterinfo.cellinfo.ydimension")?);
        let place = |keys: [&str; 3]| {
            let key = keys.map(|k| format!("rasterinfo.registrationcoord.{k}"));
            let found = key.iter().find(|k| self.entries.contains_key(*k)).or(key.first());
            self.number(found.map_or("", String::as_str))
        };
        let (x0, y0) = (place(["eastings", "longitude", "metersx"])?, place(["northings", "latitude", "metersy"])?);
        let (i, j) = (
            self.number_or("rasterinfo.registrationcellx", 0.0)?,
            self.number_or("rasterinfo.registrationcelly", 0.0)?,
        );
        let x = FileAxis::new(self.path, "x", x0 + (0.5 - i) * dx, dx, width)?;
        let y = FileAxis::new(self.path, "y", y0 - (0.5 - j) * dy, -dy, height)?;
        Ok((x, y))
    }

    /// The unit of eastings and northings. It is ignored for degrees, because programs write arbitrary words there.
    fn axis_unit(&self) -> Result<Option<AxisUnit>, ReadError> {
        let text = |key: &str| self.text(key).unwrap_or_default();
        let degrees = text("coordinatespace.coordinatetype").eq_ignore_ascii_case("LL")
            || text("coordinatespace.projection").eq_ignore_ascii_case("GEODETIC");
        if degrees {
            return Ok(None);
        }
        AxisUnit::read(self.path, "Units", &text("coordinatespace.units"))
    }

    /// The coordinate system of a datum and a projection.
    fn system(&self) -> FileCrs {
        let upper = |key: &str| self.text(key).unwrap_or_default().to_ascii_uppercase();
        let (datum, projection) = (upper("coordinatespace.datum"), upper("coordinatespace.projection"));
        let named = projection.strip_prefix("EPSG:").or_else(|| datum.strip_prefix("EPSG:"));
        let code = named.map_or_else(|| code_of(&datum, &projection), |c| c.trim().parse().ok());
        match code {
            Some(code) => FileCrs::Epsg(code),
            None if upper("coordinatespace.coordinatetype") == "RAW" || projection.is_empty() => FileCrs::Unknown,
            None if projection == "GEODETIC" => FileCrs::Unknown,
            None if ["RAW", "LOCAL"].contains(&projection.as_str()) => FileCrs::Unknown,
            None => FileCrs::Projected,
        }
    }
}

/// Datums: name, EPSG code of the system in degrees, and bases of the EPSG codes of northern and of southern UTM zones;
/// a code is the base plus the zone.
const DATUMS: [(&str, u16, Option<u16>, Option<u16>); 9] = [
    ("WGS84", 4326, Some(32600), Some(32700)),
    ("GDA94", 4283, None, Some(28300)),
    ("GDA2020", 7844, None, Some(7800)),
    ("AGD66", 4202, None, Some(20200)),
    ("AGD84", 4203, None, Some(20300)),
    ("NAD83", 4269, Some(26900), None),
    ("NAD27", 4267, Some(26700), None),
    ("ETRS89", 4258, Some(25800), None),
    ("OSGB36", 4277, None, None),
];

fn code_of(datum: &str, projection: &str) -> Option<u16> {
    let (_, degrees, north, south) = DATUMS.iter().find(|(name, ..)| *name == datum)?;
    if projection == "GEODETIC" {
        return Some(*degrees);
    }
    let zone = |prefix: &str| projection.strip_prefix(prefix)?.parse::<u16>().ok().filter(|z| (1..=60).contains(z));
    let northern = zone("NUTM").and_then(|z| Some((*north)? + z));
    northern.or_else(|| ["SUTM", "MGA", "TMAMG", "AMG"].into_iter().find_map(|p| Some((*south)? + zone(p)?)))
}

/// ER Mapper's names of the datum and projection of an EPSG code; `EPSG:` and the code for other systems.
fn names_of(code: u16) -> (String, String) {
    for (datum, degrees, north, south) in DATUMS {
        if code == degrees {
            return (datum.to_owned(), "GEODETIC".to_owned());
        }
        for (base, letter) in [(north, 'N'), (south, 'S')] {
            let zone = base.and_then(|b| code.checked_sub(b)).filter(|z| (1..=60).contains(z));
            if let Some(zone) = zone.filter(|_| datum == "WGS84") {
                return (datum.to_owned(), format!("{letter}UTM{zone:02}"));
            }
        }
    }
    (format!("EPSG:{code}"), format!("EPSG:{code}"))
}

/// Parses an angle: a number, or degrees, minutes and seconds separated by colons.
fn angle(text: &str) -> Option<f64> {
    let sign = if text.trim().starts_with('-') { -1.0 } else { 1.0 };
    let mut parts = text.trim().trim_start_matches(['-', '+']).split(':').map(|p| p.trim().parse::<f64>().ok());
    let mut value = parts.next()??;
    for scale in [60.0, 3600.0] {
        value += parts.next().unwrap_or(Some(0.0))? / scale;
    }
    parts.next().is_none().then_some(sign * value)
}

/// Number type of the cells.
struct ErsCellType {
    size: usize,
    float: bool,
    signed: bool,
    big: bool,
}

impl ErsCellType {
    fn from_header(path: &Path, header: &ErsHeader) -> Result<ErsCellType, ReadError> {
        let name = header.text("rasterinfo.celltype").unwrap_or_default().to_ascii_lowercase();
        let big = header.text("byteorder").is_some_and(|o| o.eq_ignore_ascii_case("MSBFirst"));
        let kinds = [
            ("ieee4bytereal", 4, true, true),
            ("ieee8bytereal", 8, true, true),
            ("unsigned8bitinteger", 1, false, false),
            ("signed8bitinteger", 1, false, true),
            ("unsigned16bitinteger", 2, false, false),
            ("signed16bitinteger", 2, false, true),
            ("unsigned32bitinteger", 4, false, false),
            ("signed32bitinteger", 4, false, true),
        ];
        let found = kinds.iter().find(|k| k.0 == name);
        let (_, size, float, signed) =
            *found.ok_or_else(|| ReadError::data(path, format!("the cell type `{name}` is not supported")))?;
        Ok(ErsCellType { size, float, signed, big })
    }

    /// The value of a cell from its bytes.
    fn value(&self, bytes: &[u8]) -> f64 {
        let mut wide = [0_u8; 8];
        for (i, byte) in bytes.iter().enumerate() {
            let at = if self.big { bytes.len() - 1 - i } else { i };
            if let Some(place) = wide.get_mut(at) {
                *place = *byte;
            }
        }
        let bits = u64::from_le_bytes(wide);
        match (self.float, self.size, self.signed) {
            (true, 4, _) => f64::from(f32::from_bits(bits as u32)),
            (true, ..) => f64::from_bits(bits),
            (false, size, true) => {
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            (false, ..) => bits as f64,
        }
    }
}

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    level_m(outputs, map, FORMAT.name)?;
    let path = outputs.path().to_path_buf();
    if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ers")) {
        return Err(ReadError::options(&path, "an ER Mapper header must have the extension `ers`"));
    }
    let unknown = unused(&map.anomaly_nt);
    let mut head = outputs.create()?;
    head.write_all(header(map, unknown).as_bytes()).map_err(|e| outputs.io(&e))?;
    outputs.finish(head)?;
    let mut cells = outputs.create_at(path.with_extension(""))?;
    for row in rows(map, true) {
        let value = |v: &f64| if v.is_nan() { unknown } else { *v };
        let bytes: Vec<u8> = row.iter().flat_map(|v| value(v).to_le_bytes()).collect();
        cells.write_all(&bytes).map_err(|e| outputs.io(&e))?;
    }
    outputs.finish(cells)
}

/// ER Mapper's name of a unit of eastings and northings; `UNKNOWN` for other units.
fn length_units(unit_m: f64) -> &'static str {
    let is = |known_m: f64| ((unit_m - known_m) / known_m).abs() < 1e-9;
    match unit_m {
        _ if is(1.0) => "METERS",
        _ if is(1200.0 / 3937.0) => "US SURVEY FEET",
        _ if is(0.3048) => "INTERNATIONAL FEET",
        _ => "UNKNOWN",
    }
}

fn header(map: &AnomalyGrid, unknown: f64) -> String {
    let (datum, projection) = names_of(map.crs.code());
    let (kind, units, x_name, y_name) = match map.is_geographic() {
        true => ("LL", "DEGREES", "Longitude", "Latitude"),
        false => ("EN", length_units(map.crs.unit_m()), "Eastings", "Northings"),
    };
    let (west, north) = (map.x.first - 0.5 * map.x.step, map.y.last() + 0.5 * map.y.step);
    format!(
        "DatasetHeader Begin\n\tVersion\t\t= \"6.0\"\n\tDataSetType\t= ERStorage\n\tDataType\t= Raster\n\tByteOrder\t= \
         LSBFirst\n\tCoordinateSpace Begin\n\t\tDatum\t\t= \"{datum}\"\n\t\tProjection\t= \"{projection}\"\n\
         \t\tCoordinateType\t= {kind}\n\t\tUnits\t\t= \"{units}\"\n\t\tRotation\t= 0:0:0.0\n\tCoordinateSpace End\n\
         \tRasterInfo Begin\n\t\tCellType\t= IEEE8ByteReal\n\t\tNullCellValue\t= {unknown}\n\t\tCellInfo Begin\n\
         \t\t\tXdimension\t= {}\n\t\t\tYdimension\t= {}\n\t\tCellInfo End\n\t\tNrOfLines\t= {}\n\
         \t\tNrOfCellsPerLine\t= {}\n\t\tRegistrationCoord Begin\n\t\t\t{x_name}\t= {}\n\t\t\t{y_name}\t= {}\n\
         \t\tRegistrationCoord End\n\t\tNrOfBands\t= 1\n\t\tBandId Begin\n\t\t\tValue\t\t= \"magnetic anomaly\"\n\
         \t\t\tUnits\t\t= \"{}\"\n\t\tBandId End\n\tRasterInfo End\nDatasetHeader End\n",
        text(map.x.step),
        text(map.y.step),
        map.y.len,
        map.x.len,
        text(west),
        text(north),
        map.value_unit
    )
}

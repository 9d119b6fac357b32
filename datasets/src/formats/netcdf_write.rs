//! Writes NetCDF classic files with 64-bit offsets (CDF-2), with the COARDS/CF attributes of GMT, GDAL and xarray.
//! [NetCDF classic format specification; CF conventions 1.7]

use std::io::Write;

use super::{grid_bytes::range, output::MapOutputFiles};
use crate::ReadError;
use grids::{AnomalyGrid, GridHeight, Registration};

/// Tags of the lists in a header.
const DIMENSIONS: u32 = 10;
const VARIABLES: u32 = 11;
const ATTRIBUTES: u32 = 12;

/// Types.
const CHAR: u32 = 2;
const INT: u32 = 4;
const DOUBLE: u32 = 6;

/// The value that is written for a size of more than 32 bits; readers derive such a size from the shape.
const LARGE: u32 = u32::MAX;

/// The value of an attribute.
enum NetcdfAttributeValue {
    Text(String),
    Int(i32),
    Doubles(Vec<f64>),
}

/// A variable: its name, dimensions, attributes, type and number of data bytes.
struct NetcdfVariable {
    name: &'static str,
    dimensions: &'static [u32],
    attributes: Vec<(&'static str, NetcdfAttributeValue)>,
    kind: u32,
    bytes: u64,
}

/// Writes a map as `x`, `y` (or `lon`, `lat`) and `z`, with `crs` for its coordinate system, and `alt` if the height
/// varies.
pub(super) fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    let variables = variables(map);
    let names = axis_names(map);
    let mut header = vec![];
    let length = encode(&mut header, map, names, &variables, 0).map_err(|e| refused(outputs, &e))?;
    header.clear();
    encode(&mut header, map, names, &variables, length).map_err(|e| refused(outputs, &e))?;
    let mut sink = outputs.create()?;
    let mut put = |bytes: &[u8]| sink.write_all(bytes).map_err(|e| ReadError::io(outputs.path(), &e));
    put(&header)?;
    // The value of the variable `crs`, one character, padded to four bytes.
    put(&[0; 4])?;
    for axis in [map.x.coordinates(), map.y.coordinates()] {
        put(&big_endian(&axis))?;
    }
    let heights: &[f64] = match &map.height {
        GridHeight::Cells(cells) => cells,
        GridHeight::Level(_) => &[],
    };
    for values in [heights, &map.anomaly_nt] {
        for row in values.chunks(map.x.len.max(1)) {
            put(&big_endian(row))?;
        }
    }
    outputs.finish(sink)
}

fn refused(outputs: &MapOutputFiles, what: &str) -> ReadError {
    ReadError::options(outputs.path(), format!("the map exceeds the limits of NetCDF's classic format: {what}"))
}

fn axis_names(map: &AnomalyGrid) -> [&'static str; 2] {
    if map.is_geographic() { ["lon", "lat"] } else { ["x", "y"] }
}

/// The variables in the order of their data. The map is last, so that its size is not limited.
fn variables(map: &AnomalyGrid) -> Vec<NetcdfVariable> {
    let [x, y] = axis_names(map);
    let nodes = map.nodes() as u64;
    let text = |t: &str| NetcdfAttributeValue::Text(t.to_owned());
    let crs = vec![
        ("grid_mapping_name", text(if map.is_geographic() { "latitude_longitude" } else { "unknown" })),
        ("long_name", text(map.crs.name())),
        ("epsg_code", NetcdfAttributeValue::Text(format!("EPSG:{}", map.crs.code()))),
        ("crs_wkt", text(map.crs.wkt())),
        ("spatial_ref", text(map.crs.wkt())),
    ];
    let (least, most) = range(&map.anomaly_nt);
    let mut z = vec![
        ("long_name", text("magnetic anomaly")),
        ("units", text(map.value_unit)),
        ("_FillValue", NetcdfAttributeValue::Doubles(vec![f64::NAN])),
        ("actual_range", NetcdfAttributeValue::Doubles(vec![least, most])),
        ("grid_mapping", text("crs")),
    ];
    if let GridHeight::Level(alt_m) = map.height
        && !alt_m.is_nan()
    {
        z.push(("height_m", NetcdfAttributeValue::Doubles(vec![alt_m])));
    }
    let axis = |name, dimensions, len: usize, attributes| NetcdfVariable {
        name,
        dimensions,
        attributes,
        kind: DOUBLE,
        bytes: 8 * len as u64,
    };
    let mut all = vec![
        NetcdfVariable { name: "crs", dimensions: &[], attributes: crs, kind: CHAR, bytes: 4 },
        axis(x, &[1], map.x.len, axis_attributes(map, 0)),
        axis(y, &[0], map.y.len, axis_attributes(map, 1)),
    ];
    let grid =
        |name, attributes| NetcdfVariable { name, dimensions: &[0, 1], attributes, kind: DOUBLE, bytes: 8 * nodes };
    if matches!(map.height, GridHeight::Cells(_)) {
        let about = text("height above the WGS-84 ellipsoid");
        let nan = NetcdfAttributeValue::Doubles(vec![f64::NAN]);
        all.push(grid("alt", vec![("long_name", about), ("units", text("m")), ("_FillValue", nan)]));
    }
    all.push(grid("z", z));
    all
}

/// The attributes of the x axis (0) or the y axis (1).
fn axis_attributes(map: &AnomalyGrid, which: usize) -> Vec<(&'static str, NetcdfAttributeValue)> {
    let text = |t: &str| NetcdfAttributeValue::Text(t.to_owned());
    let (names, unit) = match (map.is_geographic(), which) {
        (true, 0) => (["longitude", "longitude"], "degrees_east"),
        (true, _) => (["latitude", "latitude"], "degrees_north"),
        (false, 0) => (["projection_x_coordinate", "easting"], ""),
        (false, _) => (["projection_y_coordinate", "northing"], ""),
    };
    let metre = map.crs.unit_m();
    let unit = match unit {
        "" if metre == 1.0 => "m".to_owned(),
        "" => format!("{metre} m"),
        degrees => degrees.to_owned(),
    };
    let axis = if which == 0 { &map.x } else { &map.y };
    // For pixel registration, GMT's `actual_range` extends to the outer edges of the cells.
    let half = if map.registration == Registration::Pixel { 0.5 * axis.step } else { 0.0 };
    vec![
        ("standard_name", text(names[0])),
        ("long_name", text(names[1])),
        ("units", NetcdfAttributeValue::Text(unit)),
        ("axis", text(if which == 0 { "X" } else { "Y" })),
        ("actual_range", NetcdfAttributeValue::Doubles(vec![axis.first - half, axis.last() + half])),
    ]
}

/// Writes the header for data that begin at offset `data`; returns the length of the header.
fn encode(
    out: &mut Vec<u8>,
    map: &AnomalyGrid,
    [x, y]: [&str; 2],
    variables: &[NetcdfVariable],
    data: u64,
) -> Result<u64, String> {
    out.extend(b"CDF\x02");
    word(out, 0);
    word(out, DIMENSIONS);
    word(out, 2);
    for (name, len) in [(y, map.y.len), (x, map.x.len)] {
        named(out, name)?;
        word(out, u32::try_from(len).map_err(|_| format!("{len} nodes along {name}"))?);
    }
    let node_offset = NetcdfAttributeValue::Int(i32::from(map.registration == Registration::Pixel));
    let title = NetcdfAttributeValue::Text("magnetic anomaly map".to_owned());
    attributes(
        out,
        &[
            ("Conventions", NetcdfAttributeValue::Text("CF-1.7".to_owned())),
            ("title", title),
            ("node_offset", node_offset),
        ],
    )?;
    word(out, VARIABLES);
    word(out, variables.len() as u32);
    let mut at = data;
    for (i, variable) in variables.iter().enumerate() {
        named(out, variable.name)?;
        word(out, variable.dimensions.len() as u32);
        variable.dimensions.iter().for_each(|d| word(out, *d));
        attributes(out, &variable.attributes)?;
        word(out, variable.kind);
        let size = u32::try_from(variable.bytes).ok().filter(|n| *n <= u32::MAX - 3);
        if size.is_none() && i + 1 < variables.len() {
            return Err(format!("`{}` is larger than 4 GiB", variable.name));
        }
        word(out, size.unwrap_or(LARGE));
        out.extend(at.to_be_bytes());
        at += variable.bytes;
    }
    Ok(out.len() as u64)
}

fn word(out: &mut Vec<u8>, value: u32) {
    out.extend(value.to_be_bytes());
}

/// Appends `count` and the bytes, padded with zeros to a multiple of four bytes.
fn padded(out: &mut Vec<u8>, count: usize, bytes: &[u8]) -> Result<(), String> {
    word(out, u32::try_from(count).map_err(|_| "an attribute is too long".to_owned())?);
    out.extend(bytes);
    out.resize(out.len().next_multiple_of(4), 0);
    Ok(())
}

fn named(out: &mut Vec<u8>, name: &str) -> Result<(), String> {
    padded(out, name.len(), name.as_bytes())
}

fn attributes(out: &mut Vec<u8>, all: &[(&'static str, NetcdfAttributeValue)]) -> Result<(), String> {
    word(out, ATTRIBUTES);
    word(out, all.len() as u32);
    for (name, value) in all {
        named(out, name)?;
        match value {
            NetcdfAttributeValue::Text(text) => {
                word(out, CHAR);
                padded(out, text.len(), text.as_bytes())?;
            }
            NetcdfAttributeValue::Int(x) => {
                word(out, INT);
                padded(out, 1, &x.to_be_bytes())?;
            }
            NetcdfAttributeValue::Doubles(x) => {
                word(out, DOUBLE);
                padded(out, x.len(), &big_endian(x))?;
            }
        }
    }
    Ok(())
}

fn big_endian(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_be_bytes()).collect()
}

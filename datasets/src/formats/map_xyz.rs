//! Grids as columns of text, one row per node in any order: longitude or easting, latitude or northing, value.
//!
//! Files may have any separator, and a header or none. Written files have a header, and a comment with the coordinate
//! system, the unit and the height; the reader evaluates this comment.

use std::{io::Write, path::Path};

use super::{
    FileHead, MapFormat, MapOptions,
    csv::number,
    grid_bytes::text,
    map_parquet::{ANOMALIES, EASTINGS, HEIGHTS, LATITUDES, LONGITUDES, NORTHINGS, axis_unit},
    output::MapOutputFiles,
    text_table::{self, TextTable},
};
use crate::{
    ReadError,
    grid::{FileCrs, MapDraft, from_nodes},
};
use grids::{AnomalyGrid, GridHeight};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "xyz",
    about: "columns of text, one row per node",
    extensions: &["xyz", "csv", "txt", "dat"],
    recognise,
    companions: None,
    read,
    write: Some(write),
};

/// Whether the file begins with rows of three or more numbers, after at most one header.
fn recognise(head: &FileHead) -> bool {
    if head.text().contains(&0) {
        return false;
    }
    let start = String::from_utf8_lossy(head.text());
    let rows = start.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with(['#', '/', '!', '%', '>']));
    let numeric = |line: &str| {
        let words: Vec<&str> = line.split([',', ';', '\t', ' ']).filter(|w| !w.is_empty()).collect();
        words.len() >= 3 && words.iter().all(|w| number(w).is_some())
    };
    let rows: Vec<&str> = rows.take(3).collect();
    // The third row is not parsed, because the inspected text may end within it.
    rows.len() == 3 && (numeric(rows[0]) || !numeric(rows[0]) && numeric(rows[1]))
}

/// Other column names of the value in such files.
const VALUES: &[&str] = &["z", "value", "mag", "tmi", "total_field", "nt"];

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let table = text_table::read(path)?;
    let (x, y, value, geographic) = columns(path, &table)?;
    let name = |i: usize| table.names.get(i).map_or("", String::as_str);
    let (xs, ys, values) = (table.numbers(path, x)?, table.numbers(path, y)?, table.numbers(path, value)?);
    let height = if table.named { table.find(HEIGHTS).filter(|h| *h != value) } else { None };
    let heights = height.map(|h| table.numbers(path, h)).transpose()?;
    let all: Vec<&[f64]> = [Some(values), heights].into_iter().flatten().collect();
    let mut nodes = from_nodes(path, (name(x), xs), (name(y), ys), &all)?;
    let heights = nodes.values.pop_if(|_| heights.is_some());
    let header = XyzGridComments::from_comments(&table.comments);
    if header.nodes.is_some_and(|n| n != values.len()) {
        let what = format!("the file is cut short: {} of {} rows found", values.len(), header.nodes.unwrap_or(0));
        return Err(ReadError::data(path, what));
    }
    let system = match (header.epsg, geographic) {
        (Some(code), _) => FileCrs::Epsg(code),
        (None, true) => FileCrs::Degrees,
        (None, false) => FileCrs::Unknown,
    };
    let mut draft = MapDraft::new(path, nodes.x, nodes.y, nodes.values.pop().unwrap_or_default(), system);
    draft.heights = heights;
    draft.axis_unit = axis_unit(path, [name(x), name(y)], [None, None])?;
    draft.level_m = header.height_m;
    draft.unit = header.unit;
    draft.finish(options)
}

/// The columns of x, y and the value, and whether the names of x and y imply degrees.
fn columns(path: &Path, table: &TextTable) -> Result<(usize, usize, usize, bool), ReadError> {
    let width = table.columns.len();
    if !table.named {
        return match width {
            3 => Ok((0, 1, 2, false)),
            _ => Err(ReadError::data(path, format!("the {width} columns have no names"))
                .help("name the columns in a first row: `lon`, `lat`, `anomaly`, or `easting`, `northing`, `anomaly`")),
        };
    }
    let degrees = table.find(LONGITUDES).zip(table.find(LATITUDES));
    let place = degrees.or_else(|| table.find_axis(EASTINGS).zip(table.find_axis(NORTHINGS)));
    let value = table.find(ANOMALIES).or_else(|| table.find(VALUES));
    match (place, value) {
        (Some((x, y)), Some(value)) => Ok((x, y, value, degrees.is_some())),
        _ => Err(ReadError::data(path, format!("the columns are {}", table.names.join(", ")))
            .help("a map needs the columns `lon`, `lat` and `anomaly`, or `easting`, `northing` and `anomaly`")),
    }
}

/// Grid properties in the comments: EPSG code, height in m, unit, number of nodes.
#[derive(Debug, Default, PartialEq)]
struct XyzGridComments {
    epsg: Option<u16>,
    height_m: Option<f64>,
    unit: Option<String>,
    nodes: Option<usize>,
}

impl XyzGridComments {
    fn from_comments(comments: &[String]) -> XyzGridComments {
        let after = |key: &str| {
            let found = comments.iter().find_map(|c| c.split(key).nth(1))?;
            let word = found.trim_start().split([' ', ',', ';', ')']).next()?;
            Some(word.to_owned())
        };
        XyzGridComments {
            epsg: after("EPSG:").and_then(|w| w.parse().ok()),
            height_m: after("height_m=").and_then(|w| w.parse().ok()),
            unit: after("unit="),
            nodes: after("nodes=").and_then(|w| w.parse().ok()),
        }
    }
}

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    let names = if map.is_geographic() { "lon lat anomaly" } else { "easting northing anomaly" };
    let cells = matches!(map.height, GridHeight::Cells(_));
    let height = match map.height {
        GridHeight::Level(alt_m) if !alt_m.is_nan() => format!(" height_m={alt_m}"),
        _ => String::new(),
    };
    let comma = outputs.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    let (unit, code, nodes) = (map.value_unit, map.crs.code(), map.nodes());
    let mut line = format!("# magnetic anomaly unit={unit} EPSG:{code} nodes={nodes}{height}\n{names}");
    line.push_str(if cells { " alt\n" } else { "\n" });
    if comma {
        // Only the header is separated by commas; the comment keeps its blanks.
        line = line
            .split_inclusive('\n')
            .map(|l| if l.starts_with('#') { l.into() } else { l.replace(' ', ",") })
            .collect();
    }
    let between = if comma { ',' } else { ' ' };
    let mut sink = outputs.create()?;
    sink.write_all(line.as_bytes()).map_err(|e| outputs.io(&e))?;
    let columns: Vec<String> = map.x.coordinates().iter().map(|x| text(*x)).collect();
    let mut values = map.anomaly_nt.iter().enumerate();
    for j in 0..map.y.len {
        line.clear();
        let y = text(map.y.at(j as f64));
        for (x, (node, value)) in columns.iter().zip(values.by_ref()) {
            line.extend([x, &between.to_string(), &y, &between.to_string(), &text(*value)].map(|s| s.as_str()));
            if cells {
                line.push(between);
                line.push_str(&text(map.height_at(node)));
            }
            line.push('\n');
        }
        sink.write_all(line.as_bytes()).map_err(|e| outputs.io(&e))?;
    }
    outputs.finish(sink)
}

//! Esri ASCII grids: a header of names and numbers, then rows from the north; the coordinate system in a `.prj` file
//! next to it. [Esri, ASCII raster format]
//!
//! The format cannot store the height and the unit, which are omitted.

use std::{collections::BTreeMap, io::Write, path::Path};

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{level_m, nodes, numbers, text_of, write_rows},
    output::MapOutputFiles,
};
use crate::{
    ReadError,
    grid::{AxisUnit, FileAxis, FileCrs, MapDraft, is_marker},
};
use grids::{AnomalyGrid, Registration, epsg_of_wkt, unit_of_wkt};

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "esri_ascii",
    about: "Esri ASCII grid",
    extensions: &["asc"],
    recognise: |head: &FileHead| {
        let first = head.first_line().unwrap_or_default().to_ascii_lowercase();
        first.starts_with("ncols") || first.starts_with("nrows")
    },
    companions: Some(|path| Ok(Some(path.with_extension("prj")).filter(|p| p.is_file()).into_iter().collect())),
    read,
    write: Some(write),
};

/// The keys of the header.
const KEYS: [&str; 10] =
    ["ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize", "dx", "dy", "nodata_value"];

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let text = text_of(path)?;
    let mut words = text.split_whitespace().peekable();
    let mut head = BTreeMap::new();
    while let Some(key) = words.next_if(|w| KEYS.contains(&&*w.to_ascii_lowercase())) {
        let value = numbers(path, &mut words, 1)?.first().copied().unwrap_or(f64::NAN);
        head.insert(key.to_ascii_lowercase(), value);
    }
    let need = |keys: &[&'static str]| {
        let found = keys.iter().find_map(|k| head.get(*k).map(|v| (*k, *v)));
        found.ok_or_else(|| ReadError::data(path, format!("the header lacks `{}`", keys.join("` or `"))))
    };
    let (columns, rows) = (need(&["ncols"])?.1, need(&["nrows"])?.1);
    let (width, height) = nodes(path, columns as i64, rows as i64, 2, text.len() as u64 + 1)?;
    let (dx, dy) = (need(&["dx", "cellsize"])?.1, need(&["dy", "cellsize"])?.1);
    let place = |corner: &'static str, centre: &'static str, step: f64| {
        let (key, at) = need(&[corner, centre])?;
        Ok::<_, ReadError>(if key == corner { at + 0.5 * step } else { at })
    };
    let (west, south) = (place("xllcorner", "xllcenter", dx)?, place("yllcorner", "yllcenter", dy)?);
    // -9999 is the default of the format.
    let unknown = head.get("nodata_value").copied().unwrap_or(-9999.0);
    let known = |v: f64| if is_marker(v, unknown) { f64::NAN } else { v };
    let values = numbers(path, &mut words, width * height)?.into_iter().map(known).collect();
    let north = south + dy * (height - 1) as f64;
    let (x, y) = (FileAxis::new(path, "x", west, dx, width)?, FileAxis::new(path, "y", north, -dy, height)?);
    let wkt = std::fs::read_to_string(path.with_extension("prj")).unwrap_or_default();
    let system = epsg_of_wkt(&wkt).map_or(FileCrs::Unknown, FileCrs::Epsg);
    let mut draft = MapDraft::new(path, x, y, values, system);
    draft.axis_unit = unit_of_wkt(&wkt).map(|(name, metres)| AxisUnit::Length(name, metres));
    if head.contains_key("xllcorner") {
        draft.registration = Registration::Pixel;
    }
    draft.finish(options)
}

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    level_m(outputs, map, FORMAT.name)?;
    let pixel = map.registration == Registration::Pixel;
    let (word, west, south) = match pixel {
        true => ("corner", map.x.first - 0.5 * map.x.step, map.y.first - 0.5 * map.y.step),
        false => ("center", map.x.first, map.y.first),
    };
    let unknown = unused(&map.anomaly_nt);
    let cells = match map.x.step == map.y.step {
        true => format!("cellsize {}", map.x.step),
        false => format!("dx {}\ndy {}", map.x.step, map.y.step),
    };
    let head = format!(
        "ncols {}\nnrows {}\nxll{word} {west}\nyll{word} {south}\n{cells}\nNODATA_value {unknown}\n",
        map.x.len, map.y.len
    );
    let mut sink = outputs.create()?;
    sink.write_all(head.as_bytes()).map_err(|e| outputs.io(&e))?;
    write_rows(outputs, &mut sink, map, true, map.x.len, &unknown.to_string())?;
    outputs.finish(sink)?;
    let mut prj = outputs.create_at(outputs.path().with_extension("prj"))?;
    prj.write_all(map.crs.wkt().as_bytes()).map_err(|e| outputs.io(&e))?;
    outputs.finish(prj)
}

/// A number that marks unknown nodes, because it differs from all values.
pub(super) fn unused(values: &[f64]) -> f64 {
    let mut candidate = -99_999.0;
    while values.contains(&candidate) {
        candidate = candidate * 10.0 - 9.0;
    }
    candidate
}

//! Surfer 7 grids (`DSRB`): tagged sections, of which `GRID` has the position and `DATA` the double-precision rows from
//! the south. [Golden Software, Surfer 7 grid file format]
//!
//! The format has no coordinate system, unit or height. Reading requires `epsg`; writing omits them.

use std::{io::Write, path::Path};

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{FieldCursor, SURFER_BLANK, bytes_of, level_m, nodes, range, rows},
    output::MapOutputFiles,
};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft, is_marker},
};
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "surfer7",
    about: "Surfer 7 grid (DSRB), double precision",
    extensions: &["grd"],
    recognise: |head: &FileHead| head.starts_with(b"DSRB"),
    companions: None,
    read,
    write: Some(write),
};

/// Contents of the `GRID` section: axes, blank value, width and height.
struct SurferGridHeader {
    x: FileAxis,
    y: FileAxis,
    blank: f64,
    width: usize,
    height: usize,
}

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let bytes = bytes_of(path)?;
    let mut fields = FieldCursor::new(path, &bytes);
    let mut place = None;
    let mut version = 1;
    loop {
        let tag = fields.take(4)?;
        let size = u32::from_le_bytes(fields.take(4)?.try_into().unwrap_or_default()) as usize;
        let mut section = FieldCursor::new(path, fields.take(size)?);
        match (tag, place.as_ref()) {
            (b"DSRB", None) => version = section.i32()?,
            (b"GRID", None) => place = Some(grid(path, &mut section, bytes.len() as u64)?),
            (b"DATA", Some(place)) => return data(path, options, place, version, &mut section),
            (b"DATA", None) => return Err(ReadError::data(path, "the section DATA comes before the section GRID")),
            // Fault lines, and sections of later versions, are skipped.
            _ => {}
        }
    }
}

fn grid(path: &Path, section: &mut FieldCursor, bytes: u64) -> Result<SurferGridHeader, ReadError> {
    let (rows, columns) = (section.i32()?, section.i32()?);
    let [west, south, dx, dy] = [section.f64()?, section.f64()?, section.f64()?, section.f64()?];
    let [_, _, rotation, blank] = [section.f64()?, section.f64()?, section.f64()?, section.f64()?];
    if rotation != 0.0 {
        return Err(ReadError::data(path, format!("the grid is rotated by {rotation} degrees"))
            .help("warp the grid to north-up first"));
    }
    let (width, height) = nodes(path, columns.into(), rows.into(), 8, bytes)?;
    let x = FileAxis::new(path, "x", west, dx, width)?;
    let y = FileAxis::new(path, "y", south, dy, height)?;
    Ok(SurferGridHeader { x, y, blank, width, height })
}

fn data(
    path: &Path,
    options: &MapOptions,
    place: &SurferGridHeader,
    version: i32,
    section: &mut FieldCursor,
) -> Result<AnomalyGrid, ReadError> {
    // In version 1, all values greater than or equal to the blank value are blank; in version 2, only values equal to
    // it are.
    let blank = |v: f64| is_marker(v, place.blank) || version < 2 && v >= place.blank;
    let value = |b: &[u8]| b.try_into().map_or(f64::NAN, f64::from_le_bytes);
    let known = |v: f64| if blank(v) || v >= SURFER_BLANK { f64::NAN } else { v };
    let values = section.take(8 * place.width * place.height)?.chunks_exact(8).map(|b| known(value(b))).collect();
    MapDraft::new(path, place.x, place.y, values, FileCrs::Unknown).finish(options)
}

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    level_m(outputs, map, FORMAT.name)?;
    let refused = || ReadError::options(outputs.path(), "a Surfer 7 grid has at most 4 GiB of values");
    let size = |n: usize| i32::try_from(n).map_err(|_| refused());
    let bytes = map.nodes().checked_mul(8).and_then(|n| u32::try_from(n).ok()).ok_or_else(refused)?;
    let mut head = b"DSRB".to_vec();
    for field in [4_i32, 1] {
        head.extend(field.to_le_bytes());
    }
    head.extend(b"GRID");
    for field in [72, size(map.y.len)?, size(map.x.len)?] {
        head.extend(field.to_le_bytes());
    }
    let (least, most) = range(&map.anomaly_nt);
    for x in [map.x.first, map.y.first, map.x.step, map.y.step, least, most, 0.0, SURFER_BLANK] {
        head.extend(x.to_le_bytes());
    }
    head.extend(b"DATA");
    head.extend(bytes.to_le_bytes());
    let mut sink = outputs.create()?;
    sink.write_all(&head).map_err(|e| outputs.io(&e))?;
    for row in rows(map, false) {
        let value = |v: &f64| if v.is_nan() { SURFER_BLANK } else { *v };
        let bytes: Vec<u8> = row.iter().flat_map(|v| value(v).to_le_bytes()).collect();
        sink.write_all(&bytes).map_err(|e| outputs.io(&e))?;
    }
    outputs.finish(sink)
}

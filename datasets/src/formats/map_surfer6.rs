//! Surfer 6 grids in binary (`DSBB`): size, ends of the axes and of the values, then single-precision rows from the
//! south. [Golden Software, Surfer 6 binary grid file format]
//!
//! The format has no coordinate system, unit or height. Reading requires `epsg`; writing omits them and rounds the
//! values to single precision.

use std::{io::Write, path::Path};

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{FieldCursor, blanked, bytes_of, level_m, nodes, range, rows},
    output::MapOutputFiles,
};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft},
};
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "surfer6",
    about: "Surfer 6 grid, binary (DSBB), single precision",
    extensions: &["grd"],
    recognise: |head: &FileHead| head.starts_with(b"DSBB"),
    companions: None,
    read,
    write: Some(write),
};

/// The value that the writer uses for unknown nodes.
const BLANK: f32 = 1.701_41e38;

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let bytes = bytes_of(path)?;
    let mut fields = FieldCursor::new(path, &bytes);
    if fields.take(4)? != b"DSBB" {
        return Err(ReadError::data(path, "the file is not a Surfer 6 binary grid: it must begin with DSBB"));
    }
    let (columns, rows) = (fields.i16()?, fields.i16()?);
    let [west, east, south, north] = [fields.f64()?, fields.f64()?, fields.f64()?, fields.f64()?];
    fields.take(16)?;
    let (width, height) = nodes(path, columns.into(), rows.into(), 4, fields.left())?;
    let single = |b: &[u8]| b.try_into().map_or(f64::NAN, |b| blanked(f64::from(f32::from_le_bytes(b))));
    let values = fields.take(4 * width * height)?.chunks_exact(4).map(single).collect();
    let x = FileAxis::between(path, "x", west, east, width)?;
    let y = FileAxis::between(path, "y", south, north, height)?;
    MapDraft::new(path, x, y, values, FileCrs::Unknown).finish(options)
}

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    level_m(outputs, map, FORMAT.name)?;
    let size = |n: usize| {
        i16::try_from(n).map_err(|_| {
            ReadError::options(outputs.path(), format!("a Surfer 6 grid has at most 32767 nodes per side, not {n}"))
                .help("use the format `surfer7`")
        })
    };
    let (width, height) = (size(map.x.len)?, size(map.y.len)?);
    let mut head = b"DSBB".to_vec();
    head.extend(width.to_le_bytes());
    head.extend(height.to_le_bytes());
    let (least, most) = range(&map.anomaly_nt);
    for x in [map.x.first, map.x.last(), map.y.first, map.y.last(), least, most] {
        head.extend(x.to_le_bytes());
    }
    let mut sink = outputs.create()?;
    sink.write_all(&head).map_err(|e| outputs.io(&e))?;
    for row in rows(map, false) {
        let single = |v: &f64| if v.is_nan() { BLANK } else { *v as f32 };
        let bytes: Vec<u8> = row.iter().flat_map(|v| single(v).to_le_bytes()).collect();
        sink.write_all(&bytes).map_err(|e| outputs.io(&e))?;
    }
    outputs.finish(sink)
}

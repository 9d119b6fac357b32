//! Surfer 6 grids as text (`DSAA`): size, ends of the axes and of the values, then rows from the south.
//! [Golden Software, Surfer 6 text grid file format]
//!
//! The format has no coordinate system, unit or height: reading requires `epsg`, writing omits them.

use std::{io::Write, path::Path};

use super::{
    FileHead, MapFormat, MapOptions,
    grid_bytes::{blanked, level_m, nodes, numbers, range, text_of, write_rows},
    output::MapOutputFiles,
};
use crate::{
    ReadError,
    grid::{FileAxis, FileCrs, MapDraft},
};
use grids::AnomalyGrid;

pub(super) const FORMAT: MapFormat = MapFormat {
    name: "surfer6_text",
    about: "Surfer 6 grid, text (DSAA)",
    extensions: &["grd"],
    recognise: |head: &FileHead| head.starts_with(b"DSAA"),
    companions: None,
    read,
    write: Some(write),
};

fn read(path: &Path, options: &MapOptions) -> Result<AnomalyGrid, ReadError> {
    let text = text_of(path)?;
    let mut words = text.split_whitespace();
    if words.next() != Some("DSAA") {
        return Err(ReadError::data(path, "is not a Surfer 6 text grid: it does not begin with DSAA"));
    }
    let head = numbers(path, &mut words, 8)?;
    let [columns, rows, west, east, south, north, ..] = head.as_slice() else {
        return Err(ReadError::data(path, "the file is cut short"));
    };
    // Each value takes at least two bytes, a character and a blank; the last value may lack the blank.
    let (width, height) = nodes(path, *columns as i64, *rows as i64, 2, text.len() as u64 + 1)?;
    let values = numbers(path, &mut words, width * height)?.into_iter().map(blanked).collect();
    let x = FileAxis::between(path, "x", *west, *east, width)?;
    let y = FileAxis::between(path, "y", *south, *north, height)?;
    MapDraft::new(path, x, y, values, FileCrs::Unknown).finish(options)
}

fn write(map: &AnomalyGrid, outputs: &mut MapOutputFiles) -> Result<(), ReadError> {
    level_m(outputs, map, FORMAT.name)?;
    let mut sink = outputs.create()?;
    let (least, most) = range(&map.anomaly_nt);
    let head = format!(
        "DSAA\n{} {}\n{} {}\n{} {}\n{least} {most}\n",
        map.x.len,
        map.y.len,
        map.x.first,
        map.x.last(),
        map.y.first,
        map.y.last()
    );
    sink.write_all(head.as_bytes()).map_err(|e| outputs.io(&e))?;
    write_rows(outputs, &mut sink, map, false, 10, "1.70141e+38")?;
    outputs.finish(sink)
}

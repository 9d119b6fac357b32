//! `magline map convert`: a map in another format, coordinate system or extent.

use std::path::{Path, PathBuf};

use clap::Args;
use datasets::{GridMap, Height};
use numerics::maps::{continuation::expand, plane_grid::EvenAxis};
use schemas::Fault;

use super::{Bounds, InputArgs, OutputArgs, Stop, ThreadArgs, wrong};

#[derive(Args)]
pub struct ConvertArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// The EPSG code of the coordinate system it is resampled to, such as 4326 or 32754.
    #[arg(long)]
    to_epsg: Option<u16>,
    /// The distance between nodes, in units of the coordinate system that is written.
    #[arg(long)]
    spacing: Option<f64>,
    /// Cut to these coordinates of the system that is written.
    #[arg(long, value_name = "WEST,SOUTH,EAST,NORTH", value_parser = super::bounds, allow_hyphen_values = true)]
    bounds: Option<Bounds>,
    /// Cut rows and columns at the edges that hold no value.
    #[arg(long)]
    trim: bool,
    /// Wrap the map around: at least so many nodes more on each side, and sizes that have no prime factor above 7.
    #[arg(long, value_name = "NODES")]
    expand: Option<usize>,
    #[command(flatten)]
    threads: ThreadArgs,
}

pub fn run(args: &ConvertArgs) -> Result<(), Stop> {
    args.threads.run(|| {
        let mut map = args.input.read(&args.map)?;
        if args.to_epsg.is_some() || args.spacing.is_some() {
            let epsg = args.to_epsg.unwrap_or(map.crs.code());
            map = map.to_crs(epsg, args.spacing).map_err(Fault::from)?;
        }
        if let Some(Bounds { west, south, east, north }) = args.bounds {
            let rows = within(&map.y, (south, north));
            let columns = within(&map.x, (west, east));
            map = cut(&args.map, &map, rows, columns)?;
        }
        if args.trim {
            let (rows, columns) = known_box(&map);
            map = cut(&args.map, &map, rows, columns)?;
        }
        if let Some(pad) = args.expand {
            map = expanded(&args.map, &map, pad)?;
        }
        args.output.write(&map)
    })
}

/// The nodes of an axis between two coordinates.
fn within(axis: &EvenAxis, (low, high): (f64, f64)) -> std::ops::Range<usize> {
    let inside = |i: &usize| (low..=high).contains(&axis.at(*i as f64));
    let first = (0..axis.len).find(inside).unwrap_or(axis.len);
    let after = (0..axis.len).rev().find(inside).map_or(first, |i| i + 1);
    first..after
}

/// The rows and columns from the first to the last that hold a value.
fn known_box(map: &GridMap) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let known = |row: usize, column: usize| !map.anomaly_nt[row * map.x.len + column].is_nan();
    let rows: Vec<usize> = (0..map.y.len).filter(|j| (0..map.x.len).any(|i| known(*j, i))).collect();
    let columns: Vec<usize> = (0..map.x.len).filter(|i| (0..map.y.len).any(|j| known(j, *i))).collect();
    let range = |of: &[usize]| of.first().copied().unwrap_or(0)..of.last().map_or(0, |last| last + 1);
    (range(&rows), range(&columns))
}

/// The part of a map in some rows and columns.
fn cut(
    path: &Path,
    map: &GridMap,
    rows: std::ops::Range<usize>,
    columns: std::ops::Range<usize>,
) -> Result<GridMap, Stop> {
    if rows.len() < 2 || columns.len() < 2 {
        return Err(wrong(path, &"nothing of the map is left"));
    }
    let part = |axis: &EvenAxis, of: &std::ops::Range<usize>| EvenAxis {
        first: axis.at(of.start as f64),
        step: axis.step,
        len: of.len(),
    };
    let of = |values: &[f64]| -> Vec<f64> {
        let row = |j: usize| &values[j * map.x.len + columns.start..j * map.x.len + columns.end];
        rows.clone().flat_map(|j| row(j).to_vec()).collect()
    };
    let height = match &map.height {
        Height::Level(alt_m) => Height::Level(*alt_m),
        Height::Cells(cells) => Height::Cells(of(cells)),
    };
    let (x, y) = (part(&map.x, &columns), part(&map.y, &rows));
    let cut = GridMap { x, y, anomaly_nt: of(&map.anomaly_nt), height, ..map.clone() };
    Ok(cut)
}

fn expanded(path: &Path, map: &GridMap, pad: usize) -> Result<GridMap, Stop> {
    let Height::Level(alt_m) = map.height else {
        return Err(wrong(path, &"a draped map cannot be wrapped around: continue it to a level first"));
    };
    let plane = map.plane();
    if plane.unknown() > 0 {
        return Err(wrong(path, &"a map with gaps cannot be wrapped around: fill it first with `magline map fill`"));
    }
    let (wide, _) = expand(&plane, pad).map_err(|e| wrong(path, &e))?;
    Ok(map.with_plane(wide, Height::Level(alt_m)).map_err(Fault::from)?)
}

//! `magline map fill`: gaps filled from their surroundings, or from other maps.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use datasets::{GridMap, Height};
use numerics::maps::{
    combine::{BiasModel, Blend, CombineOptions, Combined, Piece, combine},
    continuation::{Padding, upward},
    fill::{NearestFill, SmoothFill, Weights, nearest, smooth},
    plane_grid::{EvenAxis, PlaneGrid},
};
use schemas::Fault;

use super::{InputArgs, OutputArgs, Stop, ThreadArgs, note, tell, wrong};

#[derive(Args)]
pub struct FillArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// How gaps are filled from their surroundings.
    #[arg(long, value_enum, default_value_t = Method::Knn)]
    method: Method,
    /// How many neighbours a value is the mean of (`knn`).
    #[arg(long, default_value_t = 3)]
    neighbours: usize,
    /// Weigh neighbours by the distance to minus this power (`knn`).
    #[arg(long)]
    power: Option<f64>,
    /// Leave nodes unknown that are farther than this from a known one, in metres (`knn`).
    #[arg(long)]
    within: Option<f64>,
    /// Other maps of the field, in the order in which they are to be preferred: what the map does not know comes from
    /// them first. They are brought into its coordinate system and, where they are lower, up to its height.
    #[arg(long, num_args = 1.., value_name = "MAP")]
    with: Vec<PathBuf>,
    /// Over how many metres a map fades into the next at its edge.
    #[arg(long, default_value_t = 1000.0)]
    feather: f64,
    /// Which difference to the map, found in the overlap, is removed from the others.
    #[arg(long, value_enum, default_value_t = Level::Constant)]
    level: Level,
    /// Make the map as large as all maps together.
    #[arg(long, requires = "with")]
    extend: bool,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// How gaps are filled.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Method {
    /// The mean of the nearest known nodes.
    Knn,
    /// A harmonic surface: never above or below what is around the gap.
    Harmonic,
    /// The surface of minimum curvature, which keeps the slope at the gap's edge.
    MinimumCurvature,
    /// Not at all: only from other maps.
    None,
}

/// What is removed from other maps.
#[derive(Clone, Copy, ValueEnum)]
enum Level {
    /// Nothing.
    Nothing,
    /// A constant.
    Constant,
    /// A plane.
    Plane,
}

pub fn run(args: &FillArgs) -> Result<(), Stop> {
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        let before = map.plane().unknown();
        let map = if args.with.is_empty() { map } else { combined(args, &map)? };
        let filled = from_surroundings(args, &map.plane())?;
        note(&format!("{before} unknown nodes before, {} after", filled.unknown()));
        args.output.write(&map.with_plane_values(filled.values).map_err(Fault::from)?)
    })
}

fn from_surroundings(args: &FillArgs, plane: &PlaneGrid) -> Result<PlaneGrid, Stop> {
    let fault = |e: &dyn std::fmt::Display| wrong(&args.map, e);
    let surface = |keep_slope: bool| {
        let options = SmoothFill { keep_slope, ..SmoothFill::default() };
        smooth(plane, &options).map(|(grid, _)| grid).map_err(|e| fault(&e))
    };
    match args.method {
        Method::None => Ok(plane.clone()),
        Method::Harmonic => surface(false),
        Method::MinimumCurvature => surface(true),
        Method::Knn => {
            let weights = args.power.map_or(Weights::Equal, Weights::InverseDistance);
            let options = NearestFill { neighbours: args.neighbours, weights, max_distance_m: args.within };
            nearest(plane, &options).map_err(|e| fault(&e))
        }
    }
}

/// The map with what the others know.
fn combined(args: &FillArgs, map: &GridMap) -> Result<GridMap, Stop> {
    let Height::Level(level_m) = map.height else {
        return Err(wrong(&args.map, &"a draped map cannot be combined: continue it to a level first"));
    };
    // The others' heights and units are their files'.
    let input = InputArgs { format: None, epsg: None, alt: None, unit: None };
    let mut planes = vec![map.plane()];
    let (unit_x, unit_y) = map.unit_m();
    for path in &args.with {
        let other = input.read(path)?;
        let other = other.to_crs(map.crs.code(), None).map_err(Fault::from)?;
        let (x, y) = (in_metres(&other.x, unit_x), in_metres(&other.y, unit_y));
        let plane = PlaneGrid { east_m: x, north_m: y, values: other.anomaly_nt.clone() };
        planes.push(at_level(path, plane, &other.height, level_m)?);
    }
    let (east_m, north_m) = if args.extend {
        (extended(&planes, |p| p.east_m), extended(&planes, |p| p.north_m))
    } else {
        (planes[0].east_m, planes[0].north_m)
    };
    let bias = match args.level {
        Level::Nothing => BiasModel::Nothing,
        Level::Constant => BiasModel::Constant,
        Level::Plane => BiasModel::Plane,
    };
    let options = CombineOptions { blend: Blend::Priority, feather_m: args.feather, bias };
    let pieces: Vec<Piece> = planes.iter().map(|grid| Piece { grid, weight: 1.0 }).collect();
    let done = combine(&pieces, east_m, north_m, &options).map_err(|e| wrong(&args.map, &e))?;
    compare(args, &done);
    Ok(map.with_plane(done.grid, Height::Level(level_m)).map_err(Fault::from)?)
}

fn compare(args: &FillArgs, done: &Combined) {
    let name = |i: usize| i.checked_sub(1).and_then(|i| args.with.get(i)).unwrap_or(&args.map).display().to_string();
    for o in &done.overlaps {
        note(&format!(
            "{} less {} at {} nodes: median {:.2} nT, rms {:.2} nT; after levelling {:.2} and {:.2} nT",
            name(o.first),
            name(o.second),
            o.before.count,
            o.before.median,
            o.before.rms,
            o.after.median,
            o.after.rms
        ));
    }
}

/// A map at the height of another: continued upward where it is lower.
fn at_level(path: &Path, plane: PlaneGrid, height: &Height, level_m: f64) -> Result<PlaneGrid, Stop> {
    let Height::Level(from_m) = height else {
        return Err(wrong(path, &"a draped map cannot be combined: continue it to a level first"));
    };
    let up_m = level_m - from_m;
    if up_m.is_nan() {
        tell(&format!("warning: a height is unknown; {} is taken to be as high as the map", path.display()));
        return Ok(plane);
    }
    if up_m < 0.0 {
        let what = format!("the map is {:.0} m above the one it is to fill", -up_m);
        let fault = Fault::new(what).in_file(&path.display().to_string());
        return Err(fault.help("continue it down yourself with `magline map continue`, or fill the higher map").into());
    }
    if up_m == 0.0 {
        return Ok(plane);
    }
    note(&format!("{} is continued upward by {up_m:.1} m", path.display()));
    let (full, _) = smooth(&plane, &SmoothFill::default()).map_err(|e| wrong(path, &e))?;
    let up = upward(&full, up_m, &Padding::default()).map_err(|e| wrong(path, &e))?;
    Ok(numerics::maps::continuation::masked_like(up, &plane))
}

fn in_metres(axis: &EvenAxis, unit_m: f64) -> EvenAxis {
    EvenAxis { first: axis.first * unit_m, step: axis.step * unit_m, len: axis.len }
}

/// The first map's axis, continued to where the farthest of all maps ends.
fn extended(planes: &[PlaneGrid], of: impl Fn(&PlaneGrid) -> EvenAxis) -> EvenAxis {
    let own = of(&planes[0]);
    let first = planes.iter().map(|p| of(p).first).fold(own.first, f64::min);
    let last = planes.iter().map(|p| of(p).last()).fold(own.last(), f64::max);
    let before = ((own.first - first) / own.step).floor();
    let after = ((last - own.last()) / own.step).floor();
    EvenAxis { first: own.at(-before), step: own.step, len: own.len + before as usize + after as usize }
}

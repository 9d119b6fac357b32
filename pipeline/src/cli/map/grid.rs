//! `magline map grid`: a map of survey points.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use datasets::{Height, PointOptions, SurveyPoints, check_output, read_points};
use numerics::{
    earth::{
        core_field::{CoreModel, CoreTrack},
        dates::decimal_year,
    },
    maps::{
        gridding::{self, Folds, GridError, GridOptions, Gridded, Method, Region, Spread},
        levelling::{CrossoverOptions, LevelOptions, Levelled, LineCorrection, Merit, find_crossovers, level_lines},
    },
};
use schemas::Fault;

use super::{Bounds, OutputArgs, Stop, ThreadArgs, say, write_to, wrong};
use crate::cli::{is_quiet, note, progress::Progress};

mod cleaning;

#[derive(Args)]
pub struct GridArgs {
    /// Survey points: Parquet, CSV, xyz, or any flight format.
    #[arg(required = true)]
    points: Vec<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    columns: ColumnArgs,
    #[command(flatten)]
    reduction: ReductionArgs,
    /// How the surface between the points is made.
    #[arg(long, value_enum, default_value_t = Surface::EquivalentSources)]
    method: Surface,
    /// The distance between nodes in metres; half the distance between lines when left out.
    #[arg(long)]
    spacing: Option<f64>,
    /// The height of the map in metres, for equivalent sources; that of the highest point when left out.
    #[arg(long, allow_negative_numbers = true)]
    level: Option<f64>,
    /// Damping of the equivalent sources, 1 when left out.
    #[arg(long)]
    damping: Option<f64>,
    /// Tension of the minimum-curvature surface, 0 to 1; 0.25 when left out.
    #[arg(long)]
    tension: Option<f64>,
    /// Eastings and northings in metres that the map covers; all points when left out.
    #[arg(long, value_name = "WEST,SOUTH,EAST,NORTH", value_parser = super::bounds, allow_hyphen_values = true)]
    bounds: Option<Bounds>,
    /// Side of the blocks that points are reduced to, in metres; 0 keeps every point.
    #[arg(long)]
    block: Option<f64>,
    /// Leave nodes unknown that are farther than this from any point, in metres; twice the distance between lines when
    /// left out, `inf` for none.
    #[arg(long)]
    mask: Option<f64>,
    /// Keep points that stand out from their line, and those that are far from all others.
    #[arg(long)]
    keep_outliers: bool,
    /// Leave out every N-th line in turn and predict it from the others.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(2..))]
    cross_validate: Option<u16>,
    /// Write the expected error of each node, which needs `--cross-validate`.
    #[arg(long, requires = "cross_validate")]
    error: Option<PathBuf>,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Where the columns are. Those that are not named are found by the usual names.
#[derive(Args)]
struct ColumnArgs {
    /// A flight format, `parquet` or `text`, where content and name of the file do not tell.
    #[arg(long)]
    format: Option<String>,
    /// The column of longitudes or eastings.
    #[arg(long)]
    x: Option<String>,
    /// The column of latitudes or northings.
    #[arg(long)]
    y: Option<String>,
    /// The column of heights.
    #[arg(long)]
    height: Option<String>,
    /// The column of the values.
    #[arg(long)]
    value: Option<String>,
    /// The column of line names.
    #[arg(long)]
    line: Option<String>,
    /// The EPSG code of the places; degrees of WGS-84 where the columns are latitude and longitude.
    #[arg(long)]
    epsg: Option<u16>,
    /// The EPSG code of the map; that of eastings and northings, else the UTM zone, when left out.
    #[arg(long)]
    to_epsg: Option<u16>,
}

/// What is taken off the values before.
#[derive(Args)]
struct ReductionArgs {
    /// Take the magnitude of the core field off.
    #[arg(long, value_enum)]
    core_field: Option<Core>,
    /// The date of the core field, before the points' own.
    #[arg(long)]
    decimal_year: Option<f64>,
    /// Take the column `diurnal` off.
    #[arg(long)]
    diurnal: bool,
    /// Level the lines by their crossings: a constant for each line (0), a linear correction (1), and so on.
    #[arg(long, value_name = "ORDER", value_parser = clap::value_parser!(u8).range(0..=8), num_args = 0..=1, default_missing_value = "0")]
    level_lines: Option<u8>,
    /// Lines count as crossing where their heights differ by no more than this, in metres.
    #[arg(long, default_value_t = 50.0)]
    crossing_height: f64,
}

/// How a surface is made.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Surface {
    /// A layer of sources below the points that makes the same field: a potential field, at any height.
    EquivalentSources,
    /// The surface of minimum curvature, at the heights flown.
    MinimumCurvature,
}

/// Where the core field comes from.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Core {
    /// IGRF-14.
    Igrf,
    /// The World Magnetic Model.
    Wmm,
    /// The points' own column `igrf`.
    Column,
}

pub fn run(args: &GridArgs) -> Result<(), Stop> {
    validate(args)?;
    let shown = Progress::new(is_quiet());
    args.threads.run(|| {
        let progress = |what: &str, done: usize, all: usize| {
            shown.stage(what);
            shown.set(done, all);
        };
        let (mut points, far) = read(args, &progress)?;
        reduce(args, &mut points)?;
        let line: Vec<usize> = points.line.iter().map(|l| *l as usize).collect();
        if let Some(order) = args.reduction.level_lines {
            progress("levelling lines", 0, 1);
            let levelled = level(args, &points, &line, usize::from(order));
            say(told(&levelled, &points.lines))?;
            points.value_nt.iter_mut().zip(&levelled.correction_nt).for_each(|(v, c)| *v -= c);
        }
        let gridded = gridding::grid(survey(&points, &line), &options(args), &progress);
        let gridded = gridded.map_err(|e| refused(args, &e))?;
        let height = match gridded.report.level_m {
            Some(level_m) => Height::Level(level_m),
            None => flown(args, &points, &line, &gridded, &progress)?,
        };
        say(reported(&gridded, &points, far))?;
        if let (Some(path), Some(error)) = (&args.error, &gridded.error) {
            write_to(path, &points.grid(error.clone(), height.clone()).map_err(Fault::from)?, None)?;
        }
        args.output.write(&points.grid(gridded.grid, height).map_err(Fault::from)?)
    })
}

/// Refuses what cannot be, before anything is read.
fn validate(args: &GridArgs) -> Result<(), Stop> {
    args.output.check()?;
    if let Some(path) = &args.error {
        check_output(path, None).map_err(Fault::from)?;
    }
    let other = |flag: &str, method: &str| {
        let fault = Fault::new(format!("`{flag}` is of `--method {method}` alone"));
        Stop::from(fault.help(format!("leave `{flag}` out, or say `--method {method}`")))
    };
    match args.method {
        Surface::EquivalentSources if args.tension.is_some() => return Err(other("--tension", "minimum-curvature")),
        Surface::MinimumCurvature if args.level.is_some() => return Err(other("--level", "equivalent-sources")),
        Surface::MinimumCurvature if args.damping.is_some() => return Err(other("--damping", "equivalent-sources")),
        Surface::EquivalentSources | Surface::MinimumCurvature => {}
    }
    if args.reduction.crossing_height.is_nan() || args.reduction.crossing_height < 0.0 {
        let what = format!("`--crossing-height` is {}, but must be zero or above", args.reduction.crossing_height);
        return Err(Fault::new(what).into());
    }
    gridding::check(&options(args)).map_err(|e| refused(args, &e))
}

/// What the options or the points do not allow, and the way out.
fn refused(args: &GridArgs, error: &GridError) -> Stop {
    match error {
        GridError::BelowSources { lowest_m, .. } => {
            let fault = Fault::new(error.to_string()).in_file(&args.points[0].display().to_string());
            let help = "or leave `--level` out for the height of the highest point";
            Stop::from(fault.help(format!("say `--level {:.0}` or higher, {help}", lowest_m.ceil())))
        }
        GridError::Option { name, .. } => {
            let flag = name.trim_end_matches("_m");
            Fault::new(error.to_string().replace(&format!("`{name}`"), &format!("`--{flag}`"))).into()
        }
        GridError::NoPoints | GridError::Lengths { .. } | GridError::NotFinite { .. } | GridError::TooLarge { .. } => {
            wrong(&args.points[0], error)
        }
    }
}

/// All points, on the plane of the first file, and how many of them are far from all others.
fn read(args: &GridArgs, progress: gridding::Progress) -> Result<(SurveyPoints, usize), Stop> {
    let c = &args.columns;
    let mut options = PointOptions {
        format: c.format.clone(),
        x: c.x.clone(),
        y: c.y.clone(),
        height: c.height.clone(),
        value: c.value.clone(),
        line: c.line.clone(),
        epsg: c.epsg,
        to_epsg: c.to_epsg,
    };
    let mut all: Option<SurveyPoints> = None;
    let mut starts = vec![];
    for (done, path) in args.points.iter().enumerate() {
        progress("reading points", done, args.points.len());
        let points = read_points(path, &options).map_err(Fault::from)?;
        points.notes.iter().for_each(|n| note(&format!("{}: {n}", path.display())));
        starts.push(all.as_ref().map_or(0, SurveyPoints::len));
        match &mut all {
            None => {
                options.to_epsg = Some(points.crs.code());
                all = Some(points);
            }
            Some(all) => append(all, points),
        }
    }
    let mut all = all.ok_or_else(|| Stop::from(Fault::new("there are no survey points")))?;
    let far = if args.keep_outliers { 0 } else { cleaning::without_far(&mut all, &args.points, &starts) };
    Ok((all, far))
}

/// Adds the points of another file; a line of one name is one line.
fn append(all: &mut SurveyPoints, more: SurveyPoints) {
    let place = |name: &String, lines: &mut Vec<String>| {
        let known = lines.iter().position(|n| n == name);
        known.unwrap_or_else(|| {
            lines.push(name.clone());
            lines.len() - 1
        }) as u32
    };
    let places: Vec<u32> = more.lines.iter().map(|name| place(name, &mut all.lines)).collect();
    all.line.extend(more.line.iter().map(|l| places[*l as usize]));
    all.easting_m.extend(more.easting_m);
    all.northing_m.extend(more.northing_m);
    all.lat_deg.extend(more.lat_deg);
    all.lon_deg.extend(more.lon_deg);
    all.height_m.extend(more.height_m);
    all.value_nt.extend(more.value_nt);
    all.row.extend(more.row);
    // What only some of the files have is of no use.
    let both = |a: &mut Option<Vec<f64>>, b: Option<Vec<f64>>| match (a.as_mut(), b) {
        (Some(a), Some(b)) => a.extend(b),
        _ => *a = None,
    };
    both(&mut all.extra.tt_s, more.extra.tt_s);
    both(&mut all.extra.diurnal_nt, more.extra.diurnal_nt);
    both(&mut all.extra.igrf_nt, more.extra.igrf_nt);
    both(&mut all.extra.year, more.extra.year);
    both(&mut all.extra.doy, more.extra.doy);
}

/// Takes core field and diurnal variation off.
fn reduce(args: &GridArgs, points: &mut SurveyPoints) -> Result<(), Stop> {
    let lacks = |what: &str| {
        Stop::from(Fault::new(format!("the points have no {what}")).in_file(&args.points[0].display().to_string()))
    };
    if args.reduction.diurnal {
        let diurnal = points.extra.diurnal_nt.as_ref().ok_or_else(|| lacks("column `diurnal`"))?;
        points.value_nt.iter_mut().zip(diurnal).for_each(|(v, d)| *v -= d);
    }
    let model = match args.reduction.core_field {
        None => return Ok(()),
        Some(Core::Column) => {
            let core = points.extra.igrf_nt.as_ref().ok_or_else(|| lacks("column `igrf`"))?;
            points.value_nt.iter_mut().zip(core).for_each(|(v, c)| *v -= c);
            return Ok(());
        }
        Some(Core::Igrf) => CoreModel::Igrf14,
        Some(Core::Wmm) => CoreModel::Wmm,
    };
    let years = match args.reduction.decimal_year {
        Some(year) => vec![year; points.len()],
        None => dates(points).ok_or_else(|| lacks("date in columns `year`, `doy` and `tt`: say `--decimal-year`"))?,
    };
    let field = CoreTrack::new(model).field(&points.lat_deg, &points.lon_deg, &points.height_m, &years);
    let magnitude = field.map_err(|e| wrong(&args.points[0], &e))?.magnitude_nt();
    if magnitude.iter().all(|m| m.is_nan()) {
        return Err(lacks("heights or dates for the core field"));
    }
    points.value_nt.iter_mut().zip(magnitude).for_each(|(v, m)| *v -= m);
    Ok(())
}

fn dates(points: &SurveyPoints) -> Option<Vec<f64>> {
    let (year, doy) = (points.extra.year.as_ref()?, points.extra.doy.as_ref()?);
    let tt = points.extra.tt_s.as_ref();
    let one = |i: usize| decimal_year(year[i] as i32, doy[i] as u32, tt.map_or(0.0, |tt| tt[i])).unwrap_or(f64::NAN);
    Some((0..points.len()).map(one).collect())
}

fn survey<'a>(points: &'a SurveyPoints, line: &'a [usize]) -> gridding::SurveyPoints<'a> {
    gridding::SurveyPoints {
        easting_m: &points.easting_m,
        northing_m: &points.northing_m,
        height_m: &points.height_m,
        value_nt: &points.value_nt,
        line,
    }
}

fn level(args: &GridArgs, points: &SurveyPoints, line: &[usize], order: usize) -> Levelled {
    let crossings = CrossoverOptions { most_height_m: args.reduction.crossing_height, ..CrossoverOptions::default() };
    let found = find_crossovers(survey(points, line), &crossings);
    level_lines(survey(points, line), &found, &LevelOptions { order, ..LevelOptions::default() })
}

fn options(args: &GridArgs) -> GridOptions {
    let method = match (args.method, Method::minimum_curvature()) {
        (Surface::MinimumCurvature, Method::MinimumCurvature(relaxation)) => {
            let tension = args.tension.unwrap_or(relaxation.tension);
            Method::MinimumCurvature(gridding::Relaxation { tension, ..relaxation })
        }
        _ => Method::EquivalentSources { layers: None, damping: args.damping.unwrap_or(1.0), level_m: args.level },
    };
    let mut options = GridOptions::of(method);
    options.spacing_m = args.spacing;
    options.block_m = args.block;
    options.mask_m = args.mask;
    options.folds = args.cross_validate.map(|n| Folds::all(usize::from(n)));
    if let Some(Bounds { west, south, east, north }) = args.bounds {
        options.region = Some(Region { east_m: [west, east], north_m: [south, north] });
    }
    if args.keep_outliers {
        options.clean.sigmas = 0.0;
        options.clean.without_far = false;
    }
    options
}

/// The heights flown at each node, where the surface is at these.
fn flown(
    args: &GridArgs,
    points: &SurveyPoints,
    line: &[usize],
    gridded: &Gridded,
    progress: gridding::Progress,
) -> Result<Height, Stop> {
    if points.height_m.iter().all(|h| !h.is_finite()) {
        return Ok(Height::Level(f64::NAN));
    }
    let heights = gridding::SurveyPoints { value_nt: &points.height_m, ..survey(points, line) };
    let grid = &gridded.grid;
    let mut options = GridOptions::of(Method::minimum_curvature());
    options.clean.sigmas = 0.0;
    options.spacing_m = Some(grid.east_m.step);
    options.region = Some(Region {
        east_m: [grid.east_m.first, grid.east_m.last()],
        north_m: [grid.north_m.first, grid.north_m.last()],
    });
    options.mask_m = Some(f64::INFINITY);
    let heights = gridding::grid(heights, &options, progress).map_err(|e| wrong(&args.points[0], &e))?;
    Ok(Height::Cells(heights.grid.values))
}

/// What levelling did.
fn told(levelled: &Levelled, names: &[String]) -> String {
    let row = |name: &str, m: &Merit| {
        format!("{name:<22} {:>10.3} {:>10.3} {:>8}\n", m.figure_of_merit_crossings, m.median_nt, m.n)
    };
    let mut text = format!("{:<22} {:>10} {:>10} {:>8}\n", "crossings", "rms [nT]", "median [nT]", "n");
    text += &row("before levelling", &levelled.before);
    text += &row("after levelling", &levelled.after);
    if let Some(left_out) = &levelled.left_out {
        text += &row("left out in turn", left_out);
    }
    let ties = levelled.lines.iter().filter(|l| l.tie).count();
    let noise = &levelled.noise;
    text += &format!(
        "{} lines, {ties} of them ties; where level, they differ by {:.2} nT and {:.0} m of the gradient\n",
        levelled.lines.len(),
        noise.sigma_nt,
        noise.position_m
    );
    for (group, tie, spread_nt) in [("lines", false, levelled.spread_nt[0]), ("ties", true, levelled.spread_nt[1])] {
        let of: Vec<&LineCorrection> = levelled.lines.iter().filter(|l| l.tie == tie).collect();
        let alone = of.iter().filter(|l| l.alone).count();
        let Some(largest) = of.iter().max_by(|a, b| size(a).total_cmp(&size(b))) else { continue };
        let name = names.get(largest.line).map_or("", String::as_str);
        text += &match (size(largest) > 0.0, spread_nt > 0.0 || alone > 0) {
            (false, _) => format!("{group}: level within what their crossings tell, left as they are\n"),
            (true, false) => format!("{group}: all shifted by {:.2} nT\n", -largest.coefficients_nt[0]),
            (true, true) => {
                let most = -largest.coefficients_nt[0];
                format!("{group}: corrected by up to {most:.2} nT (line {name}), {alone} of them out by themselves\n")
            }
        };
    }
    text + "\n"
}

fn size(line: &LineCorrection) -> f64 {
    line.coefficients_nt.first().map_or(0.0, |c| c.abs())
}

/// What gridding did.
fn reported(gridded: &Gridded, points: &SurveyPoints, far: usize) -> String {
    let r = &gridded.report;
    let c = &r.cleaned;
    let spread = |s: &Spread| {
        format!("median {:.2} nT, rms {:.2} nT, 95 % below {:.2} nT, at {}", s.median_nt, s.rms_nt, s.p95_nt, s.n)
    };
    let mut text = format!(
        "points       {} of {} kept; left out: {far} far away, {} not finite, {} repeated, {} outliers, {} of short lines\n",
        c.kept.len(),
        points.len(),
        c.not_finite.len() - far,
        c.duplicates.len(),
        c.outliers.len(),
        c.of_short_lines.len()
    );
    text += &format!("lines        {}, {:.0} m apart\n", points.lines.len(), r.line_spacing_m);
    text += &format!("blocks       {} of {:.0} m, {} left out\n", r.blocks, r.block_m, r.misfits.len());
    for layer in &r.layers {
        text += &format!("sources      {} at a depth of {:.0} m\n", layer.sources, layer.layer.depth_m);
    }
    if let Some(level_m) = r.level_m {
        text += &format!("level        {level_m:.1} m\n");
    }
    text += &format!("misfit       {} blocks\n", spread(&r.misfit));
    if let Some(error) = &r.cross_validation {
        text += &format!("left out     {} points of lines left out in turn\n", spread(error));
    }
    let grid = &gridded.grid;
    text + &format!(
        "map          {} x {} nodes, {:.1} m apart, EPSG:{}, {} unknown\n",
        grid.rows(),
        grid.columns(),
        grid.east_m.step,
        points.crs.code(),
        grid.unknown()
    )
}

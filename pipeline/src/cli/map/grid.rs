//! `magline map grid`: a map of survey points.

use std::path::PathBuf;

use clap::Args;
use datasets::{GridHeight, LineType, PointOptions, SurveyPointSet, check_output, doubts, read_points};
use numerics::maps::{
    gridding::{DifferenceStatistics, GriddingReport},
    levelling::{CrossoverMerit, LevellingResult, LineCorrection},
    plane_grid::PlaneGrid,
};
use schemas::Fault;
use stages::map_grid::{MapGrid, MapGridProgress, NO_HEIGHTS, SurveyMap, without_far};

use super::{
    ExitReason, InvalidValueArgs, OutputArgs, ThreadArgs, apart,
    flags::{StageFlags, in_flags},
    of_file, say, warn, write_to,
};
use crate::cli::{is_quiet, note, progress::ProgressDisplay};

/// Maximum number of isolated points listed by name.
const NAMED: usize = 5;

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
    stage: StageFlags<MapGrid>,
    /// Write the expected error of each node to this file; requires `--cross-validate`.
    #[arg(long, requires = "stage.cross_validate")]
    error: Option<PathBuf>,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Options for the columns of survey points. Unset columns are found by their usual names.
#[derive(Args)]
struct ColumnArgs {
    /// A flight format, `parquet` or `text`, if the content and name of the file do not determine it.
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
    /// The EPSG code of the positions. Default for latitude and longitude: WGS-84 in degrees.
    #[arg(long)]
    epsg: Option<u16>,
    #[command(flatten)]
    doubtful: InvalidValueArgs,
}

pub fn run(args: &GridArgs) -> Result<(), ExitReason> {
    args.output.check(&args.points)?;
    if let Some(path) = &args.error {
        apart(path, &args.points)?;
        check_output(path, None).map_err(Fault::from)?;
    }
    let stage = args.stage.stage()?;
    stage.check().map_err(in_flags::<MapGrid>)?;
    let shown = ProgressDisplay::new(is_quiet());
    args.threads.run(|| {
        let progress = |what: &str, done: usize, all: usize| {
            shown.stage(what);
            shown.set(done, all);
        };
        let (mut points, far) = read(args, &stage, &progress)?;
        let refused = |fault| of_file(&args.points[0], in_flags::<MapGrid>(fault));
        let SurveyMap { map, error, report, levelled } = stage.apply(&mut points, &progress).map_err(refused)?;
        if let Some(levelled) = &levelled {
            say(levelling_report(levelled, &points.lines))?;
        }
        say(reported(&map.plane(), &report, &points, far))?;
        if matches!(map.height, GridHeight::Level(alt_m) if alt_m.is_nan()) {
            note(NO_HEIGHTS);
        }
        if let (Some(path), Some(error)) = (&args.error, &error) {
            write_to(path, error, None)?;
        }
        args.output.write(&map)
    })
}

/// All points in the projection of the first file, and the number of isolated points.
fn read(args: &GridArgs, stage: &MapGrid, progress: MapGridProgress) -> Result<(SurveyPointSet, usize), ExitReason> {
    let c = &args.columns;
    let mut options = PointOptions {
        format: c.format.clone(),
        x: c.x.clone(),
        y: c.y.clone(),
        height: c.height.clone(),
        value: c.value.clone(),
        line: c.line.clone(),
        epsg: c.epsg,
        missing: c.doubtful.missing(),
        accept: c.doubtful.accept(),
        to_epsg: stage.epsg().map_err(in_flags::<MapGrid>)?,
    };
    let mut all: Option<SurveyPointSet> = None;
    let mut starts = vec![];
    for (done, path) in args.points.iter().enumerate() {
        progress("reading points", done, args.points.len());
        let points = read_points(path, &options).map_err(Fault::from)?;
        points.notes.iter().for_each(|n| note(&format!("{}: {n}", path.display())));
        doubts(&points).iter().for_each(|n| warn(&format!("{}: {n}", path.display())));
        starts.push(all.as_ref().map_or(0, SurveyPointSet::len));
        match &mut all {
            None => {
                options.to_epsg = Some(points.crs.code());
                all = Some(points);
            }
            Some(all) => append(all, points),
        }
    }
    let mut all = all.ok_or_else(|| ExitReason::from(Fault::new("the files contain no survey points")))?;
    let far = if stage.keep_outliers { vec![] } else { without_far(&mut all) };
    name_far(&far, &all, &args.points, &starts);
    Ok((all, far.len()))
}

/// Adds the points of another file. Lines with equal names are merged. If their types differ, they stay separate: the
/// name of the second line gets the letter of its type as a prefix.
fn append(all: &mut SurveyPointSet, more: SurveyPointSet) {
    let places: Vec<u32> =
        more.lines.iter().zip(&more.types).map(|(name, kind)| place(all, name.clone(), *kind) as u32).collect();
    all.line.extend(more.line.iter().map(|l| places[*l as usize]));
    all.easting_m.extend(more.easting_m);
    all.northing_m.extend(more.northing_m);
    all.lat_deg.extend(more.lat_deg);
    all.lon_deg.extend(more.lon_deg);
    all.height_m.extend(more.height_m);
    all.value_nt.extend(more.value_nt);
    all.row.extend(more.row);
    // An additional column is kept only if all files have it.
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

/// Index of the line with this name and type, which is added if absent.
fn place(all: &mut SurveyPointSet, mut name: String, kind: Option<LineType>) -> usize {
    loop {
        match (all.lines.iter().position(|known| *known == name), kind) {
            (None, _) => {
                all.lines.push(name);
                all.types.push(kind);
                return all.lines.len() - 1;
            }
            (Some(at), Some(own)) if all.types.get(at).copied().flatten().is_some_and(|other| other != own) => {
                let other = name.clone();
                name.insert(0, own.letter());
                let known = all.lines.contains(&name);
                if !known {
                    note(&format!(
                        "line {other} has a different type in another file, so it is named {name} as a {}",
                        own.word()
                    ));
                }
            }
            (Some(at), _) => return at,
        }
    }
}

/// Lists isolated points by name. `starts` holds the index of the first point of each file.
fn name_far(far: &[usize], points: &SurveyPointSet, files: &[PathBuf], starts: &[usize]) {
    if far.is_empty() {
        return;
    }
    let many = if far.len() == 1 { "1 point is".to_owned() } else { format!("{} points are", far.len()) };
    note(&format!("{many} far from all others and therefore removed; `--keep-outliers` keeps such points"));
    for &i in far.iter().take(NAMED) {
        let file = starts.partition_point(|start| *start <= i).saturating_sub(1);
        let line = points.lines.get(points.line[i] as usize).filter(|name| !name.is_empty());
        note(&format!(
            "{}: row {}{} is at latitude {:.5}, longitude {:.5}",
            files.get(file).map_or(String::new(), |f| f.display().to_string()),
            points.row[i],
            line.map_or(String::new(), |name| format!(", line {name},")),
            points.lat_deg[i],
            points.lon_deg[i],
        ));
    }
    if far.len() > NAMED {
        note(&format!("and {} more", far.len() - NAMED));
    }
}

/// Report of levelling.
fn levelling_report(levelled: &LevellingResult, names: &[String]) -> String {
    let row = |name: &str, m: &CrossoverMerit| {
        format!("{name:<22} {:>10.3} {:>10.3} {:>8}\n", m.figure_of_merit_crossings, m.median_nt, m.n)
    };
    let mut text = format!("{:<22} {:>10} {:>10} {:>8}\n", "crossings", "rms [nT]", "median [nT]", "n");
    text += &row("before levelling", &levelled.before);
    text += &row("after levelling", &levelled.after);
    if let Some(left_out) = &levelled.left_out {
        text += &row("leave-one-out", left_out);
    }
    let ties = levelled.lines.iter().filter(|l| l.tie).count();
    let noise = &levelled.noise;
    text += &format!(
        "{} lines, including {ties} ties; standard deviation of level lines at crossings: {:.2} nT, plus {:.0} m \
         times the gradient\n",
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
            (false, _) => {
                format!("{group}: not corrected, because they are level within the accuracy of their crossings\n")
            }
            (true, false) => format!("{group}: all shifted by {:.2} nT\n", -largest.coefficients_nt[0]),
            (true, true) => {
                let most = -largest.coefficients_nt[0];
                format!("{group}: corrected by up to {most:.2} nT (line {name}), {alone} of them individually\n")
            }
        };
    }
    text + "\n"
}

fn size(line: &LineCorrection) -> f64 {
    line.coefficients_nt.first().map_or(0.0, |c| c.abs())
}

/// Report of gridding.
fn reported(grid: &PlaneGrid, r: &GriddingReport, points: &SurveyPointSet, far: usize) -> String {
    let c = &r.cleaned;
    let spread = |s: &DifferenceStatistics| {
        format!("median {:.2} nT, rms {:.2} nT, 95 % below {:.2} nT, at {}", s.median_nt, s.rms_nt, s.p95_nt, s.n)
    };
    let mut text = format!(
        "points       {} of {} kept; removed: {far} far away, {} not finite, {} duplicates, {} outliers, \
         {} of short lines\n",
        c.kept.len(),
        points.len(),
        c.not_finite.len() - far,
        c.duplicates.len(),
        c.outliers.len(),
        c.of_short_lines.len()
    );
    text += &format!("lines        {}, {:.0} m apart\n", points.lines.len(), r.line_spacing_m);
    text += &format!("blocks       {} of {:.0} m, {} removed\n", r.blocks, r.block_m, r.misfits.len());
    for layer in &r.layers {
        text += &format!("sources      {} at a depth of {:.0} m\n", layer.sources, layer.layer.depth_m);
    }
    if let Some(level_m) = r.level_m {
        text += &format!("level        {level_m:.1} m\n");
    }
    text += &format!("residual     {} blocks\n", spread(&r.misfit));
    if let Some(error) = &r.cross_validation {
        text += &format!("held out     {} points of lines held out in turn\n", spread(error));
    }
    text + &format!(
        "map          {} x {} nodes, {:.1} m apart, EPSG:{}, {} unknown\n",
        grid.rows(),
        grid.columns(),
        grid.east_m.step,
        points.crs.code(),
        grid.unknown()
    )
}

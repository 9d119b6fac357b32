//! `magline map continue`: a map at other heights.

use std::path::{Path, PathBuf};

use clap::Args;
use datasets::{AnomalyGrid, GridHeight};
use figures::{CurveLabels, curve_svg};
use numerics::maps::continuation::LCurve;
use schemas::Fault;
use stages::map_continue::MapContinue;

use super::{
    ExitReason, InputArgs, ThreadArgs, apart,
    flags::{StageFlags, in_flags},
    note, of_file, warn, write_to, wrong,
};

#[derive(Args)]
pub struct ContinueArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// Heights above the WGS-84 ellipsoid, in metres, separated by commas.
    #[arg(long, visible_alias = "to", value_name = "M", value_delimiter = ',', allow_negative_numbers = true)]
    to_m: Vec<f64>,
    /// A map on the same grid with the output height of each node.
    #[arg(long)]
    to_drape: Option<PathBuf>,
    #[command(flatten)]
    stage: StageFlags<MapContinue>,
    /// Write a plot of the L-curve of a downward continuation to this SVG file.
    #[arg(long)]
    l_curve: Option<PathBuf>,
    /// Write the edge error of each node to this file. The unknown field beyond the edges of the map causes this error.
    #[arg(long)]
    error: Option<PathBuf>,
    /// The output file. With several heights, its name must contain `{alt}`, which is replaced by the height.
    #[arg(short, long)]
    output: PathBuf,
    /// The output format, if the extension of the file does not determine it.
    #[arg(long)]
    output_format: Option<String>,
    #[command(flatten)]
    threads: ThreadArgs,
}

pub fn run(args: &ContinueArgs) -> Result<(), ExitReason> {
    if args.to_m.len() > 1 && !args.output.to_string_lossy().contains("{alt}") {
        let help = "use for example `-o map_{alt}.tif`";
        return Err(Fault::new("several heights require `{alt}` in the name of the output file").help(help).into());
    }
    let stage = args.stage.stage()?;
    let heights: Vec<Option<f64>> =
        if args.to_m.is_empty() { vec![None] } else { args.to_m.iter().copied().map(Some).collect() };
    let stages: Vec<MapContinue> = heights.into_iter().map(|to_m| MapContinue { to_m, ..stage.clone() }).collect();
    stages.iter().try_for_each(|s| s.check(args.to_drape.is_some())).map_err(in_flags::<MapContinue>)?;
    for output in [Some(&args.output), args.error.as_ref()].into_iter().flatten() {
        apart(output, args.to_drape.iter().chain([&args.map]))?;
    }
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        if map.value_unit != "nT" && stage.derivative.is_some() {
            return Err(wrong(&args.map, &format!("the map is already a derivative, in {}", map.value_unit)));
        }
        let drape = args.to_drape.as_ref().map(|path| InputArgs { alt: None, ..args.input.clone() }.read(path));
        let drape = drape.transpose()?;
        stages.iter().try_for_each(|stage| one(args, stage, &map, drape.as_ref()))
    })
}

/// The map at one height.
fn one(
    args: &ContinueArgs,
    stage: &MapContinue,
    map: &AnomalyGrid,
    drape: Option<&AnomalyGrid>,
) -> Result<(), ExitReason> {
    let done = stage.apply(map, drape).map_err(|fault| of_file(&args.map, in_flags::<MapContinue>(fault)))?;
    done.warnings.iter().for_each(|text| warn(text));
    done.notes.iter().for_each(|text| note(text));
    if let (Some(path), Some(curve)) = (&args.l_curve, &done.curve) {
        std::fs::write(path, l_curve(curve)).map_err(|e| unwritable(path, &e))?;
    }
    if let (Some(path), Some(error)) = (&args.error, done.edge_error) {
        write_to(path, &map.with_plane_values(error.values).map_err(Fault::from)?, None)?;
    }
    let alt_m = match (&done.map.height, &map.height) {
        (GridHeight::Level(alt_m), _) | (_, GridHeight::Level(alt_m)) => *alt_m,
        (GridHeight::Cells(_), GridHeight::Cells(_)) => f64::NAN,
    };
    let name = args.output.to_string_lossy().replace("{alt}", &alt_m.to_string());
    write_to(Path::new(&name), &done.map, args.output_format.as_deref())
}

/// The L-curve as a picture.
fn l_curve(curve: &LCurve) -> String {
    let points: Vec<(f64, f64)> = curve.points.iter().map(|p| (p.misfit_nt, p.roughness_nt_per_m)).collect();
    let marked = format!("alpha = {:.3e} m2", curve.corner_alpha_m2());
    let labels = CurveLabels {
        title: "L-curve of the downward continuation",
        x: "residual at the map's height (nT rms)",
        y: "gradient of the lower map (nT/m rms)",
        marked: &marked,
    };
    curve_svg(&points, Some(curve.corner), &labels).unwrap_or_default()
}

fn unwritable(path: &Path, e: &std::io::Error) -> ExitReason {
    ExitReason::Failed(format!("error: cannot write {}: {e}", path.display()))
}

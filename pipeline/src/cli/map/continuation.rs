//! `magline map continue`: a map at other heights.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use datasets::{GridMap, Height};
use figures::{CurveLabels, curve_svg};
use numerics::maps::{
    continuation::{
        self, Derivative, Drape, LCurve, MAGNAV_ALPHA_M2, Padding, Regularisation, Spectrum, downward, drape_to_level,
        edge_error, is_far, level_to_drape, masked_like,
    },
    fill,
    plane_grid::PlaneGrid,
};
use schemas::Fault;

use super::{InputArgs, Stop, ThreadArgs, note, tell, write_to, wrong};

#[derive(Args)]
pub struct ContinueArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// Heights in metres above the WGS-84 ellipsoid, separated by commas.
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true, required_unless_present_any = ["to_drape", "derivative"])]
    to: Vec<f64>,
    /// A map with a height for each node, on the same grid: the answer is at those heights.
    #[arg(long, conflicts_with = "to")]
    to_drape: Option<PathBuf>,
    /// Write a derivative, in nT/m (or nT/m2), instead of the field.
    #[arg(long, value_enum)]
    derivative: Option<Along>,
    /// Damping of downward continuation in m2, or `auto` for the corner of the L-curve.
    #[arg(long, default_value = "auto", allow_hyphen_values = true)]
    alpha: String,
    /// Draw the L-curve of a downward continuation into this SVG file.
    #[arg(long)]
    l_curve: Option<PathBuf>,
    /// Write the estimated error at each node, which the unknown field past the map's edges makes, into this file.
    #[arg(long)]
    error: Option<PathBuf>,
    /// Keep values where the map has none.
    #[arg(long)]
    keep_filled: bool,
    /// The file that is written; with several heights `{alt}` in its name stands for the height.
    #[arg(short, long)]
    output: PathBuf,
    /// The format it is written in, where the file's ending does not tell.
    #[arg(long)]
    output_format: Option<String>,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// A direction of differentiation.
#[derive(Clone, Copy, ValueEnum)]
enum Along {
    /// Upwards.
    Up,
    /// Northwards, along the map's northing.
    North,
    /// Eastwards, along the map's easting.
    East,
    /// Upwards, twice.
    Up2,
}

impl Along {
    fn which(self) -> Derivative {
        match self {
            Along::Up => Derivative::Up,
            Along::North => Derivative::North,
            Along::East => Derivative::East,
            Along::Up2 => Derivative::UpTwice,
        }
    }
}

/// A map and what is needed to continue it.
struct Job<'a> {
    args: &'a ContinueArgs,
    map: GridMap,
    /// The map on a plane, without gaps.
    plane: PlaneGrid,
    /// As it is, with gaps.
    original: PlaneGrid,
}

pub fn run(args: &ContinueArgs) -> Result<(), Stop> {
    let several = args.to.len() > 1;
    if several && !args.output.to_string_lossy().contains("{alt}") {
        let help = "write, for example, `-o map_{alt}.tif`";
        return Err(Fault::new("several heights need `{alt}` in the name of the output").help(help).into());
    }
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        if map.value_unit != "nT" && args.derivative.is_some() {
            return Err(wrong(&args.map, &format!("the map is a derivative already, in {}", map.value_unit)));
        }
        let original = map.plane();
        let plane = filled(&args.map, &original)?;
        let job = Job { args, map, plane, original };
        match (&args.to_drape, &job.map.height) {
            (Some(drape), _) => job.onto(drape),
            (None, Height::Cells(_)) if args.derivative.is_some() => {
                Err(job.wrong("a draped map has no derivative: continue it to a level first"))
            }
            (None, Height::Cells(heights)) => args.to.iter().try_for_each(|to| job.drape_to(heights, *to)),
            (None, Height::Level(_)) if args.derivative.is_some() => job.differentiate(),
            (None, Height::Level(level)) => args.to.iter().try_for_each(|to| job.level_to(*level, *to)),
        }
    })
}

fn filled(path: &Path, original: &PlaneGrid) -> Result<PlaneGrid, Stop> {
    let gaps = original.unknown();
    if gaps == 0 {
        return Ok(original.clone());
    }
    note(&format!("{gaps} unknown nodes are filled from their surroundings for the transform"));
    fill::smooth(original, &fill::SmoothFill::default()).map(|(full, _)| full).map_err(|e| wrong(path, &e))
}

impl Job<'_> {
    fn wrong(&self, e: impl std::fmt::Display) -> Stop {
        wrong(&self.args.map, &e)
    }

    fn known_level(&self, level_m: f64) -> Result<f64, Stop> {
        if level_m.is_finite() {
            return Ok(level_m);
        }
        let fault = Fault::new("the map does not say how high it is").in_file(&self.args.map.display().to_string());
        Err(fault.help("give its height with `--alt`, in metres above the WGS-84 ellipsoid").into())
    }

    fn warn_if_far(&self, distance_m: f64) {
        if is_far(&self.plane, distance_m) {
            tell(&format!(
                "warning: {distance_m:.0} m is more than 1/50 of the map's shorter side; what lies past its edges matters"
            ));
        }
    }

    fn alpha(&self) -> Result<Regularisation, Stop> {
        match (self.args.alpha.as_str(), self.args.alpha.parse::<f64>()) {
            ("auto", _) => Ok(Regularisation::LCurve),
            (_, Ok(alpha)) if alpha >= 0.0 && alpha.is_finite() => Ok(Regularisation::Alpha(alpha)),
            (other, _) => {
                Err(Fault::new(format!("`--alpha` is `auto` or a number of at least 0 m2, not `{other}`")).into())
            }
        }
    }

    /// α in m2 for what is continued downward by `down_m` at most.
    fn alpha_m2(&self, down_m: f64) -> Result<f64, Stop> {
        Ok(match self.alpha()? {
            Regularisation::Alpha(alpha) => alpha,
            Regularisation::LCurve if down_m <= 0.0 => MAGNAV_ALPHA_M2,
            Regularisation::LCurve => {
                downward(&self.plane, down_m, Regularisation::LCurve, &Padding::default())
                    .map_err(|e| self.wrong(e))?
                    .alpha_m2
            }
        })
    }

    fn level_to(&self, level_m: f64, to_m: f64) -> Result<(), Stop> {
        let up_m = to_m - self.known_level(level_m)?;
        self.warn_if_far(up_m);
        let padding = Padding::default();
        let (plane, alpha) = if up_m < 0.0 {
            let down = downward(&self.plane, -up_m, self.alpha()?, &padding).map_err(|e| self.wrong(e))?;
            note(&format!(
                "continued downward by {:.1} m with alpha = {:.3e} m2: back at its own height it differs from the \
                 map by {:.3} nT rms",
                -up_m, down.alpha_m2, down.regularisation_error_nt
            ));
            if let Some(path) = &self.args.l_curve {
                std::fs::write(path, l_curve(&down.curve)).map_err(|e| unwritable(path, &e))?;
            }
            (down.map, down.alpha_m2)
        } else {
            (continuation::upward(&self.plane, up_m, &padding).map_err(|e| self.wrong(e))?, 0.0)
        };
        let plane = match self.args.derivative {
            Some(along) => {
                let spectrum = Spectrum::new(&self.plane, up_m, &padding).map_err(|e| self.wrong(e))?;
                spectrum.derivative(along.which(), up_m, alpha).map_err(|e| self.wrong(e))?
            }
            None => plane,
        };
        self.estimate_error(up_m, alpha)?;
        self.finish(plane, Height::Level(to_m), to_m)
    }

    fn estimate_error(&self, up_m: f64, alpha: f64) -> Result<(), Stop> {
        let Ok(error) = edge_error(&self.plane, up_m, alpha, &Padding::default()) else { return Ok(()) };
        note(&format!(
            "the unknown field past the map's edges makes an error of about {:.3} nT rms over the map",
            error.rms_nt
        ));
        match &self.args.error {
            Some(path) => {
                let map = self.map.with_plane_values(error.map.values).map_err(Fault::from)?;
                write_to(path, &map, None)
            }
            None => Ok(()),
        }
    }

    /// A derivative at the map's own height.
    fn differentiate(&self) -> Result<(), Stop> {
        let Height::Level(level_m) = self.map.height else { return Ok(()) };
        if !self.args.to.is_empty() {
            return self.args.to.iter().try_for_each(|to| self.level_to(level_m, *to));
        }
        let Some(along) = self.args.derivative else { return Ok(()) };
        let spectrum = Spectrum::new(&self.plane, 0.0, &Padding::default()).map_err(|e| self.wrong(e))?;
        let plane = spectrum.derivative(along.which(), 0.0, 0.0).map_err(|e| self.wrong(e))?;
        self.finish(plane, Height::Level(level_m), level_m)
    }

    fn drape_to(&self, heights: &[f64], to_m: f64) -> Result<(), Stop> {
        let heights = self.complete(heights)?;
        let down_m = heights.iter().map(|h| h - to_m).fold(0.0, f64::max);
        self.warn_if_far(heights.iter().map(|h| (to_m - h).abs()).fold(0.0, f64::max));
        let drape = Drape { alpha_m2: self.alpha_m2(down_m)?, ..Drape::default() };
        let plane = drape_to_level(&self.plane, &heights, to_m, &drape).map_err(|e| self.wrong(e))?;
        self.finish(plane, Height::Level(to_m), to_m)
    }

    fn onto(&self, path: &Path) -> Result<(), Stop> {
        let Height::Level(level_m) = self.map.height else {
            return Err(Fault::new("the map is draped itself").help("continue it to a level with `--to` first").into());
        };
        let level_m = self.known_level(level_m)?;
        let other = InputArgs { alt: None, ..self.args.input.clone() }.read(path)?;
        let Height::Cells(heights) = &other.height else {
            return Err(wrong(path, &"the map has one height for all nodes; `--to` takes that"));
        };
        if (other.x.len, other.y.len) != (self.map.x.len, self.map.y.len) {
            return Err(wrong(path, &"the map with the heights is not on the same grid"));
        }
        let heights = self.complete(heights)?;
        let down_m = heights.iter().map(|h| level_m - h).fold(0.0, f64::max);
        self.warn_if_far(heights.iter().map(|h| (level_m - h).abs()).fold(0.0, f64::max));
        let drape = Drape { alpha_m2: self.alpha_m2(down_m)?, ..Drape::default() };
        let plane = level_to_drape(&self.plane, level_m, &heights, &drape).map_err(|e| self.wrong(e))?;
        self.finish(plane, Height::Cells(heights), level_m)
    }

    /// Heights of all nodes, those that are unknown from their surroundings.
    fn complete(&self, heights: &[f64]) -> Result<Vec<f64>, Stop> {
        Ok(filled(&self.args.map, &self.original.with(heights.to_vec()))?.values)
    }

    fn finish(&self, plane: PlaneGrid, height: Height, alt_m: f64) -> Result<(), Stop> {
        let plane = if self.args.keep_filled { plane } else { masked_like(plane, &self.original) };
        let value_unit = match self.args.derivative {
            None => self.map.value_unit,
            Some(Along::Up2) => "nT/m2",
            Some(_) => "nT/m",
        };
        let map = GridMap { height, value_unit, ..self.map.with_plane_values(plane.values).map_err(Fault::from)? };
        let name = self.args.output.to_string_lossy().replace("{alt}", &alt_m.to_string());
        write_to(Path::new(&name), &map, self.args.output_format.as_deref())
    }
}

/// The L-curve as a picture.
fn l_curve(curve: &LCurve) -> String {
    let points: Vec<(f64, f64)> = curve.points.iter().map(|p| (p.misfit_nt, p.roughness_nt_per_m)).collect();
    let marked = format!("alpha = {:.3e} m2", curve.corner_alpha_m2());
    let labels = CurveLabels {
        title: "L-curve of the downward continuation",
        x: "misfit, back at the map's height (nT rms)",
        y: "gradient of the lower map (nT/m rms)",
        marked: &marked,
    };
    curve_svg(&points, Some(curve.corner), &labels).unwrap_or_default()
}

fn unwritable(path: &Path, e: &std::io::Error) -> Stop {
    Stop::Failed(format!("error: cannot write {}: {e}", path.display()))
}

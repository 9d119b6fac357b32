//! Makes a map of navigated lines.

mod gather;
#[cfg(test)]
mod tests;

use grids::{Height, SurveyPoints};
use numerics::{
    maps::plane_grid::{EvenAxis, PlaneGrid},
    navigation::{
        slam::{Covariance, HyperparameterSource, Kernel},
        track_map::{self, TrackMapError, TrackMapParameters, TrackSample},
    },
};
use schemas::{Column, Correction, Fault, Product, Rule, Shape, Stage, SurveyPoint, SurveyStage, Table, Yield, stage};

use self::gather::Measured;
use crate::{
    columns::{array, data, faults_of, shape},
    corrections::{CORE_FIELD, REMOVE_DIURNAL, corrects, note, twice},
    dates::{WAYS_OUT, dated_by_flight},
    map_convert::bounds_of,
    map_grid::epsg_of,
};

stage! {
    /// Makes a map of the measurements of lines at the positions of their tracks, with the standard deviation `sd` of each
    /// node: Gaussian-process regression of reduced rank.
    ///
    /// Use it to plot, score and navigate on what an aircraft without a map has found: `track` is the table of a `navigate`,
    /// by `slam` for instance, and its `lat`, `lon` and `alt` are where the measurements of `input` are taken to be. Without
    /// `track` they are at the flight's own `lat`, `lon` and `alt`, those of GNSS. Maps of survey lines that are levelled and
    /// cleaned first are those of `map_grid`.
    ///
    /// The anomaly is a Gaussian process, expanded in eigenfunctions of the Laplacian on the area of the lines, so that the
    /// equations stay the same size however long the flight; each line may have a constant of its own, each flight a temporal
    /// variation. The kernel is that of `slam`, fitted by maximum likelihood to pieces of the lines. The map is at the mean
    /// height of the measurements: differences from it are taken as noise.
    ///
    /// The covariance of the track's position (`sd_n`, `sd_e`, `cov_ne`) times the slope of the map counts as noise of the
    /// measurements, and is in `sd`. An error that the whole track has in common moves the map; nothing in the measurements
    /// shows it, and `sd` is as good as what the track says of itself. Nodes with an `sd` above `max_sd_nt` are unknown.
    ///
    /// Rows without a position, its standard deviation, a height or a measurement are left out. It refuses lines and tracks
    /// with different samples, a core field without a date, and an area that is too large for the length of the field:
    /// divide it by `bounds`; measurements three lengths beyond them are then left out.
    ///
    /// Source: Solin and Särkkä 2020, "Hilbert space methods for reduced-rank Gaussian process regression"; Viset, Kullberg,
    /// Wesel and Solin 2024 (its normal equations); McHutchon and Rasmussen 2011 (input noise).
    TrackMap = "track_map", version 2, grain Survey, yields Map, inputs [input: Lines, track: Lines optional],
    example r#"
[[stages]]
name            = "track_map"
stage           = "track_map"
input           = "assume_noise"
track           = "navigate"
core_field      = false
hyperparameters = "fixed"
sigma_se_nt     = 100.0
length_m        = 1000.0
spacing_m       = 500.0
"#;
    /// The measured field.
    mag: String, unit "nT", default "mag_c";
    /// Whether the measurement holds the core field (IGRF-14), which is then taken off at the position of the track.
    core_field: bool, unit "", default true;
    /// The date of the core field, in place of the flight's own.
    decimal_year: Option<f64>, unit "a", absent "the flight's own date", rule Rule::Between(1900.0, 2030.0);
    /// Whether the column `diurnal` is taken off the measurement. A sample without it has no measurement.
    remove_diurnal: Option<bool>, unit "", absent "true where the flight has the column and the measurement still holds it";
    /// Measurements within so many seconds are averaged; 0 takes every sample.
    interval_s: f64, unit "s", default 1.0, rule Rule::NotNegative;
    /// Whether the hyper-parameters of the kernel are fitted to the lines by maximum likelihood, or are as given.
    hyperparameters: HyperparameterSource, unit "", default HyperparameterSource::Fitted;
    /// Standard deviation north and east that is added to those of the track: an error that the track does not know of, such
    /// as that of `slam` until its first revisit.
    position_sigma_m: f64, unit "m", default 0.0, rule Rule::NotNegative;
    /// How the covariance of the anomaly falls with distance.
    covariance: Covariance, unit "", default Covariance::Matern52;
    /// Standard deviation of the anomaly.
    sigma_se_nt: Option<f64>, unit "nT", absent "50 nT", rule Rule::Positive;
    /// Correlation length of the anomaly; where it is fitted, where the search starts.
    length_m: Option<f64>, unit "m", absent "150 m", rule Rule::Positive;
    /// The noise of an averaged measurement; where it is fitted, where the search starts.
    sigma_n_nt: Option<f64>, unit "nT", absent "1 nT", rule Rule::NotNegative;
    /// Standard deviation of the temporal variation; 0 for none.
    fogm_sigma_nt: f64, unit "nT", default 3.0, rule Rule::NotNegative;
    /// Time constant of the temporal variation.
    fogm_tau_s: f64, unit "s", default 600.0, rule Rule::Positive;
    /// Standard deviation of the constant that each of several lines has; 0 for none.
    line_sigma_nt: f64, unit "nT", default 3.0, rule Rule::NotNegative;
    /// The distance between nodes.
    spacing_m: Option<f64>, unit "m", absent "a sixth of the length of the kernel", rule Rule::Positive;
    /// West, south, east and north of the map: eastings and northings in metres.
    bounds: Option<Vec<f64>>, unit "m", absent "all measurements";
    /// Leaves nodes unknown whose standard deviation is above this.
    max_sd_nt: Option<f64>, unit "nT", absent "a quarter of the standard deviation of the anomaly", rule Rule::Positive;
    /// The most functions that the anomaly is a sum of. The work grows with the third power of their number.
    max_functions: usize, unit "1", default 3000usize, rule Rule::Between(1.0, 20_000.0);
    /// The EPSG code of the map's coordinate system.
    to_epsg: Option<usize>, unit "", absent "that of the UTM zone of the measurements", rule Rule::Between(1.0, 65535.0);
}

const DIURNAL: &str = "diurnal";
const PLACE: [&str; 3] = ["lat", "lon", "alt"];
const SPREAD: [&str; 3] = ["sd_n", "sd_e", "cov_ne"];
/// The column of the standard deviation.
const SD: &str = "sd";
/// Nodes in a length of the kernel.
const NODES_A_LENGTH: f64 = 6.0;
/// The standard deviation of a node that is known, in those of the anomaly.
const KNOWN: f64 = 0.25;
/// The most nodes.
const MOST_NODES: f64 = 1e7;
/// A part of the variance that the functions may lack without a word.
const LACKING: f64 = 1e-3;
/// What the model may leave of the measurements, in standard deviations of their noise, without a word.
const MISFIT: f64 = 2.0;

impl TrackMap {
    fn removes_diurnal(&self, shape: &Shape) -> bool {
        let there = shape.get(DIURNAL).is_some();
        corrects(shape, std::slice::from_ref(&self.mag), Correction::Diurnal, self.remove_diurnal, there)
    }

    /// The columns of the lines that are read.
    fn reads(&self, shape: &Shape, tracked: bool) -> Vec<String> {
        let mut reads = vec!["tt", self.mag.as_str()];
        if !tracked {
            reads.extend(PLACE);
        }
        if self.core_field && self.decimal_year.is_none() && dated_by_flight(shape) {
            reads.extend(["year", "doy"]);
        }
        if self.removes_diurnal(shape) {
            reads.push(DIURNAL);
        }
        reads.into_iter().map(str::to_owned).collect()
    }

    /// What is wrong with the lines and the track.
    fn faults(&self, lines: &Shape, track: Option<&Shape>) -> Vec<Fault> {
        let mut faults = faults_of([lines.number(&self.mag, "nT")], "mag");
        let mag = std::slice::from_ref(&self.mag);
        faults.extend(twice(lines, mag, Correction::Diurnal, self.remove_diurnal, REMOVE_DIURNAL));
        faults.extend(twice(lines, mag, Correction::Core, Some(self.core_field), CORE_FIELD));
        let places = PLACE.iter().zip(["deg", "deg", "m"]);
        match track {
            None => faults.extend(faults_of(places.map(|(c, unit)| lines.number(c, unit)), "input")),
            Some(track) => {
                let spread = SPREAD.iter().zip(["m", "m", "m2"]);
                faults.extend(faults_of(places.chain(spread).map(|(c, unit)| track.number(c, unit)), "track"));
            }
        }
        if self.remove_diurnal == Some(true) {
            let found = lines.number(DIURNAL, "nT").map_err(|f| f.help("say `remove_diurnal = false`"));
            faults.extend(faults_of([found], "remove_diurnal"));
        }
        if self.core_field && self.decimal_year.is_none() && !dated_by_flight(lines) {
            let what = "the core field needs a date, but the flight has no `year` and `doy`";
            faults.push(Fault::new(what).help(WAYS_OUT).of_param("decimal_year"));
        }
        faults.extend(self.bounds.as_deref().and_then(|bounds| bounds_of(bounds).err()));
        faults.extend(epsg_of(self.to_epsg).err());
        faults
    }

    fn parameters(&self) -> TrackMapParameters {
        let kernel = Kernel::default();
        TrackMapParameters {
            kernel: Kernel {
                covariance: self.covariance,
                sigma_se_nt: self.sigma_se_nt.unwrap_or(kernel.sigma_se_nt),
                length_m: self.length_m.unwrap_or(kernel.length_m),
                sigma_n_nt: self.sigma_n_nt.unwrap_or(kernel.sigma_n_nt),
            },
            hyperparameters: self.hyperparameters,
            temporal: (self.fogm_sigma_nt, self.fogm_tau_s),
            line_sigma_nt: self.line_sigma_nt,
            most_functions: self.max_functions,
        }
    }

    /// The map of all lines.
    fn mapped(&self, lines: &[(&str, &[Measured])]) -> Result<Product, Fault> {
        let all = || lines.iter().flat_map(|(_, line)| line.iter());
        let places = |of: fn(&Measured) -> f64| all().map(of).collect::<Vec<f64>>();
        let points = SurveyPoints::at(places(|m| m.lat_deg), places(|m| m.lon_deg), epsg_of(self.to_epsg)?)?;
        let mut flights: Vec<&str> = vec![];
        let mut samples = vec![];
        let mut at = points.easting_m.iter().zip(&points.northing_m);
        for (number, (flight, line)) in lines.iter().enumerate() {
            let known = flights.iter().position(|f| f == flight);
            let flight = known.unwrap_or_else(|| {
                flights.push(flight);
                flights.len() - 1
            });
            for (measured, (east, north)) in line.iter().zip(&mut at) {
                samples.push(TrackSample {
                    at_m: [*east, *north],
                    alt_m: measured.alt_m,
                    tt_s: measured.tt_s,
                    value_nt: measured.value_nt,
                    variance_nt2: 0.0,
                    position_m2: measured.position_m2,
                    flight,
                    line: number,
                });
            }
        }
        samples.retain(|sample| sample.at_m.iter().all(|x| x.is_finite()));
        let bounds = self.bounds.as_deref().map(bounds_of).transpose()?;
        let parameters = self.parameters();
        let map = match bounds {
            None => track_map::TrackMap::of(&parameters, &samples),
            Some(bounds) => within(&parameters, samples.clone(), bounds),
        };
        let map = map.map_err(|e| refused(&e))?;
        let report = map.report;
        let spacing_m = self.spacing_m.unwrap_or(report.kernel.length_m / NODES_A_LENGTH);
        let [east_m, north_m] = axes(&samples, bounds, spacing_m)?;
        let most_nt = self.max_sd_nt.unwrap_or(KNOWN * report.kernel.sigma_se_nt);
        let nodes = map.on(east_m, north_m);
        let known = |value: f64, sd_nt: f64| if sd_nt <= most_nt { value } else { f64::NAN };
        let values: Vec<f64> = nodes.iter().map(|node| known(node.value_nt, node.sd_nt)).collect();
        let sd_nt = nodes.iter().map(|node| known(node.sd_nt, node.sd_nt)).collect();
        if values.iter().all(|x| x.is_nan()) {
            let least = nodes.iter().map(|node| node.sd_nt).fold(f64::INFINITY, f64::min);
            let what = format!("no node has a standard deviation below {most_nt:.1} nT; the least is {least:.1} nT");
            let help = "choose a larger `max_sd_nt`, or lines closer together";
            return Err(Fault::data(what).help(help).of_param("max_sd_nt"));
        }
        let made = points.grid(PlaneGrid { east_m, north_m, values }, Height::Level(report.alt_m))?;
        let mut columns = made.made()?;
        columns.push(array(sd_nt));
        Ok(Product { columns, warnings: self.warnings(&report) })
    }

    /// What is not to be trusted.
    fn warnings(&self, report: &track_map::TrackMapReport) -> Vec<String> {
        let mut warnings = vec![];
        if self.hyperparameters == HyperparameterSource::Fitted && !report.fitted {
            warnings.push(
                "the kernel could not be fitted: the lines are too short, or do not vary; it is as given".to_owned(),
            );
        }
        if report.lacking > LACKING {
            warnings.push(format!(
                "{} functions lack {:.1} % of the variance of a field of a length of {:.0} m, which counts as noise; a \
                 larger `max_functions`, or smaller `bounds`, take it in",
                report.functions,
                100.0 * report.lacking,
                report.kernel.length_m
            ));
        }
        if report.misfit > MISFIT {
            warnings.push(format!(
                "the measurements are off the map by {:.1} times the noise that is expected of them: positions err by more \
                 than the track says, or the field is rougher than the kernel",
                report.misfit
            ));
        }
        warnings
    }
}

/// The map of the measurements within some bounds, and of those three lengths beyond, which have a say there. The length is
/// that of a fit to all of them.
fn within(
    parameters: &TrackMapParameters,
    mut samples: Vec<TrackSample>,
    [west, south, east, north]: [f64; 4],
) -> Result<track_map::TrackMap, TrackMapError> {
    let kernel = track_map::kernel_of(parameters, &samples)?;
    let beyond_m = 3.0 * kernel.unwrap_or(parameters.kernel).length_m;
    let near = |x: f64, low: f64, high: f64| (low - beyond_m..=high + beyond_m).contains(&x);
    samples.retain(|sample| near(sample.at_m[0], west, east) && near(sample.at_m[1], south, north));
    track_map::TrackMap::with_kernel(parameters, kernel, &samples)
}

/// The axes of the map, on whole multiples of the spacing.
fn axes(samples: &[TrackSample], bounds: Option<[f64; 4]>, spacing_m: f64) -> Result<[EvenAxis; 2], Fault> {
    let end = |axis: usize, pick: fn(f64, f64) -> f64| {
        samples.iter().map(|sample| sample.at_m[axis]).reduce(pick).unwrap_or_default()
    };
    let [west, south, east, north] =
        bounds.unwrap_or([end(0, f64::min), end(1, f64::min), end(0, f64::max), end(1, f64::max)]);
    let ends = [(west, east), (south, north)].map(|(low, high)| ((low / spacing_m).floor(), (high / spacing_m).ceil()));
    let nodes = ends.iter().map(|(first, last)| last - first + 1.0).product::<f64>();
    // Also false for a NaN.
    let fits = nodes <= MOST_NODES;
    if !fits {
        let what = format!("the map would have {nodes:.0} nodes, {spacing_m:.1} m apart");
        return Err(Fault::data(what).help("choose a larger `spacing_m`, or smaller `bounds`").of_param("spacing_m"));
    }
    Ok(ends.map(|(first, last)| EvenAxis {
        first: first * spacing_m,
        step: spacing_m,
        len: (last - first) as usize + 1,
    }))
}

/// What the lines do not allow, and the way out.
fn refused(error: &TrackMapError) -> Fault {
    match error {
        TrackMapError::Nothing => data(error).help("do `bounds` hold the lines?"),
        TrackMapError::TooLarge { .. } => {
            let help = "divide it by `bounds`, give a larger `max_functions`, or a longer `length_m` with \
                        `hyperparameters = \"fixed\"`";
            data(error).help(help).of_param("max_functions")
        }
        TrackMapError::Singular => data(error).help("give a larger `sigma_n_nt`").of_param("sigma_n_nt"),
        TrackMapError::Parameter(_) => data(error),
    }
}

impl Stage for TrackMap {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let lines = shape(inputs, 0)?;
        let track = inputs.get(1).map(|table| table.shape());
        let faults = self.faults(lines, track);
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec![self.reads(lines, track.is_some())];
        if track.is_some() {
            reads.push(["tt"].iter().chain(&PLACE).chain(&SPREAD).map(|c| (*c).to_owned()).collect());
        }
        let mut yields = schemas::map::yields(schemas::map::ANOMALY_UNIT, reads.clone());
        let sd = Column::float(SD, "nT", "one sigma of the anomaly; NaN where that is unknown");
        yields.columns.push(reads.iter().enumerate().fold(sd, |sd, (i, names)| sd.from(i, names)));
        let mag = std::slice::from_ref(&self.mag);
        yields.notes.extend(note(lines, mag, Correction::Diurnal, self.remove_diurnal));
        if self.remove_diurnal.is_none() && self.removes_diurnal(lines) {
            let what = format!("`{DIURNAL}` is taken off the measurement; say `remove_diurnal = false` to leave it in");
            yields.notes.push(what);
        }
        Ok(yields)
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        let of = |what: &str| Some(Fault::new(format!("`{key}` {what}")).help(format!("leave `{key}` out")));
        match key {
            // `length_m` and `sigma_n_nt` are where the search starts.
            "sigma_se_nt" if self.hyperparameters == HyperparameterSource::Fitted => {
                of("belongs to `hyperparameters = \"fixed\"`")
            }
            "decimal_year" if !self.core_field => of("has a say only with `core_field = true`"),
            "fogm_tau_s" if self.fogm_sigma_nt == 0.0 => of("has no say with `fogm_sigma_nt = 0`"),
            _ => None,
        }
    }
}

impl SurveyStage for TrackMap {
    type Gather = gather::Lines;

    fn gather(points: Vec<SurveyPoint<Self>>) -> gather::Lines {
        gather::Lines::new(points.into_iter().map(|point| point.stage).collect())
    }
}

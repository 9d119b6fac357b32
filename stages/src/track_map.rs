//! Maps made from navigated lines.

mod gather;
#[cfg(test)]
mod tests;

use grids::{GridHeight, SurveyPointSet};
use numerics::{
    maps::plane_grid::{EvenAxis, PlaneGrid},
    navigation::{
        slam::{AnomalyKernel, CovarianceFunction, HyperparameterSource},
        track_map::{self, TrackMapError, TrackMapParameters, TrackSample},
    },
};
use schemas::{
    Column, Fault, MagneticCorrection, Rule, Stage, StageOutput, StageSchema, SurveyPoint, SurveyStage, Table,
    TableShape, stage,
};

use self::gather::AnomalyMeasurement;
use crate::{
    columns::{array, data, faults_of, shape},
    corrections::{CORE_FIELD, REMOVE_DIURNAL, corrects, note, twice},
    dates::{WAYS_OUT, dated_by_flight},
    map_convert::bounds_of,
    map_grid::epsg_of,
};

stage! {
    /// Makes a map from the measurements of lines at the positions of their tracks, by reduced-rank Gaussian-process
    /// regression. `sd` is the standard deviation of the map error at each node.
    ///
    /// Use `track_map` to plot and score an anomaly that was measured without a map, and to navigate on it. `track` is
    /// the table of a `navigate` stage, for example with the filter `slam`. The columns `lat`, `lon` and `alt` of
    /// `track` are the positions of the measurements in `input`. Without `track`, the positions are the flight's own
    /// `lat`, `lon` and `alt`, from GNSS. If the survey lines require levelling and the removal of outliers, use
    /// `map_grid`.
    ///
    /// The anomaly is a Gaussian process, expanded in eigenfunctions of the Laplacian on the area of the lines. The
    /// number of equations therefore does not depend on the length of the flight. Each line may have its own constant,
    /// and each flight its own temporal variation. The kernel (covariance function) is the same as in `slam`. Its
    /// hyper-parameters are fitted by maximum likelihood to segments of the lines. The map is at the mean height of the
    /// measurements; height differences are treated as noise.
    ///
    /// On a sloping map, a position error of the track causes an error of the field. This error is computed from the
    /// track's covariance (`sd_n`, `sd_e`, `cov_ne`), treated as measurement noise, and included in `sd`. A position
    /// error common to the whole track shifts the map. The measurements do not reveal this shift, so `sd` is only as
    /// accurate as the covariance of the track. Nodes with an `sd` above `max_sd_nt` are unknown.
    ///
    /// Rows without a position, a standard deviation of the position, a height or a measurement are skipped. The stage
    /// rejects a track whose samples differ from the samples of the line, a core field without a date, and an area that
    /// is too large for the kernel length. Divide such an area with `bounds`; measurements more than three kernel
    /// lengths beyond the bounds are skipped.
    ///
    /// Source: Solin and Särkkä 2020, "Hilbert space methods for reduced-rank Gaussian process regression"; Viset,
    /// Kullberg, Wesel and Solin 2024 (normal equations); McHutchon and Rasmussen 2011 (input noise).
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
    /// Column of the measured field.
    mag: String, unit "nT", default "mag_c";
    /// Subtracts the core field (IGRF-14) at the position of the track from the measurement. `false` means that the
    /// measurement is an anomaly.
    core_field: bool, unit "", default true;
    /// Date of the core field as a decimal year. It replaces the flight's date.
    decimal_year: Option<f64>, unit "a", absent "the flight's own date", rule Rule::Between(1900.0, 2030.0);
    /// Subtracts the column `diurnal` from the measurement. A sample with a NaN in `diurnal` has no measurement.
    remove_diurnal: Option<bool>, unit "",
        absent "true if the flight has a column `diurnal` that has not yet been subtracted from the measurement";
    /// Interval over which measurements are averaged. 0 uses every sample.
    interval_s: f64, unit "s", default 1.0, rule Rule::NotNegative;
    /// Source of the kernel's hyper-parameters: a maximum-likelihood fit to the lines (`fitted`), or the spec
    /// (`fixed`).
    hyperparameters: HyperparameterSource, unit "", default HyperparameterSource::Fitted;
    /// Standard deviation, north and east, of a position error that the track's covariance omits, such as the error of
    /// `slam` before the first revisit.
    position_sigma_m: f64, unit "m", default 0.0, rule Rule::NotNegative;
    /// Covariance function of the anomaly over distance.
    covariance: CovarianceFunction, unit "", default CovarianceFunction::Matern52;
    /// Standard deviation of the anomaly.
    sigma_se_nt: Option<f64>, unit "nT", absent "50 nT", rule Rule::Positive;
    /// Correlation length of the anomaly; if it is fitted, the initial value of the search.
    length_m: Option<f64>, unit "m", absent "150 m", rule Rule::Positive;
    /// Standard deviation of the noise of an averaged measurement; if it is fitted, the initial value of the search.
    sigma_n_nt: Option<f64>, unit "nT", absent "1 nT", rule Rule::NotNegative;
    /// Standard deviation of the temporal variation. 0 assumes no temporal variation.
    fogm_sigma_nt: f64, unit "nT", default 3.0, rule Rule::NotNegative;
    /// Time constant of the temporal variation.
    fogm_tau_s: f64, unit "s", default 600.0, rule Rule::Positive;
    /// Standard deviation of the constant of each line, if there are several lines. 0 assumes no such constants.
    line_sigma_nt: f64, unit "nT", default 3.0, rule Rule::NotNegative;
    /// Distance between nodes.
    spacing_m: Option<f64>, unit "m", absent "a sixth of the kernel length", rule Rule::Positive;
    /// West, south, east and north bounds of the map: eastings and northings in metres.
    bounds: Option<Vec<f64>>, unit "m", absent "the extent of all measurements";
    /// Largest standard deviation of a known node. Nodes with a larger standard deviation are unknown.
    max_sd_nt: Option<f64>, unit "nT", absent "a quarter of the standard deviation of the anomaly", rule Rule::Positive;
    /// Maximum number of functions in the expansion of the anomaly. Computing time grows with the third power of this
    /// number.
    max_functions: usize, unit "1", default 3000usize, rule Rule::Between(1.0, 20_000.0);
    /// EPSG code of the map's coordinate system.
    to_epsg: Option<usize>, unit "", absent "the UTM zone of the measurements", rule Rule::Between(1.0, 65535.0);
}

const DIURNAL: &str = "diurnal";
const PLACE: [&str; 3] = ["lat", "lon", "alt"];
const SPREAD: [&str; 3] = ["sd_n", "sd_e", "cov_ne"];
/// Column of the standard deviation.
const SD: &str = "sd";
/// Number of nodes per kernel length.
const NODES_A_LENGTH: f64 = 6.0;
/// Largest standard deviation of a known node, divided by the standard deviation of the anomaly.
const KNOWN: f64 = 0.25;
/// Maximum number of nodes.
const MOST_NODES: f64 = 1e7;
/// Fraction of the variance that the basis may omit without a warning.
const LACKING: f64 = 1e-3;
/// A warning is reported if the residual of the model exceeds this number of standard deviations of the measurement
/// noise.
const MISFIT: f64 = 2.0;

impl TrackMap {
    fn removes_diurnal(&self, shape: &TableShape) -> bool {
        let there = shape.get(DIURNAL).is_some();
        corrects(shape, std::slice::from_ref(&self.mag), MagneticCorrection::Diurnal, self.remove_diurnal, there)
    }

    /// The columns that are read from the lines.
    fn reads(&self, shape: &TableShape, tracked: bool) -> Vec<String> {
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

    /// Faults of the lines and the track.
    fn faults(&self, lines: &TableShape, track: Option<&TableShape>) -> Vec<Fault> {
        let mut faults = faults_of([lines.number(&self.mag, "nT")], "mag");
        let mag = std::slice::from_ref(&self.mag);
        faults.extend(twice(lines, mag, MagneticCorrection::Diurnal, self.remove_diurnal, REMOVE_DIURNAL));
        faults.extend(twice(lines, mag, MagneticCorrection::Core, Some(self.core_field), CORE_FIELD));
        let places = PLACE.iter().zip(["deg", "deg", "m"]);
        match track {
            None => faults.extend(faults_of(places.map(|(c, unit)| lines.number(c, unit)), "input")),
            Some(track) => {
                let spread = SPREAD.iter().zip(["m", "m", "m2"]);
                faults.extend(faults_of(places.chain(spread).map(|(c, unit)| track.number(c, unit)), "track"));
            }
        }
        if self.remove_diurnal == Some(true) {
            let found = lines.number(DIURNAL, "nT").map_err(|f| f.help("set `remove_diurnal = false`"));
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
        let kernel = AnomalyKernel::default();
        TrackMapParameters {
            kernel: AnomalyKernel {
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
    fn mapped(&self, lines: &[(&str, &[AnomalyMeasurement])]) -> Result<StageOutput, Fault> {
        let all = || lines.iter().flat_map(|(_, line)| line.iter());
        let places = |of: fn(&AnomalyMeasurement) -> f64| all().map(of).collect::<Vec<f64>>();
        let points = SurveyPointSet::at(places(|m| m.lat_deg), places(|m| m.lon_deg), epsg_of(self.to_epsg)?)?;
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
            None => track_map::TrackMap::new(&parameters, &samples),
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
            let what = format!("no node has a standard deviation below {most_nt:.1} nT; the smallest is {least:.1} nT");
            let help = "increase `max_sd_nt`, or add lines in between";
            return Err(Fault::data(what).help(help).of_param("max_sd_nt"));
        }
        let made = points.grid(PlaneGrid { east_m, north_m, values }, GridHeight::Level(report.alt_m))?;
        let mut columns = made.made()?;
        columns.push(array(sd_nt));
        Ok(StageOutput { columns, warnings: self.warnings(&report) })
    }

    /// Warnings about untrustworthy results.
    fn warnings(&self, report: &track_map::TrackMapReport) -> Vec<String> {
        let mut warnings = vec![];
        if self.hyperparameters == HyperparameterSource::Fitted && !report.fitted {
            warnings.push(
                "the kernel is not fitted, because the lines are too short or constant; the given kernel is used"
                    .to_owned(),
            );
        }
        if report.lacking > LACKING {
            warnings.push(format!(
                "{} functions omit {:.1} % of the variance of a field of length {:.0} m, which counts as noise; \
                 increase `max_functions`, or reduce `bounds`",
                report.functions,
                100.0 * report.lacking,
                report.kernel.length_m
            ));
        }
        if report.misfit > MISFIT {
            warnings.push(format!(
                "the residual of the map is {:.1} times the assumed noise: the position error exceeds the covariance \
                 of the track, or the field is rougher than the kernel",
                report.misfit
            ));
        }
        warnings
    }
}

/// Map of the measurements within the bounds and up to three kernel lengths beyond them, because measurements at that
/// distance still affect the map. The length is fitted to all measurements.
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
    // The comparison is also false for NaN.
    let fits = nodes <= MOST_NODES;
    if !fits {
        let what = format!("the map would have {nodes:.0} nodes, {spacing_m:.1} m apart");
        return Err(Fault::data(what).help("increase `spacing_m`, or reduce `bounds`").of_param("spacing_m"));
    }
    Ok(ends.map(|(first, last)| EvenAxis {
        first: first * spacing_m,
        step: spacing_m,
        len: (last - first) as usize + 1,
    }))
}

/// Fault of lines from which no map can be made, and its remedy.
fn refused(error: &TrackMapError) -> Fault {
    match error {
        TrackMapError::Nothing => data(error).help("set `bounds` to an area that contains lines"),
        TrackMapError::TooLarge { .. } => {
            let help = "divide it by `bounds`, increase `max_functions`, or set a longer `length_m` with \
                        `hyperparameters = \"fixed\"`";
            data(error).help(help).of_param("max_functions")
        }
        TrackMapError::Singular => data(error).help("increase `sigma_n_nt`").of_param("sigma_n_nt"),
        TrackMapError::Parameter(_) => data(error),
    }
}

impl Stage for TrackMap {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
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
        let sd = Column::float(SD, "nT", "standard deviation of the anomaly; NaN where unknown");
        yields.columns.push(reads.iter().enumerate().fold(sd, |sd, (i, names)| sd.from(i, names)));
        let mag = std::slice::from_ref(&self.mag);
        yields.notes.extend(note(lines, mag, MagneticCorrection::Diurnal, self.remove_diurnal));
        if self.remove_diurnal.is_none() && self.removes_diurnal(lines) {
            let what =
                format!("`{DIURNAL}` is subtracted from the measurement; set `remove_diurnal = false` to keep it");
            yields.notes.push(what);
        }
        Ok(yields)
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let of = |what: &str| Some(Fault::new(format!("`{key}` {what}")).help(format!("remove `{key}`")));
        match key {
            // `length_m` and `sigma_n_nt` are the initial values of the search.
            "sigma_se_nt" if self.hyperparameters == HyperparameterSource::Fitted => {
                of("has no effect without `hyperparameters = \"fixed\"`")
            }
            "decimal_year" if !self.core_field => of("has no effect without `core_field = true`"),
            "fogm_tau_s" if self.fogm_sigma_nt == 0.0 => of("has no effect with `fogm_sigma_nt = 0`"),
            _ => None,
        }
    }
}

impl SurveyStage for TrackMap {
    type Gather = gather::TrackMapAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> gather::TrackMapAggregator {
        gather::TrackMapAggregator::new(points.into_iter().map(|point| point.stage).collect())
    }
}

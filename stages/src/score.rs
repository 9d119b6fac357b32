//! Scores a compensated signal and a track against the truth.

use std::sync::Arc;

use arrow_array::{Array, ArrayRef, Int64Array, StringArray, cast::AsArray};
use numerics::{
    compensation::figure_of_merit::{figure_of_merit, manoeuvres},
    earth::geodesy::EarthModel,
    maps::{
        anomaly_retention::{RetentionError, anomaly_retention},
        crossings::figure_of_merit_crossings,
    },
    regression::statistics::{self, Figure},
    signal::segments::{STEP_TOLERANCE, Usable, filter_column, sample_rate},
};
use schemas::{Column, Fault, LineIn, Passes, Role, Rule, Shape, Stage, Table, Yield, stage};

use crate::{
    bandpass::design,
    columns::{data, faults_of, floats, shape},
    navigate::MAP_HEIGHT_ERROR,
};

/// Name, unit, what it needs, meaning.
type Metric = (&'static str, &'static str, Need, &'static str);

/// What can be scored. Deviations are about the mean, over n - 1, as MagNav.jl's are.
const METRICS: [Metric; 25] = [
    (
        "std_error",
        "nT",
        Need::Truth,
        "standard deviation (n - 1) of compensated minus truth: a constant does not count",
    ),
    ("bias_error", "nT", Need::Truth, "mean of compensated minus truth"),
    ("rms_error", "nT", Need::Truth, "root mean square (n) of compensated minus truth: a constant counts"),
    (
        "std_uncompensated",
        "nT",
        Need::Aircraft,
        "standard deviation (n - 1) of uncompensated minus truth or, without `truth`, of the uncompensated signal itself",
    ),
    (
        "improvement_ratio",
        "1",
        Need::Aircraft,
        "std_uncompensated over the same of the compensated signal: above 1 is better than nothing",
    ),
    ("improvement_ratio_band", "1", Need::Aircraft, "the same after a band-pass from `low_hz` to `high_hz`"),
    (
        "snr",
        "1",
        Need::Truth,
        "standard deviation of the true anomaly (truth less `igrf` and `diurnal`; without `igrf`, truth less its straight \
         line over time) over that of compensated minus truth",
    ),
    (
        "anomaly_retention",
        "1",
        Need::Anomaly,
        "slope of the compensated signal, less core field and diurnal variation, over the true anomaly: 1 keeps the \
         geology whole",
    ),
    (
        "figure_of_merit",
        "nT",
        Need::Box,
        "Noriega's index of a calibration box: the sum over its twelve manoeuvres (pitch, roll and yaw on four headings) of \
         the mean peak-to-peak amplitude of the band-passed compensated signal; null without all twelve",
    ),
    (
        "figure_of_merit_crossings",
        "nT",
        Need::Position,
        "thesis 001's: root mean square difference of the compensated signal between samples that are at most 1 m apart and \
         more than 1 s, where the track crosses itself; n counts pairs",
    ),
    (
        "drms",
        "m",
        Need::Track,
        "distance root mean square: the root of the mean squared horizontal error of the track, about the truth",
    ),
    ("rms_north", "m", Need::Track, "root mean square error north"),
    ("rms_east", "m", Need::Track, "root mean square error east"),
    ("ins_drms", "m", Need::Ins, "drms of the INS alone: what the filter must be better than"),
    (
        "nees",
        "1",
        Need::Track,
        "mean normalised estimation error squared e'P^-1e of the horizontal position; 2 for a consistent filter, more for \
         one that trusts itself too much, less for one that is too cautious",
    ),
    (
        "nis",
        "1",
        Need::Innovation,
        "mean normalised innovation squared; 1 for a consistent filter, more for one that trusts itself too much, less for \
         one that is too cautious",
    ),
    ("samples_used", "1", Need::Innovation, "measurements that the filter used"),
    ("samples_missing", "1", Need::Innovation, "samples without a measurement"),
    ("samples_off_map", "1", Need::Innovation, "samples off the map or in an unknown cell"),
    ("samples_gated", "1", Need::Innovation, "measurements that the innovation gate left out"),
    (
        "map_height_error",
        "nT",
        Need::Height,
        "error to expect because the map was taken at another height than the line's; 0 with `map_levels_m`",
    ),
    (
        "map_std_error",
        "nT",
        Need::MapError,
        "standard deviation (n - 1) of the compensated signal, less core field and diurnal variation, minus the map",
    ),
    ("map_bias_error", "nT", Need::MapError, "mean of the same"),
    ("map_gradient_along_track", "nT/m", Need::Map, "root mean square slope of the map along the track"),
    (
        "map_position_bound",
        "m",
        Need::Map,
        "least root mean square horizontal error with which a constant offset of the line can be found on the map",
    ),
];

/// The metrics as a table of the reference: name, unit and meaning.
pub fn metrics_table() -> String {
    let row = |(name, unit, _, meaning): &Metric| format!("| `{name}` | {unit} | {meaning} |\n");
    let rows: String = METRICS.iter().map(row).collect();
    format!("| metric | unit | meaning |\n|---|---|---|\n{rows}")
}

const NAMES: [&str; METRICS.len()] = {
    let mut names = [""; METRICS.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = METRICS[i].0;
        i += 1;
    }
    names
};

/// What a metric needs of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    /// The compensated signal and its truth.
    Truth,
    /// The compensated signal and what was taken off.
    Aircraft,
    /// The compensated signal, the core field and the known anomaly.
    Anomaly,
    /// The compensated signal and the attitude.
    Box,
    /// The compensated signal and positions.
    Position,
    /// A track and true positions.
    Track,
    /// INS and true positions.
    Ins,
    /// A track's innovations.
    Innovation,
    /// A track with the error of the map's height.
    Height,
    /// The map's value and slopes at the samples.
    Map,
    /// These, the compensated signal and the core field.
    MapError,
}

stage! {
    /// Scores each line: a compensated signal against the truth, a track against the true positions.
    ///
    /// `input` names one or several tables with the same samples: that with the compensated signal, that of the track.
    /// Left out, `metrics` is all that these tables allow. Every metric is a row of `metric`, `value`, `unit` and `n`, the
    /// number of samples (for crossings: pairs) behind it. Rows where a value is NaN are left out of a metric and of its
    /// `n`; a metric with no sample left has a null value.
    ///
    /// With `truth` the errors are against it; without, `std_uncompensated` and the ratios are those of the signals
    /// themselves, geology and all.
    ///
    /// With a table of `map_value` the map is scored: how well the signal less `igrf` (and `diurnal`, where there is one)
    /// follows it, how steep it is along the track, and what can be expected of navigating by it. `map_position_bound` is
    /// the Cramer-Rao bound for a constant horizontal offset when a constant of the measurement is unknown as well and
    /// each sample errs by `map_sigma_nt` independently; errors that last, as those of maps and of the temporal variation
    /// do, make it worse.
    ///
    /// Source: thesis 000, (3.45), (3.46); thesis 001, (66); thesis 004, (2.39) to (2.41).
    Score = "score", version 3, grain Line, inputs [input: ManyLines],
    example r#"
[[stages]]
name  = "score"
stage = "score"
input = ["compensate", "navigate"]
truth = "mag_1_c"
"#;
    /// The column that the compensated signal is held against, such as `mag_1_c`.
    truth: Option<String>, unit "nT", absent "metrics that need the truth are not scored";
    /// What to score.
    metrics: Option<Vec<String>>, unit "", absent "all metrics that the inputs allow", rule Rule::OneOf(&NAMES);
    /// The compensated signal.
    mag: String, unit "nT", default "mag_c";
    /// The lower corner for `improvement_ratio_band` and `figure_of_merit`.
    low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
    /// The upper corner for these.
    high_hz: f64, unit "Hz", default 0.9, rule Rule::NotNegative;
    /// The order of their filter.
    order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
    /// The error of a sample, for `map_position_bound`.
    map_sigma_nt: f64, unit "nT", default 5.0, rule Rule::Positive;
}

/// The table in which a column is found.
fn find(shapes: &[&Shape], fits: impl Fn(&Column) -> bool) -> Option<usize> {
    shapes.iter().position(|s| s.columns.iter().any(&fits))
}

fn named<'a>(name: &'a str, role: Option<Role>) -> impl Fn(&Column) -> bool + 'a {
    move |c: &Column| c.name == name && role.is_none_or(|r| c.role == r)
}

impl Score {
    /// Where each column that may be needed is: (table, column).
    fn places(&self, shapes: &[&Shape]) -> Places {
        let at = |name: &str, role: Option<Role>| find(shapes, named(name, role)).map(|i| (i, name.to_owned()));
        let track =
            shapes.iter().position(|s| ["lat", "lon", "residual", "nis", "update"].iter().all(|n| s.get(n).is_some()));
        Places {
            mag: at(&self.mag, None),
            aircraft: at("mag_aircraft", None),
            truth: self.truth.as_deref().and_then(|t| at(t, None)),
            position: at("lat", Some(Role::Truth)).zip(at("lon", Some(Role::Truth))).map(|(a, b)| (a.0, [a.1, b.1])),
            ins: at("ins_lat", None).zip(at("ins_lon", None)).map(|(a, b)| (a.0, [a.1, b.1])),
            track,
            height: at(MAP_HEIGHT_ERROR, None),
            map: find(shapes, named(MAP[0], None)).filter(|i| MAP.iter().all(|n| shapes[*i].get(n).is_some())),
            anomaly: at(ANOMALY, None),
            attitude: attitude(shapes, ["roll", "pitch", "yaw"])
                .or_else(|| attitude(shapes, ["ins_roll", "ins_pitch", "ins_yaw"])),
            core: at("igrf", None),
            diurnal: at("diurnal", None),
        }
    }

    /// Why a metric cannot be had.
    fn lacks(&self, places: &Places, need: Need) -> Option<String> {
        let mag = || places.mag.is_none().then(|| format!("a table with `{}`", self.mag));
        let position = || places.position.is_none().then(|| "true positions `lat` and `lon`".to_owned());
        let track = || places.track.is_none().then(|| "a track of `navigate`".to_owned());
        let map = || places.map.is_none().then(|| "a table of `map_value`".to_owned());
        let core = || places.core.is_none().then(|| "the core field `igrf`, of stage `core_field`".to_owned());
        match need {
            Need::Map => map().or_else(position),
            Need::MapError => map().or_else(mag).or_else(core),
            Need::Anomaly => mag()
                .or_else(|| places.anomaly.is_none().then(|| format!("the known anomaly `{ANOMALY}`")))
                .or_else(core),
            Need::Box => mag().or_else(|| places.attitude.is_none().then(|| "roll, pitch and yaw".to_owned())),
            Need::Truth => mag().or_else(|| places.truth.is_none().then(|| "`truth`".to_owned())),
            Need::Aircraft => {
                mag().or_else(|| places.aircraft.is_none().then(|| "`mag_aircraft` of `compensate`".to_owned()))
            }
            Need::Position => mag().or_else(position),
            Need::Track => track().or_else(position),
            Need::Ins => position().or_else(|| places.ins.is_none().then(|| "`ins_lat` and `ins_lon`".to_owned())),
            Need::Innovation => track(),
            Need::Height => track().or_else(|| places.height.is_none().then(|| format!("`{MAP_HEIGHT_ERROR}`"))),
        }
    }

    /// The metrics that are wanted and can be had.
    fn chosen(&self, places: &Places) -> Vec<&'static Metric> {
        let wanted = |name: &str| self.metrics.as_ref().is_none_or(|m| m.iter().any(|n| n == name));
        METRICS.iter().filter(|m| wanted(m.0) && self.lacks(places, m.2).is_none()).collect()
    }
}

struct Places {
    mag: Option<(usize, String)>,
    aircraft: Option<(usize, String)>,
    truth: Option<(usize, String)>,
    position: Option<(usize, [String; 2])>,
    ins: Option<(usize, [String; 2])>,
    track: Option<usize>,
    height: Option<(usize, String)>,
    map: Option<usize>,
    anomaly: Option<(usize, String)>,
    attitude: Option<(usize, [&'static str; 3])>,
    core: Option<(usize, String)>,
    diurnal: Option<(usize, String)>,
}

/// The table with all three angles.
fn attitude(shapes: &[&Shape], names: [&'static str; 3]) -> Option<(usize, [&'static str; 3])> {
    shapes.iter().position(|s| names.iter().all(|n| s.get(n).is_some())).map(|i| (i, names))
}

/// The known geology of a simulation.
const ANOMALY: &str = "anomaly_truth";
/// What `map_value` makes: the map and its slopes north and east.
const MAP: [&str; 3] = ["map_anomaly", "map_grad_n", "map_grad_e"];
const TRACK: [&str; 8] = ["lat", "lon", "alt", "sd_n", "sd_e", "cov_ne", "nis", "update"];

impl Stage for Score {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shapes: Vec<&Shape> = (0..inputs.len()).map(|i| shape(inputs, i)).collect::<Result<_, _>>()?;
        let places = self.places(&shapes);
        let mut faults = vec![];
        if let Some(truth) = &self.truth {
            let all: Shape = Shape { columns: shapes.iter().flat_map(|s| s.columns.clone()).collect(), rate_hz: None };
            faults.extend(faults_of([all.number(truth, "nT")], "truth"));
        }
        for metric in self.metrics.iter().flatten() {
            let need = METRICS.iter().find(|m| m.0 == metric).and_then(|m| self.lacks(&places, m.2));
            if let Some(lack) = need {
                faults.push(Fault::new(format!("`{metric}` needs {lack}")).of_param("metrics"));
            }
        }
        if faults.is_empty() && self.chosen(&places).is_empty() {
            let help = format!("name a table with `{}` or a track", self.mag);
            faults.push(Fault::new("there is nothing to score in these tables").help(help).of_param("input"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads: Vec<Vec<String>> = vec![vec!["tt".to_owned()]; inputs.len()];
        let mut add = |i: usize, name: &str| {
            if !reads[i].iter().any(|n| n == name) {
                reads[i].push(name.to_owned());
            }
        };
        let Places { mag, aircraft, truth, core, diurnal, anomaly, height, .. } = &places;
        for (i, name) in [mag, aircraft, truth, height].into_iter().flatten() {
            add(*i, name);
        }
        let chosen = self.chosen(&places);
        let scored = |need: Need| chosen.iter().any(|m| m.2 == need);
        if chosen.iter().any(|m| m.0 == "snr") {
            [core, diurnal].into_iter().flatten().for_each(|(i, name)| add(*i, name));
        }
        if scored(Need::Anomaly) {
            [anomaly, core, diurnal].into_iter().flatten().for_each(|(i, name)| add(*i, name));
        }
        if let Some((i, names)) = places.attitude.filter(|_| scored(Need::Box)) {
            names.iter().for_each(|name| add(i, name));
        }
        if let Some(map) = places.map {
            [core, diurnal].into_iter().flatten().for_each(|(i, name)| add(*i, name));
            MAP.iter().for_each(|n| add(map, n));
        }
        for (i, names) in [&places.position, &places.ins].into_iter().flatten() {
            names.iter().for_each(|n| add(*i, n));
        }
        if let Some(i) = places.track {
            TRACK.iter().for_each(|n| add(i, n));
        }
        let columns = vec![
            Column::text("flight", "flight identifier").role(Role::Key),
            Column::text("line", "line identifier").role(Role::Key),
            Column::text("metric", "what was scored").role(Role::Key),
            Column::float("value", "", "the score; null where no sample was left for it"),
            Column::text("unit", "the unit of the value"),
            Column::integer("n", "", "samples or pairs behind it"),
        ];
        let columns = columns.into_iter().map(|c| reads.iter().enumerate().fold(c, |c, (i, names)| c.from(i, names)));
        Ok(Yield {
            columns: columns.collect(),
            passes: Passes::None,
            reads,
            rate_hz: None,
            features: vec![],
            lenient: false,
            tidy: true,
            notes: vec![],
        })
    }

    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        let shapes: Vec<Shape> = line
            .inputs
            .iter()
            .map(|b| Shape {
                columns: b.schema().fields().iter().map(|f| schemas::describe_field(f)).collect(),
                rate_hz: None,
            })
            .collect();
        let shapes: Vec<&Shape> = shapes.iter().collect();
        same_samples(line)?;
        let mut places = self.places(&shapes);
        // Innovations are not read, so a track is known by what is.
        places.track = shapes.iter().position(|s| TRACK.iter().all(|n| s.get(n).is_some()));
        let scored = Scored { stage: self, line, places };
        let mut rows: Vec<(&str, &str, Figure)> = vec![];
        for (name, unit, ..) in self.chosen(&scored.places) {
            rows.push((name, unit, scored.metric(name)?));
        }
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; rows.len()])) };
        let value = |f: &Figure| Some(f.value).filter(|v| v.is_finite());
        Ok(vec![
            same(&line.flight),
            same(&line.line),
            Arc::new(rows.iter().map(|r| Some(r.0)).collect::<StringArray>()),
            Arc::new(rows.iter().map(|r| value(&r.2)).collect::<arrow_array::Float64Array>()),
            Arc::new(rows.iter().map(|r| Some(r.1)).collect::<StringArray>()),
            Arc::new(rows.iter().map(|r| Some(r.2.n as i64)).collect::<Int64Array>()),
        ])
    }
}

/// The tables must hold the same samples.
fn same_samples(line: &LineIn) -> Result<(), Fault> {
    let first = floats(&line.inputs[0], "tt")?;
    for batch in &line.inputs[1..] {
        if floats(batch, "tt")? != first {
            return Err(Fault::data("the tables to score have different samples")
                .in_column("tt")
                .help("score tables that were made from the same resampling"));
        }
    }
    Ok(())
}

struct Scored<'a> {
    stage: &'a Score,
    line: &'a LineIn,
    places: Places,
}

impl Scored<'_> {
    fn at(&self, place: &Option<(usize, String)>) -> Result<&[f64], Fault> {
        let (i, name) = place.as_ref().ok_or_else(|| Fault::data("a column is missing"))?;
        floats(&self.line.inputs[*i], name)
    }

    fn pair(&self, place: &Option<(usize, [String; 2])>) -> Result<(&[f64], &[f64]), Fault> {
        let (i, [a, b]) = place.as_ref().ok_or_else(|| Fault::data("positions are missing"))?;
        Ok((floats(&self.line.inputs[*i], a)?, floats(&self.line.inputs[*i], b)?))
    }

    fn track(&self, name: &str) -> Result<&[f64], Fault> {
        let i = self.places.track.ok_or_else(|| Fault::data("the track is missing"))?;
        floats(&self.line.inputs[i], name)
    }

    fn metric(&self, name: &str) -> Result<Figure, Fault> {
        let errors = || -> Result<statistics::Summary, Fault> {
            Ok(statistics::error_summary(self.at(&self.places.mag)?, self.at(&self.places.truth)?))
        };
        match name {
            "std_error" => errors().map(|s| Figure { value: s.std, n: s.n }),
            "bias_error" => errors().map(|s| Figure { value: s.mean, n: s.n }),
            "rms_error" => errors().map(|s| Figure { value: s.rms, n: s.n }),
            "std_uncompensated" => Ok(statistics::std(&self.signals()?.0)),
            "improvement_ratio" => self.signals().map(|(before, after)| statistics::improvement_ratio(&before, &after)),
            "improvement_ratio_band" => self.band_ratio(),
            "snr" => {
                let (mag, truth) = (self.at(&self.places.mag)?, self.at(&self.places.truth)?);
                Ok(statistics::signal_to_noise(mag, truth, &self.true_anomaly()?))
            }
            "anomaly_retention" => self.anomaly_retention(),
            "figure_of_merit" => self.figure_of_merit(),
            "figure_of_merit_crossings" => self.crossings(),
            "drms" | "rms_north" | "rms_east" => {
                let (north, east) = self.errors_m((self.track("lat")?, self.track("lon")?))?;
                Ok(match name {
                    "rms_north" => statistics::rms(&north),
                    "rms_east" => statistics::rms(&east),
                    _ => statistics::drms(&north, &east),
                })
            }
            "ins_drms" => {
                let (north, east) = self.errors_m(self.pair(&self.places.ins)?)?;
                Ok(statistics::drms(&north, &east))
            }
            "nees" => self.nees(),
            "nis" => Ok(statistics::mean(self.track("nis")?)),
            "map_height_error" => Ok(statistics::mean(self.at(&self.places.height)?)),
            "map_std_error" => self.map_error().map(|s| Figure { value: s.std, n: s.n }),
            "map_bias_error" => self.map_error().map(|s| Figure { value: s.mean, n: s.n }),
            "map_gradient_along_track" => self.map_gradient(),
            "map_position_bound" => {
                Ok(statistics::offset_bound(self.map("map_grad_n")?, self.map("map_grad_e")?, self.stage.map_sigma_nt))
            }
            counted => self.count(counted.trim_start_matches("samples_")),
        }
    }

    fn map(&self, name: &str) -> Result<&[f64], Fault> {
        let i = self.places.map.ok_or_else(|| Fault::data("the map's values are missing"))?;
        floats(&self.line.inputs[i], name)
    }

    /// A total field less core field and, where there is one, diurnal variation.
    fn anomaly_of(&self, field: &[f64]) -> Result<Vec<f64>, Fault> {
        let core = self.at(&self.places.core)?;
        let diurnal = if self.places.diurnal.is_some() { Some(self.at(&self.places.diurnal)?) } else { None };
        let anomaly = |(i, (field, core)): (usize, (&f64, &f64))| field - core - diurnal.map_or(0.0, |d| d[i]);
        Ok(field.iter().zip(core).enumerate().map(anomaly).collect())
    }

    /// The same of the compensated signal.
    fn measured_anomaly(&self) -> Result<Vec<f64>, Fault> {
        self.anomaly_of(self.at(&self.places.mag)?)
    }

    /// The same of the truth. Where the core field is not known, its gradient is taken for the straight line of the truth.
    fn true_anomaly(&self) -> Result<Vec<f64>, Fault> {
        let truth = self.at(&self.places.truth)?;
        if self.places.core.is_some() {
            return self.anomaly_of(truth);
        }
        Ok(statistics::less_straight_line(floats(&self.line.inputs[0], "tt")?, truth))
    }

    /// The compensated anomaly against the map.
    fn map_error(&self) -> Result<statistics::Summary, Fault> {
        Ok(statistics::error_summary(&self.measured_anomaly()?, self.map("map_anomaly")?))
    }

    /// How much of the known geology is left.
    fn anomaly_retention(&self) -> Result<Figure, Fault> {
        let anomaly = self.at(&self.places.anomaly)?;
        // Less core field and diurnal variation the true reading is the anomaly itself.
        match anomaly_retention(&self.measured_anomaly()?, anomaly, anomaly) {
            Ok(found) => Ok(Figure { value: found.slope, n: found.n }),
            Err(RetentionError::TooFew { n }) => Ok(Figure { value: f64::NAN, n }),
            Err(RetentionError::NoAnomaly { .. }) => Ok(Figure { value: f64::NAN, n: 0 }),
            Err(other) => Err(data(other)),
        }
    }

    /// What the manoeuvres of a box leave in the pass band.
    fn figure_of_merit(&self) -> Result<Figure, Fault> {
        let (i, names) = self.places.attitude.ok_or_else(|| Fault::data("the attitude is missing"))?;
        let tt = floats(&self.line.inputs[0], "tt")?;
        let angle = |name: &str| floats(&self.line.inputs[i], name);
        let found = manoeuvres(tt, [angle(names[0])?, angle(names[1])?, angle(names[2])?]);
        if found.len() < 12 {
            return Ok(Figure { value: f64::NAN, n: found.len() });
        }
        let mag = self.at(&self.places.mag)?;
        let rate_hz = sample_rate(tt, STEP_TOLERANCE).map_err(|e| data(e).in_column("tt").help("resample first"))?;
        let runs = Usable::all(tt.len()).and_finite(mag).runs_in_time(tt, rate_hz);
        match design(self.stage.low_hz, self.stage.high_hz, self.stage.order, rate_hz)? {
            None => Ok(figure_of_merit(mag, &found)),
            Some(filter) => Ok(figure_of_merit(&filter_column(&filter, mag, &runs).map_err(data)?.0, &found)),
        }
    }

    /// The slope of the map in the direction of flight, from one sample to the next.
    fn map_gradient(&self) -> Result<Figure, Fault> {
        let (lat, lon) = self.pair(&self.places.position)?;
        let (north, east) = (self.map("map_grad_n")?, self.map("map_grad_e")?);
        let along = (1..lat.len()).map(|i| {
            let (n, e) = EarthModel::default().offset_ne_m((lat[i - 1], lon[i - 1]), (lat[i], lon[i]), 0.0);
            (north[i] * n + east[i] * e) / n.hypot(e)
        });
        Ok(statistics::rms(&along.collect::<Vec<_>>()))
    }

    /// The signal before and after compensation, less the truth where there is one.
    fn signals(&self) -> Result<(Vec<f64>, Vec<f64>), Fault> {
        let (mag, aircraft) = (self.at(&self.places.mag)?, self.at(&self.places.aircraft)?);
        let truth = if self.places.truth.is_some() { Some(self.at(&self.places.truth)?) } else { None };
        let less = |i: usize| truth.map_or(0.0, |t| t[i]);
        let after: Vec<f64> = mag.iter().enumerate().map(|(i, m)| m - less(i)).collect();
        let before = after.iter().zip(aircraft).map(|(m, a)| m + a).collect();
        Ok((before, after))
    }

    fn band_ratio(&self) -> Result<Figure, Fault> {
        let tt = floats(&self.line.inputs[0], "tt")?;
        let (before, after) = self.signals()?;
        let rate_hz = sample_rate(tt, STEP_TOLERANCE).map_err(|e| data(e).in_column("tt").help("resample first"))?;
        let Some(filter) = design(self.stage.low_hz, self.stage.high_hz, self.stage.order, rate_hz)? else {
            return Ok(statistics::improvement_ratio(&before, &after));
        };
        let runs = Usable::all(tt.len()).and_finite(&before).and_finite(&after).runs_in_time(tt, rate_hz);
        let banded = |x: &[f64]| filter_column(&filter, x, &runs).map(|(y, _)| y).map_err(data);
        Ok(statistics::improvement_ratio(&banded(&before)?, &banded(&after)?))
    }

    /// North and east offset of positions from the truth, in metres.
    fn errors_m(&self, (lat, lon): (&[f64], &[f64])) -> Result<(Vec<f64>, Vec<f64>), Fault> {
        let (true_lat, true_lon) = self.pair(&self.places.position)?;
        let offset = |i: usize| EarthModel::default().offset_ne_m((true_lat[i], true_lon[i]), (lat[i], lon[i]), 0.0);
        Ok((0..lat.len()).map(offset).unzip())
    }

    fn crossings(&self) -> Result<Figure, Fault> {
        let (lat, lon) = self.pair(&self.places.position)?;
        let Some(start) = (0..lat.len()).find(|i| lat[*i].is_finite() && lon[*i].is_finite()) else {
            return Ok(Figure { value: f64::NAN, n: 0 });
        };
        let place = |i: usize| EarthModel::default().offset_ne_m((lat[start], lon[start]), (lat[i], lon[i]), 0.0);
        let (north, east): (Vec<f64>, Vec<f64>) = (0..lat.len()).map(place).unzip();
        let tt = floats(&self.line.inputs[0], "tt")?;
        Ok(figure_of_merit_crossings(&north, &east, self.at(&self.places.mag)?, tt).figure)
    }

    /// The mean over the line of e' P^-1 e for the horizontal position.
    fn nees(&self) -> Result<Figure, Fault> {
        let (north, east) = self.errors_m((self.track("lat")?, self.track("lon")?))?;
        let (sd_n, sd_e, cov) = (self.track("sd_n")?, self.track("sd_e")?, self.track("cov_ne")?);
        let all = statistics::position_nees(&north, &east, sd_n, sd_e, cov);
        Ok(statistics::mean(&all))
    }

    fn count(&self, fate: &str) -> Result<Figure, Fault> {
        let i = self.places.track.ok_or_else(|| Fault::data("the track is missing"))?;
        let fates = self.line.inputs[i].column_by_name("update").and_then(|a| a.as_string_opt::<i32>());
        let fates = fates
            .ok_or_else(|| Fault::data("the track does not say what became of its measurements").in_column("update"))?;
        let n = fates.iter().filter(|f| *f == Some(fate)).count();
        Ok(Figure { value: n as f64, n: fates.len() })
    }
}

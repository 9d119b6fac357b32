//! The synth spec: what is simulated.

use std::path::{Path, PathBuf};

use schemas::Fault;
use stages::numerics::{dates, gauss_markov::GaussMarkov, ins_error::InsErrorModel};
use toml::de::DeTable;

use super::section::{Faults, Need, Section};
use crate::{MapOptions, ReadError};

/// A synth spec, checked.
#[derive(Clone, Debug)]
pub struct Spec {
    /// Where every random draw begins.
    pub seed: u64,
    /// Calendar year and day of the year, UTC.
    pub date: (i32, u32),
    /// Samples a second.
    pub rate_hz: f64,
    /// The anomaly map and how to read it.
    pub map: (PathBuf, MapOptions),
    /// The error sources of the INS.
    pub ins: InsErrorModel,
    /// The temporal variation of the earth's field.
    pub diurnal: Option<GaussMarkov>,
    /// Standard deviation of the attitude's small motions in roll, pitch and yaw, in degrees.
    pub gusts_deg: [f64; 3],
    /// The currents on board.
    pub currents: Vec<Current>,
    /// The scalar magnetometers.
    pub scalars: Vec<Scalar>,
    /// The vector magnetometers.
    pub vectors: Vec<Vector>,
    /// The flights.
    pub flights: Vec<Flight>,
}

/// A current that is switched on and off at random, and its sensor.
#[derive(Clone, Debug)]
pub struct Current {
    /// The column, `cur_*`.
    pub name: String,
    /// Amperes while off, and while on.
    pub off_on_a: (f64, f64),
    /// Mean durations of off and on, in seconds; each is drawn from an exponential distribution.
    pub mean_off_on_s: (f64, f64),
    /// White noise of the sensor, in A.
    pub noise_a: f64,
}

/// The magnetic field of the aircraft at one place in it.
#[derive(Clone, Debug)]
pub struct Source {
    /// Magnitude of the permanent field, in nT.
    pub permanent_nt: f64,
    /// Standard deviation of the induced tensor's elements times 50,000 nT, in nT.
    pub induced_nt: f64,
    /// Standard deviation of the eddy matrix' elements, in seconds (nT per nT/s).
    pub eddy_s: f64,
    /// Field of each current in nT/A, its direction drawn.
    pub currents: Vec<(usize, f64)>,
}

/// A scalar magnetometer.
#[derive(Clone, Debug)]
pub struct Scalar {
    /// The column, `mag_N_uc` or `mag_1_c`.
    pub name: String,
    /// The aircraft's field there.
    pub source: Source,
    /// White noise, in nT.
    pub noise_nt: f64,
    /// Its own slow drift.
    pub drift: Option<GaussMarkov>,
}

/// A vector magnetometer, aligned with the body.
#[derive(Clone, Debug)]
pub struct Vector {
    /// The columns without `_x`, `_y`, `_z`.
    pub name: String,
    /// The aircraft's field there.
    pub source: Source,
    /// White noise of each axis, in nT.
    pub noise_nt: f64,
    /// Standard deviation of each axis' offset, in nT.
    pub offset_nt: f64,
    /// Standard deviation of each axis' relative scale error.
    pub scale: f64,
}

/// A flight.
#[derive(Clone, Debug)]
pub struct Flight {
    /// Its identifier.
    pub name: String,
    /// Its lines, in time.
    pub lines: Vec<Line>,
}

/// A line of a flight.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its identifier.
    pub name: String,
    /// When it begins, in seconds past midnight UTC.
    pub start_tt_s: f64,
    /// Height above the WGS-84 ellipsoid, in metres.
    pub alt_m: f64,
    /// Speed over ground, in m/s.
    pub speed_mps: f64,
    /// Where it goes.
    pub path: Path2d,
}

/// The horizontal path of a line.
#[derive(Clone, Debug)]
pub enum Path2d {
    /// From waypoint to waypoint, and round again.
    Survey {
        /// Latitude and longitude, in degrees.
        waypoints: Vec<(f64, f64)>,
        /// How long, in seconds.
        duration_s: f64,
        /// Amplitude and period of the course's swing about the way to the next waypoint.
        weave_deg_s: (f64, f64),
    },
    /// Four headings, on each a pitch, a roll and a yaw manoeuvre.
    Box {
        /// Where it begins, in degrees.
        start: (f64, f64),
        /// The first heading; the others follow to the right.
        heading_deg: f64,
        /// Amplitudes of roll, pitch and yaw.
        amplitude_deg: [f64; 3],
        /// Period of a manoeuvre.
        period_s: f64,
        /// Periods to a manoeuvre.
        cycles: u32,
    },
}

impl Spec {
    /// Reads a spec.
    ///
    /// # Errors
    /// All that is wrong with it at once, each fault with file, line and column.
    pub fn read(path: &Path) -> Result<Spec, ReadError> {
        let text = std::fs::read_to_string(path).map_err(|e| ReadError::io(path, &e))?;
        let root = DeTable::parse(&text).map_err(|e| {
            let fault = Fault::new(e.message()).at(e.span().unwrap_or(0..0));
            ReadError::spec(path, &text, &[fault])
        })?;
        let faults = Faults::default();
        let section = Section::new("synth", root.get_ref(), 0..0, &faults);
        let spec = spec(&section, path.parent().unwrap_or(Path::new("")));
        section.finish();
        let found = std::mem::take(&mut *faults.borrow_mut());
        if found.is_empty() { Ok(spec) } else { Err(ReadError::spec(path, &text, &found)) }
    }
}

fn spec(root: &Section, folder: &Path) -> Spec {
    let date = date(root);
    let currents: Vec<Current> = root.sections("currents").iter().map(current).collect();
    let scalars: Vec<_> = root.sections("magnetometers").iter().map(|s| scalar(s, &currents)).collect();
    let vectors: Vec<_> = root.sections("vector_magnetometers").iter().map(|s| vector(s, &currents)).collect();
    let flights: Vec<_> = root.sections("flights").iter().map(flight).collect();
    let of_lines = |f: &Flight| f.lines.iter().map(|l| format!("{}/{}", f.name, l.name)).collect::<Vec<_>>();
    unique(root, "current", currents.iter().map(|c| c.name.clone()));
    unique(root, "magnetometer", scalars.iter().map(|c| c.name.clone()));
    unique(root, "vector magnetometer", vectors.iter().map(|c| c.name.clone()));
    unique(root, "flight", flights.iter().map(|c| c.name.clone()));
    unique(root, "line", flights.iter().flat_map(of_lines));
    if flights.iter().all(|f| f.lines.is_empty()) {
        root.fault("the spec has no flight with a line".to_owned());
    }
    Spec {
        seed: root.whole("seed", 0, 0, i64::MAX) as u64,
        date,
        rate_hz: root.number("rate_hz", 10.0, Need::Between(0.1, 1000.0)),
        map: map(root, folder),
        ins: ins(root),
        diurnal: root.section("diurnal").and_then(|s| gauss_markov(&s, "sigma_nt", "tau_s", 600.0)),
        gusts_deg: root.numbers("gusts_deg", [0.0; 3], Need::Between(0.0, 20.0)),
        currents,
        scalars,
        vectors,
        flights,
    }
}

fn unique(root: &Section, kind: &str, names: impl Iterator<Item = String>) {
    let names: Vec<String> = names.collect();
    for (i, name) in names.iter().enumerate() {
        if names.iter().take(i).any(|n| n == name) {
            root.fault(format!("there are two of the {kind} `{name}`"));
        }
    }
}

fn date(root: &Section) -> (i32, u32) {
    let year = root.whole("year", 2020, 1900, 2030) as i32;
    let doy = root.whole("doy", 1, 1, i64::from(dates::days_in_year(year))) as u32;
    (year, doy)
}

fn map(root: &Section, folder: &Path) -> (PathBuf, MapOptions) {
    let Some(s) = root.section("map") else {
        root.fault("the spec needs a table `map`".to_owned());
        return Default::default();
    };
    let options = MapOptions {
        format: s.optional_text("format"),
        epsg: s.optional("epsg", Need::Between(1.0, 65535.0)).map(|x| x as u16),
        alt_m: s.optional("alt_m", Need::Any),
        unit: s.optional_text("unit"),
    };
    let path = folder.join(s.text("path"));
    s.finish();
    (path, options)
}

/// The INS; its temporal variation is the spec's own `diurnal`.
fn ins(root: &Section) -> InsErrorModel {
    let mut m = InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::default() };
    let Some(s) = root.section("ins") else { return m };
    let sigmas: [(&'static str, &mut f64); 11] = [
        ("init_position_sigma_m", &mut m.init_position_sigma_m),
        ("init_altitude_sigma_m", &mut m.init_altitude_sigma_m),
        ("init_velocity_sigma_mps", &mut m.init_velocity_sigma_mps),
        ("init_attitude_sigma_deg", &mut m.init_attitude_sigma_deg),
        ("vrw_sigma", &mut m.vrw_sigma),
        ("arw_sigma", &mut m.arw_sigma),
        ("baro_sigma_m", &mut m.baro_sigma_m),
        ("ha_sigma_m", &mut m.ha_sigma_m),
        ("a_hat_sigma_mps2", &mut m.a_hat_sigma_mps2),
        ("acc_sigma_mps2", &mut m.acc_sigma_mps2),
        ("gyro_sigma_radps", &mut m.gyro_sigma_radps),
    ];
    for (key, value) in sigmas {
        *value = s.number(key, *value, Need::NotNegative);
    }
    for (key, value) in
        [("baro_tau_s", &mut m.baro_tau_s), ("acc_tau_s", &mut m.acc_tau_s), ("gyro_tau_s", &mut m.gyro_tau_s)]
    {
        *value = s.number(key, *value, Need::Positive);
    }
    s.finish();
    m
}

fn gauss_markov(s: &Section, sigma: &'static str, tau: &'static str, tau_s: f64) -> Option<GaussMarkov> {
    let process =
        GaussMarkov { sigma: s.needed(sigma, Need::NotNegative), tau_s: s.number(tau, tau_s, Need::Positive) };
    s.finish();
    (process.sigma > 0.0).then_some(process)
}

fn current(s: &Section) -> Current {
    let name = s.text("name");
    if !name.is_empty() && !name.starts_with("cur_") {
        s.fault_at("name", format!("a current is called `cur_...`, not `{name}`"));
    }
    let current = Current {
        name,
        off_on_a: (s.number("off_a", 0.0, Need::Any), s.needed("on_a", Need::Any)),
        mean_off_on_s: (s.number("mean_off_s", 20.0, Need::Positive), s.number("mean_on_s", 20.0, Need::Positive)),
        noise_a: s.number("noise_a", 0.0, Need::NotNegative),
    };
    s.finish();
    current
}

fn source(s: &Section, currents: &[Current]) -> Source {
    let names: Vec<&str> = currents.iter().map(|c| c.name.as_str()).collect();
    let mut coupled = vec![];
    for (name, nt_per_a, at) in s.section("currents").map(|c| c.entries()).unwrap_or_default() {
        match names.iter().position(|n| *n == name) {
            Some(i) => coupled.push((i, nt_per_a)),
            None => s.push(Fault::new(format!("there is no current `{name}`")).at(at).nearest(&name, &names)),
        }
    }
    Source {
        permanent_nt: s.number("permanent_nt", 0.0, Need::NotNegative),
        induced_nt: s.number("induced_nt", 0.0, Need::NotNegative),
        eddy_s: s.number("eddy_s", 0.0, Need::NotNegative),
        currents: coupled,
    }
}

fn scalar(s: &Section, currents: &[Current]) -> Scalar {
    let name = s.text("name");
    let known = schemas::flight::describe(&name);
    if !name.is_empty() && (known.unit != "nT" || !name.starts_with("mag_")) {
        s.fault_at("name", format!("a scalar magnetometer is called `mag_N_uc` or `mag_1_c`, not `{name}`"));
    }
    let sensor = Scalar {
        name,
        source: source(s, currents),
        noise_nt: s.number("noise_nt", 0.0, Need::NotNegative),
        drift: s.section("drift").and_then(|d| gauss_markov(&d, "sigma_nt", "tau_s", 600.0)),
    };
    s.finish();
    sensor
}

fn vector(s: &Section, currents: &[Current]) -> Vector {
    let name = s.text("name");
    if !name.is_empty() && name.strip_prefix("flux_").is_none_or(str::is_empty) {
        s.fault_at("name", format!("a vector magnetometer is called `flux_X`, not `{name}`"));
    }
    let sensor = Vector {
        name,
        source: source(s, currents),
        noise_nt: s.number("noise_nt", 0.0, Need::NotNegative),
        offset_nt: s.number("offset_nt", 0.0, Need::NotNegative),
        scale: s.number("scale", 0.0, Need::Between(0.0, 0.5)),
    };
    s.finish();
    sensor
}

/// Seconds from the end of a line to the start of the next, where the spec does not say.
const PAUSE_S: f64 = 60.0;

fn flight(s: &Section) -> Flight {
    let name = s.text("name");
    let mut next_s = s.number("start_tt_s", 0.0, Need::NotNegative);
    let mut lines = vec![];
    for one in s.sections("lines") {
        let line = line(&one, next_s);
        if line.start_tt_s < next_s - PAUSE_S {
            one.fault_at("start_tt_s", "the line starts before the one before it ends".to_owned());
        }
        next_s = line.start_tt_s + line.duration_s() + PAUSE_S;
        lines.push(line);
    }
    s.finish();
    Flight { name, lines }
}

fn line(s: &Section, next_s: f64) -> Line {
    let path = match s.word("kind", &["survey", "box"]) {
        0 => Path2d::Survey {
            waypoints: s.places("waypoints"),
            duration_s: s.needed("duration_s", Need::Between(1.0, 1e5)),
            weave_deg_s: (
                s.number("weave_deg", 0.0, Need::Between(0.0, 45.0)),
                s.number("weave_period_s", 120.0, Need::Positive),
            ),
        },
        _ => Path2d::Box {
            start: {
                let [lat, lon] = s.numbers("start", [f64::NAN; 2], Need::Between(-360.0, 360.0));
                if lat.is_nan() || lat.abs() >= 89.0 {
                    s.fault("`lines` of kind `box` needs `start`, its [latitude, longitude] in degrees".to_owned());
                }
                (lat, lon)
            },
            heading_deg: s.number("heading_deg", 0.0, Need::Between(-360.0, 360.0)),
            // Figure 3-7 of the thesis: 4.5 degrees of pitch, 9 of roll, 5 of yaw, 6 s.
            amplitude_deg: s.numbers("amplitude_deg", [9.0, 4.5, 5.0], Need::Between(0.0, 40.0)),
            period_s: s.number("period_s", 6.0, Need::Between(1.0, 60.0)),
            cycles: s.whole("cycles", 3, 1, 100) as u32,
        },
    };
    let line = Line {
        name: s.text("name"),
        start_tt_s: s.number("start_tt_s", next_s, Need::NotNegative),
        alt_m: s.needed("alt_m", Need::Any),
        speed_mps: s.number("speed_mps", 60.0, Need::Between(1.0, 1000.0)),
        path,
    };
    s.finish();
    line
}

//! What the spec says of the magnetometers.

use nalgebra::Vector3;
use numerics::signal::gauss_markov::GaussMarkov;

use super::{
    super::super::spec::{
        gauss_markov,
        section::{Need, Section},
    },
    Current, Source,
    source::source,
};

/// A scalar magnetometer: it reads the exact magnitude of the field, and its own errors.
#[derive(Clone, Debug)]
pub struct Scalar {
    /// The column, `mag_N_uc` or `mag_1_c`. Key `name`.
    pub name: String,
    /// The aircraft's field there.
    pub source: Source,
    /// White noise, in nT. Key `noise_nt`, 0.
    pub noise_nt: f64,
    /// Its own slow drift. Table `drift` with `sigma_nt` and `tau_s` (600).
    pub drift: Option<GaussMarkov>,
    /// How its reading depends on where the field comes from. Keys `heading_nt`, 0, and `axis`.
    pub heading: Heading,
    /// It reads nothing while the field is nearer to the optical axis than this, in degrees.
    /// Key `dead_polar_deg`, 0.
    pub dead_polar_deg: f64,
    /// It reads nothing while the field is nearer to the plane across the optical axis than this, in degrees.
    /// Key `dead_equatorial_deg`, 0.
    pub dead_equatorial_deg: f64,
    /// Bursts in which it reads nothing: from one's end to the next and how long, means of exponential
    /// distributions in seconds. Table `dropouts` with `mean_s` and `for_s` (1).
    pub dropouts: Option<(f64, f64)>,
    /// What is recorded while it reads nothing: NaN, or 0 as some recorders write. Key `lost`, `nan` or `zero`.
    pub lost_is_zero: bool,
    /// Single wrong samples: mean time between them in seconds, and their standard deviation in nT.
    /// Table `spikes` with `mean_s` and `sigma_nt`.
    pub spikes: Option<(f64, f64)>,
    /// Step of its readings, in nT; 0 is none. Key `resolution_nt`, 0.
    pub resolution_nt: f64,
    /// When it reads.
    pub sampling: Sampling,
}

/// Heading error: `amplitude_nt` times the cosine of the angle between the field and the optical axis, as the
/// light's own shift of the levels goes; so the largest over all headings is the amplitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    /// The largest error, in nT: 0.15 for a split-beam caesium magnetometer, 30 for a small single-beam one.
    pub amplitude_nt: f64,
    /// Direction of the light in the body frame, of length 1. Key `axis`, half to the right and half down.
    pub axis: Vector3<f64>,
}

/// When a sensor reads: at its own rate if that is below the table's, and late.
///
/// Between its own readings the table holds the last (`hold`) or the straight line from one to the next, as a
/// recorder does or as processing does afterwards. A sensor that is as fast as the table is read at its times.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Sampling {
    /// Readings a second. Key `rate_hz`, the table's.
    pub rate_hz: Option<f64>,
    /// How old what it reads is, in seconds. Key `lag_s`, 0.
    pub lag_s: f64,
    /// Whether the last reading is held. Key `hold`, false.
    pub hold: bool,
}

/// A vector magnetometer, such as a fluxgate.
#[derive(Clone, Debug)]
pub struct Vector {
    /// The columns without `_x`, `_y`, `_z`. Key `name`.
    pub name: String,
    /// The aircraft's field there.
    pub source: Source,
    /// White noise of each axis, in nT. Key `noise_nt`, 0.
    pub noise_nt: f64,
    /// Standard deviation of each axis' offset, in nT. Key `offset_nt`, 0.
    pub offset_nt: f64,
    /// Standard deviation of each axis' relative scale error. Key `scale`, 0.
    pub scale: f64,
    /// Standard deviation of the three angles by which the axes are not square, in degrees.
    /// Key `non_orthogonal_deg`, 0.
    pub non_orthogonal_deg: f64,
    /// Standard deviation of the three angles by which it is turned against the body, in degrees.
    /// Key `misaligned_deg`, 0.
    pub misaligned_deg: f64,
    /// Standard deviation of each axis' drift with the temperature, in nT per degree from the reference.
    /// Key `temperature_nt_per_degc`, 0.
    pub temperature_nt_per_degc: f64,
    /// The slow drift of each axis. Table `drift` with `sigma_nt` and `tau_s` (600).
    pub drift: Option<GaussMarkov>,
    /// Step of its readings, in nT; 0 is none. Key `resolution_nt`, 0.
    pub resolution_nt: f64,
    /// When it reads.
    pub sampling: Sampling,
}

pub(super) fn scalar(s: &Section, currents: &[Current]) -> Scalar {
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
        heading: heading(s),
        dead_polar_deg: s.number("dead_polar_deg", 0.0, Need::Between(0.0, 90.0)),
        dead_equatorial_deg: s.number("dead_equatorial_deg", 0.0, Need::Between(0.0, 90.0)),
        dropouts: bursts(s, "dropouts", |d| d.number("for_s", 1.0, Need::Positive)),
        lost_is_zero: s.word("lost", &["nan", "zero"]) == 1,
        spikes: bursts(s, "spikes", |d| d.needed("sigma_nt", Need::NotNegative)),
        resolution_nt: s.number("resolution_nt", 0.0, Need::NotNegative),
        sampling: sampling(s),
    };
    s.finish();
    sensor
}

fn heading(s: &Section) -> Heading {
    let amplitude_nt = s.number("heading_nt", 0.0, Need::NotNegative);
    let axis = s.vector("axis").map_or(Vector3::new(0.0, 1.0, 1.0), Vector3::from);
    if axis.norm() < 1e-9 {
        s.fault_at("axis", "`axis` has no direction".to_owned());
        return Heading { amplitude_nt, axis: Vector3::z() };
    }
    Heading { amplitude_nt, axis: axis.normalize() }
}

fn bursts(s: &Section, key: &'static str, second: impl Fn(&Section) -> f64) -> Option<(f64, f64)> {
    let table = s.section(key)?;
    let found = (table.needed("mean_s", Need::Positive), second(&table));
    table.finish();
    Some(found)
}

fn sampling(s: &Section) -> Sampling {
    Sampling {
        rate_hz: s.optional("rate_hz", Need::Positive),
        lag_s: s.number("lag_s", 0.0, Need::Between(0.0, 60.0)),
        hold: s.flag("hold", false),
    }
}

pub(super) fn vector(s: &Section, currents: &[Current]) -> Vector {
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
        non_orthogonal_deg: s.number("non_orthogonal_deg", 0.0, Need::Between(0.0, 10.0)),
        misaligned_deg: s.number("misaligned_deg", 0.0, Need::Between(0.0, 30.0)),
        temperature_nt_per_degc: s.number("temperature_nt_per_degc", 0.0, Need::NotNegative),
        drift: s.section("drift").and_then(|d| gauss_markov(&d, "sigma_nt", "tau_s", 600.0)),
        resolution_nt: s.number("resolution_nt", 0.0, Need::NotNegative),
        sampling: sampling(s),
    };
    s.finish();
    sensor
}

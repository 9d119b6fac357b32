//! What the spec says of the magnetometers.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use numerics::signal::gauss_markov::GaussMarkov;
use schemas::{Nested, Rule, choice, params};

use crate::reading::Section;

use super::{
    Current, Drawn, Source,
    source::{Amount, SourceKeys, couplings, source},
};

/// A scalar magnetometer: it reads the exact magnitude of the field, and its own errors.
#[derive(Clone, Debug)]
pub struct Scalar {
    /// The column, `mag_N_uc` or `mag_1_c`.
    pub name: String,
    /// The aircraft's field there.
    pub source: Source,
    /// Where it is from the INS along nose, right and down, in m, for the earth's field; `None` is at the INS.
    pub arm_m: Option<Vector3<f64>>,
    /// White noise, in nT.
    pub noise_nt: f64,
    /// Its own slow drift.
    pub drift: Option<GaussMarkov>,
    /// How its reading depends on where the field comes from.
    pub heading: Heading,
    /// It reads nothing while the field is nearer to the optical axis than this, in degrees.
    pub dead_polar_deg: f64,
    /// It reads nothing while the field is nearer to the plane across the optical axis than this, in degrees.
    pub dead_equatorial_deg: f64,
    /// Bursts in which it reads nothing: from one's end to the next and how long, means of exponential
    /// distributions in seconds.
    pub dropouts: Option<(f64, f64)>,
    /// What is recorded while it reads nothing: NaN, or 0 as some recorders write.
    pub lost_is_zero: bool,
    /// Single wrong samples: mean time between them in seconds, and their standard deviation in nT.
    pub spikes: Option<(f64, f64)>,
    /// Step of its readings, in nT; 0 is none.
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
    /// Direction of the light in the body frame, of length 1.
    pub axis: Vector3<f64>,
}

/// When a sensor reads: at its own rate if that is below the table's, and late.
///
/// Between its own readings the table holds the last (`hold`) or the straight line from one to the next, as a
/// recorder does or as processing does afterwards. A sensor that is as fast as the table is read at its times.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Sampling {
    /// Readings a second.
    pub rate_hz: Option<f64>,
    /// How old what it reads is, in seconds.
    pub lag_s: f64,
    /// Whether the last reading is held.
    pub hold: bool,
}

/// A vector magnetometer, such as a fluxgate.
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
    /// Standard deviation of the three angles by which the axes are not square, in degrees.
    pub non_orthogonal_deg: f64,
    /// Standard deviation of the three angles by which it is turned against the body, in degrees.
    pub misaligned_deg: f64,
    /// Standard deviation of each axis' drift with the temperature, in nT per degree from the reference.
    pub temperature_nt_per_degc: f64,
    /// Standard deviation of each axis' change of scale with the temperature, in millionths per degree from the reference.
    pub temperature_scale_ppm_per_degc: f64,
    /// How fast its own temperature follows the one on board, in seconds; 0 is at once.
    pub thermal_tau_s: f64,
    /// Standard deviation of each axis' largest departure from its best straight line, in millionths of the full scale.
    pub linearity_ppm: f64,
    /// The field that it is made for, in nT.
    pub full_scale_nt: f64,
    /// What each axis still reads when its field has gone through a loop between ±50,000 nT and is back at zero, in nT.
    pub core_hysteresis_nt: f64,
    /// What currents add to the readings of its axes by its cables and its supply, in nT/A.
    pub crosstalk: Vec<(usize, Drawn<Vector3<f64>>)>,
    /// Corner of its first-order response, in Hz.
    pub bandwidth_hz: Option<f64>,
    /// How much later than the sensor each axis is read, in seconds.
    pub axis_lag_s: Vector3<f64>,
    /// The slow drift of each axis.
    pub drift: Option<GaussMarkov>,
    /// Step of its readings, in nT; 0 is none.
    pub resolution_nt: f64,
    /// When it reads.
    pub sampling: Sampling,
}

params! {
    /// A drift as a Gauss-Markov process.
    pub struct DriftKeys;
    /// Standard deviation.
    sigma_nt: f64, unit "nT", rule Rule::NotNegative;
    /// Correlation time.
    tau_s: f64, unit "s", default 600.0, rule Rule::Positive;
}

params! {
    /// Bursts in which a sensor reads nothing; both times are means of exponential distributions.
    pub struct DropoutKeys;
    /// From the end of one to the next.
    mean_s: f64, unit "s", rule Rule::Positive;
    /// How long one lasts.
    for_s: f64, unit "s", default 1.0, rule Rule::Positive;
}

params! {
    /// Single wrong samples.
    pub struct SpikeKeys;
    /// Mean time between them.
    mean_s: f64, unit "s", rule Rule::Positive;
    /// Standard deviation.
    sigma_nt: f64, unit "nT", rule Rule::NotNegative;
}

choice! {
    /// What is recorded while a sensor reads nothing.
    pub enum Lost {
        /// NaN.
        Nan = "nan",
        /// 0, as some recorders write.
        Zero = "zero",
    }
}

params! {
    /// When a sensor reads: at its own rate where that is below the table's, and late.
    pub struct SamplingKeys;
    /// Readings a second.
    rate_hz: Option<f64>, unit "Hz", absent "that of the table", rule Rule::Positive;
    /// How old what it reads is.
    lag_s: f64, unit "s", default 0.0, rule Rule::Between(0.0, 60.0);
    /// Whether the last reading is held between its own readings, else the straight line from one to the next.
    hold: bool, unit "", default false;
}

impl SamplingKeys {
    fn sampling(&self) -> Sampling {
        Sampling { rate_hz: self.rate_hz, lag_s: self.lag_s, hold: self.hold }
    }
}

params! {
    /// A table of `magnetometers`: a scalar magnetometer. It reads the exact magnitude of the field, and its own errors.
    pub struct ScalarKeys, groups [source: SourceKeys, sampling: SamplingKeys];
    /// The column, `mag_N_uc` or `mag_1_c`.
    name: String, unit "";
    /// Where it measures the earth's field, from the INS along nose, right and down. The field is evaluated there, turned by the
    /// true attitude, so that two magnetometers measure the difference of the field between them.
    arm_m: [f64; 3], unit "m", default [0.0; 3], rule Rule::Between(-200.0, 200.0);
    /// White noise.
    noise_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Its own slow drift.
    drift: Option<Nested<DriftKeys>>, unit "", absent "none";
    /// Heading error, the largest over all headings: 0.15 for a split-beam caesium magnetometer, 30 for a small
    /// single-beam one.
    heading_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// The optical axis in the body frame: direction of the light, of any length.
    axis: [f64; 3], unit "1", default [0.0, 1.0, 1.0], rule Rule::Finite;
    /// It reads nothing while the field is nearer to the optical axis than this.
    dead_polar_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 90.0);
    /// It reads nothing while the field is nearer to the plane across the optical axis than this.
    dead_equatorial_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 90.0);
    /// Bursts in which it reads nothing.
    dropouts: Option<Nested<DropoutKeys>>, unit "", absent "none";
    /// What is recorded while it reads nothing.
    lost: Lost, unit "", default Lost::Nan;
    /// Single wrong samples.
    spikes: Option<Nested<SpikeKeys>>, unit "", absent "none";
    /// Step of its readings; 0 is none.
    resolution_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
}

params! {
    /// A table of `vector_magnetometers`: a vector magnetometer, such as a fluxgate.
    pub struct VectorKeys, groups [source: SourceKeys, sampling: SamplingKeys];
    /// The columns without `_x`, `_y`, `_z`: `flux_X`.
    name: String, unit "";
    /// White noise of each axis.
    noise_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of each axis' offset.
    offset_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of each axis' relative scale error.
    scale: f64, unit "1", default 0.0, rule Rule::Between(0.0, 0.5);
    /// Standard deviation of the three angles by which the axes are not square.
    non_orthogonal_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 10.0);
    /// Standard deviation of the three angles by which it is turned against the body.
    misaligned_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 30.0);
    /// Standard deviation of each axis' drift with the temperature, per degree from the reference.
    temperature_nt_per_degc: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of each axis' change of scale with the temperature, per degree from the reference: 20 to 70 for
    /// good fluxgates.
    temperature_scale_ppm_per_degc: f64, unit "ppm", default 0.0, rule Rule::Between(0.0, 1e5);
    /// Time constant with which its own temperature follows the one on board; 0 is at once.
    thermal_tau_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of each axis' largest departure from its best straight line within `full_scale_nt`, of that: a
    /// cubic, as data sheets state the linearity; 15 to 150 for good fluxgates.
    linearity_ppm: f64, unit "ppm", default 0.0, rule Rule::Between(0.0, 1e5);
    /// The field that it is made for.
    full_scale_nt: f64, unit "nT", default 100_000.0, rule Rule::Positive;
    /// What each axis still reads when its field has gone through a loop between ±50,000 nT and is back at zero: half the
    /// loop's width, by Rayleigh's law.
    core_hysteresis_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// What each current adds to the readings for an ampere, by the names of currents: through cables and the supply, not
    /// as a field, and not at other sensors. A vector, or a magnitude whose direction is drawn.
    crosstalk: Option<BTreeMap<String, Amount>>, unit "nT", absent "none", rule Rule::Finite;
    /// Corner of its first-order response, at which half of the power is left.
    bandwidth_hz: Option<f64>, unit "Hz", absent "it follows at once", rule Rule::Positive;
    /// How much older than the others, as of `lag_s`, what each axis reads is: of a converter that takes them in turn.
    axis_lag_s: [f64; 3], unit "s", default [0.0; 3], rule Rule::Between(0.0, 60.0);
    /// The slow drift of each axis.
    drift: Option<Nested<DriftKeys>>, unit "", absent "none";
    /// Step of its readings; 0 is none.
    resolution_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
}

fn drift(keys: Option<Nested<DriftKeys>>) -> Option<GaussMarkov> {
    let process = keys.map(|Nested(keys)| GaussMarkov { sigma: keys.sigma_nt, tau_s: keys.tau_s });
    process.filter(|process| process.sigma > 0.0)
}

pub(super) fn scalar(s: &Section, currents: &[Current]) -> Option<Scalar> {
    let keys: ScalarKeys = s.group(None)?;
    let known = schemas::flight::describe(&keys.name);
    if known.unit != "nT" || !keys.name.starts_with("mag_") {
        s.fault_at("name", format!("a scalar magnetometer is called `mag_N_uc` or `mag_1_c`, not `{}`", keys.name));
    }
    let axis = Vector3::from(keys.axis);
    if axis.norm() < 1e-9 {
        s.fault_at("axis", "`axis` has no direction".to_owned());
    }
    let heading = Heading { amplitude_nt: keys.heading_nt, axis: axis.try_normalize(1e-9).unwrap_or(Vector3::z()) };
    Some(Scalar {
        source: source(s, keys.source, currents),
        sampling: keys.sampling.sampling(),
        name: keys.name,
        arm_m: Some(Vector3::from(keys.arm_m)).filter(|arm| arm.norm() > 0.0),
        noise_nt: keys.noise_nt,
        drift: drift(keys.drift),
        heading,
        dead_polar_deg: keys.dead_polar_deg,
        dead_equatorial_deg: keys.dead_equatorial_deg,
        dropouts: keys.dropouts.map(|Nested(d)| (d.mean_s, d.for_s)),
        lost_is_zero: keys.lost == Lost::Zero,
        spikes: keys.spikes.map(|Nested(d)| (d.mean_s, d.sigma_nt)),
        resolution_nt: keys.resolution_nt,
    })
}

pub(super) fn vector(s: &Section, currents: &[Current]) -> Option<Vector> {
    let keys: VectorKeys = s.group(None)?;
    if keys.name.strip_prefix("flux_").is_none_or(str::is_empty) {
        s.fault_at("name", format!("a vector magnetometer is called `flux_X`, not `{}`", keys.name));
    }
    Some(Vector {
        source: source(s, keys.source, currents),
        sampling: keys.sampling.sampling(),
        name: keys.name,
        noise_nt: keys.noise_nt,
        offset_nt: keys.offset_nt,
        scale: keys.scale,
        non_orthogonal_deg: keys.non_orthogonal_deg,
        misaligned_deg: keys.misaligned_deg,
        temperature_nt_per_degc: keys.temperature_nt_per_degc,
        temperature_scale_ppm_per_degc: keys.temperature_scale_ppm_per_degc,
        thermal_tau_s: keys.thermal_tau_s,
        linearity_ppm: keys.linearity_ppm,
        full_scale_nt: keys.full_scale_nt,
        core_hysteresis_nt: keys.core_hysteresis_nt,
        crosstalk: couplings(s, "crosstalk", keys.crosstalk.unwrap_or_default(), currents),
        bandwidth_hz: keys.bandwidth_hz,
        axis_lag_s: Vector3::from(keys.axis_lag_s),
        drift: drift(keys.drift),
        resolution_nt: keys.resolution_nt,
    })
}

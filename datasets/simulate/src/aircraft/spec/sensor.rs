//! Keys of the magnetometers in a synth spec.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use numerics::signal::gauss_markov::GaussMarkov;
use schemas::{NestedParams, Rule, choice, params};

use crate::reading::SynthSection;

use super::{
    AircraftFieldSpec, Current, QuantitySpec,
    source::{AircraftFieldKeys, CurrentFieldSpec, couplings, source},
};

/// A scalar magnetometer. It reads the exact magnitude of the field plus its errors.
#[derive(Clone, Debug)]
pub struct ScalarMagnetometer {
    /// The column, `mag_N_uc` or `mag_1_c`.
    pub name: String,
    /// The aircraft's field at the sensor.
    pub source: AircraftFieldSpec,
    /// Position relative to the INS along nose, right and down, in metres, for the earth's field; `None` means at the
    /// INS.
    pub arm_m: Option<Vector3<f64>>,
    /// White noise, in nT.
    pub noise_nt: f64,
    /// Slow drift of the reading.
    pub drift: Option<GaussMarkov>,
    /// Dependence of the reading on the direction of the field.
    pub heading: HeadingErrorModel,
    /// Dead zone about the optical axis, in degrees.
    pub dead_polar_deg: f64,
    /// Dead zone about the plane normal to the optical axis, in degrees.
    pub dead_equatorial_deg: f64,
    /// Dropouts: mean interval from the end of one dropout to the start of the next, and mean duration, in seconds.
    /// Both quantities are exponentially distributed.
    pub dropouts: Option<(f64, f64)>,
    /// Whether missing readings are recorded as 0, as by some recorders, instead of NaN.
    pub lost_is_zero: bool,
    /// Spikes of a single sample: mean interval in seconds and standard deviation in nT.
    pub spikes: Option<(f64, f64)>,
    /// Quantisation step of the readings, in nT; 0 disables rounding.
    pub resolution_nt: f64,
    /// Sampling of the sensor.
    pub sampling: SensorSampling,
}

/// Heading error: `amplitude_nt` times the cosine of the angle between the field and the optical axis, as for the
/// light shift. The maximum over all headings is the amplitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingErrorModel {
    /// Maximum error, in nT: 0.15 for a split-beam caesium magnetometer, 30 for a small single-beam one.
    pub amplitude_nt: f64,
    /// Direction of the light in the body frame, a unit vector.
    pub axis: Vector3<f64>,
}

/// Sampling of a sensor: its rate, if below the table's, and its lag.
///
/// Between two readings, the table holds the last one (`hold`), as a recorder does, or interpolates linearly, as later
/// processing does. A sensor at the table's rate or above is read at the table's times.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SensorSampling {
    /// Readings per second.
    pub rate_hz: Option<f64>,
    /// Lag of the reading, in seconds.
    pub lag_s: f64,
    /// Whether the last reading is held.
    pub hold: bool,
}

/// A vector magnetometer, such as a fluxgate.
#[derive(Clone, Debug)]
pub struct VectorMagnetometer {
    /// Name of the columns without `_x`, `_y`, `_z`.
    pub name: String,
    /// The aircraft's field at the sensor.
    pub source: AircraftFieldSpec,
    /// White noise of each axis, in nT.
    pub noise_nt: f64,
    /// Standard deviation of the bias of each axis, in nT.
    pub offset_nt: f64,
    /// Standard deviation of the relative scale error of each axis.
    pub scale: f64,
    /// Standard deviation of the three non-orthogonality angles, in degrees.
    pub non_orthogonal_deg: f64,
    /// Standard deviation of the three misalignment angles relative to the body, in degrees.
    pub misaligned_deg: f64,
    /// Standard deviation of the temperature drift of each axis, in nT per degC from the reference temperature.
    pub temperature_nt_per_degc: f64,
    /// Standard deviation of the temperature coefficient of the scale of each axis, in ppm per degC.
    pub temperature_scale_ppm_per_degc: f64,
    /// Time constant with which the sensor follows the temperature on board, in seconds; 0 disables the lag.
    pub thermal_tau_s: f64,
    /// Standard deviation of the nonlinearity of each axis, in ppm of the full scale.
    pub linearity_ppm: f64,
    /// Full scale, in nT.
    pub full_scale_nt: f64,
    /// Remanence of each axis after a loop of its field between ±50,000 nT, in nT.
    pub core_hysteresis_nt: f64,
    /// Coupling of currents into the readings through cables and supply, in nT/A.
    pub crosstalk: Vec<(usize, QuantitySpec<Vector3<f64>>)>,
    /// Corner frequency of the first-order response, in Hz.
    pub bandwidth_hz: Option<f64>,
    /// Additional lag of each axis, in seconds.
    pub axis_lag_s: Vector3<f64>,
    /// The slow drift of each axis.
    pub drift: Option<GaussMarkov>,
    /// Quantisation step of the readings, in nT; 0 disables rounding.
    pub resolution_nt: f64,
    /// Sampling of the sensor.
    pub sampling: SensorSampling,
}

params! {
    /// A drift as a first-order Gauss-Markov process.
    pub struct DriftKeys;
    /// Standard deviation of the drift.
    sigma_nt: f64, unit "nT", rule Rule::NotNegative;
    /// Time constant of the drift.
    tau_s: f64, unit "s", default 600.0, rule Rule::Positive;
}

params! {
    /// Dropouts of a sensor; both times are means of exponential distributions.
    pub struct DropoutKeys;
    /// Mean interval from the end of one dropout to the start of the next.
    mean_s: f64, unit "s", rule Rule::Positive;
    /// Mean duration of a dropout.
    for_s: f64, unit "s", default 1.0, rule Rule::Positive;
}

params! {
    /// Spikes of a single sample.
    pub struct SpikeKeys;
    /// Mean interval between spikes.
    mean_s: f64, unit "s", rule Rule::Positive;
    /// Standard deviation of the spikes.
    sigma_nt: f64, unit "nT", rule Rule::NotNegative;
}

choice! {
    /// Value of a missing reading.
    pub enum DropoutValue {
        /// NaN.
        Nan = "nan",
        /// 0, as written by some recorders.
        Zero = "zero",
    }
}

params! {
    /// Sampling of a sensor: its rate, if below the table's, and its lag.
    pub struct SamplingKeys;
    /// Readings per second. A rate above the table's rate has no effect.
    rate_hz: Option<f64>, unit "Hz", absent "`rate_hz` of the spec", rule Rule::Positive;
    /// Lag of the readings, positive if they are late.
    lag_s: f64, unit "s", default 0.0, rule Rule::Between(0.0, 60.0);
    /// Holds the last reading until the next one. If false, values are interpolated linearly between readings.
    hold: bool, unit "", default false;
}

impl SamplingKeys {
    fn sampling(&self) -> SensorSampling {
        SensorSampling { rate_hz: self.rate_hz, lag_s: self.lag_s, hold: self.hold }
    }
}

params! {
    /// A table of `magnetometers`: a scalar magnetometer. It reads the exact magnitude of the field plus its errors.
    pub struct ScalarKeys, groups [source: AircraftFieldKeys, sampling: SamplingKeys];
    /// Name of the column, `mag_N_uc` or `mag_1_c`.
    name: String, unit "";
    /// Position relative to the INS in the body frame (nose, right, down). The earth's field is evaluated at this
    /// position with the true attitude, so that two magnetometers measure the gradient between their positions.
    arm_m: [f64; 3], unit "m", default [0.0; 3], rule Rule::Between(-200.0, 200.0);
    /// Standard deviation of the white noise.
    noise_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Slow drift of the reading.
    drift: Option<NestedParams<DriftKeys>>, unit "", absent "none";
    /// Maximum heading error over all headings: 0.15 nT for a split-beam caesium magnetometer, 30 nT for a small
    /// single-beam one.
    heading_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Optical axis, the direction of the light, in the body frame. A nonzero vector of any length.
    axis: [f64; 3], unit "1", default [0.0, 1.0, 1.0], rule Rule::Finite;
    /// Dead zone about the optical axis: the sensor gives readings only if the angle between field and axis is at least
    /// this large.
    dead_polar_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 90.0);
    /// Dead zone about the plane normal to the optical axis: the sensor gives readings only if the angle between field
    /// and plane is at least this large.
    dead_equatorial_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 90.0);
    /// Dropouts of the sensor.
    dropouts: Option<NestedParams<DropoutKeys>>, unit "", absent "none";
    /// Value of a missing reading.
    lost: DropoutValue, unit "", default DropoutValue::Nan;
    /// Spikes of a single sample.
    spikes: Option<NestedParams<SpikeKeys>>, unit "", absent "none";
    /// Quantisation step of the readings; 0 disables rounding.
    resolution_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
}

params! {
    /// A table of `vector_magnetometers`: a vector magnetometer, such as a fluxgate.
    pub struct VectorKeys, groups [source: AircraftFieldKeys, sampling: SamplingKeys];
    /// Name of the columns without `_x`, `_y`, `_z`: `flux_X`.
    name: String, unit "";
    /// Standard deviation of the white noise of each axis.
    noise_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of the bias of each axis.
    offset_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of the relative scale error of each axis.
    scale: f64, unit "1", default 0.0, rule Rule::Between(0.0, 0.5);
    /// Standard deviation of the three non-orthogonality angles between the axes.
    non_orthogonal_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 10.0);
    /// Standard deviation of the three misalignment angles relative to the body.
    misaligned_deg: f64, unit "deg", default 0.0, rule Rule::Between(0.0, 30.0);
    /// Standard deviation of the temperature drift of each axis, per degC from `reference_degc` of `temperature`.
    temperature_nt_per_degc: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of the temperature coefficient of the scale of each axis, per degC from `reference_degc` of
    /// `temperature`. Good fluxgates have 20 to 70 ppm.
    temperature_scale_ppm_per_degc: f64, unit "ppm", default 0.0, rule Rule::Between(0.0, 1e5);
    /// Time constant with which the sensor follows the temperature on board; 0 disables the lag.
    thermal_tau_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of the nonlinearity of each axis: the largest deviation from the best straight line, in ppm
    /// of `full_scale_nt`. The deviation is cubic. Good fluxgates have 15 to 150 ppm.
    linearity_ppm: f64, unit "ppm", default 0.0, rule Rule::Between(0.0, 1e5);
    /// Full scale of the sensor.
    full_scale_nt: f64, unit "nT", default 100_000.0, rule Rule::Positive;
    /// Remanence of each axis: the reading at zero field after the field along the axis has been cycled between ±50,000
    /// nT. It is half the width of the hysteresis loop (Rayleigh's law).
    core_hysteresis_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Error of this sensor's readings per ampere of each current, coupled through cables and the power supply. Keys
    /// are names of currents. A value is a vector, or a magnitude whose direction is drawn.
    crosstalk: Option<BTreeMap<String, CurrentFieldSpec>>, unit "nT", absent "none", rule Rule::Finite;
    /// Corner frequency (-3 dB) of the first-order response.
    bandwidth_hz: Option<f64>, unit "Hz", absent "no response delay", rule Rule::Positive;
    /// Lag of each axis in addition to `lag_s`. A converter that reads the axes in turn has such lags.
    axis_lag_s: [f64; 3], unit "s", default [0.0; 3], rule Rule::Between(0.0, 60.0);
    /// Slow drift of each axis.
    drift: Option<NestedParams<DriftKeys>>, unit "", absent "none";
    /// Quantisation step of the readings; 0 disables rounding.
    resolution_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
}

fn drift(keys: Option<NestedParams<DriftKeys>>) -> Option<GaussMarkov> {
    let process = keys.map(|NestedParams(keys)| GaussMarkov { sigma: keys.sigma_nt, tau_s: keys.tau_s });
    process.filter(|process| process.sigma > 0.0)
}

pub(super) fn scalar(s: &SynthSection, currents: &[Current]) -> Option<ScalarMagnetometer> {
    let keys: ScalarKeys = s.group(None)?;
    let known = schemas::flight::describe(&keys.name);
    if known.unit != "nT" || !keys.name.starts_with("mag_") {
        s.fault_at(
            "name",
            format!("the name of a scalar magnetometer must be `mag_N_uc` or `mag_1_c`, not `{}`", keys.name),
        );
    }
    let axis = Vector3::from(keys.axis);
    if axis.norm() < 1e-9 {
        s.fault_at("axis", "`axis` must not be the zero vector".to_owned());
    }
    let heading =
        HeadingErrorModel { amplitude_nt: keys.heading_nt, axis: axis.try_normalize(1e-9).unwrap_or(Vector3::z()) };
    Some(ScalarMagnetometer {
        source: source(s, keys.source, currents),
        sampling: keys.sampling.sampling(),
        name: keys.name,
        arm_m: Some(Vector3::from(keys.arm_m)).filter(|arm| arm.norm() > 0.0),
        noise_nt: keys.noise_nt,
        drift: drift(keys.drift),
        heading,
        dead_polar_deg: keys.dead_polar_deg,
        dead_equatorial_deg: keys.dead_equatorial_deg,
        dropouts: keys.dropouts.map(|NestedParams(d)| (d.mean_s, d.for_s)),
        lost_is_zero: keys.lost == DropoutValue::Zero,
        spikes: keys.spikes.map(|NestedParams(d)| (d.mean_s, d.sigma_nt)),
        resolution_nt: keys.resolution_nt,
    })
}

pub(super) fn vector(s: &SynthSection, currents: &[Current]) -> Option<VectorMagnetometer> {
    let keys: VectorKeys = s.group(None)?;
    if keys.name.strip_prefix("flux_").is_none_or(str::is_empty) {
        s.fault_at("name", format!("the name of a vector magnetometer must be `flux_X`, not `{}`", keys.name));
    }
    Some(VectorMagnetometer {
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

//! The keys of the spec for the electronics on board: currents, the wires they flow in, voltages, control signals and
//! the temperature.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use schemas::{Rule, params};

pub(super) use self::{currents::current, signals::input};
pub(crate) use self::{currents::kinds, signals::signals};
pub use self::{
    currents::{Current, CurrentControl, CurrentKeys, EngineThrottle, Thermostat},
    signals::{ControlQuantity, ControlSignal, InputKeys, NamedControlQuantity},
};
use super::source::index_of;
use crate::reading::SynthSection;

mod currents;
mod signals;

/// Errors of a channel that records a current, a voltage or a control signal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChannelErrors {
    /// Delay of the recorded value, in seconds.
    pub delay_s: f64,
    /// Time constant of its first-order response, in seconds.
    pub response_s: f64,
    /// Largest magnitude that it can record, in the column's unit.
    pub limit: Option<f64>,
    /// Constant value of a broken channel, in the column's unit.
    pub stuck_at: Option<f64>,
}

/// A wire that carries a current. Its field at a magnetometer follows the Biot-Savart law.
#[derive(Clone, Debug)]
pub struct Wire {
    /// Index of the current.
    pub current: usize,
    /// Corners of the wire in the direction of the current, in metres: nose, right, down.
    pub path_m: Vec<Vector3<f64>>,
    /// Whether the wire returns from the last corner to the first.
    pub closed: bool,
    /// Number of turns along the path.
    pub turns: f64,
    /// Current at which half of the current takes this path, in A. At 0 the path carries the whole current.
    pub onset_a: f64,
    /// A small coil instead of a path: its position in metres and its moment in m² (A m² per ampere).
    pub dipole: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// A recorded voltage: the supply voltage minus the drop caused by the currents.
#[derive(Clone, Debug)]
pub struct Voltage {
    /// Name of the column, `vol_*`.
    pub name: String,
    /// Voltage without load at the flight's start.
    pub volts: f64,
    /// Series resistance for each current, in ohms. Table `ohm`.
    pub ohm: Vec<(usize, f64)>,
    /// Voltage that the battery loses per hour, in V.
    pub discharge_v_per_h: f64,
    /// White noise of the sensor, in V.
    pub noise_v: f64,
    /// Quantisation step of the recorded values, in V; 0 disables rounding.
    pub resolution_v: f64,
    /// Errors of the column.
    pub channel: ChannelErrors,
}

/// The temperature on board. It settles from the initial to the final temperature, with a slow oscillation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    /// Temperature at the flight's start.
    pub start_degc: f64,
    /// Final temperature.
    pub settled_degc: f64,
    /// Time constant of the change from the initial to the final temperature, in seconds.
    pub tau_s: f64,
    /// Amplitude of the oscillation.
    pub swing_degc: f64,
    /// Period of the oscillation, in seconds.
    pub swing_s: f64,
    /// Temperature at which the sensors are calibrated.
    pub reference_degc: f64,
}

params! {
    /// Errors of a channel that records a current, a voltage or a control signal.
    pub struct ChannelKeys;
    /// Delay of the recorded value.
    delay_s: f64, unit "s", default 0.0, rule Rule::Between(0.0, 60.0);
    /// Time constant of the column's first-order response, for example due to a filter or to an induction sensor around
    /// the wire.
    response_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Largest magnitude that the column can hold, in the column's unit. Larger values are clipped to it.
    limit: Option<f64>, unit "", absent "none", rule Rule::Positive;
    /// Constant value of the column, in its unit, to which noise is added. It simulates a sensor that is broken or
    /// attached to the wrong wire.
    stuck_at: Option<f64>, unit "", absent "no fault", rule Rule::Finite;
}

impl ChannelKeys {
    fn channel(&self) -> ChannelErrors {
        let ChannelKeys { delay_s, response_s, limit, stuck_at } = *self;
        ChannelErrors { delay_s, response_s, limit, stuck_at }
    }
}

/// The index of the current `name` in the key `key`; an unknown name is a fault.
fn current_of(s: &SynthSection, key: &'static str, name: &str, currents: &[Current]) -> Option<usize> {
    index_of(currents, name).map_err(|fault| s.push_at(key, fault)).ok()
}

params! {
    /// A table of `wires`: a wire that carries a current. Its field at a magnetometer follows the Biot-Savart law.
    pub struct WireKeys;
    /// Name of the current.
    current: String, unit "";
    /// Corners of the wire in the direction of the current, in the body frame (nose, right, down).
    path: Option<Vec<[f64; 3]>>, unit "m", absent "a small coil with `place_m` and `moment_m2`", rule Rule::Finite;
    /// Connects the last corner to the first.
    closed: bool, unit "", default false;
    /// Number of turns along the path.
    turns: f64, unit "1", default 1.0, rule Rule::Finite;
    /// Current at which the path carries half of the total current. It simulates bonded joints of the airframe in
    /// parallel with a wire. Of a current I, the path carries I abs(I) / (abs(I) + `onset_a`). With 0 it carries the
    /// whole current.
    onset_a: f64, unit "A", default 0.0, rule Rule::NotNegative;
    /// Position of a small coil in the body frame (nose, right, down). It replaces `path`.
    place_m: Option<[f64; 3]>, unit "m", absent "no coil", rule Rule::Finite;
    /// Magnetic moment of the coil per ampere (A m²/A), in the body frame.
    moment_m2: Option<[f64; 3]>, unit "m2", absent "no coil", rule Rule::Finite;
}

pub(super) fn wire(s: &SynthSection, currents: &[Current]) -> Option<Wire> {
    let keys: WireKeys = s.group(None)?;
    let path_m: Vec<Vector3<f64>> = keys.path.unwrap_or_default().into_iter().map(Vector3::from).collect();
    let dipole = keys.place_m.zip(keys.moment_m2).map(|(p, m)| (Vector3::from(p), Vector3::from(m)));
    if (path_m.len() < 2) == dipole.is_none() {
        s.fault("a wire needs either a `path` of at least two corners, or `place_m` and `moment_m2`".to_owned());
    }
    let current = current_of(s, "current", &keys.current, currents)?;
    Some(Wire { current, path_m, closed: keys.closed, turns: keys.turns, onset_a: keys.onset_a, dipole })
}

params! {
    /// A table of `voltages`: a recorded voltage, which is the supply voltage minus the drop caused by the currents.
    pub struct VoltageKeys, groups [channel: ChannelKeys];
    /// Name of the column, `vol_*`.
    name: String, unit "";
    /// Voltage without load at the flight's start.
    volts: f64, unit "V", rule Rule::Finite;
    /// Series resistance in ohms for each current, by the name of the current.
    ohm: Option<BTreeMap<String, f64>>, unit "", absent "no voltage drop", rule Rule::Finite;
    /// Voltage that the battery loses per hour.
    discharge_v_per_h: f64, unit "V", default 0.0, rule Rule::Finite;
    /// Standard deviation of the sensor's white noise.
    noise_v: f64, unit "V", default 0.0, rule Rule::NotNegative;
    /// Quantisation step of the recorded values; 0 disables rounding.
    resolution_v: f64, unit "V", default 0.0, rule Rule::NotNegative;
}

pub(super) fn voltage(s: &SynthSection, currents: &[Current]) -> Option<Voltage> {
    let keys: VoltageKeys = s.group(None)?;
    if !keys.name.starts_with("vol_") {
        s.fault_at("name", format!("the name of a voltage must begin with `vol_`, not `{}`", keys.name));
    }
    let mut ohm = vec![];
    for (current, value) in keys.ohm.unwrap_or_default() {
        match index_of(currents, &current) {
            Ok(index) => ohm.push((index, value)),
            Err(fault) => s.push(fault.at(s.key_at("ohm", &current))),
        }
    }
    let VoltageKeys { name, volts, discharge_v_per_h, noise_v, resolution_v, channel, .. } = keys;
    Some(Voltage { name, volts, ohm, discharge_v_per_h, noise_v, resolution_v, channel: channel.channel() })
}

params! {
    /// The table `temperature`: the temperature on board. It settles from the initial to the final temperature, with a
    /// slow oscillation.
    pub struct TemperatureKeys, all default;
    /// Temperature at the flight's start.
    start_degc: f64, unit "degC", default 20.0, rule Rule::Between(-90.0, 90.0);
    /// Final temperature.
    settled_degc: Option<f64>, unit "degC", default None, absent "`start_degc`", rule Rule::Between(-90.0, 90.0);
    /// Time constant of the change from the initial to the final temperature.
    tau_s: f64, unit "s", default 1200.0, rule Rule::Positive;
    /// Amplitude of the oscillation.
    swing_degc: f64, unit "degC", default 0.0, rule Rule::NotNegative;
    /// Period of the oscillation.
    swing_s: f64, unit "s", default 900.0, rule Rule::Positive;
    /// Temperature at which the sensors are calibrated.
    reference_degc: f64, unit "degC", default 20.0, rule Rule::Between(-90.0, 90.0);
}

pub(super) fn temperature(root: &SynthSection) -> Temperature {
    let keys: TemperatureKeys = root.section("temperature").and_then(|s| s.group(None)).unwrap_or_default();
    Temperature {
        start_degc: keys.start_degc,
        settled_degc: keys.settled_degc.unwrap_or(keys.start_degc),
        tau_s: keys.tau_s,
        swing_degc: keys.swing_degc,
        swing_s: keys.swing_s,
        reference_degc: keys.reference_degc,
    }
}

//! The keys of the spec for the electronics on board: currents, the wires they flow in, voltages, control signals and the
//! temperature.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use schemas::{Rule, params};

pub(super) use self::{currents::current, signals::input};
pub(crate) use self::{currents::kinds, signals::signals};
pub use self::{
    currents::{Current, CurrentKeys, Engine, Kind, Thermostat},
    signals::{Input, InputKeys, Signal, Told},
};
use super::source::index_of;
use crate::reading::Section;

mod currents;
mod signals;

/// What is wrong with a channel that records a current, a voltage or a control signal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Channel {
    /// How old what it records is, in seconds.
    pub delay_s: f64,
    /// The time constant of its own first-order response, in seconds.
    pub response_s: f64,
    /// The largest magnitude that it can record, in the column's unit.
    pub limit: Option<f64>,
    /// What it records whatever happens, in the column's unit.
    pub stuck_at: Option<f64>,
}

/// A wire that a current flows in: what it gives at a magnetometer is the law of Biot and Savart.
#[derive(Clone, Debug)]
pub struct Wire {
    /// Which of the currents.
    pub current: usize,
    /// Corners of the wire in the order of the current, in metres: nose, right, down.
    pub path_m: Vec<Vector3<f64>>,
    /// Whether it goes back from the last to the first.
    pub closed: bool,
    /// How many times it goes that way.
    pub turns: f64,
    /// The current of which half goes this way, in A: more of a larger one. 0 where all of it does.
    pub onset_a: f64,
    /// Instead of a path a small coil: its place in metres and its moment in m² (A m² per ampere).
    pub dipole: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// A voltage that is recorded: the supply's less what the currents take off.
#[derive(Clone, Debug)]
pub struct Voltage {
    /// The column, `vol_*`.
    pub name: String,
    /// Volts without load at the flight's start.
    pub volts: f64,
    /// Resistance that each current sees, in ohms. Table `ohm`.
    pub ohm: Vec<(usize, f64)>,
    /// How much the battery loses in an hour, in volts.
    pub discharge_v_per_h: f64,
    /// White noise of the sensor, in V.
    pub noise_v: f64,
    /// Step of the recorded values, in V; 0 is none.
    pub resolution_v: f64,
    /// What is wrong with the column.
    pub channel: Channel,
}

/// The temperature on board: from the ground's to the one it settles at, and a slow swing about that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    /// At the flight's start.
    pub start_degc: f64,
    /// Later on.
    pub settled_degc: f64,
    /// How fast it settles, in seconds.
    pub tau_s: f64,
    /// Amplitude of the swing.
    pub swing_degc: f64,
    /// Period of the swing, in seconds.
    pub swing_s: f64,
    /// Where sensors are calibrated.
    pub reference_degc: f64,
}

params! {
    /// What is wrong with the channel that records a current, a voltage or a control signal.
    pub struct ChannelKeys;
    /// How old what the column holds is.
    delay_s: f64, unit "s", default 0.0, rule Rule::Between(0.0, 60.0);
    /// Time constant of the column's first-order response, as that of a filter or of an induction sensor round the wire.
    response_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// The largest magnitude that the column can hold, in its unit: beyond it stays there.
    limit: Option<f64>, unit "", absent "none", rule Rule::Positive;
    /// What the column holds whatever happens, in its unit, with its noise: a sensor that is broken or clipped to the wrong
    /// wire.
    stuck_at: Option<f64>, unit "", absent "it works", rule Rule::Finite;
}

impl ChannelKeys {
    fn channel(&self) -> Channel {
        let ChannelKeys { delay_s, response_s, limit, stuck_at } = *self;
        Channel { delay_s, response_s, limit, stuck_at }
    }
}

/// The current called `name`, which `key` names; a name that is wrong is a fault.
fn current_of(s: &Section, key: &'static str, name: &str, currents: &[Current]) -> Option<usize> {
    index_of(currents, name).map_err(|fault| s.push_at(key, fault)).ok()
}

params! {
    /// A table of `wires`: a wire that a current flows in. What it gives at a magnetometer is the law of Biot and Savart.
    pub struct WireKeys;
    /// Which of the currents.
    current: String, unit "";
    /// Corners of the wire in the order of the current: nose, right, down.
    path: Option<Vec<[f64; 3]>>, unit "m", absent "a small coil, `place_m` and `moment_m2`", rule Rule::Finite;
    /// Whether it goes back from the last to the first.
    closed: bool, unit "", default false;
    /// How many times it goes that way.
    turns: f64, unit "1", default 1.0, rule Rule::Finite;
    /// The current of which half goes this way, such as the joints of the airframe beside a wire: of a smaller one less, of
    /// a larger one more, I abs(I) / (abs(I) + `onset_a`). 0 is a wire that all of it goes through.
    onset_a: f64, unit "A", default 0.0, rule Rule::NotNegative;
    /// The position of a small coil, in place of a path.
    place_m: Option<[f64; 3]>, unit "m", absent "a `path`", rule Rule::Finite;
    /// The moment of the coil, in A m² per ampere.
    moment_m2: Option<[f64; 3]>, unit "m2", absent "a `path`", rule Rule::Finite;
}

pub(super) fn wire(s: &Section, currents: &[Current]) -> Option<Wire> {
    let keys: WireKeys = s.group(None)?;
    let path_m: Vec<Vector3<f64>> = keys.path.unwrap_or_default().into_iter().map(Vector3::from).collect();
    let dipole = keys.place_m.zip(keys.moment_m2).map(|(p, m)| (Vector3::from(p), Vector3::from(m)));
    if (path_m.len() < 2) == dipole.is_none() {
        s.fault("a wire needs either a `path` of two corners or more, or `place_m` and `moment_m2`".to_owned());
    }
    let current = current_of(s, "current", &keys.current, currents)?;
    Some(Wire { current, path_m, closed: keys.closed, turns: keys.turns, onset_a: keys.onset_a, dipole })
}

params! {
    /// A table of `voltages`: a voltage that is recorded, the supply's less what the currents take off.
    pub struct VoltageKeys, groups [channel: ChannelKeys];
    /// The column, `vol_*`.
    name: String, unit "";
    /// Volts without load at the flight's start.
    volts: f64, unit "V", rule Rule::Finite;
    /// Resistance in ohms that each current sees, by the names of currents.
    ohm: Option<BTreeMap<String, f64>>, unit "", absent "no current takes anything off", rule Rule::Finite;
    /// How much the battery loses in an hour.
    discharge_v_per_h: f64, unit "V", default 0.0, rule Rule::Finite;
    /// White noise of the sensor.
    noise_v: f64, unit "V", default 0.0, rule Rule::NotNegative;
    /// Step of the recorded values; 0 is none.
    resolution_v: f64, unit "V", default 0.0, rule Rule::NotNegative;
}

pub(super) fn voltage(s: &Section, currents: &[Current]) -> Option<Voltage> {
    let keys: VoltageKeys = s.group(None)?;
    if !keys.name.starts_with("vol_") {
        s.fault_at("name", format!("a voltage is called `vol_...`, not `{}`", keys.name));
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
    /// The table `temperature`: the temperature on board, from the ground's to the one it settles at, and a slow swing
    /// about that.
    pub struct TemperatureKeys, all default;
    /// At the flight's start.
    start_degc: f64, unit "degC", default 20.0, rule Rule::Between(-90.0, 90.0);
    /// Later on.
    settled_degc: Option<f64>, unit "degC", default None, absent "that of the start", rule Rule::Between(-90.0, 90.0);
    /// How fast it settles.
    tau_s: f64, unit "s", default 1200.0, rule Rule::Positive;
    /// Amplitude of the swing.
    swing_degc: f64, unit "degC", default 0.0, rule Rule::NotNegative;
    /// Period of the swing.
    swing_s: f64, unit "s", default 900.0, rule Rule::Positive;
    /// Where sensors are calibrated.
    reference_degc: f64, unit "degC", default 20.0, rule Rule::Between(-90.0, 90.0);
}

pub(super) fn temperature(root: &Section) -> Temperature {
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

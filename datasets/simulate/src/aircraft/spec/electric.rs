//! What the spec says of the electronics on board: currents, the wires they flow in, voltages, control signals and
//! the temperature.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use schemas::{Chosen, Lists, Rule, params};

use super::source::index_of;
use crate::reading::{
    Section,
    variant::{Variant, Varied, variant},
};

/// A current on board, and its sensor.
#[derive(Clone, Debug)]
pub struct Current {
    /// The column, `cur_*`.
    pub name: String,
    /// What decides when it is on.
    pub kind: Kind,
    /// Amperes while off, and while fully on.
    pub off_on_a: (f64, f64),
    /// How long it takes to come and to go, linearly, in seconds: for `switched`, `schedule`, `periodic`.
    pub ramp_s: f64,
    /// White noise of the sensor, in A.
    pub noise_a: f64,
    /// What the sensor reads for an ampere.
    pub scale: f64,
    /// Step of the recorded values, in A; 0 is none.
    pub resolution_a: f64,
    /// What is wrong with the column.
    pub channel: Channel,
    /// Whether there is a sensor: without it the current flows and no column tells.
    pub measured: bool,
    /// What part of each change of its field eddy currents hold up.
    pub eddy_share: f64,
    /// For how long, in seconds.
    pub eddy_tau_s: f64,
    /// What remains of the field of the full current in iron near the wires when it is switched off.
    pub remanence: f64,
}

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

/// When a current flows: a level from 0 (off) to 1 (fully on).
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// On and off at random, both durations exponential.
    Switched {
        /// Mean durations of off and on, in seconds.
        mean_off_on_s: (f64, f64),
    },
    /// On from `t_on` to `t_off`, in seconds after the flight's start.
    Schedule {
        /// The times, in order.
        on_off_s: Vec<[f64; 2]>,
    },
    /// On for `for_s` every `every_s`, first at `first_s` (0) after the flight's start, such as a strobe.
    Periodic {
        /// From one beginning to the next, in seconds.
        every_s: f64,
        /// How long it is on, in seconds.
        for_s: f64,
        /// The first beginning, in seconds after the flight's start.
        first_s: f64,
    },
    /// Always on.
    Steady,
    /// As the engine's throttle.
    Engine(Engine),
    /// As the rates of the attitude, in which servos move the control surfaces.
    Servo {
        /// The shares of the rates of roll, pitch and yaw.
        axes: Vector3<f64>,
        /// The rate at which the level is 1, in degrees per second.
        full_dps: f64,
        /// Whether the direction of the motion counts, as with a deflected surface's own iron; else the rates'
        /// magnitudes add up.
        signed: bool,
    },
    /// As a thermostat's heater.
    Heater(Thermostat),
}

/// The throttle: what holds the speed and the climb, between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Engine {
    /// Throttle in level flight at `cruise_mps`, with the cube of the speed. Key `cruise`, 0.5.
    pub cruise: f64,
    /// The speed that belongs to it, in m/s.
    pub cruise_mps: f64,
    /// More throttle for a climb of 1 m/s. Key `per_climb_mps`, 0.05.
    pub per_climb_mps: f64,
    /// More throttle for the drag of lift: times the square of the load factor less 1. Key `per_load`, 0.2.
    pub per_load: f64,
    /// Standard deviation of the throttle's small corrections.
    pub ripple: f64,
    /// How long a correction lasts, in seconds.
    pub ripple_s: f64,
}

/// A heater that keeps a temperature: on below `keep - band / 2`, off above `keep + band / 2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thermostat {
    /// The temperature to keep.
    pub keep_degc: f64,
    /// Width of the band.
    pub band_degc: f64,
    /// How much warmer than the surroundings the heater can make it.
    pub power_degc: f64,
    /// How fast it warms and cools, in seconds.
    pub tau_s: f64,
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

/// A control signal that is recorded: `offset + gain * signal`, with noise, rounded to `resolution`.
#[derive(Clone, Debug)]
pub struct Input {
    /// The column.
    pub name: String,
    /// What it tells.
    pub signal: Signal,
    /// Added to it.
    pub offset: f64,
    /// Times the signal.
    pub gain: f64,
    /// White noise.
    pub noise: f64,
    /// Step of the recorded values; 0 is none.
    pub resolution: f64,
    /// What is wrong with the column.
    pub channel: Channel,
}

/// What a control signal tells.
#[derive(Clone, Debug, PartialEq)]
pub enum Signal {
    /// The level of a current, 0 to 1, such as the throttle. Kind `current`, with the key `of`.
    Level(usize),
    /// Rate of roll (aileron), of pitch (elevator) or of yaw (rudder), in degrees per second.
    Rate(usize),
    /// Speed, in m/s.
    Speed,
    /// Temperature on board, in degrees Celsius.
    Temperature,
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

impl Varied for Kind {
    const DEFAULT: &'static str = "switched";
}

variant! {
    /// On and off at random, both durations exponential.
    SWITCHED: Kind = "switched", |keys| Kind::Switched { mean_off_on_s: (keys.mean_off_s, keys.mean_on_s) };
    struct SwitchedKeys;
    /// Mean duration of off.
    mean_off_s: f64, unit "s", default 20.0, rule Rule::Positive;
    /// Mean duration of on.
    mean_on_s: f64, unit "s", default 20.0, rule Rule::Positive;
}

variant! {
    /// On from `t_on` to `t_off`, in seconds after the flight's start.
    SCHEDULE: Kind = "schedule", |keys| Kind::Schedule { on_off_s: keys.schedule };
    struct ScheduleKeys;
    /// The times, in order: `[[t_on, t_off], ...]`.
    schedule: Vec<[f64; 2]>, unit "s", rule Rule::Finite;
}

variant! {
    /// On for `for_s` every `every_s`, such as a strobe.
    PERIODIC: Kind = "periodic",
    |keys| Kind::Periodic { every_s: keys.every_s, for_s: keys.for_s, first_s: keys.first_s };
    struct PeriodicKeys;
    /// From one beginning to the next.
    every_s: f64, unit "s", rule Rule::Positive;
    /// How long it is on.
    for_s: f64, unit "s", rule Rule::Positive;
    /// The first beginning, after the flight's start.
    first_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
}

variant! {
    /// Always on.
    STEADY: Kind = "steady", |_| Kind::Steady;
    struct SteadyKeys;
}

variant! {
    /// As the engine's throttle: what holds the speed and the climb, between 0 and 1.
    ENGINE: Kind = "engine", |keys| {
        let EngineKeys { cruise, cruise_mps, per_climb_mps, per_load, ripple, ripple_s } = keys;
        Kind::Engine(Engine { cruise, cruise_mps, per_climb_mps, per_load, ripple, ripple_s })
    };
    struct EngineKeys;
    /// Throttle in level flight at `cruise_mps`, with the cube of the speed.
    cruise: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
    /// The speed that belongs to it.
    cruise_mps: f64, unit "m/s", default 60.0, rule Rule::Positive;
    /// More throttle for a climb of 1 m/s.
    per_climb_mps: f64, unit "1", default 0.05, rule Rule::NotNegative;
    /// More throttle for the drag of lift: times the square of the load factor less 1.
    per_load: f64, unit "1", default 0.2, rule Rule::NotNegative;
    /// Standard deviation of the throttle's small corrections.
    ripple: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// How long a correction lasts.
    ripple_s: f64, unit "s", default 3.0, rule Rule::Positive;
}

variant! {
    /// As the rates of the attitude, in which servos move the control surfaces.
    SERVO: Kind = "servo", |keys| {
        Kind::Servo { axes: Vector3::from(keys.axes), full_dps: keys.full_dps, signed: keys.signed }
    };
    struct ServoKeys;
    /// How much each of roll, pitch and yaw counts.
    axes: [f64; 3], unit "1", default [1.0; 3], rule Rule::Finite;
    /// The rate at which the level is 1.
    full_dps: f64, unit "deg/s", default 20.0, rule Rule::Positive;
    /// Whether the direction of the motion counts, as with a deflected surface's own iron; else the magnitudes of the
    /// rates add up.
    signed: bool, unit "", default false;
}

variant! {
    /// As a thermostat's heater: on below `keep - band / 2`, off above `keep + band / 2`.
    HEATER: Kind = "heater", |keys| {
        let HeaterKeys { keep_degc, band_degc, power_degc, warm_tau_s } = keys;
        Kind::Heater(Thermostat { keep_degc, band_degc, power_degc, tau_s: warm_tau_s })
    };
    struct HeaterKeys;
    /// The temperature to keep.
    keep_degc: f64, unit "degC", default 60.0, rule Rule::Finite;
    /// Width of the band.
    band_degc: f64, unit "degC", default 2.0, rule Rule::Positive;
    /// How much warmer than the surroundings the heater can make it.
    power_degc: f64, unit "degC", default 80.0, rule Rule::Positive;
    /// How fast it warms and cools.
    warm_tau_s: f64, unit "s", default 300.0, rule Rule::Positive;
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

params! {
    /// A table of `currents`: a current on board, and its sensor.
    pub struct CurrentKeys, groups [channel: ChannelKeys];
    /// The column, `cur_*`.
    name: String, unit "";
    /// What decides when it is on.
    kind: Chosen<Variant<Kind>>, unit "";
    /// Amperes while off.
    off_a: f64, unit "A", default 0.0, rule Rule::Finite;
    /// Amperes while fully on.
    on_a: f64, unit "A", rule Rule::Finite;
    /// How long it takes to come and to go, linearly: for `switched`, `schedule`, `periodic`.
    ramp_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// White noise of the sensor.
    noise_a: f64, unit "A", default 0.0, rule Rule::NotNegative;
    /// What the sensor reads for an ampere.
    scale: f64, unit "1", default 1.0, rule Rule::Finite;
    /// Step of the recorded values; 0 is none.
    resolution_a: f64, unit "A", default 0.0, rule Rule::NotNegative;
    /// Whether there is a sensor: without it the current flows and no column holds it.
    measured: bool, unit "", default true;
    /// What part of each change of its field the eddy currents of conductors near the wires hold up. The column does not
    /// show it.
    eddy_share: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1.0);
    /// For how long: the time constant of their decay.
    eddy_tau_s: f64, unit "s", default 0.1, rule Rule::Positive;
    /// What remains in the iron near the wires when the full current is switched off, as a part of the current's own
    /// field: half the width of the loop, by Rayleigh's law.
    remanence: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1.0);
}

/// What a current can be.
pub(in super::super::super) fn kinds() -> Lists {
    Lists::default().with(vec![&SWITCHED, &SCHEDULE, &PERIODIC, &STEADY, &ENGINE, &SERVO, &HEATER])
}

pub(super) fn current(s: &Section) -> Option<Current> {
    let keys: CurrentKeys = s.group_of(None, &kinds())?;
    s.refuse_foreign(&keys.kind);
    if !keys.name.starts_with("cur_") {
        s.fault_at("name", format!("a current is called `cur_...`, not `{}`", keys.name));
    }
    match &*keys.kind.keys {
        Kind::Schedule { on_off_s } => {
            let times: Vec<f64> = on_off_s.iter().flatten().copied().collect();
            if times.windows(2).any(|w| w[0] > w[1]) {
                s.fault_at("schedule", "the times of `schedule` must not go back".to_owned());
            }
        }
        Kind::Periodic { every_s, for_s, .. } if for_s > every_s => {
            s.fault_at("for_s", format!("it cannot be on for {for_s} s every {every_s} s"));
        }
        Kind::Switched { .. }
        | Kind::Periodic { .. }
        | Kind::Steady
        | Kind::Engine(_)
        | Kind::Servo { .. }
        | Kind::Heater(_) => {}
    }
    Some(Current {
        kind: Kind::clone(&keys.kind.keys),
        name: keys.name,
        off_on_a: (keys.off_a, keys.on_a),
        ramp_s: keys.ramp_s,
        noise_a: keys.noise_a,
        scale: keys.scale,
        resolution_a: keys.resolution_a,
        channel: keys.channel.channel(),
        measured: keys.measured,
        eddy_share: keys.eddy_share,
        eddy_tau_s: keys.eddy_tau_s,
        remanence: keys.remanence,
    })
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

/// What a control signal tells, the current by its name.
#[derive(Clone, Debug, PartialEq)]
pub enum Told {
    /// The level of a current.
    Level(String),
    /// What needs no name.
    Other(Signal),
}

impl Varied for Told {
    const DEFAULT: &'static str = "current";
}

variant! {
    /// The level of a current, 0 to 1, such as the throttle.
    LEVEL: Told = "current", |keys| Told::Level(keys.of);
    struct LevelKeys;
    /// Which of the currents.
    of: String, unit "";
}

variant! {
    /// Rate of roll, in degrees per second.
    AILERON: Told = "aileron", |_| Told::Other(Signal::Rate(0));
    struct AileronKeys;
}

variant! {
    /// Rate of pitch, in degrees per second.
    ELEVATOR: Told = "elevator", |_| Told::Other(Signal::Rate(1));
    struct ElevatorKeys;
}

variant! {
    /// Rate of yaw, in degrees per second.
    RUDDER: Told = "rudder", |_| Told::Other(Signal::Rate(2));
    struct RudderKeys;
}

variant! {
    /// Speed, in m/s.
    SPEED: Told = "speed", |_| Told::Other(Signal::Speed);
    struct SpeedKeys;
}

variant! {
    /// Temperature on board, in degrees Celsius.
    TEMPERATURE: Told = "temperature", |_| Told::Other(Signal::Temperature);
    struct TemperatureSignalKeys;
}

/// What a control signal can be.
pub(in super::super::super) fn signals() -> Lists {
    Lists::default().with(vec![&LEVEL, &AILERON, &ELEVATOR, &RUDDER, &SPEED, &TEMPERATURE])
}

params! {
    /// A table of `inputs`: a control signal that is recorded, `offset + gain * signal`, with noise, rounded to
    /// `resolution`.
    pub struct InputKeys, groups [channel: ChannelKeys];
    /// The column.
    name: String, unit "";
    /// What it tells.
    kind: Chosen<Variant<Told>>, unit "";
    /// Added to it.
    offset: f64, unit "", default 0.0, rule Rule::Finite;
    /// Times the signal.
    gain: f64, unit "1", default 1.0, rule Rule::Finite;
    /// White noise.
    noise: f64, unit "", default 0.0, rule Rule::NotNegative;
    /// Step of the recorded values; 0 is none.
    resolution: f64, unit "", default 0.0, rule Rule::NotNegative;
}

pub(super) fn input(s: &Section, currents: &[Current]) -> Option<Input> {
    let keys: InputKeys = s.group_of(None, &signals())?;
    s.refuse_foreign(&keys.kind);
    let described = schemas::flight::describe(&keys.name);
    if !described.description.is_empty() || described.role != schemas::Role::Aux {
        s.fault_at("name", format!("`{}` is the name of another column", keys.name));
    }
    let signal = match &*keys.kind.keys {
        Told::Level(of) => Signal::Level(current_of(s, "of", of, currents)?),
        Told::Other(signal) => signal.clone(),
    };
    let InputKeys { name, offset, gain, noise, resolution, channel, .. } = keys;
    Some(Input { name, signal, offset, gain, noise, resolution, channel: channel.channel() })
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

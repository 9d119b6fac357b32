<<<<<<< HEAD
//! The keys of the spec for the electronics on board: currents, the wires they flow in, voltages, control signals and the
//! temperature.
=======
//! Keys of the electronics in a synth spec: currents, their wires, voltages, control signals and the temperature.
>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617

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

<<<<<<< HEAD
mod currents;
mod signals;
=======
/// A current on board, and its sensor.
#[derive(Clone, Debug)]
pub struct Current {
    /// Name of the column, `cur_*`.
    pub name: String,
    /// Control of the current.
    pub kind: Kind,
    /// Current when off and when fully on, in A.
    pub off_on_a: (f64, f64),
    /// Duration of the linear rise and fall, in seconds: for `switched`, `schedule` and `periodic`.
    pub ramp_s: f64,
    /// White noise of the sensor, in A.
    pub noise_a: f64,
    /// Reading of the sensor per ampere.
    pub scale: f64,
    /// Step of the recorded values, in A; 0 is none.
    pub resolution_a: f64,
    /// Errors of the column.
    pub channel: Channel,
    /// Whether a sensor records the current. Otherwise the current flows without a column.
    pub measured: bool,
    /// Fraction of each change of its field that eddy currents delay.
    pub eddy_share: f64,
    /// Time constant of the eddy currents, in seconds.
    pub eddy_tau_s: f64,
    /// Remanent field of iron near the wires after the full current, as a fraction of the current's field.
    pub remanence: f64,
}
>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617

/// Errors of a channel that records a current, a voltage or a control signal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Channel {
    /// Delay of the recorded value, in seconds.
    pub delay_s: f64,
    /// Time constant of its first-order response, in seconds.
    pub response_s: f64,
    /// Largest magnitude that it can record, in the column's unit.
    pub limit: Option<f64>,
    /// Constant value of a broken channel, in the column's unit.
    pub stuck_at: Option<f64>,
}

<<<<<<< HEAD
/// A wire that a current flows in: what it gives at a magnetometer is the law of Biot and Savart.
=======
/// Control of a current: a level from 0 (off) to 1 (fully on).
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// On and off at random, with exponentially distributed durations.
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
        /// Period from one start to the next, in seconds.
        every_s: f64,
        /// Duration of each period on, in seconds.
        for_s: f64,
        /// First start, in seconds after the flight's start.
        first_s: f64,
    },
    /// Always on.
    Steady,
    /// Follows the engine's throttle.
    Engine(Engine),
    /// Follows the attitude rates that servos control.
    Servo {
        /// Weights of the rates of roll, pitch and yaw.
        axes: Vector3<f64>,
        /// Rate at which the level is 1, in degrees per second.
        full_dps: f64,
        /// Adds the signed rates, as for the iron of a deflected surface, instead of their magnitudes.
        signed: bool,
    },
    /// Follows a thermostat's heater.
    Heater(Thermostat),
}

/// The throttle that holds speed and climb, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Engine {
    /// Throttle in level flight at `cruise_mps`, proportional to the cube of the speed. Key `cruise`, 0.5.
    pub cruise: f64,
    /// Speed at which `cruise` applies, in m/s.
    pub cruise_mps: f64,
    /// Additional throttle for a climb of 1 m/s. Key `per_climb_mps`, 0.05.
    pub per_climb_mps: f64,
    /// Additional throttle for lift-induced drag, times (load factor² - 1). Key `per_load`, 0.2.
    pub per_load: f64,
    /// Standard deviation of small corrections of the throttle.
    pub ripple: f64,
    /// Time constant of the corrections, in seconds.
    pub ripple_s: f64,
}

/// A heater that keeps a temperature: on below `keep - band / 2`, off above `keep + band / 2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thermostat {
    /// The temperature to keep.
    pub keep_degc: f64,
    /// Width of the band.
    pub band_degc: f64,
    /// Maximum temperature rise above the surroundings.
    pub power_degc: f64,
    /// Time constant of warming and cooling, in seconds.
    pub tau_s: f64,
}

/// A wire that carries a current. Its field at a magnetometer follows the Biot-Savart law.
>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617
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
    /// Current at which half of it takes this path, in A. At 0 the path carries the whole current.
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
    /// Step of the recorded values, in V; 0 is none.
    pub resolution_v: f64,
    /// Errors of the column.
    pub channel: Channel,
}

<<<<<<< HEAD
/// The temperature on board: from the ground's to the one it settles at, and a slow swing about that.
=======
/// A recorded control signal: `offset + gain * signal` plus noise, rounded to `resolution`.
#[derive(Clone, Debug)]
pub struct Input {
    /// The column.
    pub name: String,
    /// The recorded quantity.
    pub signal: Signal,
    /// Offset.
    pub offset: f64,
    /// Gain.
    pub gain: f64,
    /// White noise.
    pub noise: f64,
    /// Quantisation step of the recorded values; 0 disables rounding.
    pub resolution: f64,
    /// Errors of the column.
    pub channel: Channel,
}

/// Quantity that a control signal records.
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

/// The temperature on board. It settles from the initial to the final temperature, with a slow oscillation.
>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617
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

<<<<<<< HEAD
=======
impl Varied for Kind {
    const DEFAULT: &'static str = "switched";
}

variant! {
    /// On and off at random, with exponentially distributed durations.
    SWITCHED: Kind = "switched", |keys| Kind::Switched { mean_off_on_s: (keys.mean_off_s, keys.mean_on_s) };
    struct SwitchedKeys;
    /// Mean duration of the off state.
    mean_off_s: f64, unit "s", default 20.0, rule Rule::Positive;
    /// Mean duration of the on state.
    mean_on_s: f64, unit "s", default 20.0, rule Rule::Positive;
}

variant! {
    /// On from `t_on` to `t_off`, in seconds after the flight's start.
    SCHEDULE: Kind = "schedule", |keys| Kind::Schedule { on_off_s: keys.schedule };
    struct ScheduleKeys;
    /// Switching times in ascending order, `[[t_on, t_off], ...]`, in s after the flight's start.
    schedule: Vec<[f64; 2]>, unit "s", rule Rule::Finite;
}

variant! {
    /// On for `for_s` every `every_s`, like a strobe light.
    PERIODIC: Kind = "periodic",
    |keys| Kind::Periodic { every_s: keys.every_s, for_s: keys.for_s, first_s: keys.first_s };
    struct PeriodicKeys;
    /// Period from one start to the next.
    every_s: f64, unit "s", rule Rule::Positive;
    /// Duration of each period on. At most `every_s`.
    for_s: f64, unit "s", rule Rule::Positive;
    /// First start, in s after the flight's start.
    first_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
}

variant! {
    /// Always on.
    STEADY: Kind = "steady", |_| Kind::Steady;
    struct SteadyKeys;
}

variant! {
    /// Follows the engine's throttle, which holds speed and climb. The level is from 0 to 1.
    ENGINE: Kind = "engine", |keys| {
        let EngineKeys { cruise, cruise_mps, per_climb_mps, per_load, ripple, ripple_s } = keys;
        Kind::Engine(Engine { cruise, cruise_mps, per_climb_mps, per_load, ripple, ripple_s })
    };
    struct EngineKeys;
    /// Throttle in level flight at `cruise_mps`. It is proportional to the cube of the speed.
    cruise: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
    /// Speed at which `cruise` applies.
    cruise_mps: f64, unit "m/s", default 60.0, rule Rule::Positive;
    /// Additional throttle for a climb of 1 m/s.
    per_climb_mps: f64, unit "1", default 0.05, rule Rule::NotNegative;
    /// Additional throttle for lift-induced drag, multiplied by (load factor² - 1).
    per_load: f64, unit "1", default 0.2, rule Rule::NotNegative;
    /// Standard deviation of small corrections of the throttle.
    ripple: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// Time constant of the corrections.
    ripple_s: f64, unit "s", default 3.0, rule Rule::Positive;
}

variant! {
    /// Follows the attitude rates that servos control.
    SERVO: Kind = "servo", |keys| {
        Kind::Servo { axes: Vector3::from(keys.axes), full_dps: keys.full_dps, signed: keys.signed }
    };
    struct ServoKeys;
    /// Weights of the rates of roll, pitch and yaw.
    axes: [f64; 3], unit "1", default [1.0; 3], rule Rule::Finite;
    /// Rate at which the level is 1.
    full_dps: f64, unit "deg/s", default 20.0, rule Rule::Positive;
    /// Adds the signed rates, as for the iron of a deflected surface. If false, adds their magnitudes.
    signed: bool, unit "", default false;
}

variant! {
    /// Follows a thermostat's heater: on below `keep_degc - band_degc / 2`, off above `keep_degc + band_degc / 2`.
    HEATER: Kind = "heater", |keys| {
        let HeaterKeys { keep_degc, band_degc, power_degc, warm_tau_s } = keys;
        Kind::Heater(Thermostat { keep_degc, band_degc, power_degc, tau_s: warm_tau_s })
    };
    struct HeaterKeys;
    /// Set temperature.
    keep_degc: f64, unit "degC", default 60.0, rule Rule::Finite;
    /// Width of the hysteresis band about the set temperature.
    band_degc: f64, unit "degC", default 2.0, rule Rule::Positive;
    /// Maximum temperature rise above the surroundings.
    power_degc: f64, unit "degC", default 80.0, rule Rule::Positive;
    /// Time constant of warming and cooling.
    warm_tau_s: f64, unit "s", default 300.0, rule Rule::Positive;
}

>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617
params! {
    /// Errors of a channel that records a current, a voltage or a control signal.
    pub struct ChannelKeys;
    /// Delay of the recorded value.
    delay_s: f64, unit "s", default 0.0, rule Rule::Between(0.0, 60.0);
    /// Time constant of the column's first-order response, such as of a filter or an induction sensor around the wire.
    response_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Largest magnitude that the column can hold, in the column's unit. Larger values are clipped to it.
    limit: Option<f64>, unit "", absent "none", rule Rule::Positive;
    /// Constant value of the column, in its unit, to which noise is added. Simulates a sensor that is broken or
    /// attached to the wrong wire.
    stuck_at: Option<f64>, unit "", absent "no fault", rule Rule::Finite;
}

impl ChannelKeys {
    fn channel(&self) -> Channel {
        let ChannelKeys { delay_s, response_s, limit, stuck_at } = *self;
        Channel { delay_s, response_s, limit, stuck_at }
    }
}

<<<<<<< HEAD
/// The current called `name`, which `key` names; a name that is wrong is a fault.
=======
params! {
    /// A table of `currents`: a current on board, and its sensor.
    pub struct CurrentKeys, groups [channel: ChannelKeys];
    /// Name of the column, `cur_*`.
    name: String, unit "";
    /// Control of the current.
    kind: Chosen<Variant<Kind>>, unit "";
    /// Current when off.
    off_a: f64, unit "A", default 0.0, rule Rule::Finite;
    /// Current when fully on.
    on_a: f64, unit "A", rule Rule::Finite;
    /// Duration of the linear rise and fall. Used by `switched`, `schedule` and `periodic`.
    ramp_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of the sensor's white noise.
    noise_a: f64, unit "A", default 0.0, rule Rule::NotNegative;
    /// Reading of the sensor per ampere.
    scale: f64, unit "1", default 1.0, rule Rule::Finite;
    /// Quantisation step of the recorded values; 0 disables rounding.
    resolution_a: f64, unit "A", default 0.0, rule Rule::NotNegative;
    /// Records the current in a column. If false, the current flows unrecorded.
    measured: bool, unit "", default true;
    /// Fraction of each change of the current's field that eddy currents in nearby conductors delay. The column does
    /// not show this delay.
    eddy_share: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1.0);
    /// Time constant of the decay of those eddy currents.
    eddy_tau_s: f64, unit "s", default 0.1, rule Rule::Positive;
    /// Remanent field of iron near the wires after the full current is switched off, as a fraction of the current's
    /// field. It is half the width of the hysteresis loop (Rayleigh's law).
    remanence: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1.0);
}

/// The kinds of control of a current.
pub(in super::super::super) fn kinds() -> Lists {
    Lists::default().with(vec![&SWITCHED, &SCHEDULE, &PERIODIC, &STEADY, &ENGINE, &SERVO, &HEATER])
}

pub(super) fn current(s: &Section) -> Option<Current> {
    let keys: CurrentKeys = s.group_of(None, &kinds())?;
    s.refuse_foreign(&keys.kind);
    if !keys.name.starts_with("cur_") {
        s.fault_at("name", format!("the name of a current must begin with `cur_`, not `{}`", keys.name));
    }
    match &*keys.kind.keys {
        Kind::Schedule { on_off_s } => {
            let times: Vec<f64> = on_off_s.iter().flatten().copied().collect();
            if times.windows(2).any(|w| w[0] > w[1]) {
                s.fault_at("schedule", "the times of `schedule` must be in ascending order".to_owned());
            }
        }
        Kind::Periodic { every_s, for_s, .. } if for_s > every_s => {
            s.fault_at("for_s", format!("`for_s`, {for_s} s, must be at most `every_s`, {every_s} s"));
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

/// The index of the current `name` in the key `key`; an unknown name is a fault.
>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617
fn current_of(s: &Section, key: &'static str, name: &str, currents: &[Current]) -> Option<usize> {
    index_of(currents, name).map_err(|fault| s.push_at(key, fault)).ok()
}

params! {
    /// A table of `wires`: a wire that carries a current. Its field at a magnetometer follows the Biot-Savart law.
    pub struct WireKeys;
    /// Name of the current.
    current: String, unit "";
    /// Corners of the wire in the direction of the current, in the body frame (nose, right, down).
    path: Option<Vec<[f64; 3]>>, unit "m", absent "a small coil, `place_m` and `moment_m2`", rule Rule::Finite;
    /// Connects the last corner to the first.
    closed: bool, unit "", default false;
    /// Number of turns along the path.
    turns: f64, unit "1", default 1.0, rule Rule::Finite;
    /// Current at which half of it takes this path, as through bonded joints of the airframe parallel to a wire. The
    /// path carries I abs(I) / (abs(I) + `onset_a`). At 0 it carries the whole current.
    onset_a: f64, unit "A", default 0.0, rule Rule::NotNegative;
    /// Position of a small coil in the body frame (nose, right, down). It replaces `path`.
    place_m: Option<[f64; 3]>, unit "m", absent "no coil", rule Rule::Finite;
    /// Magnetic moment of the coil per ampere, A m²/A, in the body frame.
    moment_m2: Option<[f64; 3]>, unit "m2", absent "no coil", rule Rule::Finite;
}

pub(super) fn wire(s: &Section, currents: &[Current]) -> Option<Wire> {
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

pub(super) fn voltage(s: &Section, currents: &[Current]) -> Option<Voltage> {
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

<<<<<<< HEAD
=======
/// The recorded quantity of a control signal, with a current identified by its name.
#[derive(Clone, Debug, PartialEq)]
pub enum Told {
    /// The level of a current.
    Level(String),
    /// A quantity without a name.
    Other(Signal),
}

impl Varied for Told {
    const DEFAULT: &'static str = "current";
}

variant! {
    /// The level of a current, 0 to 1, such as the throttle.
    LEVEL: Told = "current", |keys| Told::Level(keys.of);
    struct LevelKeys;
    /// Name of the current.
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

/// The kinds of control signals.
pub(in super::super::super) fn signals() -> Lists {
    Lists::default().with(vec![&LEVEL, &AILERON, &ELEVATOR, &RUDDER, &SPEED, &TEMPERATURE])
}

params! {
    /// A table of `inputs`: a recorded control signal, `offset + gain * signal` plus noise, rounded to `resolution`.
    pub struct InputKeys, groups [channel: ChannelKeys];
    /// Name of the column.
    name: String, unit "";
    /// Quantity that the signal records.
    kind: Chosen<Variant<Told>>, unit "";
    /// Offset, in the column's unit.
    offset: f64, unit "", default 0.0, rule Rule::Finite;
    /// Factor of the signal.
    gain: f64, unit "1", default 1.0, rule Rule::Finite;
    /// Standard deviation of white noise, in the column's unit.
    noise: f64, unit "", default 0.0, rule Rule::NotNegative;
    /// Quantisation step of the recorded values; 0 disables rounding.
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

>>>>>>> e94a3d7108c1eefbbec4fc47b1a28179630c0617
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

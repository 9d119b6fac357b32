//! What the spec says of the electronics on board: currents, the wires they flow in, voltages, control signals and
//! the temperature.

use nalgebra::Vector3;

use super::{
    super::super::spec::section::{Need, Section},
    source::index_of,
};

/// A current on board, and its sensor.
#[derive(Clone, Debug)]
pub struct Current {
    /// The column, `cur_*`. Key `name`.
    pub name: String,
    /// What decides when it is on. Key `kind`, `switched`.
    pub kind: Kind,
    /// Amperes while off, and while fully on. Keys `off_a`, 0, and `on_a`.
    pub off_on_a: (f64, f64),
    /// How long it takes to come and to go, linearly, in seconds: for `switched`, `schedule`, `periodic`.
    /// Key `ramp_s`, 0.
    pub ramp_s: f64,
    /// White noise of the sensor, in A. Key `noise_a`, 0.
    pub noise_a: f64,
    /// What the sensor reads for an ampere. Key `scale`, 1.
    pub scale: f64,
    /// Whether there is a sensor: without it the current flows and no column tells. Key `measured`, true.
    pub measured: bool,
}

/// When a current flows: a level from 0 (off) to 1 (fully on).
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// On and off at random, both durations exponential. Keys `mean_off_s` and `mean_on_s`, 20.
    Switched {
        /// Mean durations of off and on, in seconds.
        mean_off_on_s: (f64, f64),
    },
    /// On from `t_on` to `t_off`, in seconds after the flight's start. Key `schedule = [[t_on, t_off], ...]`.
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
        /// The shares of the rates of roll, pitch and yaw. Key `axes`, [1, 1, 1].
        axes: Vector3<f64>,
        /// The rate at which the level is 1, in degrees per second. Key `full_dps`, 20.
        full_dps: f64,
        /// Whether the direction of the motion counts, as with a deflected surface's own iron; else the rates'
        /// magnitudes add up. Key `signed`, false.
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
    /// The speed that belongs to it, in m/s. Key `cruise_mps`, 60.
    pub cruise_mps: f64,
    /// More throttle for a climb of 1 m/s. Key `per_climb_mps`, 0.05.
    pub per_climb_mps: f64,
    /// More throttle for the drag of lift: times the square of the load factor less 1. Key `per_load`, 0.2.
    pub per_load: f64,
    /// Standard deviation of the throttle's small corrections. Key `ripple`, 0.
    pub ripple: f64,
    /// How long a correction lasts, in seconds. Key `ripple_s`, 3.
    pub ripple_s: f64,
}

/// A heater that keeps a temperature: on below `keep - band / 2`, off above `keep + band / 2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thermostat {
    /// The temperature to keep. Key `keep_degc`, 60.
    pub keep_degc: f64,
    /// Width of the band. Key `band_degc`, 2.
    pub band_degc: f64,
    /// How much warmer than the surroundings the heater can make it. Key `power_degc`, 80.
    pub power_degc: f64,
    /// How fast it warms and cools, in seconds. Key `warm_tau_s`, 300.
    pub tau_s: f64,
}

/// A wire that a current flows in: what it gives at a magnetometer is the law of Biot and Savart.
#[derive(Clone, Debug)]
pub struct Wire {
    /// Which of the currents. Key `current`.
    pub current: usize,
    /// Corners of the wire in the order of the current, in metres: nose, right, down. Key `path`.
    pub path_m: Vec<Vector3<f64>>,
    /// Whether it goes back from the last to the first. Key `closed`, false.
    pub closed: bool,
    /// How many times it goes that way. Key `turns`, 1.
    pub turns: f64,
    /// Instead of a path a small coil: its place in metres and its moment in m² (A m² per ampere).
    /// Keys `place_m` and `moment_m2`.
    pub dipole: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// A voltage that is recorded: the supply's less what the currents take off.
#[derive(Clone, Debug)]
pub struct Voltage {
    /// The column, `vol_*`. Key `name`.
    pub name: String,
    /// Volts without load at the flight's start. Key `volts`.
    pub volts: f64,
    /// Resistance that each current sees, in ohms. Table `ohm`.
    pub ohm: Vec<(usize, f64)>,
    /// How much the battery loses in an hour, in volts. Key `discharge_v_per_h`, 0.
    pub discharge_v_per_h: f64,
    /// White noise of the sensor, in V. Key `noise_v`, 0.
    pub noise_v: f64,
}

/// A control signal that is recorded: `offset + gain * signal`, with noise, rounded to `resolution`.
#[derive(Clone, Debug)]
pub struct Input {
    /// The column. Key `name`.
    pub name: String,
    /// What it tells. Key `kind`.
    pub signal: Signal,
    /// Added to it. Key `offset`, 0.
    pub offset: f64,
    /// Times the signal. Key `gain`, 1.
    pub gain: f64,
    /// White noise. Key `noise`, 0.
    pub noise: f64,
    /// Step of the recorded values; 0 is none. Key `resolution`, 0.
    pub resolution: f64,
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
    /// At the flight's start. Key `start_degc`, 20.
    pub start_degc: f64,
    /// Later on. Key `settled_degc`, that of the start.
    pub settled_degc: f64,
    /// How fast it settles, in seconds. Key `tau_s`, 1200.
    pub tau_s: f64,
    /// Amplitude of the swing. Key `swing_degc`, 0.
    pub swing_degc: f64,
    /// Period of the swing, in seconds. Key `swing_s`, 900.
    pub swing_s: f64,
    /// Where sensors are calibrated. Key `reference_degc`, 20.
    pub reference_degc: f64,
}

const KINDS: [&str; 7] = ["switched", "schedule", "periodic", "steady", "engine", "servo", "heater"];

pub(super) fn current(s: &Section) -> Current {
    let name = s.text("name");
    if !name.is_empty() && !name.starts_with("cur_") {
        s.fault_at("name", format!("a current is called `cur_...`, not `{name}`"));
    }
    let kind = match s.word("kind", &KINDS) {
        0 => Kind::Switched {
            mean_off_on_s: (s.number("mean_off_s", 20.0, Need::Positive), s.number("mean_on_s", 20.0, Need::Positive)),
        },
        1 => Kind::Schedule { on_off_s: schedule(s) },
        2 => periodic(s),
        3 => Kind::Steady,
        4 => Kind::Engine(engine(s)),
        5 => Kind::Servo {
            axes: s.vector("axes").map_or(Vector3::repeat(1.0), Vector3::from),
            full_dps: s.number("full_dps", 20.0, Need::Positive),
            signed: s.flag("signed", false),
        },
        _ => Kind::Heater(Thermostat {
            keep_degc: s.number("keep_degc", 60.0, Need::Any),
            band_degc: s.number("band_degc", 2.0, Need::Positive),
            power_degc: s.number("power_degc", 80.0, Need::Positive),
            tau_s: s.number("warm_tau_s", 300.0, Need::Positive),
        }),
    };
    let current = Current {
        name,
        kind,
        off_on_a: (s.number("off_a", 0.0, Need::Any), s.needed("on_a", Need::Any)),
        ramp_s: s.number("ramp_s", 0.0, Need::NotNegative),
        noise_a: s.number("noise_a", 0.0, Need::NotNegative),
        scale: s.number("scale", 1.0, Need::Any),
        measured: s.flag("measured", true),
    };
    s.finish();
    current
}

fn schedule(s: &Section) -> Vec<[f64; 2]> {
    let Some(on_off_s) = s.rows("schedule") else {
        s.fault("`currents` of kind `schedule` needs `schedule`, a list of [on, off] in seconds".to_owned());
        return vec![];
    };
    let times: Vec<f64> = on_off_s.iter().flatten().copied().collect();
    if times.windows(2).any(|w| w[0] > w[1]) {
        s.fault_at("schedule", "the times of `schedule` must not go back".to_owned());
    }
    on_off_s
}

fn periodic(s: &Section) -> Kind {
    let every_s = s.needed("every_s", Need::Positive);
    let for_s = s.needed("for_s", Need::Positive);
    if for_s > every_s {
        s.fault_at("for_s", format!("it cannot be on for {for_s} s every {every_s} s"));
    }
    Kind::Periodic { every_s, for_s, first_s: s.number("first_s", 0.0, Need::NotNegative) }
}

fn engine(s: &Section) -> Engine {
    Engine {
        cruise: s.number("cruise", 0.5, Need::Between(0.0, 1.0)),
        cruise_mps: s.number("cruise_mps", 60.0, Need::Positive),
        per_climb_mps: s.number("per_climb_mps", 0.05, Need::NotNegative),
        per_load: s.number("per_load", 0.2, Need::NotNegative),
        ripple: s.number("ripple", 0.0, Need::NotNegative),
        ripple_s: s.number("ripple_s", 3.0, Need::Positive),
    }
}

/// The current that `key` names; a name that is wrong is a fault.
fn current_of(s: &Section, key: &'static str, currents: &[Current]) -> usize {
    let name = s.text(key);
    index_of(currents, &name).unwrap_or_else(|fault| {
        if !name.is_empty() {
            s.push_at(key, fault);
        }
        0
    })
}

pub(super) fn wire(s: &Section, currents: &[Current]) -> Wire {
    let current = current_of(s, "current", currents);
    let path_m: Vec<Vector3<f64>> = s.rows("path").unwrap_or_default().into_iter().map(Vector3::from).collect();
    let dipole = s.vector("place_m").zip(s.vector("moment_m2")).map(|(p, m)| (Vector3::from(p), Vector3::from(m)));
    if (path_m.len() < 2) == dipole.is_none() {
        s.fault("a wire needs either a `path` of two corners or more, or `place_m` and `moment_m2`".to_owned());
    }
    let (closed, turns) = (s.flag("closed", false), s.number("turns", 1.0, Need::Any));
    s.finish();
    Wire { current, path_m, closed, turns, dipole }
}

pub(super) fn voltage(s: &Section, currents: &[Current]) -> Voltage {
    let name = s.text("name");
    if !name.is_empty() && !name.starts_with("vol_") {
        s.fault_at("name", format!("a voltage is called `vol_...`, not `{name}`"));
    }
    let mut ohm = vec![];
    for (current, value, at) in s.section("ohm").map(|o| o.entries()).unwrap_or_default() {
        match index_of(currents, &current) {
            Ok(index) => ohm.push((index, value)),
            Err(fault) => s.push(fault.at(at)),
        }
    }
    let voltage = Voltage {
        name,
        volts: s.needed("volts", Need::Any),
        ohm,
        discharge_v_per_h: s.number("discharge_v_per_h", 0.0, Need::Any),
        noise_v: s.number("noise_v", 0.0, Need::NotNegative),
    };
    s.finish();
    voltage
}

const SIGNALS: [&str; 6] = ["current", "aileron", "elevator", "rudder", "speed", "temperature"];

pub(super) fn input(s: &Section, currents: &[Current]) -> Input {
    let name = s.text("name");
    let described = schemas::flight::describe(&name);
    if !name.is_empty() && (!described.description.is_empty() || described.role != schemas::Role::Aux) {
        s.fault_at("name", format!("`{name}` is the name of another column"));
    }
    let signal = match s.word("kind", &SIGNALS) {
        0 => Signal::Level(current_of(s, "of", currents)),
        axis @ 1..=3 => Signal::Rate(axis - 1),
        4 => Signal::Speed,
        _ => Signal::Temperature,
    };
    let input = Input {
        name,
        signal,
        offset: s.number("offset", 0.0, Need::Any),
        gain: s.number("gain", 1.0, Need::Any),
        noise: s.number("noise", 0.0, Need::NotNegative),
        resolution: s.number("resolution", 0.0, Need::NotNegative),
    };
    s.finish();
    input
}

pub(super) fn temperature(root: &Section) -> Temperature {
    let Some(s) = root.section("temperature") else {
        return Temperature {
            start_degc: 20.0,
            settled_degc: 20.0,
            tau_s: 1200.0,
            swing_degc: 0.0,
            swing_s: 900.0,
            reference_degc: 20.0,
        };
    };
    let start_degc = s.number("start_degc", 20.0, Need::Between(-90.0, 90.0));
    let temperature = Temperature {
        start_degc,
        settled_degc: s.number("settled_degc", start_degc, Need::Between(-90.0, 90.0)),
        tau_s: s.number("tau_s", 1200.0, Need::Positive),
        swing_degc: s.number("swing_degc", 0.0, Need::NotNegative),
        swing_s: s.number("swing_s", 900.0, Need::Positive),
        reference_degc: s.number("reference_degc", 20.0, Need::Between(-90.0, 90.0)),
    };
    s.finish();
    temperature
}

//! The currents on board: when they flow, and their sensors.

use nalgebra::Vector3;
use schemas::{Chosen, Lists, Rule, params};

use super::{Channel, ChannelKeys};
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
pub(crate) fn kinds() -> Lists {
    Lists::default().with(vec![&SWITCHED, &SCHEDULE, &PERIODIC, &STEADY, &ENGINE, &SERVO, &HEATER])
}

pub(in super::super) fn current(s: &Section) -> Option<Current> {
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

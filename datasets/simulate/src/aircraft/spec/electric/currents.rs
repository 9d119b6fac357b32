//! The currents on board: when they flow, and their sensors.

use nalgebra::Vector3;
use schemas::{ChoiceRegistry, ChoiceSelection, Rule, params};

use super::{ChannelErrors, ChannelKeys};
use crate::reading::{
    SynthSection,
    variant::{SynthVariant, SynthVariantValue, variant},
};

/// A current on board, and its sensor.
#[derive(Clone, Debug)]
pub struct Current {
    /// Name of the column, `cur_*`.
    pub name: String,
    /// Control of the current.
    pub kind: CurrentControl,
    /// Current when off and when fully on, in A.
    pub off_on_a: (f64, f64),
    /// Duration of the linear rise and fall, in seconds: for `switched`, `schedule` and `periodic`.
    pub ramp_s: f64,
    /// White noise of the sensor, in A.
    pub noise_a: f64,
    /// Reading of the sensor per ampere.
    pub scale: f64,
    /// Quantisation step of the recorded values, in A; 0 disables rounding.
    pub resolution_a: f64,
    /// Errors of the column.
    pub channel: ChannelErrors,
    /// Whether a sensor records the current. Otherwise the current flows without a column.
    pub measured: bool,
    /// Fraction of each change of its field that eddy currents delay.
    pub eddy_share: f64,
    /// Time constant of the eddy currents, in seconds.
    pub eddy_tau_s: f64,
    /// Remanent field of iron near the wires after the full current, as a fraction of the current's field.
    pub remanence: f64,
}

/// Control of a current: a level from 0 (off) to 1 (fully on).
#[derive(Clone, Debug, PartialEq)]
pub enum CurrentControl {
    /// Switches on and off at random, with exponentially distributed durations.
    Switched {
        /// Mean durations of off and on, in seconds.
        mean_off_on_s: (f64, f64),
    },
    /// On from `t_on` to `t_off`, in seconds from the flight's start.
    Schedule {
        /// The times, in order.
        on_off_s: Vec<[f64; 2]>,
    },
    /// On for `for_s` every `every_s`, like a strobe light; the first time `first_s` (0) after the flight's start.
    Periodic {
        /// Period from one start to the next, in seconds.
        every_s: f64,
        /// Time for which the current is on in each period, in seconds.
        for_s: f64,
        /// First start, in seconds after the flight's start.
        first_s: f64,
    },
    /// Always on.
    Steady,
    /// Follows the engine's throttle.
    Engine(EngineThrottle),
    /// Follows the attitude rates that the servos control.
    Servo {
        /// Weights of the rates of roll, pitch and yaw.
        axes: Vector3<f64>,
        /// Rate at which the level is 1, in degrees per second.
        full_dps: f64,
        /// Adds the signed rates instead of their magnitudes, as for the iron of a deflected control surface.
        signed: bool,
    },
    /// Follows a thermostat's heater.
    Heater(Thermostat),
}

/// The throttle that holds speed and climb, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EngineThrottle {
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
    /// Set temperature.
    pub keep_degc: f64,
    /// Width of the hysteresis band about the set temperature.
    pub band_degc: f64,
    /// Maximum temperature rise above the surroundings.
    pub power_degc: f64,
    /// Time constant of warming and cooling, in seconds.
    pub tau_s: f64,
}

impl SynthVariantValue for CurrentControl {
    const DEFAULT: &'static str = "switched";
}

variant! {
    /// Switches on and off at random, with exponentially distributed durations.
    SWITCHED: CurrentControl = "switched",
        |keys| CurrentControl::Switched { mean_off_on_s: (keys.mean_off_s, keys.mean_on_s) };
    struct SwitchedKeys;
    /// Mean duration of the off state.
    mean_off_s: f64, unit "s", default 20.0, rule Rule::Positive;
    /// Mean duration of the on state.
    mean_on_s: f64, unit "s", default 20.0, rule Rule::Positive;
}

variant! {
    /// On from `t_on` to `t_off`, in seconds from the flight's start.
    SCHEDULE: CurrentControl = "schedule", |keys| CurrentControl::Schedule { on_off_s: keys.schedule };
    struct ScheduleKeys;
    /// Switching times in ascending order, `[[t_on, t_off], ...]`, in seconds from the flight's start.
    schedule: Vec<[f64; 2]>, unit "s", rule Rule::Finite;
}

variant! {
    /// Switches on for `for_s` every `every_s`, like a strobe light.
    PERIODIC: CurrentControl = "periodic",
    |keys| CurrentControl::Periodic { every_s: keys.every_s, for_s: keys.for_s, first_s: keys.first_s };
    struct PeriodicKeys;
    /// Period from one start to the next.
    every_s: f64, unit "s", rule Rule::Positive;
    /// Time for which the current is on in each period. At most `every_s`.
    for_s: f64, unit "s", rule Rule::Positive;
    /// Time of the first start, in seconds from the flight's start.
    first_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
}

variant! {
    /// Always on.
    STEADY: CurrentControl = "steady", |_| CurrentControl::Steady;
    struct SteadyKeys;
}

variant! {
    /// Follows the engine's throttle, which maintains speed and climb. The level is between 0 and 1.
    ENGINE: CurrentControl = "engine", |keys| {
        let EngineKeys { cruise, cruise_mps, per_climb_mps, per_load, ripple, ripple_s } = keys;
        CurrentControl::Engine(EngineThrottle { cruise, cruise_mps, per_climb_mps, per_load, ripple, ripple_s })
    };
    struct EngineKeys;
    /// Throttle in level flight at `cruise_mps`. It is proportional to the cube of the speed.
    cruise: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
    /// Speed at which `cruise` applies.
    cruise_mps: f64, unit "m/s", default 60.0, rule Rule::Positive;
    /// Additional throttle for a climb of 1 m/s.
    per_climb_mps: f64, unit "1", default 0.05, rule Rule::NotNegative;
    /// Additional throttle for lift-induced drag, per unit of (load factor² - 1).
    per_load: f64, unit "1", default 0.2, rule Rule::NotNegative;
    /// Standard deviation of small corrections of the throttle.
    ripple: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// Time constant of the corrections.
    ripple_s: f64, unit "s", default 3.0, rule Rule::Positive;
}

variant! {
    /// Follows the attitude rates that the servos control.
    SERVO: CurrentControl = "servo", |keys| {
        CurrentControl::Servo { axes: Vector3::from(keys.axes), full_dps: keys.full_dps, signed: keys.signed }
    };
    struct ServoKeys;
    /// Weights of the rates of roll, pitch and yaw.
    axes: [f64; 3], unit "1", default [1.0; 3], rule Rule::Finite;
    /// Rate at which the level is 1.
    full_dps: f64, unit "deg/s", default 20.0, rule Rule::Positive;
    /// Sums the signed rates, as for the iron of a deflected control surface. If false, their magnitudes are summed.
    signed: bool, unit "", default false;
}

variant! {
    /// Follows a thermostatically controlled heater: on below `keep_degc - band_degc / 2`, off above `keep_degc +
    /// band_degc / 2`.
    HEATER: CurrentControl = "heater", |keys| {
        let HeaterKeys { keep_degc, band_degc, power_degc, warm_tau_s } = keys;
        CurrentControl::Heater(Thermostat { keep_degc, band_degc, power_degc, tau_s: warm_tau_s })
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

params! {
    /// A table of `currents`: a current on board, and its sensor.
    pub struct CurrentKeys, groups [channel: ChannelKeys];
    /// Name of the column, `cur_*`.
    name: String, unit "";
    /// Control of the current.
    kind: ChoiceSelection<SynthVariant<CurrentControl>>, unit "";
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
    /// Records the current in a column. If false, the current flows but is not recorded.
    measured: bool, unit "", default true;
    /// Fraction of each change in the current's field that eddy currents in nearby conductors delay. The column does
    /// not show this delay.
    eddy_share: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1.0);
    /// Time constant of the decay of those eddy currents.
    eddy_tau_s: f64, unit "s", default 0.1, rule Rule::Positive;
    /// Remanent field of iron near the wires after the full current is switched off, as a fraction of the current's
    /// field. This fraction is half the width of the hysteresis loop (Rayleigh's law).
    remanence: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1.0);
}

/// The kinds of control of a current.
pub(crate) fn kinds() -> ChoiceRegistry {
    ChoiceRegistry::default().with(vec![&SWITCHED, &SCHEDULE, &PERIODIC, &STEADY, &ENGINE, &SERVO, &HEATER])
}

pub(in super::super) fn current(s: &SynthSection) -> Option<Current> {
    let keys: CurrentKeys = s.group_of(None, &kinds())?;
    s.refuse_foreign(&keys.kind);
    if !keys.name.starts_with("cur_") {
        s.fault_at("name", format!("the name of a current must begin with `cur_`, not `{}`", keys.name));
    }
    match &*keys.kind.keys {
        CurrentControl::Schedule { on_off_s } => {
            let times: Vec<f64> = on_off_s.iter().flatten().copied().collect();
            if times.windows(2).any(|w| w[0] > w[1]) {
                s.fault_at("schedule", "the times of `schedule` must be in ascending order".to_owned());
            }
        }
        CurrentControl::Periodic { every_s, for_s, .. } if for_s > every_s => {
            s.fault_at("for_s", format!("`for_s` ({for_s} s) must be at most `every_s` ({every_s} s)"));
        }
        CurrentControl::Switched { .. }
        | CurrentControl::Periodic { .. }
        | CurrentControl::Steady
        | CurrentControl::Engine(_)
        | CurrentControl::Servo { .. }
        | CurrentControl::Heater(_) => {}
    }
    Some(Current {
        kind: CurrentControl::clone(&keys.kind.keys),
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

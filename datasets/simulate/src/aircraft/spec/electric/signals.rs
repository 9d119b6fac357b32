//! The control signals that are recorded.

use schemas::{ChoiceRegistry, ChoiceSelection, Rule, params};

use super::{ChannelErrors, ChannelKeys, Current, current_of};
use crate::reading::{
    SynthSection,
    variant::{SynthVariant, SynthVariantValue, variant},
};

/// A recorded control signal: `offset + gain * signal` plus noise, rounded to `resolution`.
#[derive(Clone, Debug)]
pub struct ControlSignal {
    /// Name of the column.
    pub name: String,
    /// The recorded quantity.
    pub signal: ControlQuantity,
    /// Offset.
    pub offset: f64,
    /// Gain.
    pub gain: f64,
    /// Standard deviation of the white noise, in the column's unit.
    pub noise: f64,
    /// Quantisation step of the recorded values; 0 disables rounding.
    pub resolution: f64,
    /// Errors of the column.
    pub channel: ChannelErrors,
}

/// Quantity that a control signal records.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlQuantity {
    /// The level of a current, from 0 to 1, such as the throttle. Kind `current`, with the key `of`.
    Level(usize),
    /// Rate of roll (aileron), of pitch (elevator) or of yaw (rudder), in degrees per second.
    Rate(usize),
    /// Speed, in m/s.
    Speed,
    /// Temperature on board, in degrees Celsius.
    Temperature,
}

/// The recorded quantity of a control signal, with a current identified by its name.
#[derive(Clone, Debug, PartialEq)]
pub enum NamedControlQuantity {
    /// The level of a current.
    Level(String),
    /// A quantity without a name.
    Other(ControlQuantity),
}

impl SynthVariantValue for NamedControlQuantity {
    const DEFAULT: &'static str = "current";
}

variant! {
    /// The level of a current, from 0 to 1, such as the throttle.
    LEVEL: NamedControlQuantity = "current", |keys| NamedControlQuantity::Level(keys.of);
    struct LevelKeys;
    /// Index of the current.
    of: String, unit "";
}

variant! {
    /// Rate of roll, in degrees per second.
    AILERON: NamedControlQuantity = "aileron", |_| NamedControlQuantity::Other(ControlQuantity::Rate(0));
    struct AileronKeys;
}

variant! {
    /// Rate of pitch, in degrees per second.
    ELEVATOR: NamedControlQuantity = "elevator", |_| NamedControlQuantity::Other(ControlQuantity::Rate(1));
    struct ElevatorKeys;
}

variant! {
    /// Rate of yaw, in degrees per second.
    RUDDER: NamedControlQuantity = "rudder", |_| NamedControlQuantity::Other(ControlQuantity::Rate(2));
    struct RudderKeys;
}

variant! {
    /// Speed, in m/s.
    SPEED: NamedControlQuantity = "speed", |_| NamedControlQuantity::Other(ControlQuantity::Speed);
    struct SpeedKeys;
}

variant! {
    /// Temperature on board, in degrees Celsius.
    TEMPERATURE: NamedControlQuantity = "temperature", |_| NamedControlQuantity::Other(ControlQuantity::Temperature);
    struct TemperatureSignalKeys;
}

/// The kinds of control signals.
pub(crate) fn signals() -> ChoiceRegistry {
    ChoiceRegistry::default().with(vec![&LEVEL, &AILERON, &ELEVATOR, &RUDDER, &SPEED, &TEMPERATURE])
}

params! {
    /// A table of `inputs`: a recorded control signal, `offset + gain * signal` plus noise, rounded to `resolution`.
    pub struct InputKeys, groups [channel: ChannelKeys];
    /// Name of the column.
    name: String, unit "";
    /// The recorded quantity.
    kind: ChoiceSelection<SynthVariant<NamedControlQuantity>>, unit "";
    /// Offset.
    offset: f64, unit "", default 0.0, rule Rule::Finite;
    /// Gain.
    gain: f64, unit "1", default 1.0, rule Rule::Finite;
    /// Standard deviation of the white noise, in the column's unit.
    noise: f64, unit "", default 0.0, rule Rule::NotNegative;
    /// Quantisation step of the recorded values; 0 disables rounding.
    resolution: f64, unit "", default 0.0, rule Rule::NotNegative;
}

pub(in super::super) fn input(s: &SynthSection, currents: &[Current]) -> Option<ControlSignal> {
    let keys: InputKeys = s.group_of(None, &signals())?;
    s.refuse_foreign(&keys.kind);
    let described = schemas::flight::describe(&keys.name);
    if !described.description.is_empty() || described.role != schemas::Role::Aux {
        s.fault_at("name", format!("`{}` is the name of another column", keys.name));
    }
    let signal = match &*keys.kind.keys {
        NamedControlQuantity::Level(of) => ControlQuantity::Level(current_of(s, "of", of, currents)?),
        NamedControlQuantity::Other(signal) => signal.clone(),
    };
    let InputKeys { name, offset, gain, noise, resolution, channel, .. } = keys;
    Some(ControlSignal { name, signal, offset, gain, noise, resolution, channel: channel.channel() })
}

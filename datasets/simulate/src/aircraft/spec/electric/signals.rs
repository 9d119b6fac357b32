//! The control signals that are recorded.

use schemas::{Chosen, Lists, Rule, params};

use super::{Channel, ChannelKeys, Current, current_of};
use crate::reading::{
    Section,
    variant::{Variant, Varied, variant},
};

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
pub(crate) fn signals() -> Lists {
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

pub(in super::super) fn input(s: &Section, currents: &[Current]) -> Option<Input> {
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

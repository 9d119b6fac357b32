//! Keys of the aircraft in a synth spec: its electronics and its magnetometers.

pub use electric::{
    ChannelErrors, ControlQuantity, ControlSignal, Current, CurrentControl, EngineThrottle, Temperature, Thermostat,
    Voltage, Wire,
};
pub use sensor::{HeadingErrorModel, ScalarMagnetometer, SensorSampling, VectorMagnetometer};
pub use source::{AircraftFieldSpec, QuantitySpec};

use crate::reading::{SynthSection, unique};

pub(crate) mod electric;
pub(crate) mod sensor;
mod source;

/// The aircraft.
#[derive(Clone, Debug)]
pub struct Aircraft {
    /// Whether each component of each reading is written as a column `part_<part>_<column>`.
    pub component_columns: bool,
    /// The temperature on board.
    pub temperature: Temperature,
    /// The control signals that are recorded.
    pub inputs: Vec<ControlSignal>,
    /// The currents on board.
    pub currents: Vec<Current>,
    /// The wires that the currents flow in.
    pub wires: Vec<Wire>,
    /// The voltages that are recorded.
    pub voltages: Vec<Voltage>,
    /// The scalar magnetometers.
    pub scalars: Vec<ScalarMagnetometer>,
    /// The vector magnetometers.
    pub vectors: Vec<VectorMagnetometer>,
}

/// Reads the aircraft's tables: `temperature`, `inputs`, `currents`, `wires`, `voltages`, `magnetometers` and
/// `vector_magnetometers`.
pub(in super::super) fn aircraft(root: &SynthSection, component_columns: bool) -> Aircraft {
    let currents: Vec<Current> = root.sections("currents").iter().filter_map(electric::current).collect();
    let wires = root.sections("wires").iter().filter_map(|s| electric::wire(s, &currents)).collect();
    let voltages: Vec<_> = root.sections("voltages").iter().filter_map(|s| electric::voltage(s, &currents)).collect();
    let inputs: Vec<_> = root.sections("inputs").iter().filter_map(|s| electric::input(s, &currents)).collect();
    let scalars: Vec<_> = root.sections("magnetometers").iter().filter_map(|s| sensor::scalar(s, &currents)).collect();
    let vectors: Vec<_> =
        root.sections("vector_magnetometers").iter().filter_map(|s| sensor::vector(s, &currents)).collect();
    unique(root, "current", currents.iter().map(|c| c.name.clone()));
    unique(root, "voltage", voltages.iter().map(|c| c.name.clone()));
    unique(root, "input", inputs.iter().map(|c| c.name.clone()));
    unique(root, "magnetometer", scalars.iter().map(|c| c.name.clone()));
    unique(root, "vector magnetometer", vectors.iter().map(|c| c.name.clone()));
    Aircraft {
        component_columns,
        temperature: electric::temperature(root),
        inputs,
        currents,
        wires,
        voltages,
        scalars,
        vectors,
    }
}

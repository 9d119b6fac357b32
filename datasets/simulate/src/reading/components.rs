//! Switches for the components of the simulation.

use super::section::SynthSection;

/// The components that the table `components` of a spec can switch off, by name.
pub const COMPONENTS: &[&str] = &[
    // The earth's field.
    "anomaly",
    "diurnal",
    // The trajectory.
    "gusts",
    "turbulence",
    // The navigation.
    "ins",
    // The aircraft's field.
    "permanent",
    "induced",
    "eddy",
    "currents",
    "landing",
    "walk",
    "flex",
    "hysteresis",
    "current_lag",
    "current_iron",
    "return_path",
    "unreported",
    // The sensors.
    "heading",
    "calibration",
    "linearity",
    "core_hysteresis",
    "offset",
    "temperature",
    "temperature_scale",
    "thermal_lag",
    "crosstalk",
    "bandwidth",
    "axis_lag",
    "lag",
    "drift",
    "spikes",
    "noise",
    "quantisation",
    "dead_zones",
    "dropouts",
    // The channels of currents, voltages and control signals.
    "channel_scale",
    "channel_delay",
    "channel_response",
    "channel_limit",
    "channel_resolution",
    "channel_stuck",
];

/// The components that are off; all others are on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ComponentSwitches {
    off: Vec<&'static str>,
}

impl ComponentSwitches {
    /// Reads the table `components`, whose keys are names of components and whose values switch them on or off.
    pub(crate) fn read(root: &SynthSection) -> ComponentSwitches {
        let Some(s) = root.section("components") else { return ComponentSwitches::default() };
        let off = COMPONENTS.iter().copied().filter(|name| !s.flag(name, true)).collect();
        s.finish();
        ComponentSwitches { off }
    }

    /// Whether the component `name` is on.
    pub fn on(&self, name: &str) -> bool {
        !self.off.contains(&name)
    }
}

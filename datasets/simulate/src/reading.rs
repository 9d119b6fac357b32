//! Reading of the tables of a synth spec: sections with their positions, presets, and components that are off.

pub use components::{COMPONENTS, ComponentSwitches};
pub use preset::PRESETS;
pub(crate) use section::{SynthFaultList, SynthSection, unique};

mod components;
pub(crate) mod preset;
mod section;
pub(crate) mod variant;

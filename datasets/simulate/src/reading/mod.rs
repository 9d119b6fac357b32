//! How the tables of a synth spec are read: sections with their places, presets, what is switched off.

pub use components::{COMPONENTS, Components};
pub use preset::PRESETS;
pub(crate) use section::{Faults, Section, unique};

mod components;
pub(crate) mod preset;
mod section;
pub(crate) mod variant;

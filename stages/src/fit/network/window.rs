//! Window of samples of a network.

use learning::network::MemoryLayers;
use schemas::{Fault, Rule, params};

params! {
    /// Window of samples.
    pub struct WindowKeys;
    /// Number of samples in a window, ending at the predicted sample. Future samples are not used.
    window: usize, unit "samples", default 16usize, rule Rule::Between(2.0, 4096.0);
    /// Number of features computed from the window.
    units: usize, unit "1", default 8usize, rule Rule::Between(1.0, 1000.0);
}

/// Layers that compute features of a window.
#[derive(Clone, Copy)]
pub struct WindowLayers {
    /// Type of the layers.
    pub memory: MemoryLayers,
    /// Number of samples.
    pub window: usize,
    /// Number of features.
    pub units: usize,
}

impl WindowKeys {
    /// Window with its type of layers.
    pub fn with(&self, memory: MemoryLayers) -> WindowLayers {
        WindowLayers { memory, window: self.window, units: self.units }
    }
}

impl WindowLayers {
    /// Cost of a sample relative to a network of single samples.
    pub fn effort(&self) -> f64 {
        (self.window * self.units) as f64
    }

    /// Faults of the window's keys.
    pub fn faults(&self) -> Vec<Fault> {
        let what = format!("`window` of convolutions must be a power of two, not {}", self.window);
        let wrong = self.memory == MemoryLayers::Tcn && !self.window.is_power_of_two();
        wrong.then(|| Fault::new(what).of_param("window")).into_iter().collect()
    }
}

//! Window of samples of a network.

use learning::network::MemoryLayers;
use schemas::{Fault, Rule, params};

params! {
    /// Window of samples.
    pub struct WindowKeys;
    /// Number of samples in a window; for `tcn`, a power of two. The window ends at the predicted sample, so future
    /// samples are not used.
    window: usize, unit "samples", default 16usize, rule Rule::Between(2.0, 4096.0);
    /// Number of features computed from the window.
    units: usize, unit "1", default 8usize, rule Rule::Between(1.0, 1000.0);
}

/// Layers that compute features from a window of samples.
#[derive(Clone, Copy)]
pub struct WindowLayers {
    /// Type of the layers.
    pub memory: MemoryLayers,
    /// Number of samples.
    pub window: usize,
    /// Number of units that represent a sample for a transformer; number of features for other layers.
    pub units: usize,
    /// Number of heads of a transformer; 1 for other layers.
    pub heads: usize,
}

impl WindowKeys {
    /// Layers of the type `memory` over the window.
    pub fn with(&self, memory: MemoryLayers) -> WindowLayers {
        WindowLayers { memory, window: self.window, units: self.units, heads: 1 }
    }
}

impl WindowLayers {
    /// Number of units if each sample has `inputs` inputs.
    pub fn units(&self, inputs: usize) -> usize {
        if self.memory == MemoryLayers::Window { inputs * self.window } else { self.units }
    }

    /// Number of features computed from the window if each sample has `inputs` inputs.
    pub fn features(&self, inputs: usize) -> usize {
        match self.memory {
            MemoryLayers::Window => inputs * self.window,
            MemoryLayers::Transformer => self.units * self.window,
            MemoryLayers::Gru | MemoryLayers::Lstm | MemoryLayers::Tcn => self.units,
        }
    }

    /// Cost of a sample relative to a network of single samples.
    pub fn effort(&self) -> f64 {
        (self.window * self.units) as f64
    }

    /// Faults of the window's keys.
    pub fn faults(&self) -> Vec<Fault> {
        let what = format!("`window` of convolutions must be a power of two, not {}", self.window);
        let wrong = self.memory == MemoryLayers::Tcn && !self.window.is_power_of_two();
        let mut faults: Vec<Fault> = wrong.then(|| Fault::new(what).of_param("window")).into_iter().collect();
        if !self.units.is_multiple_of(self.heads.max(1)) {
            let what = format!(
                "`units` must be a multiple of `heads`, but {} is not a multiple of {}",
                self.units, self.heads
            );
            faults.push(Fault::new(what).of_param("heads"));
        }
        faults
    }
}

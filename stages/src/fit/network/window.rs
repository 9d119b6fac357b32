//! The window of samples that a network sees.

use learning::network::Memory;
use schemas::{Fault, Rule, params};

params! {
    /// A window of samples.
    pub struct WindowKeys;
    /// Samples that a prediction looks at, the predicted one and those before it: none of the future.
    window: usize, unit "samples", default 16usize, rule Rule::Between(2.0, 4096.0);
    /// Features that are made of the window.
    units: usize, unit "1", default 8usize, rule Rule::Between(1.0, 1000.0);
}

/// Layer that computes features of a window.
#[derive(Clone, Copy)]
pub struct Window {
    /// How.
    pub memory: Memory,
    /// Samples.
    pub window: usize,
    /// Features.
    pub units: usize,
}

impl WindowKeys {
    /// With what makes features of it.
    pub fn with(&self, memory: Memory) -> Window {
        Window { memory, window: self.window, units: self.units }
    }
}

impl Window {
    /// How much more work a sample is for its window.
    pub fn effort(&self) -> f64 {
        (self.window * self.units) as f64
    }

    /// Errors in its keys.
    pub fn faults(&self) -> Vec<Fault> {
        let what = format!("convolutions see a power of two of samples, and not {}", self.window);
        let wrong = self.memory == Memory::Tcn && !self.window.is_power_of_two();
        wrong.then(|| Fault::new(what).of_param("window")).into_iter().collect()
    }
}

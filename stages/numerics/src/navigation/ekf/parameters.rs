//! Parameters of the filter.

use crate::navigation::ins_error::{InsErrorModel, ParameterError, require};
use params::Rule;

/// Parameters of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EkfParameters {
    /// Error sources of the INS and of the field.
    pub errors: InsErrorModel,
    /// Standard deviation of the measurement noise, in nT: sensor, map and compensation residual.
    pub measurement_sigma_nt: f64,
    /// Length, in seconds, of a window at the start of the line. The mean of measurement minus prediction (map and core
    /// field at the INS position) over this window is subtracted from every measurement; 0 subtracts nothing.
    /// Compensation and maps do not determine a constant, which may far exceed the range of S.
    pub offset_window_s: f64,
    /// Largest NIS of a measurement; measurements with larger NIS are rejected and counted. `None` uses every
    /// measurement. 10.83 rejects one valid measurement in a thousand.
    pub gate_nis: Option<f64>,
    /// Adds the variance from the curvature of the map over the position uncertainty to the measurement noise.
    pub second_order: bool,
    /// Returns the error states of every sample (144 bytes each).
    pub keep_states: bool,
    /// Returns the covariance of every sample (2.6 kB each).
    pub keep_covariance: bool,
}

impl Default for EkfParameters {
    fn default() -> Self {
        Self {
            errors: InsErrorModel::default(),
            measurement_sigma_nt: 5.0,
            offset_window_s: 0.0,
            gate_nis: None,
            second_order: false,
            keep_states: true,
            keep_covariance: false,
        }
    }
}

impl EkfParameters {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Fails for a measurement noise or a gate that is not a finite number above 0, or for a window that is not a
    /// finite number of at least 0. Also returns the errors of [`InsErrorModel::check`].
    pub fn check(&self) -> Result<(), ParameterError> {
        let (sigma, window) = (self.measurement_sigma_nt, self.offset_window_s);
        require("measurement_sigma_nt", sigma, Rule::Positive)?;
        require("offset_window_s", window, Rule::NotNegative)?;
        if let Some(gate) = self.gate_nis {
            require("gate_nis", gate, Rule::Positive)?;
        }
        self.errors.check()
    }
}

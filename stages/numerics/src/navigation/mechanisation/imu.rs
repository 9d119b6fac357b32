//! Errors of the readings of inertial sensors.

use nalgebra::Vector3;

use super::ImuReading;

/// Errors of one step, truth minus measurement, as for all INS errors in this crate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuErrors {
    /// Mean of the accelerometers' biases over the step, in m/s².
    pub acc_bias_mps2: Vector3<f64>,
    /// Mean of the gyroscopes' biases over the step, in rad/s.
    pub gyro_bias_radps: Vector3<f64>,
    /// Increment of velocity random walk over the step, in m/s.
    pub acc_walk_mps: Vector3<f64>,
    /// Increment of angular random walk over the step, in rad.
    pub gyro_walk_rad: Vector3<f64>,
    /// Relative scale errors of the accelerometers.
    pub acc_scale: Vector3<f64>,
    /// Relative scale errors of the gyroscopes.
    pub gyro_scale: Vector3<f64>,
}

impl ImuErrors {
    /// Reading of the sensors for an error-free reading `exact`.
    pub fn measured(&self, exact: &ImuReading) -> ImuReading {
        let angle = exact.angle_rad.component_mul(&self.gyro_scale);
        let velocity = exact.velocity_mps.component_mul(&self.acc_scale);
        ImuReading {
            dt_s: exact.dt_s,
            angle_rad: exact.angle_rad - angle - self.gyro_bias_radps * exact.dt_s - self.gyro_walk_rad,
            velocity_mps: exact.velocity_mps - velocity - self.acc_bias_mps2 * exact.dt_s - self.acc_walk_mps,
        }
    }
}

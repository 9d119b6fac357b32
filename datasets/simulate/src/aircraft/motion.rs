//! The motion that the electronics depend on, and the temperature on board.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use numerics::navigation::mechanisation::normal_gravity_mps2;

use super::{super::trajectory::Trajectory, spec::Temperature};

/// The motion along a line, as sensed on board.
pub(super) struct Motion {
    /// Seconds after the flight's start.
    pub(super) since_s: Vec<f64>,
    /// Rates of roll, pitch and yaw, in degrees per second.
    pub(super) rates_dps: [Vec<f64>; 3],
    /// Speed over ground, in m/s.
    pub(super) speed_mps: Vec<f64>,
    /// Climb, in m/s.
    pub(super) climb_mps: Vec<f64>,
    /// Upward specific force in the body less that of level flight, in m/s².
    pub(super) lift_mps2: Vec<f64>,
    /// Magnitude of the specific force over gravity.
    pub(super) load: Vec<f64>,
}

impl Motion {
    /// From the truth of a line of a flight that begins at `start_tt_s`.
    pub(super) fn of(truth: &Trajectory, start_tt_s: f64) -> Motion {
        let rows = 0..truth.tt_s.len();
        let force = |i: usize| Vector3::from_fn(|k, _| truth.force_mps2[k][i]);
        let gravity = |i: usize| normal_gravity_mps2(truth.lat_deg[i].to_radians(), truth.alt_m[i]);
        let [north, east, down] = &truth.velocity_mps;
        Motion {
            since_s: truth.tt_s.iter().map(|tt| tt - start_tt_s).collect(),
            rates_dps: truth.attitude_rates_degps.clone(),
            speed_mps: rows.clone().map(|i| Vector3::new(north[i], east[i], down[i]).norm()).collect(),
            climb_mps: down.iter().map(|v| -v).collect(),
            lift_mps2: rows.clone().map(|i| -(truth.attitude(i).transpose() * force(i)).z - gravity(i)).collect(),
            load: rows.map(|i| force(i).norm() / gravity(i)).collect(),
        }
    }
}

impl Temperature {
    /// The temperature in degrees Celsius, `since_s` seconds after the flight's start.
    pub(super) fn at(&self, since_s: f64) -> f64 {
        let settling = (self.start_degc - self.settled_degc) * (-since_s / self.tau_s).exp();
        self.settled_degc + settling + self.swing_degc * (TAU * since_s / self.swing_s).sin()
    }
}

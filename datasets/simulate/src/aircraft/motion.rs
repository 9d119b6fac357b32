//! The motion that the electronics depend on, and the temperature on board.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use numerics::navigation::mechanisation::normal_gravity_mps2;

use super::{super::trajectory::TrueTrajectory, spec::Temperature};

/// The motion along a line, as sensed on board.
pub(super) struct AircraftMotion {
    /// Seconds after the flight's start.
    pub(super) since_s: Vec<f64>,
    /// Rates of roll, pitch and yaw, in degrees per second.
    pub(super) rates_dps: [Vec<f64>; 3],
    /// Speed over ground, in m/s.
    pub(super) speed_mps: Vec<f64>,
    /// Climb, in m/s.
    pub(super) climb_mps: Vec<f64>,
    /// Upward specific force in the body, in excess of level flight, in m/s².
    pub(super) lift_mps2: Vec<f64>,
    /// Magnitude of the specific force divided by gravity.
    pub(super) load: Vec<f64>,
}

impl AircraftMotion {
    /// The motion from the truth of a line; the flight begins at `start_tt_s`.
    pub(super) fn from_truth(truth: &TrueTrajectory, start_tt_s: f64) -> AircraftMotion {
        let rows = 0..truth.tt_s.len();
        let force = |i: usize| Vector3::from_fn(|k, _| truth.force_mps2[k][i]);
        let gravity = |i: usize| normal_gravity_mps2(truth.lat_deg[i].to_radians(), truth.alt_m[i]);
        let [north, east, down] = &truth.velocity_mps;
        AircraftMotion {
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

    /// The temperature of a body that follows the temperature on board with the time constant `tau_s`, in degrees
    /// Celsius. The result solves tau dT/dt + T = [`Temperature::at`] with equal temperatures at the flight's start.
    /// With `tau_s` = 0, the result equals the temperature on board.
    pub(super) fn followed_at(&self, since_s: f64, tau_s: f64) -> f64 {
        if tau_s <= 0.0 {
            return self.at(since_s);
        }
        let (own, own_left) = ((-since_s / self.tau_s).exp(), (-since_s / tau_s).exp());
        let ratio = tau_s / self.tau_s;
        let settling = if (1.0 - ratio).abs() < 1e-6 {
            // The limit of equal time constants.
            own * (1.0 + since_s / self.tau_s)
        } else {
            (own - ratio * own_left) / (1.0 - ratio)
        };
        let omega = TAU / self.swing_s;
        let (sin, cos) = (omega * since_s).sin_cos();
        let turn = omega * tau_s;
        let swing = (sin - turn * cos + turn * own_left) / (1.0 + turn * turn);
        self.settled_degc + (self.start_degc - self.settled_degc) * settling + self.swing_degc * swing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_lagging_temperature_solves_its_differential_equation() {
        let on_board = Temperature {
            start_degc: 15.0,
            settled_degc: 23.0,
            tau_s: 1800.0,
            swing_degc: 3.0,
            swing_s: 700.0,
            reference_degc: 20.0,
        };
        for tau_s in [1.0, 240.0, 1800.0, 1800.01, 9000.0] {
            assert!((on_board.followed_at(0.0, tau_s) - 15.0).abs() < 1e-9, "{tau_s}");
            for t in [10.0, 500.0, 3000.0, 20_000.0] {
                let h = 0.1;
                let rate = (on_board.followed_at(t + h, tau_s) - on_board.followed_at(t - h, tau_s)) / (2.0 * h);
                let rest = tau_s * rate + on_board.followed_at(t, tau_s) - on_board.at(t);
                // The tolerance covers a rounding error of 1e-13, divided by 5e-6 near equal time constants, and an
                // error of the differences of 1e-9 due to the third derivative.
                assert!(rest.abs() < 1e-4, "{tau_s} {t}: {rest}");
            }
        }
        assert_eq!(on_board.followed_at(77.0, 0.0), on_board.at(77.0));
    }
}

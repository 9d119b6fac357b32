//! Readings of ideal inertial sensors along a motion.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::{ImuReading, NavigationEarth, NavigationState, REPETITIONS, surroundings};
use crate::earth::attitude::skew;

/// Readings of ideal sensors along a motion given by velocities and attitudes.
///
/// Each step inverts a mechanisation instead of using a quadrature. A free mechanisation of these readings reproduces
/// velocities and attitudes up to rounding. The position of the motion equals [`IdealImu::motion`], the trapezoidal
/// integral of the velocities.
#[derive(Clone, Debug)]
pub struct IdealImu {
    earth: NavigationEarth,
    motion: NavigationState,
    before: ImuReading,
}

impl IdealImu {
    /// Readings of a motion with this start.
    pub fn new(earth: NavigationEarth, start: NavigationState) -> Self {
        Self { earth, motion: start, before: ImuReading::default() }
    }

    /// Current motion.
    pub fn motion(&self) -> &NavigationState {
        &self.motion
    }

    /// Reading over the `dt_s` seconds until the next velocity (m/s) and attitude.
    pub fn next(&mut self, vel_ned_mps: &Vector3<f64>, body_to_ned: &UnitQuaternion<f64>, dt_s: f64) -> ImuReading {
        let from = self.motion;
        let v = 0.5 * (from.vel_ned_mps + vel_ned_mps);
        let (mut turn, mut accelerated) = (Vector3::zeros(), Vector3::zeros());
        for _ in 0..REPETITIONS {
            let to = self.motion;
            let at = surroundings(self.earth, 0.5 * (from.lat_rad + to.lat_rad), 0.5 * (from.alt_m + to.alt_m), &v);
            turn = at.frame_rate * dt_s;
            accelerated = at.acceleration * dt_s;
            self.motion.lat_rad = from.lat_rad + at.lat_rate * dt_s;
            self.motion.lon_rad = from.lon_rad + at.lon_rate * dt_s;
            self.motion.alt_m = from.alt_m - v.z * dt_s;
        }
        (self.motion.vel_ned_mps, self.motion.body_to_ned) = (*vel_ned_mps, *body_to_ned);
        self.motion.come_down_from_the_pole();
        let to_body = from.body_to_ned.inverse();
        let rotation = (to_body * UnitQuaternion::from_scaled_axis(turn) * body_to_ned).scaled_axis();
        let felt = vel_ned_mps - from.vel_ned_mps - accelerated;
        let velocity = to_body * (UnitQuaternion::from_scaled_axis(0.5 * turn) * felt);
        self.before = self.uncorrected(&rotation, &velocity, dt_s);
        self.before
    }

    /// Reading whose increments, after the correction of coning and sculling, equal the given increments.
    fn uncorrected(&self, rotation_rad: &Vector3<f64>, velocity_mps: &Vector3<f64>, dt_s: f64) -> ImuReading {
        let (angle_before, velocity_before) = self.before.stretched_to(dt_s);
        // The matrices are the identity plus small skew-symmetric matrices, so they always have an inverse.
        let solved = |m: Matrix3<f64>, right: Vector3<f64>| m.try_inverse().map_or(right, |inverse| inverse * right);
        let identity = Matrix3::identity();
        let angle_rad = solved(identity + skew(&angle_before) / 12.0, *rotation_rad);
        let angle = skew(&angle_rad);
        let turning = 0.5 * angle + angle * angle / 6.0 + skew(&angle_before) / 12.0;
        let right = velocity_mps - velocity_before.cross(&angle_rad) / 12.0;
        ImuReading { dt_s, angle_rad, velocity_mps: solved(identity + turning, right) }
    }
}

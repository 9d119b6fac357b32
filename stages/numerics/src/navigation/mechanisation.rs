//! Strapdown inertial navigation: attitude, velocity and position from the readings of gyroscopes and accelerometers,
//! with a barometer-aided vertical channel. The inverse computes the readings of a motion.
//!
//! The navigation frame is north-east-down, the body frame nose-right-down. A reading contains the integrals of the
//! body's angular rate and specific force over a step, in body axes. Within a step both are assumed linear in time.
//! Coning and sculling are corrected with the previous reading, to third order in the rotation angle of a step. [Savage
//! 1998, I (38) and II (23); Titterton & Weston 2004, 11.2]
//!
//! Unlike the error model (`pinson`), the mechanisation is nonlinear in the errors. The earth is the ellipsoid, and
//! gravity decreases with height.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::earth::geodesy::{
    EARTH_RATE_RADPS, ECCENTRICITY_SQUARED, FLATTENING, SEMI_MAJOR_AXIS_M, STANDARD_GRAVITY_MPS2, meridian_radius_m,
    transverse_radius_m,
};
use crate::navigation::pinson::{K1, K2, K3};
pub use imu::ImuErrors;
pub use readings::IdealImu;

mod imu;
mod readings;

/// Earth model of the mechanisation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum NavigationEarth {
    /// WGS-84: ellipsoid, rotation rate and normal gravity.
    #[default]
    Wgs84,
    /// Sphere of radius 6378137 m with 9.80665 m/s² everywhere: the earth of the error model and, without rotation, of
    /// textbook solutions.
    Sphere {
        /// Rotation rate, in rad/s.
        rate_radps: f64,
    },
}

impl NavigationEarth {
    /// Metres per radian of latitude at a position, and per radian of longitude at the equator.
    fn radii_m(self, lat_rad: f64, alt_m: f64) -> (f64, f64) {
        match self {
            Self::Wgs84 => (meridian_radius_m(lat_rad) + alt_m, transverse_radius_m(lat_rad) + alt_m),
            Self::Sphere { .. } => (SEMI_MAJOR_AXIS_M + alt_m, SEMI_MAJOR_AXIS_M + alt_m),
        }
    }

    fn gravity_mps2(self, lat_rad: f64, alt_m: f64) -> f64 {
        match self {
            Self::Wgs84 => normal_gravity_mps2(lat_rad, alt_m),
            Self::Sphere { .. } => STANDARD_GRAVITY_MPS2,
        }
    }

    fn rate_radps(self) -> f64 {
        match self {
            Self::Wgs84 => EARTH_RATE_RADPS,
            Self::Sphere { rate_radps } => rate_radps,
        }
    }
}

/// Normal gravity of WGS-84, in m/s², at a geodetic latitude (rad) and a height above the ellipsoid (m).
/// [NIMA TR8350.2, (4-1) and (4-3)]
pub fn normal_gravity_mps2(lat_rad: f64, alt_m: f64) -> f64 {
    const EQUATOR: f64 = 9.780_325_335_9;
    const K: f64 = 0.001_931_852_652_41;
    const M: f64 = 0.003_449_786_506_84;
    const A: f64 = SEMI_MAJOR_AXIS_M;
    let sin2 = lat_rad.sin().powi(2);
    let surface = EQUATOR * (1.0 + K * sin2) / (1.0 - ECCENTRICITY_SQUARED * sin2).sqrt();
    let gradient = 2.0 / A * (1.0 + FLATTENING + M - 2.0 * FLATTENING * sin2);
    surface * (1.0 - gradient * alt_m + 3.0 / (A * A) * alt_m * alt_m)
}

/// Position, velocity and attitude of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NavigationState {
    /// Geodetic latitude, in rad.
    pub lat_rad: f64,
    /// Longitude, in rad.
    pub lon_rad: f64,
    /// Height above the ellipsoid, in metres.
    pub alt_m: f64,
    /// Velocity north, east, down, in m/s.
    pub vel_ned_mps: Vector3<f64>,
    /// Rotation from the body frame to north-east-down.
    pub body_to_ned: UnitQuaternion<f64>,
}

/// Quaternion of a direction cosine matrix.
pub fn quaternion(matrix: &Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(*matrix))
}

/// Reading of the inertial sensors over a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuReading {
    /// Length of the step, in seconds.
    pub dt_s: f64,
    /// Integral of the body's angular rate relative to inertial space, in rad.
    pub angle_rad: Vector3<f64>,
    /// Integral of the specific force, in m/s.
    pub velocity_mps: Vector3<f64>,
}

/// Reading without the effect of rotation within the step: the rotation vector of the body relative to inertial space,
/// and the change of velocity, in the axes at the step's beginning.
struct ImuIncrements {
    rotation_rad: Vector3<f64>,
    velocity_mps: Vector3<f64>,
}

impl ImuReading {
    /// Increments with coning and sculling corrections from the previous reading.
    fn increments(&self, before: &ImuReading) -> ImuIncrements {
        let (angle, velocity) = (self.angle_rad, self.velocity_mps);
        let (angle_before, velocity_before) = before.stretched_to(self.dt_s);
        ImuIncrements {
            rotation_rad: angle + angle_before.cross(&angle) / 12.0,
            velocity_mps: velocity
                + angle.cross(&(0.5 * velocity + angle.cross(&velocity) / 6.0))
                + (angle_before.cross(&velocity) + velocity_before.cross(&angle)) / 12.0,
        }
    }

    /// Angle and velocity scaled to a step of another length; zero for a step of zero length.
    fn stretched_to(&self, dt_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let factor = if self.dt_s > 0.0 { dt_s / self.dt_s } else { 0.0 };
        (self.angle_rad * factor, self.velocity_mps * factor)
    }
}

/// Effect of the earth on a body at the middle of a step.
struct EarthEffects {
    /// Rate of the navigation frame relative to inertial space, in rad/s.
    frame_rate: Vector3<f64>,
    /// Gravity minus the Coriolis and transport accelerations, in m/s².
    acceleration: Vector3<f64>,
    /// Rates of latitude and longitude, in rad/s.
    lat_rate: f64,
    lon_rate: f64,
}

/// Smallest cosine of a latitude, 6 m from a pole. Closer to the pole the rotation rate of the frame is constant.
const LEAST_COSINE: f64 = 1e-6;

fn surroundings(earth: NavigationEarth, lat_rad: f64, alt_m: f64, v: &Vector3<f64>) -> EarthEffects {
    let (sin, cos) = lat_rad.sin_cos();
    let cos = cos.max(LEAST_COSINE);
    let (meridian_m, transverse_m) = earth.radii_m(lat_rad, alt_m);
    let earth_rate = Vector3::new(cos, 0.0, -sin) * earth.rate_radps();
    let transport = Vector3::new(v.y / transverse_m, -v.x / meridian_m, -v.y * sin / (cos * transverse_m));
    let gravity = Vector3::new(0.0, 0.0, earth.gravity_mps2(lat_rad, alt_m));
    EarthEffects {
        frame_rate: earth_rate + transport,
        acceleration: gravity - (earth_rate * 2.0 + transport).cross(v),
        lat_rate: v.x / meridian_m,
        lon_rate: v.y / (transverse_m * cos),
    }
}

/// Number of repetitions of a step, each with the midpoint of the previous result. Each repetition reduces the error by
/// the factor K1 Δt/2, or 2 Ω Δt without a barometer.
const REPETITIONS: usize = 4;

/// Inertial navigation system.
#[derive(Clone, Debug)]
pub struct Mechanisation {
    earth: NavigationEarth,
    motion: NavigationState,
    loop_mps2: f64,
    before: ImuReading,
}

impl Mechanisation {
    /// Creates a system with an initial motion and the vertical acceleration (m/s², down) of its barometer loop, 0 if
    /// unknown.
    pub fn new(earth: NavigationEarth, motion: NavigationState, loop_mps2: f64) -> Self {
        Self { earth, motion, loop_mps2, before: ImuReading::default() }
    }

    /// Current motion.
    pub fn motion(&self) -> &NavigationState {
        &self.motion
    }

    /// Vertical acceleration of the barometer loop, in m/s², down.
    pub fn loop_mps2(&self) -> f64 {
        self.loop_mps2
    }

    /// Advances by one reading. `baro_alt_m` is the barometric height, averaged over the step. The barometer aids the
    /// vertical channel through a third-order loop with the gains K1, K2, K3 of the error model. Without a barometer
    /// the vertical channel is free and unstable. [Titterton & Weston 13.4]
    ///
    /// Across a pole the longitude changes by half a turn and north becomes south.
    pub fn step(&mut self, reading: &ImuReading, baro_alt_m: Option<f64>) {
        let (dt, from, loop_from) = (reading.dt_s, self.motion, self.loop_mps2);
        let increments = reading.increments(&self.before);
        let mut turn = Vector3::zeros();
        for _ in 0..REPETITIONS {
            let to = self.motion;
            let v = 0.5 * (from.vel_ned_mps + to.vel_ned_mps);
            let (lat, alt_m) = (0.5 * (from.lat_rad + to.lat_rad), 0.5 * (from.alt_m + to.alt_m));
            let at = surroundings(self.earth, lat, alt_m, &v);
            let above_m = baro_alt_m.map_or(0.0, |baro| alt_m - baro);
            let aid = Vector3::new(0.0, 0.0, K2 * above_m + 0.5 * (loop_from + self.loop_mps2));
            turn = at.frame_rate * dt;
            let felt = UnitQuaternion::from_scaled_axis(-0.5 * turn) * (from.body_to_ned * increments.velocity_mps);
            self.motion.vel_ned_mps = from.vel_ned_mps + felt + (at.acceleration + aid) * dt;
            self.motion.lat_rad = from.lat_rad + at.lat_rate * dt;
            self.motion.lon_rad = from.lon_rad + at.lon_rate * dt;
            self.motion.alt_m = from.alt_m - (v.z + K1 * above_m) * dt;
            self.loop_mps2 = loop_from + K3 * above_m * dt;
        }
        let turned = UnitQuaternion::from_scaled_axis(-turn)
            * from.body_to_ned
            * UnitQuaternion::from_scaled_axis(increments.rotation_rad);
        self.motion.body_to_ned = UnitQuaternion::new_normalize(turned.into_inner());
        self.motion.come_down_from_the_pole();
        self.before = *reading;
    }
}

impl NavigationState {
    /// Converts a latitude beyond a pole to a latitude on this side, with the longitude changed by half a turn.
    fn come_down_from_the_pole(&mut self) {
        use std::f64::consts::{FRAC_PI_2, PI};
        if self.lat_rad.abs() <= FRAC_PI_2 {
            return;
        }
        self.lat_rad = PI.copysign(self.lat_rad) - self.lat_rad;
        self.lon_rad += PI;
        let half_turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, PI));
        self.vel_ned_mps = half_turn * self.vel_ned_mps;
        self.body_to_ned = half_turn * self.body_to_ned;
    }
}

#[cfg(test)]
mod tests;

//! Pinson error model of an inertial navigation system, with additional states for the barometer and the temporal
//! variation.
//!
//! State order, as in Gnadt 2022 (5.14): errors of latitude, longitude (rad) and altitude (m); of velocity north, east,
//! down (m/s); tilts north, east, down (rad); accelerometer biases x, y, z (m/s²); gyroscope biases x, y, z (rad/s);
//! barometer-aided altitude (m) and vertical acceleration (m/s²); temporal variation S (nT). An error is truth minus
//! INS. The earth is the sphere of Gnadt 2022 with a radius of 6378137 m, and gravity does not change with height.

use crate::earth::attitude::body_to_ned;
use crate::earth::geodesy::{EARTH_RATE_RADPS, SEMI_MAJOR_AXIS_M};

/// Number of states.
pub const STATES: usize = 18;
/// Matrix over the states, by rows.
pub type StateMatrix = [[f64; STATES]; STATES];
/// Vector over the states.
pub type StateVector = [f64; STATES];

/// Latitude error, in rad.
pub const LAT: usize = 0;
/// Longitude error, in rad.
pub const LON: usize = 1;
/// Altitude error, in metres.
pub const ALT: usize = 2;
/// North velocity error, in m/s; east and down follow.
pub const VN: usize = 3;
/// East velocity error, in m/s.
pub const VE: usize = 4;
/// Down velocity error, in m/s.
pub const VD: usize = 5;
/// Tilt about north, in rad; east and down follow.
pub const TILT_N: usize = 6;
/// Tilt about east, in rad.
pub const TILT_E: usize = 7;
/// Tilt about down, in rad.
pub const TILT_D: usize = 8;
/// Bias of the x accelerometer, in m/s²; y and z follow.
pub const ACC: usize = 9;
/// Bias of the x gyroscope, in rad/s; y and z follow.
pub const GYRO: usize = 12;
/// Barometer-aiding altitude error, in metres.
pub const HA: usize = 15;
/// Barometer-aiding vertical acceleration error, in m/s².
pub const A_HAT: usize = 16;
/// Temporal variation of the field, in nT.
pub const S: usize = 17;

/// States with off-diagonal entries in F: all except the Gauss-Markov states.
pub(crate) const COUPLED: [usize; 10] = [LAT, LON, ALT, VN, VE, VD, TILT_N, TILT_E, TILT_D, A_HAT];
/// Gauss-Markov states, each of which depends only on its own past.
pub(crate) const GAUSS_MARKOV: [usize; 8] = [ACC, ACC + 1, ACC + 2, GYRO, GYRO + 1, GYRO + 2, HA, S];

/// Index of each of these states in MagNav.jl, which has the two barometer states before the biases.
/// `MAGNAV_POSITION[i]` is the index (from 0) of magline's state `i` in the vectors of MagNav.jl.
pub const MAGNAV_POSITION: [usize; STATES] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 12, 13, 14, 15, 16, 9, 10, 17];

/// Barometer aiding of the altitude, in 1/s. [MagNav.jl `get_pinson`: k1]
pub const K1: f64 = 3e-2;
/// Barometer aiding of the vertical velocity, in 1/s².
pub const K2: f64 = 3e-4;
/// Barometer aiding of the vertical acceleration, in 1/s³.
pub const K3: f64 = 1e-6;

/// INS quantities of the error model at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InsPoint {
    /// Latitude, in rad.
    pub lat_rad: f64,
    /// Velocity north, east, down, in m/s.
    pub vel_ned_mps: [f64; 3],
    /// Specific force north, east, down, in m/s²; (0, 0, -g) at rest.
    pub force_ned_mps2: [f64; 3],
    /// Roll, pitch and yaw, in rad.
    pub euler_rad: [f64; 3],
}

/// Correlation times of the Gauss-Markov states, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeConstants {
    /// Barometer-aiding altitude.
    pub baro_s: f64,
    /// Accelerometer biases.
    pub acc_s: f64,
    /// Gyroscope biases.
    pub gyro_s: f64,
    /// Temporal variation.
    pub fogm_s: f64,
}

impl TimeConstants {
    /// Decay rates, in 1/s, of the Gauss-Markov states, indexed by state; zero for the other states.
    pub fn decay_rates_per_s(&self) -> StateVector {
        let mut rates = [0.0; STATES];
        rates[ACC..GYRO].fill(1.0 / self.acc_s);
        rates[GYRO..HA].fill(1.0 / self.gyro_s);
        rates[HA] = 1.0 / self.baro_s;
        rates[S] = 1.0 / self.fogm_s;
        rates
    }
}

/// Form of the matrix F.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PinsonForm {
    /// Gnadt 2022, (5.16) to (5.32).
    #[default]
    Thesis,
    /// Form of MagNav.jl up to 1.3.3 and its MATLAB reference data, in which the effect of altitude on the north tilt
    /// is -ve²/R² instead of -ve/R². Use this form for comparison with MagNav.jl.
    Compatible,
}

/// Matrix F of dx/dt = F x at a point of the flight. [Gnadt 2022, (5.15)-(5.32)]
#[inline(always)]
pub fn pinson_matrix(ins: &InsPoint, times: &TimeConstants, form: PinsonForm) -> StateMatrix {
    let mut f = [[0.0; STATES]; STATES];
    let (sin_lat, cos_lat) = ins.lat_rad.sin_cos();
    let at = PinsonPoint { sin_lat, cos_lat, tan_lat: sin_lat / cos_lat, vel: ins.vel_ned_mps };
    at.position_rows(&mut f);
    at.velocity_rows(&mut f, ins.force_ned_mps2);
    at.tilt_rows(&mut f, form);
    let [roll, pitch, yaw] = ins.euler_rad;
    let rotation = body_to_ned(roll, pitch, yaw);
    for row in 0..3 {
        for column in 0..3 {
            f[VN + row][ACC + column] = rotation[(row, column)];
            f[TILT_N + row][GYRO + column] = -rotation[(row, column)];
        }
    }
    f[A_HAT][ALT] = K3;
    f[A_HAT][HA] = -K3;
    for (state, rate) in times.decay_rates_per_s().into_iter().enumerate() {
        f[state][state] -= rate;
    }
    f
}

/// Trigonometric functions of the latitude, and the velocity north, east, down.
struct PinsonPoint {
    sin_lat: f64,
    cos_lat: f64,
    tan_lat: f64,
    vel: [f64; 3],
}

const R: f64 = SEMI_MAJOR_AXIS_M;
const OMEGA: f64 = EARTH_RATE_RADPS;

impl PinsonPoint {
    #[inline(always)]
    fn position_rows(&self, f: &mut StateMatrix) {
        let [vn, ve, _] = self.vel;
        f[LAT][ALT] = -vn / (R * R);
        f[LAT][VN] = 1.0 / R;
        f[LON][LAT] = ve * self.tan_lat / (R * self.cos_lat);
        f[LON][ALT] = -ve / (R * R * self.cos_lat);
        f[LON][VE] = 1.0 / (R * self.cos_lat);
        f[ALT][ALT] = -K1;
        f[ALT][VD] = -1.0;
        f[ALT][HA] = K1;
    }

    #[inline(always)]
    fn velocity_rows(&self, f: &mut StateMatrix, force: [f64; 3]) {
        let ([vn, ve, vd], [fn_, fe, fd]) = (self.vel, force);
        let Self { sin_lat: s, cos_lat: c, tan_lat: t, .. } = *self;
        let (r2, secant_squared) = (R * R, 1.0 / (c * c));
        f[VN][LAT] = -ve * (2.0 * OMEGA * c + ve * secant_squared / R);
        f[VN][ALT] = (ve * ve * t - vn * vd) / r2;
        f[VN][VN] = vd / R;
        f[VN][VE] = -2.0 * (OMEGA * s + ve * t / R);
        f[VN][VD] = vn / R;
        f[VN][TILT_E] = -fd;
        f[VN][TILT_D] = fe;
        f[VE][LAT] = 2.0 * OMEGA * (vn * c - vd * s) + vn * ve * secant_squared / R;
        f[VE][ALT] = -ve * (vn * t + vd) / r2;
        f[VE][VN] = 2.0 * OMEGA * s + ve * t / R;
        f[VE][VE] = (vn * t + vd) / R;
        f[VE][VD] = 2.0 * OMEGA * c + ve / R;
        f[VE][TILT_N] = fd;
        f[VE][TILT_D] = -fn_;
        f[VD][LAT] = 2.0 * OMEGA * ve * s;
        f[VD][ALT] = (vn * vn + ve * ve) / r2 + K2;
        f[VD][VN] = -2.0 * vn / R;
        f[VD][VE] = -2.0 * (OMEGA * c + ve / R);
        f[VD][TILT_N] = -fe;
        f[VD][TILT_E] = fn_;
        f[VD][HA] = -K2;
        f[VD][A_HAT] = 1.0;
    }

    #[inline(always)]
    fn tilt_rows(&self, f: &mut StateMatrix, form: PinsonForm) {
        let [vn, ve, _] = self.vel;
        let Self { sin_lat: s, cos_lat: c, tan_lat: t, .. } = *self;
        let (r2, turn_down) = (R * R, OMEGA * s + ve * t / R);
        f[TILT_N][LAT] = -OMEGA * s;
        f[TILT_N][ALT] = match form {
            PinsonForm::Thesis => -ve / r2,
            PinsonForm::Compatible => -ve * ve / r2,
        };
        f[TILT_N][VE] = 1.0 / R;
        f[TILT_N][TILT_E] = -turn_down;
        f[TILT_N][TILT_D] = vn / R;
        f[TILT_E][ALT] = vn / r2;
        f[TILT_E][VN] = -1.0 / R;
        f[TILT_E][TILT_N] = turn_down;
        f[TILT_E][TILT_D] = OMEGA * c + ve / R;
        f[TILT_D][LAT] = -OMEGA * c - ve / (R * c * c);
        f[TILT_D][ALT] = ve * t / r2;
        f[TILT_D][VE] = -t / R;
        f[TILT_D][TILT_N] = -vn / R;
        f[TILT_D][TILT_E] = -OMEGA * c - ve / R;
    }
}

#[cfg(test)]
pub(crate) mod tests;

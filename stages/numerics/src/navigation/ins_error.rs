//! How wrong an inertial navigation system is: its error sources, and a simulation of them.

use crate::earth::geodesy::EarthModel;
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::pinson::{
    A_HAT, ACC, ALT, GYRO, HA, LAT, LON, PinsonForm, S, STATES, StateMatrix, StateVector, TILT_D, TILT_N,
    TimeConstants, VN, pinson_matrix,
};
use crate::navigation::transition::{NoiseDiscretisation, diagonal, propagate_state, transition_matrix};
use crate::signal::gauss_markov::GaussMarkov;
use thiserror::Error;

mod along;
mod driving;
mod grade;
mod mechanised;

pub use along::{InsErrorEnsemble, errors_along, horizontal_m};
pub use driving::Draws;
pub use grade::InsGrade;
pub use mechanised::{MechanisedExtras, mechanised_errors_along};

/// The error sources of an INS and of the field's temporal variation: initial uncertainties,
/// noise densities, correlation times. The defaults are MagNav.jl's (a navigation-grade INS).
/// [thesis 000 (5.35); MagNav.jl `create_model`]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InsErrorModel {
    /// Initial position uncertainty north and east, in m.
    pub init_position_sigma_m: f64,
    /// Initial altitude uncertainty, in m.
    pub init_altitude_sigma_m: f64,
    /// Initial velocity uncertainty of each component, in m/s.
    pub init_velocity_sigma_mps: f64,
    /// Initial tilt uncertainty about each axis, in degrees.
    pub init_attitude_sigma_deg: f64,
    /// Initial heading uncertainty, the tilt about the down axis, in degrees; `None` for that of the other axes. An INS
    /// levels itself by gravity and finds north by the earth's turning, which is far weaker.
    pub init_heading_sigma_deg: Option<f64>,
    /// Velocity random walk, in m/s^1.5.
    pub vrw_sigma: f64,
    /// Angular random walk, in rad/s^0.5.
    pub arw_sigma: f64,
    /// Standard deviation of the barometer's drift, in m.
    pub baro_sigma_m: f64,
    /// Initial uncertainty of the barometer-aiding altitude, in m.
    pub ha_sigma_m: f64,
    /// Initial uncertainty of the barometer-aiding vertical acceleration, in m/s².
    pub a_hat_sigma_mps2: f64,
    /// Standard deviation of each accelerometer's bias, in m/s².
    pub acc_sigma_mps2: f64,
    /// Standard deviation of each gyroscope's bias, in rad/s.
    pub gyro_sigma_radps: f64,
    /// Standard deviation of the temporal variation, in nT.
    pub fogm_sigma_nt: f64,
    /// Correlation time of the barometer's drift, in s.
    pub baro_tau_s: f64,
    /// Correlation time of the accelerometer biases, in s.
    pub acc_tau_s: f64,
    /// Correlation time of the gyroscope biases, in s.
    pub gyro_tau_s: f64,
    /// Correlation time of the temporal variation, in s.
    pub fogm_tau_s: f64,
    /// What turns metres into radians and back.
    pub earth: EarthModel,
    /// The form of the error model's matrix.
    pub pinson: PinsonForm,
    /// How a step's process noise is made.
    pub noise: NoiseDiscretisation,
}

impl Default for InsErrorModel {
    fn default() -> Self {
        Self {
            init_position_sigma_m: 3.0,
            init_altitude_sigma_m: 0.001,
            init_velocity_sigma_mps: 0.01,
            init_attitude_sigma_deg: 0.01,
            init_heading_sigma_deg: None,
            vrw_sigma: 0.000_238,
            arw_sigma: 0.000_000_581,
            baro_sigma_m: 1.0,
            ha_sigma_m: 0.001,
            a_hat_sigma_mps2: 0.01,
            acc_sigma_mps2: 0.000_245,
            gyro_sigma_radps: 0.000_000_007_27,
            fogm_sigma_nt: 3.0,
            baro_tau_s: 3600.0,
            acc_tau_s: 3600.0,
            gyro_tau_s: 3600.0,
            fogm_tau_s: 600.0,
            earth: EarthModel::default(),
            pinson: PinsonForm::default(),
            noise: NoiseDiscretisation::default(),
        }
    }
}

/// A parameter that makes no model.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("`{name}` is {value}; it must be {need}")]
pub struct ParameterError {
    /// The parameter.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// What it has to be.
    pub need: &'static str,
}

/// Why there is no simulation.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InsErrorFault {
    /// A parameter is out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The trajectory cannot be used.
    #[error(transparent)]
    Series(#[from] SeriesError),
}

impl InsErrorModel {
    /// The model with everything as MagNav.jl 1.3.3 computes it: its conversions, its element of
    /// the Pinson matrix, its process noise.
    pub fn compatible() -> Self {
        Self {
            earth: EarthModel::Compatible,
            pinson: PinsonForm::Compatible,
            noise: NoiseDiscretisation::Rectangular,
            ..Self::default()
        }
    }

    /// Refuses negative or missing uncertainties and time constants that are not positive.
    pub fn check(&self) -> Result<(), ParameterError> {
        let sigmas = [
            ("init_position_sigma_m", self.init_position_sigma_m),
            ("init_altitude_sigma_m", self.init_altitude_sigma_m),
            ("init_velocity_sigma_mps", self.init_velocity_sigma_mps),
            ("init_attitude_sigma_deg", self.init_attitude_sigma_deg),
            ("init_heading_sigma_deg", self.init_heading_sigma_deg.unwrap_or(self.init_attitude_sigma_deg)),
            ("vrw_sigma", self.vrw_sigma),
            ("arw_sigma", self.arw_sigma),
            ("baro_sigma_m", self.baro_sigma_m),
            ("ha_sigma_m", self.ha_sigma_m),
            ("a_hat_sigma_mps2", self.a_hat_sigma_mps2),
            ("acc_sigma_mps2", self.acc_sigma_mps2),
            ("gyro_sigma_radps", self.gyro_sigma_radps),
            ("fogm_sigma_nt", self.fogm_sigma_nt),
        ];
        let times = [
            ("baro_tau_s", self.baro_tau_s),
            ("acc_tau_s", self.acc_tau_s),
            ("gyro_tau_s", self.gyro_tau_s),
            ("fogm_tau_s", self.fogm_tau_s),
        ];
        for (name, value) in sigmas {
            require(name, value, "zero or a positive number", value >= 0.0)?;
        }
        for (name, value) in times {
            require(name, value, "a positive number of seconds", value > 0.0)?;
        }
        Ok(())
    }

    /// The correlation times of the Gauss-Markov states.
    pub fn time_constants(&self) -> TimeConstants {
        TimeConstants {
            baro_s: self.baro_tau_s,
            acc_s: self.acc_tau_s,
            gyro_s: self.gyro_tau_s,
            fogm_s: self.fogm_tau_s,
        }
    }

    /// Initial standard deviations of the states at a latitude (rad) and altitude (m).
    pub fn initial_sigmas(&self, lat_rad: f64, alt_m: f64) -> StateVector {
        let mut sigmas = [0.0; STATES];
        let position_m = self.init_position_sigma_m;
        sigmas[LAT] = self.earth.north_m_to_lat_rad(position_m, lat_rad, alt_m);
        sigmas[LON] = self.earth.east_m_to_lon_rad(position_m, lat_rad, alt_m);
        sigmas[ALT] = self.init_altitude_sigma_m;
        sigmas[VN..TILT_N].fill(self.init_velocity_sigma_mps);
        sigmas[TILT_N..ACC].fill(self.init_attitude_sigma_deg.to_radians());
        sigmas[TILT_D] = self.init_heading_sigma_deg.unwrap_or(self.init_attitude_sigma_deg).to_radians();
        sigmas[ACC..GYRO].fill(self.acc_sigma_mps2);
        sigmas[GYRO..HA].fill(self.gyro_sigma_radps);
        sigmas[HA] = self.ha_sigma_m;
        sigmas[A_HAT] = self.a_hat_sigma_mps2;
        sigmas[S] = self.fogm_sigma_nt;
        sigmas
    }

    /// The initial covariance P0, diagonal. [MagNav.jl `create_P0`]
    pub fn initial_covariance(&self, lat_rad: f64, alt_m: f64) -> StateMatrix {
        diagonal(&self.initial_sigmas(lat_rad, alt_m).map(|sigma| sigma * sigma))
    }

    /// Spectral densities of the driving noise, per second, the diagonal of Q. Position and
    /// vertical acceleration get 1e-30, as in MagNav.jl: nothing, but positive. [thesis 000 (5.35)]
    pub fn noise_density(&self) -> StateVector {
        let of = |sigma: f64, tau_s: f64| GaussMarkov { sigma, tau_s }.noise_density();
        let mut q = [1e-30; STATES];
        q[VN..TILT_N].fill(self.vrw_sigma * self.vrw_sigma);
        q[TILT_N..ACC].fill(self.arw_sigma * self.arw_sigma);
        q[ACC..GYRO].fill(of(self.acc_sigma_mps2, self.acc_tau_s));
        q[GYRO..HA].fill(of(self.gyro_sigma_radps, self.gyro_tau_s));
        q[HA] = of(self.baro_sigma_m, self.baro_tau_s);
        q[S] = of(self.fogm_sigma_nt, self.fogm_tau_s);
        q
    }
}

/// Accepts a finite parameter that satisfies a condition.
pub(super) fn require(name: &'static str, value: f64, need: &'static str, holds: bool) -> Result<(), ParameterError> {
    if value.is_finite() && holds { Ok(()) } else { Err(ParameterError { name, value, need }) }
}

/// One realisation of the error states along a true trajectory: what to take off the truth to get
/// the INS (INS = truth - error), and the temporal variation to add to the measurement.
///
/// The first error is drawn from the initial covariance; each step is e ← Φ (e + w₁) + w₂ with w₁
/// and w₂ half of the step's noise each, which is exactly the covariance that a filter with
/// [`NoiseDiscretisation::Trapezoidal`] assumes. `normal` hands out standard normals: 18 for the
/// first sample, 36 a step.
pub fn simulate_ins_error(
    truth: &InsSeries<'_>,
    model: &InsErrorModel,
    mut normal: impl FnMut() -> f64,
) -> Result<Vec<StateVector>, InsErrorFault> {
    model.check()?;
    truth.check()?;
    let (density, times) = (model.noise_density(), model.time_constants());
    let first = truth.point(0);
    let mut error = model.initial_sigmas(first.lat_rad, truth.alt_m[0]).map(|sigma| sigma * normal());
    let mut errors = Vec::with_capacity(truth.len());
    errors.push(error);
    for row in 1..truth.len() {
        let dt_s = truth.tt_s[row] - truth.tt_s[row - 1];
        let f = pinson_matrix(&truth.point(row - 1), &times, model.pinson);
        let phi = transition_matrix(&f, dt_s);
        let half = density.map(|density| (0.5 * density * dt_s).sqrt());
        add_noise(&mut error, &half, &mut normal);
        error = propagate_state(&phi, &error);
        add_noise(&mut error, &half, &mut normal);
        errors.push(error);
    }
    Ok(errors)
}

fn add_noise(error: &mut StateVector, sigmas: &StateVector, normal: &mut impl FnMut() -> f64) {
    for (error, sigma) in error.iter_mut().zip(sigmas) {
        *error += sigma * normal();
    }
}

#[cfg(test)]
mod ensemble_tests;
#[cfg(test)]
mod tests;

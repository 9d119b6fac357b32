//! Error sources of an inertial navigation system, and their simulation.

use crate::earth::geodesy::EarthModel;
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::pinson::{
    A_HAT, ACC, ALT, GYRO, HA, LAT, LON, PinsonForm, S, STATES, StateMatrix, StateVector, TILT_D, TILT_N,
    TimeConstants, VN, pinson_matrix,
};
use crate::navigation::transition::{NoiseDiscretisation, diagonal, propagate_state, transition_matrix};
use crate::signal::gauss_markov::GaussMarkov;
use params::{Fault, Params, Rule, obeys, params};
use thiserror::Error;

mod along;
mod driving;
mod faulty;
mod grade;
mod graded;
mod mechanised;
mod start;

pub use along::{InsErrorEnsemble, errors_along, horizontal_m};
pub use driving::NormalStreams;
pub use faulty::faulty_ins;
pub use grade::InsGrade;
pub use graded::InsErrorSpec;
pub use mechanised::{MechanisationErrors, mechanised_errors_along};
pub use start::{StartFix, StartFixSigmas, aligned_covariance, correction_along};

params! {
    /// Error sources of an INS: initial standard deviations, noise densities and time constants. The defaults are the
    /// values of MagNav.jl for a navigation-grade INS. [Gnadt 2022, (5.35); MagNav.jl `create_model`]
    pub struct InsErrors, all default;
    /// Standard deviation of the initial horizontal position error along each axis.
    init_position_sigma_m: f64, unit "m", default 3.0, rule Rule::NotNegative;
    /// Standard deviation of the initial height error.
    init_altitude_sigma_m: f64, unit "m", default 0.001, rule Rule::NotNegative;
    /// Standard deviation of the initial velocity error along each axis.
    init_velocity_sigma_mps: f64, unit "m/s", default 0.01, rule Rule::NotNegative;
    /// Standard deviation of the initial tilt error about each axis.
    init_attitude_sigma_deg: f64, unit "deg", default 0.01, rule Rule::NotNegative;
    /// Standard deviation of the initial yaw error, the tilt about the down axis. In practice, the yaw error exceeds
    /// the other tilt errors, because the INS finds north from the earth's rotation, a much weaker signal than gravity.
    init_heading_sigma_deg: Option<f64>, unit "deg", default None, absent "the initial tilt error",
        rule Rule::NotNegative;
    /// Velocity random walk: square root of the spectral density of the accelerometer noise.
    vrw_sigma: f64, unit "m/s^1.5", default 0.000238, rule Rule::NotNegative;
    /// Angular random walk: square root of the spectral density of the gyro noise.
    arw_sigma: f64, unit "rad/s^0.5", default 0.000000581, rule Rule::NotNegative;
    /// Standard deviation of the barometer error.
    baro_sigma_m: f64, unit "m", default 1.0, rule Rule::NotNegative;
    /// Standard deviation of the initial error of the altitude in the barometer loop, which aids the INS height.
    ha_sigma_m: f64, unit "m", default 0.001, rule Rule::NotNegative;
    /// Standard deviation of the initial error of the vertical acceleration in the barometer loop, which aids the INS
    /// height.
    a_hat_sigma_mps2: f64, unit "m/s2", default 0.01, rule Rule::NotNegative;
    /// Standard deviation of the accelerometer bias.
    acc_sigma_mps2: f64, unit "m/s2", default 0.000245, rule Rule::NotNegative;
    /// Standard deviation of the gyro bias.
    gyro_sigma_radps: f64, unit "rad/s", default 0.00000000727, rule Rule::NotNegative;
    /// Time constant of the barometer error.
    baro_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the accelerometer bias.
    acc_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the gyro bias.
    gyro_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
}

impl Copy for InsErrors {}

/// Error sources of an INS and of the field's temporal variation, and the form of the error model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InsErrorModel {
    /// Error sources of the INS.
    pub sources: InsErrors,
    /// Standard deviation of the temporal variation, in nT.
    pub fogm_sigma_nt: f64,
    /// Time constant of the temporal variation, in seconds.
    pub fogm_tau_s: f64,
    /// Earth model for conversions between metres and radians.
    pub earth: EarthModel,
    /// Form of the error model's matrix.
    pub pinson: PinsonForm,
    /// Discretisation of the process noise.
    pub noise: NoiseDiscretisation,
    /// Covariance of the states at the first sample, in rad, m, m/s, m/s², rad/s and nT. `None`: diagonal, from the
    /// initial standard deviations of `sources`. The variance of the temporal variation always comes from
    /// `fogm_sigma_nt`.
    pub start: Option<StateMatrix>,
}

impl Default for InsErrorModel {
    fn default() -> Self {
        Self::from_sources(InsErrors::default())
    }
}

/// Parameter out of range.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{}", .0.what)]
pub struct ParameterError(pub Fault);

/// Reason why a simulation fails.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InsErrorFault {
    /// A parameter is out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The trajectory is invalid.
    #[error(transparent)]
    Series(#[from] SeriesError),
}

impl InsErrorModel {
    /// Error model of these error sources, with MagNav.jl's temporal variation.
    pub fn from_sources(sources: InsErrors) -> Self {
        Self {
            sources,
            fogm_sigma_nt: 3.0,
            fogm_tau_s: 600.0,
            earth: EarthModel::default(),
            pinson: PinsonForm::default(),
            noise: NoiseDiscretisation::default(),
            start: None,
        }
    }

    /// Error model as in MagNav.jl 1.3.3: its conversions, its element of the Pinson matrix, its process noise.
    pub fn compatible() -> Self {
        Self {
            earth: EarthModel::Compatible,
            pinson: PinsonForm::Compatible,
            noise: NoiseDiscretisation::Rectangular,
            ..Self::default()
        }
    }

    /// Rejects negative or missing uncertainties and time constants that are not positive.
    ///
    /// # Errors
    /// Fails for the first parameter that is not finite or out of its valid range.
    pub fn check(&self) -> Result<(), ParameterError> {
        self.sources.check().map_err(ParameterError)?;
        require("fogm_sigma_nt", self.fogm_sigma_nt, Rule::NotNegative)?;
        require("fogm_tau_s", self.fogm_tau_s, Rule::Positive)
    }

    /// Correlation times of the Gauss-Markov states.
    pub fn time_constants(&self) -> TimeConstants {
        TimeConstants {
            baro_s: self.sources.baro_tau_s,
            acc_s: self.sources.acc_tau_s,
            gyro_s: self.sources.gyro_tau_s,
            fogm_s: self.fogm_tau_s,
        }
    }

    /// Initial standard deviations of the states at a latitude (rad) and altitude (m).
    pub fn initial_sigmas(&self, lat_rad: f64, alt_m: f64) -> StateVector {
        let mut sigmas = [0.0; STATES];
        let position_m = self.sources.init_position_sigma_m;
        sigmas[LAT] = self.earth.north_m_to_lat_rad(position_m, lat_rad, alt_m);
        sigmas[LON] = self.earth.east_m_to_lon_rad(position_m, lat_rad, alt_m);
        sigmas[ALT] = self.sources.init_altitude_sigma_m;
        sigmas[VN..TILT_N].fill(self.sources.init_velocity_sigma_mps);
        sigmas[TILT_N..ACC].fill(self.sources.init_attitude_sigma_deg.to_radians());
        sigmas[TILT_D] =
            self.sources.init_heading_sigma_deg.unwrap_or(self.sources.init_attitude_sigma_deg).to_radians();
        sigmas[ACC..GYRO].fill(self.sources.acc_sigma_mps2);
        sigmas[GYRO..HA].fill(self.sources.gyro_sigma_radps);
        sigmas[HA] = self.sources.ha_sigma_m;
        sigmas[A_HAT] = self.sources.a_hat_sigma_mps2;
        sigmas[S] = self.fogm_sigma_nt;
        sigmas
    }

    /// Initial covariance P0: [`InsErrorModel::start`], or diagonal. [MagNav.jl `create_P0`]
    pub fn initial_covariance(&self, lat_rad: f64, alt_m: f64) -> StateMatrix {
        match self.start {
            Some(mut start) => {
                start[S] = [0.0; STATES];
                start.iter_mut().for_each(|row| row[S] = 0.0);
                start[S][S] = self.fogm_sigma_nt * self.fogm_sigma_nt;
                start
            }
            None => diagonal(&self.initial_sigmas(lat_rad, alt_m).map(|sigma| sigma * sigma)),
        }
    }

    /// Spectral densities of the driving noise, per second: the diagonal of Q. Position and vertical acceleration have
    /// 1e-30, as in MagNav.jl: negligible, but positive. [Gnadt 2022, (5.35)]
    pub fn noise_density(&self) -> StateVector {
        let of = |sigma: f64, tau_s: f64| GaussMarkov { sigma, tau_s }.noise_density();
        let mut q = [1e-30; STATES];
        q[VN..TILT_N].fill(self.sources.vrw_sigma * self.sources.vrw_sigma);
        q[TILT_N..ACC].fill(self.sources.arw_sigma * self.sources.arw_sigma);
        q[ACC..GYRO].fill(of(self.sources.acc_sigma_mps2, self.sources.acc_tau_s));
        q[GYRO..HA].fill(of(self.sources.gyro_sigma_radps, self.sources.gyro_tau_s));
        q[HA] = of(self.sources.baro_sigma_m, self.sources.baro_tau_s);
        q[S] = of(self.fogm_sigma_nt, self.fogm_tau_s);
        q
    }
}

/// Rejects a parameter that violates a rule.
pub(super) fn require(name: &'static str, value: f64, rule: Rule) -> Result<(), ParameterError> {
    obeys(&value, name, rule).map_err(ParameterError)
}

/// One realisation of the error states along a true trajectory (INS = truth - error), with the temporal variation of
/// the measurement.
///
/// The first error is drawn from the initial covariance. Each step is e ← Φ (e + w₁) + w₂, where w₁ and w₂ each have
/// half of the step's noise. The covariance of the errors is exactly that of a filter with
/// [`NoiseDiscretisation::Trapezoidal`]. `normal` returns standard normals: 18 for the first sample, 36 per step.
///
/// # Errors
/// Returns the errors of [`InsErrorModel::check`] and [`InsSeries::check`].
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

//! Filters of navigation fed sample by sample.

use std::{collections::BTreeMap, sync::Arc};

use numerics::{
    earth::core_field::CoreField,
    maps::{FieldMap, GeographicGrid, MapInterpolation, MapSurface},
    navigation::{
        InsErrorModel,
        adaptive::AdaptiveParameters,
        online::{CoefficientPrior, OnlineParameters},
        stream::{self, InsSample, PositionFix, StreamEstimate, StreamMagnetometer, StreamSample, StreamSetup},
    },
};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::{prelude::*, types::PyBytes};

use crate::faults::value_error;

/// A filter that takes one sample at a time.
#[pyclass(module = "magline._magline")]
pub struct FilterStream(stream::FilterStream);

/// Error sources by name, in the units that the names contain. Other sources keep their defaults.
fn error_model(given: &BTreeMap<String, f64>) -> PyResult<InsErrorModel> {
    let mut errors = InsErrorModel::default();
    for (name, value) in given {
        let sources = &mut errors.sources;
        let place = match name.as_str() {
            "init_position_sigma_m" => &mut sources.init_position_sigma_m,
            "init_altitude_sigma_m" => &mut sources.init_altitude_sigma_m,
            "init_velocity_sigma_mps" => &mut sources.init_velocity_sigma_mps,
            "init_attitude_sigma_deg" => &mut sources.init_attitude_sigma_deg,
            "init_heading_sigma_deg" => sources.init_heading_sigma_deg.get_or_insert(0.0),
            "vrw_sigma" => &mut sources.vrw_sigma,
            "arw_sigma" => &mut sources.arw_sigma,
            "baro_sigma_m" => &mut sources.baro_sigma_m,
            "ha_sigma_m" => &mut sources.ha_sigma_m,
            "a_hat_sigma_mps2" => &mut sources.a_hat_sigma_mps2,
            "acc_sigma_mps2" => &mut sources.acc_sigma_mps2,
            "gyro_sigma_radps" => &mut sources.gyro_sigma_radps,
            "baro_tau_s" => &mut sources.baro_tau_s,
            "acc_tau_s" => &mut sources.acc_tau_s,
            "gyro_tau_s" => &mut sources.gyro_tau_s,
            "fogm_sigma_nt" => &mut errors.fogm_sigma_nt,
            "fogm_tau_s" => &mut errors.fogm_tau_s,
            _ => return Err(value_error(format!("`errors` has no key `{name}`"))),
        };
        *place = *value;
    }
    Ok(errors)
}

/// Latitudes and longitudes of a map, its anomaly, the date of the core field if the measurements contain it, error
/// sources, and the longest step between two samples.
type SetupArguments<'py> = (
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray2<'py, f64>,
    Option<f64>,
    BTreeMap<String, f64>,
    f64,
);

fn setup(
    (lat_deg, lon_deg, anomaly_nt, decimal_year, errors, max_gap_s): &SetupArguments<'_>,
) -> PyResult<StreamSetup> {
    let grid = GeographicGrid::new(lat_deg.as_slice()?, lon_deg.as_slice()?, anomaly_nt.as_slice()?);
    let surface = MapSurface::new(&grid.map_err(value_error)?, MapInterpolation::Cubic);
    let core = decimal_year.map(CoreField::at).transpose().map_err(value_error)?.map(Arc::new);
    let (errors, max_gap_s) = (error_model(errors)?, *max_gap_s);
    Ok(StreamSetup { core, errors, max_gap_s, ..StreamSetup::new(Arc::new(FieldMap::Flat(surface))) })
}

#[pymethods]
impl FilterStream {
    /// `ekf`.
    #[staticmethod]
    #[pyo3(signature = (arguments, gate_nis))]
    fn ekf(arguments: SetupArguments<'_>, gate_nis: Option<f64>) -> PyResult<Self> {
        stream::FilterStream::ekf(&setup(&arguments)?, gate_nis).map(Self).map_err(value_error)
    }

    /// The filter `ekf_adaptive`, with the bounds of the noise of each magnetometer in nT, and the length of the
    /// window.
    #[staticmethod]
    #[pyo3(signature = (arguments, gate_nis, bounds_nt, window))]
    fn adaptive(
        arguments: SetupArguments<'_>,
        gate_nis: Option<f64>,
        bounds_nt: Vec<[f64; 2]>,
        window: usize,
    ) -> PyResult<Self> {
        let setup = setup(&arguments)?;
        let parameters = AdaptiveParameters { window, gate_nis, ..AdaptiveParameters::default() };
        stream::FilterStream::adaptive(&setup, &parameters, &bounds_nt).map(Self).map_err(value_error)
    }

    /// The filter `ekf_online_tl`, with the mean, the standard deviation and the random-walk density of each
    /// coefficient.
    #[staticmethod]
    #[pyo3(signature = (arguments, gate_nis, magnetometers))]
    fn online(
        arguments: SetupArguments<'_>,
        gate_nis: Option<f64>,
        magnetometers: Vec<(Vec<f64>, Vec<f64>, Vec<f64>)>,
    ) -> PyResult<Self> {
        let setup = setup(&arguments)?;
        if magnetometers.iter().any(|(mean, sigma, _)| mean.len() != sigma.len()) {
            return Err(value_error("the means and standard deviations of a magnetometer have different lengths"));
        }
        let prior = |(mean, sigma, _): &(Vec<f64>, Vec<f64>, Vec<f64>)| CoefficientPrior::independent(mean, sigma);
        let priors: Vec<CoefficientPrior> = magnetometers.iter().map(prior).collect();
        let all: Vec<StreamMagnetometer<'_>> = priors
            .iter()
            .zip(&magnetometers)
            .map(|(prior, (_, _, walk_density))| StreamMagnetometer { prior, walk_density })
            .collect();
        let parameters = OnlineParameters { gate_nis, ..OnlineParameters::default() };
        stream::FilterStream::online(&setup, &all, &parameters).map(Self).map_err(value_error)
    }

    /// Filters a sample. `ins` is in the order of the columns of an INS; `fix` is latitude, longitude, height and their
    /// standard deviations, horizontal and vertical. Returns time, position, velocity, standard deviations and
    /// covariance of the position, residual and NIS.
    #[pyo3(signature = (ins, measurement_nt, sigma_nt, terms, fix))]
    fn push(
        &mut self,
        ins: [f64; 13],
        measurement_nt: Vec<f64>,
        sigma_nt: Vec<f64>,
        terms: Vec<f64>,
        fix: Option<[f64; 5]>,
    ) -> PyResult<[f64; 12]> {
        let [tt_s, lat_deg, lon_deg, alt_m, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw] = ins;
        let ins = InsSample {
            tt_s,
            lat_deg,
            lon_deg,
            alt_m,
            velocity_ned_mps: [vn, ve, vd],
            force_ned_mps2: [force_n, force_e, force_d],
            attitude_deg: [roll, pitch, yaw],
        };
        let fix = fix.map(|[lat_deg, lon_deg, alt_m, horizontal_sigma_m, vertical_sigma_m]| PositionFix {
            lat_deg,
            lon_deg,
            alt_m,
            horizontal_sigma_m,
            vertical_sigma_m,
        });
        let sample = StreamSample { ins, measurement_nt: &measurement_nt, sigma_nt: &sigma_nt, terms: &terms, fix };
        let at = self.0.push(&sample).map_err(value_error)?;
        let [vn, ve, vd] = at.velocity_ned_mps;
        let StreamEstimate { tt_s, lat_deg, lon_deg, alt_m, sd_n_m, sd_e_m, cov_ne_m2, residual_nt, nis, .. } = at;
        Ok([tt_s, lat_deg, lon_deg, alt_m, vn, ve, vd, sd_n_m, sd_e_m, cov_ne_m2, residual_nt, nis])
    }

    /// Coefficients of all magnetometers, and their standard deviations.
    fn coefficients(&self) -> (Vec<f64>, Vec<f64>) {
        let (values, sigma) = self.0.coefficients();
        (values.to_vec(), sigma.to_vec())
    }

    /// State as bytes.
    fn save<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.save())
    }

    /// Resumes from a state.
    fn restore(&mut self, state: &[u8]) -> PyResult<()> {
        self.0.restore(state).map_err(value_error)
    }
}

//! Metrics of errors on arrays.

use numerics::regression::statistics::{self, SampleStatistic, quantile};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

type Column<'py> = PyReadonlyArray1<'py, f64>;

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(drms, module)?)?;
    module.add_function(wrap_pyfunction!(radius, module)?)?;
    module.add_function(wrap_pyfunction!(rms, module)?)?;
    module.add_function(wrap_pyfunction!(standard_deviation, module)?)?;
    module.add_function(wrap_pyfunction!(improvement_ratio, module)?)?;
    module.add_function(wrap_pyfunction!(signal_to_noise, module)?)?;
    module.add_function(wrap_pyfunction!(position_nees, module)?)
}

fn value(found: SampleStatistic) -> f64 {
    found.value
}

/// Distance root mean square, in metres.
#[pyfunction]
fn drms(north_m: Column<'_>, east_m: Column<'_>) -> PyResult<f64> {
    Ok(value(statistics::drms(north_m.as_slice()?, east_m.as_slice()?)))
}

/// Radius, in metres, that contains the fraction `part` of the samples.
#[pyfunction]
fn radius(north_m: Column<'_>, east_m: Column<'_>, part: f64) -> PyResult<f64> {
    let mut radii: Vec<f64> = north_m.as_slice()?.iter().zip(east_m.as_slice()?).map(|(n, e)| n.hypot(*e)).collect();
    radii.retain(|radius| radius.is_finite());
    radii.sort_by(f64::total_cmp);
    Ok(quantile(&radii, part))
}

/// Root mean square.
#[pyfunction]
fn rms(x: Column<'_>) -> PyResult<f64> {
    Ok(value(statistics::rms(x.as_slice()?)))
}

/// Standard deviation of a sample, with the divisor n - 1.
#[pyfunction(name = "std")]
fn standard_deviation(x: Column<'_>) -> PyResult<f64> {
    Ok(value(statistics::std(x.as_slice()?)))
}

/// Improvement ratio of compensation.
#[pyfunction]
fn improvement_ratio(uncompensated: Column<'_>, compensated: Column<'_>) -> PyResult<f64> {
    Ok(value(statistics::improvement_ratio(uncompensated.as_slice()?, compensated.as_slice()?)))
}

/// Signal-to-noise ratio of a magnetic measurement.
#[pyfunction]
fn signal_to_noise(estimate: Column<'_>, truth: Column<'_>, anomaly: Column<'_>) -> PyResult<f64> {
    Ok(value(statistics::signal_to_noise(estimate.as_slice()?, truth.as_slice()?, anomaly.as_slice()?)))
}

/// Normalised estimation error squared of the horizontal position, at each sample.
#[pyfunction]
fn position_nees<'py>(
    py: Python<'py>,
    north_m: Column<'py>,
    east_m: Column<'py>,
    sd_n_m: Column<'py>,
    sd_e_m: Column<'py>,
    cov_ne_m2: Column<'py>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (sd_n, sd_e, cov_ne) = (sd_n_m.as_slice()?, sd_e_m.as_slice()?, cov_ne_m2.as_slice()?);
    let nees = statistics::position_nees(north_m.as_slice()?, east_m.as_slice()?, sd_n, sd_e, cov_ne);
    Ok(PyArray1::from_vec(py, nees))
}

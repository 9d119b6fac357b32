//! The earth's core field on arrays.

use numerics::earth::core_field::{CoreFieldModel, CoreFieldTrack};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::faults::value_error;

/// A component of the field at each position.
type Component<'py> = Bound<'py, PyArray1<f64>>;

/// North, east and down components, in nT, at geodetic positions and dates of equal length. `wmm` selects the World
/// Magnetic Model instead of IGRF-14.
#[pyfunction]
pub fn core_field<'py>(
    py: Python<'py>,
    lat_deg: PyReadonlyArray1<'py, f64>,
    lon_deg: PyReadonlyArray1<'py, f64>,
    alt_m: PyReadonlyArray1<'py, f64>,
    decimal_year: PyReadonlyArray1<'py, f64>,
    wmm: bool,
) -> PyResult<(Component<'py>, Component<'py>, Component<'py>)> {
    let (lat, lon, alt, year) = (lat_deg.as_slice()?, lon_deg.as_slice()?, alt_m.as_slice()?, decimal_year.as_slice()?);
    let model = if wmm { CoreFieldModel::Wmm } else { CoreFieldModel::Igrf14 };
    let field = py.detach(|| CoreFieldTrack::new(model).field(lat, lon, alt, year)).map_err(value_error)?;
    let array = |values: Vec<f64>| PyArray1::from_vec(py, values);
    Ok((array(field.north_nt), array(field.east_nt), array(field.down_nt)))
}

//! Anomaly maps on arrays: rows ascend to the north, columns to the east.

use std::path::PathBuf;

use datasets::{MapOptions, read_grid};
use numerics::maps::{
    continuation::{self, MapSpectrum, Padding},
    magnetic_sources::direction,
    plane_grid::{EvenAxis, PlaneGrid},
};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use schemas::Fault;

use crate::faults::{exception, value_error};

type Matrix<'py> = Bound<'py, PyArray2<f64>>;
type Column<'py> = Bound<'py, PyArray1<f64>>;
/// Eastings, northings, anomaly, heights, EPSG code, and unit of the coordinates of a map.
type MapParts<'py> = (Column<'py>, Column<'py>, Matrix<'py>, Matrix<'py>, u16, &'static str);

/// A map continued upward by `dz_m`, with the padding of the stage `map_continue`. Spacings are of rows and columns.
#[pyfunction]
pub fn upward<'py>(
    py: Python<'py>,
    grid: PyReadonlyArray2<'py, f64>,
    spacing_m: [f64; 2],
    dz_m: f64,
) -> PyResult<Matrix<'py>> {
    let (plane, shape) = plane(&grid, spacing_m)?;
    let raised = py.detach(|| continuation::upward(&plane, dz_m, &Padding::default())).map_err(value_error)?;
    PyArray1::from_vec(py, raised.values).reshape(shape)
}

/// A map on a plane, and its numbers of rows and columns.
fn plane(grid: &PyReadonlyArray2<'_, f64>, spacing_m: [f64; 2]) -> PyResult<(PlaneGrid, [usize; 2])> {
    let (rows, columns) = grid.as_array().dim();
    let axis = |len, step| EvenAxis { first: 0.0, step, len };
    let (north_m, east_m) = (axis(rows, spacing_m[0]), axis(columns, spacing_m[1]));
    Ok((PlaneGrid { north_m, east_m, values: grid.as_slice()?.to_vec() }, [rows, columns]))
}

/// North, east and down components of the field of a map of the total-field anomaly, and whether they are damped
/// because the core field is nearly horizontal. Rows run to the north.
#[pyfunction]
pub fn vector<'py>(
    py: Python<'py>,
    grid: PyReadonlyArray2<'py, f64>,
    spacing_m: [f64; 2],
    inclination_deg: f64,
    declination_deg: f64,
) -> PyResult<(Matrix<'py>, Matrix<'py>, Matrix<'py>, bool)> {
    let (plane, shape) = plane(&grid, spacing_m)?;
    let along = direction(inclination_deg, declination_deg);
    let made = || MapSpectrum::new(&plane, 0.0, &Padding::default())?.components(along, 0.0, 0.0);
    let found = py.detach(made).map_err(value_error)?;
    let matrix = |values: Vec<f64>| PyArray1::from_vec(py, values).reshape(shape);
    let down = found.up.values.iter().map(|up| -up).collect();
    Ok((matrix(found.north.values)?, matrix(found.east.values)?, matrix(down)?, found.damped))
}

/// A map file on its native grid. `epsg`, `alt_m` and `unit` override the file.
#[pyfunction]
#[pyo3(signature = (path, epsg, alt_m, unit))]
pub fn open_map<'py>(
    py: Python<'py>,
    path: PathBuf,
    epsg: Option<u16>,
    alt_m: Option<f64>,
    unit: Option<String>,
) -> PyResult<MapParts<'py>> {
    let options = MapOptions { epsg, alt_m, unit, ..MapOptions::default() };
    let map = py.detach(|| read_grid(&path, &options)).map_err(|e| exception(py, &Fault::from(e)))?;
    let shape = [map.y.len, map.x.len];
    let heights = PyArray1::from_vec(py, map.heights()).reshape(shape)?;
    let unit = map.unit();
    Ok((
        PyArray1::from_vec(py, map.x.coordinates()),
        PyArray1::from_vec(py, map.y.coordinates()),
        PyArray1::from_vec(py, map.anomaly_nt).reshape(shape)?,
        heights,
        map.crs.code(),
        unit,
    ))
}

//! Anomaly maps on arrays: rows ascend to the north, columns to the east.

use std::path::PathBuf;

use datasets::{MapOptions, read_grid};
use numerics::maps::{
    continuation::{self, Padding},
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
    let shape = grid.as_array().dim();
    let axis = |len, step| EvenAxis { first: 0.0, step, len };
    let plane = PlaneGrid {
        north_m: axis(shape.0, spacing_m[0]),
        east_m: axis(shape.1, spacing_m[1]),
        values: grid.as_slice()?.to_vec(),
    };
    let raised = py.detach(|| continuation::upward(&plane, dz_m, &Padding::default())).map_err(value_error)?;
    PyArray1::from_vec(py, raised.values).reshape([shape.0, shape.1])
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

//! Anomaly maps on arrays: rows ascend to the north, columns to the east.

use std::path::PathBuf;

use arrow_array::RecordBatch;
use datasets::{AnomalyGrid, Crs, GridHeight, MapOptions, read_grid};
use numerics::maps::{
    continuation::{self, MapSpectrum, Padding},
    magnetic_sources::direction,
    plane_grid::{EvenAxis, PlaneGrid},
};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use schemas::Fault;

use crate::faults::{exception, value_error};

type Matrix<'py> = Bound<'py, PyArray2<f64>>;
type Column<'py> = Bound<'py, PyArray1<f64>>;
/// Eastings, northings, anomaly, heights, EPSG code, unit of the coordinates, error of each node, and spacings of a
/// map.
type MapParts<'py> =
    (Column<'py>, Column<'py>, Matrix<'py>, Matrix<'py>, u16, &'static str, Option<Matrix<'py>>, [f64; 2]);

/// Eastings, northings, anomaly, heights, EPSG code, error of each node, and spacings of a map. Spacings that do not
/// reproduce the coordinates are replaced by mean spacings.
#[derive(FromPyObject)]
pub struct MapArrays<'py>(
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray2<'py, f64>,
    u16,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<[f64; 2]>,
);

/// Largest deviation of a coordinate from even spacing, as a fraction of the spacing.
const UNEVEN: f64 = 1e-4;

impl MapArrays<'_> {
    /// The map as stages read it from its file.
    ///
    /// # Errors
    /// Fails for coordinates that are not evenly spaced, or for arrays that are not a map.
    pub fn table(&self, py: Python<'_>) -> PyResult<RecordBatch> {
        let Self(x, y, anomaly_nt, alt_m, epsg, error_nt, steps) = self;
        let (x, y) =
            (axis(x.as_slice()?, steps.map(|[x, _]| x), "x")?, axis(y.as_slice()?, steps.map(|[_, y]| y), "y")?);
        let alt_m = alt_m.as_slice()?;
        let level_m = alt_m.first().copied().unwrap_or(f64::NAN);
        let is_level = alt_m.iter().all(|alt| *alt == level_m || alt.is_nan() && level_m.is_nan());
        let height = if is_level { GridHeight::Level(level_m) } else { GridHeight::Cells(alt_m.to_vec()) };
        let error_nt = error_nt.as_ref().map(|error| error.as_slice().map(<[f64]>::to_vec)).transpose()?;
        let anomaly_nt = anomaly_nt.as_slice()?.to_vec();
        let table = || {
            let crs = Crs::from_epsg(&PathBuf::from("map"), *epsg)?;
            let map = AnomalyGrid::new(x, y, crs, anomaly_nt, height)?;
            AnomalyGrid { error_nt, ..map }.table()
        };
        table().map_err(|e| exception(py, &Fault::from(e)))
    }
}

/// Axis of evenly spaced coordinates.
fn axis(coordinates: &[f64], step: Option<f64>, name: &str) -> PyResult<EvenAxis> {
    let (Some(first), Some(last), len) = (coordinates.first(), coordinates.last(), coordinates.len()) else {
        return Err(value_error(format!("the map has no coordinates `{name}`")));
    };
    let of_step = |step: f64| EvenAxis { first: *first, step, len };
    if let Some(axis) = step.map(of_step).filter(|axis| axis.coordinates() == coordinates) {
        return Ok(axis);
    }
    let mean = of_step((last - first) / (len.max(2) - 1) as f64);
    let even = |(node, x): (usize, &f64)| (mean.at(node as f64) - x).abs() <= UNEVEN * mean.step.abs();
    if !coordinates.iter().enumerate().all(even) {
        return Err(value_error(format!("the coordinates `{name}` of the map are not evenly spaced")));
    }
    Ok(mean)
}

/// A map continued upward by `dz_m`, with the padding of the stage `map_continue`. `spacing_m` is the spacing of the
/// rows and the spacing of the columns.
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

/// North, east and down components of the anomalous field, from a map of the total-field anomaly, and whether the
/// components are damped because the core field is nearly horizontal. Rows run to the north.
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
    let steps = [map.x.step, map.y.step];
    let error_nt = map.error_nt.map(|error| PyArray1::from_vec(py, error).reshape(shape)).transpose()?;
    Ok((
        PyArray1::from_vec(py, map.x.coordinates()),
        PyArray1::from_vec(py, map.y.coordinates()),
        PyArray1::from_vec(py, map.anomaly_nt).reshape(shape)?,
        heights,
        map.crs.code(),
        unit,
        error_nt,
        steps,
    ))
}

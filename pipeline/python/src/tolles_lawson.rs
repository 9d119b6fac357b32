//! The Tolles-Lawson model on arrays.

use std::{borrow::Cow, ops::Range};

use numerics::{
    compensation::tolles_lawson::{BodyFieldColumns, TermSelection, matrix_in_runs},
    regression::{
        least_squares::{ColumnScaling, LinearFit, MomentsAccumulator, RegressionMoments},
        statistics,
    },
    signal::{
        filter::{ConstantColumns, FilterBand, ZeroPhaseFilter},
        segments::{RowMask, STEP_TOLERANCE, filter_matrix, sample_rate},
    },
};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::faults::value_error;

type Column<'py> = PyReadonlyArray1<'py, f64>;

/// Names of the terms in `groups`, in the order of the columns of the matrix.
#[pyfunction]
pub fn term_names(groups: Vec<String>) -> PyResult<Vec<&'static str>> {
    Ok(TermSelection::new(&groups).map_err(value_error)?.names())
}

/// The Tolles-Lawson matrix, one row per sample and one column per term. Differences do not cross gaps of `tt_s`.
#[pyfunction]
#[pyo3(signature = (x, y, z, groups, scalar, tt_s, bt_scale_nt))]
#[allow(clippy::too_many_arguments)] // those of the Python function
pub fn a_matrix<'py>(
    py: Python<'py>,
    x: Column<'py>,
    y: Column<'py>,
    z: Column<'py>,
    groups: Vec<String>,
    scalar: Option<Column<'py>>,
    tt_s: Option<Column<'py>>,
    bt_scale_nt: f64,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let terms = TermSelection::new(&groups).map_err(value_error)?;
    let bt = scalar.as_ref().map(|column| column.as_slice()).transpose()?;
    let field = BodyFieldColumns { x: x.as_slice()?, y: y.as_slice()?, z: z.as_slice()?, bt };
    let tt_s = tt_s.as_ref().map(|column| column.as_slice()).transpose()?;
    let rows = field.x.len();
    let runs = runs_of([field.x, field.y, field.z], tt_s)?;
    let values = matrix_in_runs(&field, &terms, bt_scale_nt, &runs).map_err(value_error)?;
    PyArray1::from_vec(py, values).reshape([rows, terms.len()])
}

/// Runs of samples with a finite vector and without a gap in time. There are no runs if the lengths of the columns
/// differ.
fn runs_of(vector: [&[f64]; 3], tt_s: Option<&[f64]>) -> PyResult<Vec<Range<usize>>> {
    let rows = vector[0].len();
    if vector.iter().any(|column| column.len() != rows) {
        return Ok(vec![]);
    }
    if let Some(tt) = tt_s.filter(|tt| tt.len() != rows) {
        return Err(value_error(format!("`tt` has {} samples, but the vector has {rows}", tt.len())));
    }
    split(vector.iter().fold(RowMask::all(rows), |mask, column| mask.and_finite(column)), tt_s)
}

/// Runs of the rows that a mask selects, without a gap of `tt_s`.
fn split(rows: RowMask, tt_s: Option<&[f64]>) -> PyResult<Vec<Range<usize>>> {
    let Some(tt) = tt_s else { return Ok(rows.runs()) };
    let rate_hz = sample_rate(tt, STEP_TOLERANCE).map_err(value_error)?;
    Ok(rows.runs_in_time(tt, rate_hz))
}

/// Filter of a fit.
#[derive(Clone, Copy, FromPyObject)]
pub struct FitFilter {
    #[pyo3(item)]
    rate_hz: f64,
    #[pyo3(item)]
    low_hz: Option<f64>,
    #[pyo3(item)]
    high_hz: Option<f64>,
    #[pyo3(item)]
    order: usize,
    /// Number of samples that are removed at both ends of a run.
    #[pyo3(item)]
    trim: usize,
}

/// Ridge fit of `y` to the columns of `a` without a constant. Returns the coefficients, the standard deviation of the
/// residual, the condition number and the number of rows. Rows with a value that is not finite are excluded; such rows
/// and the gaps of `tt_s` end a run of the filter.
#[pyfunction]
#[pyo3(signature = (a, y, lambda, filter, tt_s))]
pub fn fit<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    y: Column<'py>,
    lambda: f64,
    filter: Option<FitFilter>,
    tt_s: Option<Column<'py>>,
) -> PyResult<(Bound<'py, PyArray1<f64>>, f64, f64, usize)> {
    let terms = a.as_array().ncols();
    let (a, y) = (a.as_slice()?, y.as_slice()?);
    if terms == 0 || a.len() != y.len() * terms {
        let rows = a.len() / terms.max(1);
        return Err(value_error(format!("`a` has {rows} rows and {terms} columns, but `y` has {}", y.len())));
    }
    let tt_s = tt_s.as_ref().map(|column| column.as_slice()).transpose()?;
    if let Some(tt) = tt_s.filter(|tt| tt.len() != y.len()) {
        return Err(value_error(format!("`tt` has {} samples, but `y` has {}", tt.len(), y.len())));
    }
    let runs = split(RowMask::all(y.len()).and_finite(y).and_finite_rows(a, terms), tt_s)?;
    let moments = py.detach(|| moments_of(a, y, &runs, filter))?;
    let names: Vec<String> = (0..terms).map(|i| format!("column {i}")).collect();
    let prepared = moments.prepare(ColumnScaling::None, false).map_err(value_error)?;
    let path = prepared.ridge(&[lambda], &names).map_err(value_error)?;
    let solution = path.solutions.into_iter().next().ok_or_else(|| value_error("the fit has no solution"))?;
    let coefficients = solution.coefficients.into_iter().next().unwrap_or_default();
    let residual_std = solution.residual_variances.first().map_or(f64::NAN, |variance| variance.sqrt());
    Ok((PyArray1::from_vec(py, coefficients), residual_std, path.condition, path.rows))
}

/// Moments of the filtered and trimmed rows, accumulated run by run as in the stage `fit`.
fn moments_of(a: &[f64], y: &[f64], runs: &[Range<usize>], filter: Option<FitFilter>) -> PyResult<RegressionMoments> {
    let terms = a.len() / y.len().max(1);
    let (mut a, mut y) = (Cow::Borrowed(a), Cow::Borrowed(y));
    let (mut least, mut trim) = (1, 0);
    if let Some(filter) = filter {
        let band = FilterBand::between(filter.low_hz, filter.high_hz).map_err(value_error)?;
        let design = ZeroPhaseFilter::new(band, filter.rate_hz, filter.order).map_err(value_error)?;
        (least, trim) = (design.least_rows().max(2 * filter.trim + 1), filter.trim);
        filter_matrix(&design, a.to_mut(), terms, runs, ConstantColumns::Keep).map_err(value_error)?;
        filter_matrix(&design, y.to_mut(), 1, runs, ConstantColumns::Filter).map_err(value_error)?;
    }
    let mut moments = MomentsAccumulator::new(terms, 1);
    for run in runs.iter().filter(|run| run.len() >= least) {
        let kept = run.start + trim..run.end - trim;
        moments.push(&a[kept.start * terms..kept.end * terms], &[&y[kept]]).map_err(value_error)?;
    }
    Ok(moments.finish())
}

/// The field of a model at each row of `a`. With `detrend`, the mean of the field is subtracted.
#[pyfunction]
pub fn predict<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    coefficients: Column<'py>,
    detrend: bool,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let coefficients = coefficients.as_slice()?.to_vec();
    let terms = a.as_array().ncols();
    if coefficients.len() != terms {
        let given = coefficients.len();
        return Err(value_error(format!("`a` has {terms} columns, but there are {given} coefficients")));
    }
    let mut field = LinearFit { coefficients, intercept: 0.0 }.predict(a.as_slice()?);
    if detrend {
        let mean = statistics::mean(&field).value;
        field.iter_mut().for_each(|x| *x -= mean);
    }
    Ok(PyArray1::from_vec(py, field))
}

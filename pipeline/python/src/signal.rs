//! Filters on arrays.

use std::ops::Range;

use numerics::signal::{
    filter::{FilterBand, ZeroPhaseFilter},
    segments::{RowMask, STEP_TOLERANCE, filter_column, sample_rate},
};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::faults::value_error;

/// Zero-phase Butterworth filter of `x`, applied separately to each run of samples. `tt_s` gives the rate and the gaps;
/// without it, `rate_hz` is the rate, and only values that are not finite end a run.
#[pyfunction]
#[pyo3(signature = (x, tt_s, rate_hz, low_hz, high_hz, order))]
pub fn bandpass<'py>(
    py: Python<'py>,
    x: PyReadonlyArray1<'py, f64>,
    tt_s: Option<PyReadonlyArray1<'py, f64>>,
    rate_hz: f64,
    low_hz: Option<f64>,
    high_hz: Option<f64>,
    order: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let x = x.as_slice()?;
    let (rate_hz, runs) = match &tt_s {
        Some(tt) => timed_runs(x, tt.as_slice()?)?,
        None => (rate_hz, RowMask::all(x.len()).and_finite(x).runs()),
    };
    let band = FilterBand::between(low_hz, high_hz).map_err(value_error)?;
    let filter = ZeroPhaseFilter::new(band, rate_hz, order).map_err(value_error)?;
    let (y, report) = py.detach(|| filter_column(&filter, x, &runs)).map_err(value_error)?;
    if report.rows == 0 {
        let least = filter.least_rows();
        return Err(value_error(format!("no run of finite samples is long enough for the filter ({least} samples)")));
    }
    Ok(PyArray1::from_vec(py, y))
}

/// Sample rate, in Hz, and the runs of finite samples without a gap in time.
fn timed_runs(x: &[f64], tt_s: &[f64]) -> PyResult<(f64, Vec<Range<usize>>)> {
    if x.len() != tt_s.len() {
        return Err(value_error(format!("`x` has {} samples, but `tt` has {}", x.len(), tt_s.len())));
    }
    let rate_hz = sample_rate(tt_s, STEP_TOLERANCE).map_err(value_error)?;
    Ok((rate_hz, RowMask::all(x.len()).and_finite(x).runs_in_time(tt_s, rate_hz)))
}

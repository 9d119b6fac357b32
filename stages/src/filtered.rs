//! Zero-phase filters over the columns of a line, run by run.

use arrow_array::RecordBatch;
use numerics::{
    angle::unwrapped_deg,
    signal::{
        filter::ZeroPhaseFilter,
        resample::AngleRange,
        segments::{RowMask, filter_column},
    },
};
use schemas::{Fault, LineOutput};

use crate::columns::{array, data, even_rate_hz, floats, is_angle};

/// Treatment of angles (unit deg).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleTreatment {
    /// Values are unchanged: a crossing of north is a step of 360 degrees.
    AsNumbers,
    /// Unwrapped, filtered, and wrapped back into their original range.
    Unwrapped,
}

/// Columns of a line, each filtered run by run with the filter that `design` returns for the sample rate. A gap ends a
/// run. A run shorter than the filter's padding becomes NaN.
///
/// # Errors
/// Fails if samples are not evenly spaced, the filter cannot be designed, or a column has no run that is long enough.
pub fn filtered(
    batch: &RecordBatch,
    columns: &[String],
    angles: AngleTreatment,
    design: impl FnOnce(f64) -> Result<ZeroPhaseFilter, Fault>,
) -> LineOutput {
    let tt = floats(batch, "tt")?;
    let rate_hz = even_rate_hz(tt)?;
    let filter = design(rate_hz)?;
    let one = |name: &String| {
        let x = floats(batch, name)?;
        let runs = RowMask::all(x.len()).and_finite(x).runs_in_time(tt, rate_hz);
        let turned = (angles == AngleTreatment::Unwrapped && is_angle(batch, name)).then(|| unwrapped_deg(x));
        let values = turned.as_deref().unwrap_or(x);
        let (mut y, report) = filter_column(&filter, values, &runs).map_err(|e| data(e).in_column(name))?;
        if report.rows == 0 {
            let what = format!("no run of samples is long enough for the filter ({} samples)", filter.least_rows());
            return Err(Fault::data(what).in_column(name));
        }
        if turned.is_some() {
            let range = AngleRange::from_degrees(x);
            y.iter_mut().filter(|y| y.is_finite()).for_each(|y| *y = range.wrap(*y));
        }
        Ok(array(y))
    };
    columns.iter().map(one).collect()
}

//! Low-pass filter that precedes resampling to a lower rate.

use crate::signal::filter::{FilterBand, FilterError, ZeroPhaseFilter};
use crate::signal::segments::{GapFilterReport, RowMask, STEP_TOLERANCE, TimeError, filter_column, sample_rate};

/// Corner of the low-pass as a fraction of half of the new rate.
pub const ANTI_ALIAS_FRACTION: f64 = 0.8;

/// Order of the low-pass: both passes together attenuate by 31 dB at half of the new rate.
pub const ANTI_ALIAS_ORDER: usize = 8;

/// Error of an anti-alias filter.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AntiAliasError {
    /// The samples are not evenly spaced, but a filter requires even spacing.
    #[error(transparent)]
    Time(#[from] TimeError),
    /// The filter cannot be designed or applied.
    #[error(transparent)]
    Filter(#[from] FilterError),
}

/// Removes the components of `x` that resampling to `rate_hz` would alias to lower frequencies. Applies a zero-phase
/// low-pass at 0.8 of half of the new rate to the evenly spaced samples at times `tt`.
///
/// Each run between gaps (NaN, or missing samples) is filtered separately. A run shorter than the filter's padding
/// becomes NaN and is counted. If the corner is not below half of the present rate, nothing is removed and the report
/// contains no rows. Angles must be unwrapped first.
///
/// # Errors
/// Fails with [`TimeError::Lengths`] for columns of different lengths. Also returns the errors of [`sample_rate`], and
/// of [`ZeroPhaseFilter::new`] for a new rate that is not above 0 Hz or too low for the filter.
pub fn anti_alias(tt: &[f64], x: &[f64], rate_hz: f64) -> Result<(Vec<f64>, GapFilterReport), AntiAliasError> {
    if x.len() != tt.len() {
        return Err(TimeError::Lengths { given: x.len(), expected: tt.len() }.into());
    }
    let present_hz = sample_rate(tt, STEP_TOLERANCE)?;
    let high_hz = ANTI_ALIAS_FRACTION * rate_hz / 2.0;
    if high_hz >= present_hz / 2.0 {
        return Ok((x.to_vec(), GapFilterReport::default()));
    }
    let filter = ZeroPhaseFilter::new(FilterBand::Low { high_hz }, present_hz, ANTI_ALIAS_ORDER)?;
    let runs = RowMask::all(x.len()).and_finite(x).runs_in_time(tt, present_hz);
    Ok(filter_column(&filter, x, &runs)?)
}

//! Columns for linear models, made of attitudes, inputs, fields and positions.
//!
//! Columns come back one by one, each with one value a sample; those of a group have their names beside them.
//! Differences are per sample and stay within `runs` of samples without a jump of time; samples outside all runs
//! are NaN where a difference is needed.

pub mod attitude;
pub mod field;
pub mod inputs;
pub mod principal;

use std::ops::Range;

use super::difference::{Scheme, difference};
use super::filter::{Band, FilterError, ZeroPhase};

/// What is wrong with a request for columns.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FeatureError {
    /// Series of different lengths.
    #[error("{what} has {given} samples where the others have {expected}")]
    Length {
        /// Which series.
        what: &'static str,
        /// How many samples it has.
        given: usize,
        /// How many the first series has.
        expected: usize,
    },
    /// No attitude feature has this name.
    #[error("there is no feature of the attitude called `{name}`; there are {}", attitude::names().join(", "))]
    Unknown {
        /// The name that was given.
        name: String,
    },
    /// A number is out of its range.
    #[error("{what} must be {wanted}, and it is {given}")]
    Setting {
        /// Which number.
        what: &'static str,
        /// Its range.
        wanted: &'static str,
        /// What was given.
        given: f64,
    },
}

/// Named columns, each with one value a sample.
pub type Columns = Vec<(String, Vec<f64>)>;

fn same_length(what: &'static str, given: usize, expected: usize) -> Result<(), FeatureError> {
    if given == expected { Ok(()) } else { Err(FeatureError::Length { what, given, expected }) }
}

/// The differences of `x` per sample within each run, in its unit: [`difference`] of each, NaN in runs too short for the
/// scheme and outside all runs. [`Scheme::Fourth`] gives MagNav.jl's `_dot4`.
pub fn difference_in_runs(x: &[f64], scheme: Scheme, runs: &[Range<usize>]) -> Vec<f64> {
    let mut out = vec![f64::NAN; x.len()];
    for run in runs {
        let run = run.start.min(x.len())..run.end.min(x.len()).max(run.start.min(x.len()));
        if let Some(change) = difference(&x[run.clone()], scheme) {
            out[run].copy_from_slice(&change);
        }
    }
    out
}

/// `x` as it was `samples` earlier, within each run; a run's first samples, which have nothing earlier, keep their own
/// value, as MagNav.jl's `_lag_1` to `_lag_3`.
pub fn lagged(x: &[f64], samples: usize, runs: &[Range<usize>]) -> Vec<f64> {
    let mut out = x.to_vec();
    for run in runs {
        let (start, end) = (run.start.min(x.len()), run.end.min(x.len()));
        if start + samples < end {
            out[start + samples..end].copy_from_slice(&x[start..end - samples]);
        }
    }
    out
}

/// A current (or any input) without what is faster than `corner_hz`, without lag, within each run; NaN outside. MagNav.jl's
/// `lpf_cur_*` have a corner of 0.2 Hz and order 4. A run too short for the filter is an error.
pub fn low_passed(
    x: &[f64],
    rate_hz: f64,
    corner_hz: f64,
    order: usize,
    runs: &[Range<usize>],
) -> Result<Vec<f64>, FilterError> {
    let filter = ZeroPhase::new(Band::Low { high_hz: corner_hz }, rate_hz, order)?;
    let mut out = vec![f64::NAN; x.len()];
    for run in runs {
        let run = run.start.min(x.len())..run.end.min(x.len()).max(run.start.min(x.len()));
        out[run.clone()].copy_from_slice(&filter.apply(&x[run.clone()]).map_err(|e| e.further_down(run.start))?);
    }
    Ok(out)
}

/// The differences between pairs of scalar magnetometers, in nT: MagNav.jl's `mag_i_j_uc`, a gradiometer. A target that is the
/// same in all magnetometers cancels.
pub fn pairwise(series: &[(&str, &[f64])]) -> Result<Columns, FeatureError> {
    let rows = series.first().map_or(0, |(_, x)| x.len());
    let mut out = Vec::new();
    for (i, (one, x)) in series.iter().enumerate() {
        same_length("a series", x.len(), rows)?;
        for (other, y) in &series[i + 1..] {
            same_length("a series", y.len(), rows)?;
            out.push((format!("{one} - {other}"), x.iter().zip(*y).map(|(x, y)| x - y).collect()));
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests;

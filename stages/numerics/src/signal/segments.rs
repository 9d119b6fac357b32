//! Runs of usable samples: the runs between the gaps of a line are processed separately.
//!
//! A filter has memory, so a single NaN would affect the rest of the line (and, backwards, its beginning). Every run of
//! finite, selected, evenly spaced samples is therefore filtered separately. Samples outside all runs remain NaN; a run
//! too short for the filter's padding becomes NaN and is counted.

use std::ops::Range;

use crate::signal::filter::{ConstantColumns, FilterError, ZeroPhaseFilter};

/// Error of a time column.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TimeError {
    /// Fewer than two samples.
    #[error("a sample rate requires at least 2 samples, but there are {rows}")]
    TooShort {
        /// The number of samples.
        rows: usize,
    },
    /// A time is NaN or infinite.
    #[error("the time in row {row} is not finite")]
    NotFinite {
        /// The row, from 0.
        row: usize,
    },
    /// A time is not later than the previous one.
    #[error("the time in row {row} ({tt} s) is not later than the previous one ({before} s)")]
    NotIncreasing {
        /// The row, from 0.
        row: usize,
        /// Time, in seconds.
        tt: f64,
        /// Time of the previous row, in seconds.
        before: f64,
    },
    /// A step differs from the median step but is not a gap.
    #[error(
        "the samples are not evenly spaced: row {row} (at {tt} s) is {step_s} s after the previous \
         row, but most steps are {usual_s} s; resample first"
    )]
    Uneven {
        /// The row, from 0.
        row: usize,
        /// Time, in seconds.
        tt: f64,
        /// Time since the previous row, in seconds.
        step_s: f64,
        /// The median step, in seconds.
        usual_s: f64,
    },
    /// A column and the time column have different lengths.
    #[error("a column has {given} rows, but the time has {expected}")]
    Lengths {
        /// The number of rows of the column.
        given: usize,
        /// The number of rows of the time column.
        expected: usize,
    },
}

/// Maximum deviation of a time step from the median, as a fraction of the median, for evenly spaced samples. The
/// tolerance exceeds the rounding of times to a millisecond at 10 Hz and is well below the step of a missing sample.
pub const STEP_TOLERANCE: f64 = 0.01;

/// Minimum step of a gap, in median steps. Missing samples end a run but are not an error of the clock.
pub const GAP_STEPS: f64 = 1.5;

/// Fails unless times are finite and strictly increasing.
///
/// # Errors
/// Fails with [`TimeError::NotFinite`] for the first time that is not finite, otherwise with
/// [`TimeError::NotIncreasing`] for the first time that is not later than the previous one.
pub fn check_increasing(tt: &[f64]) -> Result<(), TimeError> {
    if let Some(row) = tt.iter().position(|tt| !tt.is_finite()) {
        return Err(TimeError::NotFinite { row });
    }
    match tt.windows(2).position(|pair| pair[1] <= pair[0]) {
        None => Ok(()),
        Some(before) => Err(TimeError::NotIncreasing { row: before + 1, tt: tt[before + 1], before: tt[before] }),
    }
}

/// The sample rate in Hz of times in seconds: one over the median step.
///
/// Gaps of at least [`GAP_STEPS`] are allowed. Any other step may differ from the median by at most the fraction
/// `tolerance` of the median (default [`STEP_TOLERANCE`]). A larger difference is rejected with its row, because a
/// filter assumes even spacing. Logs with a coarse clock (20 ms samples stamped to the millisecond) need a larger
/// tolerance or, better, a resampling first. The rounding of the times themselves (16 units in the last place) is
/// always allowed.
///
/// # Errors
/// Returns the errors of [`check_increasing`]. Also fails with [`TimeError::TooShort`] for fewer than two samples, or
/// with [`TimeError::Uneven`] for a step that is not a gap and differs from the median by more than the tolerance.
pub fn sample_rate(tt: &[f64], tolerance: f64) -> Result<f64, TimeError> {
    check_increasing(tt)?;
    let mut steps: Vec<f64> = tt.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if steps.is_empty() {
        return Err(TimeError::TooShort { rows: tt.len() });
    }
    let middle = (steps.len() - 1) / 2;
    let usual_s = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    for (before, pair) in tt.windows(2).enumerate() {
        let (step_s, rounding) = (pair[1] - pair[0], 16.0 * f64::EPSILON * pair[1].abs());
        let even = (step_s - usual_s).abs() <= tolerance * usual_s + rounding;
        if !even && step_s < GAP_STEPS * usual_s {
            return Err(TimeError::Uneven { row: before + 1, tt: pair[1], step_s, usual_s });
        }
    }
    Ok(nearest_round(usual_s))
}

/// Reciprocal of a step. If a round number of hertz is within the rounding of the times, that number is returned, so
/// that all lines of a flight have the same filter.
fn nearest_round(step_s: f64) -> f64 {
    let rate_hz = 1.0 / step_s;
    let round = (rate_hz * 1000.0).round() / 1000.0;
    if (rate_hz - round).abs() <= 1e-6 * rate_hz { round } else { rate_hz }
}

/// Mask of the usable rows of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RowMask(Vec<bool>);

impl RowMask {
    /// Mask of `rows` usable rows.
    pub fn all(rows: usize) -> Self {
        Self(vec![true; rows])
    }

    /// The rows selected by `keep`.
    pub fn selected(keep: &[bool]) -> Self {
        Self(keep.to_vec())
    }

    /// Excludes rows where `column` is not finite.
    pub fn and_finite(mut self, column: &[f64]) -> Self {
        for (usable, value) in self.0.iter_mut().zip(column) {
            *usable &= value.is_finite();
        }
        self
    }

    /// Excludes rows of a row-major matrix that contain a value that is not finite.
    pub fn and_finite_rows(mut self, values: &[f64], columns: usize) -> Self {
        for (usable, row) in self.0.iter_mut().zip(values.chunks_exact(columns.max(1))) {
            *usable &= row.iter().all(|value| value.is_finite());
        }
        self
    }

    /// One entry per row.
    pub fn rows(&self) -> &[bool] {
        &self.0
    }

    /// The runs of consecutive usable rows.
    pub fn runs(&self) -> Vec<Range<usize>> {
        self.runs_between(|_| false)
    }

    /// The runs of consecutive usable rows whose times are `1 / rate_hz` apart: a step of
    /// [`GAP_STEPS`] or more, or a negative one, ends a run.
    pub fn runs_in_time(&self, tt: &[f64], rate_hz: f64) -> Vec<Range<usize>> {
        let longest_s = GAP_STEPS / rate_hz;
        self.runs_between(|row| match (tt.get(row - 1), tt.get(row)) {
            (Some(before), Some(now)) => !(now - before > 0.0 && now - before < longest_s),
            _ => true,
        })
    }

    fn runs_between(&self, breaks_before: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for (row, _) in self.0.iter().enumerate().filter(|(_, usable)| **usable) {
            match runs.last_mut() {
                Some(run) if run.end == row && !breaks_before(row) => run.end = row + 1,
                _ => runs.push(row..row + 1),
            }
        }
        runs
    }
}

/// Report on filtering a line with gaps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GapFilterReport {
    /// The number of runs that were filtered.
    pub runs: usize,
    /// The number of rows in the filtered runs.
    pub rows: usize,
    /// The number of runs that were too short for the filter and became NaN.
    pub short_runs: usize,
    /// The number of rows in these runs.
    pub short_rows: usize,
    /// The number of rows outside all runs: not finite, or not selected.
    pub missing_rows: usize,
}

impl GapFilterReport {
    /// The number of rows that have no result.
    pub fn left_out(&self) -> usize {
        self.short_rows + self.missing_rows
    }

    fn over(total: usize, runs: &[Range<usize>], least: usize) -> Self {
        let mut report = Self::default();
        for run in runs {
            let (runs, rows) = if run.len() < least {
                (&mut report.short_runs, &mut report.short_rows)
            } else {
                (&mut report.runs, &mut report.rows)
            };
            *runs += 1;
            *rows += run.len();
        }
        report.missing_rows = total - report.rows - report.short_rows;
        report
    }
}

/// Filters each run of one column separately. The result is NaN outside the runs and in runs that are too short.
///
/// `runs` are in order, do not overlap, and contain finite values only, as [`RowMask::runs`] of the
/// same column returns them.
///
/// # Errors
/// Fails with [`FilterError::NotFinite`] for a value that is not finite in a filtered run.
pub fn filter_column(
    filter: &ZeroPhaseFilter,
    x: &[f64],
    runs: &[Range<usize>],
) -> Result<(Vec<f64>, GapFilterReport), FilterError> {
    let mut out = x.to_vec();
    let report = filter_matrix(filter, &mut out, 1, runs, ConstantColumns::Filter)?;
    Ok((out, report))
}

/// Filters each run of a row-major matrix separately, in place. Whole rows are NaN outside the runs and in runs that
/// are too short. `runs` is as in [`filter_column`].
///
/// # Errors
/// Fails with [`FilterError::Shape`] for no columns or values that are not a whole number of rows, or with
/// [`FilterError::NotFinite`] for a value that is not finite in a filtered run.
pub fn filter_matrix(
    filter: &ZeroPhaseFilter,
    values: &mut [f64],
    columns: usize,
    runs: &[Range<usize>],
    constant: ConstantColumns,
) -> Result<GapFilterReport, FilterError> {
    if columns == 0 || !values.len().is_multiple_of(columns) {
        return Err(FilterError::Shape { values: values.len(), columns });
    }
    let rows = values.len() / columns;
    let report = GapFilterReport::over(rows, runs, filter.least_rows());
    let mut done = 0;
    for run in runs.iter().filter(|run| run.len() >= filter.least_rows()) {
        values[done * columns..run.start * columns].fill(f64::NAN);
        let part = &mut values[run.start * columns..run.end * columns];
        filter.apply_matrix(part, columns, constant).map_err(|error| error.further_down(run.start))?;
        done = run.end;
    }
    values[done * columns..].fill(f64::NAN);
    Ok(report)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::signal::filter::FilterBand;

    fn filter() -> ZeroPhaseFilter {
        let band = FilterBand::Band { low_hz: 0.1, high_hz: 0.9 };
        ZeroPhaseFilter::new(band, 10.0, 4).unwrap()
    }

    fn wave(rows: usize) -> Vec<f64> {
        (0..rows).map(|k| 50_000.0 + 30.0 * (0.2 * k as f64).sin()).collect()
    }

    #[test]
    fn unit_runs_around_a_gap_are_filtered_independently() {
        let mut x = wave(300);
        x[100] = f64::NAN;
        x[101] = f64::INFINITY;
        let runs = RowMask::all(300).and_finite(&x).runs();
        assert_eq!(runs, [0..100, 102..300]);
        let (y, report) = filter_column(&filter(), &x, &runs).unwrap();
        assert_eq!(y[..100], filter().apply(&x[..100]).unwrap());
        assert_eq!(y[102..], filter().apply(&x[102..]).unwrap());
        assert!(y[100].is_nan() && y[101].is_nan());
        assert_eq!((report.runs, report.rows, report.missing_rows), (2, 298, 2));
        assert_eq!(report.left_out(), 2);
    }

    #[test]
    fn unit_a_run_too_short_for_the_padding_becomes_nan_and_is_counted() {
        let x = wave(200);
        // 25 samples are the minimum for a padding of 24.
        let (y, report) = filter_column(&filter(), &x, &[0..24, 30..55, 60..200]).unwrap();
        assert!(y[..30].iter().all(|y| y.is_nan()));
        assert!(y[30..55].iter().all(|y| y.is_finite()));
        assert!(y[55..60].iter().all(|y| y.is_nan()));
        assert_eq!((report.short_runs, report.short_rows, report.missing_rows), (1, 24, 11));
        assert_eq!((report.runs, report.rows), (2, 165));
    }

    #[test]
    fn unit_a_matrix_is_filtered_as_its_columns() {
        let (one, other) = (wave(120), (0..120).map(|k| (k as f64).sqrt()).collect::<Vec<_>>());
        let mut both: Vec<f64> = one.iter().zip(&other).flat_map(|(a, b)| [*a, *b]).collect();
        let runs = [3..50, 60..120];
        filter_matrix(&filter(), &mut both, 2, &runs, ConstantColumns::Filter).unwrap();
        for (j, x) in [one, other].iter().enumerate() {
            let (y, _) = filter_column(&filter(), x, &runs).unwrap();
            let column = both.iter().skip(j).step_by(2);
            assert!(y.iter().zip(column).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
    }

    #[test]
    fn unit_selection_finiteness_and_time_jumps_break_runs() {
        let keep = [true, true, false, true, true, true, true, true];
        let matrix = [0.0, 1.0, 2.0, 3.0, 4.0, f64::NAN, 6.0, 7.0];
        let tt = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.9];
        let usable = RowMask::selected(&keep).and_finite_rows(&matrix, 1);
        assert_eq!(usable.runs(), [0..2, 3..5, 6..8]);
        assert_eq!(usable.runs_in_time(&tt, 10.0), [0..2, 3..5, 6..7, 7..8]);
        assert!(!usable.rows()[5]);
    }

    #[test]
    fn unit_the_rate_is_found_despite_rounding_and_gaps() {
        let mut tt: Vec<f64> = (0..1000).map(|k| 50_000.0 + 0.1 * f64::from(k)).collect();
        assert_eq!(sample_rate(&tt, STEP_TOLERANCE), Ok(10.0));
        tt.drain(300..350);
        assert_eq!(sample_rate(&tt, STEP_TOLERANCE), Ok(10.0));
        let odd: Vec<f64> = (0..50).map(|k| f64::from(k) / 7.3333).collect();
        assert!((sample_rate(&odd, 0.0).unwrap() - 7.3333).abs() < 1e-9);
    }

    #[test]
    fn unit_uneven_repeated_and_backward_times_are_rejected_by_row() {
        let mut tt: Vec<f64> = (0..100).map(|k| 0.1 * f64::from(k)).collect();
        tt[40] += 0.002;
        assert!(matches!(sample_rate(&tt, STEP_TOLERANCE), Err(TimeError::Uneven { row: 40, .. })));
        assert_eq!(sample_rate(&tt, 0.05), Ok(10.0));
        tt[40] = tt[39];
        let message = check_increasing(&tt).unwrap_err().to_string();
        assert!(message.contains("row 40"), "{message}");
        tt[7] = f64::NAN;
        assert_eq!(check_increasing(&tt), Err(TimeError::NotFinite { row: 7 }));
        assert_eq!(sample_rate(&[1.0], 0.01), Err(TimeError::TooShort { rows: 1 }));
    }

    #[test]
    fn unit_a_value_that_is_not_finite_is_reported_by_its_row_of_the_line() {
        let mut x = wave(100);
        x[70] = f64::NAN;
        let run = 10..100;
        let error = filter_column(&filter(), &x, &[run]).unwrap_err();
        assert_eq!(error, FilterError::NotFinite { row: 70, column: 0 });
    }
}

//! Zero-phase Butterworth filters, which remove components outside a band without delay.
//!
//! A filter is run forwards and then backwards over the samples, so that the phase cancels and the gain is squared. At
//! a corner, where one pass has a gain of 1/√2, half of the amplitude remains. At each end the series is first extended
//! by [`ZeroPhaseFilter::padding`] samples of its odd reflection (the series rotated by half a turn about its end
//! sample). Each pass starts in the steady state for its first sample, so that the result for a constant series is
//! constant from the first sample. [Gustafsson 1996, "Determining the initial states in forward-backward filtering",
//! IEEE Trans. Signal Processing 44(4)]
//!
//! The padding is six samples per second-order section, as in MagNav.jl (24 for a band-pass of order 4, 12 for a low-
//! or high-pass of order 4). scipy's `sosfiltfilt` does the same with `padlen=24`; its default of 27 changes the first
//! and last samples by some hundredths of a nanotesla.

mod butterworth;
mod cascade;
mod notch;

pub use butterworth::{BiquadSection, FilterBand};
use cascade::BiquadCascade;
pub use notch::alias_hz;

/// Error of the design or application of a filter.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// The sample rate is not a positive number.
    #[error("the sample rate must be above 0 Hz, but is {rate_hz} Hz")]
    Rate {
        /// The given rate, in Hz.
        rate_hz: f64,
    },
    /// The order is outside 1 to 12.
    #[error("the order of a Butterworth filter must be 1 to 12, but is {order}")]
    Order {
        /// The given order.
        order: usize,
    },
    /// A corner is zero, negative or not a number.
    #[error(
        "a corner frequency must be above 0 Hz, but is {corner_hz} Hz; \
         omit the corner for a filter without that edge"
    )]
    CornerNotPositive {
        /// The given corner, in Hz.
        corner_hz: f64,
    },
    /// A corner is at or above the Nyquist frequency.
    #[error(
        "the corner of {corner_hz} Hz is not below the Nyquist frequency of {nyquist_hz} Hz at the sample \
         rate of {rate_hz} Hz"
    )]
    CornerAboveNyquist {
        /// The given corner, in Hz.
        corner_hz: f64,
        /// The Nyquist frequency: half of the sample rate, in Hz.
        nyquist_hz: f64,
        /// The sample rate, in Hz.
        rate_hz: f64,
    },
    /// The lower corner is not below the upper one.
    #[error("the lower corner of {low_hz} Hz is not below the upper corner of {high_hz} Hz")]
    CornersCrossed {
        /// The lower corner, in Hz.
        low_hz: f64,
        /// The upper corner, in Hz.
        high_hz: f64,
    },
    /// Both the lower and the upper corner are missing.
    #[error("a filter requires a lower corner, an upper corner, or both")]
    NoCorner,
    /// The corners are so close to zero, Nyquist or each other that rounding places the poles on the unit circle.
    #[error(
        "a filter of order {order} with these corners ({band}) at {rate_hz} Hz cannot be represented in \
         double precision; move the corners apart, or reduce the order or the sample rate"
    )]
    Unstable {
        /// The order.
        order: usize,
        /// The band, as text.
        band: String,
        /// The sample rate, in Hz.
        rate_hz: f64,
    },
    /// The series is not longer than the padding.
    #[error("{rows} samples are too few for this filter; at least {needed} are required")]
    TooShort {
        /// The number of samples.
        rows: usize,
        /// The minimum number of samples.
        needed: usize,
    },
    /// A value is NaN or infinite.
    #[error("the value in row {row}, column {column} is not finite; filter the runs between gaps")]
    NotFinite {
        /// The row, from 0.
        row: usize,
        /// The column, from 0.
        column: usize,
    },
    /// The number of values is not a whole number of rows.
    #[error("{values} values are not a whole number of rows of {columns} columns")]
    Shape {
        /// The number of values.
        values: usize,
        /// The number of columns.
        columns: usize,
    },
}

impl FilterError {
    /// Returns the error with the row number increased by `rows`.
    pub(super) fn further_down(self, rows: usize) -> Self {
        match self {
            Self::NotFinite { row, column } => Self::NotFinite { row: row + rows, column },
            other => other,
        }
    }
}

/// Treatment of a column whose values are all equal.
///
/// A band-pass or high-pass of a constant is zero, which would remove a bias column from a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ConstantColumns {
    /// Filters the constant column like any other column.
    #[default]
    Filter,
    /// Leaves the constant column unchanged, as MagNav.jl does for the columns of a matrix.
    Keep,
}

/// A zero-phase filter, Butterworth or [notch](Self::notches), designed once and applied to many columns.
#[derive(Debug, Clone, PartialEq)]
pub struct ZeroPhaseFilter {
    cascade: BiquadCascade,
    padding: usize,
}

impl ZeroPhaseFilter {
    /// Designs a filter of `order` 1 to 12 for samples at `rate_hz`.
    ///
    /// A band-pass of order n has n second-order sections (2n poles); a low- or high-pass has half as many.
    ///
    /// # Errors
    /// Fails for a sample rate that is not a finite number above 0, an order outside 1 to 12, a corner that is not
    /// above 0 Hz and below the Nyquist frequency, or a lower corner that is not below the upper one. Fails with
    /// [`FilterError::Unstable`] for corners whose filter cannot be represented in double precision.
    pub fn new(band: FilterBand, rate_hz: f64, order: usize) -> Result<Self, FilterError> {
        let (gain, sections) = butterworth::design(band, rate_hz, order)?;
        let padding = 6 * sections.len();
        Ok(Self { cascade: BiquadCascade::new(gain, sections), padding })
    }

    /// The second-order sections of one pass, poles nearest the origin first.
    pub fn sections(&self) -> &[BiquadSection] {
        self.cascade.sections()
    }

    /// The gain that one pass applies before its first section.
    pub fn gain(&self) -> f64 {
        self.cascade.gain()
    }

    /// Number of samples of odd reflection before and after a series: six per section for a Butterworth filter.
    pub fn padding(&self) -> usize {
        self.padding
    }

    /// The minimum number of samples that can be filtered: the padding plus 1.
    pub fn least_rows(&self) -> usize {
        self.padding() + 1
    }

    /// Filters one evenly sampled series; the result has the same unit and length.
    ///
    /// # Errors
    /// Fails with [`FilterError::TooShort`] for fewer samples than [`Self::least_rows`], or with
    /// [`FilterError::NotFinite`] for a sample that is not finite.
    pub fn apply(&self, x: &[f64]) -> Result<Vec<f64>, FilterError> {
        let mut out = x.to_vec();
        self.apply_matrix(&mut out, 1, ConstantColumns::Filter)?;
        Ok(out)
    }

    /// Filters several series of the same length; the results have the same units and lengths.
    ///
    /// # Errors
    /// Fails with [`FilterError::Shape`] for series of different lengths. Also returns the errors of [`Self::apply`].
    pub fn apply_columns(&self, columns: &[&[f64]]) -> Result<Vec<Vec<f64>>, FilterError> {
        let (width, rows) = (columns.len(), columns.first().map_or(0, |x| x.len()));
        if let Some(odd) = columns.iter().find(|column| column.len() != rows) {
            return Err(FilterError::Shape { values: odd.len(), columns: width });
        }
        if columns.is_empty() {
            return Ok(Vec::new());
        }
        let mut matrix = Vec::with_capacity(rows * width);
        for row in 0..rows {
            matrix.extend(columns.iter().map(|column| column[row]));
        }
        self.apply_matrix(&mut matrix, width, ConstantColumns::Filter)?;
        let column = |j: usize| matrix.iter().skip(j).step_by(width).copied().collect();
        Ok((0..width).map(column).collect())
    }

    /// Filters each column of a row-major matrix (`values.len() / columns` rows) in place.
    ///
    /// The result of each column is bit-identical whichever other columns the matrix contains. On an error the contents
    /// of the matrix are unspecified.
    ///
    /// # Errors
    /// Fails with [`FilterError::Shape`] for no columns or values that are not a whole number of rows, with
    /// [`FilterError::TooShort`] for fewer rows than [`Self::least_rows`], or with [`FilterError::NotFinite`] for a
    /// value that is not finite.
    pub fn apply_matrix(
        &self,
        values: &mut [f64],
        columns: usize,
        constant: ConstantColumns,
    ) -> Result<(), FilterError> {
        let (padding, needed) = (self.padding(), self.least_rows());
        if columns == 0 || !values.len().is_multiple_of(columns) {
            return Err(FilterError::Shape { values: values.len(), columns });
        }
        let rows = values.len() / columns;
        if rows < needed {
            return Err(FilterError::TooShort { rows, needed });
        }
        let kept = match constant {
            ConstantColumns::Filter => Vec::new(),
            ConstantColumns::Keep => constant_columns(values, columns),
        };
        let last = rows - 1;
        all_finite(&values[..needed * columns], columns)?;
        let mut head = reflection(values, columns, 0, (1..=padding).rev());
        let mut tail = reflection(values, columns, last, (1..=padding).map(|k| last - k));
        self.cascade.forwards(columns, [&mut head, values, &mut tail]);
        // A value that is not finite remains in the recursion, so the last row is then not finite either.
        all_finite(&values[last * columns..], columns).or_else(|_| all_finite(values, columns))?;
        self.cascade.backwards(columns, [&mut tail, values, &mut []]);
        for (column, value) in kept {
            values.iter_mut().skip(column).step_by(columns).for_each(|x| *x = value);
        }
        Ok(())
    }
}

/// Removes all components below `low_hz` or above `high_hz`, without lag. `x` is evenly sampled at `rate_hz`; the
/// result has the same unit. [Gustafsson 1996, sec. 3]
///
/// # Errors
/// Returns the errors of [`ZeroPhaseFilter::new`] and [`ZeroPhaseFilter::apply`].
pub fn band_pass(x: &[f64], rate_hz: f64, low_hz: f64, high_hz: f64, order: usize) -> Result<Vec<f64>, FilterError> {
    ZeroPhaseFilter::new(FilterBand::Band { low_hz, high_hz }, rate_hz, order)?.apply(x)
}

/// Odd reflection of the rows `rows` of a matrix about its row `about`: twice that row minus each row.
fn reflection(values: &[f64], columns: usize, about: usize, rows: impl Iterator<Item = usize>) -> Vec<f64> {
    let row = |row: usize| &values[row * columns..(row + 1) * columns];
    rows.flat_map(|other| row(other).iter().zip(row(about))).map(|(value, about)| 2.0 * about - value).collect()
}

/// Fails for the first value, row by row, that is not finite.
fn all_finite(values: &[f64], columns: usize) -> Result<(), FilterError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(at) => Err(FilterError::NotFinite { row: at / columns, column: at % columns }),
    }
}

/// Indices of the columns whose values are all equal, each with its value.
fn constant_columns(values: &[f64], columns: usize) -> Vec<(usize, f64)> {
    let first = values.iter().copied().take(columns);
    let mut constant: Vec<(usize, f64)> = first.enumerate().collect();
    for row in values.chunks_exact(columns) {
        // Varying columns are excluded within a few rows, so the loop is short.
        constant.retain(|(column, value)| row[*column] == *value);
        if constant.is_empty() {
            break;
        }
    }
    constant
}

#[cfg(test)]
mod tests;

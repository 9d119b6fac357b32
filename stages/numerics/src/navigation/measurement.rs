//! Column of a scalar magnetometer with the noise of each sample.

use crate::navigation::ins_series::SeriesError;

/// Measurements of a line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measurements<'a> {
    /// Field at each sample, in nT; NaN if missing.
    pub(crate) measurement_nt: &'a [f64],
    /// Standard deviation of the white noise of each measurement, in nT. A measurement with a value that is not above 0
    /// counts as missing.
    pub(crate) sigma_nt: &'a [f64],
}

impl Measurements<'_> {
    /// Rejects columns whose length differs from that of the line.
    ///
    /// # Errors
    /// Fails with [`SeriesError::Length`] with the column's name.
    pub(crate) fn check(&self, expected: usize) -> Result<(), SeriesError> {
        for (column, rows) in [("measurement", self.measurement_nt.len()), ("measurement sigma", self.sigma_nt.len())] {
            if rows != expected {
                return Err(SeriesError::Length { column, rows, expected });
            }
        }
        Ok(())
    }

    /// Measurement of a row minus an offset, in nT, and its variance, in nT²; `None` if the measurement is missing, or
    /// if the square of its sigma is 0 or infinite.
    #[inline(always)]
    pub(crate) fn at(&self, row: usize, offset_nt: f64) -> Option<(f64, f64)> {
        usable(self.reading(row), offset_nt)
    }

    /// Measurement of a row and its standard deviation, in nT.
    #[inline(always)]
    pub(crate) fn reading(&self, row: usize) -> Reading {
        (self.measurement_nt[row], self.sigma_nt[row])
    }
}

/// Measurement and its standard deviation, in nT.
pub(crate) type Reading = (f64, f64);

/// Measurement minus an offset, in nT, and its variance, in nT²; `None` if the measurement is missing, or if the square
/// of its sigma is 0 or infinite.
#[inline(always)]
pub(crate) fn usable((measurement_nt, sigma_nt): Reading, offset_nt: f64) -> Option<(f64, f64)> {
    let (value_nt, variance_nt2) = (measurement_nt - offset_nt, sigma_nt * sigma_nt);
    let is_there = value_nt.is_finite() && sigma_nt > 0.0 && variance_nt2 > 0.0 && variance_nt2.is_finite();
    is_there.then_some((value_nt, variance_nt2))
}

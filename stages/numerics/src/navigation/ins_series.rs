//! Output of an inertial navigation system along a line, as columns.

use crate::navigation::pinson::InsPoint;
use thiserror::Error;

/// INS output along one line, one value per sample in every column.
#[derive(Clone, Copy, Debug)]
pub struct InsSeries<'a> {
    /// Time, in seconds, strictly ascending; steps may be uneven.
    pub tt_s: &'a [f64],
    /// Geodetic latitude, in degrees.
    pub lat_deg: &'a [f64],
    /// Longitude, in degrees.
    pub lon_deg: &'a [f64],
    /// Height above the ellipsoid, in metres.
    pub alt_m: &'a [f64],
    /// Velocity north, in m/s.
    pub vn_mps: &'a [f64],
    /// Velocity east, in m/s.
    pub ve_mps: &'a [f64],
    /// Velocity down, in m/s.
    pub vd_mps: &'a [f64],
    /// Specific force north, in m/s².
    pub fn_mps2: &'a [f64],
    /// Specific force east, in m/s².
    pub fe_mps2: &'a [f64],
    /// Specific force down, in m/s² (-g at rest).
    pub fd_mps2: &'a [f64],
    /// Roll, in degrees.
    pub roll_deg: &'a [f64],
    /// Pitch, in degrees.
    pub pitch_deg: &'a [f64],
    /// Yaw, in degrees.
    pub yaw_deg: &'a [f64],
}

impl<'a> InsSeries<'a> {
    /// Series from columns in the order of the fields.
    pub fn from_columns(columns: [&'a [f64]; 13]) -> Self {
        let [tt_s, lat_deg, lon_deg, alt_m, vn_mps, ve_mps, vd_mps, rest @ ..] = columns;
        let [fn_mps2, fe_mps2, fd_mps2, roll_deg, pitch_deg, yaw_deg] = rest;
        Self {
            tt_s,
            lat_deg,
            lon_deg,
            alt_m,
            vn_mps,
            ve_mps,
            vd_mps,
            fn_mps2,
            fe_mps2,
            fd_mps2,
            roll_deg,
            pitch_deg,
            yaw_deg,
        }
    }
}

/// Reason why a line cannot be processed. Rows are counted from 0.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SeriesError {
    /// Too few samples.
    #[error("the line has {rows} sample(s); at least {needed} are required")]
    TooShort {
        /// Number of samples.
        rows: usize,
        /// Number of samples needed.
        needed: usize,
    },
    /// A column differs in length from the time column.
    #[error("column `{column}` has {rows} rows, but `tt` has {expected}")]
    Length {
        /// Column name.
        column: &'static str,
        /// Length of the column.
        rows: usize,
        /// Length of `tt`.
        expected: usize,
    },
    /// Missing or infinite value in a required column.
    #[error("column `{column}` is {value} in row {row}; the filter requires a finite value in every row")]
    NotFinite {
        /// Column name.
        column: &'static str,
        /// Row.
        row: usize,
        /// Value.
        value: f64,
    },
    /// Time does not ascend.
    #[error("time does not ascend: `tt` is {tt_s} s in row {row} after {before_s} s")]
    Time {
        /// Row.
        row: usize,
        /// Time of the row.
        tt_s: f64,
        /// Time of the previous row.
        before_s: f64,
    },
    /// Latitude at or beyond a pole.
    #[error("column `{column}` is {lat_deg} degrees in row {row}, at or beyond a pole")]
    Latitude {
        /// Column name.
        column: &'static str,
        /// Row.
        row: usize,
        /// Latitude.
        lat_deg: f64,
    },
}

impl<'a> InsSeries<'a> {
    /// Samples from `row` on; `row` is below [`InsSeries::len`].
    pub fn from(&self, row: usize) -> Self {
        Self::from_columns(self.columns().map(|(_, column)| &column[row..]))
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.tt_s.len()
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.tt_s.is_empty()
    }

    /// Columns with their names in a flight table.
    fn columns(&self) -> [(&'static str, &'a [f64]); 13] {
        [
            ("tt", self.tt_s),
            ("ins_lat", self.lat_deg),
            ("ins_lon", self.lon_deg),
            ("ins_alt", self.alt_m),
            ("ins_vn", self.vn_mps),
            ("ins_ve", self.ve_mps),
            ("ins_vd", self.vd_mps),
            ("ins_fn", self.fn_mps2),
            ("ins_fe", self.fe_mps2),
            ("ins_fd", self.fd_mps2),
            ("ins_roll", self.roll_deg),
            ("ins_pitch", self.pitch_deg),
            ("ins_yaw", self.yaw_deg),
        ]
    }

    /// Checks the columns.
    ///
    /// # Errors
    ///
    /// Fails for columns of different lengths, values that are not finite, time that does not ascend and latitudes at
    /// or beyond a pole.
    pub fn check(&self) -> Result<(), SeriesError> {
        if self.is_empty() {
            return Err(SeriesError::TooShort { rows: 0, needed: 1 });
        }
        for (column, values) in self.columns() {
            check_column(column, values, self.len())?;
        }
        check_time(self.tt_s)?;
        check_latitudes("ins_lat", self.lat_deg)
    }

    /// One sample, in the units of the error model. `row` is below [`InsSeries::len`] of a series that passed
    /// [`InsSeries::check`].
    #[inline]
    pub fn point(&self, row: usize) -> InsPoint {
        InsPoint {
            lat_rad: self.lat_deg[row].to_radians(),
            vel_ned_mps: [self.vn_mps[row], self.ve_mps[row], self.vd_mps[row]],
            force_ned_mps2: [self.fn_mps2[row], self.fe_mps2[row], self.fd_mps2[row]],
            euler_rad: [
                self.roll_deg[row].to_radians(),
                self.pitch_deg[row].to_radians(),
                self.yaw_deg[row].to_radians(),
            ],
        }
    }
}

/// Rejects a column whose length is unexpected or that has a value that is not finite.
pub(super) fn check_column(column: &'static str, values: &[f64], expected: usize) -> Result<(), SeriesError> {
    if values.len() != expected {
        return Err(SeriesError::Length { column, rows: values.len(), expected });
    }
    match values.iter().position(|value| !value.is_finite()) {
        Some(row) => Err(SeriesError::NotFinite { column, row, value: values[row] }),
        None => Ok(()),
    }
}

/// Rejects time that does not ascend.
pub(super) fn check_time(tt_s: &[f64]) -> Result<(), SeriesError> {
    for (before, pair) in tt_s.windows(2).enumerate() {
        if pair[1] <= pair[0] || pair[1].is_nan() {
            return Err(SeriesError::Time { row: before + 1, tt_s: pair[1], before_s: pair[0] });
        }
    }
    Ok(())
}

/// Rejects latitudes at or beyond a pole.
pub(super) fn check_latitudes(column: &'static str, lat_deg: &[f64]) -> Result<(), SeriesError> {
    match lat_deg.iter().position(|lat| lat.abs() >= 90.0) {
        Some(row) => Err(SeriesError::Latitude { column, row, lat_deg: lat_deg[row] }),
        None => Ok(()),
    }
}

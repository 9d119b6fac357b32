//! Aiding positions, such as those of a GNSS receiver or a barometer.

use params::Rule;

use crate::earth::geodesy::EarthModel;
use crate::navigation::ins_error::{ParameterError, require};
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::{ALT, LAT, LON};

/// Positions at the samples of a line; NaN if missing. Each coordinate is a separate measurement with white noise, so a
/// barometer is a fix of the height alone.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionFixes {
    /// Geodetic latitude, in degrees.
    pub lat_deg: Vec<f64>,
    /// Longitude, in degrees.
    pub lon_deg: Vec<f64>,
    /// Height above the ellipsoid, in metres.
    pub alt_m: Vec<f64>,
    /// Standard deviation of the position in each of north and east, in metres.
    pub horizontal_sigma_m: f64,
    /// Standard deviation of the height, in metres.
    pub vertical_sigma_m: f64,
}

/// Measurement of one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StateFix {
    pub(crate) state: usize,
    /// Measured error of the INS, in the unit of the state.
    pub(crate) error: f64,
    pub(crate) variance: f64,
}

/// Row without a position.
pub(crate) const NO_FIX: [Option<StateFix>; 3] = [None; 3];

impl PositionFixes {
    /// Rejects invalid fixes.
    ///
    /// # Errors
    /// Fails for standard deviations that are not finite and above 0, or for columns whose length differs from that of
    /// the line.
    pub fn check(&self, rows: usize) -> Result<(), NavigationError> {
        require("horizontal_sigma_m", self.horizontal_sigma_m, Rule::Positive)?;
        require("vertical_sigma_m", self.vertical_sigma_m, Rule::Positive)?;
        let columns = [("fix latitude", &self.lat_deg), ("fix longitude", &self.lon_deg), ("fix height", &self.alt_m)];
        for (column, values) in columns {
            if values.len() != rows {
                return Err(SeriesError::Length { column, rows: values.len(), expected: rows }.into());
            }
        }
        Ok(())
    }

    /// Whether a row has any coordinate.
    pub(crate) fn is_there(&self, row: usize) -> bool {
        [&self.lat_deg, &self.lon_deg, &self.alt_m].into_iter().any(|values| values[row].is_finite())
    }

    /// Measurements of a row, one per existing coordinate.
    pub(crate) fn at(&self, ins: &InsSeries<'_>, row: usize, earth: EarthModel) -> [Option<StateFix>; 3] {
        self.fix(row).of(ins, row, earth)
    }

    /// Position of a row.
    pub(crate) fn fix(&self, row: usize) -> PositionFix {
        PositionFix {
            lat_deg: self.lat_deg[row],
            lon_deg: self.lon_deg[row],
            alt_m: self.alt_m[row],
            horizontal_sigma_m: self.horizontal_sigma_m,
            vertical_sigma_m: self.vertical_sigma_m,
        }
    }
}

/// Aiding position at one sample. A coordinate that is NaN is missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionFix {
    /// Geodetic latitude, in degrees.
    pub lat_deg: f64,
    /// Longitude, in degrees.
    pub lon_deg: f64,
    /// Height above the ellipsoid, in metres.
    pub alt_m: f64,
    /// Standard deviation of the position in each of north and east, in metres.
    pub horizontal_sigma_m: f64,
    /// Standard deviation of the height, in metres.
    pub vertical_sigma_m: f64,
}

impl PositionFix {
    /// Rejects standard deviations unless they are finite and above 0.
    ///
    /// # Errors
    /// Fails with the name of the standard deviation.
    pub fn check(&self) -> Result<(), ParameterError> {
        // `require` allocates.
        if [self.horizontal_sigma_m, self.vertical_sigma_m].iter().all(|sigma_m| *sigma_m > 0.0 && sigma_m.is_finite())
        {
            return Ok(());
        }
        require("horizontal_sigma_m", self.horizontal_sigma_m, Rule::Positive)?;
        require("vertical_sigma_m", self.vertical_sigma_m, Rule::Positive)
    }

    /// Measurements of the errors of an INS at a row, one per existing coordinate.
    pub(crate) fn of(&self, ins: &InsSeries<'_>, row: usize, earth: EarthModel) -> [Option<StateFix>; 3] {
        let (lat_rad, alt_m) = (ins.lat_deg[row].to_radians(), ins.alt_m[row]);
        let (north_m, east_m) = earth.north_east_m_per_rad(lat_rad, alt_m);
        let fix = |state, error: f64, sigma: f64| {
            error.is_finite().then_some(StateFix { state, error, variance: sigma * sigma })
        };
        [
            fix(LAT, (self.lat_deg - ins.lat_deg[row]).to_radians(), self.horizontal_sigma_m / north_m),
            fix(LON, (self.lon_deg - ins.lon_deg[row]).to_radians(), self.horizontal_sigma_m / east_m),
            fix(ALT, self.alt_m - alt_m, self.vertical_sigma_m),
        ]
    }
}

//! Line with its map, as input of the filters, and the steps from sample to sample.

use std::sync::Arc;

use crate::earth::core_field::CoreField;
use crate::earth::field_value::FieldValue;
use crate::maps::map_stack::FieldMap;
use crate::navigation::field::PredictedField;
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::measurement::Measurements;
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::StateMatrix;
use crate::navigation::position_fixes::{NO_FIX, PositionFixes, StateFix};

/// Flight line with measurements of the scalar field over a map.
#[derive(Clone, Copy, Debug)]
pub struct NavigationLine<'a> {
    /// INS.
    pub ins: &'a InsSeries<'a>,
    /// Measured field at each sample, in nT; NaN if missing. The measurement contains the core field if, and only if,
    /// `core` is given.
    pub measurement_nt: &'a [f64],
    /// Standard deviation of the white noise of each measurement, in nT. A measurement with a value that is not above 0
    /// counts as missing.
    pub sigma_nt: &'a [f64],
    /// Map.
    pub map: &'a FieldMap,
    /// Core field.
    pub core: Option<&'a Arc<CoreField>>,
    /// Error sources of the INS and the temporal variation.
    pub errors: InsErrorModel,
    /// Length, in seconds, of the window over which the mean of measurement minus prediction is computed. The mean is
    /// subtracted from every measurement; 0 subtracts nothing.
    pub offset_window_s: f64,
    /// Aiding positions, each used before the measurement of its sample.
    pub fixes: Option<&'a PositionFixes>,
    /// Adds the variance from the curvature of the map over the position uncertainty to the measurement noise.
    pub second_order: bool,
}

/// Step of the 18 states: x ← Φ x + w, w ~ N(0, Q).
#[derive(Clone, Debug)]
pub struct LineStep {
    /// Length, in seconds.
    pub dt_s: f64,
    /// Mean ground speed, in m/s. For a step between two samples, it is the speed at the beginning of the step.
    pub speed_mps: f64,
    /// Φ.
    pub phi: StateMatrix,
    /// Q.
    pub noise: StateMatrix,
}

impl<'a> NavigationLine<'a> {
    /// Rejects invalid lines.
    ///
    /// # Errors
    /// Returns the errors of [`InsErrorModel::check`] and [`InsSeries::check`]. Also fails with
    /// [`SeriesError::Length`](crate::navigation::SeriesError) for columns of different lengths. Also returns the
    /// errors of [`PositionFixes::check`].
    pub fn check(&self) -> Result<(), NavigationError> {
        self.errors.check()?;
        self.ins.check()?;
        let expected = self.ins.len();
        self.measurements().check(expected)?;
        self.fixes.map_or(Ok(()), |fixes| fixes.check(expected))
    }

    #[inline(always)]
    fn measurements(&self) -> Measurements<'a> {
        Measurements { measurement_nt: self.measurement_nt, sigma_nt: self.sigma_nt }
    }

    /// Aiding positions at a row, as measurements of states.
    #[inline]
    pub(crate) fn fixes_at(&self, row: usize) -> [Option<StateFix>; 3] {
        self.fixes.map_or(NO_FIX, |fixes| fixes.at(self.ins, row, self.errors.earth))
    }

    /// Predicted field of the line.
    pub fn predicted(&self) -> PredictedField<'a> {
        PredictedField::new(self.map, self.core).with_second_order(self.second_order)
    }

    /// Measurement of a row minus an offset, in nT, and its variance, in nT²; `None` if the measurement is missing.
    #[inline(always)]
    pub fn measured(&self, row: usize, offset_nt: f64) -> Option<(f64, f64)> {
        self.measurements().at(row, offset_nt)
    }

    /// Horizontal slope of a field at a row, in nT/m.
    pub(crate) fn slope_nt_per_m(&self, row: usize, at: &FieldValue) -> f64 {
        let (lat_rad, alt_m) = (self.ins.lat_deg[row].to_radians(), self.ins.alt_m[row]);
        let (north, east) = self.errors.earth.north_east_m_per_rad(lat_rad, alt_m);
        (at.d_lat_nt_per_rad / north).hypot(at.d_lon_nt_per_rad / east)
    }

    /// Step from the sample before `row` to `row`, which is at least 1.
    #[inline]
    pub fn step(&self, row: usize) -> LineStep {
        LineStep::new(self.ins, &self.errors, row)
    }
}

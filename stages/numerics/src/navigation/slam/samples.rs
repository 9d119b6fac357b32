//! Measurements of a line, one per step of the particles, in a local frame.

use std::sync::Arc;

use crate::earth::core_field::{CoreField, LinearisedCoreField};
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::measurement::Measurements;
use crate::navigation::position_fixes::PositionFixes;
use crate::navigation::{NavigationError, NavigationLine};

/// Flight line with measurements of the scalar field, without a map.
#[derive(Clone, Copy, Debug)]
pub struct SlamLine<'a> {
    /// INS.
    pub ins: &'a InsSeries<'a>,
    /// Measured field at each sample, in nT; NaN if missing. The measurement contains the core field if, and only if,
    /// `core` is given.
    pub measurement_nt: &'a [f64],
    /// Standard deviation of the white noise of each measurement, in nT. A measurement whose standard deviation is not
    /// above 0 counts as missing.
    pub sigma_nt: &'a [f64],
    /// Core field. The subtraction only removes the slope of the field, so that the process is a better model of the
    /// anomaly.
    pub core: Option<&'a Arc<CoreField>>,
    /// Aiding positions, each used before the measurement of its sample.
    pub fixes: Option<&'a PositionFixes>,
    /// Error sources of the INS and the temporal variation.
    pub errors: InsErrorModel,
}

impl<'a> From<&NavigationLine<'a>> for SlamLine<'a> {
    /// Line, without a map and without an offset window. A constant in the measurement is part of the unknown map, so
    /// the window is not needed.
    fn from(line: &NavigationLine<'a>) -> Self {
        let NavigationLine { ins, measurement_nt, sigma_nt, core, errors, fixes, .. } = *line;
        Self { ins, measurement_nt, sigma_nt, core, fixes, errors }
    }
}

impl SlamLine<'_> {
    /// Rejects invalid lines.
    ///
    /// # Errors
    /// Returns the errors of [`InsErrorModel::check`], [`InsSeries::check`] and [`PositionFixes::check`]. Also fails
    /// with [`SeriesError::Length`](crate::navigation::SeriesError) for columns of different lengths.
    pub fn check(&self) -> Result<(), NavigationError> {
        self.errors.check()?;
        self.ins.check()?;
        self.fixes.map_or(Ok(()), |fixes| fixes.check(self.ins.len()))?;
        Ok(self.measurements().check(self.ins.len())?)
    }

    /// Whether a row has a measurement.
    pub fn is_measured(&self, row: usize) -> bool {
        self.measurements().at(row, 0.0).is_some()
    }

    fn measurements(&self) -> Measurements<'_> {
        Measurements { measurement_nt: self.measurement_nt, sigma_nt: self.sigma_nt }
    }
}

/// Frame of metres north and east of the first sample, with the scales at the latitude of this sample.
///
/// The coordinates are the same smooth function of latitude and longitude everywhere, so two visits to the same
/// position have equal coordinates. The relative error of eastern distances is the change of the cosine of the latitude
/// along the flight (1 % in 60 km at 45°).
#[derive(Clone, Copy, Debug)]
pub struct LocalFrame {
    lat_deg: f64,
    lon_deg: f64,
    /// Metres per radian of latitude and of longitude.
    pub m_per_rad: [f64; 2],
}

impl LocalFrame {
    /// Frame about the first sample of a series that passed [`InsSeries::check`].
    pub fn new(ins: &InsSeries<'_>, errors: &InsErrorModel) -> Self {
        let (lat_deg, lon_deg) = (ins.lat_deg[0], ins.lon_deg[0]);
        let (north, east) = errors.earth.north_east_m_per_rad(lat_deg.to_radians(), ins.alt_m[0]);
        Self { lat_deg, lon_deg, m_per_rad: [north, east] }
    }

    /// Position north and east, in metres.
    pub fn at_m(&self, lat_deg: f64, lon_deg: f64) -> [f64; 2] {
        let mut turn = lon_deg - self.lon_deg;
        turn -= 360.0 * (turn / 360.0).round();
        [(lat_deg - self.lat_deg).to_radians() * self.m_per_rad[0], turn.to_radians() * self.m_per_rad[1]]
    }

    /// Latitude and longitude, in degrees, of a position in metres.
    pub fn lat_lon_deg(&self, at_m: [f64; 2]) -> (f64, f64) {
        let [lat, lon] = [0, 1].map(|axis: usize| (at_m[axis] / self.m_per_rad[axis]).to_degrees());
        (self.lat_deg + lat, self.lon_deg + lon)
    }
}

/// Measurements of one step, averaged with their inverse variances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlamSample {
    /// Last row of the step.
    pub row: usize,
    /// Mean time, in seconds.
    pub tt_s: f64,
    /// Mean position of the INS, north and east, in metres.
    pub at_m: [f64; 2],
    /// Mean height of the INS, in metres.
    pub alt_m: f64,
    /// Mean measurement minus the core field at the INS, in nT.
    pub value_nt: f64,
    /// Variance of the white noise of the measurement, in nT².
    pub variance_nt2: f64,
    /// Gradient of the core field north and east, in nT/m.
    pub core_nt_per_m: [f64; 2],
}

/// Averaging of the measurements of each step.
#[derive(Debug)]
pub struct SlamSampler<'a> {
    line: SlamLine<'a>,
    frame: LocalFrame,
    core: Option<LinearisedCoreField>,
}

impl<'a> SlamSampler<'a> {
    /// Sampler for a line that passed [`SlamLine::check`].
    pub fn new(line: SlamLine<'a>, frame: LocalFrame) -> Self {
        Self { line, frame, core: line.core.map(|core| LinearisedCoreField::new(core.clone())) }
    }

    /// Sample of a range of rows; `None` if no row has a measurement.
    pub fn sample(&mut self, rows: std::ops::RangeInclusive<usize>) -> Option<SlamSample> {
        let (ins, last) = (self.line.ins, *rows.end());
        let mut weights = 0.0;
        let mut sums = [0.0; 7];
        for row in rows {
            if !self.line.is_measured(row) {
                continue;
            }
            let weight = self.line.sigma_nt[row].powi(-2);
            let [north, east] = self.frame.at_m(ins.lat_deg[row], ins.lon_deg[row]);
            let mut value_nt = self.line.measurement_nt[row];
            let mut gradient = [0.0; 2];
            if let Some(core) = &mut self.core {
                let field = core.magnitude_and_gradient(ins.lat_deg[row], ins.lon_deg[row], ins.alt_m[row]);
                value_nt -= field.value_nt;
                gradient = [field.d_lat_nt_per_rad, field.d_lon_nt_per_rad];
            }
            let times = ins.tt_s[row] - ins.tt_s[last];
            let of_row = [times, north, east, ins.alt_m[row], value_nt, gradient[0], gradient[1]];
            for (sum, value) in sums.iter_mut().zip(of_row) {
                *sum += weight * value;
            }
            weights += weight;
        }
        if weights <= 0.0 {
            return None;
        }
        let [time, north, east, alt_m, value_nt, d_lat, d_lon] = sums.map(|sum| sum / weights);
        let [per_north, per_east] = self.frame.m_per_rad;
        Some(SlamSample {
            row: last,
            tt_s: ins.tt_s[last] + time,
            at_m: [north, east],
            alt_m,
            value_nt,
            variance_nt2: 1.0 / weights,
            core_nt_per_m: [d_lat / per_north, d_lon / per_east],
        })
    }
}

/// Last rows of the steps of a line: rows at least `interval_s` apart, and the last row of the line.
pub fn step_ends(tt_s: &[f64], interval_s: f64) -> Vec<usize> {
    // Without the tolerance, rounding of the times could double the length of every other step.
    let enough = interval_s * (1.0 - 1e-6);
    let mut ends = vec![0];
    let mut since = tt_s[0];
    for (row, tt) in tt_s.iter().enumerate().skip(1) {
        if tt - since >= enough || row + 1 == tt_s.len() {
            ends.push(row);
            since = *tt;
        }
    }
    ends
}

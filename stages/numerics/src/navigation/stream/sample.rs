//! Samples of a stream, and estimates after them.

use thiserror::Error;

use crate::navigation::ins_error::ParameterError;
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::measurement::Reading;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::position_fixes::{PositionFix, StateFix};

use super::StateVisitor;

/// INS at one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InsSample {
    /// Time, in seconds, later than the time of the last sample.
    pub tt_s: f64,
    /// Geodetic latitude, in degrees.
    pub lat_deg: f64,
    /// Longitude, in degrees.
    pub lon_deg: f64,
    /// Height above the ellipsoid, in metres.
    pub alt_m: f64,
    /// Velocity north, east and down, in m/s.
    pub velocity_ned_mps: [f64; 3],
    /// Specific force north, east and down, in m/s²; (0, 0, -g) at rest.
    pub force_ned_mps2: [f64; 3],
    /// Roll, pitch and yaw, in degrees.
    pub attitude_deg: [f64; 3],
}

impl InsSample {
    /// Sample of a series. `row` is below [`InsSeries::len`].
    pub fn from_series(ins: &InsSeries<'_>, row: usize) -> Self {
        Self {
            tt_s: ins.tt_s[row],
            lat_deg: ins.lat_deg[row],
            lon_deg: ins.lon_deg[row],
            alt_m: ins.alt_m[row],
            velocity_ned_mps: [ins.vn_mps, ins.ve_mps, ins.vd_mps].map(|column| column[row]),
            force_ned_mps2: [ins.fn_mps2, ins.fe_mps2, ins.fd_mps2].map(|column| column[row]),
            attitude_deg: [ins.roll_deg, ins.pitch_deg, ins.yaw_deg].map(|column| column[row]),
        }
    }

    /// Values in the order of [`InsSeries`].
    pub(super) fn values(&self) -> [f64; 13] {
        let Self { tt_s, lat_deg, lon_deg, alt_m, .. } = *self;
        let ([vn, ve, vd], [force_n, force_e, force_d]) = (self.velocity_ned_mps, self.force_ned_mps2);
        let [roll, pitch, yaw] = self.attitude_deg;
        [tt_s, lat_deg, lon_deg, alt_m, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw]
    }

    /// Rejects the values that [`InsSeries::check`] rejects.
    pub(super) fn check(&self) -> Result<(), StreamError> {
        let (values, tt_s) = (self.values(), self.tt_s);
        let series = InsSeries::from_columns(values.each_ref().map(std::slice::from_ref));
        series.check().map_err(|fault| match fault {
            SeriesError::NotFinite { column, value, .. } => StreamError::NotFinite { column, value, tt_s },
            SeriesError::Latitude { lat_deg, .. } => StreamError::Latitude { lat_deg, tt_s },
            other => StreamError::Refused(other.into()),
        })
    }
}

/// Sample of a stream: INS, magnetometers and, if there is one, an aiding position.
#[derive(Clone, Copy, Debug, Default)]
pub struct StreamSample<'a> {
    /// INS.
    pub ins: InsSample,
    /// Field of each magnetometer, in nT; NaN if missing. The measurement contains the core field if, and only if, the
    /// filter has one.
    pub measurement_nt: &'a [f64],
    /// Standard deviation of the white noise of each measurement, in nT. A measurement whose standard deviation is not
    /// above 0 counts as missing.
    pub sigma_nt: &'a [f64],
    /// Terms of each magnetometer in turn, in the order of the coefficients; empty unless the filter estimates
    /// coefficients.
    pub terms: &'a [f64],
    /// Aiding position, used before the measurements.
    pub fix: Option<PositionFix>,
}

/// Estimate after the measurements of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamEstimate {
    /// Time of the sample, in seconds.
    pub tt_s: f64,
    /// Latitude, in degrees.
    pub lat_deg: f64,
    /// Longitude, in degrees.
    pub lon_deg: f64,
    /// Height above the ellipsoid, in metres.
    pub alt_m: f64,
    /// Velocity north, east and down, in m/s.
    pub velocity_ned_mps: [f64; 3],
    /// Standard deviation of the position north, in metres.
    pub sd_n_m: f64,
    /// Standard deviation of the position east, in metres.
    pub sd_e_m: f64,
    /// Covariance of north with east, in m².
    pub cov_ne_m2: f64,
    /// Measurement minus prediction, in nT; NaN if the measurement or the prediction is missing.
    pub residual_nt: f64,
    /// NIS: squared residual divided by its predicted variance; NaN if the residual is NaN.
    pub nis: f64,
}

impl StreamEstimate {
    /// Estimate of the first row of an output.
    pub(super) fn from_output(output: &NavigationOutput, tt_s: f64) -> Option<Self> {
        Some(Self {
            tt_s,
            lat_deg: *output.lat_deg.first()?,
            lon_deg: *output.lon_deg.first()?,
            alt_m: *output.alt_m.first()?,
            velocity_ned_mps: [*output.vn_mps.first()?, *output.ve_mps.first()?, *output.vd_mps.first()?],
            sd_n_m: *output.sd_n_m.first()?,
            sd_e_m: *output.sd_e_m.first()?,
            cov_ne_m2: *output.cov_ne_m2.first()?,
            residual_nt: *output.residual_nt.first()?,
            nis: *output.nis.first()?,
        })
    }
}

/// Quantities of one magnetometer at a sample; NaN for quantities that the filter does not compute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagnetometerEstimate {
    /// Estimated standard deviation of the noise, in nT; `ekf_adaptive` only.
    pub sigma_nt: f64,
    /// Measurement minus prediction before the sample, in nT; `ekf_online_tl` only.
    pub residual_nt: f64,
    /// NIS given the previous magnetometers; `ekf_online_tl` only.
    pub nis: f64,
    /// Aircraft field after the sample, in nT; `ekf_online_tl` only.
    pub aircraft_nt: f64,
}

impl Default for MagnetometerEstimate {
    fn default() -> Self {
        Self { sigma_nt: f64::NAN, residual_nt: f64::NAN, nis: f64::NAN, aircraft_nt: f64::NAN }
    }
}

/// Reason why a sample is not used. Unless stated otherwise, the filter is unchanged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StreamError {
    /// The time is before the last sample.
    #[error("the sample at tt = {tt_s} s is late: the last sample has tt = {last_s} s; drop the sample")]
    Late {
        /// Time of the sample, in seconds.
        tt_s: f64,
        /// Time of the last sample, in seconds.
        last_s: f64,
    },
    /// The time equals the time of the last sample.
    #[error("a sample at tt = {tt_s} s was already used; drop the duplicate")]
    Duplicate {
        /// Time of the sample, in seconds.
        tt_s: f64,
    },
    /// Too many samples are missing.
    #[error(
        "samples between tt = {last_s} s and {tt_s} s are missing, more than `max_gap_s` = {max_gap_s} s: start a new \
         filter, or raise `max_gap_s`"
    )]
    Gap {
        /// Time of the sample, in seconds.
        tt_s: f64,
        /// Time of the last sample, in seconds.
        last_s: f64,
        /// Longest step, in seconds.
        max_gap_s: f64,
    },
    /// An INS value is missing or infinite.
    #[error("`{column}` is {value} at tt = {tt_s} s; the filter requires a finite value")]
    NotFinite {
        /// Column name in a flight table.
        column: &'static str,
        /// Value.
        value: f64,
        /// Time of the sample, in seconds.
        tt_s: f64,
    },
    /// Latitude at or beyond a pole.
    #[error("`ins_lat` is {lat_deg} degrees at tt = {tt_s} s, at or beyond a pole")]
    Latitude {
        /// Latitude, in degrees.
        lat_deg: f64,
        /// Time of the sample, in seconds.
        tt_s: f64,
    },
    /// The number of values in the sample differs from the number that the filter requires.
    #[error("the sample has {found} {what}; the filter requires {expected}")]
    Count {
        /// Values that are counted.
        what: &'static str,
        /// Number of values of the sample.
        found: usize,
        /// Number of values that the filter requires.
        expected: usize,
    },
    /// The standard deviations of the aiding position are invalid.
    #[error(transparent)]
    Fix(ParameterError),
    /// State or covariance is no longer finite. The filter is stopped.
    #[error(
        "the filter diverged at tt = {tt_s} s: its covariance is no longer finite and non-negative; check the INS \
         values and the time steps before this sample"
    )]
    Diverged {
        /// Time of the sample, in seconds.
        tt_s: f64,
    },
    /// The filter cannot process the sample. The filter is stopped.
    #[error(transparent)]
    Refused(NavigationError),
    /// The filter stopped at an earlier sample.
    #[error("the filter stopped at an earlier sample: create a new filter")]
    Stopped,
}

/// Input of a filter at a sample, except the INS.
pub(crate) struct SampleInput<'a> {
    pub(super) measurement_nt: &'a [f64],
    pub(super) sigma_nt: &'a [f64],
    pub(crate) terms: &'a [f64],
    pub(crate) fixes: [Option<StateFix>; 3],
}

impl SampleInput<'_> {
    /// Measurement of a magnetometer and its standard deviation, in nT.
    #[inline(always)]
    pub(crate) fn reading(&self, magnetometer: usize) -> Reading {
        (self.measurement_nt[magnetometer], self.sigma_nt[magnetometer])
    }
}

/// Recursion of one filter.
pub(crate) trait StreamedFilter {
    /// Filters sample `row` of `ins`, which holds at most the last two samples. Row 0 is the first sample of the
    /// stream, row 1 any later sample. [`StreamedFilter::clear`] was called before.
    fn sample(&mut self, ins: &InsSeries<'_>, row: usize, input: &SampleInput<'_>) -> Result<(), NavigationError>;

    /// Removes the output of the last sample and keeps the allocated memory.
    fn clear(&mut self);

    /// Output of the last sample in one row; none before the first sample.
    fn output(&self) -> &NavigationOutput;

    /// Quantities of a magnetometer at the last sample.
    fn magnetometer(&self, _: usize) -> Option<MagnetometerEstimate> {
        None
    }

    /// Coefficients after the last sample, and their standard deviations.
    fn coefficients(&self) -> (&[f64], &[f64]) {
        (&[], &[])
    }

    /// Visits the state between two samples.
    fn visit(&mut self, state: &mut dyn StateVisitor);
}

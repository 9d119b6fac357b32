//! Output of a filter on a line, and the errors of a filter run.

use crate::earth::geodesy::EarthModel;
use crate::navigation::ins_error::ParameterError;
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::pinson::{ALT, LAT, LON, StateMatrix, StateVector, VD, VE, VN};
use thiserror::Error;

/// Use of the samples of a line. The first four counts add up to the number of samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NavigationReport {
    /// Number of used samples.
    pub updates: usize,
    /// Number of samples without a finite measurement.
    pub missing_measurements: usize,
    /// Number of samples whose predicted position is off the map or in an unknown cell.
    pub off_map: usize,
    /// Number of samples that the innovation gate rejected.
    pub gated: usize,
    /// Offset subtracted from every measurement, in nT.
    pub offset_nt: f64,
    /// Number of samples averaged for the offset. If this is zero although a window is set, no sample in the window had
    /// both a measurement and a map value, and nothing was subtracted.
    pub offset_samples: usize,
}

/// Output of a filter on a line, one value per sample in every column: the state after the measurement of the sample.
#[derive(Clone, Debug, Default)]
pub struct NavigationOutput {
    /// Error states, in the order of `pinson`; empty unless `keep_states` is set.
    pub x: Vec<StateVector>,
    /// Covariance of the error states; empty unless `keep_covariance` is set.
    pub p: Vec<StateMatrix>,
    /// Measurement minus prediction, in nT; NaN if the measurement or the prediction is missing.
    pub residual_nt: Vec<f64>,
    /// NIS: squared residual divided by its predicted variance; NaN if the residual is NaN.
    pub nis: Vec<f64>,
    /// Estimated latitude, in degrees.
    pub lat_deg: Vec<f64>,
    /// Estimated longitude, in degrees.
    pub lon_deg: Vec<f64>,
    /// Estimated height above the ellipsoid, in metres.
    pub alt_m: Vec<f64>,
    /// Estimated velocity north, in m/s.
    pub vn_mps: Vec<f64>,
    /// Estimated velocity east, in m/s.
    pub ve_mps: Vec<f64>,
    /// Estimated velocity down, in m/s.
    pub vd_mps: Vec<f64>,
    /// Standard deviation of the north position, in metres.
    pub sd_n_m: Vec<f64>,
    /// Standard deviation of the east position, in metres.
    pub sd_e_m: Vec<f64>,
    /// Covariance of north with east, in m².
    pub cov_ne_m2: Vec<f64>,
    /// Use of the samples.
    pub report: NavigationReport,
    keep_states: bool,
    keep_covariance: bool,
}

impl NavigationOutput {
    /// Empty output with capacity for `rows`.
    pub fn with_capacity(rows: usize, keep_states: bool, keep_covariance: bool) -> Self {
        let column = || Vec::with_capacity(rows);
        Self {
            x: Vec::with_capacity(if keep_states { rows } else { 0 }),
            p: Vec::with_capacity(if keep_covariance { rows } else { 0 }),
            residual_nt: column(),
            nis: column(),
            lat_deg: column(),
            lon_deg: column(),
            alt_m: column(),
            vn_mps: column(),
            ve_mps: column(),
            vd_mps: column(),
            sd_n_m: column(),
            sd_e_m: column(),
            cov_ne_m2: column(),
            report: NavigationReport::default(),
            keep_states,
            keep_covariance,
        }
    }

    /// Appends the rows of another output, which continues this one, and adds its counts.
    pub(crate) fn append(&mut self, other: Self) {
        self.x.extend(other.x);
        self.p.extend(other.p);
        let columns = [
            (&mut self.residual_nt, other.residual_nt),
            (&mut self.nis, other.nis),
            (&mut self.lat_deg, other.lat_deg),
            (&mut self.lon_deg, other.lon_deg),
            (&mut self.alt_m, other.alt_m),
            (&mut self.vn_mps, other.vn_mps),
            (&mut self.ve_mps, other.ve_mps),
            (&mut self.vd_mps, other.vd_mps),
            (&mut self.sd_n_m, other.sd_n_m),
            (&mut self.sd_e_m, other.sd_e_m),
            (&mut self.cov_ne_m2, other.cov_ne_m2),
        ];
        columns.into_iter().for_each(|(own, other)| own.extend(other));
        let NavigationReport { updates, missing_measurements, off_map, gated, .. } = other.report;
        self.report.updates += updates;
        self.report.missing_measurements += missing_measurements;
        self.report.off_map += off_map;
        self.report.gated += gated;
    }

    /// Removes all rows and keeps the report and the allocated memory.
    pub(crate) fn clear_rows(&mut self) {
        self.x.clear();
        self.p.clear();
        let columns = [
            &mut self.residual_nt,
            &mut self.nis,
            &mut self.lat_deg,
            &mut self.lon_deg,
            &mut self.alt_m,
            &mut self.vn_mps,
            &mut self.ve_mps,
            &mut self.vd_mps,
            &mut self.sd_n_m,
            &mut self.sd_e_m,
            &mut self.cov_ne_m2,
        ];
        columns.into_iter().for_each(Vec::clear);
    }

    /// Appends a row of the state `x` and its covariance `p`, given by their entries.
    #[inline(always)]
    pub fn push(
        &mut self,
        ins: &InsSeries<'_>,
        row: usize,
        x: impl Fn(usize) -> f64,
        p: impl Fn(usize, usize) -> f64,
        innovation: Innovation,
        earth: EarthModel,
    ) {
        let lat_deg = ins.lat_deg[row] + x(LAT).to_degrees();
        let alt_m = ins.alt_m[row] + x(ALT);
        let (north, east) = earth.north_east_m_per_rad(lat_deg.to_radians(), alt_m);
        if self.keep_states {
            self.x.push(std::array::from_fn(&x));
        }
        if self.keep_covariance {
            self.p.push(std::array::from_fn(|row| std::array::from_fn(|column| p(row, column))));
        }
        self.residual_nt.push(innovation.residual_nt);
        self.nis.push(innovation.nis);
        self.lat_deg.push(lat_deg);
        self.lon_deg.push(ins.lon_deg[row] + x(LON).to_degrees());
        self.alt_m.push(alt_m);
        self.vn_mps.push(ins.vn_mps[row] + x(VN));
        self.ve_mps.push(ins.ve_mps[row] + x(VE));
        self.vd_mps.push(ins.vd_mps[row] + x(VD));
        self.sd_n_m.push(north * p(LAT, LAT).sqrt());
        self.sd_e_m.push(east * p(LON, LON).sqrt());
        self.cov_ne_m2.push(north * east * p(LAT, LON));
    }
}

/// Residual and NIS; NaN without an update.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    /// Measurement minus prediction, in nT.
    pub residual_nt: f64,
    /// Squared residual over its predicted variance.
    pub nis: f64,
}

impl Innovation {
    /// No update.
    pub const NONE: Self = Self { residual_nt: f64::NAN, nis: f64::NAN };
}

/// Reason why a line was not filtered. Rows are counted from 0.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NavigationError {
    /// A parameter is out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The line's columns are invalid.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// State or covariance is no longer finite.
    #[error(
        "the filter diverged at row {row} (tt = {tt_s} s): its covariance is no longer finite and \
         non-negative; check the INS columns and the time steps before this row"
    )]
    Diverged {
        /// Row.
        row: usize,
        /// Time of the row.
        tt_s: f64,
    },
}

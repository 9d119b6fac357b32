//! Error of a map's slope in the difference of two magnetometers.

use params::{Rule, obeys};

use crate::navigation::ins_error::ParameterError;
use crate::navigation::ins_series::SeriesError;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::NavigationError;

/// Assumed inverse wavenumber of the anomalies, in metres, for a line that is too flat to determine it.
const FLAT_LENGTH_M: f64 = 1000.0;

/// Standard deviations of the errors of a map's slope. The default is an exact map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlopeError<'a> {
    /// Standard deviation of the error along any horizontal direction, in nT/m.
    pub horizontal_nt_per_m: f64,
    /// Standard deviation of the upward slope's error at each sample, in nT/m; empty for a map that contains the upward
    /// slope.
    pub upward_nt_per_m: &'a [f64],
    /// Correlation length of both errors along the track, in metres.
    pub length_m: f64,
}

impl SlopeError<'_> {
    /// Whether any error is above 0.
    pub(crate) fn is_any(&self) -> bool {
        self.horizontal_nt_per_m > 0.0 || !self.upward_nt_per_m.is_empty()
    }

    /// Standard deviation of the upward slope's error at a sample, in nT/m.
    pub(crate) fn upward_at(&self, row: usize) -> f64 {
        self.upward_nt_per_m.get(row).copied().unwrap_or(0.0)
    }

    /// Rejects invalid errors.
    pub(crate) fn check(&self, rows: usize) -> Result<(), NavigationError> {
        let require = |name: &str, value: f64, rule: Rule| obeys(&value, name, rule).map_err(ParameterError);
        let found = self.upward_nt_per_m.len();
        if !self.upward_nt_per_m.is_empty() && found != rows {
            return Err(SeriesError::Length { column: "slope error", rows: found, expected: rows }.into());
        }
        require("gradient_slope_sigma", self.horizontal_nt_per_m, Rule::NotNegative)?;
        for sigma in self.upward_nt_per_m {
            require("slope error", *sigma, Rule::NotNegative)?;
        }
        if self.is_any() {
            require("slope error length", self.length_m, Rule::Positive)?;
        }
        Ok(())
    }
}

/// Slope of a map along the INS positions of a line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapSlope {
    /// Root mean square of the horizontal slope, in nT/m; 0 if the line is off the map.
    pub rms_nt_per_m: f64,
    /// Inverse wavenumber of the map's anomalies, in metres: standard deviation over root mean square of the slope.
    pub length_m: f64,
    /// Standard deviation of the upward slope at each sample, in nT/m; empty if the map contains the upward slope.
    ///
    /// The field of buried sources has as much power in its upward slope as in both horizontal slopes together. The
    /// estimate combines the horizontal slope at the sample, which follows the local strength of the anomalies, with
    /// the horizontal slope of the whole line, which does not vanish at the top of an anomaly.
    pub upward_nt_per_m: Vec<f64>,
}

impl MapSlope {
    /// Slope along a line.
    pub fn along(line: &NavigationLine<'_>) -> Self {
        let ins = line.ins;
        let (mut sum, mut square, mut known) = (0.0, 0.0, 0.0);
        let mut slopes = Vec::with_capacity(ins.len());
        for row in 0..ins.len() {
            let at = line.map.at(ins.lat_deg[row], ins.lon_deg[row], ins.alt_m[row]);
            slopes.push(at.map(|at| line.slope_nt_per_m(row, &at)));
            if let Some(at) = at {
                sum += at.value_nt;
                square += at.value_nt * at.value_nt;
                known += 1.0;
            }
        }
        if known == 0.0 {
            return Self { length_m: FLAT_LENGTH_M, ..Self::default() };
        }
        let rms_nt_per_m = (slopes.iter().flatten().map(|slope| slope * slope).sum::<f64>() / known).sqrt();
        let deviation_nt = (square / known - (sum / known).powi(2)).max(0.0).sqrt();
        let length_m = deviation_nt / rms_nt_per_m;
        let length_m = if length_m.is_finite() && length_m > 0.0 { length_m } else { FLAT_LENGTH_M };
        let upward = |slope: Option<f64>| slope.map_or(rms_nt_per_m, |slope| rms_nt_per_m.hypot(slope));
        let upward_nt_per_m =
            if line.map.has_upward_slope() { vec![] } else { slopes.into_iter().map(upward).collect() };
        Self { rms_nt_per_m, length_m, upward_nt_per_m }
    }

    /// Errors of the slope for a given error along the baseline.
    pub fn error(&self, horizontal_nt_per_m: f64) -> SlopeError<'_> {
        SlopeError { horizontal_nt_per_m, upward_nt_per_m: &self.upward_nt_per_m, length_m: self.length_m }
    }
}

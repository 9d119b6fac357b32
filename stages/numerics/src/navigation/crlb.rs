//! Cramér-Rao bound of magnetic navigation along a known path: lower bound on the error of any unbiased filter.
//!
//! The covariance recursion of the filter is evaluated at the truth, with the map's slope there and without any
//! estimate. For the linear error dynamics with Gaussian noise this is the recursion of the information matrix
//!
//! ```text
//! J₀ = P₀⁻¹,     J ← J + Hᵀ H/σ²,     J ← (Φ J⁻¹ Φᵀ + Q)⁻¹
//! ```
//!
//! of [Tichavský, Muravchik & Nehorai 1998, (21)] for the single path that was flown, without an expectation over
//! paths. The recursion is written with P = J⁻¹, as in MagNav.jl's `crlb`. No filter with the same models can have a
//! smaller mean squared error over the draws of noise, except through the nonlinearity of the map within the filter's
//! position error.
//!
//! The INS affects the bound only through the velocity, specific force and attitude in F. A measurement affects the
//! bound only by its presence, not by its value. A measurement that is NaN, or whose sigma is not above 0, adds no
//! information. The same holds for a sample where the true position is off the map or in an unknown cell. Both kinds of
//! samples are counted.

use crate::navigation::aided::filter::AidedFilter;
use crate::navigation::aided::{AidedOutput, AidedParameters, Aids};
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::recursion::{self, FilterRecursion};
use crate::navigation::gaussian::{Sensitivity, StateEstimate};
use crate::navigation::ins_series::{InsSeries, SeriesError};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::position_fixes::StateFix;

/// True path, one value per sample in every column.
#[derive(Clone, Copy, Debug)]
pub struct TruePath<'a> {
    /// Geodetic latitude, in degrees.
    pub lat_deg: &'a [f64],
    /// Longitude, in degrees.
    pub lon_deg: &'a [f64],
    /// Height above the ellipsoid, in metres.
    pub alt_m: &'a [f64],
    /// Velocity north, east and down, in m/s; `None` uses the velocity of the INS.
    pub velocity_ned_mps: Option<[&'a [f64]; 3]>,
}

impl<'a> TruePath<'a> {
    /// Output of an INS along the path, without position error.
    ///
    /// # Errors
    /// Fails for columns whose length differs from that of the line, values that are not finite, or latitudes at or
    /// beyond a pole. Errors use the column names of a flight table.
    pub fn along(&self, ins: &InsSeries<'a>) -> Result<InsSeries<'a>, SeriesError> {
        let [vn_mps, ve_mps, vd_mps] = self.velocity_ned_mps.unwrap_or([ins.vn_mps, ins.ve_mps, ins.vd_mps]);
        let position = [("lat", self.lat_deg), ("lon", self.lon_deg), ("alt", self.alt_m)];
        for (column, values) in position.into_iter().chain([("vn", vn_mps), ("ve", ve_mps), ("vd", vd_mps)]) {
            let (rows, expected) = (values.len(), ins.len());
            if rows != expected {
                return Err(SeriesError::Length { column, rows, expected });
            }
            if let Some(row) = values.iter().position(|value| !value.is_finite()) {
                return Err(SeriesError::NotFinite { column, row, value: values[row] });
            }
        }
        if let Some(row) = self.lat_deg.iter().position(|lat| lat.abs() >= 90.0) {
            return Err(SeriesError::Latitude { column: "lat", row, lat_deg: self.lat_deg[row] });
        }
        let Self { lat_deg, lon_deg, alt_m, .. } = *self;
        Ok(InsSeries { lat_deg, lon_deg, alt_m, vn_mps, ve_mps, vd_mps, ..*ins })
    }
}

/// Computes the bound along a path.
///
/// The estimate is the truth: positions, and velocities if given, else the velocities of the INS. `sd_n_m`, `sd_e_m`
/// and `cov_ne_m2` are the bound, and so is `p` if it is kept; `x` is empty. `residual_nt` is the measurement minus the
/// offset and the field at the true position, which is the temporal variation plus the noise. `nis` is the squared
/// residual over the variance σ_S² + σ² of variation and noise; a mean of 1 confirms the assumed noise. The residual is
/// not the innovation of a filter. The offset is the mean residual over the first `offset_window_s` seconds.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`] and [`TruePath::along`]. Also fails with
/// [`NavigationError::Diverged`] if a variance is not finite or is negative.
pub fn run(
    line: &NavigationLine<'_>,
    path: &TruePath<'_>,
    keep_covariance: bool,
) -> Result<NavigationOutput, NavigationError> {
    line.check()?;
    let truth = path.along(line.ins)?;
    let mut field = line.predicted();
    let mut output = NavigationOutput::with_capacity(truth.len(), false, keep_covariance);
    let (offset_nt, samples) = field.offset(&truth, line.measurement_nt, line.offset_window_s);
    output.report.offset_nt = offset_nt;
    output.report.offset_samples = samples;
    // The estimate is the truth: an aiding position adds its information, but does not change the state.
    let still = |fix: Option<StateFix>| fix.map(|fix| StateFix { error: 0.0, ..fix });
    let bound = CramerRaoBound { line, truth, field, offset_nt, output };
    Ok(recursion::run_along(bound, &truth, &line.errors, |row| line.fixes_at(row).map(still))?.output)
}

/// Same as [`run`], with further measurements in addition to the scalar field. The residual of each measurement is
/// measurement minus truth. The NIS is the square of the residual over the variance of noise and slow error.
///
/// The bound uses the exact map, so [`Aids::flat_over_m`] is ignored.
///
/// # Errors
/// Returns the errors of [`run`] and [`Aids::check`].
pub fn run_aided(
    line: &NavigationLine<'_>,
    path: &TruePath<'_>,
    keep_covariance: bool,
    aids: &Aids<'_>,
) -> Result<AidedOutput, NavigationError> {
    line.check()?;
    aids.check(line.ins.len())?;
    let truth = path.along(line.ins)?;
    let (line, aids) = (NavigationLine { ins: &truth, ..*line }, Aids { flat_over_m: None, ..*aids });
    let parameters = AidedParameters { keep_covariance, ..AidedParameters::default() };
    AidedFilter::of_bound(&line, &aids, &parameters).run()
}

/// Cramér-Rao bound along a line, with its output so far.
struct CramerRaoBound<'a> {
    line: &'a NavigationLine<'a>,
    truth: InsSeries<'a>,
    field: PredictedField<'a>,
    offset_nt: f64,
    output: NavigationOutput,
}

impl FilterRecursion for CramerRaoBound<'_> {
    fn output(&mut self) -> &mut NavigationOutput {
        &mut self.output
    }

    /// Adds the information of the measurement of a row, if usable, and counts it.
    #[inline(always)]
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation {
        let Some((measured_nt, noise_nt2)) = self.line.measured(row, self.offset_nt) else {
            self.output.report.missing_measurements += 1;
            return Innovation::NONE;
        };
        let Some(field) = self.field.at_error(&self.truth, row, [0.0; 3]) else {
            self.output.report.off_map += 1;
            return Innovation::NONE;
        };
        self.output.report.updates += 1;
        estimate.correct(&estimate.linearised(Sensitivity::from_field(&field)), 0.0, noise_nt2);
        let residual_nt = measured_nt - field.value_nt;
        let variance_nt2 = self.line.errors.fogm_sigma_nt.powi(2) + noise_nt2;
        Innovation { residual_nt, nis: residual_nt * residual_nt / variance_nt2 }
    }
}

#[cfg(test)]
mod tests;

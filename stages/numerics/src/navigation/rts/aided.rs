//! Smoother with further measurements in addition to the scalar field.

use crate::navigation::aids::{AidInnovations, Aids, SampleUsage};
use crate::navigation::fixed_lag::whole::smooth;
use crate::navigation::fixed_lag::{self, FixedLagParameters};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{NavigationError, NavigationOutput};

use super::{RtsParameters, RtsReport};

/// Smoothed line with further measurements.
#[derive(Clone, Debug, Default)]
pub struct AidedRtsOutput {
    /// Track, as in [`RtsOutput`](super::RtsOutput).
    pub line: NavigationOutput,
    /// Report on the iteration. The size of the last step in standard deviations is not available.
    pub iterations: RtsReport,
    /// Outcome of each sample.
    pub usage: Vec<SampleUsage>,
    /// Innovations of the further measurements in the last forward pass.
    pub aids: AidInnovations,
    /// Horizontal slope of the field at the estimate of the first filter, in nT/m; NaN off the map.
    pub slope_nt_per_m: Vec<f64>,
}

/// Same as [`run`](super::run), with further measurements: the most probable trajectory of all states, by Gauss-Newton
/// iteration from the path of the extended Kalman filter. The run requires about 15 kB per sample. This run has a
/// single start, whereas [`run`](super::run) has four. With an initial error too large for the map it may therefore end
/// in another minimum. A loss applies only to the scalar field. The scalar field is not used where the map is too flat
/// at the estimate of the extended Kalman filter.
///
/// # Errors
/// Returns the errors of [`run`](super::run) and [`Aids::check`].
pub fn run_aided(
    line: &NavigationLine<'_>,
    parameters: &RtsParameters,
    aids: &Aids<'_>,
) -> Result<AidedRtsOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    aids.check(line.ins.len())?;
    super::check_window(line)?;
    let RtsParameters { iterations, tolerance_m, loss, loss_scale, keep_states, keep_covariance } = *parameters;
    let loss_scale = loss_scale.unwrap_or(loss.usual_scale());
    let of_window = FixedLagParameters { iterations, loss, loss_scale, ..FixedLagParameters::default() };
    let whole = smooth(&of_window, line, aids, tolerance_m)?;
    let mut output = NavigationOutput::with_capacity(line.ins.len(), keep_states, keep_covariance);
    (output.report.offset_nt, output.report.offset_samples) = whole.offset;
    let mut usage = vec![];
    for (row, (x, p)) in whole.x.iter().zip(&whole.p).enumerate() {
        let became = match whole.usage[row] {
            fixed_lag::FixedLagUsage::Used => SampleUsage::Used,
            fixed_lag::FixedLagUsage::Missing => SampleUsage::Missing,
            fixed_lag::FixedLagUsage::OffMap => SampleUsage::OffMap,
            fixed_lag::FixedLagUsage::Flat => SampleUsage::Flat,
        };
        output.report.count(became);
        usage.push(became);
        let innovation = whole.innovations[row];
        output.push(line.ins, row, |state| x[state], |i, j| p[i][j], innovation, line.errors.earth);
    }
    let iterations = RtsReport {
        passes: whole.report.iterations,
        halved: usize::from(whole.report.smallest_step < 1.0),
        converged: whole.report.converged,
        last_step_m: whole.report.last_step_m,
        last_step_sigmas: f64::NAN,
        cost: 0.5 * whole.report.chi_square,
    };
    Ok(AidedRtsOutput { line: output, iterations, usage, aids: whole.aids, slope_nt_per_m: whole.slope_nt_per_m })
}

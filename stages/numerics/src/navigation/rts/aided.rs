//! The smoother with further measurements besides the scalar field.

use crate::navigation::aids::{AidInnovations, Aids, Usage};
use crate::navigation::fixed_lag::whole::smooth;
use crate::navigation::fixed_lag::{self, FixedLagParameters};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{NavigationError, NavigationOutput};

use super::{SmootherParameters, SmootherReport};

/// A smoothed line with further measurements.
#[derive(Clone, Debug, Default)]
pub struct AidedSmootherOutput {
    /// The line, as that of [`SmootherOutput`](super::SmootherOutput).
    pub line: NavigationOutput,
    /// Report on the iteration. The size of its last step in standard deviations is unknown.
    pub iterations: SmootherReport,
    /// Outcome of each sample.
    pub usage: Vec<Usage>,
    /// Innovations of the further measurements, of the last forward pass.
    pub aids: AidInnovations,
    /// The horizontal slope of the field at the estimate of the first filter, in nT/m; NaN off the map.
    pub slope_nt_per_m: Vec<f64>,
}

/// [`run`](super::run) with further measurements: the most probable trajectory of all states, by Gauss and Newton's
/// iteration from the path of the extended Kalman filter. It takes some 15 kB a sample, and one start where
/// [`run`](super::run) has four, so that an initial error too large for the map ends in another valley. A loss is of
/// the scalar field alone. Where the map is too flat at the estimate of that filter, the scalar field is not used.
///
/// # Errors
/// Fails as [`run`](super::run) and [`Aids::check`].
pub fn run_aided(
    line: &NavigationLine<'_>,
    parameters: &SmootherParameters,
    aids: &Aids<'_>,
) -> Result<AidedSmootherOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    aids.check(line.ins.len())?;
    super::check_window(line)?;
    let SmootherParameters { iterations, tolerance_m, loss, loss_scale, keep_states, keep_covariance } = *parameters;
    let loss_scale = loss_scale.unwrap_or(loss.usual_scale());
    let of_window = FixedLagParameters { iterations, loss, loss_scale, ..FixedLagParameters::default() };
    let whole = smooth(&of_window, line, aids, tolerance_m)?;
    let mut output = NavigationOutput::with_capacity(line.ins.len(), keep_states, keep_covariance);
    (output.report.offset_nt, output.report.offset_samples) = whole.offset;
    let mut usage = vec![];
    for (row, (x, p)) in whole.x.iter().zip(&whole.p).enumerate() {
        let became = match whole.usage[row] {
            fixed_lag::Usage::Used => Usage::Used,
            fixed_lag::Usage::Missing => Usage::Missing,
            fixed_lag::Usage::OffMap => Usage::OffMap,
            fixed_lag::Usage::Flat => Usage::Flat,
        };
        output.report.count(became);
        usage.push(became);
        let innovation = whole.innovations[row];
        output.push(line.ins, row, |state| x[state], |i, j| p[i][j], innovation, line.errors.earth);
    }
    let iterations = SmootherReport {
        passes: whole.report.iterations,
        halved: usize::from(whole.report.smallest_step < 1.0),
        converged: whole.report.converged,
        last_step_m: whole.report.last_step_m,
        last_step_sigmas: f64::NAN,
        cost: 0.5 * whole.report.chi_square,
    };
    Ok(AidedSmootherOutput { line: output, iterations, usage, aids: whole.aids, slope_nt_per_m: whole.slope_nt_per_m })
}

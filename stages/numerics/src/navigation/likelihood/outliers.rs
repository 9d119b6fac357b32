//! Measurements that an extended Kalman filter of the scalar field rejects.

use crate::navigation::aided::{self, AidedParameters, Aids, SampleUsage};
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::recursion::{self, FilterRecursion};
use crate::navigation::gaussian::{Sensitivity, StateEstimate};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};

/// NIS above which a measurement is rejected; one valid measurement in 100,000 exceeds this limit.
pub const GATE_NIS: f64 = 19.5;

/// Number of consecutive rejections that indicates a wrong prediction instead of wrong measurements.
pub(super) const RECOVERED_AFTER: usize = 20;

/// Whether each measurement of a line is an outlier: its NIS exceeds [`GATE_NIS`] in an extended Kalman filter that
/// does not use it. After 20 rejections in a row the next measurement is used, regardless of its innovation. The filter
/// has the further states of `aids`, such as the change of the aircraft's permanent field and the lag.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`]. Also fails with [`NavigationError::Diverged`] if a state or
/// variance is not finite.
pub fn outliers(line: &NavigationLine<'_>, aids: &Aids<'_>) -> Result<Vec<bool>, NavigationError> {
    if aids.is_any() {
        let (gate_nis, recover_after) = (Some(GATE_NIS), Some(RECOVERED_AFTER));
        let parameters = AidedParameters { gate_nis, recover_after, ..AidedParameters::default() };
        let output = aided::run(line, aids, &parameters)?;
        return Ok(output.usage.iter().map(|usage| *usage == SampleUsage::Gated).collect());
    }
    line.check()?;
    let mut field = line.predicted();
    let (offset_nt, _) = field.offset(line.ins, line.measurement_nt, line.offset_window_s);
    let rejected = Vec::with_capacity(line.ins.len());
    let output = NavigationOutput::with_capacity(line.ins.len(), false, false);
    let filter = OutlierEkf { line, field, offset_nt, rejected, in_a_row: 0, output };
    Ok(recursion::run(filter, line)?.rejected)
}

struct OutlierEkf<'a> {
    line: &'a NavigationLine<'a>,
    field: PredictedField<'a>,
    offset_nt: f64,
    rejected: Vec<bool>,
    in_a_row: usize,
    output: NavigationOutput,
}

impl FilterRecursion for OutlierEkf<'_> {
    fn output(&mut self) -> &mut NavigationOutput {
        &mut self.output
    }

    #[inline(always)]
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation {
        self.rejected.push(false);
        let Some((value_nt, variance_nt2)) = self.line.measured(row, self.offset_nt) else { return Innovation::NONE };
        let [lat, lon, alt, temporal_nt] = estimate.measured();
        let Some(field) = self.field.at_error(self.line.ins, row, [lat, lon, alt]) else { return Innovation::NONE };
        let residual_nt = value_nt - (field.value_nt + temporal_nt);
        let covariance = estimate.horizontal();
        let variance_nt2 =
            variance_nt2 + self.field.curvature_nt2(self.line.ins, row, [lat, lon, alt], field.value_nt, covariance);
        let at = estimate.linearised(Sensitivity::from_field(&field));
        let nis = residual_nt * residual_nt / (at.variance + variance_nt2);
        if nis > GATE_NIS && self.in_a_row < RECOVERED_AFTER {
            self.in_a_row += 1;
            self.rejected[row] = true;
            return Innovation::NONE;
        }
        self.in_a_row = 0;
        estimate.correct(&at, residual_nt, variance_nt2);
        Innovation::NONE
    }
}

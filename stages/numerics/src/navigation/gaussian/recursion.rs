//! Recursion of a filter of the 18 states along a line.

use pulp::{Simd, WithSimd};

use crate::earth::geodesy::EarthModel;
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::position_fixes::StateFix;

use super::{StateEstimate, StepModel};

/// Recursion of a filter with a single estimate along a line.
pub(crate) trait FilterRecursion {
    /// Output of the estimates.
    fn output(&mut self) -> &mut NavigationOutput;

    /// Changes the estimate before the next time update.
    #[inline(always)]
    fn before_step(&mut self, _: &mut StateEstimate) {}

    /// Corrects the estimate with the measurement of a row, if usable, and counts it.
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation;

    /// Filters along an INS: for each row the step, the aiding positions, and the measurement.
    ///
    /// # Errors
    /// Returns the errors of [`StateEstimate::check`].
    #[inline(always)]
    fn along(
        &mut self,
        ins: &InsSeries<'_>,
        errors: &InsErrorModel,
        fixes: impl Fn(usize) -> [Option<StateFix>; 3],
    ) -> Result<(), NavigationError> {
        let (mut estimate, model) = (StateEstimate::start_of(errors, ins), StepModel::from_error_model(errors));
        for row in 0..ins.len() {
            self.sample(&mut estimate, &model, ins, row, fixes(row), errors.earth)?;
        }
        Ok(())
    }

    /// Filters one sample: the step from the row before, if any, the aiding positions, and the measurement.
    ///
    /// # Errors
    /// Returns the errors of [`StateEstimate::check`].
    #[inline(always)]
    fn sample(
        &mut self,
        estimate: &mut StateEstimate,
        model: &StepModel,
        ins: &InsSeries<'_>,
        row: usize,
        fixes: [Option<StateFix>; 3],
        earth: EarthModel,
    ) -> Result<(), NavigationError> {
        if row > 0 {
            self.before_step(estimate);
            estimate.propagate(model, ins, row);
        }
        estimate.aid(fixes);
        let innovation = self.measure(estimate, row);
        estimate.check(row, ins.tt_s[row])?;
        let (x, p) = (&estimate.x, &estimate.p);
        self.output().push(ins, row, |state| x[state], |i, j| p[i][j], innovation, earth);
        Ok(())
    }
}

/// Runs a filter along an INS, compiled for the vector unit of the machine.
///
/// # Errors
/// Returns the errors of [`FilterRecursion::along`].
pub(crate) fn run_along<F: FilterRecursion>(
    filter: F,
    ins: &InsSeries<'_>,
    errors: &InsErrorModel,
    fixes: impl Fn(usize) -> [Option<StateFix>; 3],
) -> Result<F, NavigationError> {
    pulp::Arch::new().dispatch(Dispatched { filter, ins, errors, fixes })
}

/// Runs a filter along the INS and the aiding positions of a line, as [`run_along`].
///
/// # Errors
/// Returns the errors of [`FilterRecursion::along`].
pub(crate) fn run<F: FilterRecursion>(filter: F, line: &NavigationLine<'_>) -> Result<F, NavigationError> {
    run_along(filter, line.ins, &line.errors, |row| line.fixes_at(row))
}

struct Dispatched<'a, F, P> {
    filter: F,
    ins: &'a InsSeries<'a>,
    errors: &'a InsErrorModel,
    fixes: P,
}

impl<F: FilterRecursion, P: Fn(usize) -> [Option<StateFix>; 3]> WithSimd for Dispatched<'_, F, P> {
    type Output = Result<F, NavigationError>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { mut filter, ins, errors, fixes } = self;
        filter.along(ins, errors, fixes)?;
        Ok(filter)
    }
}

//! Filter whose noise at each sample is a function of the earlier samples.

use pulp::{Scalar, Simd, WithSimd};

use super::EkfInput;
use super::pack::{EkfLane, EkfPack, EkfSamples};
use crate::earth::geodesy::EarthModel;
use crate::navigation::gaussian::StepModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::measurement::Reading;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::position_fixes::StateFix;

/// Factors on assumed standard deviations at a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NoiseFactors {
    /// Factor on the standard deviation of the measurement.
    pub(crate) measurement: f64,
    /// Factor on the standard deviation of the noise that drives the temporal variation in the step to the sample.
    pub(crate) fogm: f64,
}

/// Source of the noise of a filter.
pub(crate) trait NoiseSource {
    /// Factors at a row. `output` holds the previous rows.
    fn factors(&mut self, row: usize, output: &NavigationOutput) -> NoiseFactors;
}

/// Samples of a line, with a factor on the noise of the present measurement.
#[derive(Clone, Copy)]
struct ScaledSamples<'a> {
    point: EkfInput<'a>,
    factor: f64,
}

impl EkfSamples for ScaledSamples<'_> {
    #[inline(always)]
    fn reading(&self, row: usize) -> Reading {
        let (measurement_nt, sigma_nt) = self.point.reading(row);
        (measurement_nt, sigma_nt * self.factor)
    }

    #[inline(always)]
    fn has_fixes(&self) -> bool {
        self.point.has_fixes()
    }

    #[inline(always)]
    fn fixes(&self, ins: &InsSeries<'_>, row: usize, earth: EarthModel) -> [Option<StateFix>; 3] {
        self.point.fixes(ins, row, earth)
    }
}

/// Filters one line with the noise of a source. With factors of 1 the result is bit-identical to
/// [`run`](super::run).
///
/// # Errors
/// Returns the errors of [`run`](super::run).
pub(crate) fn run_stepped<N: NoiseSource>(
    ins: &InsSeries<'_>,
    point: EkfInput<'_>,
    source: &mut N,
) -> Result<NavigationOutput, NavigationError> {
    point.check(ins, &ins.check())?;
    pulp::Arch::new().dispatch(SteppedEkf { ins, point, source })
}

/// One filter, compiled for the vector unit of the machine.
struct SteppedEkf<'a, N> {
    ins: &'a InsSeries<'a>,
    point: EkfInput<'a>,
    source: &'a mut N,
}

impl<N: NoiseSource> WithSimd for SteppedEkf<'_, N> {
    type Output = Result<NavigationOutput, NavigationError>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { ins, point, source } = self;
        let model = StepModel::shared(&point.parameters.errors);
        let lane = EkfLane::of_line(ScaledSamples { point, factor: 1.0 }, point, ins);
        let mut pack = EkfPack::new(Scalar, vec![lane], model.noise());
        let mut step = model.empty_lane_step();
        for row in 0..ins.len() {
            let factors = source.factors(row, &pack.filters[0].output);
            pack.filters[0].samples.factor = factors.measurement;
            pack.scale_fogm(Scalar, factors.fogm);
            if row == 0 {
                pack.start(Scalar, ins);
            } else {
                model.renew_lane_step(&mut step, ins, row);
                pack.advance(Scalar, ins, row, std::slice::from_ref(&step));
            }
            if pack.filters[0].fault.is_some() {
                break;
            }
        }
        // The pack has exactly one filter.
        pack.into_filters().pop().map_or_else(|| Ok(NavigationOutput::default()), EkfLane::finish)
    }
}

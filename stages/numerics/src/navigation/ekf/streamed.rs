//! The filter fed sample by sample: one lane, and one step in memory.

use pulp::{Scalar, Simd, WithSimd};

use super::EkfParameters;
use super::pack::{EkfLane, EkfPack, EkfSamples};
use crate::earth::geodesy::EarthModel;
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::{LaneStep, StepModel};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::measurement::Reading;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::pinson::STATES;
use crate::navigation::position_fixes::{NO_FIX, StateFix};
use crate::navigation::stream::{SampleInput, StateVisitor, StreamedFilter};

/// Measurement and aiding position of the present sample.
#[derive(Clone, Copy)]
struct PresentSample {
    reading: Reading,
    fixes: [Option<StateFix>; 3],
}

impl EkfSamples for PresentSample {
    #[inline(always)]
    fn reading(&self, _: usize) -> Reading {
        self.reading
    }

    #[inline(always)]
    fn has_fixes(&self) -> bool {
        self.fixes.iter().any(Option::is_some)
    }

    #[inline(always)]
    fn fixes(&self, _: &InsSeries<'_>, _: usize, _: EarthModel) -> [Option<StateFix>; 3] {
        self.fixes
    }
}

/// Filter between two samples.
#[derive(Clone)]
pub(crate) struct StreamedEkf {
    pack: EkfPack<'static, Scalar, PresentSample>,
    model: StepModel,
    step: LaneStep,
}

impl StreamedEkf {
    pub(crate) fn new(parameters: EkfParameters, field: PredictedField<'static>) -> Self {
        let model = StepModel::shared(&parameters.errors);
        let present = PresentSample { reading: (f64::NAN, f64::NAN), fixes: NO_FIX };
        let lane = EkfLane::with_field(present, parameters, field, 1);
        let (pack, step) = (EkfPack::new(Scalar, vec![lane], model.noise()), model.empty_lane_step());
        Self { pack, model, step }
    }

    fn lane(&self) -> &EkfLane<'static, PresentSample> {
        // The pack has exactly one filter.
        &self.pack.filters[0]
    }

    #[inline(always)]
    fn advance(&mut self, ins: &InsSeries<'_>, row: usize) {
        if row == 0 {
            return self.pack.start(Scalar, ins);
        }
        self.model.renew_lane_step(&mut self.step, ins, row);
        self.pack.advance(Scalar, ins, row, std::slice::from_ref(&self.step));
    }
}

impl StreamedFilter for StreamedEkf {
    fn sample(&mut self, ins: &InsSeries<'_>, row: usize, input: &SampleInput<'_>) -> Result<(), NavigationError> {
        let lane = &mut self.pack.filters[0];
        lane.samples = PresentSample { reading: input.reading(0), fixes: input.fixes };
        pulp::Arch::new().dispatch(EkfKernel { filter: self, ins, row });
        self.lane().fault.clone().map_or(Ok(()), Err)
    }

    fn clear(&mut self) {
        self.pack.filters[0].output.clear_rows();
    }

    fn output(&self) -> &NavigationOutput {
        &self.lane().output
    }

    fn visit(&mut self, state: &mut dyn StateVisitor) {
        state.numbers(&mut self.pack.x);
        for row in 0..STATES {
            state.numbers(&mut self.pack.p[row]);
        }
        let lane = &mut self.pack.filters[0];
        state.point(&mut lane.field);
        state.report(&mut lane.output.report);
    }
}

/// One sample, compiled for the vector unit of the machine.
struct EkfKernel<'f, 'a> {
    filter: &'f mut StreamedEkf,
    ins: &'a InsSeries<'a>,
    row: usize,
}

impl WithSimd for EkfKernel<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.filter.advance(self.ins, self.row);
    }
}

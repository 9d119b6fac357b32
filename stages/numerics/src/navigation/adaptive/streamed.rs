//! The filter fed sample by sample.

use pulp::{Simd, WithSimd};

use super::noise::NoiseEstimator;
use super::{AdaptiveEkf, AdaptiveParameters, AdaptiveState, ProcessNoiseIncrement, check_bounds};
use crate::earth::geodesy::EarthModel;
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::recursion::FilterRecursion;
use crate::navigation::gaussian::{LinearisedMeasurement, Sensitivity, StateEstimate, StepModel};
use crate::navigation::ins_error::{InsErrorModel, ParameterError};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::measurement::Reading;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::pinson::STATES;
use crate::navigation::position_fixes::StateFix;
use crate::navigation::stream::{MagnetometerEstimate, SampleInput, StateVisitor, StreamedFilter};

/// Filter between two samples.
#[derive(Clone)]
pub(crate) struct StreamedAdaptive {
    state: AdaptiveState<'static>,
    estimate: StateEstimate,
    model: StepModel,
    errors: InsErrorModel,
}

impl StreamedAdaptive {
    /// Filter of magnetometers with these bounds of the estimated standard deviations, in nT.
    ///
    /// # Errors
    /// Returns the errors of [`AdaptiveParameters::check`]. Also fails for invalid bounds.
    pub(crate) fn new(
        parameters: &AdaptiveParameters,
        bounds_nt: &[[f64; 2]],
        errors: InsErrorModel,
        field: PredictedField<'static>,
    ) -> Result<Self, ParameterError> {
        parameters.check()?;
        bounds_nt.iter().try_for_each(|bounds_nt| check_bounds(*bounds_nt))?;
        let learners = bounds_nt.iter().map(|bounds_nt| NoiseEstimator::new(parameters, *bounds_nt, 1)).collect();
        let navigation = NavigationOutput::with_capacity(1, true, true);
        let state = AdaptiveState::new(parameters, field, learners, navigation, 1);
        let estimate = StateEstimate { x: [0.0; STATES], p: [[0.0; STATES]; STATES] };
        Ok(Self { state, estimate, model: StepModel::from_error_model(&errors), errors })
    }
}

impl StreamedFilter for StreamedAdaptive {
    fn sample(&mut self, ins: &InsSeries<'_>, row: usize, input: &SampleInput<'_>) -> Result<(), NavigationError> {
        let Self { state, estimate, model, errors } = self;
        if row == 0 {
            *estimate = StateEstimate::start_of(errors, ins);
        }
        let readings = |magnetometer: usize, _: usize| input.reading(magnetometer);
        let filter = AdaptiveEkf { state, ins, readings };
        let (fixes, earth) = (input.fixes, errors.earth);
        pulp::Arch::new().dispatch(AdaptiveKernel { filter, estimate, model, row, fixes, earth })
    }

    fn clear(&mut self) {
        let AdaptiveState { navigation, given_back, learners, .. } = &mut self.state;
        navigation.clear_rows();
        given_back.clear();
        learners.iter_mut().for_each(|learner| learner.adapted.sigma_nt.clear());
    }

    fn output(&self) -> &NavigationOutput {
        &self.state.navigation
    }

    fn magnetometer(&self, place: usize) -> Option<MagnetometerEstimate> {
        let sigma_nt = *self.state.learners.get(place)?.adapted.sigma_nt.first()?;
        Some(MagnetometerEstimate { sigma_nt, ..MagnetometerEstimate::default() })
    }

    fn visit(&mut self, state: &mut dyn StateVisitor) {
        let StateEstimate { x, p } = &mut self.estimate;
        state.numbers(x);
        p.iter_mut().for_each(|row| state.numbers(row));
        let AdaptiveState { field, learners, excess, pending, navigation, .. } = &mut self.state;
        state.point(field);
        state.report(&mut navigation.report);
        learners.iter_mut().for_each(|learner| learner.visit(state));
        excess.visit(state);
        let mut is_pending = usize::from(pending.is_some());
        state.count(&mut is_pending, 1);
        let mut increment = pending.take().unwrap_or(ProcessNoiseIncrement {
            at: LinearisedMeasurement { h: Sensitivity::default(), ph: [0.0; STATES], variance: 0.0 },
            noise_nt2: 0.0,
            share: 0.0,
        });
        state.numbers(&mut increment.at.h.0);
        state.numbers(&mut increment.at.ph);
        state.number(&mut increment.at.variance);
        state.number(&mut increment.noise_nt2);
        state.number(&mut increment.share);
        *pending = (is_pending == 1).then_some(increment);
    }
}

/// One sample, compiled for the vector unit of the machine.
struct AdaptiveKernel<'s, R> {
    filter: AdaptiveEkf<'s, 'static, R>,
    estimate: &'s mut StateEstimate,
    model: &'s StepModel,
    row: usize,
    fixes: [Option<StateFix>; 3],
    earth: EarthModel,
}

impl<R: Fn(usize, usize) -> Reading> WithSimd for AdaptiveKernel<'_, R> {
    type Output = Result<(), NavigationError>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { mut filter, estimate, model, row, fixes, earth } = self;
        let ins = filter.ins;
        filter.sample(estimate, model, ins, row, fixes, earth)
    }
}

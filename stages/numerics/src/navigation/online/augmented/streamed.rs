//! The filter fed sample by sample.

use std::sync::Arc;

use pulp::{Simd, WithSimd};

use super::filter::AugmentedFilter;
use super::{AircraftFieldModel, ExtraStates, LineModel, MagnetometerTrack, OnlineParameters, check};
use crate::maps::map_stack::FieldMap;
use crate::navigation::aids::{AidStates, Aids};
use crate::navigation::field::PredictedField;
use crate::navigation::ins_error::{InsErrorModel, ParameterError};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::pinson::STATES;
use crate::navigation::stream::{MagnetometerEstimate, SampleInput, StateVisitor};

/// Filter between two samples.
#[derive(Clone)]
pub(crate) struct StreamedAugmented<M> {
    filter: AugmentedFilter<'static, M>,
    map: Arc<FieldMap>,
    errors: InsErrorModel,
    second_order: bool,
}

impl<M: AircraftFieldModel> StreamedAugmented<M> {
    /// Filter for the given number of magnetometers.
    ///
    /// # Errors
    /// Fails for invalid states, zero magnetometers, or an invalid gate.
    pub(crate) fn new(
        (map, field, second_order): (Arc<FieldMap>, PredictedField<'static>, bool),
        errors: InsErrorModel,
        model: M,
        states: ExtraStates,
        (magnetometers, parameters): (usize, &OnlineParameters),
    ) -> Result<Self, ParameterError> {
        check(&states, magnetometers, parameters)?;
        let parameters =
            OnlineParameters { keep_states: true, keep_covariance: true, keep_coefficients: true, ..*parameters };
        let own = states.mean.len();
        let of_aids = AidStates::new(&Aids::default(), STATES + own);
        let states = (own, states, of_aids);
        let filter = AugmentedFilter::new(field, &errors, model, states, &parameters, [magnetometers, 1]);
        Ok(Self { filter, map, errors, second_order })
    }

    /// Model of the aircraft field.
    pub(crate) fn model_mut(&mut self) -> &mut M {
        &mut self.filter.model
    }

    /// Filters a sample.
    ///
    /// # Errors
    /// Returns the errors of the filter of a whole line.
    pub(crate) fn sample(
        &mut self,
        ins: &InsSeries<'_>,
        row: usize,
        input: &SampleInput<'_>,
    ) -> Result<(), NavigationError> {
        let Self { filter, map, errors, second_order } = self;
        let line = LineModel {
            ins,
            map,
            core: None,
            errors: *errors,
            offset_window_s: 0.0,
            fixes: None,
            aids: Aids::default(),
            second_order: *second_order,
        };
        pulp::Arch::new().dispatch(AugmentedKernel { filter, line: &line, row, input })
    }

    /// Removes the output of the last sample and keeps the allocated memory.
    pub(crate) fn clear(&mut self) {
        let output = &mut self.filter.output;
        output.navigation.clear_rows();
        output.c_by_row.clear();
        output.c_sigma_by_row.clear();
        for MagnetometerTrack { residual_nt, nis, aircraft_nt, gated, .. } in &mut output.magnetometers {
            [residual_nt, nis, aircraft_nt].into_iter().for_each(Vec::clear);
            gated.clear();
        }
    }

    pub(crate) fn output(&self) -> &NavigationOutput {
        &self.filter.output.navigation
    }

    /// Coefficients after the last sample and their standard deviations.
    pub(crate) fn coefficients(&self) -> (&[f64], &[f64]) {
        (&self.filter.output.c_by_row, &self.filter.output.c_sigma_by_row)
    }

    pub(crate) fn magnetometer(&self, place: usize) -> Option<MagnetometerEstimate> {
        let MagnetometerTrack { residual_nt, nis, aircraft_nt, .. } = self.filter.output.magnetometers.get(place)?;
        let (residual_nt, nis, aircraft_nt) = (*residual_nt.first()?, *nis.first()?, *aircraft_nt.first()?);
        Some(MagnetometerEstimate { residual_nt, nis, aircraft_nt, ..MagnetometerEstimate::default() })
    }

    pub(crate) fn visit(&mut self, state: &mut dyn StateVisitor) {
        self.filter.visit(state);
    }
}

/// One sample, compiled for the vector unit of the machine.
struct AugmentedKernel<'s, M> {
    filter: &'s mut AugmentedFilter<'static, M>,
    line: &'s LineModel<'s>,
    row: usize,
    input: &'s SampleInput<'s>,
}

impl<M: AircraftFieldModel> WithSimd for AugmentedKernel<'_, M> {
    type Output = Result<(), NavigationError>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { filter, line, row, input } = self;
        filter.sample(line, row, input.fixes, &|magnetometer| input.reading(magnetometer))
    }
}

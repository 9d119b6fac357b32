//! The filter fed sample by sample, with the terms of each sample.

use std::sync::Arc;

use super::augmented::{AircraftFieldModel, StreamedAugmented, refused};
use super::{CoefficientPrior, OnlineMagnetometer, OnlineParameters, aircraft_nt, extra_states};
use crate::maps::map_stack::FieldMap;
use crate::navigation::field::PredictedField;
use crate::navigation::ins_error::{InsErrorModel, ParameterError};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::stream::{MagnetometerEstimate, SampleInput, StateVisitor, StreamedFilter};

/// Scalar magnetometer of a stream with the model of its aircraft field.
#[derive(Clone, Copy, Debug)]
pub struct StreamMagnetometer<'a> {
    /// Prior of the coefficients.
    pub prior: &'a CoefficientPrior,
    /// Spectral density of each coefficient's random walk, in its unit squared per s; 0 for a constant.
    pub walk_density: &'a [f64],
}

/// Magnetometer of a line, with empty columns.
fn without_columns<'a>(magnetometer: &StreamMagnetometer<'a>) -> OnlineMagnetometer<'a> {
    let StreamMagnetometer { prior, walk_density } = *magnetometer;
    OnlineMagnetometer { measurement_nt: &[], sigma_nt: &[], terms: &[], prior, walk_density }
}

/// Terms of the present sample: the terms of each magnetometer in turn, in the order of the coefficients.
#[derive(Clone)]
pub(crate) struct PresentTerms {
    /// Index of the first coefficient of each magnetometer, and the number of all coefficients.
    first: Vec<usize>,
    terms: Vec<f64>,
}

impl PresentTerms {
    fn of(&self, magnetometer: usize) -> std::ops::Range<usize> {
        self.first[magnetometer]..self.first[magnetometer + 1]
    }
}

impl AircraftFieldModel for PresentTerms {
    #[inline(always)]
    fn linearised(&mut self, magnetometer: usize, _: usize, c: &[f64], derivatives: &mut [f64]) -> Option<f64> {
        let own = self.of(magnetometer);
        derivatives[own.clone()].copy_from_slice(&self.terms[own]);
        self.value(magnetometer, 0, c)
    }

    #[inline(always)]
    fn value(&mut self, magnetometer: usize, _: usize, c: &[f64]) -> Option<f64> {
        let own = self.of(magnetometer);
        let field_nt = aircraft_nt(&self.terms[own.clone()], &c[own]);
        field_nt.is_finite().then_some(field_nt)
    }
}

/// Filter between two samples.
#[derive(Clone)]
pub(crate) struct StreamedOnline(StreamedAugmented<PresentTerms>);

impl StreamedOnline {
    /// Filter of magnetometers.
    ///
    /// # Errors
    /// Returns the errors that [`run`](super::run) returns for priors, densities and gate.
    pub(crate) fn new(
        map: Arc<FieldMap>,
        field: PredictedField<'static>,
        (errors, second_order): (InsErrorModel, bool),
        magnetometers: &[StreamMagnetometer<'_>],
        parameters: &OnlineParameters,
    ) -> Result<Self, ParameterError> {
        let like_line: Vec<OnlineMagnetometer<'_>> = magnetometers.iter().map(without_columns).collect();
        let states = extra_states(&like_line, None)?;
        let mut first = vec![0];
        for magnetometer in magnetometers {
            let terms = magnetometer.prior.mean.len();
            if terms == 0 {
                return Err(refused("prior", "a magnetometer without terms has no aircraft field to estimate"));
            }
            first.push(first.last().unwrap_or(&0) + terms);
        }
        let model = PresentTerms { first, terms: vec![0.0; states.mean.len()] };
        let sizes = (magnetometers.len(), parameters);
        Ok(Self(StreamedAugmented::new((map, field, second_order), errors, model, states, sizes)?))
    }
}

impl StreamedFilter for StreamedOnline {
    fn sample(&mut self, ins: &InsSeries<'_>, row: usize, input: &SampleInput<'_>) -> Result<(), NavigationError> {
        self.0.model_mut().terms.copy_from_slice(input.terms);
        self.0.sample(ins, row, input)
    }

    fn clear(&mut self) {
        self.0.clear();
    }

    fn output(&self) -> &NavigationOutput {
        self.0.output()
    }

    fn magnetometer(&self, place: usize) -> Option<MagnetometerEstimate> {
        self.0.magnetometer(place)
    }

    fn coefficients(&self) -> (&[f64], &[f64]) {
        self.0.coefficients()
    }

    fn visit(&mut self, state: &mut dyn StateVisitor) {
        self.0.visit(state);
    }
}

//! Extended Kalman filter with the 18 states and the states of a model of the aircraft field (the further states).
//!
//! The measurement of each magnetometer is z = map(INS + x) + core(INS + x) + S + m(c). m is the model's field as a
//! function of the further states c. All magnetometers of a sample are linearised at the predicted state and processed
//! one at a time. With independent noises this equals the joint update, and their order does not matter.

mod filter;
mod streamed;

use std::sync::Arc;

use nalgebra::DMatrix;
use params::Fault;

use crate::earth::core_field::CoreField;
use crate::maps::map_stack::FieldMap;
use crate::navigation::aids::{AidInnovations, AidStates, Aids, SampleUsage};
use crate::navigation::field::PredictedField;
use crate::navigation::ins_error::{InsErrorModel, ParameterError};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::pinson::STATES;
use crate::navigation::position_fixes::PositionFixes;

use filter::{AugmentedFilter, AugmentedFilterRun};
pub(crate) use streamed::StreamedAugmented;

/// Line with its map and its error model, without the measurements.
#[derive(Clone, Copy, Debug)]
pub struct LineModel<'a> {
    /// INS.
    pub ins: &'a InsSeries<'a>,
    /// Map.
    pub map: &'a FieldMap,
    /// Core field, if and only if the measurements contain it.
    pub core: Option<&'a Arc<CoreField>>,
    /// Error sources of the INS and the temporal variation.
    pub errors: InsErrorModel,
    /// Length, in seconds, of the window from the start of the line. The mean of measurement minus prediction over the
    /// window (with the prior of the aircraft field) is subtracted from each magnetometer; 0 subtracts nothing. The
    /// subtraction is not needed if a constant is among the states and its prior is as wide as the offset.
    pub offset_window_s: f64,
    /// Aiding positions, each used before the measurements of its sample.
    pub fixes: Option<&'a PositionFixes>,
    /// Further measurements, processed after the magnetometers. Where the map is too flat, a magnetometer corrects only
    /// the temporal variation, the map error and the aircraft field.
    pub aids: Aids<'a>,
    /// Same as [`NavigationLine::second_order`].
    pub second_order: bool,
}

impl<'a> LineModel<'a> {
    /// Model of a line, without the line's own measurement.
    pub fn from_line(line: &NavigationLine<'a>) -> Self {
        let NavigationLine { ins, map, core, errors, offset_window_s, fixes, second_order, .. } = *line;
        Self { ins, map, core, errors, offset_window_s, fixes, second_order, aids: Aids::default() }
    }

    /// Line with a magnetometer's measurement and its standard deviation, in nT.
    pub(crate) fn with(&self, measurement_nt: &'a [f64], sigma_nt: &'a [f64]) -> NavigationLine<'a> {
        let Self { ins, map, core, errors, offset_window_s, fixes, second_order, .. } = *self;
        NavigationLine { ins, measurement_nt, sigma_nt, map, core, errors, offset_window_s, fixes, second_order }
    }
}

/// Optional outputs in addition to the track, and the innovation gate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OnlineParameters {
    /// Largest NIS of a measurement given the previous magnetometers of the sample; measurements with larger NIS are
    /// rejected and counted. `None` uses every measurement.
    pub gate_nis: Option<f64>,
    /// After this number of consecutive rejections of a magnetometer, its next measurement is used. `None` sets no
    /// limit.
    pub recover_after: Option<usize>,
    /// Returns the 18 error states of every sample.
    pub keep_states: bool,
    /// Returns the covariance of the states at every sample.
    pub keep_covariance: bool,
    /// Returns the coefficients (or weights) of every sample, and their standard deviations.
    pub keep_coefficients: bool,
}

/// Use of the samples of a magnetometer. The first four counts add up to the number of samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MagnetometerReport {
    /// Number of used samples.
    pub updates: usize,
    /// Number of samples whose measurement or predicted aircraft field is not finite, or whose sigma is not above 0.
    pub missing: usize,
    /// Number of samples whose predicted position is off the map or in an unknown cell.
    pub off_map: usize,
    /// Number of samples that the innovation gate rejected.
    pub gated: usize,
    /// Offset subtracted from every measurement, in nT.
    pub offset_nt: f64,
    /// Number of samples averaged for the offset.
    pub offset_samples: usize,
}

/// One magnetometer along the line, one value per sample.
#[derive(Clone, Debug, Default)]
pub struct MagnetometerTrack {
    /// Measurement minus prediction at the state before the sample, in nT; NaN if the measurement or the prediction is
    /// missing.
    pub residual_nt: Vec<f64>,
    /// NIS given the residuals of the previous magnetometers; NaN where the residual is NaN.
    pub nis: Vec<f64>,
    /// Aircraft field from the state after the sample, in nT; NaN if the model has no finite input.
    pub aircraft_nt: Vec<f64>,
    /// Whether the innovation gate rejected the measurement.
    pub gated: Vec<bool>,
    /// Use of the samples.
    pub report: MagnetometerReport,
}

/// Aircraft field at each magnetometer as a function of the further states.
pub(crate) trait AircraftFieldModel {
    /// Field of a sample at the states `c`, in nT. Writes the derivatives of the field with respect to the states to
    /// `derivatives`, which is initially zero. `None` if an input is missing.
    fn linearised(&mut self, magnetometer: usize, row: usize, c: &[f64], derivatives: &mut [f64]) -> Option<f64>;

    /// Field without derivatives.
    fn value(&mut self, magnetometer: usize, row: usize, c: &[f64]) -> Option<f64>;
}

/// Further states.
#[derive(Clone, Debug, Default)]
pub(crate) struct ExtraStates {
    /// Prior mean, to which states with a time constant return.
    pub(crate) mean: Vec<f64>,
    /// Prior covariance, row-major.
    pub(crate) covariance: Vec<f64>,
    /// Spectral densities of the driving noise of the states, per second.
    pub(crate) density: Vec<f64>,
    /// Time constants, in seconds; infinite for random walks.
    pub(crate) tau_s: Vec<f64>,
}

/// Error of a parameter.
pub(crate) fn refused(param: &str, what: impl Into<String>) -> ParameterError {
    ParameterError(Fault::new(what).of_param(param))
}

impl ExtraStates {
    /// Rejects means that are not finite, an invalid covariance, negative densities and time constants.
    pub(crate) fn check(&self) -> Result<(), ParameterError> {
        let states = self.mean.len();
        if let Some(at) = self.mean.iter().position(|mean| !mean.is_finite()) {
            return Err(refused("prior", format!("the prior mean of coefficient {at} is {}", self.mean[at])));
        }
        check_covariance(&self.covariance, states)?;
        let not_a_density = |x: f64| !(0.0..f64::INFINITY).contains(&x);
        for (name, values, bad) in [
            ("spectral density of the random walk", &self.density, not_a_density as fn(f64) -> bool),
            ("time constant", &self.tau_s, |x| x.is_nan() || x <= 0.0),
        ] {
            if values.len() != states {
                let what = format!("{} values of the {name} are given for {states} coefficients", values.len());
                return Err(refused("walk_density", what));
            }
            if let Some(at) = values.iter().position(|value| bad(*value)) {
                return Err(refused("walk_density", format!("the {name} of coefficient {at} is {}", values[at])));
            }
        }
        Ok(())
    }

    /// Appends the states of further measurements.
    fn with(&self, aids: &AidStates) -> Self {
        let (own, count) = (self.mean.len(), self.mean.len() + aids.errors.len());
        let mut all = Self { covariance: vec![0.0; count * count], ..self.clone() };
        for (row, from) in self.covariance.chunks_exact(own.max(1)).enumerate() {
            all.covariance[row * count..][..own].copy_from_slice(from);
        }
        for (place, error) in aids.errors.iter().enumerate() {
            all.covariance[(own + place) * (count + 1)] = error.sigma * error.sigma;
            all.mean.push(0.0);
            // The time constant of a state with a correlation length is infinite here and is computed at each step.
            all.density.push(if error.tau_s.is_finite() { error.noise_density() } else { 0.0 });
            all.tau_s.push(error.tau_s);
        }
        all
    }

    /// Decay factor, over a step, of each state's deviation from its mean, and the variance that the step adds.
    #[inline(always)]
    fn step(&self, dt_s: f64, decay: &mut [f64], noise: &mut [f64]) {
        for (state, (decay, noise)) in decay.iter_mut().zip(noise).enumerate() {
            let (tau_s, density) = (self.tau_s[state], self.density[state]);
            *decay = if tau_s.is_finite() { (-dt_s / tau_s).exp() } else { 1.0 };
            *noise = match tau_s.is_finite() {
                true => -0.5 * density * tau_s * (-2.0 * dt_s / tau_s).exp_m1(),
                false => density * dt_s,
            };
        }
    }
}

/// Rejects a matrix that is not finite, symmetric and positive semidefinite. Correlations from a matrix inverse have
/// rounding errors of about 1e-9.
pub(crate) fn check_covariance(covariance: &[f64], states: usize) -> Result<(), ParameterError> {
    if covariance.len() != states * states {
        let what = format!("the prior covariance has {} entries for {states} coefficients", covariance.len());
        return Err(refused("prior", what));
    }
    if let Some(at) = covariance.iter().position(|entry| !entry.is_finite()) {
        let (row, column) = (at / states, at % states);
        let what = format!("the prior covariance is {} in row {row}, column {column}", covariance[at]);
        return Err(refused("prior", what));
    }
    let at = |row: usize, column: usize| covariance[row * states + column];
    let bad = |what: &str| Err(refused("prior", format!("the prior covariance is not {what}")));
    if (0..states).any(|state| at(state, state) < 0.0) {
        return bad("positive semidefinite: a variance is below 0");
    }
    let scale = |row: usize, column: usize| (at(row, row) * at(column, column)).sqrt();
    let correlation = DMatrix::from_fn(states, states, |row, column| match scale(row, column) {
        0.0 if at(row, column) == 0.0 => 0.0,
        scale => at(row, column) / scale,
    });
    if correlation.iter().any(|entry| entry.is_nan() || entry.abs() > 1.0 + 1e-9) {
        return bad("positive semidefinite: a correlation is outside -1 to 1");
    }
    if (&correlation - correlation.transpose()).amax() > 1e-9 {
        return bad("symmetric");
    }
    if states > 0 && correlation.symmetric_eigenvalues().min() < -1e-9 {
        return bad("positive semidefinite");
    }
    Ok(())
}

/// Measurement of a magnetometer and its standard deviation, in nT.
pub(crate) type MagnetometerColumns<'a> = (&'a [f64], &'a [f64]);

/// Output of the filter on a line.
#[derive(Clone)]
pub(crate) struct AugmentedOutput {
    pub(crate) navigation: NavigationOutput,
    pub(crate) magnetometers: Vec<MagnetometerTrack>,
    /// Further states after the last sample.
    pub(crate) c: Vec<f64>,
    /// Covariance of the further states, row-major.
    pub(crate) c_covariance: Vec<f64>,
    /// Outcome of each sample, if there are further measurements.
    pub(crate) usage: Vec<SampleUsage>,
    /// Innovations of the further measurements.
    pub(crate) aids: AidInnovations,
    /// Horizontal slope of the predicted field, in nT/m, if the flatness of the map is tested.
    pub(crate) slope_nt_per_m: Vec<f64>,
    /// Further states of every sample and their standard deviations, one row per sample; empty unless
    /// `keep_coefficients` is set.
    pub(crate) c_by_row: Vec<f64>,
    pub(crate) c_sigma_by_row: Vec<f64>,
}

/// Filters a line.
pub(crate) fn run<M: AircraftFieldModel>(
    line: &LineModel<'_>,
    readings: &[MagnetometerColumns<'_>],
    model: M,
    states: &ExtraStates,
    parameters: &OnlineParameters,
) -> Result<AugmentedOutput, NavigationError> {
    check(states, readings.len(), parameters)?;
    let window_s = line.offset_window_s;
    if !(window_s >= 0.0 && window_s.is_finite()) {
        return Err(refused("offset_window_s", format!("`offset_window_s` must be at least 0, not {window_s}")).into());
    }
    let lines: Vec<NavigationLine<'_>> = readings.iter().map(|(nt, sigma_nt)| line.with(nt, sigma_nt)).collect();
    for line in &lines {
        line.check()?;
    }
    line.aids.check(line.ins.len())?;
    let of_aids = AidStates::new(&line.aids, STATES + states.mean.len());
    let all = states.with(&of_aids);
    let (own, sizes) = (states.mean.len(), [lines.len(), line.ins.len()]);
    let predicted = PredictedField::new(line.map, line.core).with_second_order(line.second_order);
    let mut filter = AugmentedFilter::new(predicted, &line.errors, model, (own, all, of_aids), parameters, sizes);
    filter.take_offsets(&lines);
    pulp::Arch::new().dispatch(AugmentedFilterRun { filter, line, magnetometers: readings })
}

/// Fails for invalid states, an empty list of magnetometers, or an invalid gate.
fn check(states: &ExtraStates, magnetometers: usize, parameters: &OnlineParameters) -> Result<(), ParameterError> {
    states.check()?;
    if magnetometers == 0 {
        return Err(refused("mags", "no magnetometer is given"));
    }
    match parameters.gate_nis {
        Some(gate) if !(gate > 0.0 && gate.is_finite()) => {
            Err(refused("gate_nis", format!("`gate_nis` must be above 0, not {gate}")))
        }
        _ => Ok(()),
    }
}

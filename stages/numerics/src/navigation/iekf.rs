//! Iterated extended Kalman filter of magnetic navigation.
//!
//! States, measurement and steps are the same as in `ekf`. While `ekf` linearises the map once at the predicted
//! position x⁻, this filter searches for the most probable state after the measurement, the minimum of
//!
//! ```text
//! J(x) = (x - x⁻)ᵀ P⁻¹ (x - x⁻)/2 + (z - h(x))²/(2 σ²)
//! ```
//!
//! by the Gauss-Newton iteration: the map is linearised again at each iterate xᵢ, with its row Hᵢ,
//!
//! ```text
//! x⁺ = x⁻ + Kᵢ (z - h(xᵢ) - Hᵢ (x⁻ - xᵢ)),      Kᵢ = P Hᵢᵀ/(Hᵢ P Hᵢᵀ + σ²)
//! ```
//!
//! [Jazwinski 1970, chapter 8; Bell & Cathey 1993]. A step that would raise J is halved until J does not rise. After
//! ten halvings the iteration ends at the last iterate, so no result is less probable than the prediction. The
//! covariance is the covariance of the last linearisation. All iterates are x⁻ + P v, where v has entries for position
//! and S only. The first term of J is then vᵀ P v/2, which needs no inverse, and an iteration costs little more than
//! its map value.
//!
//! With one iteration the filter equals the extended Kalman filter: the full step is taken and J is not computed.
//!
//! Irregularities are treated as in `ekf`. If a measurement is NaN or infinite, its sigma is not above 0, or the
//! predicted position is off the map, the filter only predicts. An iterate off the map, or in an unknown cell, has no
//! J, so the step to it is halved.

use crate::earth::field_value::FieldValue;
use crate::navigation::field::PredictedField;
use crate::navigation::ins_error::ParameterError;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use params::{Rule, obeys};

use crate::navigation::gaussian::linearise::{Optimum, ScalarProblem, ScalarSearch};
use crate::navigation::gaussian::recursion::{self, FilterRecursion};
use crate::navigation::gaussian::{LinearisedMeasurement, MEASURED, Sensitivity, StateEstimate};
use crate::navigation::transition::add_scaled;

/// Parameters of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IekfParameters {
    /// Maximum number of linearisations of the map per measurement, at least 1.
    pub iterations: usize,
    /// Position change, in metres, below which the iteration ends.
    pub tolerance_m: f64,
    /// Largest NIS of a measurement; measurements with larger NIS are rejected and counted. `None` uses every
    /// measurement.
    pub gate_nis: Option<f64>,
    /// Returns the error states of every sample (144 bytes each).
    pub keep_states: bool,
    /// Returns the covariance of every sample (2.6 kB each).
    pub keep_covariance: bool,
}

impl Default for IekfParameters {
    fn default() -> Self {
        Self { iterations: 5, tolerance_m: 0.1, gate_nis: None, keep_states: true, keep_covariance: false }
    }
}

impl IekfParameters {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Fails for zero iterations, or for a tolerance or gate that is not a finite number above 0.
    pub fn check(&self) -> Result<(), ParameterError> {
        obeys(&self.iterations, "iterations", Rule::Positive).map_err(ParameterError)?;
        obeys(&self.tolerance_m, "tolerance_m", Rule::Positive).map_err(ParameterError)?;
        self.gate_nis.map_or(Ok(()), |gate| obeys(&gate, "gate_nis", Rule::Positive).map_err(ParameterError))
    }
}

/// Report on the iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IekfReport {
    /// Total number of linearisations of the map in all updates.
    pub linearisations: usize,
    /// Number of halved steps.
    pub halved: usize,
    /// Updates whose last step was not below the tolerance: the iterations were exhausted, or no step lowered J. The
    /// number is always 0 with one iteration.
    pub unconverged: usize,
}

/// Output of the filter on a line. `residual_nt` and `nis` refer to the predicted state, as in `ekf`.
#[derive(Clone, Debug, Default)]
pub struct IekfOutput {
    /// Track.
    pub line: NavigationOutput,
    /// Report on the iterations.
    pub iterations: IekfReport,
}

/// Filters one line.
///
/// # Errors
/// Returns the errors of [`IekfParameters::check`] and [`NavigationLine::check`]. Also fails for an `offset_window_s`
/// that is not a finite number of at least 0. Also fails with [`NavigationError::Diverged`] if a state or variance is
/// not finite or a variance is negative.
pub fn run(line: &NavigationLine<'_>, parameters: &IekfParameters) -> Result<IekfOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    obeys(&line.offset_window_s, "offset_window_s", Rule::NotNegative).map_err(ParameterError)?;
    Ok(recursion::run(IteratedEkf::new(line, parameters), line)?.output)
}

struct IteratedEkf<'a> {
    line: &'a NavigationLine<'a>,
    parameters: &'a IekfParameters,
    field: PredictedField<'a>,
    output: IekfOutput,
}

impl FilterRecursion for IteratedEkf<'_> {
    fn output(&mut self) -> &mut NavigationOutput {
        &mut self.output.line
    }

    #[inline(always)]
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation {
        let report = &mut self.output.line.report;
        let Some((value_nt, variance_nt2)) = self.line.measured(row, report.offset_nt) else {
            report.missing_measurements += 1;
            return Innovation::NONE;
        };
        let [lat, lon, alt, temporal_nt] = estimate.measured();
        let Some(field) = self.field.at_error(self.line.ins, row, [lat, lon, alt]) else {
            report.off_map += 1;
            return Innovation::NONE;
        };
        let predicted = estimate.linearised(Sensitivity::from_field(&field));
        let residual_nt = value_nt - (field.value_nt + temporal_nt);
        let nis = residual_nt * residual_nt / (predicted.variance + variance_nt2);
        let innovation = Innovation { residual_nt, nis };
        if self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            report.gated += 1;
            return innovation;
        }
        report.updates += 1;
        let Optimum { v, h, .. } = self.most_probable(estimate, row, (value_nt, variance_nt2), field);
        let LinearisedMeasurement { h, ph, variance } = estimate.linearised(h);
        // x⁻ + P v, before P is corrected.
        for (factor, state) in v.into_iter().zip(MEASURED) {
            add_scaled(&mut estimate.x, factor, &estimate.p[state]);
        }
        let weight = 1.0 / (variance + variance_nt2);
        estimate.correct_covariance(&h, &ph.map(|ph| ph * weight), &ph, variance_nt2);
        innovation
    }
}

impl<'a> IteratedEkf<'a> {
    fn new(line: &'a NavigationLine<'a>, parameters: &'a IekfParameters) -> Self {
        let IekfParameters { keep_states, keep_covariance, .. } = *parameters;
        let mut field = line.predicted();
        let mut output = NavigationOutput::with_capacity(line.ins.len(), keep_states, keep_covariance);
        let (offset_nt, samples) = field.offset(line.ins, line.measurement_nt, line.offset_window_s);
        (output.report.offset_nt, output.report.offset_samples) = (offset_nt, samples);
        Self { line, parameters, field, output: IekfOutput { line: output, iterations: IekfReport::default() } }
    }

    /// Most probable state after a measured value (nT) with the variance of its noise (nT²); `field` is the field at
    /// the predicted state.
    #[inline(always)]
    fn most_probable(
        &mut self,
        predicted: &StateEstimate,
        row: usize,
        (value_nt, variance_nt2): (f64, f64),
        field: FieldValue,
    ) -> Optimum {
        let ins = self.line.ins;
        let search = ScalarSearch {
            iterations: self.parameters.iterations,
            tolerance_m: self.parameters.tolerance_m,
            m_per_rad: self.line.errors.earth.north_east_m_per_rad(ins.lat_deg[row].to_radians(), ins.alt_m[row]),
        };
        let problem = ScalarProblem::from_estimate(predicted, value_nt, variance_nt2);
        let optimum = problem.most_probable(&search, field, |position| self.field.at_error(ins, row, position));
        let report = &mut self.output.iterations;
        report.linearisations += optimum.linearisations;
        report.halved += optimum.halved;
        report.unconverged += usize::from(!optimum.converged);
        optimum
    }
}

#[cfg(test)]
mod tests;

//! One forward and backward pass over the line: exact solution of the linear problem.

use crate::earth::field_value::FieldValue;
use crate::navigation::field::PredictedField;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationReport};
use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix, StateVector};
use pulp::{Simd, WithSimd};

use super::RtsParameters;
use super::adjoint::{AdjointState, ForwardUpdate};
use crate::navigation::gaussian::linearise::{ScalarProblem, ScalarSearch};
use crate::navigation::gaussian::{MeasurementUpdate, Sensitivity, StateEstimate, StepModel, inner, measured_states};
use crate::navigation::loss::RobustLoss;
use crate::navigation::position_fixes::StateFix;
use crate::navigation::transition::add_scaled;

/// Number of samples between two stored states of the forward pass. The results that the backward pass recomputes
/// between them stay in the second-level cache.
const BLOCK: usize = 64;

/// Trajectory, and the field along the trajectory.
type TrajectoryField<'a> = (&'a [StateVector], &'a [Option<FieldValue>]);

/// Linearisation point of the map, and the residuals that determine the weights of a robust loss.
#[derive(Clone, Copy)]
pub(super) enum RtsLinearisation<'a> {
    /// Most probable state after each measurement, given the previous measurements.
    Filtered(FirstPass),
    /// Trajectory, and the residuals along the trajectory.
    Along(TrajectoryField<'a>),
}

/// Settings of a first pass.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct FirstPass {
    /// Maximum number of linearisations per measurement.
    pub(super) iterations: usize,
    /// Whether a robust loss weights the normalised innovations.
    pub(super) robust: bool,
    /// Factor on the standard deviation of every measurement.
    pub(super) sigma_factor: f64,
}

/// Solution of a linear problem.
#[derive(Default)]
pub(super) struct RtsSolution {
    pub(super) x: Vec<StateVector>,
    /// Twice the part of J that is due to the initial state and the process noise.
    pub(super) motion: f64,
    /// The same quadratic form between the solution and the trajectory of the linearisation.
    pub(super) motion_with_last: f64,
    /// Σ (H d)²/σ² over the weighted measurements, with the step d from that trajectory.
    pub(super) measured_step: f64,
}

/// Measurement of the linear problem, value = H x + noise. For an aiding position, the value is in the unit of the
/// measured state.
#[derive(Clone, Copy, Debug)]
struct LinearMeasurement {
    h: Sensitivity,
    value_nt: f64,
    /// Variance divided by the weight of a robust loss.
    variance_nt2: f64,
}

/// Result of the forward pass at a sample of a block.
struct ForwardSample {
    /// Φ of the step to the sample.
    phi: StateMatrix,
    /// Estimate after the measurement of the sample.
    estimate: StateEstimate,
    /// Updates with the aiding positions and the measurement.
    used: [Option<ForwardUpdate>; 4],
}

/// State of the passes, with additional results of the last solution.
pub(super) struct SmootherPass<'a> {
    line: &'a NavigationLine<'a>,
    loss: RobustLoss,
    offset_nt: f64,
    tolerance_m: f64,
    keep_covariance: bool,
    model: StepModel,
    measurements: Vec<Option<LinearMeasurement>>,
    /// Estimate before the measurement of the first sample of each block.
    kept: Vec<StateEstimate>,
    block: Vec<ForwardSample>,
    pub(super) innovations: Vec<Innovation>,
    /// Smoothed covariances of latitude, of latitude and longitude, of longitude, in rad².
    pub(super) position_covariances: Vec<[f64; 3]>,
    /// All covariances, if requested.
    pub(super) covariances: Vec<StateMatrix>,
    pub(super) report: NavigationReport,
}

impl<'a> SmootherPass<'a> {
    pub(super) fn new(line: &'a NavigationLine<'a>, parameters: &RtsParameters, offset_nt: f64) -> Self {
        let (rows, keep_covariance) = (line.ins.len(), parameters.keep_covariance);
        Self {
            line,
            loss: RobustLoss::new(parameters.loss, parameters.loss_scale),
            offset_nt,
            tolerance_m: parameters.tolerance_m,
            keep_covariance,
            model: StepModel::from_error_model(&line.errors),
            measurements: vec![None; rows],
            kept: Vec::with_capacity(rows.div_ceil(BLOCK)),
            block: Vec::with_capacity(BLOCK),
            innovations: vec![Innovation::NONE; rows],
            position_covariances: vec![[0.0; 3]; rows],
            covariances: vec![[[0.0; STATES]; STATES]; if keep_covariance { rows } else { 0 }],
            report: NavigationReport::default(),
        }
    }

    /// Smooths the line with the map linearised along a trajectory, or at the predicted states.
    pub(super) fn run(
        &mut self,
        about: RtsLinearisation<'_>,
        field: &mut PredictedField<'a>,
    ) -> Result<RtsSolution, NavigationError> {
        pulp::Arch::new().dispatch(SimdPass { pass: self, about, field })
    }

    #[inline(always)]
    fn forward(&mut self, about: RtsLinearisation<'_>, field: &mut PredictedField<'a>) -> Result<(), NavigationError> {
        let ins = self.line.ins;
        self.report = NavigationReport::default();
        self.kept.clear();
        let mut estimate = StateEstimate::start_of(&self.line.errors, ins);
        for row in 0..ins.len() {
            if row > 0 {
                estimate.propagate(&self.model, ins, row);
            }
            if row % BLOCK == 0 {
                self.kept.push(estimate);
            }
            self.aid(row, &mut estimate);
            self.linearise(row, &estimate, about, field);
            if let Some(measurement) = &self.measurements[row] {
                measurement.correct(&mut estimate);
            }
            estimate.check(row, ins.tt_s[row])?;
        }
        Ok(())
    }

    /// Updates with the aiding positions of a row.
    #[inline(always)]
    fn aid(&self, row: usize, estimate: &mut StateEstimate) -> [Option<ForwardUpdate>; 3] {
        self.line.fixes_at(row).map(|fix| fix.map(|fix| LinearMeasurement::of_fix(&fix).correct(estimate)))
    }

    /// Measurement of a row in the linear problem, and its innovation.
    #[inline(always)]
    fn linearise(
        &mut self,
        row: usize,
        predicted: &StateEstimate,
        about: RtsLinearisation<'_>,
        field: &mut PredictedField<'a>,
    ) {
        self.measurements[row] = None;
        self.innovations[row] = Innovation::NONE;
        let Some((value_nt, variance_nt2)) = self.line.measured(row, self.offset_nt) else {
            self.report.missing_measurements += 1;
            return;
        };
        let (expected, ins) = (predicted.measured(), self.line.ins);
        let found = match about {
            RtsLinearisation::Along((x, fields)) => fields[row].map(|field| (measured_states(&x[row]), field)),
            RtsLinearisation::Filtered(_) => {
                let [lat, lon, alt, _] = expected;
                field.at_error(ins, row, [lat, lon, alt]).map(|field| (expected, field))
            }
        };
        let Some((at, value)) = found else {
            self.report.off_map += 1;
            return;
        };
        self.report.updates += 1;
        let mut linear = LinearMeasurement::new(value_nt, variance_nt2, at, &value);
        let innovation = linear.innovation(predicted);
        let variance_nt2 = match about {
            RtsLinearisation::Along(_) => {
                let r = (value_nt - (value.value_nt + at[3])) / variance_nt2.sqrt();
                variance_nt2 / self.loss.weight(r)
            }
            RtsLinearisation::Filtered(FirstPass { robust, sigma_factor, .. }) => {
                let weight = if robust { self.loss.weight(innovation.nis.sqrt()) } else { 1.0 };
                variance_nt2 * sigma_factor.powi(2) / weight
            }
        };
        if let RtsLinearisation::Filtered(FirstPass { iterations, .. }) = about {
            let m_per_rad = self.line.errors.earth.north_east_m_per_rad(ins.lat_deg[row].to_radians(), ins.alt_m[row]);
            let search = ScalarSearch { iterations, tolerance_m: self.tolerance_m, m_per_rad };
            let problem = ScalarProblem::from_estimate(predicted, value_nt, variance_nt2);
            let optimum = problem.most_probable(&search, value, |position| field.at_error(ins, row, position));
            let (at, value) = optimum.linearised_at;
            linear = LinearMeasurement::new(value_nt, variance_nt2, at, &value);
        }
        self.innovations[row] = innovation;
        self.measurements[row] = Some(LinearMeasurement { variance_nt2, ..linear });
    }

    #[inline(always)]
    fn backward(&mut self, about: RtsLinearisation<'_>) -> Result<RtsSolution, NavigationError> {
        let rows = self.line.ins.len();
        let mut solution = RtsSolution { x: vec![[0.0; STATES]; rows], ..RtsSolution::default() };
        let mut adjoint = AdjointState::END;
        for first in (0..rows).step_by(BLOCK).rev() {
            self.again(first);
            for at in (0..self.block.len()).rev() {
                let (row, ForwardSample { phi, estimate, used }) = (first + at, &self.block[at]);
                let x = smoothed_state(estimate, &adjoint);
                let covariance = position_covariance(estimate, &adjoint);
                // A sum of products with zero differs from zero only if a factor is not finite.
                let finite = x.iter().chain(&covariance).map(|value| value * 0.0).sum::<f64>();
                if finite != 0.0 || covariance[0] < 0.0 || covariance[2] < 0.0 {
                    return Err(NavigationError::Diverged { row, tt_s: self.line.ins.tt_s[row] });
                }
                solution.x[row] = x;
                self.position_covariances[row] = covariance;
                if self.keep_covariance {
                    self.covariances[row] = adjoint.smoothed(&estimate.p);
                }
                for used in used.iter().rev().flatten() {
                    let u = adjoint.through_measurement(used);
                    solution.motion += u * used.h.dot(&x);
                    if let RtsLinearisation::Along((last, _)) = about {
                        let (last_nt, weight) = (used.h.dot(&last[row]), 1.0 / used.variance_nt2);
                        solution.motion_with_last += u * last_nt;
                        solution.measured_step += (used.h.dot(&x) - last_nt).powi(2) * weight;
                    }
                }
                if row > 0 {
                    adjoint.through_step(phi);
                }
            }
        }
        Ok(solution)
    }

    /// Repeats the filter for the block of samples that begins at `first`, from the stored state of the forward pass.
    #[inline(always)]
    fn again(&mut self, first: usize) {
        let ins = self.line.ins;
        let mut estimate = self.kept[first / BLOCK];
        self.block.clear();
        for row in first..(first + BLOCK).min(ins.len()) {
            let mut phi = [[0.0; STATES]; STATES];
            if row > first {
                phi = estimate.propagate(&self.model, ins, row);
            } else if row > 0 {
                phi = self.model.transition(ins, row).phi;
            }
            let [lat, lon, alt] = self.aid(row, &mut estimate);
            let measured = self.measurements[row].as_ref().map(|measurement| measurement.correct(&mut estimate));
            let used = [lat, lon, alt, measured];
            self.block.push(ForwardSample { phi, estimate, used });
        }
    }
}

impl LinearMeasurement {
    /// Measurement, linearised at the measured states `at` and the field at these states.
    #[inline(always)]
    fn new(value_nt: f64, variance_nt2: f64, at: [f64; 4], field: &FieldValue) -> Self {
        let h = Sensitivity::from_field(field);
        Self { h, value_nt: value_nt - (field.value_nt + at[3]) + h.of_measured(at), variance_nt2 }
    }

    #[inline(always)]
    fn of_fix(fix: &StateFix) -> Self {
        Self { h: Sensitivity::of_state(fix.state), value_nt: fix.error, variance_nt2: fix.variance }
    }

    #[inline(always)]
    fn innovation(&self, predicted: &StateEstimate) -> Innovation {
        let residual_nt = self.value_nt - self.h.dot(&predicted.x);
        let variance_nt2 = self.h.dot(&self.h.covariance(&predicted.p)) + self.variance_nt2;
        Innovation { residual_nt, nis: residual_nt * residual_nt / variance_nt2 }
    }

    #[inline(always)]
    fn correct(&self, estimate: &mut StateEstimate) -> ForwardUpdate {
        let LinearMeasurement { h, value_nt, variance_nt2 } = *self;
        let MeasurementUpdate { gain, innovation, weight } = estimate.update(h, value_nt, variance_nt2);
        ForwardUpdate { h, gain, force: innovation * weight, weight, variance_nt2 }
    }
}

/// x - P λ.
#[inline(always)]
fn smoothed_state(estimate: &StateEstimate, adjoint: &AdjointState) -> StateVector {
    let mut x = estimate.x;
    for (factor, row) in adjoint.state.iter().zip(&estimate.p) {
        add_scaled(&mut x, -factor, row);
    }
    x
}

/// Entries of P - P Λ P for latitude and longitude.
#[inline(always)]
fn position_covariance(estimate: &StateEstimate, adjoint: &AdjointState) -> [f64; 3] {
    let p = &estimate.p;
    let (lat, lon) = (adjoint.product(&p[LAT]), adjoint.product(&p[LON]));
    [p[LAT][LAT] - inner(&p[LAT], &lat), p[LAT][LON] - inner(&p[LAT], &lon), p[LON][LON] - inner(&p[LON], &lon)]
}

/// One smoother pass and its inputs, as a kernel compiled for the SIMD instructions of the machine.
struct SimdPass<'p, 'a, 't> {
    pass: &'p mut SmootherPass<'a>,
    about: RtsLinearisation<'t>,
    field: &'p mut PredictedField<'a>,
}

impl WithSimd for SimdPass<'_, '_, '_> {
    type Output = Result<RtsSolution, NavigationError>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { pass, about, field } = self;
        pass.forward(about, field)?;
        pass.backward(about)
    }
}

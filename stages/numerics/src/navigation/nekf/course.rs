//! Forward and backward pass of filter and network over a window of a line, for training.

use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::{Sensitivity, StateEstimate, StepModel, inner};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateVector};
use crate::navigation::position_fixes::StateFix;
use crate::navigation::rts::adjoint::AdjointState;
use crate::navigation::transition::{NoiseDiscretisation, add_scaled, propagate_state};
use crate::signal::gauss_markov::GaussMarkov;

use super::inputs::{InputSource, SampleBefore};
use super::network::{CellAdjoint, CellState, CellTape, NoiseNetwork};
use super::training::{NoiseLoss, TrainingLine};

/// Scalar measurement update of the forward pass.
struct UpdateTape {
    h: Sensitivity,
    /// P Hᵀ.
    ph: StateVector,
    /// Innovation and its variance.
    residual: f64,
    variance: f64,
}

/// Derivatives of the loss of a position with respect to latitude and longitude, and to their covariance.
struct PositionTape {
    state: [f64; 2],
    covariance: [[f64; 2]; 2],
}

/// One sample of the forward pass.
pub(super) struct SampleTape {
    row: usize,
    cell: CellTape,
    /// Variance of the temporal variation that the step adds, in nT².
    fogm_nt2: f64,
    fixes: Vec<UpdateTape>,
    /// Update with the measurement, and the scaled R in nT², without the variance due to the curvature of the map.
    measured: Option<(UpdateTape, f64)>,
    position: Option<PositionTape>,
}

/// Sum of a loss over samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LossSum {
    pub(super) sum: f64,
    pub(super) terms: usize,
}

/// State of filter and network between two windows of a line.
pub(super) struct LineCourse<'a> {
    pub(super) inputs: InputSource<'a>,
    training: &'a TrainingLine<'a>,
    line: &'a NavigationLine<'a>,
    field: PredictedField<'a>,
    model: StepModel,
    offset_nt: f64,
    estimate: StateEstimate,
    cell: CellState,
    before: SampleBefore,
    row: usize,
}

impl<'a> LineCourse<'a> {
    /// State before the first sample.
    pub(super) fn new(training: &'a TrainingLine<'a>, network: &NoiseNetwork) -> Self {
        let line = &training.line;
        let mut field = line.predicted();
        let (offset_nt, _) = field.offset(line.ins, line.measurement_nt, line.offset_window_s);
        Self {
            inputs: InputSource::new(line, training.further),
            training,
            line,
            field,
            model: StepModel::from_error_model(&line.errors),
            offset_nt,
            estimate: StateEstimate::start_of(&line.errors, line.ins),
            cell: network.start(),
            before: SampleBefore::NONE,
            row: 0,
        }
    }

    /// Whether all samples are processed.
    pub(super) fn is_done(&self) -> bool {
        self.row >= self.line.ins.len()
    }

    /// Inputs of the next sample.
    pub(super) fn next_inputs(&mut self) -> Vec<f64> {
        self.inputs.at(self.row, &self.before)
    }

    /// Forward pass over at most `rows` samples.
    ///
    /// # Errors
    /// Returns the errors of [`StateEstimate::check`].
    pub(super) fn forward(
        &mut self,
        network: &NoiseNetwork,
        loss: NoiseLoss,
        rows: usize,
    ) -> Result<(Vec<SampleTape>, LossSum), NavigationError> {
        let (mut tape, mut sum) = (vec![], LossSum::default());
        for _ in 0..rows.min(self.line.ins.len() - self.row) {
            tape.push(self.sample(network, loss, &mut sum)?);
        }
        Ok((tape, sum))
    }

    fn sample(
        &mut self,
        network: &NoiseNetwork,
        loss: NoiseLoss,
        sum: &mut LossSum,
    ) -> Result<SampleTape, NavigationError> {
        let row = self.row;
        let inputs = self.next_inputs();
        let cell = network.advance(&mut self.cell, &inputs);
        let [log_r, log_q] = network.log_scales(&cell);
        let fogm_nt2 = if row > 0 { self.step(row, log_q.exp()) } else { 0.0 };
        let fixes = self.line.fixes_at(row).into_iter().flatten().map(|fix| self.fix(fix)).collect();
        let measured = self.measure(row, log_r.exp());
        self.estimate.check(row, self.line.ins.tt_s[row])?;
        if let (NoiseLoss::Likelihood, Some((update, _))) = (loss, &measured) {
            let UpdateTape { residual, variance, .. } = update;
            sum.sum += 0.5 * (variance.ln() + residual * residual / variance);
            sum.terms += 1;
        }
        let position = if loss == NoiseLoss::Position { self.position(row, sum) } else { None };
        self.before.error = [LAT, LON, ALT].map(|state| self.estimate.x[state]);
        self.row += 1;
        Ok(SampleTape { row, cell, fogm_nt2, fixes, measured, position })
    }

    /// Time update that multiplies the noise of the temporal variation by `scale`. Returns the variance that this noise
    /// adds, in nT².
    fn step(&mut self, row: usize, scale: f64) -> f64 {
        let step = self.model.transition(self.line.ins, row);
        let StateEstimate { x, p } = &mut self.estimate;
        *x = propagate_state(&step.phi, x);
        *p = self.model.covariance(p, &step);
        let errors = &self.line.errors;
        let fogm = GaussMarkov { sigma: errors.fogm_sigma_nt, tau_s: errors.fogm_tau_s };
        let decay = step.phi[S][S];
        let added_nt2 = match errors.noise {
            NoiseDiscretisation::Trapezoidal => 0.5 * step.dt_s * fogm.noise_density() * (1.0 + decay * decay),
            NoiseDiscretisation::Rectangular => step.dt_s * fogm.noise_density(),
            NoiseDiscretisation::VanLoan => fogm.step_variance(step.dt_s),
        };
        p[S][S] += (scale - 1.0) * added_nt2;
        scale * added_nt2
    }

    fn fix(&mut self, StateFix { state, error, variance }: StateFix) -> UpdateTape {
        let h = Sensitivity::of_state(state);
        let at = self.estimate.linearised(h);
        let residual = error - self.estimate.x[state];
        self.estimate.correct(&at, residual, variance);
        UpdateTape { h, ph: at.ph, residual, variance: at.variance + variance }
    }

    /// Update with the measurement of a row, with its assumed variance multiplied by `scale`.
    fn measure(&mut self, row: usize, scale: f64) -> Option<(UpdateTape, f64)> {
        self.before.innovation = Innovation::NONE;
        let (measured_nt, assumed_nt2) = self.line.measured(row, self.offset_nt)?;
        let [lat, lon, alt, temporal_nt] = self.estimate.measured();
        let (ins, error) = (self.line.ins, [lat, lon, alt]);
        let field = self.field.at_error(ins, row, error)?;
        let at = self.estimate.linearised(Sensitivity::from_field(&field));
        let curvature_nt2 = self.field.curvature_nt2(ins, row, error, field.value_nt, self.estimate.horizontal());
        let own_nt2 = scale * assumed_nt2;
        let residual = measured_nt - field.value_nt - temporal_nt;
        let variance = at.variance + own_nt2 + curvature_nt2;
        self.estimate.correct(&at, residual, own_nt2 + curvature_nt2);
        let innovation = Innovation { residual_nt: residual, nis: residual * residual / variance };
        self.before = SampleBefore { innovation, assumed_nt2, used_nt2: own_nt2, ..self.before };
        Some((UpdateTape { h: at.h, ph: at.ph, residual, variance }, own_nt2))
    }

    /// Adds the loss of the position of a row: ½ (ln |C| + eᵀ C⁻¹ e) in m, with the error e and the covariance C.
    fn position(&self, row: usize, sum: &mut LossSum) -> Option<PositionTape> {
        let [lat_deg, lon_deg] = self.training.truth?.map(|column| column[row]);
        let ins = self.line.ins;
        let StateEstimate { x, p } = &self.estimate;
        let error = [lat_deg - ins.lat_deg[row], lon_deg - ins.lon_deg[row]].map(f64::to_radians);
        let e = [error[0] - x[LAT], error[1] - x[LON]];
        let determinant = p[LAT][LAT] * p[LON][LON] - p[LAT][LON] * p[LAT][LON];
        if !(e[0].is_finite() && e[1].is_finite() && determinant > 0.0) {
            return None;
        }
        let across = -p[LAT][LON] / determinant;
        let inverse = [[p[LON][LON] / determinant, across], [across, p[LAT][LAT] / determinant]];
        let force = inverse.map(|row| row[0] * e[0] + row[1] * e[1]);
        let (north, east) = self.line.errors.earth.north_east_m_per_rad(lat_deg.to_radians(), ins.alt_m[row]);
        let square = force[0] * e[0] + force[1] * e[1];
        sum.sum += 0.5 * ((determinant * (north * east).powi(2)).ln() + square);
        sum.terms += 1;
        let covariance = [0, 1]
            .map(|row: usize| [0, 1].map(|column: usize| 0.5 * (inverse[row][column] - force[row] * force[column])));
        Some(PositionTape { state: force.map(|force| -force), covariance })
    }

    /// Derivatives of the summed loss of a window with respect to the weights. The state before the window, the inputs
    /// of the network, the rows of H and the curvature of the map are treated as constants.
    pub(super) fn backward(&self, network: &NoiseNetwork, loss: NoiseLoss, tape: &[SampleTape]) -> Vec<f64> {
        let mut gradient = vec![0.0; network.weights.len()];
        let (mut states, mut cell) = (AdjointState::END, CellAdjoint::end(network.hidden));
        for sample in tape.iter().rev() {
            if let Some(position) = &sample.position {
                add_position(&mut states, position);
            }
            let mut d_logs = [0.0; 2];
            if let Some((update, own_nt2)) = &sample.measured {
                d_logs[0] = own_nt2 * through_update(&mut states, update, loss == NoiseLoss::Likelihood);
            }
            for fix in sample.fixes.iter().rev() {
                through_update(&mut states, fix, false);
            }
            if sample.row > 0 {
                d_logs[1] = sample.fogm_nt2 * states.matrix[S][S];
                states.through_step(&self.model.transition(self.line.ins, sample.row).phi);
            }
            network.back(&sample.cell, d_logs, &mut cell, &mut gradient);
        }
        gradient
    }
}

fn add_position(states: &mut AdjointState, position: &PositionTape) {
    for (row, state) in [LAT, LON].into_iter().enumerate() {
        states.state[state] += position.state[row];
        for (column, other) in [LAT, LON].into_iter().enumerate() {
            states.matrix[state][other] += position.covariance[row][column];
        }
    }
}

/// Propagates derivatives with respect to x and P back through x + P Hᵀ v/s and P − P Hᵀ H P/s, and through the
/// negative log-likelihood of v if it is part of the loss. Returns the derivative with respect to s.
fn through_update(states: &mut AdjointState, update: &UpdateTape, in_loss: bool) -> f64 {
    let UpdateTape { h, ph, residual, variance } = update;
    let weight = 1.0 / variance;
    let product = states.product(ph);
    let along = inner(ph, &states.state);
    let mut d_variance = weight * weight * (inner(ph, &product) - along * residual);
    let mut d_residual = weight * along;
    if in_loss {
        d_variance += 0.5 * weight * (1.0 - residual * residual * weight);
        d_residual += weight * residual;
    }
    let mut row = [0.0; STATES];
    for (measured, factor) in crate::navigation::gaussian::MEASURED.into_iter().zip(h.0) {
        row[measured] = factor;
    }
    // d(P Hᵀ).
    let mut d_ph = product.map(|product| -2.0 * weight * product);
    add_scaled(&mut d_ph, weight * residual, &states.state);
    add_scaled(&mut d_ph, d_variance, &row);
    for (i, entries) in states.matrix.iter_mut().enumerate() {
        for (j, entry) in entries.iter_mut().enumerate() {
            *entry += 0.5 * (d_ph[i] * row[j] + row[i] * d_ph[j]);
        }
    }
    add_scaled(&mut states.state, -d_residual, &row);
    d_variance
}

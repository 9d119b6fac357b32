//! Steps from sample to sample, and the time update.

use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::LineStep;
use crate::navigation::pinson::{PinsonForm, S, STATES, StateMatrix, StateVector, TimeConstants, pinson_matrix};
use crate::navigation::transition::{
    NoiseDiscretisation, add, identity, propagate_covariance, propagate_state, step_covariance, transition_matrix,
    van_loan,
};

use super::lanes::TransitionEntries;
use super::{Gaussian, StateEstimate, StateLayout};

/// Process model of the 18 states. Only the INS quantities change along a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepModel {
    times: TimeConstants,
    form: PinsonForm,
    /// Spectral densities of the process noise.
    density: StateVector,
    noise: NoiseDiscretisation,
}

/// Transition of a step.
pub(crate) struct Transition {
    /// Length, in seconds.
    pub dt_s: f64,
    /// F at the beginning of the step.
    f: StateMatrix,
    /// Φ = exp(F Δt).
    pub phi: StateMatrix,
}

/// Step that filters in lanes share.
#[derive(Clone)]
pub(crate) struct LaneStep {
    /// Length, in seconds.
    pub dt_s: f64,
    pub phi: TransitionEntries,
    /// Process noise of the step if the noise is integrated, without the noise of the temporal variation.
    pub noise: Option<Box<StateMatrix>>,
}

impl StepModel {
    /// Process model of an error model.
    pub fn from_error_model(errors: &InsErrorModel) -> Self {
        Self {
            times: errors.time_constants(),
            form: errors.pinson,
            density: errors.noise_density(),
            noise: errors.noise,
        }
    }

    /// Part of a process model that filters in lanes share. The temporal variation is excluded: it drives no other
    /// state and decays independently, so every filter has separate noise for this state. The process noise is shared
    /// only if the noise is integrated over a step.
    pub fn shared(errors: &InsErrorModel) -> Self {
        let mut model = Self::from_error_model(errors);
        model.times.fogm_s = f64::INFINITY;
        match errors.noise {
            NoiseDiscretisation::VanLoan => model.density[S] = 0.0,
            NoiseDiscretisation::Trapezoidal | NoiseDiscretisation::Rectangular => model.density = [0.0; STATES],
        }
        model
    }

    /// Discretisation of the process noise.
    pub fn noise(&self) -> NoiseDiscretisation {
        self.noise
    }

    /// Transition from the sample before `row` to `row`, which is at least 1.
    #[inline(never)]
    pub fn transition(&self, ins: &InsSeries<'_>, row: usize) -> Transition {
        let dt_s = ins.tt_s[row] - ins.tt_s[row - 1];
        let f = pinson_matrix(&ins.point(row - 1), &self.times, self.form);
        Transition { dt_s, f, phi: transition_matrix(&f, dt_s) }
    }

    /// Φ P Φᵀ + Q.
    #[inline(always)]
    pub fn covariance(&self, p: &StateMatrix, step: &Transition) -> StateMatrix {
        step_covariance(p, &step.f, &step.phi, &self.density, step.dt_s, self.noise)
    }

    /// Step from the sample before `row` to `row`, for filters in lanes.
    #[inline(always)]
    pub fn lane_step(&self, ins: &InsSeries<'_>, row: usize) -> LaneStep {
        let Transition { dt_s, f, phi } = self.transition(ins, row);
        let noise = self.integrated_noise(&f, dt_s).map(Box::new);
        LaneStep { dt_s, phi: TransitionEntries::from_matrix(&phi), noise }
    }

    /// Step of zero length and without noise; later steps reuse its memory.
    pub fn empty_lane_step(&self) -> LaneStep {
        let noise = (self.noise == NoiseDiscretisation::VanLoan).then(|| Box::new([[0.0; STATES]; STATES]));
        LaneStep { dt_s: 0.0, phi: TransitionEntries::from_matrix(&identity()), noise }
    }

    /// Same as [`StepModel::lane_step`], but reuses the memory of another step of this model.
    #[inline(always)]
    pub fn renew_lane_step(&self, step: &mut LaneStep, ins: &InsSeries<'_>, row: usize) {
        let Transition { dt_s, f, phi } = self.transition(ins, row);
        (step.dt_s, step.phi) = (dt_s, TransitionEntries::from_matrix(&phi));
        if let (Some(to), Some(noise)) = (&mut step.noise, self.integrated_noise(&f, dt_s)) {
            **to = noise;
        }
    }

    #[inline(always)]
    fn integrated_noise(&self, f: &StateMatrix, dt_s: f64) -> Option<StateMatrix> {
        (self.noise == NoiseDiscretisation::VanLoan).then(|| van_loan(f, &self.density, dt_s))
    }
}

impl LineStep {
    /// Step of an INS from the sample before `row` to `row`, which is at least 1.
    #[inline]
    pub fn new(ins: &InsSeries<'_>, errors: &InsErrorModel, row: usize) -> Self {
        let model = StepModel::from_error_model(errors);
        let step = model.transition(ins, row);
        let noise = model.covariance(&[[0.0; STATES]; STATES], &step);
        let speed_mps = ins.vn_mps[row - 1].hypot(ins.ve_mps[row - 1]);
        Self { dt_s: step.dt_s, speed_mps, phi: step.phi, noise }
    }
}

impl StateEstimate {
    /// x ← Φ x and P ← Φ P Φᵀ + Q of the step from the sample before `row` to `row`. Returns Φ.
    #[inline(always)]
    pub(crate) fn propagate(&mut self, model: &StepModel, ins: &InsSeries<'_>, row: usize) -> StateMatrix {
        let step = model.transition(ins, row);
        self.x = propagate_state(&step.phi, &self.x);
        self.p = model.covariance(&self.p, &step);
        step.phi
    }
}

impl Gaussian {
    /// x ← Φ x, P ← Φ P Φᵀ + Q. `spare` is a buffer for the cross-covariance.
    pub fn propagate(&mut self, layout: &StateLayout, step: &LineStep, spare: &mut Vec<f64>) {
        propagate_mean(layout, step, &mut self.x);
        let mut block = propagate_covariance(&step.phi, &self.p.ins());
        add(&mut block, &step.noise);
        self.p.set_ins(&block);
        let (errors, dt_s) = (layout.errors.len(), step.dt_s);
        let mut decay: Vec<f64> = layout.errors_of(step).map(|error| error.decay(dt_s)).collect();
        decay.resize(self.dim() - STATES, 1.0);
        self.p.propagate_cross(&step.phi, &decay, spare);
        self.p.decay_each(&decay[..errors]);
        for (k, error) in layout.errors_of(step).enumerate() {
            *self.p.at_mut(STATES + k, STATES + k) += error.step_variance(dt_s);
        }
        for (k, density) in layout.walk.iter().enumerate() {
            let at = layout.coefficients() + k;
            *self.p.at_mut(at, at) += density * dt_s;
        }
    }
}

/// x ← Φ x of all states.
pub(crate) fn propagate_mean(layout: &StateLayout, step: &LineStep, x: &mut [f64]) {
    let mut ins = [0.0; STATES];
    ins.copy_from_slice(&x[..STATES]);
    x[..STATES].copy_from_slice(&propagate_state(&step.phi, &ins));
    for (error, x) in layout.errors_of(step).zip(&mut x[STATES..]) {
        *x *= error.decay(step.dt_s);
    }
}

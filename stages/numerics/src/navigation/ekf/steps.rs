//! Steps from sample to sample, which filters of the same error model share.

use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::pinson::{PinsonForm, S, StateMatrix, StateVector, TimeConstants, pinson_matrix};
use crate::navigation::transition::lanes::TransitionEntries;
use crate::navigation::transition::{NoiseDiscretisation, transition_matrix, van_loan};

/// Parameters that determine the steps along a line. The temporal variation is excluded: it drives no other state and
/// decays independently, so every filter has its own.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct EkfStepModel {
    times: TimeConstants,
    form: PinsonForm,
    noise: NoiseDiscretisation,
    /// Spectral densities of the process noise, if its integral is shared too.
    density: Option<StateVector>,
}

/// Step that filters of the same error model share, with its length in s.
pub(super) struct EkfStep {
    pub(super) dt_s: f64,
    pub(super) phi: TransitionEntries,
    /// Process noise of the step if it is integrated, without that of the temporal variation.
    pub(super) noise: Option<Box<StateMatrix>>,
}

impl EkfStepModel {
    pub(super) fn from_error_model(errors: &InsErrorModel) -> Self {
        let mut density = errors.noise_density();
        density[S] = 0.0;
        Self {
            times: TimeConstants { fogm_s: f64::INFINITY, ..errors.time_constants() },
            form: errors.pinson,
            noise: errors.noise,
            density: (errors.noise == NoiseDiscretisation::VanLoan).then_some(density),
        }
    }

    /// Discretisation of the process noise.
    pub(super) fn noise(&self) -> NoiseDiscretisation {
        self.noise
    }

    /// Step from the sample before `row` to `row`.
    #[inline(always)]
    pub(super) fn step(&self, ins: &InsSeries<'_>, row: usize) -> EkfStep {
        let dt_s = ins.tt_s[row] - ins.tt_s[row - 1];
        let f = pinson_matrix(&ins.point(row - 1), &self.times, self.form);
        let phi = TransitionEntries::from_matrix(&transition_matrix(&f, dt_s));
        let noise = self.density.map(|density| Box::new(van_loan(&f, &density, dt_s)));
        EkfStep { dt_s, phi, noise }
    }
}

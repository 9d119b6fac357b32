//! INS errors by the linear error model along a trajectory given in consecutive pieces.

use super::driving::{DrivingNoise, NormalStreams, blocks};
use super::{InsErrorFault, InsErrorModel};
use crate::earth::geodesy::EarthModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix, StateVector, pinson_matrix};
use crate::navigation::transition::{propagate_state, transition_matrix};

impl InsErrorModel {
    /// Error drawn from the initial covariance at a latitude (rad) and altitude (m): 18 draws.
    pub fn initial_error(&self, lat_rad: f64, alt_m: f64, normal: &mut dyn FnMut() -> f64) -> StateVector {
        self.initial_sigmas(lat_rad, alt_m).map(|sigma| sigma * normal())
    }
}

/// One realisation of the error states (truth minus INS) along a true trajectory, one per sample, starting from the
/// error `start` at its first sample.
///
/// Half of a step's noise is added before the step and half after it, which is accurate to second order. The last error
/// of a piece is the first error of the next piece.
///
/// # Errors
/// Returns the errors of [`InsErrorModel::check`] and [`InsSeries::check`].
pub fn errors_along(
    truth: &InsSeries<'_>,
    model: &InsErrorModel,
    start: &StateVector,
    draws: &mut NormalStreams<'_>,
) -> Result<Vec<StateVector>, InsErrorFault> {
    model.check()?;
    truth.check()?;
    let (driving, times) = (DrivingNoise::new(model), model.time_constants());
    let mut error = *start;
    let mut errors = Vec::with_capacity(truth.len());
    errors.push(error);
    for (first, last) in blocks(truth.tt_s) {
        let steps_s = steps_s(truth.tt_s, first, last);
        let noises = driving.steps(&steps_s, draws);
        for ((row, dt_s), noise) in (first..last).zip(steps_s).zip(noises) {
            let phi = transition_matrix(&pinson_matrix(&truth.point(row), &times, model.pinson), dt_s);
            error = step(&phi, &error, &noise);
            errors.push(error);
        }
    }
    Ok(errors)
}

/// Lengths of the steps between two rows.
pub(super) fn steps_s(tt_s: &[f64], first: usize, last: usize) -> Vec<f64> {
    tt_s.get(first..=last).unwrap_or_default().windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// Φ (e + w/2) + w/2.
fn step(phi: &StateMatrix, error: &StateVector, noise: &StateVector) -> StateVector {
    let plus_half = |x: &StateVector| -> StateVector { std::array::from_fn(|state| x[state] + 0.5 * noise[state]) };
    plus_half(&propagate_state(phi, &plus_half(error)))
}

/// Many realisations of the errors along one trajectory, propagated together in steps of a second (or in the steps of
/// the trajectory, if these are longer).
///
/// All members share each transition matrix, and a member has the same noise as [`errors_along`] with the same draws. A
/// selected member can therefore be recomputed at the trajectory's own rate; its realisation differs only within a
/// second.
#[derive(Clone, Debug)]
pub struct InsErrorEnsemble {
    errors: Vec<StateVector>,
    squares_m2: Vec<f64>,
    samples: usize,
}

impl InsErrorEnsemble {
    /// Members with these initial errors.
    pub fn new(starts: Vec<StateVector>) -> Self {
        let squares_m2 = vec![0.0; starts.len()];
        Self { errors: starts, squares_m2, samples: 0 }
    }

    /// Realigns the INS of every member and keeps the accumulated squares.
    pub fn restart(&mut self, starts: Vec<StateVector>) {
        self.errors = starts;
        self.squares_m2.resize(self.errors.len(), 0.0);
    }

    /// Current errors of the members.
    pub fn errors(&self) -> &[StateVector] {
        &self.errors
    }

    /// Propagates the members along a trajectory. `normal` draws the next standard normal number of a member's
    /// [`NormalStreams::block`]. The positions enter [`InsErrorEnsemble::drms_m`] only if `counts` is set.
    ///
    /// # Errors
    /// Returns the errors of [`InsErrorModel::check`] and [`InsSeries::check`].
    pub fn advance(
        &mut self,
        truth: &InsSeries<'_>,
        model: &InsErrorModel,
        counts: bool,
        normal: &mut dyn FnMut(usize) -> f64,
    ) -> Result<(), InsErrorFault> {
        model.check()?;
        truth.check()?;
        let (driving, times) = (DrivingNoise::new(model), model.time_constants());
        if counts {
            self.count(truth, 0);
        }
        for (first, last) in blocks(truth.tt_s) {
            let duration_s: f64 = steps_s(truth.tt_s, first, last).iter().sum();
            let middle = truth.point(first + (last - first) / 2);
            let phi = transition_matrix(&pinson_matrix(&middle, &times, model.pinson), duration_s);
            for (member, error) in self.errors.iter_mut().enumerate() {
                let noise = driving.block(duration_s, &mut || normal(member));
                *error = step(&phi, error, &noise);
            }
            if counts {
                self.count(truth, last);
            }
        }
        Ok(())
    }

    fn count(&mut self, truth: &InsSeries<'_>, row: usize) {
        let (lat_rad, alt_m) = (truth.lat_deg[row].to_radians(), truth.alt_m[row]);
        for (square, error) in self.squares_m2.iter_mut().zip(&self.errors) {
            *square += horizontal_m(error, lat_rad, alt_m).powi(2);
        }
        self.samples += 1;
    }

    /// DRMS of each member so far, in metres.
    pub fn drms_m(&self) -> Vec<f64> {
        self.squares_m2.iter().map(|squares| (squares / self.samples.max(1) as f64).sqrt()).collect()
    }

    /// Member with the `rank`-th largest DRMS, counted from 1. Of several members with equal DRMS, the first is used.
    /// `None` if there are fewer members.
    pub fn ranked(&self, rank: usize) -> Option<usize> {
        let drms = self.drms_m();
        let mut order: Vec<usize> = (0..drms.len()).collect();
        order.sort_by(|a, b| drms[*b].total_cmp(&drms[*a]));
        order.get(rank.checked_sub(1)?).copied()
    }
}

/// Horizontal position error of the INS, in metres, from its error states.
pub fn horizontal_m(error: &[f64; STATES], lat_rad: f64, alt_m: f64) -> f64 {
    let earth = EarthModel::Wgs84;
    let north = earth.lat_rad_to_north_m(error[LAT], lat_rad, alt_m);
    let east = earth.lon_rad_to_east_m(error[LON], lat_rad, alt_m);
    north.hypot(east)
}

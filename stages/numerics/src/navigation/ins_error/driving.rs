//! Driving noise of the INS errors, drawn so that the realisation does not depend on the sample rate.
//!
//! The noise of a block of steps (one second) is drawn first; the share of each step is then drawn as the increment of
//! a Brownian bridge. The resulting noise is white. Steps of 1 s and steps of 4 ms give the same realisation.

use super::InsErrorModel;
use crate::navigation::pinson::{A_HAT, STATES, StateVector, VN};

/// Length of a block, in seconds. A longer step is one block.
const BLOCK_S: f64 = 1.0;

/// Two streams of standard normal numbers, which determine a realisation.
pub struct NormalStreams<'a> {
    /// Draws for the initial error and the noise of each block.
    pub block: &'a mut dyn FnMut() -> f64,
    /// Draws that distribute the noise of a block over its steps.
    pub within: &'a mut dyn FnMut() -> f64,
}

/// Driving noise of an INS, from the spectral densities.
pub(super) struct DrivingNoise {
    /// Square roots of the spectral densities, per square root of a second.
    sigmas: StateVector,
}

/// States with driving noise, excluding those with 1e-30 (position and barometer loop).
fn driven() -> impl Iterator<Item = usize> {
    (VN..STATES).filter(|state| *state != A_HAT)
}

impl DrivingNoise {
    pub(super) fn new(model: &InsErrorModel) -> Self {
        Self { sigmas: model.noise_density().map(f64::sqrt) }
    }

    /// Noise of `duration_s`: 14 draws.
    pub(super) fn block(&self, duration_s: f64, normal: &mut dyn FnMut() -> f64) -> StateVector {
        let mut noise = [0.0; STATES];
        for state in driven() {
            noise[state] = self.sigmas[state] * duration_s.sqrt() * normal();
        }
        noise
    }

    /// Noise of the steps of one block: 14 draws for the block, and 14 draws for each step if the block has several
    /// steps.
    pub(super) fn steps(&self, steps_s: &[f64], draws: &mut NormalStreams<'_>) -> Vec<StateVector> {
        let duration_s: f64 = steps_s.iter().sum();
        let whole = self.block(duration_s, draws.block);
        if let [_] = steps_s {
            return vec![whole];
        }
        let mut parts: Vec<StateVector> = steps_s.iter().map(|step| self.block(*step, draws.within)).collect();
        for state in driven() {
            let sum: f64 = parts.iter().map(|part| part[state]).sum();
            for (part, step) in parts.iter_mut().zip(steps_s) {
                part[state] += (whole[state] - sum) * step / duration_s;
            }
        }
        parts
    }
}

/// Blocks of a time column, each given by its first and last row. The last row of a block is the first of the next.
pub(super) fn blocks(tt_s: &[f64]) -> impl Iterator<Item = (usize, usize)> + '_ {
    let mut first = 0;
    std::iter::from_fn(move || {
        let from = first;
        let start_s = tt_s.get(from)?;
        let mut rows = tt_s.iter().enumerate().skip(from + 1);
        // Times are rounded: a block may be a millionth of a second short.
        let whole = rows.find(|(_, tt)| *tt - start_s > BLOCK_S * (1.0 - 1e-6)).map(|(row, _)| row);
        first = whole.unwrap_or(tt_s.len() - 1);
        (first > from).then_some((from, first))
    })
}

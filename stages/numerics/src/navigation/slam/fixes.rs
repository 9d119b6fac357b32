//! Aiding positions, such as those of a GNSS receiver.
//!
//! A fix measures one state, y = x_s + e, where e has the variance R. With the present mean m and covariance P, the
//! update is a Kalman update,
//!
//! ```text
//! K = P_s/(P_ss + R),    m ← m + K (y − m_s),    P ← (I − K hᵀ) P (I − K hᵀ)ᵀ + R K Kᵀ
//! ```
//!
//! from which all particles are redrawn. The position of each particle at this step is drawn from N(m, P), and its
//! other states follow by regression, as at the start of a flight. Until the field weights the particles, a parallel
//! Kalman filter provides m and P; afterwards they are computed from the particles, with the lost variance
//! ([`super::resolution`]). Without a revisit the result therefore equals that of the Kalman filter up to rounding. If
//! the distance from the cloud to the aircraft exceeds the width of the cloud, this update corrects the cloud.
//! Weighting the particles could not correct it.
//!
//! The *paths* are weighted by each particle's prediction of the fix. The covariance of the prediction given the path
//! is C = Φ P Φᵀ + Q. After a loss of the track, fixes therefore select the maps that agree with them:
//!
//! ```text
//! log q ← log q − (y − x_s)²/2(C_ss + R)
//! ```
//!
//! The drawn positions do not depend on that weight, so no fix is counted twice. There are two approximations. First, P
//! represents the whole distribution, as in any Kalman filter. Second, with GNSS, the map treats position errors as
//! independent from step to step, although they persist over the memory of the Kalman filter.

use crate::navigation::pinson::{STATES, StateMatrix, StateVector};
use crate::navigation::position_fixes::StateFix;

use super::particles::SlamParticles;

/// Gain of a fix.
fn gain(p: &StateMatrix, fix: &StateFix) -> StateVector {
    let measured = &p[fix.state];
    measured.map(|entry| entry / (measured[fix.state] + fix.variance))
}

/// Corrects a mean with a fix.
fn shift(x: &mut StateVector, gain: &StateVector, fix: &StateFix) {
    let residual = fix.error - x[fix.state];
    for (entry, gain) in x.iter_mut().zip(gain) {
        *entry += gain * residual;
    }
}

/// Covariance after a fix, by Joseph's form. [Bucy & Joseph 1968]
fn narrow(p: &mut StateMatrix, gain: &StateVector, fix: &StateFix) {
    let (state, measured, variance) = (fix.state, p[fix.state], fix.variance);
    let mut left = *p;
    for (row, gain) in left.iter_mut().zip(gain) {
        for (entry, measured) in row.iter_mut().zip(&measured) {
            *entry -= gain * measured;
        }
    }
    for row in 0..STATES {
        for column in 0..=row {
            let entry = left[row][column] - left[row][state] * gain[column] + variance * gain[row] * gain[column];
            p[row][column] = entry;
            p[column][row] = entry;
        }
    }
}

/// Kalman update of a mean and covariance with a fix.
pub(super) fn update(x: &mut StateVector, p: &mut StateMatrix, fix: &StateFix) {
    let gain = gain(p, fix);
    shift(x, &gain, fix);
    narrow(p, &gain, fix);
}

impl SlamParticles {
    /// Weights the particles with a fix, and conditions each particle on the fix.
    pub(super) fn foresee(&mut self, fix: &StateFix) {
        let (gain, total) = (gain(&self.linear, fix), self.linear[fix.state][fix.state] + fix.variance);
        let logs: Vec<f64> = self.x.iter().map(|x| -0.5 * (fix.error - x[fix.state]).powi(2) / total).collect();
        for x in &mut self.x {
            shift(x, &gain, fix);
        }
        narrow(&mut self.linear, &gain, fix);
        // If no weight remains, the weights do not change.
        self.weigh(&logs);
    }

    /// Sets the mean and covariance of every particle, without drawing the positions.
    pub(super) fn join(&mut self, mean: &StateVector, covariance: &StateMatrix) {
        self.x.fill(*mean);
        self.linear = *covariance;
    }
}

//! Marginalised particle filter: particles for the position, a Kalman filter for the other states.
//!
//! A map is strongly nonlinear in position; the rest of the model is nearly linear. Given the position, the 16 other
//! states of `pinson` are linear and Gaussian. Each particle therefore holds an error of latitude and longitude, with
//! the conditional mean of the other states. All particles share one covariance P [Schön, Gustafsson & Nordlund 2005;
//! Gnadt 2022, section 5.3 for the states]. Use this filter for a position error of kilometres, or if two positions can
//! explain the measurements: [`MpfOutput::modes`] contains the probability of each. In other cases, its results agree
//! with those of the extended Kalman filter, but 1000 particles take seventy times as long.
//!
//! # A sample
//!
//! Let h_i be the field at particle i (map and core field, at its own position and altitude) plus the S of the
//! particle, and H_i the derivatives with respect to altitude and S. For a measurement z of variance R,
//!
//! ```text
//! e_i = z − h_i,   V_i = H_i P H_iᵀ + R,   q_i ∝ q_i N(e_i; 0, V_i)
//! x_i ← x_i + P H_iᵀ e_i/V_i,              P ← P − P (Σ q_i H_iᵀ H_i/V_i) P
//! Σ = Φ diag(0, P) Φᵀ + Q = [M Cᵀ; C T]    (position first)
//! x_i ← Φ x_i + [√M; C √M⁻ᵀ] ξ_i,          P ← T − C M⁻¹ Cᵀ,      ξ_i ~ N(0, I)
//! ```
//!
//! P after a measurement is the mean of the covariances that the particles would have individually. The update equals
//! the usual update if the field changes equally with height at all particles. The step follows (22)-(25) of the paper,
//! with the linear states after their measurement update. Weights are stored as logarithms and never underflow.
//!
//! **A particle off the map**, or in an unknown cell: its weight is multiplied by the mean likelihood of the others.
//! The probability of being off the map therefore stays constant until particles enter it. If less than a tenth of the
//! weight is on the map, the sample is `off_map` and is not used.
//!
//! **A measurement that contradicts every particle** ([`UNEXPLAINED_NIS`]) is not used; it is counted as gated, and in
//! [`MpfReport::unexplained`]. Many in succession mean that the cloud has permanently lost the aircraft.
//!
//! # Resampling
//!
//! The particles are resampled when 1/Σq² < `resample_threshold` N. Resampling is systematic, with one uniform random
//! number. The position of a navigation-grade INS has almost no driving noise. Copies of a particle therefore remain
//! copies, also in velocity and tilt. A plain particle filter is left with a few distinct paths and a covariance that
//! is far too small. With `regularise`, new particles are drawn from a kernel density instead. The position is drawn
//! from Gaussian kernels of the optimal bandwidth h = N^(-1/6) [Musso, Oudjane & Le Gland 2001]; the particles are
//! first contracted by √(1 − h²), which preserves mean and covariance [West 1993]. The linear states follow the
//! position by their regression on it. The fraction h² of the covariance about the regression is transferred from the
//! particles to P instead of being drawn. A cloud wider than `smooth_over_m` has one kernel per cell of at least 16
//! effective particles, and one regression per mode. If a measurement would leave less than a tenth of the particles
//! effective, it is split into several measurements whose inverse variances add up to the original one. The particles
//! are resampled between these (progressive correction, same source).
//!
//! # Aiding positions
//!
//! A fix of latitude and longitude weights the particles, whose positions have no variance. A fix of the height is a
//! Kalman update of the linear states of each particle, with a common gain. Both methods are exact except for the
//! finite number of particles. A fix far narrower than the cloud is split, like a measurement.
//!
//! # Further measurements
//!
//! The Gauss-Markov states of [`aids`](crate::navigation::aids), the slow errors of measurements and of the map, are
//! linear like the other 16. They are part of each particle's mean and of the common covariance, which then has 21
//! states, or 27 with the field vector. A difference, a component of the vector, and a height are each processed like
//! the field, with
//!
//! ```text
//! e_i = z − v(position of i) − u x_i,   H_i = u + (slope of v with height at i) for the altitude,
//! ```
//!
//! where v is the map value at each particle's own position, at both ends of the baseline for a difference. The row u
//! of biases, S and tilt is common: the effect of the tilt is linearised at the mean of the cloud. These measurements
//! are processed after the field, each after a resampling if too few particles are effective. A measurement weights the
//! particles by the values of the map and not by its slope, even where the map is flat. [`Aids::flat_over_m`] is
//! therefore ignored; the map error is a state.
//!
//! Every random number is a function of seed, sample and particle, and sums have a fixed order, so results are
//! bit-identical for any number of threads.
//!
//! # Number of particles
//!
//! For an INS position error of hundreds of metres, 3000 particles are sufficient. With 1000 particles, the filter lost
//! an INS of micro-mechanical sensors over strong anomalies on 2 of 36 flights; with 2000 or 4000, on none. For an
//! error of kilometres, some particles of the first cloud must lie within one anomaly width of the true position, even
//! if that position is at the edge of the cloud. With [`MpfParameters::adapt`] the number is set at the start and at
//! each resampling, from the number k of squares of side `smooth_over_m` that the cloud occupies. The Kullback-Leibler
//! distance of the particles from the density is then below 0.05 with probability 0.99 [Fox 2003],
//!
//! ```text
//! N = (k − 1)/0.1 [1 − 2/(9 (k − 1)) + √(2/(9 (k − 1))) 2.326]³
//! ```
//!
//! With a standard deviation of 1.5 km on each axis, the filter begins with about 17,000 particles. The number depends
//! only on the particles, so it is the same on any number of threads. The report indicates whether the cloud has lost
//! the aircraft.
//!
//! # Hand-over
//!
//! [`run_then_ekf`] replaces the particles by a Gaussian and continues with an extended Kalman filter. It does so when,
//! for 10 s without interruption, one mode has held 99 % of the weight and the field has been linear over the mode:
//!
//! ```text
//! Σ w over the mode ≥ 0.99 Σ w,     E [h(x̄ + e) − h(x̄) − H e]² ≤ σ²,     e ~ N(0, covariance of the mode)
//! ```

mod cloud;
mod core_expansion;
mod count;
mod covariance;
mod draws;
mod filter;
mod fixes;
mod hand_over;
mod look;
mod measurement;
mod modes;
mod output;
mod parameters;
mod partition;
mod resampling;

use crate::navigation::aids::{AidStates, Aids};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::STATES;

use filter::MarginalisedParticleFilter;
use hand_over::HandOverEstimate;
pub use hand_over::{HandOver, HandOverOutput, LocatedAircraft, locate, run_then_ekf};
pub use output::{MpfOutput, MpfReport, PositionMode, SampleModes};
pub use parameters::MpfParameters;

/// A measurement is not used if its NIS exceeds this limit for every particle; the NIS of one valid measurement in a
/// billion exceeds it.
pub const UNEXPLAINED_NIS: f64 = 37.33;

/// Number of states including the biases of difference and height and the map error, but not the states of a vector
/// measurement.
const WITH_BIASES: usize = STATES + 3;
/// Number of states including the states of a vector measurement.
const WITH_VECTOR: usize = WITH_BIASES + 6;
/// Number of states including the states of a vector measurement and of the error of the map's slope.
const WITH_ALL: usize = WITH_VECTOR + 2;

/// Filters one line.
///
/// Each row of the output is the weighted mean of the particles after the sample's measurements and before any
/// resampling. If a measurement is missing (NaN, infinite, or with a sigma that is not above 0) or rejected, the filter
/// only predicts. Uneven time and a single sample are valid. Takes about 0.2 ms per sample for 1000 particles on one
/// core, and uses several threads from 8192 particles on.
///
/// # Errors
/// Returns the errors of [`MpfParameters::check`], [`Aids::check`] and [`NavigationLine::check`]. Also fails with
/// [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(
    parameters: &MpfParameters,
    line: &NavigationLine<'_>,
    aids: &Aids<'_>,
) -> Result<MpfOutput, NavigationError> {
    check(parameters, line, aids)?;
    filtered(parameters, line, aids, None).map(|(output, _)| output)
}

fn check(parameters: &MpfParameters, line: &NavigationLine<'_>, aids: &Aids<'_>) -> Result<(), NavigationError> {
    parameters.check()?;
    line.check()?;
    aids.check(line.ins.len())
}

/// Filters one line, or its start until a hand-over.
fn filtered(
    parameters: &MpfParameters,
    line: &NavigationLine<'_>,
    aids: &Aids<'_>,
    hand_over: Option<&HandOver>,
) -> Result<(MpfOutput, Option<HandOverEstimate>), NavigationError> {
    let states = AidStates::new(aids, STATES);
    match STATES + states.errors.len() {
        STATES => MarginalisedParticleFilter::<STATES>::new(line, aids, states, parameters).run(hand_over),
        count if count <= WITH_BIASES => {
            MarginalisedParticleFilter::<WITH_BIASES>::new(line, aids, states, parameters).run(hand_over)
        }
        count if count <= WITH_VECTOR => {
            MarginalisedParticleFilter::<WITH_VECTOR>::new(line, aids, states, parameters).run(hand_over)
        }
        _ => MarginalisedParticleFilter::<WITH_ALL>::new(line, aids, states, parameters).run(hand_over),
    }
}

#[cfg(test)]
mod tests;

//! Hand-over from the particles to an extended Kalman filter.
//!
//! Particles with a single narrow mode carry no more information than a Gaussian. The weights of the particles are the
//! probabilities of the modes. The Kalman filter takes over when, for [`HELD_S`] s without interruption,
//!
//! - the most probable mode has at least the weight [`HandOver::weight`], and
//! - the linearisation error over the mode's covariance is below the measurement noise (see
//!   [`linearity`](crate::navigation::linearity)).
//!
//! The Gaussian has the mean and covariance of the particles of that mode, Σ w (x − x̄)(x − x̄)ᵀ/Σ w + P, over all
//! states.

use crate::navigation::aided::filter::AidedFilter;
use crate::navigation::aided::{AidedParameters, Aids};
use crate::navigation::gaussian::Gaussian;
use crate::navigation::line::NavigationLine;
use crate::navigation::linearity::{LinearityTest, PathStart, noise_nt};
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::{ALT, LAT, LON, STATES, VD, VE, VN};

use super::filter::MarginalisedParticleFilter;
use super::output::MpfOutput;
use super::parameters::MpfParameters;
use super::resampling::{moments, position};
use super::{check, filtered};

/// Time between two tests of the particles, in seconds.
const INTERVAL_S: f64 = 5.0;
/// Time for which the conditions must hold before the hand-over, in seconds.
const HELD_S: f64 = 60.0;

/// Conditions of the hand-over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandOver {
    /// Smallest weight of the most probable mode, above 0.5 and at most 1.
    pub weight: f64,
}

impl Default for HandOver {
    fn default() -> Self {
        Self { weight: 0.99 }
    }
}

/// Gaussian that replaces the particles after the measurements of a sample.
#[derive(Clone, Debug)]
pub(super) struct HandOverEstimate {
    row: usize,
    gaussian: Gaussian,
}

/// Test of the conditions along a line.
pub(super) struct HandOverTest<'a> {
    conditions: HandOver,
    linearity: LinearityTest<'a>,
    sigma_nt: f64,
    due_s: f64,
    /// Time since which the conditions have held.
    since_s: Option<f64>,
}

impl<'a> HandOverTest<'a> {
    pub(super) fn new(line: &NavigationLine<'a>, conditions: HandOver) -> Self {
        Self {
            conditions,
            linearity: LinearityTest::new(line),
            sigma_nt: noise_nt(line),
            due_s: f64::NEG_INFINITY,
            since_s: None,
        }
    }

    /// Gaussian that replaces the particles of a row, if the conditions hold.
    pub(super) fn estimate<const N: usize>(
        &mut self,
        filter: &mut MarginalisedParticleFilter<'_, N>,
        row: usize,
    ) -> Option<HandOverEstimate> {
        let tt_s = filter.line.ins.tt_s[row];
        if tt_s < self.due_s {
            return None;
        }
        self.due_s = tt_s + INTERVAL_S;
        let Some(mode) = self.mode(filter, row) else {
            self.since_s = None;
            return None;
        };
        let since_s = *self.since_s.get_or_insert(tt_s);
        (tt_s - since_s >= HELD_S).then(|| HandOverEstimate { row, gaussian: gaussian(filter, mode) })
    }

    /// Most probable mode, if it has enough weight and the field is linear over it.
    fn mode<const N: usize>(&mut self, filter: &mut MarginalisedParticleFilter<'_, N>, row: usize) -> Option<usize> {
        let MarginalisedParticleFilter { cloud, clusters, line, .. } = filter;
        let cloud = &*cloud;
        let weights = &cloud.weights.as_flattened()[..cloud.particles];
        clusters.find(weights, |index| position(cloud, index));
        let modes = moments::<2>(weights, &clusters.labels, clusters.count, |index| position(cloud, index));
        let (label, mode) = modes.iter().enumerate().max_by(|(_, a), (_, b)| a.weight.total_cmp(&b.weight))?;
        let all: f64 = modes.iter().map(|mode| mode.weight).sum();
        if mode.weight < self.conditions.weight * all {
            return None;
        }
        let (mean, ins) = (cloud.mean(), line.ins);
        let at = PathStart {
            lat_deg: ins.lat_deg[row] + mode.mean[LAT].to_degrees(),
            lon_deg: ins.lon_deg[row] + mode.mean[LON].to_degrees(),
            alt_m: ins.alt_m[row] + mean[ALT],
            velocity_ne_mps: [ins.vn_mps[row] + mean[VN], ins.ve_mps[row] + mean[VE]],
        };
        let [[a, b], [_, c]] = mode.covariance;
        self.linearity.is_linear(&at, [a, b, c], self.sigma_nt).then_some(label)
    }
}

/// Mean and covariance of the particles of a mode over all states.
fn gaussian<const N: usize>(filter: &MarginalisedParticleFilter<'_, N>, mode: usize) -> Gaussian {
    let MarginalisedParticleFilter { cloud, clusters, line, layout, p, .. } = filter;
    let weights = &cloud.weights.as_flattened()[..cloud.particles];
    let of_modes = moments::<N>(weights, &clusters.labels, clusters.count, |index| cloud.particle(index));
    let mut gaussian = Gaussian::start_of(line, layout);
    let states = STATES + layout.errors.len();
    if let Some(of) = of_modes.get(mode) {
        gaussian.x.copy_from_slice(&of.mean[..states]);
        for (row, (of_mode, own)) in of.covariance.iter().zip(p).enumerate().take(states) {
            for (column, (of_mode, own)) in of_mode.iter().zip(own).enumerate().take(states) {
                *gaussian.p.at_mut(row, column) = of_mode + own;
            }
        }
    }
    gaussian
}

/// Output of the particles and of the Kalman filter after them.
#[derive(Clone, Debug, Default)]
pub struct HandOverOutput {
    /// Output of the particles, continued by that of the Kalman filter. After the hand-over, the effective number of
    /// particles is NaN and their number is 0.
    pub all: MpfOutput,
    /// Last row of the particles; `None` if the conditions never hold.
    pub handed_over: Option<usize>,
}

/// Filters one line with particles, and from the hand-over on with an extended Kalman filter of the same states.
///
/// # Errors
/// Returns the errors of [`super::run`].
pub fn run_then_ekf(
    parameters: &MpfParameters,
    line: &NavigationLine<'_>,
    aids: &Aids<'_>,
    conditions: &HandOver,
) -> Result<HandOverOutput, NavigationError> {
    check(parameters, line, aids)?;
    let (mut all, estimate) = filtered(parameters, line, aids, Some(conditions))?;
    let Some(HandOverEstimate { row: last, gaussian }) = estimate else {
        return Ok(HandOverOutput { all, handed_over: None });
    };
    let MpfParameters { gate_nis, keep_states, keep_covariance, .. } = *parameters;
    let kalman = AidedParameters { gate_nis, keep_states, keep_covariance, ..AidedParameters::default() };
    let mut filter = AidedFilter::new(line, aids, &kalman);
    filter.now = gaussian;
    for row in last + 1..line.ins.len() {
        filter.advance(row);
        let scalar = filter.scalar(row);
        filter.finish(row, scalar)?;
    }
    let rest = filter.output;
    all.effective.resize(line.ins.len(), f64::NAN);
    all.particles.resize(line.ins.len(), 0);
    all.track.append(rest.navigation);
    all.usage.extend(rest.usage);
    all.aids.append(rest.aids);
    Ok(HandOverOutput { all, handed_over: Some(last) })
}

/// Position and velocity that the particles found for the aircraft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocatedAircraft {
    /// Row of the sample.
    pub row: usize,
    /// Latitude, in degrees.
    pub lat_deg: f64,
    /// Longitude, in degrees.
    pub lon_deg: f64,
    /// Height above the ellipsoid, in metres.
    pub alt_m: f64,
    /// Velocity north, east and down, in m/s.
    pub vel_ned_mps: [f64; 3],
    /// Root mean square of the horizontal position error, in metres.
    pub horizontal_sigma_m: f64,
    /// Standard deviation of the height, in metres.
    pub vertical_sigma_m: f64,
    /// Standard deviation of the velocity north or east, the larger one, in m/s.
    pub velocity_sigma_mps: f64,
}

/// Position and velocity at the hand-over; `None` if its conditions never hold.
///
/// # Errors
/// Returns the errors of [`super::run`].
pub fn locate(
    parameters: &MpfParameters,
    line: &NavigationLine<'_>,
    conditions: &HandOver,
) -> Result<Option<LocatedAircraft>, NavigationError> {
    let aids = Aids::default();
    check(parameters, line, &aids)?;
    let (_, estimate) = filtered(parameters, line, &aids, Some(conditions))?;
    Ok(estimate.map(|HandOverEstimate { row, gaussian }| {
        let (ins, x, p) = (line.ins, &gaussian.x, &gaussian.p);
        let (lat_deg, alt_m) = (ins.lat_deg[row] + x[LAT].to_degrees(), ins.alt_m[row] + x[ALT]);
        let (north_m, east_m) = line.errors.earth.north_east_m_per_rad(lat_deg.to_radians(), alt_m);
        let sigma = |state: usize| p.at(state, state).sqrt();
        LocatedAircraft {
            row,
            lat_deg,
            lon_deg: ins.lon_deg[row] + x[LON].to_degrees(),
            alt_m,
            vel_ned_mps: [ins.vn_mps[row] + x[VN], ins.ve_mps[row] + x[VE], ins.vd_mps[row] + x[VD]],
            horizontal_sigma_m: f64::hypot(north_m * sigma(LAT), east_m * sigma(LON)),
            vertical_sigma_m: sigma(ALT),
            velocity_sigma_mps: sigma(VN).max(sigma(VE)),
        }
    }))
}

//! Test of aiding positions against the INS. It detects jammed, spoofed or drifting receivers.
//!
//! A filter of INS and fixes alone, without the magnetic field, predicts each fix. A wrong map therefore cannot cause
//! the rejection of a position, and all filters of a line use the same fixes. Two tests of the innovation ν with
//! covariance S run in parallel, each for the horizontal position and for the height:
//!
//! - the chi-square test of one fix, νᵀ S⁻¹ ν against [`SINGLE_NIS`]: a fix above this limit is rejected [Bar-Shalom,
//!   Li & Kirubarajan 2001, section 5.4];
//! - a cumulative sum s of the whitened innovations z, s ← (s + z) max(0, 1 − k / |s + z|) with k = [`ALLOWANCE`],
//!   which raises an alarm if |s| > [`ALARM`] [Crosier 1988, Multivariate generalizations of cumulative sum
//!   quality-control schemes, Technometrics 30(3)]; it has the same power in every direction. It detects changes
//!   smaller than the noise of a single fix. With fixes of 2 m every second, it detects a drift of 1 m/s after 7 to 12
//!   s, and a drift of 0.5 m/s after 12 to 19 s.
//!
//! At an alarm, the fixes since the sum was last 0 are also rejected, and the test resumes from the state before them.
//! The test therefore stores the estimate before the last fix at which the sum was 0. During the alarm, the INS alone
//! predicts. [`RECOVERY`] consecutive fixes that agree with the INS end the alarm.
//!
//! The test assumes a large uncertainty of the initial position, velocity and attitude ([`START_POSITION_M`] and
//! others), because the actual initial error may exceed the error that a filter assumes. It needs about 30 s of fixes
//! before it detects a drift. An offset that is present from the first fix on cannot be detected. If the fixes have
//! more noise than assumed, the limits of both tests are widened according to the median of z² over the last
//! [`SCALE_OVER`] fixes.

use crate::navigation::gaussian::{Sensitivity, StateEstimate, StepModel};
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::{ALT, LAT, LON, StateMatrix, TILT_D, TILT_N, VD, VN};
use crate::navigation::position_fixes::{PositionFixes, StateFix};

/// Limits of the NIS per component, for a height and for a pair of coordinates. A single fix above the limit is
/// rejected. The probability for a valid fix is 1e-6.
pub const SINGLE_NIS: [f64; 2] = [23.9, 13.8];
/// Part of each whitened innovation that the cumulative sum ignores, in standard deviations.
pub const ALLOWANCE: f64 = 1.0;
/// Cumulative sum that raises an alarm, in standard deviations.
pub const ALARM: f64 = 10.0;
/// Largest innovation that enters the sum, in standard deviations, so that one outlier raises no alarm.
const LARGEST: f64 = 5.0;
/// Number of consecutive fixes that must agree with the INS before fixes are used again.
pub const RECOVERY: usize = 10;
/// Largest NIS per component of a fix that agrees with the INS: 0.1 % of valid pairs exceed it.
const AGREES_NIS: f64 = 6.9;
/// Number of fixes from which the noise is estimated.
pub const SCALE_OVER: usize = 50;
/// Median of the square of a standard normal variable.
const MEDIAN_SQUARE: f64 = 0.4549;
/// Smallest initial standard deviation of each coordinate in the test, in metres.
pub const START_POSITION_M: f64 = 10_000.0;
/// Smallest initial standard deviation of each velocity component, in m/s.
pub const START_VELOCITY_MPS: f64 = 2.0;
/// Smallest initial standard deviations of tilt and heading, in degrees.
pub const START_ATTITUDE_DEG: [f64; 2] = [0.05, 0.2];

/// Result for the fixes of a line.
#[derive(Clone, Debug, PartialEq)]
pub struct FixTestResult {
    /// Accepted fixes; rejected fixes are NaN.
    pub accepted: PositionFixes,
    /// For each sample, whether a coordinate of its fix was rejected.
    pub rejected: Vec<bool>,
    /// Samples at which the cumulative sum raised an alarm.
    pub alarms: Vec<usize>,
}

/// Tests the fixes of a line against its INS.
///
/// # Errors
/// Returns the errors of [`InsErrorModel::check`], [`InsSeries::check`] and [`PositionFixes::check`]. Also fails with
/// [`NavigationError::Diverged`] if a state or variance is not finite.
pub fn run(
    ins: &InsSeries<'_>,
    errors: &InsErrorModel,
    fixes: &PositionFixes,
) -> Result<FixTestResult, NavigationError> {
    errors.check()?;
    ins.check()?;
    fixes.check(ins.len())?;
    let mut monitor = FixMonitor::new(ins, errors, fixes);
    for row in 0..ins.len() {
        monitor.sample(row)?;
    }
    Ok(monitor.finish())
}

/// Coordinates of the horizontal position and of the height.
const CHANNELS: [&[usize]; 2] = [&[0, 1], &[2]];

/// State of the test of one channel: the horizontal position or the height.
struct FixTestChannel {
    /// Coordinates of the channel.
    coordinates: &'static [usize],
    /// Cumulative sum of each coordinate's whitened innovations.
    sum: [f64; 2],
    /// Last fix before which the sum was 0: the sample of the fix, and the estimate before the fix.
    calm: Option<(usize, StateEstimate)>,
    /// Number of consecutive fixes during an alarm that agreed with the INS; `None` without an alarm.
    alarm: Option<usize>,
    /// Squares of the last whitened innovations.
    squares: Vec<f64>,
    /// For each sample, whether its fix is used.
    uses: Vec<bool>,
}

struct FixMonitor<'a> {
    ins: &'a InsSeries<'a>,
    errors: &'a InsErrorModel,
    model: StepModel,
    fixes: &'a PositionFixes,
    now: StateEstimate,
    channels: [FixTestChannel; 2],
    alarms: Vec<usize>,
}

impl FixTestChannel {
    fn new(coordinates: &'static [usize], rows: usize) -> Self {
        let (sum, squares) = ([0.0; 2], Vec::with_capacity(2 * SCALE_OVER));
        Self { coordinates, sum, calm: None, alarm: None, squares, uses: vec![true; rows] }
    }

    /// Ratio of the observed to the assumed variance of the last fixes; at least 1.
    fn scale(&self) -> f64 {
        let last = SCALE_OVER * self.coordinates.len();
        let mut squares = self.squares[self.squares.len().saturating_sub(last)..].to_vec();
        if squares.len() < last / 2 {
            return 1.0;
        }
        let middle = squares.len() / 2;
        let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
        (*median / MEDIAN_SQUARE).max(1.0)
    }

    /// Adds whitened innovations with the standard deviation `scale` to the cumulative sum.
    fn accumulate(&mut self, z: &[f64], scale: f64) {
        for (sum, z) in self.sum.iter_mut().zip(z) {
            *sum += (z / scale).clamp(-LARGEST, LARGEST);
        }
        let shrink = (1.0 - ALLOWANCE / length(self.sum)).max(0.0);
        self.sum = self.sum.map(|sum| sum * shrink);
    }

    /// Whether a fix with these whitened innovations is used, and whether it raises an alarm.
    fn judge(&mut self, z: &[f64], row: usize, before: &StateEstimate) -> (bool, bool) {
        let scale = self.scale();
        let nis = z.iter().map(|z| z * z).sum::<f64>() / (scale * z.len() as f64);
        if let Some(agreed) = &mut self.alarm {
            *agreed = if nis < AGREES_NIS { *agreed + 1 } else { 0 };
            if *agreed >= RECOVERY {
                (self.alarm, self.sum, self.calm) = (None, [0.0; 2], None);
            }
            return (false, false);
        }
        if self.calm.is_none() || self.sum == [0.0; 2] {
            self.calm = Some((row, *before));
        }
        // Before the noise of the fixes is estimated, excess noise would appear as a drift.
        if self.squares.len() >= SCALE_OVER / 2 * z.len() {
            self.accumulate(z, scale.sqrt());
        }
        let alarm = length(self.sum) > ALARM;
        let used = nis <= SINGLE_NIS[z.len() - 1];
        if used {
            self.squares.extend(z.iter().map(|z| z * z));
        }
        (used && !alarm, alarm)
    }
}

impl<'a> FixMonitor<'a> {
    fn new(ins: &'a InsSeries<'a>, errors: &'a InsErrorModel, fixes: &'a PositionFixes) -> Self {
        let mut now = StateEstimate::start_of(errors, ins);
        let (lat_rad, alt_m) = (ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let (north_m, east_m) = errors.earth.north_east_m_per_rad(lat_rad, alt_m);
        let mut at_least = |state: usize, sigma: f64| now.p[state][state] = now.p[state][state].max(sigma * sigma);
        at_least(LAT, START_POSITION_M / north_m);
        at_least(LON, START_POSITION_M / east_m);
        at_least(ALT, START_POSITION_M);
        (VN..=VD).for_each(|state| at_least(state, START_VELOCITY_MPS));
        (TILT_N..=TILT_D).for_each(|state| at_least(state, START_ATTITUDE_DEG[0].to_radians()));
        at_least(TILT_D, START_ATTITUDE_DEG[1].to_radians());
        let channels = CHANNELS.map(|coordinates| FixTestChannel::new(coordinates, ins.len()));
        Self { ins, errors, model: StepModel::from_error_model(errors), fixes, now, channels, alarms: vec![] }
    }

    fn step(&mut self, row: usize) {
        if row > 0 {
            self.now.propagate(&self.model, self.ins, row);
        }
    }

    /// Processes a row: step, tests, and the fixes that pass them.
    fn sample(&mut self, row: usize) -> Result<(), NavigationError> {
        self.step(row);
        let fixes = self.fixes.at(self.ins, row, self.errors.earth);
        for of in 0..self.channels.len() {
            let before = self.now;
            let channel = &mut self.channels[of];
            let there: Vec<StateFix> = channel.coordinates.iter().filter_map(|k| fixes[*k]).collect();
            if there.is_empty() {
                continue;
            }
            let (used, alarm) = channel.judge(&whitened(&before, &there), row, &before);
            channel.uses[row] = used;
            if alarm {
                self.resume(of, row);
            } else if used {
                there.into_iter().for_each(|fix| self.correct(fix));
            }
        }
        self.now.check(row, self.ins.tt_s[row])
    }

    /// Rejects the fixes of a channel since its sum began to rise, and filters these samples again.
    fn resume(&mut self, of: usize, row: usize) {
        self.alarms.push(row);
        let channel = &mut self.channels[of];
        channel.alarm = Some(0);
        let Some((first, before)) = channel.calm.take() else { return };
        channel.uses[first..=row].fill(false);
        // A state of another channel that was stored within these samples is no longer valid.
        for other in self.channels.iter_mut().filter(|other| other.calm.is_some_and(|(at, _)| at > first)) {
            other.calm = None;
        }
        self.now = before;
        for at in first..=row {
            if at > first {
                self.step(at);
            }
            let fixes = self.fixes.at(self.ins, at, self.errors.earth);
            for channel in 0..self.channels.len() {
                // At the first sample, the stored estimate already includes the fixes of the preceding channels.
                let done = at == first && channel < of;
                let later = at == row && channel > of;
                let FixTestChannel { coordinates, uses, .. } = &self.channels[channel];
                if !done && !later && uses[at] {
                    let there: Vec<StateFix> = coordinates.iter().filter_map(|k| fixes[*k]).collect();
                    there.into_iter().for_each(|fix| self.correct(fix));
                }
            }
        }
    }

    fn correct(&mut self, StateFix { state, error, variance }: StateFix) {
        self.now.update(Sensitivity::of_state(state), error, variance);
    }

    fn finish(self) -> FixTestResult {
        let mut accepted = self.fixes.clone();
        let mut rejected = vec![false; self.ins.len()];
        for (row, rejected) in rejected.iter_mut().enumerate() {
            let values = [&mut accepted.lat_deg, &mut accepted.lon_deg, &mut accepted.alt_m];
            for (coordinate, values) in values.into_iter().enumerate() {
                let channel = self.channels.iter().find(|channel| channel.coordinates.contains(&coordinate));
                if values[row].is_finite() && channel.is_some_and(|channel| !channel.uses[row]) {
                    (values[row], *rejected) = (f64::NAN, true);
                }
            }
        }
        FixTestResult { accepted, rejected, alarms: self.alarms }
    }
}

fn length([a, b]: [f64; 2]) -> f64 {
    a.hypot(b)
}

/// Innovations of fixes, whitened to independent values of variance 1, in their order.
fn whitened(estimate: &StateEstimate, fixes: &[StateFix]) -> Vec<f64> {
    let (x, p): (_, &StateMatrix) = (&estimate.x, &estimate.p);
    let own = |fix: &StateFix| (fix.error - x[fix.state], p[fix.state][fix.state] + fix.variance);
    match fixes {
        [first, second] => {
            let ((a, s_aa), (b, s_bb)) = (own(first), own(second));
            let slope = p[first.state][second.state] / s_aa;
            let rest = s_bb - slope * p[first.state][second.state];
            vec![a / s_aa.sqrt(), (b - slope * a) / rest.sqrt()]
        }
        others => others.iter().map(|fix| own(fix).0 / own(fix).1.sqrt()).collect(),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;

//! The legs of a flight: straight stretches, and the turns between them.

use std::ops::Range;

use numerics::regression::statistics::{mean, quantile};

use super::motion::{FlightMotion, RATE_HZ, runs};

/// Minimum rate of a turn: a share of the flight's typical turn rate, within limits in degrees per second.
const PART: f64 = 0.25;
const LIMITS_DPS: (f64, f64) = (0.3, 3.0);
/// Minimum course change that counts as a turn, in degrees; the yaw manoeuvres of a calibration stay below this change.
const LEAST_DEG: f64 = 20.0;
/// Maximum duration of an interruption of a turn by a lower turn rate, in seconds.
const LULL_S: f64 = 3.0;
/// Bounds on the minimum length of a leg, in seconds; shorter stretches belong to the adjacent turns. The minimum
/// length is the share `LEG_OF_SHORT` of the longest leg, within these bounds. The sides of a small square are thus
/// either all legs or all parts of turns. The lower bound is necessary because the smoothing of turn rates blurs
/// shorter legs.
const LEG_S: (f64, f64) = (3.6, 5.0);
const LEG_OF_SHORT: f64 = 0.35;
/// Maximum deviation of a leg's course from its mean, in degrees. A tenth of the samples may deviate more.
const STRAIGHT_DEG: f64 = 15.0;
/// Changes of the angles with longer periods than [`SLOW_S`] are removed. The power of the angles is computed over
/// windows of [`POWER_S`].
const SLOW_S: f64 = 12.0;
const POWER_S: f64 = 6.0;
/// Time in which the aircraft levels out at the ends of a leg, in seconds.
const SETTLE_S: f64 = 3.0;
/// Minimum root mean square of an angle in a manoeuvre, in degrees, and minimum ratio of this value to that of quiet
/// flight.
const LEAST_RMS_DEG: f64 = 0.8;
const CONTRAST: f64 = 3.0;

/// Class of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionClass {
    /// On the ground, in hover, or unknown.
    Slow,
    /// Straight flight.
    Straight,
    /// Turn or curve.
    Turn,
    /// Straight flight with a pitch, roll or yaw manoeuvre.
    Manoeuvre,
}

/// A straight stretch.
#[derive(Clone, Debug)]
pub struct StraightLeg {
    /// Rows.
    pub rows: Range<usize>,
    /// The number of the run that contains the leg.
    pub run: usize,
    /// The mean course, unwrapped within the run, in degrees.
    pub course_deg: f64,
    /// Whether roll, pitch and yaw show a manoeuvre on the leg.
    pub manoeuvres: [bool; 3],
}

/// A turn to one side.
#[derive(Clone, Debug)]
pub struct FlightTurn {
    /// Rows.
    pub rows: Range<usize>,
    /// The change of the course, degrees, positive to the right.
    pub change_deg: f64,
}

/// Segmentation of a flight into legs and turns.
#[derive(Clone, Debug, Default)]
pub struct FlightSegments {
    /// Class of each sample.
    pub parts: Vec<MotionClass>,
    /// In the order of time.
    pub legs: Vec<StraightLeg>,
    /// In the order of time.
    pub turns: Vec<FlightTurn>,
    /// The root mean square of roll, pitch and yaw about the slow changes of these angles, in degrees; NaN off the
    /// legs.
    pub power_deg: [Vec<f64>; 3],
}

impl FlightSegments {
    /// Divides a flight into segments.
    pub fn from_motion(motion: &FlightMotion) -> FlightSegments {
        let rows = motion.tt_s.len();
        let none = vec![f64::NAN; rows];
        let mut found = FlightSegments {
            parts: vec![MotionClass::Slow; rows],
            power_deg: std::array::from_fn(|_| none.clone()),
            ..FlightSegments::default()
        };
        let least_dps = threshold_dps(motion);
        let turning: Vec<Vec<bool>> = motion.runs.iter().map(|run| found.turning(motion, run, least_dps)).collect();
        let stretches: Vec<Vec<Range<usize>>> =
            motion.runs.iter().zip(&turning).map(|(run, turning)| straight(motion, run, turning)).collect();
        let longest = stretches.iter().flatten().map(ExactSizeIterator::len).max().unwrap_or(0) as f64;
        let least = (LEG_OF_SHORT * longest).clamp(LEG_S.0 * RATE_HZ, LEG_S.1 * RATE_HZ);
        for (number, (run, straight)) in motion.runs.iter().zip(stretches).enumerate() {
            found.parts[run.clone()].fill(MotionClass::Turn);
            for rows in straight.into_iter().filter(|rows| rows.len() as f64 >= least) {
                found.parts[rows.clone()].fill(MotionClass::Straight);
                let course_deg = mean(&motion.course_deg[rows.clone()]).value;
                found.legs.push(StraightLeg { rows, run: number, course_deg, manoeuvres: [false; 3] });
            }
        }
        let mut legs = std::mem::take(&mut found.legs);
        legs.iter_mut().for_each(|leg| found.manoeuvres(motion, leg));
        found.legs = legs;
        found
    }

    /// Whether each sample of a run is in a turn. The turns are stored.
    fn turning(&mut self, motion: &FlightMotion, run: &Range<usize>, least_dps: f64) -> Vec<bool> {
        let rates = &motion.turn_dps[run.clone()];
        let mut sides: Vec<i8> = rates.iter().map(|r| if r.abs() < least_dps { 0 } else { r.signum() as i8 }).collect();
        let lull = (LULL_S * RATE_HZ) as usize;
        let found = equal_runs(&sides);
        for w in found.windows(3) {
            let [before, between, after] = w else { continue };
            let to = sides[before.start];
            if sides[between.start] == 0 && to == sides[after.start] && between.len() < lull {
                sides[between.clone()].fill(to);
            }
        }
        let course = &motion.course_deg;
        let mut turning = vec![false; run.len()];
        for side in equal_runs(&sides).into_iter().filter(|side| sides[side.start] != 0) {
            let rows = run.start + side.start..run.start + side.end;
            let change_deg = course[rows.end - 1] - course[rows.start];
            if change_deg.abs() >= LEAST_DEG {
                turning[side].fill(true);
                self.turns.push(FlightTurn { rows, change_deg });
            }
        }
        turning
    }

    /// Computes the power of the angles on a leg, and detects the manoeuvres.
    fn manoeuvres(&mut self, motion: &FlightMotion, leg: &mut StraightLeg) {
        let settle = (SETTLE_S * RATE_HZ) as usize;
        let inner = leg.rows.start + settle..leg.rows.end.saturating_sub(settle);
        if inner.len() < (2.0 * POWER_S * RATE_HZ) as usize {
            return;
        }
        let angles = motion.angles_deg.iter().zip(&mut self.power_deg).zip(&mut leg.manoeuvres);
        for ((angle, power), has_manoeuvre) in angles {
            let about = less_slow(&angle[inner.clone()]);
            let squares: Vec<f64> = about.iter().map(|x| x * x).collect();
            let rms: Vec<f64> =
                moving_mean(&squares, (POWER_S * RATE_HZ) as usize).into_iter().map(f64::sqrt).collect();
            power[inner.clone()].copy_from_slice(&rms);
            let mut sorted: Vec<f64> = rms.iter().copied().filter(|x| x.is_finite()).collect();
            if 2 * sorted.len() < rms.len() {
                continue;
            }
            sorted.sort_by(f64::total_cmp);
            let (quiet, loud) = (quantile(&sorted, 0.2), quantile(&sorted, 0.9));
            if loud < LEAST_RMS_DEG || loud < CONTRAST * quiet {
                continue;
            }
            *has_manoeuvre = true;
            // The threshold is halfway between the levels of quiet flight and of manoeuvres, in decibels.
            let limit = (quiet.max(0.01 * loud) * loud).sqrt();
            let at = inner.clone().zip(&rms).filter(|(_, rms)| **rms > limit);
            at.for_each(|(row, _)| self.parts[row] = MotionClass::Manoeuvre);
        }
    }

    /// The change of the course from the end of one leg to the start of the next, in degrees; `None` if there is a gap
    /// between them.
    pub fn turned_deg(&self, motion: &FlightMotion, from: &StraightLeg, to: &StraightLeg) -> Option<f64> {
        let course = |row: usize| motion.course_deg.get(row).copied();
        (from.run == to.run).then(|| Some(course(to.rows.start)? - course(from.rows.end.checked_sub(1)?)?))?
    }
}

/// Minimum turn rate at which the aircraft is in a turn. The limit is a share of the rate below which half of the total
/// change of course occurs. Long straight flight and sharp corners therefore have little effect.
fn threshold_dps(motion: &FlightMotion) -> f64 {
    let mut rates: Vec<f64> = motion.turn_dps.iter().map(|r| r.abs()).filter(|r| r.is_finite()).collect();
    rates.sort_by(f64::total_cmp);
    let half = 0.5 * rates.iter().sum::<f64>();
    let mut sum = 0.0;
    let usual = rates.iter().find(|r| {
        sum += **r;
        sum >= half
    });
    (PART * usual.copied().unwrap_or(0.0)).clamp(LIMITS_DPS.0, LIMITS_DPS.1)
}

/// The straight stretches between the turns of a run.
fn straight(motion: &FlightMotion, run: &Range<usize>, turning: &[bool]) -> Vec<Range<usize>> {
    let between = runs(turning.iter().map(|t| !t)).into_iter();
    let rows = between.map(|rows| run.start + rows.start..run.start + rows.end);
    rows.filter(|rows| is_straight(&motion.course_deg[rows.clone()])).collect()
}

fn is_straight(course_deg: &[f64]) -> bool {
    let middle = mean(course_deg).value;
    let mut off: Vec<f64> = course_deg.iter().map(|c| (c - middle).abs()).collect();
    off.sort_by(f64::total_cmp);
    quantile(&off, 0.9) <= STRAIGHT_DEG
}

/// The runs of equal entries.
fn equal_runs<T: PartialEq>(entries: &[T]) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = vec![];
    for (row, entry) in entries.iter().enumerate() {
        match found.last_mut() {
            Some(run) if entries.get(run.start) == Some(entry) => run.end = row + 1,
            _ => found.push(row..row + 1),
        }
    }
    found
}

/// Values minus the mean of the surrounding samples.
fn less_slow(x: &[f64]) -> Vec<f64> {
    let slow = moving_mean(x, (SLOW_S * RATE_HZ) as usize);
    x.iter().zip(slow).map(|(x, slow)| x - slow).collect()
}

/// Mean of the finite samples of a window about each sample, clipped at the ends.
fn moving_mean(x: &[f64], window: usize) -> Vec<f64> {
    let (mut sums, mut counts) = (vec![0.0], vec![0_usize]);
    for value in x {
        let there = value.is_finite();
        sums.push(sums.last().copied().unwrap_or(0.0) + if there { *value } else { 0.0 });
        counts.push(counts.last().copied().unwrap_or(0) + usize::from(there));
    }
    let one = |row: usize| {
        let (from, to) = (row.saturating_sub(window / 2), (row + window / 2 + 1).min(x.len()));
        (sums[to] - sums[from]) / (counts[to] - counts[from]) as f64
    };
    (0..x.len()).map(one).collect()
}

//! A flight at evenly spaced times: position, speed, course and attitude.

use numerics::{
    angle::{unwrapped_deg, wrap_deg},
    earth::geodesy::EarthModel,
    regression::statistics::{median, quantile},
    signal::savitzky_golay::SavitzkyGolay,
};
use std::ops::Range;

/// The rate of the evenly spaced times.
pub const RATE_HZ: f64 = 5.0;
/// Number of samples of the polynomials whose slopes are the velocity and the turn rate.
const VELOCITY_WINDOW: usize = 11;
const TURN_WINDOW: usize = 15;
/// Speed limits: a share of the flight's typical speed, and a minimum speed. A slower aircraft is on the ground or
/// hovers.
const SLOW: f64 = 0.2;
const LEAST_MPS: f64 = 1.0;
/// Quantile of the speeds that is taken as the typical speed. The percentile is high, because most of a log may be on
/// the ground.
const USUAL: f64 = 0.95;

/// Positions of a flight, in the order of their times.
#[derive(Clone, Debug, Default)]
pub struct PositionChannel {
    /// Times, in seconds past midnight UTC.
    pub tt_s: Vec<f64>,
    /// Latitudes, in degrees.
    pub lat_deg: Vec<f64>,
    /// Longitudes, in degrees.
    pub lon_deg: Vec<f64>,
    /// Heights, in metres; NaN if unknown.
    pub alt_m: Vec<f64>,
}

/// Attitudes of a flight, in the order of their times.
#[derive(Clone, Debug, Default)]
pub struct AttitudeChannel {
    /// Times, in seconds past midnight UTC.
    pub tt_s: Vec<f64>,
    /// Roll, pitch and yaw, in degrees.
    pub angles_deg: [Vec<f64>; 3],
}

/// Position and attitude of a flight, the inputs of line detection.
#[derive(Clone, Debug, Default)]
pub struct FlightChannels {
    /// Positions; may be empty.
    pub position: PositionChannel,
    /// Attitudes; may be empty.
    pub attitude: AttitudeChannel,
}

/// Motion of a flight at 5 Hz; NaN where unknown.
#[derive(Clone, Debug, Default)]
pub struct FlightMotion {
    /// Times at multiples of the time step, in seconds past midnight UTC.
    pub tt_s: Vec<f64>,
    /// Distance north of the first position, in metres.
    pub north_m: Vec<f64>,
    /// Distance east of the first position, in metres.
    pub east_m: Vec<f64>,
    /// Height, in metres.
    pub alt_m: Vec<f64>,
    /// Speed over ground, in m/s.
    pub speed_mps: Vec<f64>,
    /// Course, or heading if there are no positions, in degrees; unwrapped within a run.
    pub course_deg: Vec<f64>,
    /// Rate of change of the course, in degrees per second.
    pub turn_dps: Vec<f64>,
    /// Roll, pitch and yaw, degrees, unwrapped.
    pub angles_deg: [Vec<f64>; 3],
    /// Stretches of motion without a gap.
    pub runs: Vec<Range<usize>>,
}

impl FlightMotion {
    /// The motion of a flight; empty without positions and headings.
    pub fn from_channels(channels: &FlightChannels) -> FlightMotion {
        let FlightChannels { position, attitude } = channels;
        let Some(tt_s) = even_times(&[&position.tt_s, &attitude.tt_s]) else { return FlightMotion::default() };
        let (at_s, north, east, alt) = on_the_plane(position);
        let on = |x: &[f64]| onto(&at_s, x, &tt_s);
        let (north_m, east_m, alt_m) = (on(&north), on(&east), on(&alt));
        let angle = |x: &Vec<f64>| onto(&attitude.tt_s, &unwrapped_deg(x), &tt_s);
        let angles_deg = attitude.angles_deg.each_ref().map(angle);
        let none = vec![f64::NAN; tt_s.len()];
        let (course_deg, turn_dps, speed_mps) = (none.clone(), none.clone(), none);
        let mut motion =
            FlightMotion { tt_s, north_m, east_m, alt_m, speed_mps, course_deg, turn_dps, angles_deg, runs: vec![] };
        let moving = if at_s.is_empty() { motion.of_headings() } else { motion.of_positions() };
        motion.turns(&moving);
        motion
    }

    /// Computes speed and course from the positions. Returns whether the aircraft moves at each time.
    fn of_positions(&mut self) -> Vec<bool> {
        let Ok(slope) = SavitzkyGolay::new(VELOCITY_WINDOW, 2, 1) else { return vec![] };
        for run in runs(self.north_m.iter().map(|x| x.is_finite())) {
            let (Some(north), Some(east)) =
                (slope.apply(&self.north_m[run.clone()]), slope.apply(&self.east_m[run.clone()]))
            else {
                continue;
            };
            for (row, (n, e)) in run.zip(north.into_iter().zip(east)) {
                self.speed_mps[row] = n.hypot(e) * RATE_HZ;
                self.course_deg[row] = e.atan2(n).to_degrees();
            }
        }
        let mut speeds: Vec<f64> = self.speed_mps.iter().copied().filter(|v| v.is_finite()).collect();
        speeds.sort_by(f64::total_cmp);
        let usual = if speeds.is_empty() { 0.0 } else { quantile(&speeds, USUAL) };
        let slow = LEAST_MPS.max(SLOW * usual);
        self.speed_mps.iter().map(|v| *v > slow).collect()
    }

    /// Uses the heading as the course. Returns whether the aircraft moves at each time.
    fn of_headings(&mut self) -> Vec<bool> {
        let [_, _, yaw] = &self.angles_deg;
        self.course_deg.clone_from(yaw);
        yaw.iter().map(|x| x.is_finite()).collect()
    }

    /// Computes the turn rate in each stretch of motion.
    fn turns(&mut self, moving: &[bool]) {
        let Ok(slope) = SavitzkyGolay::new(TURN_WINDOW, 2, 1) else { return };
        for run in runs(moving.iter().copied()) {
            let course = unwrapped_deg(&self.course_deg[run.clone()]);
            let Some(rates) = slope.apply(&course) else { continue };
            self.course_deg[run.clone()].copy_from_slice(&course);
            self.turn_dps[run.clone()].iter_mut().zip(rates).for_each(|(to, rate)| *to = rate * RATE_HZ);
            self.runs.push(run);
        }
    }

    /// The course at a row, 0 to 360 degrees.
    pub fn heading_deg(&self, row: usize) -> f64 {
        self.course_deg.get(row).map_or(f64::NAN, |c| c.rem_euclid(360.0))
    }
}

/// The runs of rows for which `holds` is true.
pub fn runs(holds: impl Iterator<Item = bool>) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = vec![];
    for (row, _) in holds.enumerate().filter(|(_, holds)| *holds) {
        match found.last_mut() {
            Some(run) if run.end == row => run.end = row + 1,
            _ => found.push(row..row + 1),
        }
    }
    found
}

/// Multiples of the time step from the first to the last of all times.
fn even_times(all: &[&[f64]]) -> Option<Vec<f64>> {
    /// Maximum number of samples: ten days.
    const MOST: f64 = 10.0 * 86_400.0 * RATE_HZ;
    let ends = all.iter().filter_map(|tt| Some((*tt.first()?, *tt.last()?)));
    let (first, last) = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
    let (from, to) = ((first * RATE_HZ).ceil(), (last * RATE_HZ).floor());
    if !(to > from && to - from < MOST) {
        return None;
    }
    Some((0..=(to - from) as usize).map(|k| (from + k as f64) / RATE_HZ).collect())
}

/// Times, coordinates north and east of the first position, in metres, and heights, in metres. Positions that a
/// receiver repeats until its next fix are omitted.
fn on_the_plane(position: &PositionChannel) -> (Vec<f64>, Vec<f64>, Vec<f64>, Vec<f64>) {
    let (mut tt, mut north, mut east, mut alt) = (vec![], vec![], vec![], vec![]);
    let mut last: Option<(f64, f64)> = None;
    let (mut n, mut e) = (0.0, 0.0);
    let rows = position.tt_s.iter().zip(&position.lat_deg).zip(&position.lon_deg).zip(&position.alt_m);
    for (((t, lat), lon), height) in rows {
        if !(t.is_finite() && lat.is_finite() && lon.is_finite()) || last == Some((*lat, *lon)) {
            continue;
        }
        if let Some(before) = last {
            // A sum of small steps is correct everywhere, including across the date line.
            let to = (*lat, before.1 + wrap_deg(lon - before.1));
            let (dn, de) = EarthModel::default().offset_ne_m(before, to, 0.0);
            (n, e) = (n + dn, e + de);
        }
        last = Some((*lat, *lon));
        tt.push(*t);
        north.push(n);
        east.push(e);
        alt.push(*height);
    }
    (tt, north, east, alt)
}

/// Linear interpolation onto even times; NaN in gaps.
fn onto(tt: &[f64], x: &[f64], grid: &[f64]) -> Vec<f64> {
    /// Minimum length of a gap that is not interpolated, in median steps, with lower and upper bounds in seconds.
    const STEPS: f64 = 2.5;
    const GAP_S: (f64, f64) = (1.0, 5.0);
    let known: Vec<(f64, f64)> = tt.iter().copied().zip(x.iter().copied()).filter(|(_, x)| x.is_finite()).collect();
    let mut steps: Vec<f64> = known.windows(2).map(|w| w[1].0 - w[0].0).filter(|d| *d > 0.0).collect();
    if steps.is_empty() {
        return vec![f64::NAN; grid.len()];
    }
    let gap_s = (STEPS * median(&mut steps)).clamp(GAP_S.0, GAP_S.1);
    let mut next = 0;
    let one = |t: &f64| {
        while known.get(next).is_some_and(|k| k.0 < *t) {
            next += 1;
        }
        match (next.checked_sub(1).and_then(|i| known.get(i)), known.get(next)) {
            (_, Some(after)) if after.0 == *t => after.1,
            (Some(before), Some(after)) if after.0 - before.0 <= gap_s => {
                before.1 + (after.1 - before.1) * (t - before.0) / (after.0 - before.0)
            }
            _ => f64::NAN,
        }
    };
    grid.iter().map(one).collect()
}

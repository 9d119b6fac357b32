//! True trajectories: level flight at constant speed over the ellipsoid, the course integrated with the
//! position, the attitude coordinated with the course.
//!
//! Manoeuvres and gusts move the attitude alone: they are short beside the time in which they would move
//! the aircraft.

use std::f64::consts::{PI, TAU};

use nalgebra::Matrix3;
use stages::numerics::{
    attitude::body_to_ned,
    geodesy::{EarthModel, wrap_deg},
};

use super::random::Random;
use crate::motion::{normal_gravity_mps2, specific_force_mps2};
pub use spec::{Flight, Line, Path2d};

pub(super) mod spec;

/// Fastest turn, in rad/s: at 60 m/s a bank of 23 degrees.
const FASTEST_TURN_RADPS: f64 = 4.0 * PI / 180.0;
/// Straight flight between the manoeuvres of a box, in seconds.
const SETTLE_S: f64 = 5.0;
/// Nose up in level flight, in degrees.
const TRIM_DEG: f64 = 2.0;
/// Longest step of the integration, in seconds.
const STEP_S: f64 = 0.1;

/// A true trajectory, one value a sample in each column.
#[derive(Clone, Debug, Default)]
pub(super) struct Trajectory {
    pub(super) tt_s: Vec<f64>,
    pub(super) lat_deg: Vec<f64>,
    pub(super) lon_deg: Vec<f64>,
    pub(super) alt_m: Vec<f64>,
    /// North, east, down, in m/s.
    pub(super) velocity_mps: [Vec<f64>; 3],
    /// North, east, down, in m/s².
    pub(super) force_mps2: [Vec<f64>; 3],
    /// Roll, pitch, yaw.
    pub(super) attitude_deg: [Vec<f64>; 3],
}

impl Trajectory {
    /// The matrix that turns the body frame into north-east-down at a sample.
    pub(super) fn attitude(&self, i: usize) -> Matrix3<f64> {
        let [roll, pitch, yaw] = self.attitude_deg.each_ref().map(|a| a[i].to_radians());
        body_to_ned(roll, pitch, yaw)
    }
}

impl Line {
    /// How long the line takes, in seconds.
    pub(super) fn duration_s(&self) -> f64 {
        match &self.path {
            Path2d::Survey { duration_s, .. } => *duration_s,
            Path2d::Box { period_s, cycles, .. } => Timeline::new(*period_s, *cycles).duration_s(),
        }
    }

    /// Flies the line. `gusts_deg` are standard deviations in roll, pitch and yaw.
    pub(super) fn fly(&self, rate_hz: f64, gusts_deg: [f64; 3], random: &mut Random) -> Trajectory {
        let gusts = gusts_deg.map(|sigma_deg| Gusts::new(sigma_deg, random));
        let mut pilot = Pilot::new(self);
        let mut state = pilot.start();
        let mut out = Trajectory::default();
        let samples = (self.duration_s() * rate_hz).floor() as usize + 1;
        for i in 0..samples {
            let t = i as f64 / rate_hz;
            self.record(&mut out, t, state, pilot.rate_radps(t, state), &gusts);
            pilot.choose_waypoint(state);
            state = pilot.advance(state, t, 1.0 / rate_hz);
        }
        out
    }

    fn record(&self, out: &mut Trajectory, t: f64, state: State, rate_radps: f64, gusts: &[Gusts; 3]) {
        let [lat, lon, course, _] = state;
        let (sin, cos) = course.sin_cos();
        let (v, turn) = (self.speed_mps, self.speed_mps * rate_radps);
        let velocity = [v * cos, v * sin, 0.0];
        let force = specific_force_mps2(lat, self.alt_m, velocity, [-turn * sin, turn * cos, 0.0]);
        let bank_deg = turn.atan2(normal_gravity_mps2(lat, self.alt_m)).to_degrees();
        let steady = [bank_deg, TRIM_DEG, course.to_degrees()];
        let moved = self.manoeuvre_deg(t);
        out.tt_s.push(self.start_tt_s + t);
        out.lat_deg.push(lat.to_degrees());
        out.lon_deg.push(wrap_deg(lon.to_degrees()));
        out.alt_m.push(self.alt_m);
        for axis in 0..3 {
            out.velocity_mps[axis].push(velocity[axis]);
            out.force_mps2[axis].push(force[axis]);
            let angle = steady[axis] + moved[axis] + gusts[axis].at(t);
            out.attitude_deg[axis].push(if axis == 2 { wrap_deg(angle) } else { angle });
        }
    }

    /// Roll, pitch and yaw that a manoeuvre adds.
    pub(super) fn manoeuvre_deg(&self, t: f64) -> [f64; 3] {
        let Path2d::Box { amplitude_deg, period_s, cycles, .. } = &self.path else { return [0.0; 3] };
        let mut out = [0.0; 3];
        if let Some((axis, since)) = Timeline::new(*period_s, *cycles).manoeuvre(t) {
            let left = period_s * f64::from(*cycles) - since;
            // The swing comes and goes within half a period, so that no rate jumps.
            let ramp = |s: f64| (PI * (s / period_s).min(0.5)).sin().powi(2);
            out[axis] = amplitude_deg[axis] * (TAU * since / period_s).sin() * ramp(since) * ramp(left);
        }
        out
    }
}

/// When what happens on a box.
struct Timeline {
    manoeuvre_s: f64,
}

impl Timeline {
    /// A turn by a right angle at a rate that comes and goes as a squared sine.
    const TURN_S: f64 = PI / FASTEST_TURN_RADPS;

    fn new(period_s: f64, cycles: u32) -> Self {
        Self { manoeuvre_s: period_s * f64::from(cycles) }
    }

    fn leg_s(&self) -> f64 {
        SETTLE_S + 3.0 * (self.manoeuvre_s + SETTLE_S)
    }

    fn duration_s(&self) -> f64 {
        4.0 * self.leg_s() + 3.0 * Self::TURN_S
    }

    /// Seconds since the beginning of the leg, and since the beginning of the turn after it.
    fn place(&self, t: f64) -> (f64, f64) {
        let since = t.rem_euclid(self.leg_s() + Self::TURN_S);
        (since, since - self.leg_s())
    }

    fn rate_radps(&self, t: f64) -> f64 {
        let (_, turning) = self.place(t);
        if turning < 0.0 { 0.0 } else { FASTEST_TURN_RADPS * (PI * turning / Self::TURN_S).sin().powi(2) }
    }

    /// The axis of the manoeuvre (pitch, roll, yaw in this order) and the seconds since it began.
    fn manoeuvre(&self, t: f64) -> Option<(usize, f64)> {
        const AXES: [usize; 3] = [1, 0, 2];
        let (since, _) = self.place(t);
        let slot = self.manoeuvre_s + SETTLE_S;
        let axis = AXES.get(((since - SETTLE_S) / slot).floor().max(0.0) as usize)?;
        let within = (since - SETTLE_S).rem_euclid(slot);
        (since >= SETTLE_S && within < self.manoeuvre_s).then_some((*axis, within))
    }
}

/// Latitude and longitude (rad), course (rad), its rate (rad/s).
type State = [f64; 4];

/// Who turns the aircraft.
struct Pilot<'a> {
    line: &'a Line,
    next: usize,
}

impl<'a> Pilot<'a> {
    fn new(line: &'a Line) -> Self {
        Self { line, next: 1 }
    }

    fn start(&self) -> State {
        match &self.line.path {
            Path2d::Survey { waypoints, .. } => {
                let (lat, lon) = waypoints.first().copied().unwrap_or_default();
                [lat.to_radians(), lon.to_radians(), self.bearing(lat, lon), 0.0]
            }
            Path2d::Box { start, heading_deg, .. } => {
                [start.0.to_radians(), start.1.to_radians(), heading_deg.to_radians(), 0.0]
            }
        }
    }

    /// North and east to the next waypoint, in metres.
    fn offset_m(&self, lat_deg: f64, lon_deg: f64) -> (f64, f64) {
        let Path2d::Survey { waypoints, .. } = &self.line.path else { return (1.0, 0.0) };
        let to = waypoints.get(self.next).copied().unwrap_or_default();
        EarthModel::Wgs84.offset_ne_m((lat_deg, lon_deg), to, self.line.alt_m)
    }

    fn bearing(&self, lat_deg: f64, lon_deg: f64) -> f64 {
        let (north, east) = self.offset_m(lat_deg, lon_deg);
        east.atan2(north)
    }

    /// Goes for the waypoint after the next once the turn towards it has to begin.
    fn choose_waypoint(&mut self, state: State) {
        let Path2d::Survey { waypoints, .. } = &self.line.path else { return };
        let (north, east) = self.offset_m(state[0].to_degrees(), state[1].to_degrees());
        if north.hypot(east) < 1.3 * self.line.speed_mps / FASTEST_TURN_RADPS {
            self.next = (self.next + 1) % waypoints.len();
        }
    }

    fn rate_radps(&self, t: f64, state: State) -> f64 {
        match &self.line.path {
            Path2d::Survey { .. } => state[3],
            Path2d::Box { period_s, cycles, .. } => Timeline::new(*period_s, *cycles).rate_radps(t),
        }
    }

    fn derivative(&self, t: f64, state: State) -> State {
        let [lat, lon, course, _] = state;
        let (v, alt_m, earth) = (self.line.speed_mps, self.line.alt_m, EarthModel::Wgs84);
        let rate = self.rate_radps(t, state);
        let d_rate = match &self.line.path {
            Path2d::Survey { weave_deg_s: (weave_deg, period_s), .. } => {
                // The pilot turns in proportion to the course error, with a lag of two seconds.
                const GAIN_PER_S: f64 = 0.1;
                const LAG_S: f64 = 2.0;
                let swing = weave_deg.to_radians() * (TAU * t / period_s).sin();
                let wanted = self.bearing(lat.to_degrees(), lon.to_degrees()) + swing;
                let error = wrap_deg((wanted - course).to_degrees()).to_radians();
                let turn = (GAIN_PER_S * error).clamp(-FASTEST_TURN_RADPS, FASTEST_TURN_RADPS);
                (turn - rate) / LAG_S
            }
            Path2d::Box { .. } => 0.0,
        };
        let (north, east) = (v * course.cos(), v * course.sin());
        [earth.north_m_to_lat_rad(north, lat, alt_m), earth.east_m_to_lon_rad(east, lat, alt_m), rate, d_rate]
    }

    /// The state `dt_s` later, by Runge and Kutta's fourth order in steps of a tenth of a second or less.
    fn advance(&self, mut state: State, t: f64, dt_s: f64) -> State {
        let steps = (dt_s / STEP_S - 1e-9).ceil().max(1.0);
        let h = dt_s / steps;
        for step in 0..steps as usize {
            let t = t + h * step as f64;
            let moved = |k: &State, by: f64| std::array::from_fn(|i| state[i] + by * k[i]);
            let k1 = self.derivative(t, state);
            let k2 = self.derivative(t + 0.5 * h, moved(&k1, 0.5 * h));
            let k3 = self.derivative(t + 0.5 * h, moved(&k2, 0.5 * h));
            let k4 = self.derivative(t + h, moved(&k3, h));
            state = std::array::from_fn(|i| state[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
        }
        state
    }
}

/// Small motions of one angle: sinusoids of random phase, 0.02 to 0.5 Hz, smooth and stationary.
struct Gusts {
    amplitude_deg: f64,
    waves: Vec<(f64, f64)>,
}

impl Gusts {
    fn new(sigma_deg: f64, random: &mut Random) -> Self {
        const WAVES: usize = 16;
        let wave = |k: usize| {
            let place = (k as f64 + random.uniform()) / WAVES as f64;
            (TAU * 0.02 * 25f64.powf(place), TAU * random.uniform())
        };
        Self { amplitude_deg: sigma_deg * (2.0 / WAVES as f64).sqrt(), waves: (0..WAVES).map(wave).collect() }
    }

    fn at(&self, t: f64) -> f64 {
        self.amplitude_deg * self.waves.iter().map(|(w, phase)| (w * t + phase).sin()).sum::<f64>()
    }
}

//! A route over the ground: straight segments, turns with smooth roll-in and roll-out, and swings.
//!
//! Distances are along the surface of the ellipsoid, on which the planned route is integrated.

use std::f64::consts::{PI, TAU};

use super::{
    air::{Dynamics, FlightConditions},
    curve::smooth_step,
    geodesic::{Geodesic, RoutePosition},
};

/// Maximum steps of the integration, along a geodesic and in a turn, in metres.
const STRAIGHT_STEP_M: f64 = 1000.0;
const TURN_PARTS: f64 = 64.0;

/// The curvature of a segment of a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum RouteCurvature {
    /// Along a geodesic.
    Straight,
    /// With a steady curvature, in 1/m; right is positive.
    Steady { curvature_per_m: f64 },
    /// A turn whose curvature rises and falls over `ramp_m`.
    Turn { curvature_per_m: f64, ramp_m: f64 },
    /// A course that deviates from the route and returns to the route.
    Swing { angle_rad: f64, periods: f64 },
}

/// A segment of a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RouteSegment {
    /// Distance from the start of the route.
    pub(super) from_m: f64,
    pub(super) length_m: f64,
    pub(super) bend: RouteCurvature,
}

impl RouteSegment {
    /// Curvature in 1/m at a distance from the start of the segment.
    pub(super) fn curvature_per_m(&self, s: f64) -> f64 {
        match self.bend {
            RouteCurvature::Straight => 0.0,
            RouteCurvature::Steady { curvature_per_m } => curvature_per_m,
            RouteCurvature::Turn { curvature_per_m, ramp_m } => {
                curvature_per_m * smooth_step(s.min(self.length_m - s).max(0.0) / ramp_m)
            }
            RouteCurvature::Swing { angle_rad, periods } => {
                let u = (s / self.length_m).clamp(0.0, 1.0);
                let edge = (2.0 * periods * u.min(1.0 - u)).min(1.0);
                let rise = 30.0 * (edge * (1.0 - edge)).powi(2) * 2.0 * periods * if u < 0.5 { 1.0 } else { -1.0 };
                let (sin, cos) = (TAU * periods * u).sin_cos();
                angle_rad * (rise * sin + smooth_step(edge) * TAU * periods * cos) / self.length_m
            }
        }
    }

    pub(super) fn step_m(&self) -> f64 {
        match self.bend {
            RouteCurvature::Straight => STRAIGHT_STEP_M,
            RouteCurvature::Steady { curvature_per_m } => TAU / (TURN_PARTS * curvature_per_m.abs()),
            RouteCurvature::Turn { .. } => self.length_m / TURN_PARTS,
            RouteCurvature::Swing { periods, .. } => self.length_m / (TURN_PARTS * periods),
        }
    }
}

/// Course of a swing at the fraction u (0 to 1) of its length, relative to the straight course, as a fraction of the
/// swing's amplitude.
fn swing(u: f64, periods: f64) -> f64 {
    smooth_step(2.0 * periods * u.min(1.0 - u)) * (TAU * periods * u).sin()
}

/// Shape of a turn, relative to its beginning.
#[derive(Clone, Copy, Debug)]
pub(super) struct TurnShape {
    pub(super) bend: RouteCurvature,
    pub(super) length_m: f64,
    /// Length of the chord from the beginning to the end of the turn.
    chord_m: f64,
    /// Displacement from the beginning to the end of the turn, ahead and to the right.
    pub(super) ahead_m: f64,
    pub(super) right_m: f64,
}

impl TurnShape {
    /// A turn by an angle (rad; right is positive) with a radius and a ramp. If the angle is too small for both ramps,
    /// the radius is increased.
    pub(super) fn new(angle_rad: f64, radius_m: f64, ramp_m: f64) -> Self {
        let held_m = (angle_rad.abs() * radius_m).max(ramp_m);
        let curvature_per_m = angle_rad / held_m;
        let length_m = held_m + ramp_m;
        // The turn is symmetric about its middle, so its chord is parallel to the course at the middle. The ramp is
        // integrated by Simpson's rule, with its course in closed form. The circle is exact.
        let half = 0.5 * angle_rad;
        const PARTS: usize = 32;
        let cosine = |i: usize| {
            let u = i as f64 / PARTS as f64;
            let weight = if i == 0 || i == PARTS { 1.0 } else { 2.0 + 2.0 * (i % 2) as f64 };
            weight * (curvature_per_m * ramp_m * u.powi(4) * (2.5 + u * (u - 3.0)) - half).cos()
        };
        let ramped_m = (0..=PARTS).map(cosine).sum::<f64>() * ramp_m / (3.0 * PARTS as f64);
        let rolled = 0.5 * curvature_per_m * ramp_m - half;
        let circle_m = if curvature_per_m == 0.0 { 0.0 } else { -rolled.sin() / curvature_per_m };
        let chord_m = 2.0 * (ramped_m + circle_m);
        let bend = RouteCurvature::Turn { curvature_per_m, ramp_m };
        Self { bend, length_m, chord_m, ahead_m: chord_m * half.cos(), right_m: chord_m * half.sin() }
    }

    /// Distance before the corner of two legs at which the turn from the first into the second begins; negative if the
    /// turn begins after the corner.
    pub(super) fn tangent_m(&self, angle_rad: f64) -> f64 {
        0.5 * self.chord_m / (0.5 * angle_rad).cos()
    }
}

/// Reason why a route cannot be flown, and the key of the spec that causes it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RouteError {
    pub(super) key: &'static str,
    pub(super) what: String,
}

impl RouteError {
    pub(super) fn new(key: &'static str, what: String) -> Self {
        Self { key, what }
    }
}

/// A route under construction.
#[derive(Clone, Debug)]
pub(super) struct Route {
    pub(super) start: RoutePosition,
    /// Current end of the route.
    pub(super) end: RoutePosition,
    pub(super) pieces: Vec<RouteSegment>,
    pub(super) length_m: f64,
    /// Largest absolute latitude at the middles and ends of the segments, in radians.
    pub(super) highest_lat_rad: f64,
    /// Radius and ramp of the turns.
    pub(super) radius_m: f64,
    pub(super) ramp_m: f64,
}

impl Route {
    /// A route from a position, with turns of a radius, or as tight as the aircraft allows at the speed over
    /// ground `fastest_mps`.
    ///
    /// # Errors
    /// Fails for a radius that needs too steep a bank.
    pub(super) fn new(
        start: RoutePosition,
        air: &FlightConditions,
        fastest_mps: f64,
        radius_m: Option<f64>,
    ) -> Result<Self, RouteError> {
        let dynamics = &air.dynamics;
        let radius = radius_m.unwrap_or(dynamics.tightest_m(fastest_mps));
        let bank_deg = Dynamics::bank_rad(radius, fastest_mps).to_degrees();
        if bank_deg > dynamics.bank_deg + 1e-9 {
            let (most, least) = (dynamics.bank_deg, dynamics.tightest_m(fastest_mps).ceil());
            let what = format!(
                "a turn with a radius of {radius} m at a ground speed of {fastest_mps:.1} m/s needs a bank of \
                 {bank_deg:.0} degrees, but `bank_deg` of `dynamics` is {most}: raise `radius_m` to at least {least} \
                 m"
            );
            return Err(RouteError::new("radius_m", what));
        }
        let ramp_m = dynamics.ramp_m(radius, fastest_mps);
        let highest_lat_rad = start.lat_rad.abs();
        Ok(Self { start, end: start, pieces: vec![], length_m: 0.0, highest_lat_rad, radius_m: radius, ramp_m })
    }

    fn push(&mut self, length_m: f64, bend: RouteCurvature) {
        let piece = RouteSegment { from_m: self.length_m, length_m, bend };
        let middle = self.end.along(0.5 * length_m, piece.step_m(), |s| piece.curvature_per_m(s));
        self.end = middle.along(0.5 * length_m, piece.step_m(), |s| piece.curvature_per_m(0.5 * length_m + s));
        self.length_m += length_m;
        for place in [middle, self.end] {
            // NaN, which occurs at a pole, is stored as infinity.
            let lat_rad = if place.lat_rad.is_finite() { place.lat_rad.abs() } else { f64::INFINITY };
            self.highest_lat_rad = self.highest_lat_rad.max(lat_rad);
        }
        self.pieces.push(piece);
    }

    pub(super) fn straight(&mut self, length_m: f64) {
        if length_m > 0.0 {
            self.push(length_m, RouteCurvature::Straight);
        }
    }

    /// Arc of a circle, with constant bank from the beginning of the arc.
    pub(super) fn arc(&mut self, angle_rad: f64) {
        let curvature_per_m = angle_rad.signum() / self.radius_m;
        self.push(angle_rad.abs() * self.radius_m, RouteCurvature::Steady { curvature_per_m });
    }

    /// The shape of a turn by an angle.
    pub(super) fn shape(&self, angle_rad: f64) -> TurnShape {
        TurnShape::new(angle_rad, self.radius_m, self.ramp_m)
    }

    pub(super) fn turn(&mut self, angle_rad: f64) {
        let shape = self.shape(angle_rad);
        self.push(shape.length_m, shape.bend);
    }

    /// A straight segment along which the course swings by an angle, in whole periods of about `period_m`; straight if
    /// a period does not fit.
    pub(super) fn swing(&mut self, ahead_m: f64, angle_rad: f64, period_m: f64) {
        let periods = (ahead_m / period_m).round();
        if angle_rad == 0.0 || periods < 1.0 {
            return self.straight(ahead_m);
        }
        // The progress is the length of the path times the mean cosine of the swing.
        let parts = (64.0 * periods) as usize;
        let cosines = (0..parts).map(|i| (angle_rad * swing((i as f64 + 0.5) / parts as f64, periods)).cos());
        let mean = cosines.sum::<f64>() / parts as f64;
        self.push(ahead_m / mean, RouteCurvature::Swing { angle_rad, periods });
    }

    /// The shortest path to a position and course by a turn, a straight and a turn.
    ///
    /// # Errors
    /// Fails for a position that no such path reaches; no case is known.
    pub(super) fn join(&mut self, to: &RoutePosition) -> Result<(), RouteError> {
        let lost = || RouteError::new("spacing_m", "no turn connects a line to the next".to_owned());
        let way = Geodesic::between(self.end.degrees(), to.degrees()).ok_or_else(lost)?;
        let bearing = way.leaves_rad - self.end.course_rad;
        let target = (way.length_m * bearing.cos(), way.length_m * bearing.sin());
        // Course on arrival at this position, relative to the current course.
        let finally = to.course_rad - (way.arrives_rad - way.leaves_rad) - self.end.course_rad;
        let (first, straight_m, second) = shortest(self, target, finally).ok_or_else(lost)?;
        self.turn_if(first);
        self.straight(straight_m);
        self.turn_if(second);
        Ok(())
    }

    fn turn_if(&mut self, angle_rad: f64) {
        if angle_rad.abs() > 1e-9 {
            self.turn(angle_rad);
        }
    }
}

/// Path of a turn, a straight and a turn to a position (ahead, to the right) and a course, relative to the start.
/// Returns the first turn, the straight and the second turn.
fn shortest(route: &Route, target: (f64, f64), finally_rad: f64) -> Option<(f64, f64, f64)> {
    const DIRECTIONS: usize = 72;
    let mut best: Option<(f64, (f64, f64, f64))> = None;
    for (first_sign, second_sign) in [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)] {
        let way = |theta: f64| {
            let turned = |angle: f64, sign: f64| sign * (sign * angle).rem_euclid(TAU);
            let (a, b) = (turned(theta, first_sign), turned(finally_rad - theta, second_sign));
            let shape = |angle: f64| if angle.abs() < 1e-9 { None } else { Some(route.shape(angle)) };
            let (one, two) = (shape(a), shape(b));
            let moved = |t: &Option<TurnShape>| t.as_ref().map_or((0.0, 0.0), |t| (t.ahead_m, t.right_m));
            let ((ahead1, right1), (ahead2, right2)) = (moved(&one), moved(&two));
            let (sin, cos) = theta.sin_cos();
            let (x, y) = (target.0 - ahead1, target.1 - right1);
            let across = -sin * x + cos * y - right2;
            let along = cos * x + sin * y - ahead2;
            let turns_m = one.map_or(0.0, |t| t.length_m) + two.map_or(0.0, |t| t.length_m);
            (across, along, a, b, turns_m)
        };
        let step = TAU / DIRECTIONS as f64;
        // The samples avoid exact multiples, where a zero turn and a full turn coincide.
        let at = |i: usize| -PI + 0.123_456 * step + i as f64 * step;
        for i in 0..DIRECTIONS {
            let (mut low, mut high) = (at(i), at(i + 1));
            let (from, to) = (way(low).0, way(high).0);
            if (from > 0.0) == (to > 0.0) {
                continue;
            }
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if (way(middle).0 > 0.0) == (from > 0.0) { low = middle } else { high = middle }
            }
            let (across, along, a, b, turns_m) = way(0.5 * (low + high));
            // A change of sign at a jump, where a zero turn becomes a full turn, is not a root.
            if across.abs() < 1e-3 && along >= 0.0 && best.is_none_or(|(length, _)| turns_m + along < length) {
                best = Some((turns_m + along, (a, along, b)));
            }
        }
    }
    best.map(|(_, way)| way)
}

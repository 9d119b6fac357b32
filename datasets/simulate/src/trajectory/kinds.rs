//! The kinds of lines: their parameters in the spec, and the resulting routes.

use numerics::angle::wrap_rad;
use std::f64::consts::{PI, TAU};

use super::{
    geodesic::{Geodesic, RoutePosition},
    route::{Route, RouteError},
};

/// The horizontal path of a line.
#[derive(Clone, Debug, PartialEq)]
pub enum HorizontalPath {
    /// `survey`: from waypoint to waypoint, repeated until the end of the duration.
    Survey {
        /// `waypoints`: latitude and longitude, in degrees; two or more.
        waypoints: Vec<(f64, f64)>,
        /// `duration_s`: duration, in seconds; 1 to 100 000.
        duration_s: f64,
        /// `weave_deg` and `weave_period_s`: amplitude (degrees, 0 to 45, default 0) and period (s, default 120) of a
        /// periodic change of the course about each leg.
        weave_deg_s: (f64, f64),
    },
    /// `free`: the waypoints once.
    Free {
        /// `waypoints`: latitude and longitude, in degrees; two or more.
        waypoints: Vec<(f64, f64)>,
    },
    /// `box`: legs along the sides of a square, each with a pitch, a roll and a yaw manoeuvre.
    Box {
        /// `start`: position of the start, latitude and longitude in degrees.
        start: (f64, f64),
        /// `heading_deg`: the first course, default 0; turns are to the right.
        heading_deg: f64,
        /// `amplitude_deg`: amplitudes of roll, pitch and yaw, in degrees, 0 to 40, default [9, 4.5, 5]; an amplitude
        /// of 0 omits the manoeuvre [Gnadt 2022, figure 3-7].
        amplitude_deg: [f64; 3],
        /// `period_s`: period of a manoeuvre, in seconds; 1 to 60, default 6.
        period_s: f64,
        /// `cycles`: periods per manoeuvre; 1 to 100, default 3.
        cycles: u32,
        /// `legs`: number of legs; 1 to 64, default 4.
        legs: u32,
    },
    /// `grid`, with `split = false`: survey lines in alternating directions and the tie lines across them, as one line.
    Grid(SurveyLineGrid),
    /// `grid`: one survey line or tie line of a grid.
    Traverse {
        /// Start of the line.
        start: (f64, f64),
        /// Course at the start, in degrees.
        heading_deg: f64,
        /// Length of the line, in metres.
        length_m: f64,
    },
    /// `circle`: around a centre.
    Circle {
        /// The circle.
        orbit: Orbit,
        /// `turns`: number of turns; 0.01 to 1000, default 1.
        turns: f64,
    },
    /// `looping`: around a centre while climbing, then while descending.
    Looping {
        /// The circle.
        orbit: Orbit,
        /// `turns`: number of turns during the climb and during the descent; 0.1 to 100, default 1.
        turns: f64,
        /// `rounds`: number of climbs, each followed by a descent; 1 to 100, default 1.
        rounds: u32,
        /// `top_m`: maximum height, in metres above the ellipsoid.
        top_m: f64,
    },
    /// `loiter`: a racetrack of two straights and two half circles.
    Loiter {
        /// `start`: start of the first straight, latitude and longitude in degrees.
        start: (f64, f64),
        /// `heading_deg`: course of the first straight, in degrees; default 0.
        heading_deg: f64,
        /// `leg_m`: length of a straight, in metres; 0 or more, default 2000.
        leg_m: f64,
        /// `rounds`: number of rounds; 1 to 1000, default 1.
        rounds: u32,
        /// `direction`: `right` or `left`.
        right: bool,
    },
    /// `figure_eight`: two loops that cross at a right angle, one to the right and one to the left.
    FigureEight {
        /// `center`: position of the crossing, latitude and longitude in degrees.
        center: (f64, f64),
        /// `heading_deg`: course of the first crossing; default 0.
        heading_deg: f64,
        /// `rounds`: number of rounds; 1 to 1000, default 1.
        rounds: u32,
    },
    /// `cloverleaf`: crossings of one centre on four courses, a right angle apart.
    Cloverleaf {
        /// `center`: the centre, latitude and longitude in degrees.
        center: (f64, f64),
        /// `heading_deg`: course of the first crossing; default 0.
        heading_deg: f64,
        /// `crossings`: number of crossings; 1 to 1000, default 4.
        crossings: u32,
        /// `direction` of the loops: `right` or `left`.
        right: bool,
    },
}

/// A circle around a centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// `center`: latitude and longitude in degrees.
    pub center: (f64, f64),
    /// `from_deg`: azimuth of the start seen from the centre, in degrees; default 0.
    pub from_deg: f64,
    /// `direction`: `right` (clockwise) or `left`.
    pub right: bool,
}

/// Survey lines and tie lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurveyLineGrid {
    /// `origin`: start of the first line, latitude and longitude in degrees.
    pub origin: (f64, f64),
    /// `heading_deg`: course of the first line; default 0. Lines alternate in direction.
    pub heading_deg: f64,
    /// `line_m`: length of a line, in metres; 1 to 1 000 000.
    pub line_m: f64,
    /// `spacing_m`: distance between adjacent lines, in metres; 0.1 to 100 000.
    pub spacing_m: f64,
    /// `count`: number of lines; 1 to 10 000.
    pub count: u32,
    /// `tie_spacing_m`: distance between adjacent tie lines, in metres; no tie lines by default. The largest number of
    /// tie lines that fits is centred on the lines.
    pub tie_spacing_m: Option<f64>,
    /// `side` of the first line on which the others lie, `right` or `left`.
    pub right: bool,
}

/// A straight line of a grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurveyGridLine {
    pub(super) tie: bool,
    pub(super) start: RoutePosition,
    pub(super) length_m: f64,
}

impl SurveyLineGrid {
    /// The survey lines in the order flown, then the tie lines.
    pub(super) fn stretches(&self) -> Vec<SurveyGridLine> {
        let base = RoutePosition::new(self.origin, self.heading_deg.to_radians());
        let side = if self.right { 1.0 } else { -1.0 };
        let width_m = self.spacing_m * f64::from(self.count.saturating_sub(1));
        let line = |i: u32| {
            let across = side * self.spacing_m * f64::from(i);
            let back = i % 2 == 1;
            let start = base.offset(if back { self.line_m } else { 0.0 }, across);
            let start = if back { RoutePosition { course_rad: start.course_rad + PI, ..start } } else { start };
            SurveyGridLine { tie: false, start, length_m: self.line_m }
        };
        let mut all: Vec<_> = (0..self.count).map(line).collect();
        if let Some(spacing_m) = self.tie_spacing_m.filter(|_| width_m > 0.0) {
            let ties = (self.line_m / spacing_m).floor() as u32 + 1;
            let first_m = 0.5 * (self.line_m - spacing_m * f64::from(ties - 1));
            for j in 0..ties {
                // Tie lines begin at the side where the survey lines end, and alternate in direction.
                let back = j % 2 == 0;
                let across = if back { side * width_m } else { 0.0 };
                let ahead = first_m + spacing_m * f64::from(j);
                let start = base.offset(ahead, across);
                let turned = if back { -side } else { side } * 0.5 * PI;
                let start = RoutePosition { course_rad: start.course_rad + turned, ..start };
                all.push(SurveyGridLine { tie: true, start, length_m: width_m });
            }
        }
        all
    }
}

/// A route over the ground, and marks at distances along it.
pub(super) struct GroundRoute {
    pub(super) route: Route,
    /// Distance at which each waypoint is passed, or each leg, line or round begins.
    pub(super) marks_m: Vec<f64>,
}

/// Angle of a turn, in radians, above which the turn begins over the waypoint and ends on a course to the next
/// waypoint. Other turns begin before the waypoint and end on the next leg.
const FLY_OVER_RAD: f64 = 2.0;

/// A route along waypoints: once, or repeated until the route is `until_m` long. `swing` is the angle (rad) and the
/// period (m) of a weave.
///
/// # Errors
/// Fails for legs too short for the turns at their ends.
pub(super) fn waypoints(
    mut route: Route,
    places: &[(f64, f64)],
    until_m: Option<f64>,
    (swing_rad, period_m): (f64, f64),
) -> Result<GroundRoute, RouteError> {
    let (mut marks_m, mut k) = (vec![0.0], 1);
    let name = |k: usize| k % places.len() + 1;
    loop {
        let target = places[k % places.len()];
        let leg = geodesic(route.end.degrees(), target)?;
        let last = match until_m {
            None => k + 1 == places.len(),
            Some(until_m) => route.length_m + leg.length_m >= until_m,
        };
        if last {
            route.swing(leg.length_m, swing_rad, period_m);
            marks_m.push(route.length_m);
            return Ok(GroundRoute { route, marks_m });
        }
        let after = places[(k + 1) % places.len()];
        let next = geodesic(target, after)?;
        let angle = wrap_rad(next.leaves_rad - leg.arrives_rad);
        if angle.abs() > FLY_OVER_RAD {
            route.swing(leg.length_m, swing_rad, period_m);
            marks_m.push(route.length_m);
            turn_towards(&mut route, angle, after).map_err(|least_m| short(name(k), next.length_m, least_m))?;
        } else if angle.abs() > 1e-6 {
            let shape = route.shape(angle);
            let tangent_m = shape.tangent_m(angle);
            if tangent_m > leg.length_m || tangent_m > next.length_m {
                let (from, length_m) =
                    if tangent_m > leg.length_m { (name(k - 1), leg.length_m) } else { (name(k), next.length_m) };
                return Err(short(from, length_m, tangent_m));
            }
            route.swing(leg.length_m - tangent_m, swing_rad, period_m);
            route.turn(angle);
            marks_m.push(route.length_m - 0.5 * shape.length_m);
        } else {
            route.swing(leg.length_m, swing_rad, period_m);
            marks_m.push(route.length_m);
        }
        k += 1;
    }
}

fn short(from: usize, length_m: f64, least_m: f64) -> RouteError {
    let what = format!(
        "the leg after waypoint {from} has only {length_m:.0} m left for a turn that requires {least_m:.0} m: move \
         the waypoints apart, fly slower or bank more steeply (`bank_deg` of `dynamics`)"
    );
    RouteError::new("waypoints", what)
}

fn geodesic(from: (f64, f64), to: (f64, f64)) -> Result<Geodesic, RouteError> {
    let found = Geodesic::between(from, to).filter(|way| way.length_m > 0.0);
    found.ok_or_else(|| {
        let what = format!("there is no route from {:.5}, {:.5} to {:.5}, {:.5}", from.0, from.1, to.0, to.1);
        RouteError::new("waypoints", what + ": consecutive waypoints must be neither equal nor antipodal")
    })
}

/// Turns by about `angle`, so that the course afterwards points to the position `to`. Returns the required distance if
/// there is no room for the turn.
fn turn_towards(route: &mut Route, mut angle: f64, to: (f64, f64)) -> Result<(), f64> {
    let least_m = 2.5 * (2.0 * route.radius_m + route.ramp_m);
    for _ in 0..50 {
        let mut tried = route.clone();
        tried.turn(angle);
        let way = Geodesic::between(tried.end.degrees(), to).ok_or(least_m)?;
        let error = wrap_rad(way.leaves_rad - tried.end.course_rad);
        if error.abs() < 1e-10 {
            *route = tried;
            return Ok(());
        }
        angle += error;
        if angle.abs() > TAU {
            break;
        }
    }
    Err(least_m)
}

/// The survey lines and tie lines of a grid with the turns between them; the marks are at the starts of the lines.
///
/// # Errors
/// Fails for lines that no turns can join.
pub(super) fn grid(mut route: Route, stretches: &[SurveyGridLine]) -> Result<GroundRoute, RouteError> {
    let mut marks_m = vec![];
    for (i, stretch) in stretches.iter().enumerate() {
        if i > 0 {
            route.join(&stretch.start)?;
        }
        marks_m.push(route.length_m);
        route.straight(stretch.length_m);
    }
    Ok(GroundRoute { route, marks_m })
}

/// Sides of a polygon with a right angle after each side.
pub(super) fn square(mut route: Route, side_m: f64, legs: u32) -> GroundRoute {
    let mut marks_m = vec![];
    for leg in 0..legs {
        if leg > 0 {
            route.turn(0.5 * PI);
        }
        marks_m.push(route.length_m);
        route.straight(side_m);
    }
    GroundRoute { route, marks_m }
}

/// Circles.
pub(super) fn circles(mut route: Route, turns: f64, right: bool) -> GroundRoute {
    route.arc(if right { TAU } else { -TAU } * turns);
    GroundRoute { marks_m: vec![0.0], route }
}

/// Racetracks.
pub(super) fn racetrack(mut route: Route, leg_m: f64, rounds: u32, right: bool) -> GroundRoute {
    let (half, mut marks_m) = (if right { PI } else { -PI }, vec![]);
    for _ in 0..rounds {
        marks_m.push(route.length_m);
        for _ in 0..2 {
            route.straight(leg_m);
            route.turn(half);
        }
    }
    GroundRoute { route, marks_m }
}

/// Crossings of one centre a right angle apart, joined by loops; `right` gives the direction of each loop. The marks
/// are the crossings. The route begins at the distance [`lead_m`] before the first crossing, and ends at the end of the
/// last loop or, with `again`, after another crossing of the centre.
pub(super) fn crossings(mut route: Route, loops: &[bool], again: bool) -> GroundRoute {
    let lead_m = lead_m(&route);
    let mut marks_m = vec![lead_m];
    for right in loops {
        route.straight(2.0 * lead_m);
        route.turn(if *right { 1.5 * PI } else { -1.5 * PI });
        marks_m.push(route.length_m + lead_m);
    }
    if again {
        route.straight(2.0 * lead_m);
    }
    GroundRoute { route, marks_m }
}

/// Distance from the crossing to the start of a loop, in metres.
pub(super) fn lead_m(route: &Route) -> f64 {
    let angle = 1.5 * PI;
    -route.shape(angle).tangent_m(angle)
}

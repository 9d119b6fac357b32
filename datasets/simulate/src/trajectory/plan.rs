//! The plan of a line: its route over the ground, its heights, and its timing.

use std::f64::consts::{PI, TAU};

use numerics::earth::geodesy::transverse_radius_m;

use super::{
    air::FlightConditions,
    curve::smooth_step,
    geodesic::RoutePosition,
    kinds::{self, GroundRoute, HorizontalPath, SurveyGridLine},
    profile::{ExcessiveClimb, RouteHeightProfile},
    route::{Route, RouteError, RouteSegment},
};

/// Duration of straight flight between the manoeuvres of a box, in seconds.
const SETTLE_S: f64 = 5.0;
/// Half of the duration of the transition at the start or end of a climb, in seconds.
const ROUNDING_S: f64 = 5.0;
/// Maximum distance per step of the timing, in metres.
const CLOCK_STEP_M: f64 = 500.0;
/// Maximum absolute latitude of a line, in degrees.
const HIGHEST_DEG: f64 = 89.0;
/// The strongest wind in which a line is planned, as a fraction of the airspeed.
const STRONGEST: f64 = 0.8;

/// The heights of a line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineHeights {
    /// `alts_m`: height at each waypoint, in metres above the ellipsoid; default `alt_m`.
    pub alts_m: Option<Vec<f64>>,
    /// `drape`: whether the heights are a surface to stay above, with climbs that begin early enough. Otherwise the
    /// heights are flown exactly, and a climb that is too steep is a fault. Default `false`.
    pub drape: bool,
}

/// Inputs of a trajectory plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrajectoryRequest<'a> {
    pub(super) path: &'a HorizontalPath,
    pub(super) alt_m: f64,
    pub(super) heights: &'a LineHeights,
    pub(super) airspeed_mps: f64,
    pub(super) radius_m: Option<f64>,
    pub(super) air: &'a FlightConditions,
}

/// Periodic manoeuvre of one attitude angle.
#[derive(Clone, Copy, Debug, PartialEq)]
struct AttitudeManoeuvre {
    axis: usize,
    start_s: f64,
    length_s: f64,
    period_s: f64,
    amplitude_deg: f64,
}

impl AttitudeManoeuvre {
    /// The angle, in degrees, at a time after the start of the manoeuvre. The angle reaches its amplitude within a
    /// quarter of a period, and its rate is continuous.
    fn at(&self, since_s: f64) -> f64 {
        let edge = since_s.min(self.length_s - since_s) / (0.25 * self.period_s);
        self.amplitude_deg * smooth_step(edge) * (TAU * since_s / self.period_s).sin()
    }
}

/// The plan of a line.
#[derive(Clone, Debug, Default)]
pub(super) struct TrajectoryPlan {
    pub(super) start: RoutePosition,
    pieces: Vec<RouteSegment>,
    profile: RouteHeightProfile,
    airspeed_mps: f64,
    pub(super) air: FlightConditions,
    /// The wind, if it is the same at all heights: north and east, in m/s.
    same_wind_mps: Option<(f64, f64)>,
    pub(super) duration_s: f64,
    manoeuvres: Vec<AttitudeManoeuvre>,
    /// Starts of the lines of a grid, in seconds.
    pub(super) marks_s: Vec<f64>,
}

impl TrajectoryPlan {
    /// Plans a line.
    ///
    /// # Errors
    /// Fails for a line beyond the performance of the aircraft.
    pub(super) fn new(request: &TrajectoryRequest) -> Result<TrajectoryPlan, RouteError> {
        let fastest_mps = fastest_mps(request)?;
        let way = way(request, fastest_mps)?;
        if way.route.highest_lat_rad.to_degrees() >= HIGHEST_DEG {
            let what = "the line comes within a degree of a pole, where courses are undefined".to_owned();
            return Err(RouteError::new("kind", what + ": move the waypoints away from the pole"));
        }
        let profile = profile(request, &way, fastest_mps)?;
        let mut plan = TrajectoryPlan {
            start: way.route.start,
            pieces: way.route.pieces,
            profile,
            airspeed_mps: request.airspeed_mps,
            air: *request.air,
            same_wind_mps: request.air.wind.same_mps(),
            ..TrajectoryPlan::default()
        };
        plan.duration_s = match request.path {
            HorizontalPath::Survey { duration_s, .. } => *duration_s,
            _ => plan.clock(&way.marks_m, &mut vec![]),
        };
        let mut marks_s = vec![];
        if matches!(request.path, HorizontalPath::Box { .. } | HorizontalPath::Grid(_)) {
            plan.clock(&way.marks_m, &mut marks_s);
        }
        if let HorizontalPath::Box { amplitude_deg, period_s, cycles, .. } = request.path {
            plan.manoeuvres = manoeuvres(&marks_s, *amplitude_deg, *period_s, *cycles);
        }
        plan.marks_s = marks_s;
        Ok(plan)
    }

    /// The wind at a height: north and east, in m/s.
    pub(super) fn wind_mps(&self, alt_m: f64) -> (f64, f64) {
        self.same_wind_mps.unwrap_or_else(|| self.air.wind.at(alt_m))
    }

    /// Speed over ground at the line's airspeed, in m/s.
    fn ground_mps(&self, course_rad: f64, alt_m: f64, slope: f64) -> f64 {
        let (north, east) = self.wind_mps(alt_m);
        let v2 = self.airspeed_mps * self.airspeed_mps;
        if north == 0.0 && east == 0.0 {
            return self.airspeed_mps / (1.0 + slope * slope).sqrt();
        }
        let (sin, cos) = course_rad.sin_cos();
        let behind = north * cos + east * sin;
        let steep = 1.0 + slope * slope;
        (behind + (behind * behind + steep * (v2 - north * north - east * east)).max(0.0).sqrt()) / steep
    }

    /// Speed along the surface (m/s) at a distance along the route, and the height there (m).
    fn pace(&self, s: f64, place: &RoutePosition) -> (f64, f64) {
        let (alt_m, slope) = self.profile.at(s);
        let radius_m = transverse_radius_m(place.lat_rad);
        (self.ground_mps(place.course_rad, alt_m, slope) * radius_m / (radius_m + alt_m), alt_m)
    }

    /// The duration of the route, in seconds. The times at which the marks are passed are added to `marks_s`.
    fn clock(&self, marks_m: &[f64], marks_s: &mut Vec<f64>) -> f64 {
        let (mut place, mut t) = (self.start, 0.0);
        let mut marks = marks_m.iter().peekable();
        for piece in &self.pieces {
            // Marks are at the beginnings of segments.
            while marks.next_if(|mark| **mark <= piece.from_m + 1e-6).is_some() {
                marks_s.push(t);
            }
            let steps = (piece.length_m / CLOCK_STEP_M.min(piece.step_m())).ceil().max(1.0);
            let h = piece.length_m / steps;
            for step in 0..steps as usize {
                let s = h * step as f64;
                let bend = |from: f64| move |x: f64| piece.curvature_per_m(from + x);
                let middle = place.along(0.5 * h, h, bend(s));
                let end = middle.along(0.5 * h, h, bend(s + 0.5 * h));
                let slow = |x: f64, p: &RoutePosition| 1.0 / self.pace(piece.from_m + x, p).0;
                t += h / 6.0 * (slow(s, &place) + 4.0 * slow(s + 0.5 * h, &middle) + slow(s + h, &end));
                place = end;
            }
        }
        t
    }

    /// Roll, pitch and yaw of manoeuvres, in degrees.
    pub(super) fn manoeuvre_deg(&self, t: f64) -> [f64; 3] {
        let mut out = [0.0; 3];
        let next = self.manoeuvres.partition_point(|m| m.start_s <= t);
        if let Some(m) = next.checked_sub(1).and_then(|i| self.manoeuvres.get(i)).filter(|m| t < m.start_s + m.length_s)
        {
            out[m.axis] = m.at(t - m.start_s);
        }
        out
    }

    /// The route in time.
    pub(super) fn runner(&self) -> RouteFollower<'_> {
        RouteFollower { plan: self, place: self.start, s: 0.0, piece: 0 }
    }

    pub(super) fn airspeed_mps(&self) -> f64 {
        self.airspeed_mps
    }
}

/// State of an aircraft on its route, advanced in time.
#[derive(Clone, Debug)]
pub(super) struct RouteFollower<'a> {
    plan: &'a TrajectoryPlan,
    place: RoutePosition,
    s: f64,
    piece: usize,
}

impl RouteFollower<'_> {
    /// Latitude, longitude (rad) and height (m).
    pub(super) fn position(&self) -> [f64; 3] {
        [self.place.lat_rad, self.place.lon_rad, self.plan.profile.at(self.s).0]
    }

    fn rate(&self, [lat_rad, lon_rad, course_rad, s]: [f64; 4]) -> [f64; 4] {
        let place = RoutePosition { lat_rad, lon_rad, course_rad };
        let (mps, _) = self.plan.pace(s, &place);
        let pieces = self.plan.pieces.get(self.piece..).unwrap_or(&[]);
        let here = pieces.iter().find(|p| s < p.from_m + p.length_m).or(pieces.last());
        let curvature = here.map_or(0.0, |p| p.curvature_per_m(s - p.from_m));
        let [lat, lon, course] = place.rate(curvature);
        [lat * mps, lon * mps, course * mps, mps]
    }

    /// Advances by `h` seconds with the fourth-order Runge-Kutta method.
    pub(super) fn step(&mut self, h: f64) {
        let x = [self.place.lat_rad, self.place.lon_rad, self.place.course_rad, self.s];
        let moved = |k: &[f64; 4], by: f64| std::array::from_fn(|i| x[i] + by * k[i]);
        let k1 = self.rate(x);
        let k2 = self.rate(moved(&k1, 0.5 * h));
        let k3 = self.rate(moved(&k2, 0.5 * h));
        let k4 = self.rate(moved(&k3, h));
        let [lat_rad, lon_rad, course_rad, s] =
            std::array::from_fn(|i| x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
        (self.place, self.s) = (RoutePosition { lat_rad, lon_rad, course_rad }, s);
        let over = |p: &RouteSegment| s >= p.from_m + p.length_m;
        while self.piece + 1 < self.plan.pieces.len() && self.plan.pieces.get(self.piece).is_some_and(over) {
            self.piece += 1;
        }
    }
}

/// Upper bound of the speed over ground on a line, in m/s.
fn fastest_mps(request: &TrajectoryRequest) -> Result<f64, RouteError> {
    let alts = request.heights.alts_m.as_deref().unwrap_or(&[]);
    let top = if let HorizontalPath::Looping { top_m, .. } = request.path { *top_m } else { request.alt_m };
    let winds = alts.iter().copied().chain([request.alt_m, top]).map(|alt_m| {
        let (north, east) = request.air.wind.at(alt_m);
        north.hypot(east)
    });
    let (strongest, v) = (winds.fold(0.0, f64::max), request.airspeed_mps);
    if strongest > STRONGEST * v {
        let what = format!("a wind of {strongest:.1} m/s is too strong for an airspeed of {v} m/s");
        return Err(RouteError::new("speed_mps", what));
    }
    Ok(v + strongest)
}

fn way(request: &TrajectoryRequest, fastest_mps: f64) -> Result<GroundRoute, RouteError> {
    let air = request.air;
    let route = |start: RoutePosition| Route::new(start, air, fastest_mps, request.radius_m);
    let headed = |place: (f64, f64), heading_deg: f64| route(RoutePosition::new(place, heading_deg.to_radians()));
    match request.path {
        HorizontalPath::Survey { waypoints, duration_s, weave_deg_s } => {
            let swing = (weave_deg_s.0.to_radians(), weave_deg_s.1 * request.airspeed_mps);
            kinds::waypoints(towards(waypoints, &route)?, waypoints, Some(fastest_mps * duration_s), swing)
        }
        HorizontalPath::Free { waypoints } => {
            kinds::waypoints(towards(waypoints, &route)?, waypoints, None, (0.0, 1.0))
        }
        HorizontalPath::Box { start, heading_deg, amplitude_deg, period_s, cycles, legs } => {
            let angles = amplitude_deg.iter().filter(|a| **a > 0.0).count() as f64;
            let leg_s = SETTLE_S + angles * (period_s * f64::from(*cycles) + SETTLE_S);
            Ok(kinds::square(headed(*start, *heading_deg)?, leg_s * fastest_mps, *legs))
        }
        HorizontalPath::Grid(grid) => {
            let lines = grid.stretches();
            let start = lines.first().map_or_else(RoutePosition::default, |l| l.start);
            kinds::grid(route(start)?, &lines)
        }
        HorizontalPath::Traverse { start, heading_deg, length_m } => {
            let start = RoutePosition::new(*start, heading_deg.to_radians());
            kinds::grid(route(start)?, &[SurveyGridLine { tie: false, start, length_m: *length_m }])
        }
        HorizontalPath::Circle { orbit, turns } => Ok(kinds::circles(round(orbit, &route)?, *turns, orbit.right)),
        HorizontalPath::Looping { orbit, turns, rounds, .. } => {
            Ok(kinds::circles(round(orbit, &route)?, 2.0 * turns * f64::from(*rounds), orbit.right))
        }
        HorizontalPath::Loiter { start, heading_deg, leg_m, rounds, right } => {
            Ok(kinds::racetrack(headed(*start, *heading_deg)?, *leg_m, *rounds, *right))
        }
        HorizontalPath::FigureEight { center, heading_deg, rounds } => {
            let loops: Vec<bool> = (0..2 * *rounds).map(|i| i % 2 == 0).collect();
            Ok(kinds::crossings(before(*center, *heading_deg, &route)?, &loops, false))
        }
        HorizontalPath::Cloverleaf { center, heading_deg, crossings, right } => {
            let loops = vec![*right; crossings.saturating_sub(1) as usize];
            Ok(kinds::crossings(before(*center, *heading_deg, &route)?, &loops, true))
        }
    }
}

type RouteFactory<'a> = dyn Fn(RoutePosition) -> Result<Route, RouteError> + 'a;

/// A route from the first waypoint to the second.
fn towards(waypoints: &[(f64, f64)], route: &RouteFactory) -> Result<Route, RouteError> {
    let &[from, to, ..] = waypoints else {
        return Err(RouteError::new("waypoints", "a line needs at least two waypoints".to_owned()));
    };
    let leaves = super::geodesic::Geodesic::between(from, to).map_or(0.0, |way| way.leaves_rad);
    route(RoutePosition::new(from, leaves))
}

/// A route that begins on a circle.
fn round(orbit: &kinds::Orbit, route: &RouteFactory) -> Result<Route, RouteError> {
    let centre = RoutePosition::new(orbit.center, orbit.from_deg.to_radians());
    let begun = route(centre)?;
    let edge = centre.along(begun.radius_m, begun.radius_m, |_| 0.0);
    let quarter = if orbit.right { 0.5 * PI } else { -0.5 * PI };
    route(RoutePosition { course_rad: edge.course_rad + quarter, ..edge })
}

/// A route that begins before a centre, at the distance that the loops of a cloverleaf require.
fn before(center: (f64, f64), heading_deg: f64, route: &RouteFactory) -> Result<Route, RouteError> {
    let centre = RoutePosition::new(center, heading_deg.to_radians());
    let lead_m = kinds::lead_m(&route(centre)?);
    route(centre.along(-lead_m, lead_m, |_| 0.0))
}

fn profile(request: &TrajectoryRequest, way: &GroundRoute, fastest_mps: f64) -> Result<RouteHeightProfile, RouteError> {
    let steepest = request.air.dynamics.climb_mps / fastest_mps;
    let rounding_m = ROUNDING_S * request.airspeed_mps;
    let climbs = |knots: Vec<(f64, f64)>, key: &'static str| {
        RouteHeightProfile::climbs(knots, steepest, rounding_m).map_err(|e| too_steep(&e, request, fastest_mps, key))
    };
    match (request.path, &request.heights.alts_m) {
        (HorizontalPath::Looping { top_m, rounds, .. }, _) => {
            let parts = 2 * rounds;
            let at = |i: u32| way.route.length_m * f64::from(i) / f64::from(parts);
            let alt = |i: u32| if i.is_multiple_of(2) { request.alt_m } else { *top_m };
            climbs((0..=parts).map(|i| (at(i), alt(i))).collect(), "top_m")
        }
        (HorizontalPath::Survey { .. } | HorizontalPath::Free { .. }, Some(alts_m)) => {
            let alts = alts_m.iter().copied().cycle();
            let knots: Vec<_> = way.marks_m.iter().copied().zip(alts).collect();
            match request.heights.drape {
                true => Ok(RouteHeightProfile::drape(&knots, steepest, rounding_m)),
                false => climbs(knots, "alts_m"),
            }
        }
        _ => Ok(RouteHeightProfile::level(request.alt_m)),
    }
}

fn too_steep(e: &ExcessiveClimb, request: &TrajectoryRequest, fastest_mps: f64, key: &'static str) -> RouteError {
    let (climb, most) = (e.slope * fastest_mps, request.air.dynamics.climb_mps);
    let way_out = if key == "alts_m" {
        ": move the waypoints apart, raise `climb_mps`, or set `drape = true` to begin climbs early enough"
    } else {
        ": raise `turns` or `climb_mps`"
    };
    let what = format!(
        "the climb after height no. {} is {climb:.1} m/s at a ground speed of {fastest_mps:.1} m/s, but `climb_mps` of \
         `dynamics` is {most}{way_out}",
        e.knot + 1
    );
    RouteError::new(key, what)
}

/// A pitch, a roll and a yaw manoeuvre on each leg, in this order.
fn manoeuvres(legs_s: &[f64], amplitude_deg: [f64; 3], period_s: f64, cycles: u32) -> Vec<AttitudeManoeuvre> {
    const ORDER: [usize; 3] = [1, 0, 2];
    let length_s = period_s * f64::from(cycles);
    let mut out = vec![];
    for leg_s in legs_s {
        let axes = ORDER.into_iter().filter(|axis| amplitude_deg[*axis] > 0.0);
        for (slot, axis) in axes.enumerate() {
            let start_s = leg_s + SETTLE_S + slot as f64 * (length_s + SETTLE_S);
            out.push(AttitudeManoeuvre { axis, start_s, length_s, period_s, amplitude_deg: amplitude_deg[axis] });
        }
    }
    out
}

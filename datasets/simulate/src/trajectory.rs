//! True trajectories. A planned route over the ellipsoid is flown at an airspeed through a wind, with the resulting
//! attitude, gusts and manoeuvres.
//!
//! Position and attitude are smooth curves through nodes 0.05 s apart, at any sample rate: the flight is the same at 10
//! Hz and at 250 Hz. Velocity, specific force and angular rates are the exact derivatives of these curves.
//!
//! The manoeuvres of a box and the motions of `gusts_deg` move the attitude alone: they are too short to move the
//! aircraft. Turbulence moves position and attitude.

use nalgebra::{Matrix3, Vector3};
use numerics::angle::wrap_deg;
use numerics::earth::{
    attitude::body_to_ned,
    geodesy::{ECCENTRICITY_SQUARED, EarthModel, meridian_radius_m, transverse_radius_m},
};
use numerics::navigation::{mechanisation::normal_gravity_mps2, strapdown::specific_force_mps2};

use super::random::RandomStream;
pub use air::{Dynamics, FlightConditions, Turbulence, Wind};
use curve::{MARGIN, QuinticSpline, slopes};
use gusts::{AttitudeSway, GustSimulator};
pub use kinds::{HorizontalPath, Orbit, SurveyLineGrid};
pub use plan::LineHeights;
use plan::TrajectoryPlan;
pub use spec::{SynthFlight, SynthLine};

pub(super) mod air;
mod curve;
mod geodesic;
mod gusts;
mod kinds;
mod plan;
mod profile;
mod route;
pub(super) mod spec;
#[cfg(test)]
mod tests;

/// Seconds between nodes.
const NODE_S: f64 = 0.05;
/// Number of nodes that a curve of the position has at each end in addition to those of the attitude.
const LEAD: usize = 2;

/// A true trajectory, one value per sample in each column.
#[derive(Clone, Debug, Default)]
pub(super) struct TrueTrajectory {
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
    /// The rates of roll, pitch and yaw, in deg/s.
    pub(super) attitude_rates_degps: [Vec<f64>; 3],
    /// Angular rates of the body relative to north-east-down, about the body's axes: nose, right, down, in deg/s.
    pub(super) rates_degps: [Vec<f64>; 3],
}

impl TrueTrajectory {
    /// The matrix that rotates the body frame into north-east-down at a sample.
    pub(super) fn attitude(&self, i: usize) -> Matrix3<f64> {
        let [roll, pitch, yaw] = self.attitude_deg.each_ref().map(|a| a[i].to_radians());
        body_to_ned(roll, pitch, yaw)
    }

    /// The trajectory of a point of the body, `arm_m` (nose, right, down; m) from the reference.
    pub(super) fn at_arm(&self, arm_m: &Vector3<f64>) -> Self {
        let mut moved = self.clone();
        for i in 0..self.tt_s.len() {
            let along = self.attitude(i) * arm_m;
            let (lat_rad, alt_m) = (self.lat_deg[i].to_radians(), self.alt_m[i]);
            let (north, east) = EarthModel::Wgs84.north_east_m_per_rad(lat_rad, alt_m);
            moved.lat_deg[i] += (along.x / north).to_degrees();
            moved.lon_deg[i] += (along.y / east).to_degrees();
            moved.alt_m[i] -= along.z;
        }
        moved
    }

    /// Latitudes, longitudes (deg) and heights (m).
    pub(super) fn places(&self) -> [&[f64]; 3] {
        [&self.lat_deg, &self.lon_deg, &self.alt_m]
    }

    /// The rate of a vector in the body frame at a sample: Cᵀ v' − ω × (Cᵀ v), from the rate v' of its components
    /// north, east and down, and from its components `body` in the body frame.
    pub(super) fn rate_in_body(&self, i: usize, rate_ned: &Vector3<f64>, body: &Vector3<f64>) -> Vector3<f64> {
        let turning = Vector3::from(self.rates_degps.each_ref().map(|rate| rate[i].to_radians()));
        self.attitude(i).transpose() * rate_ned - turning.cross(body)
    }
}

impl SynthLine {
    /// The duration of the line, in seconds.
    pub(super) fn duration_s(&self) -> f64 {
        self.plan.duration_s
    }

    /// Flies the line through air without turbulence. `gusts_deg` are standard deviations in roll, pitch and yaw.
    #[cfg(test)]
    pub(super) fn fly(&self, rate_hz: f64, gusts_deg: [f64; 3], random: &mut RandomStream) -> TrueTrajectory {
        self.fly_through(None, rate_hz, gusts_deg, random)
    }

    /// Flies the line through the turbulence of the spec, or through smooth air if not `on`.
    pub(super) fn fly_on(
        &self,
        on: bool,
        rate_hz: f64,
        gusts_deg: [f64; 3],
        random: &mut RandomStream,
    ) -> TrueTrajectory {
        self.fly_through(self.plan.air.turbulence.filter(|_| on), rate_hz, gusts_deg, random)
    }

    fn fly_through(
        &self,
        turbulence: Option<Turbulence>,
        rate_hz: f64,
        gusts_deg: [f64; 3],
        random: &mut RandomStream,
    ) -> TrueTrajectory {
        let curves = self.curves(turbulence, gusts_deg, random);
        let mut out = TrueTrajectory::default();
        let samples = (self.duration_s() * rate_hz + 1e-6).floor() as usize + 1;
        for i in 0..samples {
            curves.record(i as f64 / rate_hz, self.start_tt_s, &mut out);
        }
        out
    }

    /// Roll, pitch and yaw that a manoeuvre adds.
    #[cfg(test)]
    pub(super) fn manoeuvre_deg(&self, t: f64) -> [f64; 3] {
        self.plan.manoeuvre_deg(t)
    }

    fn curves(
        &self,
        turbulence: Option<Turbulence>,
        gusts_deg: [f64; 3],
        random: &mut RandomStream,
    ) -> TrajectoryCurves {
        let nodes = (self.duration_s() / NODE_S).floor() as usize + 2 * MARGIN + 2;
        let start_s = -(MARGIN as f64) * NODE_S;
        let mut position = TrajectoryCurves::positions(&self.plan, nodes + 2 * LEAD);
        let mut roll_rad = 0.0;
        let steady = (LEAD..nodes + LEAD).map(|k| {
            let now = steady(&position, k, roll_rad, &self.plan);
            roll_rad = now.attitude_rad[0];
            now
        });
        let steady: Vec<_> = steady.collect();
        for curve in &mut position {
            curve.nodes.drain(..LEAD);
            curve.nodes.truncate(nodes);
        }
        let mut angles = [0, 1, 2].map(|axis| steady.iter().map(|s| s.attitude_rad[axis]).collect::<Vec<f64>>());
        unwrap(&mut angles[2]);
        let mut sway = [vec![0.0; nodes], vec![0.0; nodes], vec![0.0; nodes]];
        for (sigma_deg, column) in gusts_deg.into_iter().zip(&mut sway) {
            AttitudeSway::new(sigma_deg, random).add(column, start_s, NODE_S);
        }
        let mut gusts = turbulence.map(|turbulence| {
            let place = (self.alt_m, self.plan.airspeed_mps());
            GustSimulator::new(&turbulence, &self.plan.air.dynamics, place, NODE_S, random)
        });
        for (k, steady) in steady.iter().enumerate() {
            let manoeuvre_deg = self.plan.manoeuvre_deg(start_s + k as f64 * NODE_S);
            for (axis, angles) in angles.iter_mut().enumerate() {
                angles[k] += (manoeuvre_deg[axis] + sway[axis][k]).to_radians();
            }
            if let Some(gusts) = &mut gusts {
                let moved = gusts.next(position[2].nodes[k], random);
                displace(&mut position, k, steady.heading_rad, moved.by_m);
                angles.iter_mut().zip(moved.turned_rad).for_each(|(angles, turned)| angles[k] += turned);
            }
        }
        TrajectoryCurves { position, angles: angles.map(|nodes| QuinticSpline { nodes }) }
    }
}

/// Moves a node of a position ahead, to the right and down.
fn displace(position: &mut [QuinticSpline; 3], k: usize, heading_rad: f64, [ahead, right, down]: [f64; 3]) {
    let (lat, alt) = (position[0].nodes[k], position[2].nodes[k]);
    let (sin, cos) = heading_rad.sin_cos();
    position[0].nodes[k] += (ahead * cos - right * sin) / (meridian_radius_m(lat) + alt);
    position[1].nodes[k] += (ahead * sin + right * cos) / ((transverse_radius_m(lat) + alt) * lat.cos());
    position[2].nodes[k] -= down;
}

/// The smooth curves of a line.
struct TrajectoryCurves {
    /// Latitude and longitude (rad), height (m).
    position: [QuinticSpline; 3],
    /// Roll, pitch and yaw (rad).
    angles: [QuinticSpline; 3],
}

impl TrajectoryCurves {
    fn positions(plan: &TrajectoryPlan, nodes: usize) -> [QuinticSpline; 3] {
        let before = MARGIN + LEAD;
        let mut out: [QuinticSpline; 3] = Default::default();
        let mut back = plan.runner();
        for _ in 0..before {
            back.step(-NODE_S);
            back.position().iter().zip(&mut out).for_each(|(x, curve)| curve.nodes.push(*x));
        }
        out.iter_mut().for_each(|curve| curve.nodes.reverse());
        let mut ahead = plan.runner();
        for k in before..nodes {
            if k > before {
                ahead.step(NODE_S);
            }
            ahead.position().iter().zip(&mut out).for_each(|(x, curve)| curve.nodes.push(*x));
        }
        out
    }

    fn record(&self, t: f64, start_tt_s: f64, out: &mut TrueTrajectory) {
        let place = t / NODE_S;
        let k = place.floor();
        let at = |curve: &QuinticSpline| curve.at(k as usize + MARGIN, place - k, NODE_S);
        let [lat, lon, alt] = self.position.each_ref().map(at);
        let (velocity, acceleration) = motion(lat, lon, alt);
        let force = specific_force_mps2(lat[0], alt[0], velocity, acceleration);
        let [roll, pitch, yaw] = self.angles.each_ref().map(at);
        let ((sin_roll, cos_roll), (sin_pitch, cos_pitch)) = (roll[0].sin_cos(), pitch[0].sin_cos());
        let rates = [
            roll[1] - yaw[1] * sin_pitch,
            pitch[1] * cos_roll + yaw[1] * cos_pitch * sin_roll,
            yaw[1] * cos_pitch * cos_roll - pitch[1] * sin_roll,
        ];
        out.tt_s.push(start_tt_s + t);
        out.lat_deg.push(lat[0].to_degrees());
        out.lon_deg.push(wrap_deg(lon[0].to_degrees()));
        out.alt_m.push(alt[0]);
        for axis in 0..3 {
            out.velocity_mps[axis].push(velocity[axis]);
            out.force_mps2[axis].push(force[axis]);
            out.rates_degps[axis].push(rates[axis].to_degrees());
        }
        for (column, angle) in out.attitude_rates_degps.iter_mut().zip([roll, pitch, yaw]) {
            column.push(angle[1].to_degrees());
        }
        out.attitude_deg[0].push(wrap_deg(roll[0].to_degrees()));
        out.attitude_deg[1].push(pitch[0].to_degrees());
        out.attitude_deg[2].push(wrap_deg(yaw[0].to_degrees()));
    }
}

/// Velocity (m/s) and its derivative (m/s²), north-east-down, from latitude, longitude (rad) and height (m),
/// each with its first and second derivative.
fn motion(lat: [f64; 3], lon: [f64; 3], alt: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let (sin, cos) = lat[0].sin_cos();
    let (meridian, transverse) = (meridian_radius_m(lat[0]), transverse_radius_m(lat[0]));
    // The change of the radii with latitude: M' = 3 M e² sin cos / W², N' = N e² sin cos / W².
    let bulge = ECCENTRICITY_SQUARED * sin * cos / (1.0 - ECCENTRICITY_SQUARED * sin * sin);
    let (north_m, east_m) = (meridian + alt[0], (transverse + alt[0]) * cos);
    let north_rate = 3.0 * meridian * bulge * lat[1] + alt[1];
    let east_rate = (transverse * bulge * lat[1] + alt[1]) * cos - (transverse + alt[0]) * sin * lat[1];
    (
        [north_m * lat[1], east_m * lon[1], -alt[1]],
        [north_m * lat[2] + north_rate * lat[1], east_m * lon[2] + east_rate * lon[1], -alt[2]],
    )
}

/// The attitude of steady flight, and the heading through the air.
#[derive(Clone, Copy, Debug, Default)]
struct SteadyAttitude {
    attitude_rad: [f64; 3],
    heading_rad: f64,
}

/// The attitude at a node: no sideslip, no lateral force, and the angle of attack that follows from the load factor and
/// the airspeed. The search begins at a nearby roll.
fn steady(position: &[QuinticSpline; 3], k: usize, roll_rad: f64, plan: &TrajectoryPlan) -> SteadyAttitude {
    let [lat, lon, alt] = position.each_ref().map(|curve| {
        let (first, second) = slopes(&curve.nodes, k);
        [curve.nodes[k], first / NODE_S, second / (NODE_S * NODE_S)]
    });
    let (velocity, acceleration) = motion(lat, lon, alt);
    let force = Vector3::from(specific_force_mps2(lat[0], alt[0], velocity, acceleration));
    let (north, east) = plan.wind_mps(alt[0]);
    let through_air = Vector3::new(velocity[0] - north, velocity[1] - east, velocity[2]);
    let load = force.norm() / normal_gravity_mps2(lat[0], alt[0]);
    coordinated(&through_air, &force, load, roll_rad, plan)
}

fn coordinated(
    through_air: &Vector3<f64>,
    force: &Vector3<f64>,
    load: f64,
    roll_rad: f64,
    plan: &TrajectoryPlan,
) -> SteadyAttitude {
    let speed = through_air.norm();
    let trim = &plan.air.dynamics;
    let slow = trim.cruise_mps.unwrap_or(plan.airspeed_mps()) / speed;
    let attack = trim.trim_deg.to_radians() * load * slow * slow;
    let (sin_attack, cos_attack) = attack.sin_cos();
    let heading_rad = through_air.y.atan2(through_air.x);
    let sin_climb = -through_air.z / speed;
    let (sin, cos) = heading_rad.sin_cos();
    let (mut roll, mut pitch, mut slip) = (roll_rad, 0.0, 0.0);
    // Each iteration multiplies the error by about the angle of attack in radians.
    for _ in 0..8 {
        let before: f64 = roll;
        let (sin_roll, cos_roll) = roll.sin_cos();
        // Before pitching, the direction of the velocity has this vertical component. The velocity lies in the body's
        // plane of symmetry.
        let lifted = sin_attack * cos_roll;
        pitch = (sin_climb / cos_attack.hypot(lifted)).asin() + lifted.atan2(cos_attack);
        let (sin_pitch, cos_pitch) = pitch.sin_cos();
        slip = (sin_attack * sin_roll).atan2(cos_attack * cos_pitch + lifted * sin_pitch);
        let (sin_slip, cos_slip) = slip.sin_cos();
        let (ahead, right) = (force.x * cos + force.y * sin, force.y * cos - force.x * sin);
        let (ahead, right) = (ahead * cos_slip + right * sin_slip, right * cos_slip - ahead * sin_slip);
        roll = right.atan2(-(ahead * sin_pitch + force.z * cos_pitch));
        if (roll - before).abs() < 1e-9 {
            break;
        }
    }
    SteadyAttitude { attitude_rad: [roll, pitch, heading_rad + slip], heading_rad }
}

/// Unwraps an angle, in radians.
fn unwrap(angles: &mut [f64]) {
    let mut before = angles.first().copied().unwrap_or(0.0);
    for angle in angles {
        *angle -= std::f64::consts::TAU * ((*angle - before) / std::f64::consts::TAU).round();
        before = *angle;
    }
}

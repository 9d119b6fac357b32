//! The unrecorded flight between two lines, during which the errors of the INS continue.

use numerics::angle::wrap_deg;
use numerics::earth::geodesy::EarthModel;
use numerics::navigation::strapdown::specific_force_mps2;

use super::super::trajectory::TrueTrajectory;

/// Time and position of the aircraft at one end of a pause between lines.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PauseEndpoint {
    pub(super) tt_s: f64,
    pub(super) lat_deg: f64,
    pub(super) lon_deg: f64,
    pub(super) alt_m: f64,
}

impl PauseEndpoint {
    pub(super) fn first(truth: &TrueTrajectory) -> Option<PauseEndpoint> {
        PauseEndpoint::at(truth, 0)
    }

    pub(super) fn last(truth: &TrueTrajectory) -> Option<PauseEndpoint> {
        PauseEndpoint::at(truth, truth.tt_s.len().checked_sub(1)?)
    }

    fn at(truth: &TrueTrajectory, row: usize) -> Option<PauseEndpoint> {
        Some(PauseEndpoint {
            tt_s: *truth.tt_s.get(row)?,
            lat_deg: *truth.lat_deg.get(row)?,
            lon_deg: *truth.lon_deg.get(row)?,
            alt_m: *truth.alt_m.get(row)?,
        })
    }
}

/// Maximum speed between lines, in m/s. If the lines are too far apart for the pause, the speed is limited to this
/// value, because a higher speed would change the errors unrealistically.
const FASTEST_MPS: f64 = 300.0;

/// Straight and level flight in steps of a second or slightly less, with the nose along the course. Without time
/// between the lines there are no steps.
pub(super) fn between(from: &PauseEndpoint, to: &PauseEndpoint) -> Option<TrueTrajectory> {
    let pause_s = to.tt_s - from.tt_s;
    if pause_s <= 0.0 {
        return None;
    }
    let (north_m, east_m) =
        EarthModel::Wgs84.offset_ne_m((from.lat_deg, from.lon_deg), (to.lat_deg, to.lon_deg), from.alt_m);
    let down_m = from.alt_m - to.alt_m;
    let speed_mps = (north_m.powi(2) + east_m.powi(2) + down_m.powi(2)).sqrt() / pause_s;
    let slowed = (FASTEST_MPS / speed_mps.max(FASTEST_MPS)) / pause_s;
    let velocity = [north_m * slowed, east_m * slowed, down_m * slowed];
    let steps = pause_s.ceil();
    let mut pause = TrueTrajectory::default();
    for k in 0..=steps as usize {
        let share = k as f64 / steps;
        let lat_deg = from.lat_deg + share * (to.lat_deg - from.lat_deg);
        let alt_m = from.alt_m + share * (to.alt_m - from.alt_m);
        let force = specific_force_mps2(lat_deg.to_radians(), alt_m, velocity, [0.0; 3]);
        pause.tt_s.push(from.tt_s + share * pause_s);
        pause.lat_deg.push(lat_deg);
        pause.lon_deg.push(wrap_deg(from.lon_deg + share * wrap_deg(to.lon_deg - from.lon_deg)));
        pause.alt_m.push(alt_m);
        let attitude_deg = [0.0, 0.0, east_m.atan2(north_m).to_degrees()];
        for axis in 0..3 {
            pause.velocity_mps[axis].push(velocity[axis]);
            pause.force_mps2[axis].push(force[axis]);
            pause.attitude_deg[axis].push(attitude_deg[axis]);
        }
    }
    Some(pause)
}

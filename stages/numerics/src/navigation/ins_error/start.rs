//! INS error at the first sample of a line: from the alignment before it, or from a position and velocity fix.

use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::pinson::{ALT, InsPoint, LAT, LON, STATES, StateMatrix, StateVector, VN, pinson_matrix};
use crate::navigation::strapdown::specific_force_mps2;
use crate::navigation::transition::{propagate_state, step_covariance, transition_matrix};

/// Longest step of the propagation from the alignment, in seconds.
const STEP_S: f64 = 5.0;

/// Covariance of the states at the first sample of `ins`, whose alignment was `age_s` seconds earlier.
///
/// The initial standard deviations of `errors` apply at the alignment. Between the alignment and the first sample the
/// flight is assumed to be straight and level, with the velocity and heading of the first sample. `ins` has at least
/// one sample.
pub fn aligned_covariance(errors: &InsErrorModel, ins: &InsSeries<'_>, age_s: f64) -> StateMatrix {
    let errors = InsErrorModel { start: None, ..*errors };
    let first = ins.point(0);
    let mut p = errors.initial_covariance(first.lat_rad, ins.alt_m[0]);
    if age_s <= 0.0 {
        return p;
    }
    let level = InsPoint {
        force_ned_mps2: specific_force_mps2(first.lat_rad, ins.alt_m[0], first.vel_ned_mps, [0.0; 3]),
        euler_rad: [0.0, 0.0, first.euler_rad[2]],
        ..first
    };
    let steps = (age_s / STEP_S).ceil();
    let dt_s = age_s / steps;
    let f = pinson_matrix(&level, &errors.time_constants(), errors.pinson);
    let (phi, density) = (transition_matrix(&f, dt_s), errors.noise_density());
    for _ in 0..steps as usize {
        p = step_covariance(&p, &f, &phi, &density, dt_s, errors.noise);
    }
    p
}

/// A position and velocity fix at the first sample of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartFix {
    /// Latitude and longitude, in degrees.
    pub lat_lon_deg: [f64; 2],
    /// Height above the ellipsoid, in metres.
    pub alt_m: f64,
    /// Velocity north, east and down, in m/s; `None` keeps the velocity of the INS.
    pub vel_ned_mps: Option<[f64; 3]>,
    /// Standard deviations of the fix.
    pub sigmas: StartFixSigmas,
}

/// Standard deviations of a fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartFixSigmas {
    /// Standard deviation of the position in each of north and east, in metres.
    pub horizontal_m: f64,
    /// Standard deviation of the height, in metres.
    pub vertical_m: f64,
    /// Standard deviation of each component of the velocity, in m/s.
    pub velocity_mps: f64,
}

impl StartFix {
    /// Covariance of the states of an INS corrected by the fix.
    ///
    /// `aligned` is the covariance before the fix, from the alignment of the INS. Without it, tilts, biases and the
    /// barometer loop have the initial standard deviations of `errors`. If the fix has no velocity, the velocity also
    /// has its initial standard deviation. The correlations of the replaced states with the others are dropped: they
    /// depend on the manoeuvres since the alignment, which are unknown.
    pub fn covariance(&self, errors: &InsErrorModel, aligned: Option<&StateMatrix>) -> StateMatrix {
        let mut model = InsErrorModel { start: None, ..*errors };
        model.sources.init_position_sigma_m = self.sigmas.horizontal_m;
        model.sources.init_altitude_sigma_m = self.sigmas.vertical_m;
        if self.vel_ned_mps.is_some() {
            model.sources.init_velocity_sigma_mps = self.sigmas.velocity_mps;
        }
        let mut p = model.initial_covariance(self.lat_lon_deg[0].to_radians(), self.alt_m);
        if let Some(aligned) = aligned {
            let replaced = if self.vel_ned_mps.is_some() { LAT..VN + 3 } else { LAT..ALT + 1 };
            for (row, of_alignment) in aligned.iter().enumerate().filter(|(row, _)| !replaced.contains(row)) {
                for (column, value) in of_alignment.iter().enumerate().filter(|(column, _)| !replaced.contains(column))
                {
                    p[row][column] = *value;
                }
            }
        }
        p
    }

    /// Error of an INS at its first sample, truth minus INS: latitude and longitude (rad), height (m), velocity (m/s).
    pub fn error(&self, ins: &InsSeries<'_>) -> [f64; 6] {
        let [lat_deg, lon_deg] = self.lat_lon_deg;
        let own = [ins.vn_mps[0], ins.ve_mps[0], ins.vd_mps[0]];
        let velocity = self.vel_ned_mps.map_or([0.0; 3], |fix| [0, 1, 2].map(|axis| fix[axis] - own[axis]));
        [
            (lat_deg - ins.lat_deg[0]).to_radians(),
            (lon_deg - ins.lon_deg[0]).to_radians(),
            self.alt_m - ins.alt_m[0],
            velocity[0],
            velocity[1],
            velocity[2],
        ]
    }
}

/// Corrections along a line for an error at the sample `at`, as returned by [`StartFix::error`]: latitude and longitude
/// in degrees, height in m, velocity north, east and down in m/s, one column each. The error propagates by the INS
/// error model, backwards to the samples before `at`.
pub fn correction_along(errors: &InsErrorModel, ins: &InsSeries<'_>, at: usize, error: [f64; 6]) -> [Vec<f64>; 6] {
    let mut x = [0.0; STATES];
    for (state, value) in [LAT, LON, ALT, VN, VN + 1, VN + 2].into_iter().zip(error) {
        x[state] = value;
    }
    let step = |from: usize, to: usize, x: StateVector| {
        let f = pinson_matrix(&ins.point(from), &errors.time_constants(), errors.pinson);
        propagate_state(&transition_matrix(&f, ins.tt_s[to] - ins.tt_s[from]), &x)
    };
    x = (0..at).rev().fold(x, |x, row| step(row + 1, row, x));
    let mut columns: [Vec<f64>; 6] = Default::default();
    for row in 0..ins.len() {
        if row > 0 {
            x = step(row - 1, row, x);
        }
        let now = [x[LAT].to_degrees(), x[LON].to_degrees(), x[ALT], x[VN], x[VN + 1], x[VN + 2]];
        columns.iter_mut().zip(now).for_each(|(column, value)| column.push(value));
    }
    columns
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::navigation::ins_error::{InsErrors, InsGrade, simulate_ins_error};
    use crate::navigation::pinson::TILT_N;
    use crate::random::NormalGenerator;

    /// Straight level flight, one sample per second.
    fn flight(rows: usize) -> [Vec<f64>; 13] {
        let each = |of: &dyn Fn(f64) -> f64| (0..rows).map(|k| of(k as f64)).collect::<Vec<f64>>();
        let force = specific_force_mps2(0.7, 500.0, [60.0, 20.0, 0.0], [0.0; 3]);
        let still = |value: f64| vec![value; rows];
        let yaw_deg = 20.0_f64.atan2(60.0).to_degrees();
        [
            each(&|t| t),
            each(&|t| 0.7_f64.to_degrees() + 60.0 * t / 111_000.0),
            each(&|t| 20.0 * t / 85_000.0),
            still(500.0),
            still(60.0),
            still(20.0),
            still(0.0),
            still(force[0]),
            still(force[1]),
            still(force[2]),
            still(0.0),
            still(0.0),
            still(yaw_deg),
        ]
    }

    fn series(columns: &[Vec<f64>; 13]) -> InsSeries<'_> {
        InsSeries::from_columns(columns.each_ref().map(Vec::as_slice))
    }

    #[test]
    fn law_errors_since_the_alignment_have_the_predicted_covariance() {
        let columns = flight(433);
        let model = InsGrade::Navigation.model();
        let mut normals = NormalGenerator::new(5);
        let runs = 400;
        let mut sums = [0.0; STATES];
        for _ in 0..runs {
            let errors = simulate_ins_error(&series(&columns), &model, || normals.draw()).unwrap();
            sums.iter_mut().zip(errors[432]).for_each(|(sum, error)| *sum += error * error);
        }
        // The line begins 432 s after the alignment.
        let rest = columns.each_ref().map(|column| &column[432..]);
        let p = aligned_covariance(&model, &InsSeries::from_columns(rest), 432.0);
        for state in [LAT, LON, VN, VN + 1, TILT_N, TILT_N + 1] {
            // 400 draws determine a variance to 7 % (one standard deviation).
            let ratio = sums[state] / f64::from(runs) / p[state][state];
            assert!((0.75..1.3).contains(&ratio), "{state}: {ratio}");
        }
        // At the alignment itself no time has passed.
        let at = aligned_covariance(&model, &series(&columns), 0.0);
        assert_eq!(at, model.initial_covariance(columns[1][0].to_radians(), 500.0));
    }

    #[test]
    fn law_an_error_of_the_first_sample_is_corrected_along_the_line() {
        let columns = flight(900);
        let sources = InsErrors {
            init_position_sigma_m: 300.0,
            init_velocity_sigma_mps: 0.5,
            init_attitude_sigma_deg: 0.0,
            acc_sigma_mps2: 0.0,
            gyro_sigma_radps: 0.0,
            vrw_sigma: 0.0,
            arw_sigma: 0.0,
            baro_sigma_m: 0.0,
            a_hat_sigma_mps2: 0.0,
            ..InsErrors::default()
        };
        let model = InsErrorModel::from_sources(sources);
        let mut normals = NormalGenerator::new(9);
        let errors = simulate_ins_error(&series(&columns), &model, || normals.draw()).unwrap();
        let mut ins = columns.clone();
        for (row, error) in errors.iter().enumerate() {
            ins[1][row] -= error[LAT].to_degrees();
            ins[2][row] -= error[LON].to_degrees();
            for axis in 0..3 {
                ins[4 + axis][row] -= error[VN + axis];
            }
        }
        let fix = StartFix {
            lat_lon_deg: [columns[1][0], columns[2][0]],
            alt_m: 500.0,
            vel_ned_mps: Some([60.0, 20.0, 0.0]),
            sigmas: StartFixSigmas { horizontal_m: 3.0, vertical_m: 5.0, velocity_mps: 0.1 },
        };
        let at_first = correction_along(&model, &series(&ins), 0, fix.error(&series(&ins)));
        // The same from a fix 2 s after the first sample.
        let rest = InsSeries::from_columns(ins.each_ref().map(|column| &column[2..]));
        let vel_ned_mps = Some([4, 5, 6].map(|column: usize| columns[column][2]));
        let later = StartFix { lat_lon_deg: [columns[1][2], columns[2][2]], vel_ned_mps, ..fix };
        let at_third = correction_along(&model, &series(&ins), 2, later.error(&rest));
        // For errors of up to 1 km the linear model is accurate to some decimetres; the step back to the first sample
        // adds some decimetres.
        let both = [(&at_first, 0.5), (&at_third, 1.0)];
        for (corrections, within_m, row) in both.into_iter().flat_map(|(of, m)| [0, 450, 899].map(|row| (of, m, row))) {
            let off_m = |column: usize, of: usize| {
                (ins[column][row] + corrections[of][row] - columns[column][row]).abs() * 111_000.0
            };
            assert!(off_m(1, 0) < within_m && off_m(2, 1) < within_m, "{row}: {} {}", off_m(1, 0), off_m(2, 1));
        }
        let p = fix.covariance(&model, None);
        assert!((p[VN][VN].sqrt() - 0.1).abs() < 1e-12 && (p[LAT][LAT].sqrt() * 6.37e6 - 3.0).abs() < 0.1);
    }

    #[test]
    fn unit_a_fix_keeps_the_tilt_since_the_alignment() {
        let columns = flight(2);
        let model = InsGrade::Tactical.model();
        let aligned = aligned_covariance(&model, &series(&columns), 600.0);
        let mut fix = StartFix {
            lat_lon_deg: [columns[1][0], columns[2][0]],
            alt_m: 500.0,
            vel_ned_mps: Some([60.0, 20.0, 0.0]),
            sigmas: StartFixSigmas { horizontal_m: 3.0, vertical_m: 5.0, velocity_mps: 0.1 },
        };
        let p = fix.covariance(&model, Some(&aligned));
        assert_eq!(p[TILT_N][TILT_N], aligned[TILT_N][TILT_N]);
        assert!(p[TILT_N][TILT_N] > 100.0 * fix.covariance(&model, None)[TILT_N][TILT_N]);
        assert!((p[VN][VN].sqrt() - 0.1).abs() < 1e-12 && p[VN][TILT_N] == 0.0 && aligned[VN][TILT_N + 1] != 0.0);
        fix.vel_ned_mps = None;
        let p = fix.covariance(&model, Some(&aligned));
        assert_eq!((p[VN][VN], p[VN][TILT_N + 1]), (aligned[VN][VN], aligned[VN][TILT_N + 1]));
        assert!(p[LAT][LAT] < aligned[LAT][LAT] && p[LAT][VN] == 0.0);
    }
}

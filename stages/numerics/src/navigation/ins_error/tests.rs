#![allow(clippy::unwrap_used)]
use super::*;
use crate::navigation::pinson::MAGNAV_POSITION;
use crate::navigation::pinson::tests::golden;
use crate::navigation::transition::step_covariance;
use crate::random::NormalGenerator;

/// MagNav.jl's values of the parameters whose defaults are rounded in magline.
fn magnav() -> InsErrorModel {
    InsErrorModel {
        sources: InsErrors { vrw_sigma: 2.38e-4, arw_sigma: 5.81e-7, ..InsErrors::default() },
        ..InsErrorModel::compatible()
    }
}

#[test]
fn val_magnav_initial_covariance_and_process_noise() {
    let p0 = magnav().initial_covariance(45.0_f64.to_radians(), 1234.0);
    let (golden_p0, golden_q) = (golden("create_P0_diag")[0], golden("create_Qd_diag")[0]);
    let qd = magnav().noise_density().map(|density| density * 0.1);
    for (state, theirs) in MAGNAV_POSITION.into_iter().enumerate() {
        assert!((p0[state][state] / golden_p0[theirs] - 1.0).abs() < 1e-13, "{state}");
        assert!((qd[state] / golden_q[theirs] - 1.0).abs() < 1e-14, "{state}");
    }
}

#[test]
fn unit_invalid_parameters_are_rejected() {
    let model =
        InsErrorModel { sources: InsErrors { acc_tau_s: 0.0, ..InsErrors::default() }, ..InsErrorModel::default() };
    assert_eq!(model.check().unwrap_err().to_string(), "`acc_tau_s` must be above 0, not 0");
    assert!(
        InsErrorModel { sources: InsErrors { vrw_sigma: -1.0, ..InsErrors::default() }, ..InsErrorModel::default() }
            .check()
            .is_err()
    );
    assert!(InsErrorModel { fogm_sigma_nt: f64::NAN, ..InsErrorModel::default() }.check().is_err());
    assert!(InsErrorModel::default().check().is_ok());
}

/// 200 s of a turning flight, one sample every 2 s.
struct Flight {
    columns: [Vec<f64>; 13],
}

impl Flight {
    fn new() -> Self {
        let tt: Vec<f64> = (0..100).map(|k| 2.0 * f64::from(k)).collect();
        let of = |f: &dyn Fn(f64) -> f64| tt.iter().map(|t| f(*t)).collect::<Vec<f64>>();
        let columns = [
            of(&|t| t),
            of(&|t| -22.0 + 1e-5 * t),
            of(&|t| 140.0 + 2e-5 * t),
            of(&|_| 500.0),
            of(&|t| 60.0 * (0.02 * t).cos()),
            of(&|t| 60.0 * (0.02 * t).sin()),
            of(&|_| 0.0),
            of(&|t| -1.2 * (0.02 * t).sin()),
            of(&|t| 1.2 * (0.02 * t).cos()),
            of(&|_| -9.8),
            of(&|_| 7.0),
            of(&|_| 2.0),
            of(&|t| (0.02 * t).to_degrees()),
        ];
        Self { columns }
    }

    fn series(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }
}

#[test]
fn law_simulated_errors_have_the_predicted_covariance() {
    let flight = Flight::new();
    let truth = flight.series();
    let model = InsErrorModel::default();
    let runs = 2000;
    let mut sums = [[0.0; STATES]; STATES];
    for run in 0..runs {
        let mut normals = NormalGenerator::new(run);
        let errors = simulate_ins_error(&truth, &model, || normals.draw()).unwrap();
        let last = errors[errors.len() - 1];
        for (sums, a) in sums.iter_mut().zip(last) {
            for (sum, b) in sums.iter_mut().zip(last) {
                *sum += a * b / runs as f64;
            }
        }
    }
    let mut p = model.initial_covariance(truth.lat_deg[0].to_radians(), 500.0);
    for row in 0..truth.len() - 1 {
        let f = pinson_matrix(&truth.point(row), &model.time_constants(), model.pinson);
        let phi = transition_matrix(&f, 2.0);
        p = step_covariance(&p, &f, &phi, &model.noise_density(), 2.0, model.noise);
    }
    for row in 0..STATES {
        for column in 0..STATES {
            let size = (p[row][row] * p[column][column]).sqrt();
            // The mean of 2000 products has a standard deviation of at most sqrt(2/2000) = 3.2 % of `size`; for 324
            // products the limit is 4.5 standard deviations.
            let difference = (sums[row][column] - p[row][column]) / size;
            assert!(difference.abs() < 4.5 * 0.032, "{row} {column} {difference}");
        }
    }
}

#[test]
fn law_without_uncertainty_and_noise_the_error_is_zero() {
    let flight = Flight::new();
    let quiet = InsErrorModel {
        sources: InsErrors {
            init_position_sigma_m: 0.0,
            init_altitude_sigma_m: 0.0,
            init_velocity_sigma_mps: 0.0,
            init_attitude_sigma_deg: 0.0,
            vrw_sigma: 0.0,
            arw_sigma: 0.0,
            baro_sigma_m: 0.0,
            ha_sigma_m: 0.0,
            a_hat_sigma_mps2: 0.0,
            acc_sigma_mps2: 0.0,
            gyro_sigma_radps: 0.0,
            ..InsErrors::default()
        },
        fogm_sigma_nt: 0.0,
        ..InsErrorModel::default()
    };
    let errors = simulate_ins_error(&flight.series(), &quiet, || 1.0).unwrap();
    // A variance of 1e-30 per second remains, a standard deviation of 1e-15.
    assert!(errors.iter().flatten().all(|error| error.abs() < 1e-9));
    let mut broken = Flight::new();
    broken.columns[4][7] = f64::NAN;
    let message = simulate_ins_error(&broken.series(), &quiet, || 1.0).unwrap_err().to_string();
    assert!(message.starts_with("column `ins_vn` is NaN in row 7"), "{message}");
}

#[test]
fn law_the_heading_has_its_own_initial_uncertainty() {
    use crate::navigation::pinson::{TILT_D, TILT_E};
    let (tilt, heading) = (0.01_f64.to_radians(), 0.1_f64.to_radians());
    let model = InsErrorModel {
        sources: InsErrors { init_heading_sigma_deg: Some(0.1), ..InsErrors::default() },
        ..InsErrorModel::default()
    };
    let p = model.initial_covariance(0.5, 300.0);
    assert_eq!([p[TILT_N][TILT_N], p[TILT_E][TILT_E]], [tilt * tilt; 2]);
    assert_eq!(p[TILT_D][TILT_D], heading * heading);
    let usual = InsErrorModel::default().initial_covariance(0.5, 300.0);
    assert_eq!(usual[TILT_D][TILT_D], tilt * tilt);
    assert!((0..STATES).all(|state| state == TILT_D || p[state] == usual[state]));
    let refused = InsErrorModel {
        sources: InsErrors { init_heading_sigma_deg: Some(-1.0), ..InsErrors::default() },
        ..InsErrorModel::default()
    }
    .check();
    assert!(refused.unwrap_err().to_string().starts_with("`init_heading_sigma_deg` must be 0 or above"));
    // Half a minute north at 60 m/s, then a turn to the east: a yaw error rotates the measured change of velocity by
    // the angle of the error.
    let flight = Flight::new();
    let quiet = InsErrorModel {
        sources: InsErrors {
            init_position_sigma_m: 0.0,
            init_altitude_sigma_m: 0.0,
            init_velocity_sigma_mps: 0.0,
            init_attitude_sigma_deg: 0.0,
            init_heading_sigma_deg: Some(1.0),
            vrw_sigma: 0.0,
            arw_sigma: 0.0,
            baro_sigma_m: 0.0,
            ha_sigma_m: 0.0,
            a_hat_sigma_mps2: 0.0,
            acc_sigma_mps2: 0.0,
            gyro_sigma_radps: 0.0,
            ..InsErrors::default()
        },
        fogm_sigma_nt: 0.0,
        ..InsErrorModel::default()
    };
    let mut draws = 0;
    // An error of one standard deviation in yaw, and no error in the other states.
    let one = |state: usize| if state == TILT_D { 1.0 } else { 0.0 };
    let errors = simulate_ins_error(&flight.series(), &quiet, || {
        draws += 1;
        if draws <= STATES { one(draws - 1) } else { 0.0 }
    })
    .unwrap();
    // After 78 s of 0.02 rad/s the velocity has turned from north to east. The velocity changed by (-60, +60) m/s. A
    // rotation of this change by one degree is 1.05 m/s in each component.
    let row = 39;
    let expected = 60.0 * 1.0_f64.to_radians();
    let got = [errors[row][VN].abs(), errors[row][VN + 1].abs()];
    assert!(got.iter().all(|v| (v / expected - 1.0).abs() < 0.1), "{got:?} {expected}");
}

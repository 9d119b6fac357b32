#![allow(clippy::unwrap_used)]
use super::*;
use crate::earth::attitude::{tilt_between, tilted};
use crate::earth::geodesy::STANDARD_GRAVITY_MPS2;
use nalgebra::{Matrix3, Vector3};

/// Values computed by MagNav.jl 1.3.3, by name: row, column and value.
pub(crate) fn golden_entries(name: &str) -> impl Iterator<Item = (usize, usize, f64)> {
    let file = include_str!("../../../reference/navigation/magnav_golden.csv");
    let lines = file.lines().map(|line| line.split(',').collect::<Vec<&str>>());
    lines
        .filter(move |words| words[0] == name)
        .map(|words| (words[1].parse().unwrap(), words[2].parse().unwrap(), words[3].parse().unwrap()))
}

/// The reference values as a matrix over the states.
pub(crate) fn golden(name: &str) -> StateMatrix {
    let mut matrix = [[0.0; STATES]; STATES];
    for (row, column, value) in golden_entries(name) {
        matrix[row][column] = value;
    }
    matrix
}

/// The reference matrix with rows and columns in magline's order.
pub(crate) fn golden_in_our_order(name: &str) -> StateMatrix {
    let theirs = golden(name);
    let mut ours = [[0.0; STATES]; STATES];
    for row in 0..STATES {
        for column in 0..STATES {
            ours[row][column] = theirs[MAGNAV_POSITION[row]][MAGNAV_POSITION[column]];
        }
    }
    ours
}

pub(crate) const GOLDEN_POINT: InsPoint = InsPoint {
    lat_rad: 0.75,
    vel_ned_mps: [60.0, -35.0, 1.5],
    force_ned_mps2: [0.3, -0.2, -9.7],
    euler_rad: [0.1, -0.2, 2.5],
};
pub(crate) const GOLDEN_TIMES: TimeConstants =
    TimeConstants { baro_s: 3600.0, acc_s: 3600.0, gyro_s: 3600.0, fogm_s: 600.0 };

#[test]
fn val_magnav_pinson_matrix_in_the_compatible_form() {
    let ours = pinson_matrix(&GOLDEN_POINT, &GOLDEN_TIMES, PinsonForm::Compatible);
    let theirs = golden_in_our_order("get_pinson_18");
    for (row, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
        for (column, (ours, theirs)) in ours.iter().zip(theirs).enumerate() {
            // Rounding of sums of a few terms.
            assert!((ours - theirs).abs() <= 4e-16 * theirs.abs(), "{row} {column} {ours} {theirs}");
        }
    }
}

#[test]
fn unit_the_forms_differ_only_in_the_element_of_altitude_and_tilt() {
    let thesis = pinson_matrix(&GOLDEN_POINT, &GOLDEN_TIMES, PinsonForm::Thesis);
    let compatible = pinson_matrix(&GOLDEN_POINT, &GOLDEN_TIMES, PinsonForm::Compatible);
    for row in 0..STATES {
        for column in 0..STATES {
            let differs = (row, column) == (TILT_N, ALT);
            assert_eq!(thesis[row][column] != compatible[row][column], differs);
        }
    }
    assert_eq!(thesis[TILT_N][ALT], 35.0 / (R * R));
}

/// State of the INS and of the barometer loop that aids it.
#[derive(Clone, Copy)]
struct Mechanisation {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    body_to_ned: Matrix3<f64>,
    acc_bias: Vector3<f64>,
    gyro_bias: Vector3<f64>,
    baro_m: f64,
    loop_mps2: f64,
    temporal_nt: f64,
}

/// Rates of change of a [`Mechanisation`], with the attitude as an angular rate in the navigation frame:
/// d(body_to_ned)/dt = skew(rate) body_to_ned.
struct Rates {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    turn: Vector3<f64>,
    baro_m: f64,
    loop_mps2: f64,
}

/// Strapdown equations on a rotating sphere with constant gravity, aided by a barometer in a third-order loop
/// [Titterton & Weston 3.69-3.75, 13.4]. The barometer measures `true_alt_m` with the drift `baro_m`. The function is
/// independent of the error model; the matrix of the model must equal the derivative of the function.
fn rates(m: &Mechanisation, force_body: &Vector3<f64>, rate_body: &Vector3<f64>, true_alt_m: f64) -> Rates {
    let (lat, height) = (m.position.x, m.position.z);
    let radius = R + height;
    let v = m.velocity;
    let earth = Vector3::new(lat.cos(), 0.0, -lat.sin()) * OMEGA;
    let transport = Vector3::new(v.y / radius, -v.x / radius, -v.y * lat.tan() / radius);
    let force = m.body_to_ned * (force_body + m.acc_bias);
    let gravity = Vector3::new(0.0, 0.0, STANDARD_GRAVITY_MPS2);
    let above_baro = height - (true_alt_m + m.baro_m);
    let down_loop = Vector3::new(0.0, 0.0, K2 * above_baro + m.loop_mps2);
    Rates {
        position: Vector3::new(v.x / radius, v.y / (radius * lat.cos()), -v.z - K1 * above_baro),
        velocity: force + gravity - (earth * 2.0 + transport).cross(&v) + down_loop,
        turn: m.body_to_ned * (rate_body + m.gyro_bias) - (earth + transport),
        baro_m: -m.baro_m / GOLDEN_TIMES.baro_s,
        loop_mps2: K3 * above_baro,
    }
}

/// Mechanisation displaced by a vector of error states.
fn moved(m: &Mechanisation, e: &StateVector) -> Mechanisation {
    let v3 = |from: usize| Vector3::new(e[from], e[from + 1], e[from + 2]);
    Mechanisation {
        position: m.position + v3(LAT),
        velocity: m.velocity + v3(VN),
        body_to_ned: tilted(&m.body_to_ned, &v3(TILT_N)),
        acc_bias: m.acc_bias + v3(ACC),
        gyro_bias: m.gyro_bias + v3(GYRO),
        baro_m: m.baro_m + e[HA],
        loop_mps2: m.loop_mps2 + e[A_HAT],
        temporal_nt: m.temporal_nt + e[S],
    }
}

/// Rate of change of the error states between two mechanisations.
fn error_rates(m: &Mechanisation, other: &Mechanisation, force: &Vector3<f64>, turn: &Vector3<f64>) -> StateVector {
    let truth = m.position.z;
    let (a, b) = (rates(m, force, turn, truth), rates(other, force, turn, truth));
    // A short step of both attitudes, and the change of the tilt between them.
    let dt = 0.005;
    let step = |m: &Mechanisation, r: &Rates| tilted(&m.body_to_ned, &(-r.turn * dt));
    let back = |m: &Mechanisation, r: &Rates| tilted(&m.body_to_ned, &(r.turn * dt));
    let tilt =
        (tilt_between(&step(m, &a), &step(other, &b)) - tilt_between(&back(m, &a), &back(other, &b))) / (2.0 * dt);
    let mut out = [0.0; STATES];
    out[LAT..VN].copy_from_slice((b.position - a.position).as_slice());
    out[VN..TILT_N].copy_from_slice((b.velocity - a.velocity).as_slice());
    out[TILT_N..ACC].copy_from_slice(tilt.as_slice());
    out[ACC..GYRO].copy_from_slice((-(other.acc_bias - m.acc_bias) / GOLDEN_TIMES.acc_s).as_slice());
    out[GYRO..HA].copy_from_slice((-(other.gyro_bias - m.gyro_bias) / GOLDEN_TIMES.gyro_s).as_slice());
    out[HA] = b.baro_m - a.baro_m;
    out[A_HAT] = b.loop_mps2 - a.loop_mps2;
    out[S] = -(other.temporal_nt - m.temporal_nt) / GOLDEN_TIMES.fogm_s;
    out
}

/// Steps of the error states: small, but large compared with rounding.
const STEPS: StateVector =
    [1e-4, 1e-4, 100.0, 1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5, 10.0, 1e-3, 1.0];

#[test]
fn law_every_element_is_the_derivative_of_the_mechanisation() {
    let points = [
        GOLDEN_POINT,
        InsPoint {
            lat_rad: -1.1,
            vel_ned_mps: [-180.0, 210.0, -8.0],
            force_ned_mps2: [4.1, -5.3, -12.4],
            euler_rad: [-0.8, 0.3, -2.0],
        },
    ];
    for point in points {
        let f = pinson_matrix(&point, &GOLDEN_TIMES, PinsonForm::Thesis);
        let [roll, pitch, yaw] = point.euler_rad;
        let rotation = body_to_ned(roll, pitch, yaw);
        let m = Mechanisation {
            position: Vector3::new(point.lat_rad, 0.4, 0.0),
            velocity: Vector3::from(point.vel_ned_mps),
            body_to_ned: rotation,
            acc_bias: Vector3::zeros(),
            gyro_bias: Vector3::zeros(),
            baro_m: 0.0,
            loop_mps2: 0.0,
            temporal_nt: 0.0,
        };
        let force = rotation.transpose() * Vector3::from(point.force_ned_mps2);
        let turn = rotation.transpose() * Vector3::new(0.02, -0.03, 0.05);
        for column in 0..STATES {
            let mut e = [0.0; STATES];
            e[column] = STEPS[column];
            let up = error_rates(&m, &moved(&m, &e), &force, &turn);
            let down = error_rates(&m, &moved(&m, &e.map(|e| -e)), &force, &turn);
            for row in 0..STATES {
                let derivative = (up[row] - down[row]) / (2.0 * STEPS[column]);
                // Effect of one step of the column's state on the row's state, relative to one step of the row's state
                // per second. Rounding contributes 1e-11, and the third derivatives 1e-6.
                let noise = 1e-10 * STEPS[row] / STEPS[column];
                assert!(
                    (f[row][column] - derivative).abs() <= 1e-6 * derivative.abs() + noise,
                    "({row}, {column}) {} {derivative}",
                    f[row][column]
                );
            }
        }
    }
}

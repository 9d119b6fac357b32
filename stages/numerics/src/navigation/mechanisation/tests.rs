use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::earth::attitude::{body_to_ned, tilt_between};

const NOT_ROTATING: NavigationEarth = NavigationEarth::Sphere { rate_radps: 0.0 };
const R: f64 = SEMI_MAJOR_AXIS_M;
const G: f64 = STANDARD_GRAVITY_MPS2;

fn at_rest(lat_rad: f64) -> NavigationState {
    NavigationState {
        lat_rad,
        lon_rad: 0.3,
        alt_m: 0.0,
        vel_ned_mps: Vector3::zeros(),
        body_to_ned: quaternion(&body_to_ned(0.2, -0.1, 1.3)),
    }
}

/// Readings of `seconds` at rest.
fn resting(earth: NavigationEarth, start: NavigationState, seconds: usize) -> Vec<ImuReading> {
    let mut readings = IdealImu::new(earth, start);
    (0..seconds).map(|_| readings.next(&Vector3::zeros(), &start.body_to_ned, 1.0)).collect()
}

#[test]
fn ref_normal_gravity() {
    // NIMA TR8350.2, table 3.4: 9.7803253359 m/s² at the equator and 9.8321849378 m/s² at the pole, to the printed
    // digits.
    assert!((normal_gravity_mps2(0.0, 0.0) - 9.780_325_335_9).abs() < 1e-10);
    assert!((normal_gravity_mps2(std::f64::consts::FRAC_PI_2, 0.0) - 9.832_184_937_8).abs() < 2e-10);
}

#[test]
fn law_normal_gravity_decreases_with_height() {
    const H: f64 = 50_000.0;
    let [low, middle, high] = [0.0, H, 2.0 * H].map(|alt_m| normal_gravity_mps2(0.8, alt_m));
    // Derivatives of g R²/(R + h)²: -2 g/R and 6 g/R². The flattening and the rotation contribute 1 % each.
    assert!((-(high - low) / (2.0 * H) / (2.0 * middle / R) - 1.0).abs() < 0.02);
    assert!(((low - 2.0 * middle + high) / (H * H) / (6.0 * middle / (R * R)) - 1.0).abs() < 0.03);
}

#[test]
fn law_at_rest_the_sensors_measure_the_earth_rate_and_minus_gravity() {
    let start = at_rest(0.7);
    let to_body = start.body_to_ned.inverse();
    let rate = to_body * Vector3::new(0.7_f64.cos(), 0.0, -0.7_f64.sin()) * EARTH_RATE_RADPS;
    let lift = to_body * Vector3::new(0.0, 0.0, -normal_gravity_mps2(0.7, 0.0));
    let last = resting(NavigationEarth::Wgs84, start, 3)[2];
    // Rounding of angles of 1 rad and of velocities of 9.8 m/s.
    assert!((last.angle_rad - rate).norm() < 1e-15, "{}", (last.angle_rad - rate).norm());
    // The earth rotates the body by 7e-5 rad per second: the error is of second order in this angle, plus rounding.
    assert!((last.velocity_mps - lift).norm() < 1e-8, "{}", (last.velocity_mps - lift).norm());
}

#[test]
fn law_an_error_free_ins_at_rest_stays_at_rest() {
    let start = at_rest(0.7);
    let mut ins = Mechanisation::new(NavigationEarth::Wgs84, start, 0.0);
    for reading in resting(NavigationEarth::Wgs84, start, 3600) {
        ins.step(&reading, Some(0.0));
    }
    let end = ins.motion();
    // 3600 rounding errors of 1e-16 rad of tilt and 1e-15 m/s.
    assert!((end.lat_rad - 0.7).abs() * R < 1e-5 && end.vel_ned_mps.norm() < 1e-9, "{end:?}");
    assert!(start.body_to_ned.angle_to(&end.body_to_ned) < 1e-11);
}

/// Analytic motion whose position and attitude oscillate in all directions.
struct Swing {
    earth: NavigationEarth,
}

impl Swing {
    fn place(t: f64) -> [f64; 3] {
        [0.7 + 2e-6 * t + 4e-5 * (0.15 * t).sin(), -1.2 + 1e-5 * t, 900.0 + 30.0 * (0.2 * t).sin()]
    }

    fn attitude(t: f64) -> Matrix3<f64> {
        body_to_ned(0.2 * (1.1 * t).sin(), 0.1 * (1.1 * t).cos(), 0.4 + 0.05 * t + 0.1 * (0.7 * t).sin())
    }

    /// Derivative of [`Swing::place`].
    fn place_rate(t: f64) -> [f64; 3] {
        [2e-6 + 6e-6 * (0.15 * t).cos(), 1e-5, 6.0 * (0.2 * t).cos()]
    }

    fn velocity(&self, t: f64) -> Vector3<f64> {
        let [lat, _, alt] = Self::place(t);
        let [lat_rate, lon_rate, climb] = Self::place_rate(t);
        let (meridian, transverse) = self.earth.radii_m(lat, alt);
        Vector3::new(lat_rate * meridian, lon_rate * transverse * lat.cos(), -climb)
    }

    /// Angular rate and specific force in the body frame, from the definitions of these quantities.
    fn sensed(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let [lat, _, alt] = Self::place(t);
        let (v, c) = (self.velocity(t), Self::attitude(t));
        let (meridian, transverse) = self.earth.radii_m(lat, alt);
        let earth_rate = Vector3::new(lat.cos(), 0.0, -lat.sin()) * self.earth.rate_radps();
        let transport = Vector3::new(v.y / transverse, -v.x / meridian, -v.y * lat.tan() / transverse);
        // The rotation is minus the tilt over a short time, in north-east-down.
        const H: f64 = 1e-4;
        let turn = -tilt_between(&Self::attitude(t - H), &Self::attitude(t + H)) / (2.0 * H);
        let gravity = Vector3::new(0.0, 0.0, self.earth.gravity_mps2(lat, alt));
        let rate = (self.velocity(t + H) - self.velocity(t - H)) / (2.0 * H);
        let force = rate + (earth_rate * 2.0 + transport).cross(&v) - gravity;
        (c.transpose() * (turn + earth_rate + transport), c.transpose() * force)
    }

    /// Integrals over a step, by Simpson's rule with eight intervals.
    fn reading(&self, t: f64, dt_s: f64) -> ImuReading {
        let (mut angle_rad, mut velocity_mps) = (Vector3::zeros(), Vector3::zeros());
        for k in 0..=16 {
            let weight = if k == 0 || k == 16 { 1.0 } else { f64::from(2 + 2 * (k % 2)) } * dt_s / 48.0;
            let (rate, force) = self.sensed(t + dt_s * f64::from(k) / 16.0);
            angle_rad += rate * weight;
            velocity_mps += force * weight;
        }
        ImuReading { dt_s, angle_rad, velocity_mps }
    }

    fn motion(&self, t: f64) -> NavigationState {
        let [lat_rad, lon_rad, alt_m] = Self::place(t);
        let body_to_ned = quaternion(&Self::attitude(t));
        NavigationState { lat_rad, lon_rad, alt_m, vel_ned_mps: self.velocity(t), body_to_ned }
    }
}

/// Distance (m), speed (m/s) and angle (rad) between two motions.
fn apart(a: &NavigationState, b: &NavigationState) -> [f64; 3] {
    let north = (a.lat_rad - b.lat_rad) * R;
    let east = (a.lon_rad - b.lon_rad) * R * a.lat_rad.cos();
    let place = Vector3::new(north, east, a.alt_m - b.alt_m).norm();
    [place, (a.vel_ned_mps - b.vel_ned_mps).norm(), a.body_to_ned.angle_to(&b.body_to_ned)]
}

/// Difference after a minute between a motion and the mechanisation of the integrated angular rate and specific force
/// of this motion.
fn after_a_minute(earth: NavigationEarth, steps: u32) -> [f64; 3] {
    let swing = Swing { earth };
    let dt_s = 60.0 / f64::from(steps);
    // The first reading serves as the previous reading for the second reading.
    let mut ins = Mechanisation::new(earth, swing.motion(0.0), 0.0);
    for k in 0..steps {
        let (t, middle) = (dt_s * f64::from(k), dt_s * (f64::from(k) + 0.5));
        ins.step(&swing.reading(t, dt_s), Some(Swing::place(middle)[2]));
    }
    apart(ins.motion(), &swing.motion(60.0))
}

#[test]
fn law_the_mechanisation_reproduces_a_motion_from_the_integrals_of_its_rate_and_force() {
    for earth in [NavigationEarth::Wgs84, NavigationEarth::Sphere { rate_radps: EARTH_RATE_RADPS }] {
        let (coarse, fine) = (after_a_minute(earth, 1200), after_a_minute(earth, 2400));
        println!("{earth:?}: {coarse:?} {fine:?} m, m/s, rad");
        for (coarse, fine) in coarse.iter().zip(fine) {
            // Third order: a factor of eight; the position adds the second order of the trapezoidal rule.
            assert!(coarse / fine > 6.0, "{coarse:e} {fine:e}");
        }
        // At 40 Hz, with oscillations of 0.2 rad at 1.1 rad/s: (0.2 * 1.1 Δt)³ of 9.8 m/s² is 2e-6 m/s² in each step.
        assert!(fine[0] < 1e-3 && fine[1] < 3e-5 && fine[2] < 2e-7, "{fine:?}");
    }
}

#[test]
fn law_the_readings_of_a_motion_are_the_integrals_of_its_rate_and_force() {
    let swing = Swing { earth: NavigationEarth::Wgs84 };
    let worst = |dt_s: f64| {
        let mut readings = IdealImu::new(NavigationEarth::Wgs84, swing.motion(0.0));
        let mut worst = [0.0_f64; 2];
        for k in 0..(20.0 / dt_s) as u32 {
            let t = dt_s * f64::from(k);
            let to = swing.motion(t + dt_s);
            let ours = readings.next(&to.vel_ned_mps, &to.body_to_ned, dt_s);
            let theirs = swing.reading(t, dt_s);
            if k > 0 {
                worst[0] = worst[0].max((ours.angle_rad - theirs.angle_rad).norm() / dt_s);
                worst[1] = worst[1].max((ours.velocity_mps - theirs.velocity_mps).norm() / dt_s);
            }
        }
        worst
    };
    let (coarse, fine) = (worst(0.1), worst(0.05));
    println!("{coarse:?} {fine:?} rad/s, m/s²");
    // The error after the corrections is of third order.
    assert!(coarse[0] / fine[0] > 7.0 && coarse[1] / fine[1] > 7.0, "{coarse:?} {fine:?}");
    assert!(fine[0] < 1e-6 && fine[1] < 5e-5, "{fine:?}");
}

#[test]
fn law_the_mechanisation_of_ideal_readings_reproduces_the_motion() {
    let swing = Swing { earth: NavigationEarth::Wgs84 };
    let mut readings = IdealImu::new(NavigationEarth::Wgs84, swing.motion(0.0));
    let mut ins = Mechanisation::new(NavigationEarth::Wgs84, swing.motion(0.0), 0.0);
    for k in 1..=6000 {
        let to = swing.motion(0.1 * f64::from(k));
        let baro_alt_m = 0.5 * (readings.motion().alt_m + 0.0);
        let reading = readings.next(&to.vel_ned_mps, &to.body_to_ned, 0.1);
        ins.step(&reading, Some(baro_alt_m + 0.5 * readings.motion().alt_m));
    }
    let [place, speed, angle] = apart(ins.motion(), readings.motion());
    // The error consists of 6000 rounding errors and of the truncation error after the last repetition of a step, (2 Ω
    // Δt)^4.
    assert!(place < 1e-6 && speed < 1e-9 && angle < 1e-12, "{place:e} {speed:e} {angle:e}");
    let [place, ..] = apart(readings.motion(), &swing.motion(600.0));
    // Trapezoidal rule over the velocities: v'' Δt²/12 of the oscillations, which average out.
    assert!(place < 0.05, "{place}");
}

/// Displacement north from the start (m) after each second of rest on a sphere that does not rotate.
fn drift_north_m(errors: &ImuErrors, tilt: f64, seconds: usize) -> Vec<f64> {
    let start = NavigationState { body_to_ned: quaternion(&Matrix3::identity()), ..at_rest(0.0) };
    let tilted = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, tilt, 0.0)) * start.body_to_ned;
    let mut ins = Mechanisation::new(NOT_ROTATING, NavigationState { body_to_ned: tilted, ..start }, 0.0);
    let one = |reading: &ImuReading| {
        ins.step(&errors.measured(reading), Some(0.0));
        ins.motion().lat_rad * R
    };
    resting(NOT_ROTATING, start, seconds).iter().map(one).collect()
}

/// Largest difference between two series, relative to the magnitude of the second series.
fn difference(a: &[f64], b: impl Fn(f64) -> f64) -> f64 {
    let b: Vec<f64> = (1..=a.len()).map(|t| b(t as f64)).collect();
    let size = b.iter().fold(0.0_f64, |size, b| size.max(b.abs()));
    a.iter().zip(b).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs())) / size
}

#[test]
fn law_tilts_and_biases_oscillate_with_the_schuler_period() {
    let schuler = (G / R).sqrt();
    let hours = 2 * 5064;
    // Small enough to neglect the second order, in kilometres over the radius.
    let (bias, tilt, drift) = (1e-3, 1e-5, 1e-8);
    let acc = ImuErrors { acc_bias_mps2: Vector3::new(-bias, 0.0, 0.0), ..ImuErrors::default() };
    let gyro = ImuErrors { gyro_bias_radps: Vector3::new(0.0, -drift, 0.0), ..ImuErrors::default() };
    // Titterton & Weston 2004, table 12.2: b/ωs² (1 - cos ωs t), -R ψ (1 - cos ωs t), -R ε (t - sin ωs t / ωs).
    let of_bias =
        difference(&drift_north_m(&acc, 0.0, hours), |t| bias / schuler.powi(2) * (1.0 - (schuler * t).cos()));
    let of_tilt =
        difference(&drift_north_m(&ImuErrors::default(), tilt, hours), |t| -R * tilt * (1.0 - (schuler * t).cos()));
    let of_drift = difference(&drift_north_m(&gyro, 0.0, hours), |t| -R * drift * (t - (schuler * t).sin() / schuler));
    println!("bias {of_bias:.1e}, tilt {of_tilt:.1e}, drift {of_drift:.1e}");
    // With a step of one second, the phase error is (ωs Δt)²/12 = 1e-7, over two oscillations.
    assert!(of_bias < 1e-5 && of_tilt < 1e-5 && of_drift < 1e-5, "{of_bias:e} {of_tilt:e} {of_drift:e}");
}

#[test]
fn ref_the_schuler_period_on_the_real_earth_is_84_4_minutes() {
    let start = at_rest(45.0_f64.to_radians());
    let mut ins = Mechanisation::new(NavigationEarth::Wgs84, start, 0.0);
    let errors = ImuErrors { acc_bias_mps2: Vector3::new(1e-3, 0.0, 0.0), ..ImuErrors::default() };
    let away = |reading: &ImuReading| {
        ins.step(&errors.measured(reading), Some(0.0));
        apart(ins.motion(), &start)[0]
    };
    let distances: Vec<f64> = resting(NavigationEarth::Wgs84, start, 6000).iter().map(away).collect();
    // The plane of the oscillation rotates like Foucault's: b/ωs² |1 - exp(-i Ω sin(lat) t) cos(ωs t)|.
    let turning = EARTH_RATE_RADPS * start.lat_rad.sin();
    let misfit = |period_min: f64| {
        let schuler = std::f64::consts::TAU / (60.0 * period_min);
        difference(&distances, |t| {
            let (swing, turned) = ((schuler * t).cos(), turning * t);
            1e-3 / schuler.powi(2) * (1.0 - 2.0 * swing * turned.cos() + swing * swing).sqrt()
        })
    };
    let periods = (0..200).map(|k| 80.0 + 0.05 * f64::from(k));
    let best = periods.min_by(|a, b| misfit(*a).total_cmp(&misfit(*b))).unwrap_or_default();
    println!("period {best:.2} min, misfit {:.4}", misfit(best));
    // In addition to Foucault's rotation, the earth rate changes the period by (Ω/ωs)², 0.35 %.
    assert!((best - 84.4).abs() < 0.3 && misfit(best) < 0.02, "{best} {}", misfit(best));
}

#[test]
fn law_a_flight_over_the_pole_continues_south_on_the_other_side() {
    let start = NavigationState {
        lat_rad: 89.999_f64.to_radians(),
        lon_rad: 0.5,
        alt_m: 0.0,
        vel_ned_mps: Vector3::new(100.0, 0.0, 0.0),
        body_to_ned: quaternion(&Matrix3::identity()),
    };
    let mut ins = Mechanisation::new(NOT_ROTATING, start, 0.0);
    for _ in 0..20 {
        // Along a great circle the body rotates only about its lateral axis.
        let angle_rad = Vector3::new(0.0, -100.0 / R, 0.0);
        ins.step(&ImuReading { dt_s: 1.0, angle_rad, velocity_mps: Vector3::new(0.0, 0.0, 1e4 / R - G) }, Some(0.0));
    }
    let end = ins.motion();
    let beyond = 2000.0 / R - 0.001_f64.to_radians();
    let expected = std::f64::consts::FRAC_PI_2 - beyond;
    assert!((end.lat_rad - expected).abs() * R < 0.1, "{}", (end.lat_rad - expected) * R);
    assert!((end.lon_rad - 0.5 - std::f64::consts::PI).abs() < 1e-9 && (end.vel_ned_mps.x + 100.0).abs() < 1e-2);
    let nose = end.body_to_ned * Vector3::x();
    assert!((nose + Vector3::x()).norm() < 1e-4, "{nose:?}");
}

#[test]
fn law_a_free_vertical_channel_diverges_and_a_barometer_stabilises_it() {
    let start = at_rest(0.7);
    let errors =
        ImuErrors { acc_bias_mps2: start.body_to_ned.inverse() * Vector3::new(0.0, 0.0, 1e-3), ..ImuErrors::default() };
    let fallen = |baro: Option<f64>| {
        let mut ins = Mechanisation::new(NavigationEarth::Wgs84, start, 0.0);
        for reading in resting(NavigationEarth::Wgs84, start, 1200) {
            ins.step(&errors.measured(&reading), baro);
        }
        ins.motion().alt_m
    };
    // b/λ² (cosh λt - 1) upwards with λ² = 2g/R [Titterton & Weston 2004, 12.3.2]; the other gradients of gravity and
    // of the centrifugal force are 0.5 % of this gradient.
    let lambda = (2.0 * G / R).sqrt();
    let expected = 1e-3 / lambda.powi(2) * ((lambda * 1200.0).cosh() - 1.0);
    let free = fallen(None);
    assert!((free / expected - 1.0).abs() < 0.01, "{free} {expected}");
    // The integral term of the loop compensates the bias: b/K2 = 3.3 m at most, and decreasing.
    assert!(fallen(Some(0.0)).abs() < 0.3, "{}", fallen(Some(0.0)));
}

//! The eddy field is the exact derivative of the field in the body frame at any sample rate.

use numerics::{
    compensation::tolles_lawson::{BodyFieldColumns as Flux, DEFAULT_SCALE_NT, TermSelection, matrix},
    regression::least_squares::QrAccumulator,
};

use super::{super::super::trajectory::TrueTrajectory, *};

/// A weaving climb through gusts over Osborne, with every variable part of the field.
const WILD: &str = "
[[flights]]
name = 'A'
start_tt_s = 36000.0
[[flights.lines]]
name = 'A.1'
kind = 'free'
alts_m = [500.0, 560.0, 520.0]
alt_m = 500.0
waypoints = [[-22.05, 140.6], [-22.03, 140.62], [-22.01, 140.60]]
[turbulence]
level = 'moderate'
[diurnal]
sigma_nt = 5.0
quiet_nt = 30.0
pulsation_nt = 1.0
storm_nt = 80.0
storm_start_tt_s = 36020.0
[[sources]]
lat = -22.04
lon = 140.61
depth_m = 10.0
moment_am2 = 1e7
";

const EDDY: &str = "[[vector_magnetometers]]\nname = 'flux_a'\n[[vector_magnetometers]]\nname = 'flux_b'\n\
                    eddy = [[0.03, 0.01, 0.0], [0.0, 0.02, -0.01], [0.005, 0.0, 0.03]]\n\
                    [[magnetometers]]\nname = 'mag_1_c'\n[[magnetometers]]\nname = 'mag_2_uc'\n\
                    eddy = [[0.03, 0.01, 0.0], [0.0, 0.02, -0.01], [0.005, 0.0, 0.03]]\n\
                    [[currents]]\nname = 'cur_r'\nkind = 'servo'\naxes = [1.0, 0.5, 0.5]\nfull_dps = 30.0\n\
                    on_a = 6.0\n";

#[test]
fn law_the_eddy_field_does_not_depend_on_the_sample_rate() {
    let at = |rate: u32| lines_of(&format!("rate_hz = {rate}.0\ncomponent_columns = true"), EDDY, WILD).remove(0);
    let slow = at(10);
    for rate in [100, 1000] {
        let (fast, every) = (at(rate), rate as usize / 10);
        for name in ["mag_2_uc", "flux_b_x", "flux_b_y", "flux_b_z", "part_eddy_mag_2_uc", "cur_r"] {
            let pairs = column(&slow, name).iter().zip(column(&fast, name).iter().step_by(every));
            let most = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            println!("10 and {rate} Hz, {name}: {most:e} nT apart at most, of {:.2}", sd(column(&slow, name)));
            // Time stamps of 36000 s are rounded to 7e-12 s.
            assert!(most < 1e-6, "{rate} Hz {name}: {most}");
        }
    }
    assert!(sd(column(&slow, "part_eddy_mag_2_uc")) > 1.0);
}

#[test]
fn law_the_eddy_field_is_the_derivative_of_the_field_in_the_body_frame() {
    let line = &lines_of("rate_hz = 1000.0", EDDY, WILD)[0];
    let at = |name: &str, i: usize| Vector3::from(["x", "y", "z"].map(|a| column(line, &format!("{name}_{a}"))[i]));
    let eddy_s = nalgebra::Matrix3::new(0.03, 0.01, 0.0, 0.0, 0.02, -0.01, 0.005, 0.0, 0.03);
    let (mut most, mut size) = (0.0_f64, 0.0_f64);
    // Excludes the nodes of the track, every 50 samples, where the third derivative jumps.
    for i in (2..line.num_rows() - 2).step_by(7).filter(|i| (2..=48).contains(&(i % 50))) {
        let change = |by: usize| at("flux_a", i + by) - at("flux_a", i - by);
        let rate = (8.0 * change(1) - change(2)) / 0.012;
        let eddy = at("flux_b", i) - at("flux_a", i);
        most = most.max((eddy - eddy_s * rate).norm());
        size = size.max(eddy.norm());
    }
    // Rounding of the differences over milliseconds, in the test and in the simulator: parts in 10^8 of the field's
    // rate.
    assert!(most < 1e-7 * size && size > 30.0, "{most} of {size}");
}

/// A level turn at a constant rate with roll and pitch held, sampled at 10 Hz.
fn turn(roll_deg: f64, pitch_deg: f64, turn_degps: f64) -> TrueTrajectory {
    let mut true_track = TrueTrajectory::default();
    let ((sin_roll, cos_roll), (sin_pitch, cos_pitch)) =
        (roll_deg.to_radians().sin_cos(), pitch_deg.to_radians().sin_cos());
    let rates = [-sin_pitch, sin_roll * cos_pitch, cos_roll * cos_pitch].map(|part| turn_degps * part);
    for k in 0..600 {
        let tt_s = 0.1 * f64::from(k);
        true_track.tt_s.push(tt_s);
        for (axis, angle) in [roll_deg, pitch_deg, turn_degps * tt_s].into_iter().enumerate() {
            true_track.attitude_deg[axis].push(angle);
            true_track.rates_degps[axis].push(rates[axis]);
        }
    }
    true_track
}

#[test]
fn law_in_a_steady_turn_the_rate_is_that_of_the_rotating_horizontal_field() {
    let (roll_deg, pitch_deg, turn_degps) = (25.0_f64, 3.0_f64, 6.0_f64);
    let true_track = turn(roll_deg, pitch_deg, turn_degps);
    let ned_nt = Vector3::new(30_000.0, 3000.0, -40_000.0);
    let w = turn_degps.to_radians();
    let ((sin_roll, cos_roll), (sin_pitch, cos_pitch)) =
        (roll_deg.to_radians().sin_cos(), pitch_deg.to_radians().sin_cos());
    for i in 0..true_track.tt_s.len() {
        let (sin, cos) = (w * true_track.tt_s[i]).sin_cos();
        // The components ahead and to the right in the horizontal plane, rotated by pitch and roll.
        let ahead = w * (ned_nt.y * cos - ned_nt.x * sin);
        let right = -w * (ned_nt.x * cos + ned_nt.y * sin);
        let expected = Vector3::new(
            ahead * cos_pitch,
            ahead * sin_pitch * sin_roll + right * cos_roll,
            ahead * sin_pitch * cos_roll - right * sin_roll,
        );
        let body_nt = true_track.attitude(i).transpose() * ned_nt;
        let found = true_track.rate_in_body(i, &Vector3::zeros(), &body_nt);
        // Rounding error of the eddy-current terms in a field of 4e4 nT that rotates at 0.1 rad/s.
        assert!((found - expected).norm() < 1e-9, "{i}: {found} {expected}");
    }
}

#[test]
fn law_a_circle_in_the_core_field_has_the_rate_of_a_steady_turn() {
    let circle = "[[flights]]\nname = 'A'\n[[flights.lines]]\nname = 'A.1'\nkind = 'circle'\nalt_m = 500.0\n\
                  center = [-22.0, 140.6]\nradius_m = 1000.0\n[components]\nanomaly = false\ngusts = false\n";
    let sensor = "[[vector_magnetometers]]\nname = 'flux_a'\n[[vector_magnetometers]]\nname = 'flux_b'\n\
                  eddy = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n";
    let line = &lines_of("", sensor, circle)[0];
    let at = |name: &str, i: usize| Vector3::from(["x", "y", "z"].map(|a| column(line, &format!("{name}_{a}"))[i]));
    let core = numerics::earth::core_field::CoreField::at(2020.503).unwrap().field_ned_nt(-22.0, 140.6, 500.0);
    let expected = core[0].hypot(core[1]) * 60.0 / 1000.0;
    let mut within = 0;
    for i in 0..line.num_rows() {
        let rate = at("flux_b", i) - at("flux_a", i);
        // The turn is not steady during roll-in and roll-out.
        if (column(line, "yaw")[i] - column(line, "yaw")[(i + 1).min(line.num_rows() - 1)]).abs() > 300.0 {
            continue;
        }
        within += usize::from((rate.norm() / expected - 1.0).abs() < 2e-3);
    }
    // The field changes by 10 nT/km, which is 0.6 nT/s of 1800 nT/s.
    assert!(within > line.num_rows() * 8 / 10, "{within} of {}", line.num_rows());
}

/// Root mean square of the residual of Tolles-Lawson's eddy terms, computed from central differences, and of the eddy
/// field, in nT.
fn left_nt(rate_hz: f64) -> (f64, f64) {
    let sensors = "[[vector_magnetometers]]\nname = 'flux_a'\n[[magnetometers]]\nname = 'mag_1_c'\n\
                   [[magnetometers]]\nname = 'mag_2_uc'\neddy = [[1e-4, 2e-5, 0.0], [0.0, 2e-4, 5e-5], [3e-5, 0.0, \
                   1e-4]]\n";
    let line = &lines_of(&format!("rate_hz = {rate_hz}"), sensors, SURVEY)[0];
    let [x, y, z] = ["x", "y", "z"].map(|a| column(line, &format!("flux_a_{a}")));
    let terms = TermSelection::new(&["eddy"]).unwrap();
    let a = matrix(&Flux { x, y, z, bt: None }, &terms, DEFAULT_SCALE_NT).unwrap();
    let both = column(line, "mag_2_uc").iter().zip(column(line, "mag_1_c"));
    let eddy: Vec<f64> = both.map(|(read, truth)| read - truth).collect();
    // The differences at the first and the last sample are one-sided.
    let inner = 1..eddy.len() - 1;
    let (a, eddy) = (&a[inner.start * terms.len()..inner.end * terms.len()], &eddy[inner]);
    let solved = QrAccumulator::from_matrix(a, terms.len(), &[eddy]).unwrap().solve(&[1e-12], &terms.names()).unwrap();
    let coefficients = &solved.solutions[0].coefficients[0];
    let rms = |x: &[f64]| (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt();
    let rows = a.chunks_exact(terms.len()).zip(eddy);
    let left: Vec<f64> =
        rows.map(|(row, eddy)| eddy - row.iter().zip(coefficients.iter()).map(|(a, c)| a * c).sum::<f64>()).collect();
    (rms(&left), rms(eddy))
}

#[test]
fn law_the_error_of_central_differences_is_quadratic_in_the_sampling_interval() {
    let rates = [10.0, 20.0, 40.0];
    let left: Vec<f64> = rates
        .iter()
        .map(|rate| {
            let (left, eddy) = left_nt(*rate);
            println!("{rate} Hz: {left:e} nT left of {eddy:e} nT");
            left / eddy
        })
        .collect();
    // The error (w h)²/6 for motions of 0.02 to 0.5 Hz is at most 1.6 % at 10 Hz; the fit reduces it.
    assert!(left[0] > 1e-3 && left[0] < 2e-2, "{left:?}");
    for pair in left.windows(2) {
        let ratio = pair[0] / pair[1];
        assert!((3.5..4.5).contains(&ratio), "twice the rate, a quarter of the rest: {left:?}");
    }
}

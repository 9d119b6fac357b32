//! Aiding positions, compared with the Kalman filter of INS and positions.

use super::*;
use crate::navigation::ins_only;
use crate::navigation::position_fixes::PositionFixes;

/// Fixes at every few samples, displaced from the INS.
fn fixes(scene: &Scene, every: usize, moved_m: [f64; 3], sigma_m: f64) -> PositionFixes {
    let at = |row: usize| row % every == every - 1;
    let rows = scene.columns[0].len();
    let place = |row: usize| scene.moved(row, [moved_m[0], moved_m[1]]);
    let of = |f: &dyn Fn(usize) -> f64| (0..rows).map(|row| if at(row) { f(row) } else { f64::NAN }).collect();
    PositionFixes {
        lat_deg: of(&|row| place(row).0),
        lon_deg: of(&|row| place(row).1),
        alt_m: of(&|_| 300.0 + moved_m[2]),
        horizontal_sigma_m: sigma_m,
        vertical_sigma_m: 2.0 * sigma_m,
    }
}

/// Scene without measurements of the field.
fn blind(samples: usize, sources: InsErrors) -> Scene {
    let mut scene = Scene::new(samples, map_of(|_, _| 0.0, None), sources, [0.0; 2]);
    scene.measured_nt.fill(f64::NAN);
    scene
}

fn with_fixes(scene: &Scene, fixes: &PositionFixes, parameters: &MpfParameters) -> MpfOutput {
    let ins = crate::navigation::InsSeries::from_columns(scene.columns.each_ref().map(Vec::as_slice));
    let line = NavigationLine {
        ins: &ins,
        measurement_nt: &scene.measured_nt,
        sigma_nt: &scene.sigma_nt,
        map: &scene.map,
        core: None,
        errors: scene.errors,
        offset_window_s: 0.0,
        fixes: Some(fixes),
        second_order: false,
    };
    run(parameters, &line, &Aids::default()).unwrap()
}

fn exact(scene: &Scene, fixes: &PositionFixes) -> NavigationOutput {
    let ins = crate::navigation::InsSeries::from_columns(scene.columns.each_ref().map(Vec::as_slice));
    ins_only::run(&ins, &scene.errors, Some(fixes)).unwrap()
}

/// Rms distance from the Kalman filter over the last rows, in standard deviations of the Kalman filter, and the mean
/// ratio of the northward standard deviations.
fn compared(scene: &Scene, fixes: &PositionFixes, particles: usize, resample_threshold: f64) -> (f64, f64) {
    const SEEDS: u64 = 12;
    let exact = exact(scene, fixes);
    let rows = scene.columns[0].len();
    let (mut square, mut ratio, mut count) = (0.0, 0.0, 0.0);
    for seed in 0..SEEDS {
        let parameters = MpfParameters { particles, seed, resample_threshold, ..MpfParameters::default() };
        let track = with_fixes(scene, fixes, &parameters).track;
        for row in rows / 2..rows {
            let at = |of: &NavigationOutput| (of.lat_deg[row], of.lon_deg[row]);
            let (north, east) = EARTH.offset_ne_m(at(&exact), at(&track), 300.0);
            square += 0.5 * ((north / exact.sd_n_m[row]).powi(2) + (east / exact.sd_e_m[row]).powi(2));
            ratio += 0.5 * (track.sd_n_m[row] / exact.sd_n_m[row] + track.sd_e_m[row] / exact.sd_e_m[row]);
            count += 1.0;
        }
    }
    (f64::sqrt(square / count), ratio / count)
}

#[test]
fn law_positions_without_the_field_give_the_kalman_filter() {
    let sources = InsErrors {
        init_position_sigma_m: 30.0,
        init_altitude_sigma_m: 20.0,
        init_velocity_sigma_mps: 0.5,
        ..InsErrors::default()
    };
    let scene = blind(120, sources);
    let fixes = fixes(&scene, 5, [25.0, -18.0, 12.0], 15.0);
    let found = [500, 8000].map(|particles| compared(&scene, &fixes, particles, 0.5));
    println!("rms distance in sigmas, and ratio of sigmas, of 500 and 8000 particles: {found:.3?}");
    // The mean of N particles has an error of 1/√N of a standard deviation, to which each resampling adds the same
    // amount.
    assert!(found[1].0 < 0.1 && (found[1].1 - 1.0).abs() < 0.03, "{found:?}");
    // With sixteen times as many particles, the distance is a quarter, except for the contribution of the kernels.
    assert!(found[1].0 < 0.7 * found[0].0, "{found:?}");
}

#[test]
fn law_a_fix_of_metres_narrows_a_cloud_of_kilometres() {
    // The cloud is 700 times as wide as the fix, which is one standard deviation from the middle of the cloud.
    let sources = InsErrors { init_position_sigma_m: 1500.0, ..InsErrors::default() };
    let scene = blind(40, sources);
    let fixes = fixes(&scene, 4, [1100.0, -900.0, 0.0], 2.0);
    let (distance, ratio) = compared(&scene, &fixes, 2000, 0.5);
    println!("rms distance {distance:.2} sigmas, ratio of sigmas {ratio:.2}");
    assert!(distance < 0.5 && (ratio - 1.0).abs() < 0.15, "{distance} {ratio}");
}

#[test]
fn law_a_height_fix_is_the_kalman_update_of_the_linear_states() {
    // The position is known: only copies are drawn, and the result is exact.
    let sources = InsErrors { init_altitude_sigma_m: 20.0, ..exact_ins(0.0) };
    let scene = blind(1, sources);
    let fixes = fixes(&scene, 1, [f64::NAN, f64::NAN, 9.0], 5.0);
    let parameters =
        MpfParameters { particles: 50, keep_states: true, keep_covariance: true, ..MpfParameters::default() };
    let track = with_fixes(&scene, &fixes, &parameters).track;
    // 20 m against 10 m: 4/5 of 9 m, and 400·100/500 m².
    assert!((track.x[0][ALT] - 7.2).abs() < 1e-9 && (track.p[0][ALT][ALT] - 80.0).abs() < 1e-9, "{}", track.x[0][ALT]);
}

#[test]
fn unit_without_positions_results_are_bit_identical_to_a_line_without_fixes() {
    let scene = two_hills(true);
    let mut none = fixes(&scene, 5, [0.0; 3], 10.0);
    for column in [&mut none.lat_deg, &mut none.lon_deg, &mut none.alt_m] {
        column.fill(f64::NAN);
    }
    let parameters = MpfParameters::default();
    assert_eq!(bits(&with_fixes(&scene, &none, &parameters)), bits(&scene.run(&parameters)));
}

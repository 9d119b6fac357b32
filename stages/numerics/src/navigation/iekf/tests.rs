#![allow(clippy::unwrap_used)]
use super::*;
use crate::maps::map_surface::MapInterpolation;
use crate::navigation::ekf::{self, EkfParameters};
use crate::navigation::pinson::{S, STATES};
use crate::navigation::scenes::{
    AnalyticScene, DenseBatchSmoother, assert_close, assert_refusals, hills, m_per_deg, plane, uneven,
};
use crate::random::NormalGenerator;

fn all(iterations: usize) -> IekfParameters {
    IekfParameters { iterations, keep_covariance: true, ..IekfParameters::default() }
}

fn filtered(scene: &AnalyticScene, parameters: &IekfParameters) -> IekfOutput {
    scene.with(|line| run(line, parameters)).unwrap()
}

/// Extended Kalman filter of the same scene.
fn ekf(scene: &AnalyticScene, gate_nis: Option<f64>) -> NavigationOutput {
    let parameters = EkfParameters {
        errors: scene.errors,
        measurement_sigma_nt: scene.sigma_nt[0],
        gate_nis,
        keep_covariance: true,
        ..EkfParameters::default()
    };
    ekf::run(&parameters, &scene.series(), &scene.measurement_nt, &scene.map, None).unwrap()
}

fn assert_equal(ours: &NavigationOutput, theirs: &NavigationOutput, part: f64) {
    for row in 0..theirs.x.len() {
        assert_eq!(ours.nis[row].is_nan(), theirs.nis[row].is_nan(), "{row}");
        if !theirs.nis[row].is_nan() {
            let scale = theirs.residual_nt[row].abs() / theirs.nis[row].sqrt();
            assert!((ours.residual_nt[row] - theirs.residual_nt[row]).abs() < part * scale, "{row}");
            assert!((ours.nis[row] - theirs.nis[row]).abs() < part * (1.0 + theirs.nis[row]), "{row}");
        }
        for state in 0..STATES {
            let sigma = theirs.p[row][state][state].sqrt();
            assert!((ours.x[row][state] - theirs.x[row][state]).abs() < part * sigma, "{row} {state}");
            for other in 0..STATES {
                let size = sigma * theirs.p[row][other][other].sqrt();
                assert!((ours.p[row][state][other] - theirs.p[row][state][other]).abs() < part * size, "{row} {state}");
            }
        }
    }
    assert_eq!(ours.report, theirs.report);
}

#[test]
fn law_one_iteration_equals_the_extended_kalman_filter() {
    let mut scene = AnalyticScene::new(&uneven(150), MapInterpolation::Cubic, hills);
    for row in [0, 17, 18, 80] {
        scene.measurement_nt[row] = f64::NAN;
    }
    scene.measurement_nt[40] += 300.0;
    // Off the map.
    scene.columns[1][100] += 3.0;
    for gate_nis in [None, Some(10.83)] {
        let output = filtered(&scene, &IekfParameters { gate_nis, ..all(1) });
        // Same sums in another order.
        assert_equal(&output.line, &ekf(&scene, gate_nis), 1e-9);
        assert_eq!(output.iterations.linearisations, output.line.report.updates);
        assert_eq!((output.iterations.halved, output.iterations.unconverged), (0, 0));
    }
    assert_eq!(filtered(&scene, &IekfParameters { gate_nis: Some(10.83), ..all(1) }).line.report.gated, 1);
}

#[test]
fn law_on_a_plane_more_iterations_change_nothing_and_the_last_state_is_least_squares() {
    let scene = AnalyticScene::new(&uneven(150), MapInterpolation::Linear, plane);
    let output = filtered(&scene, &IekfParameters { tolerance_m: 1e-9, ..all(5) });
    // Positions have a rounding error of 1e-16 degrees; a degree is 1e5 m.
    assert_equal(&output.line, &ekf(&scene, None), 1e-9);
    let last = scene.columns[0].len() - 1;
    let batch = scene.with(|line| {
        let mut batch = DenseBatchSmoother::new(line);
        batch.solve(line, |_| 1.0);
        batch
    });
    let found = (&output.line.x[last], &output.line.p[last]);
    // The dense solution loses four of sixteen digits because of the condition number of the matrix.
    assert_close(found.0, found.1, (&batch.x[last], &batch.p[last]), 1e-6, "last");
}

/// Field that depends on north only, a wave of 2.5 km, and one measurement of this field.
fn wave(north: f64, _: f64) -> f64 {
    200.0 * (north / 400.0).sin()
}

#[test]
fn law_one_update_gives_the_most_probable_state() {
    for offset_m in [-180.0, -60.0, 30.0, 120.0, 240.0] {
        let mut scene = AnalyticScene::new(&[0.0], MapInterpolation::Cubic, wave);
        scene.measurement_nt[0] = wave(offset_m, 0.0);
        let output = filtered(&scene, &IekfParameters { tolerance_m: 1e-3, ..all(30) });
        assert_eq!(output.iterations.unconverged, 0, "{offset_m}");
        // J as a function of north only: the minimum over S (normal) and east (no slope) is known.
        let (sigma_m, variance) = (100.0_f64, 3.0_f64.powi(2) + 5.0_f64.powi(2));
        let residual_nt = |north: f64| scene.measurement_nt[0] - north_of(&scene, north);
        let j = |north: f64| (north / sigma_m).powi(2) / 2.0 + residual_nt(north).powi(2) / variance / 2.0;
        // On the slope that contains the start, where J has one minimum.
        let (mut low, mut high) = (-600.0, 600.0);
        for _ in 0..200 {
            let (a, b) = (low + (high - low) * 0.382, low + (high - low) * 0.618);
            if j(a) < j(b) { high = b } else { low = a }
        }
        let north = (output.line.lat_deg[0] - scene.columns[1][0]) * m_per_deg().0;
        // With a remaining residual and curvature, the iteration converges linearly; the error is a few times the last
        // step.
        assert!((north - low).abs() < 1e-2, "{offset_m} {north} {low}");
    }
}

/// Map value at `north_m` metres north of the first sample of a scene.
fn north_of(scene: &AnalyticScene, north_m: f64) -> f64 {
    let lat_deg = scene.columns[1][0] + north_m / m_per_deg().0;
    scene.map.at(lat_deg, scene.columns[2][0], 500.0).unwrap().value_nt
}

#[test]
fn law_on_a_curved_map_with_a_large_error_it_is_more_accurate_than_the_extended_kalman_filter() {
    // The slope northward is 0.25 nT/m at the first sample, and changes by 0.05 nT/m in 100 m.
    let field = |north: f64, _: f64| 0.5 * north + 2.5e-4 * north * north;
    let mut normals = NormalGenerator::new(3);
    let (mut ours, mut theirs, runs) = ([0.0; 2], [0.0; 2], 40);
    for _ in 0..runs {
        let mut scene = AnalyticScene::new(&uneven(20), MapInterpolation::Cubic, field);
        scene.errors.sources.init_position_sigma_m = 150.0;
        scene.errors.fogm_sigma_nt = 0.5;
        scene.sigma_nt.fill(1.0);
        let offset_deg = 150.0 * normals.draw() / m_per_deg().0;
        for row in 0..20 {
            let (lat, lon) = (scene.columns[1][row] + offset_deg, scene.columns[2][row]);
            scene.measurement_nt[row] = scene.map.at(lat, lon, 500.0).unwrap().value_nt + normals.draw();
        }
        let (iterated, extended) = (filtered(&scene, &all(10)).line, ekf(&scene, None));
        for (at, row) in [0, 19].into_iter().enumerate() {
            let square_m2 = |output: &NavigationOutput| {
                ((output.lat_deg[row] - scene.columns[1][row] - offset_deg) * m_per_deg().0).powi(2) / f64::from(runs)
            };
            ours[at] += square_m2(&iterated);
            theirs[at] += square_m2(&extended);
        }
    }
    let (ours, theirs) = (ours.map(f64::sqrt), theirs.map(f64::sqrt));
    println!("rms north of samples 0 and 19: iterated {ours:.1?} m, extended {theirs:.1?} m");
    // 1.1 nT at a slope of 0.25 nT/m correspond to 4.5 m. With linearisation 150 m away, the field has an error of 6
    // nT, and the slope has an error of a third.
    assert!(ours[0] < 0.4 * theirs[0] && ours[1] < theirs[1], "{ours:?} {theirs:?}");
}

#[test]
fn law_no_result_is_less_probable_than_the_prediction() {
    // Near the crest of a wave, at 628 m, the slope is nearly zero, and a full step is kilometres long.
    let mut halved = 0;
    let mut scene = AnalyticScene::new(&[0.0], MapInterpolation::Cubic, wave);
    scene.errors.sources.init_position_sigma_m = 5000.0;
    for start_m in [560.0, 600.0, 620.0, 650.0, 700.0] {
        let north_deg = start_m / m_per_deg().0;
        scene.columns[1][0] += north_deg;
        scene.measurement_nt[0] = -150.0;
        let output = filtered(&scene, &all(5));
        let moved_m = (output.line.lat_deg[0] - scene.columns[1][0]) * m_per_deg().0;
        let j = |north: f64, s: f64| {
            let residual = -150.0 - north_of(&scene, north) - s;
            (north / 5000.0).powi(2) + (s / 3.0).powi(2) + residual.powi(2) / 25.0
        };
        assert!(j(moved_m, output.line.x[0][S]) <= j(0.0, 0.0) + 1e-9, "{start_m} {moved_m}");
        scene.columns[1][0] -= north_deg;
        halved += output.iterations.halved;
    }
    assert!(halved > 0, "steps that need no halving test nothing");
}

#[test]
fn unit_irregular_samples_are_predicted_and_counted() {
    let mut scene = AnalyticScene::new(&uneven(20), MapInterpolation::Cubic, hills);
    for row in [0, 4, 5] {
        scene.measurement_nt[row] = f64::NAN;
    }
    scene.measurement_nt[6] = f64::INFINITY;
    scene.sigma_nt[7] = 0.0;
    scene.sigma_nt[8] = -1.0;
    scene.columns[1][10] += 1.0;
    let output = filtered(&scene, &IekfParameters::default());
    let report = output.line.report;
    assert_eq!((report.updates, report.missing_measurements, report.off_map), (13, 6, 1));
    for row in [0, 4, 5, 6, 7, 8, 10] {
        assert!(output.line.residual_nt[row].is_nan() && output.line.sd_n_m[row].is_finite());
    }
    let flat = AnalyticScene::new(&uneven(20), MapInterpolation::Linear, |_, _| 7.0);
    let last = filtered(&flat, &IekfParameters::default()).line.x[19];
    assert!(last[..S].iter().all(|x| *x == 0.0) && last[S] != 0.0);
    let single = AnalyticScene::new(&[0.0], MapInterpolation::Linear, plane);
    assert_eq!(filtered(&single, &IekfParameters::default()).line.report.updates, 1);
}

#[test]
fn unit_invalid_lines_and_parameters_are_rejected() {
    assert_refusals(|scene| scene.with(|line| run(line, &IekfParameters::default())).err());
    let scene = AnalyticScene::new(&[0.0], MapInterpolation::Linear, plane);
    let message = |parameters: &IekfParameters| scene.with(|line| run(line, parameters)).unwrap_err().to_string();
    let good = IekfParameters::default();
    assert_eq!(message(&IekfParameters { iterations: 0, ..good }), "`iterations` must be above 0, not 0");
    assert_eq!(message(&IekfParameters { tolerance_m: -1.0, ..good }), "`tolerance_m` must be above 0, not -1");
    assert_eq!(message(&IekfParameters { gate_nis: Some(0.0), ..good }), "`gate_nis` must be above 0, not 0");
}

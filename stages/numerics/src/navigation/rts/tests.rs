#![allow(clippy::unwrap_used)]
use super::*;
use crate::maps::map_surface::MapInterpolation;
use crate::navigation::ekf::{self, EkfParameters};
use crate::navigation::pinson::STATES;
use crate::navigation::scenes::{
    AnalyticScene, DenseBatchSmoother, DenseStateMatrix, assert_close, assert_refusals, dense, hills, m_per_deg, plane,
    positions, uneven,
};
use crate::navigation::transition::NoiseDiscretisation;

fn all() -> RtsParameters {
    RtsParameters { keep_covariance: true, ..RtsParameters::default() }
}

fn smoothed(scene: &AnalyticScene, parameters: &RtsParameters) -> RtsOutput {
    scene.with(|line| run(line, parameters)).unwrap()
}

/// Dense solution after `iterations` iterations.
fn batch(scene: &AnalyticScene, loss: RobustLoss, iterations: usize) -> DenseBatchSmoother {
    scene.with(|line| {
        let mut batch = DenseBatchSmoother::new(line);
        batch.solve(line, |_| 1.0);
        for _ in 1..iterations {
            batch.solve(line, |r| loss.weight(r));
        }
        batch
    })
}

/// Line longer than two blocks of the backward pass, with gaps.
fn gaps(interpolation: MapInterpolation, field_nt: fn(f64, f64) -> f64) -> AnalyticScene {
    let mut scene = AnalyticScene::new(&uneven(150), interpolation, field_nt);
    for row in [0, 17, 18, 63, 64, 100, 149] {
        scene.measurement_nt[row] = f64::NAN;
    }
    scene
}

#[test]
fn law_on_a_plane_every_state_equals_dense_least_squares() {
    for noise in [NoiseDiscretisation::Trapezoidal, NoiseDiscretisation::Rectangular, NoiseDiscretisation::VanLoan] {
        let mut scene = gaps(MapInterpolation::Linear, plane);
        scene.errors.noise = noise;
        let output = smoothed(&scene, &all());
        let batch = batch(&scene, RobustLoss::new(TrajectoryLoss::None, None), 1);
        for row in 0..150 {
            // The dense solution loses four of sixteen digits because of the condition number of the matrix. If
            // smoothing reduces the prior variance little, the difference loses more digits.
            let found = (&output.line.x[row], &output.line.p[row]);
            assert_close(found.0, found.1, (&batch.x[row], &batch.p[row]), 1e-6, &format!("{noise:?} row {row}"));
            let north_m = 6_378_137.0 * batch.p[row][(LAT, LAT)].sqrt();
            // The meridian radius is 0.2 % smaller here.
            assert!((output.line.sd_n_m[row] / north_m - 1.0).abs() < 0.003);
        }
        assert!(output.iterations.converged && output.iterations.passes == 2, "{:?}", output.iterations);
    }
}

#[test]
fn law_on_a_curved_map_it_equals_the_dense_minimum_with_every_loss() {
    let mut scene = gaps(MapInterpolation::Cubic, hills);
    for row in [30, 31, 90] {
        scene.measurement_nt[row] += 40.0;
    }
    for loss in [TrajectoryLoss::None, TrajectoryLoss::Huber, TrajectoryLoss::Cauchy] {
        let parameters = RtsParameters { tolerance_m: 1e-4, loss, iterations: 60, ..all() };
        let output = smoothed(&scene, &parameters);
        assert!(output.iterations.converged, "{loss:?} {:?}", output.iterations);
        let robust = RobustLoss::new(loss, None);
        let batch = batch(&scene, robust, 60);
        for row in 0..150 {
            // The uncertainty of positions is at least 10 m, so the last step is 1e-5 of this uncertainty. The
            // reweighting converges linearly, and its error is a few times the last step.
            let found = (&output.line.x[row], &output.line.p[row]);
            assert_close(found.0, found.1, (&batch.x[row], &batch.p[row]), 1e-4, &format!("{loss:?} row {row}"));
        }
        let cost = scene.with(|line| {
            let mut field = line.predicted();
            let mut cost = 0.5 * batch.motion;
            for row in 0..150 {
                let (Some((measured, variance)), x) = (line.measured(row, 0.0), batch.x[row]) else { continue };
                let value = field.at_error(line.ins, row, [x[LAT], x[LON], x[ALT]]).unwrap().value_nt;
                cost += robust.value((measured - value - x[S]) / variance.sqrt());
            }
            cost
        });
        // J is flat at its minimum: a change of the state by 1e-4 standard deviations changes J by 1e-8.
        assert!((output.iterations.cost / cost - 1.0).abs() < 1e-7, "{loss:?} {} {cost}", output.iterations.cost);
    }
}

#[test]
fn law_with_aiding_positions_it_equals_the_dense_minimum() {
    let mut scene = gaps(MapInterpolation::Cubic, hills);
    scene.fixes = Some(positions(&scene.columns));
    let output = smoothed(&scene, &RtsParameters { tolerance_m: 1e-4, iterations: 60, ..all() });
    assert!(output.iterations.converged, "{:?}", output.iterations);
    let batch = batch(&scene, RobustLoss::new(TrajectoryLoss::None, None), 60);
    for row in 0..150 {
        let found = (&output.line.x[row], &output.line.p[row]);
        assert_close(found.0, found.1, (&batch.x[row], &batch.p[row]), 1e-4, &format!("row {row}"));
    }
    let cost = scene.with(|line| {
        let (mut field, mut cost) = (line.predicted(), 0.5 * batch.motion);
        for (row, x) in batch.x.iter().enumerate() {
            for fix in line.fixes_at(row).into_iter().flatten() {
                cost += 0.5 * (fix.error - x[fix.state]).powi(2) / fix.variance;
            }
            let Some((measured, variance)) = line.measured(row, 0.0) else { continue };
            let value = field.at_error(line.ins, row, [x[LAT], x[LON], x[ALT]]).unwrap().value_nt;
            cost += 0.5 * (measured - value - x[S]).powi(2) / variance;
        }
        cost
    });
    assert!((output.iterations.cost / cost - 1.0).abs() < 1e-7, "{} {cost}", output.iterations.cost);
    // Without positions the result differs.
    scene.fixes = None;
    let alone = smoothed(&scene, &all());
    assert!(alone.line.sd_n_m[75] > 1.02 * output.line.sd_n_m[75]);
}

#[test]
fn law_the_cost_never_rises() {
    // Waves with a length of a few times the initial error.
    let field = |north: f64, east: f64| 200.0 * (north / 300.0).sin() + 150.0 * (east / 250.0).cos();
    let mut halved = 0;
    for interpolation in [MapInterpolation::Cubic, MapInterpolation::Linear] {
        for shift in 0..6 {
            let mut scene = AnalyticScene::new(&uneven(70), interpolation, field);
            let north_deg = (60.0 * f64::from(shift) - 150.0) / m_per_deg().0;
            scene.columns[1].iter_mut().for_each(|lat| *lat += north_deg);
            scene.errors.sources.init_position_sigma_m = 150.0;
            let mut last = f64::INFINITY;
            // These limits apply to all first passes.
            for iterations in 5..14 {
                let output = smoothed(&scene, &RtsParameters { iterations, ..RtsParameters::default() });
                let report = output.iterations;
                // J of the process noise accumulates rounding from step to step.
                assert!(report.cost <= last * (1.0 + 1e-9), "{shift} {iterations} {} {last}", report.cost);
                last = report.cost;
                halved += report.halved;
                assert!(report.passes <= iterations);
            }
        }
    }
    assert!(halved > 0, "a map that never needs a shorter step tests nothing");
}

#[test]
fn law_covariances_are_symmetric_positive_and_at_most_those_of_the_filter() {
    let mut scene = gaps(MapInterpolation::Cubic, hills);
    scene.sigma_nt.fill(0.05);
    scene.errors.sources.init_altitude_sigma_m = 0.0;
    let output = smoothed(&scene, &all());
    for p in &output.line.p {
        let p = dense(p);
        assert_eq!(p, p.transpose());
        assert!((0..STATES).all(|state| p[(state, state)] >= 0.0));
        let sigma: [f64; STATES] = std::array::from_fn(|state| p[(state, state)].sqrt().max(1e-300));
        let correlation = DenseStateMatrix::from_fn(|row, column| p[(row, column)] / sigma[row] / sigma[column]);
        // A difference from the filter's covariance, which is up to 1e6 times as large in one direction.
        let smallest = correlation.symmetric_eigenvalues().min();
        assert!(smallest > -1e-8, "{smallest:e}");
    }
}

#[test]
fn law_the_last_sample_and_the_innovations_equal_those_of_the_filter() {
    let scene = AnalyticScene::new(&uneven(150), MapInterpolation::Linear, plane);
    let parameters = EkfParameters { errors: scene.errors, ..EkfParameters::default() };
    let filter = ekf::run(&parameters, &scene.series(), &scene.measurement_nt, &scene.map, None).unwrap();
    let output = smoothed(&scene, &RtsParameters::default()).line;
    for state in 0..STATES {
        let size = filter.x[149][state].abs();
        assert!((output.x[149][state] - filter.x[149][state]).abs() <= 1e-7 * size, "{state}");
    }
    assert!((output.sd_n_m[149] / filter.sd_n_m[149] - 1.0).abs() < 1e-9);
    for row in 0..150 {
        assert!((output.residual_nt[row] - filter.residual_nt[row]).abs() < 1e-7, "{row}");
        assert!((output.nis[row] - filter.nis[row]).abs() < 1e-7, "{row}");
        // Only north is observed: the plane has a slope in one direction.
        assert!(output.sd_n_m[row] <= filter.sd_n_m[row] * (1.0 + 1e-9), "{row}");
    }
}

#[test]
fn unit_irregular_samples_are_smoothed_and_counted() {
    let mut scene = AnalyticScene::new(&uneven(80), MapInterpolation::Cubic, hills);
    let clean = smoothed(&scene, &RtsParameters::default()).line;
    for row in [0, 4, 5] {
        scene.measurement_nt[row] = f64::NAN;
    }
    scene.measurement_nt[6] = f64::INFINITY;
    scene.sigma_nt[7] = -1.0;
    // 90 km off the map.
    scene.columns[1][70] += 0.8;
    let output = smoothed(&scene, &RtsParameters::default());
    let report = output.line.report;
    assert_eq!((report.updates, report.missing_measurements, report.off_map), (74, 5, 1));
    for row in [0, 4, 5, 6, 7, 70] {
        assert!(output.line.residual_nt[row].is_nan() && output.line.nis[row].is_nan());
        assert!(output.line.sd_n_m[row].is_finite() && output.line.lat_deg[row].is_finite());
        assert!(output.line.sd_n_m[row] > clean.sd_n_m[row], "{row}");
    }
    assert!(output.iterations.converged);
}

#[test]
fn law_without_measurements_the_output_is_the_ins() {
    let mut scene = AnalyticScene::new(&uneven(80), MapInterpolation::Cubic, hills);
    scene.measurement_nt.fill(f64::NAN);
    let output = smoothed(&scene, &RtsParameters::default());
    assert_eq!(output.line.lat_deg, scene.columns[1]);
    assert!(output.line.sd_n_m.windows(2).all(|pair| pair[1] >= pair[0]));
    assert_eq!((output.iterations.cost, output.iterations.converged), (0.0, true));
}

#[test]
fn law_a_single_sample_equals_the_iterated_filter() {
    let scene = AnalyticScene::new(&[0.0], MapInterpolation::Cubic, hills);
    let output = smoothed(&scene, &RtsParameters { tolerance_m: 1e-6, ..RtsParameters::default() });
    let parameters =
        crate::navigation::iekf::IekfParameters { iterations: 30, tolerance_m: 1e-6, ..Default::default() };
    let filter = scene.with(|line| crate::navigation::iekf::run(line, &parameters)).unwrap();
    assert!((output.line.lat_deg[0] - filter.line.lat_deg[0]).abs() * 1.1e5 < 1e-5);
    assert!((output.line.sd_n_m[0] / filter.line.sd_n_m[0] - 1.0).abs() < 1e-6);
}

#[test]
fn law_a_flat_map_corrects_only_the_temporal_variation() {
    let mut scene = AnalyticScene::new(&uneven(80), MapInterpolation::Linear, |_, _| 7.0);
    scene.measurement_nt.fill(11.0);
    let output = smoothed(&scene, &RtsParameters::default()).line;
    assert!(output.x.iter().all(|x| x[..S].iter().all(|x| *x == 0.0) && x[S] > 2.0));
}

#[test]
fn unit_a_single_pass_is_reported_as_unconverged() {
    let scene = AnalyticScene::new(&uneven(80), MapInterpolation::Cubic, hills);
    let report = smoothed(&scene, &RtsParameters { iterations: 1, ..RtsParameters::default() }).iterations;
    assert!(!report.converged && report.passes == 1 && report.last_step_m.is_infinite());
}

#[test]
fn unit_invalid_lines_and_parameters_are_rejected() {
    assert_refusals(|scene| scene.with(|line| run(line, &RtsParameters::default())).err());
    let scene = AnalyticScene::new(&[0.0], MapInterpolation::Linear, plane);
    let message = |parameters: &RtsParameters| scene.with(|line| run(line, parameters)).unwrap_err().to_string();
    let good = RtsParameters::default();
    assert_eq!(message(&RtsParameters { iterations: 0, ..good }), "`iterations` must be above 0, not 0");
    assert_eq!(message(&RtsParameters { loss_scale: Some(0.0), ..good }), "`loss_scale` must be above 0, not 0");
}

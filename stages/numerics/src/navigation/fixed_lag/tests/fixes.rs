//! Aiding positions, compared to dense least squares and to a filter of the INS and positions alone.
#![allow(clippy::unwrap_used)]

use crate::maps::MapInterpolation;
use crate::navigation::loss::TrajectoryLoss;
use crate::navigation::scenes::{AnalyticScene, DenseBatchSmoother, assert_close, plane, positions, uneven};
use crate::navigation::{NavigationLine, ins_only};

use super::super::{FixedLagMagnetometer, FixedLagOptions, FixedLagOutput, FixedLagParameters, FixedLagUsage, run};

const ROWS: usize = 60;

/// Scene with positions at every seventh sample; without field measurements if `blind`.
fn scene(blind: bool) -> AnalyticScene {
    let mut scene = AnalyticScene::new(&uneven(ROWS), MapInterpolation::Linear, plane);
    scene.measurement_nt[20..if blind { ROWS } else { 35 }].fill(f64::NAN);
    if blind {
        scene.measurement_nt.fill(f64::NAN);
    }
    scene.fixes = Some(positions(&scene.columns));
    scene
}

fn smoothed(line: &NavigationLine<'_>, parameters: FixedLagParameters) -> FixedLagOutput {
    let keep = FixedLagOptions { states: true, covariance: true };
    run(&parameters, line, &[FixedLagMagnetometer::of_line(line)], keep).unwrap()
}

/// Parameters without averaging of measurements.
fn parameters(window_s: f64, overlap: f64, lag_s: f64) -> FixedLagParameters {
    FixedLagParameters { window_s, overlap, lag_s, measurement_interval_s: 0.0, ..FixedLagParameters::default() }
}

#[test]
fn law_positions_with_and_without_the_field_give_the_least_squares_solution() {
    for blind in [false, true] {
        scene(blind).with(|line| {
            let mut batch = DenseBatchSmoother::new(line);
            batch.solve(line, |_| 1.0);
            let found = smoothed(line, parameters(1000.0, 0.0, 1000.0));
            for row in 0..ROWS {
                let (x, p) = (&found.navigation.x[row], &found.navigation.p[row]);
                assert_close(x, p, (&batch.x[row], &batch.p[row]), 1e-6, &format!("blind {blind}, {row}"));
            }
            let missing = found.usage.iter().filter(|usage| **usage == FixedLagUsage::Missing).count();
            assert_eq!(missing, if blind { ROWS } else { 15 });
            // The loss applies only to residuals of the field.
            let huber =
                FixedLagParameters { loss: TrajectoryLoss::Huber, loss_scale: 0.1, ..parameters(1000.0, 0.0, 1000.0) };
            let robust = smoothed(line, huber);
            let same = robust.navigation.x == found.navigation.x;
            assert_eq!(same, blind, "a scale of a tenth of a sigma cuts the noise of the field");
        });
    }
}

#[test]
fn law_at_zero_lag_it_equals_the_filter_for_any_window() {
    scene(true).with(|line| {
        let filter = ins_only::run(line.ins, &line.errors, line.fixes).unwrap();
        for (window_s, overlap) in [(1000.0, 0.0), (12.0, 0.5), (15.0, 0.8)] {
            let found = smoothed(line, parameters(window_s, overlap, 0.0)).navigation;
            for row in 0..ROWS {
                let off_m = 111_000.0 * (found.lat_deg[row] - filter.lat_deg[row]).abs();
                assert!(off_m < 1e-6 * filter.sd_n_m[row], "{window_s} {overlap} {row}: {off_m}");
                assert!((found.sd_n_m[row] / filter.sd_n_m[row] - 1.0).abs() < 1e-6, "{window_s} {overlap} {row}");
                assert!((found.sd_e_m[row] / filter.sd_e_m[row] - 1.0).abs() < 1e-6, "{window_s} {overlap} {row}");
            }
        }
    });
}

#[test]
fn law_positions_within_an_interval_count_at_their_own_time() {
    scene(true).with(|line| {
        let mut batch = DenseBatchSmoother::new(line);
        batch.solve(line, |_| 1.0);
        let every = FixedLagParameters { measurement_interval_s: 3.0, ..parameters(1000.0, 0.0, 1000.0) };
        let found = smoothed(line, every);
        // The noise of the INS within three seconds is neglected.
        assert_close(
            &found.navigation.x[ROWS - 1],
            &found.navigation.p[ROWS - 1],
            (&batch.x[ROWS - 1], &batch.p[ROWS - 1]),
            0.02,
            "last",
        );
        assert_close(&found.navigation.x[0], &found.navigation.p[0], (&batch.x[0], &batch.p[0]), 0.02, "first");
    });
}

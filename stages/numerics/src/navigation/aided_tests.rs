#![allow(clippy::unwrap_used)]
//! Aiding positions in every filter that accepts them.

use super::adaptive::{self, AdaptiveNoise, AdaptiveParameters};
use super::ekf::{self, EkfInput, EkfParameters};
use super::iekf::{self, IekfParameters};
use super::ins_only;
use super::line::NavigationLine;
use super::online::{self, LineModel, OnlineParameters};
use super::output::NavigationOutput;
use super::pinson::STATES;
use super::scenes::{AnalyticScene, DenseBatchSmoother, assert_close, hills, plane, positions, uneven};
use super::ukf::{self, UkfParameters};
use crate::maps::map_surface::MapInterpolation;

fn aided(field_nt: fn(f64, f64) -> f64) -> AnalyticScene {
    let mut scene = AnalyticScene::new(&uneven(90), MapInterpolation::Linear, field_nt);
    scene.measurement_nt[40..60].fill(f64::NAN);
    scene.fixes = Some(positions(&scene.columns));
    scene
}

fn by_ekf(line: &NavigationLine<'_>) -> NavigationOutput {
    let parameters =
        EkfParameters { errors: line.errors, keep_states: true, keep_covariance: true, ..EkfParameters::default() };
    let point = EkfInput {
        parameters: &parameters,
        measurement_nt: line.measurement_nt,
        sigma_nt: Some(line.sigma_nt),
        fixes: line.fixes,
        map: line.map,
        core: line.core,
    };
    ekf::run_together(line.ins, &[point]).pop().unwrap().unwrap()
}

fn by_iekf(line: &NavigationLine<'_>) -> NavigationOutput {
    iekf::run(line, &IekfParameters { iterations: 1, keep_covariance: true, ..IekfParameters::default() }).unwrap().line
}

fn by_ukf(line: &NavigationLine<'_>) -> NavigationOutput {
    let parameters = UkfParameters { keep_states: true, keep_covariance: true, ..UkfParameters::default() };
    ukf::run(&parameters, line).unwrap().navigation
}

/// The bounds keep the estimated noise at its assumed value.
fn by_adaptive(line: &NavigationLine<'_>) -> NavigationOutput {
    let parameters = AdaptiveParameters {
        adapt: AdaptiveNoise::R,
        keep_states: true,
        keep_covariance: true,
        ..AdaptiveParameters::default()
    };
    let magnetometer = adaptive::AdaptiveMagnetometer::from_line(line, 5.0, 5.0);
    adaptive::run(&parameters, line, &[magnetometer]).unwrap().navigation
}

fn by_online(line: &NavigationLine<'_>) -> NavigationOutput {
    let prior = online::CoefficientPrior { mean: vec![], covariance: vec![] };
    let magnetometer = online::OnlineMagnetometer {
        measurement_nt: line.measurement_nt,
        sigma_nt: line.sigma_nt,
        terms: &[],
        prior: &prior,
        walk_density: &[],
    };
    let parameters = OnlineParameters { keep_states: true, keep_covariance: true, ..OnlineParameters::default() };
    online::run(&LineModel::from_line(line), &[magnetometer], None, &parameters).unwrap().navigation
}

type ByFilter = fn(&NavigationLine<'_>) -> NavigationOutput;

#[test]
fn law_every_filter_ends_at_dense_least_squares_on_a_plane() {
    let scene = aided(plane);
    let filters: [(&str, ByFilter); 5] =
        [("ekf", by_ekf), ("iekf", by_iekf), ("ukf", by_ukf), ("adaptive", by_adaptive), ("online", by_online)];
    scene.with(|line| {
        let mut batch = DenseBatchSmoother::new(line);
        batch.solve(line, |_| 1.0);
        for (name, run) in filters {
            let output = run(line);
            // The dense solution loses four of sixteen digits.
            assert_close(&output.x[89], &output.p[89], (&batch.x[89], &batch.p[89]), 1e-6, name);
        }
    });
}

#[test]
fn law_an_ins_with_aiding_positions_equals_the_ekf_without_measurements() {
    let mut scene = aided(hills);
    scene.measurement_nt.fill(f64::NAN);
    scene.with(|line| {
        let (alone, ekf) = (ins_only::run(line.ins, &line.errors, line.fixes).unwrap(), by_ekf(line));
        for row in 0..90 {
            let difference_m = 111_000.0 * (alone.lat_deg[row] - ekf.lat_deg[row]).abs();
            assert!(difference_m < 1e-7 && (alone.sd_n_m[row] / ekf.sd_n_m[row] - 1.0).abs() < 1e-9);
        }
        let free = ins_only::run(line.ins, &line.errors, None).unwrap();
        assert!(free.sd_n_m[89] > 3.0 * alone.sd_n_m[89], "{} {}", free.sd_n_m[89], alone.sd_n_m[89]);
        assert_eq!(STATES, ekf.x[0].len());
    });
}

#[test]
fn unit_positions_of_another_length_are_rejected() {
    let mut scene = aided(plane);
    scene.fixes.as_mut().unwrap().lon_deg.pop();
    let fault = scene.with(|line| line.check()).unwrap_err().to_string();
    assert!(fault.contains("fix longitude"), "{fault}");
}

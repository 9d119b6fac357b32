//! Tests with aiding positions.

use crate::navigation::ins_only;
use crate::navigation::position_fixes::PositionFixes;

use super::*;

/// GNSS positions of a flight with noise of `sigma_m`, at every `every`-th row for which `there` is true.
fn gnss(flight: &Flight, sigma_m: f64, every: usize, there: impl Fn(usize) -> bool) -> PositionFixes {
    let (mut normals, truth) = (crate::random::NormalGenerator::new(77), &flight.truth.columns);
    let mut of = |column: usize, m_per_unit: f64| -> Vec<f64> {
        let mut at = |(row, value): (usize, &f64)| {
            let noise = sigma_m * normals.draw() / m_per_unit;
            if row % every == 0 && there(row) { value + noise } else { f64::NAN }
        };
        truth[column].iter().enumerate().map(&mut at).collect()
    };
    PositionFixes {
        lat_deg: of(1, flights::M_PER_DEG.0),
        lon_deg: of(2, flights::M_PER_DEG.1),
        alt_m: of(3, 1.0),
        horizontal_sigma_m: sigma_m,
        vertical_sigma_m: sigma_m,
    }
}

fn aided(flight: &Flight, parameters: &SlamParameters, fixes: Option<&PositionFixes>) -> SlamOutput {
    let ins = flight.ins.series();
    let (measurement_nt, sigma_nt) = (flight.measured_nt.as_slice(), flight.sigma_nt.as_slice());
    let line = SlamLine { ins: &ins, measurement_nt, sigma_nt, core: None, fixes, errors: flight.model };
    run(parameters, &line).unwrap()
}

#[test]
fn law_positions_without_the_field_give_the_kalman_filter() {
    // Rows of 0.5 s in steps of 1 s, so that fixes occur at and between the draws. GNSS is lost from 100 to 200 s, and
    // returns when the position error of the INS alone is tens of metres.
    let mut flight = Flight::tactical(loiter(ROUGH_DEG, 600, 0.5), 3);
    flight.measured_nt.fill(f64::NAN);
    let fixes = gnss(&flight, 5.0, 3, |row| !(200..400).contains(&row));
    let parameters = SlamParameters { particles: 200, ..quick() };
    let output = aided(&flight, &parameters, Some(&fixes));
    let (slam, exact) = (&output.navigation, ins_only::run(&flight.ins.series(), &flight.model, Some(&fixes)).unwrap());
    for row in 0..600 {
        let apart_m = [
            (slam.lat_deg[row] - exact.lat_deg[row]) * flights::M_PER_DEG.0,
            (slam.lon_deg[row] - exact.lon_deg[row]) * flights::M_PER_DEG.1,
            slam.alt_m[row] - exact.alt_m[row],
            slam.sd_n_m[row] - exact.sd_n_m[row],
            slam.sd_e_m[row] - exact.sd_e_m[row],
        ];
        assert!(apart_m.iter().all(|apart_m| apart_m.abs() < 1e-6), "{row} {apart_m:?}");
    }
    assert!(exact.sd_n_m[399] > 5.0 * exact.sd_n_m[199], "{} {}", exact.sd_n_m[399], exact.sd_n_m[199]);
}

#[test]
fn law_positions_of_particles_are_draws_of_the_kalman_filter() {
    // The field exists and is steep, but no position is revisited, so every position of the map is a draw.
    let flight = Flight::tactical(loiter(ROUGH_DEG, 50, 1.0), 3);
    let fixes = gnss(&flight, 5.0, 1, |_| true);
    let particles = 2000;
    let output = aided(&flight, &SlamParameters { particles, resample_below: 0.0, ..quick() }, Some(&fixes));
    let exact = ins_only::run(&flight.ins.series(), &flight.model, Some(&fixes)).unwrap();
    assert_eq!((output.report.revisits, output.path.len()), (0, 50));
    // Last positions, which no later fix affects.
    let last = &output.path[49];
    let sd_m = exact.sd_n_m[49].hypot(exact.sd_e_m[49]);
    let apart_m = ((last.lat_deg - exact.lat_deg[49]) * flights::M_PER_DEG.0)
        .hypot((last.lon_deg - exact.lon_deg[49]) * flights::M_PER_DEG.1);
    println!("{apart_m} {sd_m} {} {}", last.spread_m, output.effective[49]);
    // The limits are four standard errors of the mean and of the standard deviation, for this effective number of
    // draws.
    let of_mean = 1.0 / output.effective[49].sqrt();
    assert!(apart_m < 4.0 * sd_m * of_mean && (last.spread_m / sd_m - 1.0).abs() < 4.0 * of_mean);
}

#[test]
fn law_a_lap_with_gnss_anchors_the_track() {
    let mut squares = [0.0; 2];
    for seed in 0..3 {
        let flight = Flight::tactical(loiter(ROUGH_DEG, 700, 1.0), seed);
        let parameters = SlamParameters { particles: 300, ..SlamParameters::default() };
        // A lap takes 130 s.
        let fixes = gnss(&flight, 2.0, 1, |row| row < 150);
        let (with, without) = (aided(&flight, &parameters, Some(&fixes)), aided(&flight, &parameters, None));
        let kalman = ins_only::run(&flight.ins.series(), &flight.model, Some(&fixes)).unwrap();
        let last = flight.errors.len() - 1;
        let ends = |out: &NavigationOutput| {
            let t = &flight.truth.columns;
            let north = (out.lat_deg[last] - t[1][last]) * flights::M_PER_DEG.0;
            north.hypot((out.lon_deg[last] - t[2][last]) * flights::M_PER_DEG.1)
        };
        let (aided_m, ins_m) = (ends(&with.navigation), ends(&kalman));
        println!("seed {seed}: at the end {aided_m:.1} m, INS with GNSS {ins_m:.1} m");
        println!("DRMS {:.1} m, {:.1} m", flight.drms_m(Some(&without)), flight.drms_m(Some(&with)));
        assert!(aided_m < 0.5 * ins_m && flight.drms_m(Some(&with)) < 50.0);
        squares[0] += flight.drms_m(Some(&with)).powi(2);
        squares[1] += flight.drms_m(Some(&without)).powi(2);
    }
    assert!(squares[0] < 0.8 * squares[1], "{squares:?}");
}

#[test]
fn law_returning_gnss_recovers_lost_particles() {
    let mut flight = Flight::tactical(loiter(ROUGH_DEG, 700, 1.0), 5);
    flight.measured_nt.fill(f64::NAN);
    let fixes = gnss(&flight, 2.0, 1, |row| row > 650);
    for particles in [50, 300] {
        let output = aided(&flight, &SlamParameters { particles, ..quick() }, Some(&fixes));
        let [n, e] = flight.error_m(Some(&output), 699);
        println!("{particles}: {:?} -> {n:.1} {e:.1} m", flight.error_m(None, 650));
        assert!(n.hypot(e) < 6.0 * output.navigation.sd_n_m[699].hypot(output.navigation.sd_e_m[699]).max(1.0));
    }
}

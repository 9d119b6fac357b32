//! Uncompensated cabin magnetometers from a cold start: consistency of the smoother, and error of the smoother where an
//! online filter diverges.

use crate::navigation::PredictedField;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES};
use crate::signal::gauss_markov::GaussMarkov;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::time::Instant;

use super::super::nodes::LineNodeBuilder;
use super::super::{AircraftCoefficients, FixedLagMagnetometer, FixedLagOutput, FixedLagParameters};
use super::flights::{Flight, Left, fly};
use crate::navigation::gaussian::StateLayout;

const EPOCHS: [usize; 5] = [300, 675, 1050, 1425, 1799];

/// A third of the default number of windows.
fn fewer() -> FixedLagParameters {
    FixedLagParameters { overlap: 0.85, ..FixedLagParameters::default() }
}

/// Smooths the flight with its actual error model.
fn smoothed(flight: &Flight) -> FixedLagOutput {
    flight.smoothed(&fewer(), flight.left)
}

/// Means over flights: NEES of the position per degree of freedom over all epochs, NEES of the coefficients per degree
/// of freedom at the end, and NIS.
fn consistency(left: Left, flights: u64) -> (f64, f64, f64) {
    let of = |seed: u64| {
        let flight = fly(seed, 1800, 1.0, 1, left);
        let output = smoothed(&flight);
        let position: f64 = EPOCHS.iter().map(|row| flight.nees(&output, *row)).sum();
        let p = DMatrix::from_row_slice(flight.terms, flight.terms, &output.coefficient_covariance);
        let e = DVector::from_iterator(
            flight.terms,
            output.coefficients.iter().zip(&flight.truth[0]).map(|(found, truth)| found - truth),
        );
        let coefficients = e.dot(&p.cholesky().unwrap().solve(&e)) / flight.terms as f64;
        assert_eq!((output.inconsistent(), output.unconverged()), (0, 0), "{left:?} {seed}");
        let nis = output.navigation.nis.iter().sum::<f64>() / 1800.0;
        [position / (2.0 * EPOCHS.len() as f64), coefficients, nis]
    };
    let all: Vec<[f64; 3]> = (0..flights).into_par_iter().map(of).collect();
    let mean = |k: usize| all.iter().map(|one| one[k]).sum::<f64>() / flights as f64;
    (mean(0), mean(1), mean(2))
}

#[test]
fn law_a_cold_start_is_consistent() {
    let flights = 10;
    for left in [Left::White, Left::Drift] {
        let (position, coefficients, nis) = consistency(left, flights);
        println!("{left:?}: NEES a degree, position {position:.2}, coefficients {coefficients:.2}; NIS {nis:.3}");
        // The mean of 100 values of chi-square with one degree of freedom, from correlated neighbouring epochs, has a
        // 99.9 % band of ±3.29 √(2/100) = ±0.47.
        assert!((position - 1.0).abs() < 0.47, "{left:?} {position}");
        // The band for 190 values is ±0.34.
        assert!((coefficients - 1.0).abs() < 0.34, "{left:?} {coefficients}");
        // The band for 18,000 values is ±0.035. The limit allows half of that in addition, for the linearisation.
        assert!((nis - 1.0).abs() < 0.05, "{left:?} {nis}");
    }
}

#[test]
fn law_it_converges_where_an_online_filter_diverges() {
    const SEEDS: [u64; 4] = [0, 1, 3, 4];
    // Drift, and steps of the current, which neither filter models. The smoother assumes some slow error.
    let expected = GaussMarkov { sigma: 36.0, tau_s: 200.0 };
    let flown = |seed: u64| {
        let flight = fly(seed, 3600, 1.0, 1, Left::Steps);
        let output = flight.smoothed(&fewer(), expected);
        [
            flight.drms_m(&flight.online()),
            flight.drms_m(&output.navigation.x),
            flight.drms_m(&vec![[0.0; STATES]; 3600]),
        ]
    };
    let drms: Vec<[f64; 3]> = SEEDS.into_par_iter().map(flown).collect();
    for (seed, [online, smoother, ins]) in SEEDS.into_iter().zip(&drms) {
        println!("seed {seed}: DRMS m: online {online:.0}, smoother {smoother:.1}, INS {ins:.0}");
        assert!(smoother < online && *smoother < 100.0, "{seed} {online} {smoother}");
    }
    assert!(drms.iter().any(|[online, ..]| *online > 1000.0), "the online filter is lost on some line");
}

#[test]
fn law_a_second_magnetometer_and_a_lag_reduce_the_error() {
    let lagged = FixedLagParameters { lag_s: 200.0, overlap: 0.8, ..FixedLagParameters::default() };
    let unlagged = FixedLagParameters { lag_s: 0.0, ..lagged };
    let flown = |seed: u64| {
        let two = fly(seed, 1200, 1.0, 2, Left::Drift);
        let mut one = fly(seed, 1200, 1.0, 2, Left::Drift);
        one.measured.truncate(1);
        let of = |flight: &Flight, parameters| {
            let output = flight.smoothed(parameters, flight.left);
            let sd = (600..1000).map(|row| output.navigation.sd_n_m[row].hypot(output.navigation.sd_e_m[row]));
            [flight.drms_m(&output.navigation.x).powi(2), sd.sum::<f64>() / 400.0]
        };
        [of(&one, &unlagged), of(&two, &unlagged), of(&one, &lagged)]
    };
    let all: Vec<[[f64; 2]; 3]> = (20..24_u64).into_par_iter().map(flown).collect();
    let drms = [0, 1, 2].map(|k: usize| (all.iter().map(|one| one[k][0]).sum::<f64>() / 4.0).sqrt());
    println!("DRMS m: one {:.1}, two {:.1}, one with a lag of 200 s {:.1}", drms[0], drms[1], drms[2]);
    // Additional information cannot increase the variance; the errors decrease on average.
    assert!(all.iter().all(|[one, two, lagged]| two[1] < one[1] && lagged[1] < one[1]), "{all:?}");
    assert!(drms[1] < drms[0] && drms[2] < drms[0], "{drms:?}");
}

#[test]
fn law_averages_over_a_second_equal_every_sample() {
    let flight = fly(4, 3000, 0.1, 1, Left::White);
    let of = |measurement_interval_s| {
        let parameters = FixedLagParameters { measurement_interval_s, ..FixedLagParameters::default() };
        let start = Instant::now();
        let output = flight.smoothed(&parameters, flight.left);
        println!("{measurement_interval_s} s: {:.0} microseconds a sample", start.elapsed().as_secs_f64() / 3e-3);
        output
    };
    let (every, averaged) = (of(0.0), of(1.0));
    let navigation = &averaged.navigation;
    assert_eq!(navigation.nis.iter().filter(|nis| nis.is_finite()).count(), 300);
    let mut largest: f64 = 0.0;
    for row in (600..3000).step_by(10).map(|row| row + 9) {
        let sd = every.navigation.sd_n_m[row];
        // Averaging loses only the information in the change of the terms within a second, which is small.
        assert!((navigation.sd_n_m[row] / sd - 1.0).abs() < 0.1, "{row} {} {sd}", navigation.sd_n_m[row]);
        let moved_m = (navigation.x[row][LAT] - every.navigation.x[row][LAT]) * 6.37e6;
        largest = largest.max(moved_m.abs() / sd);
    }
    println!("largest difference north {largest:.2} sd");
    // The two estimates differ in a tenth of the information. The standard deviation of their difference is therefore a
    // third of the standard deviation of the estimate, and the limit is three times this value.
    assert!(largest < 1.0, "{largest}");
    // The aircraft field is known except for the temporal variation, 3 nT.
    let beta = &flight.truth[0];
    let square = |row: usize| {
        let terms = flight.regressors[row * flight.terms..].iter().zip(beta);
        (averaged.aircraft_nt[row] - terms.map(|(a, b)| a * b).sum::<f64>()).powi(2)
    };
    let rms = ((1500..3000).map(square).sum::<f64>() / 1500.0).sqrt();
    assert!(rms < 9.0, "{rms} nT");
}

#[test]
fn law_the_jacobian_of_an_averaged_measurement_equals_differences() {
    let flight = fly(6, 40, 0.1, 1, Left::White);
    let ins = flight.ins.series();
    let line = flight.line(&ins);
    let (covariance, zeros) = (flight.covariance(), vec![0.0; flight.terms]);
    let regressors = &flight.regressors;
    let coefficients = AircraftCoefficients { regressors, mean: &zeros, covariance: &covariance, walk_density: &zeros };
    let magnetometers = [FixedLagMagnetometer { coefficients, ..FixedLagMagnetometer::of_line(&line) }];
    let error = GaussMarkov { sigma: 5.0, tau_s: 2.0 };
    let mut layout = StateLayout { errors: vec![error], walk: zeros.clone(), ..StateLayout::default() };
    layout.blocks.push(STATES + 1..layout.dim());
    let node = LineNodeBuilder::new(&line, &magnetometers, &layout, &[0.0], 1.0).take(f64::INFINITY).unwrap();
    assert_eq!(node.rows, 0..10);
    let mut field: PredictedField = line.predicted();
    let mut residual = |x: &[f64]| {
        let local = node.field(0, &line, &mut field, x).unwrap();
        let measurement = node.measurements[0].as_ref().unwrap();
        let h = measurement.sensitivity(&local, &layout, 0);
        let mut row = vec![0.0; layout.dim()];
        h.add_to(&mut row, 1.0);
        (measurement.residual(&local, &h, x), row)
    };
    let mut x: Vec<f64> = (0..layout.dim()).map(|k| if k < STATES { 0.0 } else { 3.0 + k as f64 }).collect();
    (x[LAT], x[LON], x[ALT], x[S]) = (2e-5, -1e-5, 7.0, 4.0);
    let (_, row) = residual(&x);
    for state in 0..layout.dim() {
        // The position error at the end of the second is about 30 m, over which the slope of the map changes by a few
        // percent.
        let step = match state {
            LAT | LON => 1e-6,
            6..12 => 1e-2,
            12..15 => 1e-2,
            _ => 1.0,
        };
        let mut at = |by: f64| {
            let mut moved = x.clone();
            moved[state] += by;
            residual(&moved).0
        };
        let slope = -(at(step) - at(-step)) / (2.0 * step);
        let scale = row[state].abs().max(1e-9 / step);
        assert!((slope - row[state]).abs() < 2e-3 * scale + 1e-6 / step, "{state} {slope} {}", row[state]);
    }
}

#[test]
#[ignore = "the time of an hour at 10 Hz, half a minute"]
fn unit_an_hour_at_10_hz_takes_seconds() {
    let flight = fly(1, 36_000, 0.1, 1, Left::Steps);
    let expected = GaussMarkov { sigma: 36.0, tau_s: 200.0 };
    for (overlap, lag_s) in [(0.95, 0.0), (0.8, 0.0), (0.8, 200.0)] {
        let parameters = FixedLagParameters { overlap, lag_s, ..FixedLagParameters::default() };
        let start = Instant::now();
        let output = flight.smoothed(&parameters, expected);
        let taken_us = start.elapsed().as_secs_f64() * 1e6 / 36_000.0;
        let drms_m = flight.drms_m(&output.navigation.x);
        println!("overlap {overlap}, lag {lag_s} s: {taken_us:.0} microseconds a sample, DRMS {drms_m:.1} m");
        assert!(drms_m < 150.0, "{drms_m}");
    }
}

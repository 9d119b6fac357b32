//! Lines with gaps, edges and invalid values.

use super::*;
use crate::navigation::SeriesError;

#[test]
fn unit_a_magnetometer_without_a_value_is_skipped_and_the_others_are_used() {
    let map = wavy(-74.88);
    let flight = Flight::turning(&map, 2);
    let priors = [flight.prior(0, 30.0), flight.prior(1, 30.0)];
    let density = vec![0.01; flight.width];
    let both = |flight: &Flight| {
        let magnetometers = [0, 1].map(|k| flight.magnetometer(k, &priors[k], &density));
        run(&flight.line(&map), &magnetometers, None, &ALL).unwrap()
    };
    // If all values of the second magnetometer are missing, the result equals the result without this magnetometer,
    // except for the random walk of its coefficients.
    let (mut by_term, mut by_value, mut by_sigma) = (flight.clone(), flight.clone(), flight.clone());
    for row in 0..ROWS {
        by_term.terms[1][18 * row + row % 18] = if row % 2 == 0 { f64::NAN } else { f64::INFINITY };
    }
    by_value.measurement_nt[1].fill(f64::NAN);
    by_sigma.sigma_nt[1].fill(0.0);
    let alone = run(&flight.line(&map), &[flight.magnetometer(0, &priors[0], &density)], None, &ALL).unwrap();
    for flight in [&by_term, &by_value, &by_sigma] {
        let output = both(flight);
        assert_eq!(output.navigation.x, alone.navigation.x);
        assert_eq!(output.navigation.p, alone.navigation.p);
        assert_eq!(output.navigation.report, alone.navigation.report);
        let [first, second] = [0, 1].map(|k| output.magnetometers[k].track.report);
        assert_eq!((first.updates, second.updates, second.missing), (ROWS, 0, ROWS));
        assert!(output.magnetometers[1].track.residual_nt.iter().all(|r| r.is_nan()));
        assert_eq!(output.magnetometers[1].coefficients, priors[1].mean);
        let grown = priors[1].covariance[0] + 0.01 * (flight.columns[0][ROWS - 1] - flight.columns[0][0]);
        assert!((output.magnetometers[1].covariance[0] / grown - 1.0).abs() < 1e-12);
    }
    assert!(both(&by_term).magnetometers[1].track.aircraft_nt.iter().all(|nt| nt.is_nan()));
    // Only the first magnetometer lacks some samples. At these samples, the residual of the track is the residual of
    // the second magnetometer.
    let mut gap = flight.clone();
    gap.terms[0][18 * 30 + 4] = f64::NAN;
    let output = both(&gap);
    let report = output.magnetometers[0].track.report;
    assert_eq!((report.missing, report.updates), (1, ROWS - 1));
    assert_eq!(output.navigation.report.updates, ROWS);
    let (second, track) = (&output.magnetometers[1].track, &output.navigation);
    assert_eq!((track.residual_nt[30], track.nis[30]), (second.residual_nt[30], second.nis[30]));
}

#[test]
fn unit_off_the_map_the_filter_only_predicts() {
    let map = wavy(-74.9);
    let flight = Flight::turning(&map, 2);
    let prior = flight.prior(0, 30.0);
    let none = vec![0.0; flight.width];
    let magnetometers = [0, 1].map(|k| flight.magnetometer(k, &prior, &none));
    let output = run(&flight.line(&map), &magnetometers, None, &ALL).unwrap();
    let report = output.navigation.report;
    assert_eq!((report.updates, report.off_map), (0, ROWS));
    assert_eq!(output.magnetometers[1].track.report.off_map, ROWS);
    assert!(output.navigation.residual_nt.iter().chain(&output.navigation.nis).all(|value| value.is_nan()));
    assert_eq!(output.magnetometers[0].covariance, prior.covariance);
    // The aircraft field is known from the prior.
    let expected: f64 = flight.terms[0][..18].iter().zip(&prior.mean).map(|(a, b)| a * b).sum();
    assert!((output.magnetometers[0].track.aircraft_nt[0] - expected).abs() < 1e-12);
}

#[test]
fn law_uneven_time_equals_missing_samples() {
    let map = wavy(-74.88);
    let mut thinned = Flight::turning(&map, 1);
    thinned.errors.noise = NoiseDiscretisation::VanLoan;
    let left_out = |row: &usize| row % 7 == 3 || (60..75).contains(row);
    // INS quantities are constant, so two short steps equal one long step.
    for column in [1, 4, 5, 6, 7, 8, 10, 11, 12] {
        let first = thinned.columns[column][0];
        thinned.columns[column].fill(first);
    }
    let keep = |values: &[f64], width: usize| -> Vec<f64> {
        let kept = (0..ROWS).filter(|row| !left_out(row));
        kept.flat_map(|row| values[width * row..][..width].to_vec()).collect()
    };
    let uneven = Flight {
        columns: thinned.columns.each_ref().map(|column| keep(column, 1)),
        terms: vec![keep(&thinned.terms[0], 18)],
        measurement_nt: vec![keep(&thinned.measurement_nt[0], 1)],
        sigma_nt: vec![keep(&thinned.sigma_nt[0], 1)],
        ..thinned.clone()
    };
    (0..ROWS).filter(left_out).for_each(|row| thinned.measurement_nt[0][row] = f64::NAN);
    let prior = thinned.prior(0, 30.0);
    let density = vec![0.3; 18];
    let of = |flight: &Flight| {
        run(&flight.line(&map), &[flight.magnetometer(0, &prior, &density)], None, &ALL)
            .unwrap()
            .magnetometers
            .remove(0)
    };
    let (a, b) = (of(&thinned), of(&uneven));
    for ((one, other), sd) in a.coefficients.iter().zip(&b.coefficients).zip(a.sigma()) {
        // The longitude drift depends on the latitude, which both INS samples share; rounding is far smaller.
        assert!((one - other).abs() < 1e-6 * sd, "{one} {other} {sd}");
    }
    assert!(a.covariance.iter().zip(&b.covariance).all(|(one, other)| (one - other).abs() < 1e-6 * 900.0));
}

#[test]
fn unit_the_gate_rejects_one_magnetometer() {
    let map = wavy(-74.88);
    let mut flight = Flight::turning(&map, 2);
    flight.measurement_nt[1][100] += 1e4;
    let prior = flight.prior(0, 30.0);
    let none = vec![0.0; 18];
    let parameters = OnlineParameters { gate_nis: Some(30.0), ..ALL };
    let of = |flight: &Flight| {
        let magnetometers = [0, 1].map(|k| flight.magnetometer(k, &prior, &none));
        run(&flight.line(&map), &magnetometers, None, &parameters).unwrap()
    };
    let gated = of(&flight);
    flight.measurement_nt[1][100] = f64::NAN;
    let missing = of(&flight);
    assert_eq!(gated.magnetometers[1].track.report.gated, 1);
    assert_eq!((gated.navigation.report.gated, gated.navigation.report.updates), (0, ROWS));
    assert_eq!(gated.navigation.x, missing.navigation.x, "as if it had not been measured");
    assert!(gated.magnetometers[1].track.nis[100] > 1e4);
}

#[test]
fn law_one_sample_is_one_update() {
    let map = wavy(-74.88);
    let mut flight = Flight::turning(&map, 1);
    flight.columns.iter_mut().for_each(|column| column.truncate(1));
    flight.measurement_nt[0].truncate(1);
    flight.sigma_nt[0].truncate(1);
    flight.terms[0].truncate(18);
    let (prior, none) = (flight.prior(0, 30.0), vec![0.0; 18]);
    let output = run(&flight.line(&map), &[flight.magnetometer(0, &prior, &none)], None, &ALL).unwrap();
    let terms = &flight.terms[0];
    let slopes = output.navigation.nis[0].recip() * output.navigation.residual_nt[0].powi(2)
        - terms.iter().map(|a| 900.0 * a * a).sum::<f64>();
    // Part of the innovation's variance that is not due to the coefficients: S, noise, and the slope over 3 m, below 3
    // nT.
    assert!((9.0 + 4.0..9.0 + 4.0 + 9.0).contains(&slopes), "{slopes}");
}

#[test]
fn unit_invalid_input_is_rejected() {
    let map = wavy(-74.88);
    let flight = Flight::turning(&map, 1);
    let (prior, none) = (flight.prior(0, 30.0), vec![0.0; 18]);
    let good = flight.magnetometer(0, &prior, &none);
    let line = flight.line(&map);
    let message = |m: OnlineMagnetometer<'_>| run(&line, &[m], None, &ALL).unwrap_err().to_string();
    let words = message(OnlineMagnetometer { terms: &flight.terms[0][1..], ..good });
    assert_eq!(words, "magnetometer 0 has 4139 values, not 18 terms in each of 230 rows");
    let words = message(OnlineMagnetometer { walk_density: &none[1..], ..good });
    assert_eq!(words, "magnetometer 0 has 18 coefficients, a covariance of 324 entries and 17 densities");
    let negative = vec![-1.0; 18];
    let words = message(OnlineMagnetometer { walk_density: &negative, ..good });
    assert_eq!(words, "the spectral density of the random walk of coefficient 0 is -1");
    let mut bad = prior.clone();
    bad.covariance[1] = 1000.0;
    let words = message(OnlineMagnetometer { prior: &bad, ..good });
    assert_eq!(words, "the prior covariance is not positive semidefinite: a correlation is outside -1 to 1");
    bad.covariance[1] = 100.0;
    assert_eq!(message(OnlineMagnetometer { prior: &bad, ..good }), "the prior covariance is not symmetric");
    bad = prior.clone();
    for (i, j, c) in [(0, 1, 0.9), (1, 2, 0.9), (0, 2, -0.9)] {
        (bad.covariance[18 * i + j], bad.covariance[18 * j + i]) = (c * 900.0, c * 900.0);
    }
    assert_eq!(
        message(OnlineMagnetometer { prior: &bad, ..good }),
        "the prior covariance is not positive semidefinite"
    );
    bad = CoefficientPrior::independent(&[f64::NAN; 18], &[1.0; 18]);
    assert_eq!(message(OnlineMagnetometer { prior: &bad, ..good }), "the prior mean of coefficient 0 is NaN");
    bad = CoefficientPrior::independent(&[0.0; 18], &[1e8; 18]);
    assert!(
        message(OnlineMagnetometer { prior: &bad, ..good })
            .starts_with("the prior standard deviation of the aircraft field")
    );
    let words = message(OnlineMagnetometer { sigma_nt: &flight.sigma_nt[0][1..], ..good });
    assert_eq!(words, "column `measurement sigma` has 229 rows, but `tt` has 230");
    assert_eq!(run(&line, &[], None, &ALL).unwrap_err().to_string(), "no magnetometer is given");
    let gate = OnlineParameters { gate_nis: Some(0.0), ..ALL };
    assert_eq!(run(&line, &[good], None, &gate).unwrap_err().to_string(), "`gate_nis` must be above 0, not 0");
    let mut wild = flight.clone();
    wild.columns[7][11] = 1e200;
    let fault = run(&wild.line(&map), &[good], None, &ALL).unwrap_err();
    assert!(matches!(fault, NavigationError::Diverged { row: 12, .. }), "{fault}");
    wild = flight.clone();
    wild.columns[0][3] = wild.columns[0][2];
    let fault = run(&wild.line(&map), &[good], None, &ALL).unwrap_err();
    assert!(matches!(fault, NavigationError::Series(SeriesError::Time { row: 3, .. })), "{fault}");
}

#[test]
fn unit_a_scalar_magnetometer_is_rejected_as_a_term() {
    assert!(check_sources(&["flux_b_x", "cur_ac_hi", "x", "mags"]).is_ok());
    let words = check_sources(&["flux_b_x", "mag_3_uc"]).unwrap_err().to_string();
    assert!(words.contains("`mag_3_uc`") && words.contains("subtract its own"), "{words}");
    let map = wavy(-74.88);
    let flight = Flight::turning(&map, 1);
    let vector = Vector::new(&flight, &["permanent", "induced", "eddy"]);
    let (prior, none) = (flight.prior(0, 30.0), vec![0.0; 18]);
    let magnetometer = flight.magnetometer(0, &prior, &none);
    let refused = |fluxgate: &Fluxgate<'_>, magnetometer: OnlineMagnetometer<'_>| {
        run(&flight.line(&map), &[magnetometer], Some(fluxgate), &ALL).unwrap_err().to_string()
    };
    let good = vector.fluxgate(20.0, f64::INFINITY);
    assert!(run(&flight.line(&map), &[magnetometer], Some(&good), &ALL).is_ok());
    let modified = Fluxgate { field: BodyFieldColumns { bt: Some(&flight.measurement_nt[0]), ..good.field }, ..good };
    assert!(refused(&modified, magnetometer).contains("depend on the filter's own"));
    let mut others = flight.terms[0].clone();
    others[18 * 50 + 2] *= 1.001;
    let words = refused(&good, OnlineMagnetometer { terms: &others, ..magnetometer });
    assert_eq!(words, "the terms of magnetometer 0 differ in row 50 from those of the vector magnetometer");
    others[18 * 50 + 2] = f64::NAN;
    assert!(refused(&good, OnlineMagnetometer { terms: &others, ..magnetometer }).contains("row 50"));
    assert!(
        refused(&Fluxgate { tau_s: 0.0, ..good }, magnetometer).contains("time constant of the bias must be above 0")
    );
    assert!(refused(&Fluxgate { sigma_nt: -1.0, ..good }, magnetometer).contains("must not be below 0"));
}

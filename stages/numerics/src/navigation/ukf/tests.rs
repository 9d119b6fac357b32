#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use super::*;
use crate::earth::core_field::CoreField;
use crate::navigation::flights::{
    FLIGHTS, OsborneFlight, OwnedNavigationLine, chi_square, ensemble, golden_map, known, plane,
};
use crate::navigation::gaussian::linearise::cholesky;
use crate::navigation::ins_error::{InsErrorModel, InsErrors};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix};
use crate::navigation::transition::NoiseDiscretisation;
use crate::random::NormalGenerator;
use nalgebra::{SMatrix, SVector};

fn all() -> UkfParameters {
    UkfParameters { keep_covariance: true, ..UkfParameters::default() }
}

fn compatible() -> InsErrorModel {
    InsErrorModel::compatible()
}

/// Covariance of correlated states with different scales, drawn with a seed.
fn covariance(seed: u64) -> StateMatrix {
    let mut normals = NormalGenerator::new(seed);
    let root = SMatrix::<f64, STATES, STATES>::from_fn(|row, _| 10_f64.powi(row as i32 % 5 - 3) * normals.draw());
    let p = root * root.transpose();
    std::array::from_fn(|row| std::array::from_fn(|column| p[(row, column)]))
}

#[test]
fn law_over_a_plane_it_equals_the_ekf() {
    let (line, map) = (OwnedNavigationLine::golden(3.0), plane());
    let ins = line.series();
    let core = Arc::new(CoreField::at(2020.5).unwrap());
    let total: Vec<f64> = line.measurement_nt.iter().map(|z| z + 53_000.0).collect();
    for (core, measurement_nt) in [(None, &line.measurement_nt), (Some(&core), &total)] {
        let line = NavigationLine { core, measurement_nt, ..line.line(&ins, &map, InsErrorModel::default()) };
        let (ukf, ekf) = (run(&all(), &line).unwrap().navigation, known(&line, 3.0).unwrap());
        for row in 0..20 {
            // Differences of map values of 600 nT over a few metres have a rounding error of 1e-11 of the slope.
            assert!((ukf.residual_nt[row] / ekf.residual_nt[row] - 1.0).abs() < 1e-9, "{row}");
            for state in 0..STATES {
                let variance = ekf.p[row][state][state];
                let moved = (ukf.x[row][state] - ekf.x[row][state]).abs();
                assert!(moved <= 1e-9 * variance.sqrt().max(ekf.x[row][state].abs()), "{row} {state} {moved:e}");
                assert!((ukf.p[row][state][state] / variance - 1.0).abs() < 1e-9, "{row} {state}");
            }
        }
        assert_eq!(ukf.report, ekf.report);
    }
}

#[test]
fn law_the_moments_of_a_quadratic_field_are_exact() {
    // With c² = 2 and β = α² the variance is exact where the second derivatives are diagonal along the points.
    for (alpha, kappa, beta) in [(1.0, -1.0, 1.0), (0.5, 5.0, 0.25)] {
        let spread = SigmaPoints::new(alpha, beta, kappa);
        let p = covariance(7);
        let root = cholesky(&p);
        let root = SMatrix::<f64, 3, 3>::from_fn(|row, column| root[row][column]);
        let inverse = root.try_inverse().unwrap();
        let bend = inverse.transpose() * SMatrix::<f64, 3, 3>::from_diagonal(&[0.7, -0.3, 1.1].into()) * inverse;
        let slope = SVector::<f64, 3>::new(2.0, -3.0, 0.5);
        let field = |away: [f64; 3]| {
            let away = SVector::from(away);
            Some(11.0 + slope.dot(&away) + away.dot(&(bend * away)))
        };
        let found = spread.regression(&p, 11.0, field).unwrap();
        let p3 = root * root.transpose();
        let product = bend * p3;
        // E[yᵀ B y] = tr(B P), Var[yᵀ B y] = 2 tr(B P B P), and no covariance with bᵀ y. Sums of a few numbers have a
        // rounding error of 1e-14 of the largest number, and the factor of P loses three digits because of its
        // condition number of 1e3.
        assert!((found.mean_nt - 11.0 - product.trace()).abs() < 1e-11);
        assert!((found.remainder_nt2 / (2.0 * (product * product).trace()) - 1.0).abs() < 1e-10);
        for (found, given) in found.slope.iter().zip(slope.iter()) {
            assert!((found / given - 1.0).abs() < 1e-9, "{found} {given}");
        }
    }
}

#[test]
fn law_the_defaults_are_exact_for_a_cubic_field() {
    // E[y · y³] = 3 σ⁴: the slope of a y³ is 3 a σ², and its mean is 0; the mean of a y⁴ is 3 a σ⁴.
    let mut p = [[0.0; STATES]; STATES];
    (p[0][0], p[1][1], p[2][2]) = (4.0, 0.25, 9.0);
    let spread = UkfParameters::default().sigma_points();
    for state in 0..3 {
        let variance = p[state][state];
        let cubic = spread.regression(&p, 0.0, |away| Some(0.3 * away[state].powi(3))).unwrap();
        assert!((cubic.slope[state] / (0.9 * variance) - 1.0).abs() < 1e-14 && cubic.mean_nt.abs() < 1e-14);
        let quartic = spread.regression(&p, 0.0, |away| Some(0.3 * away[state].powi(4))).unwrap();
        assert!((quartic.mean_nt / (0.9 * variance * variance) - 1.0).abs() < 1e-14);
    }
}

/// Unscented transform of all 18 states of a scalar function: mean, variance and covariance with the states. [Wan & van
/// der Merwe 2000, (15), with the points of the Cholesky factor]
fn full_transform(
    p: &StateMatrix,
    [alpha, beta, kappa]: [f64; 3],
    of: impl Fn(&SVector<f64, STATES>) -> f64,
) -> (f64, f64, SVector<f64, STATES>) {
    let n = STATES as f64;
    let lambda = alpha * alpha * (n + kappa) - n;
    let p = SMatrix::<f64, STATES, STATES>::from_fn(|row, column| p[row][column]);
    let root = p.cholesky().unwrap().l() * (n + lambda).sqrt();
    let mut points = vec![SVector::<f64, STATES>::zeros()];
    for column in root.column_iter() {
        points.extend([column.into_owned(), -column]);
    }
    let side = 0.5 / (n + lambda);
    let weight = |at: usize| if at == 0 { lambda / (n + lambda) } else { side };
    let values: Vec<f64> = points.iter().map(of).collect();
    let mean: f64 = values.iter().enumerate().map(|(at, value)| weight(at) * value).sum();
    let (mut variance, mut shared) = (0.0, SVector::<f64, STATES>::zeros());
    for (at, (point, value)) in points.iter().zip(&values).enumerate() {
        let weight = weight(at) + if at == 0 { 1.0 - alpha * alpha + beta } else { 0.0 };
        variance += weight * (value - mean).powi(2);
        shared += point * (weight * (value - mean));
    }
    (mean, variance, shared)
}

#[test]
fn law_the_transform_of_the_position_equals_that_of_all_states() {
    let field =
        |lat: f64, lon: f64, alt: f64| 20.0 * (30.0 * lat).sin() + 7.0 * (8.0 * lon + 0.4).cos() - 0.5 * lat * alt;
    for (seed, alpha, beta, kappa) in [(1, 1.0, 1.0, 0.0), (2, 0.8, 2.0, 0.5), (3, 1.3, 1.5, -0.5)] {
        let p = covariance(seed);
        let spread = SigmaPoints::new(alpha, beta, kappa);
        let found = spread.regression(&p, field(0.0, 0.0, 0.0), |[a, b, c]| Some(field(a, b, c))).unwrap();
        let estimate = StateEstimate { x: [0.0; STATES], p };
        let at = estimate.linearised(Sensitivity::of_slope(found.slope));
        // The same α and c² = α² (3 + κ) of 18 states.
        let (mean, variance, shared) =
            full_transform(&p, [alpha, beta, kappa - 15.0], |x| field(x[LAT], x[LON], x[ALT]) + x[S]);
        // The weights of 37 points of size 1 to 10 nearly cancel: 1e-12 of the standard deviation.
        assert!((found.mean_nt - mean).abs() < 1e-11 * variance.sqrt(), "{} {mean}", found.mean_nt);
        assert!(((at.variance + found.remainder_nt2) / variance - 1.0).abs() < 1e-10);
        for state in 0..STATES {
            let size = (p[state][state] * variance).sqrt();
            assert!((at.ph[state] - shared[state]).abs() < 1e-10 * size, "{state}");
        }
    }
}

#[test]
fn law_the_curvature_variance_without_a_preferred_direction_is_as_documented() {
    let mut p = [[0.0; STATES]; STATES];
    (p[0][0], p[1][1]) = (4.0, 4.0);
    for beta in [0.75, 1.0, 2.0] {
        let spread = UkfParameters { beta, ..UkfParameters::default() }.sigma_points();
        let waves = 16;
        let of_wave = |wave: i32| {
            let (sin, cos) = (std::f64::consts::PI * f64::from(wave) / f64::from(waves)).sin_cos();
            let field = |[lat, lon, _]: [f64; 3]| Some((cos * lat + sin * lon).powi(2));
            spread.regression(&p, 0.0, field).unwrap().remainder_nt2 / f64::from(waves)
        };
        let found: f64 = (0..waves).map(of_wave).sum();
        // The square of a normal number of variance 4 has the variance 2·4²; the mean over directions is exact.
        assert!((found / 32.0 - (5.0 + 4.0 * beta) / 8.0).abs() < 1e-13, "{beta} {found}");
    }
}

#[test]
fn law_the_nonlinear_variance_is_never_negative() {
    let mut normals = NormalGenerator::new(5);
    for seed in 0..50 {
        let (alpha, kappa) = (0.1 + normals.draw().abs(), -2.9 + normals.draw().abs());
        let beta = -alpha * alpha * kappa / 3.0;
        let parameters = UkfParameters { alpha, beta, kappa, ..UkfParameters::default() };
        parameters.check().unwrap();
        let bends: [f64; 3] = std::array::from_fn(|_| if seed % 2 == 0 { 1.0 } else { normals.draw() });
        let field = |away: [f64; 3]| Some(away.iter().zip(bends).map(|(y, bend)| bend * y * y).sum());
        let spread = SigmaPoints { sigmas: alpha * (3.0 + kappa).sqrt(), beyond: beta - alpha * alpha };
        let (mut p, mut squares) = ([[0.0; STATES]; STATES], 0.0);
        for (state, bend) in bends.into_iter().enumerate() {
            p[state][state] = 1.0;
            squares += bend * bend;
        }
        // With unit variances, e = c² b, so ω is the sum below. The bound on β makes ω zero for equal b.
        let sum: f64 = bends.iter().sum();
        let expected = spread.sigmas.powi(2) * (squares - sum * sum / 3.0);
        let found = spread.regression(&p, 0.0, field).unwrap().remainder_nt2;
        assert!((found - expected).abs() < 1e-12 * spread.sigmas.powi(2) * (squares + 1.0), "{found} {expected}");
    }
}

#[test]
fn law_the_filter_is_consistent() {
    let epochs = [120, 450, 780, 1110, 1440, 1770, 2100, 2430, 2760, 3090, 3599];
    let n = FLIGHTS as f64;
    let (low, high) = (chi_square(2.0 * n, -1.96) / n, chi_square(2.0 * n, 1.96) / n);
    let mean = |row: usize| ensemble().iter().map(|run| run.flight.nees(&run.ukf.navigation, row)).sum::<f64>() / n;
    let nees = epochs.map(mean);
    println!("position NEES by epoch, band {low:.2}..{high:.2}: {nees:.2?}");
    // By chance, one epoch in twenty is outside the band, and 3 or more of 11 epochs are outside in 1.5 % of all cases.
    assert!(nees.iter().filter(|nees| !(low..=high).contains(nees)).count() <= 2, "{nees:.2?}");
    // All epochs together, in the 99.9 % band, because neighbouring epochs are correlated.
    let (all, sum) = (2.0 * n * epochs.len() as f64, n * nees.iter().sum::<f64>());
    assert!((chi_square(all, -3.29)..=chi_square(all, 3.29)).contains(&sum), "{}", sum / all);
    let nis = |run: &crate::navigation::flights::FlightEstimates| run.ukf.navigation.nis.iter().sum::<f64>();
    let nis = ensemble().iter().map(nis).sum::<f64>() / (n * f64::from(crate::navigation::flights::SAMPLES));
    // The mean of 216,000 values has a standard deviation of 0.003. The second-order term is 9/8 of the true term.
    assert!((nis - 1.0).abs() < 0.02, "{nis}");
}

#[test]
fn law_with_a_wide_prior_it_is_more_consistent_than_the_ekf() {
    let wide = InsErrors { init_position_sigma_m: 100.0, ..InsErrors::default() };
    let (mut ekf, mut ukf) = ([0.0; 2], [0.0; 2]);
    let flights = 60_u64;
    for seed in 0..flights {
        let flight = OsborneFlight::flown(300 + seed, 400, 1.0, InsErrorModel::from_sources(wide));
        let (measured, sigma) = (flight.measured(seed, 5.0), vec![5.0; 400]);
        let ins = flight.ins.series();
        let line = flight.line(&ins, &measured, &sigma);
        let of = |output: &NavigationOutput| {
            let nees = [100, 200, 300, 399].map(|row| flight.nees(output, row)).iter().sum::<f64>() / 8.0;
            [nees / flights as f64, flight.square_m2(output, 200) / flights as f64]
        };
        let (a, b) = (of(&known(&line, 5.0).unwrap()), of(&run(&all(), &line).unwrap().navigation));
        for measure in 0..2 {
            ekf[measure] += a[measure];
            ukf[measure] += b[measure];
        }
    }
    println!(
        "NEES and DRMS of a prior of 100 m: EKF {:.2} {:.1} m, UKF {:.2} {:.1} m",
        ekf[0],
        ekf[1].sqrt(),
        ukf[0],
        ukf[1].sqrt()
    );
    // The EKF uses slopes that are not valid over 100 m. The mean of 60 flights with about two independent epochs each
    // varies by 1/√120 = 9 %.
    assert!(ekf[0] > 1.5 && (0.75..1.25).contains(&ukf[0]) && ukf[1] < ekf[1], "{ukf:?} {ekf:?}");
}

#[test]
fn unit_samples_without_measurement_or_map_value_are_predicted_and_counted() {
    let (mut line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    for row in [0, 4, 5] {
        line.measurement_nt[row] = f64::NAN;
    }
    line.measurement_nt[6] = f64::INFINITY;
    (line.sigma_nt[7], line.sigma_nt[8]) = (0.0, f64::NAN);
    line.columns[1][10] += 1.0;
    let ins = line.series();
    let output = run(&all(), &line.line(&ins, &map, compatible())).unwrap();
    let report = output.navigation.report;
    assert_eq!((report.updates, report.missing_measurements, report.off_map, output.linearised), (13, 6, 1, 0));
    for row in [0, 4, 5, 6, 7, 8, 10] {
        assert!(output.navigation.residual_nt[row].is_nan() && output.nonlinear_sd_nt[row].is_nan());
        assert!(output.navigation.sd_n_m[row].is_finite());
    }
    assert!(output.nonlinear_sd_nt[11] > 0.0);
    // The initial uncertainty remains unchanged.
    assert!((output.navigation.sd_n_m[0] - 3.0).abs() < 1e-9 && output.navigation.x[0] == [0.0; STATES]);
    line.measurement_nt.fill(f64::NAN);
    let ins = line.series();
    let nothing = run(&all(), &line.line(&ins, &map, compatible())).unwrap();
    assert_eq!(nothing.navigation.lat_deg, line.columns[1]);
}

#[test]
fn law_at_the_edge_of_the_map_it_equals_the_ekf() {
    // 1 m inside the map's south edge, with 3 m of uncertainty.
    let (line, map) = (OwnedNavigationLine::golden(3.0).thinned(|row| row == 0), golden_map());
    let mut line = line;
    line.columns[1][0] = (0.70_f64 + 1.6e-7).to_degrees();
    line.measurement_nt[0] = 100.0;
    let ins = line.series();
    let line = line.line(&ins, &map, compatible());
    let (ukf, ekf) = (run(&all(), &line).unwrap(), known(&line, 3.0).unwrap());
    assert_eq!((ukf.linearised, ukf.navigation.report.updates), (1, 1));
    assert!(ukf.nonlinear_sd_nt[0].is_nan());
    assert!((ukf.navigation.residual_nt[0] - ekf.residual_nt[0]).abs() < 1e-12);
    for state in 0..STATES {
        assert!((ukf.navigation.x[0][state] - ekf.x[0][state]).abs() <= 1e-14 * ekf.x[0][state].abs());
        assert!((ukf.navigation.p[0][state][state] / ekf.p[0][state][state] - 1.0).abs() < 1e-13);
    }
}

#[test]
fn law_an_exact_position_is_kept_and_a_flat_map_corrects_only_the_temporal_variation() {
    let (line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    let ins = line.series();
    let exact = InsErrors { init_position_sigma_m: 0.0, init_altitude_sigma_m: 0.0, ..InsErrors::default() };
    let output = run(&all(), &line.line(&ins, &map, InsErrorModel::from_sources(exact))).unwrap();
    assert_eq!((output.navigation.report.updates, output.linearised), (20, 0));
    assert!(output.navigation.x[0][..S].iter().all(|x| *x == 0.0) && output.navigation.x[0][S] != 0.0);
    assert_eq!(output.nonlinear_sd_nt[0], 0.0);
    let mut flat = plane();
    if let FieldMap::Flat(map) = &mut flat {
        let grid = crate::maps::map_surface::GeographicGrid::new(&[40.0, 40.2], &[-75.0, -74.0], &[10.0; 4]);
        *map = crate::maps::map_surface::MapSurface::new(&grid.unwrap(), map.interpolation());
    }
    let level = OwnedNavigationLine { measurement_nt: vec![14.0; 20], ..line.clone() };
    let last = run(&all(), &level.line(&ins, &flat, InsErrorModel::default())).unwrap().navigation;
    for (state, x) in last.x[19][..S].iter().enumerate() {
        // Between equal nodes, the interpolated value has an error of 1e-15 of that value.
        assert!(x.abs() < 1e-12 * last.p[19][state][state].sqrt(), "{state} {x:e}");
    }
    assert!(last.x[19][S] > 2.0);
}

#[test]
fn law_uneven_time_equals_missing_samples() {
    let (mut thinned, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    let gone = [3, 4, 5, 9, 15];
    gone.iter().for_each(|row| thinned.measurement_nt[*row] = f64::NAN);
    // Constant INS quantities, so that two short steps equal one long step.
    for column in [1, 2, 7, 8, 10] {
        let first = thinned.columns[column][0];
        thinned.columns[column].fill(first);
    }
    let uneven = thinned.thinned(|row| !gone.contains(&row));
    let errors = InsErrorModel { noise: NoiseDiscretisation::VanLoan, ..InsErrorModel::default() };
    let of = |line: &OwnedNavigationLine| run(&all(), &line.line(&line.series(), &map, errors)).unwrap().navigation;
    let (a, b) = (of(&thinned), of(&uneven));
    let kept: Vec<usize> = (0..20).filter(|row| !gone.contains(row)).collect();
    for (place, row) in kept.into_iter().enumerate() {
        // Products of two steps instead of one have a rounding error of 1e-12 of a residual.
        assert!((a.residual_nt[row] - b.residual_nt[place]).abs() < 1e-9, "{row}");
        assert!((a.sd_e_m[row] - b.sd_e_m[place]).abs() < 1e-9, "{row}");
    }
}

#[test]
fn unit_the_gate_rejects_outliers_and_the_offset_is_subtracted() {
    let (mut line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    line.measurement_nt.iter_mut().for_each(|measured| *measured += 1000.0);
    line.measurement_nt[7] += 500.0;
    let ins = line.series();
    let with_offset = NavigationLine { offset_window_s: 0.45, ..line.line(&ins, &map, compatible()) };
    let parameters = UkfParameters { gate_nis: Some(10.83), ..all() };
    let output = run(&parameters, &with_offset).unwrap().navigation;
    assert_eq!((output.report.gated, output.report.updates, output.report.offset_samples), (1, 19, 5));
    assert!((output.report.offset_nt - 1000.0).abs() < 2.0 && output.nis[7] > 1000.0);
    let mut missing = line.clone();
    missing.measurement_nt[7] = f64::NAN;
    let ins = missing.series();
    let missing = NavigationLine { offset_window_s: 0.45, ..missing.line(&ins, &map, compatible()) };
    assert_eq!(output.x, run(&all(), &missing).unwrap().navigation.x, "as if it had not been measured");
}

#[test]
fn law_covariances_are_symmetric_and_positive() {
    let (mut line, map) = (OwnedNavigationLine::golden(1e-3), golden_map());
    line.measurement_nt[3] += 30.0;
    let ins = line.series();
    let wide = InsErrors { init_position_sigma_m: 100.0, ..InsErrors::default() };
    for errors in [InsErrorModel::default(), InsErrorModel::from_sources(wide)] {
        let output = run(&all(), &line.line(&ins, &map, errors)).unwrap().navigation;
        for p in &output.p {
            for (row, entries) in p.iter().enumerate() {
                entries.iter().enumerate().for_each(|(column, entry)| assert_eq!(*entry, p[column][row]));
            }
            let correlation = SMatrix::<f64, STATES, STATES>::from_fn(|row, column| {
                p[row][column] / (p[row][row] * p[column][column]).sqrt()
            });
            // Correlations near 1 have a rounding error of 1e-16.
            let smallest = correlation.symmetric_eigenvalues().min();
            assert!(smallest > -1e-13, "{smallest:e}");
        }
    }
}

#[test]
fn unit_invalid_parameters_and_lines_are_rejected() {
    let (line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    let message = |parameters: UkfParameters| {
        run(&parameters, &line.line(&line.series(), &map, compatible())).unwrap_err().to_string()
    };
    let usual = UkfParameters::default();
    assert_eq!(message(UkfParameters { alpha: 0.0, ..usual }), "`alpha` must be above 0, not 0");
    assert_eq!(message(UkfParameters { kappa: -3.0, ..usual }), "`kappa` must be above -3, not -3");
    let refused = message(UkfParameters { kappa: -1.5, beta: 0.4, ..usual });
    assert_eq!(refused, "`beta` must be at least -alpha² kappa/3 = 0.5, not 0.4");
    assert_eq!(message(UkfParameters { gate_nis: Some(-1.0), ..usual }), "`gate_nis` must be above 0, not -1");
    let refused = |change: &dyn Fn(&mut OwnedNavigationLine)| {
        let mut line = OwnedNavigationLine::golden(3.0);
        change(&mut line);
        run(&usual, &line.line(&line.series(), &map, compatible())).unwrap_err().to_string()
    };
    assert!(refused(&|line| line.columns[5][12] = f64::NAN).starts_with("column `ins_ve` is NaN in row 12"));
    assert!(refused(&|line| line.columns[0][3] = 0.2).starts_with("time does not ascend"));
    assert!(refused(&|line| line.columns[7][11] = 1e200).starts_with("the filter diverged at row 12"));
    assert_eq!(refused(&|line| line.sigma_nt.truncate(3)), "column `measurement sigma` has 3 rows, but `tt` has 20");
}

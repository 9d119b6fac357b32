#![allow(clippy::unwrap_used)]
use super::*;
use crate::navigation::flights::{
    FLIGHTS, OwnedNavigationLine, SAMPLES, claimed_m2, ensemble, from_magnav, golden_map, known, plane,
};
use crate::navigation::ins_error::{InsErrorModel, InsErrors};
use crate::navigation::pinson::{STATES, StateMatrix};
use nalgebra::{DMatrix, SMatrix};

/// Diagonal of the covariance after 20 samples by `crlb` of MagNav.jl 1.3.3, with the states in the order of MagNav.jl.
/// The golden line is the truth, with the defaults of `create_model(0.1, lat[1])` and the variance 9.
const MAGNAV_CRLB_P20: [f64; STATES] = [
    2.191_559_314_363_993_2e-13,
    3.773_709_818_813_917_5e-13,
    0.000_656_844_472_902_010_6,
    0.000_110_901_002_721_625_75,
    0.000_110_902_768_753_927_52,
    0.000_461_091_039_541_799_37,
    3.046_221_446_394_892e-8,
    3.046_221_403_592_464_6e-8,
    3.046_238_438_691_929e-8,
    0.001_056_026_903_545_464_2,
    9.999_977_460_163_251e-5,
    6.002_500_175_460_066e-8,
    6.002_500_174_654_031e-8,
    6.002_500_175_886_827e-8,
    5.285_290_154_889_564e-17,
    5.285_290_154_889_564e-17,
    5.285_290_154_889_564e-17,
    0.502_711_388_286_209_8,
];

/// Positions of an INS as the truth.
fn path_of<'a>(ins: &InsSeries<'a>) -> TruePath<'a> {
    TruePath { lat_deg: ins.lat_deg, lon_deg: ins.lon_deg, alt_m: ins.alt_m, velocity_ned_mps: None }
}

#[test]
fn val_magnav_bound_in_the_compatible_form() {
    let (line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    let ins = line.series();
    let output = run(&line.line(&ins, &map, InsErrorModel::compatible()), &path_of(&ins), true).unwrap();
    for (state, theirs) in from_magnav(&MAGNAV_CRLB_P20).into_iter().enumerate() {
        // MagNav.jl's gradient is a central difference over 1e-8 rad with a rounding error of 1e-7.
        assert!((output.p[19][state][state] / theirs - 1.0).abs() < 1e-8, "{state}");
    }
    assert_eq!(output.report.updates, 20);
}

/// Covariance of the last state given all measurements, from the joint Gaussian of the initial state and the noise of
/// all steps, without a recursion.
fn batch_covariance(line: &NavigationLine<'_>, rows: &[usize]) -> SMatrix<f64, STATES, STATES> {
    type Square = SMatrix<f64, STATES, STATES>;
    let dense = |m: &StateMatrix| Square::from_fn(|row, column| m[row][column]);
    let ins = line.ins;
    let steps: Vec<_> = (1..ins.len()).map(|row| line.step(row)).collect();
    // Cov(x_j, x_k) = Cov(x_j) Φᵀ(k ← j) for j ≤ k.
    let mut marginal = vec![dense(&line.errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]))];
    for (row, step) in steps.iter().enumerate() {
        let phi = dense(&step.phi);
        marginal.push(phi * marginal[row] * phi.transpose() + dense(&step.noise));
    }
    let shared = |j: usize, k: usize| (j..k).fold(marginal[j], |p, row| p * dense(&steps[row].phi).transpose());
    let last = ins.len() - 1;
    let h = |row: usize| {
        let field = line.predicted().at_error(ins, row, [0.0; 3]).unwrap();
        let mut h = SMatrix::<f64, STATES, 1>::zeros();
        (h[0], h[1], h[2]) = (field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, field.d_alt_nt_per_m);
        h[STATES - 1] = 1.0;
        h
    };
    let slopes: Vec<_> = rows.iter().map(|row| h(*row)).collect();
    let n = rows.len();
    let mut z = DMatrix::zeros(n, n);
    let mut with_last = DMatrix::zeros(n, STATES);
    for (a, row) in rows.iter().enumerate() {
        for (b, other) in rows.iter().enumerate().skip(a) {
            let value = (slopes[a].transpose() * shared(*row, *other) * slopes[b])[0];
            (z[(a, b)], z[(b, a)]) = (value, value);
        }
        z[(a, a)] += line.sigma_nt[*row].powi(2);
        with_last.row_mut(a).copy_from(&(slopes[a].transpose() * shared(*row, last)));
    }
    let gained = with_last.transpose() * z.cholesky().unwrap().solve(&with_last);
    marginal[last] - Square::from_fn(|row, column| gained[(row, column)])
}

#[test]
fn law_the_recursion_equals_the_batch_covariance() {
    let (mut line, map) = (OwnedNavigationLine::golden(0.7), golden_map());
    line.measurement_nt[3] = f64::NAN;
    line.sigma_nt[8] = 2.0;
    line.columns[0][11..].iter_mut().for_each(|tt| *tt += 3.0);
    let ins = line.series();
    let wide = InsErrors { init_position_sigma_m: 30.0, init_altitude_sigma_m: 5.0, ..InsErrors::default() };
    let line = line.line(&ins, &map, InsErrorModel::from_sources(wide));
    let found = run(&line, &path_of(&ins), true).unwrap().p[19];
    let measured: Vec<usize> = (0..20).filter(|row| *row != 3).collect();
    let expected = batch_covariance(&line, &measured);
    for row in 0..STATES {
        for column in 0..STATES {
            let size = (expected[(row, row)] * expected[(column, column)]).sqrt();
            // The batch solves a matrix whose condition number is the ratio of the variance of 30 m of slope to the
            // variance of the noise: 1e6.
            assert!((found[row][column] - expected[(row, column)]).abs() < 1e-8 * size, "{row} {column}");
        }
    }
}

#[test]
fn law_over_a_plane_it_equals_the_covariance_of_the_ekf() {
    let (line, map) = (OwnedNavigationLine::golden(3.0), plane());
    let ins = line.series();
    let line = line.line(&ins, &map, InsErrorModel::default());
    let (bound, ekf) = (run(&line, &path_of(&ins), true).unwrap(), known(&line, 3.0).unwrap());
    for (row, (bound, ekf)) in bound.p.iter().zip(&ekf.p).enumerate() {
        for (bound, ekf) in bound.as_flattened().iter().zip(ekf.as_flattened()) {
            // The slopes differ by the rounding of the position within the cell.
            assert!((bound - ekf).abs() <= 1e-11 * ekf.abs(), "{row} {bound} {ekf}");
        }
    }
}

#[test]
fn law_the_filters_attain_the_bound() {
    let n = FLIGHTS as f64;
    let bound = ensemble().iter().map(|run| claimed_m2(&run.bound, 0)).sum::<f64>() / n;
    let ekf = ensemble().iter().map(|run| run.flight.square_m2(&run.ekf, 0)).sum::<f64>() / n;
    let ukf = ensemble().iter().map(|run| run.flight.square_m2(&run.ukf.navigation, 0)).sum::<f64>() / n;
    println!("DRMS: EKF {:.2}, UKF {:.2}, bound {:.2} m", ekf.sqrt(), ukf.sqrt(), bound.sqrt());
    // No filter is better than the bound, except by chance, because there are only 60 flights. Errors are correlated
    // over minutes, so a flight has about 20 independent errors in each direction, and the root mean square varies by
    // 1/√(2·2·20·60) = 1.5 %.
    for square in [ekf, ukf] {
        let ratio = (square / bound).sqrt();
        assert!((0.95..1.2).contains(&ratio), "{ratio}");
    }
    // The residual at the truth has the assumed variance. S has a time constant of 600 s, so there are 60 times 3
    // independent values with a third of the variance.
    let nis = ensemble().iter().map(|run| run.bound.nis.iter().sum::<f64>()).sum::<f64>() / (n * f64::from(SAMPLES));
    assert!((nis - 1.0).abs() < 0.1, "{nis}");
}

#[test]
fn law_the_estimate_is_the_truth_and_the_residual_refers_to_it() {
    let (mut line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    line.measurement_nt[4] = f64::NAN;
    line.sigma_nt[5] = 0.0;
    let ins = line.series();
    let mut truth = line.clone();
    truth.columns[1].iter_mut().for_each(|lat| *lat += 1e-6_f64.to_degrees());
    truth.columns[2].iter_mut().for_each(|lon| *lon -= 2e-6_f64.to_degrees());
    truth.columns[1][9] += 1.0;
    truth.columns[4].fill(64.0);
    let true_ins = truth.series();
    let velocity_ned_mps = Some([true_ins.vn_mps, true_ins.ve_mps, true_ins.vd_mps]);
    let path = TruePath { velocity_ned_mps, ..path_of(&true_ins) };
    let output = run(&line.line(&ins, &map, InsErrorModel::default()), &path, false).unwrap();
    assert_eq!(
        (&output.lat_deg, &output.lon_deg, &output.alt_m),
        (&truth.columns[1], &truth.columns[2], &truth.columns[3])
    );
    assert!(output.vn_mps.iter().all(|vn| *vn == 64.0) && output.x.is_empty() && output.p.is_empty());
    let report = output.report;
    assert_eq!((report.updates, report.missing_measurements, report.off_map), (17, 2, 1));
    for row in 0..20 {
        if [4, 5, 9].contains(&row) {
            assert!(output.residual_nt[row].is_nan() && output.nis[row].is_nan() && output.sd_n_m[row].is_finite());
        } else {
            // Measurement minus the map at the truth. 2 m on a slope of 4e5 nT/rad have a rounding error of 1e-10 nT.
            let expected = 0.5 * (row as f64).sin();
            assert!((output.residual_nt[row] - expected).abs() < 1e-9, "{row}");
            assert!((output.nis[row] - expected * expected / 18.0).abs() < 1e-9);
        }
    }
    let without = TruePath { velocity_ned_mps: None, ..path };
    let output = run(&line.line(&ins, &map, InsErrorModel::default()), &without, true).unwrap();
    assert!(output.vn_mps.iter().all(|vn| *vn == 63.0) && output.p.len() == 20);
}

#[test]
fn law_the_offset_refers_to_the_truth_and_does_not_change_the_bound() {
    let (mut line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    let ins = line.series();
    let plain = run(&line.line(&ins, &map, InsErrorModel::default()), &path_of(&ins), false).unwrap();
    line.measurement_nt.iter_mut().for_each(|measured| *measured += 700.0);
    let ins = line.series();
    let with = NavigationLine { offset_window_s: 0.25, ..line.line(&ins, &map, InsErrorModel::default()) };
    let output = run(&with, &path_of(&ins), false).unwrap();
    assert_eq!((output.report.offset_samples, &output.sd_n_m), (3, &plain.sd_n_m));
    assert!(output.residual_nt[..3].iter().sum::<f64>().abs() < 1e-9);
    let one = line.thinned(|row| row == 0);
    let ins = one.series();
    let one = run(&one.line(&ins, &map, InsErrorModel::default()), &path_of(&ins), false).unwrap();
    assert_eq!(one.sd_n_m, plain.sd_n_m[..1], "one sample is a line");
}

#[test]
fn unit_invalid_paths_are_rejected() {
    let (line, map) = (OwnedNavigationLine::golden(3.0), golden_map());
    let ins = line.series();
    let line = line.line(&ins, &map, InsErrorModel::default());
    let message = |path: &TruePath<'_>| run(&line, path, false).unwrap_err().to_string();
    let usual = path_of(&ins);
    assert_eq!(message(&TruePath { lon_deg: &[1.0], ..usual }), "column `lon` has 1 rows, but `tt` has 20");
    let mut gap = ins.lat_deg.to_vec();
    gap[7] = f64::NAN;
    let found = message(&TruePath { lat_deg: &gap, ..usual });
    assert!(found.starts_with("column `lat` is NaN in row 7"), "{found}");
    gap[7] = 90.0;
    let found = message(&TruePath { lat_deg: &gap, ..usual });
    assert!(found.starts_with("column `lat` is 90 degrees in row 7"), "{found}");
    let velocity_ned_mps = Some([ins.vn_mps, ins.ve_mps, &[]]);
    assert_eq!(message(&TruePath { velocity_ned_mps, ..usual }), "column `vd` has 0 rows, but `tt` has 20");
}

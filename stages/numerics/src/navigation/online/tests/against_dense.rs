//! Comparison of the recursion with dense solutions.

use super::*;
use crate::earth::field_value::FieldValue;
use crate::maps::FieldMap;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES};
use crate::navigation::{InsErrorModel, InsErrors, NavigationLine};
use nalgebra::{DMatrix, DVector};

fn of_rows(rows: &[[f64; STATES]; STATES]) -> DMatrix<f64> {
    DMatrix::from_fn(STATES, STATES, |row, column| rows[row][column])
}

/// Normal distribution of the states at a sample and of all measurements so far, from the dynamics alone.
struct Joint {
    states: DMatrix<f64>,
    /// Covariance of the states with each measurement's noiseless value.
    with: Vec<DVector<f64>>,
    /// Covariance matrix of the measurements.
    among: Vec<Vec<f64>>,
}

impl Joint {
    fn step(&mut self, phi: &DMatrix<f64>, noise: &DMatrix<f64>) {
        self.states = phi * &self.states * phi.transpose() + noise;
        self.with.iter_mut().for_each(|with| *with = phi * &*with);
    }

    fn measure(&mut self, h: &DVector<f64>) {
        let with = &self.states * h;
        let mut row: Vec<f64> = self.with.iter().map(|earlier| earlier.dot(h)).collect();
        row.push(with.dot(h));
        self.with.push(with);
        self.among.push(row);
    }

    /// Mean and covariance of the states given the measurements minus the prior mean of the measurements, from one
    /// dense solution.
    fn given(&self, measured_nt: &[f64], sigma_nt: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
        let count = measured_nt.len();
        let mut all = DMatrix::from_fn(count, count, |i, j| self.among[i.max(j)][i.min(j)]);
        (0..count).for_each(|i| all[(i, i)] += sigma_nt[i] * sigma_nt[i]);
        let cross = DMatrix::from_columns(&self.with);
        let inverse = all.cholesky().unwrap();
        let mean = &cross * inverse.solve(&DVector::from_column_slice(measured_nt));
        (mean, &self.states - &cross * inverse.solve(&cross.transpose()))
    }
}

#[test]
fn law_on_a_linear_map_it_equals_least_squares_of_the_whole_line() {
    let map = sloping();
    let mut flight = Flight::turning(&map, 2);
    // Five terms per magnetometer; some terms are constant within the line.
    let narrow: Vec<f64> = flight.terms[0].chunks_exact(18).flat_map(|row| row[..5].to_vec()).collect();
    flight.replace_terms(&map, &narrow, 5, 80.0);
    let rows = 60_usize;
    flight.columns.iter_mut().for_each(|column| column.truncate(rows));
    for k in 0..2 {
        flight.measurement_nt[k].truncate(rows);
        flight.sigma_nt[k].truncate(rows);
        flight.terms[k].truncate(5 * rows);
    }
    let sources = InsErrors { init_position_sigma_m: 200.0, init_altitude_sigma_m: 5.0, ..InsErrors::default() };
    flight.errors = InsErrorModel { noise: NoiseDiscretisation::VanLoan, ..InsErrorModel::from_sources(sources) };
    let line = flight.line(&map);
    let density = [0.5, 1.0, 2.0, 0.0, 4.0];
    let mixed = |i: usize, j: usize| if i == j { 80.0_f64.powi(2) } else { 1000.0 };
    let covariance = (0..25).map(|ij| mixed(ij / 5, ij % 5)).collect();
    let prior = CoefficientPrior { mean: vec![10.0, -20.0, 30.0, 0.0, 5.0], covariance };
    let magnetometers = [0, 1].map(|k| flight.magnetometer(k, &prior, &density));
    let ours = run(&line, &magnetometers, None, &ALL).unwrap();

    let states = STATES + 10;
    let steps = NavigationLine {
        ins: line.ins,
        measurement_nt: &flight.measurement_nt[0],
        sigma_nt: &flight.sigma_nt[0],
        map: &map,
        core: None,
        errors: flight.errors,
        offset_window_s: 0.0,
        fixes: None,
        second_order: false,
    };
    let mut first = DMatrix::zeros(states, states);
    let p0 = flight.errors.initial_covariance(line.ins.lat_deg[0].to_radians(), line.ins.alt_m[0]);
    first.view_mut((0, 0), (STATES, STATES)).copy_from(&of_rows(&p0));
    for k in 0..2 {
        let place = STATES + 5 * k;
        first.view_mut((place, place), (5, 5)).copy_from(&DMatrix::from_row_slice(5, 5, &prior.covariance));
    }
    let mut joint = Joint { states: first, with: vec![], among: vec![] };
    let (mut measured_nt, mut sigma_nt) = (vec![], vec![]);
    for row in 0..rows {
        if row > 0 {
            let step = steps.step(row);
            let (mut phi, mut noise) = (DMatrix::identity(states, states), DMatrix::zeros(states, states));
            phi.view_mut((0, 0), (STATES, STATES)).copy_from(&of_rows(&step.phi));
            noise.view_mut((0, 0), (STATES, STATES)).copy_from(&of_rows(&step.noise));
            (0..10).for_each(|c| noise[(STATES + c, STATES + c)] = density[c % 5] * step.dt_s);
            joint.step(&phi, &noise);
        }
        let field: FieldValue = map.at(line.ins.lat_deg[row], line.ins.lon_deg[row], line.ins.alt_m[row]).unwrap();
        for k in 0..2 {
            let terms = &flight.terms[k][5 * row..][..5];
            let mut h = DVector::zeros(states);
            (h[LAT], h[LON], h[ALT], h[S]) =
                (field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, field.d_alt_nt_per_m, 1.0);
            (0..5).for_each(|c| h[STATES + 5 * k + c] = terms[c]);
            joint.measure(&h);
            let before: f64 = terms.iter().zip(&prior.mean).map(|(a, b)| a * b).sum();
            measured_nt.push(flight.measurement_nt[k][row] - field.value_nt - before);
            sigma_nt.push(flight.sigma_nt[k][row]);
        }
    }
    let (x, p) = joint.given(&measured_nt, &sigma_nt);
    // The precision of the dense solution is reduced by the condition number of the covariance, about 1e5; an error of
    // 1e-6 of a standard deviation remains.
    for state in 0..STATES {
        let sd = p[(state, state)].sqrt();
        let (x_ours, p_ours) = (ours.navigation.x[rows - 1][state], &ours.navigation.p[rows - 1][state]);
        assert!((x_ours - x[state]).abs() < 1e-6 * sd, "{state} {x_ours:e} {:e}", x[state]);
        for other in 0..STATES {
            let size = sd * p[(other, other)].sqrt();
            assert!((p_ours[other] - p[(state, other)]).abs() < 1e-6 * size, "{state} {other}");
        }
    }
    for (k, estimate) in ours.magnetometers.iter().enumerate() {
        for c in 0..5 {
            let place = STATES + 5 * k + c;
            let sd = p[(place, place)].sqrt();
            let expected = prior.mean[c] + x[place];
            assert!((estimate.coefficients[c] - expected).abs() < 1e-6 * sd, "{c} {expected}");
            for d in 0..5 {
                let (found, expected) = (estimate.covariance[5 * c + d], p[(place, STATES + 5 * k + d)]);
                assert!((found - expected).abs() < 1e-6 * sd * p[(place - c + d, place - c + d)].sqrt());
            }
        }
    }
}

/// Map without slope and an INS without error: only the coefficients are unknown.
fn only_coefficients(flight: &mut Flight) -> FieldMap {
    let sources = InsErrors {
        init_position_sigma_m: 0.0,
        init_altitude_sigma_m: 0.0,
        init_velocity_sigma_mps: 0.0,
        init_attitude_sigma_deg: 0.0,
        vrw_sigma: 0.0,
        arw_sigma: 0.0,
        baro_sigma_m: 0.0,
        ha_sigma_m: 0.0,
        a_hat_sigma_mps2: 0.0,
        acc_sigma_mps2: 0.0,
        gyro_sigma_radps: 0.0,
        ..InsErrors::default()
    };
    flight.errors = InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::from_sources(sources) };
    wavy(-74.85)
}

/// Least-squares solution for the coefficients of a line, by QR decomposition of the rows of the prior and the rows of
/// the line, divided by the noise.
fn by_qr(flight: &Flight, prior_sigma: &[f64], residual_nt: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let (width, rows) = (flight.width, residual_nt.len());
    let entry = |row: usize, column: usize| match row.checked_sub(width) {
        None if row == column => 1.0,
        None => 0.0,
        Some(row) => flight.terms[0][row * width + column] * prior_sigma[column] / flight.sigma_nt[0][row],
    };
    let a = DMatrix::from_fn(rows + width, width, entry);
    let target = DVector::from_fn(rows + width, |row, _| match row.checked_sub(width) {
        None => 0.0,
        Some(row) => residual_nt[row] / flight.sigma_nt[0][row],
    });
    let qr = a.qr();
    let inverse = qr.r().try_inverse().unwrap();
    let scale = DMatrix::from_diagonal(&DVector::from_column_slice(prior_sigma));
    let root = scale * &inverse;
    (&root * (qr.q().transpose() * target), &root * root.transpose())
}

#[test]
fn law_a_cold_start_loses_no_significant_digits() {
    // Prior of 1e4 nT against noise of 0.5 nT. All columns of the first half are constant: the aircraft flies straight.
    for straight in [0, 115, ROWS] {
        let mut flight = Flight::turning(&wavy(-74.85), 1);
        let map = only_coefficients(&mut flight);
        for row in 1..straight {
            let (earlier, later) = flight.terms[0].split_at_mut(18 * row);
            later[..18].copy_from_slice(&earlier[..18]);
        }
        flight.sigma_nt[0].fill(0.5);
        let a = flight.terms[0].clone();
        flight.replace_terms(&map, &a, 18, 5000.0);
        let prior = CoefficientPrior::independent(&[0.0; 18], &[1e4; 18]);
        let none = vec![0.0; 18];
        let line = flight.line(&map);
        let ours = run(&line, &[flight.magnetometer(0, &prior, &none)], None, &ALL).unwrap();
        let at = |row: usize| map.at(line.ins.lat_deg[row], line.ins.lon_deg[row], 0.0).unwrap().value_nt;
        let residual_nt: Vec<f64> = (0..ROWS).map(|row| flight.measurement_nt[0][row] - at(row)).collect();
        let (x, p) = by_qr(&flight, &[1e4; 18], &residual_nt);
        let estimate = &ours.magnetometers[0];
        for c in 0..18 {
            let sd = p[(c, c)].sqrt();
            // The first update leaves an error of (1e4 nT)² 18 / (0.5 nT)² times 1e-16, which is 1e-6, in the variance
            // of the measured sum. The position's 1e-30 per s contribute less.
            let missed = (estimate.coefficients[c] - x[c]).abs() / sd;
            assert!(missed < 1e-4, "{straight} {c} {missed:e}");
            for d in 0..18 {
                let size = sd * p[(d, d)].sqrt();
                let missed = (estimate.covariance[18 * c + d] - p[(c, d)]).abs() / size;
                assert!(missed < 1e-5, "{straight} {c} {d} {missed:e}");
            }
        }
        let correlation =
            DMatrix::from_fn(18, 18, |c, d| estimate.covariance[18 * c + d] / (p[(c, c)] * p[(d, d)]).sqrt());
        let transposed = correlation.transpose();
        assert!(correlation == transposed, "symmetric to the bit");
        let exact = DMatrix::from_fn(18, 18, |c, d| p[(c, d)] / (p[(c, c)] * p[(d, d)]).sqrt());
        let (least, expected) = (correlation.symmetric_eigenvalues().min(), exact.symmetric_eigenvalues().min());
        assert!(least > 0.0 && (least / expected - 1.0).abs() < 1e-2, "{straight} {least:e} {expected:e}");
    }
}

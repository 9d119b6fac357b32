#![allow(clippy::unwrap_used)]
use super::*;
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector};
use crate::navigation::scenes::{DenseStateMatrix, DenseStateVector, dense};
use crate::random::NormalGenerator;
use nalgebra::SVector;

/// Correlated estimate with states of similar scales.
pub(crate) fn random_estimate(seed: u64) -> StateEstimate {
    let mut normals = NormalGenerator::new(seed);
    let root = DenseStateMatrix::from_fn(|_, _| normals.draw());
    let p = root * root.transpose();
    let mut p: StateMatrix = std::array::from_fn(|row| std::array::from_fn(|column| p[(row, column)]));
    mirror(&mut p);
    StateEstimate { x: std::array::from_fn(|_| normals.draw()), p }
}

/// Correlated estimate with states of different scales.
fn estimate() -> StateEstimate {
    let mut normals = NormalGenerator::new(3);
    let root = DenseStateMatrix::from_fn(|row, _| 10_f64.powi(row as i32 % 5 - 3) * normals.draw());
    let p = root * root.transpose();
    let p = std::array::from_fn(|row| std::array::from_fn(|column| p[(row.min(column), row.max(column))]));
    StateEstimate { x: std::array::from_fn(|_| normals.draw()), p }
}

/// Largest difference between two covariances, in standard deviations of the first covariance.
fn difference(a: &DenseStateMatrix, b: &DenseStateMatrix) -> f64 {
    let relative = |row: usize, column: usize| {
        (a[(row, column)] - b[(row, column)]).abs() / (a[(row, row)] * a[(column, column)]).sqrt()
    };
    (0..STATES).flat_map(|row| (0..STATES).map(move |column| relative(row, column))).fold(0.0, f64::max)
}

#[test]
fn law_a_correction_equals_the_dense_formula_and_can_be_reverted() {
    let (before, slope) = (estimate(), [40.0, -7.0, 0.3]);
    let h = SVector::<f64, STATES>::from_fn(|state, _| match state {
        LAT | LON | ALT => slope[state],
        S => 1.0,
        _ => 0.0,
    });
    for noise_nt2 in [1e-6, 1.0, 1e4] {
        let p = dense(&before.p);
        let at = before.linearised(Sensitivity::of_slope(slope));
        let (ph, variance) = (p * h, (h.transpose() * p * h)[0]);
        assert!((at.variance / variance - 1.0).abs() < 1e-12);
        let gain = ph / (variance + noise_nt2);
        let mut after = before;
        after.correct(&at, 2.5, noise_nt2);
        for state in 0..STATES {
            let moved = after.x[state] - before.x[state];
            // The mean is of order 1, with a relative rounding error of 1e-16.
            assert!((moved - 2.5 * gain[state]).abs() < 1e-13 * (1.0 + gain[state].abs()), "{state}");
            assert!((0..STATES).all(|other| after.p[state][other] == after.p[other][state]));
        }
        // Joseph's form equals the short form up to rounding of the prior.
        assert!(difference(&(p - gain * ph.transpose()), &dense(&after.p)) < 1e-9);
        assert!(dense(&after.p).cholesky().is_some(), "positive");
        let mut half = after;
        half.give_back(&at, noise_nt2, 0.5);
        after.give_back(&at, noise_nt2, 1.0);
        assert!(difference(&p, &dense(&after.p)) < 1e-13);
        assert!(
            difference(&p, &(p - gain * ph.transpose() * 0.5))
                > difference(&dense(&half.p), &(p - gain * ph.transpose() * 0.5))
        );
        assert!((0..STATES).all(|state| (0..STATES).all(|other| half.p[state][other] == half.p[other][state])));
    }
}

#[test]
fn unit_estimates_that_are_not_finite_or_negative_have_diverged() {
    let fault = Err(NavigationError::Diverged { row: 4, tt_s: 0.5 });
    assert_eq!(estimate().check(4, 0.5), Ok(()));
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut wrong = estimate();
        wrong.x[7] = bad;
        assert_eq!(wrong.check(4, 0.5), fault);
    }
    for bad in [f64::NAN, f64::INFINITY, -1e-300] {
        let mut wrong = estimate();
        wrong.p[STATES - 1][STATES - 1] = bad;
        assert_eq!(wrong.check(4, 0.5), fault);
    }
}

#[test]
fn law_the_corrected_covariance_equals_josephs_form() {
    let mut estimate = random_estimate(1);
    let (h, variance) = (Sensitivity([0.7, -1.3, 0.2, 1.0]), 0.5);
    let mut row = DenseStateVector::zeros();
    for (factor, state) in h.0.into_iter().zip(MEASURED) {
        row[state] = factor;
    }
    let p = dense(&estimate.p);
    let ph = h.covariance(&estimate.p);
    // An arbitrary gain: the form holds for every gain, not only for the optimal gain.
    let gain: StateVector = std::array::from_fn(|state| 0.1 * (state as f64).cos());
    let dense_gain = DenseStateVector::from_fn(|state, _| gain[state]);
    let rest = DenseStateMatrix::identity() - dense_gain * row.transpose();
    let expected = rest * p * rest.transpose() + dense_gain * variance * dense_gain.transpose();
    let sum = h.dot(&ph) + variance;
    let best = ph.map(|ph| ph / sum);
    assert!(((p * row) - DenseStateVector::from_fn(|state, _| ph[state])).norm() < 1e-12);
    estimate.correct_covariance(&h, &gain, &ph, variance);
    // Entries are of order 10 to 100.
    assert!((dense(&estimate.p) - expected).abs().max() < 1e-11);
    let mut estimate = random_estimate(1);
    estimate.correct_covariance(&h, &best, &ph, variance);
    let expected = p - (p * row) * (p * row).transpose() / ((row.transpose() * p * row)[(0, 0)] + variance);
    assert!((dense(&estimate.p) - expected).abs().max() < 1e-11);
    assert_eq!(dense(&estimate.p), dense(&estimate.p).transpose());
}

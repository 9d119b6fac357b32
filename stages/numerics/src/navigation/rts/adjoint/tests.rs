use super::*;
use crate::navigation::gaussian::tests::random_estimate;
use crate::navigation::pinson::{InsPoint, PinsonForm, TimeConstants, pinson_matrix};
use crate::navigation::scenes::{DenseStateMatrix, DenseStateVector, dense};
use crate::navigation::transition::transition_matrix;

fn adjoint() -> AdjointState {
    let estimate = random_estimate(5);
    AdjointState { state: estimate.x, matrix: estimate.p }
}

/// Largest difference over the largest entry.
fn apart(a: &DenseStateMatrix, b: &DenseStateMatrix) -> f64 {
    (a - b).abs().max() / b.abs().max()
}

#[test]
fn law_back_through_a_step_is_the_transposed_transition() {
    let times = TimeConstants { baro_s: 3600.0, acc_s: 1000.0, gyro_s: 500.0, fogm_s: 60.0 };
    let point = InsPoint {
        lat_rad: 0.7,
        vel_ned_mps: [60.0, 30.0, -2.0],
        force_ned_mps2: [0.3, -0.2, -9.8],
        euler_rad: [0.1, 0.05, 0.6],
    };
    let phi = transition_matrix(&pinson_matrix(&point, &times, PinsonForm::Thesis), 2.0);
    let mut back = adjoint();
    let (state, matrix) = (DenseStateVector::from(back.state), dense(&back.matrix));
    back.through_step(&phi);
    let phi = dense(&phi);
    assert!((DenseStateVector::from(back.state) - phi.transpose() * state).norm() < 1e-13 * state.norm() * phi.norm());
    assert!(apart(&dense(&back.matrix), &(phi.transpose() * matrix * phi)) < 1e-14);
    assert_eq!(dense(&back.matrix), dense(&back.matrix).transpose());
}

#[test]
fn law_back_through_a_measurement_equals_the_dense_recursion() {
    let mut back = adjoint();
    let (state, matrix) = (DenseStateVector::from(back.state), dense(&back.matrix));
    let gain: StateVector = std::array::from_fn(|state| 0.1 * (state as f64).sin());
    let used =
        ForwardUpdate { h: Sensitivity([0.7, -1.3, 0.2, 1.0]), gain, force: 0.4, weight: 0.25, variance_nt2: 2.0 };
    let mut h = DenseStateVector::zeros();
    for (factor, state) in used.h.0.into_iter().zip(MEASURED) {
        h[state] = factor;
    }
    let rest = DenseStateMatrix::identity() - DenseStateVector::from(gain) * h.transpose();
    let u = back.through_measurement(&used);
    assert!((u - (0.4 + DenseStateVector::from(gain).dot(&state))).abs() < 1e-14);
    // λ in the form printed by Bierman.
    let expected = rest.transpose() * state - h * 0.4;
    assert!((DenseStateVector::from(back.state) - expected).norm() < 1e-13);
    let expected = rest.transpose() * matrix * rest + h * 0.25 * h.transpose();
    assert!(apart(&dense(&back.matrix), &expected) < 1e-14);
}

#[test]
fn law_the_smoothed_covariance_equals_the_dense_product() {
    let (estimate, back) = (random_estimate(6), adjoint());
    let (p, matrix) = (dense(&estimate.p), dense(&back.matrix));
    assert!(apart(&dense(&back.smoothed(&estimate.p)), &(p - p * matrix * p)) < 1e-14);
}

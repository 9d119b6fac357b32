#![allow(clippy::unwrap_used)]
use super::*;
use crate::navigation::pinson::tests::{GOLDEN_POINT, GOLDEN_TIMES, golden_in_our_order};
use crate::navigation::pinson::{InsPoint, PinsonForm, TimeConstants, pinson_matrix};
use nalgebra::SMatrix;

fn cases() -> [(&'static str, StateMatrix); 2] {
    let turn = InsPoint {
        lat_rad: -1.2,
        vel_ned_mps: [-180.0, 210.0, -8.0],
        force_ned_mps2: [4.1, -5.3, -12.4],
        euler_rad: [-0.8, 0.3, -2.0],
    };
    let times = TimeConstants { baro_s: 900.0, acc_s: 1200.0, gyro_s: 300.0, fogm_s: 60.0 };
    [
        ("level", pinson_matrix(&GOLDEN_POINT, &GOLDEN_TIMES, PinsonForm::Thesis)),
        ("turn", pinson_matrix(&turn, &times, PinsonForm::Thesis)),
    ]
}

/// Spectral densities of the reference's process noise: the defaults of MagNav.jl.
fn density() -> StateVector {
    crate::navigation::ins_error::InsErrorModel::from_sources(crate::navigation::ins_error::InsErrors {
        vrw_sigma: 2.38e-4,
        arw_sigma: 5.81e-7,
        ..Default::default()
    })
    .noise_density()
}

/// Matrix computed by scipy, indexed by case, step and name.
fn reference(case: &str, dt_s: f64, what: &str) -> StateMatrix {
    let mut matrix = [[0.0; STATES]; STATES];
    let prefix = format!("{case},{dt_s:?},{what},");
    let mut found = 0;
    for line in include_str!("../../../reference/navigation/transition.csv").lines() {
        let Some(rest) = line.strip_prefix(&prefix) else {
            continue;
        };
        let words: Vec<&str> = rest.split(',').collect();
        matrix[words[0].parse::<usize>().unwrap()][words[1].parse::<usize>().unwrap()] = words[2].parse().unwrap();
        found += 1;
    }
    assert!(found > 0, "{prefix}");
    matrix
}

/// Largest difference of scaled states (metres, metres per 30 s, and so on).
fn scaled_difference(a: &StateMatrix, b: &StateMatrix) -> f64 {
    let mut worst = 0.0_f64;
    for row in 0..STATES {
        for column in 0..STATES {
            let difference = (a[row][column] - b[row][column]).abs();
            worst = worst.max(difference * SCALE[row] / SCALE[column]);
        }
    }
    worst
}

#[test]
fn val_scipy_matrix_exponential() {
    for (case, f) in cases() {
        for dt_s in [0.1, 1.0, 30.0] {
            let (ours, theirs) = (transition_matrix(&f, dt_s), reference(case, dt_s, "phi"));
            // Both results have a few rounding errors of entries of 1 to 5 in scaled states.
            let worst = scaled_difference(&ours, &theirs);
            assert!(worst < 1e-14, "{case} {dt_s} {worst:e}");
            for row in 0..STATES {
                for column in 0..STATES {
                    let (a, b) = (ours[row][column], theirs[row][column]);
                    let floor = 1e-16 * SCALE[column] / SCALE[row];
                    assert!((a - b).abs() <= 1e-12 * b.abs() + floor, "{case} {dt_s} {row} {column} {a:e} {b:e}");
                }
            }
        }
    }
}

#[test]
fn val_magnav_transition_matrix_in_the_compatible_form() {
    let f = pinson_matrix(&GOLDEN_POINT, &GOLDEN_TIMES, PinsonForm::Compatible);
    let worst = scaled_difference(&transition_matrix(&f, 0.1), &golden_in_our_order("get_Phi_18"));
    assert!(worst < 1e-14, "{worst:e}");
}

#[test]
fn law_the_pattern_contains_every_nonzero_entry() {
    for (_, f) in cases() {
        let mut rest = f;
        for (row, columns) in COUPLING.iter().chain(&DRIVEN) {
            for column in *columns {
                rest[*row][*column] = 0.0;
            }
        }
        for state in GAUSS_MARKOV {
            rest[state][state] = 0.0;
        }
        assert_eq!(rest, [[0.0; STATES]; STATES]);
    }
}

#[test]
fn law_two_steps_equal_one_of_twice_the_length() {
    for (_, f) in cases() {
        for dt_s in [0.05, 0.7, 20.0, 600.0] {
            let half = transition_matrix(&f, dt_s);
            let whole = transition_matrix(&f, 2.0 * dt_s);
            let size = scaled_difference(&whole, &[[0.0; STATES]; STATES]);
            let worst = scaled_difference(&product(&half, &half), &whole);
            assert!(worst < 1e-14 * size.max(1.0), "{dt_s} {worst:e} {size}");
        }
    }
    assert_eq!(transition_matrix(&cases()[0].1, 0.0), identity());
}

#[test]
fn unit_values_that_are_not_finite_propagate() {
    let (_, mut f) = cases()[0];
    f[VN][TILT_E] = f64::NAN;
    assert!(transition_matrix(&f, 0.1)[VN].iter().any(|entry| entry.is_nan()));
}

/// Full covariance with all correlations, from a matrix of odd numbers.
fn full_covariance() -> StateMatrix {
    let mut p = [[0.0; STATES]; STATES];
    for row in 0..STATES {
        for column in 0..STATES {
            let sum: f64 = (0..STATES)
                .map(|k| {
                    let a = ((row * 7 + k * 3 + 1) as f64).sin() / SCALE[row];
                    let b = ((column * 7 + k * 3 + 1) as f64).sin() / SCALE[column];
                    a * b
                })
                .sum();
            p[row][column] = sum;
        }
    }
    std::array::from_fn(|row| std::array::from_fn(|column| p[row.min(column)][row.max(column)]))
}

fn dense(m: &StateMatrix) -> SMatrix<f64, STATES, STATES> {
    SMatrix::from_fn(|row, column| m[row][column] * 1.0)
}

#[test]
fn law_sparse_products_equal_dense_ones_and_are_symmetric() {
    let p = full_covariance();
    for (_, f) in cases() {
        for dt_s in [0.1, 30.0] {
            let phi = transition_matrix(&f, dt_s);
            let ours = propagate_covariance(&phi, &p);
            let theirs = dense(&phi) * dense(&p) * dense(&phi).transpose();
            for row in 0..STATES {
                for column in 0..STATES {
                    assert_eq!(ours[row][column], ours[column][row]);
                    let size = SCALE[row] * SCALE[column];
                    let difference = (ours[row][column] - theirs[(row, column)]).abs() * size;
                    // Entries of about 10 in scaled states, which increase by up to 5² over 30 s.
                    assert!(difference < 1e-11, "{row} {column} {difference:e}");
                }
            }
            let x: StateVector = std::array::from_fn(|k| (k as f64 + 0.5).sin() / SCALE[k]);
            let moved = propagate_state(&phi, &x);
            for row in 0..STATES {
                let expected: f64 = (0..STATES).map(|k| phi[row][k] * x[k]).sum();
                assert!((moved[row] - expected).abs() * SCALE[row] < 1e-13);
            }
        }
    }
}

/// Largest difference relative to the standard deviations of the second covariance.
fn correlation_difference(a: &StateMatrix, b: &StateMatrix) -> f64 {
    let mut worst = 0.0_f64;
    for row in 0..STATES {
        for column in 0..STATES {
            let size = (b[row][row] * b[column][column]).sqrt();
            worst = worst.max((a[row][column] - b[row][column]).abs() / size);
        }
    }
    worst
}

#[test]
fn val_scipy_van_loan_noise() {
    for (case, f) in cases() {
        for dt_s in [0.1, 1.0, 30.0] {
            let (ours, theirs) = (van_loan(&f, &density(), dt_s), reference(case, dt_s, "noise"));
            // Relative to the noise that the step adds, in every state. In the smallest (position within 0.1 s),
            // scipy's own rounding error is 1e-7 of this noise.
            let worst = correlation_difference(&ours, &theirs);
            assert!(worst < 1e-6, "{case} {dt_s} {worst:e}");
        }
    }
}

#[test]
fn law_trapezoidal_noise_is_second_order_and_rectangular_first() {
    // Velocity noise from tilt and biases within a step, relative to the velocity noise.
    let (_, f) = cases()[1];
    let q = density();
    let error = |dt_s: f64, noise: NoiseDiscretisation| {
        let phi = transition_matrix(&f, dt_s);
        let step = step_covariance(&[[0.0; STATES]; STATES], &f, &phi, &q, dt_s, noise);
        let exact = van_loan(&f, &q, dt_s);
        (step[S][S] / exact[S][S] - 1.0).abs()
    };
    for (noise, order) in [(NoiseDiscretisation::Rectangular, 1), (NoiseDiscretisation::Trapezoidal, 2)] {
        let ratio = error(2.0, noise) / error(1.0, noise);
        assert!((ratio / f64::from(1 << order) - 1.0).abs() < 0.05, "{noise:?} {ratio}");
    }
    assert!(error(2.0, NoiseDiscretisation::VanLoan) < 1e-13);
}

#[test]
fn law_every_noise_is_positive_semidefinite() {
    for (_, f) in cases() {
        for dt_s in [0.1, 1.0, 60.0] {
            let phi = transition_matrix(&f, dt_s);
            for noise in
                [NoiseDiscretisation::Rectangular, NoiseDiscretisation::Trapezoidal, NoiseDiscretisation::VanLoan]
            {
                let zero = [[0.0; STATES]; STATES];
                let q = step_covariance(&zero, &f, &phi, &density(), dt_s, noise);
                let scaled = SMatrix::<f64, STATES, STATES>::from_fn(|row, column| {
                    q[row][column] / (q[row][row] * q[column][column]).sqrt()
                });
                let smallest = scaled.symmetric_eigenvalues().min();
                assert!(smallest > -1e-13, "{noise:?} {dt_s} {smallest:e}");
            }
        }
    }
}

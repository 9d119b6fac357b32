#![allow(clippy::unwrap_used)]
use super::super::online::tests::flights::{Flight, ROWS, wavy};
use super::training::{NetworkRecursion, diagonal};
use super::*;
use crate::navigation::ekf::{EkfInput, EkfParameters, run_together};
use crate::random::NormalGenerator;
use nalgebra::{DMatrix, DVector};

const ALL: OnlineParameters = OnlineParameters {
    gate_nis: None,
    recover_after: None,
    keep_states: true,
    keep_covariance: true,
    keep_coefficients: true,
};

/// Rows of three features and a smooth function of the features, in nT.
fn samples(rows: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut normals = NormalGenerator::new(seed);
    let features: Vec<f64> = (0..rows)
        .flat_map(|_| [10.0 + 2.0 * normals.draw(), 1e-3 * normals.draw(), 500.0 + 100.0 * normals.draw()])
        .collect();
    let field = |row: &[f64]| {
        let [a, b, c] = [(row[0] - 10.0) / 2.0, row[1] / 1e-3, (row[2] - 500.0) / 100.0];
        60.0 * (0.8 * a).tanh() + 25.0 * b * c / (1.0 + b * b) - 40.0 * c
    };
    let field_nt = features.chunks_exact(3).map(field).collect();
    (features, field_nt)
}

fn network(hidden: usize, activation: OnlineActivation) -> OnlineNetwork {
    OnlineNetwork::new(&samples(500, 9).0, 3, hidden, activation, 50.0).unwrap()
}

#[test]
fn law_back_propagation_equals_differences() {
    for activation in [OnlineActivation::Swish, OnlineActivation::Tanh] {
        let network = network(5, activation);
        let weights: Vec<f64> = network.draw(4).iter().map(|w| 2.0 * w).collect();
        for inputs in network.standardised(&samples(40, 3).0).chunks_exact(3) {
            let mut ours = vec![0.0; network.weights()];
            let value = network.value_and_gradient(inputs, &weights, &mut ours);
            assert_eq!(value, network.value(inputs, &weights));
            for weight in 0..weights.len() {
                let at = |step: f64| {
                    let mut moved = weights.clone();
                    moved[weight] += step;
                    network.value(inputs, &moved)
                };
                // Fourth order: the fifth derivative of 50 nT times 1e-12, and a rounding error of 1e-14 over 1e-3.
                let theirs = (8.0 * (at(1e-3) - at(-1e-3)) - (at(2e-3) - at(-2e-3))) / 12e-3;
                assert!((ours[weight] - theirs).abs() < 1e-8, "{activation:?} {weight} {} {theirs}", ours[weight]);
            }
        }
    }
}

#[test]
fn law_training_only_the_output_layer_equals_least_squares() {
    let (hidden, sigma_nt) = (4, 3.0);
    let network = network(hidden, OnlineActivation::Tanh);
    let (features, field_nt) = samples(300, 5);
    let inputs = network.standardised(&features);
    let states = network.weights();
    let first = states - hidden - 1;
    let mut sigma = vec![0.0; first];
    sigma.resize(states, 2.0);
    let start = network.draw(8);
    let mut recursion = NetworkRecursion::new(&network, sigma_nt, start.clone(), &diagonal(&sigma));
    for (row, nt) in inputs.chunks_exact(3).zip(&field_nt) {
        recursion.update(row, *nt);
    }
    // Ridge regression about the initial weights, by the normal equations.
    let mut phi = vec![0.0; states];
    let (mut normal, mut right) = (DMatrix::identity(hidden + 1, hidden + 1) / 4.0, DVector::zeros(hidden + 1));
    for (row, nt) in inputs.chunks_exact(3).zip(&field_nt) {
        let missed = nt - network.value_and_gradient(row, &start, &mut phi);
        let phi = DVector::from_column_slice(&phi[first..]) / sigma_nt;
        right += &phi * (missed / sigma_nt);
        normal += &phi * phi.transpose();
    }
    let inverse = normal.try_inverse().unwrap();
    let change = &inverse * right;
    for k in 0..=hidden {
        let sd = inverse[(k, k)].sqrt();
        let (ours, expected) = (recursion.weights[first + k], start[first + k] + change[k]);
        // The condition number of the normal equations, about 1e5, leaves an error of 1e-10.
        assert!((ours - expected).abs() < 1e-8 * sd, "{k} {ours} {expected}");
        for j in 0..=hidden {
            let size = sd * inverse[(j, j)].sqrt();
            assert!((recursion.p.at(first + k, first + j) - inverse[(k, j)]).abs() < 1e-8 * size, "{k} {j}");
        }
    }
    assert_eq!(recursion.weights[..first], start[..first]);
}

#[test]
fn unit_training_fits_a_nonlinear_function() {
    let (features, mut field_nt) = samples(1500, 11);
    let tt_s: Vec<f64> = (0..1500).map(f64::from).collect();
    let mut normals = NormalGenerator::new(2);
    field_nt.iter_mut().for_each(|nt| *nt += 2.0 * normals.draw());
    field_nt[700] = f64::NAN;
    let (unseen, truth_nt) = samples(500, 12);
    for activation in [OnlineActivation::Swish, OnlineActivation::Tanh] {
        let network = network(8, activation);
        let calibration = NetworkCalibration { tt_s: &tt_s, features: &features, aircraft_nt: &field_nt };
        let parameters = TrainingParameters { sigma_nt: 2.0, ..TrainingParameters::default() };
        let prior = train(&network, &calibration, None, &parameters).unwrap();
        let again = train(&network, &calibration, None, &parameters).unwrap();
        assert_eq!(prior, again, "the same seed gives the same bits");
        let mut phi = vec![0.0; network.weights()];
        let (mut missed, mut spread, mut chi) = (0.0, 0.0, 0.0);
        for (inputs, truth) in network.standardised(&unseen).chunks_exact(3).zip(&truth_nt) {
            let error = truth - network.value_and_gradient(inputs, &prior.weights, &mut phi);
            let phi = DVector::from_column_slice(&phi);
            let p = DMatrix::from_row_slice(phi.len(), phi.len(), &prior.covariance);
            missed += error * error / 500.0;
            spread += truth * truth / 500.0;
            chi += error * error / phi.dot(&(p * &phi)) / 500.0;
        }
        println!("{activation:?}: {:.2} of {:.1} nT, chi {chi:.2}", missed.sqrt(), spread.sqrt());
        // The residual of a linear fit is 23 % of the field, because the term 25 b c/(1 + b²), with an rms of 14 nT, is
        // not linear.
        assert!(missed.sqrt() < 0.12 * spread.sqrt(), "{activation:?} {} {}", missed.sqrt(), spread.sqrt());
        // The ratio is 1 for a correct linear model; the model error of the network increases it.
        assert!((0.2..10.0).contains(&chi), "{activation:?} {chi}");
        assert!(prior.walk_density.iter().all(|q| *q > 0.0 && q.is_finite()));
    }
}

#[test]
fn law_fixed_weights_equal_the_ekf_on_the_compensated_line() {
    let map = wavy(-74.88);
    let flight = Flight::turning(&map, 1);
    let features: Vec<f64> = (0..ROWS).flat_map(|row| [0, 1, 2].map(|axis| flight.vector_nt[axis][row])).collect();
    let network = OnlineNetwork::new(&features, 3, 4, OnlineActivation::Swish, 40.0).unwrap();
    let weights = network.draw(2);
    let states = network.weights();
    let inputs = network.standardised(&features);
    let aircraft_nt: Vec<f64> = inputs.chunks_exact(3).map(|row| network.value(row, &weights)).collect();
    let compensated_nt = flight.compensated(0);
    let mut measured_nt: Vec<f64> = compensated_nt.iter().zip(&aircraft_nt).map(|(nt, own)| nt + own).collect();
    measured_nt[77] = f64::NAN;
    let line = flight.line(&map).with(&measured_nt, &flight.sigma_nt[0]);
    let prior = NetworkPrior {
        weights,
        covariance: vec![0.0; states * states],
        walk_density: vec![0.0; states],
        misfit_nt: 0.0,
    };
    let ours = run(&line, &network, &features, &prior, &Aids::default(), &ALL).unwrap();
    let parameters = EkfParameters { errors: flight.errors, keep_covariance: true, ..EkfParameters::default() };
    let mut compensated_nt = compensated_nt;
    compensated_nt[77] = f64::NAN;
    let sigma_nt = Some(flight.sigma_nt[0].as_slice());
    let point = EkfInput {
        parameters: &parameters,
        measurement_nt: &compensated_nt,
        sigma_nt,
        fixes: None,
        map: &map,
        core: None,
    };
    let ekf = run_together(line.ins, &[point]).pop().unwrap().unwrap();
    for row in 0..ROWS {
        for state in 0..18 {
            let sd = ekf.p[row][state][state].sqrt();
            assert!((ours.navigation.x[row][state] - ekf.x[row][state]).abs() < 1e-9 * sd, "{row} {state}");
            assert!((ours.navigation.p[row][state][state].sqrt() / sd - 1.0).abs() < 1e-9);
        }
    }
    assert_eq!((ours.track.report.missing, &ours.weights), (1, &prior.weights));
    // With an unknown feature the measurement is not used, even where the activation would saturate.
    for bad in [f64::NAN, f64::INFINITY] {
        let mut gap = features.clone();
        gap[3 * 50 + 1] = bad;
        let output = run(&line, &network, &gap, &prior, &Aids::default(), &ALL).unwrap();
        assert_eq!(output.track.report.missing, 2);
        assert!(output.track.aircraft_nt[50].is_nan() && output.navigation.residual_nt[50].is_nan());
    }
}

#[test]
fn unit_invalid_networks_are_rejected() {
    let (features, field_nt) = samples(50, 1);
    let words = |inputs: usize, hidden: usize, output_nt: f64, features: &[f64]| {
        OnlineNetwork::new(features, inputs, hidden, OnlineActivation::Tanh, output_nt).unwrap_err().to_string()
    };
    assert_eq!(words(3, 0, 1.0, &features), "150 values are not whole rows of 3 features, with 0 hidden units");
    assert_eq!(words(4, 2, 1.0, &features), "150 values are not whole rows of 4 features, with 2 hidden units");
    assert_eq!(words(3, 2, 0.0, &features), "the scale of the output must be above 0 nT, not 0");
    let mut constant = features.clone();
    constant.chunks_exact_mut(3).for_each(|row| row[1] = 0.1);
    assert!(words(3, 2, 1.0, &constant).starts_with("feature 1 is constant in the calibration"));
    assert!(words(3, 2, 1.0, &[f64::NAN; 6]).starts_with("feature 0 is constant"));
    let network = network(4, OnlineActivation::Tanh);
    let tt_s: Vec<f64> = (0..50).map(f64::from).collect();
    let good = NetworkCalibration { tt_s: &tt_s, features: &features, aircraft_nt: &field_nt };
    let parameters = TrainingParameters::default();
    let words = |calibration: &NetworkCalibration<'_>, start: Option<&[f64]>, parameters: &TrainingParameters| {
        train(&network, calibration, start, parameters).unwrap_err().to_string()
    };
    assert!(train(&network, &good, Some(&network.draw(1)), &parameters).is_ok());
    assert_eq!(words(&good, Some(&[0.0]), &parameters), "1 weights are given, but 21 finite ones are required");
    let noiseless = TrainingParameters { sigma_nt: 0.0, ..parameters };
    assert_eq!(words(&good, None, &noiseless), "`calibration_sigma_nt` must be above 0, not 0");
    let short = NetworkCalibration { aircraft_nt: &field_nt[1..], ..good };
    assert!(words(&short, None, &parameters).contains("require 50 field values"));
    let none = vec![f64::NAN; 50];
    let empty = NetworkCalibration { aircraft_nt: &none, ..good };
    assert_eq!(words(&empty, None, &parameters), "the calibration has 0 usable rows; 4 are required");
    let still = vec![0.0; 50];
    assert!(words(&NetworkCalibration { tt_s: &still, ..good }, None, &parameters).contains("do not ascend"));
    let map = wavy(-74.88);
    let flight = Flight::turning(&map, 1);
    let line = flight.line(&map).with(&flight.measurement_nt[0], &flight.sigma_nt[0]);
    let prior = train(&network, &good, None, &parameters).unwrap();
    let fault = run(&line, &network, &features, &prior, &Aids::default(), &ALL).unwrap_err().to_string();
    assert_eq!(fault, "150 feature values are given, not 230 rows of 3");
    let other = NetworkPrior { weights: vec![0.0; 3], ..prior };
    let fault = run(&line, &network, &[0.0; 3 * ROWS], &other, &Aids::default(), &ALL).unwrap_err().to_string();
    assert_eq!(fault, "3 weights and 21 random-walk densities are given, not 21 of each");
}

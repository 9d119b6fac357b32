//! Elementary effects and Sobol indices against SALib and the analytic values of the Ishigami function.
#![allow(clippy::unwrap_used)]

use std::convert::Infallible;
use std::f64::consts::PI;

use super::*;
use crate::reference_csv::{columns, matrix};

const RANGES: [[f64; 2]; 3] = [[-PI, PI]; 3];
const A: f64 = 7.0;
const B: f64 = 0.1;

/// Mean effect μ. Effects of opposite signs cancel. (MagNav.jl's `eval_gsa` returns this mean.)
fn mean(found: &ElementaryEffects) -> f64 {
    found.effects.iter().sum::<f64>() / found.effects.len() as f64
}

/// sin x₁ + 7 sin² x₂ + 0.1 x₃⁴ sin x₁ [Ishigami & Homma 1990].
fn ishigami(rows: &[f64]) -> Result<Vec<f64>, Infallible> {
    let of = |x: &[f64]| x[0].sin() + A * x[1].sin().powi(2) + B * x[2].powi(4) * x[0].sin();
    Ok(rows.chunks_exact(3).map(of).collect())
}

fn single(width: usize) -> Vec<Vec<usize>> {
    (0..width).map(|column| vec![column]).collect()
}

fn unit(rows: &[f64]) -> Vec<f64> {
    rows.iter().map(|x| (x + PI) / (2.0 * PI)).collect()
}

fn assert_close(found: f64, expected: f64, name: &str) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs().max(1.0), "{name}: {found} {expected}");
}

#[test]
fn val_elementary_effects_agree_with_salib() {
    for (sample, expected) in [
        (
            include_str!("../../reference/sensitivity/morris.csv"),
            include_str!("../../reference/sensitivity/morris_indices.csv"),
        ),
        (
            include_str!("../../reference/sensitivity/morris_network.csv"),
            include_str!("../../reference/sensitivity/morris_network_indices.csv"),
        ),
    ] {
        let (sample, expected) = (columns(sample), columns(expected));
        let points = unit(&matrix(&sample, &["x1", "x2", "x3"]));
        let found = elementary_effects::<Infallible>(&points, &sample["y"], &single(3), 4).unwrap();
        for (input, found) in found.iter().enumerate() {
            assert_close(mean(found), expected["mu"][input], "mu");
            assert_close(found.mean_absolute(), expected["mu_star"][input], "mu_star");
            assert_close(found.deviation(), expected["sigma"][input], "sigma");
        }
    }
}

#[test]
fn val_sobol_indices_agree_with_salib() {
    for (sample, expected) in [
        (
            include_str!("../../reference/sensitivity/sobol.csv"),
            include_str!("../../reference/sensitivity/sobol_indices.csv"),
        ),
        (
            include_str!("../../reference/sensitivity/sobol_network.csv"),
            include_str!("../../reference/sensitivity/sobol_network_indices.csv"),
        ),
    ] {
        let (sample, expected) = (columns(sample), columns(expected));
        // SALib's order of rows: A, A with each column from B in turn, B.
        let of = |place: usize| sample["y"].iter().skip(place).step_by(5).copied().collect::<Vec<f64>>();
        let predictions = SobolPredictions { a: of(0), b: of(4), mixed: (1..4).map(of).collect() };
        let found = sobol_indices::<Infallible>(&predictions, 1).unwrap();
        for (input, found) in found.iter().enumerate() {
            assert_close(found.first.value, expected["first"][input], "first");
            assert_close(found.total.value, expected["total"][input], "total");
            // SALib's interval is 1.96 times the standard deviation of 1000 bootstrap samples, here of other samples.
            for (error, theirs) in [(found.first.error, "first_conf"), (found.total.error, "total_conf")] {
                let ratio = 1.959_964 * error / expected[theirs][input];
                assert!((ratio - 1.0).abs() < 0.15, "{theirs} of {input}: {ratio}");
            }
        }
    }
}

#[test]
fn law_sobol_indices_of_the_ishigami_function() {
    let variance = A * A / 8.0 + B * PI.powi(4) / 5.0 + B * B * PI.powi(8) / 18.0 + 0.5;
    let of_3 = 8.0 * B * B * PI.powi(8) / 225.0 / variance;
    let first = [0.5 * (1.0 + B * PI.powi(4) / 5.0).powi(2) / variance, A * A / 8.0 / variance, 0.0];
    let total = [first[0] + of_3, first[1], of_3];
    let found = sobol(&ishigami, &RANGES, &single(3), &SobolDesign { points: 20_000, seed: 3 }).unwrap();
    for input in 0..3 {
        for (index, expected) in [(found[input].first, first[input]), (found[input].total, total[input])] {
            let SobolIndex { value, error, interval } = index;
            assert!((value - expected).abs() < 4.0 * error && error < 0.025, "{input}: {index:?} {expected}");
            assert!(interval[0] < value && value < interval[1]);
        }
    }
    // The groups {1, 3} and {2} do not interact, so first and total index are equal and add up to 1.
    let groups = [vec![0, 2], vec![1]];
    let found = sobol(&ishigami, &RANGES, &groups, &SobolDesign { points: 20_000, seed: 3 }).unwrap();
    let expected = [1.0 - first[1], first[1]];
    for (of, expected) in found.iter().zip(expected) {
        for index in [of.first, of.total] {
            assert!((index.value - expected).abs() < 4.0 * index.error, "{index:?} {expected}");
        }
    }
}

#[test]
fn law_intervals_of_sobol_indices_cover_the_truth() {
    // y = x₁ + 2 x₂: shares of 0.2 and 0.8. 95 % of 200 intervals are expected to cover, with a deviation of 1.5 %.
    let linear = |rows: &[f64]| -> Result<Vec<f64>, Infallible> {
        Ok(rows.chunks_exact(2).map(|x| x[0] + 2.0 * x[1]).collect())
    };
    let mut covered = [0_usize; 2];
    for seed in 0..200 {
        let design = SobolDesign { points: 200, seed };
        let found = sobol(&linear, &[[0.0, 1.0]; 2], &single(2), &design).unwrap()[0];
        for (covered, SobolIndex { interval, .. }) in covered.iter_mut().zip([found.first, found.total]) {
            *covered += usize::from(interval[0] <= 0.2 && 0.2 <= interval[1]);
        }
    }
    assert!(covered.iter().all(|covered| (178..=200).contains(covered)), "{covered:?}");
}

#[test]
fn law_elementary_effects_of_a_linear_model_are_its_coefficients_times_the_ranges() {
    let linear = |rows: &[f64]| -> Result<Vec<f64>, Infallible> {
        Ok(rows.chunks_exact(4).map(|x| 3.0 * x[0] - 2.0 * x[1] + 5.0 * x[2] + x[3]).collect())
    };
    // The last column has no range.
    let ranges = [[1.0, 3.0], [-1.0, 0.5], [0.0, 0.1], [7.0, 7.0]];
    for levels in [2, 4, 10] {
        let design = MorrisDesign { trajectories: 10, levels, seed: 1 };
        let found = morris(&linear, &ranges, &single(4), &design).unwrap();
        for (found, expected) in found.iter().zip([6.0, -3.0, 0.5, 0.0_f64]) {
            assert_close(mean(found), expected, "mean");
            assert_close(found.mean_absolute(), expected.abs(), "mean absolute");
            assert!(found.deviation() < 1e-12 && found.error() < 1e-12);
            assert_eq!(found.effects.len(), 10);
        }
    }
    // Columns of a group move together, each in its own direction: |6 ± 3| per step.
    let design = MorrisDesign { trajectories: 400, levels: 4, seed: 1 };
    let found = morris(&linear, &ranges, &[vec![0, 1], vec![2], vec![3]], &design).unwrap();
    assert!(found[0].effects.iter().all(|effect| (effect - 3.0).abs() < 1e-9 || (effect - 9.0).abs() < 1e-9));
    assert!((found[0].mean_absolute() - 6.0).abs() < 4.0 * found[0].error());
}

#[test]
fn unit_invalid_settings_of_a_sensitivity_are_errors() {
    let design = MorrisDesign { trajectories: 2, levels: 4, seed: 0 };
    let points = SobolDesign { points: 2, seed: 0 };
    assert!(morris(&ishigami, &RANGES, &single(3), &MorrisDesign { levels: 3, ..design }).is_err());
    assert!(morris(&ishigami, &RANGES, &single(3), &MorrisDesign { trajectories: 1, ..design }).is_err());
    assert!(morris(&ishigami, &RANGES, &single(2), &design).is_err());
    assert!(sobol(&ishigami, &RANGES, &single(3), &SobolDesign { points: 1, ..points }).is_err());
    for range in [[1.0, 0.0], [f64::NAN, 1.0], [0.0, f64::INFINITY]] {
        let ranges = [range, RANGES[1], RANGES[2]];
        assert!(sobol(&ishigami, &ranges, &single(3), &points).is_err());
        assert!(morris(&ishigami, &ranges, &single(3), &design).is_err());
    }
    let constant = |rows: &[f64]| -> Result<Vec<f64>, Infallible> { Ok(vec![1.0; rows.len() / 3]) };
    assert_eq!(sobol(&constant, &RANGES, &single(3), &points), Err(ImportanceError::Constant));
    assert!(morris(&constant, &RANGES, &single(3), &design).unwrap().iter().all(|of| of.mean_absolute() == 0.0));
}

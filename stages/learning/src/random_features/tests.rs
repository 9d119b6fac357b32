#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::reference_csv::{columns, matrix};

#[test]
fn ref_many_features_approach_the_gaussian_process_of_scikit_learn() {
    let table = columns(include_str!("../../reference/random_features/gaussian_process.csv"));
    let x = matrix(&table, &["x0", "x1", "x2"]);
    let rows = table["train"].iter().filter(|t| **t == 1.0).count();
    for (name, linear) in [("plain", 0.0), ("linear", 1.0)] {
        let of = |what: &str| &table[&format!("{name}_{what}")];
        let typical = of("deviation").iter().map(|d| d * d).sum::<f64>();
        // The root mean square difference of the predictions over five draws, in standard deviations of the prediction.
        let difference = |features: usize| {
            let one = |seed: u64| {
                let how = RandomFeatureSettings {
                    features,
                    length: Some(1.5),
                    linear,
                    seed,
                    ..RandomFeatureSettings::default()
                };
                let model = fit(&x[..3 * rows], 3, &table["y"][..rows], &how).unwrap();
                let mean = model.mean(&x).unwrap();
                mean.iter().zip(of("mean")).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / typical
            };
            ((0..5).map(one).sum::<f64>() / 5.0).sqrt()
        };
        // The error of the kernel is proportional to the inverse square root of the number of frequencies.
        let (few, many) = (difference(50), difference(450));
        assert!(many < 0.4 && few / many > 2.2 && few / many < 4.5, "{name}: {few} {many}");
        let how =
            RandomFeatureSettings { features: 800, length: Some(1.5), linear, ..RandomFeatureSettings::default() };
        let model = fit(&x[..3 * rows], 3, &table["y"][..rows], &how).unwrap();
        assert!((model.lambda / of("lambda")[0]).ln().abs() < 0.2, "{name}: {} {}", model.lambda, of("lambda")[0]);
        assert!((model.noise_variance / of("noise")[0] - 1.0).abs() < 0.05, "{name}: {}", model.noise_variance);
        let (mean, deviation) = model.predict(&x).unwrap();
        let mut ratios: Vec<f64> = deviation.iter().zip(of("deviation")).map(|(a, b)| (a / b).ln().abs()).collect();
        assert!(median(&mut ratios) < 0.03, "{name}: {}", median(&mut ratios));
        assert_eq!(model.mean(&x).unwrap(), mean);
    }
}

fn rows(count: u32) -> (Vec<f64>, Vec<f64>) {
    let wave = |k: f64, j: f64| 1.4 * (k * (0.131 + 0.171 * j) + 0.37 * j).sin();
    let x: Vec<f64> = (0..count).flat_map(|k| (0..4).map(move |j| wave(f64::from(k), f64::from(j)))).collect();
    let y = x.chunks(4).map(|x| 50_000.0 + 3.0 * x[0] * x[1] + 5.0 * x[2] + (2.0 * x[3]).sin()).collect();
    (x, y)
}

#[test]
fn unit_linear_functions_are_found_and_extrapolated() {
    let (x, _) = rows(400);
    let y: Vec<f64> = x.chunks(4).map(|x| 50_000.0 + 3.0 * x[0] - 5.0 * x[2]).collect();
    let model = fit(&x, 4, &y, &RandomFeatureSettings { features: 60, ..RandomFeatureSettings::default() }).unwrap();
    let (mean, _) = model.predict(&[3.0, 0.0, 3.0, 0.0, 0.5, 0.5, -0.5, 0.0]).unwrap();
    assert!((mean[0] - 49_994.0).abs() < 0.05 && (mean[1] - 50_004.0).abs() < 1e-3, "{mean:?}");
}

#[test]
fn law_the_mean_of_products_of_features_is_the_kernel() {
    let directions = directions(3, 3000, 1);
    let (a, b) = ([0.3, -1.0, 0.7], [0.9, 0.2, -0.1]);
    for length in [0.8, 2.0] {
        let (features, _) = RandomFeatureMap::new(3, &directions, length, 0.0).features(&[a, b].concat());
        let (f, g) = features.split_at(6000);
        let square: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
        let kernel = (-square / (2.0 * length * length)).exp();
        assert!((dot(f, g) - kernel).abs() < 0.02 && (dot(f, f) - 1.0).abs() < 1e-12, "{} {kernel}", dot(f, g));
    }
    // Three frequencies in a block are orthogonal.
    assert!(dot(&directions[..3], &directions[3..6]).abs() < 1e-12);
}

#[test]
fn jac_the_gradient_agrees_with_differences_of_predictions() {
    let (x, y) = rows(300);
    for linear in [0.0, 0.5] {
        let model =
            fit(&x, 4, &y, &RandomFeatureSettings { features: 101, linear, ..RandomFeatureSettings::default() })
                .unwrap();
        let at = &x[40..44];
        let gradient = model.gradient(at).unwrap();
        for j in 0..4 {
            let moved = |by: f64| {
                let mut row = at.to_vec();
                row[j] += by;
                model.mean(&row).unwrap()[0]
            };
            let difference = (moved(1e-4) - moved(-1e-4)) / 2e-4;
            assert!((gradient[j] - difference).abs() < 1e-5, "{j}: {} {difference}", gradient[j]);
        }
    }
}

#[test]
fn unit_the_most_likely_length_and_ratio_predict_best() {
    let (x, y) = rows(1500);
    let ((train, ahead), (target, truth)) = (x.split_at(4 * 1000), y.split_at(1000));
    let error = |length: Option<f64>, lambda: Option<f64>| {
        let model = fit(
            train,
            4,
            target,
            &RandomFeatureSettings { features: 300, length, lambda, ..RandomFeatureSettings::default() },
        )
        .unwrap();
        let mean = model.mean(ahead).unwrap();
        (mean.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / 500.0).sqrt()
    };
    let best = error(None, None);
    assert!(best < 0.02 && 5.0 * best < error(Some(0.2), None) && 5.0 * best < error(None, Some(100.0)), "{best}");
}

#[test]
fn unit_threads_change_no_bit() {
    let (x, y) = rows(1300);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let model =
                fit(&x, 4, &y, &RandomFeatureSettings { features: 60, ..RandomFeatureSettings::default() }).unwrap();
            let predicted = model.predict(&x).unwrap();
            (model, predicted)
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn unit_invalid_fits_are_rejected_and_nan_predicts_nan() {
    let (x, y) = rows(30);
    let how = RandomFeatureSettings { features: 10, ..RandomFeatureSettings::default() };
    let fault = |x: &[f64], y: &[f64], how: &RandomFeatureSettings| fit(x, 4, y, how).unwrap_err().to_string();
    assert!(fault(&x, &[50_000.1; 30], &how).contains("constant"));
    assert!(fault(&[1.0; 120], &y, &how).contains("equal"));
    assert!(fault(&x[..8], &y[..2], &how).contains("too few"));
    assert!(fault(&x, &y[1..], &how).contains("29"));
    assert!(fault(&x, &y, &RandomFeatureSettings { features: 1, ..how.clone() }).contains("features"));
    assert!(fault(&x, &y, &RandomFeatureSettings { lambda: Some(0.0), ..how.clone() }).contains("lambda"));
    let mut holed = x.clone();
    holed[6] = f64::INFINITY;
    assert!(fault(&holed, &y, &how).contains("row 1, column 2"));
    let model = fit(&x, 4, &y, &how).unwrap();
    let (mean, deviation) = model.predict(&[f64::NAN, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4]).unwrap();
    assert!(mean[0].is_nan() && deviation[0].is_nan() && mean[1].is_finite() && deviation[1] > 0.0);
    assert!(model.predict(&x[1..]).is_err());
    assert!(RandomFeatures { weights: vec![], ..model }.mean(&x).is_err());
}

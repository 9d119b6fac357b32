#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::random::NormalGenerator;
use crate::reference_csv::{TERMS, columns, model_lines};

fn lines() -> Vec<RegressionMoments> {
    model_lines().iter().map(|line| RegressionMoments::from_matrix(&line.a, 8, &[&line.y0]).unwrap()).collect()
}

fn near(one: f64, other: f64, relative: f64, scale: f64) {
    assert!((one - other).abs() <= relative * (other.abs() + scale), "{one} {other}");
}

#[test]
fn val_fits_equal_scikit_learn() {
    let all = RegressionMoments::merged(&lines()).unwrap();
    let table = columns(include_str!("../../../reference/models/elastic_net.csv"));
    assert_eq!(table["alpha"].len(), 18);
    for (row, &alpha) in table["alpha"].iter().enumerate() {
        let net = ElasticNetOptions {
            l1_ratio: table["l1_ratio"][row],
            scaling: ColumnScaling::None,
            intercept: table["centred"][row] == 1.0,
            tolerance: 1e-13,
            ..ElasticNetOptions::default()
        };
        let fit = &net.path(&all, 0, &[alpha]).unwrap()[0];
        // scikit-learn stops at a gap of 1e-14 of ‖y‖², so its coefficients are accurate to some 1e-6.
        for (ours, name) in fit.fit.coefficients.iter().zip(TERMS) {
            near(*ours, table[name][row], 2e-6, 1e-3);
        }
        near(fit.fit.intercept, table["intercept"][row], 2e-6, 1.0);
    }
}

#[test]
fn val_a_path_equals_scikit_learn() {
    let all = RegressionMoments::merged(&lines()).unwrap();
    let table = columns(include_str!("../../../reference/models/enet_path.csv"));
    let net = ElasticNetOptions { l1_ratio: 0.7, tolerance: 1e-13, ..ElasticNetOptions::default() };
    let alphas = net.alphas(&all, 0, 12, 1e-3).unwrap();
    let deviations = all.term_deviations();
    for (k, fit) in net.path(&all, 0, &alphas).unwrap().iter().enumerate() {
        near(fit.alpha, table["alpha"][k], 1e-12, 0.0);
        for (j, name) in TERMS.iter().enumerate() {
            near(fit.fit.coefficients[j] * deviations[j], table[*name][k], 2e-6, 1e-2);
        }
        assert!(fit.gap <= 1e-13);
    }
}

#[test]
fn val_scores_of_omitted_lines_equal_scikit_learn() {
    let lines = lines();
    let table = columns(include_str!("../../../reference/models/enet_cv.csv"));
    let net = ElasticNetOptions {
        l1_ratio: 0.7,
        scaling: ColumnScaling::None,
        tolerance: 1e-13,
        ..ElasticNetOptions::default()
    };
    let alphas = net.alphas(&RegressionMoments::merged(&lines).unwrap(), 0, 10, 1e-3).unwrap();
    let choice = net.choose(&lines, 0, &alphas, LineScoreMeasure::MeanSquare).unwrap();
    let mut means = Vec::new();
    for (k, alpha) in alphas.iter().enumerate() {
        near(*alpha, table["alpha"][k], 1e-12, 0.0);
        let theirs: Vec<f64> = (0..4).map(|line| table[format!("line{line}").as_str()][k]).collect();
        for (ours, theirs) in choice.scores.scores[k].iter().zip(&theirs) {
            near(*ours, *theirs, 1e-6, 0.0);
        }
        means.push(theirs.iter().sum::<f64>() / 4.0);
    }
    let best = (0..10).min_by(|a, b| means[*a].total_cmp(&means[*b])).unwrap();
    assert_eq!(choice.best().unwrap().alpha, alphas[best]);
    let simpler = choice.within_one_error().unwrap();
    let limit = means[best] + choice.scores.standard_error[best];
    assert!(simpler.alpha >= alphas[best] && choice.scores.mean[choice.scores.within_one_error] <= limit);
}

#[test]
fn law_the_conditions_of_a_minimum_hold() {
    // For each nonzero coefficient, the gradient of the squared residuals equals the penalty of this coefficient. For a
    // zero coefficient, the gradient is smaller.
    let all = RegressionMoments::merged(&lines()).unwrap();
    let net = ElasticNetOptions { l1_ratio: 0.6, tolerance: 1e-14, ..ElasticNetOptions::default() };
    let prepared = all.prepare(net.scaling, true).unwrap();
    let alphas = net.alphas(&all, 0, 30, 1e-4).unwrap();
    let mut zeros = 0;
    for fit in net.path(&all, 0, &alphas).unwrap() {
        let b = prepared.scaled(&fit.fit.coefficients);
        let left = prepared.left_of(prepared.along(0).unwrap(), &b);
        for (pull, b) in prepared.transposed_times(&left).iter().zip(&b) {
            let (pull, l1) = (pull / 120.0, fit.alpha * net.l1_ratio);
            let slope = pull - fit.alpha * (1.0 - net.l1_ratio) * b;
            if *b == 0.0 {
                zeros += 1;
                assert!(slope.abs() <= l1 * (1.0 + 1e-6));
            } else {
                // The active terms are solved exactly.
                near(slope, l1.copysign(*b), 1e-9, 1e-9);
            }
        }
    }
    assert!(zeros > 10, "{zeros}");
    let first = &net.path(&all, 0, &alphas[..1]).unwrap()[0];
    assert!(first.active.is_empty(), "{:?}", first.active);
}

#[test]
fn law_without_a_first_order_penalty_the_fit_is_ridge() {
    let all = RegressionMoments::merged(&lines()).unwrap();
    let net = ElasticNetOptions { l1_ratio: 0.0, tolerance: 1e-18, ..ElasticNetOptions::default() };
    let path = net.path(&all, 0, &[0.3, 0.01]).unwrap();
    let ridge =
        all.prepare(ColumnScaling::Standardise, true).unwrap().ridge(&[0.3 * 120.0, 0.01 * 120.0], &TERMS).unwrap();
    for (fit, ridge) in path.iter().zip(&ridge.solutions) {
        for (ours, theirs) in fit.fit.coefficients.iter().zip(&ridge.coefficients[0]) {
            near(*ours, *theirs, 1e-9, 1e-6);
        }
        near(fit.residual_squares, ridge.residual_squares[0], 1e-9, 0.0);
    }
}

#[test]
fn unit_badly_conditioned_terms_are_solved_in_few_sweeps() {
    // Thirty terms with relative differences of 1e-5: descent without exact steps requires some 1e10 sweeps.
    let (rows, p) = (400, 30);
    let mut normals = NormalGenerator::new(4);
    let mut row = || {
        let common = normals.draw();
        (0..p).map(|_| common + 1e-5 * normals.draw()).collect::<Vec<f64>>()
    };
    let a: Vec<f64> = (0..rows).flat_map(|_| row()).collect();
    let mut noise = NormalGenerator::new(5);
    let y: Vec<f64> = a.chunks(p).map(|r| 3e4 * (r[0] - r[1]) + r[2] + 0.1 * noise.draw()).collect();
    let moments = RegressionMoments::from_matrix(&a, p, &[&y]).unwrap();
    let net = ElasticNetOptions::default();
    let alphas = net.alphas(&moments, 0, 60, 1e-6).unwrap();
    let path = net.path(&moments, 0, &alphas).unwrap();
    let sweeps: usize = path.iter().map(|fit| fit.sweeps).sum();
    assert!(sweeps < 60_000, "{sweeps}");
    assert!(path.iter().all(|fit| fit.gap <= net.tolerance));
}

#[test]
fn unit_settings_out_of_range_are_rejected() {
    let all = RegressionMoments::merged(&lines()).unwrap();
    let message = |net: ElasticNetOptions, alpha: f64| net.path(&all, 0, &[alpha]).unwrap_err().to_string();
    let net = |l1_ratio: f64| ElasticNetOptions { l1_ratio, ..ElasticNetOptions::default() };
    assert!(message(net(1.5), 1.0).contains("l1 ratio of an elastic net must be from 0 to 1, but is 1.5"));
    assert!(message(net(0.5), -1.0).contains("alpha must be a finite number of at least 0, but is -1"));
    assert!(net(0.0).alphas(&all, 0, 5, 1e-3).unwrap_err().to_string().contains("above 0"));
    assert!(net(0.5).path(&all, 1, &[1.0]).unwrap_err().to_string().contains("target 1 does not exist"));
    let few = ElasticNetOptions { sweeps: 1, tolerance: 1e-30, ..ElasticNetOptions::default() };
    assert!(message(few, 0.1).contains("allow more sweeps or a larger tolerance"));
    let alphas = net(0.5).alphas(&all, 0, 5, 1e-2).unwrap();
    assert_eq!(
        net(0.5).paths(&all, std::slice::from_ref(&alphas)).unwrap()[0],
        net(0.5).path(&all, 0, &alphas).unwrap()
    );
}

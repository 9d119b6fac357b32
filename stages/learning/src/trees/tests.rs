#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use std::ops::ControlFlow;

use super::*;
use crate::reference_csv::{columns, matrix};

fn on(_: usize, _: f64, _: f64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The same numbers as in `reference/trees/make_reference.py`.
fn waves(rows: std::ops::Range<u32>) -> (Vec<f64>, Vec<f64>) {
    let wave = |k: f64, j: f64| (k * (0.013 + 0.0171 * j) + 0.37 * j).sin() + 0.2 * (k * (1.7 + 0.31 * j)).sin();
    let x: Vec<f64> = rows.clone().flat_map(|k| (0..8).map(move |j| wave(f64::from(k), f64::from(j)))).collect();
    let y = rows.zip(x.chunks(8)).map(|(k, x)| {
        let k = f64::from(k);
        10.0 * x[0] * x[1] + 5.0 * (3.0 * x[2]).tanh() + 4.0 * x[3].abs() + x[4] + 0.5 * (k * k * 0.37).sin()
    });
    let y = y.collect();
    (x, y)
}

fn mse(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64
}

#[test]
fn ref_trees_of_few_distinct_values_equal_those_of_scikit_learn() {
    let table = columns(include_str!("../../reference/trees/few_values.csv"));
    let x = matrix(&table, &["x0", "x1", "x2", "x3", "x4"]);
    let first = BoostingSettings { trees: 40, leaves: 8, least_rows: 5, ..BoostingSettings::default() };
    let deep =
        BoostingSettings { depth: Some(3), least_rows: 10, l2: 4.0, learning_rate: 0.3, ..BoostingSettings::default() };
    for (how, name) in [(first, "leaves"), (BoostingSettings { trees: 15, ..deep }, "depth")] {
        let boosted = boost(&x, 5, &table["y"], &how, None, &mut on).unwrap();
        let ours = boosted.forest.predict(&x, 5);
        // The reference residuals have 24 bits. The relative rounding error is 1e-7 for values of about 5. The errors
        // add up over the trees.
        let worst = ours.iter().zip(&table[name]).fold(0.0f64, |w, (a, b)| w.max((a - b).abs()));
        assert!(worst < 2e-5, "{name}: {worst:e}");
        assert!((boosted.losses.last().unwrap().0 / mse(&ours, &table["y"]) - 1.0).abs() < 1e-9);
    }
}

#[test]
fn ref_errors_with_many_distinct_values_agree_with_scikit_learn() {
    let table = columns(include_str!("../../reference/trees/many_values.csv"));
    let ((x, y), (ahead, truth)) = (waves(0..6000), waves(6000..9000));
    for first in (0..table["trees"].len()).step_by(5) {
        let (trees, leaves) = (table["trees"][first] as usize, table["leaves"][first] as usize);
        let how =
            BoostingSettings { trees, leaves, learning_rate: table["rate"][first], ..BoostingSettings::default() };
        let boosted = boost(&x, 8, &y, &how, None, &mut on).unwrap();
        let ours = [boosted.losses[trees - 1].0, mse(&boosted.forest.predict(&ahead, 8), &truth)];
        for (ours, name) in ours.into_iter().zip(["train_mse", "ahead_mse"]) {
            // scikit-learn was run with five different numbers of bins.
            let theirs = &table[name][first..first + 5];
            let (least, most) = theirs.iter().fold((f64::MAX, 0.0f64), |(a, b), x| (a.min(*x), b.max(*x)));
            assert!(ours > 0.97 * least && ours < 1.03 * most, "{trees} trees, {name}: {ours} {theirs:?}");
        }
    }
}

#[test]
fn law_one_tree_at_full_rate_is_the_mean_on_each_side_of_a_step() {
    let x: Vec<f64> = (0..60).map(|k| f64::from(k * 7 % 60)).collect();
    let y: Vec<f64> = x.iter().map(|x| if *x > 20.0 { 50_004.0 } else { 49_998.0 }).collect();
    let how = BoostingSettings { trees: 5, learning_rate: 1.0, least_rows: 1, ..BoostingSettings::default() };
    let boosted = boost(&x, 1, &y, &how, None, &mut on).unwrap();
    let RegressionTreeNode::Split { threshold, .. } = boosted.forest.trees[0].nodes[0] else { panic!("{boosted:?}") };
    assert_eq!((threshold, boosted.forest.trees[0].nodes.len()), (20.5, 3));
    assert!(boosted.forest.predict(&x, 1).iter().zip(&y).all(|(a, b)| (a - b).abs() < 1e-9));
    assert!(boosted.forest.predict(&[f64::NAN, 20.0], 1)[0].is_nan());
    let at = boosted.forest.predict(&[-1e9, 20.5, 20.6, 1e9], 1);
    let truth = [49_998.0, 49_998.0, 50_004.0, 50_004.0];
    assert!(at.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-9), "{at:?}");
}

#[test]
fn law_neither_scale_nor_logarithm_of_a_column_changes_a_tree() {
    let (x, y) = waves(0..3000);
    let how = BoostingSettings { trees: 20, ..BoostingSettings::default() };
    let plain = boost(&x, 8, &y, &how, None, &mut on).unwrap().forest.predict(&x, 8);
    let bent: Vec<f64> = x.iter().enumerate().map(|(i, x)| if i % 2 == 0 { (x + 3.0).ln() } else { 1e6 * x }).collect();
    let same = boost(&bent, 8, &y, &how, None, &mut on).unwrap().forest.predict(&bent, 8);
    assert_eq!(plain, same);
}

#[test]
fn unit_threads_change_no_bit_and_seeds_change_the_rows_of_a_tree() {
    let (x, y) = waves(0..4000);
    let run = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let how = BoostingSettings { trees: 12, subsample: 0.6, seed, ..BoostingSettings::default() };
        pool.install(|| boost(&x, 8, &y, &how, Some((&x[..800], &y[..100])), &mut on).unwrap())
    };
    assert_eq!(run(1, 5), run(2, 5));
    assert_eq!(run(1, 5), run(5, 5));
    assert_ne!(run(1, 5).forest, run(1, 6).forest);
    let how = BoostingSettings { subsample: 0.6, ..BoostingSettings::default() };
    let seen = drawn(&how, 3, 4000).unwrap();
    assert_eq!(seen.len(), 2400);
    assert_ne!(drawn(&how, 4, 4000).unwrap(), seen);
}

#[test]
fn unit_a_resumed_training_is_bit_identical() {
    let (x, y) = waves(0..3000);
    for (subsample, patience) in [(1.0, None), (0.6, Some(6))] {
        let how = BoostingSettings { trees: 12, subsample, patience, ..BoostingSettings::default() };
        let ahead = Some((&x[..800], &y[50..150]));
        let whole = boost(&x, 8, &y, &how, ahead, &mut on).unwrap();
        for stop in [1, 5, whole.losses.len()] {
            let mut kept = vec![];
            let mut each = |trees: &[RegressionTree], _: f64, _: f64| {
                kept = trees_to_bytes(trees);
                if trees.len() == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            boost_on(vec![], &x, 8, &y, &how, ahead, &mut each).unwrap();
            let begun = trees_from_bytes(&kept).unwrap();
            assert_eq!(begun.len(), stop);
            let mut each = |_: &[RegressionTree], _: f64, _: f64| ControlFlow::Continue(());
            assert_eq!(boost_on(begun, &x, 8, &y, &how, ahead, &mut each).unwrap(), whole, "{subsample} {stop}");
        }
    }
    let foreign =
        RegressionTree { nodes: vec![RegressionTreeNode::Split { feature: 8, threshold: 0.0, left: 1, right: 2 }] };
    let mut each = |_: &[RegressionTree], _: f64, _: f64| ControlFlow::Continue(());
    let fault = boost_on(vec![foreign], &x, 8, &y, &BoostingSettings::default(), None, &mut each).unwrap_err();
    assert!(matches!(fault, BoostingError::Malformed { tree: 0, node: 0, .. }), "{fault}");
}

#[test]
fn unit_early_stopping_keeps_the_trees_with_the_best_validation_loss() {
    let (x, y) = waves(0..2000);
    // The validation target is twice as large with the opposite sign. Each tree after the first makes its loss worse.
    let ahead: Vec<f64> = y.iter().map(|y| -2.0 * y).collect();
    let how = BoostingSettings { trees: 50, patience: Some(4), ..BoostingSettings::default() };
    let stopped = boost(&x, 8, &y, &how, Some((&x, &ahead)), &mut on).unwrap();
    assert_eq!((stopped.best, stopped.losses.len(), stopped.forest.trees.len()), (1, 5, 1));
    let own = boost(&x, 8, &y, &how, Some((&x, &y)), &mut on).unwrap();
    assert_eq!((own.best, own.losses.len()), (50, 50));
    assert!(own.losses.iter().all(|(a, b)| (a / b - 1.0).abs() < 1e-9));
    let mut reports = vec![];
    let mut third = |n: usize, train: f64, validation: f64| {
        reports.push((train, validation));
        if n == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let broken = boost(&x, 8, &y, &how, Some((&x, &y)), &mut third).unwrap();
    assert_eq!((broken.losses.len(), broken.forest.trees.len()), (3, 3));
    assert_eq!(broken.losses, reports);
    assert_eq!(broken.forest.trees[..], own.forest.trees[..3]);
}

#[test]
fn unit_invalid_training_input_is_rejected() {
    let (mut x, y) = waves(0..200);
    let how = BoostingSettings::default();
    let fault =
        |x: &[f64], y: &[f64], how: &BoostingSettings| boost(x, 8, y, how, None, &mut on).unwrap_err().to_string();
    assert!(fault(&x, &y[1..], &how).contains("199 entries"), "{}", fault(&x, &y[1..], &how));
    assert!(fault(&x[3..], &y, &how).contains("require"));
    assert!(fault(&x, &y, &BoostingSettings { leaves: 1, ..how.clone() }).contains("leaves must be at least 2"));
    assert!(fault(&x, &y, &BoostingSettings { subsample: 0.0, ..how.clone() }).contains("above 0"));
    assert!(fault(&x, &y, &BoostingSettings { learning_rate: f64::NAN, ..how.clone() }).contains("learning rate"));
    assert!(fault(&x, &y, &BoostingSettings { patience: Some(3), ..how.clone() }).contains("validation"));
    assert!(fault(&x, &y, &BoostingSettings { least_rows: 101, ..how.clone() }).contains("202"));
    assert!(fault(&x, &y, &BoostingSettings { least_rows: usize::MAX, ..how.clone() }).contains("200 rows"));
    assert!(fault(&x, &[7.5; 200], &how).contains("constant"));
    assert!(fault(&[1.0; 1600], &y, &how).contains("constant"));
    let huge: Vec<f64> = y.iter().map(|y| 1e200 * y).collect();
    assert!(fault(&x, &huge, &how).contains("not finite"));
    assert!(
        fault(&x, &y, &BoostingSettings { learning_rate: 2.5, trees: 5000, ..how.clone() })
            .contains("set the learning rate below 1")
    );
    x[8 * 17 + 3] = f64::NAN;
    assert!(fault(&x, &y, &how).contains("row 17, column 3"));
    assert!(fault(&[], &[], &how).contains("no values"));
}

#[test]
fn unit_a_cyclic_forest_is_rejected() {
    let split = |feature, left, right| RegressionTreeNode::Split { feature, threshold: 0.0, left, right };
    let leaf = RegressionTreeNode::Leaf { value: 1.0 };
    let good = RegressionTree { nodes: vec![split(1, 1, 2), leaf, leaf] };
    let forest = |tree: &RegressionTree| Forest { base: 0.0, trees: vec![good.clone(), tree.clone()] };
    assert_eq!(forest(&good).check(2), Ok(()));
    assert!(forest(&good).check(1).is_err());
    let circle = vec![split(0, 0, 1), leaf];
    let outside = vec![split(0, 1, 7), leaf];
    for nodes in [circle, outside, vec![], vec![RegressionTreeNode::Leaf { value: f64::NAN }]] {
        let bad = forest(&RegressionTree { nodes });
        assert!(matches!(bad.check(2), Err(BoostingError::Malformed { tree: 1, node: 0, .. })));
        assert!(bad.predict(&[-1.0, -1.0, 1.0, 1.0], 2).iter().any(|y| y.is_nan()));
    }
}

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use numerics::random::NormalGenerator;

use super::*;
use crate::{
    reference_csv::{columns, matrix},
    trees::{Forest, RegressionTree, RegressionTreeNode},
};

type Never = Infallible;

/// The same function as in `reference/importance/make_reference.py`.
fn function(x: &[f64]) -> Result<Vec<f64>, Never> {
    let one =
        |x: &[f64]| 3.0 * (x[0] * x[1] + x[2] * x[3]).tanh() + x[2] * x[2] * x[3] - 2.0 * x[4] + (x[0] + x[3]).sin();
    Ok(x.chunks(5).map(one).collect())
}

const NAMES: [&str; 5] = ["x0", "x1", "x2", "x3", "x4"];
const EXPLAINED: usize = 6;

fn each_alone(width: usize) -> Vec<Vec<usize>> {
    (0..width).map(|j| vec![j]).collect()
}

/// The rows to explain, the background, and the reference table.
fn shapley_case() -> (Vec<f64>, Vec<f64>, std::collections::BTreeMap<String, Vec<f64>>) {
    let table = columns(include_str!("../../reference/importance/shapley.csv"));
    let mut x = matrix(&table, &NAMES);
    let background = x.split_off(5 * EXPLAINED);
    (x, background, table)
}

fn expected(table: &std::collections::BTreeMap<String, Vec<f64>>, name: &str) -> Vec<f64> {
    let names: Vec<String> = (0..5).map(|j| format!("{name}{j}")).collect();
    let mut all = matrix(table, &names.iter().map(String::as_str).collect::<Vec<_>>());
    all.truncate(5 * EXPLAINED);
    all
}

fn worst(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |w, (a, b)| w.max((a - b).abs()))
}

fn normals(count: usize, seed: u64) -> Vec<f64> {
    let mut normals = NormalGenerator::new(seed);
    (0..count).map(|_| normals.draw()).collect()
}

#[test]
fn ref_sampled_values_agree_with_shap_within_their_errors() {
    let (rows, background, table) = shapley_case();
    let truth = expected(&table, "exact");
    let run = |samples, seed| {
        shapley_sampled(&function, &rows, &background, 5, &each_alone(5), &AttributionSampling { samples, seed })
            .unwrap()
    };
    let many = run(400, 1);
    assert!(worst(&many.values, &truth) < 0.02, "{}", worst(&many.values, &truth));
    let found = run(30, 2);
    let ratios: Vec<f64> = found
        .values
        .iter()
        .zip(&truth)
        .zip(&found.errors)
        .filter(|(_, e)| **e > 1e-12)
        .map(|((v, t), e)| (v - t) / e)
        .collect();
    let typical = (ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64).sqrt();
    // The root mean square of the 24 differences is expected to be one standard error. The five differences of a row
    // are correlated, so the tolerance is about a third.
    assert!(ratios.len() >= 20 && (0.6..1.5).contains(&typical), "{typical} {ratios:?}");
    // The additive term -2 x4 has no sampling error.
    let mean = background.iter().skip(4).step_by(5).sum::<f64>() / 20.0;
    for row in 0..EXPLAINED {
        assert!((found.values[5 * row + 4] + 2.0 * (rows[5 * row + 4] - mean)).abs() < 1e-12);
    }
}

#[test]
fn law_values_add_up_to_the_prediction_and_two_groups_are_exact() {
    let (rows, background, table) = shapley_case();
    let predictions = function(&rows).unwrap();
    for groups in
        [each_alone(5), vec![vec![3, 0], vec![2], vec![1, 4]], vec![vec![0, 1, 2, 3], vec![4]], vec![(0..5).collect()]]
    {
        let sampling = AttributionSampling { samples: 2, seed: 3 };
        let found = shapley_sampled(&function, &rows, &background, 5, &groups, &sampling).unwrap();
        for (row, prediction) in found.values.chunks(groups.len()).zip(&predictions) {
            assert!((found.base + row.iter().sum::<f64>() - prediction).abs() < 1e-10, "{groups:?}");
        }
        if groups.len() == 2 {
            // x4 is additive, so the other group has the sum of the values of its columns.
            let exact = expected(&table, "exact");
            let together: Vec<f64> = exact.chunks(5).map(|v| v[..4].iter().sum()).collect();
            let ours: Vec<f64> = found.values.iter().step_by(2).copied().collect();
            assert!(worst(&ours, &together) < 1e-10 && found.errors.iter().all(|e| *e < 1e-12));
        }
    }
}

#[test]
fn law_a_product_is_shared_symmetrically_and_a_dummy_has_value_zero() {
    // Contributions to x0 x1 with one background row, from orders of the groups and from gradients: (x0 - b0)(x1 +
    // b1)/2 and (x1 - b1)(x0 + b0)/2.
    let product = |x: &[f64]| Ok::<_, Never>(x.chunks(3).map(|x| x[0] * x[1]).collect());
    let slopes = |x: &[f64]| Ok::<_, Never>(x.chunks(3).flat_map(|x| [x[1], x[0], 0.0]).collect());
    let (rows, background) = ([2.0, 3.0, 9.0, -1.0, 0.5, 4.0], [0.5, 1.0, -7.0]);
    let truth = [0.5 * 1.5 * 4.0, 0.5 * 2.0 * 2.5, 0.0, 0.5 * -1.5 * 1.5, 0.5 * -0.5 * -0.5, 0.0];
    let sampling = AttributionSampling { samples: 2000, seed: 1 };
    let orders = shapley_sampled(&product, &rows, &background, 3, &each_alone(3), &sampling).unwrap();
    assert!(worst(&orders.values, &truth) < 1e-12 && orders.base == 0.5, "{orders:?}");
    let gradients = expected_gradients(&slopes, &rows, &background, 3, &each_alone(3), &sampling).unwrap();
    // a is drawn in each of 2000 intervals: errors of at most about 1/2000 of the range.
    assert!(worst(&gradients.values, &truth) < 2e-3, "{gradients:?}");
    assert_eq!((gradients.values[2], gradients.values[5]), (0.0, 0.0));
}

#[test]
fn law_expected_gradients_of_a_linear_model_are_its_shapley_values() {
    let (rows, background, table) = shapley_case();
    let coefficients = &table["coefficient"][..5];
    let slopes = |x: &[f64]| Ok::<_, Never>(coefficients.repeat(x.len() / 5));
    // The number of samples is a multiple of the background rows, so that each is used equally often.
    let sampling = AttributionSampling { samples: 40, seed: 0 };
    let found = expected_gradients(&slopes, &rows, &background, 5, &each_alone(5), &sampling).unwrap();
    assert!(worst(&found.values, &expected(&table, "linear")) < 1e-10);
    let means: Vec<f64> = (0..5).map(|j| background.iter().skip(j).step_by(5).sum::<f64>() / 20.0).collect();
    let exact = shapley_linear(coefficients, &rows, &means, &each_alone(5)).unwrap();
    assert!(worst(&exact.values, &expected(&table, "linear")) < 1e-10);
    let pairs = shapley_linear(coefficients, &rows, &means, &[vec![1, 3]]).unwrap();
    assert!((pairs.values[0] - exact.values[1] - exact.values[3]).abs() < 1e-12);
}

#[test]
fn ref_values_of_a_forest_are_those_of_tree_explainer() {
    let table = columns(include_str!("../../reference/importance/forest.csv"));
    let at = |name: &str, i: usize| table[name][i];
    let node = |i: usize| match at("leaf", i) == 1.0 {
        true => RegressionTreeNode::Leaf { value: at("value", i) },
        false => RegressionTreeNode::Split {
            feature: at("feature", i) as usize,
            threshold: at("threshold", i),
            left: at("left", i) as usize,
            right: at("right", i) as usize,
        },
    };
    let trees = (0..12).map(|t| RegressionTree {
        nodes: (0..table["tree"].len()).filter(|&i| at("tree", i) == t as f64).map(node).collect(),
    });
    let forest = Forest { base: table["base"][0], trees: trees.collect() };
    let truth = columns(include_str!("../../reference/importance/forest_shapley.csv"));
    let (rows, background, _) = shapley_case();
    assert!(worst(&forest.predict(&rows, 5), &truth["prediction"]) < 1e-12);
    let found = shapley_trees(&forest, &rows, &background, 5, &each_alone(5)).unwrap();
    // SHAP evaluates trees partly in single precision.
    assert!(
        worst(&found.values, &expected(&truth, "value")) < 1e-5,
        "{}",
        worst(&found.values, &expected(&truth, "value"))
    );
    // The group values equal sampled values if there are enough samples to cover all orders.
    let groups = [vec![2, 0], vec![1, 3], vec![4]];
    let exact = shapley_trees(&forest, &rows, &background, 5, &groups).unwrap();
    let predict = |x: &[f64]| Ok::<_, Never>(forest.predict(x, 5));
    let sampled =
        shapley_sampled(&predict, &rows, &background, 5, &groups, &AttributionSampling { samples: 3000, seed: 9 })
            .unwrap();
    assert!((exact.base - sampled.base).abs() < 1e-12 && worst(&exact.values, &sampled.values) < 0.01);
    let ratios =
        exact.values.iter().zip(&sampled.values).zip(&sampled.errors).map(|((a, b), e)| (a - b).abs() / (e + 1e-12));
    assert!(ratios.fold(0.0, f64::max) < 4.0);
}

#[test]
fn law_permutation_of_a_linear_model_is_twice_the_explained_variance() {
    let n = 40_000;
    let x = normals(3 * n, 4);
    let y: Vec<f64> = x.chunks(3).map(|x| 2.0 * x[0] - x[1] + 7.0).collect();
    let model = |x: &[f64]| Ok::<_, Never>(x.chunks(3).map(|x| 2.0 * x[0] - x[1] + 7.0).collect());
    let blocks = PermutationBlocks { rows: 100, repeats: 3, seed: 5 };
    let groups = [vec![0], vec![1], vec![2], vec![0, 1]];
    let found = permutation(&model, &x, 3, &y, &groups, &blocks).unwrap();
    assert!(found.base < 1e-20);
    for (increases, truth) in found.increases.iter().zip([8.0, 2.0, 0.0, 10.0]) {
        // The standard error of a mean of 40,000 squared differences is 2^0.5/200 of the mean.
        assert!(
            increases.len() == 3 && increases.iter().all(|i| (i - truth).abs() < 0.035 * truth + 1e-12),
            "{found:?}"
        );
    }
}

#[test]
fn unit_results_are_independent_of_threads_and_other_groups() {
    let (rows, background, _) = shapley_case();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let sampling = AttributionSampling { samples: 3, seed: 8 };
        let blocks = PermutationBlocks { rows: 3, repeats: 4, seed: 8 };
        pool.install(|| {
            let shapley = shapley_sampled(&function, &rows, &background, 5, &each_alone(5), &sampling).unwrap();
            let slopes = |x: &[f64]| Ok::<_, Never>(x.iter().map(|x| x.sin()).collect());
            let gradients = expected_gradients(&slopes, &rows, &background, 5, &each_alone(5), &sampling).unwrap();
            let y = vec![0.0; 20];
            let groups = each_alone(5);
            let permuted = permutation(&function, &background, 5, &y, &groups, &blocks).unwrap();
            let alone = permutation(&function, &background, 5, &y, &groups[3..4], &blocks).unwrap();
            assert_eq!(alone.increases[0], permuted.increases[3]);
            (shapley, gradients.values, gradients.errors, permuted)
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn ref_correlations_with_ties_are_those_of_scipy() {
    let table = columns(include_str!("../../reference/importance/correlation.csv"));
    for (a, b) in [("a", "b"), ("a", "c"), ("b", "c")] {
        let (x, y) = (&table[a], &table[b]);
        for (found, name) in [(pearson(x, y), "pearson"), (spearman(x, y), "spearman")] {
            assert!(
                (found.value - table[&format!("{name}_{a}{b}")][0]).abs() < 1e-12 && found.n == 40,
                "{name} {found:?}"
            );
        }
    }
    assert!(pearson(&[0.1; 30], &normals(30, 1)).value.is_nan());
    assert!(spearman(&[1.0, 2.0], &[f64::NAN, 2.0]).value.is_nan());
    let holed = spearman(&[1.0, f64::NAN, 2.0, 3.0, f64::INFINITY], &[-1.0, 0.0, -20.0, -300.0, 1.0]);
    assert_eq!((holed.value, holed.n), (-1.0, 3));
}

#[test]
fn ref_hard_thresholding_finds_the_best_of_all_subsets() {
    let table = columns(include_str!("../../reference/importance/sparse.csv"));
    let d = matrix(&table, &["d0", "d1", "d2", "d3", "d4", "d5", "d6", "d7"]);
    let found = iterative_hard_thresholding(&d, 8, &table["t"], 3).unwrap();
    assert!(found.converged && worst(&found.coefficients, &table["coefficient"][..8]) < 1e-8, "{found:?}");
    // All terms: least squares, whose residual is orthogonal to every column.
    let all = iterative_hard_thresholding(&d, 8, &table["t"], 8).unwrap();
    for j in 0..8 {
        let left = |(row, t): (&[f64], &f64)| {
            (t - row.iter().zip(&all.coefficients).map(|(a, b)| a * b).sum::<f64>()) * row[j]
        };
        assert!(d.chunks(8).zip(&table["t"]).map(left).sum::<f64>().abs() < 1e-6);
    }
    assert!(iterative_hard_thresholding(&d, 8, &table["t"], 0).is_err());
    assert_eq!(iterative_hard_thresholding(&[0.0; 6], 2, &[1.0, 2.0, 3.0], 1).unwrap().coefficients, [0.0, 0.0]);
}

#[test]
fn unit_invalid_models_rows_and_groups_are_rejected() {
    let (rows, background, _) = shapley_case();
    let sampling = AttributionSampling { samples: 2, seed: 0 };
    let fault = |rows: &[f64], groups: &[Vec<usize>], samples: usize| {
        let sampling = AttributionSampling { samples, ..sampling };
        shapley_sampled(&function, rows, &background, 5, groups, &sampling).unwrap_err().to_string()
    };
    assert_eq!(fault(&rows, &[vec![0, 1], vec![2, 4]], 2), "column 3 is in no group");
    assert!(fault(&rows, &[(0..5).collect(), vec![4]], 2).contains("group 1"));
    assert!(fault(&rows, &[vec![0, 5]], 2).contains("does not exist"));
    assert!(fault(&rows, &[(0..5).collect(), vec![]], 2).contains("group 1 has no columns"));
    assert!(fault(&rows, &[], 2).contains("groups"));
    assert!(fault(&rows, &each_alone(5), 1).contains("at least 2"));
    assert!(fault(&rows[1..], &each_alone(5), 2).contains("required"));
    let mut holed = rows.clone();
    holed[7] = f64::NAN;
    assert!(fault(&holed, &each_alone(5), 2).contains("row 1, column 2"));
    let broken = |x: &[f64]| if x.len() > 5 { Err("no licence") } else { Ok(vec![0.0; x.len() / 5]) };
    let nan = |x: &[f64]| Ok::<_, Never>(vec![f64::NAN; x.len() / 5]);
    let short = |_: &[f64]| Ok::<_, Never>(vec![0.0]);
    let groups = each_alone(5);
    let error = shapley_sampled(&broken, &rows, &background, 5, &groups, &sampling).unwrap_err();
    assert_eq!(error, ImportanceError::Model("no licence"));
    assert_eq!(
        shapley_sampled(&nan, &rows, &background, 5, &groups, &sampling).unwrap_err(),
        ImportanceError::NotFinite
    );
    let error = expected_gradients(&short, &rows, &background, 5, &groups, &sampling).unwrap_err();
    assert_eq!(error, ImportanceError::Answer { given: 1, expected: 10 });
    let blocks = PermutationBlocks { rows: 20, repeats: 1, seed: 0 };
    let error = permutation(&function, &background, 5, &[0.0; 20], &groups, &blocks).unwrap_err();
    assert_eq!(error, ImportanceError::OneBlock { rows: 20, block: 20 });
}

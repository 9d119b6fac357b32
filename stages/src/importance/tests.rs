#![allow(clippy::unwrap_used)]
use arrow_array::{Array, cast::AsArray, types::Float64Type};

use super::*;
use crate::testing::{batch, fault_texts, line as line_of, sampled, table};

fn importance(method: ImportanceMethod) -> Importance {
    Importance {
        target: "mag_4_uc".into(),
        method,
        groups: vec![],
        block_s: 1.0,
        repeats: 20,
        samples: 100,
        background: 40,
        draws: 2,
        kept_samples: 20,
        terms: 1,
        trajectories: 50,
        levels: 4,
        points: 4000,
        tails: 0.0,
        seed: 0,
    }
}

const WAVES: [(&str, f64); 3] = [("cur_1", 1.9), ("cur_2", 3.1), ("vol", 4.7)];

/// 400 s at 10 Hz: 5 cur_1 - 2 cur_2 + 100, without the third column.
fn line() -> LineInput {
    let wave = |rate: f64| sampled(0.0, 10.0, 4000, |t| (rate * t + (0.01 * t).sin()).sin());
    let [a, b, _] = WAVES.map(|(_, rate)| wave(rate));
    let y = a.iter().zip(&b).map(|(a, b)| 5.0 * a - 2.0 * b + 100.0).collect();
    let mut columns = vec![("tt", "s", sampled(0.0, 10.0, 4000, |t| t)), ("mag_4_uc", "nT", y)];
    columns.extend(WAVES.map(|(name, rate)| (name, "A", wave(rate))));
    line_of(vec![batch(columns)])
}

fn model(terms: &[(&str, f64)]) -> RecordBatch {
    let names: ArrayRef = Arc::new(terms.iter().map(|(name, _)| Some(*name)).collect::<StringArray>());
    let values = array(terms.iter().map(|(_, value)| *value).collect());
    RecordBatch::try_from_iter([("term", names), ("value", values)]).unwrap()
}

const TERMS: [(&str, f64); 4] = [("cur_1", 5.0), ("cur_2", -2.0), ("vol", 0.0), ("intercept", 100.0)];

fn run(stage: &Importance, terms: &[(&str, f64)]) -> Result<(Vec<String>, Vec<f64>), Fault> {
    let fitted = stage.prepare(&[line().inputs[0].slice(0, 0), model(terms)])?;
    let made = stage.run(&line(), &fitted)?;
    let names = made[3].as_string::<i32>().iter().map(|n| n.unwrap_or_default().to_owned()).collect();
    Ok((names, made[4].as_primitive::<Float64Type>().values().to_vec()))
}

fn near(found: &[f64], truth: &[f64], part: f64) {
    let scale = truth.iter().fold(0.0f64, |s, t| s.max(t.abs()));
    assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < part * scale), "{found:?} {truth:?}");
}

#[test]
fn law_importance_of_a_linear_model_of_sines_is_exact() {
    // Twice the variance, 25/2 and 4/2; the mean absolute sine is 2/π.
    near(&run(&importance(ImportanceMethod::Permutation), &TERMS).unwrap().1, &[25.0, 4.0, 0.0], 0.08);
    let mean = 2.0 / std::f64::consts::PI;
    for method in [ImportanceMethod::Shapley, ImportanceMethod::ExpectedGradients] {
        near(&run(&importance(method), &TERMS).unwrap().1, &[5.0 * mean, 2.0 * mean, 0.0], 0.08);
    }
    // Standard deviations 5 and 2 of independent parts: 5/√29 and −2/√29.
    for method in [ImportanceMethod::Pearson, ImportanceMethod::Spearman] {
        near(&run(&importance(method), &TERMS).unwrap().1, &[0.928, -0.371, 0.0], 0.06);
    }
}

#[test]
fn unit_a_group_holds_all_entries_with_its_prefix() {
    let grouped = Importance { groups: vec!["cur".into()], ..importance(ImportanceMethod::Permutation) };
    let (names, values) = run(&grouped, &TERMS).unwrap();
    assert_eq!(names, ["cur", "vol"]);
    near(&values, &[29.0, 0.0], 0.08);
    let lacking = Importance { groups: vec!["flux".into()], ..importance(ImportanceMethod::Permutation) };
    let fault = run(&lacking, &TERMS).err().unwrap();
    assert_eq!((fault.what.as_str(), fault.param.as_deref()), ("the model has no input `flux`", Some("groups")));
    let twice = Importance { groups: vec!["cur".into(), "cur_1".into()], ..importance(ImportanceMethod::Permutation) };
    assert_eq!(run(&twice, &TERMS).err().unwrap().what, "`cur_1` is in two groups");
}

#[test]
fn unit_trees_are_explained_exactly_and_have_no_gradient() {
    let stump = [
        ("family boosted_trees", 1.0),
        ("input[1] cur_1", 1.0),
        ("input[2] vol", 1.0),
        ("base", 100.0),
        ("nodes[1]", 3.0),
        ("split[1,1] cur_1", 0.0),
        ("left[1,1]", 2.0),
        ("leaf[1,2]", -4.0),
        ("leaf[1,3]", 4.0),
    ];
    // Either 4 or -4, because the mean of the background is near 0.
    near(&run(&importance(ImportanceMethod::Shapley), &stump).unwrap().1, &[4.0, 0.0], 0.06);
    let fault = run(&importance(ImportanceMethod::ExpectedGradients), &stump).err().unwrap();
    assert_eq!((fault.what.as_str(), fault.param.as_deref()), ("the model has no gradient", Some("method")));
    let sampled = run(&importance(ImportanceMethod::Permutation), &stump).unwrap().1;
    assert!(sampled[0] > 5.0 && sampled[1] == 0.0, "{sampled:?}");
}

#[test]
fn unit_invalid_inputs_are_reported_with_their_parameter() {
    let long = Importance { block_s: 400.0, ..importance(ImportanceMethod::Permutation) };
    let fault = run(&long, &TERMS).err().unwrap();
    assert!(fault.what.contains("fewer than two blocks") && fault.param.as_deref() == Some("block_s"), "{fault}");
    let shape = |columns: Vec<Column>| schemas::TableShape { columns: columns.into(), rate_hz: None };
    let fitted = Table::Model {
        shape: shape(vec![Column::text("term", ""), Column::float("value", "", "")]),
        features: vec!["tl".into()],
    };
    let stage = Importance { groups: vec!["a".into(), "a".into()], ..importance(ImportanceMethod::Pearson) };
    let lines = table(&[("tt", "s"), ("mag_4_uc", "s")], None);
    let faults = fault_texts(stage.yields(&[&lines, &fitted]).unwrap_err());
    assert!(["[target]", "`tl`", "duplicate group `a`"].iter().all(|part| faults.contains(part)), "{faults}");
    assert!(stage.unused_key("block_s").is_some() && stage.unused_key("groups").is_none());
}

/// The lists of a method that explains samples: values and inputs, by group.
fn samples(stage: &Importance, terms: &[(&str, f64)]) -> [Vec<Vec<f64>>; 2] {
    let fitted = stage.prepare(&[line().inputs[0].slice(0, 0), model(terms)]).unwrap();
    let made = stage.run(&line(), &fitted).unwrap();
    let of = |at: usize| {
        let rows = made[at].as_fixed_size_list();
        (0..rows.len()).map(|row| rows.value(row).as_primitive::<Float64Type>().values().to_vec()).collect()
    };
    [of(9), of(10)]
}

#[test]
fn law_shapley_values_of_a_linear_model_are_its_centred_terms() {
    let [values, inputs] = samples(&importance(ImportanceMethod::Shapley), &TERMS);
    assert_eq!((values.len(), values[0].len()), (3, 20));
    for (slope, (values, inputs)) in [5.0, -2.0, 0.0].into_iter().zip(values.iter().zip(&inputs)) {
        // A Shapley value of a linear model is slope times (input - mean of the background), so differences of values
        // are slope times differences of inputs.
        for pair in 1..20 {
            let (dv, dx) = (values[pair] - values[0], inputs[pair] - inputs[0]);
            assert!((dv - slope * dx).abs() < 1e-9, "{dv} {dx}");
        }
        assert!(inputs.iter().any(|x| *x > 0.5) && inputs.iter().any(|x| *x < -0.5), "{inputs:?}");
    }
    let grouped = Importance { groups: vec!["cur".into()], ..importance(ImportanceMethod::Shapley) };
    let [values, inputs] = samples(&grouped, &TERMS);
    assert!(values[0].iter().all(|v| v.is_finite()) && inputs[0].iter().all(|x| x.is_nan()));
    assert!(inputs[1].iter().all(|x| x.is_finite()));
    // Fewer samples than `kept_samples`.
    let few = Importance { samples: 5, kept_samples: 3, ..importance(ImportanceMethod::Shapley) };
    assert_eq!(samples(&few, &TERMS)[0][0].len(), 3);
    let none = Importance { kept_samples: 0, ..importance(ImportanceMethod::Shapley) };
    assert_eq!((none.kept(), importance(ImportanceMethod::Permutation).kept()), (None, None));
}

#[test]
fn law_the_best_sparse_linear_model_keeps_the_larger_terms() {
    // Sines of amplitudes 5 and 2 have standard deviations of 5/√2 and 2/√2.
    let deviation = std::f64::consts::FRAC_1_SQRT_2;
    near(&run(&importance(ImportanceMethod::HardThresholding), &TERMS).unwrap().1, &[5.0 * deviation, 0.0, 0.0], 0.05);
    let two = Importance { terms: 2, ..importance(ImportanceMethod::HardThresholding) };
    near(&run(&two, &TERMS).unwrap().1, &[5.0 * deviation, 2.0 * deviation, 0.0], 0.02);
    let all = Importance { terms: 50, groups: vec!["cur".into()], ..importance(ImportanceMethod::HardThresholding) };
    near(&run(&all, &TERMS).unwrap().1, &[29f64.sqrt() * deviation, 0.0], 0.02);
}

#[test]
fn law_first_layer_weights_agree_with_a_manual_calculation() {
    let network = [
        ("family network", 1.0),
        ("form m1", 1.0),
        ("activation tanh", 1.0),
        ("hidden[1]", 2.0),
        ("input_mean[1] cur_1", 0.0),
        ("input_mean[2] vol", 0.0),
        ("input_scale[1]", 2.0),
        ("input_scale[2]", 1.0),
        ("target_mean", 0.0),
        ("target_scale", 1.0),
        ("members", 1.0),
        ("w1[1,1]", 3.0),
        ("w1[1,2]", 0.5),
        ("w1[2,1]", -4.0),
        ("w1[2,2]", 0.0),
        ("b1[1]", 0.0),
        ("b1[2]", 0.0),
        ("w2[1,1]", 1.0),
        ("w2[1,2]", 1.0),
        ("b2[1]", 0.0),
    ];
    // √(9 + 16) = 5 and 0.5, times the standard deviations of a sine divided by the scales.
    let deviation = std::f64::consts::FRAC_1_SQRT_2;
    near(
        &run(&importance(ImportanceMethod::GroupLasso), &network).unwrap().1,
        &[2.5 * deviation, 0.5 * deviation],
        0.02,
    );
    let fault = run(&importance(ImportanceMethod::GroupLasso), &TERMS).err().unwrap();
    assert!(fault.what.contains("not a network") && fault.param.as_deref() == Some("method"), "{fault}");
}

#[test]
fn law_sensitivity_of_a_linear_model_follows_its_coefficients_and_ranges() {
    // The ranges of the sines are 2, so the effects are 10 and 4, and the shares of the variance 25/29 and 4/29.
    let (names, values) = run(&importance(ImportanceMethod::Morris), &TERMS).unwrap();
    assert_eq!(names, ["cur_1", "cur_2", "vol"]);
    near(&values, &[10.0, 4.0, 0.0], 1e-3);
    for method in [ImportanceMethod::SobolFirst, ImportanceMethod::SobolTotal] {
        near(&run(&importance(method), &TERMS).unwrap().1, &[25.0 / 29.0, 4.0 / 29.0, 0.0], 0.06);
    }
    // Between the quantiles at 1/4 and 3/4, a sine has a range of √2.
    let inner = Importance { tails: 0.25, ..importance(ImportanceMethod::Morris) };
    near(&run(&inner, &TERMS).unwrap().1, &[5.0 * 2.0_f64.sqrt(), 2.0 * 2.0_f64.sqrt(), 0.0], 0.02);
    let constant = [("cur_1", 0.0), ("cur_2", 0.0), ("vol", 0.0), ("intercept", 100.0)];
    let fault = run(&importance(ImportanceMethod::SobolTotal), &constant).err().unwrap();
    assert!(fault.what.starts_with("the predictions are equal over the ranges"), "{fault}");
}

#[test]
fn law_sobol_indices_have_intervals_and_the_total_index_includes_interactions() {
    // A tree whose prediction is the product of the signs of two inputs: no input alone has a share.
    let product = [
        ("family boosted_trees", 1.0),
        ("input[1] cur_1", 1.0),
        ("input[2] vol", 1.0),
        ("base", 100.0),
        ("nodes[1]", 7.0),
        ("split[1,1] cur_1", 0.0),
        ("left[1,1]", 2.0),
        ("split[1,2] vol", 0.0),
        ("left[1,2]", 4.0),
        ("split[1,3] vol", 0.0),
        ("left[1,3]", 6.0),
        ("leaf[1,4]", 4.0),
        ("leaf[1,5]", -4.0),
        ("leaf[1,6]", -4.0),
        ("leaf[1,7]", 4.0),
    ];
    for (method, expected) in [(ImportanceMethod::SobolFirst, 0.0), (ImportanceMethod::SobolTotal, 1.0)] {
        let stage = importance(method);
        let fitted = stage.prepare(&[line().inputs[0].slice(0, 0), model(&product)]).unwrap();
        let made = stage.run(&line(), &fitted).unwrap();
        let column = |at: usize| made[at].as_primitive::<Float64Type>().values().to_vec();
        let (values, errors, low, high) = (column(4), column(6), column(9), column(10));
        for group in 0..2 {
            assert!((values[group] - expected).abs() < 5.0 * errors[group] + 0.02, "{values:?} {errors:?}");
            assert!(low[group] < values[group] && values[group] < high[group]);
        }
    }
}

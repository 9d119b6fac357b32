//! Boosted trees and random features: fit, application and input importance.

use crate::support::{Bench, SPEC, numbers, read, stderr, stdout, texts};

/// Spec of the small flights with a fit to the true aircraft field. `keys` are additional keys of the fit.
fn spec(axes: &str, keys: &str, importance: &str) -> String {
    let tables = SPEC.split("[axes]").next().unwrap();
    format!(
        r#"{tables}
{axes}

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "flights"
vector = "flux_a"

[[stages]]
name  = "wanted"
stage = "target"
input = "terms"
kind  = "d"
mag   = "mag_4_uc"

[[stages]]
name   = "rival"
stage  = "fit"
input  = "wanted"
target = "target"
{keys}

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
model = "rival"
mag   = "mag_4_uc"

[[stages]]
name    = "scores"
stage   = "score"
input   = ["clean"]
truth   = "mag_1_c"
metrics = ["std_error", "std_uncompensated"]

[[stages]]
name    = "weights"
stage   = "importance"
input   = "wanted"
model   = "rival"
target  = "target"
{importance}
"#
    )
}

#[test]
fn user_trees_and_random_features_compensate_and_are_explained() {
    let bench = Bench::new();
    let axes = "[axes]\nmodel = [\"boosted_trees\", \"random_features\"]\n\
                method = [\"permutation\", \"shapley\", \"spearman\"]";
    bench.spec(&spec(
        axes,
        "model = \"$model\"\nleaf_samples = 5\nrandom_features = 50",
        "method = \"$method\"\nblock_s = 1.0\nsamples = 20\nbackground = 10",
    ));
    let done = bench.run(&["--threads", "1", "--set", "store=one"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let folder = |table: &str| read(&bench.path("one/tables/small").join(table));
    let scores = folder("scores");
    let of = |metric: &str| -> Vec<f64> {
        let names = texts(&scores, "metric");
        numbers(&scores, "value").into_iter().zip(names).filter(|(_, name)| name == metric).map(|(v, _)| v).collect()
    };
    let (after, before) = (of("std_error"), of("std_uncompensated"));
    assert_eq!(after.len(), 2 * 4);
    assert!(after.iter().zip(&before).all(|(after, before)| *after < 0.5 * before), "{after:?} {before:?}");
    // The Gaussian process gives a standard deviation; the trees do not.
    let (clean, models) = (folder("clean"), texts(&folder("clean"), "model"));
    for (sigma, model) in numbers(&clean, "mag_aircraft_sigma").into_iter().zip(models) {
        assert!(if model == "boosted_trees" { sigma.is_nan() } else { sigma > 0.0 }, "{model} {sigma}");
    }
    // 18 terms on 4 lines by 2 models and 3 methods.
    let weights = folder("weights");
    let values = numbers(&weights, "value");
    assert_eq!(values.len(), 18 * 4 * 2 * 3);
    let all = texts(&weights, "method").into_iter().zip(texts(&weights, "unit")).zip(values);
    for ((method, unit), value) in all {
        let expected = match method.as_str() {
            "permutation" => "nT2",
            "shapley" => "nT",
            _ => "1",
        };
        assert_eq!(unit, expected);
        assert!(method != "shapley" || value >= 0.0, "{value}");
        assert!(method != "spearman" || value.is_nan() || value.abs() <= 1.0, "{value}");
    }
    let best = "SELECT \"group\" FROM small.weights WHERE method = 'shapley' AND model = 'random_features' \
                GROUP BY \"group\" ORDER BY avg(value) DESC LIMIT 1";
    let answer = bench.magline(&["sql", "--store", "one", "--format", "csv", best]);
    assert!(answer.status.success() && stdout(&answer).lines().count() == 2, "{}{}", stdout(&answer), stderr(&answer));
    // The axis replaces the column of the same name; the column appears once.
    assert_eq!(weights[0].schema().fields().iter().filter(|field| field.name() == "method").count(), 1);
    let lists =
        "SELECT count(*) FROM small.weights WHERE sample_values IS NOT NULL AND array_length(sample_values) = 20";
    let answer = bench.magline(&["sql", "--store", "one", "--format", "csv", lists]);
    assert_eq!(stdout(&answer).lines().nth(1), Some("144"), "{}{}", stdout(&answer), stderr(&answer));
    assert_eq!(bench.run(&["--threads", "2", "--set", "store=two"]).code, 0);
    assert!(bench.tables("one") == bench.tables("two"), "the bytes differ");
}

#[test]
fn user_invalid_keys_of_trees_and_random_features_are_rejected() {
    let bench = Bench::new();
    let check_fault = |keys: &str, importance: &str| {
        bench.spec(&spec("", keys, importance));
        let checked = bench.magline(&["check", "spec.toml"]);
        assert_eq!(checked.status.code(), Some(2), "{keys}: {}", stdout(&checked));
        stderr(&checked)
    };
    let alone = check_fault("model = \"boosted_trees\"\npatience = 5", "");
    assert!(alone.contains("name lines or flights in `validation`"), "{alone}");
    let whole = check_fault("model = \"boosted_trees\"\nseed = 5", "");
    assert!(whole.contains("has no effect without `subsample`"), "{whole}");
    let foreign = check_fault("model = \"random_features\"\ntrees = 5", "");
    assert!(foreign.contains("`trees` belongs to `boosted_trees`"), "{foreign}");
    let unused = check_fault("model = \"random_features\"", "method = \"spearman\"\nblock_s = 5.0");
    assert!(unused.contains("`block_s` has no effect without the method `permutation`"), "{unused}");
}

#[test]
fn user_the_error_without_each_input_is_a_sweep_over_subsets() {
    let bench = Bench::new();
    // All four inputs together, and all subsets of three inputs.
    let axes = "[axes]\ninputs = { subsets_of = [\"x\", \"y\", \"z\", \"yy\"], at_least = 3 }";
    let fit = "model = \"ridge\"\nentries = \"$inputs\"\nlambda = 0.0\nlow_hz = 0.0\nhigh_hz = 0.0\ntrim = 0";
    bench.spec(&spec(axes, fit, "method = \"pearson\""));
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("rival")), (0, 5), "{}", done.stderr);
    let grows = "SELECT inputs, avg(value) - (SELECT avg(value) FROM small.scores WHERE metric = 'std_error' AND \
                 inputs = 'x+y+z+yy') AS grows FROM small.scores WHERE metric = 'std_error' AND inputs <> 'x+y+z+yy' \
                 GROUP BY inputs ORDER BY grows DESC";
    let answer = bench.magline(&["sql", "--store", "store", "--format", "csv", grows]);
    let lines: Vec<String> = stdout(&answer).lines().skip(1).map(str::to_owned).collect();
    assert_eq!(lines.len(), 4, "{}{}", stdout(&answer), stderr(&answer));
    // The field of these flights varies most along y, then along x, and hardly along z. The aircraft field does not
    // depend on `yy`.
    let order: Vec<&str> = lines.iter().filter_map(|line| line.split(',').next()).collect();
    assert_eq!(order[..2], ["x+z+yy", "y+z+yy"], "{lines:?}");
}

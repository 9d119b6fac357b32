//! Linear models of the command line, compared with other programs and exact results.

use std::{collections::BTreeMap, fmt::Write, fs};

use arrow_array::RecordBatch;
use tempfile::TempDir;

use crate::support::{Bench, numbers, read, repository, texts};

const TERMS: [&str; 8] = ["a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7"];

/// Columns of a committed reference table.
fn reference(name: &str) -> BTreeMap<String, Vec<f64>> {
    let text = fs::read_to_string(repository().join("stages/numerics/reference/models").join(name)).unwrap();
    let mut lines = text.lines().filter(|l| !l.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    names.iter().enumerate().map(|(j, n)| ((*n).to_owned(), rows.iter().map(|r| r[j]).collect())).collect()
}

/// The committed small case as a flight in CSV: four lines, eight terms, `y0` as `mag_4_uc` and `y1` as `mag_5_uc`.
fn small_case(stages: &str) -> Bench {
    let bench = Bench { folder: TempDir::new().unwrap() };
    fs::create_dir(bench.path("flights")).unwrap();
    let table = reference("samples.csv");
    let mut csv = format!("flight,line,tt,{},mag_4_uc,mag_5_uc\n", TERMS.join(","));
    for (row, line) in table["line"].iter().enumerate() {
        write!(csv, "F,L{line},{:.1}", 1000.0 * line + 0.1 * row as f64).unwrap();
        for name in TERMS.into_iter().chain(["y0", "y1"]) {
            write!(csv, ",{}", table[name][row]).unwrap();
        }
        csv.push('\n');
    }
    fs::write(bench.path("flights/F.csv"), csv).unwrap();
    bench.spec(&format!("name = \"small\"\nstore = \"store\"\n[tables.flights]\npath = \"flights/\"\n{stages}"));
    bench
}

/// A fit of the small case, without filter.
fn fit(name: &str, target: &str, more: &str) -> String {
    let features = TERMS.map(|t| format!("\"{t}\"")).join(",");
    format!(
        "[[stages]]\nname = \"{name}\"\nstage = \"fit\"\ninput = \"flights\"\ntarget = \"{target}\"\n\
         features = [{features}]\nlow_hz = 0.0\nhigh_hz = 0.0\ntrim = 0\n{more}\n"
    )
}

pub fn run(bench: &Bench) {
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
}

/// The coefficients of a fit in the order of the terms; the intercept is last.
pub fn coefficients(bench: &Bench, name: &str) -> Vec<f64> {
    numbers(&read(&bench.path("store/tables/small").join(name)), "value")
}

fn chosen(bench: &Bench, name: &str) -> f64 {
    numbers(&read(&bench.path("store/tables/small").join(name)), "chosen")[0]
}

/// Asserts that a fit has row `row` of a reference table, to `tolerance` of each coefficient.
fn near(bench: &Bench, name: &str, table: &BTreeMap<String, Vec<f64>>, row: usize, tolerance: f64) {
    let ours = coefficients(bench, name);
    let theirs: Vec<f64> = TERMS.into_iter().chain(["intercept"]).map(|t| table[t][row]).collect();
    for (i, theirs) in theirs.iter().enumerate() {
        let ours = ours.get(i).copied().unwrap_or(0.0);
        assert!((ours - theirs).abs() <= tolerance * (theirs.abs() + 1e-2), "{name} {i}: {ours} {theirs}");
    }
}

#[test]
fn val_models_from_moments_equal_scikit_learn() {
    let (ridge, net, pls) = (reference("ridge_scaled.csv"), reference("elastic_net.csv"), reference("pls.csv"));
    let scalings = ["none", "standardise", "max_abs", "min_max"];
    let mut stages = String::new();
    for row in 0..9 {
        let (scaling, lambda) = (scalings[ridge["scaling"][row] as usize], ridge["lambda"][row]);
        let more = format!("model = \"ridge\"\nscaling = \"{scaling}\"\nlambda = {lambda:?}");
        stages += &fit(&format!("ridge{row}"), "mag_4_uc", &more);
    }
    let elastic = |row: usize| {
        let (alpha, ratio, centred) = (net["alpha"][row], net["l1_ratio"][row], net["centred"][row] == 1.0);
        let more = format!(
            "model = \"elastic_net\"\nscaling = \"none\"\nintercept = {centred}\nl1_ratio = {ratio:?}\nlambda = \
             {alpha:?}"
        );
        fit(&format!("net{row}"), "mag_4_uc", &more)
    };
    stages.extend((0..18).map(elastic));
    for k in 1..=8 {
        stages += &fit(&format!("pls{k}"), "mag_4_uc", &format!("model = \"pls\"\ncomponents = {k}"));
    }
    // A truncated decomposition with all components is ordinary least squares: the first row of the ridge table.
    stages += &fit("svd8", "mag_4_uc", "model = \"truncated_svd\"\ncomponents = 8");
    // A fit without a penalty to all whitened components is also ordinary least squares.
    stages += &fit("white8", "mag_4_uc", "model = \"ridge\"\nlambda = 0.0\nwhiten = 8.0");
    let bench = small_case(&stages);
    run(&bench);
    (0..9).for_each(|row| near(&bench, &format!("ridge{row}"), &ridge, row, 1e-9));
    // Coordinate descent stops at a duality gap. scikit-learn used 1e-14 of the sum of squares of the target.
    (0..18).for_each(|row| near(&bench, &format!("net{row}"), &net, row, 1e-5));
    (1..=8).for_each(|k| near(&bench, &format!("pls{k}"), &pls, k - 1, 1e-8));
    near(&bench, "svd8", &ridge, 0, 1e-9);
    near(&bench, "white8", &ridge, 0, 1e-9);
}

#[test]
fn val_partial_least_squares_of_two_targets_equals_scikit_learn() {
    let pls = reference("pls.csv");
    let of = |name: &str, target: &str, other: &str, k: usize| {
        fit(name, target, &format!("model = \"pls\"\ncomponents = {k}\nwith_targets = [\"{other}\"]"))
    };
    let mut stages = String::new();
    for k in 1..=8 {
        stages += &of(&format!("first{k}"), "mag_4_uc", "mag_5_uc", k);
        stages += &of(&format!("second{k}"), "mag_5_uc", "mag_4_uc", k);
        stages += &fit(&format!("alone{k}"), "mag_4_uc", &format!("model = \"pls\"\ncomponents = {k}"));
    }
    let bench = small_case(&stages);
    run(&bench);
    for k in 1..=8 {
        // The rows of two targets follow the eight rows of one target and alternate between the targets.
        near(&bench, &format!("first{k}"), &pls, 8 + 2 * (k - 1), 1e-7);
        near(&bench, &format!("second{k}"), &pls, 9 + 2 * (k - 1), 1e-7);
        near(&bench, &format!("alone{k}"), &pls, k - 1, 1e-8);
    }
    let refused = small_case(&fit("no", "mag_4_uc", "model = \"ridge\"\nwith_targets = [\"mag_5_uc\"]")).run(&[]);
    assert!(refused.code == 2 && refused.stderr.contains("`with_targets` belongs to `pls`"), "{}", refused.stderr);
}

#[test]
fn val_robust_models_equal_scikit_learn_and_statsmodels() {
    let table = reference("robust.csv");
    let stages: Vec<String> = (0..table["kind"].len())
        .map(|row| {
            let tuning = table["tuning"][row];
            let kind = match table["kind"][row] {
                0.0 => format!("scale = \"joint\"\nthreshold = {tuning:?}"),
                1.0 => format!("scale = \"mad\"\nthreshold = {tuning:?}"),
                _ => format!("scale = \"joint\"\nloss = \"student_t\"\ndegrees_of_freedom = {tuning:?}"),
            };
            let more = format!("model = \"robust\"\nlambda = {:?}\n{kind}", table["penalty"][row]);
            fit(&format!("robust{row}"), "mag_5_uc", &more)
        })
        .collect();
    let bench = small_case(&stages.concat());
    run(&bench);
    // At the minimum of the objective, coefficients have half of the accurate digits of the objective.
    (0..table["kind"].len()).for_each(|row| near(&bench, &format!("robust{row}"), &table, row, 1e-4));
}

#[test]
fn law_recursive_least_squares_without_forgetting_equals_ridge_regression() {
    let bench = small_case(
        &[
            fit("recursive", "mag_4_uc", "model = \"recursive_least_squares\"\nscaling = \"none\"\nlambda = 0.5"),
            fit("ridge", "mag_4_uc", "model = \"ridge\"\nscaling = \"none\"\nintercept = false\nlambda = 0.5"),
        ]
        .concat(),
    );
    run(&bench);
    let (one, other) = (coefficients(&bench, "recursive"), coefficients(&bench, "ridge"));
    assert_eq!((one.len(), other.len()), (8, 8));
    for (a, b) in one.iter().zip(&other) {
        assert!((a - b).abs() < 1e-9 * (b.abs() + 1e-2), "{a} {b}");
    }
}

#[test]
fn val_chosen_parameters_match_explicit_formulas() {
    let table = reference("choice.csv");
    let spelt = |name: &str| table[name].iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ");
    let net = format!(
        "model = \"elastic_net\"\nscaling = \"none\"\nl1_ratio = 0.7\nchoose = \"leave_one_line_out\"\nlambdas = [{}]",
        spelt("alpha")
    );
    let ridge = |how: &str| format!("model = \"ridge\"\nchoose = \"{how}\"\nlambdas = [{}]", spelt("lambda"));
    let bench = small_case(
        &[
            fit("best", "mag_5_uc", &net),
            fit("simpler", "mag_5_uc", &format!("{net}\none_standard_error = true")),
            fit("gcv", "mag_4_uc", &ridge("gcv")),
            fit("corner", "mag_4_uc", &ridge("l_curve")),
            fit("lines", "mag_4_uc", &ridge("leave_one_line_out")),
        ]
        .concat(),
    );
    run(&bench);
    let scores: Vec<Vec<f64>> = (0..9).map(|i| (0..4).map(|k| table[&format!("line{k}")][i]).collect()).collect();
    let mean = |s: &Vec<f64>| s.iter().sum::<f64>() / 4.0;
    let least = |values: &[f64]| (0..values.len()).min_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap();
    let means: Vec<f64> = scores.iter().map(mean).collect();
    let best = least(&means);
    let spread: f64 = scores[best].iter().map(|s| (s - means[best]).powi(2)).sum();
    let limit = means[best] + (spread / 3.0 / 4.0).sqrt();
    let simpler = means.iter().position(|m| *m <= limit).unwrap();
    assert!(simpler < best, "{means:?}");
    assert_eq!(chosen(&bench, "best"), table["alpha"][best]);
    // In this case the mean squares of scikit-learn and the variances lead to the same choice.
    assert_eq!(best, least(&table["mean_square"]));
    assert_eq!(chosen(&bench, "simpler"), table["alpha"][simpler]);
    assert_eq!(chosen(&bench, "gcv"), table["lambda"][least(&table["gcv"])]);
    for name in ["corner", "lines"] {
        assert!(table["lambda"].contains(&chosen(&bench, name)), "{name} {}", chosen(&bench, name));
    }
    // The fit uses the chosen parameter.
    let again = format!("model = \"ridge\"\nlambda = {:?}", chosen(&bench, "gcv"));
    let given = small_case(&fit("given", "mag_4_uc", &again));
    run(&given);
    assert_eq!(coefficients(&given, "given"), coefficients(&bench, "gcv"));
}

#[test]
fn user_truth_is_rejected_as_a_feature_directly_and_in_a_list() {
    let bench = Bench::new();
    let head = "name = \"truth\"\nstore = \"store\"\n[tables.flights]\npath = \"flights/\"\n";
    let fit = |features: &str, input: &str| {
        format!(
            "[[stages]]\nname = \"fit\"\nstage = \"fit\"\ninput = \"{input}\"\nmodel = \"ridge\"\n\
             target = \"mag_4_uc\"\nfeatures = [\"{features}\"]\n"
        )
    };
    let list = |features: &str| {
        format!("[[stages]]\nname = \"made\"\nstage = \"features\"\ninput = \"flights\"\nfeatures = [\"{features}\"]\n")
    };
    for features in ["mag_1_c", "mag_1_c_dot", "lpf_mag_1_c", "mag_1_c_lag_2"] {
        bench.spec(&format!("{head}{}{}", list(features), fit("features", "made")));
        let done = bench.run(&[]);
        assert_eq!(done.code, 2, "{features}: {}", done.stderr);
        assert!(done.stderr.contains("mag_1_c") && done.stderr.contains("truth"), "{}", done.stderr);
    }
    bench.spec(&format!("{head}{}", fit("mag_1_c", "flights")));
    let done = bench.run(&[]);
    assert!(done.code == 2 && done.stderr.contains("truth"), "{}", done.stderr);
}

/// Sweep over every kind of axis and model, with lists.
fn sweep() -> Bench {
    let features = TERMS.map(|t| format!("\"{t}\"")).join(",");
    let models = ["tolles_lawson", "ridge", "elastic_net", "pls", "truncated_svd", "robust", "recursive_least_squares"];
    let names = models.map(|m| format!("\"{m}\"")).join(",");
    small_case(&format!(
        "[axes]\nterms = {{ subsets_of = [\"a0\", [\"a1\", \"a2\"], \"a5\"], up_to = 2 }}\nmodel = [{names}]\n\
         lambda = [0.01, 0.5, 20.0]\n\
         [[stages]]\nname = \"made\"\nstage = \"features\"\ninput = \"flights\"\nfeatures = [{features}]\n\
         publish = false\n\
         [[stages]]\nname = \"columns\"\nstage = \"fit\"\ninput = \"flights\"\nmodel = \"$model\"\n\
         target = \"mag_4_uc\"\nfeatures = [\"$terms\", \"a7\"]\nlambda = \"$lambda\"\ncomponents = 2\nlow_hz = 0.0\n\
         high_hz = 0.0\ntrim = 0\n\
         [[stages]]\nname = \"entries\"\nstage = \"fit\"\ninput = \"made\"\nmodel = \"$model\"\n\
         target = \"mag_4_uc\"\nfeatures = [\"features\"]\nentries = [\"$terms\", \"a7\"]\nlambda = \"$lambda\"\n\
         components = 2\nlow_hz = 0.0\nhigh_hz = 0.0\ntrim = 0\n"
    ))
}

#[test]
fn user_a_sweep_of_models_has_the_same_bytes_with_any_threads_and_in_any_steps() {
    let bench = sweep();
    let run = |more: &[&str]| {
        let done = bench.run(more);
        assert!(done.code == 0 && done.total("failed") == 0, "{}", done.stderr);
    };
    run(&["--set", "store=one", "--threads", "1"]);
    run(&["--set", "store=two", "--threads", "2"]);
    for step in ["axes.lambda=[0.5]", "axes.model=[\"pls\", \"robust\"]", "axes.terms=[[\"a5\"]]"] {
        run(&["--set", "store=grown", "--set", step]);
    }
    run(&["--set", "store=grown"]);
    let one = bench.tables("one");
    assert!(one.len() >= 3 && !one.keys().any(|k| k.contains("/made/")), "{:?}", one.keys());
    for other in ["two", "grown"] {
        let other_tables = bench.tables(other);
        assert_eq!(one.keys().collect::<Vec<_>>(), other_tables.keys().collect::<Vec<_>>());
        for (name, bytes) in &one {
            assert!(other_tables[name] == *bytes, "{name} differs in {other}");
        }
    }
}

#[test]
fn law_entries_of_a_list_are_the_columns_of_that_name() {
    let bench = sweep();
    run(&bench);
    let [columns, entries] = ["columns", "entries"].map(|name| read(&bench.path("store/tables/small").join(name)));
    let keys = |t: &[RecordBatch]| {
        let of = |c| texts(t, c);
        of("terms").into_iter().zip(of("model")).zip(of("term")).collect::<Vec<_>>()
    };
    assert_eq!(keys(&columns), keys(&entries));
    let mut sets = texts(&columns, "terms");
    sets.dedup();
    assert_eq!(sets, ["a0", "a1+a2", "a5", "a0+a1+a2", "a0+a5", "a1+a2+a5"]);
    for column in ["value", "residual_std"] {
        for (a, b) in numbers(&columns, column).iter().zip(numbers(&entries, column)) {
            // One factor is a part of the factor of eight columns; the other factor is computed separately. Robust
            // models stop at a tolerance.
            assert!((a - b).abs() <= 1e-6 * (b.abs() + 1e-2), "{column}: {a} {b}");
        }
    }
}

#[test]
fn gold_missing_entries_are_rejected() {
    let bench = small_case(&fit("bad", "mag_4_uc", "model = \"ridge\"\nentries = [\"a0\", \"b7\"]"));
    let done = bench.run(&[]);
    assert_eq!(done.code, 2);
    assert!(done.stderr.contains("the features have no entry `b7`"), "{}", done.stderr);
    let bench = small_case(&fit("bad", "mag_4_uc", "model = \"ridge\"\nentries = [\"a0\", \"a0\"]"));
    assert!(bench.run(&[]).stderr.contains("duplicate entry `a0`"));
}

#[test]
fn gold_a_key_of_another_model_is_rejected_with_the_owning_model() {
    let refused = |more: &str| {
        let done = small_case(&fit("bad", "mag_4_uc", more)).run(&[]);
        assert_eq!(done.code, 2, "{}", done.stderr);
        done.stderr
    };
    let text = refused("model = \"tolles_lawson\"\nl1_ratio = 0.5");
    assert!(text.contains("`l1_ratio` belongs to `elastic_net`") && text.contains("| ^^^^^^^^"), "{text}");
    assert!(refused("model = \"ridge\"\ncomponents = 3").contains("belongs to `pls` and `truncated_svd`"));
    assert!(refused("model = \"pls\"\nlambda = 0.5").contains("`lambda` belongs to `tolles_lawson`, "));
    let text = refused("model = \"robust\"\ndegrees_of_freedom = 4.0");
    assert!(text.contains("`degrees_of_freedom` belongs to the loss `student_t`"), "{text}");
    let text = refused("model = \"ridge\"\none_standard_error = true");
    assert!(text.contains("`one_standard_error` requires cross-validation"), "{text}");
    let text = refused("model = \"ridge\"\nlambda = 0.5\nchoose = \"gcv\"");
    assert!(text.contains("`lambda` and `choose = \"gcv\"` cannot be combined"), "{text}");
    // A misspelt choice gives the nearest valid word.
    assert!(refused("model = \"rigde\"").contains("did you mean `ridge`?"));
    assert!(refused("model = \"ridge\"\nscaling = \"max_ab\"").contains("did you mean `max_abs`?"));
}

#[test]
fn user_a_key_of_any_model_of_the_sweep_is_accepted() {
    let spec = |models: &str| {
        let stage = fit("swept", "mag_4_uc", "model = \"$kind\"\ncomponents = 2\nlambda = \"$lambda\"");
        small_case(&format!("[axes]\nkind = [{models}]\nlambda = [0.1, 1.0]\n{stage}")).magline(&["check", "spec.toml"])
    };
    assert!(spec("\"ridge\", \"pls\"").status.success());
    // An axis value may apply to other models. A key that applies to no model is an error.
    assert!(spec("\"pls\"").status.success());
    let none = spec("\"ridge\", \"robust\"");
    assert_eq!(none.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&none.stderr).contains("`components` belongs to `pls` and `truncated_svd`"));
}

/// Sweep of two models over the ridge parameter, which applies to only one of the models.
fn two_models(more: &str) -> Bench {
    let stage = fit("swept", "mag_4_uc", &format!("model = \"$kind\"\nlambda = \"$lambda\"\ncomponents = 2\n{more}"));
    small_case(&format!(
        "[axes]\nkind = [\"ridge\", \"pls\"]\nlambda = [0.1, 1.0, 10.0]\n{stage}\
         [[stages]]\nname = \"clean\"\nstage = \"compensate\"\ninput = \"flights\"\nmodel = \"swept\"\n\
         mag = \"mag_4_uc\"\n"
    ))
}

#[test]
fn user_points_that_differ_only_in_an_unused_key_are_computed_once_and_all_published() {
    let bench = two_models("");
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let counted = |table: &str, what: &str| done.last["tables"][table][what].as_u64().unwrap();
    // Three ridge fits and one partial least squares fit, and their compensation of four lines.
    assert_eq!((done.computed("swept"), counted("swept", "reused")), (4, 2));
    assert_eq!((done.computed("clean"), counted("clean", "reused")), (16, 8));
    let table = read(&bench.path("store/tables/small/swept"));
    let (kinds, lambdas, values) = (texts(&table, "kind"), numbers(&table, "lambda"), numbers(&table, "value"));
    assert_eq!(values.len(), 6 * 9);
    let of = |kind: &str, lambda: f64| -> Vec<f64> {
        let rows = (0..values.len()).filter(|i| kinds[*i] == kind && lambdas[*i] == lambda);
        rows.map(|i| values[i]).collect()
    };
    assert_eq!(of("pls", 0.1).len(), 9);
    assert!(of("pls", 0.1) == of("pls", 1.0) && of("pls", 0.1) == of("pls", 10.0));
    assert!(of("ridge", 0.1) != of("ridge", 1.0));
    let clean = read(&bench.path("store/tables/small/clean"));
    let rows = |lambda: f64| numbers(&clean, "lambda").iter().filter(|l| **l == lambda).count();
    assert!(rows(0.1) > 0 && rows(0.1) == rows(1.0) && rows(0.1) == rows(10.0));
    // All results are now in the store, including the result shared with another point.
    let again = bench.run(&[]);
    assert_eq!((again.code, again.total("computed")), (0, 0), "{}", again.last);
    // The bytes are the same with one thread and after growth in steps.
    for more in [&["--set", "store=one", "--threads", "1"][..], &["--set", "store=grown", "--set", "axes.lambda=[1.0]"]]
    {
        assert_eq!(bench.run(more).code, 0);
    }
    let grown = bench.run(&["--set", "store=grown"]);
    assert_eq!(grown.computed("swept"), 2, "{}", grown.last);
    let tables = bench.tables("store");
    for store in ["one", "grown"] {
        assert!(bench.tables(store) == tables, "{store}");
    }
}

#[test]
fn user_points_with_the_same_failure_are_each_listed_and_not_retried() {
    let bench = two_models("trim = 100000");
    let spec = fs::read_to_string(bench.path("spec.toml")).unwrap().replacen("trim = 0\n", "", 1);
    bench.spec(&spec);
    let first = bench.run(&[]);
    assert_eq!((first.code, first.total("failed")), (1, 6), "{}", first.stderr);
    let stages = |bench: &Bench| texts(&read(&bench.path("store/tables/small/failures")), "stage");
    assert_eq!(stages(&bench).iter().filter(|s| *s == "swept").count(), 6);
    let packs = || fs::read_dir(bench.path("store/objects")).unwrap().count();
    let before = packs();
    let again = bench.run(&[]);
    assert_eq!((again.code, again.total("computed"), again.total("failed")), (1, 0, 6), "{}", again.last);
    assert_eq!(packs(), before);
}

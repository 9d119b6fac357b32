//! `[search]`: search over axis values.

use serde_json::Value;

use crate::{
    killed::same_after,
    support::{Bench, numbers, read, stderr, stdout, texts},
};

/// Stages of a compensation, for a search or a sweep.
const STAGES: &str = r#"
[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "flights"
vector = "flux_d"

[[stages]]
name   = "coefficients"
stage  = "fit"
input  = "terms"
where  = "line like '%.01'"
model  = "tolles_lawson"
target = "mag_5_uc"
lambda = "$lambda"
trim   = "$trim"

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
model = "coefficients"
mag   = "mag_5_uc"

[[stages]]
name  = "scores"
stage = "score"
input = "clean"
truth = "mag_1_c"
"#;

const HEAD: &str = "name = 'small'\nseed = 1\nstore = 'store'\n[tables.flights]\npath = 'flights/'\n";

/// Search axes: ridge parameter and trimmed samples at the ends of a line.
const AXES: &str =
    "[search.axes]\nlambda = { low = 1e-6, high = 100.0, log = true }\ntrim = { low = 0, high = 60, whole = true }\n";

fn spec(search: &str) -> String {
    format!("{HEAD}{search}{STAGES}")
}

fn searched(keys: &str) -> Bench {
    let bench = Bench::new();
    bench.spec(&spec(&format!("[search]\ngoal = 'scores.std_error'\nwhere = \"line like '%.02'\"\n{keys}\n{AXES}")));
    bench
}

const TPE: &str = "trials = 16\ngeneration = 4\nstart = 4";
const HALVING: &str =
    "trials = 18\ngeneration = 9\nstart = 9\nhalving = { axis = 'share', values = ['1.01', '2.01'], eta = 3 }";

/// Events of a run, one per line.
fn events(bench: &Bench, more: &[&str]) -> Vec<Value> {
    let args: Vec<&str> = ["run", "spec.toml", "--json"].iter().chain(more).copied().collect();
    let output = bench.magline(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    stdout(&output).lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

fn assert_rejected(search: &str, wanted: &[&str]) {
    let bench = Bench::new();
    bench.spec(&spec(search));
    let output = bench.magline(&["check", "spec.toml"]);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{search}\n{text}");
    for one in wanted {
        assert!(text.contains(one), "`{one}` is not said:\n{text}");
    }
    assert_eq!(text.matches("error:").count(), wanted.len(), "{text}");
}

#[test]
fn user_errors_of_a_search_are_reported_before_the_run() {
    let goal = "[search]\ntrials = 4\ngoal = 'scores.std_error'\n";
    assert_rejected(
        &format!("[search]\ntrials = 0\ngoal = 'scores.std_error'\n{AXES}"),
        &["`trials` must be 1 to 100000, not 0"],
    );
    assert_rejected(&format!("[search]\ntrials = 4\ngoal = 'score.std_error'\n{AXES}"), &["did you mean `scores`?"]);
    assert_rejected(&format!("[search]\ntrials = 4\ngoal = 'scores.std_eror'\n{AXES}"), &["did you mean `std_error`?"]);
    assert_rejected(
        &format!("[search]\ntrials = 4\ngoal = 'clean.std_error'\n{AXES}"),
        &["is not a table of line scores"],
    );
    assert_rejected(&format!("[search]\ntrials = 4\ngoal = 'std_error'\n{AXES}"), &["`goal` cannot be `std_error`"]);
    assert_rejected(&format!("{goal}where = \"lat > 3\"\n{AXES}"), &["there is no column `lat`"]);
    assert_rejected(
        &format!("{goal}start = 3\nmethod = 'random'\n{AXES}"),
        &["`start` belongs to `tpe`, not to `random`"],
    );
    assert_rejected(&format!("{goal}trails = 3\n{AXES}"), &["did you mean `trials`?"]);
    assert_rejected(&format!("{goal}method = 'tpo'\n{AXES}"), &["did you mean `tpe`?"]);
    assert_rejected(
        &format!(
            "{goal}[search.axes]\nlambda = {{ low = 1.0, high = 1.0 }}\ntrim = {{ low = 0.5, high = 9, whole = true \
             }}\n"
        ),
        &[
            "`low` of the axis `lambda` is 1; it must be below `high`, 1",
            "`low` of the axis `trim` is 0.5; it must be \
            a whole number",
        ],
    );
    assert_rejected(
        &format!("{goal}[search.axes]\nlambda = {{ low = 0.0, high = 1.0, log = true }}\ntrim = [1]\n"),
        &["`low` of the axis `lambda` is 0; with `log` it must be positive"],
    );
    assert_rejected(&format!("[axes]\ntrim = [1, 2]\n{goal}{AXES}"), &["the axis `trim` is both searched and listed"]);
    assert_rejected(&format!("{goal}{AXES}more = [1, 2]\n"), &["no stage uses the searched axis `more`"]);
    assert_rejected(
        &format!("{goal}{AXES}state = [1, 2]\n"),
        &["has the same name as a column of the table of trials"],
    );
    assert_rejected(goal, &["`search` requires `[search.axes]`"]);
    assert_rejected(&format!("{goal}[search.axes]\nlambda = [1.0, 2.0]\n"), &["there is no axis `trim`"]);
    assert_rejected(
        &format!("{goal}halving = {{ axis = 'lambda', values = [1] }}\n{AXES}"),
        &["`halving` requires at least two \
        rungs"],
    );
    assert_rejected(
        &format!("{goal}halving = {{ axis = 'lambda', values = [1, 2] }}\n{AXES}"),
        &["the axis `lambda` of `halving` is also searched"],
    );
    // A goal without lines is detected once the lines are known.
    let bench = Bench::new();
    bench.spec(&spec(&format!("{goal}where = \"line = '9.09'\"\n{AXES}")));
    let output = bench.magline(&["run", "spec.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("the goal of the search selects no line"), "{}", stderr(&output));
}

#[test]
fn user_every_trial_is_a_row_and_the_best_is_reported() {
    let bench = searched(TPE);
    let text = stdout(&bench.magline(&["check", "spec.toml"]));
    assert!(text.contains("4 tables, at most 49 points"), "{text}");
    let text = stdout(&bench.magline(&["explain", "spec.toml"]));
    assert!(
        text.contains(
            "search tpe for scores.std_error where line like '%.02': 16 trials, 4 at a time, 4 of them planned"
        ),
        "{text}"
    );
    assert!(text.contains("axis lambda = searched: 0.000001 to 100, by ratio"), "{text}");
    assert!(text.contains("at 4 points: trial (4), at most 16 after the search; 2 lines"), "{text}");
    // Terms on 4 lines. Each trial has one fit, and 4 lines are compensated and scored.
    assert!(text.contains("the complete search has at most 148 units"), "{text}");
    let output = bench.magline(&["run", "spec.toml"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let trials = read(&bench.path("store/tables/small/trials"));
    let (number, goal) = (numbers(&trials, "trial"), numbers(&trials, "goal"));
    assert_eq!(number, (1..=16).map(f64::from).collect::<Vec<_>>());
    assert_eq!(numbers(&trials, "generation"), (0..16).map(|i| f64::from(i / 4 + 1)).collect::<Vec<_>>());
    assert!(texts(&trials, "state").iter().all(|s| s == "done") && numbers(&trials, "lines").iter().all(|n| *n == 2.0));
    let best = (0..16).min_by(|a, b| goal[*a].total_cmp(&goal[*b])).unwrap();
    let printed = stdout(&output);
    assert!(printed.contains(&format!("best of 16 trials: trial {}, scores.std_error ", best + 1)), "{printed}");
    // The goal is the root mean square of the scores of both lines, weighted by samples.
    let scores = read(&bench.path("store/tables/small/scores"));
    let (of, line, metric) = (numbers(&scores, "trial"), texts(&scores, "line"), texts(&scores, "metric"));
    let (value, n) = (numbers(&scores, "value"), numbers(&scores, "n"));
    for (trial, goal) in number.iter().zip(&goal) {
        let rows =
            || (0..of.len()).filter(|i| of[*i] == *trial && metric[*i] == "std_error" && line[*i].ends_with(".02"));
        let square: f64 = rows().map(|i| n[i] * value[i] * value[i]).sum::<f64>() / rows().map(|i| n[i]).sum::<f64>();
        assert!(rows().count() == 2 && (square.sqrt() - goal).abs() < 1e-12 * goal, "{trial}");
    }
    // Each row of a model holds its parameter values.
    let models = read(&bench.path("store/tables/small/coefficients"));
    let (of, lambda) = (numbers(&models, "trial"), numbers(&models, "lambda"));
    let asked = numbers(&trials, "lambda");
    assert!(of.iter().zip(&lambda).all(|(t, l)| asked[*t as usize - 1] == *l));
    // All results are reused, and the report plots them.
    let done = bench.run(&[]);
    assert_eq!((done.code, done.total("computed")), (0, 0), "{}", done.stderr);
    let text = stdout(&bench.magline(&["explain", "spec.toml"]));
    assert!(text.contains("16 of them planned") && text.contains("64 of 64 stored, 0 to compute"), "{text}");
    assert!(bench.magline(&["report", "spec.toml", "-o", "a.html"]).status.success());
    let page = std::fs::read_to_string(bench.path("a.html")).unwrap();
    assert!(
        page.contains("Goal over lambda")
            && page.contains("Goal of each trial")
            && page.contains("searched: 0.000001 to 100")
    );
    assert!(!page.contains("of the earlier spec or data"), "the report takes the trials of the last run for its own");
}

#[test]
fn user_one_thread_and_two_give_the_same_trials() {
    let bench = searched(TPE);
    for (store, threads) in [("one", "1"), ("two", "2")] {
        let done = bench.run(&["--set", &format!("store={store}"), "--threads", threads]);
        assert_eq!(done.code, 0, "{}", done.stderr);
    }
    let (one, two) = (bench.tables("one"), bench.tables("two"));
    assert_eq!(one.keys().collect::<Vec<_>>(), two.keys().collect::<Vec<_>>());
    assert!(one.keys().any(|k| k.contains("/trials/")));
    for (name, bytes) in &one {
        assert!(two[name] == *bytes, "{name} differs");
    }
    // Another seed has other trials.
    assert_eq!(bench.run(&["--set", "store=other", "--set", "search.seed=5"]).code, 0);
    let lambda = |store: &str| numbers(&read(&bench.path(store).join("tables/small/trials")), "lambda");
    assert!(lambda("one") == lambda("two") && lambda("one") != lambda("other"));
}

#[test]
fn user_a_killed_search_resumes_to_the_same_bytes() {
    same_after(&searched(TPE), |child| child.kill().unwrap());
}

#[test]
fn user_force_recomputes_all_trials_of_a_search() {
    let bench = searched(TPE);
    let first = events(&bench, &[]).pop().unwrap();
    let before = bench.tables("store");
    let again = events(&bench, &["--force"]).pop().unwrap();
    assert_eq!((&again["computed"], &again["interrupted"]), (&0.into(), &false.into()));
    let compared = again["compared"].as_array().unwrap();
    // All trials of all generations: the number of units equals the number that the search computed.
    for table in ["coefficients", "clean", "scores"] {
        let found = compared.iter().find(|c| c["table"] == table).unwrap();
        let computed = &first["tables"][table]["computed"];
        assert_eq!((&found["units"], &found["differ"]), (computed, &0.into()), "{table}");
    }
    assert_eq!(bench.tables("store"), before);
}

#[test]
fn user_the_cost_of_a_search_includes_all_its_trials() {
    // Successive halving: in each of two generations, three of nine trials are promoted to the second rung.
    for (keys, assumed) in [(TPE, 12), (HALVING, 15)] {
        let bench = searched(keys);
        let text = std::fs::read_to_string(bench.path("spec.toml")).unwrap();
        if keys == HALVING {
            bench.spec(&text.replace("where  = \"line like '%.01'\"", "where  = \"line = '$share'\""));
        }
        let cost = || -> Value {
            let output = bench.magline(&["explain", "spec.toml", "--cost", "--format", "json"]);
            assert!(output.status.success(), "{}", stderr(&output));
            serde_json::from_str(&stdout(&output)).unwrap()
        };
        let before = cost();
        assert_eq!(before["trials_assumed"], assumed);
        let text = stdout(&bench.magline(&["explain", "spec.toml", "--cost"]));
        assert!(text.contains(&format!("the parameter values of {assumed} trials are assumed")), "{text}");
        let done = events(&bench, &[]).pop().unwrap();
        for table in before["tables"].as_array().unwrap() {
            let name = table["table"].as_str().unwrap();
            // Only repeated values are computed once.
            assert_eq!(table["compute"], done["tables"][name]["computed"], "{name}");
        }
        let after = cost();
        assert_eq!((&after["trials_assumed"], &after["processor_s"]), (&0.into(), &0.0.into()));
    }
}

#[test]
fn user_a_search_finds_the_best_of_a_fine_sweep() {
    let bench = searched("trials = 32\ngeneration = 8");
    let sets = ["--set", "search.axes.trim=[20]", "--set", "store=store"];
    assert_eq!(bench.run(&sets).code, 0);
    let trials = read(&bench.path("store/tables/small/trials"));
    let (goal, lambda) = (numbers(&trials, "goal"), numbers(&trials, "lambda"));
    // 200 values with constant ratio over the whole range.
    let listed: Vec<String> =
        (0..200).map(|i| format!("{:e}", 10f64.powf(-6.0 + 8.0 * f64::from(i) / 199.0))).collect();
    bench.spec(&format!("{HEAD}[axes]\nlambda = [{}]\ntrim = [20]\n{STAGES}", listed.join(", ")));
    assert_eq!(bench.run(&["--set", "store=swept"]).code, 0);
    let scores = read(&bench.path("swept/tables/small/scores"));
    let (of, line, metric) = (numbers(&scores, "lambda"), texts(&scores, "line"), texts(&scores, "metric"));
    let (value, n) = (numbers(&scores, "value"), numbers(&scores, "n"));
    let mut sums: Vec<(f64, f64, f64)> = vec![];
    for i in (0..of.len()).filter(|i| metric[*i] == "std_error" && line[*i].ends_with(".02")) {
        match sums.iter_mut().find(|s| s.0 == of[i]) {
            Some(sum) => *sum = (sum.0, sum.1 + n[i] * value[i] * value[i], sum.2 + n[i]),
            None => sums.push((of[i], n[i] * value[i] * value[i], n[i])),
        }
    }
    let swept: Vec<(f64, f64)> = sums.iter().map(|s| (s.0, (s.1 / s.2).sqrt())).collect();
    assert_eq!(swept.len(), 200);
    let best = swept.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    let worst = swept.iter().map(|s| s.1).fold(0.0, f64::max);
    // The optimum is inside the range and not on a plateau.
    assert!(best.0 > 1e-5 && best.0 < 10.0 && worst > 1.5 * best.1, "{best:?} {worst}");
    let found = (0..goal.len()).min_by(|a, b| goal[*a].total_cmp(&goal[*b])).unwrap();
    // The goal is within 1/100 of the range of the sweep. 1/32 as many random values would have a larger error.
    assert!(goal[found] - best.1 < 0.01 * (worst - best.1), "{} at {}, swept {best:?}", goal[found], lambda[found]);
}

#[test]
fn user_the_goal_is_pooled_over_other_axes_and_can_be_maximised() {
    let bench = searched(&format!("{TPE}\ndirection = 'maximise'"));
    let text = std::fs::read_to_string(bench.path("spec.toml")).unwrap();
    let swept = text
        .replace("\"mag_5_uc\"", "\"$mag\"")
        .replace("[search]", "[axes]\nmag = ['mag_4_uc', 'mag_5_uc']\n[search]");
    bench.spec(&swept);
    let output = bench.magline(&["run", "spec.toml"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let trials = read(&bench.path("store/tables/small/trials"));
    let goal = numbers(&trials, "goal");
    assert!(numbers(&trials, "lines").iter().all(|n| *n == 4.0));
    let best = (0..16).max_by(|a, b| goal[*a].total_cmp(&goal[*b])).unwrap();
    assert!(stdout(&output).contains(&format!("trial {}, scores.std_error ", best + 1)), "{}", stdout(&output));
    let scores = read(&bench.path("store/tables/small/scores"));
    let (of, line, metric) = (numbers(&scores, "trial"), texts(&scores, "line"), texts(&scores, "metric"));
    let (value, n) = (numbers(&scores, "value"), numbers(&scores, "n"));
    let rows = || (0..of.len()).filter(|i| of[*i] == 7.0 && metric[*i] == "std_error" && line[*i].ends_with(".02"));
    let square = rows().map(|i| n[i] * value[i] * value[i]).sum::<f64>() / rows().map(|i| n[i]).sum::<f64>();
    assert!((square.sqrt() - goal[6]).abs() < 1e-12 * goal[6]);
    // The report identifies each point, although trials share values of a choice.
    let sets = ["--set", "search.axes.trim=[10, 20]", "--set", "store=again"];
    assert_eq!(bench.run(&sets).code, 0);
    let args: Vec<&str> = ["report", "spec.toml", "-o", "a.html"].iter().chain(&sets).copied().collect();
    assert!(bench.magline(&args).status.success());
    let page = std::fs::read_to_string(bench.path("a.html")).unwrap();
    assert!(page.contains("32 points of the sweep") && page.contains("Goal over trim"), "a point is missing");
}

#[test]
fn user_a_search_with_predetermined_points_is_one_run() {
    for method in ["method = 'sobol'\nscramble = false", "method = 'random'"] {
        let bench = searched(&format!("trials = 8\n{method}"));
        let all = events(&bench, &[]);
        let of = |event: &str| all.iter().filter(|e| e["event"] == event).count();
        assert_eq!((of("started"), of("searching"), of("trial"), of("finished")), (1, 0, 8, 1), "{method}");
        let trials = read(&bench.path("store/tables/small/trials"));
        if method.contains("sobol") {
            // The Sobol points 0, 1/2, 3/4 and 1/4, of eight decades and of 61 whole numbers.
            let lambda: Vec<f64> = numbers(&trials, "lambda").iter().map(|l| l.log10()).collect();
            for (ours, wanted) in lambda.iter().zip([-6.0, -2.0, 0.0, -4.0]) {
                assert!((ours - wanted).abs() < 1e-9, "{lambda:?}");
            }
            assert_eq!(numbers(&trials, "trim")[..4], [0.0, 30.0, 15.0, 45.0]);
        }
        assert!(numbers(&trials, "goal").iter().all(|g| g.is_finite()));
    }
}

#[test]
fn user_events_name_each_trial_once() {
    let bench = searched(TPE);
    let all = events(&bench, &[]);
    let of = |event: &str| all.iter().filter(|e| e["event"] == event).collect::<Vec<_>>();
    assert_eq!((of("started").len(), of("searching").len(), of("trial").len(), of("finished").len()), (1, 4, 16, 1));
    let last = all.last().unwrap();
    assert_eq!(last["tables"]["coefficients"]["computed"], 16, "{last}");
    let units = of("unit").len();
    let counted: u64 = ["computed", "reused", "failed", "skipped"].iter().map(|k| last[k].as_u64().unwrap()).sum();
    assert_eq!(units as u64, counted);
    let trial = of("trial")[15];
    assert_eq!((&trial["trial"], &trial["generation"], &trial["state"]), (&16.into(), &4.into(), &"done".into()));
    assert!(trial["axes"]["lambda"].is_number() && trial["best"]["goal"].is_number(), "{trial}");
}

#[test]
fn user_halving_promotes_the_best_third() {
    let bench = searched(HALVING);
    let text = std::fs::read_to_string(bench.path("spec.toml")).unwrap();
    // A rung uses another calibration line, with equal cost and another result.
    bench.spec(&text.replace("where  = \"line like '%.01'\"", "where  = \"line = '$share'\""));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let trials = read(&bench.path("store/tables/small/trials"));
    let (number, rung, goal) = (numbers(&trials, "trial"), numbers(&trials, "rung"), numbers(&trials, "goal"));
    let (state, share, generation) = (texts(&trials, "state"), texts(&trials, "share"), numbers(&trials, "generation"));
    assert_eq!(number.len(), 2 * (9 + 3));
    for of in [1.0, 2.0] {
        let first: Vec<usize> = (0..24).filter(|i| generation[*i] == of && rung[*i] == 1.0).collect();
        let mut order = first.clone();
        order.sort_by(|a, b| goal[*a].total_cmp(&goal[*b]));
        let mut on: Vec<f64> = order.iter().take(3).map(|i| number[*i]).collect();
        on.sort_by(f64::total_cmp);
        let second: Vec<f64> = (0..24).filter(|i| generation[*i] == of && rung[*i] == 2.0).map(|i| number[i]).collect();
        assert_eq!((first.len(), second), (9, on.clone()));
        for i in first {
            assert_eq!(
                (state[i].as_str(), share[i].as_str()),
                (if on.contains(&number[i]) { "promoted" } else { "pruned" }, "1.01")
            );
        }
    }
    assert!((0..24).filter(|i| rung[*i] == 2.0).all(|i| state[i] == "done" && share[i] == "2.01"));
    // There are 18 fits at the first rung and 6 fits at the second rung instead of 36 fits.
    assert_eq!(done.computed("coefficients"), 24);
    let text = stdout(&bench.magline(&["explain", "spec.toml"]));
    assert!(text.contains("rungs share = 1.01 | 2.01; 1 of 3 trials is promoted to the next rung"), "{text}");
    assert!(bench.magline(&["report", "spec.toml", "-o", "a.html"]).status.success());
    assert_eq!(bench.run(&[]).total("computed"), 0);
}

#[test]
fn user_a_failed_trial_is_ranked_last_and_listed() {
    // Lines of 700 samples: a trim of 400 at each end leaves no samples.
    let bench = searched(TPE);
    let done = bench.run(&["--set", "search.axes.trim=[10, 400]"]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    let trials = read(&bench.path("store/tables/small/trials"));
    let (trim, goal, state) = (numbers(&trials, "trim"), numbers(&trials, "goal"), texts(&trials, "state"));
    assert!(trim.contains(&400.0) && trim.contains(&10.0), "{trim:?}");
    for i in 0..trim.len() {
        assert_eq!(state[i], if trim[i] == 400.0 { "failed" } else { "done" });
        assert_eq!(goal[i].is_nan(), trim[i] == 400.0);
    }
    assert!(texts(&trials, "error").iter().zip(&trim).all(|(e, t)| e.is_empty() != (*t == 400.0)));
    let output = bench.magline(&["run", "spec.toml", "--set", "search.axes.trim=[10, 400]"]);
    assert!(
        stdout(&output).contains("without a goal: ") && stdout(&output).contains("small.trials"),
        "{}",
        stdout(&output)
    );
    // If all trials fail, the search ends after its first generation with a message.
    let output = bench.magline(&["run", "spec.toml", "--set", "search.axes.trim=[400]", "--set", "store=none"]);
    assert_eq!(output.status.code(), Some(1));
    let text = stderr(&output);
    assert!(text.contains("the goal `scores.std_error` has no value in any of the 4 trials"), "{text}");
    assert_eq!(numbers(&read(&bench.path("none/tables/small/trials")), "trial").len(), 4);
}

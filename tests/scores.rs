//! In-sample scores, pooled scores and undefined metrics: on the terminal, in the report, as JSON and in tables.

use std::{collections::BTreeMap, fs};

use arrow_array::{Array, RecordBatch, cast::AsArray};
use serde_json::Value;

use crate::support::{Bench, Done, SPEC, changed, line_of, numbers, read, stderr, stdout, texts, write};

/// Boolean column over all batches.
fn flags(batches: &[RecordBatch], column: &str) -> Vec<bool> {
    let one = |b: &RecordBatch| {
        let array = b.column_by_name(column).unwrap_or_else(|| panic!("no {column}")).as_boolean().clone();
        assert_eq!(array.null_count(), 0, "{column}");
        array.iter().flatten().collect::<Vec<bool>>()
    };
    batches.iter().flat_map(one).collect()
}

/// Keys of `navigate` that fit [`line_of_flight`].
const NAVIGATION: &str = "offset_window_s = 1.0\nmeasurement_sigma_nt = 1.0\nfogm_sigma_nt = 1.0\n\
                          map_interpolation = \"cubic\"\ninit_position_sigma_m = 40.0";

/// Line with an INS error of 40 m and white noise of 1 nT in its magnetometer.
fn line_of_flight(flight: &str, line: &str, rows: usize) -> RecordBatch {
    let mut state = line.bytes().fold(0x9E37_79B9_7F4A_7C15_u64, |all, byte| all.rotate_left(8) ^ u64::from(byte));
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let noise: Vec<f64> = (0..rows).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect();
    let line = changed(&line_of(flight, line, rows), "mag_4_uc", |row, nt| nt + noise[row]);
    changed(&changed(&line, "ins_lat", |_, lat| lat + 3e-4), "ins_lon", |_, lon| lon - 3e-4)
}

/// A folder with a spec and the flights of [`line_of_flight`].
fn bench(text: &str) -> Bench {
    let bench = Bench::new();
    for flight in ["1", "2"] {
        let lines =
            [("01", 700), ("02", 500)].map(|(line, rows)| line_of_flight(flight, &format!("{flight}.{line}"), rows));
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    bench.spec(text);
    bench
}

/// Spec with one magnetometer, one vector magnetometer and three ridge parameters, calibrated on the lines `%.01`, with
/// `changes` applied. The assumed errors are those of [`line_of_flight`], so that only the track of the largest ridge
/// parameter is flagged.
fn spec(changes: &[(&str, &str)]) -> String {
    let small = [
        ("[\"mag_4_uc\", \"mag_5_uc\"]", "[\"mag_4_uc\"]"),
        ("[\"flux_a\", \"flux_d\"]", "[\"flux_a\"]"),
        ("[0.0, 0.025]", "[0.025, 0.25, 25.0]"),
        ("offset_window_s = 1.0", NAVIGATION),
    ];
    small.iter().chain(changes).fold(SPEC.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    })
}

/// Runs a spec; returns the bench, standard output and standard error.
fn ran(text: &str) -> (Bench, String, String) {
    let bench = bench(text);
    let output = bench.magline(&["run", "spec.toml"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (bench, stdout(&output), stderr(&output))
}

/// In-sample flag of each line of a score table.
fn in_sample(bench: &Bench, table: &str) -> BTreeMap<String, bool> {
    let scores = read(&bench.path("store/tables/small").join(table));
    texts(&scores, "line").into_iter().zip(flags(&scores, "in_sample")).collect()
}

fn lines(seen: [bool; 4]) -> BTreeMap<String, bool> {
    ["1.01", "1.02", "2.01", "2.02"].map(str::to_owned).into_iter().zip(seen).collect()
}

const WHERE: &str = "where  = \"line like '%.01'\"\n";

#[test]
fn user_scores_of_fitted_lines_are_in_sample_and_pooled_apart() {
    let (bench, out, _) = ran(&spec(&[]));
    assert_eq!(in_sample(&bench, "scores"), lines([true, false, true, false]));
    assert!(out.contains("scores, pooled over 2 held-out lines; 2 in-sample lines are pooled separately"), "{out}");
    assert!(out.lines().filter(|l| l.starts_with('*')).count() == 2, "a star and its legend: {out}");

    // The pooled table: root mean squares of the held-out lines, and separately of the in-sample lines.
    let scores = read(&bench.path("store/tables/small/scores"));
    let (metrics, values, n) = (texts(&scores, "metric"), numbers(&scores, "value"), numbers(&scores, "n"));
    let (seen, lambdas) = (flags(&scores, "in_sample"), numbers(&scores, "lambda"));
    let rms = |metric: &str, lambda: f64, of: bool| {
        let wanted = |i: &usize| metrics[*i] == metric && lambdas[*i] == lambda && seen[*i] == of;
        let all: Vec<usize> = (0..values.len()).filter(wanted).collect();
        assert_eq!(all.len(), 2, "{metric}");
        let sum: f64 = all.iter().map(|i| n[*i] * values[*i].powi(2)).sum();
        (sum / all.iter().map(|i| n[*i]).sum::<f64>()).sqrt()
    };
    let pooled = read(&bench.path("store/tables/small/scores_pooled"));
    let (names, figures) = (texts(&pooled, "metric"), numbers(&pooled, "value"));
    let (of, apart) = (numbers(&pooled, "lambda"), numbers(&pooled, "value_in_sample"));
    for metric in ["std_error", "drms", "rms_north", "ins_drms"] {
        for lambda in [0.025, 0.25, 25.0] {
            let at = (0..names.len()).find(|i| names[*i] == metric && of[*i] == lambda).unwrap();
            assert!((figures[at] / rms(metric, lambda, false) - 1.0).abs() < 1e-12, "{metric}");
            assert!((apart[at] / rms(metric, lambda, true) - 1.0).abs() < 1e-12, "{metric}");
        }
    }
    assert!(flags(&pooled, "in_sample").iter().all(|seen| !seen), "each point has held-out lines");
    assert_eq!(texts(&pooled, "stage").iter().collect::<std::collections::BTreeSet<_>>().len(), 1);

    // Terminal, `--json`, SQL and table show the same number.
    let Done { last, .. } = bench.run(&[]);
    let points = last["scores"].as_array().unwrap();
    assert_eq!(points.len(), 3);
    for (point, lambda) in points.iter().zip([0.025, 0.25, 25.0]) {
        let json = point["metrics"]["drms"].as_f64().unwrap();
        assert!((json / rms("drms", lambda, false) - 1.0).abs() < 1e-12, "{point}");
        let apart = point["metrics_in_sample"]["drms"].as_f64().unwrap();
        assert!((apart / rms("drms", lambda, true) - 1.0).abs() < 1e-12, "{point}");
        assert_eq!((&point["in_sample"], &point["lines_held_out"]), (&Value::Bool(false), &Value::from(2)));
        let shown = format!("{json:.3}");
        assert!(out.contains(&shown[..4]), "{shown}: {out}");
    }
    let query = "SELECT value FROM small.scores_pooled WHERE metric = 'drms' AND lambda = 0.025";
    let sql = stdout(&bench.magline(&["sql", query, "--format", "csv"]));
    let asked: f64 = sql.lines().nth(1).unwrap().parse().unwrap();
    assert!((asked / rms("drms", 0.025, false) - 1.0).abs() < 1e-12, "{sql}");
}

#[test]
fn law_pooled_radii_contain_their_share_of_all_samples() {
    let (bench, ..) = ran(&spec(&[("[0.025, 0.25, 25.0]", "[0.025]")]));
    let (track, even) = (read(&bench.path("store/tables/small/track")), read(&bench.path("store/tables/small/even")));
    let [lat, lon] = ["lat", "lon"].map(|name| (numbers(&track, name), numbers(&even, name)));
    // Metres per degree on a sphere. The radii of the ellipsoid at 45 degrees north differ by less than the tolerance.
    let (north, east) = (111_131.8, 78_847.0);
    let names = texts(&track, "line");
    let held_out = (0..names.len()).filter(|i| names[*i].ends_with(".02"));
    let mut radii: Vec<f64> =
        held_out.map(|i| (north * (lat.0[i] - lat.1[i])).hypot(east * (lon.0[i] - lon.1[i]))).collect();
    radii.sort_by(f64::total_cmp);
    let pooled = read(&bench.path("store/tables/small/scores_pooled"));
    let (metrics, values, n) = (texts(&pooled, "metric"), numbers(&pooled, "value"), numbers(&pooled, "n"));
    for (metric, share) in [("cep", 0.5), ("r95", 0.95)] {
        let at = metrics.iter().position(|m| m == metric).unwrap();
        assert_eq!(n[at] as usize, radii.len());
        let exact = radii[(share * (radii.len() - 1) as f64).round() as usize];
        assert!((values[at] / exact - 1.0).abs() < 0.02, "{metric}: {} against {exact}", values[at]);
    }
}

#[test]
fn user_without_a_held_out_line_no_point_is_the_best() {
    let (bench, out, _) = ran(&spec(&[(WHERE, "")]));
    assert_eq!(in_sample(&bench, "scores"), lines([true; 4]));
    let rows: Vec<&str> = out.lines().skip_while(|l| !l.contains("drms [m]")).skip(1).take(3).collect();
    assert!(rows.iter().all(|row| row.starts_with("~ ") || row.starts_with("!~")), "{out}");
    assert!(!out.lines().any(|l| l.starts_with('*')), "{out}");
    assert!(out.contains("\n~ in sample: ") && out.contains("\nno best point: every line is in sample"), "{out}");
    let points = bench.run(&[]).last["scores"].clone();
    let all = points.as_array().unwrap().iter();
    assert!(all.clone().all(|p| p["in_sample"] == true && p["best"] == false && p["lines_in_sample"] == 4), "{points}");
    let pooled = read(&bench.path("store/tables/small/scores_pooled"));
    let (value, apart) = (numbers(&pooled, "value"), numbers(&pooled, "value_in_sample"));
    assert!(value.iter().zip(&apart).all(|(a, b)| a == b || (a.is_nan() && b.is_nan())));
    assert!(flags(&pooled, "in_sample").iter().zip(&value).all(|(seen, value)| *seen == value.is_finite()));
    // The report.
    let report = bench.magline(&["report", "spec.toml", "-o", "report.html"]);
    assert!(report.status.success(), "{}", stderr(&report));
    let page = fs::read_to_string(bench.path("report.html")).unwrap();
    let body = &page[page.find("id=\"scores-scores\"").unwrap()..page.find("id=\"plan\"").unwrap()];
    assert!(!body.contains("n best") && !body.contains("The best point") && body.contains(" ~</td>"), "{body}");
    assert!(body.contains("every point is in sample") && body.contains("4 of 4"), "{body}");
}

/// Second model, fitted to the residual of the first model on other lines.
const SECOND: &str = r#"
[[stages]]
name   = "terms_again"
stage  = "a_matrix"
input  = "clean"
vector = "$vector"

[[stages]]
name   = "again"
stage  = "fit"
input  = "terms_again"
where  = "line = '1.02'"
model  = "tolles_lawson"
target = "mag_c"
lambda = 0.025

[[stages]]
name  = "cleaner"
stage = "compensate"
input = "terms_again"
model = "again"
mag   = "mag_c"

[[stages]]
name  = "scores_again"
stage = "score"
input = "cleaner"
truth = "mag_1_c"
"#;

#[test]
fn user_lines_are_in_sample_through_other_tables() {
    let text = spec(&[("[0.025, 0.25, 25.0]", "[0.025]")]) + SECOND;
    let (bench, ..) = ran(&text);
    assert_eq!(in_sample(&bench, "scores"), lines([true, false, true, false]));
    // Lines of the first model, and lines of the second model, which was fitted to the residual of the first.
    assert_eq!(in_sample(&bench, "scores_again"), lines([true, true, true, false]));
    // A changed `where` of the second model does not affect the first.
    bench.spec(&text.replace("line = '1.02'", "line = '2.02'"));
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("scores"), done.computed("scores_again")), (0, 0, 4), "{}", done.stderr);
    assert_eq!(in_sample(&bench, "scores_again"), lines([true, false, true, true]));
}

/// Summaries of all lines, of two held-out lines, and of the two lines of the model.
const SUMMARIES: &str = r#"
[[stages]]
name  = "together"
stage = "summary"
input = "scores"

[[stages]]
name  = "held_out"
stage = "summary"
input = "scores"
where = "line like '%.02'"

[[stages]]
name  = "fitted"
stage = "summary"
input = "scores"
where = "line like '%.01'"
"#;

#[test]
fn user_a_summary_pools_held_out_lines_and_flags_in_sample_lines() {
    let (bench, _, err) = ran(&(spec(&[("[0.025, 0.25, 25.0]", "[0.025]")]) + SUMMARIES));
    let table = |name: &str| read(&bench.path("store/tables/small").join(name));
    let marks = |name: &str| flags(&table(name), "in_sample");
    let figures = |name: &str, column: &str| -> BTreeMap<String, f64> {
        texts(&table(name), "metric").into_iter().zip(numbers(&table(name), column)).collect()
    };
    let of = |name: &str, metric: &str, column: &str| figures(name, column)[metric];
    for column in ["value", "low", "high", "lines", "n"] {
        let both = ["together", "held_out"].map(|name| format!("{:?}", figures(name, column)));
        assert_eq!(both[0], both[1], "{column}");
    }
    assert!(!marks("together").is_empty() && marks("together").iter().all(|seen| !seen));
    assert!(!marks("held_out").is_empty() && marks("held_out").iter().all(|seen| !seen));
    assert!(!marks("fitted").is_empty() && marks("fitted").iter().all(|seen| *seen));
    assert!(!err.contains("in-sample lines with"), "{err}");
    // The summary and the pooled scores show the same number.
    for (metric, value) in metrics(&bench, "scores_pooled").into_iter().filter(|(_, value)| value.is_finite()) {
        let summary = of("together", &metric, "value");
        assert!((summary - value).abs() <= 1e-12 * value.abs(), "{metric}: {summary} {value}");
    }
    // A changed `where` of the model changes the pooled lines and the flag.
    bench.spec(&(spec(&[("[0.025, 0.25, 25.0]", "[0.025]"), ("'%.01'", "'1.02'")]) + SUMMARIES));
    assert_eq!(bench.run(&[]).code, 0);
    let lines = ["together", "held_out", "fitted"].map(|name| of(name, "std_error", "lines"));
    assert_eq!(lines, [3.0, 1.0, 2.0]);
    assert!(["together", "held_out", "fitted"].iter().all(|name| marks(name).iter().all(|seen| !seen)));
}

#[test]
fn user_lines_of_the_goal_of_a_search_are_in_sample() {
    let search = "[search]\ngoal = 'scores.std_error'\nwhere = \"line = '1.02'\"\ntrials = 3\n\
                  [search.axes]\nlambda = { low = 0.001, high = 1.0, log = true }\n";
    let text = spec(&[("lambda = [0.025, 0.25, 25.0]\n", "")])
        .replace("[[stages]]\nname    = \"even\"", &format!("{search}\n[[stages]]\nname    = \"even\""));
    let (bench, ..) = ran(&text);
    assert_eq!(in_sample(&bench, "scores"), lines([true, true, true, false]));
}

#[test]
fn user_the_cramer_rao_bound_is_never_the_best_result() {
    let text = spec(&[
        ("[0.025, 0.25, 25.0]", "[0.025]\nfilter = [\"ekf\", \"crlb\"]"),
        ("core_field      = false", "core_field      = false\nfilter          = \"$filter\""),
    ]);
    let (bench, out, _) = ran(&text);
    let query =
        "SELECT filter, min(value) AS least FROM small.scores WHERE metric = 'drms' GROUP BY filter ORDER BY least";
    let sql = stdout(&bench.magline(&["sql", query, "--format", "csv"]));
    assert!(sql.lines().nth(1).unwrap().starts_with("ekf,"), "{sql}");
    assert!(!sql.contains("crlb,0"), "{sql}");
    let starred = out.lines().find(|l| l.starts_with("*  ")).unwrap();
    assert!(starred.contains("ekf"), "{out}");
    let pooled = read(&bench.path("store/tables/small/scores_pooled"));
    let (metrics, filters, values) = (texts(&pooled, "metric"), texts(&pooled, "filter"), numbers(&pooled, "value"));
    let of = |metric: &str, filter: &str| {
        (0..values.len()).find(|i| metrics[*i] == metric && filters[*i] == filter).map(|i| values[i])
    };
    assert!(of("drms", "crlb").unwrap().is_nan() && of("drms_bound", "crlb").unwrap() > 0.0);
    assert!(of("drms", "ekf").unwrap() > 0.0 && of("drms_bound", "ekf").is_none());
}

/// At 1 Hz the upper corner of the metrics' band, 0.9 Hz, is above half the rate.
const SLOW: [(&str, &str); 3] = [
    ("rate_hz = 10.0", "rate_hz = 1.0"),
    ("lambda = \"$lambda\"", "lambda = \"$lambda\"\nlow_hz = 0.02\nhigh_hz = 0.4\norder = 2\ntrim = 2"),
    ("[0.025, 0.25, 25.0]", "[0.025]"),
];

#[test]
fn user_an_undefined_default_metric_is_omitted_with_a_reason() {
    let (bench, out, err) = ran(&spec(&SLOW));
    assert!(out.contains("std_error") && !out.contains("improvement_ratio_band"), "{out}");
    assert!(err.contains("`improvement_ratio_band` cannot be computed: ") && err.contains("0.9"), "{err}");
    let scores = read(&bench.path("store/tables/small/scores"));
    let (metrics, notes, values) = (texts(&scores, "metric"), texts(&scores, "note"), numbers(&scores, "value"));
    let noted: Vec<&String> = (0..notes.len()).filter(|i| !notes[*i].is_empty()).map(|i| &metrics[i]).collect();
    assert!(noted.len() == 4 && noted.iter().all(|m| *m == "improvement_ratio_band"), "{noted:?}");
    assert!((0..notes.len()).all(|i| notes[i].is_empty() || values[i].is_nan()));
    let warnings = read(&bench.path("store/tables/small/warnings"));
    assert_eq!(texts(&warnings, "kind").iter().filter(|kind| *kind == "metric").count(), 4);
}

#[test]
fn user_an_undefined_requested_metric_fails_alone() {
    let bench = Bench::new();
    let metrics = "truth = \"mag_1_c\"\nmetrics = [\"std_error\", \"improvement_ratio_band\"]";
    bench.spec(&spec(&[SLOW[0], SLOW[1], SLOW[2], ("truth = \"mag_1_c\"", metrics)]));
    let done = bench.run(&[]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    let failures = done.last["failures"].as_array().unwrap();
    assert_eq!(failures.len(), 4, "{}", done.last);
    assert!(failures.iter().all(|f| f["stage"] == "scores" && f["error"].as_str().unwrap().contains("_band`")));
    // The other metric is computed.
    let scores = read(&bench.path("store/tables/small/scores"));
    let (metrics, values) = (texts(&scores, "metric"), numbers(&scores, "value"));
    let there = (0..values.len()).filter(|i| metrics[*i] == "std_error" && values[*i].is_finite());
    assert_eq!(there.count(), 4);
    assert_eq!(read(&bench.path("store/tables/small/failures")).iter().map(RecordBatch::num_rows).sum::<usize>(), 4);
}

#[test]
fn user_axes_without_effect_ordinary_least_squares_and_edges_are_noted() {
    let text = spec(&[("\"tolles_lawson\"", "\"pls\"")]);
    let (_, _, err) = ran(&text);
    assert!(err.contains("`scores`: `lambda` has no effect"), "{err}");
    assert!(err.contains("the 3 points that differ only in `lambda` are computed once"), "{err}");
    assert!(err.contains("18 components for 18 terms give ordinary least squares"), "{err}");
    assert!(!err.contains("end of the axis `lambda`"), "equal values have no best: {err}");
    let (bench, _, err) = ran(&spec(&[("[0.025, 0.25, 25.0]", "[0.025, 25.0, 250.0]")]));
    assert!(err.contains("is at an end of the axis `lambda`: 0.025 in the range 0.025 to 250"), "{err}");
    assert!(!err.contains("has no effect"), "{err}");
    let notes = bench.run(&[]).last["notes"].clone();
    assert!(notes.to_string().contains("is at an end of the axis `lambda`"), "{notes}");
}

#[test]
fn user_an_incomplete_publish_does_not_block_a_run() {
    let text = format!("{}\n[publish]\ntitle = \"t\"\n", spec(&[]));
    let (bench, _, err) = ran(&text);
    assert!(err.contains("`[publish]` is incomplete") && err.contains("`publish` needs `licence`"), "{err}");
    for args in [vec!["check", "spec.toml"], vec!["publish", "spec.toml", "scores", "--to", "set"]] {
        let output = bench.magline(&args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(stderr(&output).contains("`publish` needs `licence`"), "{}", stderr(&output));
    }
    assert!(!bench.path("set").exists());
}

#[test]
fn user_pooled_scores_are_a_table_like_the_others() {
    let facts = "\n[publish]\ntitle = \"t\"\ndescription = \"d\"\nlicence = \"CC0-1.0\"\ndate = \"2026-02-28\"\n\
                 contact = \"a@b.c\"\nversion = \"1.0.0\"\n[[publish.authors]]\nname = \"A\"\n";
    let (bench, ..) = ran(&(spec(&[]) + facts));
    let lineage = stdout(&bench.magline(&["lineage", "small.scores_pooled", "--store", "store"]));
    assert!(lineage.starts_with("scores_pooled  ") && lineage.contains("value <- scores.metric"), "{lineage}");
    let listed = stdout(&bench.magline(&["ls", "--store", "store"]));
    assert!(listed.contains("scores_pooled"), "{listed}");
    let verified = bench.magline(&["verify", "--store", "store"]);
    assert!(verified.status.success(), "{}", stderr(&verified));
    let done = bench.magline(&["publish", "spec.toml", "scores_pooled", "scores", "--to", "set"]);
    assert!(done.status.success(), "{}", stderr(&done));
    assert_eq!(
        read(&bench.path("set/data/scores_pooled")).iter().map(RecordBatch::num_rows).sum::<usize>(),
        read(&bench.path("store/tables/small/scores_pooled")).iter().map(RecordBatch::num_rows).sum::<usize>()
    );
    assert!(bench.magline(&["verify", "set"]).status.success());
    // The table stays unchanged when a run skips its table of scores.
    let before = bench.tables("store");
    assert_eq!(bench.run(&["--until", "clean", "--set", "axes.lambda=[0.025, 0.25, 25.0]"]).code, 0);
    assert_eq!(bench.tables("store").keys().collect::<Vec<_>>(), before.keys().collect::<Vec<_>>());
    let removed = bench.magline(&["rm", "small.scores_pooled", "--store", "store"]);
    assert!(removed.status.success(), "{}", stderr(&removed));
    assert!(!bench.path("store/tables/small/scores_pooled").exists());
    assert!(bench.magline(&["gc", "--store", "store", "--yes"]).status.success());
    // The name `scores_pooled` is reserved.
    bench.spec(&SPEC.replace("name  = \"scores\"", "name  = \"scores_pooled\""));
    let taken = bench.magline(&["check", "spec.toml"]);
    assert!(
        stderr(&taken).contains("`scores_pooled` is the name of the table of scores pooled over lines"),
        "{}",
        stderr(&taken)
    );
}

/// Runs a spec over flights without `columns`; returns the bench, standard output and standard error.
fn without(columns: &[&str], text: &str) -> (Bench, String, String) {
    let bench = bench(text);
    let fewer = |batch: RecordBatch| {
        let schema = batch.schema();
        let kept = schema.fields().iter().enumerate().filter(|(_, f)| !columns.contains(&f.name().as_str()));
        batch.project(&kept.map(|(i, _)| i).collect::<Vec<_>>()).unwrap()
    };
    for flight in ["1", "2"] {
        let lines = [("01", 700), ("02", 500)]
            .map(|(line, rows)| fewer(line_of_flight(flight, &format!("{flight}.{line}"), rows)));
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    let output = bench.magline(&["run", "spec.toml"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (bench, stdout(&output), stderr(&output))
}

/// Metrics of a table with their values.
fn metrics(bench: &Bench, table: &str) -> BTreeMap<String, f64> {
    let scores = read(&bench.path("store/tables/small").join(table));
    texts(&scores, "metric").into_iter().zip(numbers(&scores, "value")).collect()
}

#[test]
fn user_a_run_without_truth_has_the_metrics_that_need_none() {
    let text = spec(&[("[0.025, 0.25, 25.0]", "[0.025]"), ("truth = \"mag_1_c\"", "")]);
    let (bench, out, err) = without(&["mag_1_c"], &text);
    let found = metrics(&bench, "scores_pooled");
    for name in ["std_uncompensated", "improvement_ratio", "improvement_ratio_band", "nis", "drms"] {
        assert!(found.get(name).is_some_and(|value| value.is_finite()), "{name}: {found:?}");
    }
    assert!(found.contains_key("figure_of_merit_crossings"), "{found:?}");
    assert!(!found.contains_key("std_error") && !found.contains_key("snr"), "{found:?}");
    assert!(out.contains("improvement_ratio"), "{out}");
    assert!(err.contains("`scores`: not scored without `truth`: `std_error`, "), "{err}");
    // The positions are unknown too.
    let (bench, _, err) = without(&["mag_1_c", "lat", "lon", "alt", "vn", "ve", "vd"], &text);
    let found = metrics(&bench, "scores_pooled");
    assert!(found["improvement_ratio"].is_finite() && found["nis"].is_finite(), "{found:?}");
    assert!(!found.contains_key("drms") && !found.contains_key("figure_of_merit_crossings"), "{found:?}");
    let positions = err.lines().find(|l| l.contains("not scored without true positions `lat` and `lon`: "));
    assert!(positions.is_some_and(|l| l.contains("`drms`") && l.contains("`figure_of_merit_crossings`")), "{err}");
    // With a truth there is no note.
    let (_, _, err) = ran(&spec(&[("[0.025, 0.25, 25.0]", "[0.025]")]));
    assert!(!err.contains("not scored without `truth`"), "{err}");
}

/// The two queries of the page on tables for the scores of `osborne`.
#[test]
fn user_the_queries_of_the_page_on_tables_read_the_pooled_table() {
    let page = "pipeline/docs/how-to/read-tables.md";
    let text = fs::read_to_string(crate::support::repository().join(page)).unwrap();
    let asked: Vec<&str> = text.lines().filter(|l| l.contains("store/tables/osborne/scores")).collect();
    assert_eq!(asked.len(), 2, "{asked:?}");
    assert!(asked.iter().all(|line| line.contains("osborne/scores_pooled/")), "{asked:?}");
    let served = fs::read_to_string(crate::support::repository().join("pipeline/SERVE.md")).unwrap();
    for text in [text, served] {
        assert!(!text.contains("avg(value)") && !text.contains("aggregate_function=\"mean\""));
    }
}

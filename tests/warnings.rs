//! Untrustworthy results are flagged: in the terminal, in the report, as JSON and as a table. Commands report their
//! progress.

use serde_json::Value;

use crate::support::{Bench, SPEC, numbers, read, repository, stderr, stdout, texts};

/// Spec of a filter with an assumed measurement noise of 0.001 nT and without offset removal.
fn diverging() -> String {
    SPEC.replace("offset_window_s = 1.0", "offset_window_s = 0.0\nmeasurement_sigma_nt = 0.001\nfogm_sigma_nt = 0.001")
        .replace("[\"mag_4_uc\", \"mag_5_uc\"]", "[\"mag_4_uc\"]")
        .replace("[\"flux_a\", \"flux_d\"]", "[\"flux_a\"]")
}

fn ran(spec: &str) -> (Bench, String, String) {
    let bench = Bench::new();
    bench.spec(spec);
    let output = bench.magline(&["run", "spec.toml"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (bench, stdout(&output), stderr(&output))
}

#[test]
fn user_a_diverged_filter_is_flagged_wherever_its_score_is_shown() {
    let (bench, out, err) = ran(&diverging());
    // On the terminal, every row is flagged, and no row is marked as the best.
    let rows: Vec<&str> = out.lines().skip_while(|l| !l.contains("nees")).skip(1).take(2).collect();
    assert!(rows.iter().all(|r| r.starts_with("! ") && r.ends_with("4/4")), "{out}");
    assert!(out.contains("! flagged: worse than the INS alone, NEES or NIS far from the expected value"), "{out}");
    assert!(!out.lines().any(|l| l.starts_with('*')), "{out}");
    assert!(err.contains("warning: scores: the filter is worse than the INS alone"), "{err}");
    assert!(err.contains("likely cause: ") && err.contains("the table `small.warnings` lists all"), "{err}");

    // The table.
    let table = read(&bench.path("store/tables/small/warnings"));
    let (kinds, values, limits) = (texts(&table, "kind"), numbers(&table, "value"), numbers(&table, "limit"));
    let scores = read(&bench.path("store/tables/small/scores"));
    let (metrics, figures) = (texts(&scores, "metric"), numbers(&scores, "value"));
    let of = |m: &str| (0..metrics.len()).filter(|i| metrics[*i] == m).map(|i| figures[i]).collect::<Vec<_>>();
    let (drms, ins) = (of("drms"), of("ins_drms"));
    let worse: Vec<f64> = drms.iter().zip(&ins).filter(|(d, i)| d > i).map(|(d, _)| *d).collect();
    assert!(!worse.is_empty(), "the filter was meant to diverge: {drms:?} against {ins:?}");
    let warned: Vec<f64> = (0..kinds.len()).filter(|i| kinds[*i] == "worse_than_ins").map(|i| values[i]).collect();
    assert_eq!(warned, worse);
    let high = of("nees").into_iter().filter(|v| *v > 20.0).count();
    assert_eq!(kinds.iter().filter(|k| *k == "nees_high").count(), high);
    assert!((0..kinds.len()).filter(|i| kinds[*i] == "nees_high").all(|i| limits[i] == 20.0));
    assert!(texts(&table, "cause").iter().any(|c| c.contains("measurement_sigma_nt")), "{:?}", texts(&table, "cause"));
    assert_eq!(texts(&table, "mag")[0], "mag_4_uc");

    // SQL.
    let sql = bench.magline(&["sql", "SELECT count(*) AS n FROM small.warnings", "--format", "csv"]);
    assert_eq!(stdout(&sql), format!("n\n{}\n", kinds.len()));

    // The report: a separate section, no green cell, no coloured tile.
    let report = bench.magline(&["report", "spec.toml", "-o", "report.html"]);
    assert!(report.status.success(), "{}", stderr(&report));
    let page = std::fs::read_to_string(bench.path("report.html")).unwrap();
    assert!(
        page.contains("<section class=\"trouble\" id=\"warnings\">") && page.contains("data-kind=\"worse_than_ins\"")
    );
    assert_eq!(page.matches("<tr class=\"bad\">").count(), 2);
    let body = &page[page.find("id=\"scores-scores\"").unwrap()..page.find("id=\"plan\"").unwrap()];
    assert!(!body.contains("n best") && !body.contains("The best point"), "a marked row is shown as good");
    assert!(body.contains("every point is flagged"));
}

#[test]
fn user_a_cautious_filter_gives_a_warning() {
    let spec = SPEC.replace("offset_window_s = 1.0", "offset_window_s = 1.0\nmeasurement_sigma_nt = 500.0");
    let (bench, out, _) = ran(&spec);
    let table = read(&bench.path("store/tables/small/warnings"));
    let (kinds, causes) = (texts(&table, "kind"), texts(&table, "cause"));
    let low = kinds.iter().position(|k| k == "nis_low").unwrap_or_else(|| panic!("{kinds:?}\n{out}"));
    assert!(causes[low].contains("`measurement_sigma_nt` is 500.0 nT"), "{causes:?}");
}

/// A simulated flight over the Osborne map: a calibration and 20 minutes of a survey.
const FLIGHT: &str = r#"
preset = "cessna"
seed   = 5

[map]
path  = "MAP"
alt_m = 500.0

[ins]
grade = "navigation"

[[flights]]
name = "f"

[[flights.lines]]
name  = "cal"
kind  = "box"
alt_m = 3000.0
start = [-21.99, 140.63]

[[flights.lines]]
name       = "L1"
alt_m      = 500.0
kind       = "survey"
duration_s = 1200.0
waypoints  = [[-22.10, 140.58], [-21.84, 140.58], [-21.84, 140.78], [-22.10, 140.78]]
"#;

/// Navigation on this flight with keys of the user.
const NAVIGATION: &str = r#"
name  = "hint"
store = "store"

[tables.flights]
path = "f.synth.toml"

[tables.anomaly]
path  = "MAP"
alt_m = 500.0

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "flights"
vector = "flux_a"

[[stages]]
name   = "coefficients"
stage  = "fit"
input  = "terms"
where  = "line = 'cal'"
model  = "tolles_lawson"
target = "mag_1_uc"

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
where = "line = 'L1'"
model = "coefficients"
mag   = "mag_1_uc"

[[stages]]
name  = "track"
stage = "navigate"
input = "clean"
map   = "anomaly"
KEYS

[[stages]]
name  = "scores"
stage = "score"
input = ["clean", "track"]
truth = "mag_1_c"
"#;

#[test]
fn user_a_reported_remedy_gives_the_reported_result() {
    let map = repository().join("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif").display().to_string();
    let bench = Bench::new();
    std::fs::write(bench.path("f.synth.toml"), FLIGHT.replace("MAP", &map)).unwrap();
    let run = |keys: &str| {
        bench.spec(&NAVIGATION.replace("MAP", &map).replace("KEYS", keys));
        let output = bench.magline(&["run", "spec.toml"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let causes = texts(&read(&bench.path("store/tables/hint/warnings")), "cause");
        let query = "SELECT value FROM hint.scores WHERE metric = 'drms'";
        let drms = stdout(&bench.magline(&["sql", query, "--format", "csv"]));
        (causes, drms.lines().nth(1).and_then(|value| value.parse::<f64>().ok()).unwrap())
    };
    for (keys, remedy) in [
        ("measurement_sigma_nt = 200.0\noffset_window_s = 1.0", "without `measurement_sigma_nt`, `offset_window_s`"),
        ("start = \"given\"", "without `start`"),
    ] {
        let (causes, before_m) = run(keys);
        let told = format!("{remedy}, this line has drms ");
        let told = causes.iter().find_map(|cause| cause.split(&told).nth(1)).unwrap_or_else(|| panic!("{causes:?}"));
        let told_m: f64 = told.split(' ').next().unwrap().parse().unwrap();
        // The user follows the hint. A second run has the same causes.
        assert_eq!(run(keys).0, causes);
        let (left, after_m) = run("");
        assert!((told_m / after_m - 1.0).abs() < 1e-3 && after_m < 0.8 * before_m, "{told_m} {after_m} {before_m}");
        assert!(left.is_empty(), "{left:?}");
    }
}

/// Spec of a filter whose assumed noise matches the small flights.
fn consistent() -> String {
    SPEC.replace("offset_window_s = 1.0", "offset_window_s = 1.0\nmeasurement_sigma_nt = 1.0\nfogm_sigma_nt = 1.0")
}

#[test]
fn user_json_holds_warnings_notes_scores_time_version_and_run() {
    let bench = Bench::new();
    bench.spec(&diverging());
    let output = bench.magline(&["run", "spec.toml", "--json"]);
    let events: Vec<Value> = stdout(&output).lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert!(events.iter().all(|e| e["event"].is_string()));
    let started = events.iter().find(|e| e["event"] == "started").unwrap();
    assert_eq!(started["version"], env!("CARGO_PKG_VERSION"));
    assert!(started["notes"].as_array().is_some_and(|n| !n.is_empty()), "{started}");
    let last = events.last().unwrap();
    assert_eq!(last["run"], started["run"]);
    assert_eq!(last["run"].as_str().unwrap().len(), 16);
    assert!(last["time"].as_str().unwrap().ends_with('Z') && last["seconds"].as_f64().unwrap() > 0.0);
    assert!(last["tables"]["track"]["seconds"].as_f64().unwrap() > 0.0);
    assert_eq!(last["notes"], started["notes"]);
    let warning = &last["warnings"].as_array().unwrap()[0];
    assert_eq!((&warning["stage"], &warning["axes"]["mag"]), (&Value::from("scores"), &Value::from("mag_4_uc")));
    assert!(warning["value"].as_f64().unwrap() > warning["limit"].as_f64().unwrap());
    let scores = last["scores"].as_array().unwrap();
    assert_eq!(scores.len(), 2);
    assert_eq!((scores[0]["marked"].as_u64(), scores[0]["lines"].as_u64()), (Some(4), Some(4)));
    assert!(scores[0]["metrics"]["drms"].as_f64().unwrap() > scores[0]["metrics"]["ins_drms"].as_f64().unwrap());

    // Equal requests have the same identifier, for any state of the store and formatting of the spec.
    let run = |bench: &Bench| bench.run(&[]).last["run"].clone();
    assert_eq!(run(&bench), last["run"]);
    bench.spec(&format!("# a comment\n{}", diverging()));
    assert_eq!(run(&bench), last["run"]);
    bench.spec(&diverging().replace("0.001", "0.002"));
    assert_ne!(run(&bench), last["run"]);
}

#[test]
fn user_the_event_finished_begins_with_fixed_text() {
    let bench = Bench::new();
    bench.run(&[]);
    let output = bench.magline(&["run", "spec.toml", "--json"]);
    let last = stdout(&output).lines().last().unwrap().to_owned();
    assert!(last.starts_with("{\"event\":\"finished\",\"computed\":0,"), "{last}");
}

#[test]
fn user_a_fit_gives_warnings_even_if_its_table_is_not_published() {
    // A line of 50 s with one slow turn and without manoeuvres hardly constrains eighteen terms.
    let weak = SPEC.replace("model  = \"tolles_lawson\"", "model  = \"tolles_lawson\"\npublish = false");
    let (bench, ..) = ran(&weak);
    let published = ran(SPEC).0;
    let fits = |b: &Bench| {
        let table = read(&b.path("store/tables/small/warnings"));
        texts(&table, "kind").iter().filter(|k| *k == "fit").count()
    };
    assert!(!bench.path("store/tables/small/coefficients").exists());
    assert!(fits(&bench) > 0);
    assert_eq!(fits(&bench), fits(&published));
}

#[test]
fn user_a_report_counts_points_and_shows_summary_and_map() {
    let more = r#"
[[stages]]
name    = "coarse"
stage   = "resample"
input   = "flights"
rate_hz = "$rate"

[[stages]]
name  = "along"
stage = "map_value"
input = "clean"
map   = "anomaly"

[[stages]]
name  = "pooled"
stage = "summary"
input = "scores"
"#;
    let spec = consistent().replace("lambda = [0.0, 0.025]", "lambda = [0.0, 0.025]\nrate   = [2.0, 5.0, 10.0]");
    let (bench, ..) = ran(&format!("{spec}{more}"));
    let report = bench.magline(&["report", "spec.toml", "-o", "report.html"]);
    assert!(report.status.success(), "{}", stderr(&report));
    let page = std::fs::read_to_string(bench.path("report.html")).unwrap();
    // The three axes have eight points, and no table has an additional column for a fourth axis.
    assert!(page.contains("<strong>8</strong>sweep points"), "{}", &page[page.find("<header>").unwrap()..][..600]);
    assert!(page.contains("id=\"summary-pooled\"") && page.contains("class=\"intervals\""));
    let drms = page.split("drms: pooled values with their intervals").nth(1).unwrap();
    assert_eq!(drms[..drms.find("</svg>").unwrap()].matches("class=\"arm\"").count(), 8);
    assert!(
        page.contains("<h4>The map along the line</h4>")
            && page.contains("The standard deviation of mag_c minus the map is")
    );
}

#[test]
fn user_warnings_is_a_reserved_table_name() {
    let bench = Bench::new();
    bench.spec(&SPEC.replace("name  = \"scores\"", "name  = \"warnings\""));
    let output = bench.magline(&["check", "spec.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("`warnings` is the name of the table of"), "{}", stderr(&output));
}

#[test]
fn user_the_score_table_is_at_most_120_wide_without_a_terminal() {
    let (_, out, _) = ran(&consistent());
    let table: Vec<&str> = out.lines().skip_while(|l| !l.contains("drms [m]")).collect();
    assert!(table.len() > 8 && table.iter().take(9).all(|l| l.chars().count() <= 120), "{out}");
    assert!(out.contains("omitted to fit the width: "), "{out}");
}

#[test]
fn user_quiet_prints_only_warnings_and_errors() {
    let bench = Bench::new();
    bench.spec(&consistent());
    let output = bench.magline(&["run", "spec.toml", "--quiet"]);
    assert_eq!((output.status.code(), stdout(&output)), (Some(0), String::new()));
    assert!(stderr(&output).lines().all(|l| l.starts_with("warning: ") && l.contains("small.warnings")));
    // Untrustworthy results are reported in one line.
    bench.spec(&diverging());
    let err = stderr(&bench.magline(&["run", "spec.toml", "--quiet"]));
    assert_eq!(err.lines().count(), 1, "{err}");
    assert!(err.contains("warnings; the table `small.warnings` lists all"), "{err}");
    bench.spec(&SPEC.replace("rate_hz", "rate_h"));
    let output = bench.magline(&["run", "spec.toml", "--quiet"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("rate_h"));
    let info = bench.magline(&["map", "info", "map.parquet", "--quiet"]);
    assert!(info.status.success() && stdout(&info).contains("map.parquet"), "{}", stderr(&info));
}

#[test]
fn user_standard_error_is_plain_without_a_terminal() {
    let bench = Bench::new();
    for args in [&["run", "spec.toml"][..], &["explain", "spec.toml"], &["map", "info", "map.parquet"]] {
        let output = bench.magline(args);
        let err = stderr(&output);
        assert!(!err.contains(['\u{1b}', '\r']), "{args:?}: {err:?}");
        assert!(!err.contains("0/0") && !err.contains("left)"), "{args:?}: {err}");
    }
}

#[test]
fn user_help_describes_magline_and_the_json_events() {
    let bench = Bench::new();
    let help = stdout(&bench.magline(&["--help"]));
    let first = help.lines().next().unwrap();
    assert!(first.contains("aeromagnetic") && first.contains("navigat"), "{first}");
    let run = stdout(&bench.magline(&["run", "--help"]));
    for word in ["worse_than_ins", "warnings (stage, axes", "scores (stage", "version, run, time", "--quiet"] {
        assert!(run.contains(word), "{word}\n{run}");
    }
}

//! Estimates of `explain --cost` before a run, compared with the run.

use std::{fs, path::Path};

use serde_json::Value;

use crate::support::{Bench, SPEC, line_of, stderr, stdout, write};

fn cost(bench: &Bench, more: &[&str]) -> Value {
    let args: Vec<&str> = ["explain", "spec.toml", "--cost", "--format", "json"].iter().chain(more).copied().collect();
    let output = bench.magline(&args);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    serde_json::from_str(&stdout(&output)).unwrap()
}

fn of<'a>(cost: &'a Value, table: &str) -> &'a Value {
    cost["tables"].as_array().unwrap().iter().find(|t| t["table"] == table).unwrap()
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("no {key} in {value}"))
}

/// The bytes of all packs of the store.
fn packs(folder: &Path) -> u64 {
    let inside = |e: fs::DirEntry| if e.path().is_dir() { packs(&e.path()) } else { e.metadata().unwrap().len() };
    fs::read_dir(folder).unwrap().flatten().map(inside).sum()
}

fn within_two(predicted: f64, real: f64, what: &str) {
    assert!(predicted < 2.0 * real && real < 2.0 * predicted, "{what}: {predicted} predicted, {real} real");
}

fn rows(bench: &Bench, table: &str) -> f64 {
    let query = format!("SELECT count(*) AS n FROM small.{table}");
    let output = bench.magline(&["sql", &query, "--format", "json"]);
    let row: Value = serde_json::from_str(stdout(&output).trim()).unwrap();
    number(&row, "n")
}

#[test]
fn user_rows_and_bytes_are_told_before_a_run_and_nothing_is_left_after_it() {
    let bench = Bench::new();
    let before = cost(&bench, &[]);
    let read = packs(&bench.path("store/objects"));
    assert_eq!(bench.run(&[]).code, 0);
    // Lines that a stage only appends columns to have the rows of their inputs; 4 lines of 2,400 rows in all, 8 points.
    for (table, real) in [("even", 2400.0), ("terms", 4800.0), ("clean", 19_200.0), ("track", 19_200.0)] {
        assert_eq!(rows(&bench, table), real);
        let told = number(of(&before, table), "rows");
        assert!((told / real - 1.0).abs() < 0.01, "{table}: {told} rows, {real} real");
    }
    // Rows of scores follow from the metrics that a line has, which no plan tells.
    within_two(number(of(&before, "coefficients"), "rows"), rows(&bench, "coefficients"), "coefficients");
    within_two(number(&before, "bytes"), (packs(&bench.path("store/objects")) - read) as f64, "bytes");
    for t in before["tables"].as_array().unwrap() {
        assert!(number(t, "processor_s") > 0.0 && number(t, "clock_s") > 0.0 && number(t, "memory_bytes") > 0.0, "{t}");
        assert!(number(t, "compute") > 0.0 && number(t, "there") == 0.0, "{t}");
    }
    // All of it is there, and costs nothing.
    let after = cost(&bench, &[]);
    for key in ["rows", "bytes", "processor_s", "clock_s", "memory_bytes"] {
        assert_eq!(number(&after, key), 0.0, "{key}: {after}");
    }
    assert_eq!(number(of(&after, "clean"), "there"), 32.0);
    assert_eq!(number(of(&after, "clean"), "rows_there"), 19_200.0);
    let text = stdout(&bench.magline(&["explain", "spec.toml", "--cost"]));
    assert!(text.contains("all results are in the store"), "{text}");
}

#[test]
fn user_the_cost_of_a_sweep_that_grows_is_that_of_its_new_points() {
    let bench = Bench::new();
    let whole = cost(&bench, &[]);
    assert_eq!(bench.run(&[]).code, 0);
    let more = cost(&bench, &["--set", "axes.lambda=[0.0, 0.025, 0.25]"]);
    for table in ["even", "terms"] {
        assert_eq!(number(of(&more, table), "compute"), 0.0, "{table}");
    }
    // A third value in addition to two: half of the total for these.
    assert_eq!(number(of(&more, "clean"), "compute"), 16.0);
    assert_eq!(number(of(&more, "clean"), "rows"), number(of(&whole, "clean"), "rows") / 2.0);
    assert!(number(&more, "bytes") < number(&whole, "bytes"));
    // Measurements in the store do not change a byte of the published tables.
    let (again, tables) = (Bench::new(), bench.tables("store"));
    assert_eq!(again.run(&[]).code, 0);
    fs::remove_dir_all(again.path("store/costs")).unwrap();
    assert_eq!(again.run(&[]).code, 0);
    assert_eq!(again.tables("store"), tables);
}

#[test]
fn user_seconds_and_bytes_follow_the_rows() {
    let bench = Bench::new();
    let small = cost(&bench, &[]);
    for flight in ["1", "2"] {
        let lines: Vec<_> =
            [("01", 7000), ("02", 5000)].map(|(l, n)| line_of(flight, &format!("{flight}.{l}"), n)).into();
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    // The INS of these long lines drifts; the cost does not depend on that.
    let large = cost(&bench, &[]);
    for table in ["even", "terms", "clean", "track"] {
        let ratio = |key: &str| number(of(&large, table), key) / number(of(&small, table), key);
        // Each estimate measures how fast the machine is at that moment, which other work on it changes.
        let speeds = number(&large, "speed") / number(&small, "speed");
        assert!((ratio("rows") - 10.0).abs() < 0.1, "{table}: {}", ratio("rows"));
        assert!(ratio("bytes") > 3.0 && ratio("bytes") < 11.0, "{table}: {}", ratio("bytes"));
        let seconds = ratio("processor_s") * speeds;
        assert!(seconds > 1.5 && seconds < 11.0, "{table}: {seconds}");
    }
}

#[test]
fn user_a_damaged_record_of_costs_is_passed_over() {
    let bench = Bench::new();
    assert_eq!(bench.run(&[]).code, 0);
    let file = bench.path("store/costs/small.json");
    let mut bytes = fs::read(&file).unwrap();
    assert!(number(&cost(&bench, &[]), "measured") >= 6.0);
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&file, &bytes).unwrap();
    assert_eq!(number(&cost(&bench, &[]), "measured"), 0.0);
    fs::write(&file, &bytes[..middle]).unwrap();
    assert_eq!(number(&cost(&bench, &[]), "measured"), 0.0);
    // The next run that computes something begins anew.
    assert_eq!(bench.run(&["--set", "axes.lambda=[0.5]"]).code, 0);
    assert!(number(&cost(&bench, &[]), "measured") >= 3.0);
}

#[test]
fn user_a_table_that_is_not_kept_costs_where_it_is_needed() {
    let bench = Bench::new();
    let kept = cost(&bench, &[]);
    bench.spec(&SPEC.replace("vector = \"$vector\"\n", "vector = \"$vector\"\nkeep = false\npublish = false\n"));
    let not = cost(&bench, &[]);
    assert_eq!(of(&not, "terms")["kept"], false);
    assert_eq!((number(of(&not, "terms"), "compute"), number(of(&not, "terms"), "bytes")), (0.0, 0.0));
    // In seconds of one machine: each estimate measures its speed at that moment.
    let clean_s = |cost: &Value| number(of(cost, "clean"), "processor_s") * number(cost, "speed");
    assert!(clean_s(&not) > clean_s(&kept));
    assert!(stdout(&bench.magline(&["explain", "spec.toml", "--cost"])).contains("not kept"));
}

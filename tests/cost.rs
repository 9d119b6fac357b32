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

/// Total size of the packs below a folder, in bytes.
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
fn user_rows_and_bytes_are_estimated_before_a_run_and_are_zero_after_it() {
    let bench = Bench::new();
    let before = cost(&bench, &[]);
    let read = packs(&bench.path("store/objects"));
    assert_eq!(bench.run(&[]).code, 0);
    // A stage that only appends columns keeps the rows of its inputs: 4 lines with 2,400 rows in total, 8 points.
    for (table, real) in [("even", 2400.0), ("terms", 4800.0), ("clean", 19_200.0), ("track", 19_200.0)] {
        assert_eq!(rows(&bench, table), real);
        let estimated = number(of(&before, table), "rows");
        assert!((estimated / real - 1.0).abs() < 0.01, "{table}: {estimated} rows, {real} real");
    }
    // The rows of scores depend on the metrics of each line, which the plan does not contain.
    within_two(number(of(&before, "coefficients"), "rows"), rows(&bench, "coefficients"), "coefficients");
    within_two(number(&before, "bytes"), (packs(&bench.path("store/objects")) - read) as f64, "bytes");
    for t in before["tables"].as_array().unwrap() {
        assert!(number(t, "processor_s") > 0.0 && number(t, "clock_s") > 0.0 && number(t, "memory_bytes") > 0.0, "{t}");
        assert!(number(t, "compute") > 0.0 && number(t, "there") == 0.0, "{t}");
    }
    // All results are stored, so the cost is zero.
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
fn user_a_grown_sweep_costs_only_its_new_points() {
    let bench = Bench::new();
    let whole = cost(&bench, &[]);
    assert_eq!(bench.run(&[]).code, 0);
    let more = cost(&bench, &["--set", "axes.lambda=[0.0, 0.025, 0.25]"]);
    for table in ["even", "terms"] {
        assert_eq!(number(of(&more, table), "compute"), 0.0, "{table}");
    }
    // A third value costs half as much as the first two values together.
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
fn user_seconds_and_bytes_scale_with_the_rows() {
    let bench = Bench::new();
    let small = cost(&bench, &[]);
    for flight in ["1", "2"] {
        let lines: Vec<_> =
            [("01", 7000), ("02", 5000)].map(|(l, n)| line_of(flight, &format!("{flight}.{l}"), n)).into();
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    // The INS drifts on these long lines; the cost does not depend on the drift.
    let large = cost(&bench, &[]);
    for table in ["even", "terms", "clean", "track"] {
        let ratio = |key: &str| number(of(&large, table), key) / number(of(&small, table), key);
        // Each estimate measures the current speed of the machine, which depends on its load.
        let speeds = number(&large, "speed") / number(&small, "speed");
        assert!((ratio("rows") - 10.0).abs() < 0.1, "{table}: {}", ratio("rows"));
        assert!(ratio("bytes") > 3.0 && ratio("bytes") < 11.0, "{table}: {}", ratio("bytes"));
        let seconds = ratio("processor_s") * speeds;
        assert!(seconds > 1.5 && seconds < 11.0, "{table}: {seconds}");
    }
}

#[test]
fn user_a_damaged_cost_record_is_ignored() {
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
    // The next run with computed units starts a new record.
    assert_eq!(bench.run(&["--set", "axes.lambda=[0.5]"]).code, 0);
    assert!(number(&cost(&bench, &[]), "measured") >= 3.0);
}

#[test]
fn user_the_cost_of_an_unkept_table_is_charged_to_its_reader() {
    let bench = Bench::new();
    let kept = cost(&bench, &[]);
    bench.spec(&SPEC.replace("vector = \"$vector\"\n", "vector = \"$vector\"\nkeep = false\npublish = false\n"));
    let not = cost(&bench, &[]);
    assert_eq!(of(&not, "terms")["kept"], false);
    assert_eq!((number(of(&not, "terms"), "compute"), number(of(&not, "terms"), "bytes")), (0.0, 0.0));
    // Scaled to equal speed, because each estimate measures the current speed of the machine.
    let clean_s = |cost: &Value| number(of(cost, "clean"), "processor_s") * number(cost, "speed");
    assert!(clean_s(&not) > clean_s(&kept));
    assert!(stdout(&bench.magline(&["explain", "spec.toml", "--cost"])).contains("not kept"));
}

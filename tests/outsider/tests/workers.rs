//! A unit that fails, panics, kills its worker or hangs affects no other unit: with tasks, processes and a cluster.
#![allow(clippy::unwrap_used)]

use std::{
    fs,
    io::Write,
    os::unix::process::ExitStatusExt,
    path::Path,
    process::{Command, Output, Stdio},
    sync::Arc,
};

use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;

#[cfg(feature = "cluster")]
#[allow(dead_code)]
#[path = "../../cluster_support.rs"]
mod cluster_support;

/// Three lines at two points: one of the six units fails.
const SPEC: &str = r#"
name  = "troubled"
store = "store"

[tables.flights]
path = "flight.parquet"

[axes]
does = ["none", "TROUBLE"]

[[stages]]
name    = "resample"
stage   = "resample"
input   = "flights"
rate_hz = 10.0

[[stages]]
name  = "trouble"
stage = "trouble"
input = "resample"
does  = "$does"
on    = "1.02"
"#;

fn scene(failure: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let file = fs::File::create(folder.path().join("flight.parquet")).unwrap();
    let lines = ["1.01", "1.02", "1.03"].map(|line| {
        let text = |word: &str| Arc::new(StringArray::from(vec![word; 100])) as ArrayRef;
        let numbers = |scale: f64| {
            let values = (0..100).map(|i| 40_000.0 + scale * f64::from(i)).collect::<Vec<f64>>();
            Arc::new(Float64Array::from(values)) as ArrayRef
        };
        let columns = [("flight", text("1")), ("line", text(line)), ("tt", numbers(0.1)), ("mag_1_c", numbers(0.3))];
        RecordBatch::try_from_iter(columns).unwrap()
    });
    let mut writer = ArrowWriter::try_new(file, lines[0].schema(), None).unwrap();
    lines.iter().for_each(|line| writer.write(line).unwrap());
    writer.close().unwrap();
    fs::write(folder.path().join("spec.toml"), SPEC.replace("TROUBLE", failure)).unwrap();
    folder
}

fn run_magline(folder: &Path, args: &[&str], input: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_troubled"))
        .args(args)
        .current_dir(folder)
        // Symbols of a large program take seconds to resolve.
        .env("RUST_BACKTRACE", "0")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A lost worker does not read its input.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    child.wait_with_output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.clone(), output.stderr.clone()].concat()).into_owned()
}

/// Computed, reused, failed and skipped units of a run.
fn counts(output: &Output) -> [u64; 4] {
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let last = text.lines().last().unwrap().to_owned();
    let of = |word: &str| {
        let (_, rest) = last.split_once(&format!("\"{word}\":")).unwrap();
        rest.split(|c: char| !c.is_ascii_digit()).next().unwrap().parse().unwrap()
    };
    ["computed", "reused", "failed", "skipped"].map(of)
}

/// Result of each fault where a worker is a process.
const FAILURES: [(&str, &str); 4] = [
    ("fault", "trouble was asked for"),
    ("panic", "the stage panicked (trouble was asked for)"),
    ("abort", "its worker was lost 3 times"),
    ("hang", "its worker was lost 3 times"),
];

#[cfg(feature = "cluster")]
#[test]
fn user_a_cluster_survives_any_failing_unit() {
    for (failure, expected) in FAILURES {
        let folder = scene(failure);
        let cluster = cluster_support::Cluster::new(env!("CARGO_BIN_EXE_troubled"), folder.path(), 2);
        let engine = cluster.engine();
        let mut args = vec!["run", "spec.toml", "--engine", &engine, "--key-file", cluster_support::KEY_FILE, "--json"];
        if failure == "hang" {
            args.extend(["--unit-timeout", "3s"]);
        }
        let run = run_magline(folder.path(), &args, "");
        assert_eq!(run.status.code(), Some(1), "{failure}: {}", text(&run));
        assert!(text(&run).contains(expected), "{failure}: {} {}", text(&run), cluster.worker_stderr());
        assert_eq!(counts(&run), [8, 0, 1, 0], "{failure}: {}", text(&run));
        // The workers survive and compute the next run, which limits the number of attempts.
        let again = run_magline(folder.path(), &args, "");
        assert_eq!((again.status.code(), counts(&again)), (Some(1), [0, 8, 1, 0]), "{failure}: {}", text(&again));
    }
}

#[test]
fn user_the_engine_of_processes_survives_any_failing_unit() {
    for (failure, expected) in FAILURES {
        let folder = scene(failure);
        let mut args = vec!["run", "spec.toml", "--engine", "processes", "--threads", "2", "--json"];
        if failure == "hang" {
            args.extend(["--unit-timeout", "3s"]);
        }
        let run = run_magline(folder.path(), &args, "");
        assert_eq!(run.status.code(), Some(1), "{failure}: {}", text(&run));
        assert!(text(&run).contains(expected), "{failure}: {}", text(&run));
        // Three lines at two points of the first table, and all units of the second table except one.
        assert_eq!(counts(&run), [8, 0, 1, 0], "{failure}: {}", text(&run));
        // All other units are published and reused.
        let again = run_magline(folder.path(), &args, "");
        assert_eq!((again.status.code(), counts(&again)), (Some(1), [0, 8, 1, 0]), "{failure}: {}", text(&again));
    }
}

#[test]
fn user_a_unit_that_kills_its_workers_fails_and_the_others_are_computed() {
    for failure in ["panic", "abort", "hang"] {
        let folder = scene(failure);
        let (mut waves, mut deaths, mut computed) = (0, 0, 0);
        loop {
            let listed = run_magline(folder.path(), &["tasks", "spec.toml", "--quiet"], "");
            assert!(listed.status.success(), "{}", text(&listed));
            let tasks = String::from_utf8(listed.stdout).unwrap();
            if tasks.is_empty() {
                break;
            }
            waves += 1;
            assert!(waves < 12, "{failure}: it never ends");
            let limit: &[&str] = if failure == "hang" { &["--unit-timeout", "4s"] } else { &[] };
            let work = run_magline(folder.path(), &[&["task"][..], limit].concat(), &tasks);
            deaths += usize::from(work.status.signal().is_some());
            let status = work.status.code().unwrap_or(1);
            assert!(status == 0 || status == 1, "{failure}: {}", text(&work));
            let receipts = String::from_utf8_lossy(&work.stdout).into_owned();
            computed += receipts.matches("\"outcome\":\"computed\"").count();
            assert_eq!(receipts.contains("\"ended\":true"), failure == "hang" && status == 1, "{receipts}");
        }
        // One wave for the first table and three attempts of the unit. On a busy machine other units may also exceed
        // the limit.
        assert!(waves == 4 || failure == "hang" && waves > 4, "{failure}: {waves} waves");
        assert_eq!(deaths, if failure == "abort" { 3 } else { 0 }, "{failure}");
        let run = run_magline(folder.path(), &["run", "spec.toml", "--json"], "");
        let expected = if failure == "panic" { "the stage panicked (trouble" } else { "its worker was lost 3 times" };
        assert!(run.status.code() == Some(1) && text(&run).contains(expected), "{failure}: {}", text(&run));
        assert_eq!(counts(&run), [0, 8, 1, 0], "{failure}: {}", text(&run));
        assert!(failure == "abort" || computed <= 8, "{computed}");
        // A larger `--retries` permits further attempts.
        let tasks = run_magline(folder.path(), &["tasks", "spec.toml", "--quiet", "--retries", "3"], "");
        assert_eq!(String::from_utf8(tasks.stdout).unwrap().lines().count(), 1);
    }
}

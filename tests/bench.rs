//! `magline bench`: tasks, supplied data and rejected predictions.

use std::{fs, path::Path, process::Output, sync::OnceLock};

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{changed, magline, numbers, read, repository, stderr, stdout, texts, without};

/// The data of the benchmark, made once.
fn data() -> &'static TempDir {
    static DATA: OnceLock<TempDir> = OnceLock::new();
    DATA.get_or_init(|| {
        let folder = TempDir::new().unwrap();
        let to = folder.path().join("bench");
        let output = magline(&repository(), &["bench", "data", "--to", to.to_str().unwrap()]);
        assert!(output.status.success(), "{}", stderr(&output));
        folder
    })
}

/// The two lines of the test flight, as one batch.
fn test_flight() -> RecordBatch {
    let batches = read(&data().path().join("bench/test"));
    let schema = batches[0].schema();
    let whole = arrow_select::concat::concat_batches(&schema, &batches).unwrap();
    let lines = texts(&batches, "line");
    let first = lines.iter().position(|l| l == "3.02").unwrap();
    assert!(lines[first..].iter().all(|l| l == "3.02" || l == "3.03"));
    whole.slice(first, whole.num_rows() - first)
}

/// Predictions: columns of the test flight under other names.
fn predicted(columns: &[(&str, &str)]) -> RecordBatch {
    let flight = test_flight();
    let keys = ["flight", "line", "tt"].map(|k| (k, k));
    let named = keys.iter().chain(columns).map(|(from, to)| {
        let array = flight.column_by_name(from).unwrap().clone();
        (*to, array)
    });
    RecordBatch::try_from_iter(named).unwrap()
}

/// Predictions of the baseline.
fn naive() -> RecordBatch {
    predicted(&[("mag_4_uc", "mag_4_comp"), ("ins_lat", "lat"), ("ins_lon", "lon")])
}

fn score(batch: &RecordBatch, more: &[&str]) -> Output {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("predictions.parquet");
    crate::support::write(&path, std::slice::from_ref(batch));
    score_file(&path, more)
}

fn score_file(path: &Path, more: &[&str]) -> Output {
    let args: Vec<&str> = ["bench", "score", path.to_str().unwrap()].iter().chain(more).copied().collect();
    magline(&repository(), &args)
}

fn rows(output: &Output) -> Vec<Value> {
    stdout(output).lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

fn refused(batch: &RecordBatch) -> String {
    let output = score(batch, &[]);
    assert_eq!(output.status.code(), Some(2), "{}{}", stdout(&output), stderr(&output));
    stderr(&output)
}

/// The truth of a line, from the simulation itself.
fn truth() -> &'static Vec<RecordBatch> {
    static TRUTH: OnceLock<Vec<RecordBatch>> = OnceLock::new();
    TRUTH.get_or_init(|| {
        let folder = data().path().join("truth");
        let spec = "datasets/examples/magline-bench.synth.toml";
        let output = magline(&repository(), &["synth", spec, "--to", folder.to_str().unwrap()]);
        assert!(output.status.success(), "{}", stderr(&output));
        let only = folder.join("only");
        fs::create_dir(&only).unwrap();
        fs::rename(folder.join("3.parquet"), only.join("3.parquet")).unwrap();
        read(&only)
    })
}

fn of_line(batches: &[RecordBatch], line: &str, column: &str) -> Vec<f64> {
    let (lines, values) = (texts(batches, "line"), numbers(batches, column));
    lines.iter().zip(values).filter(|(l, _)| *l == line).map(|(_, v)| v).collect()
}

#[test]
fn user_only_the_test_flight_lacks_its_truth() {
    let flight = test_flight();
    for hidden in ["lat", "lon", "alt", "vn", "roll", "yaw_rate", "mag_1_c", "anomaly_truth", "igrf"] {
        assert!(flight.column_by_name(hidden).is_none(), "{hidden}");
    }
    for given in ["tt", "ins_lat", "mag_5_uc", "flux_d_x", "cur_strb", "diurnal"] {
        assert!(flight.column_by_name(given).is_some(), "{given}");
    }
    let train = read(&data().path().join("bench/train"));
    assert!(train[0].column_by_name("mag_1_c").is_some() && train[0].column_by_name("lat").is_some());
    assert!(!texts(&train, "flight").contains(&"3".to_owned()));
    let again = magline(&repository(), &["bench", "data", "--to", data().path().join("bench").to_str().unwrap()]);
    assert_eq!(again.status.code(), Some(2), "a folder with files is not written to");
}

#[test]
fn law_scores_are_standard_deviation_and_horizontal_error() {
    let output = score(&naive(), &["--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let rows = rows(&output);
    assert_eq!(rows.len(), 6);
    // The expected scores are computed here from the simulation.
    let mut squares = (0.0, 0.0);
    for line in ["3.02", "3.03"] {
        let of = |column: &str| of_line(truth(), line, column);
        let errors: Vec<f64> = of("mag_4_uc").iter().zip(of("mag_1_c")).map(|(a, b)| a - b).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let std = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (errors.len() - 1) as f64).sqrt();
        // The sphere is accurate to 0.5 %.
        let north =
            of("ins_lat").iter().zip(of("lat")).map(|(a, b)| (a - b).to_radians() * 6.371e6).collect::<Vec<_>>();
        let lon = of("ins_lon").into_iter().zip(of("lon")).zip(of("lat"));
        let east = lon.map(|((a, b), lat)| (a - b).to_radians() * 6.371e6 * lat.to_radians().cos()).collect::<Vec<_>>();
        let drms = (north.iter().zip(&east).map(|(n, e)| n * n + e * e).sum::<f64>() / north.len() as f64).sqrt();
        let got = |task: &str| {
            let row = rows.iter().find(|r| r["task"] == task && r["line"] == line).unwrap();
            assert_eq!(row["score"], row["naive"], "the naive answer is the baseline: {row}");
            row["score"].as_f64().unwrap()
        };
        assert!((got("compensate") - std).abs() < 1e-6 * std, "{line}: {} {std}", got("compensate"));
        assert!((got("navigate") - drms).abs() < 0.006 * drms, "{line}: {} {drms}", got("navigate"));
        squares = (squares.0 + std * std * errors.len() as f64, squares.1 + errors.len() as f64);
    }
    let all = rows.iter().find(|r| r["task"] == "compensate" && r["line"].is_null()).unwrap();
    let pooled = (squares.0 / squares.1).sqrt();
    assert!((all["score"].as_f64().unwrap() - pooled).abs() < 1e-6 * pooled);
    // The truth has no error. A constant does not affect the compensation score.
    let true_rows = predicted(&[("mag_4_uc", "mag_4_comp")]);
    let true_field: Vec<f64> = ["3.02", "3.03"].iter().flat_map(|l| of_line(truth(), l, "mag_1_c")).collect();
    let perfect = changed(&true_rows, "mag_4_comp", |i, _| true_field[i] + 100.0);
    let output = score(&perfect, &["--json"]);
    let value = serde_json::from_str::<Value>(stdout(&output).lines().last().unwrap()).unwrap();
    assert!(value["score"].as_f64().unwrap() < 1e-9 && value["naive"].as_f64().unwrap() > 100.0, "{value}");
}

#[test]
fn user_missing_samples_fail_the_line_and_are_reported() {
    let whole = naive();
    let n = whole.num_rows();
    let less =
        arrow_select::concat::concat_batches(&whole.schema(), &[whole.slice(0, 7), whole.slice(8, n - 8)]).unwrap();
    let output = score(&less, &["--json"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("line 3.02: 1 sample of 9001 without a prediction"), "{}", stderr(&output));
    for row in rows(&output) {
        let failed = row["line"] == "3.02" || row["line"].is_null();
        assert_eq!(row["score"].is_null(), failed, "{row}");
        assert_eq!(row["missing"], u64::from(failed));
        assert!(row["naive"].is_f64());
    }
    // A line without any prediction also fails.
    let lines = texts(std::slice::from_ref(&whole), "line");
    let first = lines.iter().filter(|l| *l == "3.02").count();
    let output = score(&whole.slice(0, first), &["--json", "--tasks", "navigate"]);
    assert_eq!(output.status.code(), Some(1));
    let all = rows(&output).pop().unwrap();
    assert!(all["score"].is_null() && all["missing"] == (n - first) as u64, "{all}");
}

#[test]
fn user_invalid_predictions_are_rejected_with_their_position() {
    let whole = naive();
    let twice = arrow_select::concat::concat_batches(&whole.schema(), &[whole.clone(), whole.slice(3, 1)]).unwrap();
    let cases: Vec<(RecordBatch, &str)> = vec![
        (twice, "is a duplicate of row 3"),
        (
            changed(&whole, "mag_4_comp", |i, x| if i == 5 { f64::NAN } else { x }),
            "row 5: the prediction is not a finite number",
        ),
        (changed(&whole, "mag_4_comp", |_, x| x * 1000.0), "the value is probably in pT"),
        (changed(&whole, "mag_4_comp", |_, x| x * 1e-9), "the value is probably in T"),
        (changed(&changed(&whole, "lat", |_, x| x.to_radians()), "lon", |_, x| x.to_radians()), "in radians"),
        (changed(&whole, "lat", |i, x| if i == 2 { 95.0 } else { x }), "95 is not a latitude"),
        (changed(&whole, "tt", |_, x| x + 0.03), "has no sample at tt"),
        (changed(&whole, "mag_4_comp", |_, _| 51_000.0), "the prediction is 51000 in all"),
        (changed(&whole, "lon", |_, _| 140.7), "the prediction is 140.7 in all"),
        (without(&whole, "lon"), "requires the columns `lat` and `lon`"),
        (without(&whole, "line"), "there is no column `line`"),
        (predicted(&[("mag_4_uc", "mag_4_cmp")]), "did you mean `mag_4_comp`?"),
        (predicted(&[]), "no column of any task"),
    ];
    for (batch, wanted) in cases {
        let message = refused(&batch);
        assert!(message.contains(wanted), "{wanted}: {message}");
    }
    let train = read(&data().path().join("bench/train"));
    let other = RecordBatch::try_from_iter(
        [("flight", "flight"), ("line", "line"), ("tt", "tt"), ("mag_4_uc", "mag_4_comp")]
            .map(|(from, to)| (to, train[0].column_by_name(from).unwrap().clone())),
    );
    assert!(refused(&other.unwrap()).contains("is not scored"));
    let lines: Vec<f64> = texts(std::slice::from_ref(&whole), "line").iter().map(|l| l.parse().unwrap()).collect();
    let mut columns: Vec<(String, arrow_array::ArrayRef)> =
        whole.schema().fields().iter().map(|f| f.name().clone()).zip(whole.columns().iter().cloned()).collect();
    columns[1].1 = std::sync::Arc::new(arrow_array::Float64Array::from(lines));
    let message = refused(&RecordBatch::try_from_iter(columns).unwrap());
    assert!(message.contains("do not distinguish 3.1 from 3.10"), "{message}");
    let output = score(&whole, &["--tasks", "navigat"]);
    assert!(output.status.code() == Some(2) && stderr(&output).contains("did you mean `navigate`?"));
    let output = score(&whole, &["--tasks", "map_free"]);
    assert!(output.status.code() == Some(2) && stderr(&output).contains("free_lat"));
}

#[test]
fn user_csv_and_parquet_score_alike_and_results_are_written() {
    let whole = naive();
    let folder = TempDir::new().unwrap();
    let mut text = "flight,line,tt,mag_4_comp\n".to_owned();
    let column = |name: &str| whole.column_by_name(name).unwrap().clone();
    let (flight, line) = (column("flight"), column("line"));
    let (tt, mag) = (column("tt"), column("mag_4_comp"));
    for row in 0..whole.num_rows() {
        let word = |a: &arrow_array::ArrayRef| a.as_string::<i32>().value(row).to_owned();
        let number = |a: &arrow_array::ArrayRef| a.as_primitive::<Float64Type>().value(row);
        // Rounded to 0.001, as many programs write it.
        text += &format!("{},{},{:.3},{}\n", word(&flight), word(&line), number(&tt), number(&mag));
    }
    let csv = folder.path().join("p.csv");
    fs::write(&csv, text).unwrap();
    let results = folder.path().join("results.parquet");
    let one = score_file(&csv, &["--json", "-o", results.to_str().unwrap()]);
    assert_eq!(one.status.code(), Some(0), "{}", stderr(&one));
    let other = score(&without(&without(&whole, "lat"), "lon"), &["--json"]);
    assert_eq!(stdout(&one), stdout(&other));
    let written = read(folder.path());
    assert_eq!(texts(&written, "task"), ["compensate"; 3]);
    assert!(written[0].column_by_name("score").unwrap().null_count() == 0);
    let table = folder.path().join("results.md");
    let output = score_file(&csv, &["-o", table.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0));
    let text = fs::read_to_string(table).unwrap();
    assert!(text.starts_with("| task | prediction |") && text.lines().count() == 5, "{text}");
}

//! A stage that is not magline's own, as a user of its binary sees it.
#![allow(clippy::unwrap_used)]

use std::{
    fs,
    path::Path,
    process::{Command, Output},
    sync::Arc,
};

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, StringArray, cast::AsArray, types::Float64Type};
use parquet::arrow::{ArrowWriter, arrow_reader::ParquetRecordBatchReaderBuilder};

const SPEC: &str = r#"
name  = "theirs"
store = "store"

[tables.flights]
path = "flight.parquet"

[axes]
mag = ["mag_1_c", "mag_2_c"]

[[stages]]
name    = "resample"
stage   = "resample"
input   = "flights"
rate_hz = 10.0

[[stages]]
name   = "detrend"
stage  = "detrend"
input  = "resample"
column = "$mag"
"#;

/// A minute of a drift of 0.3 nT a second with a wave on it, in two magnetometers.
fn flight(path: &Path) {
    let time: Vec<f64> = (0..600).map(|i| 40_000.0 + 0.1 * f64::from(i)).collect();
    let field = |scale: f64| time.iter().map(|t| 120.0 + 0.3 * (t - 40_000.0) + scale * (0.7 * t).sin()).collect();
    let numbers = |values: Vec<f64>| Arc::new(Float64Array::from(values)) as ArrayRef;
    let text = |word: &str| Arc::new(StringArray::from(vec![word; time.len()])) as ArrayRef;
    let batch = RecordBatch::try_from_iter([
        ("flight", text("1")),
        ("line", text("1.01")),
        ("tt", numbers(time.clone())),
        ("mag_1_c", numbers(field(2.0))),
        ("mag_2_c", numbers(field(5.0))),
    ]);
    let batch = batch.unwrap();
    let mut writer = ArrowWriter::try_new(fs::File::create(path).unwrap(), batch.schema(), None).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
}

fn theirs(folder: &Path, args: &[&str]) -> (Output, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_outsider")).args(args).current_dir(folder).output().unwrap();
    let text = String::from_utf8_lossy(&[output.stdout.clone(), output.stderr.clone()].concat()).into_owned();
    (output, text)
}

fn detrended(folder: &Path, mag: &str) -> Vec<f64> {
    let mut found = vec![];
    for file in fs::read_dir(folder.join("store/tables/theirs/detrend")).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_none_or(|e| e != "parquet") {
            continue;
        }
        let file = fs::File::open(path).unwrap();
        for batch in ParquetRecordBatchReaderBuilder::try_new(file).unwrap().build().unwrap() {
            let batch = batch.unwrap();
            let values = batch.column_by_name(&format!("{mag}_detrended")).unwrap().as_primitive::<Float64Type>();
            found.extend((0..values.len()).filter(|i| values.is_valid(*i)).map(|i| values.value(i)));
        }
    }
    found
}

#[test]
fn a_stage_of_ones_own_is_run_explained_keyed_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    flight(&folder.join("flight.parquet"));
    fs::write(folder.join("spec.toml"), SPEC).unwrap();

    let (run, text) = theirs(folder, &["run", "spec.toml"]);
    assert!(run.status.success(), "{text}");
    for (mag, amplitude) in [("mag_1_c", 2.0), ("mag_2_c", 5.0)] {
        let values = detrended(folder, mag);
        assert_eq!(values.len(), 600);
        // The line that is fitted takes little of seven waves with it.
        let rms = (values.iter().map(|x| x * x).sum::<f64>() / 600.0).sqrt();
        assert!((rms / (amplitude / 2.0_f64.sqrt()) - 1.0).abs() < 0.03, "{rms}");
    }

    let (again, text) = theirs(folder, &["run", "spec.toml", "--json"]);
    assert!(again.status.success() && text.contains(r#""event":"finished","computed":0,"#), "{text}");
    let (_, text) = theirs(folder, &["explain", "spec.toml"]);
    assert!(text.contains("detrend"), "{text}");
    let (_, text) = theirs(folder, &["stages", "detrend"]);
    assert!(text.contains("## `detrend` (version 1)") && text.contains("straight line over time"), "{text}");
    let (_, text) = theirs(folder, &["lineage", "theirs.detrend"]);
    assert!(text.contains("flight.parquet"), "{text}");
    let (report, text) = theirs(folder, &["report", "spec.toml", "-o", "report.html"]);
    assert!(report.status.success(), "{text}");
    assert!(fs::read_to_string(folder.join("report.html")).unwrap().contains("detrend"));

    let (wrong, text) = theirs(folder, &["check", "spec.toml", "--set", "detrend.column=mag_9_c"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(text.contains("mag_9_c"), "{text}");
}

//! Custom stage, model, filter and metric in a binary.
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

/// One minute of a drift of 0.3 nT/s plus a wave, in two magnetometers.
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
    numbers(&folder.join("store/tables/theirs/detrend"), &format!("{mag}_detrended"))
}

/// A column of a published table.
fn numbers(folder: &Path, column: &str) -> Vec<f64> {
    let mut found = vec![];
    for file in fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_none_or(|e| e != "parquet") {
            continue;
        }
        let file = fs::File::open(path).unwrap();
        for batch in ParquetRecordBatchReaderBuilder::try_new(file).unwrap().build().unwrap() {
            let batch = batch.unwrap();
            let values = batch.column_by_name(column).unwrap().as_primitive::<Float64Type>();
            found.extend((0..values.len()).filter(|i| values.is_valid(*i)).map(|i| values.value(i)));
        }
    }
    found
}

#[test]
fn user_a_custom_stage_is_run_explained_keyed_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    flight(&folder.join("flight.parquet"));
    fs::write(folder.join("spec.toml"), SPEC).unwrap();

    let (run, text) = theirs(folder, &["run", "spec.toml"]);
    assert!(run.status.success(), "{text}");
    for (mag, amplitude) in [("mag_1_c", 2.0), ("mag_2_c", 5.0)] {
        let values = detrended(folder, mag);
        assert_eq!(values.len(), 600);
        // The fitted line removes little of the seven waves.
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

/// Real samples of the repository: a calibration and a flight over a map.
const CHOSEN: &str = r#"
name  = "chosen"
store = "store"

[tables.calibration]
path   = "SAMPLES/magnavjl_tl/magnavjl_tl.parquet"
flight = "sample"
line   = "1"

[tables.calibration.rename]
time_s      = "tt"
flux_a_x_nt = "flux_a_x"
flux_a_y_nt = "flux_a_y"
flux_a_z_nt = "flux_a_z"
mag_1_uc_nt = "mag_1_uc"

[tables.flights]
path = "SAMPLES/simple_magnav/xyz.h5"

[tables.anomaly]
path = "SAMPLES/simple_magnav/map.h5"

[axes]
shrinkage = [0.5, 1.0]
filter    = ["ekf", "dead_reckoning"]

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "calibration"
vector = "flux_a"

[[stages]]
name   = "squares"
stage  = "fit"
input  = "terms"
model  = "tolles_lawson"
target = "mag_1_uc"
lambda = 0.0

[[stages]]
name      = "shrunk"
stage     = "fit"
input     = "terms"
model     = "uniform_shrinkage"
target    = "mag_1_uc"
shrinkage = "$shrinkage"

[[stages]]
name       = "track"
stage      = "navigate"
tuning     = "magnav"
input      = "flights"
map        = "anomaly"
filter     = "$filter"
mag        = "mag_1_c"
core_field = false

[[stages]]
name    = "scores"
stage   = "score"
input   = ["flights", "track"]
metrics = ["drms", "ins_drms", "final_error"]
"#;

#[test]
fn user_a_custom_model_filter_and_metric_are_chosen_keyed_documented_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../datasets/samples");
    fs::write(folder.join("spec.toml"), CHOSEN.replace("SAMPLES", samples.to_str().unwrap())).unwrap();

    let (run, text) = theirs(folder, &["run", "spec.toml"]);
    assert!(run.status.success(), "{text}");
    assert!(text.contains("final_error"), "{text}");
    let of = |table: &str, column: &str| numbers(&folder.join("store/tables/chosen").join(table), column);
    let (squares, shrunk) = (of("squares", "value"), of("shrunk", "value"));
    let expected = squares.iter().map(|b| 0.5 * b).chain(squares.iter().copied());
    assert!(shrunk.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-12 * b.abs()), "{shrunk:?} {squares:?}");
    assert_eq!(shrunk.len(), 2 * squares.len());

    // Rows: `ekf`, then `dead_reckoning`, whose track is the INS.
    let scores = of("scores", "value");
    assert_eq!(scores.len(), 6);
    let [drms, ins_drms] = [scores[3], scores[4]];
    assert!((drms - ins_drms).abs() < 1e-6 * ins_drms, "{scores:?}");
    assert!(scores[2] > 0.0 && scores[5] > 0.0 && scores[2] != scores[5], "{scores:?}");
    let sigma = of("track", "sd_n");
    let last = sigma.len() - 1;
    assert!(sigma[last] > sigma[sigma.len() / 2], "the error grows with time");

    let (again, text) = theirs(folder, &["run", "spec.toml", "--json"]);
    assert!(again.status.success() && text.contains(r#""event":"finished","computed":0,"#), "{text}");
    let (_, text) = theirs(folder, &["stages", "navigate"]);
    assert!(text.contains("### The filter `dead_reckoning`") && text.contains("`drift_mps`"), "{text}");
    let (_, text) = theirs(folder, &["stages", "fit"]);
    assert!(text.contains("### The model `uniform_shrinkage`") && text.contains("van Houwelingen"), "{text}");
    let (_, text) = theirs(folder, &["stages", "score"]);
    assert!(text.contains("| `final_error` | m |"), "{text}");
    let (_, text) = theirs(folder, &["explain", "spec.toml"]);
    assert!(text.contains("shrinkage") && text.contains("dead_reckoning"), "{text}");
    let (report, text) = theirs(folder, &["report", "spec.toml", "-o", "report.html"]);
    assert!(report.status.success(), "{text}");
    assert!(fs::read_to_string(folder.join("report.html")).unwrap().contains("final_error"));

    // A key of another model or filter, or an unknown metric, is rejected before the run.
    for (set, message) in [
        ("shrunk.lambda=0.1", "`lambda` belongs to `tolles_lawson`"),
        ("squares.shrinkage=0.1", "`shrinkage` belongs to `boosted_trees` and `uniform_shrinkage`"),
        ("track.drift_mp=0.1", "did you mean `drift_mps`"),
        ("scores.metrics=final_eror", "did you mean `final_error`"),
    ] {
        let (wrong, text) = theirs(folder, &["check", "spec.toml", "--set", set]);
        assert!(wrong.status.code() == Some(2) && text.contains(message), "{set}: {text}");
    }
}

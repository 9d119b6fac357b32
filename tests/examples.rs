//! The example specs run, and their answers are those of others.

use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::support::{magline, numbers, read, repository, stderr, stdout, texts};

/// Runs an example into a store of its own; the folder and the last event.
fn run(example: &str) -> (TempDir, Value) {
    let folder = TempDir::new().unwrap();
    let spec = repository().join("datasets/examples").join(example);
    let store = format!("store={}", folder.path().join("store").display());
    let output = magline(folder.path(), &["run", &spec.display().to_string(), "--set", &store, "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let last = stdout(&output).lines().last().map(|l| serde_json::from_str(l).unwrap()).unwrap();
    (folder, last)
}

fn values(folder: &Path, pipeline: &str, metric: &str) -> Vec<f64> {
    let scores = read(&folder.join("store/tables").join(pipeline).join("scores"));
    let (metrics, values) = (texts(&scores, "metric"), numbers(&scores, "value"));
    (0..values.len()).filter(|i| metrics[*i] == metric).map(|i| values[i]).collect()
}

#[test]
fn val_tolles_lawson_on_real_samples_is_that_of_scikit_learn() {
    let (folder, _) = run("tolles_lawson.toml");
    let models = read(&folder.path().join("store/tables/tolles_lawson/coefficients"));
    let (lambdas, terms, ours) = (numbers(&models, "lambda"), texts(&models, "term"), numbers(&models, "value"));
    let reference = include_str!("reference/tolles_lawson.csv");
    let mut compared = 0;
    for row in reference.lines().skip(1) {
        let cells: Vec<&str> = row.split(',').collect();
        let (lambda, value): (f64, f64) = (cells[0].parse().unwrap(), cells[2].parse().unwrap());
        let at = (0..ours.len()).find(|i| lambdas[*i] == lambda && terms[*i] == cells[1]).unwrap();
        // The matrix has a condition number of some 1e3; both solve by SVD, so all but the last digits agree.
        assert!((ours[at] - value).abs() <= 1e-7 * value.abs().max(1.0), "{row}: {}", ours[at]);
        compared += 1;
    }
    assert_eq!(compared, 4 * 18);
    let ratios = values(folder.path(), "tolles_lawson", "improvement_ratio_band");
    let reference = include_str!("reference/tolles_lawson_ratio.csv").lines().skip(1);
    let expected: Vec<f64> = reference.map(|r| r.split(',').nth(1).unwrap().parse().unwrap()).collect();
    assert_eq!(ratios.len(), expected.len());
    for (ours, theirs) in ratios.iter().zip(&expected) {
        assert!((ours - theirs).abs() < 1e-7 * theirs, "{ours} {theirs}");
    }
}

#[test]
fn ref_simple_magnav_flight_navigates_as_printed() {
    let (folder, _) = run("navigation.toml");
    let scores = read(&folder.path().join("store/tables/navigation/scores"));
    let (axes, metrics, values) =
        (texts(&scores, "interpolation"), texts(&scores, "metric"), numbers(&scores, "value"));
    let of = |axis: &str, metric: &str| {
        let at = (0..values.len()).find(|i| axes[*i] == axis && metrics[*i] == metric).unwrap();
        values[at]
    };
    // MagNav.jl 1.3.3 with its defaults: 7.35 m cubic, 2.00 m bilinear, INS alone 1.98 m. It differs in one element
    // of F, in the discretisation of the noise, in the velocities (grid north for true north) and in the radii.
    assert!((of("cubic", "drms") - 7.35).abs() < 0.5, "{}", of("cubic", "drms"));
    assert!((of("linear", "drms") - 2.00).abs() < 0.3, "{}", of("linear", "drms"));
    assert!((of("linear", "ins_drms") - 1.98).abs() < 0.05, "{}", of("linear", "ins_drms"));
}

#[test]
fn law_the_main_job_compensates_and_navigates() {
    let (folder, last) = run("osborne.toml");
    assert_eq!(last["failed"], 0);
    let scores = read(&folder.path().join("store/tables/osborne/scores"));
    let (mags, lambdas) = (texts(&scores, "mag"), numbers(&scores, "lambda"));
    let (metrics, values) = (texts(&scores, "metric"), numbers(&scores, "value"));
    let of = |mag: &str, metric: &str| -> Vec<f64> {
        let wanted = |i: &usize| mags[*i] == mag && metrics[*i] == metric && lambdas[*i] == 0.025;
        (0..values.len()).filter(wanted).map(|i| values[i]).collect()
    };
    for mag in ["mag_1_uc", "mag_4_uc", "mag_5_uc"] {
        let (before, after) = (of(mag, "std_uncompensated"), of(mag, "std_error"));
        // Three vector magnetometers on four lines.
        assert_eq!(after.len(), 12);
        assert!(after.iter().zip(&before).all(|(a, b)| a < b), "{mag}");
    }
    // The stinger and the best of the cabin find their way; magnetometer 4 is left with 35 nT, which no filter that
    // expects 10 gets along with.
    for mag in ["mag_1_uc", "mag_5_uc"] {
        let (drms, ins) = (of(mag, "drms"), of(mag, "ins_drms"));
        assert!(drms.iter().zip(&ins).all(|(d, i)| d < i), "{mag}: {drms:?} {ins:?}");
        assert!(drms.iter().all(|d| *d < 120.0), "{mag}: {drms:?}");
    }
}

#[test]
fn law_geology_is_kept_by_a_calibration_far_above_it() {
    let (folder, last) = run("retention.toml");
    assert_eq!(last["failed"], 0);
    let summary = read(&folder.path().join("store/tables/retention/summary"));
    let (mags, boxes) = (texts(&summary, "mag"), texts(&summary, "calibration"));
    let (metrics, values) = (texts(&summary, "metric"), numbers(&summary, "value"));
    let (low, high, lines) =
        (numbers(&summary, "low"), numbers(&summary, "high"), summary.iter().map(|b| b.num_rows()).sum::<usize>());
    // Two calibrations of three magnetometers, five metrics each.
    assert_eq!(lines, 30);
    let of = |mag: &str, calibration: &str, metric: &str| {
        let at =
            (0..values.len()).find(|i| mags[*i] == mag && boxes[*i] == calibration && metrics[*i] == metric).unwrap();
        (values[at], low[at], high[at])
    };
    for mag in ["mag_1_uc", "mag_4_uc", "mag_5_uc"] {
        let (kept, low, high) = of(mag, "3.01", "anomaly_retention");
        assert!(low <= kept && kept <= high && (kept - 1.0).abs() < 0.05, "{mag}: {kept} in {low} to {high}");
        // A calibration low over the geology costs accuracy elsewhere.
        assert!(of(mag, "4.01", "std_error").0 > of(mag, "3.01", "std_error").0, "{mag}");
    }
}

#[test]
fn law_a_map_at_the_height_flown_follows_the_stinger() {
    let (folder, last) = run("map.toml");
    assert_eq!(last["failed"], 0);
    let std = |table: &str, interpolation: &str, high: bool| {
        let scores = read(&folder.path().join("store/tables/map").join(table));
        let (axes, lines) = (texts(&scores, "interpolation"), texts(&scores, "line"));
        let (metrics, values) = (texts(&scores, "metric"), numbers(&scores, "value"));
        let wanted = |i: &usize| {
            metrics[*i] == "map_std_error" && axes[*i] == interpolation && lines[*i].ends_with(".01") == high
        };
        (0..values.len()).filter(wanted).map(|i| values[i]).fold(0.0, f64::max)
    };
    // The stinger's noise is 0.02 nT; the simulated field is the map's cubic spline.
    assert!(std("scores_level", "cubic", false) < 0.03);
    assert!(std("scores_level", "linear", false) > 0.3);
    // The boxes are flown 2500 m above the map: there the level map is off by all of the short anomalies, the
    // continued one by what the levels 700 m apart leave and the edges do.
    assert!(std("scores_level", "cubic", true) > 10.0);
    assert!(std("scores_flown", "cubic", true) < 1.0);
}

//! Every input leads to a clear message, or to a result that lists the skipped parts.

use std::fs;

use arrow_array::RecordBatch;

use crate::support::{
    Bench, Done, SPEC, batch, changed, line_of, map, numbers, read, stderr, stdout, texts, without, write,
};

/// Message of `magline check` on an invalid spec, with exit status 2.
fn refused(spec: &str) -> String {
    let bench = Bench::new();
    bench.spec(spec);
    let run = bench.run(&[]);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(!bench.path("store/tables/small").exists(), "something was run");
    let check = bench.magline(&["check", "spec.toml"]);
    assert_eq!(check.status.code(), Some(2));
    assert_eq!(stderr(&check), run.stderr);
    run.stderr
}

#[test]
fn gold_misspelt_parameter() {
    let message = refused(&SPEC.replace("lambda = \"$lambda\"", "lamda  = \"$lambda\""));
    let expected = "error: `fit` has no parameter `lamda`\n  --> spec.toml:36:1\n\
                    36 | lamda  = \"$lambda\"\n   | ^^^^^ did you mean `lambda`?\n";
    assert_eq!(message, expected);
}

#[test]
fn gold_unknown_stage_axis_table_column_and_key() {
    for (from, to, expected_text) in [
        ("stage   = \"resample\"", "stage   = \"resampel\"", "there is no stage `resampel`"),
        ("target = \"$mag\"", "target = \"$magg\"", "there is no axis `magg`"),
        ("map             = \"anomaly\"", "map             = \"anomoly\"", "did you mean `anomaly`?"),
        ("truth = \"mag_1_c\"", "truth = \"mag_1_d\"", "did you mean `mag_1_c`?"),
        ("seed  = 1", "sed  = 1", "a spec has no key `sed`"),
        ("[\"flux_a\", \"flux_d\"]", "[\"flux_a\", \"flux_x\"]", "there is no vector magnetometer `flux_x`"),
        ("where  = \"line like '%.01'\"", "where  = \"lin like '%.01'\"", "did you mean `line`?"),
        ("rate_hz = 10.0", "rate_hz = \"ten\"", "`rate_hz` of `resample` must be a number, not a text"),
        ("rate_hz = 10.0", "rate_hz = -10.0", "`rate_hz` must be above 0, not -10"),
        ("rate_hz = 10.0", "rate_hz = 1.0", "a corner of 0.9 Hz is not below the Nyquist frequency of 0.5 Hz"),
        (
            "model = \"coefficients\"",
            "model = \"terms\"",
            "`model` requires a model table, but `terms` is a table of flight lines",
        ),
        ("path = \"flights/\"", "path = \"flight/\"", "there is no file or folder"),
        ("input   = \"flights\"", "input   = \"clean\"", "depends on itself"),
        ("target = \"$mag\"", "target = \"$mag\"\nfeatures = [\"tl\", \"mag_1_c\"]", "`mag_1_c` is a truth column"),
        ("[0.0, 0.025]", "[]", "the axis `lambda` has no values"),
        ("[0.0, 0.025]", "[0.0, 0.0]", "the axis `lambda` has the value `0` twice"),
        ("mag    = [\"mag_4_uc\", \"mag_5_uc\"]", "line    = [\"mag_4_uc\", \"mag_5_uc\"]", "there is no axis `mag`"),
        ("seed  = 1", "seed  = 1 1", "spec.toml:3:"),
    ] {
        assert!(SPEC.contains(from), "{from}");
        let message = refused(&SPEC.replace(from, to));
        assert!(message.contains(expected_text), "{to}\n{message}");
        assert!(message.contains("--> spec.toml:"), "{message}");
    }
}

#[test]
fn gold_a_where_without_a_match_is_rejected_with_the_available_lines() {
    let bench = Bench::new();
    bench.spec(&SPEC.replace("'%.01'", "'%.07'"));
    let done = bench.run(&[]);
    assert_eq!(done.code, 2);
    assert!(
        done.stderr.contains("`where` selects no line") && done.stderr.contains("1/1.01, 1/1.02"),
        "{}",
        done.stderr
    );
    assert!(done.stderr.contains("--> spec.toml:33:10"), "{}", done.stderr);
}

#[test]
fn gold_each_mistake_gives_one_message() {
    let message = refused(&SPEC.replace("\"a_matrix\"", "\"amatrix\""));
    assert_eq!(message.matches("error:").count(), 1, "{message}");
    let message =
        refused(&SPEC.replace("\"a_matrix\"", "\"amatrix\"").replace("offset_window_s = 1.0", "offset_windows = 1.0"));
    assert_eq!(message.matches("error:").count(), 2, "{message}");
}

#[test]
fn gold_set_reports_unknown_keys() {
    let bench = Bench::new();
    let done = bench.run(&["--set", "axes.lamda=[1.0]"]);
    assert_eq!(done.code, 2);
    assert!(done.stderr.contains("did you mean `lambda`?"), "{}", done.stderr);
    assert_eq!(bench.magline(&["run"]).status.code(), Some(2));
    let none = bench.magline(&["run", "nowhere.toml"]);
    assert_eq!(none.status.code(), Some(2));
    assert!(stderr(&none).contains("cannot read nowhere.toml"));
}

/// Runs with the lines of flight 1 replaced.
fn with_lines(lines: &[RecordBatch]) -> (Bench, Done) {
    let bench = Bench::new();
    write(&bench.path("flights/1.parquet"), lines);
    let done = bench.run(&[]);
    (bench, done)
}

fn failures(bench: &Bench) -> Vec<(String, String, String)> {
    let table = read(&bench.path("store/tables/small/failures"));
    let (lines, stages, errors) = (texts(&table, "line"), texts(&table, "stage"), texts(&table, "error"));
    (0..lines.len()).map(|i| (lines[i].clone(), stages[i].clone(), errors[i].clone())).collect()
}

#[test]
fn gold_repeated_and_backward_time_fail_their_line_only() {
    for (at, from, expected_text) in [
        (50usize, 49usize, "row 50: duplicate time 36004.9 s"),
        (50, 47, "row 50: time decreases from 36004.9 s to 36004.7 s"),
    ] {
        let good = line_of("1", "1.02", 500);
        let bad = changed(&good, "tt", |i, t| if i == at { 36_000.0 + from as f64 * 0.1 } else { t });
        let (bench, done) = with_lines(&[line_of("1", "1.01", 700), bad]);
        assert_eq!(done.code, 1);
        assert_eq!(done.computed("even"), 3);
        assert_eq!(done.computed("scores"), 24);
        let failed = failures(&bench);
        assert_eq!(failed.len(), 1);
        assert_eq!((failed[0].0.as_str(), failed[0].1.as_str()), ("1.02", "flights"));
        assert!(failed[0].2.contains(expected_text) && failed[0].2.contains("flights/1.parquet"), "{}", failed[0].2);
        // A second run computes nothing and reports the same failure.
        let again = bench.run(&[]);
        assert_eq!((again.code, again.total("computed")), (1, 0));
    }
}

#[test]
fn user_a_dropout_affects_only_its_samples_and_sensor() {
    let gap = |i: usize| (200..230).contains(&i);
    let lines = [
        changed(&line_of("1", "1.01", 700), "mag_4_uc", |i, x| {
            if gap(i) { if i % 2 == 0 { f64::NAN } else { 0.0 } } else { x }
        }),
        line_of("1", "1.02", 500),
    ];
    let (bench, done) = with_lines(&lines);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let clean = read(&bench.path("store/tables/small/clean"));
    let (mags, lines, values) = (texts(&clean, "mag"), texts(&clean, "line"), numbers(&clean, "mag_c"));
    let of = |mag: &str| -> Vec<f64> {
        (0..values.len()).filter(|i| mags[*i] == mag && lines[*i] == "1.01").map(|i| values[i]).collect()
    };
    let (four, five) = (of("mag_4_uc"), of("mag_5_uc"));
    // The gap of 3 s exceeds the 1 s that resampling bridges. The other magnetometer is unaffected.
    assert!((0..700).all(|i| four[i].is_nan() == gap(i)));
    assert!(five.iter().all(|x| x.is_finite()));
    let models = read(&bench.path("store/tables/small/coefficients"));
    let left: Vec<i64> = models
        .iter()
        .flat_map(|b| {
            let a = b.column_by_name("left_out").unwrap();
            a.as_any().downcast_ref::<arrow_array::Int64Array>().unwrap().values().to_vec()
        })
        .collect();
    let mags = texts(&models, "mag");
    // Trim: 20 samples at each end of each run. Each of the two lines is one run; the gap adds one more run.
    assert!((0..left.len()).all(|i| left[i] == if mags[i] == "mag_4_uc" { 30 + 3 * 40 } else { 2 * 40 }), "{left:?}");
    let track = read(&bench.path("store/tables/small/track"));
    let missing = texts(&track, "update").iter().filter(|u| *u == "missing").count();
    assert_eq!(missing, 30 * 4);
}

#[test]
fn gold_a_line_shorter_than_the_filter_is_skipped_and_no_usable_line_is_a_failure() {
    let (bench, done) = with_lines(&[line_of("1", "1.01", 30), line_of("1", "1.02", 500)]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    drop(bench);
    let bench = Bench::new();
    for flight in ["1", "2"] {
        let lines = [line_of(flight, &format!("{flight}.01"), 30), line_of(flight, &format!("{flight}.02"), 500)];
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    let done = bench.run(&[]);
    assert_eq!(done.code, 1);
    // The lines are computed; the models and their dependents are missing.
    assert_eq!((done.computed("terms"), done.computed("coefficients"), done.computed("clean")), (8, 0, 0));
    let failed = failures(&bench);
    assert_eq!(failed.len(), 8);
    assert!(failed[0].2.contains("is long enough to be filtered and trimmed"), "{}", failed[0].2);
}

#[test]
fn gold_bandpass_of_a_short_line_and_of_uneven_time() {
    let bench = Bench::new();
    let spec = "store = \"store\"\n[tables.flights]\npath = \"flights/1.parquet\"\n[[stages]]\nname = \"slow\"\n\
                stage = \"bandpass\"\ninput = \"flights\"\ncolumns = [\"mag_4_uc\"]\n";
    bench.spec(spec);
    let uneven = changed(&line_of("1", "1.02", 500), "tt", |i, t| if i % 2 == 1 { t + 0.03 } else { t });
    write(&bench.path("flights/1.parquet"), &[line_of("1", "1.01", 24), uneven, line_of("1", "1.03", 25)]);
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("slow")), (1, 1));
    let failed = done.last["failures"].as_array().unwrap();
    let errors: Vec<&str> = failed.iter().map(|f| f["error"].as_str().unwrap()).collect();
    assert!(
        errors[0].contains(
            "flight 1, line 1.01, column `mag_4_uc`: no run of samples is long enough for the filter (25 samples)"
        ),
        "{errors:?}"
    );
    assert!(errors[1].contains("column `tt`") && errors[1].contains("resample first"), "{errors:?}");
}

#[test]
fn gold_positions_off_the_map_are_counted_and_a_line_wholly_off_fails() {
    let half = changed(&line_of("1", "1.02", 500), "ins_lat", |i, x| if i >= 300 { x + 1.0 } else { x });
    // 330 km off the map. An INS more than 500 km from the truth is rejected by the reader.
    let away = changed(&line_of("1", "1.03", 500), "ins_lat", |_, x| x + 3.0);
    let (bench, done) = with_lines(&[line_of("1", "1.01", 700), half, away]);
    assert_eq!(done.code, 1);
    let failed = failures(&bench);
    assert_eq!(failed.len(), 8, "{failed:?}");
    assert!(failed.iter().all(|f| f.0 == "1.03" && f.1 == "track"));
    assert!(failed[0].2.contains("check that the map covers the flight"), "{}", failed[0].2);
    let scores = read(&bench.path("store/tables/small/scores"));
    let (lines, metrics, values) = (texts(&scores, "line"), texts(&scores, "metric"), numbers(&scores, "value"));
    let off: Vec<f64> = (0..values.len())
        .filter(|i| lines[*i] == "1.02" && metrics[*i] == "samples_off_map")
        .map(|i| values[i])
        .collect();
    assert_eq!(off, [200.0; 8]);
}

#[test]
fn user_a_flat_map_navigates_no_better_than_the_ins() {
    let bench = Bench::new();
    write(&bench.path("map.parquet"), &[changed(&map(), "anomaly", |_, _| 5.0)]);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let scores = read(&bench.path("store/tables/small/scores"));
    let (metrics, values) = (texts(&scores, "metric"), numbers(&scores, "value"));
    let of = |m: &str| -> Vec<f64> { (0..values.len()).filter(|i| metrics[*i] == m).map(|i| values[i]).collect() };
    for (filter, ins) in of("drms").iter().zip(of("ins_drms")) {
        // The measurements hold no information on the position, so the estimate equals the INS to rounding.
        assert!((filter - ins).abs() < 1e-6, "{filter} {ins}");
    }
}

#[test]
fn gold_terms_without_excitation_are_listed() {
    let still = |b: RecordBatch| ["flux_a_x", "flux_a_y"].iter().fold(b, |b, c| changed(&b, c, |_, _| 0.0));
    let bench = Bench::new();
    for flight in ["1", "2"] {
        let lines = ["01", "02"].map(|l| still(line_of(flight, &format!("{flight}.{l}"), 600)));
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    let done = bench.run(&[]);
    assert_eq!(done.code, 1);
    // Without a ridge parameter only the fits of flux_a fail. With a ridge parameter, these fits succeed with a large
    // condition number.
    assert_eq!((done.computed("coefficients"), done.total("failed")), (6, 2));
    let failed = failures(&bench);
    assert!(
        failed.iter().all(|f| f.2.contains("`x`, `y`, `xx`, `xy`, `xz`") && f.2.contains("are constant")),
        "{failed:?}"
    );
    let models = read(&bench.path("store/tables/small/coefficients"));
    assert!(numbers(&models, "condition").iter().any(|c| *c > 1e10));
}

#[test]
fn gold_a_line_without_a_column_fails_where_the_column_is_read() {
    let bench = Bench::new();
    write(&bench.path("flights/3.parquet"), &[without(&line_of("3", "3.02", 500), "flux_d_z")]);
    let done = bench.run(&[]);
    assert_eq!(done.code, 1);
    // Resampling makes a column of NaN, so navigation with this vector magnetometer fails; navigation with the other
    // magnetometer works.
    let failed = failures(&bench);
    assert_eq!(failed.len(), 4, "{failed:?}");
    assert!(
        failed.iter().all(|f| f.0 == "3.02" && f.1 == "track" && f.2.contains("500 without a measurement")),
        "{failed:?}"
    );
    assert_eq!((done.computed("clean"), done.computed("track")), (40, 36));
    // Without resampling the line fails in the first stage that reads the column.
    bench.spec(&SPEC.replace("input  = \"even\"", "input  = \"flights\""));
    let done = bench.run(&[]);
    let failed = failures(&bench);
    assert_eq!((done.code, failed.len()), (1, 1));
    assert!(
        failed[0].1 == "terms" && failed[0].2.contains("flight 3, line 3.02") && failed[0].2.contains("`flux_d_z`"),
        "{failed:?}"
    );
}

#[test]
fn gold_truncated_and_foreign_files_are_rejected_before_the_run() {
    for (bytes, expected_text) in [(0usize, "the file is empty"), (3, "1.parquet"), (5000, "1.parquet")] {
        let bench = Bench::new();
        let whole = fs::read(bench.path("flights/1.parquet")).unwrap();
        fs::write(bench.path("flights/1.parquet"), &whole[..bytes]).unwrap();
        let done = bench.run(&[]);
        assert_eq!(done.code, 2, "{}", done.stderr);
        assert!(done.stderr.contains(expected_text) && done.stderr.contains("--> spec.toml:7:8"), "{}", done.stderr);
    }
    let bench = Bench::new();
    fs::write(bench.path("map.parquet"), b"PAR1 not really").unwrap();
    let done = bench.run(&[]);
    assert_eq!(done.code, 2, "{}", done.stderr);
    assert!(done.stderr.contains("map.parquet"), "{}", done.stderr);
}

#[test]
fn gold_missing_keys_wrong_units_and_text_for_numbers() {
    let bench = Bench::new();
    write(&bench.path("flights/1.parquet"), &[without(&line_of("1", "1.01", 100), "tt")]);
    let done = bench.run(&[]);
    assert_eq!(done.code, 2);
    assert!(done.stderr.contains("a flight table requires a column `tt`"), "{}", done.stderr);
    fs::remove_file(bench.path("flights/1.parquet")).unwrap();
    fs::write(bench.path("flights/1.csv"), "flight,line,tt,mag_4_uc\n1,1.01,0.0,50000\n1,1.01,0.1,oops\n").unwrap();
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("even")), (1, 2));
    let failed = failures(&bench);
    assert!(
        failed[0].2.contains("1.csv, flight 1, line 1.01, column `mag_4_uc`, row 1: `oops` is not a number"),
        "{failed:?}"
    );
}

#[test]
fn gold_a_line_in_two_files_is_not_used() {
    let bench = Bench::new();
    write(&bench.path("flights/copy.parquet"), &[line_of("1", "1.02", 400)]);
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("even")), (1, 3));
    let failed = failures(&bench);
    assert!(failed[0].2.contains("the line is also in") && failed[0].2.contains("copy.parquet"), "{failed:?}");
}

#[test]
fn gold_an_irregular_map_is_rejected_and_a_map_with_a_hole_is_accepted() {
    let bench = Bench::new();
    write(&bench.path("map.parquet"), &[changed(&map(), "lon", |i, lon| if i == 100 { lon + 0.001 } else { lon })]);
    let done = bench.run(&[]);
    assert_eq!(done.code, 2, "{}", done.last);
    assert!(done.stderr.contains("map.parquet") && done.stderr.contains("lon"), "{}", done.stderr);
    // Nodes absent from the table are missing values. None of these nodes is below a track.
    let rows = map();
    write(&bench.path("map.parquet"), &[rows.slice(0, rows.num_rows() - 7)]);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
}

#[test]
fn user_a_foreign_folder_is_not_used_as_a_store() {
    let bench = Bench::new();
    fs::create_dir(bench.path("mine")).unwrap();
    fs::write(bench.path("mine/thesis.txt"), "years of work").unwrap();
    let done = bench.run(&["--set", "store=mine"]);
    assert_eq!(done.code, 2);
    assert!(done.stderr.contains("not a magline store"), "{}", done.stderr);
}

#[test]
fn user_float_and_dictionary_keys_are_read_as_text() {
    let bench = Bench::new();
    let one = line_of("1", "1.01", 700);
    let plain = without(&without(&one, "flight"), "line");
    let numbers_only = batch(&[("flight", vec![1.0; 700]), ("line", vec![1.01; 700])]);
    let fields: Vec<_> = numbers_only.schema().fields().iter().chain(plain.schema().fields()).cloned().collect();
    let columns = numbers_only.columns().iter().chain(plain.columns()).cloned().collect();
    let keyed = RecordBatch::try_new(std::sync::Arc::new(arrow_schema::Schema::new(fields)), columns).unwrap();
    write(&bench.path("flights/1.parquet"), &[keyed]);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let text = stdout(&bench.magline(&[
        "sql",
        "SELECT DISTINCT flight, line FROM small.even ORDER BY line",
        "--format",
        "csv",
    ]));
    assert_eq!(text, "flight,line\n1,1.01\n2,2.01\n2,2.02\n");
}

//! Navigation: date, measurement, assumed noise and metrics of the map.

use std::fs;

use arrow_array::RecordBatch;

use crate::support::{Bench, SPEC, batch, changed, line_of, numbers, read, stderr, texts, with_keys, write};

/// Line with additional columns.
fn with_columns(line: &RecordBatch, more: &[(&str, Vec<f64>)]) -> RecordBatch {
    let (flight, name) =
        (texts(std::slice::from_ref(line), "flight")[0].clone(), texts(std::slice::from_ref(line), "line")[0].clone());
    let names: Vec<String> = line.schema().fields().iter().map(|f| f.name().clone()).skip(2).collect();
    let columns: Vec<(&str, Vec<f64>)> = names
        .iter()
        .map(|n| (n.as_str(), numbers(std::slice::from_ref(line), n)))
        .chain(more.iter().cloned())
        .collect();
    with_keys(&flight, &name, &batch(&columns))
}

/// Bench with changed lines.
fn bench_of(change: impl Fn(RecordBatch) -> RecordBatch) -> Bench {
    let bench = Bench::new();
    for flight in ["1", "2"] {
        let lines =
            [("01", 700), ("02", 500)].map(|(line, rows)| change(line_of(flight, &format!("{flight}.{line}"), rows)));
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    bench
}

/// One magnetometer, vector magnetometer and ridge parameter.
fn one() -> String {
    let spec = SPEC.replace("[\"mag_4_uc\", \"mag_5_uc\"]", "[\"mag_4_uc\"]");
    spec.replace("[\"flux_a\", \"flux_d\"]", "[\"flux_a\"]").replace("[0.0, 0.025]", "[0.025]")
}

fn track(bench: &Bench, column: &str) -> Vec<f64> {
    numbers(&read(&bench.path("store/tables/small/track")), column)
}

fn metric(bench: &Bench, name: &str) -> Vec<f64> {
    let scores = read(&bench.path("store/tables/small/scores"));
    let (metrics, values) = (texts(&scores, "metric"), numbers(&scores, "value"));
    (0..values.len()).filter(|i| metrics[*i] == name).map(|i| values[i]).collect()
}

fn close(a: &[f64], b: &[f64], within: f64) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < within || a.is_nan() && b.is_nan())
}

const WITH_CORE: &str = "track.core_field=true";

#[test]
fn user_a_missing_date_is_an_error_before_the_run() {
    let bench = Bench::new();
    let run = bench.run(&["--set", WITH_CORE]);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(!bench.path("store/tables/small").exists());
    for word in ["needs a date", "`decimal_year`", "`year` and `doy`", "`core_field = false`"] {
        assert!(run.stderr.contains(word), "{word}: {}", run.stderr);
    }
    let check = bench.magline(&["check", "spec.toml", "--set", WITH_CORE]);
    assert_eq!((check.status.code(), stderr(&check)), (Some(2), run.stderr));
    assert_eq!(bench.run(&["--set", WITH_CORE, "--set", "track.decimal_year=2020.5"]).code, 0);
}

#[test]
fn user_the_date_of_the_spec_takes_precedence_over_the_flight() {
    let dated = |year: f64| {
        move |line: RecordBatch| {
            let n = line.num_rows();
            with_columns(&line, &[("year", vec![year; n]), ("doy", vec![60.0; n])])
        }
    };
    let residual = |bench: &Bench, sets: &[&str]| {
        bench.spec(&one());
        let run = bench.run(sets);
        assert_eq!(run.code, 0, "{}", run.stderr);
        track(bench, "lat")
    };
    let core_field_keys = ["--set", WITH_CORE, "--set", "track.decimal_year=1950.25"];
    let nobody = residual(&Bench::new(), &core_field_keys);
    let both = residual(&bench_of(dated(2024.0)), &core_field_keys);
    assert_eq!(nobody, both);
    let flight = residual(&bench_of(dated(2024.0)), &core_field_keys[..2]);
    assert_ne!(flight, both);
    // The first samples lack the day, and other samples lack the year. The first sample with day and year gives the
    // date.
    let holes = residual(
        &bench_of(|line| {
            let line = changed(&dated(2024.0)(line), "doy", |row, x| if row < 3 { f64::NAN } else { x });
            changed(&line, "year", |row, x| if row == 3 || row > 20 { f64::NAN } else { x })
        }),
        &core_field_keys[..2],
    );
    // One second is 3e-8 of a year.
    assert!(close(&holes, &flight, 1e-12));
}

#[test]
fn user_a_flight_without_a_date_fails_alone() {
    let bench = bench_of(|line| {
        let n = line.num_rows();
        with_columns(&line, &[("year", vec![2024.0; n]), ("doy", vec![60.0; n])])
    });
    let lines = [("01", 700), ("02", 500)].map(|(line, rows)| line_of("2", &format!("2.{line}"), rows));
    write(&bench.path("flights/2.parquet"), &lines);
    bench.spec(&one());
    let run = bench.run(&["--set", WITH_CORE]);
    assert_eq!(run.code, 1, "{}", run.stderr);
    let failed = read(&bench.path("store/tables/small/failures"));
    let (lines, errors) = (texts(&failed, "line"), texts(&failed, "error"));
    assert_eq!(lines, ["2.01", "2.02"]);
    assert!(errors.iter().all(|e| e.contains("needs a date") && e.contains("decimal_year")), "{errors:?}");
    // An impossible day is reported with its row.
    let bench = bench_of(|line| {
        let n = line.num_rows();
        with_columns(&line, &[("year", vec![2024.0; n]), ("doy", vec![367.0; n])])
    });
    bench.spec(&one());
    let run = bench.run(&["--set", WITH_CORE]);
    let failed = read(&bench.path("store/tables/small/failures"));
    assert!(run.code == 1 && texts(&failed, "error").iter().all(|e| e.contains("`doy`")), "{failed:?}");
}

/// Adds a slow variation of 40 nT over the whole line, with a column `diurnal` if `known`.
fn disturbed(line: &RecordBatch, known: bool) -> RecordBatch {
    let diurnal: Vec<f64> = (0..line.num_rows()).map(|i| 40.0 * (0.012 * i as f64).sin()).collect();
    let line = changed(line, "mag_4_uc", |row, x| x + diurnal[row]);
    if known { with_columns(&line, &[("diurnal", diurnal)]) } else { line }
}

#[test]
fn user_the_diurnal_variation_is_subtracted_from_the_measurement() {
    let quiet = bench_of(|line| line);
    let hidden = bench_of(|line| disturbed(&line, false));
    let known = bench_of(|line| disturbed(&line, true));
    // The model is always fitted on quiet lines, so that only navigation differs.
    let spec = one();
    let drms = |bench: &Bench, sets: &[&str]| {
        bench.spec(&spec);
        let run = bench.run(sets);
        assert_eq!(run.code, 0, "{}", run.stderr);
        metric(bench, "drms").iter().map(|d| d * d).sum::<f64>().sqrt()
    };
    let (quiet, hidden, taken_off) = (drms(&quiet, &[]), drms(&hidden, &[]), drms(&known, &[]));
    let left_in = drms(&known, &["--set", "track.remove_diurnal=false"]);
    println!("DRMS quiet {quiet:.2}, hidden {hidden:.2}, taken off {taken_off:.2}, left in {left_in:.2} m");
    assert!((taken_off / quiet - 1.0).abs() < 0.05 && left_in > 1.5 * quiet, "{quiet} {taken_off} {left_in}");
    assert_eq!(left_in, hidden);
    // A request without a diurnal column is an error.
    let bench = Bench::new();
    let run = bench.run(&["--set", "track.remove_diurnal=true"]);
    assert!(run.code == 2 && run.stderr.contains("`diurnal`") && run.stderr.contains("remove_diurnal = false"));
}

#[test]
fn user_a_sample_without_diurnal_has_no_measurement() {
    let bench = bench_of(|line| {
        changed(&disturbed(&line, true), "diurnal", |row, x| if (100..110).contains(&row) { f64::NAN } else { x })
    });
    bench.spec(&one().replace("input           = \"clean\"", "input           = \"terms\"\nmag = \"mag_4_uc\""));
    let spec = fs::read_to_string(bench.path("spec.toml")).unwrap();
    bench.spec(&spec.replace("stage   = \"resample\"", "stage   = \"resample\"\nmax_gap_s = 0.2"));
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let updates = texts(&read(&bench.path("store/tables/small/track")), "update");
    let missing = updates.iter().filter(|f| *f == "missing").count();
    // Ten samples on each of four lines.
    assert!((40..=48).contains(&missing), "{missing}");
}

#[test]
fn user_the_initial_heading_error_increases_the_position_uncertainty() {
    let bench = Bench::new();
    bench.spec(&one());
    let sd = |sets: &[&str]| {
        assert_eq!(bench.run(sets).code, 0);
        track(&bench, "sd_n").iter().chain(&track(&bench, "sd_e")).sum::<f64>()
    };
    let usual = sd(&[]);
    assert_eq!(usual, sd(&["--set", "track.init_heading_sigma_deg=0.01"]));
    assert!(sd(&["--set", "track.init_heading_sigma_deg=5.0"]) > usual * (1.0 + 1e-6));
}

#[test]
fn user_automatic_noise_uses_the_calibration_residual() {
    let auto = [
        "--set",
        "track.measurement_sigma_nt=auto",
        "--set",
        "track.fogm_sigma_nt=auto",
        "--set",
        "track.fogm_tau_s=auto",
    ];
    let bench = Bench::new();
    // Bilinear interpolation would add its error to the calibration residual.
    let one = || one().replace("offset_window_s = 1.0", "offset_window_s = 1.0\nmap_interpolation = \"cubic\"");
    bench.spec(&one());
    let run = bench.run(&auto);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let model = read(&bench.path("store/tables/small/coefficients"));
    let clean = read(&bench.path("store/tables/small/clean"));
    for (of_model, of_line) in [
        ("residual_sigma", "mag_sigma"),
        ("residual_fogm_sigma", "mag_fogm_sigma"),
        ("residual_fogm_tau", "mag_fogm_tau"),
    ] {
        let (found, on_line) = (numbers(&model, of_model), numbers(&clean, of_line));
        assert!(found[0] > 0.0 && found.iter().chain(&on_line).all(|x| *x == found[0]), "{of_model} {found:?}");
    }
    // The same noise values, set explicitly. With an offset the FOGM part has twice the variance and time constant.
    let by_hand = track(&bench, "lat");
    let (white, sigma, tau) = (
        numbers(&model, "residual_sigma")[0],
        numbers(&model, "residual_fogm_sigma")[0] * std::f64::consts::SQRT_2,
        numbers(&model, "residual_fogm_tau")[0] * 2.0,
    );
    let sets = [
        format!("track.measurement_sigma_nt={white:?}"),
        format!("track.fogm_sigma_nt={sigma:?}"),
        format!("track.fogm_tau_s={tau:?}"),
    ];
    let run = bench.run(&["--set", &sets[0], "--set", &sets[1], "--set", &sets[2]]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(by_hand, track(&bench, "lat"));
    // Without compensation there is no residual noise, which is an error.
    bench.spec(&one().replace("input           = \"clean\"", "input           = \"even\"\nmag = \"mag_4_uc\""));
    let run = bench.run(&auto);
    assert_eq!(run.code, 2);
    for word in ["`measurement_sigma_nt = \"auto\"`", "mag_sigma", "compensate", "assume_noise", "a number"] {
        assert!(run.stderr.contains(word), "{word}: {}", run.stderr);
    }
    let run = bench.run(&["--set", "track.fogm_tau_s=atuo"]);
    assert!(run.code == 2 && run.stderr.contains("number or `auto`"), "{}", run.stderr);
}

#[test]
fn user_automatic_noise_uses_lines_over_a_known_field() {
    let bench = Bench::new();
    let more = "\n[[stages]]\nname = \"left\"\nstage = \"residual_noise\"\ninput = \"clean\"\n\
                where = \"line like '%.01'\"\n\
                truth = \"mag_1_c\"\n\n[[stages]]\nname = \"expected\"\nstage = \"assume_noise\"\ninput = \"clean\"\n\
                noise = \"left\"\n";
    let spec =
        one().replace("input           = \"clean\"", "input           = \"expected\"\nmeasurement_sigma_nt = \"auto\"");
    bench.spec(&(spec.clone() + more));
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let (left, expected) =
        (read(&bench.path("store/tables/small/left")), read(&bench.path("store/tables/small/expected")));
    let sigma = numbers(&left, "residual_sigma");
    assert!(sigma.len() == 1 && numbers(&expected, "mag_sigma").iter().all(|x| *x == sigma[0]));
    // Without a true field, the components of the field are required; the message gives the stages that compute them.
    bench.spec(&(spec + &more.replace("truth = \"mag_1_c\"\n", "")));
    let run = bench.run(&[]);
    assert_eq!(run.code, 2);
    assert!(run.stderr.contains("`core_field`") && run.stderr.contains("`map_value`"), "{}", run.stderr);
}

#[test]
fn user_a_map_at_another_height_has_an_estimated_error() {
    let error = |alt_m: f64, sets: &[&str]| {
        let bench = bench_of(|line| changed(&changed(&line, "alt", |_, _| alt_m), "ins_alt", |_, _| alt_m));
        bench.spec(&one());
        let run = bench.run(sets);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let all = metric(&bench, "map_height_error");
        assert!(all.len() == 4 && all.iter().all(|x| (x - all[0]).abs() < 1e-9), "{all:?}");
        all[0]
    };
    // The map is at 300 m. The waves of the map are about 2.5 km long and have an rms of 100 nT. At 200 m above the
    // map, the field is smaller by 100 (1 - exp(-2 pi 0.08)) nT.
    assert!(error(300.0, &[]) < 1e-6);
    let high = error(500.0, &[]);
    assert!((20.0..70.0).contains(&high), "{high}");
    assert!(error(320.0, &[]) < 0.25 * high);
    // The remaining error of a continued map comes from the edges of the map.
    let continued = error(500.0, &["--set", "track.map_levels_m=[300.0, 500.0, 700.0]"]);
    assert!((0.0..0.5 * high).contains(&continued), "{continued} {high}");
}

//! Logs that are read through mappings: in a spec, by `magline ingest`, and with suggested mappings.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread::sleep,
    time::Duration,
};

use arrow_array::RecordBatch;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use tempfile::TempDir;

use crate::support::{magline, numbers, read, repository, stderr, stdout, texts};

pub fn sample(name: &str) -> String {
    repository().join("datasets/samples").join(name).display().to_string()
}

pub fn file(path: &Path) -> Vec<RecordBatch> {
    let reader = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(path).unwrap()).unwrap();
    reader.build().unwrap().map(Result::unwrap).collect()
}

/// All files below a folder, with their bytes.
pub fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    found
}

/// A log of `rows` rows at 10 Hz in milligauss, and a mapping of this log.
fn log(folder: &Path, name: &str, rows: usize) {
    let mut text = "ms,MagX,MagY,MagZ,cur\n".to_owned();
    for i in 0..rows {
        let wave = |k: f64| (100.0 * (i as f64 * 0.01 * k).sin()).round();
        text += &format!("{},{},{},{},{}\n", 1000 + 100 * i, 200.0 + wave(1.0), wave(2.0), 450.0 + wave(3.0), i % 7);
    }
    fs::write(folder.join(name), text).unwrap();
}

const MAPPING: &str = "flight = { of_file = true }\nline = '1'\nepoch = { utc = '2021-04-21T12:00:00Z' }\n\
    [tables.mag]\ntime = { from = 'ms', unit = 'ms', clock = 'boot' }\n\
    vectors = { flux_a = { from = ['MagX', 'MagY', 'MagZ'], unit = 'mgauss', axes = '+x -y -z' } }\n\
    columns = { cur_motor = { from = 'cur', unit = 'A', scale = 0.5 } }\n";

pub fn bench(rows: usize) -> TempDir {
    let folder = TempDir::new().unwrap();
    log(folder.path(), "log.csv", rows);
    fs::write(folder.path().join("m.toml"), MAPPING).unwrap();
    folder
}

#[test]
fn ref_real_logs_are_read_through_their_mappings() {
    let folder = TempDir::new().unwrap();
    let run = |input: &str, mapping: &str, to: &str| {
        let output = magline(folder.path(), &["ingest", input, "--to", to, "--mapping", mapping]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        (stdout(&output), stderr(&output))
    };
    let (printed, noted) = run(&sample("skywalker_x8"), "skywalker_x8_parquet", "sky");
    for words in ["control", "attitude", "2013, day 333", "quantisation", "gaps"] {
        assert!(printed.contains(words), "no {words} in {printed}");
    }
    assert!(noted.contains("its clock read 0 on 2013-11-29 at 21:59:47.520 UTC"), "{noted}");
    let mag = file(&folder.path().join("sky/mag/mag.parquet"));
    // Values of the file by pyarrow: time_s 13.244, mag (-195, 28, -618), offset (172, -19, -153) mgauss. GPS time of
    // week is 511203.52 s ahead (median). UTC is 16 s behind GPS, on the fifth day of the week.
    assert!((numbers(&mag, "tt")[0] - (511_203.52 + 13.244 - 16.0 - 5.0 * 86_400.0)).abs() < 1e-6);
    let first = ["flux_a_x", "flux_a_y", "flux_a_z"].map(|axis| numbers(&mag, axis)[0]);
    assert_eq!(first, [-36_700.0, 4_700.0, -46_500.0]);
    assert_eq!((numbers(&mag, "year")[0], numbers(&mag, "doy")[0]), (2013.0, 333.0));
    assert_eq!(
        (texts(&mag, "flight")[0].as_str(), mag.iter().map(RecordBatch::num_rows).sum::<usize>()),
        ("skywalker_x8", 6129)
    );
    let gps = file(&folder.path().join("sky/gps/gps.parquet"));
    // 2.03 m/s on a course of 278.85 degrees.
    assert!((numbers(&gps, "vn")[0] - 2.03 * 278.85_f64.to_radians().cos()).abs() < 1e-9);
    // Quantisation of a magnetometer logged in milligauss.
    let quality = file(&folder.path().join("sky/mag/_quality/mag.parquet"));
    let (columns, checks, values) = (texts(&quality, "column"), texts(&quality, "check"), numbers(&quality, "value"));
    let of = |column: &str, check: &str| {
        (0..values.len()).find(|i| columns[*i] == column && checks[*i] == check).map(|i| values[i])
    };
    assert_eq!(of("flux_a_x", "quantisation"), Some(100.0));
    // README of the log: gaps of up to 0.27 s at an interval of 0.1 s.
    let gap = of("tt", "longest_gap").unwrap();
    assert!((gap - 0.169).abs() < 1e-6, "{gap}");

    run(&sample("thor75"), "thor75_parquet", "thor");
    let ours = file(&folder.path().join("thor/flight/flight.parquet"));
    let theirs = file(Path::new(&sample("thor75/flight.parquet")));
    let skip = numbers(&theirs, "time_s").iter().position(|t| *t > 25.0).unwrap();
    let expected: Vec<f64> = numbers(&theirs, "mag_y_gauss")[skip..].iter().map(|y| -y * 1e5).collect();
    let worst = expected.iter().zip(numbers(&ours, "flux_a_y")).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(expected.len() == numbers(&ours, "flux_a_y").len() && worst < 1e-6, "{worst}");
    // The motor clock is 7.75 s behind the flight clock.
    let motor = file(&folder.path().join("thor/motor/motor.parquet"));
    let start = numbers(&ours, "tt")[0] - numbers(&theirs, "time_s")[skip];
    assert!((numbers(&motor, "tt")[0] - start - 7.75).abs() < 1e-6);
}

#[test]
fn ref_binary_logs_are_read_through_their_mappings() {
    let folder = TempDir::new().unwrap();
    let run = |input: &str, mapping: &str, to: &str| {
        let output = magline(folder.path(), &["ingest", &sample(input), "--to", to, "--mapping", mapping]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        (stdout(&output), stderr(&output))
    };
    // PX4 by pyulog: magnetometer_ga (0.42917827, -0.11418437, -0.05181336) at 20.310847 s after the start, and UTC
    // 1618986658.600345 at 20.471648 s.
    let (_, noted) = run("logs/sample_log_small.ulg", "px4_ulog", "px4");
    assert!(noted.contains("its clock read 0 on 2021-04-21 at 06:30:38.1"), "{noted}");
    let mag = file(&folder.path().join("px4/mag/sample_log_small.parquet"));
    let first = ["flux_a_x", "flux_a_y", "flux_a_z"].map(|axis| numbers(&mag, axis)[0]);
    let expected = [42_917.827, -11_418.437, -5_181.336];
    assert!(first.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.01), "{first:?}");
    let start = 1_618_986_658.600_345 - 1_618_963_200.0 - 20.471_648;
    // The fixes of six seconds are up to 0.02 s late.
    assert!((numbers(&mag, "tt")[0] - (start + 20.310_847)).abs() < 0.02, "{}", numbers(&mag, "tt")[0]);
    let gps = file(&folder.path().join("px4/gps/sample_log_small.parquet"));
    assert!((numbers(&gps, "lat")[0] - 63.417_062_2).abs() < 1e-9 && (numbers(&gps, "alt")[0] - 106.766).abs() < 1e-9);
    // ArduPilot by pymavlink: MAG (217, 4, -586) with the offsets (-97, 118, 213) at 11.477 s. The cut ends before the
    // first fix, so the start of the log is unknown.
    let cut = sample("logs/log171_cut.bin");
    let output = magline(folder.path(), &["ingest", &cut, "--to", "ap", "--mapping", "ardupilot_dataflash_timems"]);
    if output.status.code() == Some(2) {
        assert!(stderr(&output).contains("gives the start time of the log"), "{}", stderr(&output));
        let ready = fs::read_to_string(repository().join("datasets/mappings/ardupilot_dataflash_timems.toml")).unwrap();
        let (head, rest) = ready.split_once("[epoch]").unwrap();
        let tables = rest.split_once("\n\n").unwrap().1;
        fs::write(
            folder.path().join("own.toml"),
            format!("{head}epoch = {{ utc = '2015-11-21T23:43:40.32Z' }}\n\n{tables}"),
        )
        .unwrap();
        let args = ["ingest", &cut, "--to", "ap", "--mapping", "own.toml"];
        let output = magline(folder.path(), &args);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
    let mag = file(&folder.path().join("ap/mag/log171_cut.parquet"));
    let first = ["flux_a_x", "flux_a_y", "flux_a_z"].map(|axis| numbers(&mag, axis)[0]);
    assert_eq!(first, [31_400.0, -11_400.0, -79_900.0]);
    // 23:43:40.32 and 11.477 s.
    assert!((numbers(&mag, "tt")[0] - 85_431.797).abs() < 0.01, "{}", numbers(&mag, "tt")[0]);
    let battery = file(&folder.path().join("ap/battery/log171_cut.parquet"));
    assert_eq!((numbers(&battery, "cur_battery")[0], numbers(&battery, "vol_battery")[0]), (0.55, 16.54));
    // MATLAB: the array from which the Parquet file was made.
    run("logs/TestLog2_cut.mat", "skywalker_x8", "sky");
    let mat = file(&folder.path().join("sky/mag/TestLog2_cut.parquet"));
    run("skywalker_x8", "skywalker_x8_parquet", "skyp");
    let parquet = file(&folder.path().join("skyp/mag/mag.parquet"));
    for axis in ["flux_a_x", "flux_a_y", "flux_a_z"] {
        assert_eq!(numbers(&mat, axis), numbers(&parquet, axis), "{axis}");
    }
    let late = numbers(&mat, "tt").iter().zip(numbers(&parquet, "tt")).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(late < 0.01, "{late}");
}

#[test]
fn user_a_log_in_a_spec_and_its_ingested_file_give_the_same_bytes() {
    let folder = bench(3000);
    let at = folder.path();
    let spec = |path: &str| {
        format!(
            "name = 'small'\nstore = 'store'\n[tables.log]\n{path}\n[[stages]]\nname = 'even'\nstage = 'resample'\n\
             input = 'log'\nrate_hz = 5.0\n[[stages]]\nname = 'size'\nstage = 'magnitude'\ninput = 'even'\n\
             vector = 'flux_a'\n"
        )
    };
    fs::write(at.join("raw.toml"), spec("path = 'log.csv'\nmapping = 'm.toml'")).unwrap();
    fs::write(at.join("in.toml"), spec("path = 'out'")).unwrap();
    fs::write(at.join("hive.toml"), spec("path = 'hive'")).unwrap();
    assert_eq!(magline(at, &["ingest", "log.csv", "--to", "out", "--mapping", "m.toml"]).status.code(), Some(0));
    assert_eq!(
        magline(at, &["ingest", "log.csv", "--to", "hive", "--hive", "--mapping", "m.toml"]).status.code(),
        Some(0)
    );
    assert!(at.join("hive/flight=log/log.parquet").is_file());
    let tables = |name: &str| {
        let output = magline(at, &["run", &format!("{name}.toml"), "--set", &format!("store=s_{name}")]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        ["even", "size"].map(|table| {
            let all = files(&at.join(format!("s_{name}/tables/small")).join(table));
            all.into_iter().map(|(path, bytes)| (path.file_name().unwrap().to_owned(), bytes)).collect::<Vec<_>>()
        })
    };
    let raw = tables("raw");
    assert!(raw.iter().all(|t| !t.is_empty()));
    assert!(raw == tables("in"), "the ingested file differs");
    assert!(raw == tables("hive"), "the file of a hive folder differs");
    // 500 mgauss are 50,000 nT. The signs of y and z are reversed. Amperes are half of the counts.
    let even = read(&at.join("s_raw/tables/small/even"));
    assert_eq!(numbers(&even, "flux_a_z")[0], -45_000.0);
    // A changed mapping changes the key.
    fs::write(at.join("m.toml"), MAPPING.replace("+x -y -z", "+x +y +z")).unwrap();
    magline(at, &["run", "raw.toml", "--set", "store=s_raw"]);
    assert_eq!(numbers(&read(&at.join("s_raw/tables/small/even")), "flux_a_z")[0], 45_000.0);
}

#[test]
fn user_one_thread_and_two_write_the_same_files() {
    let folder = TempDir::new().unwrap();
    for i in 0..6 {
        log(folder.path(), &format!("log{i}.csv"), 200 + 100 * i);
    }
    fs::write(folder.path().join("m.toml"), MAPPING).unwrap();
    let run = |threads: &str| {
        let args = ["ingest", "log*.csv", "--to", threads, "--mapping", "m.toml", "--threads", threads, "--json"];
        let output = magline(folder.path(), &args);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let to = folder.path().join(threads);
        let all = files(&to).into_iter().map(|(p, b)| (p.strip_prefix(&to).unwrap().to_owned(), b)).collect::<Vec<_>>();
        (all, stdout(&output).lines().count())
    };
    let (one, lines) = run("1");
    assert_eq!((one.len(), lines), (12, 6));
    assert!(one == run("2").0);
}

/// Runs `magline ingest log.csv --to out --mapping m.toml` with an invalid log or mapping and checks exit status and
/// message.
fn refused(csv: &str, mapping: &str, code: i32, words: &[&str]) -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("log.csv"), csv).unwrap();
    fs::write(folder.path().join("m.toml"), mapping).unwrap();
    let output = magline(folder.path(), &["ingest", "log.csv", "--to", "out", "--mapping", "m.toml"]);
    let printed = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{printed}");
    for word in words {
        assert!(printed.contains(word), "no `{word}` in:\n{printed}");
    }
    folder
}

#[test]
fn user_errors_are_reported_with_their_position_and_nothing_is_written() {
    let csv = "ms,MagX,MagY,MagZ,cur\n1000,200,0,450,1\n1100,201,0,450,1\n1200,202,0,450,1\n";
    let empty = |folder: TempDir| {
        let out = folder.path().join("out");
        let left = if out.is_dir() { files(&out) } else { BTreeMap::new() };
        assert!(left.is_empty(), "{:?}", left.keys());
    };
    let change = |from: &str, to: &str| {
        assert!(MAPPING.contains(from), "{from}");
        MAPPING.replace(from, to)
    };
    empty(refused(
        csv,
        &change("'mgauss'", "'mgaus'"),
        2,
        &["`mgaus`, which does not convert to nT", "m.toml:6:", "did you mean `mgauss`?"],
    ));
    // Gauss in place of milligauss: 500 gauss are not a field of the earth.
    empty(refused(
        csv,
        &change("'mgauss'", "'gauss'"),
        2,
        &["plausible magnitude of a vector measurement", "set `unit = \"mgauss\"` for `flux_a_x`"],
    ));
    empty(refused(csv, &change("'MagY'", "'MagW'"), 2, &["there is no column `MagW` in log.csv", "m.toml:6:"]));
    empty(refused(csv, &change("[tables.mag]", "[tables.mag]\ntopic = 'MAG'"), 2, &["topic"]));
    empty(refused(csv, &change("epoch = { utc = '2021-04-21T12:00:00Z' }\n", ""), 2, &["the start time is unknown"]));
    empty(refused(csv, &change("'2021-04-21T12:00:00Z'", "'noon'"), 2, &["`utc` cannot be `noon`", "m.toml:3:"]));
    empty(refused(
        csv,
        &change(
            "epoch = { utc = '2021-04-21T12:00:00Z' }",
            "epoch = { from = 'ms', unit = 'ms', clock = 'unix', boot = 'ms', boot_unit = 'ms', rows = 'cur > 5' }",
        ),
        2,
        &["no row of log.csv gives the start time of the log", "unknown = true"],
    ));
    let back = "ms,MagX,MagY,MagZ,cur\n1000,200,0,450,1\n1200,201,0,450,1\n1100,202,0,450,1\n";
    empty(refused(back, MAPPING, 2, &["line 1", "column `tt`, row 2", "time decreases"]));
    let torn = "ms,MagX,MagY,MagZ,cur\n1000,200,0,450,1\n1100,oops,0,450,1\n1200,202,0,450,1\n";
    empty(refused(torn, MAPPING, 2, &["MagX"]));
    let folder = bench(10);
    for (args, words) in [
        (vec!["ingest", "log.csv", "--to", "out", "--mapping", "px4_ulg"], "did you mean `px4_ulog`?"),
        (vec!["ingest", "log.csv", "--to", "out", "--mapping", "m.toml", "--table", "mug"], "has no table `mug`"),
        (vec!["ingest", "gone.csv", "--to", "out"], "there is no file"),
        (vec!["ingest", "log.csv"], "--to"),
    ] {
        let output = magline(folder.path(), &args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(stderr(&output).contains(words), "{args:?}: {}", stderr(&output));
    }
}

#[test]
fn user_an_invalid_line_does_not_affect_the_others() {
    let mut text = "flight,line,tt,mag_1_uc\n".to_owned();
    for line in 1..=3 {
        for i in 0..50 {
            let tt = if line == 2 && i == 20 { 3.0 } else { f64::from(i) * 0.1 };
            text += &format!("7,7.0{line},{tt},{}\n", 50_000 + i % 5);
        }
    }
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("a.csv"), text).unwrap();
    // Canonical names need no mapping.
    let output = magline(folder.path(), &["ingest", "a.csv", "--to", "out"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("line 7.02") && stderr(&output).contains("2 lines written, 1 line rejected"),
        "{}",
        stderr(&output)
    );
    let written = file(&folder.path().join("out/a.parquet"));
    let lines = texts(&written, "line");
    assert!(lines.len() == 100 && !lines.contains(&"7.02".to_owned()));
    // The quality figures of all lines are kept, including those of the decreasing clock.
    let quality = file(&folder.path().join("out/_quality/a.parquet"));
    let checks = texts(&quality, "check");
    assert!(checks.contains(&"backward_time".to_owned()) || checks.contains(&"repeated_time".to_owned()), "{checks:?}");
}

#[test]
fn user_another_file_is_never_replaced_silently() {
    let folder = bench(100);
    let at = folder.path();
    let run = |more: &[&str]| {
        let args = [&["ingest", "log.csv", "--to", "out", "--mapping", "m.toml"], more].concat();
        magline(at, &args)
    };
    assert_eq!(run(&[]).status.code(), Some(0));
    let before = files(&at.join("out"));
    let again = run(&[]);
    assert!(again.status.code() == Some(0) && stdout(&again).contains("unchanged: "), "{}", stderr(&again));
    assert!(before == files(&at.join("out")));
    log(at, "log.csv", 50);
    let other = run(&[]);
    assert!(
        other.status.code() == Some(2) && stderr(&other).contains("already contains other data"),
        "{}",
        stderr(&other)
    );
    assert!(before == files(&at.join("out")));
    assert_eq!(run(&["--replace"]).status.code(), Some(0));
    assert_eq!(file(&at.join("out/log.parquet")).iter().map(RecordBatch::num_rows).sum::<usize>(), 50);
    // Two logs with the same name.
    fs::create_dir(at.join("b")).unwrap();
    log(&at.join("b"), "log.csv", 20);
    let clash = magline(at, &["ingest", "log.csv", "b/log.csv", "--to", "c", "--mapping", "m.toml"]);
    assert!(
        clash.status.code() == Some(2) && stderr(&clash).contains("would both be written to log"),
        "{}",
        stderr(&clash)
    );
}

fn spawned(folder: &Path, args: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_magline"));
    command.args(args).current_dir(folder).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn user_simultaneous_ingests_leave_one_data_set_of_a_name() {
    let folder = bench(20_000);
    let at = folder.path();
    let same = ["ingest", "log.csv", "--to", "out", "--mapping", "m.toml", "-q"];
    let children: Vec<Child> = (0..4).map(|_| spawned(at, &same)).collect();
    for child in children {
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    }
    assert_eq!(file(&at.join("out/log.parquet")).iter().map(RecordBatch::num_rows).sum::<usize>(), 20_000);
    // Only the first of several data sets with the same name is written.
    for name in ["a", "b", "c"] {
        fs::create_dir(at.join(name)).unwrap();
        log(&at.join(name), "log.csv", 5_000 + name.len() + usize::from(name.as_bytes()[0]));
    }
    let args = |name: &str| format!("{name}/log.csv");
    let children: Vec<Child> = ["a", "b", "c"]
        .map(|name| spawned(at, &["ingest", &args(name), "--to", "race", "--mapping", "m.toml", "-q"]))
        .into_iter()
        .collect();
    let codes: Vec<i32> = children.into_iter().map(|c| c.wait_with_output().unwrap().status.code().unwrap()).collect();
    assert_eq!(codes.iter().filter(|c| **c == 0).count(), 1, "{codes:?}");
    assert_eq!(codes.iter().filter(|c| **c == 2).count(), 2, "{codes:?}");
    file(&at.join("race/log.parquet"));
}

#[test]
fn user_a_kill_leaves_no_partial_or_temporary_files() {
    let folder = bench(60_000);
    let at = folder.path();
    let args = ["ingest", "log.csv", "--to", "out", "--mapping", "m.toml", "-q"];
    let mut died = 0;
    for i in 0..10 {
        let mut child = spawned(at, &args);
        sleep(Duration::from_millis(4 + 8 * i));
        // SIGKILL: no handler runs.
        child.kill().unwrap();
        died += u32::from(!child.wait().unwrap().success());
        let path = at.join("out/log.parquet");
        if path.exists() {
            assert_eq!(file(&path).iter().map(RecordBatch::num_rows).sum::<usize>(), 60_000);
            fs::remove_file(path).unwrap();
        }
    }
    assert!(died >= 2, "only {died} were killed at work");
    assert_eq!(magline(at, &args).status.code(), Some(0));
    let names: Vec<PathBuf> =
        files(&at.join("out")).into_keys().map(|p| p.strip_prefix(at).unwrap().to_owned()).collect();
    assert_eq!(names, [PathBuf::from("out/_quality/log.parquet"), PathBuf::from("out/log.parquet")]);
}

#[test]
fn user_a_suggested_mapping_is_valid_and_lists_its_guesses() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    for (input, words) in [
        ("thor75/motor.parquet", vec!["motor_voltage_v", "clock = \"boot\"", "unknown = true"]),
        ("skywalker_x8/mag.parquet", vec!["unit = \"mgauss\"", "the logged offsets"]),
        (
            "skywalker_x8/gps.parquet",
            vec!["lat = { from = \"latitude_deg\", unit = \"deg\" }", "week      = \"gps_week\"", "omitted: a height"],
        ),
        (
            "magnavjl_tl/magnavjl_tl.parquet",
            vec!["mag_1_uc = { from = \"mag_1_uc_nt\", unit = \"nT\" }", "flux_a = { from = [\"flux_a_x_nt\""],
        ),
    ] {
        let name = input.replace(['/', '.'], "_") + ".toml";
        let output = magline(at, &["ingest", "--suggest", &sample(input), "-o", &name]);
        assert_eq!(output.status.code(), Some(0), "{input}: {}", stderr(&output));
        let text = fs::read_to_string(at.join(&name)).unwrap();
        for word in words {
            assert!(text.contains(word), "{input}: no `{word}` in\n{text}");
        }
        let output =
            magline(at, &["ingest", &sample(input), "--to", &format!("to_{name}"), "--mapping", &format!("./{name}")]);
        assert_eq!(output.status.code(), Some(0), "{input}: {}\n{text}", stderr(&output));
        // An existing mapping is not overwritten.
        assert_eq!(magline(at, &["ingest", "--suggest", &sample(input), "-o", &name]).status.code(), Some(1));
    }
    // Without units in the names, units are inferred from the values.
    let mut csv = "timestamp,lat,lon,mx,my,mz,Roll,Yaw\n".to_owned();
    for i in 0..200 {
        let t = 1_618_986_658_600_345_u64 + 20_000 * i;
        let a = i as f64 * 0.03;
        csv += &format!(
            "{t},{},{},{},{},{},{},{}\n",
            634_170_622 + i,
            104_082_151 + i,
            0.2 * a.cos(),
            0.2 * a.sin(),
            0.45,
            20.0 * a.sin(),
            a.to_degrees() % 360.0
        );
    }
    fs::write(at.join("bare.csv"), csv.replace("mx,my,mz", "mag_x,mag_y,mag_z")).unwrap();
    let output = magline(at, &["ingest", "--suggest", "bare.csv"]);
    let text = stdout(&output);
    for word in [
        "unit = \"us\", clock = \"unix\"",
        "unit = \"degE7\"",
        "unit = \"gauss\"",
        "ins_yaw = { from = \"Yaw\", unit = \"deg\" }",
    ] {
        assert!(text.contains(word), "no `{word}` in\n{text}");
    }
}

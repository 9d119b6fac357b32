//! Properties and pitfalls of files: units, missing values, damaged rows, midnight, patterns in names, and pipes.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::DataType;

use crate::support::{Bench, Done, changed, line_of, numbers, read, repository, stderr, stdout, texts};

/// Spec with one stage on a table of files, with additional options of the table.
fn spec(options: &str) -> String {
    format!(
        "name = \"small\"\nstore = \"store\"\n[tables.flights]\npath = \"logs/\"\n{options}\n\
         [[stages]]\nname = \"even\"\nstage = \"resample\"\ninput = \"flights\"\nrate_hz = 10.0\n"
    )
}

fn bench(options: &str) -> Bench {
    let bench = Bench::new();
    fs::create_dir(bench.path("logs")).unwrap();
    bench.spec(&spec(options));
    bench
}

/// Replacement of a CSV cell by row, column name and value; `None` keeps the value.
type Cell<'a> = &'a dyn Fn(usize, &str, f64) -> Option<String>;

/// Batches as CSV text, with renamed columns and replaced cells.
fn csv(batches: &[RecordBatch], name: &dyn Fn(&str) -> String, cell: Cell) -> String {
    let names: Vec<String> = batches[0].schema().fields().iter().map(|f| f.name().clone()).collect();
    let mut text = names.iter().map(|n| name(n)).collect::<Vec<_>>().join(",") + "\n";
    for batch in batches {
        for row in 0..batch.num_rows() {
            let one = |(name, column): (&String, &arrow_array::ArrayRef)| match column.data_type() {
                DataType::Utf8 => {
                    cell(row, name, f64::NAN).unwrap_or_else(|| column.as_string::<i32>().value(row).to_owned())
                }
                _ => {
                    let x = column.as_primitive::<Float64Type>().value(row);
                    cell(row, name, x).unwrap_or_else(|| x.to_string())
                }
            };
            text += &(names.iter().zip(batch.columns()).map(one).collect::<Vec<_>>().join(",") + "\n");
        }
    }
    text
}

fn same(name: &str) -> String {
    name.to_owned()
}

/// Line with scalar magnetometers that read the total field.
fn total(flight: &str, line: &str, rows: usize) -> RecordBatch {
    let mags = ["mag_1_c", "mag_4_uc", "mag_5_uc"];
    mags.iter().fold(line_of(flight, line, rows), |b, mag| changed(&b, mag, |_, x| x + 48_000.0))
}

fn lines(rows: usize) -> Vec<RecordBatch> {
    ["1.01", "1.02", "1.03"].iter().map(|line| total("1", line, rows)).collect()
}

/// Columns of `even` by SQL, as numbers by row.
fn even(bench: &Bench, columns: &str) -> Vec<Vec<f64>> {
    let query = format!("SELECT {columns} FROM small.even ORDER BY flight, line, tt");
    let output = bench.magline(&["sql", &query, "--format", "csv"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let number = |word: &str| word.parse().unwrap_or(f64::NAN);
    stdout(&output).lines().skip(1).map(|l| l.split(',').map(number).collect()).collect()
}

fn failures(bench: &Bench) -> Vec<(String, String)> {
    let table = read(&bench.path("store/tables/small/failures"));
    texts(&table, "line").into_iter().zip(texts(&table, "error")).collect()
}

fn refused(bench: &Bench) -> String {
    let done = bench.run(&[]);
    assert_eq!(done.code, 2, "{} {}", done.stderr, done.last);
    done.stderr
}

fn finished(bench: &Bench) -> Done {
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{} {}", done.stderr, done.last);
    done
}

#[test]
fn user_units_in_the_names_of_renamed_columns_are_converted() {
    let foreign = |name: &str| match name {
        "lat" => "GPS Lat (rad)".to_owned(),
        "alt" => "GPS Alt ft".to_owned(),
        "mag_4_uc" => "MagCabin_T".to_owned(),
        "mag_5_uc" => "Mag 5 [uT]".to_owned(),
        other => other.to_owned(),
    };
    let other_unit = |_: usize, name: &str, x: f64| match name {
        "lat" => Some(x.to_radians().to_string()),
        "alt" => Some((x / 0.3048).to_string()),
        "mag_4_uc" => Some((x * 1e-9).to_string()),
        "mag_5_uc" => Some((x * 1e-3).to_string()),
        _ => None,
    };
    let rename = "rename = { \"GPS Lat (rad)\" = \"lat\", \"GPS Alt ft\" = \"alt\", \"MagCabin_T\" = \"mag_4_uc\", \
                  \"Mag 5 [uT]\" = \"mag_5_uc\" }";
    let theirs = bench(rename);
    fs::write(theirs.path("logs/1.csv"), csv(&lines(100), &foreign, &other_unit)).unwrap();
    finished(&theirs);
    let ours = bench("");
    fs::write(ours.path("logs/1.csv"), csv(&lines(100), &same, &|_, _, _| None)).unwrap();
    finished(&ours);
    let columns = "lat, alt, mag_4_uc, mag_5_uc";
    let (theirs, ours) = (even(&theirs, columns), even(&ours, columns));
    assert_eq!((theirs.len(), ours.len()), (300, 300));
    for (a, b) in theirs.iter().flatten().zip(ours.iter().flatten()) {
        // Two rounding errors of 1e-16 of the value.
        assert!((a - b).abs() <= 1e-12 * b.abs(), "{a} {b}");
    }
}

#[test]
fn user_units_of_the_table_scale_the_column_and_invalid_units_are_rejected() {
    let text = csv(&lines(60), &same, &|_, name, x| (name == "mag_4_uc").then(|| (x / 1000.0).to_string()));
    let unit = bench("units = { mag_4_uc = \"uT\" }");
    fs::write(unit.path("logs/1.csv"), &text).unwrap();
    finished(&unit);
    let wanted = numbers(&[total("1", "1.01", 60)], "mag_4_uc");
    for (row, wanted) in even(&unit, "mag_4_uc").iter().zip(wanted) {
        assert!((row[0] - wanted).abs() <= 1e-12 * wanted.abs(), "{row:?} {wanted}");
    }
    for (options, expected) in [
        ("units = { mag_4_uc = \"V\" }", "1.csv, column `mag_4_uc`: `units` gives `V`, which does not convert to nT"),
        ("units = { mag_4_uc = \"nTT\" }", "column `mag_4_uc`: `units` gives `nTT`"),
        ("units = { mag_4_u = \"uT\" }", "`units` names the column `mag_4_u`, which does not exist"),
        ("units = \"uT\"", "`units` of `flights` must be a table, not a text"),
        ("rename = \"lat\"", "`rename` of `flights` must be a table, not a text"),
        ("rename = { MagCabin = \"mag_6_uc\" }", "there is no column `MagCabin` to rename"),
        ("unit = { mag_4_uc = \"uT\" }", "did you mean `units`?"),
    ] {
        unit.spec(&spec(options));
        let message = refused(&unit);
        assert!(message.contains(expected) && message.contains("spec.toml:"), "{options}: {message}");
    }
    unit.spec(&spec("units = { mag_4_u = \"uT\" }"));
    assert!(refused(&unit).contains("did you mean `mag_4_uc`?"));
}

#[test]
fn user_a_column_name_with_a_conflicting_unit_is_rejected() {
    for (own, ours, expected) in [
        (
            "Cabin temp_degC",
            "mag_6_uc",
            "its name implies `degC`, which does not convert to nT, the unit of `mag_6_uc`",
        ),
        ("Alt (fathoms)", "baro", "its name implies `fathoms`, which does not convert to m"),
        ("MAG_T", "mag_6_uc", "its name ends in `T`, which may be the unit"),
    ] {
        let options = format!("rename = {{ \"{own}\" = \"{ours}\" }}");
        let bench = bench(&options);
        let source = if ours == "baro" { "ins_alt" } else { "mag_5_uc" };
        let name = |name: &str| if name == source { own.to_owned() } else { name.to_owned() };
        fs::write(bench.path("logs/1.csv"), csv(&lines(60), &name, &|_, _, _| None)).unwrap();
        let message = refused(&bench);
        let place = format!("1.csv, column `{own}`: ");
        assert!(message.contains(expected) && message.contains(&place) && message.contains("units = {"), "{message}");
        // A unit in `units` takes precedence.
        let unit = if ours == "baro" { "m" } else { "nT" };
        bench.spec(&spec(&format!("{options}\nunits = {{ \"{own}\" = \"{unit}\" }}")));
        finished(&bench);
    }
}

#[test]
fn user_words_for_missing_values_are_read_as_missing() {
    let word = |row: usize| match row {
        20 => Some("N/A"),
        21 => Some("-99999"),
        22 => Some("*"),
        23 => Some("null"),
        24 => Some(""),
        25 => Some("dropout"),
        26 => Some("-7777.0"),
        _ => None,
    };
    let cell = |row: usize, name: &str, _: f64| word(row).filter(|_| name == "mag_4_uc").map(str::to_owned);
    let bench = bench("missing = [\"dropout\", -7777]");
    fs::write(bench.path("logs/1.csv"), csv(&lines(60), &same, &cell)).unwrap();
    finished(&bench);
    let mags: Vec<f64> = even(&bench, "mag_4_uc").into_iter().map(|r| r[0]).collect();
    // The gap is shorter than the 1 s that resampling bridges. All values are interpolated from neighbours, so no value
    // is a placeholder for missing data.
    assert!(mags.iter().all(|x| (x - 48_000.0).abs() < 1_000.0), "{mags:?}");
    // Without the option the first unknown word fails its lines, and the message names the option.
    bench.spec(&spec(""));
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("even")), (1, 0), "{}", done.stderr);
    let failed = failures(&bench);
    assert_eq!(failed.len(), 3);
    assert!(failed[0].1.contains("column `mag_4_uc`, row 25: `dropout` is not a number"), "{failed:?}");
    assert!(failed[0].1.contains("if the text marks a missing value, add it to `missing`"), "{failed:?}");
}

#[test]
fn user_a_bad_cell_fails_only_its_line() {
    let text = csv(&lines(60), &same, &|_, _, _| None);
    let mut rows: Vec<String> = text.lines().map(str::to_owned).collect();
    // Row 10 of the second line.
    let at = 1 + 60 + 10;
    let whole = rows[at].clone();
    let check = |rows: &[String], expected: &str| {
        let bench = bench("");
        fs::write(bench.path("logs/1.csv"), rows.join("\n") + "\n").unwrap();
        let other = total("2", "2.01", 60);
        fs::write(bench.path("logs/2.csv"), csv(&[other], &same, &|_, _, _| None)).unwrap();
        assert_eq!(bench.magline(&["check", "spec.toml"]).status.code(), Some(0));
        let done = bench.run(&[]);
        assert_eq!((done.code, done.computed("even")), (1, 3), "{} {}", done.stderr, done.last);
        let failed = failures(&bench);
        assert_eq!(failed.len(), 1, "{failed:?}");
        assert!(failed[0].0 == "1.02" && failed[0].1.contains(expected), "{failed:?}");
        assert!(failed[0].1.contains("logs/1.csv, flight 1, line 1.02"), "{failed:?}");
        // A second run computes nothing and reports the same failure.
        let again = bench.run(&[]);
        assert_eq!((again.code, again.total("computed")), (1, 0));
    };
    rows[at] = whole.replacen("300,", "oops,", 1);
    check(&rows, "column `alt`, row 10: `oops` is not a number (line 72 of the file");
    rows[at] = whole.rsplit_once(',').unwrap().0.to_owned();
    check(&rows, "row 10: the row has 17 values, but the header has 18 (line 72 of the file");
    rows[at] = whole.replacen("1,1.02,", "1,,", 1);
    check(&rows, "column `line`, row 10: the identifier is missing");
    rows[at] = whole.replacen("1,1.02,", "N/A,1.02,", 1);
    check(&rows, "column `flight`, row 10: the identifier is missing");
}

#[test]
fn user_rows_without_a_line_are_reported_and_the_lines_are_read() {
    let mut rows: Vec<String> = csv(&lines(60), &same, &|_, _, _| None).lines().map(str::to_owned).collect();
    // The turn between the two lines has no line identifier.
    for row in &mut rows[58..64] {
        let (line, other) = if row.contains(",1.01,") { (",1.01,", ",,") } else { (",1.02,", ",,") };
        *row = row.replacen(line, other, 1);
    }
    let bench = bench("");
    fs::write(bench.path("logs/1.csv"), rows.join("\n") + "\n").unwrap();
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("even")), (1, 3), "{}", done.last);
    let failed = failures(&bench);
    assert_eq!(failed.len(), 1, "{failed:?}");
    assert!(
        failed[0].1.contains("column `line`, row 57: the identifier is missing in 6 rows of the file"),
        "{failed:?}"
    );
}

#[test]
fn user_a_repeated_header_is_skipped_and_a_different_header_is_an_error() {
    let text = csv(&lines(60), &same, &|_, _, _| None);
    let (header, _) = text.split_once('\n').unwrap();
    let mut rows: Vec<&str> = text.lines().collect();
    rows.insert(1 + 60, header);
    rows.insert(1 + 60 + 30, header);
    let bench = bench("");
    fs::write(bench.path("logs/1.csv"), rows.join("\n") + "\n").unwrap();
    let check = bench.magline(&["check", "spec.toml"]);
    let message = stderr(&check);
    assert_eq!(check.status.code(), Some(0), "{message}");
    assert!(message.contains("1.csv: 2 rows repeat the header (first in line 62 of the file); skipped"), "{message}");
    assert_eq!(finished(&bench).computed("even"), 3);
    assert_eq!(even(&bench, "tt").len(), 180);
    // The second header has the columns in another order, so later values would be misassigned.
    let turned: Vec<&str> = header.split(',').rev().collect();
    let turned = turned.join(",");
    rows[61] = &turned;
    fs::write(bench.path("logs/1.csv"), rows.join("\n") + "\n").unwrap();
    let message = refused(&bench);
    assert!(message.contains("row 60: the row looks like another header"), "{message}");
}

#[test]
fn user_midnight_is_unwrapped_and_other_decreases_of_time_are_errors() {
    let over = |row: usize| (863_960 + row) % 864_000;
    let dated = |name: &str| {
        if name == "ins_alt" {
            "doy".to_owned()
        } else if name == "flux_d_z" {
            "year".to_owned()
        } else {
            name.to_owned()
        }
    };
    let cell = |row: usize, name: &str, _: f64| match name {
        "tt" => Some((over(row) as f64 / 10.0).to_string()),
        "ins_alt" => Some("366".to_owned()),
        "flux_d_z" => Some("2020".to_owned()),
        _ => None,
    };
    let midnight = bench("");
    fs::write(midnight.path("logs/1.csv"), csv(&lines(60), &dated, &cell)).unwrap();
    finished(&midnight);
    let rows = even(&midnight, "tt, year, doy");
    assert_eq!(rows.len(), 180);
    for (i, row) in rows.iter().take(60).enumerate() {
        let date = if i < 40 { [2020.0, 366.0] } else { [2021.0, 1.0] };
        assert!((row[0] - (86_396.0 + i as f64 / 10.0)).abs() < 1e-6, "{row:?}");
        assert_eq!(row[1..], date, "row {i}");
    }
    // A decrease of time in the middle of the day is an error of the log.
    let back = |row: usize, name: &str, _: f64| {
        (name == "tt").then(|| (if row < 40 { 70_000.0 } else { 10_000.0 } + row as f64 / 10.0).to_string())
    };
    let noon = bench("");
    fs::write(noon.path("logs/1.csv"), csv(&lines(60), &same, &back)).unwrap();
    assert_eq!(noon.run(&[]).code, 1);
    assert!(failures(&noon)[0].1.contains("row 40: time decreases from 70003.9 s to 10004 s"));
}

#[test]
fn user_a_column_name_can_contain_a_dot() {
    let dotted = |name: &str| if name == "mag_4_uc" { "mag.4".to_owned() } else { name.to_owned() };
    let text = csv(&lines(60), &dotted, &|_, _, _| None);
    let wanted = numbers(&[total("1", "1.01", 60)], "mag_4_uc");
    let renamed = bench("rename = { \"mag.4\" = \"mag_4_uc\" }\nunits = { \"mag.4\" = \"nT\" }");
    fs::write(renamed.path("logs/1.csv"), &text).unwrap();
    finished(&renamed);
    let plain = bench("");
    fs::write(plain.path("logs/1.csv"), &text).unwrap();
    plain.spec(
        &(spec("") + "[[stages]]\nname = \"slow\"\nstage = \"bandpass\"\ninput = \"even\"\ncolumns = [\"mag.4\"]\n"),
    );
    finished(&plain);
    assert!(plain.path("store/tables/small/slow").is_dir());
    for (bench, column) in [(&renamed, "mag_4_uc"), (&plain, "\"mag.4\"")] {
        let rows = even(bench, column);
        for (row, wanted) in rows.iter().zip(&wanted) {
            // Resampling at the rate of the log interpolates to rounding.
            assert!((row[0] - wanted).abs() < 1e-6, "{row:?} {wanted}");
        }
    }
}

#[test]
fn user_a_csv_cut_inside_its_last_number_is_reported() {
    let text = csv(&lines(60), &same, &|_, name, x| (name == "flux_d_z").then(|| format!("{x:.3}")));
    let whole = text.trim_end();
    let bench = bench("");
    let read_cut = |cut: &str| {
        fs::write(bench.path("logs/1.csv"), cut).unwrap();
        let check = bench.magline(&["check", "spec.toml"]);
        assert_eq!(check.status.code(), Some(0), "{}", stderr(&check));
        finished(&bench);
        (stderr(&check), even(&bench, "tt").len())
    };
    // Three digits are missing, and all other values of the column are longer.
    let (note, rows) = read_cut(&whole[..whole.len() - 3]);
    assert!(note.contains("1.csv: the file does not end with a newline"), "{note}");
    assert!(note.contains("of `flux_d_z` (line 181 of the file) is shorter than all others"), "{note}");
    assert_eq!(rows, 179);
    // Only the newline is missing. The row is used with a note.
    let (note, rows) = read_cut(whole);
    assert!(note.contains("may be cut short inside the last value") && rows == 180, "{note} {rows}");
    let (note, rows) = read_cut(&text);
    assert!(!note.contains("newline") && rows == 180, "{note} {rows}");
    // A row with missing columns fails its line.
    fs::write(bench.path("logs/1.csv"), whole.rsplit_once(',').unwrap().0).unwrap();
    let done = bench.run(&[]);
    assert_eq!((done.code, done.computed("even")), (1, 0), "{}", done.last);
    assert!(failures(&bench)[0].1.contains("of the file is cut short: the file ends there without a newline"));
}

#[test]
fn user_a_pipe_is_not_read_as_a_file() {
    let bench = bench("");
    fs::write(bench.path("logs/1.csv"), csv(&lines(60), &same, &|_, _, _| None)).unwrap();
    let pipe = bench.path("logs/2.csv");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let started = Instant::now();
    assert_eq!(finished(&bench).computed("even"), 3);
    bench.spec(&spec("").replace("logs/", "logs/2.csv"));
    assert!(refused(&bench).contains("logs/2.csv is a pipe, socket or device, not a regular file"));
    let info = bench.magline(&["map", "info", "logs/2.csv"]);
    assert_eq!(info.status.code(), Some(2));
    assert!(stderr(&info).contains("is a pipe, socket or device"), "{}", stderr(&info));
    assert!(started.elapsed() < Duration::from_secs(60));
}

#[test]
fn user_a_pattern_matches_in_a_folder_with_brackets() {
    let bench = Bench::new();
    let folder = bench.path("survey [2020]");
    fs::create_dir_all(folder.join("logs [a]")).unwrap();
    let text = csv(&lines(60), &same, &|_, _, _| None);
    fs::write(folder.join("logs [a]/1.csv"), &text).unwrap();
    fs::write(folder.join("1[x].csv"), &text).unwrap();
    for path in ["*.csv", "1[x].csv", "logs [a]/1.csv", "logs [a]", "logs */?.csv"] {
        fs::write(folder.join("spec.toml"), spec("").replace("logs/", path)).unwrap();
        let output = crate::support::magline(&folder, &["check", "spec.toml"]);
        assert_eq!(output.status.code(), Some(0), "{path}: {}", stderr(&output));
    }
}

#[test]
fn user_an_interrupt_of_a_simulation_takes_effect_within_a_second() {
    let bench = Bench::new();
    let path = repository().join("datasets/examples/osborne.synth.toml");
    bench.spec(&spec("").replace("logs/", &path.display().to_string()));
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["run", "spec.toml"])
        .current_dir(bench.folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while !bench.path("store/objects").is_dir() && child.try_wait().unwrap().is_none() {
        sleep(Duration::from_millis(2));
    }
    sleep(Duration::from_millis(200));
    let sent = Instant::now();
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let output = child.wait_with_output().unwrap();
    let took = sent.elapsed();
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(took < Duration::from_secs(1), "{took:?}");
}

/// Copies a sample into the folder of logs.
fn sample(bench: &Bench, name: &str) -> PathBuf {
    let from = repository().join("datasets/samples").join(name);
    let to = bench.path("logs").join(Path::new(name).file_name().unwrap());
    fs::copy(from, &to).unwrap();
    to
}

#[test]
fn user_rename_and_units_apply_to_hdf5() {
    let plain = bench("");
    sample(&plain, "magnavjl_sample/sgl_2020.h5");
    finished(&plain);
    let wanted = even(&plain, "mag_3_uc, alt");
    let changed = bench(
        "rename = { mag_3_uc = \"mag_8_uc\", utm_z = \"alt\" }\nunits = { utm_z = \"ft\" }\naccept = [\"range\"]",
    );
    sample(&changed, "magnavjl_sample/sgl_2020.h5");
    finished(&changed);
    let found = even(&changed, "mag_8_uc, alt");
    assert_eq!(found.len(), wanted.len());
    for (found, wanted) in found.iter().zip(&wanted) {
        assert!(found[0] == wanted[0] && (found[1] - 0.3048 * wanted[1]).abs() < 1e-9, "{found:?} {wanted:?}");
    }
    changed.spec(&spec("rename = { mag_3_u = \"mag_8_uc\" }"));
    let message = refused(&changed);
    assert!(message.contains("there is no column `mag_3_u` to rename") && message.contains("`mag_3_uc`"), "{message}");
}

#[test]
fn user_required_columns_of_a_format_can_be_renamed() {
    for (name, own, ours, mark) in
        [("magnavjl_sample/sgl_2020.h5", "tu", "tt", "\0"), ("simple_magnav/xyz.csv", "lau", "lat", ",")]
    {
        let plain = bench("");
        sample(&plain, name);
        finished(&plain);
        let renamed = bench(&format!("rename = {{ {own} = \"{ours}\" }}"));
        let path = sample(&renamed, name);
        let mut bytes = fs::read(&path).unwrap();
        let (from, to) = (format!("{mark}{ours}{mark}"), format!("{mark}{own}{mark}"));
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        fs::write(&path, bytes).unwrap();
        finished(&renamed);
        // `vn` is derived from the position, so its columns were known before.
        assert_eq!(even(&plain, "tt, lat, vn"), even(&renamed, "tt, lat, vn"), "{name}");
    }
}

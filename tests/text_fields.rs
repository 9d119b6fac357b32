//! Text files, clocks and units of loggers and other programs.

use std::{fs, process::Output, sync::Arc};

use arrow_array::{
    ArrayRef, Float32Array, Float64Array, Int64Array, RecordBatch, StringArray, TimestampMicrosecondArray,
};
use tempfile::TempDir;

use crate::support::{magline, numbers, read, stderr, stdout, texts, write};

const HEAD: &str = "/ XYZ EXPORT [05/03/2019]\n/\n/ X Y UTC LON LAT ALT MAG\n/== == === === === === ===\n";

/// Survey of six lines and three ties, 20 nT above the lines. Tie numbers start at `first_tie`.
fn survey(first_tie: usize) -> String {
    let row = |x: f64, y: f64, up_nt: f64| {
        let mag = 100.0 * (x / 1500.0).sin() * (y / 1100.0).cos() + up_nt;
        format!("{} {} 0 0 0 500.0 {mag:.3}\n", 500_000.0 + x, 7_600_000.0 + y)
    };
    let mut text = HEAD.to_owned();
    for line in 0..6 {
        text += &format!("Line {}\n", line + 1);
        text.extend((0..81).map(|i| row(50.0 * f64::from(i), 400.0 * f64::from(line), 0.0)));
    }
    for tie in 0..3usize {
        text += &format!("Tie {}\n", first_tie + tie);
        text.extend((0..41).map(|i| row(500.0 + 1500.0 * tie as f64, 50.0 * f64::from(i), 20.0)));
    }
    text
}

fn gridded(folder: &TempDir, files: &[&str]) -> Output {
    let more = ["--x", "X", "--y", "Y", "--height", "ALT", "--value", "MAG", "--epsg", "32754", "-o", "map.parquet"];
    let method = ["--spacing", "100", "--method", "minimum_curvature", "--level-lines=0"];
    magline(folder.path(), &[&["map", "grid"][..], files, &more, &method].concat())
}

#[test]
fn user_a_tie_with_the_number_of_a_line_is_a_separate_line() {
    let folder = TempDir::new().unwrap();
    let expected = ["15\n", "9 lines, including 3 ties", "ties: all shifted by -20.00 nT"];
    for first_tie in [1, 9001] {
        fs::write(folder.path().join("survey.xyz"), survey(first_tie)).unwrap();
        let output = gridded(&folder, &["survey.xyz"]);
        let text = stdout(&output);
        assert!(expected.iter().all(|words| text.contains(words)), "{text}{}", stderr(&output));
        assert_eq!(stderr(&output).contains("`Tie 1` is named T1"), first_tie == 1, "{}", stderr(&output));
    }
    // Line types persist across files.
    let text = survey(1);
    let at = text.find("Tie 1").unwrap();
    fs::write(folder.path().join("lines.xyz"), &text[..at]).unwrap();
    fs::write(folder.path().join("ties.xyz"), format!("{HEAD}{}", &text[at..])).unwrap();
    let output = gridded(&folder, &["lines.xyz", "ties.xyz"]);
    assert!(expected.iter().all(|words| stdout(&output).contains(words)), "{}{}", stdout(&output), stderr(&output));
}

/// Output of `magline run` on a spec with one table of flights and one column `out`.
fn derived(folder: &TempDir, file: &str, table: &str, out: &str) -> Output {
    let spec = format!(
        "name = \"x\"\nstore = \"store\"\n[tables.f]\npath = {file:?}\n{table}\n[[stages]]\nname = \"s\"\n\
         stage = \"derive\"\n\
         input = \"f\"\ncolumns = {{ out = {out:?} }}\n"
    );
    fs::write(folder.path().join("spec.toml"), spec).unwrap();
    magline(folder.path(), &["run", "spec.toml"])
}

/// Number of rows of each line of the derived table.
fn lines(folder: &TempDir) -> Vec<(String, usize)> {
    let mut found: Vec<(String, usize)> = vec![];
    for name in texts(&read(&folder.path().join("store/tables/x/s")), "line") {
        match found.iter_mut().find(|(known, _)| *known == name) {
            Some((_, n)) => *n += 1,
            None => found.push((name, 1)),
        }
    }
    found.sort();
    found
}

#[test]
fn user_every_line_record_of_an_xyz_file_begins_a_line() {
    let folder = TempDir::new().unwrap();
    let mut text = HEAD.to_owned();
    for (i, record) in ["Line 1010", "Tie 1010", "Base 1", "TEST 2", "Foo 7", "random 3"].into_iter().enumerate() {
        text += &format!("{record}\n");
        let row = |k: usize| format!("0 0 {:.1} 140.5{k:02} -22.0 500 5200{k:02}.0\n", 36_000 + 100 * i + k);
        text.extend((0..12).map(row).map(|row| row.replace("5200", "520")));
    }
    fs::write(folder.path().join("a.xyz"), text + "\x1a").unwrap();
    let table =
        "flight = \"F\"\nrename = { UTC = \"tt\", LON = \"lon\", LAT = \"lat\", ALT = \"alt\", MAG = \"mag_1_uc\" }";
    let output = derived(&folder, "a.xyz", table, "mag_1_uc - 52000");
    let expected = ["1", "1010", "2", "3", "T1010"].map(|name| (name.to_owned(), 12));
    assert_eq!(lines(&folder), expected, "{}", stderr(&output));
    let printed = stdout(&output) + &stderr(&output);
    assert!(printed.contains("line Foo 7") && printed.contains("`Foo 7` is not a line record"), "{printed}");
}

/// Time `s` past midnight as hhmmss digits.
fn hhmmss(s: f64) -> f64 {
    let tenths = (s * 10.0).round() % 864_000.0;
    let (hours, minutes) = ((tenths / 36_000.0).floor(), (tenths / 600.0).floor() % 60.0);
    (1e5 * hours + 1e3 * minutes + tenths % 600.0) / 10.0
}

/// CSV at 10 Hz from `from_s`, with times written by `clock`.
fn log(from_s: f64, rows: usize, clock: impl Fn(f64) -> String) -> String {
    let row = |i: usize| format!("F,1,{},{}\n", clock(from_s + 0.1 * i as f64), 52_000.0 + (i as f64 * 0.7).sin());
    "flight,line,tt,mag_1_uc\n".to_owned() + &(0..rows).map(row).collect::<String>()
}

#[test]
fn user_a_clock_in_digits_is_rejected_as_seconds_and_read_by_a_mapping() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mapping = |time: &str| {
        let text = format!(
            "about = \"x\"\nflight = \"F\"\nline = \"1\"\n[tables.m]\ntime = {time}\n[tables.m.columns]\n\
             mag_1_uc = {{ from = \"mag_1_uc\", unit = \"nT\" }}\n"
        );
        fs::write(path("m.toml"), text).unwrap();
    };
    let ingest = |more: &[&str]| magline(folder.path(), &[&["ingest", "a.csv", "--to", "out"][..], more].concat());
    for from_s in [36_000.0, 401.5, 86_390.0] {
        fs::write(path("a.csv"), log(from_s, 1_200, |s| hhmmss(s).to_string())).unwrap();
        let output = ingest(&[]);
        assert_eq!(output.status.code(), Some(2));
        let printed = stderr(&output);
        assert!(
            printed.contains("hhmmss") && printed.contains("clock = \"text\"") && printed.contains("%H%M%S%.f"),
            "{printed}"
        );
        assert!(!path("out/a.parquet").exists());
        let run = derived(&folder, "a.csv", "", "mag_1_uc + 0");
        assert!(stderr(&run).contains("hhmmss") && run.status.code() != Some(0), "{}", stderr(&run));
        mapping("{ from = \"tt\", clock = \"day\", unit = \"s\", zone = \"+02:00\" }");
        assert!(stderr(&ingest(&["--mapping", "m.toml"])).contains("hhmmss"));
        mapping("{ from = \"tt\", clock = \"text\", format = \"%H%M%S%.f\", date = \"2019-03-05\" }");
        let output = ingest(&["--mapping", "m.toml", "--replace"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let tt = numbers(&read(&path("out")), "tt");
        assert!(tt.iter().enumerate().all(|(i, tt)| (tt - from_s - 0.1 * i as f64).abs() < 1e-6), "{from_s}: {tt:?}");
        fs::remove_dir_all(path("out")).unwrap();
    }
}

#[test]
fn user_a_time_zone_for_times_with_a_zone_is_rejected() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let at = |i: i64| 1_572_044_398_000_000 + 100_000 * i;
    let mag: ArrayRef = Arc::new((0..40).map(|i| 52_000.0 + f64::from(i)).collect::<Float64Array>());
    let times: TimestampMicrosecondArray = (0..40).map(|i| Some(at(i))).collect();
    let typed: ArrayRef = Arc::new(times.with_timezone("Europe/Rome"));
    let text = |i: i64| format!("2019-10-26T00:59:{:02}.000+02:00", i);
    let texts: ArrayRef = Arc::new((0..40).map(|i| Some(text(i))).collect::<StringArray>());
    for (when, clock) in [(typed, "unix"), (texts, "text")] {
        let batch = RecordBatch::try_from_iter([("when", when), ("mag_1_uc", mag.clone())]).unwrap();
        write(&path("a.parquet"), &[batch]);
        let ingest = |zone: &str| {
            let text = format!(
                "about = \"x\"\nflight = \"F\"\nline = \"1\"\n[tables.m]\n\
                 time = {{ from = \"when\", clock = \"{clock}\"{zone} }}\n\
                 [tables.m.columns]\nmag_1_uc = {{ from = \"mag_1_uc\", unit = \"nT\" }}\n"
            );
            fs::write(path("m.toml"), text).unwrap();
            magline(folder.path(), &["ingest", "a.parquet", "--to", "out", "--mapping", "m.toml", "--replace"])
        };
        let output = ingest(", zone = \"+02:00\"");
        let printed = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{printed}");
        assert!(printed.contains("`zone` has no effect") && printed.contains("remove `zone`"), "{printed}");
        let output = ingest("");
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let tt = numbers(&read(&path("out")), "tt")[0];
        assert!((tt - if clock == "unix" { 82_798.0 } else { 82_740.0 }).abs() < 1e-6, "{tt}");
    }
}

#[test]
fn user_units_in_names_are_converted_or_rejected() {
    let folder = TempDir::new().unwrap();
    let log = |name: &str, value: f64| {
        let row = |i: usize| format!("F,1,{:.1},{value},52000\n", 36_000.0 + 0.1 * i as f64);
        let text = format!("flight,line,tt,{name},mag_1_uc\n") + &(0..20).map(row).collect::<String>();
        fs::write(folder.path().join("a.csv"), text).unwrap();
    };
    let out = |name: &str, ours: &str| {
        derived(&folder, "a.csv", &format!("rename = {{ {name:?} = {ours:?} }}"), &format!("{ours} + 0"))
    };
    for (name, ours, value, expected) in [
        ("Alt_ftUS", "alt", 1640.42, 1640.42 * 1200.0 / 3937.0),
        ("Alt (US survey foot)", "alt", 1000.0, 1.2e6 / 3937.0),
        ("alt_us_ft", "alt", 1000.0, 1.2e6 / 3937.0),
        ("vn_fps", "vn", 100.0, 30.48),
        ("vn_kts", "vn", 100.0, 51.444_444_444),
        ("vn km/hr", "vn", 36.0, 10.0),
    ] {
        log(name, value);
        let output = out(name, ours);
        assert_eq!(output.status.code(), Some(0), "{name}: {}", stderr(&output));
        let found = numbers(&read(&folder.path().join("store/tables/x/s")), "out")[0];
        assert!((found - expected).abs() < 1e-6 * expected, "{name}: {found}");
    }
    for (name, ours) in [("Alt_fathoms", "alt"), ("alt_kft", "alt"), ("lat_dms", "lat"), ("vn_ft/day", "vn")] {
        log(name, 10.0);
        let output = out(name, ours);
        let printed = stderr(&output);
        assert!(
            output.status.code() == Some(2) && printed.contains("does not convert") && printed.contains("units"),
            "{name}: {printed}"
        );
    }
}

#[test]
fn user_velocities_in_another_unit_than_the_positions_are_rejected() {
    let folder = TempDir::new().unwrap();
    let row = |i: usize| {
        format!("F,1,{:.1},-22,{:.8},500,0,229.659,52000\n", 36_000.0 + 0.1 * i as f64, 140.0 + 6.782e-5 * i as f64)
    };
    let text = "flight,line,tt,lat,lon,alt,vn,ve,mag_1_uc\n".to_owned() + &(0..200).map(row).collect::<String>();
    fs::write(folder.path().join("a.csv"), text).unwrap();
    let output = magline(folder.path(), &["ingest", "a.csv", "--to", "out"]);
    let printed = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{printed}");
    assert!(printed.contains("in ft/s, the velocities agree") && printed.contains("\"ve\" = \"ft/s\""), "{printed}");
}

#[test]
fn user_identifiers_in_single_precision_have_their_shortest_text() {
    let folder = TempDir::new().unwrap();
    let n = 40;
    let column =
        |f: &dyn Fn(f64) -> f64| Arc::new((0..n).map(|i| f(f64::from(i))).collect::<Float64Array>()) as ArrayRef;
    let batch = RecordBatch::try_from_iter([
        ("flight", Arc::new(Int64Array::from(vec![7; 40])) as ArrayRef),
        ("line", Arc::new(Float32Array::from(vec![1006.04; 40]))),
        ("tt", column(&|i| 36_000.0 + 0.1 * i)),
        ("mag_1_uc", column(&|i| 52_000.0 + (0.7 * i).sin())),
    ]);
    write(&folder.path().join("a.parquet"), &[batch.unwrap()]);
    let output = derived(&folder, "a.parquet", "", "mag_1_uc + 0");
    assert_eq!(lines(&folder), [("1006.04".to_owned(), 40)], "{}", stderr(&output));
}

#[test]
fn user_a_dos_end_of_file_mark_ends_a_text() {
    let folder = TempDir::new().unwrap();
    let text = log(36_000.0, 40, |s| format!("{s:.1}")).replace('\n', "\r\n");
    for text in [text.clone() + "\x1a", text.trim_end().to_owned() + "\x1a", text + "\x1a\x1a\x1a\x1a"] {
        fs::write(folder.path().join("a.csv"), &text).unwrap();
        let output = magline(folder.path(), &["ingest", "a.csv", "--to", "out", "--replace"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        assert_eq!(numbers(&read(&folder.path().join("out")), "tt").len(), 40);
    }
}

#[test]
fn user_a_line_name_of_any_length_is_shown() {
    let folder = TempDir::new().unwrap();
    let text = log(36_000.0, 20, |s| format!("{s:.1}")).replace("F,1,", &format!("F,{},", "L".repeat(70_000)));
    fs::write(folder.path().join("a.csv"), text).unwrap();
    let output = magline(folder.path(), &["ingest", "a.csv", "--to", "out"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

//! Tables leave a store as files that other programs read.

use std::{fs, process::Command};

use arrow_array::{Array, cast::AsArray, types::Float64Type};

use crate::support::{Bench, numbers, read, stderr, stdout};

const POINT: &str = "mag = 'mag_4_uc' AND vector = 'flux_a' AND lambda = 0.025";

fn ran() -> Bench {
    let bench = Bench::new();
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

fn exported(bench: &Bench, args: &[&str]) {
    let output = bench.magline(&[&["export"], args].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(stdout(&output), "");
}

/// Rows of a query, by way of a Parquet file of `magline sql`.
fn queried(bench: &Bench, query: &str) -> Vec<arrow_array::RecordBatch> {
    let folder = bench.path("answer");
    fs::create_dir_all(&folder).unwrap();
    let output = bench.magline(&["sql", query, "--format", "parquet", "-o", "answer/rows.parquet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    read(&folder)
}

/// Column of a CSV file without quotes.
fn csv_column(text: &str, name: &str) -> Vec<f64> {
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let at = rows.next().unwrap().iter().position(|n| *n == name).unwrap_or_else(|| panic!("no {name}"));
    rows.map(|row| row[at].parse().unwrap_or(f64::NAN)).collect()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

#[test]
fn user_a_list_is_exported_as_one_column_per_entry_with_the_same_values() {
    let bench = ran();
    exported(&bench, &["small.terms", "-o", "terms.csv", "--where", "vector = 'flux_d'", "--line", "1.01,2.02"]);
    let text = fs::read_to_string(bench.path("terms.csv")).unwrap();
    let query = "SELECT * FROM small.terms WHERE vector = 'flux_d' AND line IN ('1.01', '2.02') ORDER BY line, tt";
    let rows = queried(&bench, query);
    assert_eq!(text.lines().count(), 1 + 700 + 500);
    for name in ["tt", "mag_4_uc", "flux_d_x"] {
        assert_eq!(bits(&csv_column(&text, name)), bits(&numbers(&rows, name)), "{name}");
    }
    let lists = rows.iter().map(|batch| batch.column_by_name("tl").unwrap().as_fixed_size_list().clone());
    let lists: Vec<_> = lists.collect();
    let size = lists[0].value_length();
    assert!(size > 10 && !text.contains(&format!("tl_{}", size + 1)), "{size}");
    for entry in 1..=size {
        let of = |row: arrow_array::ArrayRef| row.as_primitive::<Float64Type>().value(entry as usize - 1);
        let expected: Vec<f64> = lists.iter().flat_map(|l| (0..l.len()).map(|i| of(l.value(i)))).collect();
        assert_eq!(bits(&csv_column(&text, &format!("tl_{entry}"))), bits(&expected), "tl_{entry}");
    }
}

#[test]
fn user_an_exported_parquet_file_keeps_units_and_values() {
    let bench = ran();
    fs::create_dir(bench.path("out")).unwrap();
    exported(&bench, &["small.clean", "-o", "out/clean.parquet", "--where", POINT]);
    let rows = read(&bench.path("out"));
    let expected = queried(&bench, &format!("SELECT * FROM small.clean WHERE {POINT} ORDER BY flight, line, tt"));
    assert_eq!(bits(&numbers(&rows, "mag_c")), bits(&numbers(&expected, "mag_c")));
    let schema = rows[0].schema();
    let unit = |name: &str| schema.field_with_name(name).unwrap().metadata().get("unit").cloned();
    assert_eq!((unit("mag_c").as_deref(), unit("tt").as_deref()), (Some("nT"), Some("s")));
}

#[test]
fn user_an_exported_xyz_file_is_read_back_with_the_same_lines_and_values() {
    let bench = ran();
    exported(&bench, &["small.clean", "-o", "clean.xyz", "--where", POINT]);
    let text = fs::read_to_string(bench.path("clean.xyz")).unwrap();
    let names: Vec<&str> = text.lines().filter(|line| line.starts_with("Line ")).collect();
    assert_eq!(names, ["Line 1.01", "Line 1.02", "Line 2.01", "Line 2.02"]);
    assert!(text.contains("//Flight 2\n") && text.starts_with("/ units: "), "{}", &text[..200]);
    fs::create_dir(bench.path("again")).unwrap();
    let spec = "name = \"again\"\nstore = \"store2\"\n[tables.flights]\npath = \"clean.xyz\"\n[[stages]]\n\
                name = \"same\"\nstage = \"derive\"\ninput = \"flights\"\ncolumns = { same = \"mag_c\" }\n";
    fs::write(bench.path("again.toml"), spec).unwrap();
    let output = bench.magline(&["run", "again.toml"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let output = bench.magline(&[
        "sql",
        "SELECT line, tt, same FROM again.same ORDER BY line, tt",
        "--store",
        "store2",
        "--format",
        "csv",
    ]);
    let expected = bench.magline(&[
        "sql",
        &format!("SELECT line, tt, mag_c AS same FROM small.clean WHERE {POINT} ORDER BY line, tt"),
        "--format",
        "csv",
    ]);
    assert_eq!(stdout(&output), stdout(&expected));
    assert_eq!(stdout(&output).lines().count(), 1 + 2 * (700 + 500));
}

#[test]
fn user_the_header_of_a_csv_file_names_the_units_on_request() {
    let bench = ran();
    exported(&bench, &["small.clean", "-o", "plain.csv", "--where", POINT]);
    exported(&bench, &["small.clean", "-o", "units.csv", "--where", POINT, "--units"]);
    let [plain, units] = ["plain.csv", "units.csv"].map(|name| fs::read_to_string(bench.path(name)).unwrap());
    let header = |text: &str| text.lines().next().unwrap().to_owned();
    assert!(header(&plain).contains(",mag_c,"), "{}", header(&plain));
    assert!(header(&units).contains(",mag_c [nT],") && header(&units).contains("tt [s]"), "{}", header(&units));
    assert!(plain.lines().skip(1).eq(units.lines().skip(1)));
    let output = bench.magline(&["export", "small.clean", "-o", "x.parquet", "--units"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("`--units` requires the extension .csv"), "{}", stderr(&output));
}

#[test]
fn user_a_table_that_a_format_cannot_store_is_rejected_and_the_old_file_is_kept() {
    let bench = ran();
    fs::write(bench.path("old.xyz"), "mine").unwrap();
    let refused = |args: &[&str], said: &str| {
        let output = bench.magline(&[&["export"], args].concat());
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(said), "{args:?}: {}", stderr(&output));
    };
    refused(&["small.clean", "-o", "old.xyz"], "has several values");
    refused(&["small.clean", "-o", "x.xlsx"], ".csv, .parquet, .xyz, .gpkg, .mat");
    refused(&["small.clean", "-o", "noending"], "without an extension");
    refused(&["clean", "-o", "x.csv"], "PIPELINE.TABLE");
    refused(&["small.cleam", "-o", "x.csv"], "small.clean");
    refused(&["small.clean", "-o", "x.csv", "--where", "true; SELECT 1"], "");
    refused(&["small.clean", "-o", "x.csv", "--where", "no_column = 1"], "no_column");
    refused(&["small.clean", "-o", "store/x.csv"], "store");
    assert_eq!(fs::read_to_string(bench.path("old.xyz")).unwrap(), "mine");
    let left: Vec<String> = fs::read_dir(bench.folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .filter(|name| name.contains(".tmp") || name.starts_with("x."))
        .collect();
    assert_eq!(left, [""; 0]);
}

#[test]
fn user_a_query_in_a_subfolder_finds_the_store_in_the_folder_above() {
    let bench = ran();
    fs::create_dir(bench.path("notes")).unwrap();
    let output = crate::support::magline(&bench.path("notes"), &["sql", "SELECT count(*) AS n FROM small.clean"]);
    assert!(output.status.success() && stdout(&output).contains("19200"), "{}", stderr(&output));
    assert!(stderr(&output).contains("../store"), "{}", stderr(&output));
    // A command that removes does not look in the folder above.
    let output = crate::support::magline(&bench.path("notes"), &["rm", "small"]);
    assert_eq!(output.status.code(), Some(2), "{}", stdout(&output));
}

#[test]
fn user_a_terminal_shows_the_first_rows_of_a_query_and_the_next_command_of_a_run() {
    let bench = ran();
    let on_terminal = |command: &str| {
        let line = format!("{} {command}", env!("CARGO_BIN_EXE_magline"));
        let mut script = Command::new("script");
        let output = script.args(["-qec", &line, "/dev/null"]).current_dir(bench.folder.path()).output().unwrap();
        stdout(&output)
    };
    let shown = on_terminal("sql \"SELECT tt FROM small.clean\"");
    assert!(shown.contains("`--max-rows 19200` shows all rows"), "{shown}");
    assert!(shown.lines().count() < 60, "{shown}");
    let shown = on_terminal("run spec.toml");
    assert!(shown.contains("next: magline report spec.toml -o small.html"), "{shown}");
    // Other output is complete.
    let output = bench.magline(&["sql", "SELECT tt FROM small.clean"]);
    assert!(stdout(&output).lines().count() > 19_200);
    assert!(!bench.run(&[]).stderr.contains("next:"));
}

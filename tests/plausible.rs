//! An impossible value is an error with a likely cause. Dropouts of a sensor are missing values and are counted.

use std::fs;

use arrow_array::RecordBatch;

use crate::support::{
    Bench, Done, batch, changed, line_of, numbers, read, stderr, stdout, texts, with_keys, without, write,
};

const SPEC: &str = r#"
name  = "small"
store = "store"

[tables.flights]
path = "flights/"

[[stages]]
name    = "even"
stage   = "resample"
input   = "flights"
rate_hz = 10.0
"#;

/// Line with magnetometers that read the total field.
fn total(line: &str, rows: usize) -> RecordBatch {
    ["mag_1_c", "mag_4_uc", "mag_5_uc"]
        .iter()
        .fold(line_of("1", line, rows), |b, column| changed(&b, column, |_, x| x + 48_000.0))
}

/// Line of [`total`] with velocities that agree with the positions.
fn moving(line: &str, rows: usize) -> RecordBatch {
    let flight = total(line, rows);
    let column = |name: &str| numbers(std::slice::from_ref(&flight), name);
    let rate = |x: &[f64], i: usize| (x[(i + 1).min(rows - 1)] - x[i.saturating_sub(1)]) / 0.2;
    let (lat, lon) = (column("lat"), column("lon"));
    let more = [
        ("vn", (0..rows).map(|i| rate(&lat, i) * 111_130.0).collect::<Vec<f64>>()),
        ("ve", (0..rows).map(|i| rate(&lon, i) * 78_850.0).collect()),
    ];
    let mut columns: Vec<(String, Vec<f64>)> =
        flight.schema().fields().iter().skip(2).map(|f| (f.name().clone(), column(f.name()))).collect();
    columns.extend(more.into_iter().map(|(name, values)| (name.to_owned(), values)));
    let columns: Vec<(&str, Vec<f64>)> = columns.iter().map(|(n, v)| (n.as_str(), v.clone())).collect();
    with_keys("1", line, &batch(&columns))
}

/// The batch with a column under another name.
fn renamed(flight: &RecordBatch, from: &str, to: &str) -> RecordBatch {
    let mut schema = arrow_schema::SchemaBuilder::from(flight.schema().fields());
    let at = flight.schema().index_of(from).unwrap();
    *schema.field_mut(at) = std::sync::Arc::new(arrow_schema::Field::new(to, arrow_schema::DataType::Float64, true));
    RecordBatch::try_new(std::sync::Arc::new(schema.finish()), flight.columns().to_vec()).unwrap()
}

/// Bench with one file of these lines and with additional keys in the table of the spec.
fn bench(lines: &[RecordBatch], more: &str) -> Bench {
    let bench = Bench::new();
    fs::remove_file(bench.path("flights/2.parquet")).unwrap();
    write(&bench.path("flights/1.parquet"), lines);
    bench.spec(&SPEC.replace("path = \"flights/\"", &format!("path = \"flights/\"\n{more}")));
    bench
}

fn errors(bench: &Bench) -> Vec<String> {
    texts(&read(&bench.path("store/tables/small/failures")), "error")
}

/// Rows of the table `quality`: line, column, finding, n, first row, value.
fn quality(bench: &Bench) -> Vec<(String, String, String, f64, f64, f64)> {
    let table = read(&bench.path("store/tables/small/quality"));
    let [lines, columns, findings] = ["line", "column_name", "finding"].map(|c| texts(&table, c));
    let [n, rows, values] = ["n", "first_row", "value"].map(|c| numbers(&table, c));
    (0..lines.len())
        .map(|i| (lines[i].clone(), columns[i].clone(), findings[i].clone(), n[i], rows[i], values[i]))
        .collect()
}

/// Single failure of a run and of a check for a flight of one line. Asserts that nothing is computed.
fn refused(lines: &[RecordBatch], more: &str) -> String {
    let bench = bench(lines, more);
    let done = bench.run(&[]);
    assert_eq!((done.code, done.total("computed")), (1, 0), "{}", done.stderr);
    let errors = errors(&bench);
    assert_eq!(errors.len(), 1, "{errors:?}");
    let check = bench.magline(&["check", "spec.toml"]);
    assert_eq!(check.status.code(), Some(2), "{}", stdout(&check));
    let printed = stderr(&check);
    let what = errors[0].split(" (").next().unwrap();
    assert!(printed.contains(what) && printed.contains("--> spec.toml:6:8"), "{what}\n{printed}");
    // With `accept`, the same values are accepted.
    let accepted = format!("accept = [\"range\"]\n{more}");
    bench.spec(&SPEC.replace("path = \"flights/\"", &format!("path = \"flights/\"\n{accepted}")));
    assert_eq!(bench.magline(&["check", "spec.toml"]).status.code(), Some(0));
    let done = bench.run(&[]);
    assert_eq!((done.code, done.total("computed")), (0, 1), "{}", done.stderr);
    assert!(done.last["quality"].as_u64().unwrap() > 0);
    errors[0].clone()
}

fn each(flight: &RecordBatch, columns: &[&str], change: impl Fn(f64) -> f64) -> RecordBatch {
    columns.iter().fold(flight.clone(), |b, column| changed(&b, column, |_, x| change(x)))
}

fn contains(printed: &str, words: &[&str]) {
    for word in words {
        assert!(printed.contains(word), "{word} is not in\n{printed}");
    }
}

#[test]
fn user_a_field_in_another_unit_is_rejected_with_that_unit() {
    let flight = total("1.01", 300);
    // 48,000 nT in a column declared as microtesla.
    let declared = renamed(&flight, "mag_4_uc", "cabin_uT");
    let printed = refused(&[declared], "rename = { \"cabin_uT\" = \"mag_4_uc\" }");
    contains(
        &printed,
        &[
            "flights/1.parquet, flight 1, line 1.01, column `mag_4_uc`, row 0: 4",
            "nT is not a total field of the earth (15,000 to 80,000 nT); this applies to 300 of 300 values",
            "if the value is in nT, it is 4",
            "set `units = { \"cabin_uT\" = \"nT\" }`",
            "`accept = [\"range\"]` accepts the values unchanged",
        ],
    );
    for (factor, unit) in [(1e-9, "T"), (1e-3, "uT"), (1e-2, "mgauss"), (1e-5, "gauss")] {
        let printed = refused(&[each(&flight, &["mag_4_uc"], |x| x * factor)], "");
        contains(
            &printed,
            &["column `mag_4_uc`, row 0", &format!("if the value is in {unit}, it is 4"), &format!("= \"{unit}\" }}`")],
        );
        // One mistake of a vector magnetometer gives one message.
        let printed = refused(&[each(&flight, &["flux_a_x", "flux_a_y", "flux_a_z"], |x| x * factor)], "");
        contains(&printed, &["column `flux_a_x`", "vector measurement", &format!("\"flux_a_z\" = \"{unit}\"")]);
    }
    let printed = refused(&[each(&flight, &["flux_a_x", "flux_a_y", "flux_a_z"], |x| x * 1e3)], "");
    contains(&printed, &["column `flux_a_x`", "vector measurement"]);
}

#[test]
fn user_impossible_positions_are_rejected() {
    let flight = total("1.01", 300);
    for (column, value, expected_text) in [
        ("lat", 95.0, "95 deg is not a latitude (-90 to 90 deg)"),
        ("lat", -100.0, "-100 deg is not a latitude"),
        ("lon", 500.0, "500 deg is not a longitude (-180 to 360 deg)"),
        ("ins_lon", 1e300, "1e300 deg is not a longitude"),
        ("alt", 2e5, "200,000 m is not a plausible aircraft height (-1000 to 100,000 m)"),
    ] {
        // One impossible position is enough.
        let printed = refused(&[changed(&flight, column, |i, x| if i == 123 { value } else { x })], "");
        contains(
            &printed,
            &["flights/1.parquet, flight 1, line 1.01", &format!("column `{column}`, row 123: {expected_text}")],
        );
    }
    let nmea = changed(&flight, "lat", |i, _| 2603.0 + 0.001 * i as f64);
    contains(&refused(&[nmea], ""), &["2603 deg is not a latitude", "(NMEA ddmm.mm), it is 26.05 deg"]);
    let two_digits = with_keys("1", "1.01", &batch(&[("tt", vec![1.0, 2.0]), ("year", vec![20.0, 20.0])]));
    contains(
        &refused(&[two_digits], ""),
        &["20 is not a year of a flight (1900 to 2100)", "write the year with four digits, 2020"],
    );
    let unix = changed(&flight, "tt", |_, t| t + 1.7e9);
    contains(&refused(&[unix], ""), &["column `tt`", "a Unix time, it is", "s past midnight"]);
}

#[test]
fn user_radians_are_detected_from_the_ins_the_velocities_or_the_speed() {
    let radians = |b: &RecordBatch| each(b, &["lat", "lon"], f64::to_radians);
    let expected_text = "set `units = { \"lat\" = \"rad\", \"lon\" = \"rad\" }`";
    let ins = radians(&total("1.01", 600));
    let printed = refused(&[ins], "");
    contains(&printed, &["column `lat`, row 0: the INS at 44.9", "km from the position 0.78", expected_text]);
    let no_ins = |b: RecordBatch| ["ins_lat", "ins_lon", "ins_alt"].iter().fold(b, |b, c| without(&b, c));
    contains(
        &refused(&[radians(&no_ins(moving("1.01", 600)))], ""),
        &["column `lat`", "probably in radians", expected_text],
    );
    contains(&refused(&[radians(&no_ins(total("1.01", 600)))], ""), &["column `lat`", "Gulf of Guinea", expected_text]);
    let far = changed(&total("1.01", 300), "ins_lat", |i, x| if i > 100 { x + 9.0 } else { x });
    contains(&refused(&[far], ""), &["column `ins_lat`, row 101", "is 1001 km from the position"]);
}

#[test]
fn user_velocities_and_heights_in_another_unit_are_rejected() {
    let flight = moving("1.01", 600);
    assert_eq!(bench(std::slice::from_ref(&flight), "").run(&[]).code, 0);
    for (factor, unit) in [(3.6, "km/h"), (1.0 / 0.514_444, "kn"), (1.0 / 0.3048, "ft/s")] {
        let printed = refused(&[each(&flight, &["vn", "ve"], |x| x * factor)], "");
        contains(
            &printed,
            &["the positions move at", &format!("`units = {{ \"vn\" = \"{unit}\", \"ve\" = \"{unit}\" }}`")],
        );
    }
    contains(&refused(&[each(&flight, &["ve"], |x| -x)], ""), &["the change in longitude have opposite signs"]);
    let feet = each(&flight, &["alt"], |x| x / 0.3048);
    let printed = refused(&[renamed(&feet, "alt", "height")], "rename = { \"height\" = \"alt\" }");
    contains(
        &printed,
        &["column `alt`", "`alt` and `ins_alt` are 684 m apart", "set `units = { \"height\" = \"ft\" }`"],
    );
    // The heights are 487 m apart and would agree if 700 were in feet, but both rise together.
    let rising = |from: f64| move |i: usize, _: f64| from + 20.0 * (0.05 * i as f64).sin();
    let flight = changed(&changed(&flight, "alt", rising(700.0)), "ins_alt", rising(213.0));
    assert_eq!(bench(&[flight], "").run(&[]).code, 0);
}

#[test]
fn user_spikes_infinities_and_dropouts_are_missing_and_counted() {
    let flight = changed(&total("1.01", 400), "mag_4_uc", |i, x| match i {
        7 => 1e300,
        8 => f64::INFINITY,
        9 => 0.0,
        10 => f64::NAN,
        11 => 5.0,
        _ => x,
    });
    let flight = changed(&flight, "mag_5_uc", |_, _| 50_123.0);
    let flight = ["flux_a_x", "flux_a_y", "flux_a_z"]
        .iter()
        .fold(flight, |b, c| changed(&b, c, |i, x| if i == 20 { 0.0 } else { x }));
    let bench = bench(&[flight, total("1.02", 300)], "");
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let row = |column: &str, finding: &str, n: f64, first: f64, value: f64| {
        ("1.01".to_owned(), column.to_owned(), finding.to_owned(), n, first, value)
    };
    let found = quality(&bench);
    let expected = [
        row("mag_4_uc", "missing", 1.0, 10.0, f64::NAN),
        row("mag_4_uc", "infinite", 1.0, 8.0, f64::NAN),
        row("mag_4_uc", "zero_reading", 1.0, 9.0, 0.0),
        row("mag_4_uc", "impossible", 2.0, 7.0, 1e300),
        row("mag_5_uc", "constant", 400.0, 0.0, 50_123.0),
        row("flux_a", "impossible", 1.0, 20.0, 0.0),
    ];
    let spelt = |rows: &[(String, String, String, f64, f64, f64)]| format!("{rows:?}");
    assert_eq!(spelt(&found), spelt(&expected));
    // Samples 7 to 11 are missing. The gap of 0.6 s is bridged, so all outputs are plausible total fields.
    let even = read(&bench.path("store/tables/small/even"));
    assert!(numbers(&even, "mag_4_uc").iter().all(|x| (47_000.0..49_000.0).contains(x)));
    let output = bench.magline(&["sql", "SELECT sum(n) AS n FROM small.quality", "--format", "csv"]);
    assert_eq!(stdout(&output), "n\n406\n", "{}", stderr(&output));
    // A run from the store reports the same findings in one line.
    let again = bench.magline(&["run", "spec.toml"]);
    assert!(stderr(&again).contains("data quality: 6 findings in 1 line; see the table `small.quality`"));
    assert_eq!(spelt(&quality(&bench)), spelt(&expected));
    // Impossible values on a fifth of the line do not count as spikes.
    let bad = changed(&total("1.01", 400), "mag_4_uc", |i, x| if i % 5 == 0 { 9e5 } else { x });
    contains(
        &refused(&[bad], ""),
        &["column `mag_4_uc`, row 0: 900,000 nT", "this applies to 80 of 400 values", "correct the file"],
    );
}

#[test]
fn user_a_magnetometer_that_stops_in_flight_is_a_finding() {
    let flight = total("1.01", 400);
    let of = |column: &str| numbers(std::slice::from_ref(&flight), column);
    let (stop, held) = (of("mag_4_uc")[100], of("mag_5_uc"));
    let stopped = changed(&flight, "mag_4_uc", |i, x| if (100..=340).contains(&i) { stop } else { x });
    // Each sample ten times is a slower sensor.
    let bench = bench(&[changed(&stopped, "mag_5_uc", |i, _| held[i / 10 * 10])], "");
    assert_eq!(bench.run(&[]).code, 0);
    let found = quality(&bench);
    let expected = [("1.01".to_owned(), "mag_4_uc".to_owned(), "stuck".to_owned(), 241.0, 100.0, stop)];
    assert_eq!(found, expected);
}

#[test]
fn user_one_mistake_of_a_file_gives_one_message() {
    let lines = [("1.01", 300), ("1.02", 200), ("1.03", 100)]
        .map(|(line, rows)| each(&total(line, rows), &["mag_4_uc"], |x| x * 1e-9));
    let bench = bench(&lines, "");
    let output = bench.magline(&["run", "spec.toml"]);
    assert_eq!(output.status.code(), Some(1));
    let printed = stderr(&output);
    assert_eq!(printed.matches("not a total field").count(), 1, "{printed}");
    contains(&printed, &["line 1.01", "(and in 2 more lines of the file)"]);
    assert_eq!(errors(&bench).len(), 3);
    assert_eq!(stderr(&bench.magline(&["check", "spec.toml"])).matches("not a total field").count(), 1);
    // Three mistakes give three messages in one run.
    let wrong = each(&each(&lines[0], &["alt"], |x| x / 0.3048), &["lat", "lon"], f64::to_radians);
    write(&bench.path("flights/1.parquet"), &[wrong]);
    let done: Done = bench.run(&[]);
    assert_eq!(done.code, 1);
    let printed = errors(&bench);
    assert_eq!(printed.len(), 3, "{printed:?}");
    for (error, unit) in printed.iter().zip(["T", "rad", "ft"]) {
        contains(error, &[&format!("= \"{unit}\"")]);
    }
}

#[test]
fn user_all_options_of_tables_are_checked_like_parameters() {
    let bench = bench(&[total("1.01", 100)], "fromat = \"csv\"\nunits = { mag_1_uc = 5 }\nepsg = 70000\nline = 7");
    let done = bench.run(&[]);
    assert_eq!(done.code, 2);
    let expected_messages = [
        "`flights` has no parameter `fromat`",
        "did you mean `format`?",
        "`units.mag_1_uc` of `flights` must be a text, not 5",
        "`epsg` of `flights` must be a whole number below 65536, not 70000",
        "`line` of `flights` must be a text, not 7",
    ];
    contains(&done.stderr, &expected_messages);
}

#[test]
fn user_accept_and_the_name_of_the_table_are_checked() {
    let bench = bench(&[total("1.01", 100)], "accept = [\"rnage\"]");
    let done = bench.run(&[]);
    assert_eq!(done.code, 2);
    contains(&done.stderr, &["`accept` cannot be `rnage`", "did you mean `range`?", "--> spec.toml:7:10"]);
    bench.spec(&SPEC.replace("\"even\"", "\"quality\""));
    let done = bench.run(&[]);
    assert_eq!(done.code, 2);
    contains(&done.stderr, &["`quality` is the name of the table of data quality"]);
}

#[test]
fn user_sql_rejects_impossible_positions_and_dates() {
    let bench = bench(&[total("1.01", 100)], "");
    assert_eq!(bench.run(&[]).code, 0);
    let ask = |call: &str| bench.magline(&["sql", &format!("SELECT {call} AS f"), "--format", "csv"]);
    for (call, expected_text) in [
        ("igrf(2603.0, 10.0, 0.0, 2020.0)", "2603.0 is not a latitude; the range is -90 to 90 deg"),
        ("wmm(-100.0, 10.0, 0.0, 2020.0)", "-100.0 is not a latitude"),
        ("igrf_n(45.0, 500.0, 0.0, 2020.0)", "500.0 is not a longitude; the range is -180 to 360 deg"),
        ("igrf(45.0, 10.0, 1e300, 2020.0)", "1e300 is not a height"),
        ("igrf(45.0, 10.0, 0.0, 1200.0)", "1200"),
        ("igrf(45.0, 10.0, 0.0, 2600.0)", "covers the years 1900 to 2030"),
        ("wmm_d(45.0, 10.0, 0.0, 2015.0)", "WMM covers the years 2020 to 2030"),
        ("igrf(45.0, 10.0, CAST('inf' AS DOUBLE), 2020.0)", "the height is infinite"),
    ] {
        let output = ask(call);
        assert_eq!(output.status.code(), Some(2), "{call}: {}", stdout(&output));
        assert!(stderr(&output).contains(expected_text), "{call}: {}", stderr(&output));
    }
    for nothing in ["igrf(NULL, 10.0, 0.0, 2020.0)", "igrf(45.0, 10.0, CAST('NaN' AS DOUBLE), 2020.0)"] {
        assert_eq!(stdout(&ask(nothing)), "f\n\"\"\n", "{nothing}");
    }
    let known: f64 = stdout(&ask("igrf(45.0, 10.0, 300.0, 2020.5)")).lines().nth(1).unwrap().parse().unwrap();
    assert!((47_000.0..48_500.0).contains(&known), "{known}");
}

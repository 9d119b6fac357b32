//! Maps made within a spec: from survey points to a map, on to other heights and grids, and to navigation.

use std::fs;

use crate::support::{Bench, anomaly, batch, numbers, read, stderr, stdout, texts, write};

/// Flight lines of a survey over the small map, 220 m apart, and four ties across.
fn survey(bench: &Bench) {
    survey_with(bench, &[]);
}

/// Survey with additional points of [latitude, longitude, height, line].
fn survey_with(bench: &Bench, more: &[[f64; 4]]) {
    let mut rows: Vec<[f64; 4]> = more.to_vec();
    for line in 0..56 {
        let lat = 44.93 + 0.002 * f64::from(line);
        rows.extend((0..60).map(|k| [lat, 9.94 + 0.002 * f64::from(k), 300.0, 100.0 + f64::from(line)]));
    }
    for tie in 0..4 {
        let lon = 9.945 + 0.03 * f64::from(tie);
        rows.extend((0..110).map(|k| [44.93 + 0.001 * f64::from(k), lon, 300.0, 900.0 + f64::from(tie)]));
    }
    let column = |k: usize| rows.iter().map(|r| r[k]).collect::<Vec<f64>>();
    let values = rows.iter().map(|r| anomaly(r[0], r[1])).collect();
    let columns = [
        ("latitude_deg", column(0)),
        ("longitude_deg", column(1)),
        ("height_m", column(2)),
        ("total_field_anomaly_nt", values),
        ("flight_line", column(3)),
    ];
    write(&bench.path("points.parquet"), &[batch(&columns)]);
}

const TABLES: &str = r#"
name  = "maps"
seed  = 1
store = "store"

[tables.flights]
path = "flights/"

[tables.anomaly]
path = "map.parquet"

[tables.points]
path   = "points.parquet"
format = "points"
flight = "survey"
"#;

const FROM_POINTS: &str = r#"
[axes]
spacing = [150.0, 400.0]

[[stages]]
name        = "gridded"
stage       = "map_grid"
input       = "points"
level_order = 0
method      = "minimum_curvature"
spacing_m   = "$spacing"

[[stages]]
name  = "level"
stage = "map_continue"
map   = "gridded"
to_m  = 310.0

[[stages]]
name  = "held"
stage = "map_value"
position = "truth"
input = "flights"
map   = "gridded"

[[stages]]
name            = "track"
stage           = "navigate"
tuning          = "magnav"
input           = "flights"
map             = "level"
mag             = "mag_1_c"
core_field      = false
offset_window_s = 1.0

[[stages]]
name    = "scores"
stage   = "score"
input   = ["held", "track"]
metrics = ["drms", "ins_drms"]
"#;

fn fine(output: &std::process::Output) -> String {
    assert!(output.status.success(), "{}{}", stdout(output), stderr(output));
    stdout(output)
}

#[test]
fn user_warnings_of_a_map_are_in_the_table_warnings() {
    let bench = Bench::new();
    survey_with(&bench, &[[-5.0, 9.94, 300.0, 7.0]]);
    bench.spec(&(TABLES.to_owned() + FROM_POINTS));
    for (computed, reused) in [(2, 0), (0, 2)] {
        let done = bench.run(&[]);
        let of = |what: &str| done.last["tables"]["gridded"][what].as_u64();
        assert_eq!((done.code, of("computed"), of("reused")), (0, Some(computed), Some(reused)), "{}", done.stderr);
        let warnings = read(&bench.path("store/tables/maps/warnings"));
        let of_map: Vec<usize> =
            texts(&warnings, "kind").iter().enumerate().filter(|(_, k)| *k == "map").map(|(i, _)| i).collect();
        assert_eq!(of_map.len(), 2, "{warnings:?}");
        for i in of_map {
            assert_eq!(texts(&warnings, "stage")[i], "gridded");
            let text = &texts(&warnings, "text")[i];
            assert!(text.starts_with("1 point is far from all others and omitted"), "{text}");
            assert!(text.contains("row 0 of line survey 7 at latitude -5.00000, longitude 9.94000"), "{text}");
        }
        assert!(done.last["warnings"].to_string().contains("far from all others"), "{}", done.last);
    }
}

#[test]
fn user_a_spec_goes_from_survey_points_to_a_map_to_navigation() {
    let bench = Bench::new();
    survey(&bench);
    bench.spec(&(TABLES.to_owned() + FROM_POINTS));
    let done = bench.run(&["--threads", "1"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!((done.computed("gridded"), done.computed("level"), done.computed("track")), (2, 2, 8));
    let folder = bench.path("store/tables/maps");
    let map = read(&folder.join("gridded"));
    let names: Vec<String> = map[0].schema().fields().iter().map(|f| f.name().clone()).collect();
    assert_eq!(names, ["spacing", "lat", "lon", "alt", "anomaly", "easting", "northing", "epsg"]);
    let (lat, lon, values) = (numbers(&map, "lat"), numbers(&map, "lon"), numbers(&map, "anomaly"));
    let (easting, spacing, epsg) = (numbers(&map, "easting"), numbers(&map, "spacing"), numbers(&map, "epsg"));
    assert!(epsg.iter().all(|code| *code == 32632.0));
    assert!((easting[1] - easting[0] - spacing[0]).abs() < 1e-6, "{}", easting[1] - easting[0]);
    let inside = |i: &usize| (44.94..45.03).contains(&lat[*i]) && (9.95..10.05).contains(&lon[*i]);
    let squares: Vec<f64> =
        (0..values.len()).filter(inside).map(|i| (values[i] - anomaly(lat[i], lon[i])).powi(2)).collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    // Points 160 m by 220 m apart of waves of 2.2 km and more.
    assert!(squares.len() > 3000 && rms < 3.0, "{} {rms}", squares.len());
    let held = read(&folder.join("held"));
    assert!(numbers(&held, "map_anomaly").iter().filter(|v| v.is_finite()).count() > 1000);
    let scores = read(&folder.join("scores"));
    let (metrics, values) = (texts(&scores, "metric"), numbers(&scores, "value"));
    let drms: Vec<f64> = (0..values.len()).filter(|i| metrics[*i] == "drms").map(|i| values[i]).collect();
    assert!(drms.len() == 8 && drms.iter().all(|d| *d < 30.0), "{drms:?}");

    let again = bench.run(&[]);
    assert_eq!((again.code, again.total("computed")), (0, 0), "{}", again.last);
    let explained = fine(&bench.magline(&["explain", "spec.toml"]));
    assert!(explained.contains("gridded  map_grid v1 <- points"), "{explained}");
    assert!(
        explained.contains("level  map_continue v1 <- gridded\n  runs     at 2 points: spacing (2)\n"),
        "{explained}"
    );
    let lineage = fine(&bench.magline(&["lineage", "track", "--store", "store"]));
    assert!(lineage.contains("points  flights of 60 lines") && lineage.contains("points.parquet"), "{lineage}");
    let question = "select spacing, count(*) as n, max(alt) as top from maps.level group by spacing order by spacing";
    let rows = fine(&bench.magline(&["sql", question, "--store", "store", "--format", "csv"]));
    assert!(rows.lines().count() == 3 && rows.contains("310"), "{rows}");
    fine(&bench.magline(&["report", "spec.toml", "-o", "report.html"]));
    assert!(fs::read_to_string(bench.path("report.html")).unwrap().contains("on the anomaly map"));

    // Only results that depend on the height are recomputed.
    bench.spec(&(TABLES.to_owned() + &FROM_POINTS.replace("to_m  = 310.0", "to_m  = 320.0")));
    let why = fine(&bench.magline(&["why", "spec.toml", "track"]));
    assert!(why.contains("level"), "{why}");
    let higher = bench.run(&[]);
    assert_eq!((higher.code, higher.computed("gridded"), higher.computed("level")), (0, 0, 2), "{}", higher.last);
    assert_eq!((higher.computed("held"), higher.computed("track")), (0, 8));
}

#[test]
fn user_maps_have_the_same_bytes_on_any_number_of_threads() {
    let bench = Bench::new();
    survey(&bench);
    bench.spec(&(TABLES.to_owned() + &FROM_POINTS.replace("\"minimum_curvature\"", "\"equivalent_sources\"")));
    let tables = ["1", "2"].map(|threads| {
        let done = bench.run(&["--threads", threads, "--set", &format!("store=store{threads}")]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        bench.tables(&format!("store{threads}"))
    });
    let maps = |tables: &std::collections::BTreeMap<String, Vec<u8>>| {
        tables.iter().filter(|(name, _)| name.contains("/gridded/") || name.contains("/level/")).count()
    };
    assert!(maps(&tables[0]) >= 2);
    assert!(tables[0] == tables[1]);
}

#[test]
fn user_a_command_and_a_stage_give_the_same_map() {
    let bench = Bench::new();
    survey(&bench);
    bench.spec(
        &(TABLES.to_owned()
            + r#"
[[stages]]
name  = "up"
stage = "map_continue"
map   = "anomaly"
to_m  = 450.0

[[stages]]
name    = "utm"
stage   = "map_convert"
map     = "up"
to_epsg = 32632
spacing = 300.0
trim    = true

[[stages]]
name  = "filled"
stage = "map_fill"
map   = "utm"

[[stages]]
name      = "gridded"
stage     = "map_grid"
input     = "points"
spacing_m = 400.0
level_m   = 320.0
"#),
    );
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    for args in [
        &["map", "continue", "map.parquet", "--to", "450", "-o", "up.parquet"][..],
        &["map", "convert", "up.parquet", "--to-epsg", "32632", "--spacing", "300", "--trim", "-o", "utm.parquet"],
        &["map", "fill", "utm.parquet", "-o", "filled.parquet"],
        &["map", "grid", "points.parquet", "--spacing-m", "400", "--level-m", "320", "-o", "gridded.parquet"],
    ] {
        fine(&bench.magline(args));
    }
    for name in ["up", "utm", "filled", "gridded"] {
        let published = bench.path("store/tables/maps").join(name);
        let single = bench.path(&format!("{name}.d"));
        fs::create_dir(&single).unwrap();
        fs::copy(bench.path(&format!("{name}.parquet")), single.join("0.parquet")).unwrap();
        let (stage, command) = (read(&published), read(&single));
        for column in ["anomaly", "alt"] {
            let (a, b) = (numbers(&stage, column), numbers(&command, column));
            let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-6 || a.is_nan() && b.is_nan();
            assert!(a.len() == b.len() && a.iter().zip(&b).all(near), "{name} {column}");
        }
        // The published file is a map file.
        let file = fs::read_dir(&published).unwrap().flatten().next().unwrap().path();
        let message = fine(&bench.magline(&["map", "info", &file.display().to_string()]));
        assert!(message.contains(if name == "up" { "4326" } else { "32632" }), "{message}");
    }
}

fn fine_or_failed(output: &std::process::Output) -> String {
    assert!(matches!(output.status.code(), Some(0 | 1)), "{}", stderr(output));
    stdout(output)
}

#[test]
fn user_a_failed_map_is_reported_and_its_dependents_are_skipped() {
    let bench = Bench::new();
    survey(&bench);
    let low = FROM_POINTS
        .replace("method      = \"minimum_curvature\"", "level_m = \"$low\"")
        .replace("[axes]\n", "[axes]\nlow = [-2000.0, 320.0]\n");
    bench.spec(&(TABLES.to_owned() + &low));
    let done = bench.run(&[]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    let of = |table: &str, what: &str| done.last["tables"][table][what].as_u64().unwrap();
    assert_eq!((of("gridded", "failed"), of("gridded", "computed")), (2, 2), "{}", done.last);
    assert_eq!((of("level", "skipped"), of("track", "skipped"), of("track", "computed")), (2, 8, 8), "{}", done.last);
    let failures = read(&bench.path("store/tables/maps/failures"));
    assert!(texts(&failures, "stage").iter().all(|t| t == "gridded"));
    assert!(texts(&failures, "error")[0].contains("-2000 m high is not available"), "{failures:?}");
    let events = fine_or_failed(&bench.magline(&["run", "spec.toml", "--json"]));
    let skipped = events.lines().find(|e| e.contains("\"skipped\"") && e.contains("\"table\":\"level\""));
    assert!(skipped.is_some_and(|e| e.contains("its input `gridded` could not be computed")), "{events}");
    let output = bench.magline(&["run", "spec.toml"]);
    assert!(stderr(&output).contains("set `level_m = "), "{}", stderr(&output));
}

#[test]
fn gold_invalid_parameters_are_rejected_before_the_run() {
    let bench = Bench::new();
    survey(&bench);
    let up = "[[stages]]\nname = \"up\"\nstage = \"map_continue\"\nmap = \"anomaly\"\n";
    let grid = "[[stages]]\nname = \"g\"\nstage = \"map_grid\"\ninput = \"points\"\n";
    let value = "[[stages]]\nname = \"v\"\nstage = \"map_value\"\ninput = \"flights\"\nmap = \"up\"\n";
    for (stages, expected) in [
        (up.to_owned(), "no continuation and no derivative is requested"),
        (format!("{up}to_m = 400.0\nwhere = \"line = '1'\"\n"), "works on maps, which have no lines"),
        (format!("{up}derivative = \"upp\"\n"), "did you mean `up`"),
        (format!("{up}derivative = \"up\"\n{value}"), "`up` is a derivative in nT/m"),
        (format!("{up}to_m = 400.0\n{}", value.replace("input = \"flights\"", "input = \"up\"")), "but `up` is a map"),
        (format!("{grid}core_field = \"igrf\"\n"), "the core field needs a date"),
        (format!("{grid}tension = 0.5\n"), "`tension` has no effect without `method = \"minimum_curvature\"`"),
        (format!("{grid}spacing_m = 0.0\n"), "`spacing_m` must be above 0"),
        (format!("{grid}mask_m = -1.0\n"), "`mask_m` is -1"),
        (format!("{grid}value = \"anomly\"\n"), "there is no column `anomly`"),
        (format!("{grid}bounds = [1.0, 2.0]\n"), "four numbers"),
        (format!("{grid}to_epsg = 1\n"), "EPSG:1"),
        (format!("{grid}keep = false\n"), "`keep` applies only to tables of flight lines"),
    ] {
        bench.spec(&(TABLES.to_owned() + &stages));
        let output = bench.magline(&["check", "spec.toml"]);
        assert_eq!(output.status.code(), Some(2), "{stages}{}", stdout(&output));
        assert!(stderr(&output).contains(expected), "{stages}{}", stderr(&output));
    }
}

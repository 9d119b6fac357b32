//! `magline map`: operations on maps, from survey points to a picture.

use std::{fs, path::Path, process::Output};

use serde_json::Value;

use crate::support::{Bench, batch, magline, map, numbers, read, repository, stderr, stdout, write};

/// File extension and format. If `format` is empty, the extension determines the format.
const FORMATS: [(&str, &str); 11] = [
    ("parquet", ""),
    ("tif", ""),
    ("nc", ""),
    ("grd", "netcdf"),
    ("grd", "surfer7"),
    ("grd", "surfer6"),
    ("grd", "surfer6_text"),
    ("xyz", ""),
    ("h5", ""),
    ("gxf", ""),
    ("ers", ""),
];

fn osborne() -> String {
    repository().join("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif").display().to_string()
}

fn fine(output: &Output) -> String {
    assert!(output.status.success(), "{}", stderr(output));
    stdout(output)
}

fn info(folder: &Path, map: &str) -> Value {
    serde_json::from_str(&fine(&magline(folder, &["map", "info", map, "--json"]))).unwrap()
}

#[test]
fn user_a_map_survives_conversion_to_every_format() {
    let bench = Bench::new();
    let first = info(bench.folder.path(), "map.parquet");
    for (ending, format) in FORMATS {
        let file = format!("there_{format}.{ending}");
        let as_format: &[&str] = if format.is_empty() { &[] } else { &["--output-format", format] };
        fine(&bench.magline(&[&["map", "convert", "map.parquet", "-o", &file], as_format].concat()));
        // Surfer grids do not contain their coordinate system.
        let there = fine(&bench.magline(&["map", "info", &file, "--json", "--epsg", "4326"]));
        let there: Value = serde_json::from_str(&there).unwrap();
        for key in ["columns", "rows", "epsg"] {
            assert_eq!(there[key], first[key], "{ending} {format} {key}");
        }
        for key in ["west [deg]", "north [deg]", "min [nT]", "max [nT]", "std [nT]", "mean [nT]"] {
            let (a, b) = (there[key].as_f64().unwrap(), first[key].as_f64().unwrap());
            // Some of the formats are in single precision.
            assert!((a - b).abs() < 1e-5 * b.abs().max(1.0), "{ending} {format} {key}: {a} {b}");
        }
    }
}

#[test]
fn user_bytes_do_not_depend_on_threads() {
    let bench = Bench::new();
    for (name, args) in [
        ("up", &["map", "continue", "map.parquet", "--to", "450"][..]),
        ("down", &["map", "continue", "map.parquet", "--to", "200"]),
        ("utm", &["map", "convert", "map.parquet", "--to-epsg", "32632"]),
        ("png", &["map", "plot", "map.parquet", "--width", "400"]),
    ] {
        let files = ["1", "2"].map(|threads| {
            let file = format!("{name}{threads}.{}", if name == "png" { "png" } else { "parquet" });
            fine(&bench.magline(&[args, &["-o", &file, "--threads", threads]].concat()));
            fs::read(bench.path(&file)).unwrap()
        });
        assert!(files[0] == files[1], "{name}");
    }
}

#[test]
fn user_downward_and_upward_continuation_restore_the_map_within_the_reported_error() {
    let bench = Bench::new();
    let output = bench.magline(&["map", "continue", &osborne(), "--to", "450", "-o", "low.tif", "--l-curve", "l.svg"]);
    fine(&output);
    let message = stderr(&output);
    let words: Vec<&str> = message.split_whitespace().collect();
    let at = words.windows(2).position(|w| w == ["nT", "rms"]).unwrap();
    let rms: f64 = words[at - 1].parse().unwrap();
    fine(&bench.magline(&["map", "continue", "low.tif", "--to", "500", "-o", "back.parquet"]));
    fine(&bench.magline(&["map", "convert", &osborne(), "-o", "map500.parquet"]));
    let [back, map] = ["back", "map500"].map(|n| numbers(&file(&bench, &format!("{n}.parquet")), "anomaly"));
    let inner: Vec<f64> = back.iter().zip(&map).map(|(a, b)| a - b).collect();
    let found = (inner.iter().map(|d| d * d).sum::<f64>() / inner.len() as f64).sqrt();
    // The intermediate file is in single precision, and the field beyond its edges is unknown.
    assert!(found < 1.5 * rms + 0.01, "{found} {rms}");
    assert!(fs::read_to_string(bench.path("l.svg")).unwrap().contains("alpha"));
}

fn file(bench: &Bench, name: &str) -> Vec<arrow_array::RecordBatch> {
    let folder = bench.path(&format!("{name}.d"));
    fs::create_dir_all(&folder).unwrap();
    fs::copy(bench.path(name), folder.join("0.parquet")).unwrap();
    read(&folder)
}

#[test]
fn gold_a_long_continuation_gives_a_warning_and_heights_are_required() {
    let bench = Bench::new();
    let output = bench.magline(&["map", "continue", &osborne(), "--to", "2500", "-o", "up.tif"]);
    fine(&output);
    assert!(stderr(&output).contains("exceeds 1/50"), "{}", stderr(&output));
    let near = bench.magline(&["map", "continue", &osborne(), "--to", "700", "-o", "up.tif"]);
    assert!(!stderr(&near).contains("1/50"), "{}", stderr(&near));
    write(&bench.path("flat.parquet"), &[crate::support::without(&map(), "alt")]);
    let refused = bench.magline(&["map", "continue", "flat.parquet", "--to", "700", "-o", "up.parquet"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("--alt"), "{}", stderr(&refused));
    let several = bench.magline(&["map", "continue", &osborne(), "--to", "600,700", "-o", "up.tif"]);
    assert_eq!(several.status.code(), Some(2));
    assert!(stderr(&several).contains("{alt}"), "{}", stderr(&several));
    fine(&bench.magline(&["map", "continue", &osborne(), "--to", "600,700", "-o", "up_{alt}.tif"]));
    assert!(bench.path("up_600.tif").exists() && bench.path("up_700.tif").exists());
}

#[test]
fn user_a_hole_is_filled_from_its_surroundings_or_another_map() {
    let bench = Bench::new();
    let whole = map();
    let punched = crate::support::changed(&whole, "anomaly", |i, v| {
        let (row, column) = (i / 81, i % 81);
        if (30..40).contains(&row) && (50..62).contains(&column) { f64::NAN } else { v }
    });
    write(&bench.path("hole.parquet"), &[punched]);
    let truth = numbers(std::slice::from_ref(&whole), "anomaly");
    let rms = |name: &str| {
        let values = numbers(&file(&bench, name), "anomaly");
        assert!(values.iter().all(|v| v.is_finite()), "{name}");
        let sum: f64 = values.iter().zip(&truth).map(|(a, b)| (a - b) * (a - b)).sum();
        (sum / 120.0).sqrt()
    };
    for method in ["knn", "harmonic", "minimum-curvature"] {
        fine(&bench.magline(&["map", "fill", "hole.parquet", "--method", method, "-o", "filled.parquet"]));
        // The anomaly has a standard deviation of 106 nT. The hole is a third of a wavelength wide.
        assert!(rms("filled.parquet") < 150.0, "{method}: {}", rms("filled.parquet"));
    }
    let shifted = crate::support::changed(&whole, "anomaly", |_, v| v + 25.0);
    write(&bench.path("other.parquet"), &[shifted]);
    let output = bench.magline(&[
        "map",
        "fill",
        "hole.parquet",
        "--with",
        "other.parquet",
        "--method",
        "none",
        "-o",
        "both.parquet",
    ]);
    fine(&output);
    assert!(stderr(&output).contains("median -25.00"), "{}", stderr(&output));
    // The other map is exact except for its level, which is computed from the overlap.
    assert!(rms("both.parquet") < 1e-6, "{}", rms("both.parquet"));
}

#[test]
fn user_a_survey_of_dipoles_is_levelled_and_gridded_to_their_field() {
    let bench = Bench::new();
    let dipoles = [(2200.0, 1800.0, 9e4), (3500.0, 3300.0, -7e4), (1200.0, 3900.0, 5e4)];
    let field = |e: f64, n: f64, h: f64| -> f64 {
        let one = |(x, y, m): &(f64, f64, f64)| {
            let (dx, dy, dz) = (e - x, n - y, h + 350.0);
            let r2 = dx * dx + dy * dy + dz * dz;
            m * 1e2 * (2.0 * dz * dz - dx * dx - dy * dy) / r2.powf(2.5) * 100.0
        };
        dipoles.iter().map(one).sum()
    };
    let mut rows: Vec<[f64; 5]> = vec![];
    for line in 0..26 {
        let offset = 7.0 * f64::from(line % 5) - 14.0;
        rows.extend((0..501).map(|k| {
            let (e, n) = (10.0 * f64::from(k), 200.0 * f64::from(line));
            [e, n, 80.0, field(e, n, 80.0) + offset, f64::from(line)]
        }));
    }
    for tie in 0..6 {
        rows.extend((0..501).map(|k| {
            let (e, n) = (1000.0 * f64::from(tie) + 3.0, 10.0 * f64::from(k));
            [e, n, 80.0, field(e, n, 80.0), 100.0 + f64::from(tie)]
        }));
    }
    let column = |k: usize| rows.iter().map(|r| r[k]).collect::<Vec<f64>>();
    write(
        &bench.path("points.parquet"),
        &[batch(&[
            ("easting_m", column(0).iter().map(|e| e + 500_000.0).collect()),
            ("northing_m", column(1).iter().map(|n| n + 5_000_000.0).collect()),
            ("height_m", column(2)),
            ("anomaly_nt", column(3)),
            ("line", column(4)),
        ])],
    );
    let args =
        ["map", "grid", "points.parquet", "--epsg", "32632", "--spacing", "100", "--level", "120", "--level-lines"];
    let output = bench
        .magline(&[&args[..], &["-o", "grid.parquet", "--cross-validate", "5", "--error", "error.parquet"]].concat());
    let report = fine(&output);
    let after = report.lines().find(|l| l.starts_with("after levelling")).unwrap();
    let left: f64 = after.split_whitespace().nth(2).unwrap().parse().unwrap();
    // Offsets of -14 to 14 nT are removed. The residual is the interpolation error between points 10 m apart.
    assert!(left < 1.0, "{report}");
    let grid = file(&bench, "grid.parquet");
    let (e, n, v) = (numbers(&grid, "easting"), numbers(&grid, "northing"), numbers(&grid, "anomaly"));
    let mean: f64 = 0.0;
    let errors: Vec<f64> = (0..v.len())
        .filter(|i| (500.0..4500.0).contains(&(e[*i] - 5e5)) && (500.0..4500.0).contains(&(n[*i] - 5e6)))
        .map(|i| v[i] - field(e[i] - 5e5, n[i] - 5e6, 120.0) - mean)
        .collect();
    let rms = (errors.iter().map(|d| d * d).sum::<f64>() / errors.len() as f64).sqrt();
    let signal = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    // At 40 m above points 200 m apart across lines, 430 m from the sources.
    assert!(rms < 0.02 * signal, "{rms} of {signal}");
    assert!(bench.path("error.parquet").exists());
}

/// East-west lines 200 m apart over 4 by 4 km and four ties, over a smooth field.
fn points_of(bench: &Bench, change: impl Fn(usize, &mut [f64; 5])) {
    let mut rows: Vec<[f64; 5]> = vec![];
    let mut push = |e: f64, n: f64, line: f64| {
        let value = 300.0 * (e / 900.0).sin() * (n / 1100.0).cos();
        let mut row = [500_000.0 + e, 5_000_000.0 + n, 80.0 + 20.0 * (e / 800.0).sin(), value, line];
        change(rows.len(), &mut row);
        rows.push(row);
    };
    for line in 0..21 {
        (0..201).for_each(|k| push(20.0 * f64::from(k), 200.0 * f64::from(line), f64::from(line)));
    }
    for tie in 0..4 {
        (0..201).for_each(|k| push(1000.0 * f64::from(tie) + 7.0, 20.0 * f64::from(k), 100.0 + f64::from(tie)));
    }
    let names = ["easting_m", "northing_m", "height_m", "anomaly_nt", "line"];
    let columns: Vec<(&str, Vec<f64>)> =
        names.iter().enumerate().map(|(k, name)| (*name, rows.iter().map(|r| r[k]).collect())).collect();
    write(&bench.path("points.parquet"), &[batch(&columns)]);
}

const GRID: [&str; 6] = ["map", "grid", "points.parquet", "--epsg", "32632", "--spacing"];

fn grid(bench: &Bench, more: &[&str]) -> Output {
    bench.magline(&[&GRID[..], &["100"], more].concat())
}

#[test]
fn user_distant_points_are_skipped_and_reported() {
    let bench = Bench::new();
    // A position of zeros, and swapped coordinates.
    points_of(&bench, |i, row| match i {
        300 => (row[0], row[1]) = (0.0, 0.0),
        777 => (row[0], row[1]) = (row[1], row[0]),
        _ => {}
    });
    let begun = std::time::Instant::now();
    let output = grid(&bench, &["-o", "grid.parquet"]);
    let report = fine(&output);
    let message = stderr(&output);
    assert!(message.contains("note: 2 points are far from all others and therefore removed"), "{message}");
    assert!(message.contains("points.parquet: row 300, line 1,") && message.contains("row 777, line 3,"), "{message}");
    assert!(message.contains("--keep-outliers"), "{message}");
    assert!(report.contains("removed: 2 far away, 0 not finite"), "{report}");
    let first = info(bench.folder.path(), "grid.parquet");
    assert_eq!((first["columns"].as_f64(), first["rows"].as_f64()), (Some(41.0), Some(41.0)), "{first}");
    // Takes about 2 s here. A grid over the distant points would be 5000 km wide.
    assert!(begun.elapsed().as_secs() < 60, "{:?}", begun.elapsed());
    let kept = bench.magline(&[&GRID[..], &["1", "-o", "kept.parquet", "--keep-outliers"]].concat());
    assert_eq!(kept.status.code(), Some(2), "{}", stderr(&kept));
    assert!(stderr(&kept).contains("nodes, more than"), "{}", stderr(&kept));
}

#[test]
fn user_invalid_arguments_are_rejected_before_the_computation() {
    let bench = Bench::new();
    points_of(&bench, |_, _| ());
    for (args, expected) in [
        (&["-o", "grid.xyzzy"][..], "the extension belongs to no writable map format"),
        (&["-o", "none/grid.parquet"], "the folder `none` does not exist"),
        (&["-o", "grid.parquet", "--spacing", "0"], "`--spacing-m` must be above 0, not 0"),
        (&["-o", "grid.parquet", "--damping=-1"], "`--damping` must be above 0, not -1"),
        (&["-o", "grid.parquet", "--mask=-1"], "`--mask-m` is -1"),
        (&["-o", "grid.parquet", "--tension", "0.5"], "`--tension` has no effect without `--method minimum_curvature`"),
        (
            &["-o", "grid.parquet", "--level", "90", "--method", "minimum-curvature"],
            "`--level-m` has no effect without `--method equi",
        ),
    ] {
        // The arguments are checked before the points are opened.
        let output = bench.magline(&[&["map", "grid", "none.parquet"], args].concat());
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{args:?}: {}", stderr(&output));
    }
    let low = grid(&bench, &["-o", "grid.parquet", "--level", "20"]);
    assert_eq!(low.status.code(), Some(2));
    let message = stderr(&low);
    assert!(message.contains("20 m high is not available") && message.contains("set `--level-m "), "{message}");
    let least = message.split("set `--level-m ").nth(1).and_then(|t| t.split('`').next()).unwrap().to_owned();
    fine(&grid(&bench, &["-o", "grid.parquet", "--level", &least]));
}

#[test]
fn user_levelling_shifts_ties_and_keeps_level_lines() {
    let bench = Bench::new();
    // Ties are 25 nT too high, and the values of the ties are from positions 15 m away from the recorded positions.
    points_of(&bench, |i, row| {
        if row[4] >= 100.0 {
            let shift_m = 15.0 * ((i / 7) as f64).sin();
            row[3] = 25.0 + 300.0 * ((row[0] - 500_000.0 + shift_m) / 900.0).sin() * ((row[1] - 5e6) / 1100.0).cos();
        }
    });
    let output = grid(&bench, &["-o", "levelled.parquet", "--level", "140", "--level-lines"]);
    let report = fine(&output);
    assert!(
        report.contains("lines: not corrected, because they are level within the accuracy of their crossings"),
        "{report}"
    );
    assert!(report.contains("ties: all shifted by -2"), "{report}");
    points_of(&bench, |_, _| ());
    fine(&grid(&bench, &["-o", "level.parquet", "--level", "140"]));
    let [levelled, level] = ["levelled.parquet", "level.parquet"].map(|n| numbers(&file(&bench, n), "anomaly"));
    let squares: f64 = levelled.iter().zip(&level).map(|(a, b)| (a - b) * (a - b)).sum();
    let rms = (squares / level.len() as f64).sqrt();
    // Along the ties the values are wrong by up to 5 nT.
    assert!(rms < 2.0, "{rms}");
}

#[test]
fn user_an_interrupt_ends_gridding_at_once_and_leaves_no_file() {
    let bench = Bench::new();
    points_of(&bench, |_, _| ());
    let args = [&GRID[..], &["5", "-o", "grid.parquet", "--cross-validate", "20", "--block", "0"]].concat();
    // The parent of the tests may have set the signal to be ignored.
    let mut running = std::process::Command::new("env")
        .args(["--default-signal=INT", env!("CARGO_BIN_EXE_magline")])
        .args(args)
        .current_dir(bench.folder.path())
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(std::time::Duration::from_millis(1500));
    assert!(running.try_wait().unwrap().is_none(), "it was too fast to be interrupted");
    let stopped = std::time::Instant::now();
    std::process::Command::new("kill").args(["-INT", &running.id().to_string()]).status().unwrap();
    running.wait().unwrap();
    // Complete gridding takes about 1 min.
    assert!(stopped.elapsed().as_secs() < 20, "{:?}", stopped.elapsed());
    let left: Vec<_> = fs::read_dir(bench.folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().contains("grid")), "{left:?}");
}

#[test]
fn user_the_format_of_a_picture_follows_its_file_name() {
    let bench = Bench::new();
    for (name, starts) in
        [("a.png", &b"\x89PNG"[..]), ("a.svg", b"<?xml"), ("a.kml", b"<?xml"), ("a.kmz", b"PK\x03\x04")]
    {
        let flights = "flights/1.parquet";
        fine(&bench.magline(&["map", "plot", "map.parquet", "--track", flights, "-o", name, "--width", "600"]));
        let bytes = fs::read(bench.path(name)).unwrap();
        assert!(bytes.starts_with(starts), "{name}: {:?}", &bytes[..8]);
    }
    assert!(bench.path("a_map.png").exists(), "the overlay is beside the .kml");
    let wrong = bench.magline(&["map", "plot", "map.parquet", "-o", "a.jpg"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains(".png"), "{}", stderr(&wrong));
}

#[test]
fn gold_unreadable_maps_are_rejected_and_leave_no_files() {
    let bench = Bench::new();
    fs::write(bench.path("half.tif"), &fs::read(osborne()).unwrap()[..200_000]).unwrap();
    fs::write(bench.path("empty.nc"), b"").unwrap();
    for (map, expected) in [("half.tif", "TIFF"), ("empty.nc", "empty"), ("none.grd", "does not exist")] {
        let output = bench.magline(&["map", "convert", map, "-o", "out.parquet"]);
        assert_eq!(output.status.code(), Some(2), "{map}");
        assert!(stderr(&output).contains(expected) && stderr(&output).contains(map), "{}", stderr(&output));
        assert!(!bench.path("out.parquet").exists(), "{map}");
    }
}

#[test]
fn user_a_map_is_not_written_over_itself() {
    let bench = Bench::new();
    let bytes = fs::read(osborne()).unwrap();
    fs::write(bench.path("m.tif"), &bytes).unwrap();
    fs::create_dir(bench.path("sub")).unwrap();
    for args in [
        &["map", "convert", "m.tif", "-o", "m.tif"][..],
        &["map", "convert", "m.tif", "-o", "sub/../m.tif"],
        &["map", "fill", "m.tif", "-o", "./m.tif"],
        &["map", "continue", "m.tif", "--to", "600", "-o", "m.tif"],
    ] {
        let output = bench.magline(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(stderr(&output).contains("would overwrite the input"), "{}", stderr(&output));
        assert!(fs::read(bench.path("m.tif")).unwrap() == bytes, "{args:?}");
    }
}

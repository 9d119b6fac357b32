//! Special cases of maps and survey points: impossible values, points without heights, the seam of a map around the
//! earth, and unsupported formats.

use std::{fs, path::PathBuf};

use datasets::{AnomalyGrid, Crs, GridHeight, write_grid};
use numerics::maps::plane_grid::EvenAxis;

use crate::support::{Bench, batch, numbers, read, repository, stderr, stdout, with_keys, write};

fn case(name: &str) -> PathBuf {
    repository().join("tests/cases/maps").join(name)
}

const SPEC: &str = r#"
name  = "x"
store = "store"

[tables.f]
path   = "TRACK"
accept = ["range"]

[tables.m]
path  = "MAP"
alt_m = 4000.0
MORE

[[stages]]
name  = "v"
stage = "map_value"
input = "f"
map   = "m"
map_interpolation = "KIND"
"#;

fn spec(track: &str, map: &str, more: &str, kind: &str) -> String {
    SPEC.replace("TRACK", track).replace("MAP", map).replace("MORE", more).replace("KIND", kind)
}

#[test]
fn user_a_marker_in_a_map_is_an_error_with_its_remedy() {
    let bench = Bench::new();
    let (track, map) = (case("emag2_track.parquet"), case("emag2.nc"));
    let (track, map) = (track.display().to_string(), map.display().to_string());
    bench.spec(&spec(&track, &map, "", "linear"));
    let run = bench.run(&[]);
    assert_ne!(run.code, 0);
    for part in ["emag2.nc", "99,999 nT is not a magnetic anomaly", "`missing = [99999]`", "--missing=99999"] {
        assert!(run.stderr.contains(part), "{part}: {}", run.stderr);
    }
    bench.spec(&spec(&track, &map, "missing = [99999]", "linear"));
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let found = numbers(&read(&bench.path("store/tables/x/v")), "map_anomaly");
    let most = found.iter().copied().filter(|v| !v.is_nan()).fold(f64::NEG_INFINITY, f64::max);
    assert!(most < 700.0, "{most}");

    // All commands on maps have the check and the flags.
    for args in [
        &["map", "info"][..],
        &["map", "fill", "-o", "f.tif"],
        &["map", "continue", "--to", "5000", "--alt", "4000", "-o", "c.tif"],
        &["map", "convert", "-o", "v.tif"],
        &["map", "plot", "-o", "p.png"],
    ] {
        let refused = bench.magline(&[args, &[map.as_str()]].concat());
        assert!(
            !refused.status.success() && stderr(&refused).contains("--missing=99999"),
            "{args:?}: {}",
            stderr(&refused)
        );
        let taken = bench.magline(&[args, &["--missing=99999", map.as_str()]].concat());
        assert!(taken.status.success(), "{args:?}: {}", stderr(&taken));
    }
    let accepted = bench.magline(&["map", "info", "--accept", "range", &map]);
    assert!(stdout(&accepted).contains("99999 nT"), "{}", stderr(&accepted));
}

#[test]
fn user_points_without_heights_are_gridded_by_minimum_curvature() {
    let bench = Bench::new();
    let mut text = "line,lon,lat,anomaly\n".to_owned();
    let field = |lon: f64, lat: f64| 200.0 * (40.0 * (lon - 140.0)).sin() * (60.0 * (lat + 22.0)).cos();
    for line in 0..12 {
        for i in 0..60 {
            let (lon, lat) = (140.0 + 0.001 * f64::from(i), -22.0 + 0.004 * f64::from(line));
            text += &format!("{line},{lon},{lat},{}\n", field(lon, lat));
        }
    }
    fs::write(bench.path("points.csv"), text).unwrap();
    let grid = |more: &[&str]| {
        bench.magline(&[&["map", "grid", "points.csv", "--spacing", "200", "-o", "g.tif"], more].concat())
    };
    let refused = grid(&[]);
    assert!(!refused.status.success());
    for part in ["none of 720 points remains to grid", "--method minimum_curvature", "--height"] {
        assert!(stderr(&refused).contains(part), "{part}: {}", stderr(&refused));
    }
    for more in [&["--method", "minimum_curvature"][..], &["--method", "minimum_curvature", "--level-lines"]] {
        let done = grid(more);
        let text = stderr(&done);
        // The error is about lines without crossings, not about missing heights.
        if more.len() > 2 {
            assert!(text.contains("no lines cross"), "{text}");
            continue;
        }
        assert!(done.status.success() && text.contains("the points have no heights"), "{text}");
    }
    let map = datasets::read_grid(&bench.path("g.tif"), &datasets::MapOptions::default()).unwrap();
    assert!(matches!(map.height, GridHeight::Level(alt_m) if alt_m.is_nan()));
    let (x, y) = map.crs.project(-21.982, 140.03).unwrap();
    let (column, row) = (map.x.node(x).round(), map.y.node(y).round());
    let (lat, lon) = map.crs.unproject(map.x.at(column), map.y.at(row)).unwrap();
    let found = map.anomaly_nt[row as usize * map.x.len + column as usize];
    // Lines 440 m apart over waves of 11 km.
    assert!((found - field(lon, lat)).abs() < 5.0, "{found} {}", field(lon, lat));
}

/// A smooth field around the earth.
fn field(lat: f64, lon: f64) -> f64 {
    let (phi, lambda) = (lat.to_radians(), lon.to_radians());
    100.0 * lambda.cos() * phi.cos() + 50.0 * (2.0 * lambda).sin() * phi.cos().powi(2) + lat
}

/// Writes a map around the earth with the first longitude `west`.
fn globe(bench: &Bench, name: &str, west: f64, columns: usize) {
    let axis = |first: f64, step: f64, len: usize| EvenAxis { first, step, len };
    let (x, y) = (axis(west, 2.0, columns), axis(-60.0, 2.0, 61));
    let values =
        y.coordinates().iter().flat_map(|lat| x.coordinates().into_iter().map(|lon| field(*lat, lon))).collect();
    let map = AnomalyGrid::new(x, y, Crs::wgs84().unwrap(), values, GridHeight::Level(4000.0)).unwrap();
    write_grid(&bench.path(name), &map, None).unwrap();
}

#[test]
fn law_a_map_around_the_earth_has_no_seam() {
    let bench = Bench::new();
    // Positions across the date line and Greenwich, at cell edges and between them.
    let lon: Vec<f64> =
        (0..81).map(|i| 177.0 + 0.075 * f64::from(i)).chain((0..81).map(|i| -3.0 + 0.075 * f64::from(i))).collect();
    let lat: Vec<f64> = lon.iter().map(|lon| 10.0 + 0.5 * lon.to_radians().sin()).collect();
    let tt = (0..lon.len()).map(|i| i as f64).collect();
    let line = batch(&[("tt", tt), ("lat", lat.clone()), ("lon", lon.clone()), ("alt", vec![4000.0; lon.len()])]);
    write(&bench.path("track.parquet"), &[with_keys("1", "1.01", &line)]);
    for (name, west, columns) in
        [("a.nc", 0.0, 180), ("b.tif", -180.0, 180), ("c.nc", 0.0, 181), ("d.nc", -180.0, 181), ("e.nc", 1.0, 180)]
    {
        globe(&bench, name, west, columns);
        for (kind, most) in [("linear", 0.1), ("cubic", 0.001)] {
            bench.spec(&spec("track.parquet", name, "", kind));
            let run = bench.run(&[]);
            assert_eq!(run.code, 0, "{}", run.stderr);
            let found = numbers(&read(&bench.path("store/tables/x/v")), "map_anomaly");
            for ((found, lat), lon) in found.iter().zip(&lat).zip(&lon) {
                // Bilinear error: an eighth of the squared spacing of 2 degrees for a field of 300 nT.
                assert!((found - field(*lat, *lon)).abs() < most, "{name} {kind} at {lon}: {found}");
            }
        }
    }
    // A projected map across the date line uses both sides.
    let done = bench.magline(&[
        "map",
        "convert",
        "a.nc",
        "--to-epsg",
        "32601",
        "--bounds",
        "200000,800000,700000,1600000",
        "-o",
        "u.tif",
    ]);
    if done.status.success() {
        let map = datasets::read_grid(&bench.path("u.tif"), &datasets::MapOptions::default()).unwrap();
        assert!(map.anomaly_nt.iter().all(|v| !v.is_nan()), "a hole at the date line");
    } else {
        panic!("{}", stderr(&done));
    }
}

#[test]
fn gold_a_geosoft_binary_grid_is_read_with_its_coordinate_system() {
    let bench = Bench::new();
    let file = case("geosoft.grd").display().to_string();
    let unset = bench.magline(&["map", "info", &file]);
    let text = stderr(&unset);
    assert!(!unset.status.success() && text.contains("set `epsg`"), "{text}");
    let done = bench.magline(&["map", "info", &file, "--epsg", "32754"]);
    let text = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success() && text.contains("geosoft_grd"), "{text}{}", stderr(&done));
    assert!(text.contains("columns           9") && text.contains("spacing_y         200 m"), "{text}");
}

//! A map in eastings and northings is interpolated on its native grid.

use std::path::PathBuf;

use arrow_array::RecordBatch;
use datasets::{AnomalyGrid, Crs, MapOptions, read_grid};

use crate::support::{Bench, batch, numbers, read, repository, with_keys, write};

const SPEC: &str = r#"
name  = "look"
store = "store"

[tables.flights]
path = "flights.parquet"

[tables.anomaly]
path = "MAP"

[[stages]]
name  = "place"
stage = "map_value"
input = "flights"
map   = "anomaly"
map_interpolation = "linear"
"#;

/// Levelled grid of Osborne in UTM zone 54 south, with nodes 100 m apart.
fn osborne() -> (PathBuf, AnomalyGrid, Crs) {
    let path = repository().join("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif");
    let map = read_grid(&path, &MapOptions::default()).unwrap();
    let crs = map.crs.clone();
    (path, map, crs)
}

/// Line along a track in eastings and northings, at 10 Hz.
fn line_batch(line: &str, crs: &Crs, track: impl Fn(f64) -> (f64, f64), rows: usize) -> RecordBatch {
    let places: Vec<(f64, f64)> = (0..rows)
        .map(|i| {
            let (easting, northing) = track(i as f64);
            crs.unproject(easting, northing).unwrap()
        })
        .collect();
    let columns = batch(&[
        ("tt", (0..rows).map(|i| 36_000.0 + 0.1 * i as f64).collect()),
        ("lat", places.iter().map(|p| p.0).collect()),
        ("lon", places.iter().map(|p| p.1).collect()),
        ("alt", vec![500.0; rows]),
    ]);
    with_keys("1", line, &columns)
}

/// Value, and slope eastward and northward on the grid per metre, of the bilinear surface through the nodes.
fn bilinear(map: &AnomalyGrid, easting: f64, northing: f64) -> (f64, f64, f64) {
    let (x, y) = (map.x.node(easting), map.y.node(northing));
    let column = (x.max(0.0) as usize).min(map.x.len - 2);
    let row = (y.max(0.0) as usize).min(map.y.len - 2);
    let node = |r: usize, c: usize| map.anomaly_nt[(row + r) * map.x.len + column + c];
    let (u, v) = (x - column as f64, y - row as f64);
    let (low, high) = (node(0, 0) + u * (node(0, 1) - node(0, 0)), node(1, 0) + u * (node(1, 1) - node(1, 0)));
    let across = (1.0 - v) * (node(0, 1) - node(0, 0)) + v * (node(1, 1) - node(1, 0));
    (low + v * (high - low), across / map.x.step, (high - low) / map.y.step)
}

/// Flown lines, interpolated values along them, and the map.
fn looked_up(spec: &str) -> (Vec<RecordBatch>, Vec<RecordBatch>, AnomalyGrid, Crs) {
    let (path, map, crs) = osborne();
    let bench = Bench::new();
    let (west, south) = (map.x.first, map.y.first);
    let (east, north) = (map.x.last(), map.y.last());
    let (wide, high) = (east - west, north - south);
    // The lines follow two edges of the map, through the nodes. Steps of 50 m would be 500 m/s, so the step is 10 m and
    // every tenth sample is a node.
    let lines = [
        line_batch("1.01", &crs, |i| (west + 10.0 * i, south), 1000),
        line_batch("1.02", &crs, |i| (east, south + 10.0 * i), 1000),
        line_batch("1.03", &crs, |i| (west + 0.4 * wide + 7.3 * i, south + 0.3 * high + 6.1 * i), 1500),
    ];
    write(&bench.path("flights.parquet"), &lines);
    bench.spec(&spec.replace("MAP", path.to_str().unwrap()));
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    (lines.to_vec(), read(&bench.path("store/tables/look/place")), map, crs)
}

#[test]
fn law_linear_interpolation_of_a_projected_map_is_bilinear_up_to_its_edges() {
    let (lines, rows, map, crs) = looked_up(SPEC);
    let [lat, lon] = ["lat", "lon"].map(|name| numbers(&lines, name));
    let [found, north, east] = ["map_anomaly", "map_grad_n", "map_grad_e"].map(|name| numbers(&rows, name));
    let (mut most, mut squares, mut lost, mut steepest) = (0.0_f64, 0.0, 0, 0.0_f64);
    for i in 0..lat.len() {
        let (easting, northing) = crs.project(lat[i], lon[i]).unwrap();
        let (value, per_east, per_north) = bilinear(&map, easting, northing);
        if found[i].is_nan() {
            lost += 1;
            continue;
        }
        let slope = per_east.hypot(per_north);
        steepest = steepest.max(slope);
        most = most.max((found[i] - value).abs());
        squares += (found[i] - value).powi(2);
        // Slopes are per metre on the ground. The scale of UTM is within 4e-4 of 1 here, and the magnitude is
        // independent of rotation. On a line of nodes rounding selects the cell, and the slope of a bilinear surface is
        // discontinuous there.
        let on_node = |x: f64| (x - x.round()).abs() < 1e-6;
        if !on_node(map.x.node(easting)) && !on_node(map.y.node(northing)) {
            let length = north[i].hypot(east[i]);
            assert!((length - slope).abs() < 5e-4 * slope + 1e-9, "{i}: {length} {slope}");
        }
    }
    let rms = (squares / lat.len() as f64).sqrt();
    println!("against bilinear on its nodes: rms {rms:e} nT, most {most:e} nT, {lost} lost, steepest {steepest} nT/m");
    assert_eq!(lost, 0, "samples on the edge of the map are lost");
    // Northings of 7.6e6 m are rounded to 1e-9 m, and these lines cross slopes of up to 0.13 nT/m.
    assert!(steepest > 0.1 && most < 1e-9, "{most} {rms} {steepest}");
}

#[test]
fn law_levels_of_a_projected_map_are_continued_on_its_native_grid() {
    let lines = "map_levels_m = [500.0, 600.0]\n";
    let (flight_lines, rows, map, crs) = looked_up(&format!("{SPEC}{lines}"));
    let [lat, lon] = ["lat", "lon"].map(|name| numbers(&flight_lines, name));
    let [found, up] = ["map_anomaly", "map_grad_u"].map(|name| numbers(&rows, name));
    let (mut most, mut n) = (0.0_f64, 0);
    for i in (0..lat.len()).filter(|i| found[*i].is_finite()) {
        let (easting, northing) = crs.project(lat[i], lon[i]).unwrap();
        let (value, ..) = bilinear(&map, easting, northing);
        (most, n) = (most.max((found[i] - value).abs()), n + 1);
        assert!(up[i].is_finite());
    }
    println!("at the map's own height, continued by 0 m: most {most:e} nT of {n} samples");
    // Rounding of a Fourier transform and its inverse with values of 3800 nT. Positions are rounded as above.
    assert!(most < 1e-6 && n == lat.len(), "{most} {n}");
}

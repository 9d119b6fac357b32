#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use numerics::maps::plane_grid::EvenAxis;

use grids::{AnomalyGrid, Crs, GridHeight, SummaryValue};

fn crs(code: u16) -> Crs {
    Crs::from_epsg(Path::new("a"), code).unwrap()
}

fn axis(first: f64, step: f64, len: usize) -> EvenAxis {
    EvenAxis { first, step, len }
}

/// A smooth field as a function of position: waves of a few degrees, periodic around the earth.
fn field(lat_deg: f64, lon_deg: f64) -> f64 {
    100.0 * (3.0 * lat_deg).sin() + 80.0 * (120.0 * lon_deg.to_radians()).cos() + 5.0 * lat_deg
}

fn made(code: u16, x: EvenAxis, y: EvenAxis) -> AnomalyGrid {
    let crs = crs(code);
    let value = |j: usize, i: usize| {
        let (lat, lon) = crs.unproject(x.at(i as f64), y.at(j as f64)).unwrap();
        field(lat, lon)
    };
    let values = (0..y.len).flat_map(|j| (0..x.len).map(move |i| (j, i))).map(|(j, i)| value(j, i)).collect();
    AnomalyGrid::new(x, y, crs.clone(), values, GridHeight::Level(100.0)).unwrap()
}

/// The largest error of a map of the field at its known nodes, and their number.
fn error(map: &AnomalyGrid) -> (f64, usize) {
    let (mut most, mut known) = (0.0_f64, 0);
    for (node, value) in map.anomaly_nt.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
        let (j, i) = (node / map.x.len, node % map.x.len);
        let (lat, lon) = map.crs.unproject(map.x.at(i as f64), map.y.at(j as f64)).unwrap();
        most = most.max((value - field(lat, lon)).abs());
        known += 1;
    }
    (most, known)
}

#[test]
fn law_a_field_is_the_same_in_any_system() {
    // With steps of 1.1 km for waves of 170 km, the polynomials of third degree at the edges have errors of 1e-3 nT.
    let most = 2e-3;
    let utm = made(32630, axis(300_000.0, 1100.0, 60), axis(5_500_000.0, 1100.0, 50));
    let national = utm.to_crs(27700, Some(1000.0)).unwrap();
    assert_eq!((national.x.first % 1000.0, national.y.first % 1000.0, national.x.step), (0.0, 0.0, 1000.0));
    let degrees = national.to_crs(4326, None).unwrap();
    let feet = made(2263, axis(900_000.0, 3000.0, 60), axis(150_000.0, 3000.0, 50));
    for map in [&utm, &national, &degrees, &feet.to_crs(32618, None).unwrap(), &degrees.to_crs(3857, None).unwrap()] {
        let (worst, known) = error(map);
        assert!(worst < most, "{:?}: {worst}", map.crs);
        assert!(known as f64 > 0.7 * map.nodes() as f64, "{:?}: {known} of {}", map.crs, map.nodes());
    }
    assert_eq!(utm.to_crs(32630, None).unwrap(), utm, "its own system changes nothing");
    // The default spacing is the map's own, on the ground.
    let other = feet.to_crs(32618, None).unwrap();
    assert!((other.x.step / (3000.0 * 0.304_800_6) - 1.0).abs() < 0.03, "{}", other.x.step);
}

#[test]
fn unit_results_do_not_depend_on_the_number_of_threads() {
    let map = made(32630, axis(300_000.0, 1100.0, 40), axis(5_500_000.0, 1100.0, 40));
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| map.to_crs(27700, None).unwrap().anomaly_nt)
    };
    let bits = |values: Vec<f64>| values.into_iter().map(f64::to_bits).collect::<Vec<_>>();
    assert_eq!(bits(with(1)), bits(with(4)));
}

#[test]
fn law_maps_across_the_date_line_are_not_split() {
    // Zone 1 south begins at 180 degrees; west of its edge the longitudes are about 179 east.
    let utm = made(32701, axis(150_000.0, 2000.0, 60), axis(7_800_000.0, 2000.0, 30));
    let ((south, north), (west, east)) = utm.bounds_deg().unwrap();
    assert!(west < -180.0 && east > -180.0 && east - west < 3.0 && south < north, "{west} {east}");
    let degrees = utm.to_crs(4326, None).unwrap();
    assert!(degrees.x.first < -180.0 && degrees.x.last() > -180.0, "one axis, not torn");
    let (worst, known) = error(&degrees);
    assert!(worst < 0.02 && known as f64 > 0.7 * degrees.nodes() as f64, "{worst} {known}");
    let back = degrees.to_crs(32701, Some(2000.0)).unwrap();
    let (worst, known) = error(&back);
    assert!(worst < 0.05 && known > 500, "{worst} {known}");
    // One file with longitudes of 0 to 360 across Greenwich, and one across the date line.
    let over = made(4326, axis(175.0, 0.25, 40), axis(-20.0, 0.25, 10));
    assert_eq!(over.bounds_deg().unwrap().1, (175.0, 184.75));
    let (worst, known) = error(&over.to_crs(32701, None).unwrap());
    // With eight nodes per wave of 2.1 degrees, the polynomials of third degree at the edges have errors of 1 nT.
    assert!(worst < 2.0 && known > 200, "{worst} {known}");
}

#[test]
fn gold_a_map_around_a_pole() {
    let polar = made(3031, axis(-500_000.0, 50_000.0, 21), axis(-500_000.0, 50_000.0, 21));
    let message = polar.to_crs(4326, None).unwrap_err().to_string();
    let help = "trim the map, or keep it in its coordinate system";
    assert_eq!(
        message,
        format!("the map contains a pole, which a grid of latitude and longitude cannot represent ({help})")
    );
    assert_eq!(polar.summary().unwrap().lon_deg, None);
    // A map next to the pole needs no special treatment.
    made(3031, axis(500_000.0, 50_000.0, 21), axis(-500_000.0, 50_000.0, 21)).to_crs(4326, None).unwrap();
}

#[test]
fn gold_invalid_maps() {
    let new = |x: EvenAxis, y: EvenAxis, code: u16, values: Vec<f64>, height: GridHeight| {
        AnomalyGrid::new(x, y, crs(code), values, height).map(|_| ()).unwrap_err().to_string()
    };
    let (x, y, level) = (axis(0.0, 1.0, 2), axis(0.0, 1.0, 2), GridHeight::Level(0.0));
    let four = vec![1.0; 4];
    let message = new(axis(0.0, 1.0, 1), y, 4326, four.clone(), level.clone());
    assert_eq!(message, "column `lon`: a map requires at least two nodes along each axis, not 1");
    let message = new(x, axis(0.0, -1.0, 2), 32630, four.clone(), level.clone());
    assert_eq!(message, "column `northing`: the axis must ascend, but it runs from 0 to -1");
    let message = new(x, axis(89.5, 1.0, 2), 4326, four.clone(), level.clone());
    assert!(message.starts_with("column `lat`: the coordinate 90.5 degrees is out of range"), "{message}");
    let message = new(x, y, 4326, vec![1.0; 3], level.clone());
    assert_eq!(message, "column `anomaly`: the grid has 4 nodes, but 3 values");
    assert_eq!(new(x, y, 4326, vec![f64::NAN; 4], level), "column `anomaly`: the map has no known value");
    let message = new(x, y, 4326, four, GridHeight::Cells(vec![0.0; 3]));
    assert_eq!(message, "column `alt`: each node must have a height that is finite, or NaN if unknown");
    let map = made(32630, axis(300_000.0, 1000.0, 5), axis(5_500_000.0, 1000.0, 5));
    assert_eq!(
        map.to_crs(32630, Some(-1.0)).unwrap_err().to_string(),
        "the spacing must be positive and finite, not -1"
    );
    assert!(map.to_crs(27700, Some(1e-3)).unwrap_err().to_string().contains("nodes is too large"));
    assert!(map.to_crs(27700, Some(1e6)).unwrap_err().to_string().contains("wider than the map"));
}

#[test]
fn law_the_plane_of_a_map_is_in_metres_and_converts_back() {
    // A degree of latitude at 52 degrees is 111 267 m, of longitude 68 678 m (WGS-84; NGA calculator).
    let degrees = made(4326, axis(-3.0, 0.1, 6), axis(51.9, 0.1, 3));
    let plane = degrees.plane();
    assert!((plane.north_m.step - 11_126.7).abs() < 0.1 && (plane.east_m.step - 6_867.8).abs() < 0.1, "{plane:?}");
    let back = degrees.with_plane(plane, degrees.height.clone()).unwrap();
    assert!((back.x.first + 3.0).abs() < 1e-14 && (back.y.step - 0.1).abs() < 1e-15);
    assert_eq!(back.anomaly_nt, degrees.anomaly_nt);
    let feet = made(2263, axis(900_000.0, 1000.0, 6), axis(150_000.0, 1000.0, 5)).plane();
    assert!((feet.east_m.step - 304.800_61).abs() < 1e-4, "{}", feet.east_m.step);
    // Web Mercator at 60 degrees has a scale of 2 (1.995 and 2.005 along the two axes of the ellipsoid).
    let mercator = made(3857, axis(0.0, 1000.0, 6), axis(8_399_000.0, 1000.0, 5)).plane();
    assert!((mercator.east_m.step - 501.0).abs() < 2.0 && (mercator.north_m.step - 499.0).abs() < 2.0, "{mercator:?}");
    let utm = made(32630, axis(300_000.0, 1000.0, 6), axis(5_500_000.0, 1000.0, 5)).plane();
    assert_eq!((utm.east_m.first, utm.east_m.step), (300_000.0, 1000.0));
}

#[test]
fn law_a_drape_is_resampled_with_its_map() {
    let utm = made(32630, axis(300_000.0, 1100.0, 20), axis(5_500_000.0, 1100.0, 20));
    let plane = |e: f64, n: f64| 100.0 + 1e-3 * (e - 300_000.0) + 2e-3 * (n - 5_500_000.0);
    let heights = (0..400).map(|k| plane(utm.x.at(f64::from(k % 20)), utm.y.at(f64::from(k / 20)))).collect();
    let drape = AnomalyGrid { height: GridHeight::Cells(heights), ..utm };
    let table = drape.to_geographic().unwrap();
    let mut known = 0;
    for (i, alt) in table.column("alt").iter().enumerate().filter(|(_, a)| !a.is_nan()) {
        let (e, n) = drape.crs.project(table.column("lat")[i], table.column("lon")[i]).unwrap();
        // A plane is exact except for rounding.
        assert!((alt - plane(e, n)).abs() < 1e-6);
        known += 1;
    }
    assert!(known > 200 && !table.column("anomaly")[5].is_infinite());
}

#[test]
fn law_a_summary_has_the_statistics_of_the_map() {
    let mut map = made(32630, axis(300_000.0, 100.0, 4), axis(5_500_000.0, 200.0, 3));
    map.anomaly_nt = [0.0, 1.0, 2.0, f64::NAN, 10.0, 11.0, 12.0, 13.0, 20.0, 21.0, 22.0, 23.0].to_vec();
    let summary = map.summary().unwrap();
    assert_eq!((summary.nodes, summary.unknown, summary.unit), ((4, 3), 1, "m"));
    assert_eq!(
        (summary.x, summary.y, summary.spacing),
        ((300_000.0, 300_300.0), (5_500_000.0, 5_500_400.0), (100.0, 200.0))
    );
    // numpy 2: min, mean, max, std and percentiles of the eleven values.
    assert_eq!(summary.min_mean_max_nt, (0.0, 135.0 / 11.0, 23.0));
    assert!((summary.std_nt - 8.180_808_0).abs() < 1e-6, "{}", summary.std_nt);
    let expected = [0.1, 0.5, 6.0, 12.0, 20.5, 22.5, 22.9];
    assert!(
        summary.percentiles_nt.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12),
        "{:?}",
        summary.percentiles_nt
    );
    assert_eq!(summary.mean_step_nt, (1.0, 10.0));
    // The scale of zone 30 at 300 km is 1.00009.
    assert!((summary.spacing_m.0 - 100.0).abs() < 0.05 && (summary.spacing_m.1 - 200.0).abs() < 0.1);
    let figures = summary.figures();
    let figure = |name: &str| figures.iter().find(|f| f.0 == name).unwrap().clone();
    assert_eq!(figure("unknown_share").1, SummaryValue::Number(100.0 / 12.0));
    assert_eq!((figure("west").2, figure("percentile_50").2), ("m", "nT"));
}

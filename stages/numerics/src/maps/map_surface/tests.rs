#![allow(clippy::unwrap_used)]
use super::*;

/// The map of MagNav.jl's golden cases, map[j,k] = 100 sin(.7j) + 40 cos(.5k) + 2jk with j = 1..9
/// from latitude 0.70 to 0.7008 rad and k = 1..11 from longitude -1.30 to -1.2990 rad.
pub(crate) fn golden_grid() -> GeographicGrid {
    let lat: Vec<f64> = (0..9).map(|j| (0.70 + 1e-4 * f64::from(j)).to_degrees()).collect();
    let lon: Vec<f64> = (0..11).map(|k| (-1.30 + 1e-4 * f64::from(k)).to_degrees()).collect();
    let node = |j: f64, k: f64| 100.0 * (0.7 * j).sin() + 40.0 * (0.5 * k).cos() + 2.0 * j * k;
    let values: Vec<f64> = (1..=9).flat_map(|j| (1..=11).map(move |k| node(f64::from(j), f64::from(k)))).collect();
    GeographicGrid::new(&lat, &lon, &values).unwrap()
}

pub(super) const ALL: [MapInterpolation; 3] =
    [MapInterpolation::Linear, MapInterpolation::Quadratic, MapInterpolation::Cubic];

const PLACES: [(f64, f64); 3] = [(0.70023, -1.29947), (0.70001, -1.29999), (0.70079, -1.29901)];

fn at_rad(map: &MapSurface, (lat, lon): (f64, f64)) -> FieldValue {
    map.at(lat.to_degrees(), lon.to_degrees()).unwrap()
}

#[test]
fn val_magnav_interpolation_and_gradient() {
    let cases = [
        (
            MapInterpolation::Linear,
            [73.097_030_017_780_6, 104.008_270_602_819_2, 215.867_345_281_223_71],
            [-402_221.216_492_869_37, 87_414.323_723_805_28],
        ),
        (
            MapInterpolation::Quadratic,
            [75.548_467_351_735_7, 104.780_081_380_927_64, 215.526_026_043_600_35],
            [-349_454.255_889_000_43, 68_081.182_304_750_18],
        ),
        (
            MapInterpolation::Cubic,
            [75.347_292_442_001_67, 105.114_029_169_415_13, 215.419_425_062_506_27],
            [-347_993.863_016_065_9, 67_831.772_720_114_82],
        ),
    ];
    for (interpolation, values, gradient) in cases {
        let map = MapSurface::new(&golden_grid(), interpolation);
        for (place, expected) in PLACES.into_iter().zip(values) {
            // Conversion to degrees and back moves the position by 2e-16 rad, 1e-10 nT at 4e5 nT/rad.
            assert!((at_rad(&map, place).value_nt - expected).abs() < 1e-9);
        }
        let at = at_rad(&map, PLACES[0]);
        // MagNav.jl's gradients are central differences over 1e-8 rad: rounding of 1e-14 x 75 nT / 2e-8 rad.
        assert!((at.d_lat_nt_per_rad - gradient[0]).abs() < 0.05, "{at:?}");
        assert!((at.d_lon_nt_per_rad - gradient[1]).abs() < 0.05, "{at:?}");
    }
}

#[test]
fn jac_gradient_of_all_interpolations() {
    let grid = golden_grid();
    for interpolation in ALL {
        let map = MapSurface::new(&grid, interpolation);
        for place in [(0.70001, -1.29999), (0.70047, -1.29932), (0.700796, -1.299002)] {
            let (step, at) = (1e-9, at_rad(&map, place));
            let difference = |dlat: f64, dlon: f64| {
                (at_rad(&map, (place.0 + dlat, place.1 + dlon)).value_nt
                    - at_rad(&map, (place.0 - dlat, place.1 - dlon)).value_nt)
                    / (2.0 * step)
            };
            // Rounding of the position in degrees: 1e-10 nT over 2e-9 rad; gradients are 1e5 nT/rad.
            assert!((at.d_lat_nt_per_rad - difference(step, 0.0)).abs() < 0.5);
            assert!((at.d_lon_nt_per_rad - difference(0.0, step)).abs() < 0.5);
        }
    }
}

#[test]
fn unit_nodes_edges_and_outside_positions() {
    let grid = golden_grid();
    let (lat, lon) = (grid.lat(), grid.lon());
    for interpolation in ALL {
        let map = MapSurface::new(&grid, interpolation);
        for row in 0..lat.len() {
            for column in 0..lon.len() {
                let place =
                    (lat.first_deg() + lat.step_deg() * row as f64, lon.first_deg() + lon.step_deg() * column as f64);
                let value = map.at(place.0, place.1).unwrap().value_nt;
                assert!((value - grid.values()[row * lon.len() + column]).abs() < 1e-9);
            }
        }
        let (middle_lat, middle_lon) = (lat.first_deg() + 0.02, lon.first_deg() + 0.02);
        assert!(map.at(lat.first_deg() - 1e-6, middle_lon).is_none());
        assert!(map.at(lat.last_deg() + 1e-6, middle_lon).is_none());
        assert!(map.at(middle_lat, lon.last_deg() + 1e-6).is_none());
        assert!(map.at(f64::NAN, middle_lon).is_none() && map.at(middle_lat, f64::INFINITY).is_none());
        let turned = map.at(middle_lat, middle_lon + 360.0).unwrap();
        assert!((turned.value_nt - map.at(middle_lat, middle_lon).unwrap().value_nt).abs() < 1e-8);
    }
}

fn wavy(rows: usize, columns: usize) -> Vec<f64> {
    (0..rows * columns)
        .map(|i| ((i / columns) as f64 * 0.3).sin() * 50.0 + ((i % columns) as f64 * 0.4).cos() * 30.0)
        .collect()
}

fn axis(first: f64, count: usize) -> Vec<f64> {
    (0..count).map(|k| first + 0.001 * k as f64).collect()
}

#[test]
fn unit_a_hole_is_unknown_and_affects_only_cells_near_it() {
    let (rows, columns) = (30, 40);
    let complete = wavy(rows, columns);
    let mut holed = complete.clone();
    for row in 10..20 {
        holed[row * columns + 15..row * columns + 25].fill(f64::NAN);
    }
    let (lat, lon) = (axis(-22.0, rows), axis(140.0, columns));
    for interpolation in ALL {
        let full = MapSurface::new(&GeographicGrid::new(&lat, &lon, &complete).unwrap(), interpolation);
        let map = MapSurface::new(&GeographicGrid::new(&lat, &lon, &holed).unwrap(), interpolation);
        for (row, column) in (0..rows - 1).flat_map(|r| (0..columns - 1).map(move |c| (r, c))) {
            let place = (lat[row] + 0.0003, lon[column] + 0.0006);
            let unknown = (9..20).contains(&row) && (14..25).contains(&column);
            let value = map.at(place.0, place.1);
            assert_eq!(value.is_none(), unknown, "{row} {column}");
            let Some(value) = value else { continue };
            let distance = [9_i64 - row as i64, row as i64 - 19, 14 - column as i64, column as i64 - 24]
                .into_iter()
                .max()
                .unwrap_or(0);
            // The slope at the hole's edge changes by less than 40 nT; its effect on a spline decreases by 2 - sqrt(3)
            // per cell.
            let bound = 0.5 * (2.0_f64 - 3.0_f64.sqrt()).powi(distance as i32 - 1) + 1e-9;
            let error = (value.value_nt - full.at(place.0, place.1).unwrap().value_nt).abs();
            assert!(error < bound * 10.0, "{row} {column} {error} {bound}");
            assert!(distance < 6 || error < 0.01, "{distance} {error}");
        }
    }
}

#[test]
fn unit_rows_of_a_table_make_the_same_map() {
    let grid = golden_grid();
    let (lat, lon) = (axis(50.0, 4), axis(-5.0, 3));
    let table: (Vec<f64>, Vec<f64>) = lat.iter().flat_map(|lat| lon.iter().map(move |lon| (*lat, *lon))).unzip();
    let values = &grid.values()[..12];
    let of_rows = GeographicGrid::from_rows(&table.0, &table.1, values).unwrap();
    assert_eq!(of_rows, GeographicGrid::new(&lat, &lon, values).unwrap());
    assert_eq!(of_rows.lat().last_deg(), lat[3]);
    let mut swapped = table.clone();
    swapped.1.swap(4, 5);
    let message = GeographicGrid::from_rows(&swapped.0, &swapped.1, values).unwrap_err().to_string();
    assert!(message.starts_with("row 4 of the map is at latitude 50.001, longitude -4.998"), "{message}");
    assert!(GeographicGrid::from_rows(&table.0[..11], &table.1[..11], &values[..11]).is_err());
    assert!(GeographicGrid::from_rows(&[], &[], &[]).is_err());
    assert!(matches!(GeographicGrid::from_rows(&[1.0], &[], &[2.0]), Err(MapGridError::Columns { .. })));
}

#[test]
fn unit_invalid_maps_are_rejected() {
    let (lat, lon, values) = (axis(50.0, 3), axis(10.0, 3), vec![1.0; 9]);
    let refused =
        |lat: &[f64], lon: &[f64], values: &[f64]| GeographicGrid::new(lat, lon, values).unwrap_err().to_string();
    let descending: Vec<f64> = lat.iter().rev().copied().collect();
    assert_eq!(
        refused(&descending, &lon, &values),
        "the map's latitudes must ascend, but latitude 1 is 50.001 after 50.002"
    );
    assert!(refused(&lat, &[10.0, 10.4, 11.0], &values).contains("even steps: longitude 1 is 10.4"));
    assert!(refused(&lat, &[10.0], &values).contains("at least two"));
    assert!(refused(&[50.0, f64::NAN, 52.0], &lon, &values).contains("latitude 1 of the map is NaN"));
    assert!(refused(&[80.0, 90.0, 100.0], &lon, &values).contains("outside the valid range"));
    assert!(refused(&lat, &[0.0, 200.0, 400.0], &values).contains("outside the valid range"));
    assert!(refused(&lat, &lon, &values[..8]).contains("8 values for 3 latitudes"));
    assert_eq!(refused(&lat, &lon, &[f64::NAN; 9]), "every value of the map is NaN");
    let mut infinite = values.clone();
    infinite[7] = f64::INFINITY;
    assert!(refused(&lat, &lon, &infinite).contains("row 7 of the map is infinite"));
    assert!(GeographicGrid::new(&lat, &lon, &values).is_ok());
}

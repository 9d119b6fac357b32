//! Maps around the whole earth: closed at their seam, with and without a repeated first meridian.

#![allow(clippy::unwrap_used)]

use super::*;

fn field(lat: f64, lon: f64) -> f64 {
    let (phi, lambda) = (lat.to_radians(), lon.to_radians());
    100.0 * lambda.cos() * phi.cos() + 50.0 * (2.0 * lambda).sin() * phi.cos().powi(2) + lat
}

fn globe(west: f64, columns: usize) -> GeographicGrid {
    let lat: Vec<f64> = (0..31).map(|j| -60.0 + 4.0 * f64::from(j)).collect();
    let lon: Vec<f64> = (0..columns).map(|i| west + 4.0 * i as f64).collect();
    let values: Vec<f64> = lat.iter().flat_map(|lat| lon.iter().map(|lon| field(*lat, *lon))).collect();
    GeographicGrid::new(&lat, &lon, &values).unwrap()
}

#[test]
fn law_interpolation_at_the_seam_equals_that_elsewhere() {
    for (west, columns) in [(-180.0, 90), (-180.0, 91), (0.0, 90), (0.0, 91), (-178.0, 90)] {
        for (kind, most) in
            [(MapInterpolation::Linear, 0.5), (MapInterpolation::Quadratic, 0.02), (MapInterpolation::Cubic, 0.005)]
        {
            let map = MapSurface::new(&globe(west, columns), kind);
            for i in -80..=80 {
                let (lat, lon) = (11.3, west + 0.1 * f64::from(i));
                // Longitudes are within one full turn.
                for turn in [-360.0, 0.0, 360.0].into_iter().filter(|turn| (lon + turn).abs() <= 360.0) {
                    let found = map.at(lat, lon + turn).map(|f| f.value_nt);
                    let error = found.map(|v| (v - field(lat, lon)).abs());
                    assert!(error.is_some_and(|e| e < most), "{west} {columns} {kind:?} {lon}: {error:?}");
                }
            }
            // With splines, value and slope are continuous across the seam.
            if kind != MapInterpolation::Linear {
                let (left, right) = (map.at(11.3, west - 1e-6).unwrap(), map.at(11.3, west + 1e-6).unwrap());
                assert!((left.d_lon_nt_per_rad - right.d_lon_nt_per_rad).abs() < 1e-3, "{left:?} {right:?}");
            }
        }
    }
}

#[test]
fn unit_a_known_value_fills_its_repeated_meridian() {
    let lat = [0.0, 10.0];
    let lon: Vec<f64> = (0..37).map(|i| 10.0 * f64::from(i)).collect();
    let mut values = vec![1.0; 74];
    (values[0], values[73]) = (f64::NAN, f64::NAN);
    let map = MapSurface::new(&GeographicGrid::new(&lat, &lon, &values).unwrap(), MapInterpolation::Linear);
    assert_eq!(map.at(5.0, 359.0).map(|f| f.value_nt), Some(1.0));
    assert_eq!(map.at(5.0, 1.0).map(|f| f.value_nt), Some(1.0));
    // A map that does not quite span the earth is not closed.
    let short = GeographicGrid::new(&lat, &lon[..35], &values[..70]).unwrap();
    assert_eq!(short.lon().len(), 35);
}

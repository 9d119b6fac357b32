#![allow(clippy::unwrap_used)]

use super::*;
use crate::maps::MapInterpolation;
use crate::navigation::position_fixes::PositionFixes;
use crate::navigation::scenes::AnalyticScene;

fn scene(field_nt: impl Fn(f64, f64) -> f64) -> AnalyticScene {
    let tt: Vec<f64> = (0..=60).map(f64::from).collect();
    AnalyticScene::new(&tt, MapInterpolation::Cubic, field_nt)
}

#[test]
fn law_the_range_of_a_quadratic_field_has_a_closed_form() {
    // With h = a n²/2 + b e²/2 and variance r² on each axis, ε² = (3 a² + 2 a b + 3 b²) r⁴/4.
    let (a, b) = (2e-4, -3e-4);
    let range = scene(|north, east| 0.5 * (a * north * north + b * east * east) + 0.03 * north).with(at_start);
    let expected = (4.0 * 25.0 / (3.0 * a * a + 2.0 * a * b + 3.0 * b * b)).powf(0.25);
    // The spline of a parabola with a natural end differs near the edges of the map only.
    assert!((range.limit_m / expected - 1.0).abs() < 2e-3, "{range:?} {expected}");
    assert!((range.sigma_m - 100.0).abs() < 1e-6 && !range.is_exceeded());
    let mut wide = scene(|north, east| 0.5 * (a * north * north + b * east * east));
    wide.errors.sources.init_position_sigma_m = 1500.0;
    let range = wide.with(at_start);
    assert!((range.limit_m / expected - 1.0).abs() < 2e-3 && range.is_exceeded(), "{range:?}");
    // Half the noise reduces the range by the square root.
    wide.sigma_nt.fill(2.5);
    let narrower = wide.with(at_start).limit_m;
    assert!((range.limit_m / narrower - 2_f64.sqrt()).abs() < 1e-3, "{narrower}");
}

#[test]
fn law_the_range_has_the_shape_of_the_covariance() {
    // An error north of s and an error east of s/2, over a field that bends only along one diagonal:
    // h = a u²/2 with u = (n + e)/√2, so ε² = 3 a² Var(u)²/4 with Var(u) = (s² + s²/4)/2 + covariance.
    let a = 3e-4;
    let mut scene = scene(|north, east| 0.25 * a * (north + east).powi(2));
    for correlation in [-0.6, 0.0, 0.6] {
        let (north_m, east_m) =
            scene.errors.earth.north_east_m_per_rad(scene.columns[1][0].to_radians(), scene.columns[3][0]);
        let mut p = scene.errors.initial_covariance(0.78, 500.0);
        p[LAT][LAT] = (100.0 / north_m).powi(2);
        p[LON][LON] = (50.0 / east_m).powi(2);
        p[LAT][LON] = correlation * 5000.0 / (north_m * east_m);
        p[LON][LAT] = p[LAT][LON];
        scene.errors.start = Some(p);
        let range = scene.with(at_start);
        let variance = 0.5 * (10_000.0 + 2_500.0) + correlation * 5000.0;
        let expected = range.sigma_m * (4.0 * 25.0 / (3.0 * a * a * variance * variance)).powf(0.25);
        assert!((range.limit_m / expected - 1.0).abs() < 2e-3, "{correlation}: {range:?} {expected}");
        let longer = 6_250.0 + (3_750_f64.powi(2) + (correlation * 5000.0).powi(2)).sqrt();
        assert!((range.sigma_m - longer.sqrt()).abs() < 1e-6, "{range:?}");
    }
}

#[test]
fn law_a_fix_of_the_first_sample_bounds_the_uncertainty() {
    let mut scene = scene(|north, _| 1e-4 * north * north);
    scene.errors.sources.init_position_sigma_m = 1500.0;
    let rows = scene.sigma_nt.len();
    let at_first = |value: f64| (0..rows).map(|row| if row == 0 { value } else { f64::NAN }).collect::<Vec<f64>>();
    scene.fixes = Some(PositionFixes {
        lat_deg: at_first(scene.columns[1][0]),
        lon_deg: at_first(scene.columns[2][0]),
        alt_m: at_first(f64::NAN),
        horizontal_sigma_m: 20.0,
        vertical_sigma_m: 20.0,
    });
    let range = scene.with(at_start);
    assert!((range.sigma_m - 20.0).abs() < 0.01 && !range.is_exceeded(), "{range:?}");
}

#[test]
fn unit_a_linear_field_has_no_limit_and_an_unknown_field_no_range() {
    let linear = scene(|north, east| 0.05 * north - 0.02 * east).with(at_start);
    assert!(linear.limit_m > 0.99 * RANGE_M[1] && !linear.is_exceeded(), "{linear:?}");
    let mut exact = scene(|north, _| 1e-4 * north * north);
    exact.errors.sources.init_position_sigma_m = 0.0;
    let range = exact.with(at_start);
    assert!(range.sigma_m == 0.0 && range.limit_m > 50.0 && !range.is_exceeded(), "{range:?}");
    let mut off = scene(|north, _| 1e-4 * north * north);
    off.columns[1].iter_mut().for_each(|lat| *lat += 1.0);
    let range = off.with(at_start);
    assert!(range.limit_m.is_nan() && !range.is_exceeded());
    let mut silent = scene(|north, _| 1e-4 * north * north);
    silent.measurement_nt.fill(f64::NAN);
    assert!(silent.with(at_start).limit_m.is_nan());
}

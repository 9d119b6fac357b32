#![allow(clippy::unwrap_used)]

use super::*;
use crate::maps::MapInterpolation;
use crate::navigation::position_fixes::PositionFixes;
use crate::navigation::scenes::AnalyticScene;

fn scene(field_nt: impl Fn(f64, f64) -> f64) -> AnalyticScene {
    let tt: Vec<f64> = (0..=60).map(f64::from).collect();
    AnalyticScene::new(&tt, MapInterpolation::Cubic, field_nt)
}

/// Path of a scene.
fn path(scene: &AnalyticScene) -> PathStart {
    let [_, lat, lon, alt, vn, ve, ..] = &scene.columns;
    PathStart { lat_deg: lat[0], lon_deg: lon[0], alt_m: alt[0], velocity_ne_mps: [vn[0], ve[0]] }
}

#[test]
fn law_the_linearisation_error_of_a_quadratic_field_is_exact() {
    // h = a u²/2 bends only along u = (n + e)/√2, so ε² = 3 a² Var(u)²/4, with Var(u) = (Var(n) + Var(e))/2 + Cov(n,
    // e).
    let a = 3e-4;
    let scene = scene(|north, east| 0.25 * a * (north + east).powi(2));
    for correlation in [-0.6, 0.0, 0.6] {
        let at = path(&scene);
        let (north_m, east_m) = scene.errors.earth.north_east_m_per_rad(at.lat_deg.to_radians(), at.alt_m);
        let covariance = [100.0 * 100.0, correlation * 100.0 * 50.0, 50.0 * 50.0];
        let [n, both, e] = covariance;
        let root = cholesky([n / north_m.powi(2), both / (north_m * east_m), e / east_m.powi(2)]);
        let found = scene.with(|line| LinearityTest::new(line).changes(&at, root)).unwrap().error_nt;
        let expected = (0.75_f64).sqrt() * a * (0.5 * (n + e) + both);
        // The spline of a parabola with a natural end differs near the edges of the map only.
        assert!((found / expected - 1.0).abs() < 2e-3, "{correlation}: {found} {expected}");
        let longer = longer_axis(covariance);
        let expected = 6_250.0 + (3_750_f64.powi(2) + (correlation * 5000.0).powi(2)).sqrt();
        assert!((longer.powi(2) / expected - 1.0).abs() < 1e-12, "{longer}");
    }
}

#[test]
fn law_the_range_of_a_quadratic_field_has_a_closed_form() {
    // With h = a n²/2 + b e²/2 and variance r² on each axis, ε² = (3 a² + 2 a b + 3 b²) r⁴/4.
    let (a, b) = (2e-4, -3e-4);
    let bend = (0.25_f64 * (3.0 * a * a + 2.0 * a * b + 3.0 * b * b)).sqrt();
    let mut scene = scene(|north, east| 0.5 * (a * north * north + b * east * east));
    // Large noise exceeds a third of the linear change.
    for sigma_nt in [200.0, 100.0] {
        scene.sigma_nt.fill(sigma_nt);
        let (range, expected) = (scene.with(at_start), f64::sqrt(sigma_nt / bend));
        assert!((range.limit_m / expected - 1.0).abs() < 5e-3, "{range:?} {expected}");
        assert!((range.sigma_m - 100.0).abs() < 1e-6 && !range.is_exceeded());
    }
    // With little noise, ε is a third of λ = |∇h| r at r = |∇h|/(3 bend), for the median slope of the path.
    scene.sigma_nt.fill(0.01);
    let slope = |k: u32| f64::hypot(a * 60.0 * (5.0 * f64::from(k) - 30.0), b * 30.0 * (5.0 * f64::from(k) - 30.0));
    let expected = median((0..13).map(slope).collect()).unwrap() / (3.0 * bend);
    let range = scene.with(at_start);
    assert!((range.limit_m / expected - 1.0).abs() < 0.01, "{range:?} {expected}");
    scene.errors.sources.init_position_sigma_m = 1500.0;
    let wide = scene.with(at_start);
    assert!((wide.limit_m / range.limit_m - 1.0).abs() < 1e-3 && wide.is_exceeded(), "{wide:?}");
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
fn unit_the_range_of_a_linear_field_is_the_extent_of_the_map_and_an_unknown_field_no_range() {
    let linear = scene(|north, east| 0.05 * north - 0.02 * east).with(at_start);
    // The map is 14 km wide, and the nearest node of the rule is 0.9 standard deviations from its centre.
    assert!((7e3..2e4).contains(&linear.limit_m) && !linear.is_exceeded(), "{linear:?}");
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

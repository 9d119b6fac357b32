//! Properties that hold for any map.

use realfft::num_complex::Complex;

use crate::maps::continuation::*;

use super::fields::{Field, Random, Scene, depth, minus, rms_where};
use super::{formula, worst};

fn noise(rows: usize, columns: usize) -> PlaneGrid {
    let mut random = Random::new(11);
    let mut map = formula(rows, columns, [80.0, 50.0], |_, _| 0.0);
    map.values.iter_mut().for_each(|value| *value = 100.0 * random.normal());
    map
}

#[test]
fn law_a_constant_is_the_same_at_any_height_and_has_no_slope() {
    let map = formula(20, 33, [80.0, 50.0], |_, _| 271.5);
    let spectrum = MapSpectrum::new(&map, 400.0, &Padding::default()).unwrap();
    for up_m in [-400.0, 0.0, 400.0] {
        assert!(worst(&spectrum.at_height(up_m, 200.0).unwrap().values, &map.values) < 1e-10);
        let slope = spectrum.derivative(MapDerivative::Up, up_m, 200.0).unwrap();
        assert!(worst(&slope.values, &vec![0.0; 660]) < 1e-10);
    }
}

#[test]
fn law_a_plane_is_the_same_at_any_height_and_keeps_its_slopes() {
    let map = formula(20, 33, [80.0, 50.0], |j, k| 100.0 + 3.0 * j - 2.0 * k);
    let padding = Padding { trend: TrendRemoval::EdgePlane, ..Padding::default() };
    let spectrum = MapSpectrum::new(&map, 400.0, &padding).unwrap();
    assert!(worst(&spectrum.at_height(400.0, 0.0).unwrap().values, &map.values) < 1e-10);
    for (which, slope) in
        [(MapDerivative::East, -2.0 / 80.0), (MapDerivative::North, 3.0 / 50.0), (MapDerivative::Up, 0.0)]
    {
        let ours = spectrum.derivative(which, 100.0, 0.0).unwrap();
        assert!(worst(&ours.values, &vec![slope; 660]) < 1e-12, "{which:?}");
    }
}

#[test]
fn law_a_periodic_wave_is_damped_by_its_wavenumber_alone() {
    let (rows, columns) = (24, 30);
    let tau = std::f64::consts::TAU;
    let phase = |j: f64, k: f64| tau * (3.0 * k / 30.0 + 2.0 * j / 24.0);
    let wave = formula(rows, columns, [80.0, 50.0], |j, k| phase(j, k).cos());
    let (k_east, k_north) = (tau * 3.0 / (30.0 * 80.0), tau * 2.0 / (24.0 * 50.0));
    let k = k_east.hypot(k_north);
    let spectrum = MapSpectrum::new(&wave, 0.0, &Padding::none()).unwrap();
    let scaled = |factor: f64| wave.values.iter().map(|v| v * factor).collect::<Vec<f64>>();
    let (up_m, down_m, alpha) = (130.0_f64, 70.0_f64, 900.0);
    assert!(worst(&spectrum.at_height(up_m, alpha).unwrap().values, &scaled((-k * up_m).exp())) < 1e-13);
    let growth = (k * down_m).exp();
    let damped = growth / (1.0 + alpha * k * k * growth);
    assert!(worst(&spectrum.at_height(-down_m, alpha).unwrap().values, &scaled(damped)) < 1e-13);
    let east = formula(rows, columns, [80.0, 50.0], |j, k| -k_east * phase(j, k).sin());
    assert!(worst(&spectrum.derivative(MapDerivative::East, 0.0, 0.0).unwrap().values, &east.values) < 1e-13);
    let north = formula(rows, columns, [80.0, 50.0], |j, k| -k_north * phase(j, k).sin());
    assert!(worst(&spectrum.derivative(MapDerivative::North, 0.0, 0.0).unwrap().values, &north.values) < 1e-13);
}

#[test]
fn law_the_derivatives_obey_laplace() {
    let map = noise(31, 40); // odd padding excludes the wave of two nodes
    let padding = Padding { width: PaddingWidth::Nodes([2, 2]), even: false, ..Padding::default() };
    let spectrum = MapSpectrum::new(&map, 0.0, &padding).unwrap();
    assert_eq!([spectrum.layout().rows.padded % 2, spectrum.layout().columns.padded % 2], [1, 1]);
    let across = spectrum.filtered(|east, north| Complex::new(-east * east - north * north, 0.0));
    let up = spectrum.derivative(MapDerivative::UpTwice, 0.0, 0.0).unwrap();
    let sum: Vec<f64> = up.values.iter().zip(&across.values).map(|(a, b)| a + b).collect();
    assert!(worst(&sum, &vec![0.0; map.values.len()]) < 1e-12 * 100.0);
}

#[test]
fn law_both_filters_agree_and_a_factor_of_one_is_the_identity() {
    for (rows, columns) in [(2, 2), (5, 3), (16, 16), (67, 83), (90, 200)] {
        let map = noise(rows, columns);
        for padding in [Padding::default(), Padding::none(), Padding::magnav(&map, 100.0)] {
            let spectrum = MapSpectrum::new(&map, 100.0, &padding).unwrap();
            let itself = spectrum.filtered_radially(|_| 1.0);
            assert!(worst(&itself.values, &map.values) < 1e-10, "{rows} x {columns}");
            let radial = spectrum.at_height(100.0, 0.0).unwrap();
            let general = spectrum.filtered(|e, n| Complex::new((-100.0 * e.hypot(n)).exp(), 0.0));
            assert!(worst(&radial.values, &general.values) < 1e-10);
            let once = upward(&map, 100.0, &padding).unwrap();
            assert!(worst(&radial.values, &once.values) < 1e-10);
        }
    }
}

#[test]
fn unit_results_do_not_depend_on_the_number_of_threads() {
    let map = noise(83, 149);
    let heights: Vec<f64> = (0..map.values.len()).map(|i| 60.0 * (i as f64 * 0.01).sin()).collect();
    let bits = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let padding = Padding::default();
            let up = upward(&map, 120.0, &padding).unwrap();
            let down = downward(&map, 60.0, Regularisation::LCurve, &padding).unwrap();
            let drape = drape_to_level(&map, &heights, 30.0, &DrapeOptions::default()).unwrap();
            let error = edge_error(&map, 50.0, 0.0, &padding).unwrap();
            let all = [up.values, down.map.values, vec![down.alpha_m2], drape.values, error.map.values].concat();
            all.iter().map(|value| value.to_bits()).collect::<Vec<u64>>()
        })
    };
    let one = bits(1);
    assert!(bits(2) == one && bits(3) == one && bits(8) == one);
}

#[test]
fn law_down_and_up_again_reproduces_the_map_within_the_reported_error() {
    let map = Field::new(Scene::Around, 6, [60, 70]).anomaly(100.0);
    let padding = Padding::default();
    for regularisation in [Regularisation::LCurve, Regularisation::Alpha(5e3)] {
        let down = downward(&map, 100.0, regularisation, &padding).unwrap();
        let back = upward(&down.map, 100.0, &padding).unwrap();
        let error = rms_where(&minus(&back, &map), |_, _| true);
        assert!(error <= 1.000_001 * down.regularisation_error_nt, "{error}");
        assert!(down.regularisation_error_nt < 0.2 * rms_where(&map, |_, _| true));
    }
    let strong = downward(&map, 100.0, Regularisation::Alpha(5e3), &padding).unwrap();
    // Away from the edges the misfit equals the misfit on the L-curve for this α.
    let point = strong
        .curve
        .points
        .iter()
        .min_by(|a, b| (a.alpha_m2.ln() - 5e3_f64.ln()).abs().total_cmp(&(b.alpha_m2.ln() - 5e3_f64.ln()).abs()))
        .unwrap();
    let back = upward(&strong.map, 100.0, &padding).unwrap();
    let inner = rms_where(&minus(&back, &map), |row, column| depth(&map, row, column) >= 8);
    assert!((0.5..2.0).contains(&(inner / point.misfit_nt)), "{inner} {}", point.misfit_nt);
}

#[test]
fn law_misfit_rises_and_roughness_falls_along_the_l_curve() {
    let map = noise(50, 60);
    let curve = downward(&map, 90.0, Regularisation::LCurve, &Padding::default()).unwrap().curve;
    assert!(curve.points.windows(2).all(|pair| pair[0].alpha_m2 < pair[1].alpha_m2));
    assert!(curve.points.windows(2).all(|pair| pair[0].misfit_nt < pair[1].misfit_nt));
    assert!(curve.points.windows(2).all(|pair| pair[0].roughness_nt_per_m > pair[1].roughness_nt_per_m));
    assert!(curve.points.iter().all(|point| point.curvature <= curve.points[curve.corner].curvature));
}

#[test]
fn law_far_downward_continuation_stays_bounded() {
    let map = noise(30, 30);
    let down = continued(&map, -1e5, 200.0, &Padding { width: PaddingWidth::None, ..Padding::default() }).unwrap();
    assert!(down.values.iter().all(|value| value.is_finite()));
}

#[test]
fn unit_padding_is_ten_distances_within_the_limit_of_nodes() {
    let map = formula(100, 300, [50.0, 50.0], |_, _| 0.0);
    let wide = Padding::default().layout(&map, 500.0).unwrap();
    assert!(wide.rows.before >= 100 && wide.columns.after() >= 100);
    assert_eq!(wide.rows.before + wide.rows.len + wide.rows.after(), wide.rows.padded);
    assert_eq!(seven_smooth(wide.columns.padded), wide.columns.padded);
    let bounded = Padding::default().layout(&map, 1e9).unwrap();
    assert!(bounded.rows.before >= MOST_PADDING && bounded.rows.before < MOST_PADDING + 200);
    let small = Padding { most_nodes: 60_000, ..Padding::default() };
    let narrowed = small.layout(&map, 500.0).unwrap();
    assert!(narrowed.nodes() <= 60_000 && narrowed.rows.before > 0, "{narrowed:?}");
    let none = Padding { most_nodes: 100, ..Padding::default() }.layout(&map, 500.0);
    assert!(matches!(none, Err(ContinuationError::TooLarge { most: 100, .. })));
}

#[test]
fn unit_invalid_maps_are_rejected_with_a_remedy() {
    let map = noise(20, 30);
    let padding = Padding::default();
    let mut holes = map.clone();
    (holes.values[65], holes.values[70]) = (f64::NAN, f64::INFINITY);
    let refused = upward(&holes, 10.0, &padding).unwrap_err();
    assert_eq!(refused, ContinuationError::Unknown { count: 2, nodes: 600, row: 2, column: 5 });
    assert!(refused.to_string().contains("fill the map first"));
    let line = formula(1, 30, [1.0, 1.0], |_, _| 0.0);
    assert_eq!(check(&line), Err(ContinuationError::TooSmall { rows: 1, columns: 30 }));
    let mut short = map.clone();
    short.values.pop();
    assert_eq!(check(&short), Err(ContinuationError::Shape { values: 599, rows: 20, columns: 30 }));
    let mut turned = map.clone();
    turned.north_m.step = -50.0;
    assert_eq!(expand(&turned, 2).unwrap_err(), ContinuationError::Spacing { step_m: -50.0 });
    assert!(matches!(upward(&map, -1.0, &padding), Err(ContinuationError::Height { .. })));
    assert!(matches!(upward(&map, f64::NAN, &padding), Err(ContinuationError::Height { .. })));
    assert!(matches!(stack(&map, &[1.0, f64::INFINITY], 0.0, &padding), Err(ContinuationError::Height { .. })));
    assert!(matches!(continued(&map, -9.0, -1.0, &padding), Err(ContinuationError::Alpha { .. })));
    let spectrum = MapSpectrum::new(&map, 0.0, &padding).unwrap();
    assert!(matches!(spectrum.components([0.0; 3], 0.0, 0.0), Err(ContinuationError::Direction { .. })));
    let heights = vec![0.0; 600];
    assert!(matches!(
        level_to_drape(&map, 0.0, &heights[1..], &DrapeOptions::default()),
        Err(ContinuationError::DrapeHeights { given: 599, .. })
    ));
    let tall: Vec<f64> = (0..600).map(|i| 1e4 * f64::from(i)).collect();
    let fine = DrapeOptions { step_m: Some(1.0), ..DrapeOptions::default() };
    assert!(matches!(level_to_drape(&map, 0.0, &tall, &fine), Err(ContinuationError::TooManyLevels { .. })));
    let still = DrapeOptions { step_m: Some(0.0), ..DrapeOptions::default() };
    assert!(matches!(level_to_drape(&map, 0.0, &heights, &still), Err(ContinuationError::Height { .. })));
    let small = noise(10, 30);
    assert!(matches!(edge_error(&small, 1.0, 0.0, &padding), Err(ContinuationError::TooSmallToMeasure { .. })));
}

#[test]
fn law_a_flat_drape_is_a_level_and_deeper_nodes_are_unknown() {
    let map = Field::new(Scene::Around, 8, [40, 50]).anomaly(0.0);
    let exact = upward(&map, 75.0, &Padding::default()).unwrap();
    let draped = level_to_drape(&map, 100.0, &vec![175.0; 2000], &DrapeOptions::default()).unwrap();
    // 75 m is midway between levels of 50 m, so the cubic between levels makes the difference.
    assert!(rms_where(&minus(&draped, &exact), |_, _| true) < 2e-3 * rms_where(&exact, |_, _| true));
    let mut heights = vec![100.0; 2000];
    heights[41] = 100.0 - 151.0;
    heights[42] = 100.0 - 149.0;
    let deep = level_to_drape(&map, 100.0, &heights, &DrapeOptions::default()).unwrap();
    assert!(deep.values[41].is_nan() && deep.values[42].is_finite());
    assert_eq!(deep.unknown(), 1);
    assert!(worst(&[deep.values[0]], &[map.values[0]]) < 1e-9);
}

#[test]
fn law_a_stack_equals_its_single_levels() {
    let map = noise(40, 50);
    let padding = Padding::default();
    let levels = stack(&map, &[0.0, 60.0, -20.0], 300.0, &padding).unwrap();
    let spectrum = MapSpectrum::new(&map, 60.0, &padding).unwrap();
    assert!(worst(&levels[0].values, &map.values) < 1e-10);
    assert_eq!(levels[1], spectrum.at_height(60.0, 0.0).unwrap());
    assert_eq!(levels[2], spectrum.at_height(-20.0, 300.0).unwrap());
}

#[test]
fn unit_far_is_a_fiftieth_of_the_shorter_side_and_masks_are_restored() {
    let map = formula(51, 101, [100.0, 100.0], |_, _| 1.0);
    assert!(!is_far(&map, 100.0) && !is_far(&map, -100.0));
    assert!(is_far(&map, 100.1) && is_far(&map, -100.1));
    let mut original = map.clone();
    original.values[7] = f64::NAN;
    let masked = masked_like(map, &original);
    assert!(masked.values[7].is_nan() && masked.unknown() == 1);
}

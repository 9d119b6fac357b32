//! The values of MagNav.jl and of harmonica.

use crate::maps::continuation::*;
use crate::reference_csv::columns;

use super::{formula, worst};

const MAGNAV: &str = include_str!("../../../../reference/maps/continuation/magnav.csv");
const HARMONICA: &str = include_str!("../../../../reference/maps/continuation/harmonica.csv");

/// The map of the golden cases: 9 rows 650 m apart, 11 columns 600 m apart.
fn magnav_map() -> PlaneGrid {
    formula(9, 11, [600.0, 650.0], |j, k| 100.0 * (0.7 * j).sin() + 40.0 * (0.5 * k).cos() + 2.0 * j * k)
}

/// Rounding error of values of a few hundred nT in double precision, after two transforms.
const ROUNDING_NT: f64 = 1e-10;

#[test]
fn val_expand_equals_magnav() {
    let values: [[f64; 4]; 3] = [[1.0, 2.0, 4.0, 8.0], [3.0, 5.0, 7.0, 9.0], [2.0, 2.0, 6.0, 1.0]];
    let map = formula(3, 4, [10.0, 10.0], |j, k| values[j as usize - 1][k as usize - 1]);
    let (expanded, layout) = expand(&map, 2).unwrap();
    let theirs = columns(include_str!("../../../../reference/maps/continuation/magnav_expand.csv"));
    assert_eq!([layout.rows.padded, layout.columns.padded], [7, 8]);
    assert_eq!([layout.rows.before, layout.columns.before], [2, 2]);
    assert!(worst(&expanded.values, &theirs["map_expand"]) < 1e-14);
    assert_eq!(expanded.east_m.at(2.0), map.east_m.first);
    assert_eq!(expanded.north_m.len, 7);
}

#[test]
fn ref_sizes_are_the_next_products_of_2_3_5_and_7() {
    let sizes = [7279, 7439, 3195, 3355, 11, 13, 121].map(seven_smooth);
    assert_eq!(sizes, [7290, 7500, 3200, 3360, 12, 14, 125]);
    assert_eq!(seven_smooth(0), 1);
}

#[test]
fn val_continuation_equals_magnav() {
    let theirs = columns(MAGNAV);
    let map = magnav_map();
    let plain = upward(&map, 300.0, &Padding::none()).unwrap();
    assert!(worst(&plain.values, &theirs["upward_fft_noexpand"]) < ROUNDING_NT);
    let padded = upward(&map, 300.0, &Padding::magnav(&map, 300.0)).unwrap();
    assert!(worst(&padded.values, &theirs["upward_fft_expand"]) < ROUNDING_NT);
    let lower = continued(&map, -100.0, 200.0, &Padding::magnav(&map, 100.0)).unwrap();
    assert!(worst(&lower.values, &theirs["downward_fft_alpha200"]) < ROUNDING_NT);
}

#[test]
fn val_components_equal_magnav_except_mean_and_axis_names() {
    let theirs = columns(MAGNAV);
    let spectrum = MapSpectrum::new(&magnav_map(), 0.0, &Padding::none()).unwrap();
    // Declination -0.2 and inclination 1.2 rad, the declination counted from east.
    let main = [1.2_f64.cos() * 0.2_f64.cos(), -(1.2_f64.cos()) * 0.2_f64.sin(), -(1.2_f64.sin())];
    let field = spectrum.components(main, 0.0, 0.0).unwrap();
    let without_mean = |values: &[f64], sign: f64| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|v| sign * (v - mean)).collect::<Vec<f64>>()
    };
    for (ours, sign, name) in [(&field.east, 1.0, "vector_fft_X"), (&field.up, -1.0, "vector_fft_Z")] {
        let difference = worst(&without_mean(&ours.values, sign), &without_mean(&theirs[name], 1.0));
        assert!(difference < ROUNDING_NT, "{name}: {difference}");
    }
    assert!(!field.damped);
}

#[test]
fn val_chessboard_equals_magnav() {
    let map = magnav_map();
    let heights = formula(9, 11, [600.0, 650.0], |j, k| 300.0 + 5.0 * j + 3.0 * k);
    let drape = DrapeOptions::magnav(20.0, Padding::magnav(&map, 60.0));
    let level = drape_to_level(&map, &heights.values, 360.0, &drape).unwrap();
    let difference = worst(&level.values, &columns(MAGNAV)["map_chessboard"]);
    assert!(difference < ROUNDING_NT, "{difference}");
}

#[test]
fn val_zero_padding_equals_harmonica() {
    let theirs = columns(HARMONICA);
    let map = formula(30, 42, [50.0, 60.0], |j, k| 100.0 * (0.7 * j).sin() + 40.0 * (0.5 * k).cos() + 0.2 * j * k);
    let padding = Padding {
        width: PaddingWidth::Nodes([10, 14]),
        edge: EdgeExtension::Zero,
        trend: TrendRemoval::None,
        ..Padding::default()
    };
    let spectrum = MapSpectrum::new(&map, 0.0, &padding).unwrap();
    assert_eq!([spectrum.layout().rows.padded, spectrum.layout().columns.padded], [50, 70]);
    let up = upward(&map, 130.0, &padding).unwrap();
    assert!(worst(&up.values, &theirs["upward_130"]) < ROUNDING_NT);
    for (which, name) in [
        (MapDerivative::Up, "derivative_upward"),
        (MapDerivative::UpTwice, "derivative_upward_2"),
        (MapDerivative::East, "derivative_easting"),
        (MapDerivative::North, "derivative_northing"),
    ] {
        let ours = spectrum.derivative(which, 0.0, 0.0).unwrap();
        let difference = worst(&ours.values, &theirs[name]);
        assert!(difference < ROUNDING_NT, "{name}: {difference}");
    }
}

#![allow(clippy::unwrap_used, clippy::panic)]
use super::*;

const REFERENCE: &str = include_str!("../../../reference/navigation/igrf14_computed_values.csv");

#[test]
fn val_igrf14_values_of_ppigrf() {
    let mut rows = 0;
    for line in REFERENCE.lines().skip(1) {
        let v: Vec<f64> = line.split(',').map(|word| word.parse().unwrap()).collect();
        let field = CoreField::at(v[0]).unwrap();
        let ned = field.field_ned_nt(v[2], v[3], v[1] * 1e3);
        for (computed, expected) in ned.iter().zip(&v[4..7]) {
            // The reference is printed to 0.001 nT; the conversion of the reference from geodetic coordinates differs
            // by 0.002 nT.
            assert!((computed - expected).abs() < 0.003, "{ned:?} {line}");
        }
        assert!((field.magnitude_nt(v[2], v[3], v[1] * 1e3) - v[8]).abs() < 0.003, "{line}");
        rows += 1;
    }
    assert_eq!(rows, 100);
}

fn rows(text: &str) -> Vec<Vec<f64>> {
    text.lines().skip(1).map(|line| line.split(',').map(|word| word.parse().unwrap()).collect()).collect()
}

/// Largest differences from the official test values: north, east, down, magnitude and the three rates.
fn worst_of_wmm(text: &str) -> [f64; 7] {
    let rows = rows(text);
    assert_eq!(rows.len(), 100);
    let column = |k: usize| rows.iter().map(|r| r[k]).collect::<Vec<f64>>();
    let (year, alt) = (column(0), column(1).iter().map(|km| km * 1e3).collect::<Vec<_>>());
    let track = CoreFieldTrack::new(CoreFieldModel::Wmm);
    let field = track.field(&column(2), &column(3), &alt, &year).unwrap();
    let worst = |of: &[f64], k: usize| of.iter().zip(column(k)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let [n, e, d] = [worst(&field.north_nt, 4), worst(&field.east_nt, 5), worst(&field.down_nt, 6)];
    if rows[0].len() < 14 {
        return [n, e, d, 0.0, 0.0, 0.0, 0.0];
    }
    let rate = track.secular_variation(&column(2), &column(3), &alt, &year).unwrap();
    let [rn, re, rd] = [worst(&rate.north_nt, 11), worst(&rate.east_nt, 12), worst(&rate.down_nt, 13)];
    [n, e, d, worst(&field.magnitude_nt(), 8), rn, re, rd]
}

#[test]
fn ref_wmm_test_values() {
    // Printed to 0.1 nT.
    let worst = worst_of_wmm(include_str!("../../../reference/core_field/wmm2020_test_values.csv"));
    assert!(worst.iter().all(|w| *w < 0.051), "{worst:?}");
    // Printed to 1e-6 nT. The official north component is not exact (see the reference's README). The rounding error of
    // the down component affects the other components by a thousandth, and the magnitude by up to the full error.
    let worst = worst_of_wmm(include_str!("../../../reference/core_field/wmm2025_test_values.csv"));
    let printed = [8e-4, 0.51e-6, 3e-6, 8e-4, 1.1e-6, 0.51e-6, 0.6e-6];
    assert!(worst.iter().zip(printed).all(|(w, p)| *w < p), "{worst:?}");
}

#[test]
fn val_wmm_equals_the_textbook_sum() {
    let worst = worst_of_wmm(include_str!("../../../reference/core_field/wmm2025_exact.csv"));
    // Printed to 1e-6 nT.
    assert!(worst.iter().all(|w| *w < 0.51e-6), "{worst:?}");
}

#[test]
fn jac_gradient_of_the_magnitude() {
    let field = CoreField::at(2023.4).unwrap();
    for (lat, lon, alt) in [(45.0, -75.7, 400.0), (-21.9, 140.6, 3e3), (89.0, 10.0, 0.0), (0.0, 179.99, 1e4)] {
        let at = field.magnitude_and_gradient(lat, lon, alt);
        // For a step of 1 km, the relative truncation error is at most 1e-5 and the rounding error 1e-8 nT over 30 nT.
        let step = 0.01_f64;
        let central = |dlat: f64, dlon: f64, dalt: f64| {
            field.magnitude_nt(lat + dlat, lon + dlon, alt + dalt)
                - field.magnitude_nt(lat - dlat, lon - dlon, alt - dalt)
        };
        let d_lat = central(step, 0.0, 0.0) / (2.0 * step.to_radians());
        let d_lon = central(0.0, step, 0.0) / (2.0 * step.to_radians());
        let d_alt = central(0.0, 0.0, 1e3) / 2e3;
        assert!((at.d_lat_nt_per_rad - d_lat).abs() < 1e-5 * 6e4, "{at:?} {d_lat}");
        assert!((at.d_lon_nt_per_rad - d_lon).abs() < 1e-5 * 6e4, "{at:?} {d_lon}");
        assert!((at.d_alt_nt_per_m - d_alt).abs() < 1e-5 * 0.03, "{at:?} {d_alt}");
        // The two results are the same sum, rounded before or after the rotation into the local frame.
        assert!((at.value_nt - field.magnitude_nt(lat, lon, alt)).abs() < 1e-10);
    }
}

#[test]
fn law_the_field_has_neither_divergence_nor_curl() {
    let field = CoreField::at(2000.0).unwrap();
    let harmonics = field.recursion.harmonics(ecef_m(0.6, 2.1, 5e3), HIGHEST_DEGREE);
    let [xx, _, _, yy, _, zz] = field.tensor.each_ref().map(|c| dot_terms(c, &harmonics));
    // Relative to the magnitude of the entries, 0.01 nT/m.
    assert!((xx + yy + zz).abs() < 1e-14, "{}", xx + yy + zz);
    let yx = derivative(&field.components[1], 0, 1.0 / REFERENCE_RADIUS_M);
    // The sine of order zero has no effect and may differ.
    let [yx, xy] = [&yx, &field.tensor[1]].map(|c| dot_terms(c, &harmonics));
    assert!((yx - xy).abs() < 1e-16, "{yx} {xy}");
}

#[test]
fn law_the_field_is_continuous_at_the_poles() {
    let field = CoreField::at(2025.0).unwrap();
    for pole in [90.0, -90.0] {
        let magnitudes: Vec<f64> = (0..8).map(|k| field.magnitude_nt(pole, 45.0 * f64::from(k), 100.0)).collect();
        let near = field.magnitude_nt(pole * (1.0 - 1e-9), 30.0, 100.0);
        for magnitude in magnitudes {
            // 90 degrees in radians is 4e-10 m from the pole; 1e-7 degrees are 0.01 m.
            assert!((magnitude - near).abs() < 1e-3, "{magnitude} {near}");
        }
        assert!(field.magnitude_and_gradient(pole, 12.0, 0.0).d_lat_nt_per_rad.is_finite());
    }
}

#[test]
fn law_the_field_is_linear_in_time_between_epochs() {
    let [early, middle, late] =
        [2020.0, 2022.5, 2025.0].map(|year| CoreField::at(year).unwrap().field_ned_nt(50.0, 10.0, 0.0));
    for ((a, b), c) in early.iter().zip(&middle).zip(&late) {
        assert!((0.5 * (a + c) - b).abs() < 1e-9);
    }
    assert!(CoreField::at(1900.0).is_ok() && CoreField::at(2030.0).is_ok());
    for year in [1899.9, 2030.1, f64::NAN] {
        assert!(matches!(CoreField::at(year), Err(CoreFieldError::Date { .. })));
    }
    assert_eq!(CoreField::at(2031.0).unwrap_err().to_string(), "IGRF-14 covers the years 1900 to 2030, not 2031");
    assert_eq!(
        CoreField::new(CoreFieldModel::Wmm, 2019.9).unwrap_err().to_string(),
        "WMM covers the years 2020 to 2030, not 2019.9"
    );
}

#[test]
fn law_the_expansion_follows_the_field() {
    let field = CoreField::at(2014.8).unwrap();
    let mut near = LinearisedCoreField::new(field.clone());
    let mut worst = 0.0_f64;
    for k in 0..20_000 {
        let s = f64::from(k);
        // A zigzag from near the south pole to near the north pole in steps of 990 m. At each position, 60 small steps
        // use the expansion.
        let (lat, lon) = (-89.0 + 0.0089 * s, 170.0 * (0.01 * s).sin());
        for j in 0..8 {
            let phase = f64::from(j) * 0.785;
            let north = 138.0 / 111e3 * phase.cos();
            let east = 138.0 / (111e3 * lat.to_radians().cos()) * phase.sin();
            let alt = 500.0 + 49.0 * (2.0 * phase).sin();
            let value = near.magnitude_and_gradient(lat + north, lon + east, alt).value_nt;
            worst = worst.max((value - field.magnitude_nt(lat + north, lon + east, alt)).abs());
        }
    }
    assert!(worst > 0.0 && worst < 1e-3, "{worst}");
}

#[test]
fn law_a_track_equals_single_evaluations() {
    for model in [CoreFieldModel::Igrf14, CoreFieldModel::Wmm] {
        // Dates before, on and after an epoch; a number of positions that is not a multiple of the vector width; and
        // gaps.
        let n = 203;
        let part = |k: usize| k as f64 / n as f64;
        let lat: Vec<f64> = (0..n).map(|k| 180.0 * part(k) - 90.0).collect();
        let lon: Vec<f64> = (0..n).map(|k| 540.0 * part(k) - 180.0).collect();
        let mut alt: Vec<f64> = (0..n).map(|k| 1e4 * part(k)).collect();
        let year: Vec<f64> =
            (0..n).map(|k| if k % 7 == 0 { 2025.0 } else { 2021.0 + 9.0 * part(k * 31 % n) }).collect();
        (alt[7], alt[100]) = (f64::NAN, f64::NAN);
        let ned = CoreFieldTrack::new(model).field(&lat, &lon, &alt, &year).unwrap();
        for k in 0..n {
            let got = [ned.north_nt[k], ned.east_nt[k], ned.down_nt[k]];
            if !alt[k].is_finite() {
                assert!(got.iter().all(|x| x.is_nan()));
                continue;
            }
            let one = CoreField::new(model, year[k]).unwrap().field_ned_nt(lat[k], lon[k], alt[k]);
            // The two results are the same sum in a different order.
            assert!(got.iter().zip(&one).all(|(a, b)| (a - b).abs() < 1e-9), "{got:?} {one:?}");
        }
        let late = CoreFieldTrack::new(model).field(&[0.0], &[0.0], &[0.0], &[2031.0]);
        assert!(matches!(late, Err(CoreFieldError::Date { .. })));
    }
}

#[test]
fn law_secular_variation_is_the_change_of_the_field() {
    let track = CoreFieldTrack::new(CoreFieldModel::Igrf14);
    let at = |year: f64| track.field(&[51.0], &[-3.0], &[300.0], &[year]).unwrap();
    let (early, late) = (at(2026.0), at(2028.0));
    let rate = track.secular_variation(&[51.0], &[-3.0], &[300.0], &[2027.0]).unwrap();
    assert!((0.5 * (late.north_nt[0] - early.north_nt[0]) - rate.north_nt[0]).abs() < 1e-9);
    assert!((0.5 * (late.down_nt[0] - early.down_nt[0]) - rate.down_nt[0]).abs() < 1e-9);
}

#[test]
fn ref_the_step_between_world_models_has_its_known_size() {
    let mut most = 0.0_f64;
    for lat in (-89..90).step_by(2) {
        for lon in (-180..180).step_by(4) {
            let (lat, lon) = (f64::from(lat), f64::from(lon));
            let before = CoreField::new(CoreFieldModel::Wmm, 2025.0 - 1e-9).unwrap().field_ned_nt(lat, lon, 0.0);
            let after = CoreField::new(CoreFieldModel::Wmm, 2025.0).unwrap().field_ned_nt(lat, lon, 0.0);
            most = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(most, f64::max);
        }
    }
    assert!(most > 313.0 && most < 315.0, "{most}");
}

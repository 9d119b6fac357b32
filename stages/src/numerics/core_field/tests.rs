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
            // The reference is printed to 0.001 nT; its conversion from geodetic differs by 0.002.
            assert!((computed - expected).abs() < 0.003, "{ned:?} {line}");
        }
        assert!((field.magnitude_nt(v[2], v[3], v[1] * 1e3) - v[8]).abs() < 0.003, "{line}");
        rows += 1;
    }
    assert_eq!(rows, 100);
}

#[test]
fn jac_gradient_of_the_magnitude() {
    let field = CoreField::at(2023.4).unwrap();
    for (lat, lon, alt) in [(45.0, -75.7, 400.0), (-21.9, 140.6, 3e3), (89.0, 10.0, 0.0), (0.0, 179.99, 1e4)] {
        let at = field.magnitude_and_gradient(lat, lon, alt);
        // A step of 1 km: truncation 1e-5 relative at most, rounding 1e-8 nT over 30 nT.
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
        // The same sum, rounded before or after the turn into the local frame.
        assert!((at.value_nt - field.magnitude_nt(lat, lon, alt)).abs() < 1e-10);
    }
}

#[test]
fn law_the_field_has_neither_divergence_nor_curl() {
    let field = CoreField::at(2000.0).unwrap();
    let harmonics = field.recursion.harmonics(ecef_m(0.6, 2.1, 5e3), HIGHEST_DEGREE);
    let [xx, _, _, yy, _, zz] = field.tensor.each_ref().map(|c| dot_terms(c, &harmonics));
    // Relative to the size of the entries, 0.01 nT/m.
    assert!((xx + yy + zz).abs() < 1e-14, "{}", xx + yy + zz);
    let yx = derivative(&field.components[1], 0, 1.0 / REFERENCE_RADIUS_M);
    // The sine of order zero, which multiplies nothing, need not agree.
    let [yx, xy] = [&yx, &field.tensor[1]].map(|c| dot_terms(c, &harmonics));
    assert!((yx - xy).abs() < 1e-16, "{yx} {xy}");
}

#[test]
fn law_nothing_happens_at_the_poles() {
    let field = CoreField::at(2025.0).unwrap();
    for pole in [90.0, -90.0] {
        let magnitudes: Vec<f64> = (0..8).map(|k| field.magnitude_nt(pole, 45.0 * f64::from(k), 100.0)).collect();
        let near = field.magnitude_nt(pole * (1.0 - 1e-9), 30.0, 100.0);
        for magnitude in magnitudes {
            // 90 degrees in radians is off the pole by 4e-10 m; 1e-7 degrees are 0.01 m.
            assert!((magnitude - near).abs() < 1e-3, "{magnitude} {near}");
        }
        assert!(field.magnitude_and_gradient(pole, 12.0, 0.0).d_lat_nt_per_rad.is_finite());
    }
}

#[test]
fn law_time_is_linear_between_epochs_and_bounded() {
    let [early, middle, late] =
        [2020.0, 2022.5, 2025.0].map(|year| CoreField::at(year).unwrap().field_ned_nt(50.0, 10.0, 0.0));
    for ((a, b), c) in early.iter().zip(&middle).zip(&late) {
        assert!((0.5 * (a + c) - b).abs() < 1e-9);
    }
    assert!(CoreField::at(1900.0).is_ok() && CoreField::at(2030.0).is_ok());
    for year in [1899.9, 2030.1, f64::NAN] {
        assert!(matches!(CoreField::at(year), Err(CoreFieldError::Date { .. })));
    }
    assert_eq!(
        CoreField::at(2031.0).unwrap_err().to_string(),
        "the core field is asked for the year 2031; IGRF-14 covers 1900 to 2030"
    );
}

#[test]
fn law_the_expansion_follows_the_field() {
    let field = CoreField::at(2014.8).unwrap();
    let mut near = LinearisedCoreField::new(field.clone());
    let mut worst = 0.0_f64;
    for k in 0..20_000 {
        let s = f64::from(k);
        // From the south pole's surroundings to the north's in steps of 990 m, zigzagging, in
        // between 60 small steps about each place so that the expansion is used, not only made.
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

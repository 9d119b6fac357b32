#![allow(clippy::unwrap_used)]
//! Filter with aiding positions, and with the noise of each measurement.

use super::*;
use crate::earth::geodesy::EarthModel;
use crate::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::ins_error::{InsErrorModel, InsErrors};
use crate::navigation::pinson::{LAT, LON};

const ROWS: usize = 241;
const DT_S: f64 = 5.0;

/// INS at rest at 45° N for 20 min.
fn columns() -> [Vec<f64>; 13] {
    let of = |value: f64| vec![value; ROWS];
    let mut columns = [0.0, 45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0].map(of);
    columns[0] = (0..ROWS).map(|k| DT_S * k as f64).collect();
    columns
}

fn flat() -> FieldMap {
    let grid = GeographicGrid::new(&[44.0, 46.0], &[-77.0, -75.0], &[0.0; 4]).unwrap();
    FieldMap::Flat(MapSurface::new(&grid, MapInterpolation::Linear))
}

fn parameters() -> EkfParameters {
    let sources = InsErrors { init_position_sigma_m: 40.0, ..InsErrors::default() };
    EkfParameters { errors: InsErrorModel::from_sources(sources), keep_covariance: true, ..EkfParameters::default() }
}

/// Positions `north_m` metres north of the INS until a row; no positions from that row on.
fn fixes(until: usize, north_m: f64) -> PositionFixes {
    let north_deg = EarthModel::Wgs84.north_m_to_lat_rad(north_m, 45_f64.to_radians(), 300.0).to_degrees();
    let until = |value: f64| (0..ROWS).map(|row| if row < until { value } else { f64::NAN }).collect();
    PositionFixes {
        lat_deg: until(45.0 + north_deg),
        lon_deg: until(-76.0),
        alt_m: until(300.0),
        horizontal_sigma_m: 3.0,
        vertical_sigma_m: 5.0,
    }
}

fn run_with(fixes: Option<&PositionFixes>, measurement_nt: &[f64], sigma_nt: Option<&[f64]>) -> NavigationOutput {
    let (columns, parameters, map) = (columns(), parameters(), flat());
    let ins = InsSeries::from_columns(columns.each_ref().map(Vec::as_slice));
    let point = EkfInput { parameters: &parameters, measurement_nt, sigma_nt, fixes, map: &map, core: None };
    run_together(&ins, &[point]).pop().unwrap().unwrap()
}

#[test]
fn law_a_fix_is_the_weighted_mean_with_the_ins_and_the_ins_drifts_without_fixes() {
    let none = vec![f64::NAN; ROWS];
    let aided = run_with(Some(&fixes(121, 30.0)), &none, None);
    // Two measurements of the position: 0 ± 40 m and 30 ± 3 m.
    let north_m =
        (aided.lat_deg[0] - 45.0).to_radians() * EarthModel::Wgs84.north_m_per_rad(45_f64.to_radians(), 300.0);
    let (prior, fix) = (40_f64.powi(-2), 3_f64.powi(-2));
    assert!((north_m - 30.0 * fix / (fix + prior)).abs() < 1e-3, "{north_m}");
    for sd_m in [aided.sd_n_m[0], aided.sd_e_m[0]] {
        // The degree of longitude refers to the estimate, 30 m further north.
        assert!((sd_m - (fix + prior).powf(-0.5)).abs() < 1e-4, "{sd_m}");
    }
    // Ten minutes of fixes reduce the error to well below the error of one fix, and the error grows again afterwards.
    assert!(aided.sd_n_m[120] < 1.5 && aided.sd_n_m[ROWS - 1] > 3.0 * aided.sd_n_m[120]);
    let drift = run_with(None, &none, None);
    assert!(aided.sd_n_m[ROWS - 1] < 0.1 * drift.sd_n_m[ROWS - 1]);
    for (row, p) in aided.p.iter().enumerate() {
        assert!(p[LAT][LAT] > 0.0 && p[LON][LON] > 0.0 && p[LAT][LON] == p[LON][LAT], "{row}");
    }
}

#[test]
fn law_without_fixes_nothing_changes() {
    let measurement_nt: Vec<f64> = (0..ROWS).map(|row| (0.3 * row as f64).sin()).collect();
    let bits = |out: NavigationOutput| -> Vec<u64> {
        out.p.into_flattened().into_flattened().iter().map(|x| x.to_bits()).collect()
    };
    let with = bits(run_with(Some(&fixes(0, 0.0)), &measurement_nt, None));
    assert!(with == bits(run_with(None, &measurement_nt, None)));
    let sigmas = vec![parameters().measurement_sigma_nt; ROWS];
    assert!(with == bits(run_with(None, &measurement_nt, Some(&sigmas))));
}

#[test]
fn law_each_measurement_has_its_own_noise() {
    let measurement_nt = vec![2.0; ROWS];
    let mut sigmas = vec![f64::INFINITY; ROWS];
    sigmas[0] = 4.0;
    let out = run_with(None, &measurement_nt, Some(&sigmas));
    assert_eq!((out.report.updates, out.report.missing_measurements), (1, ROWS - 1));
    // On a flat map the measurement depends only on S, whose standard deviation is 3 nT.
    assert!((out.nis[0] - 4.0 / (16.0 + 9.0)).abs() < 1e-12, "{}", out.nis[0]);
    assert!(out.nis[1..].iter().all(|nis| nis.is_nan()));
}

#[test]
fn unit_invalid_fixes_are_rejected() {
    let (columns, parameters, map, none) = (columns(), parameters(), flat(), vec![f64::NAN; ROWS]);
    let ins = InsSeries::from_columns(columns.each_ref().map(Vec::as_slice));
    let short = PositionFixes { lat_deg: vec![45.0], ..fixes(ROWS, 0.0) };
    let exact = PositionFixes { horizontal_sigma_m: 0.0, ..fixes(ROWS, 0.0) };
    for (fixes, words) in [(short, "fix latitude"), (exact, "horizontal_sigma_m")] {
        let fixes = Some(&fixes);
        let point =
            EkfInput { parameters: &parameters, measurement_nt: &none, sigma_nt: None, fixes, map: &map, core: None };
        let error = run_together(&ins, &[point]).pop().unwrap().unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
    }
}

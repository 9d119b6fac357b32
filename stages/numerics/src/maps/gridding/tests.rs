#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod curvature;
mod parts;
mod sources;
mod whole;

use super::*;
use crate::reference_csv::columns;
use std::collections::BTreeMap;

/// No progress is shown.
const QUIET: GriddingProgress = &|_, _, _| {};

fn reference(name: &str) -> BTreeMap<String, Vec<f64>> {
    columns(match name {
        "points" => include_str!("../../../reference/maps/gridding/points.csv"),
        _ => include_str!("../../../reference/maps/gridding/nodes.csv"),
    })
}

/// Vertical field of a vertical dipole in nT, and the east, north and upward derivatives of this field, at the
/// displacement `d` from the dipole.
fn dipole(d: [f64; 3]) -> [f64; 4] {
    let [e, n, h] = d;
    let r2 = e * e + n * n + h * h;
    let r5 = r2 * r2 * r2.sqrt();
    let slope = |x: f64| 1e11 * (3.0 * x / r5 - 15.0 * h * h * x / (r5 * r2));
    [1e11 * (3.0 * h * h - r2) / r5, slope(e), slope(n), slope(h) + 6e11 * h / r5]
}

/// Lines 200 m apart, a point every 50 m, over two dipoles; the lines rise and fall.
fn survey() -> OwnedSurveyPoints {
    let mut points = OwnedSurveyPoints::default();
    for line in 0..21 {
        for k in 0..81 {
            let (e, n) = (50.0 * f64::from(k), 200.0 * f64::from(line));
            let h = 300.0 + 20.0 * (e / 700.0).sin() + 5.0 * (n / 600.0).cos();
            points.easting_m.push(500_000.0 + e);
            points.northing_m.push(7_000_000.0 + n);
            points.height_m.push(h);
            points.value_nt.push(field([e, n, h])[0]);
            points.line.push(line as usize);
        }
    }
    points
}

/// The field of `survey`, with eastings from 500 km and northings from 7000 km.
fn field([e, n, h]: [f64; 3]) -> [f64; 4] {
    let (one, two) = (dipole([e - 1430.0, n - 1970.0, h + 300.0]), dipole([e - 2730.0, n - 2290.0, h + 400.0]));
    std::array::from_fn(|k| one[k] - 0.5 * two[k])
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Pseudo-random numbers, uniform between -1 and 1.
fn scattered(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed;
    let next = |_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..count).map(next).collect()
}

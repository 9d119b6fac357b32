//! Contradictions of made lines.

#![allow(clippy::unwrap_used)]

use std::{collections::BTreeMap, sync::Arc};

use arrow_array::{ArrayRef, Float64Array};
use arrow_schema::{DataType, Field, Schema};

use super::*;

/// A line at 60 m/s to the east and 20 m/s to the north that climbs at 3 m/s, with velocities times `factors` and a
/// noise of the positions, in metres.
fn steady_flight(rows: usize, factors: [f64; 3], noise_m: f64) -> RecordBatch {
    let t = |i: usize| i as f64 * 0.1;
    let noise = |i: usize, k: f64| noise_m * (1e3 * (i as f64 + k)).sin();
    let column = |f: &dyn Fn(usize) -> f64| Arc::new((0..rows).map(f).collect::<Float64Array>()) as ArrayRef;
    RecordBatch::try_from_iter([
        ("tt", column(&|i| 36_000.0 + t(i))),
        ("lat", column(&|i| -22.0 + (20.0 * t(i) + noise(i, 0.0)) / 110_720.0)),
        ("lon", column(&|i| 140.0 + (60.0 * t(i) + noise(i, 0.5)) / 103_280.0)),
        ("alt", column(&|i| 500.0 + 3.0 * t(i) + noise(i, 0.2))),
        ("vn", column(&|_| 20.0 * factors[0])),
        ("ve", column(&|_| 60.0 * factors[1])),
        ("vd", column(&|_| -3.0 * factors[2])),
    ])
    .unwrap()
}

fn faults_of(batch: &RecordBatch) -> Vec<String> {
    contradictions(batch, &[], &FileColumns::default()).iter().map(|(fault, _)| fault.to_string()).collect()
}

#[test]
fn unit_velocities_in_another_unit_are_found_in_short_and_long_lines() {
    for (unit, factor) in [("km/h", 3.6), ("kn", 3600.0 / 1852.0), ("ft/s", 1.0 / 0.3048), ("mph", 1.0 / 0.44704)] {
        for rows in [60, 200, 900] {
            let found = faults_of(&steady_flight(rows, [factor, factor, 1.0], 0.3));
            let units = format!("`units = {{ \"vn\" = \"{unit}\", \"ve\" = \"{unit}\" }}`");
            assert!(found.len() == 1 && found[0].contains(&units), "{unit}, {rows} rows: {found:?}");
        }
    }
    let one = faults_of(&steady_flight(900, [1.0, 1.0 / 0.3048, 1.0], 0.3));
    assert!(one.len() == 1 && one[0].contains("in ft/s, `ve` agrees"), "{one:?}");
}

#[test]
fn unit_vertical_velocities_in_another_unit_are_found_by_the_heights() {
    for (unit, factor) in [("ft/s", 1.0 / 0.3048), ("ft/min", 60.0 / 0.3048), ("km/h", 3.6)] {
        let found = faults_of(&steady_flight(600, [1.0, 1.0, factor], 0.3));
        assert!(found.len() == 1 && found[0].contains(&format!("in {unit}, `vd` agrees")), "{unit}: {found:?}");
    }
}

#[test]
fn unit_a_speed_over_ground_is_compared_in_its_own_unit() {
    let batch = steady_flight(600, [1.0; 3], 0.3);
    let faults_of = |unit: &str, speed: f64| {
        let field = schemas::field("ground_speed", DataType::Float64, unit, schemas::Role::Aux, "");
        let fields: Vec<Field> = batch.schema().fields().iter().map(|f| f.as_ref().clone()).chain([field]).collect();
        let speed: ArrayRef = Arc::new(Float64Array::from(vec![speed; 600]));
        let columns = batch.columns().iter().cloned().chain([speed]).collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).unwrap();
        let origins = FileColumns::new(&batch.schema(), &BTreeMap::new());
        contradictions(&batch, &[], &origins).iter().map(|(fault, _)| fault.to_string()).collect::<Vec<_>>()
    };
    let mps = 63.2;
    for (unit, speed) in [("m/s", mps), ("kn", mps * 3600.0 / 1852.0), ("", 3.6 * mps), ("m/s", 0.75 * mps)] {
        assert_eq!(faults_of(unit, speed), Vec::<String>::new(), "{unit}");
    }
    let found = faults_of("m/s", 3.6 * mps);
    assert!(found.len() == 1 && found[0].contains("`units = { \"ground_speed\" = \"km/h\" }`"), "{found:?}");
}

#[test]
fn unit_noise_and_short_lines_are_no_contradiction() {
    for (rows, noise_m) in [(900, 5.0), (200, 3.0), (60, 0.5), (20, 3.0), (2, 0.0)] {
        assert_eq!(
            faults_of(&steady_flight(rows, [1.0; 3], noise_m)),
            Vec::<String>::new(),
            "{rows} rows, {noise_m} m"
        );
    }
    // Wind and a velocity through the air differ by less.
    assert_eq!(faults_of(&steady_flight(900, [0.8, 1.3, 1.0], 0.3)), Vec::<String>::new());
}

#[test]
fn unit_a_clock_in_digits_names_its_format() {
    let digits = |i: usize| if i < 300 { 100_030.0 } else { 100_070.0 } + 0.1 * i as f64;
    let tt: ArrayRef = Arc::new((0..600).map(digits).collect::<Float64Array>());
    let found = faults_of(&RecordBatch::try_from_iter([("tt", tt)]).unwrap());
    let words = ["hhmmss", "clock = \"text\"", "`%H%M%S%.f`", "accept"];
    assert!(found.len() == 1 && words.iter().all(|w| found[0].contains(w)), "{found:?}");
}

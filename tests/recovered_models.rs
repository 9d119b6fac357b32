//! Models of simulated flights, compared with the coefficients of their aircraft.

use std::fs;

use arrow_array::RecordBatch;
use numerics::random::NormalGenerator;
use tempfile::TempDir;

use crate::{
    models::{coefficients, run},
    support::{Bench, batch, numbers, read, with_keys, write},
};

/// Line with manoeuvres in all axes. Its magnetometers read the exact terms times eighteen coefficients, plus noise.
fn flight_line(line: usize, rows: usize, beta: &[f64], noise_nt: f64, normals: &mut NormalGenerator) -> RecordBatch {
    let t = |i: usize| 0.1 * i as f64;
    let angle = |i: usize, w: f64, a: f64| a * (w * t(i) + line as f64).sin();
    let vector: Vec<[f64; 3]> = (0..rows)
        .map(|i| {
            let (roll, pitch, yaw) = (angle(i, 1.31, 0.4), angle(i, 1.73, 0.3), 0.13 * t(i) + angle(i, 0.87, 0.5));
            let field = [20_000.0, 0.0, 44_000.0 + 300.0 * (0.02 * t(i)).sin()];
            let turned = [field[0] * yaw.cos(), -field[0] * yaw.sin(), field[2]];
            let pitched = [
                turned[0] * pitch.cos() - turned[2] * pitch.sin(),
                turned[1],
                turned[0] * pitch.sin() + turned[2] * pitch.cos(),
            ];
            [
                pitched[0],
                pitched[1] * roll.cos() + pitched[2] * roll.sin(),
                pitched[2] * roll.cos() - pitched[1] * roll.sin(),
            ]
        })
        .collect();
    let change = |i: usize, k: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(rows - 1));
        (vector[b][k] - vector[a][k]) / (b - a) as f64
    };
    let aircraft: Vec<f64> = (0..rows)
        .map(|i| {
            let b = vector[i];
            let total = (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]).sqrt();
            let mut terms: Vec<f64> = b.iter().map(|x| x / total).collect();
            for (j, x) in b.iter().enumerate() {
                terms.extend(b[j..].iter().map(|y| x * y / total / 50_000.0));
            }
            for x in b {
                terms.extend((0..3).map(|k| x * change(i, k) / total / 50_000.0));
            }
            terms.iter().zip(beta).map(|(a, b)| a * b).sum()
        })
        .collect();
    let columns = [
        ("tt", (0..rows).map(t).collect()),
        ("mag_4_uc", aircraft.iter().map(|x| x + noise_nt * normals.draw()).collect()),
        ("flux_a_x", vector.iter().map(|b| b[0]).collect()),
        ("flux_a_y", vector.iter().map(|b| b[1]).collect()),
        ("flux_a_z", vector.iter().map(|b| b[2]).collect::<Vec<f64>>()),
    ];
    with_keys("F", &format!("L{line:03}"), &batch(&columns))
}

const AIRCRAFT: [f64; 18] = [
    120.0, -80.0, 45.0, 30.0, -12.0, 7.5, 22.0, 4.0, -16.0, 900.0, -400.0, 250.0, 120.0, 640.0, -310.0, 75.0, 510.0,
    -830.0,
];

fn bench_of_flight(lines: &[RecordBatch], axes: &str, more: &str) -> Bench {
    let bench = Bench { folder: TempDir::new().unwrap() };
    fs::create_dir(bench.path("flights")).unwrap();
    write(&bench.path("flights/F.parquet"), lines);
    bench.spec(&format!(
        "name = \"small\"\nstore = \"store\"\n[tables.flights]\npath = \"flights/\"\n{axes}\
         [[stages]]\nname = \"terms\"\nstage = \"a_matrix\"\ninput = \"flights\"\nvector = \"flux_a\"\n\
         [[stages]]\nname = \"fit\"\nstage = \"fit\"\ninput = \"terms\"\nmodel = \"tolles_lawson\"\n\
         target = \"mag_4_uc\"\nlambda = 0.0\n{more}"
    ));
    bench
}

#[test]
fn law_coefficients_of_a_noise_free_flight_are_recovered() {
    let mut normals = NormalGenerator::new(1);
    let lines: Vec<RecordBatch> = (0..3).map(|k| flight_line(k, 1500, &AIRCRAFT, 0.0, &mut normals)).collect();
    for more in ["", "low_hz = 0.0\nhigh_hz = 0.0\ntrim = 0\n"] {
        let bench = bench_of_flight(&lines, "", more);
        run(&bench);
        let found = coefficients(&bench, "fit");
        assert_eq!(found.len(), 18);
        for (found, beta) in found.iter().zip(AIRCRAFT) {
            assert!((found / beta - 1.0).abs() < 1e-6, "{found} {beta}");
        }
    }
}

#[test]
fn law_errors_from_noise_match_their_predicted_covariance() {
    let mut normals = NormalGenerator::new(2);
    const REPEATS: usize = 240;
    let lines: Vec<RecordBatch> = (0..REPEATS).map(|k| flight_line(k, 300, &AIRCRAFT, 0.5, &mut normals)).collect();
    let names: Vec<String> = (0..REPEATS).map(|k| format!("\"L{k:03}\"")).collect();
    let bench = bench_of_flight(
        &lines,
        &format!("[axes]\nflown = [{}]\n", names.join(", ")),
        "where = \"line = '$flown'\"\nlow_hz = 0.0\nhigh_hz = 0.0\ntrim = 0\n",
    );
    run(&bench);
    let table = read(&bench.path("store/tables/small/fit"));
    let (values, std) = (numbers(&table, "value"), numbers(&table, "std"));
    assert_eq!(values.len(), REPEATS * 18);
    let squares: Vec<f64> =
        values.iter().zip(&std).enumerate().map(|(i, (v, s))| ((v - AIRCRAFT[i % 18]) / s).powi(2)).collect();
    // Each term separately over all flights: chi-square with 240 degrees of freedom and a standard deviation of 22. The
    // tolerance is five standard deviations.
    for term in 0..18 {
        let sum: f64 = squares.iter().skip(term).step_by(18).sum();
        assert!((130.0..350.0).contains(&sum), "term {term}: {sum}");
    }
    // All terms together: squares of mean 1. Terms of one flight are correlated, so they count as at least 240
    // independent squares.
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((mean - 1.0).abs() < 3.5 * (2.0f64 / 240.0).sqrt(), "{mean}");
}

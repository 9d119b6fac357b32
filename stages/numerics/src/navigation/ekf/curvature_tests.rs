//! Coarse start over a curved map: without the curvature the covariance becomes too small.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::navigation::flights::{OsborneFlight, world};
use crate::navigation::ins_error::{InsErrorModel, InsErrors};

const FLIGHTS: u64 = 20;
const SAMPLES: u32 = 600;
const SIGMA_NT: f64 = 1.0;

/// Median over the flights of the mean NEES of the position, expected value 2.
fn nees(second_order: bool) -> f64 {
    let sources = InsErrors { init_position_sigma_m: 300.0, init_velocity_sigma_mps: 0.5, ..InsErrors::default() };
    let errors = InsErrorModel { fogm_sigma_nt: 1.0, ..InsErrorModel::from_sources(sources) };
    let mut means: Vec<f64> = (0..FLIGHTS)
        .map(|seed| {
            let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, errors);
            let measured = flight.measured(700 + seed, SIGMA_NT);
            let ins = flight.ins.series();
            let parameters = EkfParameters {
                errors,
                measurement_sigma_nt: SIGMA_NT,
                second_order,
                keep_states: false,
                ..EkfParameters::default()
            };
            let output = run(&parameters, &ins, &measured, &world().map, Some(&world().core)).unwrap();
            let rows = SAMPLES as usize;
            (0..rows).map(|row| flight.nees(&output, row)).sum::<f64>() / rows as f64
        })
        .collect();
    means.sort_by(f64::total_cmp);
    means[means.len() / 2]
}

#[test]
fn law_curvature_keeps_a_coarse_start_consistent() {
    let (first, second) = (nees(false), nees(true));
    assert!(second < 4.0 && first > 3.0 * second, "first order {first}, second order {second}");
}

#![allow(clippy::unwrap_used)]
use super::*;
use crate::navigation::flights::OsborneFlight;
use crate::navigation::ins_error::InsErrors;
use crate::random::NormalGenerator;

const FOGM_SIGMA_NT: f64 = 6.0;
const FOGM_TAU_S: f64 = 200.0;
const SIGMA_NT: f64 = 4.0;

fn flown(seed: u64) -> OsborneFlight {
    let sources = InsErrors { init_position_sigma_m: 50.0, init_velocity_sigma_mps: 0.2, ..InsErrors::default() };
    let model =
        InsErrorModel { fogm_sigma_nt: FOGM_SIGMA_NT, fogm_tau_s: FOGM_TAU_S, ..InsErrorModel::from_sources(sources) };
    OsborneFlight::flown(seed, 1500, 1.0, model)
}

fn found(flight: &OsborneFlight, measured_nt: &[f64], given: [Option<f64>; 3]) -> LineNoise {
    let series = flight.ins.series();
    let sigma_nt = vec![1.0; measured_nt.len()];
    let line = flight.line(&series, measured_nt, &sigma_nt);
    let rows = rows_at(series.tt_s, 2.0);
    let search_of = NoiseSearch { line: &line, rows: &rows, scale: &sigma_nt, known_nt: None, map_nt: None, given };
    search(&search_of).unwrap().unwrap()
}

#[test]
fn law_the_simulated_noise_is_estimated() {
    for seed in 0..10 {
        let flight = flown(seed);
        let noise = found(&flight, &flight.measured(50 + seed, SIGMA_NT), [None; 3]);
        assert!((noise.sigma_nt.value / SIGMA_NT - 1.0).abs() < 0.25, "{seed}: {noise:?}");
        assert!((1.0 / 2.5..2.5).contains(&(noise.fogm_sigma_nt.value / FOGM_SIGMA_NT)), "{seed}: {noise:?}");
        // A factor of 1.3 in the variance is possible by chance.
        assert!(noise.inflation < 1.25, "{seed}: {noise:?}");
        for of in [noise.sigma_nt, noise.fogm_sigma_nt, noise.fogm_tau_s] {
            assert!(of.low < of.value && of.value < of.high, "{seed}: {noise:?}");
        }
    }
}

#[test]
fn law_an_offset_is_a_process_with_a_long_time_constant() {
    let flight = flown(3);
    let measured: Vec<f64> = flight.measured(4, SIGMA_NT).iter().map(|nt| nt + 400.0).collect();
    let noise = found(&flight, &measured, [None; 3]);
    assert!((noise.sigma_nt.value / SIGMA_NT - 1.0).abs() < 0.25, "{noise:?}");
    assert!(noise.fogm_sigma_nt.value > 60.0 && noise.fogm_tau_s.value > 2000.0, "{noise:?}");
}

#[test]
fn unit_a_given_parameter_is_kept_and_correlated_noise_is_inflated() {
    let flight = flown(5);
    let clean = flight.measured(0, 1e-9);
    let mut normals = NormalGenerator::new(8);
    let mut slow = 0.0;
    // The noise has a correlation time of 12 s, while the given process is slow and small.
    let lasting = clean.iter().map(|nt| {
        slow = 0.92 * slow + (1.0_f64 - 0.92 * 0.92).sqrt() * 8.0 * normals.draw();
        nt + slow
    });
    let noise = found(&flight, &lasting.collect::<Vec<f64>>(), [None, Some(FOGM_SIGMA_NT), Some(FOGM_TAU_S)]);
    assert_eq!((noise.fogm_sigma_nt.low, noise.fogm_tau_s.value), (FOGM_SIGMA_NT, FOGM_TAU_S));
    assert!(noise.inflation > 1.4, "{noise:?}");
}

#[test]
fn law_spikes_are_outliers_and_healthy_measurements_are_not() {
    let mut flight = flown(7);
    let mut measured = flight.measured(1, SIGMA_NT);
    let spikes: Vec<usize> = (5..measured.len()).step_by(33).collect();
    for (at, row) in spikes.iter().enumerate() {
        measured[*row] += if at % 2 == 0 { 300.0 } else { -80.0 };
    }
    let noise = found(&flight, &measured, [None; 3]);
    assert!((noise.sigma_nt.value / SIGMA_NT - 1.0).abs() < 0.3, "{noise:?}");
    flight.model.fogm_sigma_nt = noise.fogm_sigma_nt.value;
    let series = flight.ins.series();
    let sigma_nt = vec![noise.sigma_nt.value; measured.len()];
    let rejected = outliers(&flight.line(&series, &measured, &sigma_nt)).unwrap();
    let healthy = (0..measured.len()).filter(|row| rejected[*row] && !spikes.contains(row)).count();
    assert!(spikes.iter().all(|row| rejected[*row]), "every spike");
    assert!(healthy <= 2, "{healthy}");
}

#[test]
fn unit_too_few_measurements_give_no_noise() {
    let flight = flown(1);
    let measured = vec![f64::NAN; flight.errors.len()];
    let series = flight.ins.series();
    let sigma_nt = vec![1.0; measured.len()];
    let line = flight.line(&series, &measured, &sigma_nt);
    let rows = rows_at(series.tt_s, 2.0);
    let all =
        NoiseSearch { line: &line, rows: &rows, scale: &sigma_nt, known_nt: None, map_nt: None, given: [None; 3] };
    assert_eq!(search(&all).unwrap(), None);
}

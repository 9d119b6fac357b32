#![allow(clippy::unwrap_used)]
use super::*;
use crate::navigation::aided::field_direction;
use crate::navigation::flights::{OsborneFlight, levels, world};
use crate::navigation::ins_error::InsErrors;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::online::CoefficientPrior;
use crate::random::NormalGenerator;
use crate::signal::gauss_markov::GaussMarkov;

const FOGM_SIGMA_NT: f64 = 6.0;
const FOGM_TAU_S: f64 = 200.0;
const SIGMA_NT: f64 = 4.0;

fn flown(seed: u64) -> OsborneFlight {
    flown_from(seed, 50.0, 0.2)
}

/// Flight whose INS has these standard deviations of its initial position and velocity, in metres and m/s.
fn flown_from(seed: u64, init_position_sigma_m: f64, init_velocity_sigma_mps: f64) -> OsborneFlight {
    let sources = InsErrors { init_position_sigma_m, init_velocity_sigma_mps, ..InsErrors::default() };
    let model =
        InsErrorModel { fogm_sigma_nt: FOGM_SIGMA_NT, fogm_tau_s: FOGM_TAU_S, ..InsErrorModel::from_sources(sources) };
    OsborneFlight::flown(seed, 1500, 1.0, model)
}

fn found(flight: &OsborneFlight, measured_nt: &[f64], given: NoiseParameters) -> LineNoise {
    found_with(flight, measured_nt, None, given)
}

/// Noise of a line for which a lag is searched.
fn found_late(flight: &OsborneFlight, measured_nt: &[f64]) -> LineNoise {
    let series = flight.ins.series();
    let sigma_nt = vec![1.0; measured_nt.len()];
    let line = flight.line(&series, measured_nt, &sigma_nt);
    let rows = rows_at(series.tt_s, 2.0);
    let search_of = NoiseSearch {
        line: &line,
        rows: &rows,
        scale: &sigma_nt,
        known_nt: None,
        map_nt: None,
        direction: None,
        aircraft: None,
        latency_sigma_s: None,
        map_height_sigma_m: Some(0.0),
        given: [None; PARAMETERS],
    };
    search(&search_of).unwrap().unwrap()
}

#[test]
fn law_a_lag_is_found_and_no_lag_is_found_where_there_is_none() {
    let lag = |delay_s: f64| {
        move |seed: &u64| {
            let flight = flown_from(*seed, 5.0, 0.02);
            found_late(&flight, &flight.late_nt(delay_s, 50 + seed, SIGMA_NT)).latency_sigma_s.is_some()
        }
    };
    let of = |delay_s: f64| (0..6).filter(lag(delay_s)).count();
    let found = [1.0, -1.0, 0.0].map(of);
    assert!(found[0] >= 5 && found[1] >= 5 && found[2] == 0, "{found:?} of 6");
}

#[test]
fn law_a_height_bias_is_found_and_no_bias_is_found_where_there_is_none() {
    let bias = |below_m: f64| {
        move |seed: &u64| {
            let (flight, measured_nt) = flown_from(*seed, 5.0, 0.02).below(below_m, 50 + seed, SIGMA_NT);
            let (series, sigma_nt) = (flight.ins.series(), vec![1.0; measured_nt.len()]);
            let rows = rows_at(series.tt_s, 2.0);
            let found = |map| {
                let line = NavigationLine { map, ..flight.line(&series, &measured_nt, &sigma_nt) };
                let search_of = NoiseSearch {
                    line: &line,
                    rows: &rows,
                    scale: &sigma_nt,
                    known_nt: None,
                    map_nt: None,
                    direction: None,
                    aircraft: None,
                    latency_sigma_s: None,
                    map_height_sigma_m: None,
                    given: [None; PARAMETERS],
                };
                search(&search_of).unwrap().unwrap()
            };
            // A map that does not change with height has no bias.
            if *seed == 0 {
                assert_eq!(found(&world().map).map_height_sigma_m, None, "{below_m}");
            }
            let noise = found(levels());
            assert_eq!(noise.latency_sigma_s, None, "{below_m} {seed}");
            noise.map_height_sigma_m.is_some()
        }
    };
    let of = |below_m: f64| (0..6).filter(bias(below_m)).count();
    let found = [60.0, -60.0, 0.0].map(of);
    assert!(found[0] >= 5 && found[1] >= 5 && found[2] == 0, "{found:?} of 6");
}

/// Noise found with the direction of the field at each sample.
fn found_with(
    flight: &OsborneFlight,
    measured_nt: &[f64],
    directions: Option<&[[f64; 3]]>,
    given: NoiseParameters,
) -> LineNoise {
    let series = flight.ins.series();
    let sigma_nt = vec![1.0; measured_nt.len()];
    let line = flight.line(&series, measured_nt, &sigma_nt);
    let rows = rows_at(series.tt_s, 2.0);
    let direction: Option<Vec<[f64; 3]>> = directions.map(|of| rows.iter().map(|row| of[*row]).collect());
    let search_of = NoiseSearch {
        line: &line,
        rows: &rows,
        scale: &sigma_nt,
        known_nt: None,
        map_nt: None,
        direction: direction.as_deref(),
        aircraft: None,
        latency_sigma_s: Some(0.0),
        map_height_sigma_m: Some(0.0),
        given,
    };
    search(&search_of).unwrap().unwrap()
}

#[test]
fn law_the_simulated_noise_is_estimated() {
    for seed in 0..10 {
        let flight = flown(seed);
        let noise = found(&flight, &flight.measured(50 + seed, SIGMA_NT), [None; PARAMETERS]);
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
    let noise = found(&flight, &measured, [None; PARAMETERS]);
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
    let noise =
        found(&flight, &lasting.collect::<Vec<f64>>(), [None, Some(FOGM_SIGMA_NT), Some(FOGM_TAU_S), None, None]);
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
    let noise = found(&flight, &measured, [None; PARAMETERS]);
    assert!((noise.sigma_nt.value / SIGMA_NT - 1.0).abs() < 0.3, "{noise:?}");
    flight.model.fogm_sigma_nt = noise.fogm_sigma_nt.value;
    let series = flight.ins.series();
    let sigma_nt = vec![noise.sigma_nt.value; measured.len()];
    let rejected = outliers(&flight.line(&series, &measured, &sigma_nt), &Aids::default()).unwrap();
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
    let all = NoiseSearch {
        line: &line,
        rows: &rows,
        scale: &sigma_nt,
        known_nt: None,
        map_nt: None,
        direction: None,
        aircraft: None,
        latency_sigma_s: None,
        map_height_sigma_m: Some(0.0),
        given: [None; PARAMETERS],
    };
    assert_eq!(search(&all).unwrap(), None);
}

/// Aircraft field of 40, -25 and 30 nT times the direction of the core field, in sinusoidal manoeuvres.
fn aircraft_terms(rows: usize) -> (Vec<f64>, Vec<f64>) {
    let terms: Vec<f64> = (0..rows)
        .flat_map(|row| {
            let (turn, roll) = ((row as f64 / 90.0).sin(), 0.4 * (row as f64 / 11.0).sin());
            [turn.cos() * roll.cos(), turn.sin() * roll.cos(), roll.sin()]
        })
        .collect();
    let field_nt = terms.chunks_exact(3).map(|d| 40.0 * d[0] - 25.0 * d[1] + 30.0 * d[2]).collect();
    (terms, field_nt)
}

#[test]
fn law_the_noise_is_estimated_beside_an_unknown_aircraft_field() {
    for seed in 0..2 {
        let flight = flown(seed);
        let (terms, field_nt) = aircraft_terms(flight.errors.len());
        let measured: Vec<f64> =
            flight.measured(70 + seed, SIGMA_NT).iter().zip(&field_nt).map(|(nt, own)| nt + own).collect();
        let prior = CoefficientPrior::independent(&[0.0; 3], &[300.0; 3]);
        let aircraft = AircraftStates { terms: &terms, prior: &prior, walk_density: &[0.0; 3] };
        let series = flight.ins.series();
        let sigma_nt = vec![1.0; measured.len()];
        let line = flight.line(&series, &measured, &sigma_nt);
        let rows = rows_at(series.tt_s, 2.0);
        let search_of = NoiseSearch {
            line: &line,
            rows: &rows,
            scale: &sigma_nt,
            known_nt: None,
            map_nt: None,
            direction: None,
            aircraft: Some(aircraft),
            latency_sigma_s: Some(0.0),
            map_height_sigma_m: Some(0.0),
            given: [None; PARAMETERS],
        };
        let noise = search(&search_of).unwrap().unwrap();
        assert!((noise.sigma_nt.value / SIGMA_NT - 1.0).abs() < 0.25, "{seed}: {noise:?}");
        assert!((1.0 / 2.5..2.5).contains(&(noise.fogm_sigma_nt.value / FOGM_SIGMA_NT)), "{seed}: {noise:?}");
        // Without states for the aircraft field it counts as noise.
        let plain = search(&NoiseSearch { aircraft: None, ..search_of }).unwrap().unwrap();
        let all_nt = |of: &LineNoise| of.sigma_nt.value.hypot(of.fogm_sigma_nt.value);
        assert!(all_nt(&plain) > 1.5 * all_nt(&noise), "{seed}: {plain:?}");

        // Spikes are outliers, and the estimated aircraft field follows the true field up to a constant.
        let spikes: Vec<usize> = (200..measured.len()).step_by(97).collect();
        let mut spiked = measured.clone();
        spikes.iter().for_each(|row| spiked[*row] += 500.0);
        let sigma_nt = vec![noise.sigma_nt.value; measured.len()];
        let along = aircraft.along(&flight.line(&series, &spiked, &sigma_nt)).unwrap();
        assert!(spikes.iter().all(|row| along.rejected[*row]), "{seed}");
        assert!(along.rejected.iter().filter(|out| **out).count() < spikes.len() + 15, "{seed}");
    }
}

fn directions(series: &InsSeries<'_>) -> Vec<[f64; 3]> {
    (0..series.len()).map(|row| field_direction(&world().core, series, row)).collect()
}

#[test]
fn law_a_change_of_the_permanent_field_is_found_with_its_size() {
    let (mut without_m2, mut with_m2, mut nees) = (0.0, 0.0, 0.0);
    for seed in 0..5 {
        let flight = flown(seed);
        let mut normals = NormalGenerator::new(100 + seed);
        let mut draw = || [0; 3].map(|_| 60.0 * normals.draw());
        let (first, warming) = (draw(), draw());
        // A constant and a warming, which the filter does not assume.
        let change = |t_s: f64| [0, 1, 2].map(|k| first[k] + warming[k] * (1.0 - (-t_s / 600.0).exp()));
        let along = |(row, own): (usize, &[f64; 3])| -> f64 {
            own.iter().zip(change(row as f64)).map(|(own, change)| own * change).sum()
        };
        let effect: Vec<f64> = directions(&flight.truth.series()).iter().enumerate().map(along).collect();
        let measured: Vec<f64> =
            flight.measured(50 + seed, SIGMA_NT).iter().zip(&effect).map(|(nt, more)| nt + more).collect();
        let without = found(&flight, &measured, [None; PARAMETERS]);
        let direction = directions(&flight.ins.series());
        let noise = found_with(&flight, &measured, Some(&direction), [None; PARAMETERS]);
        let [sigma, tau_s] = noise.permanent.unwrap();
        // Each component is 60 nT before and 60 nT after the warming.
        assert!((25.0..150.0).contains(&sigma.value), "{seed}: {sigma:?}");
        assert!(sigma.low < sigma.value && sigma.value < sigma.high, "{seed}: {sigma:?}");
        let series = flight.ins.series();
        let track = |noise: &LineNoise, permanent: Option<PermanentChange<'_>>| {
            let (fogm_sigma_nt, fogm_tau_s) = (noise.fogm_sigma_nt.value, noise.fogm_tau_s.value);
            let errors = InsErrorModel { fogm_sigma_nt, fogm_tau_s, ..flight.model };
            let sigma_nt = vec![noise.sigma_nt.value; measured.len()];
            let line = NavigationLine { errors, ..flight.line(&series, &measured, &sigma_nt) };
            let aids = Aids { permanent, ..Aids::default() };
            aided::run(&line, &aids, &AidedParameters::default()).unwrap().navigation
        };
        let process = GaussMarkov { sigma: sigma.value, tau_s: tau_s.value };
        let (plain, aided) =
            (track(&without, None), track(&noise, Some(PermanentChange { direction: &direction, process })));
        without_m2 += flight.square_m2(&plain, 300) / 5.0;
        with_m2 += flight.square_m2(&aided, 300) / 5.0;
        let rows = (300..measured.len()).step_by(20);
        nees += rows.clone().map(|row| flight.nees(&aided, row)).sum::<f64>() / rows.count() as f64 / 5.0;
    }
    // The heading of these flights varies slowly, so a Gauss-Markov process describes most of the change, too.
    assert!(with_m2 < without_m2, "{} m with these states, {} m without", with_m2.sqrt(), without_m2.sqrt());
    assert!((1.0..4.0).contains(&nees), "{nees}");
}

#[test]
fn law_a_constant_permanent_field_is_rarely_found_to_change() {
    let changed = |seed: &u64| {
        let flight = flown(*seed);
        let directions = directions(&flight.ins.series());
        let measured = flight.measured(50 + seed, SIGMA_NT);
        found_with(&flight, &measured, Some(&directions), [None; PARAMETERS]).permanent.is_some()
    };
    let changed = (0..10).filter(changed).count();
    assert!(changed <= 1, "{changed} of 10");
}

#[test]
fn law_more_measurements_are_used_only_if_their_errors_are_independent() {
    let (mut of_white, mut of_coloured) = (0, 0);
    for seed in 0..5 {
        let flight = flown(seed);
        let series = flight.ins.series();
        let mut normals = NormalGenerator::new(200 + seed);
        let mut own = [0.0; 2];
        // Errors of about 8 nT with a period of 6.3 s, like those of a compensation in manoeuvres. A Gauss-Markov
        // process does not describe them, and the estimate at 10 s counts them as white.
        let mut coloured = |nt: &f64| {
            let next = 2.0 * 0.97 * (std::f64::consts::TAU / 6.3).cos() * own[0] - 0.97 * 0.97 * own[1];
            own = [next + 2.3 * normals.draw(), own[0]];
            nt + own[0]
        };
        let white = flight.measured(50 + seed, SIGMA_NT);
        let measured = flight.measured(50 + seed, 0.1).iter().map(&mut coloured).collect::<Vec<f64>>();
        for (measured, uses) in [(&white, &mut of_white), (&measured, &mut of_coloured)] {
            let sigma_nt = vec![1.0; measured.len()];
            let line = flight.line(&series, measured, &sigma_nt);
            let [few, all] = [10.0, 1.0].map(|interval_s| rows_at(series.tt_s, interval_s));
            let search_of = NoiseSearch {
                line: &line,
                rows: &few,
                scale: &sigma_nt,
                known_nt: None,
                map_nt: None,
                direction: None,
                aircraft: None,
                latency_sigma_s: Some(0.0),
                map_height_sigma_m: Some(0.0),
                given: [None; PARAMETERS],
            };
            let noise = search(&search_of).unwrap().unwrap();
            let found = denser(&NoiseSearch { rows: &all, ..search_of }, &noise, few.len()).unwrap();
            let is_white = std::ptr::eq(measured, &white);
            if let Some(more) = found {
                *uses += 1;
                assert!(!is_white || (more.sigma_nt.value / SIGMA_NT - 1.0).abs() < 0.3, "{seed}: {more:?}");
            }
        }
    }
    assert!(of_white >= 4 && of_coloured <= 1, "{of_white} of 5 with white errors, {of_coloured} with correlated ones");
}

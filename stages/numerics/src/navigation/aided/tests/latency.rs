//! Magnetometer with late time stamps: its samples belong to earlier positions.

use super::flights::SAMPLES;
use super::*;
use crate::navigation::flights::OsborneFlight;
use crate::navigation::ins_error::{InsErrorModel, InsErrors};

/// Mean square error from 200 s on, in m², mean NEES, and lag with its standard deviation at the end of flights.
fn flown(delay_s: f64, latency_sigma_s: Option<f64>, linearisation: Linearisation) -> (f64, f64, Vec<[f64; 2]>) {
    let model = InsErrorModel::from_sources(InsErrors { init_velocity_sigma_mps: 0.1, ..InsErrors::default() });
    let (mut square, mut nees, mut delays) = (0.0, 0.0, vec![]);
    let flights = 6;
    for seed in 0..flights {
        let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, model);
        let (measured, sigma) = (flight.late_nt(delay_s, 50 + seed, 2.0), vec![2.0; SAMPLES as usize]);
        let ins = flight.ins.series();
        let aids = Aids { latency_sigma_s, ..Aids::default() };
        let parameters = AidedParameters { linearisation, ..AidedParameters::default() };
        let out = run(&flight.line(&ins, &measured, &sigma), &aids, &parameters).unwrap();
        square += flight.square_m2(&out.navigation, 200) / flights as f64;
        let rows = (200..SAMPLES as usize).step_by(20);
        let of_rows = rows.clone().map(|row| flight.nees(&out.navigation, row)).sum::<f64>();
        nees += of_rows / (rows.count() as f64 * flights as f64);
        if latency_sigma_s.is_some() {
            delays.push(out.latency_s.each_ref().map(|of| of[SAMPLES as usize - 1]));
        }
    }
    (square, nees, delays)
}

#[test]
fn law_a_lag_is_estimated_to_hundredths_and_does_not_shift_the_position() {
    for (name, linearisation) in [
        ("once", Linearisation::Once),
        ("iterated", Linearisation::Iterated { iterations: 5, tolerance_m: 0.1 }),
        ("unscented", Linearisation::Unscented(ukf::UkfParameters::default())),
    ] {
        let (healthy_m2, _, none) = flown(0.0, Some(1.0), linearisation);
        assert!(none.iter().all(|[delay_s, sigma_s]| delay_s.abs() < 4.0 * sigma_s), "{name}: {none:?}");
        for delay_s in [0.6, -0.3] {
            let (square_m2, nees, found) = flown(delay_s, Some(1.0), linearisation);
            for [found_s, sigma_s] in &found {
                let off_s = (found_s - delay_s).abs();
                assert!(off_s < 4.0 * sigma_s && *sigma_s < 0.1, "{name} {delay_s}: {found_s} {sigma_s}");
            }
            assert!(square_m2 < 1.3 * healthy_m2, "{name} {delay_s}: {square_m2} {healthy_m2}");
            assert!((1.0..3.5).contains(&nees), "{name} {delay_s}: NEES {nees}");
            let (without_m2, without_nees, _) = flown(delay_s, None, linearisation);
            assert!(without_m2 > 1.2 * square_m2, "{name} {delay_s}: {without_m2} {square_m2}");
            assert!(without_nees > nees, "{name} {delay_s}: {without_nees} {nees}");
        }
    }
}

#[test]
fn law_the_lag_state_does_not_change_a_filter_without_it() {
    let scene = scene(hills);
    let narrow = Aids { latency_sigma_s: Some(1e-9), ..Aids::default() };
    scene.with(|line| {
        let (with, without) = (
            run(line, &narrow, &keep(Linearisation::Once)).unwrap(),
            run(line, &Aids::default(), &keep(Linearisation::Once)).unwrap(),
        );
        assert!(difference(&with.navigation, &without.navigation) < 1e-4);
        assert_eq!((with.latency_s[0].len(), without.latency_s[0].len()), (ROWS, 0));
    });
    let wrong = Aids { latency_sigma_s: Some(0.0), ..Aids::default() };
    assert!(scene.with(|line| run(line, &wrong, &keep(Linearisation::Once))).is_err());
}

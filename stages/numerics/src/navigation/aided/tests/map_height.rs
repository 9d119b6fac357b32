//! Barometer with a constant error, or map at a wrong height: the field belongs to another height on the map.

use super::*;
use crate::navigation::flights::{OsborneFlight, levels};
use crate::navigation::ins_error::{InsErrorModel, InsErrors};

const SAMPLES: u32 = 2400;

/// Statistics of six flights: mean square error from 200 s on, in m², mean NEES, and height bias with its standard
/// deviation at the end of each flight, in metres.
fn flown(below_m: f64, map_height_sigma_m: Option<f64>, linearisation: Linearisation) -> (f64, f64, Vec<[f64; 2]>) {
    let model = InsErrorModel::from_sources(InsErrors { init_velocity_sigma_mps: 0.1, ..InsErrors::default() });
    let (mut square, mut nees, mut biases) = (0.0, 0.0, vec![]);
    let flights = 6;
    for seed in 0..flights {
        let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, model);
        let (flight, measured) = flight.below(below_m, 70 + seed, 2.0);
        let (ins, sigma) = (flight.ins.series(), vec![2.0; SAMPLES as usize]);
        let line = NavigationLine { map: levels(), ..flight.line(&ins, &measured, &sigma) };
        let aids = Aids { map_height_sigma_m, ..Aids::default() };
        let parameters = AidedParameters { linearisation, ..AidedParameters::default() };
        let out = run(&line, &aids, &parameters).unwrap();
        square += flight.square_m2(&out.navigation, 200) / flights as f64;
        let rows = (200..SAMPLES as usize).step_by(20);
        let of_rows = rows.clone().map(|row| flight.nees(&out.navigation, row)).sum::<f64>();
        nees += of_rows / (rows.count() as f64 * flights as f64);
        if map_height_sigma_m.is_some() {
            biases.push(out.map_height_m.each_ref().map(|of| of[SAMPLES as usize - 1]));
        }
    }
    (square, nees, biases)
}

#[test]
fn law_a_height_bias_is_estimated_to_metres_and_does_not_shift_the_position() {
    for (name, linearisation) in [
        ("once", Linearisation::Once),
        ("iterated", Linearisation::Iterated { iterations: 5, tolerance_m: 0.1 }),
        ("unscented", Linearisation::Unscented(ukf::UkfParameters::default())),
    ] {
        let (healthy_m2, _, none) = flown(0.0, Some(50.0), linearisation);
        assert!(none.iter().all(|[bias_m, sigma_m]| bias_m.abs() < 4.0 * sigma_m), "{name}: {none:?}");
        for below_m in [60.0, -60.0] {
            let (square_m2, nees, found) = flown(below_m, Some(50.0), linearisation);
            for [bias_m, sigma_m] in &found {
                let off_m = (bias_m - below_m).abs();
                assert!(off_m < 4.0 * sigma_m && *sigma_m < 6.0, "{name} {below_m}: {bias_m} {sigma_m}");
            }
            assert!(square_m2 < 1.3 * healthy_m2, "{name} {below_m}: {square_m2} {healthy_m2}");
            assert!((1.0..3.5).contains(&nees), "{name} {below_m}: NEES {nees}");
            let (without_m2, without_nees, _) = flown(below_m, None, linearisation);
            assert!(without_m2 > 2.0 * square_m2, "{name} {below_m}: {without_m2} {square_m2}");
            assert!(without_nees > 2.0 * nees, "{name} {below_m}: {without_nees} {nees}");
        }
    }
}

#[test]
fn law_the_height_state_does_not_change_a_filter_without_it() {
    let scene = AnalyticScene { map: bowl_in_height(), ..scene(bowl) };
    let narrow = Aids { map_height_sigma_m: Some(1e-9), ..Aids::default() };
    scene.with(|line| {
        let (with, without) = (
            run(line, &narrow, &keep(Linearisation::Once)).unwrap(),
            run(line, &Aids::default(), &keep(Linearisation::Once)).unwrap(),
        );
        assert!(difference(&with.navigation, &without.navigation) < 1e-4);
        assert_eq!((with.map_height_m[0].len(), without.map_height_m[0].len()), (ROWS, 0));
    });
    let wrong = Aids { map_height_sigma_m: Some(0.0), ..Aids::default() };
    assert!(scene.with(|line| run(line, &wrong, &keep(Linearisation::Once))).is_err());
}

#[test]
fn unit_a_flat_sample_does_not_correct_the_height() {
    let scene = AnalyticScene { map: bowl_in_height(), ..scene(bowl) };
    scene.with(|line| {
        let aids = Aids { map_height_sigma_m: Some(30.0), flat_over_m: Some(1e-3), ..Aids::default() };
        let found = run(line, &aids, &keep(Linearisation::Once)).unwrap();
        assert!(found.flat() > 0 && found.map_height_m[0].iter().all(|bias_m| *bias_m == 0.0));
    });
}

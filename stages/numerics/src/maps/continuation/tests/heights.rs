//! Error of a map at another height.

use super::fields::{Field, Random, Scene, minus, rms_where};
use crate::maps::continuation::{MAGNAV_ALPHA_M2, Padding, RadialPower, continued};
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

#[test]
fn law_the_height_error_agrees_with_the_closed_form() {
    for (seed, scene) in [(1, Scene::Around), (2, Scene::Around), (3, Scene::Inside)] {
        let field = Field::new(scene, seed, [160, 200]);
        let map = field.anomaly(0.0);
        let power = RadialPower::from_map(&map).unwrap();
        for up_m in [20.0, 100.0, 400.0, 1500.0, -30.0] {
            let truth = rms_where(&minus(&map, &field.anomaly(up_m)), |_, _| true);
            let ours = power.height_error_nt(up_m);
            // Tolerance of a quarter for the edges and the uneven distribution of the power.
            assert!((ours / truth - 1.0).abs() < 0.25, "{scene:?} {up_m} m: {ours} {truth}");
        }
        assert_eq!(power.height_error_nt(0.0), 0.0);
    }
}

#[test]
fn law_a_wave_decays_with_its_wavenumber() {
    let axis = |len| EvenAxis { first: 0.0, step: 100.0, len };
    let k = std::f64::consts::TAU / 2000.0;
    let wave = |i: usize| 10.0 * (k * 100.0 * (i % 200) as f64).sin();
    let map = PlaneGrid { east_m: axis(200), north_m: axis(100), values: (0..20_000).map(wave).collect() };
    let power = RadialPower::from_map(&map).unwrap();
    let expected = 50f64.sqrt() * (1.0 - (-k * 300.0).exp());
    // The padding truncates the wave, which broadens its line.
    assert!((power.height_error_nt(300.0) / expected - 1.0).abs() < 0.1);
    let mut holes = map.clone();
    holes.values.iter_mut().step_by(7).for_each(|x| *x = f64::NAN);
    assert!(RadialPower::from_map(&holes).unwrap().height_error_nt(300.0).is_finite());
}

#[test]
fn law_the_downward_error_is_the_amplified_noise_and_the_damped_field() {
    for (seed, scene) in [(1, Scene::Around), (2, Scene::Around), (3, Scene::Regional)] {
        let field = Field::new(scene, seed, [160, 200]);
        for (from_m, down_m) in [(300.0, 100.0), (500.0, 300.0)] {
            for noise_nt in [0.0, 1.0] {
                let mut random = Random::new(40 + seed);
                let mut map = field.anomaly(from_m);
                map.values.iter_mut().for_each(|nt| *nt += noise_nt * random.normal());
                let below = continued(&map, -down_m, MAGNAV_ALPHA_M2, &Padding::default()).unwrap();
                let errors = minus(&below, &field.anomaly(from_m - down_m));
                let truth = rms_where(&errors, |row, column| (30..130).contains(&row) && (30..170).contains(&column));
                let power = RadialPower::from_map(&map).unwrap();
                let known = power.downward_error_nt(down_m, MAGNAV_ALPHA_M2, Some(noise_nt));
                let found = power.downward_error_nt(down_m, MAGNAV_ALPHA_M2, None);
                println!(
                    "{scene:?} {seed}, {from_m} m down {down_m} m, noise {noise_nt} nT: error {truth:.2} nT, known \
                     {known:.2}, found {found:.2}"
                );
                // Noise that cannot be distinguished from the field past the edges is fully amplified: an upper bound.
                assert!((0.5 * truth..2.5 * truth + 0.3).contains(&known) || noise_nt == 0.0, "{known} {truth}");
                // Without noise, leakage from the padding is treated as field, which makes the estimate too large.
                let bounded = known < 2.5 * truth + 0.3 && found < 2.5 * truth + 4.0;
                assert!(bounded || noise_nt == 0.0, "{known} {found} {truth}");
                assert!(found > 0.5 * truth || noise_nt == 0.0, "{found} {truth}");
            }
        }
    }
}

#[test]
fn law_white_noise_grows_downward_by_the_mean_gain() {
    let axis = |len| EvenAxis { first: 0.0, step: 100.0, len };
    let mut random = Random::new(9);
    let map = PlaneGrid {
        east_m: axis(120),
        north_m: axis(120),
        values: (0..14_400).map(|_| 2.0 * random.normal()).collect(),
    };
    let power = RadialPower::from_map(&map).unwrap();
    let below = continued(&map, -50.0, MAGNAV_ALPHA_M2, &Padding::default()).unwrap();
    let truth = rms_where(&below, |row, column| (10..110).contains(&row) && (10..110).contains(&column));
    for noise in [None, Some(2.0)] {
        let ours = power.downward_error_nt(50.0, MAGNAV_ALPHA_M2, noise);
        assert!((ours / truth - 1.0).abs() < 0.15, "{noise:?}: {ours} {truth}");
    }
    let double = power.downward_error_nt(50.0, MAGNAV_ALPHA_M2, Some(4.0))
        / power.downward_error_nt(50.0, MAGNAV_ALPHA_M2, Some(2.0));
    assert!((double - 2.0).abs() < 0.1, "{double}");
}

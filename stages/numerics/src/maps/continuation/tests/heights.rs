//! What a map is off by at another height.

use super::fields::{Field, Scene, minus, rms_where};
use crate::maps::continuation::RadialPower;
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

#[test]
fn law_the_error_of_a_height_is_that_of_the_field_in_closed_form() {
    for (seed, scene) in [(1, Scene::Around), (2, Scene::Around), (3, Scene::Inside)] {
        let field = Field::new(scene, seed, [160, 200]);
        let map = field.anomaly(0.0);
        let power = RadialPower::of(&map).unwrap();
        for up_m in [20.0, 100.0, 400.0, 1500.0, -30.0] {
            let truth = rms_where(&minus(&map, &field.anomaly(up_m)), |_, _| true);
            let ours = power.height_error_nt(up_m);
            // The edges, and the spread of the power over places: a quarter.
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
    let power = RadialPower::of(&map).unwrap();
    let expected = 50f64.sqrt() * (1.0 - (-k * 300.0).exp());
    // The padding breaks the wave off, which spreads its line.
    assert!((power.height_error_nt(300.0) / expected - 1.0).abs() < 0.1);
    let mut holes = map.clone();
    holes.values.iter_mut().step_by(7).for_each(|x| *x = f64::NAN);
    assert!(RadialPower::of(&holes).unwrap().height_error_nt(300.0).is_finite());
}

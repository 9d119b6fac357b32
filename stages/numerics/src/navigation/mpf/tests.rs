#![allow(clippy::unwrap_used)]
use std::sync::{Arc, OnceLock};

use crate::earth::EarthModel;
use crate::earth::core_field::CoreField;
use crate::maps::map_surface::VerticalDerivative;
use crate::maps::{FieldMap, GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::aids::SampleUsage;
use crate::navigation::ekf::{self, EkfParameters};
use crate::navigation::osborne::{Line, core_field, grid, temporal_nt};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector, VE, VN};
use crate::navigation::{InsErrorModel, InsErrors, NavigationOutput, simulate_ins_error};
use crate::random::NormalGenerator;

use super::core_expansion::CoreExpansion;
use super::covariance::{InformationSums, correct, measure};
use super::draws::{DrawPurpose, ParticleDraws};
use super::modes::ModeClusters;
use super::*;

mod fixes;
mod flights;
mod hand_over;

const EARTH: EarthModel = EarthModel::Wgs84;

/// Line whose INS flies north at 75 m/s from 45° N, 76° W.
struct Scene {
    columns: [Vec<f64>; 13],
    measured_nt: Vec<f64>,
    sigma_nt: Vec<f64>,
    map: FieldMap,
    errors: InsErrorModel,
}

/// INS whose only uncertain states are position and S.
fn exact_ins(position_m: f64) -> InsErrors {
    InsErrors {
        init_position_sigma_m: position_m,
        init_altitude_sigma_m: 0.0,
        init_velocity_sigma_mps: 0.0,
        init_attitude_sigma_deg: 0.0,
        vrw_sigma: 0.0,
        arw_sigma: 0.0,
        baro_sigma_m: 0.0,
        ha_sigma_m: 0.0,
        a_hat_sigma_mps2: 0.0,
        acc_sigma_mps2: 0.0,
        gyro_sigma_radps: 0.0,
        ..InsErrors::default()
    }
}

/// Map of a function of metres north and east of 45° N, 76° W, 16 km wide.
fn map_of(value: impl Fn(f64, f64) -> f64, slope: Option<f64>) -> FieldMap {
    let axis = |first: f64| -> Vec<f64> { (0..161).map(|k| first - 0.08 + 0.001 * f64::from(k)).collect() };
    let (lat, lon) = (axis(45.0), axis(-76.0));
    let mut values = vec![];
    for lat in &lat {
        for lon in &lon {
            let (north, east) = EARTH.offset_ne_m((45.0, -76.0), (*lat, *lon), 300.0);
            values.push(value(north, east));
        }
    }
    let grid = GeographicGrid::new(&lat, &lon, &values).unwrap();
    FieldMap::Flat(match slope {
        None => MapSurface::new(&grid, MapInterpolation::Cubic),
        Some(slope) => {
            let d_alt = vec![slope; values.len()];
            let vertical = VerticalDerivative { d_alt_nt_per_m: &d_alt, alt_m: 300.0 };
            MapSurface::with_vertical(&grid, vertical, MapInterpolation::Cubic).unwrap()
        }
    })
}

impl Scene {
    /// Flight of `samples` seconds over a map, with this displacement of the aircraft north and east of the INS.
    fn new(samples: usize, map: FieldMap, sources: InsErrors, true_m: [f64; 2]) -> Self {
        let constant = |value: f64| vec![value; samples];
        let tt: Vec<f64> = (0..samples).map(|k| k as f64).collect();
        let lat: Vec<f64> = tt.iter().map(|t| 45.0 + 75.0 * t / 111_200.0).collect();
        let columns = [
            tt,
            lat,
            constant(-76.0),
            constant(300.0),
            constant(75.0),
            constant(0.0),
            constant(0.0),
            constant(0.0),
            constant(0.0),
            constant(-9.80665),
            constant(0.0),
            constant(0.0),
            constant(0.0),
        ];
        let errors = InsErrorModel { fogm_sigma_nt: 1.0, ..InsErrorModel::from_sources(sources) };
        let mut scene = Self { columns, measured_nt: vec![], sigma_nt: constant(2.0), map, errors };
        let mut normals = NormalGenerator::new(5);
        for row in 0..samples {
            let (lat, lon) = scene.moved(row, true_m);
            let field = scene.map.at(lat, lon, 300.0).map_or(f64::NAN, |field| field.value_nt);
            scene.measured_nt.push(field + 2.0 * normals.draw());
        }
        scene
    }

    /// Position of the INS at a row, shifted, in degrees.
    fn moved(&self, row: usize, [north_m, east_m]: [f64; 2]) -> (f64, f64) {
        let (lat, lon) = (self.columns[1][row], self.columns[2][row]);
        let (north, east) = EARTH.north_east_m_per_rad(lat.to_radians(), 300.0);
        (lat + (north_m / north).to_degrees(), lon + (east_m / east).to_degrees())
    }

    /// The flight as input of a filter.
    fn with<T>(&self, of: impl FnOnce(&NavigationLine<'_>) -> T) -> T {
        let ins = crate::navigation::InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice));
        let Self { measured_nt, sigma_nt, map, errors, .. } = self;
        of(&NavigationLine {
            ins: &ins,
            measurement_nt: measured_nt,
            sigma_nt,
            map,
            core: None,
            errors: *errors,
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        })
    }

    fn try_run(&self, parameters: &MpfParameters) -> Result<MpfOutput, NavigationError> {
        self.with(|line| run(parameters, line, &Aids::default()))
    }

    fn run(&self, parameters: &MpfParameters) -> MpfOutput {
        self.try_run(parameters).unwrap()
    }

    fn ekf(&self) -> NavigationOutput {
        let ins = crate::navigation::InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice));
        let parameters = EkfParameters {
            errors: self.errors,
            measurement_sigma_nt: 2.0,
            keep_covariance: true,
            ..EkfParameters::default()
        };
        ekf::run(&parameters, &ins, &self.measured_nt, &self.map, None).unwrap()
    }
}

fn used(output: &MpfOutput, row: usize) -> bool {
    output.usage[row] == SampleUsage::Used
}

/// All numbers of an output, as bits.
fn bits(output: &MpfOutput) -> Vec<u64> {
    let t = &output.track;
    let columns = [&t.residual_nt, &t.nis, &t.lat_deg, &t.lon_deg, &t.alt_m, &t.vn_mps, &t.sd_n_m, &t.cov_ne_m2];
    let mut bits: Vec<u64> = columns.into_iter().flatten().chain(&output.effective).map(|x| x.to_bits()).collect();
    for mode in output.modes.iter().flat_map(|at| &at.modes) {
        bits.extend([mode.weight, mode.lat_deg, mode.lon_deg, mode.sd_n_m, mode.cov_ne_m2].map(f64::to_bits));
    }
    bits
}

/// Map of constant slope in both directions, and measurements that each determine the position to about one prior
/// standard deviation.
fn linear_scene() -> Scene {
    let sources = InsErrors { init_position_sigma_m: 100.0, ..InsErrors::default() };
    Scene::new(5, map_of(|north, east| 0.02 * north - 0.015 * east, None), sources, [60.0, -80.0])
}

#[test]
fn law_on_a_linear_map_the_difference_to_the_kalman_filter_falls_with_the_root_of_the_particles() {
    let scene = linear_scene();
    let exact = scene.ekf();
    let last = exact.lat_deg.len() - 1;
    let seeds = 24_u64;
    let error_m = |particles: usize| {
        let (mut square, mut sd) = (0.0, 0.0);
        for seed in 0..seeds {
            let out =
                scene.run(&MpfParameters { particles, seed, resample_threshold: 0.0, ..MpfParameters::default() });
            let at = |t: &NavigationOutput| (t.lat_deg[last], t.lon_deg[last]);
            let (north, east) = EARTH.offset_ne_m(at(&exact), at(&out.track), 300.0);
            square += (north * north + east * east) / seeds as f64;
            sd += out.track.sd_n_m[last] / exact.sd_n_m[last] / seeds as f64;
        }
        (square.sqrt(), sd)
    };
    let found = [100, 1000, 10_000].map(error_m);
    println!("rms to the Kalman filter and ratio of sigmas at 100, 1000, 10000 particles: {found:.3?}");
    for pair in found.windows(2) {
        // Factor of √10 = 3.16. Each rms is computed from 48 numbers, so its standard deviation is 10 %, and the
        // standard deviation of the ratio of two is 15 %; the limit is three standard deviations.
        let factor = pair[0].0 / pair[1].0;
        assert!((1.8..5.5).contains(&factor), "{factor}");
    }
    // A standard deviation from 10,000 particles has an error of 1 %, and the mean over the seeds has an error of 0.2
    // %.
    assert!((found[2].1 - 1.0).abs() < 0.01, "{}", found[2].1);
}

#[test]
fn law_with_a_known_position_it_equals_the_kalman_filter_of_the_linear_states() {
    // Altitude, velocity and other states are uncertain at the first sample. After that, only S is uncertain, which
    // does not affect the position.
    for (sources, rows) in [(InsErrors { init_altitude_sigma_m: 20.0, ..exact_ins(0.0) }, 1), (exact_ins(0.0), 60)] {
        let mut scene = Scene::new(rows, map_of(|_, _| 0.0, Some(-0.2)), sources, [0.0; 2]);
        scene.errors.fogm_sigma_nt = 8.0;
        let exact = scene.ekf();
        let usual = MpfParameters { particles: 40, ..MpfParameters::default() };
        let out = scene.run(&MpfParameters { keep_states: true, keep_covariance: true, ..usual });
        for row in 0..rows {
            // Rounding only: a few hundred operations for each number.
            assert!((out.track.residual_nt[row] - exact.residual_nt[row]).abs() < 1e-11);
            assert!((out.track.nis[row] - exact.nis[row]).abs() < 1e-11);
            for a in [ALT, S] {
                let sigma = |k: usize| exact.p[row][k][k].sqrt();
                let off = (out.track.x[row][a] - exact.x[row][a]).abs();
                assert!(off <= 1e-12 * sigma(S), "{row} {a} {off:e}");
                for b in [ALT, S] {
                    let off = (out.track.p[row][a][b] - exact.p[row][a][b]).abs();
                    assert!(off <= 1e-12 * sigma(S) * sigma(S), "{row} {a} {b} {off:e}");
                }
            }
        }
    }
}

#[test]
fn law_the_covariance_after_a_measurement_is_the_mean_over_the_particles() {
    // Altitude and temporal variation S are correlated. Three particles have different slopes; the second particle is
    // off the map.
    let mut p: StateMatrix = [[0.0; STATES]; STATES];
    (p[ALT][ALT], p[S][S], p[ALT][S], p[S][ALT], p[5][5], p[5][ALT], p[ALT][5]) = (4.0, 9.0, 1.5, 1.5, 2.0, 1.0, 1.0);
    let mut expected: StateMatrix = [[0.0; STATES]; STATES];
    let mut sums = InformationSums::default();
    for (weight, slope) in [(0.5, Some(-0.3)), (0.2, None), (0.3, Some(0.8))] {
        let mut own = p;
        if let Some(slope) = slope {
            let variance = 25.0 + p[S][S] + 2.0 * slope * p[ALT][S] + slope * slope * p[ALT][ALT];
            correct(&mut own, &[(S, 1.0), (ALT, slope)], 25.0);
            sums.common += weight / variance;
            sums.alt_common += weight * slope / variance;
            sums.alt += weight * slope * slope / variance;
        }
        for (sum, own) in expected.as_flattened_mut().iter_mut().zip(own.as_flattened()) {
            *sum += weight * own;
        }
    }
    measure(&mut p, &[(S, 1.0)], sums);
    for (a, b) in p.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((a - b).abs() < 1e-13, "{a} {b}");
    }
}

/// Two equal hills, 1.5 km east and west of the line. Optionally, a third hill lies along the western path, on which
/// the aircraft flies.
fn two_hills(third: bool) -> Scene {
    let hill = |north: f64, east: f64| 80.0 * (-(north * north + east * east) / (2.0 * 500.0_f64.powi(2))).exp();
    let value = move |north: f64, east: f64| {
        let sides = hill(north - 1500.0, east - 1500.0) + hill(north - 1500.0, east + 1500.0);
        sides + if third { hill(north - 4500.0, east + 1500.0) } else { 0.0 }
    };
    Scene::new(80, map_of(value, None), exact_ins(800.0), [0.0, -1500.0])
}

#[test]
fn law_an_ambiguous_map_has_two_modes_until_a_feature_resolves_them() {
    let parameters = MpfParameters { particles: 2000, modes_every: Some(10), ..MpfParameters::default() };
    let east_of = |at: &SampleModes, scene: &Scene| -> Vec<(f64, f64)> {
        let origin = |row: usize| (scene.columns[1][row], -76.0);
        let of = |mode: &PositionMode| EARTH.offset_ne_m(origin(at.row), (mode.lat_deg, mode.lon_deg), 300.0).1;
        at.modes.iter().map(|mode| (mode.weight, of(mode))).collect()
    };
    let scene = two_hills(false);
    let mut shares = vec![];
    for seed in 0..8 {
        let out = scene.run(&MpfParameters { seed, ..parameters });
        // After 35 s the aircraft has passed half of both hills.
        let modes = east_of(&out.modes[4], &scene);
        assert_eq!(modes.len(), 2, "{modes:?}");
        assert!(modes.iter().all(|(_, east)| (east.abs() - 1500.0).abs() < 100.0), "{modes:?}");
        shares.push(modes.iter().find(|(_, east)| *east > 0.0).unwrap().0);
    }
    println!("probability of the eastern hill: {shares:.2?}");
    // 1500 m are 1.9 standard deviations: initially a few hundred particles per side, and fewer after each resampling.
    // The result is unbiased over seeds.
    let mean = shares.iter().sum::<f64>() / 8.0;
    assert!((mean - 0.5).abs() < 0.15 && shares.iter().all(|share| (0.15..0.85).contains(share)), "{shares:?}");
    let scene = two_hills(true);
    let exact = scene.ekf();
    let last = exact.lon_deg.len() - 1;
    let (_, ekf_east) =
        EARTH.offset_ne_m(scene.moved(last, [0.0, -1500.0]), (exact.lat_deg[last], exact.lon_deg[last]), 300.0);
    let out = scene.run(&parameters);
    let modes = east_of(out.modes.last().unwrap(), &scene);
    println!("after the third hill: {modes:.3?}; the Kalman filter is {ekf_east:.0} m off");
    assert!(modes[0].0 > 0.99 && (modes[0].1 + 1500.0).abs() < 50.0, "{modes:?}");
    // The covariance is small on the wrong hill.
    assert!(ekf_east.abs() > 500.0 && exact.sd_e_m[last] < 50.0, "{ekf_east}");
}

#[test]
fn unit_results_are_bit_identical_for_any_number_of_threads_and_differ_by_seed() {
    // Enough particles to use several threads.
    let scene = two_hills(true);
    let parameters = MpfParameters { particles: 9000, modes_every: Some(20), ..MpfParameters::default() };
    let on = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        bits(&pool.install(|| scene.run(&MpfParameters { seed, ..parameters })))
    };
    let one = on(1, 3);
    assert!(one == on(4, 3) && one == on(4, 3));
    assert!(one != on(4, 4));
}

#[test]
fn law_draws_are_standard_normal_and_uncorrelated() {
    let n = 100_000;
    let [mut sum, mut square, mut product, mut across] = [0.0; 4];
    let (here, next) = (ParticleDraws::new(7, DrawPurpose::Motion, 1), ParticleDraws::new(7, DrawPurpose::Motion, 2));
    for particle in 0..n {
        let ([a, b], [c, _]) = (here.normals(particle), next.normals(particle));
        sum += a + b;
        square += a * a + b * b;
        product += a * b;
        across += a * c;
    }
    let n = n as f64;
    // The standard deviations of the means are 1/√(2n), √(2/2n) and 1/√n. The limits are four standard deviations.
    assert!((sum / (2.0 * n)).abs() < 4.0 / (2.0 * n).sqrt() && (square / (2.0 * n) - 1.0).abs() < 4.0 / n.sqrt());
    assert!(product.abs() < 4.0 * n.sqrt() && across.abs() < 4.0 * n.sqrt());
}

#[test]
fn law_modes_of_different_sizes_are_separated_and_one_gaussian_is_one_mode() {
    let mut clusters = ModeClusters::default();
    for seed in 0..20 {
        let mut normals = NormalGenerator::new(seed);
        let mut points = vec![];
        // Three quarters of the points in two narrow modes 300 apart, and a quarter in a wide mode far away.
        for k in 0..1000 {
            let (at, size) =
                [([0.0, 0.0], 20.0), ([300.0, 0.0], 30.0), ([0.0, 0.0], 20.0), ([5000.0, -9000.0], 400.0)][k % 4];
            points.push([at[0] + size * normals.draw(), at[1] + size * normals.draw()]);
        }
        clusters.find(&[1e-3; 1000], |k| points[k]);
        assert_eq!(clusters.count, 3, "seed {seed}");
        let wrong = (0..1000).filter(|k| clusters.labels[*k] != clusters.labels[[0, 1, 0, 3][k % 4]]).count();
        assert!(wrong <= 2, "{wrong}");
        let one: Vec<[f64; 2]> = (0..1000).map(|_| [normals.draw(), 50.0 * normals.draw()]).collect();
        clusters.find(&[1e-3; 1000], |k| one[k]);
        assert_eq!(clusters.count, 1, "seed {seed}");
    }
}

#[test]
fn law_the_core_field_is_expanded_to_a_thousandth_within_ten_kilometres() {
    let core = Arc::new(CoreField::at(2020.5).unwrap());
    for lat in [-70.0, 0.0, 45.0] {
        let mut near = CoreExpansion::new(core.clone());
        near.follow(lat, 140.0, 500.0);
        for (north, east, up) in [(0.0, 0.0, 0.0), (7e3, 7e3, 50.0), (-1e4, 0.0, -50.0), (0.0, 1e4, 20.0)] {
            let (per_north, per_east) = EARTH.north_east_m_per_rad(f64::to_radians(lat), 500.0);
            let at = (lat + f64::to_degrees(north / per_north), 140.0 + f64::to_degrees(east / per_east), 500.0 + up);
            let exact = core.magnitude_and_gradient(at.0, at.1, at.2);
            let (value_nt, slope) = near.at(at.0, at.1, at.2);
            assert!((value_nt - exact.value_nt).abs() < 2e-3, "{lat} {north} {}", value_nt - exact.value_nt);
            assert!((slope - exact.d_alt_nt_per_m).abs() < 1e-5);
        }
    }
}

#[test]
fn unit_missing_measurements_are_predicted_and_counted() {
    let mut scene = two_hills(true);
    scene.measured_nt[0] = f64::NAN;
    scene.measured_nt[10..20].fill(f64::NAN);
    scene.measured_nt[30] = f64::INFINITY;
    scene.sigma_nt[31] = 0.0;
    scene.sigma_nt[32] = -1.0;
    scene.sigma_nt[33] = f64::NAN;
    let out = scene.run(&MpfParameters::default());
    let report = out.track.report;
    assert_eq!((report.missing_measurements, report.updates), (15, 65));
    assert!([0, 15, 30, 31, 32, 33].iter().all(|row| out.track.residual_nt[*row].is_nan() && !used(&out, *row)));
    assert!(out.track.lat_deg.iter().chain(&out.track.sd_n_m).all(|x| x.is_finite()));
    scene.measured_nt.fill(f64::NAN);
    let out = scene.run(&MpfParameters::default());
    assert_eq!((out.track.report.missing_measurements, out.report.resamplings), (80, 0));
    // For 1000 draws, the standard deviation of the mean is 800/√1000 = 25 m, and the standard deviation of the sample
    // standard deviation is 18 m. The limits are three times these values.
    assert!(
        EARTH.offset_ne_m(scene.moved(79, [0.0; 2]), (out.track.lat_deg[79], out.track.lon_deg[79]), 300.0).0.abs()
            < 80.0
    );
    assert!((out.track.sd_n_m[79] - 800.0).abs() < 60.0, "{}", out.track.sd_n_m[79]);
}

#[test]
fn law_particles_off_the_map_keep_their_probability() {
    // The line begins 8.9 km from the northern edge; this position is 200 m from that edge.
    let mut scene = two_hills(false);
    let edge = 45.08 - 200.0 / 111_200.0;
    scene.columns[1].fill(edge);
    scene.columns[4].fill(0.0);
    scene.measured_nt.fill(0.0);
    scene.measured_nt[5..].fill(f64::NAN);
    let parameters = MpfParameters { particles: 4000, resample_threshold: 0.0, ..MpfParameters::default() };
    let out = scene.run(&parameters);
    assert_eq!(out.track.report.updates, 5);
    // The map is flat there, so the measurements contain no information, and the cloud keeps its shape on and off the
    // map.
    let mut blind = scene.measured_nt.clone();
    blind.fill(f64::NAN);
    let without = Scene { measured_nt: blind, ..two_hills(false) };
    let without = Scene { columns: scene.columns.clone(), ..without }.run(&parameters);
    assert!((out.track.lat_deg[10] - without.track.lat_deg[10]).abs() < 1e-4, "within 10 m");
    assert!((out.track.sd_n_m[10] / without.track.sd_n_m[10] - 1.0).abs() < 0.01);
    // 30 km away from the map no value exists.
    scene.columns[1].fill(45.4);
    let out = scene.run(&parameters);
    assert_eq!((out.track.report.off_map, out.track.report.missing_measurements, out.track.report.updates), (5, 75, 0));
    assert!(out.track.residual_nt.iter().all(|residual| residual.is_nan()) && (out.effective[4] - 4000.0).abs() < 1e-6);
}

#[test]
fn unit_measurements_that_no_particle_explains_are_rejected_and_counted() {
    let clean = two_hills(true);
    let mut spiked = two_hills(true);
    spiked.measured_nt[40] += 1e6;
    spiked.measured_nt[41] = -1e300;
    let mut missing = two_hills(true);
    missing.measured_nt[40..42].fill(f64::NAN);
    let parameters = MpfParameters::default();
    let (out, expected) = (spiked.run(&parameters), missing.run(&parameters));
    assert_eq!((out.track.report.gated, out.report.unexplained, out.report.unexplained_in_a_row), (2, 2, 2));
    assert_eq!(out.track.lat_deg, expected.track.lat_deg, "as if they had not been measured");
    assert!(out.track.nis[40] > 1e6 && !used(&out, 40));
    // A gate rejects more measurements.
    let gated = clean.run(&MpfParameters { gate_nis: Some(4.0), ..parameters });
    assert!(gated.track.report.gated > 0 && gated.report.unexplained == 0);
}

#[test]
fn unit_uneven_time_and_a_single_sample_are_valid() {
    let mut scene = two_hills(true);
    for column in &mut scene.columns {
        let mut row = 0;
        column.retain(|_| {
            row += 1;
            row % 7 != 3 && !(20..31).contains(&row)
        });
    }
    let rows = scene.columns[0].len();
    let out = scene.run_first(rows);
    assert_eq!((out.track.lat_deg.len(), out.modes.last().unwrap().row), (rows, rows - 1));
    assert!(out.track.sd_e_m.iter().all(|sd| sd.is_finite() && *sd > 0.0));
    let single = two_hills(true).run_first(1);
    assert_eq!((single.track.lat_deg.len(), single.modes.len(), single.track.report.updates), (1, 1, 1));
    let weights: f64 = single.modes[0].modes.iter().map(|mode| mode.weight).sum();
    assert!((weights - 1.0).abs() < 1e-12);
    // With one particle, the filter equals a Kalman filter of the linear states along one random path.
    let one = two_hills(true).run(&MpfParameters { particles: 1, ..MpfParameters::default() });
    assert!(one.track.lat_deg.iter().all(|x| x.is_finite()) && one.track.sd_n_m.iter().all(|sd| *sd == 0.0));
}

impl Scene {
    /// Runs the filter on the first rows of all columns.
    fn run_first(mut self, rows: usize) -> MpfOutput {
        self.columns
            .iter_mut()
            .chain([&mut self.measured_nt, &mut self.sigma_nt])
            .for_each(|column| column.truncate(rows));
        self.run(&MpfParameters::default())
    }
}

#[test]
fn unit_invalid_lines_and_parameters_are_rejected() {
    let refused = |parameters: MpfParameters| linear_scene().try_run(&parameters).unwrap_err().to_string();
    let usual = MpfParameters::default();
    assert_eq!(refused(MpfParameters { particles: 0, ..usual }), "`particles` must be 1 to 1000000, not 0");
    assert_eq!(
        refused(MpfParameters { resample_threshold: 1.5, ..usual }),
        "`resample_threshold` must be 0 to 1, not 1.5"
    );
    assert_eq!(refused(MpfParameters { gate_nis: Some(0.0), ..usual }), "`gate_nis` must be above 0, not 0");
    assert_eq!(refused(MpfParameters { modes_every: Some(0), ..usual }), "`modes_every` must be above 0, not 0");
    assert!(refused(MpfParameters { roughening: f64::NAN, ..usual }).starts_with("`roughening` must be"));
    let mut line = linear_scene();
    line.columns[7][2] = 1e200;
    let message = line.try_run(&usual).unwrap_err().to_string();
    assert!(message.starts_with("the filter diverged at row 3"), "{message}");
    line.columns[7][2] = f64::NAN;
    assert!(line.try_run(&usual).unwrap_err().to_string().contains("is NaN in row 2"));
}

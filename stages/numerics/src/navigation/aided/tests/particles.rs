//! Further measurements in the particle filter: compared to the Kalman filter where that is exact, and to flights with
//! known truth.

use super::flights::{Consistency, SAMPLES, consistency_of, difference_nt, drifting, lasting_error_nt, vector_nt};
use super::*;
use crate::navigation::flights::{OsborneFlight, world};
use crate::navigation::ins_error::{InsErrorModel, InsErrors};
use crate::navigation::mpf::{self, MpfOutput, MpfParameters};
use crate::navigation::pinson::TILT_D;

/// Errors of an INS without position drift.
fn steady() -> InsErrors {
    InsErrors {
        init_position_sigma_m: 0.0,
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

fn kept(particles: usize, seed: u64) -> MpfParameters {
    MpfParameters { particles, seed, keep_states: true, keep_covariance: true, ..MpfParameters::default() }
}

/// Largest difference of means and covariances of the linear states, in standard deviations of the Kalman filter.
fn off(found: &NavigationOutput, exact: &NavigationOutput, row: usize) -> f64 {
    let mut largest = 0.0_f64;
    // States without variance contain only rounding errors.
    let unknown = |state: &usize| exact.p[row][*state][*state] > 1e-20;
    for a in (ALT..STATES).filter(unknown) {
        let sigma = exact.p[row][a][a].sqrt();
        largest = largest.max((found.x[row][a] - exact.x[row][a]).abs() / sigma);
        for b in (ALT..STATES).filter(unknown) {
            let size = sigma * exact.p[row][b][b].sqrt();
            largest = largest.max((found.p[row][a][b] - exact.p[row][a][b]).abs() / size);
        }
    }
    largest
}

/// Scene with known position near the map and measurements, with aids with or without a vector.
fn known(sources: InsErrors) -> (AnalyticScene, Read) {
    let mut scene = AnalyticScene { fixes: None, ..scene(bowl) };
    scene.errors.sources = sources;
    let read = read(&scene);
    (scene, read)
}

#[test]
fn law_at_a_known_position_particles_equal_the_kalman_filter_with_all_measurements() {
    let (scene, read) = known(steady());
    scene.with(|line| {
        for aids in [aids(&read), Aids { vector: None, ..aids(&read) }, Aids { height: None, ..aids(&read) }] {
            let exact = run(line, &aids, &keep(Linearisation::Once)).unwrap();
            let found = mpf::run(&kept(40, 0), line, &aids).unwrap();
            for row in 0..ROWS {
                let off = off(&found.track, &exact.navigation, row);
                assert!(off < 1e-8, "{row}: {off:e}");
            }
            assert_eq!(found.usage, exact.usage);
            let same = |one: &Innovations, other: &Innovations, name: &str| {
                assert_eq!(one.nis.len(), other.nis.len(), "{name}");
                for (one, other) in one.nis.iter().zip(&other.nis).chain(one.residual.iter().zip(&other.residual)) {
                    assert!((one.is_nan() && other.is_nan()) || (one - other).abs() < 1e-7, "{name}: {one} {other}");
                }
            };
            same(&found.aids.difference, &exact.aids.difference, "difference");
            same(&found.aids.vector, &exact.aids.vector, "vector");
            same(&found.aids.height, &exact.aids.height, "height");
            assert!(exact.navigation.p[ROWS - 1][S][S] > 0.0 && found.report.unexplained == 0);
        }
    });
}

#[test]
fn law_one_sample_corrects_height_and_tilt_like_the_kalman_filter() {
    let sources = InsErrors { init_altitude_sigma_m: 20.0, init_attitude_sigma_deg: 0.3, ..steady() };
    let (mut scene, read) = known(sources);
    let at = |column: usize| scene.columns[column][0];
    scene.measurement_nt[0] += read.core.magnitude_nt(at(1), at(2), at(3));
    scene.with(|line| {
        let row = || (0..13).map(|column| scene.columns[column][..1].to_vec());
        let columns: Vec<Vec<f64>> = row().collect();
        let columns: [&[f64]; 13] = std::array::from_fn(|k| columns[k].as_slice());
        let ins = InsSeries::from_columns(columns);
        let (measurement_nt, sigma_nt) = (&line.measurement_nt[..1], &line.sigma_nt[..1]);
        let line = NavigationLine { ins: &ins, measurement_nt, sigma_nt, core: Some(&read.core), ..*line };
        let all = aids(&read);
        let first = |aids: Aids<'_>| -> (f64, f64) {
            let exact = run(&line, &aids, &keep(Linearisation::Once)).unwrap().navigation;
            let found = mpf::run(&kept(40, 0), &line, &aids).unwrap().track;
            let heading = exact.p[0][TILT_D][TILT_D].sqrt();
            (off(&found, &exact, 0), heading)
        };
        let difference = all.difference.map(|of| DifferenceAid { difference_nt: &of.difference_nt[..1], ..of });
        let vector = all.vector.map(|of| VectorAid { field_nt: of.field_nt.map(|column| &column[..1]), ..of });
        let height = all.height.map(|of| HeightAid { alt_m: &of.alt_m[..1], ..of });
        let none = Aids { map_error: all.map_error, ..Aids::default() };
        let (_, before) = first(none);
        for (name, aids, within) in [
            // The core field is accurate to 0.001 nT of 5.
            ("difference", Aids { difference, ..none }, 1e-3),
            ("height", Aids { height, ..none }, 1e-3),
            // Half a degree to second order changes 2 nT of 50,000.
            ("vector", Aids { vector, ..none }, 0.05),
        ] {
            let (off, heading) = first(aids);
            println!("{name}: {off:e} of a sigma, heading {heading:e} of {before:e}");
            assert!(off < within, "{name}: {off:e}");
            assert!((name == "vector") == (heading < 0.97 * before), "{name}: {heading} {before}");
        }
    });
}

#[test]
fn law_over_a_bowl_particles_converge_to_the_kalman_filter_with_all_measurements() {
    let mut scene = AnalyticScene { fixes: None, ..scene(bowl) };
    scene.errors.sources.init_position_sigma_m = 40.0;
    let read = read(&scene);
    scene.with(|line| {
        let aids = aids(&read);
        let exact = run(line, &aids, &keep(Linearisation::Once)).unwrap().navigation;
        let last = ROWS - 1;
        let mean = |particles: usize| {
            const SEEDS: u64 = 8;
            let (mut square, mut sd) = (0.0, [0.0; 4]);
            for seed in 0..SEEDS {
                let found = mpf::run(&kept(particles, seed), line, &aids).unwrap().track;
                for state in 0..STATES {
                    let sigma = exact.p[last][state][state].sqrt();
                    let off = (found.x[last][state] - exact.x[last][state]) / sigma;
                    square += off * off / (STATES as f64 * SEEDS as f64);
                }
                for (sd, state) in sd.iter_mut().zip([LAT, LON, ALT, TILT_D]) {
                    *sd += (found.p[last][state][state] / exact.p[last][state][state]).sqrt() / SEEDS as f64;
                }
            }
            (square.sqrt(), sd)
        };
        let [(few, _), (many, sd)] = [300, 10_000].map(mean);
        println!("rms of all states to the Kalman filter {few:.3} and {many:.3} sigma, ratios of sigma {sd:.3?}");
        assert!(many < 0.05 && few > 2.0 * many, "{few} {many}");
        assert!(sd.iter().all(|ratio| (ratio - 1.0).abs() < 0.03), "{sd:?}");
    });
}

/// Consistency on flights of a filter that must be consistent.
fn flown(
    name: &str,
    model: InsErrorModel,
    map_error: Option<MapErrorProcess>,
    scalar: bool,
    by: impl Fn(&NavigationLine<'_>, &Aids<'_>) -> NavigationOutput,
) -> Consistency {
    let found = flown_only(model, map_error, scalar, by);
    found.assert(name, 0.05);
    found
}

/// Consistency on flights with a difference, a map error and optionally the field.
fn flown_only(
    model: InsErrorModel,
    map_error: Option<MapErrorProcess>,
    scalar: bool,
    by: impl Fn(&NavigationLine<'_>, &Aids<'_>) -> NavigationOutput,
) -> Consistency {
    let baseline_m = [15.0, 0.0, 0.0];
    consistency_of(model, |flight, seed| {
        let difference = difference_nt(flight, baseline_m, 0.05, 500 + seed);
        let mut measured = flight.measured(1000 + seed, 2.0);
        if let Some(of) = map_error {
            measured.iter_mut().zip(lasting_error_nt(flight, of, 700 + seed)).for_each(|(nt, error)| *nt += error);
        }
        if !scalar {
            measured.fill(f64::NAN);
        }
        let (ins, sigma) = (flight.ins.series(), vec![2.0; SAMPLES as usize]);
        let bias = GaussMarkov { sigma: 0.3, tau_s: 600.0 };
        let difference = DifferenceAid {
            difference_nt: &difference,
            sigma_nt: 0.05,
            baseline_m,
            slope: SlopeError::default(),
            bias,
        };
        let aids = Aids { difference: Some(difference), map_error, ..Aids::default() };
        by(&flight.line(&ins, &measured, &sigma), &aids)
    })
}

/// 8000 particles, and the distance over which the measurement is nearly linear.
fn by_particles(smooth_over_m: f64) -> impl Fn(&NavigationLine<'_>, &Aids<'_>) -> NavigationOutput {
    let parameters = MpfParameters { particles: 8000, smooth_over_m, ..MpfParameters::default() };
    move |line, aids| mpf::run(&parameters, line, aids).unwrap().track
}

fn by_ekf(line: &NavigationLine<'_>, aids: &Aids<'_>) -> NavigationOutput {
    run(line, aids, &AidedParameters::default()).unwrap().navigation
}

#[test]
fn law_particles_are_consistent_with_a_difference_and_a_map_error() {
    let map_error = Some(MapErrorProcess { sigma_nt: 15.0, length_m: 1000.0 });
    let ekf = flown("ekf", drifting(), map_error, true, by_ekf);
    // With 2000 particles, the filter with a difference of 0.05 nT diverges on one flight in twenty.
    let particles = flown("mpf", drifting(), map_error, true, by_particles(200.0));
    assert!(particles.square_m2 < 1.2 * ekf.square_m2, "{} {}", particles.square_m2, ekf.square_m2);
}

#[test]
fn law_particles_recover_a_lost_aircraft_with_the_difference_alone() {
    let lost = InsErrorModel::from_sources(InsErrors { init_position_sigma_m: 300.0, ..InsErrors::default() });
    // The slope of the map is linear over a smaller distance than the map.
    let particles = flown("mpf, lost by 300 m", lost, None, false, by_particles(70.0));
    assert!(particles.square_m2 < 10.0 * 10.0, "{}", particles.square_m2);
    let kalman = flown_only(lost, None, false, by_ekf);
    println!("ekf, lost by 300 m: DRMS {:.0} m", kalman.square_m2.sqrt());
    assert!(kalman.square_m2 > 100.0 * particles.square_m2, "{}", kalman.square_m2);
}

#[test]
fn law_particles_estimate_the_heading_from_a_vector() {
    let sources = InsErrors { init_heading_sigma_deg: Some(0.5), ..InsErrors::default() };
    let model = InsErrorModel::from_sources(sources);
    const FLIGHTS: u64 = 12;
    let (mut square, mut nees, mut exact) = (0.0, 0.0, 0.0);
    for seed in 0..FLIGHTS {
        let flight = OsborneFlight::flown(seed, 301, 1.0, model);
        let (measured, field) = (flight.measured(1000 + seed, 5.0), vector_nt(&flight, 300 + seed));
        let (ins, sigma) = (flight.ins.series(), vec![5.0; 301]);
        let vector = VectorAid {
            field_nt: field.each_ref().map(Vec::as_slice),
            sigma_nt: 5.0,
            bias: GaussMarkov { sigma: 20.0, tau_s: 3600.0 },
            crustal_sigma_nt: 40.0,
            crustal_length_m: 2000.0,
            core: &world().core,
        };
        let aids = Aids { vector: Some(vector), ..Aids::default() };
        let line = flight.line(&ins, &measured, &sigma);
        let MpfOutput { track, .. } = mpf::run(&kept(1000, seed), &line, &aids).unwrap();
        let kalman = run(&line, &aids, &keep(Linearisation::Once)).unwrap().navigation;
        let of = |out: &NavigationOutput| (flight.errors[300][TILT_D] - out.x[300][TILT_D]).powi(2);
        square += of(&track) / FLIGHTS as f64;
        exact += of(&kalman) / FLIGHTS as f64;
        nees += of(&track) / track.p[300][TILT_D][TILT_D] / FLIGHTS as f64;
    }
    let [deg, exact_deg] = [square, exact].map(|square: f64| square.sqrt().to_degrees());
    println!("heading to {deg:.3} degrees, by the Kalman filter {exact_deg:.3}; NEES {nees:.2}");
    // The 99.9 % band of chi-square with 12 degrees of freedom.
    assert!(deg < 0.1 && deg < 1.2 * exact_deg && (0.15..2.9).contains(&nees), "{deg} {exact_deg} {nees}");
}

#[test]
fn unit_particles_with_further_measurements_are_bit_identical_for_any_number_of_threads() {
    let scene = scene(hills);
    let read = read(&scene);
    scene.with(|line| {
        let aids = aids(&read);
        let on = |threads: usize, seed: u64| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let out = pool.install(|| mpf::run(&kept(9000, seed), line, &aids).unwrap());
            let states = out.track.x.iter().flatten();
            states.chain(&out.aids.vector.nis).map(|x| x.to_bits()).collect::<Vec<u64>>()
        };
        let one = on(1, 3);
        assert!(one == on(3, 3) && one != on(1, 4));
    });
}

#[test]
fn unit_particles_skip_each_missing_measurement_separately() {
    let (scene, mut read) = known(InsErrors { init_position_sigma_m: 30.0, ..steady() });
    read.difference_nt[12] = 50.0;
    read.alt_m[14] += 500.0;
    read.field_nt[1][15] += 5000.0;
    scene.with(|line| {
        let all = aids(&read);
        let found = mpf::run(&kept(500, 1), line, &all).unwrap();
        let normal = |nis: &[f64], row: usize| nis[row] < 37.0;
        assert!(!normal(&found.aids.difference.nis, 12) && !normal(&found.aids.height.nis, 14));
        assert!(
            found.usage[12] == SampleUsage::Used
                && found.usage[14] == SampleUsage::Used
                && found.usage[15] == SampleUsage::Used
        );
        // The height carries no information about the horizontal position.
        assert_eq!(found.report.unexplained, 2);
        assert_eq!(found.aids.difference.nis.len(), ROWS);
        let blind = [f64::NAN; ROWS];
        let without =
            Aids { difference: Some(DifferenceAid { difference_nt: &blind, ..all.difference.unwrap() }), ..all };
        let found = mpf::run(&kept(500, 1), line, &without).unwrap();
        assert!(found.aids.difference.nis.iter().all(|nis| nis.is_nan()));
    });
}

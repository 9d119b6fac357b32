#![allow(clippy::unwrap_used)]
//! Comparison of propagated errors with other sample rates, with the propagated covariance, and between mechanisation
//! and error model.
use std::f64::consts::TAU;

use nalgebra::{SMatrix, SVector};

use super::*;
use crate::earth::geodesy::{EARTH_RATE_RADPS, EarthModel, SEMI_MAJOR_AXIS_M, STANDARD_GRAVITY_MPS2};
use crate::navigation::mechanisation::NavigationEarth;
use crate::navigation::pinson::TILT_D;
use crate::navigation::transition::step_covariance;
use crate::random::NormalGenerator;

/// Level flight at 60 m/s on the sphere of the error model at height 0, with a course that varies by `weave_rad` about
/// 30 degrees in two minutes.
struct Flight {
    columns: [Vec<f64>; 13],
}

impl Flight {
    fn new(seconds: f64, rate_hz: f64, weave_rad: f64) -> Self {
        const V: f64 = 60.0;
        const R: f64 = SEMI_MAJOR_AXIS_M;
        let mut columns: [Vec<f64>; 13] = Default::default();
        let (mut lat, mut lon) = (-0.4_f64, 2.4_f64);
        for k in 0..=(seconds * rate_hz).round() as usize {
            let t = k as f64 / rate_hz;
            let heading = |t: f64| 0.5 + weave_rad * (TAU * t / 120.0).sin();
            let turn = weave_rad * TAU / 120.0 * (TAU * t / 120.0).cos();
            let (sin, cos) = heading(t).sin_cos();
            let (vn, ve) = (V * cos, V * sin);
            let coriolis = 2.0 * EARTH_RATE_RADPS * lat.sin() + ve * lat.tan() / R;
            let force = [
                -V * turn * sin + ve * coriolis,
                V * turn * cos - vn * coriolis,
                2.0 * EARTH_RATE_RADPS * ve * lat.cos() + V * V / R - STANDARD_GRAVITY_MPS2,
            ];
            let roll = (V * turn / STANDARD_GRAVITY_MPS2).atan();
            let row = [t, lat.to_degrees(), lon.to_degrees(), 0.0, vn, ve, 0.0, force[0], force[1], force[2]];
            let attitude = [roll.to_degrees(), 2.0, heading(t).to_degrees()];
            columns.iter_mut().zip(row.into_iter().chain(attitude)).for_each(|(column, x)| column.push(x));
            let (sin, cos) = heading(t + 0.5 / rate_hz).sin_cos();
            lon += V * sin / (R * lat.cos()) / rate_hz;
            lat += V * cos / R / rate_hz;
        }
        Self { columns }
    }

    fn series(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }
}

const SPHERE: MechanisationErrors = MechanisationErrors {
    earth: NavigationEarth::Sphere { rate_radps: EARTH_RATE_RADPS },
    acc_scale: [0.0; 3],
    gyro_scale: [0.0; 3],
};

/// Runs `f` with the two streams of a seed.
fn drawn<T>(seed: u64, f: impl FnOnce(&mut NormalStreams<'_>) -> T) -> T {
    let (mut block, mut within) = (NormalGenerator::new(2 * seed), NormalGenerator::new(2 * seed + 1));
    f(&mut NormalStreams { block: &mut || block.draw(), within: &mut || within.draw() })
}

/// Last error of a member drawn from the start.
fn last_error(truth: &InsSeries<'_>, model: &InsErrorModel, seed: u64, mechanised: bool) -> StateVector {
    drawn(seed, |draws| {
        let start = model.initial_error(truth.point(0).lat_rad, truth.alt_m[0], draws.block);
        let errors = match mechanised {
            true => mechanised_errors_along(truth, model, &SPHERE, &start, draws).unwrap(),
            false => errors_along(truth, model, &start, draws).unwrap(),
        };
        errors[errors.len() - 1]
    })
}

/// Covariance at the end of a trajectory.
fn propagated(truth: &InsSeries<'_>, model: &InsErrorModel) -> StateMatrix {
    let mut p = model.initial_covariance(truth.point(0).lat_rad, truth.alt_m[0]);
    for row in 1..truth.len() {
        let dt_s = truth.tt_s[row] - truth.tt_s[row - 1];
        let f = pinson_matrix(&truth.point(row - 1), &model.time_constants(), model.pinson);
        p = step_covariance(&p, &f, &transition_matrix(&f, dt_s), &model.noise_density(), dt_s, model.noise);
    }
    p
}

/// Largest difference between two errors, in standard deviations from a covariance.
fn apart(a: &StateVector, b: &StateVector, p: &StateMatrix) -> f64 {
    (0..A_HAT).fold(0.0, |most: f64, state| most.max((a[state] - b[state]).abs() / p[state][state].sqrt()))
}

#[test]
fn ref_grades_of_lee_2019() {
    // Tables 9 and 10: position 0, height 5 m, and velocity and tilt with the numbers of the biases.
    let printed = [
        (InsGrade::Navigation, [1e-12, 2.4525e-4, 5.8178e-7, 1.4544e-8]),
        (InsGrade::Tactical, [0.003_302, 9.81e-3, 3.6361e-5, 4.8481e-6]),
        (InsGrade::Commercial, [0.0043, 0.1960, 6.5e-4, 0.0087]),
    ];
    for (grade, [vrw, acc, arw, gyro]) in printed {
        let model = grade.model();
        assert_eq!(
            [
                model.sources.vrw_sigma,
                model.sources.acc_sigma_mps2,
                model.sources.arw_sigma,
                model.sources.gyro_sigma_radps
            ],
            [vrw, acc, arw, gyro]
        );
        let sigmas = model.initial_sigmas(0.5, 0.0);
        assert_eq!((sigmas[LAT], sigmas[ALT], sigmas[VN], sigmas[ACC], sigmas[GYRO]), (0.0, 5.0, acc, acc, gyro));
        assert!((sigmas[TILT_N] / gyro - 1.0).abs() < 1e-15);
        assert_eq!((model.sources.acc_tau_s, model.sources.gyro_tau_s), (3600.0, 3600.0));
        // Navigation grade in common units: 25 micro-g and 0.003 degrees per hour.
    }
    let navigation = InsGrade::Navigation.model();
    assert!((navigation.sources.gyro_sigma_radps.to_degrees() * 3600.0 - 0.003).abs() < 1e-6);
    assert!((navigation.sources.acc_sigma_mps2 / 9.81 - 25e-6).abs() < 1e-9);
    assert_eq!(InsGrade::default().model(), InsErrorModel::default());
}

#[test]
fn law_a_realisation_does_not_depend_on_rate_or_ensemble() {
    for grade in [InsGrade::Magnav, InsGrade::Tactical] {
        let model = grade.model();
        let [slow, fast, faster] = [1.0, 10.0, 50.0].map(|rate_hz| Flight::new(300.0, rate_hz, 0.6));
        let p = propagated(&slow.series(), &model);
        let [of_slow, of_fast, of_faster] =
            [&slow, &fast, &faster].map(|flight| last_error(&flight.series(), &model, 5, false));
        // Bank (up to 11 degrees) and turn rate (up to 2 degrees per second) are constant over a step.
        assert!(apart(&of_slow, &of_fast, &p) < 0.03, "{grade:?} {}", apart(&of_slow, &of_fast, &p));
        assert!(apart(&of_fast, &of_faster, &p) < 0.003, "{grade:?} {}", apart(&of_fast, &of_faster, &p));
        let mut normals = NormalGenerator::new(10);
        let start = model.initial_error(-0.4, 0.0, &mut || normals.draw());
        let mut ensemble = InsErrorEnsemble::new(vec![start]);
        ensemble.advance(&fast.series(), &model, true, &mut |_| normals.draw()).unwrap();
        assert!(apart(&ensemble.errors()[0], &of_fast, &p) < 0.003);
        let other = last_error(&fast.series(), &model, 6, false);
        assert!(apart(&other, &of_fast, &p) > 0.1, "another seed is another realisation");
    }
}

#[test]
fn law_a_trajectory_in_pieces_gives_the_errors_of_the_whole() {
    let model = InsGrade::Navigation.model();
    let flight = Flight::new(120.0, 10.0, 0.6);
    let whole = last_error(&flight.series(), &model, 1, false);
    let part = |from: usize, to: usize| Flight { columns: flight.columns.each_ref().map(|c| c[from..=to].to_vec()) };
    let (first, second) = (part(0, 700), part(700, 1200));
    let in_pieces = drawn(1, |draws| {
        let start = model.initial_error(-0.4, 0.0, draws.block);
        let errors = errors_along(&first.series(), &model, &start, draws).unwrap();
        errors_along(&second.series(), &model, &errors[700], draws).unwrap()[500]
    });
    assert_eq!(in_pieces, whole);
}

/// Quantile of chi-square with `freedom` degrees at `z` standard normal deviates, by the formula of Wilson and
/// Hilferty; the error is below 0.1 % for at least a hundred degrees of freedom.
fn chi_square(freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + z * spread.sqrt()).powi(3)
}

/// Compares the variances of position, velocity and tilt of `errors`, and the mean of their NEES, with a covariance.
/// Each variance times the number of errors is chi-square with that many degrees; the sum of the nine-dimensional NEES
/// has nine times as many.
fn assert_covariance(what: &str, errors: &[StateVector], p: &StateMatrix) {
    // By Bonferroni's method, the two-sided probability of 0.1 % is divided among 10 statistics of each of 6 ensembles,
    // which gives 0.001/120 per tail.
    const Z: f64 = 4.30;
    let n = errors.len() as f64;
    let scaled = |error: &StateVector| SVector::<f64, 9>::from_fn(|k, _| error[k] / p[k][k].sqrt());
    let correlation = SMatrix::<f64, 9, 9>::from_fn(|a, b| p[a][b] / (p[a][a] * p[b][b]).sqrt());
    let ratios: SVector<f64, 9> = errors.iter().map(|e| scaled(e).map(|x| x * x)).sum::<SVector<f64, 9>>() / n;
    let inverse = correlation.try_inverse().unwrap();
    let normalised: f64 = errors.iter().map(|e| scaled(e).dot(&(inverse * scaled(e)))).sum();
    println!("{what}: variances {:.2?} of those predicted, NEES/9 {:.3}", ratios.as_slice(), normalised / (9.0 * n));
    for ratio in ratios.iter() {
        let (low, high) = (chi_square(n, -Z) / n, chi_square(n, Z) / n);
        assert!((low..high).contains(ratio), "{what}: {ratio} is not within {low} to {high}");
    }
    let freedom = 9.0 * n;
    assert!((chi_square(freedom, -Z)..chi_square(freedom, Z)).contains(&normalised), "{what}: {normalised}");
}

/// Grades of the INS and the duration of the test for each, in minutes.
const LOOKED_AT: [(InsGrade, f64); 4] =
    [(InsGrade::Magnav, 60.0), (InsGrade::Navigation, 60.0), (InsGrade::Tactical, 14.0), (InsGrade::Commercial, 1.0)];

#[test]
fn law_200_realisations_of_each_grade_have_the_propagated_covariance() {
    const MEMBERS: u64 = 200;
    for (grade, minutes) in LOOKED_AT {
        let flight = Flight::new(60.0 * minutes, 1.0, 0.6);
        let (truth, model) = (flight.series(), grade.model());
        let mut normals: Vec<NormalGenerator> =
            (0..MEMBERS).map(|member| NormalGenerator::new(1000 + member)).collect();
        let starts = normals.iter_mut().map(|n| model.initial_error(-0.4, 0.0, &mut || n.draw())).collect();
        let mut ensemble = InsErrorEnsemble::new(starts);
        ensemble.advance(&truth, &model, true, &mut |member| normals[member].draw()).unwrap();
        assert_covariance(grade.word(), ensemble.errors(), &propagated(&truth, &model));
    }
}

#[test]
fn law_mechanised_realisations_have_the_propagated_covariance() {
    // On the error model's sphere, only nonlinear terms differ.
    for (grade, minutes) in [(InsGrade::Navigation, 20.0), (InsGrade::Tactical, 8.0)] {
        let flight = Flight::new(60.0 * minutes, 2.0, 0.6);
        let (truth, model) = (flight.series(), grade.model());
        let errors: Vec<_> = (0..200).map(|seed| last_error(&truth, &model, 20_000 + seed, true)).collect();
        assert_covariance(&format!("{} mechanised", grade.word()), &errors, &propagated(&truth, &model));
    }
}

/// Initial errors with a relative magnitude. A magnitude of 1 is a hundred times the initial errors of a good INS.
fn start_error(size: f64) -> StateVector {
    let mut e = [0.0; STATES];
    e[LAT] = 1e-5;
    e[LON] = -2e-5;
    e[ALT] = 30.0;
    e[VN] = 1.0;
    e[VN + 1] = -2.0;
    e[VN + 2] = 0.5;
    e[TILT_N] = 2e-3;
    e[TILT_N + 1] = -1e-3;
    e[TILT_D] = 4e-3;
    e[ACC] = 0.01;
    e[ACC + 1] = -0.02;
    e[ACC + 2] = 0.01;
    e[GYRO] = 1e-5;
    e[GYRO + 1] = 2e-5;
    e[GYRO + 2] = -2e-5;
    e[HA] = 10.0;
    e[A_HAT] = 0.005;
    e.map(|e| e * size)
}

/// Errors after five minutes from the error model and from the mechanisation, in common units: position errors in
/// metres, and other errors in units that cause a position error of one metre in five minutes.
fn both_after(flight: &Flight, size: f64) -> (SVector<f64, 9>, SVector<f64, 9>) {
    let quiet = InsErrorModel {
        sources: InsErrors {
            vrw_sigma: 0.0,
            arw_sigma: 0.0,
            baro_sigma_m: 0.0,
            acc_sigma_mps2: 0.0,
            gyro_sigma_radps: 0.0,
            ..InsErrors::default()
        },
        fogm_sigma_nt: 0.0,
        ..InsErrorModel::default()
    };
    let units = [6.4e6, 6.4e6, 1.0, 300.0, 300.0, 300.0, 4e5, 4e5, 4e5];
    let in_metres = |errors: Vec<StateVector>| SVector::from_fn(|k, _| errors[errors.len() - 1][k] * units[k]);
    let (truth, start) = (flight.series(), start_error(size));
    let linear = drawn(0, |draws| errors_along(&truth, &quiet, &start, draws).unwrap());
    let mechanised = drawn(0, |draws| mechanised_errors_along(&truth, &quiet, &SPHERE, &start, draws).unwrap());
    (in_metres(linear), in_metres(mechanised))
}

#[test]
fn law_mechanisation_and_error_model_differ_by_the_square_of_the_error() {
    let flight = Flight::new(300.0, 50.0, 0.6);
    let relative = |size: f64| {
        let (linear, mechanised) = both_after(&flight, size);
        (mechanised - linear).norm() / linear.norm()
    };
    let even = |size: f64| (both_after(&flight, size).1 + both_after(&flight, -size).1) / 2.0;
    let sizes = [1.0, 0.5, 0.25, 0.01].map(relative);
    let squares = even(1.0).norm() / even(0.5).norm();
    println!("apart by {sizes:?} of their size; what does not change sign: {squares:.3} times at twice the size");
    // The remaining error of a hundredth is due to the error model's step, which keeps the initial attitude for 0.02 s.
    assert!(sizes[3] < 2e-4, "{}", sizes[3]);
    for pair in sizes[..3].windows(2) {
        let quadratic = (pair[0] - sizes[3]) / (pair[1] - sizes[3]);
        assert!((quadratic - 2.0).abs() < 0.1, "the difference itself quarters: {quadratic}");
    }
    assert!((squares - 4.0).abs() < 0.02, "{squares}");
}

#[test]
fn law_on_the_ellipsoid_the_error_model_has_the_error_of_its_sphere() {
    let flight = Flight::new(600.0, 10.0, 0.6);
    let (truth, model) = (flight.series(), InsGrade::Navigation.model());
    let extras = MechanisationErrors::default();
    for seed in 0..5 {
        let run = |mechanised: bool| {
            drawn(seed, |draws| {
                let start = model.initial_error(-0.4, 0.0, draws.block);
                let errors = match mechanised {
                    true => mechanised_errors_along(&truth, &model, &extras, &start, draws).unwrap(),
                    false => errors_along(&truth, &model, &start, draws).unwrap(),
                };
                let last = errors[errors.len() - 1];
                [last[LAT] * 6.35e6, last[LON] * 6.38e6 * truth.point(0).lat_rad.cos()]
            })
        };
        let ([n, e], [n_mechanised, e_mechanised]) = (run(false), run(true));
        let apart = (n - n_mechanised).hypot(e - e_mechanised) / n.hypot(e);
        // The sphere's radius has an error of up to 0.6 %, and the gravity has an error of up to 0.2 %.
        assert!(apart < 0.01, "{seed}: {apart}");
    }
}

#[test]
fn law_each_source_alone_has_the_same_effect_on_mechanisation_and_error_model() {
    let flight = Flight::new(120.0, 20.0, 0.6);
    let truth = flight.series();
    let quiet = InsErrorModel {
        sources: InsErrors { vrw_sigma: 0.0, arw_sigma: 0.0, baro_sigma_m: 0.0, ..InsErrors::default() },
        ..InsErrorModel::default()
    };
    let quiet = InsErrorModel {
        sources: InsErrors { acc_sigma_mps2: 0.0, gyro_sigma_radps: 0.0, ..quiet.sources },
        fogm_sigma_nt: 0.0,
        ..quiet
    };
    let alone = [
        InsErrorModel { sources: InsErrors { vrw_sigma: 0.003, ..quiet.sources }, ..quiet },
        InsErrorModel { sources: InsErrors { arw_sigma: 1e-5, ..quiet.sources }, ..quiet },
        InsErrorModel { sources: InsErrors { baro_sigma_m: 30.0, ..quiet.sources }, ..quiet },
        InsErrorModel { sources: InsErrors { acc_sigma_mps2: 0.01, ..quiet.sources }, ..quiet },
        InsErrorModel { sources: InsErrors { gyro_sigma_radps: 1e-5, ..quiet.sources }, ..quiet },
    ];
    let extras = &SPHERE;
    for (source, model) in alone.into_iter().enumerate() {
        let zero = [0.0; STATES];
        let linear = drawn(source as u64, |draws| errors_along(&truth, &model, &zero, draws).unwrap());
        let other =
            drawn(source as u64, |draws| mechanised_errors_along(&truth, &model, extras, &zero, draws).unwrap());
        let size = |errors: &[StateVector], minus: &[StateVector], states: std::ops::Range<usize>| {
            let last = errors.len() - 1;
            states.map(|k| (errors[last][k] - minus[last][k]).powi(2)).sum::<f64>().sqrt()
        };
        let nothing = vec![zero; linear.len()];
        for states in [LAT..ALT, ALT..VN, VN..TILT_N, TILT_N..ACC] {
            let (apart, whole) = (size(&linear, &other, states.clone()), size(&linear, &nothing, states.clone()));
            // The noise of a step acts at its middle or at its ends, the attitude is constant for 0.05 s, and nonlinear
            // terms are as large as the tilts, at most 1e-4.
            assert!(apart < 0.02 * whole + 1e-11, "source {source}, {states:?}: {apart:e} of {whole:e}");
        }
    }
}

#[test]
fn law_an_ins_without_errors_is_exact() {
    let flight = Flight::new(30.0, 10.0, 0.6);
    let quiet = InsErrorModel {
        sources: InsErrors { vrw_sigma: 0.0, arw_sigma: 0.0, baro_sigma_m: 0.0, ..InsErrors::default() },
        ..InsErrorModel::default()
    };
    let quiet = InsErrorModel {
        sources: InsErrors { acc_sigma_mps2: 0.0, gyro_sigma_radps: 0.0, ..quiet.sources },
        fogm_sigma_nt: 0.0,
        ..quiet
    };
    let zero = [0.0; STATES];
    let truth = flight.series();
    let linear = drawn(0, |draws| errors_along(&truth, &quiet, &zero, draws).unwrap());
    assert!(linear.iter().all(|error| *error == zero));
    let extras = MechanisationErrors::default();
    let mechanised = drawn(0, |draws| mechanised_errors_along(&truth, &quiet, &extras, &zero, draws).unwrap());
    for error in mechanised {
        // 300 rounding errors of radians and metres per second, and of conversions between matrices and quaternions.
        let metres = horizontal_m(&error, -0.4, 0.0);
        let (speed, tilt) = (error[VN..TILT_N].iter().sum::<f64>(), error[TILT_N..ACC].iter().sum::<f64>());
        assert!(metres < 1e-6 && speed.abs() < 1e-9 && tilt.abs() < 1e-12, "{metres:e} {speed:e} {tilt:e}");
    }
}

#[test]
fn law_the_commercial_grade_diverges_with_finite_numbers() {
    let flight = Flight::new(840.0, 1.0, 0.6);
    let (truth, model) = (flight.series(), InsGrade::Commercial.model());
    let furthest = |mechanised: bool| {
        let error = last_error(&truth, &model, 3, mechanised);
        assert!(error.iter().all(|e| e.is_finite()), "{error:?}");
        horizontal_m(&error, -0.4, 0.0)
    };
    // 9.8 * 0.0087 t³/6 is 8400 km; an actual INS tumbles and therefore drifts less.
    assert!(furthest(false) > 5e5 && furthest(true) > 5e4, "{} {}", furthest(false), furthest(true));
}

#[test]
fn unit_the_member_of_a_rank_is_found() {
    let flight = Flight::new(60.0, 1.0, 0.0);
    let model = InsGrade::Tactical.model();
    let mut normals: Vec<NormalGenerator> = (0..50).map(NormalGenerator::new).collect();
    let starts = normals.iter_mut().map(|n| model.initial_error(-0.4, 0.0, &mut || n.draw())).collect();
    let mut ensemble = InsErrorEnsemble::new(starts);
    ensemble.advance(&flight.series(), &model, true, &mut |member| normals[member].draw()).unwrap();
    let drms = ensemble.drms_m();
    let chosen = ensemble.ranked(10).unwrap();
    assert_eq!(drms.iter().filter(|other| **other > drms[chosen]).count(), 9);
    assert_eq!((ensemble.ranked(0), ensemble.ranked(51)), (None, None));
    let again = drawn_drms(&flight, &model, chosen as u64);
    assert!((again / drms[chosen] - 1.0).abs() < 1e-12, "{again} {}", drms[chosen]);
}

fn drawn_drms(flight: &Flight, model: &InsErrorModel, seed: u64) -> f64 {
    let truth = flight.series();
    let mut normals = NormalGenerator::new(seed);
    let start = model.initial_error(-0.4, 0.0, &mut || normals.draw());
    let mut never = || f64::NAN;
    let mut draws = NormalStreams { block: &mut || normals.draw(), within: &mut never };
    let errors = errors_along(&truth, model, &start, &mut draws).unwrap();
    let place = |row: usize| EarthModel::Wgs84.lat_rad_to_north_m(1.0, truth.point(row).lat_rad, 0.0);
    let east = |row: usize| EarthModel::Wgs84.lon_rad_to_east_m(1.0, truth.point(row).lat_rad, 0.0);
    let square = |(row, e): (usize, &StateVector)| (e[LAT] * place(row)).powi(2) + (e[LON] * east(row)).powi(2);
    (errors.iter().enumerate().map(square).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn val_drift_of_each_grade_against_an_independent_implementation() {
    // 20 runs of another implementation gave for navigation grade, 60 min, a DRMS of 443 m (168 to 764 m), and for
    // tactical grade, 14 min, 3031 m. The test uses 400 realisations.
    let others = [
        (InsGrade::Magnav, 60.0, None),
        (InsGrade::Navigation, 60.0, Some(443.0)),
        (InsGrade::Tactical, 14.0, Some(3031.0)),
    ];
    println!("grade        min    mean DRMS     5 % to 95 %   10th largest of 100   theirs");
    for (grade, minutes, theirs) in others {
        let flight = Flight::new(60.0 * minutes, 1.0, 0.6);
        let (truth, model) = (flight.series(), grade.model());
        let mut normals: Vec<NormalGenerator> = (0..400).map(|member| NormalGenerator::new(7000 + member)).collect();
        let starts = normals.iter_mut().map(|n| model.initial_error(-0.4, 0.0, &mut || n.draw())).collect();
        let mut ensemble = InsErrorEnsemble::new(starts);
        ensemble.advance(&truth, &model, true, &mut |member| normals[member].draw()).unwrap();
        let mut drms = ensemble.drms_m();
        let mut of_100 = drms[..100].to_vec();
        of_100.sort_by(f64::total_cmp);
        drms.sort_by(f64::total_cmp);
        let mean = drms.iter().sum::<f64>() / 400.0;
        let (name, low, high) = (grade.word(), drms[20], drms[380]);
        println!("{name:12} {minutes:3} {mean:10.0} m {low:8.0} to {high:5.0} m {:16.0} m {theirs:?}", of_100[90]);
        if let Some(theirs) = theirs {
            let deviation = (drms.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 399.0).sqrt();
            // The means of the 20 runs and of the 400 realisations agree within three standard errors.
            let error = deviation * (1.0 / 20.0 + 1.0 / 400.0_f64).sqrt();
            assert!((mean - theirs).abs() < 3.0 * error, "{name}: {mean} {theirs} {error}");
        }
    }
}

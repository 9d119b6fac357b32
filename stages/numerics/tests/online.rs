//! Monte Carlo of the online filters on simulated flights over the real Osborne map: consistency of the position and of
//! the aircraft field, and tracking of an aircraft that changes.
#![allow(clippy::unwrap_used)]

use std::f64::consts::TAU;
use std::sync::{Arc, OnceLock};

use nalgebra::{DMatrix, DVector, Vector3};
use numerics::navigation::online::{
    CoefficientPrior, LineModel, OnlineMagnetometer, OnlineOutput, OnlineParameters, run as online_run,
};
use numerics::navigation::online_nn::{
    NetworkCalibration, NetworkPrior, OnlineActivation, OnlineNetwork, TrainingParameters, run as nn_run, train,
};
use numerics::{
    compensation::tolles_lawson::{BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection, matrix},
    earth::{attitude::body_to_ned, core_field::CoreField, geodesy::EarthModel},
    maps::{FieldMap, MapInterpolation, MapSurface},
    navigation::{
        EkfParameters, InsErrorModel, NavigationLine, NavigationOutput,
        aids::Aids,
        ekf,
        ins_error::simulate_ins_error,
        pinson::{LAT, LON},
    },
    random::NormalGenerator,
};
mod osborne;
use osborne::{Line, core_field, grid, temporal_nt};

const SAMPLES: u32 = 2400;
const DT_S: f64 = 1.0;
/// White noise, in nT.
const SIGMA_NT: f64 = 2.0;
/// Samples at which consistency is tested: far enough apart to be nearly independent.
const EPOCHS: [usize; 7] = [120, 500, 880, 1260, 1640, 2020, 2399];
const RUNS: u64 = 60;

fn map() -> &'static FieldMap {
    static MAP: OnceLock<FieldMap> = OnceLock::new();
    MAP.get_or_init(|| FieldMap::Flat(MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic)))
}

fn core() -> &'static Arc<CoreField> {
    static CORE: OnceLock<Arc<CoreField>> = OnceLock::new();
    CORE.get_or_init(|| Arc::new(core_field().unwrap()))
}

/// A manoeuvring flight: its truth, its INS, and the inputs of its magnetometer.
struct Flight {
    ins: Line,
    errors: Vec<[f64; 18]>,
    terms: Vec<f64>,
    width: usize,
    /// The field without the aircraft's, with temporal variation and noise.
    clean_nt: Vec<f64>,
}

impl Flight {
    /// Rolls by 15 degrees, pitches by 8 degrees and yaws by 5 degrees, each with a different period, for the first
    /// `manoeuvring_s` of every ten minutes.
    fn flown(seed: u64, groups: &[&str], manoeuvring_s: f64) -> Self {
        let mut truth = Line::flown(SAMPLES, DT_S, 0.1 * seed as f64).unwrap();
        let mut normals = NormalGenerator::new(seed);
        for row in 0..SAMPLES as usize {
            let t = truth.columns[0][row];
            let on = if t % 600.0 < manoeuvring_s { 1.0 } else { 0.0 };
            for (column, degrees, period_s) in [(10, 15.0, 17.0), (11, 8.0, 23.0), (12, 5.0, 31.0)] {
                truth.columns[column][row] += on * degrees * (TAU * t / period_s).sin();
            }
        }
        let errors = simulate_ins_error(&truth.series(), &InsErrorModel::default(), || normals.draw()).unwrap();
        let (mut vector, mut clean_nt) = ([vec![], vec![], vec![]], vec![]);
        for (row, error) in errors.iter().enumerate() {
            let [lat, lon, alt, roll, pitch, yaw] = [1, 2, 3, 10, 11, 12].map(|c: usize| truth.columns[c][row]);
            let field = Vector3::from(core().field_ned_nt(lat, lon, alt));
            let turn = body_to_ned(roll.to_radians(), pitch.to_radians(), yaw.to_radians());
            let body = turn.transpose() * field;
            (0..3).for_each(|axis| vector[axis].push(body[axis]));
            let anomaly_nt = map().at(lat, lon, alt).unwrap().value_nt;
            clean_nt.push(anomaly_nt + field.norm() + temporal_nt(error) + SIGMA_NT * normals.draw());
        }
        let terms = TermSelection::new(groups).unwrap();
        let [x, y, z] = &vector;
        let a = matrix(&BodyFieldColumns { x, y, z, bt: None }, &terms, DEFAULT_SCALE_NT).unwrap();
        Self { ins: truth.with_errors(&errors), errors, terms: a, width: terms.len(), clean_nt }
    }

    /// Readings of the magnetometer with coefficients that depend on the row.
    fn measured(&self, coefficients: impl Fn(usize) -> Vec<f64>) -> Vec<f64> {
        let aircraft = |row: usize| -> f64 {
            let terms = &self.terms[row * self.width..][..self.width];
            terms.iter().zip(coefficients(row)).map(|(a, b)| a * b).sum()
        };
        (0..self.clean_nt.len()).map(|row| self.clean_nt[row] + aircraft(row)).collect()
    }

    fn online(&self, measurement_nt: &[f64], prior: &CoefficientPrior, walk_density: &[f64]) -> OnlineOutput {
        let sigma_nt = vec![SIGMA_NT; measurement_nt.len()];
        let ins = self.ins.series();
        let line = LineModel {
            ins: &ins,
            map: map(),
            core: Some(core()),
            errors: InsErrorModel::default(),
            offset_window_s: 0.0,
            fixes: None,
            aids: Aids::default(),
            second_order: false,
        };
        let magnetometer =
            OnlineMagnetometer { measurement_nt, sigma_nt: &sigma_nt, terms: &self.terms, prior, walk_density };
        let parameters = OnlineParameters {
            keep_states: true,
            keep_covariance: true,
            keep_coefficients: true,
            ..OnlineParameters::default()
        };
        online_run(&line, &[magnetometer], None, &parameters).unwrap()
    }

    fn plain(&self, compensated_nt: &[f64], sigma_nt: f64) -> NavigationOutput {
        let parameters = EkfParameters { measurement_sigma_nt: sigma_nt, ..EkfParameters::default() };
        ekf::run(&parameters, &self.ins.series(), compensated_nt, map(), Some(core())).unwrap()
    }

    /// Root mean square of the horizontal error over rows, in metres.
    fn drms_m(&self, output: &NavigationOutput, rows: std::ops::Range<usize>) -> f64 {
        let earth = EarthModel::Wgs84;
        let square = |row: usize| {
            let lat = output.lat_deg[row].to_radians();
            let north = earth.lat_rad_to_north_m(self.errors[row][LAT] - output.x[row][LAT], lat, 500.0);
            let east = earth.lon_rad_to_east_m(self.errors[row][LON] - output.x[row][LON], lat, 500.0);
            north * north + east * east
        };
        (rows.clone().map(square).sum::<f64>() / rows.len() as f64).sqrt()
    }

    /// NEES of the horizontal position: chi-square with 2 degrees of freedom.
    fn position_nees(&self, output: &NavigationOutput, row: usize) -> f64 {
        let e = [LAT, LON].map(|state| self.errors[row][state] - output.x[row][state]);
        let p = &output.p[row];
        let (a, b, c) = (p[LAT][LAT], p[LAT][LON], p[LON][LON]);
        (c * e[0] * e[0] - 2.0 * b * e[0] * e[1] + a * e[1] * e[1]) / (a * c - b * b)
    }
}

/// Squared error, normalised by the covariance.
fn nees(error: &[f64], covariance: &[f64]) -> f64 {
    let n = error.len();
    let p = DMatrix::from_row_slice(n, n, covariance);
    let e = DVector::from_column_slice(error);
    e.dot(&p.cholesky().unwrap().solve(&e))
}

/// Quantile of chi-square with `freedom` degrees at `z` standard normals, by the formula of Wilson and Hilferty.
fn chi_square(freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + z * spread.sqrt()).powi(3)
}

/// Whether a mean of `count` chi-squares of `freedom` degrees is within a band of `z` standard normals.
fn within(mean: f64, freedom: f64, count: f64, z: f64) -> bool {
    let all = freedom * count;
    (chi_square(all, -z)..=chi_square(all, z)).contains(&(mean * count))
}

#[test]
fn law_the_online_filter_is_consistent() {
    // Coefficients of an aircraft as calibrated to some tens of nT, walking by 3 nT in an hour.
    let prior_sigma: Vec<f64> = [[40.0; 3].as_slice(), &[40.0; 6], &[60.0; 9]].concat();
    let walk = vec![9.0 / 3600.0; 18];
    let (mut by_epoch, mut of_coefficients, mut half_way, mut nis) = ([0.0; EPOCHS.len()], 0.0, 0.0, 0.0);
    let (mut drms, mut ins_drms) = (0.0, 0.0);
    let n = RUNS as f64;
    for seed in 0..RUNS {
        let flight = Flight::flown(seed, &["permanent", "induced", "eddy"], 120.0);
        let mut normals = NormalGenerator::new(90_000 + seed);
        let mean: Vec<f64> = (0..18).map(|_| 100.0 * normals.draw()).collect();
        let mut coefficients =
            vec![mean.iter().zip(&prior_sigma).map(|(m, s)| m + s * normals.draw()).collect::<Vec<f64>>()];
        for row in 1..SAMPLES as usize {
            let step = |(c, q): (&f64, &f64)| c + (q * DT_S).sqrt() * normals.draw();
            coefficients.push(coefficients[row - 1].iter().zip(&walk).map(step).collect());
        }
        let measured_nt = flight.measured(|row| coefficients[row].clone());
        let prior = CoefficientPrior::independent(&mean, &prior_sigma);
        let output = flight.online(&measured_nt, &prior, &walk);
        for (nees, row) in by_epoch.iter_mut().zip(EPOCHS) {
            *nees += flight.position_nees(&output.navigation, row) / n;
        }
        let estimate = &output.magnetometers[0];
        let last = SAMPLES as usize - 1;
        let error: Vec<f64> = estimate.coefficients.iter().zip(&coefficients[last]).map(|(x, c)| c - x).collect();
        of_coefficients += nees(&error, &estimate.covariance) / n;
        // Each coefficient alone half-way: chi-square of 1 degree.
        let row = 1200;
        let of = |k: usize| {
            let (x, sd) = (estimate.coefficients_by_row[18 * row + k], estimate.sigma_by_row[18 * row + k]);
            ((coefficients[row][k] - x) / sd).powi(2)
        };
        half_way += (0..18).map(of).sum::<f64>() / n / 18.0;
        nis += output.navigation.nis.iter().sum::<f64>() / f64::from(SAMPLES) / n;
        drms += flight.drms_m(&output.navigation, 0..last).powi(2) / n;
        let mut ins = output.navigation.clone();
        ins.x.iter_mut().for_each(|x| *x = [0.0; 18]);
        ins_drms += flight.drms_m(&ins, 0..last).powi(2) / n;
    }
    let (low, high) = (chi_square(2.0 * n, -1.96) / n, chi_square(2.0 * n, 1.96) / n);
    println!("position NEES by epoch, band {low:.2}..{high:.2}: {by_epoch:.2?}; NIS {nis:.4}");
    let band = [-1.96, 1.96].map(|z| chi_square(18.0 * n, z) / n);
    println!("NEES of the 18 coefficients {of_coefficients:.2}, band {band:.2?}; each half-way {half_way:.3}");
    println!("DRMS {:.1} m, INS {:.0} m", drms.sqrt(), ins_drms.sqrt());
    let outside = by_epoch.iter().filter(|nees| !within(**nees, 2.0, n, 1.96)).count();
    // By chance, one epoch in twenty is outside the band, and 2 or more of 7 epochs in 4 % of all cases.
    assert!(outside <= 1, "{outside} of {} epochs outside", EPOCHS.len());
    assert!(within(by_epoch.iter().sum::<f64>() / EPOCHS.len() as f64, 2.0, n * EPOCHS.len() as f64, 3.29));
    assert!(within(of_coefficients, 18.0, n, 1.96), "{of_coefficients}");
    // The 18 coefficients are correlated, which widens the band of their mean. 15 % is four standard deviations for
    // 1080 independent values.
    assert!((half_way - 1.0).abs() < 0.15, "{half_way}");
    // With 144,000 samples the standard deviation is 0.4 %; the linearisation adds a further error.
    assert!((nis - 1.0).abs() < 0.02, "{nis}");
    assert!(drms.sqrt() < 0.2 * ins_drms.sqrt());
}

#[test]
fn law_the_filter_follows_an_aircraft_that_changes() {
    // The permanent field changes by 100 nT at half-time: at once, or within 400 s.
    for (name, lasting_s, per_s, most) in [("jump", 1.0, 6.0, 0.5), ("drift", 400.0, 1.0, 0.5)] {
        let (half, all) = (SAMPLES as usize / 2, SAMPLES as usize);
        let prior = CoefficientPrior::independent(&[0.0; 18], &[5.0; 18]);
        let (mut plain, mut patient, mut without) = (0.0, 0.0, 0.0);
        let (mut online, mut late, mut plain_late) = ([0.0; 4], [0.0; 4], 0.0);
        let runs = 12_u64;
        for seed in 0..runs {
            let flight = Flight::flown(200 + seed, &["permanent", "induced", "eddy"], 120.0);
            let mut normals = NormalGenerator::new(seed);
            let jump = Vector3::from_fn(|_, _| normals.draw()).normalize() * 100.0;
            let measured_nt = flight.measured(|row| {
                let part = ((row as f64 - half as f64) / lasting_s).clamp(0.0, 1.0);
                [(jump * part).as_slice(), &[0.0; 15]].concat()
            });
            let second = |output: &NavigationOutput| flight.drms_m(output, half..all).powi(2) / runs as f64;
            for ((sum, late), factor) in online.iter_mut().zip(&mut late).zip([0.1, 0.3, 1.0, 3.0]) {
                let walk: Vec<f64> = [[factor * per_s; 3].as_slice(), &[0.0; 15]].concat();
                let output = flight.online(&measured_nt, &prior, &walk).navigation;
                *sum += second(&output);
                *late += flight.drms_m(&output, all - 600..all).powi(2) / runs as f64;
            }
            // The fixed compensation, which is right for the first half, with the noise of the sensor and with a noise
            // of 50 nT.
            let fixed = flight.plain(&measured_nt, SIGMA_NT);
            plain += second(&fixed);
            plain_late += flight.drms_m(&fixed, all - 600..all).powi(2) / runs as f64;
            patient += second(&flight.plain(&measured_nt, 50.0));
            without += second(&flight.plain(&flight.clean_nt, SIGMA_NT));
        }
        let (late, plain_late) = (late.map(f64::sqrt), plain_late.sqrt());
        println!("{name}: last ten minutes: online {late:.1?} m, fixed {plain_late:.0} m");
        let online = online.map(f64::sqrt);
        let [plain, patient, without] = [plain, patient, without].map(f64::sqrt);
        println!(
            "{name}: DRMS of the second half: online {online:.1?} m, fixed {plain:.0} m (with 50 nT of noise \
             {patient:.0} m), no change {without:.1} m"
        );
        assert!(late[2] < 0.5 * plain_late, "{late:?} {plain_late}");
        assert!(online[2] < most * plain.min(patient), "{online:?} {plain} {patient}");
    }
}

#[test]
fn law_a_cold_start_in_the_cabin_is_calibrated_in_flight() {
    // The field of an aircraft of hundreds of nT is unknown. The measurement contains only the sum of this field and
    // the field at the position.
    let sigma: Vec<f64> = [[1000.0; 3].as_slice(), &[1000.0; 6], &[100.0; 9], &[500.0]].concat();
    let prior = CoefficientPrior::independent(&[0.0; 19], &sigma);
    let (runs, all) = (12_u64, SAMPLES as usize);
    let (mut online, mut ins, mut left, mut worst) = (0.0, 0.0, 0.0, 0.0_f64);
    for seed in 0..runs {
        let flight = Flight::flown(300 + seed, &["permanent", "induced", "eddy", "bias"], 120.0);
        let mut normals = NormalGenerator::new(seed);
        let truth: Vec<f64> = sigma.iter().map(|sigma| 0.5 * sigma * normals.draw()).collect();
        let measured_nt = flight.measured(|_| truth.clone());
        let output = flight.online(&measured_nt, &prior, &[0.0; 19]);
        let own = flight.drms_m(&output.navigation, all / 4..all);
        worst = worst.max(own);
        online += own.powi(2) / runs as f64;
        let mut none = output.navigation.clone();
        none.x.iter_mut().for_each(|x| *x = [0.0; 18]);
        ins += flight.drms_m(&none, all / 4..all).powi(2) / runs as f64;
        // Residual of compensation with the final coefficients, except for a constant.
        let (a, found) = (&flight.terms, &output.magnetometers[0].coefficients);
        let miss = |row: usize| (0..19).map(|k| a[19 * row + k] * (found[k] - truth[k])).sum::<f64>();
        let mean = (0..all).map(miss).sum::<f64>() / all as f64;
        left += (0..all).map(|row| (miss(row) - mean).powi(2)).sum::<f64>() / (all as f64 * runs as f64);
    }
    let [online, ins, left] = [online, ins, left].map(f64::sqrt);
    println!(
        "cold start: DRMS {online:.1} m, worst {worst:.1} m, INS {ins:.0} m; the compensation leaves {left:.2} nT"
    );
    assert!(online < 0.25 * ins, "{online} {ins}");
    assert!(left < 3.0, "{left}");
}

/// Aircraft current with values between 0 and 1: the sum of two sinusoids with periods of 71 and 43 samples.
fn current(seed: u64, row: usize) -> f64 {
    let (t, phase) = (row as f64, seed as f64);
    0.5 + 0.3 * (TAU * t / 71.0 + phase).sin() + 0.2 * (TAU * t / 43.0 + 2.0 * phase).sin()
}

#[test]
fn law_an_online_network_follows_an_aircraft_that_changes() {
    // The field of a current saturates, in addition to a permanent field. At half-time the current's field grows by
    // half.
    let (half, all) = (SAMPLES as usize / 2, SAMPLES as usize);
    let field = |terms: &[f64], current: f64, gain: f64| {
        60.0 * terms[0] - 40.0 * terms[1] + gain * 90.0 * (3.0 * (current - 0.5)).tanh() * terms[2]
    };
    let (mut online, mut fixed, mut patient, mut without) = (0.0, 0.0, 0.0, 0.0);
    let runs = 8_u64;
    for seed in 0..runs {
        let flight = Flight::flown(500 + seed, &["permanent"], 120.0);
        let box_flown = Flight::flown(700 + seed, &["permanent"], 600.0);
        let mut normals = NormalGenerator::new(seed);
        let features_of = |flight: &Flight, seed: u64| -> Vec<f64> {
            let rows = flight.terms.chunks_exact(3).enumerate();
            rows.flat_map(|(row, terms)| [terms[0], terms[1], terms[2], current(seed, row)]).collect()
        };
        let calibrating = 1200;
        let before = features_of(&box_flown, 100 + seed);
        let tt_s: Vec<f64> = (0..calibrating).map(|row| row as f64).collect();
        let known: Vec<f64> = before
            .chunks_exact(4)
            .take(calibrating)
            .map(|row| field(row, row[3], 1.0) + SIGMA_NT * normals.draw())
            .collect();
        let calibration = &before[..4 * calibrating];
        let network = OnlineNetwork::new(calibration, 4, 6, OnlineActivation::Swish, 60.0).unwrap();
        let parameters = TrainingParameters { seed, sigma_nt: SIGMA_NT, passes: 5, memory_s: 600.0 };
        let calibration = NetworkCalibration { tt_s: &tt_s, features: calibration, aircraft_nt: &known };
        let prior = train(&network, &calibration, None, &parameters).unwrap();
        let features = features_of(&flight, seed);
        let gain = |row: usize| if row < half { 1.0 } else { 1.5 };
        let own = |row: usize| field(&features[4 * row..], features[4 * row + 3], gain(row));
        let measurement_nt: Vec<f64> = (0..all).map(|row| flight.clean_nt[row] + own(row)).collect();
        let ins = flight.ins.series();
        let filtered = |prior: &NetworkPrior, sigma_nt: f64| {
            let sigma_nt = vec![sigma_nt; all];
            let line = NavigationLine {
                ins: &ins,
                measurement_nt: &measurement_nt,
                sigma_nt: &sigma_nt,
                map: map(),
                core: Some(core()),
                errors: InsErrorModel::default(),
                offset_window_s: 0.0,
                fixes: None,
                second_order: false,
            };
            let parameters = OnlineParameters { keep_states: true, ..OnlineParameters::default() };
            let output = nn_run(&line, &network, &features, prior, &Aids::default(), &parameters).unwrap();
            flight.drms_m(&output.navigation, half..all).powi(2) / runs as f64
        };
        online += filtered(&prior, SIGMA_NT.hypot(prior.misfit_nt));
        let still = NetworkPrior {
            covariance: vec![0.0; prior.covariance.len()],
            walk_density: vec![0.0; prior.weights.len()],
            ..prior.clone()
        };
        fixed += filtered(&still, SIGMA_NT.hypot(prior.misfit_nt));
        patient += filtered(&still, 30.0);
        without += flight.drms_m(&flight.plain(&flight.clean_nt, SIGMA_NT), half..all).powi(2) / runs as f64;
    }
    let [online, fixed, patient, without] = [online, fixed, patient, without].map(f64::sqrt);
    println!(
        "network, DRMS of the second half: online {online:.1} m, fixed {fixed:.0} m (with 30 nT of noise \
         {patient:.0} m), no aircraft {without:.1} m"
    );
    assert!(online < 0.5 * fixed.min(patient), "{online} {fixed} {patient}");
}

/// The time that this thread had a processor, in seconds.
fn cpu_s() -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    told.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e9
}

#[test]
#[ignore = "a measurement of time"]
fn unit_time_of_a_step() {
    use numerics::navigation::online::Fluxgate;
    let flight = Flight::flown(1, &["permanent", "induced", "eddy"], 120.0);
    let core_free = LineModel {
        ins: &flight.ins.series(),
        map: map(),
        core: None,
        errors: InsErrorModel::default(),
        offset_window_s: 0.0,
        fixes: None,
        aids: Aids::default(),
        second_order: false,
    };
    let prior = CoefficientPrior::independent(&[0.0; 18], &[40.0; 18]);
    let sigma_nt = vec![5.0; SAMPLES as usize];
    let measured: Vec<f64> = flight
        .clean_nt
        .iter()
        .enumerate()
        .map(|(row, nt)| {
            let [lat, lon, alt] = [1, 2, 3].map(|c: usize| flight.ins.columns[c][row]);
            nt - core().magnitude_nt(lat, lon, alt)
        })
        .collect();
    let magnetometer = OnlineMagnetometer {
        measurement_nt: &measured,
        sigma_nt: &sigma_nt,
        terms: &flight.terms,
        prior: &prior,
        walk_density: &[0.1; 18],
    };
    let [x, y, z] = [0, 1, 2].map(|k| {
        let norm = |row: usize| {
            flight.terms[18 * row + 3] / flight.terms[18 * row] * DEFAULT_SCALE_NT / flight.terms[18 * row]
        };
        (0..SAMPLES as usize).map(|row| flight.terms[18 * row + k] * norm(row)).collect::<Vec<f64>>()
    });
    let terms = TermSelection::new(&["permanent", "induced", "eddy"]).unwrap();
    let fluxgate = Fluxgate {
        field: BodyFieldColumns { x: &x, y: &y, z: &z, bt: None },
        terms: &terms,
        scale_nt: DEFAULT_SCALE_NT,
        runs: &[],
        sigma_nt: 50.0,
        tau_s: f64::INFINITY,
    };
    let time = |magnetometers: &[OnlineMagnetometer<'_>], fluxgate: Option<&Fluxgate<'_>>| {
        let mut best = f64::MAX;
        for _ in 0..8 {
            let begin = cpu_s();
            let output = online_run(&core_free, magnetometers, fluxgate, &OnlineParameters::default()).unwrap();
            assert_eq!(output.navigation.report.off_map, 0);
            best = best.min((cpu_s() - begin) * 1e6 / f64::from(SAMPLES));
        }
        best
    };
    println!("18 + 18: {:.2} us a step", time(&[magnetometer], None));
    println!("18 + 18 + 3: {:.2} us a step", time(&[magnetometer], Some(&fluxgate)));
    println!("18 + 4 x 18: {:.2} us a step", time(&[magnetometer; 4], None));
    let parameters = EkfParameters::default();
    let begin = cpu_s();
    ekf::run(&parameters, &flight.ins.series(), &measured, map(), None).unwrap();
    println!("18 (ekf): {:.2} us a step", (cpu_s() - begin) * 1e6 / f64::from(SAMPLES));
}

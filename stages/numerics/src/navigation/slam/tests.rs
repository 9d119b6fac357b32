mod aided;
pub(super) mod flights;
mod long;
mod parts;

use flights::{Flight, ROUGH_DEG, loiter, straight};

use super::*;

fn filtered(flight: &Flight, parameters: &SlamParameters) -> SlamOutput {
    run_on(flight, parameters).unwrap()
}

fn run_on(flight: &Flight, parameters: &SlamParameters) -> Result<SlamOutput, NavigationError> {
    let ins = flight.ins.series();
    let (measurement_nt, sigma_nt) = (flight.measured_nt.as_slice(), flight.sigma_nt.as_slice());
    run(parameters, &SlamLine { ins: &ins, measurement_nt, sigma_nt, core: None, fixes: None, errors: flight.model })
}

/// Few particles and a given kernel, for fast tests.
fn quick() -> SlamParameters {
    let kernel = AnomalyKernel { sigma_se_nt: 100.0, length_m: 700.0, ..AnomalyKernel::default() };
    SlamParameters { particles: 100, kernel, hyperparameters: HyperparameterSource::Fixed, ..SlamParameters::default() }
}

#[test]
fn law_a_loiter_is_accurate_to_tens_of_metres() {
    for seed in [0, 1] {
        let flight = Flight::tactical(loiter(ROUGH_DEG, 840, 1.0), seed);
        let output = filtered(&flight, &SlamParameters { particles: 500, ..SlamParameters::default() });
        let (ins, slam) = (flight.drms_m(None), flight.drms_m(Some(&output)));
        println!("seed {seed}: INS {ins:.0} m, SLAM {slam:.1} m");
        assert!(ins > 200.0 && slam < 100.0 && slam < 0.25 * ins, "{ins} {slam}");
        assert!(output.report.fitted && output.report.revisits > 300);
    }
}

#[test]
fn law_few_particles_are_not_overconfident() {
    let (mut sum, mut largest) = (0.0, 0.0_f64);
    for seed in 0..5 {
        let flight = Flight::tactical(loiter(ROUGH_DEG, 840, 1.0), seed);
        let output = filtered(&flight, &SlamParameters { particles: 100, ..SlamParameters::default() });
        let nees = flight.nees(&output);
        println!("seed {seed}: {:.1} m, NEES per degree of freedom {nees:.2?}", flight.drms_m(Some(&output)));
        sum += nees.0 / 5.0;
        largest = largest.max(nees.1);
    }
    // The expected value is 1. The errors within a flight are correlated, so the mean of a flight varies like that of a
    // few independent draws.
    assert!((0.2..5.0).contains(&sum) && largest < 50.0, "{sum} {largest}");
}

#[test]
fn law_each_method_of_expectation_limits_the_drift() {
    for expected in [ExpectedMeasurement::Regression, ExpectedMeasurement::InverseDistance] {
        let flight = Flight::tactical(loiter(ROUGH_DEG, 840, 1.0), 0);
        let output = filtered(&flight, &SlamParameters { particles: 500, expected, ..SlamParameters::default() });
        let (ins, slam) = (flight.drms_m(None), flight.drms_m(Some(&output)));
        println!("{expected:?}: INS {ins:.0} m, SLAM {slam:.1} m");
        // These methods count errors that neighbouring measurements share more than once, so they are only required to
        // reduce the error.
        assert!(slam < 0.6 * ins, "{ins} {slam}");
    }
}

#[test]
fn law_the_track_without_a_revisit_equals_that_of_the_ins() {
    let flight = Flight::tactical(straight(500, 1.0), 3);
    let parameters = SlamParameters { particles: 1000, keep_covariance: true, ..SlamParameters::default() };
    let output = filtered(&flight, &parameters);
    assert_eq!((output.report.revisits, output.report.resamplings), (0, 0));
    assert!(output.revisiting.iter().all(|count| *count == 0) && output.navigation.nis.iter().all(|nis| nis.is_nan()));
    let ins = flight.ins.series();
    let mut p = flight.model.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
    for row in 1..ins.len() {
        let f = pinson_matrix(&ins.point(row - 1), &flight.model.time_constants(), flight.model.pinson);
        let phi = transition_matrix(&f, 1.0);
        p = step_covariance(&p, &f, &phi, &flight.model.noise_density(), 1.0, flight.model.noise);
        if row % 100 == 99 {
            // A variance from 1000 particles has a standard deviation of 4.5 %, and a mean has a standard deviation of
            // 3.2 %; the limits are four standard deviations.
            for state in [LAT, LON] {
                let ratio = output.navigation.p[row][state][state] / p[state][state];
                assert!((ratio - 1.0).abs() < 0.18, "{row} {ratio}");
            }
            let moved_m = (output.navigation.lat_deg[row] - ins.lat_deg[row]) * flights::M_PER_DEG.0;
            assert!(moved_m.abs() < 0.13 * output.navigation.sd_n_m[row], "{row} {moved_m}");
        }
    }
    let report = output.navigation.report;
    assert_eq!((report.updates, report.off_map, report.missing_measurements), (0, 500, 0));
}

/// All numbers of an output, as bits.
fn bits(output: &SlamOutput) -> Vec<u64> {
    let out = &output.navigation;
    let columns = [&out.lat_deg, &out.lon_deg, &out.vn_mps, &out.sd_n_m, &out.cov_ne_m2, &out.nis, &output.effective];
    let of_path = output.path.iter().map(|sample| sample.at_m[0]);
    columns.into_iter().flatten().copied().chain(of_path).map(f64::to_bits).collect()
}

#[test]
fn unit_results_are_bit_identical_for_threads_and_runs_and_differ_by_seed() {
    let flight = Flight::tactical(loiter(ROUGH_DEG, 300, 1.0), 1);
    let of = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bits(&filtered(&flight, &SlamParameters { seed, particles: 150, ..quick() })))
    };
    let one = of(1, 0);
    assert_eq!(one, of(4, 0));
    assert_ne!(one, of(1, 1));
}

#[test]
fn law_the_core_field_and_a_constant_change_nothing() {
    let flight = Flight::tactical(loiter(ROUGH_DEG, 400, 1.0), 2);
    let plain = filtered(&flight, &quick());
    let core = std::sync::Arc::new(crate::navigation::osborne::core_field().unwrap());
    let (ins, truth) = (flight.ins.series(), &flight.truth.columns);
    let total = |row: usize| core.magnitude_nt(truth[1][row], truth[2][row], truth[3][row]);
    let measured: Vec<f64> = flight.measured_nt.iter().enumerate().map(|(row, z)| z + total(row) + 500.0).collect();
    let line = SlamLine {
        ins: &ins,
        measurement_nt: &measured,
        sigma_nt: &flight.sigma_nt,
        core: Some(&core),
        fixes: None,
        errors: flight.model,
    };
    let with = run(&quick(), &line).unwrap();
    // At the particles, the core field is subtracted to first order, with an error of 0.01 nT. Until the first
    // resampling, weights and tracks agree except for this error; after a resampling, a rounding error can select
    // another particle.
    let resampled = |row: &usize| plain.effective[*row] < 50.0;
    let until = (0..flight.errors.len()).find(resampled).unwrap();
    assert!(plain.navigation.nis[..until].iter().any(|nis| nis.is_finite()));
    for row in 0..until {
        let apart_m = (with.navigation.lat_deg[row] - plain.navigation.lat_deg[row]).abs() * flights::M_PER_DEG.0;
        assert!(apart_m <= 0.05 * plain.navigation.sd_n_m[row] + 1e-6, "{row} {apart_m}");
    }
    let first = plain.navigation.nis.iter().position(|nis| nis.is_finite()).unwrap();
    let difference = with.navigation.residual_nt[first] - plain.navigation.residual_nt[first];
    assert!(difference.abs() < 0.05, "{difference}");
}

#[test]
fn unit_gaps_uneven_time_and_invalid_sigmas_are_missing_measurements() {
    let mut flight = Flight::tactical(loiter(ROUGH_DEG, 400, 1.0), 4);
    let rows = [10_usize, 11, 12, 200, 201, 202, 203, 204, 300, 350];
    for (place, row) in rows.into_iter().enumerate() {
        match place % 4 {
            0 => flight.measured_nt[row] = f64::NAN,
            1 => flight.sigma_nt[row] = 0.0,
            2 => flight.sigma_nt[row] = f64::INFINITY,
            _ => flight.measured_nt[row] = f64::INFINITY,
        }
    }
    flight.sigma_nt[20] = -1.0;
    let output = filtered(&flight, &quick());
    let report = output.navigation.report;
    assert_eq!(report.missing_measurements, rows.len() + 1);
    assert_eq!(report.updates + report.off_map + report.missing_measurements, 400);
    assert!(rows.iter().all(|row| output.navigation.nis[*row].is_nan()));
    assert!(output.navigation.sd_n_m.iter().all(|sd| sd.is_finite()));
    // Without measurements there is no reason to resample.
    flight.measured_nt.fill(f64::NAN);
    let none = filtered(&flight, &SlamParameters { hyperparameters: HyperparameterSource::Fitted, ..quick() });
    assert_eq!((none.report.resamplings, none.path.len(), none.report.fitted), (0, 0, false));
}

/// Subset of the rows of a flight.
fn thinned(flight: &Flight, keep: impl Fn(usize) -> bool) -> Flight {
    let rows: Vec<usize> = (0..flight.errors.len()).filter(|row| keep(*row)).collect();
    let of = |column: &Vec<f64>| -> Vec<f64> { rows.iter().map(|row| column[*row]).collect() };
    let line = |line: &crate::navigation::osborne::Line| crate::navigation::osborne::Line {
        columns: line.columns.each_ref().map(of),
    };
    Flight {
        truth: line(&flight.truth),
        ins: line(&flight.ins),
        errors: rows.iter().map(|row| flight.errors[*row]).collect(),
        measured_nt: of(&flight.measured_nt),
        sigma_nt: of(&flight.sigma_nt),
        model: flight.model,
    }
}

#[test]
fn law_uneven_and_fast_sampling_limit_the_drift() {
    let fast = Flight::tactical(loiter(ROUGH_DEG, 3000, 0.2), 5);
    let uneven = thinned(&fast, |row| row % 7 == 0 || row % 5 < 2 || (row > 800 && row < 830));
    for flight in [&fast, &uneven] {
        let output = filtered(flight, &SlamParameters { particles: 300, ..quick() });
        let last = flight.errors.len() - 1;
        let far = |output: Option<&SlamOutput>| flight.error_m(output, last).iter().map(|e| e * e).sum::<f64>().sqrt();
        println!("rows {last}: at the end INS {:.0} m, SLAM {:.1} m", far(None), far(Some(&output)));
        assert!(far(Some(&output)) < 0.5 * far(None).max(100.0));
        assert_eq!(output.navigation.lat_deg.len(), last + 1);
    }
}

#[test]
fn unit_lines_of_one_and_two_samples_are_filtered() {
    let flight = Flight::tactical(loiter(ROUGH_DEG, 50, 1.0), 6);
    for rows in [1, 2] {
        let output = filtered(&thinned(&flight, |row| row < rows), &SlamParameters::default());
        assert_eq!((output.navigation.lat_deg.len(), output.path.len()), (rows, rows));
        assert!(!output.report.fitted);
    }
    assert!(matches!(run_on(&thinned(&flight, |_| false), &quick()), Err(NavigationError::Series(_))));
}

#[test]
fn unit_invalid_parameters_and_lines_are_rejected() {
    let flight = Flight::tactical(loiter(ROUGH_DEG, 20, 1.0), 6);
    let kernel = quick().kernel;
    let wrong = [
        SlamParameters { particles: 1, ..quick() },
        SlamParameters { update_interval_s: f64::NAN, ..quick() },
        SlamParameters { neighbours: 0, ..quick() },
        SlamParameters { neighbours: 22, recent: 4, ..quick() },
        SlamParameters { recent: 30, ..quick() },
        SlamParameters { kernel: AnomalyKernel { length_m: 0.0, ..kernel }, ..quick() },
        SlamParameters { resample_below: 1.5, ..quick() },
        SlamParameters { gate_nis: Some(0.0), ..quick() },
    ];
    for parameters in wrong {
        assert!(matches!(run_on(&flight, &parameters), Err(NavigationError::Parameter(_))), "{parameters:?}");
    }
    let mut broken = thinned(&flight, |_| true);
    broken.model.sources.acc_sigma_mps2 = 1e200;
    assert!(matches!(run_on(&broken, &quick()), Err(NavigationError::Diverged { .. })));
    broken = thinned(&flight, |_| true);
    broken.sigma_nt.pop();
    assert!(matches!(run_on(&broken, &quick()), Err(NavigationError::Series(_))));
}

#[test]
fn law_an_outlier_is_gated_and_samples_at_other_heights_are_ignored() {
    let mut flight = Flight::tactical(loiter(ROUGH_DEG, 400, 1.0), 7);
    let clean = filtered(&flight, &quick());
    let row = (200..400).find(|row| clean.navigation.nis[*row].is_finite()).unwrap();
    flight.measured_nt[row] += 5000.0;
    let gated = filtered(&flight, &SlamParameters { gate_nis: Some(100.0), ..quick() });
    assert!(gated.navigation.nis[row] > 100.0 && gated.navigation.report.gated >= 1);
    // Every lap is 300 m higher than the previous lap.
    for (row, alt_m) in flight.ins.columns[3].iter_mut().enumerate() {
        *alt_m += 3.0 * row as f64;
    }
    let climbing = filtered(&flight, &SlamParameters { max_height_difference_m: 50.0, ..quick() });
    assert_eq!(climbing.report.revisits, 0);
}

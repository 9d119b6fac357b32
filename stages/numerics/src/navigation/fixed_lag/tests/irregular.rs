//! Outliers, gaps and other irregularities of a line.

use crate::navigation::loss::TrajectoryLoss;
use crate::navigation::{InsSeries, NavigationLine};
use crate::random::NormalGenerator;
use crate::signal::gauss_markov::GaussMarkov;

use super::super::{
    AircraftCoefficients, FixedLagError, FixedLagMagnetometer, FixedLagOptions, FixedLagOutput, FixedLagParameters,
    FixedLagUsage, run,
};
use super::flights::{Flight, Left, fly, scene};

const NO_ERROR: GaussMarkov = GaussMarkov { sigma: 0.0, tau_s: 1.0 };

fn smoothed(flight: &Flight) -> FixedLagOutput {
    flight.smoothed(&FixedLagParameters { window_s: 200.0, overlap: 0.8, ..FixedLagParameters::default() }, NO_ERROR)
}

fn is_sound(output: &FixedLagOutput) -> bool {
    let navigation = &output.navigation;
    let columns = [&navigation.lat_deg, &navigation.lon_deg, &navigation.sd_n_m, &navigation.sd_e_m];
    columns.iter().all(|column| column.iter().all(|value| value.is_finite()))
        && output.coefficients.iter().chain(&output.coefficient_covariance).all(|value| value.is_finite())
}

#[test]
fn law_a_robust_loss_limits_the_effect_of_outliers() {
    let clean = fly(3, 1500, 1.0, 1, Left::White);
    let mut spoilt = fly(3, 1500, 1.0, 1, Left::White);
    let mut normals = NormalGenerator::new(99);
    // One measurement in twenty has an error of about 300 nT, a hundred times the noise.
    for row in (0..1500).filter(|row| row % 20 == 7) {
        spoilt.measured[0][row] += 300.0 * normals.draw();
    }
    let drms = |flight: &Flight, loss: TrajectoryLoss| {
        let parameters = FixedLagParameters { loss, overlap: 0.8, ..FixedLagParameters::default() };
        flight.drms_m(&flight.smoothed(&parameters, NO_ERROR).navigation.x)
    };
    let without = drms(&clean, TrajectoryLoss::None);
    let [squares, huber, cauchy] =
        [TrajectoryLoss::None, TrajectoryLoss::Huber, TrajectoryLoss::Cauchy].map(|loss| drms(&spoilt, loss));
    let unspoilt = drms(&clean, TrajectoryLoss::Cauchy);
    println!("DRMS m: clean {without:.1}, Cauchy {unspoilt:.1}");
    println!("with outliers: least squares {squares:.1}, Huber {huber:.1}, Cauchy {cauchy:.1}");
    // A twentieth of the data is lost, and robust weights lose another twentieth, so the errors increase by far less
    // than half.
    assert!(cauchy < 1.5 * without && huber < 2.0 * without, "{without} {huber} {cauchy}");
    assert!(squares > 2.0 * cauchy, "{squares} {cauchy}");
    assert!(unspoilt < 1.2 * without, "{unspoilt} {without}");
}

#[test]
fn unit_missing_measurements_are_counted() {
    let mut flight = fly(1, 400, 1.0, 2, Left::White);
    // Some samples have only one magnetometer, other samples have none, and some regressors have no value.
    flight.measured[1][50..150].fill(f64::NAN);
    flight.measured[0][100..120].fill(f64::NAN);
    flight.regressors[200 * flight.terms] = f64::NAN;
    flight.sigma[300] = 0.0;
    flight.sigma[301] = f64::NAN;
    let output = smoothed(&flight);
    assert!(is_sound(&output));
    assert_eq!(output.navigation.lat_deg.len(), 400);
    assert_eq!(output.usage.len(), 400);
    assert_eq!(output.aircraft_nt.len(), 800);
    let report = output.navigation.report;
    assert_eq!((report.updates, report.missing_measurements, report.off_map), (377, 23, 0));
    assert_eq!(output.usage[110], FixedLagUsage::Missing);
    assert!(output.navigation.nis[110].is_nan() && output.navigation.nis[60].is_finite());
    assert!(output.navigation.sd_n_m[119] > output.navigation.sd_n_m[99]);
    assert!(flight.drms_m(&output.navigation.x) < 40.0);
}

#[test]
fn unit_a_gap_longer_than_a_window_is_bridged() {
    let mut flight = fly(1, 600, 1.0, 1, Left::White);
    // 700 s pass between two samples: the INS values do not change, and the states are propagated.
    (300..600).for_each(|row| flight.ins.columns[0][row] += 700.0);
    let output = smoothed(&flight);
    assert!(is_sound(&output));
    assert_eq!(output.navigation.report.updates, 600);
    assert!(output.navigation.sd_n_m[299] > 0.0);
}

#[test]
fn unit_off_the_map_the_output_follows_the_ins() {
    let mut flight = fly(1, 300, 1.0, 1, Left::White);
    (120..200).for_each(|row| flight.ins.columns[2][row] += 3.0);
    let output = smoothed(&flight);
    assert!(is_sound(&output));
    let report = output.navigation.report;
    assert_eq!((report.updates, report.off_map), (220, 80));
    assert_eq!(output.usage[150], FixedLagUsage::OffMap);
    // A line that is never on the map.
    flight.ins.columns[2].iter_mut().for_each(|lon| *lon += 30.0);
    let output = smoothed(&flight);
    assert_eq!(output.navigation.report.off_map, 300);
    assert!(output.windows.iter().all(|window| window.measurements == 0 && !window.inconsistent));
}

/// The first samples of a flight with other regressors.
fn first(samples: usize, regressors: &[f64], covariance: &[f64]) -> Result<FixedLagOutput, FixedLagError> {
    let flight = fly(2, 300, 1.0, 1, Left::White);
    let columns = flight.ins.columns.each_ref().map(|column| &column[..samples]);
    let ins = InsSeries::from_columns(columns);
    let measured = &flight.measured[0][..samples];
    let line =
        NavigationLine { ins: &ins, measurement_nt: measured, sigma_nt: &flight.sigma[..samples], ..flight.line(&ins) };
    let terms = regressors.len() / samples;
    let zeros = vec![0.0; terms];
    let coefficients = AircraftCoefficients { regressors, mean: &zeros, covariance, walk_density: &zeros };
    let magnetometer = FixedLagMagnetometer { coefficients, ..FixedLagMagnetometer::of_line(&line) };
    run(&FixedLagParameters::default(), &line, &[magnetometer], FixedLagOptions::default())
}

#[test]
fn unit_one_sample_is_one_update() {
    let output = first(1, &[1.0], &[1e6]).unwrap();
    assert!(is_sound(&output));
    assert_eq!((output.windows.len(), output.navigation.report.updates), (1, 1));
    // The bias absorbs the whole residual: position and temporal variation have far smaller variances.
    assert!(output.coefficient_covariance[0] < 100.0, "{:?}", output.coefficient_covariance);
}

#[test]
fn unit_collinear_regressors_share_according_to_their_prior() {
    // Two biases with different priors, and a column of zeros.
    let regressors = [1.0, 1.0, 0.0].repeat(200);
    let output = first(200, &regressors, &[1e6, 0.0, 0.0, 0.0, 4e6, 0.0, 0.0, 0.0, 9e4]).unwrap();
    assert!(is_sound(&output));
    let [a, b, c] = output.coefficients[..] else { panic!("{:?}", output.coefficients) };
    // The sum is determined. The share of each bias is proportional to its prior variance. The precision is sixteen
    // digits minus the digits of the ratio 1e6/10.
    assert!((b / a - 4.0).abs() < 1e-6, "{a} {b}");
    assert!(c.abs() < 1e-9, "{c}");
    let p = &output.coefficient_covariance;
    assert!(((p[0] + 2.0 * p[1] + p[4]) / (p[0] + p[4])).abs() < 1e-3 && (p[8] / 9e4 - 1.0).abs() < 1e-12);
    // The prior has rank one, so both coefficients are equal.
    let output = first(200, &[1.0, 1.0].repeat(200), &[1e6, 1e6, 1e6, 1e6]).unwrap();
    assert!((output.coefficients[0] - output.coefficients[1]).abs() < 1e-6 * output.coefficients[0].abs());
}

#[test]
fn unit_invalid_arrays_are_rejected() {
    assert!(matches!(first(10, &[1.0; 10], &[1.0; 4]), Err(FixedLagError::Size { array: "prior covariance", .. })));
    for covariance in [[1.0, 2.0, 2.0, 1.0], [-1.0, 0.0, 0.0, 1.0], [1.0, 0.5, 0.4, 1.0], [f64::NAN, 0.0, 0.0, 1.0]] {
        assert!(matches!(first(10, &[1.0; 20], &covariance), Err(FixedLagError::Prior { .. })), "{covariance:?}");
    }
    let flight = fly(2, 20, 1.0, 1, Left::White);
    let ins = flight.ins.series();
    let line = flight.line(&ins);
    let of_line = FixedLagMagnetometer::of_line(&line);
    let fails =
        |parameters, magnetometer| run(&parameters, &line, &[magnetometer], FixedLagOptions::default()).is_err();
    assert!(fails(FixedLagParameters { window_s: 0.0, ..FixedLagParameters::default() }, of_line));
    assert!(fails(FixedLagParameters { overlap: 1.0, ..FixedLagParameters::default() }, of_line));
    assert!(fails(FixedLagParameters { lag_s: f64::NAN, ..FixedLagParameters::default() }, of_line));
    let error = GaussMarkov { sigma: 1.0, tau_s: 0.0 };
    assert!(fails(FixedLagParameters::default(), FixedLagMagnetometer { error, ..of_line }));
    assert!(fails(FixedLagParameters::default(), FixedLagMagnetometer { sigma_nt: &[], ..of_line }));
    assert!(!fails(FixedLagParameters::default(), of_line));
}

#[test]
fn unit_without_magnetometers_the_output_is_the_ins() {
    let flight = fly(2, 50, 1.0, 1, Left::White);
    let ins = flight.ins.series();
    let output = run(&FixedLagParameters::default(), &flight.line(&ins), &[], FixedLagOptions::default()).unwrap();
    assert_eq!(output.navigation.lat_deg, flight.ins.columns[1]);
    assert_eq!(output.navigation.report.missing_measurements, 50);
    assert!(scene().map.at(ins.lat_deg[0], ins.lon_deg[0], ins.alt_m[0]).is_some());
}

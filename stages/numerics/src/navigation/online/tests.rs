#![allow(clippy::unwrap_used)]
mod against_dense;
pub(crate) mod flights;
mod irregular;
mod priors;

use super::*;
use crate::compensation::tolles_lawson::{BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection, matrix};
use crate::earth::core_field::CoreField;
use crate::navigation::ekf::{EkfInput, EkfParameters, run_together};
use crate::navigation::transition::NoiseDiscretisation;
use crate::random::NormalGenerator;
use flights::{Flight, ROWS, bits, sloping, wavy};
use std::sync::Arc;

/// Enables all outputs of the filter.
const ALL: OnlineParameters = OnlineParameters {
    gate_nis: None,
    recover_after: None,
    keep_states: true,
    keep_covariance: true,
    keep_coefficients: true,
};

fn fixed(coefficients: &[f64]) -> CoefficientPrior {
    CoefficientPrior::independent(coefficients, &vec![0.0; coefficients.len()])
}

#[test]
fn law_known_coefficients_equal_the_ekf_on_the_compensated_line() {
    let map = wavy(-74.892);
    let main = Arc::new(CoreField::at(2020.5).unwrap());
    for (noise, gate_nis, offset_window_s, core) in [
        (NoiseDiscretisation::Trapezoidal, None, 0.0, Some(&main)),
        (NoiseDiscretisation::Rectangular, Some(0.6), 0.0, None),
        (NoiseDiscretisation::VanLoan, None, 1.05, None),
    ] {
        let mut flight = Flight::turning(&map, 1);
        flight.errors.noise = noise;
        flight.measurement_nt[0][40..55].fill(f64::NAN);
        for (row, measured_nt) in flight.measurement_nt[0].iter_mut().enumerate() {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| flight.columns[column][row]);
            *measured_nt += core.map_or(0.0, |core| core.magnitude_nt(lat, lon, alt));
        }
        let prior = fixed(&flight.coefficients[0]);
        let zero = vec![0.0; prior.mean.len()];
        let line = LineModel { offset_window_s, core, ..flight.line(&map) };
        let parameters = OnlineParameters { gate_nis, ..ALL };
        let online = run(&line, &[flight.magnetometer(0, &prior, &zero)], None, &parameters).unwrap();
        let compensated_nt = flight.compensated(0);
        let parameters = EkfParameters {
            errors: flight.errors,
            offset_window_s,
            gate_nis,
            keep_covariance: true,
            ..EkfParameters::default()
        };
        let sigma_nt = Some(flight.sigma_nt[0].as_slice());
        let point = EkfInput {
            parameters: &parameters,
            measurement_nt: &compensated_nt,
            sigma_nt,
            fixes: None,
            map: &map,
            core,
        };
        let ekf = run_together(line.ins, &[point]).pop().unwrap().unwrap();
        let ours = &online.navigation;
        assert!(ekf.report.off_map > 60 && ekf.report.updates > 30 && ekf.report.missing_measurements == 15);
        assert_eq!(ekf.report.gated > 5, gate_nis.is_some());
        // The offset is the mean of values of 1e2 nT.
        assert!((ours.report.offset_nt - ekf.report.offset_nt).abs() < 1e-11);
        let counts = |report: crate::navigation::NavigationReport| {
            (report.updates, report.gated, report.off_map, report.missing_measurements, report.offset_samples)
        };
        assert_eq!(counts(ours.report), counts(ekf.report));
        for row in 0..ROWS {
            for (state, (ours, theirs)) in ours.x[row].iter().zip(&ekf.x[row]).enumerate() {
                // Sums in another order, of fields of 5e4 nT with rounding errors of 7e-12 nT: about 1e-12 of 2 nT and
                // of a standard deviation.
                let sd = ekf.p[row][state][state].sqrt();
                assert!((ours - theirs).abs() <= 1e-9 * sd, "{row} {state} {ours:e} {theirs:e} {sd:e}");
            }
            for (a, ours) in ours.p[row].iter().enumerate() {
                for (b, ours) in ours.iter().enumerate() {
                    let size = (ekf.p[row][a][a] * ekf.p[row][b][b]).sqrt();
                    assert!((ours - ekf.p[row][a][b]).abs() <= 1e-9 * size, "{row} {a} {b}");
                }
            }
            let (ours, theirs) = (ours.residual_nt[row], ekf.residual_nt[row]);
            assert!((ours - theirs).abs() < 1e-9 || ours.is_nan() && theirs.is_nan(), "{row} {ours} {theirs}");
        }
        assert_eq!(online.magnetometers[0].coefficients, prior.mean);
        let aircraft_nt = &online.magnetometers[0].track.aircraft_nt;
        assert!(aircraft_nt.iter().zip(flight.aircraft(0)).all(|(ours, theirs)| (ours - theirs).abs() < 1e-9));
    }
}

#[test]
fn law_the_order_of_the_magnetometers_does_not_matter() {
    let map = wavy(-74.88);
    let flight = Flight::turning(&map, 3);
    let density = vec![0.01; flight.width];
    let priors: Vec<CoefficientPrior> = (0..3).map(|k| flight.prior(k, 30.0)).collect();
    let in_order = |order: [usize; 3]| {
        let magnetometers = order.map(|k| flight.magnetometer(k, &priors[k], &density));
        run(&flight.line(&map), &magnetometers, None, &ALL).unwrap()
    };
    let (one, other) = (in_order([0, 1, 2]), in_order([2, 0, 1]));
    let (p, q) = (one.navigation.p.last().unwrap(), other.navigation.p.last().unwrap());
    for (state, (x, y)) in one.navigation.x[ROWS - 1].iter().zip(&other.navigation.x[ROWS - 1]).enumerate() {
        // The updates round differently; 1e-9 of a standard deviation exceeds any rounding caused by the order.
        assert!((x - y).abs() <= 1e-7 * p[state][state].sqrt(), "{state} {x:e} {y:e}");
        assert!((p[state][state] / q[state][state] - 1.0).abs() < 1e-7);
    }
    let (a, b) = (&one.magnetometers[0], &other.magnetometers[1]);
    assert!(a.coefficients.iter().zip(&b.coefficients).zip(a.sigma()).all(|((a, b), sd)| (a - b).abs() < 1e-7 * sd));
    let sums = |output: &OnlineOutput| output.navigation.nis.iter().sum::<f64>();
    // The sum of the NIS of the magnetometers equals the NIS of the joint innovation.
    assert!((sums(&one) / sums(&other) - 1.0).abs() < 1e-7);
}

#[test]
fn unit_the_same_line_gives_bit_identical_results() {
    let map = wavy(-74.88);
    let flight = Flight::turning(&map, 2);
    let prior = flight.prior(0, 100.0);
    let density = vec![0.01; flight.width];
    let magnetometers = [0, 1].map(|k| flight.magnetometer(k, &prior, &density));
    let line = flight.line(&map);
    let run = || run(&line, &magnetometers, None, &ALL).unwrap();
    let here = bits(&run());
    let there = std::thread::scope(|scope| scope.spawn(|| bits(&run())).join().unwrap());
    assert!(here == there);
}

/// Vector of a flight as terms with a bias.
struct Vector {
    columns: [Vec<f64>; 3],
    terms: TermSelection,
}

impl Vector {
    fn new(flight: &Flight, groups: &[&str]) -> Self {
        Self { columns: flight.vector_nt.clone(), terms: TermSelection::new(groups).unwrap() }
    }

    fn field(&self) -> BodyFieldColumns<'_> {
        let [x, y, z] = &self.columns;
        BodyFieldColumns { x, y, z, bt: None }
    }

    fn fluxgate(&self, sigma_nt: f64, tau_s: f64) -> Fluxgate<'_> {
        Fluxgate { field: self.field(), terms: &self.terms, scale_nt: DEFAULT_SCALE_NT, runs: &[], sigma_nt, tau_s }
    }
}

#[test]
fn law_the_derivatives_of_the_terms_by_the_bias_equal_differences() {
    let flight = Flight::turning(&wavy(-74.88), 1);
    let mut vector = Vector::new(&flight, &["permanent", "induced", "eddy", "derivative", "bias"]);
    vector.columns[0][7] = 0.0;
    let terms = FluxgateTerms::new(&vector.fluxgate(50.0, f64::INFINITY)).unwrap();
    let mut normals = NormalGenerator::new(5);
    let coefficients: Vec<f64> = (0..terms.len()).map(|_| 300.0 * normals.draw()).collect();
    let value = |row: usize, bias: [f64; 3]| {
        let mut own = vec![0.0; terms.len()];
        terms.row(row, bias, &mut own);
        own.iter().zip(&coefficients).map(|(term, c)| term * c).sum::<f64>()
    };
    for (row, bias) in [(7, [0.0; 3]), (7, [30.0, -20.0, 10.0]), (100, [-400.0, 200.0, 100.0]), (229, [0.0; 3])] {
        let ours = terms.derivatives(row, bias, &coefficients);
        for axis in 0..3 {
            let step = |size: f64| std::array::from_fn(|k| bias[k] + if k == axis { size } else { 0.0 });
            let theirs = (value(row, step(10.0)) - value(row, step(-10.0))) / 20.0;
            // The relative size of the third derivative over |V|² is (10/50,000)² of the first derivative, and the
            // relative size of the rounding error is 1e-12/20.
            assert!((ours[axis] - theirs).abs() < 1e-7 * (theirs.abs() + 1e-2), "{row} {axis} {ours:?} {theirs:e}");
        }
    }
    assert_eq!(vector.columns[0][7], 0.0, "the direction whose cosine is zero");
}

#[test]
fn law_terms_without_a_bias_equal_those_of_the_matrix() {
    let flight = Flight::turning(&wavy(-74.88), 1);
    let mut vector = Vector::new(&flight, &["permanent", "induced5", "eddy8", "derivative", "bias"]);
    vector.columns[2][20] = f64::NAN;
    let a = matrix(&vector.field(), &vector.terms, DEFAULT_SCALE_NT).unwrap();
    let terms = FluxgateTerms::new(&vector.fluxgate(50.0, 900.0)).unwrap();
    let mut own = vec![0.0; terms.len()];
    for (row, a) in a.chunks_exact(terms.len()).enumerate() {
        terms.row(row, [0.0; 3], &mut own);
        let same = |(one, other): (&f64, &f64)| one.to_bits() == other.to_bits() || one.is_nan() && other.is_nan();
        assert!(own.iter().zip(a).all(same), "{row} {own:?} {a:?}");
    }
}

#[test]
fn law_the_bias_of_the_vector_is_estimated() {
    let map = wavy(-74.88);
    let mut flight = Flight::turning(&map, 2);
    let mut vector = Vector::new(&flight, &["permanent", "induced"]);
    // The readings are the truth minus the bias.
    let bias = [80.0, -60.0, 40.0];
    let truth = matrix(&vector.field(), &vector.terms, DEFAULT_SCALE_NT).unwrap();
    for (column, bias) in vector.columns.iter_mut().zip(bias) {
        column.iter_mut().for_each(|read| *read -= bias);
    }
    let read = matrix(&vector.field(), &vector.terms, DEFAULT_SCALE_NT).unwrap();
    flight.replace_terms(&map, &truth, 9, 4000.0);
    flight.terms = vec![read.clone(), read];
    let priors: Vec<CoefficientPrior> =
        flight.coefficients.iter().map(|c| CoefficientPrior::independent(c, &[1.0; 9])).collect();
    let none = [0.0; 9];
    let magnetometers: Vec<OnlineMagnetometer<'_>> =
        (0..2).map(|k| flight.magnetometer(k, &priors[k], &none)).collect();
    let fluxgate = vector.fluxgate(100.0, f64::INFINITY);
    let with = run(&flight.line(&map), &magnetometers, Some(&fluxgate), &ALL).unwrap();
    let found = with.fluxgate.unwrap();
    for (axis, bias_nt) in bias.into_iter().enumerate() {
        let (missed, sd) = (found.bias_nt[axis] - bias_nt, found.sigma_nt[axis]);
        assert!(sd < 25.0 && missed.abs() < 3.0 * sd, "{axis} {missed} {sd}");
    }
    let without = run(&flight.line(&map), &magnetometers, None, &ALL).unwrap();
    let nis = |output: &OnlineOutput| output.navigation.nis.iter().sum::<f64>() / ROWS as f64;
    assert!(nis(&with) < 1.3 && nis(&without) > 2.0 * nis(&with), "{} {}", nis(&with), nis(&without));
}

//! Further measurements in the other filters: compared to the dense solution of all states, to each other, and to
//! flights with known truth.

use std::cell::Cell;

use super::flights::{Consistency, SAMPLES, consistency_of, difference_nt, drifting, lasting_error_nt};
use super::*;
use crate::navigation::adaptive::{self, AdaptiveNoise, AdaptiveParameters};
use crate::navigation::crlb::{self, TruePath};
use crate::navigation::fixed_lag::{self, FixedLagOptions, FixedLagParameters};
use crate::navigation::line::NavigationLine;
use crate::navigation::online::{self, CoefficientPrior, LineModel, OnlineParameters};
use crate::navigation::online_nn::{self, NetworkPrior, OnlineActivation, OnlineNetwork};
use crate::navigation::rts::{self, RtsParameters};
use crate::navigation::scenes::plane;
use crate::random::NormalGenerator;

/// The bounds keep the estimated noise at its assumed value.
fn by_adaptive(line: &NavigationLine<'_>, aids: &Aids<'_>) -> NavigationOutput {
    let parameters =
        AdaptiveParameters { adapt: AdaptiveNoise::R, keep_covariance: true, ..AdaptiveParameters::default() };
    let sigma_nt = line.sigma_nt[0];
    let magnetometer = adaptive::AdaptiveMagnetometer::from_line(line, sigma_nt, sigma_nt);
    adaptive::run_aided(&parameters, line, &[magnetometer], aids).unwrap().line.navigation
}

fn by_online(line: &NavigationLine<'_>, aids: &Aids<'_>) -> NavigationOutput {
    let prior = CoefficientPrior { mean: vec![], covariance: vec![] };
    let (measurement_nt, sigma_nt) = (line.measurement_nt, line.sigma_nt);
    let magnetometer =
        online::OnlineMagnetometer { measurement_nt, sigma_nt, terms: &[], prior: &prior, walk_density: &[] };
    let parameters = OnlineParameters { keep_states: true, keep_covariance: true, ..OnlineParameters::default() };
    let model = LineModel { aids: *aids, ..LineModel::from_line(line) };
    online::run(&model, &[magnetometer], None, &parameters).unwrap().navigation
}

/// Aircraft field of a network. The filter assumes an error of `spread` (of 20 nT) in the output layer and no error in
/// the other layers.
fn by_network(line: &NavigationLine<'_>, aids: &Aids<'_>, spread: f64, seed: u64) -> NavigationOutput {
    const INPUTS: usize = 3;
    const HIDDEN: usize = 4;
    let of_row = |row: usize| [(0.11 * row as f64).sin(), (0.05 * row as f64).cos(), (0.17 * row as f64 + 1.0).sin()];
    let features: Vec<f64> = (0..line.ins.len()).flat_map(of_row).collect();
    let network = OnlineNetwork::new(&features, INPUTS, HIDDEN, OnlineActivation::Tanh, 20.0).unwrap();
    let (weights, states) = (network.draw(seed), network.weights());
    let (mut truth, mut covariance) = (weights.clone(), vec![0.0; states * states]);
    let mut normals = NormalGenerator::new(9000 + seed);
    for weight in states - HIDDEN - 1..states {
        truth[weight] += spread * normals.draw();
        covariance[weight * (states + 1)] = spread * spread;
    }
    let own_nt = network.standardised(&features);
    let own_nt = own_nt.chunks_exact(INPUTS).map(|inputs| network.value(inputs, &truth));
    let measured_nt: Vec<f64> = line.measurement_nt.iter().zip(own_nt).map(|(nt, own)| nt + own).collect();
    let prior = NetworkPrior { weights, covariance, walk_density: vec![0.0; states], misfit_nt: 0.0 };
    let parameters = OnlineParameters { keep_states: true, keep_covariance: true, ..OnlineParameters::default() };
    let line = NavigationLine { measurement_nt: &measured_nt, ..*line };
    online_nn::run(&line, &network, &features, &prior, aids, &parameters).unwrap().navigation
}

fn by_fixed_lag(line: &NavigationLine<'_>, aids: &Aids<'_>, (window_s, lag_s): (f64, f64)) -> NavigationOutput {
    let parameters = FixedLagParameters {
        window_s,
        lag_s,
        measurement_interval_s: 0.0,
        overlap: 0.5,
        ..FixedLagParameters::default()
    };
    let magnetometers = [fixed_lag::FixedLagMagnetometer::of_line(line)];
    let keep = FixedLagOptions { states: true, covariance: true };
    fixed_lag::run_aided(&parameters, line, &magnetometers, aids, keep).unwrap().navigation
}

fn by_rts(line: &NavigationLine<'_>, aids: &Aids<'_>) -> NavigationOutput {
    let parameters = RtsParameters { keep_covariance: true, tolerance_m: 1e-4, ..RtsParameters::default() };
    let found = rts::run_aided(line, &parameters, aids).unwrap();
    assert!(found.iterations.converged, "{:?}", found.iterations);
    found.line
}

/// Dense least squares of the states of all samples at once, in the space of the measurements. Prior and measurements
/// are linearised about zero error.
struct Chain {
    x: Vec<DVector<f64>>,
    p: Vec<DMatrix<f64>>,
}

/// Measurement: row, value minus prediction at zero error, H, and standard deviation.
type Taken = (usize, f64, DVector<f64>, f64);

impl Chain {
    fn solve(line: &NavigationLine<'_>, lasting: &[(f64, f64)], taken: &[Taken]) -> Self {
        let mut prior: Vec<(DMatrix<f64>, DMatrix<f64>)> = vec![];
        let mut first = DMatrix::zeros(DIM, DIM);
        let of_ins = line.errors.initial_covariance(line.ins.lat_deg[0].to_radians(), line.ins.alt_m[0]);
        (0..STATES).for_each(|k| first[(k, k)] = of_ins[k][k]);
        lasting.iter().enumerate().for_each(|(k, (sigma, _))| first[(STATES + k, STATES + k)] = sigma * sigma);
        prior.push((DMatrix::identity(DIM, DIM), first));
        for row in 1..ROWS {
            let (phi, q) = transition(line, row, lasting);
            let p = &phi * &prior[row - 1].1 * phi.transpose() + q;
            prior.push((phi, p));
        }
        let with = |(row, _, h, sigma): &Taken| -> Vec<DVector<f64>> {
            let mut all = vec![DVector::zeros(DIM); ROWS];
            let mut a = h / *sigma;
            for k in (0..=*row).rev() {
                all[k] = &prior[k].1 * &a;
                a = prior[k].0.transpose() * a;
            }
            for k in row + 1..ROWS {
                all[k] = &prior[k].0 * &all[k - 1];
            }
            all
        };
        let columns: Vec<Vec<DVector<f64>>> = taken.iter().map(with).collect();
        let n = taken.len();
        let sum = DMatrix::from_fn(n, n, |i, j| {
            let (row, _, h, sigma) = &taken[i];
            h.dot(&columns[j][*row]) / sigma + if i == j { 1.0 } else { 0.0 }
        });
        let inverse = sum.cholesky().unwrap().inverse();
        let values = DVector::from_iterator(n, taken.iter().map(|(_, value, _, sigma)| value / sigma));
        let dual = &inverse * values;
        let (mut x, mut p) = (vec![], vec![]);
        for (row, (_, before)) in prior.iter().enumerate() {
            let c = DMatrix::from_fn(DIM, n, |state, j| columns[j][row][state]);
            x.push(&c * &dual);
            p.push(before - &c * &inverse * c.transpose());
        }
        Self { x, p }
    }

    /// Asserts that a filter agrees with the dense solution at some rows, within a fraction of the standard deviations.
    fn assert(&self, found: &NavigationOutput, rows: std::ops::Range<usize>, part: f64, name: &str) {
        for row in rows {
            let sigma = |state: usize| self.p[row][(state, state)].sqrt();
            for a in 0..STATES {
                if let Some(x) = found.x.get(row) {
                    let off = (x[a] - self.x[row][a]).abs() / sigma(a);
                    assert!(off < part, "{name}, {row}, state {a}: {off:e}");
                }
                for b in 0..STATES {
                    let off = (found.p[row][a][b] - self.p[row][(a, b)]).abs() / (sigma(a) * sigma(b));
                    assert!(off < part, "{name}, {row}, covariance {a} {b}: {off:e}");
                }
            }
        }
    }
}

/// Measurement whose prediction is a function of the state.
fn taken(row: usize, measured: f64, sigma: f64, predict: impl Fn(&DVector<f64>) -> f64) -> Option<Taken> {
    let scale = |state: usize| if state < 2 { 1e-6 } else { 1e-2 };
    let none = DVector::zeros(DIM);
    let h = DVector::from_fn(DIM, |state, _| {
        let (mut ahead, mut behind) = (none.clone(), none.clone());
        ahead[state] += scale(state);
        behind[state] -= scale(state);
        (predict(&ahead) - predict(&behind)) / (2.0 * scale(state))
    });
    measured.is_finite().then(|| (row, measured - predict(&none), h, sigma))
}

/// Asserts that every filter equals the dense solution.
fn assert_all(line: &NavigationLine<'_>, aids: &Aids<'_>, chain: &Chain, part: f64) {
    let last = ROWS - 1..ROWS;
    for linearisation in [
        Linearisation::Once,
        Linearisation::Iterated { iterations: 5, tolerance_m: 1e-4 },
        Linearisation::Unscented(UkfParameters::default()),
    ] {
        let found = run(line, aids, &keep(linearisation)).unwrap().navigation;
        chain.assert(&found, last.clone(), part, &format!("{linearisation:?}"));
    }
    chain.assert(&by_adaptive(line, aids), last.clone(), part, "adaptive");
    chain.assert(&by_online(line, aids), last.clone(), part, "online");
    chain.assert(&by_network(line, aids, 0.0, 1), last.clone(), part, "online network");
    chain.assert(&by_fixed_lag(line, aids, (12.0, 0.0)), last.clone(), part, "fixed lag, lag 0");
    chain.assert(&by_fixed_lag(line, aids, (1000.0, 1000.0)), 0..ROWS, part, "fixed lag, whole line");
    chain.assert(&by_rts(line, aids), 0..ROWS, part, "rts");
    let InsSeries { lat_deg, lon_deg, alt_m, .. } = *line.ins;
    let path = TruePath { lat_deg, lon_deg, alt_m, velocity_ned_mps: None };
    let bound = crlb::run_aided(line, &path, true, aids).unwrap();
    chain.assert(&bound.navigation, last, part, "crlb");
}

#[test]
fn law_on_a_plane_every_filter_equals_dense_least_squares_of_all_states() {
    let scene = AnalyticScene { fixes: None, ..scene(plane) };
    let read = read(&scene);
    scene.with(|line| {
        let aids = Aids { difference: None, vector: None, ..aids(&read) };
        let lasting = [(5.0, 600.0), (4.0, 300.0 / 60_f64.hypot(30.0))];
        let mut all = vec![];
        let at = Dense { line, read: &read, x: DVector::zeros(DIM), p: DMatrix::zeros(DIM, DIM) };
        for row in 0..ROWS {
            let scalar = |x: &DVector<f64>| at.map_nt(at.place(row, x)) + x[S] + x[STATES + 1];
            all.extend(taken(row, line.measurement_nt[row], 5.0, scalar));
            all.extend(taken(row, read.alt_m[row] - line.ins.alt_m[row], 2.0, |x| x[ALT] + x[STATES]));
        }
        assert_all(line, &aids, &Chain::solve(line, &lasting, &all), 1e-6);
    });
}

#[test]
fn law_over_a_bowl_with_slope_measurements_every_filter_equals_dense_least_squares() {
    let mut scene = AnalyticScene { fixes: None, ..scene(bowl) };
    scene.measurement_nt.fill(f64::NAN);
    // The product of tilt and position is not linear.
    scene.errors.sources.init_attitude_sigma_deg = 1e-6;
    scene.errors.sources.arw_sigma = 1e-12;
    scene.errors.sources.gyro_sigma_radps = 1e-12;
    let read = read(&scene);
    scene.with(|line| {
        let aids = Aids { vector: None, map_error: None, ..aids(&read) };
        let lasting = [(0.5, 300.0), (5.0, 600.0)];
        let mut all = vec![];
        let at = Dense { line, read: &read, x: DVector::zeros(DIM), p: DMatrix::zeros(DIM, DIM) };
        for row in 0..ROWS {
            all.extend(taken(row, read.difference_nt[row], 0.1, |x| at.difference(row, x)));
            all.extend(taken(row, read.alt_m[row] - line.ins.alt_m[row], 2.0, |x| x[ALT] + x[STATES + 1]));
        }
        assert_all(line, &aids, &Chain::solve(line, &lasting, &all), 1e-5);
    });
}

#[test]
fn law_filters_with_the_same_linearisation_agree_over_hills_with_all_measurements() {
    let scene = scene(hills);
    let read = read(&scene);
    scene.with(|line| {
        let aids = aids(&read);
        let ekf = run(line, &aids, &keep(Linearisation::Once)).unwrap().navigation;
        let of_network = by_network(line, &aids, 0.0, 1);
        for (name, found) in
            [("adaptive", by_adaptive(line, &aids)), ("online", by_online(line, &aids)), ("network", of_network)]
        {
            let off = difference(&found, &ekf);
            assert!(off < 1e-7, "{name}: {off:e}");
        }
        // This limit makes half of the samples too flat.
        let usual = run(line, &aids, &keep(Linearisation::Once)).unwrap();
        let mut slopes = usual.slope_nt_per_m.clone();
        slopes.sort_by(f64::total_cmp);
        let flat = Aids { flat_over_m: Some(5.0 / slopes[ROWS / 2]), ..aids };
        let ekf = run(line, &flat, &keep(Linearisation::Once)).unwrap();
        assert!(difference(&ekf.navigation, &usual.navigation) > 1e-3);
        let of_network = by_network(line, &flat, 0.0, 1);
        for (name, found) in
            [("adaptive", by_adaptive(line, &flat)), ("online", by_online(line, &flat)), ("network", of_network)]
        {
            let off = difference(&found, &ekf.navigation);
            assert!(off < 1e-7, "flat, {name}: {off:e}");
        }
    });
}

#[test]
fn law_smoothers_agree_over_hills_with_all_measurements() {
    let scene = scene(hills);
    let read = read(&scene);
    scene.with(|line| {
        // Without further measurements, the smoother of all states equals the smoother of the 18 states.
        let parameters = RtsParameters { keep_covariance: true, tolerance_m: 1e-3, ..RtsParameters::default() };
        let usual = rts::run(line, &parameters).unwrap().line;
        let found = rts::run_aided(line, &parameters, &Aids::default()).unwrap().line;
        let off = difference(&found, &usual);
        // Each smoother stops when the last step changes the cost by less than 0.01.
        assert!(off < 0.05, "without: {off:e}");
        let aids = aids(&read);
        let (whole, lagged) = (by_rts(line, &aids), by_fixed_lag(line, &aids, (1000.0, 1000.0)));
        for row in 0..ROWS {
            for state in 0..STATES {
                let sigma = whole.p[row][state][state].sqrt();
                let off = (whole.x[row][state] - lagged.x[row][state]).abs() / sigma;
                assert!(off < 0.05, "{row}, state {state}: {off:e}");
                assert!((lagged.p[row][state][state].sqrt() / sigma - 1.0).abs() < 0.02, "{row}, {state}");
            }
        }
        let filter = run(line, &aids, &keep(Linearisation::Once)).unwrap().navigation;
        assert!(whole.sd_n_m[10] < 0.9 * filter.sd_n_m[10], "{} {}", whole.sd_n_m[10], filter.sd_n_m[10]);
    });
}

/// Flights with a difference of magnetometers and a map error, for each filter.
fn flown(name: &str, by: impl Fn(&NavigationLine<'_>, &Aids<'_>) -> NavigationOutput) -> Consistency {
    let map_error = MapErrorProcess { sigma_nt: 15.0, length_m: 1000.0 };
    let baseline_m = [15.0, 0.0, 0.0];
    let found = consistency_of(drifting(), |flight, seed| {
        let difference = difference_nt(flight, baseline_m, 0.05, 500 + seed);
        let mut measured = flight.measured(1000 + seed, 2.0);
        measured.iter_mut().zip(lasting_error_nt(flight, map_error, 700 + seed)).for_each(|(nt, error)| *nt += error);
        let (ins, sigma) = (flight.ins.series(), vec![2.0; SAMPLES as usize]);
        let bias = GaussMarkov { sigma: 0.3, tau_s: 600.0 };
        let difference = DifferenceAid {
            difference_nt: &difference,
            sigma_nt: 0.05,
            baseline_m,
            slope: SlopeError::default(),
            bias,
        };
        let aids = Aids { difference: Some(difference), map_error: Some(map_error), ..Aids::default() };
        by(&flight.line(&ins, &measured, &sigma), &aids)
    });
    found.assert(name, if name == "ekf_adaptive" { 0.1 } else { 0.05 });
    found
}

#[test]
fn law_every_filter_is_consistent_with_a_difference_and_a_map_error() {
    let ekf = flown("ekf", |line, aids| run(line, aids, &AidedParameters::default()).unwrap().navigation);
    let adaptive = flown("ekf_adaptive", |line, aids| {
        // The map error per step is larger than the noise; the default form is designed for this case.
        let parameters = AdaptiveParameters::default();
        let magnetometer = adaptive::AdaptiveMagnetometer::from_line(line, 0.2, 40.0);
        let output = adaptive::run_aided(&parameters, line, &[magnetometer], aids).unwrap();
        output.line.navigation
    });
    let online = flown("ekf_online_tl", by_online);
    let flight = Cell::new(0);
    let network = flown("ekf_online_nn", |line, aids| {
        flight.set(flight.get() + 1);
        by_network(line, aids, 0.5, flight.get())
    });
    let lagged = |lag_s: f64| {
        move |line: &NavigationLine<'_>, aids: &Aids<'_>| {
            let parameters = FixedLagParameters { lag_s, measurement_interval_s: 0.0, ..FixedLagParameters::default() };
            let magnetometers = [fixed_lag::FixedLagMagnetometer::of_line(line)];
            fixed_lag::run_aided(&parameters, line, &magnetometers, aids, FixedLagOptions::default())
                .unwrap()
                .navigation
        }
    };
    let now = flown("fixed_lag", lagged(0.0));
    let later = flown("fixed_lag, 60 s", lagged(60.0));
    let whole = flown("rts", |line, aids| rts::run_aided(line, &RtsParameters::default(), aids).unwrap().line);
    for filter in [&adaptive, &online, &now] {
        assert!(filter.square_m2 < 1.2 * ekf.square_m2, "{} {}", filter.square_m2, ekf.square_m2);
    }
    // The filter estimates five more weights, each with a standard deviation of 10 nT.
    assert!(network.square_m2 < 2.0 * ekf.square_m2, "{} {}", network.square_m2, ekf.square_m2);
    assert!(later.square_m2 < ekf.square_m2 && whole.square_m2 < 0.5 * ekf.square_m2);
}

#![allow(clippy::unwrap_used)]

use super::course::LineCourse;
use super::*;
use crate::maps::map_surface::MapInterpolation;
use crate::navigation::adaptive::{self, AdaptiveMagnetometer, AdaptiveParameters};
use crate::navigation::ekf;
use crate::navigation::flights::OsborneFlight;
use crate::navigation::ins_error::{InsErrorModel, InsErrors};
use crate::navigation::scenes::{AnalyticScene, assert_refusals, hills, plane, positions, uneven};
use crate::navigation::transition::NoiseDiscretisation;
use crate::random::NormalGenerator;

/// Network with an effect on a scene. All weights are random, and the inputs are of order 1.
fn network(noise: NetworkNoise, inputs: usize) -> NoiseNetwork {
    let mut network = NoiseNetwork::initial(noise, inputs, 4, 5.0, 3);
    let mut normals = NormalGenerator::new(9);
    let outputs = network.weights.len() - noise.outputs() * 5;
    network.weights[outputs..].iter_mut().for_each(|weight| *weight = 0.7 * normals.draw());
    network.inverse_deviation.fill(0.5);
    network.mean[5] = 67.0;
    network.mean[7] = 9.8;
    network
}

/// Second-by-second scene with a gap, positions, and changing noise.
fn scene(interpolation: MapInterpolation, field_nt: fn(f64, f64) -> f64) -> AnalyticScene {
    let mut scene = AnalyticScene::new(&uneven(70), interpolation, field_nt);
    scene.fixes = Some(positions(&scene.columns));
    scene.measurement_nt[20..24].fill(f64::NAN);
    let mut normals = NormalGenerator::new(5);
    scene.measurement_nt[40..].iter_mut().for_each(|measured| *measured += 20.0 * normals.draw());
    scene
}

fn further(rows: usize) -> Vec<f64> {
    (0..rows).map(|row| (0.3 * row as f64).sin()).collect()
}

#[test]
fn law_without_an_output_it_equals_the_ekf_bit_for_bit() {
    for noise in [NoiseDiscretisation::Trapezoidal, NoiseDiscretisation::Rectangular, NoiseDiscretisation::VanLoan] {
        let mut scene = scene(MapInterpolation::Cubic, hills);
        scene.errors.noise = noise;
        let further = further(70);
        scene.with(|line| {
            let line = NavigationLine { second_order: true, offset_window_s: 3.0, ..*line };
            let zero = NoiseNetwork::initial(NetworkNoise::Both, 9, 4, 5.0, 3);
            let parameters = NekfParameters { gate_nis: Some(8.0), keep_states: true, keep_covariance: true };
            let found = run(&line, &zero, &further, &parameters).unwrap();
            let ekf = EkfParameters {
                errors: line.errors,
                offset_window_s: 3.0,
                gate_nis: Some(8.0),
                second_order: true,
                keep_covariance: true,
                ..EkfParameters::default()
            };
            let point = EkfInput {
                parameters: &ekf,
                measurement_nt: line.measurement_nt,
                sigma_nt: Some(line.sigma_nt),
                fixes: line.fixes,
                map: line.map,
                core: None,
            };
            let expected = ekf::run_together(line.ins, &[point]).pop().unwrap().unwrap();
            assert!(expected.report.gated > 0 && expected.report.missing_measurements == 4);
            // NaN is not equal to itself, so the text is compared.
            assert_eq!(format!("{:?}", found.navigation), format!("{expected:?}"));
            // With an output the result differs.
            let moved = run(&line, &network(NetworkNoise::Both, 9), &further, &parameters).unwrap();
            assert_ne!(moved.navigation.lat_deg, expected.lat_deg);
        });
    }
}

/// Loss over a whole line.
fn loss_of(training: &TrainingLine<'_>, network: &NoiseNetwork, loss: NoiseLoss, frozen: Option<&[f64]>) -> f64 {
    let mut course = LineCourse::new(training, network);
    course.inputs.frozen = frozen.map(<[f64]>::to_vec);
    course.forward(network, loss, usize::MAX).unwrap().1.sum
}

fn gradient_of(training: &TrainingLine<'_>, network: &NoiseNetwork, loss: NoiseLoss) -> Vec<f64> {
    let mut course = LineCourse::new(training, network);
    let (tape, _) = course.forward(network, loss, usize::MAX).unwrap();
    course.backward(network, loss, &tape)
}

/// Derivatives of the loss by central differences.
fn differences(
    training: &TrainingLine<'_>,
    network: &NoiseNetwork,
    loss: NoiseLoss,
    frozen: Option<&[f64]>,
) -> Vec<f64> {
    const STEP: f64 = 1e-5;
    let at = |weight: usize, by: f64| {
        let mut moved = network.clone();
        moved.weights[weight] += by;
        loss_of(training, &moved, loss, frozen)
    };
    (0..network.weights.len()).map(|weight| (at(weight, STEP) - at(weight, -STEP)) / (2.0 * STEP)).collect()
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// True positions of a scene.
fn truth(scene: &AnalyticScene) -> [Vec<f64>; 2] {
    let (north, east) = crate::navigation::scenes::m_per_deg();
    let shifted = |column: usize, by: f64| scene.columns[column].iter().map(|x| x + by).collect::<Vec<f64>>();
    [shifted(1, 40.0 / north), shifted(2, -60.0 / east)]
}

#[test]
fn jac_the_gradient_equals_finite_differences_on_a_map_of_constant_slope() {
    for noise in [NetworkNoise::R, NetworkNoise::Q, NetworkNoise::Both] {
        for loss in [NoiseLoss::Likelihood, NoiseLoss::Position] {
            let mut scene = scene(MapInterpolation::Linear, plane);
            // Noise Q with a clear effect.
            (scene.errors.fogm_sigma_nt, scene.errors.fogm_tau_s) = (10.0, 20.0);
            let (further, truth) = (further(70), truth(&scene));
            scene.with(|line| {
                let truth = Some([truth[0].as_slice(), truth[1].as_slice()]);
                let training = TrainingLine { line: *line, further: &further, truth };
                let network = network(noise, 9);
                // The inputs are constants of the gradient.
                let frozen = run(line, &network, &further, &NekfParameters::default()).unwrap().inputs;
                let (found, expected) =
                    (gradient_of(&training, &network, loss), differences(&training, &network, loss, Some(&frozen)));
                let off: Vec<f64> = found.iter().zip(&expected).map(|(a, b)| a - b).collect();
                // The step of 1e-5 has an error of 1e-10 and a rounding error of 1e-8.
                let share = norm(&off) / norm(&expected);
                assert!(norm(&expected) > 1e-2 && share < 1e-5, "{noise:?} {loss:?} {share:e} {}", norm(&expected));
            });
        }
    }
}

#[test]
fn jac_on_a_curved_map_the_neglected_terms_are_small() {
    let scene = scene(MapInterpolation::Cubic, hills);
    let further = further(70);
    scene.with(|line| {
        let line = NavigationLine { second_order: true, ..*line };
        let training = TrainingLine { line, further: &further, truth: None };
        let network = network(NetworkNoise::R, 9);
        let found = gradient_of(&training, &network, NoiseLoss::Likelihood);
        let expected = differences(&training, &network, NoiseLoss::Likelihood, None);
        let inner: f64 = found.iter().zip(&expected).map(|(a, b)| a * b).sum();
        let cosine = inner / (norm(&found) * norm(&expected));
        assert!(cosine > 0.9, "{cosine} {} {}", norm(&found), norm(&expected));
    });
}

#[test]
fn val_numpy_computes_the_same_scales() {
    let (inputs, units, noise) = (9, 3, NetworkNoise::Both);
    let mut network = NoiseNetwork::initial(noise, inputs, units, 6.0, 1);
    for (at, weight) in network.weights.iter_mut().enumerate() {
        *weight = 0.7 * (1.3 * at as f64 + 0.2).sin();
    }
    network.mean = (0..inputs).map(|at| 0.1 * at as f64).collect();
    network.inverse_deviation = (0..inputs).map(|at| 1.0 + 0.1 * at as f64).collect();
    network.check().unwrap();
    let mut state = network.start();
    let reference = include_str!("../../../reference/navigation/nekf.csv").lines().skip(1);
    let mut steps = 0;
    for (step, line) in reference.enumerate() {
        let row: Vec<f64> = (0..inputs).map(|at| 3.0 * (0.7 * step as f64 + 1.9 * at as f64).sin()).collect();
        let tape = network.advance(&mut state, &row);
        let expected: Vec<f64> = line.split(',').map(|value| value.parse().unwrap()).collect();
        for (found, expected) in network.log_scales(&tape).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{step} {found} {expected}");
        }
        steps += 1;
    }
    assert_eq!(steps, 12);
}

#[test]
fn law_training_runs_the_same_filter() {
    for noise in [NoiseDiscretisation::Trapezoidal, NoiseDiscretisation::Rectangular, NoiseDiscretisation::VanLoan] {
        let mut scene = scene(MapInterpolation::Cubic, hills);
        scene.errors.noise = noise;
        let further = further(70);
        scene.with(|line| {
            let line = NavigationLine { second_order: true, ..*line };
            let network = network(NetworkNoise::Both, 9);
            let filtered = run(&line, &network, &further, &NekfParameters::default()).unwrap();
            let mut loss = 0.0;
            for (residual, nis) in filtered.navigation.residual_nt.iter().zip(&filtered.navigation.nis) {
                if nis.is_finite() {
                    loss += 0.5 * ((residual * residual / nis).ln() + nis);
                }
            }
            let training = TrainingLine { line, further: &further, truth: None };
            let trained = loss_of(&training, &network, NoiseLoss::Likelihood, None);
            // Another order of summation.
            assert!((trained / loss - 1.0).abs() < 1e-9, "{trained} {loss}");
        });
    }
}

#[test]
fn law_the_noise_of_a_sample_does_not_depend_on_the_present() {
    let scene = scene(MapInterpolation::Cubic, hills);
    let mut other = scene.clone();
    other.measurement_nt[30..].iter_mut().for_each(|measured| *measured += 50.0);
    let factors = |scene: &AnalyticScene| {
        scene.with(|line| {
            run(line, &network(NetworkNoise::R, 8), &[], &NekfParameters::default()).unwrap().measurement_factor
        })
    };
    let (first, second) = (factors(&scene), factors(&other));
    assert_eq!(first[..=30], second[..=30]);
    assert_ne!(first[31], second[31]);
}

#[test]
fn unit_invalid_lines_networks_and_inputs_are_rejected() {
    let own = network(NetworkNoise::R, 8);
    assert_refusals(|scene| scene.with(|line| run(line, &own, &[], &NekfParameters::default()).err()));
    let scene = AnalyticScene::new(&uneven(20), MapInterpolation::Linear, plane);
    scene.with(|line| {
        let why = |network: &NoiseNetwork, further: &[f64]| {
            run(line, network, further, &NekfParameters::default()).unwrap_err().to_string()
        };
        assert!(why(&own, &[1.0; 20]).contains("20 further inputs are given, not 20 rows of 0"));
        let mut values = [1.0; 20];
        values[7] = f64::NAN;
        assert!(why(&network(NetworkNoise::R, 9), &values).contains("further input 0 is NaN at row 7 (tt ="));
        let with = |change: fn(&mut NoiseNetwork)| {
            let mut network = own.clone();
            change(&mut network);
            why(&network, &[])
        };
        assert!(with(|network| network.weights[3] = f64::NAN).contains("contains NaN"));
        assert!(with(|network| network.weights.truncate(3)).contains("weights"));
        assert!(with(|network| network.limit = 1.0).contains("above 1"));
        assert!(with(|network| network.hidden = 0).contains("no units"));
        let training = TrainingLine { line: *line, further: &[], truth: None };
        let trained = |lines: &[TrainingLine<'_>], parameters: &NoiseTraining| {
            train::<NavigationError>(lines, parameters, |_, _| Ok(())).unwrap_err().to_string()
        };
        let usual = NoiseTraining::default();
        assert!(trained(&[], &usual).contains("no lines"));
        assert!(trained(&[training], &usual).contains("20 samples have a loss, but training requires at least 100"));
        assert!(trained(&[training], &NoiseTraining { window: 0, ..usual }).contains("no samples"));
        let short = TrainingLine { truth: Some([&[1.0], &[1.0]]), ..training };
        assert!(trained(&[short], &usual).contains("column `lat` has 1 rows"));
    });
}

/// Flights over the Osborne map whose white noise switches between 1 and 12 nT at random times, on average after a
/// minute.
struct SwitchingFlight {
    flight: OsborneFlight,
    measured_nt: Vec<f64>,
    /// Standard deviation of the noise of each sample.
    sigma_nt: Vec<f64>,
    /// Root mean square of the noise.
    rms_nt: f64,
}

const SAMPLES: u32 = 900;

impl SwitchingFlight {
    fn new(seed: u64) -> Self {
        let sources = InsErrors { init_position_sigma_m: 50.0, init_velocity_sigma_mps: 0.3, ..InsErrors::default() };
        let model = InsErrorModel { fogm_sigma_nt: 2.0, ..InsErrorModel::from_sources(sources) };
        let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, model);
        let mut normals = NormalGenerator::new(1000 + seed);
        let (mut sigma_nt, mut sum) = (1.0, 0.0);
        let (mut measured_nt, mut all_nt) = (vec![], vec![]);
        for field_nt in &flight.field_nt {
            // A standard normal number is above 2.13 once in 60.
            if normals.draw() > 2.13 {
                sigma_nt = 13.0 - sigma_nt;
            }
            let noise_nt = sigma_nt * normals.draw();
            sum += noise_nt * noise_nt;
            measured_nt.push(field_nt + noise_nt);
            all_nt.push(sigma_nt);
        }
        Self { flight, measured_nt, sigma_nt: all_nt, rms_nt: (sum / f64::from(SAMPLES)).sqrt() }
    }

    fn with<T>(&self, sigma_nt: &[f64], of: impl FnOnce(&NavigationLine<'_>) -> T) -> T {
        let ins = self.flight.ins.series();
        of(&NavigationLine { second_order: true, ..self.flight.line(&ins, &self.measured_nt, sigma_nt) })
    }
}

/// Network trained on flights of these seeds with the rms noise of the first.
fn trained(seeds: std::ops::Range<u64>, parameters: &NoiseTraining) -> (TrainedNoise, f64) {
    let flights: Vec<SwitchingFlight> = seeds.map(SwitchingFlight::new).collect();
    let rms_nt = flights[0].rms_nt;
    let (ins, sigma_nt): (Vec<_>, _) =
        (flights.iter().map(|flight| flight.flight.ins.series()).collect(), vec![rms_nt; SAMPLES as usize]);
    let lines: Vec<TrainingLine<'_>> = flights
        .iter()
        .zip(&ins)
        .map(|(flight, ins)| TrainingLine {
            line: NavigationLine { second_order: true, ..flight.flight.line(ins, &flight.measured_nt, &sigma_nt) },
            further: &[],
            truth: None,
        })
        .collect();
    (train::<NavigationError>(&lines, parameters, |_, _| Ok(())).unwrap(), rms_nt)
}

#[test]
fn law_training_does_not_depend_on_the_number_of_threads() {
    let parameters = NoiseTraining { epochs: 2, hidden: 3, ..NoiseTraining::default() };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| trained(1..4, &parameters).0)
    };
    let one = on(1);
    assert_eq!(one, on(2));
    let other = trained(1..4, &NoiseTraining { seed: 2, ..parameters }).0;
    assert_ne!(one.network.weights, other.network.weights);
}

#[test]
fn law_on_switching_noise_it_is_nearer_to_the_known_noise() {
    const FLIGHTS: u64 = 20;
    const FROM: usize = 300;
    let parameters = NoiseTraining { epochs: 30, ..NoiseTraining::default() };
    let (found, sigma_nt) = trained(101..107, &parameters);
    let zero = NoiseNetwork::initial(NetworkNoise::R, 8, 2, 5.0, 1);
    let filtered = |line: &NavigationLine<'_>, network: &NoiseNetwork| {
        run(line, network, &[], &NekfParameters::default()).unwrap().navigation
    };
    let mut squares = [0.0; 4];
    // Mean over each flight: errors within a flight are correlated.
    let mut nees: [Vec<f64>; 4] = Default::default();
    for seed in 1..=FLIGHTS {
        let own = SwitchingFlight::new(seed);
        let known = own.with(&own.sigma_nt, |line| filtered(line, &zero));
        own.with(&[sigma_nt; SAMPLES as usize], |line| {
            let magnetometer = AdaptiveMagnetometer::from_line(line, sigma_nt / 20.0, 20.0 * sigma_nt);
            let adaptive = adaptive::run(&AdaptiveParameters::default(), line, &[magnetometer]).unwrap().navigation;
            let outputs = [filtered(line, &zero), adaptive, filtered(line, &found.network), known];
            for (at, output) in outputs.iter().enumerate() {
                squares[at] += own.flight.square_m2(output, FROM) / FLIGHTS as f64;
                let rows = FROM..SAMPLES as usize;
                let sum: f64 = rows.clone().map(|row| own.flight.nees(output, row)).sum();
                nees[at].push(sum / rows.len() as f64);
            }
        });
    }
    let drms = squares.map(f64::sqrt);
    let nees = nees.map(|flights| {
        let mean = flights.iter().sum::<f64>() / FLIGHTS as f64;
        let square = flights.iter().map(|nees| (nees - mean).powi(2)).sum::<f64>() / (FLIGHTS - 1) as f64;
        (mean, 1.96 * (square / FLIGHTS as f64).sqrt())
    });
    println!("constant, adaptive, neural, known: drms {drms:.1?} m, nees {nees:.2?}");
    assert!(found.epoch_loss[29] < found.initial_loss - 0.3);
    let [constant, adaptive, neural, known] = drms;
    assert!(neural < 0.85 * constant && neural < adaptive && known < 1.02 * neural, "{drms:?}");
    assert!(nees[2].0 < nees[1].0 && nees[2].0 < 1.5 * nees[3].0, "{nees:?}");
}

use std::ops::ControlFlow;

use super::objective::{BatchRows, TrainingObjective};
use super::tests::{Table, columns, go_on, near};
use super::windowed::NetworkArchitecture;
use super::*;

const MEMORIES: [MemoryLayers; 5] =
    [MemoryLayers::Gru, MemoryLayers::Lstm, MemoryLayers::Tcn, MemoryLayers::Window, MemoryLayers::Transformer];

fn network(memory: MemoryLayers, form: NetworkForm, inputs: usize, linear: usize) -> WindowedNetworkShape {
    let (units, heads, features) = match memory {
        MemoryLayers::Window => (4 * inputs, 1, 4 * inputs),
        MemoryLayers::Transformer => (4, 2, 16),
        MemoryLayers::Gru | MemoryLayers::Lstm | MemoryLayers::Tcn => (3, 1, 3),
    };
    let head = NetworkShape { inputs: features, linear, hidden: vec![4], activation: ActivationFunction::Tanh, form };
    WindowedNetworkShape { memory, inputs, window: 4, heads, units, head }
}

/// Trains one network over windows.
pub(super) fn train_windowed(
    network: &WindowedNetworkShape,
    start: TrainingState,
    training: &NetworkTraining,
    runs: &SampleRuns<'_>,
    validation: Option<&SampleRuns<'_>>,
    each: &mut EpochCallback<'_>,
) -> Result<TrainingResult, TrainingError> {
    let job = TrainingJob::windowed(network, start, training, runs, validation, Box::new(each));
    train_together(vec![job]).remove(0)
}

fn waves(count: usize, case: usize) -> Vec<f64> {
    (0..count).map(|i| 0.5 * (0.9 * i as f64 + case as f64).sin()).collect()
}

#[test]
fn ref_windowed_predictions_and_steps_agree_with_pytorch() {
    let table = Table::reference();
    let expected = columns(include_str!("../../reference/network/windowed.csv"));
    let runs = SampleRuns { samples: table.samples(), lengths: &[20, 3, 22] };
    let training = NetworkTraining { epochs: 5, batch: 14, learning_rate: 0.02, seed: 3, ..NetworkTraining::default() };
    for memory in [MemoryLayers::Gru, MemoryLayers::Lstm, MemoryLayers::Tcn] {
        for form in [NetworkForm::Plain, NetworkForm::TrainedLinear] {
            let network = network(memory, form, 5, 3);
            let start = waves(network.parameters(), 2);
            let name = format!("{} {}", memory.word(), form.word());
            let predicted = network.predict(&start, &table.x, &table.a, runs.lengths);
            near(&predicted, &expected[format!("{name} predicted").as_str()], 1e-13, &name);
            let trained = train_windowed(&network, network.start(start), &training, &runs, None, &mut go_on).unwrap();
            near(&trained.parameters, &expected[format!("{name} trained").as_str()], 1e-10, &name);
            assert_eq!(network.names().len(), network.parameters());
        }
    }
}

#[test]
fn law_windowed_gradients_agree_with_central_differences() {
    let table = Table::made(300, |x, a| x[0] * x[1] + 0.5 * a[0]);
    let runs = SampleRuns { samples: table.samples(), lengths: &[100, 1, 2, 197] };
    let first = runs.first_rows().unwrap();
    for memory in MEMORIES {
        for form in [NetworkForm::Plain, NetworkForm::Weights, NetworkForm::TrainedLinear] {
            for dropout in [0.0, 0.3] {
                let network = network(memory, form, 4, 2);
                let parameters = waves(network.parameters(), 7);
                let training = NetworkTraining {
                    dropout,
                    sparse_group_lasso: Some(SparseGroupLasso { strength: 0.2, alpha: 0.4 }),
                    physics: 0.6,
                    ..NetworkTraining::default()
                };
                let model = NetworkArchitecture::from(&network);
                let mut objective = TrainingObjective::new(model, &training, runs.samples, first.clone(), &[0.3, -0.4]);
                let seed = (dropout > 0.0).then_some(5);
                let mut gradient = vec![0.0; parameters.len()];
                objective.at(&parameters, BatchRows::All, seed, &mut gradient);
                let mut none = vec![0.0; parameters.len()];
                let mut at = |i: usize, offset: f64| {
                    let mut moved = parameters.clone();
                    moved[i] += offset;
                    objective.at(&moved, BatchRows::All, seed, &mut none).objective
                };
                for (i, slope) in gradient.iter().enumerate() {
                    let by_difference = (at(i, 1e-6) - at(i, -1e-6)) / 2e-6;
                    let name = &network.names()[i];
                    assert!(
                        (slope - by_difference).abs() < 1e-7,
                        "{memory:?} {form:?} {name}: {slope} {by_difference}"
                    );
                }
            }
        }
    }
}

#[test]
fn unit_a_prediction_depends_only_on_its_window() {
    let table = Table::made(60, |_, _| 0.0);
    for memory in MEMORIES {
        let network = network(memory, NetworkForm::Plain, 4, 0);
        let parameters = network.initial(3, &[]);
        let of = |x: &[f64]| network.predict(&parameters, x, &[], &[25, 35]);
        let before = of(&table.x);
        for row in [0, 10, 24, 25, 40, 59] {
            let mut x = table.x.clone();
            x[row * 4 + 1] += 0.1;
            let after = of(&x);
            let end = if row < 25 { 25 } else { 60 };
            for other in 0..60 {
                let seen = (row..(row + 4).min(end)).contains(&other);
                assert_eq!(before[other] != after[other], seen, "{memory:?}: row {other} of a change in {row}");
            }
        }
    }
}

#[test]
fn unit_a_memory_learns_history_and_a_dense_network_does_not() {
    let mut table = Table::made(3000, |_, _| 0.0);
    let mut normals = numerics::random::NormalGenerator::new(1);
    let before: Vec<f64> = (0..3000).map(|_| 0.6 * normals.draw()).collect();
    table.y = (0..3000).map(|i| if i < 3 { 0.0 } else { before[i - 3] - before[i - 1].powi(2) }).collect();
    let samples = NetworkSamples { a: &[], ..table.samples() };
    let mean = table.y.iter().sum::<f64>() / 3000.0;
    let variance = table.y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / 3000.0;
    let training = NetworkTraining { epochs: 60, batch: 60, learning_rate: 0.01, ..NetworkTraining::default() };
    let dense = NetworkShape {
        inputs: 1,
        linear: 0,
        hidden: vec![8],
        activation: ActivationFunction::Tanh,
        form: NetworkForm::Plain,
    };
    let last = |trained: TrainingResult| trained.epochs[59].train_loss / variance;
    let x: &[f64] = &before;
    let start = TrainingState::new(&dense, dense.initial(1, &[]));
    let samples = NetworkSamples { x, ..samples };
    let without = last(train(&dense, start, &training, &samples, None, &mut go_on).unwrap());
    assert!(without > 0.95, "{without}");
    for memory in MEMORIES {
        let shape = network(memory, NetworkForm::Plain, 1, 0);
        let (units, features) = match memory {
            MemoryLayers::Window => (4, 4),
            MemoryLayers::Transformer => (4, 16),
            MemoryLayers::Gru | MemoryLayers::Lstm | MemoryLayers::Tcn => (6, 6),
        };
        let head = NetworkShape { inputs: features, ..dense.clone() };
        let network = WindowedNetworkShape { units, head, ..shape };
        let start = network.start(network.initial(1, &[]));
        let runs = SampleRuns { samples, lengths: &[3000] };
        let with = last(train_windowed(&network, start, &training, &runs, None, &mut go_on).unwrap());
        assert!(with < 0.1, "{memory:?}: {with}, without {without}");
    }
}

#[test]
fn unit_windowed_training_is_bit_identical_on_resume_and_threads() {
    let table = Table::made(1500, |x, a| x[0] * x[1] - 0.3 * a[0]);
    let (samples, unseen) = (table.part(0..1000), table.part(1000..1500));
    let (runs, unseen) =
        (SampleRuns { samples, lengths: &[300, 700] }, SampleRuns { samples: unseen, lengths: &[500] });
    let training =
        NetworkTraining { epochs: 3, batch: 600, dropout: 0.1, learning_rate: 0.01, ..NetworkTraining::default() };
    for memory in MEMORIES {
        let network = network(memory, NetworkForm::TrainedLinear, 4, 2);
        let on = |threads: usize, start: TrainingState, stop: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut kept = vec![];
            let trained = pool.install(|| {
                train_windowed(&network, start, &training, &runs, Some(&unseen), &mut |_, state| {
                    kept = state.to_bytes();
                    if state.epoch == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
                })
            });
            (format!("{:?}", trained.unwrap()), kept)
        };
        let start = || network.start(network.initial(9, &[0.1, 0.2]));
        let whole = on(1, start(), 9);
        assert_eq!(whole, on(3, start(), 9));
        let stopped = on(2, start(), 1);
        assert_eq!(whole, on(1, TrainingState::from_bytes(&stopped.1).unwrap(), 9), "{memory:?}");
    }
}

#[test]
fn unit_mismatched_windows_are_rejected() {
    let table = Table::made(50, |x, _| x[0]);
    let usual = NetworkTraining { epochs: 1, ..NetworkTraining::default() };
    let refused = |network: &WindowedNetworkShape, lengths: &[usize], what: &str| {
        let runs = SampleRuns { samples: NetworkSamples { a: &[], ..table.samples() }, lengths };
        let start = network.start(network.initial(1, &[]));
        let error = train_windowed(network, start, &usual, &runs, None, &mut go_on).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
        if lengths != [50] {
            assert!(network.predict(&network.initial(1, &[]), &table.x, &[], lengths).iter().all(|y| y.is_nan()));
        }
    };
    let gru = network(MemoryLayers::Gru, NetworkForm::Plain, 4, 0);
    refused(&gru, &[49], "49 values of the lengths of runs");
    refused(&gru, &[51], "51 values");
    refused(&gru, &[usize::MAX, 60], "lengths of runs");
    refused(&WindowedNetworkShape { window: 0, ..gru.clone() }, &[50], "the window must be at least 1");
    refused(
        &WindowedNetworkShape { units: 5, ..gru.clone() },
        &[50],
        "the number of inputs of the dense network must be the number of features",
    );
    refused(&WindowedNetworkShape { memory: MemoryLayers::Tcn, window: 6, ..gru }, &[50], "a power of two");
}

use std::ops::ControlFlow;

use super::objective::{BatchRows, TrainingObjective};
use super::tests::{Table, go_on};
use super::*;

fn start(shape: &NetworkShape) -> TrainingState {
    let parameters = (0..shape.parameters()).map(|i| 0.3 * (0.9 * i as f64).sin()).collect();
    TrainingState::new(shape, parameters)
}

/// Result of a training as text, with all bits.
fn bits(trained: &Result<TrainingResult, TrainingError>) -> String {
    match trained {
        Ok(TrainingResult { parameters, epochs, best }) => {
            let curve = epochs.iter().flat_map(|e| [e.train_loss, e.validation_loss, e.learning_rate]);
            let all = parameters.iter().copied().chain(curve).map(|x| format!("{:x}", x.to_bits()));
            format!("{best} {}", all.collect::<Vec<_>>().join(" "))
        }
        Err(error) => error.to_string(),
    }
}

/// Trainings of many kinds, some of which share passes.
fn trainings() -> Vec<NetworkTraining> {
    let usual = NetworkTraining { epochs: 5, batch: 600, learning_rate: 0.01, seed: 7, ..NetworkTraining::default() };
    let lasso = SparseGroupLasso { strength: 0.01, alpha: 0.5 };
    let optimiser = NetworkOptimiser { lbfgs_epochs: 3, ..NetworkOptimiser::default() };
    vec![
        usual.clone(),
        NetworkTraining { dropout: 0.2, loss: NetworkLoss::Absolute, ..usual.clone() },
        NetworkTraining { sparse_group_lasso: Some(lasso), epochs: 3, ..usual.clone() },
        // Diverges after some steps; the others continue.
        NetworkTraining { learning_rate: 1e200, ..usual.clone() },
        // Another order of the samples, and other batches.
        NetworkTraining { seed: 8, ..usual.clone() },
        NetworkTraining { batch: 130, ..usual.clone() },
        NetworkTraining { optimiser, ..usual },
    ]
}

#[test]
fn unit_training_together_equals_training_alone() {
    let table = Table::made(1200, |x, a| x[0] * x[1] + a[0] - 0.3 * a[1]);
    let (rows, last) = (table.part(0..1000), table.part(1000..1200));
    let of = |form, hidden: &[usize]| NetworkShape {
        inputs: 4,
        linear: 2,
        hidden: hidden.to_vec(),
        activation: ActivationFunction::Swish,
        form,
    };
    let shapes = [
        of(NetworkForm::Plain, &[40]),
        of(NetworkForm::TrainedLinear, &[5, 3]),
        of(NetworkForm::FixedLinear, &[3]),
        of(NetworkForm::Weights, &[4]),
    ];
    let trainings = trainings();
    let all: Vec<(&NetworkShape, &NetworkTraining)> =
        shapes.iter().flat_map(|s| trainings.iter().map(move |t| (s, t))).collect();
    let alone = |(shape, training): &(&NetworkShape, &NetworkTraining)| {
        train(shape, start(shape), training, &rows, Some(&last), &mut go_on)
    };
    let expected: Vec<String> = all.iter().map(|case| bits(&alone(case))).collect();
    assert_eq!(expected.iter().filter(|end| end.starts_with("training diverged")).count(), shapes.len());
    // The training runs from the start, and from the states after one, two and three epochs.
    for stops in [1, 4] {
        let after = |place: usize, shape: &NetworkShape, training: &NetworkTraining| {
            let mut state = start(shape);
            for _ in 0..place % stops {
                let mut next = None;
                let one = &mut |_: &TrainingEpoch, now: &TrainingState| {
                    next = Some(now.clone());
                    ControlFlow::Break(())
                };
                let _ends_after_one = train(shape, state.clone(), training, &rows, Some(&last), one);
                state = next.unwrap_or(state);
            }
            state
        };
        let begin = all.iter().enumerate().map(|(place, (shape, training))| {
            let state = after(place, shape, training);
            TrainingJob::new(shape, state, training, rows, Some(last), Box::new(go_on))
        });
        let found = train_together(begin.collect());
        for ((found, expected), (shape, training)) in found.iter().zip(&expected).zip(&all) {
            assert_eq!(&bits(found), expected, "{:?} {training:?}", shape.form);
        }
    }
}

#[test]
fn unit_a_job_that_cannot_start_does_not_affect_the_others() {
    let table = Table::made(100, |x, _| x[0]);
    let shape = NetworkShape {
        inputs: 4,
        linear: 0,
        hidden: vec![3],
        activation: ActivationFunction::Tanh,
        form: NetworkForm::Plain,
    };
    let samples = NetworkSamples { a: &[], ..table.samples() };
    let (good, bad) = (
        NetworkTraining { epochs: 2, ..NetworkTraining::default() },
        NetworkTraining { batch: 0, ..NetworkTraining::default() },
    );
    let job = |training| TrainingJob::new(&shape, start(&shape), training, samples, None, Box::new(go_on));
    let found = train_together([&good, &bad, &good].map(job).into());
    let succeeded: Vec<bool> = found.iter().map(Result::is_ok).collect();
    assert_eq!(succeeded, [true, false, true]);
    assert_eq!(bits(&found[0]), bits(&found[2]));
    assert!(train_together(vec![]).is_empty());
}

#[test]
fn unit_precomputed_products_of_fixed_coefficients_are_bit_identical() {
    let table = Table::made(700, |x, a| x[0] * x[1] + a[0]);
    let (hidden, activation) = (vec![5], ActivationFunction::Swish);
    let shape = NetworkShape { inputs: 4, linear: 2, hidden, activation, form: NetworkForm::FixedLinear };
    let parameters = start(&shape).parameters;
    let training = NetworkTraining { dropout: 0.1, ..NetworkTraining::default() };
    let of = |held: bool, rows: BatchRows<'_>| {
        let mut objective = TrainingObjective::new((&shape).into(), &training, table.samples(), vec![], &[]);
        if held {
            objective.hold_fixed(&parameters);
        }
        let mut gradient = vec![f64::NAN; parameters.len()];
        let mean = objective.at(&parameters, rows, Some(3), &mut gradient);
        gradient.extend([mean.loss, mean.objective]);
        gradient.into_iter().map(f64::to_bits).collect::<Vec<_>>()
    };
    let some: Vec<u32> = (0..300).map(|k| k * 7 % 700).collect();
    for rows in [BatchRows::All, BatchRows::These(&some)] {
        assert_eq!(of(true, rows), of(false, rows));
    }
}

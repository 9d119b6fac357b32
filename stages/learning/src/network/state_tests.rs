use std::ops::ControlFlow;

use super::tests::{Table, go_on};
use super::*;

/// A training that uses all random numbers and all state between epochs.
fn elaborate() -> (Table, NetworkShape, NetworkTraining) {
    let table = Table::made(5000, |x, a| x[0] * x[1] - 0.3 * a[0]);
    let shape = NetworkShape {
        inputs: 4,
        linear: 2,
        hidden: vec![24, 12],
        activation: ActivationFunction::Swish,
        form: NetworkForm::TrainedLinear,
    };
    let training = NetworkTraining {
        optimiser: NetworkOptimiser { lbfgs_epochs: 4, ..NetworkOptimiser::default() },
        epochs: 5,
        batch: 1100,
        learning_rate: 0.01,
        schedule: LearningRateSchedule::Plateau { patience: 1, factor: 0.5 },
        weight_decay: 0.01,
        dropout: 0.2,
        seed: 17,
        ..NetworkTraining::default()
    };
    (table, shape, training)
}

#[test]
fn unit_a_resumed_training_is_bit_identical() {
    let (table, shape, training) = elaborate();
    let (samples, unseen) = (table.part(0..4000), table.part(4000..5000));
    let start = || TrainingState::new(&shape, shape.initial(9, &[0.1, 0.2]));
    let whole = train(&shape, start(), &training, &samples, Some(&unseen), &mut go_on).unwrap();
    assert_eq!(whole.epochs.len(), 9);
    for stop in 1..=9 {
        let mut kept = vec![];
        let stopped = train(&shape, start(), &training, &samples, Some(&unseen), &mut |_, state| {
            kept = state.to_bytes();
            if state.epoch == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert_eq!(stopped.unwrap().epochs.len(), stop);
        let state = TrainingState::from_bytes(&kept).unwrap();
        assert_eq!(state.epoch, stop);
        let resumed = train(&shape, state, &training, &samples, Some(&unseen), &mut go_on).unwrap();
        assert_eq!(format!("{resumed:?}"), format!("{whole:?}"), "after {stop}");
    }
}

#[test]
fn unit_threads_change_no_bit() {
    let (table, shape, training) = elaborate();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let start = TrainingState::new(&shape, shape.initial(9, &[0.1, 0.2]));
            let samples = table.part(0..4000);
            train(&shape, start, &training, &samples, Some(&table.part(4000..5000)), &mut go_on).unwrap()
        })
    };
    let one = on(1);
    assert_eq!(one.parameters, on(2).parameters);
    assert_eq!(one.parameters, on(3).parameters);
    let other = NetworkTraining { seed: 18, ..training };
    let start = TrainingState::new(&shape, shape.initial(9, &[0.1, 0.2]));
    assert_ne!(
        one.parameters,
        train(&shape, start, &other, &table.part(0..4000), Some(&table.part(4000..5000)), &mut go_on)
            .unwrap()
            .parameters
    );
}

#[test]
fn unit_a_truncated_or_altered_state_is_rejected() {
    let (table, shape, training) = elaborate();
    let mut bytes = vec![];
    let start = TrainingState::new(&shape, shape.initial(9, &[0.1, 0.2]));
    train(&shape, start, &training, &table.part(0..300), None, &mut |_, state| {
        bytes = state.to_bytes();
        ControlFlow::Continue(())
    })
    .unwrap_err();
    let plain = NetworkTraining { schedule: LearningRateSchedule::Constant, ..training };
    let start = TrainingState::new(&shape, shape.initial(9, &[0.1, 0.2]));
    let mut last = None;
    train(&shape, start, &plain, &table.part(0..300), None, &mut |_, state| {
        (bytes, last) = (state.to_bytes(), Some(format!("{state:?}")));
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(format!("{:?}", TrainingState::from_bytes(&bytes).unwrap()), last.unwrap());
    for cut in (0..bytes.len()).step_by(97) {
        assert!(TrainingState::from_bytes(&bytes[..cut]).is_err(), "{cut}");
    }
    for place in (0..bytes.len()).step_by(89) {
        let mut flipped = bytes.clone();
        flipped[place] ^= 0x10;
        assert!(TrainingState::from_bytes(&flipped).is_err(), "{place}");
    }
    assert_eq!(TrainingState::from_bytes(b"no state"), Err(TrainingStateError::NotAState));
}

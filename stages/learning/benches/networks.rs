//! Benchmark of one epoch of a network: 400,000 samples, batches of 2048, Adam, reshuffled each epoch; on one and on
//! two threads.
//!
//! `cargo bench -p magline-learning --bench networks --profile dev` prints the wall-clock time and the processor time
//! (sum of all threads) of the fastest of several epochs. It checks that both thread counts give the same bits and that
//! the loss has fallen. `networks.py` runs PyTorch on the same shapes, then this bench.

mod processors;

use std::ops::ControlFlow;
use std::time::Instant;

use learning::network::{
    ActivationFunction, FieldCoupling, NetworkForm, NetworkSamples, NetworkShape, NetworkTraining, TrainingState,
    VectorFrame, train,
};
use numerics::random::NormalGenerator;

use processors::processors;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const ROWS: usize = 400_000;
const INPUTS: usize = 77;
const TERMS: usize = 18;
const EPOCHS: usize = 7;

fn main() -> Result<(), Failure> {
    let mut normals = NormalGenerator::new(1);
    let x: Vec<f64> = (0..ROWS * INPUTS).map(|_| normals.draw()).collect();
    let a: Vec<f64> = (0..ROWS * TERMS).map(|_| normals.draw()).collect();
    let target = |x: &[f64]| 0.5 * x[0] * x[1] + (1.5 * x[2]).sin() + 0.2 * x[3];
    let y: Vec<f64> = x.chunks_exact(INPUTS).map(target).collect();
    println!(
        "{ROWS} samples of {INPUTS} inputs, batches of 2048; the fastest of {} epochs: clock, processors",
        EPOCHS - 1
    );
    // Rows of the vector forms, from Tolles-Lawson terms of a field of 50,000 nT in random directions.
    let terms: Vec<f64> = a.chunks_exact(TERMS).flat_map(terms).collect();
    let frame = VectorFrame { coupling: FieldCoupling::Magnitude, bt_scale_nt: 50_000.0, target_scale_nt: 100.0 };
    let vectors = frame.rows(&terms, TERMS);
    let cases: [(NetworkForm, &[usize]); 8] = [
        (NetworkForm::Plain, &[8]),
        (NetworkForm::TrainedLinear, &[8]),
        (NetworkForm::Weights, &[8]),
        (NetworkForm::VectorScalar, &[8]),
        (NetworkForm::VectorNetwork, &[8]),
        (NetworkForm::Plain, &[16, 8]),
        (NetworkForm::Plain, &[64, 32]),
        (NetworkForm::Plain, &[16, 16, 16]),
    ];
    for (form, hidden) in cases {
        let linear = if form == NetworkForm::Plain { 0 } else { TERMS };
        let shape = NetworkShape {
            inputs: INPUTS,
            linear,
            hidden: hidden.to_vec(),
            activation: ActivationFunction::Swish,
            form,
        };
        let a: &[f64] = match form {
            NetworkForm::Plain => &[],
            form if form.is_vector() => &vectors,
            _ => &a,
        };
        let samples = NetworkSamples { x: &x, a, y: &y };
        let one = timed(&shape, &samples, 1)?;
        let two = timed(&shape, &samples, 2)?;
        assert_eq!(one, two, "the bits depend on the number of threads");
    }
    Ok(())
}

/// Tolles-Lawson terms of a random direction and a random change of the field.
fn terms(random: &[f64]) -> Vec<f64> {
    let size = random[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
    let u: Vec<f64> = random[..3].iter().map(|x| x / size).collect();
    let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    let induced = pairs.into_iter().map(|(i, j)| u[i] * u[j]);
    let eddy = (0..3).flat_map(|i| random[3..6].iter().map(move |change| (i, 0.01 * change)));
    u.iter().copied().chain(induced).chain(eddy.map(|(i, change)| u[i] * change)).collect()
}

/// Trains with `threads` threads and returns the parameters.
fn timed(shape: &NetworkShape, samples: &NetworkSamples<'_>, threads: usize) -> Result<Vec<f64>, Failure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let training = NetworkTraining { epochs: EPOCHS, ..NetworkTraining::default() };
    let start = TrainingState::new(shape, shape.initial(1, &vec![0.0; shape.linear]));
    let (mut clock_s, mut processors_s) = (f64::INFINITY, f64::INFINITY);
    let mut before = None;
    let trained = pool.install(|| {
        train(shape, start, &training, samples, None, &mut |_, _| {
            let now = (Instant::now(), processors());
            // The first epoch allocates the buffers and includes the check of the samples.
            if let Some((clock, processors)) = before.replace(now) {
                clock_s = clock_s.min(now.0.duration_since(clock).as_secs_f64());
                processors_s = processors_s.min(now.1 - processors);
            }
            ControlFlow::Continue(())
        })
    })?;
    let losses: Vec<f64> = trained.epochs.iter().map(|epoch| epoch.train_loss).collect();
    assert!(losses.windows(2).all(|pair| pair[1] < pair[0]), "the loss does not fall: {losses:?}");
    let (form, hidden) = (shape.form.word(), &shape.hidden);
    println!("{form} {hidden:?}, {threads} threads: {:.1} ms, {:.1} ms", clock_s * 1e3, processors_s * 1e3);
    Ok(trained.parameters)
}

//! Training of one network on the samples of a folder, timed. `training.py` writes the folder and runs PyTorch on it.
//!
//! `training FOLDER MODEL HIDDEN WINDOW THREADS` prints the wall-clock time and the processor time of the training in
//! seconds, then the loss of each epoch. The trained parameters are written to `trained.f64`. `HIDDEN` holds the units
//! of the hidden layers with commas, or `-` without hidden layers.

mod processors;

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use learning::network::{
    ActivationFunction, FieldCoupling, MemoryLayers, NetworkForm, NetworkSamples, NetworkShape, NetworkTraining,
    SampleRuns, TrainingJob, TrainingResult, TrainingState, VectorFrame, WindowedNetworkShape, train, train_together,
};
use params::{Literal, ParamValue};

use processors::processors;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const INPUTS: usize = 77;
const TERMS: usize = 18;
const UNITS: usize = 8;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|each| each != "--bench").collect();
    let [folder, model, hidden, window, threads] = &arguments[..] else {
        println!("`python3 stages/learning/benches/training.py` runs this program");
        return Ok(());
    };
    let folder = Path::new(folder);
    let read = |name: &str| -> Result<Vec<f64>, Failure> {
        let bytes = std::fs::read(folder.join(name))?;
        Ok(bytes.as_chunks::<8>().0.iter().map(|each| f64::from_le_bytes(*each)).collect())
    };
    let (x, terms, y, start) = (read("x.f64")?, read("terms.f64")?, read("y.f64")?, read("start.f64")?);
    let (curriculum, word) = match model.as_str() {
        "m3sc" => (Some(1.0), "m3s"),
        "m3vc" => (Some(1.0), "m3v"),
        "m3w" | "m3tf" => (None, "m3s"),
        word => (None, word),
    };
    let form = NetworkForm::read(&Literal::Text(word.to_owned())).ok_or("no such form")?;
    let hidden: Result<Vec<usize>, _> = hidden.split(',').filter(|each| *each != "-").map(str::parse).collect();
    let head = NetworkShape {
        inputs: if form == NetworkForm::VectorOnly { 0 } else { INPUTS },
        linear: if form == NetworkForm::Plain { 0 } else { TERMS },
        hidden: hidden?,
        activation: ActivationFunction::Swish,
        form,
    };
    let frame = VectorFrame { coupling: FieldCoupling::Magnitude, bt_scale_nt: 50_000.0, target_scale_nt: 100.0 };
    let vectors = if form.is_vector() { frame.rows(&terms, TERMS) } else { vec![] };
    let a: &[f64] = match form {
        NetworkForm::Plain => &[],
        form if form.is_vector() => &vectors,
        _ => &terms,
    };
    let x: &[f64] = if form == NetworkForm::VectorOnly { &[] } else { &x };
    let samples = NetworkSamples { x, a, y: &y };
    let training = NetworkTraining { epochs: read("epochs.f64")?.len(), curriculum, ..NetworkTraining::default() };
    let job = Job { head, window: window.parse()?, samples, training, start };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.parse()?).build()?;
    // The pool creates its threads and the buffers of the samples are in memory before the clock starts.
    pool.install(|| rayon::broadcast(|_| ()));
    let begun = (Instant::now(), processors());
    let trained = pool.install(|| job.run(model))?;
    println!("{} {}", begun.0.elapsed().as_secs_f64(), processors() - begun.1);
    trained.epochs.iter().for_each(|epoch| println!("{}", epoch.train_loss));
    let bytes: Vec<u8> = trained.parameters.iter().flat_map(|each| each.to_le_bytes()).collect();
    std::fs::write(folder.join("trained.f64"), bytes)?;
    Ok(())
}

struct Job<'a> {
    head: NetworkShape,
    window: usize,
    samples: NetworkSamples<'a>,
    training: NetworkTraining,
    start: Vec<f64>,
}

impl Job<'_> {
    fn run(self, model: &str) -> Result<TrainingResult, Failure> {
        let Self { mut head, window, samples, training, start } = self;
        let mut each = |_: &_, _: &_| ControlFlow::Continue(());
        let (memory, units, features) = match model {
            "m3w" => (MemoryLayers::Window, INPUTS * window, INPUTS * window),
            "m3tf" => (MemoryLayers::Transformer, UNITS, UNITS * window),
            _ => {
                let start = TrainingState::new(&head, start);
                return Ok(train(&head, start, &training, &samples, None, &mut each)?);
            }
        };
        head.inputs = features;
        let heads = if memory == MemoryLayers::Transformer { UNITS } else { 1 };
        let windowed = WindowedNetworkShape { memory, inputs: INPUTS, window, heads, units, head };
        let runs = SampleRuns { samples, lengths: &[samples.y.len()] };
        let start = windowed.start(start);
        let job = TrainingJob::windowed(&windowed, start, &training, &runs, None, Box::new(&mut each));
        Ok(train_together(vec![job]).remove(0)?)
    }
}

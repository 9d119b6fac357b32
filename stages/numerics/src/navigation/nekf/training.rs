//! Training of the network on lines.

use params::choice;
use rayon::prelude::*;

use crate::navigation::ins_series::SeriesError;
use crate::navigation::line::NavigationLine;
use crate::navigation::online::augmented::refused;
use crate::navigation::output::NavigationError;

use super::check_further;
use super::course::{LineCourse, LossSum};
use super::inputs::FILTER_INPUTS;
use super::network::{NetworkNoise, NoiseNetwork};

choice! {
    /// Loss of the training, per sample.
    #[derive(Default)]
    pub enum NoiseLoss {
        /// Negative log-likelihood of the innovations, ½ (ln s + v²/s); requires no truth.
        #[default]
        Likelihood = "likelihood",
        /// Negative log-likelihood of the true position, ½ (ln |C| + eᵀ C⁻¹ e), with the error e of latitude and
        /// longitude and its covariance C.
        Position = "position",
    }
}

/// Line of a training.
#[derive(Clone, Copy, Debug)]
pub struct TrainingLine<'a> {
    /// Line.
    pub line: NavigationLine<'a>,
    /// Further inputs of the network, row-major, one row per sample.
    pub further: &'a [f64],
    /// True latitude and longitude in degrees, for [`NoiseLoss::Position`]; NaN where unknown.
    pub truth: Option<[&'a [f64]; 2]>,
}

/// Parameters of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseTraining {
    /// Noise that the network sets.
    pub noise: NetworkNoise,
    /// Loss.
    pub loss: NoiseLoss,
    /// Number of units.
    pub hidden: usize,
    /// Largest factor on a standard deviation.
    pub limit: f64,
    /// Number of passes through the lines.
    pub epochs: usize,
    /// Number of samples through which derivatives are propagated.
    pub window: usize,
    /// Learning rate of the first step.
    pub learning_rate: f64,
    /// Seed of the initial weights.
    pub seed: u64,
}

impl Default for NoiseTraining {
    fn default() -> Self {
        Self {
            noise: NetworkNoise::R,
            loss: NoiseLoss::Likelihood,
            hidden: 8,
            limit: 10.0,
            epochs: 30,
            window: 200,
            learning_rate: 0.01,
            seed: 1,
        }
    }
}

/// Trained network.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedNoise {
    /// Network.
    pub network: NoiseNetwork,
    /// Mean loss per sample of the filter without the network.
    pub initial_loss: f64,
    /// Mean loss per sample in each epoch, with the weights at the time of each window.
    pub epoch_loss: Vec<f64>,
    /// Number of samples for which the loss is defined.
    pub samples: usize,
}

/// Adam's decay rates of the moments, and its smallest denominator.
const BETA: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;
/// Largest norm of the gradient of the mean loss; a longer gradient is shortened.
const LARGEST_GRADIENT: f64 = 1.0;
/// Smallest number of samples for which the loss is defined.
const FEWEST: usize = 100;
/// Smallest standard deviation of an input that counts as varying: relative to its mean, and absolute.
const SMALLEST_SPREAD: [f64; 2] = [1e-9, 1e-12];

/// Trains a network. A step of Adam [Kingma & Ba 2015] uses one window of every line: the first windows of all lines,
/// then the second, and so on. The learning rate falls to 0 along half a cosine. Filter and network continue from
/// window to window. `progress` receives the number of each finished epoch and its loss.
///
/// Lines are processed in parallel and their derivatives are added in their order, so results are bit-identical for any
/// number of threads.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`] and
/// [`StateEstimate::check`](crate::navigation::NavigationError::Diverged). Also fails with
/// [`NavigationError::Parameter`] if there are no lines. Also fails for further inputs that are not finite or of
/// another size, for fewer than 100 samples with a defined loss, or for a loss that is not finite. An error of
/// `progress` is returned.
pub fn train<E: From<NavigationError>>(
    lines: &[TrainingLine<'_>],
    parameters: &NoiseTraining,
    mut progress: impl FnMut(usize, f64) -> Result<(), E>,
) -> Result<TrainedNoise, E> {
    let (mut network, initial) = start(lines, parameters)?;
    let mut optimiser = Adam::new(network.weights.len());
    let steps = lines.iter().map(|line| line.line.ins.len().div_ceil(parameters.window)).max().unwrap_or(1);
    let total = (steps * parameters.epochs) as f64;
    let mut epoch_loss = vec![];
    for epoch in 0..parameters.epochs {
        let mut courses: Vec<LineCourse<'_>> = lines.iter().map(|line| LineCourse::new(line, &network)).collect();
        let mut sum = LossSum::default();
        for step in 0..steps {
            let (gradient, part) = window(&mut courses, &network, parameters)?;
            let done = (epoch * steps + step) as f64 / total;
            let rate = 0.5 * parameters.learning_rate * (1.0 + (std::f64::consts::PI * done).cos());
            optimiser.step(&mut network.weights, &gradient, rate);
            sum = add(sum, part);
        }
        let mean = sum.sum / sum.terms as f64;
        if !mean.is_finite() || network.check().is_err() {
            let what = format!("the loss of epoch {} is {mean}; reduce `learning_rate`", epoch + 1);
            return Err(NavigationError::from(refused("learning_rate", what)).into());
        }
        epoch_loss.push(mean);
        progress(epoch + 1, mean)?;
    }
    let initial_loss = initial.sum / initial.terms as f64;
    Ok(TrainedNoise { network, initial_loss, epoch_loss, samples: initial.terms })
}

/// Network before training, with standardised inputs, and the loss of the filter without the network.
fn start(lines: &[TrainingLine<'_>], parameters: &NoiseTraining) -> Result<(NoiseNetwork, LossSum), NavigationError> {
    let NoiseTraining { noise, hidden, limit, seed, loss, window, .. } = *parameters;
    if window == 0 {
        return Err(refused("window", "the window has no samples").into());
    }
    let Some(first) = lines.first() else { return Err(refused("input", "no lines are selected for training").into()) };
    let width = first.further.len() / first.line.ins.len().max(1);
    for line in lines {
        line.line.check()?;
        check_further(line.further, width, line.line.ins)?;
        for (column, values) in ["lat", "lon"].into_iter().zip(line.truth.into_iter().flatten()) {
            let (rows, expected) = (values.len(), line.line.ins.len());
            if rows != expected {
                return Err(SeriesError::Length { column, rows, expected }.into());
            }
        }
    }
    let mut network = NoiseNetwork::initial(noise, FILTER_INPUTS.len() + width, hidden, limit, seed);
    network.check()?;
    let passes: Vec<_> = lines.par_iter().map(|line| inputs_of(line, &network, loss)).collect();
    let (mut rows, mut sum) = (vec![], LossSum::default());
    for pass in passes {
        let (inputs, part) = pass?;
        rows.extend(inputs);
        sum = add(sum, part);
    }
    if sum.terms < FEWEST {
        let what = format!("{} samples have a loss, but training requires at least {FEWEST}", sum.terms);
        return Err(refused("input", what).into());
    }
    standardise(&mut network, &rows);
    Ok((network, sum))
}

/// Inputs of all samples of a line, and the loss of the filter, both without the network.
fn inputs_of(
    line: &TrainingLine<'_>,
    network: &NoiseNetwork,
    loss: NoiseLoss,
) -> Result<(Vec<Vec<f64>>, LossSum), NavigationError> {
    let (mut course, mut inputs, mut sum) = (LineCourse::new(line, network), vec![], LossSum::default());
    while !course.is_done() {
        inputs.push(course.next_inputs());
        sum = add(sum, course.forward(network, loss, 1)?.1);
    }
    Ok((inputs, sum))
}

/// Sets mean and inverse standard deviation of each input from its finite values. A constant input has no effect.
fn standardise(network: &mut NoiseNetwork, rows: &[Vec<f64>]) {
    for input in 0..network.inputs() {
        let column = || rows.iter().map(|row| row[input]).filter(|x| x.is_finite());
        let count = column().count().max(1) as f64;
        let mean = column().sum::<f64>() / count;
        let spread = (column().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt();
        let [relative, absolute] = SMALLEST_SPREAD;
        let varies = spread > relative * mean.abs() + absolute;
        (network.mean[input], network.inverse_deviation[input]) = (mean, if varies { 1.0 / spread } else { 0.0 });
    }
}

/// Gradient of the mean loss over the next window of all lines, and the loss in this window.
fn window(
    courses: &mut [LineCourse<'_>],
    network: &NoiseNetwork,
    parameters: &NoiseTraining,
) -> Result<(Vec<f64>, LossSum), NavigationError> {
    let of = |course: &mut LineCourse<'_>| {
        let (tape, sum) = course.forward(network, parameters.loss, parameters.window)?;
        Ok((course.backward(network, parameters.loss, &tape), sum))
    };
    let parts: Vec<Result<(Vec<f64>, LossSum), NavigationError>> = courses.par_iter_mut().map(of).collect();
    let (mut gradient, mut sum) = (vec![0.0; network.weights.len()], LossSum::default());
    for part in parts {
        let (own, part) = part?;
        gradient.iter_mut().zip(own).for_each(|(to, own)| *to += own);
        sum = add(sum, part);
    }
    let scale = 1.0 / sum.terms.max(1) as f64;
    gradient.iter_mut().for_each(|entry| *entry *= scale);
    Ok((gradient, sum))
}

fn add(a: LossSum, b: LossSum) -> LossSum {
    LossSum { sum: a.sum + b.sum, terms: a.terms + b.terms }
}

/// Moments of the gradient.
struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    steps: i32,
}

impl Adam {
    fn new(weights: usize) -> Self {
        Self { first: vec![0.0; weights], second: vec![0.0; weights], steps: 0 }
    }

    fn step(&mut self, weights: &mut [f64], gradient: &[f64], rate: f64) {
        self.steps += 1;
        let norm = gradient.iter().map(|entry| entry * entry).sum::<f64>().sqrt();
        let scale = if norm > LARGEST_GRADIENT { LARGEST_GRADIENT / norm } else { 1.0 };
        let [first, second] = BETA.map(|beta| 1.0 - beta.powi(self.steps));
        for (at, weight) in weights.iter_mut().enumerate() {
            let entry = scale * gradient[at];
            self.first[at] = BETA[0] * self.first[at] + (1.0 - BETA[0]) * entry;
            self.second[at] = BETA[1] * self.second[at] + (1.0 - BETA[1]) * entry * entry;
            *weight -= rate * (self.first[at] / first) / ((self.second[at] / second).sqrt() + EPSILON);
        }
    }
}

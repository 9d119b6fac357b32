//! Training of one or several networks together by Adam and L-BFGS.

use std::ops::{ControlFlow, Range};

use numerics::random::SplitMix64;

use super::curriculum::TrainingPhase;
use super::error::TrainingError;
use super::loss::NetworkLoss;
use super::objective::{BatchRows, GradientPass, GradientRequest, TrainingObjective};
use super::shape::{DenseLayer, NetworkForm, NetworkRandomStream, NetworkShape, derived_seed};
use super::state::TrainingState;
use super::training::{
    LearningRateSchedule, NetworkOptimiser, NetworkSamples, NetworkTraining, TrainingEpoch, TrainingResult,
};
use super::windowed::{NetworkArchitecture, SampleRuns, WindowedNetworkShape};

const TRAIN: &str = "to train on";
const VALIDATE: &str = "to validate with";

/// Callback after each epoch. It receives the losses of the epoch and the state after the epoch, and can stop the
/// training.
pub type EpochCallback<'a> = dyn FnMut(&TrainingEpoch, &TrainingState) -> ControlFlow<()> + 'a;

/// Trains a network from a start, or resumes from the state at the end of an epoch of the same training.
///
/// Results are bit-identical on any number of threads. Neither resuming nor training together with other networks
/// ([`train_together`]) changes them.
///
/// # Errors
/// Fails without samples, or for mismatched lengths, values that are not finite, settings out of range, or patience
/// without validation. Fails with [`TrainingError::Diverged`] if loss or parameters are no longer finite.
pub fn train(
    shape: &NetworkShape,
    start: TrainingState,
    training: &NetworkTraining,
    samples: &NetworkSamples<'_>,
    validation: Option<&NetworkSamples<'_>>,
    each: &mut EpochCallback<'_>,
) -> Result<TrainingResult, TrainingError> {
    let mut job = TrainingJob::new(shape, start, training, *samples, validation.copied(), Box::new(each))?;
    run(&mut [&mut job]);
    job.trained()
}

/// Trains several networks with the same result as one at a time. Jobs with the same samples in the same order (one
/// slice of inputs, one seed, one batch size) share a pass, so that the inputs of a batch are gathered once. If a job
/// cannot start, its error is returned.
pub fn train_together(
    mut jobs: Vec<Result<TrainingJob<'_>, TrainingError>>,
) -> Vec<Result<TrainingResult, TrainingError>> {
    run(&mut jobs.iter_mut().flatten().collect::<Vec<_>>());
    jobs.into_iter().map(|job| job?.trained()).collect()
}

fn run(jobs: &mut [&mut TrainingJob<'_>]) {
    let mut pass = GradientPass::default();
    loop {
        // Jobs with fewer completed epochs run first, so that interrupted trainings reach the same epoch.
        let going = jobs.iter().enumerate().filter(|(_, job)| job.ended.is_none());
        let Some((first, next)) = going.min_by_key(|(_, job)| job.state.epoch) else { return };
        let together =
            |(at, job): (usize, &&mut TrainingJob<'_>)| at == first || (job.ended.is_none() && job.shares_with(next));
        let together: Vec<bool> = jobs.iter().enumerate().map(together).collect();
        let now = jobs.iter_mut().zip(together).filter_map(|(job, now)| now.then_some(&mut **job));
        epoch(&mut now.collect::<Vec<_>>(), &mut pass);
    }
}

/// Samples, and for a windowed network the first row of each sample's run.
pub(super) type SamplesWithRunStarts<'a> = (NetworkSamples<'a>, Vec<u32>);

/// Training of one network, alone or together with others.
pub struct TrainingJob<'a> {
    model: NetworkArchitecture<'a>,
    training: &'a NetworkTraining,
    samples: NetworkSamples<'a>,
    validation: Option<SamplesWithRunStarts<'a>>,
    layers: Vec<DenseLayer>,
    /// For a curriculum: whether the first phases use each sample.
    near: Option<Vec<bool>>,
    objective: TrainingObjective<'a>,
    state: TrainingState,
    gradient: Vec<f64>,
    each: Box<EpochCallback<'a>>,
    /// Result of the training. `None` while the training runs.
    ended: Option<Result<(), TrainingError>>,
}

impl<'a> TrainingJob<'a> {
    /// Training job of a network without windows; see [`train`].
    ///
    /// # Errors
    /// Returns the errors of [`train`], except errors that occur during training.
    pub fn new(
        shape: &'a NetworkShape,
        start: TrainingState,
        training: &'a NetworkTraining,
        samples: NetworkSamples<'a>,
        validation: Option<NetworkSamples<'a>>,
        each: Box<EpochCallback<'a>>,
    ) -> Result<Self, TrainingError> {
        let validation = validation.map(|samples| (samples, vec![]));
        Self::from_architecture(shape.into(), start, training, (samples, vec![]), validation, each)
    }

    /// Training job of a network over windows. Each epoch predicts every sample of the runs once, from the window that
    /// ends at the sample. The sparse group lasso applies to the input weights of the memory, and dropout also to the
    /// features.
    ///
    /// # Errors
    /// Returns the errors of [`train`], except errors that occur during training. Also fails if the lengths of the runs
    /// do not add up to the number of samples.
    pub fn windowed(
        network: &'a WindowedNetworkShape,
        start: TrainingState,
        training: &'a NetworkTraining,
        runs: &SampleRuns<'a>,
        validation: Option<&SampleRuns<'a>>,
        each: Box<EpochCallback<'a>>,
    ) -> Result<Self, TrainingError> {
        let placed = |runs: &SampleRuns<'a>| Ok((runs.samples, runs.first_rows()?));
        let validation = validation.map(placed).transpose()?;
        Self::from_architecture(network.into(), start, training, placed(runs)?, validation, each)
    }

    fn from_architecture(
        model: NetworkArchitecture<'a>,
        state: TrainingState,
        training: &'a NetworkTraining,
        (samples, first): SamplesWithRunStarts<'a>,
        validation: Option<SamplesWithRunStarts<'a>>,
        each: Box<EpochCallback<'a>>,
    ) -> Result<Self, TrainingError> {
        model.check()?;
        let plain = model.head.form == NetworkForm::Plain;
        samples.check(model, TRAIN, !plain || training.physics > 0.0)?;
        validation.as_ref().map_or(Ok(()), |(samples, _)| samples.check(model, VALIDATE, !plain))?;
        training.check(model, &state, validation.is_some())?;
        let near = training.near_the_mean(&samples, &state.tolles_lawson)?;
        let mut objective = TrainingObjective::new(model, training, samples, first, &state.tolles_lawson);
        objective.hold_fixed(&state.parameters);
        let ended = training.ends(&state).then_some(Ok(()));
        let (layers, gradient) = (model.layers(), vec![0.0; state.parameters.len()]);
        Ok(Self { model, training, samples, validation, layers, near, objective, state, gradient, each, ended })
    }

    /// Request for the mean loss over a batch and the gradient of the mean loss.
    fn part(&mut self, batch: usize) -> GradientRequest<'_, 'a> {
        let (training, state) = (self.training, &self.state);
        let numbers = [NetworkRandomStream::Dropout as u64, state.epoch as u64, batch as u64];
        let dropout = (training.dropout > 0.0).then(|| derived_seed(training.seed, &numbers));
        let (objective, gradient) = (&mut self.objective, &mut self.gradient);
        objective.phase = training.phase(state.epoch);
        GradientRequest { objective, parameters: &state.parameters, dropout, gradient }
    }

    fn by_adam(&self) -> bool {
        self.state.epoch < self.training.epochs
    }

    /// Whether the next epochs of two trainings use the same rows of the same inputs in the same order.
    fn shares_with(&self, other: &TrainingJob<'_>) -> bool {
        let alike = |job: &TrainingJob<'_>| {
            let NetworkTraining { seed, batch, .. } = *job.training;
            (job.model.windowed.is_none(), job.by_adam(), job.samples.y.len(), seed, batch, job.state.epoch)
        };
        let gathers = self.model.windowed.is_none() && self.by_adam() && self.near.is_none() && other.near.is_none();
        gathers && alike(self) == alike(other) && std::ptr::eq(self.samples.x, other.samples.x)
    }

    /// Restarts Adam at the start of a phase of the curriculum.
    fn enter_phase(&mut self) {
        let epoch = self.state.epoch;
        if epoch > 0 && self.training.phase(epoch) != self.training.phase(epoch - 1) {
            self.state.first_moments.fill(0.0);
            self.state.second_moments.fill(0.0);
            self.state.powers = [1.0; 2];
        }
    }

    /// Order of the samples of the next epoch of Adam.
    fn order(&self) -> Vec<u32> {
        let mut order = order(self.samples.y.len(), self.training.seed, self.state.epoch);
        if let Some(near) = self.near.as_ref().filter(|_| !TrainingPhase::has_network(self.phase())) {
            order.retain(|row| near[*row as usize]);
        }
        order
    }

    fn phase(&self) -> Option<TrainingPhase> {
        self.training.phase(self.state.epoch)
    }

    /// Completes an epoch: computes the losses and records them in the state.
    fn conclude(&mut self, train_loss: f64, learning_rate: f64) {
        let phase = self.phase();
        let (training, state) = (self.training, &mut self.state);
        state.epoch += 1;
        let plain = training.plain(self.model, phase, &state.parameters);
        let of = |samples| mean_loss(self.model, training.loss, &plain, samples);
        let validation_loss = self.validation.as_ref().map_or(f64::NAN, of);
        let finite = train_loss.is_finite()
            && (self.validation.is_none() || validation_loss.is_finite())
            && state.parameters.iter().all(|x| x.is_finite());
        if !finite {
            self.ended = Some(Err(TrainingError::Diverged { epoch: state.epoch, learning_rate }));
            return;
        }
        drop(plain);
        if self.validation.is_some() && TrainingPhase::has_network(phase) {
            judge(training, validation_loss, state);
        }
        let epoch = TrainingEpoch { train_loss, validation_loss, learning_rate };
        state.epochs.push(epoch);
        if (self.each)(&epoch, state).is_break() || training.ends(state) {
            self.ended = Some(Ok(()));
        }
    }

    fn trained(self) -> Result<TrainingResult, TrainingError> {
        self.ended.unwrap_or(Ok(()))?;
        let TrainingState { parameters, epoch, best, best_epoch, epochs, .. } = self.state;
        let (parameters, best) = if best.is_empty() { (parameters, epoch) } else { (best, best_epoch) };
        Ok(TrainingResult { parameters, epochs, best })
    }
}

/// Runs one joint epoch of several trainings.
fn epoch(jobs: &mut [&mut TrainingJob<'_>], pass: &mut GradientPass) {
    if jobs.iter().all(|job| job.by_adam()) {
        let rates: Vec<f64> = jobs.iter().map(|job| job.training.rate(&job.state)).collect();
        let losses = adam_epoch(jobs, &rates, pass);
        for ((job, loss), rate) in jobs.iter_mut().zip(losses).zip(rates) {
            job.conclude(loss, rate);
        }
    } else {
        for job in jobs {
            let loss = lbfgs_epoch(job);
            job.conclude(loss, f64::NAN);
        }
    }
}

/// Keeps the parameters of the smallest validation loss, and lowers the learning rate on a plateau.
fn judge(training: &NetworkTraining, validation_loss: f64, state: &mut TrainingState) {
    state.on_plateau += 1;
    if validation_loss < state.best_loss {
        (state.best_loss, state.best_epoch, state.on_plateau) = (validation_loss, state.epoch, 0);
        state.best.clone_from(&state.parameters);
    }
    if let LearningRateSchedule::Plateau { patience, factor } = training.schedule
        && state.on_plateau >= patience
    {
        state.rate_factor *= factor;
        state.on_plateau = 0;
    }
}

/// The mean loss of the errors over samples.
pub(super) fn mean_loss(
    model: NetworkArchitecture<'_>,
    loss: NetworkLoss,
    parameters: &[f64],
    (samples, first): &SamplesWithRunStarts<'_>,
) -> f64 {
    let predicted = model.predict(parameters, samples, first);
    let sum: f64 = predicted.iter().zip(samples.y).map(|(predicted, y)| loss.at(predicted - y).0).sum();
    sum / samples.y.len() as f64
}

/// Order of the samples in an epoch, which is counted from 0. The row numbers are shuffled by the method of Fisher and
/// Yates.
pub(super) fn order(samples: usize, seed: u64, epoch: usize) -> Vec<u32> {
    let mut bits = SplitMix64::new(derived_seed(seed, &[NetworkRandomStream::Order as u64, epoch as u64]));
    let mut order: Vec<u32> = (0..samples as u32).collect();
    for last in (1..samples).rev() {
        let with = (u128::from(bits.draw()) * (last as u128 + 1)) >> 64;
        order.swap(last, with as usize);
    }
    order
}

/// Runs one joint epoch of Adam for several trainings. Returns the mean loss of each training over its samples.
fn adam_epoch(jobs: &mut [&mut TrainingJob<'_>], rates: &[f64], pass: &mut GradientPass) -> Vec<f64> {
    jobs.iter_mut().for_each(|job| job.enter_phase());
    let Some(first) = jobs.first() else { return vec![] };
    let order = first.order();
    let rows = order.len();
    let batches = rows.div_ceil(first.training.batch);
    let mut sums = vec![0.0; jobs.len()];
    for batch in 0..batches {
        let (first, end) = (share(batch, batches, rows), share(batch + 1, batches, rows));
        let mut parts: Vec<GradientRequest<'_, '_>> = jobs.iter_mut().map(|job| job.part(batch)).collect();
        let means = pass.means(&mut parts, BatchRows::These(&order[first..end]));
        for (((job, mean), sum), rate) in jobs.iter_mut().zip(means).zip(&mut sums).zip(rates) {
            *sum += mean.loss * (end - first) as f64;
            if mean.objective.is_finite() {
                let trained = job.training.trained(job.model, job.phase());
                adam_step(&job.layers, job.training, *rate, &job.gradient, &trained, &mut job.state);
            } else {
                *sum = f64::NAN;
            }
        }
        if sums.iter().all(|sum| sum.is_nan()) {
            break;
        }
    }
    sums.into_iter().map(|sum| sum / rows as f64).collect()
}

/// Start of a batch. Batch sizes differ by at most one row.
fn share(batch: usize, batches: usize, rows: usize) -> usize {
    (batch as u128 * rows as u128 / batches as u128) as usize
}

fn adam_step(
    layers: &[DenseLayer],
    training: &NetworkTraining,
    learning_rate: f64,
    gradient: &[f64],
    trained: &[Range<usize>],
    state: &mut TrainingState,
) {
    let NetworkOptimiser { beta_1, beta_2, epsilon, .. } = training.optimiser;
    state.powers = [state.powers[0] * beta_1, state.powers[1] * beta_2];
    let [first, second] = state.powers.map(|power| 1.0 - power);
    if training.weight_decay > 0.0 {
        let factor = 1.0 - learning_rate * training.weight_decay;
        let decays = |layer: &&DenseLayer| trained.iter().any(|range| range.contains(&layer.start));
        for layer in layers.iter().filter(decays) {
            state.parameters[layer.range()].iter_mut().for_each(|weight| *weight *= factor);
        }
    }
    let (step, root) = (learning_rate / first, second.sqrt());
    for range in trained.iter().cloned() {
        let moments = state.first_moments[range.clone()].iter_mut().zip(&mut state.second_moments[range.clone()]);
        let parameters = state.parameters[range.clone()].iter_mut().zip(&gradient[range]);
        for ((parameter, g), (mean, square)) in parameters.zip(moments) {
            *mean = beta_1 * *mean + (1.0 - beta_1) * g;
            *square = beta_2 * *square + (1.0 - beta_2) * g * g;
            *parameter -= step * *mean / (square.sqrt() / root + epsilon);
        }
    }
}

/// A step of L-BFGS. Returns the mean loss after the epoch.
fn lbfgs_epoch(job: &mut TrainingJob<'_>) -> f64 {
    let TrainingJob { training, state, objective, gradient, .. } = job;
    objective.phase = None;
    let memory = training.optimiser.lbfgs_memory;
    state.lbfgs.step(&mut state.parameters, memory, &mut |parameters, gradient| {
        objective.at(parameters, BatchRows::All, None, gradient).objective
    });
    // The last evaluation of the line search may be at other parameters.
    objective.at(&state.parameters, BatchRows::All, None, gradient).loss
}

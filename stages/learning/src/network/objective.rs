//! Objective of the training and its gradient, over many rows.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use numerics::random::SplitMix64;

use super::curriculum::TrainingPhase;
use super::gathering::gather;
use super::passes::{BLOCK, BlockWorkspace, Dropout, NetworkLinearTerms, PackedNetwork, dot};
use super::shape::{NetworkForm, derived_seed, unit_uniform};
use super::training::{NetworkSamples, NetworkTraining, SparseGroupLasso};
use super::windowed::{FeatureExtractor, MemoryLayers, NetworkArchitecture, WindowedNetworkShape};

/// Number of blocks whose gradients are in memory at the same time.
const ROUND: usize = 64;
/// Work (number of rows times number of parameters) below which a second thread costs more time than it saves.
const LEAST_TO_SPREAD: usize = 200_000;

/// Rows over which the objective is averaged.
#[derive(Clone, Copy)]
pub(super) enum BatchRows<'a> {
    /// All rows, in their order.
    All,
    /// The listed rows.
    These(&'a [u32]),
}

impl BatchRows<'_> {
    fn count(self, samples: &NetworkSamples<'_>) -> usize {
        match self {
            BatchRows::All => samples.y.len(),
            BatchRows::These(rows) => rows.len(),
        }
    }
}

/// Mean loss and objective over rows.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ObjectiveMean {
    /// Mean loss of the errors, without penalties.
    pub loss: f64,
    /// Loss plus the distance from Tolles-Lawson and the penalty on weights. The gradient is the gradient of this sum.
    pub objective: f64,
}

/// The objective of a training.
pub(super) struct TrainingObjective<'a> {
    model: NetworkArchitecture<'a>,
    training: &'a NetworkTraining,
    samples: NetworkSamples<'a>,
    /// For a network over a window: the first row of each row's run.
    first: Vec<u32>,
    tolles_lawson: Vec<f64>,
    /// The linear terms of each row times their coefficients, if the coefficients are fixed.
    products: Option<Vec<f64>>,
    network: PackedNetwork<'a>,
    of_body: Vec<f64>,
    /// Phase of the current epoch.
    pub phase: Option<TrainingPhase>,
    idle: Mutex<Vec<ObjectiveWorkspace>>,
}

/// Workspace of one thread.
struct ObjectiveWorkspace {
    buffers: BlockWorkspace,
    body: Option<Box<dyn FeatureExtractor>>,
    features: Vec<f64>,
    d_features: Vec<f64>,
    /// Dropout factors of the features.
    factors: Vec<f64>,
    a: Vec<f64>,
    y: Vec<f64>,
    by_prediction: Vec<f64>,
}

/// Contribution of a block of rows to the objective and to the gradient of the objective.
#[derive(Default)]
struct GradientContribution {
    loss: f64,
    physics: f64,
    gradient: Vec<f64>,
}

/// Block of the rows over which a mean is computed.
struct GradientBlock<'r> {
    rows: BatchRows<'r>,
    range: Range<usize>,
    /// Number of rows over which the mean is computed.
    count: usize,
    dropout: Option<Dropout>,
}

/// Objective of one of several networks that are evaluated over the same rows, and its gradient.
pub(super) struct GradientRequest<'p, 'a> {
    pub objective: &'p mut TrainingObjective<'a>,
    pub parameters: &'p [f64],
    /// Seed of dropout; `None` disables dropout.
    pub dropout: Option<u64>,
    /// Gradient with respect to the parameters.
    pub gradient: &'p mut [f64],
}

/// Pass over rows that computes several means from the same gathered inputs. The next pass reuses its work buffers.
#[derive(Default)]
pub(super) struct GradientPass {
    /// Contribution of each block of a round to each mean.
    slots: Vec<Vec<GradientContribution>>,
    /// Buffer of gathered inputs.
    idle: Mutex<Vec<Vec<f64>>>,
}

impl GradientPass {
    /// The means, and the gradients of the means.
    pub fn means(&mut self, parts: &mut [GradientRequest<'_, '_>], rows: BatchRows<'_>) -> Vec<ObjectiveMean> {
        let count = parts.first().map_or(0, |part| rows.count(&part.objective.samples));
        let blocks = count.div_ceil(BLOCK);
        self.slots.resize_with(blocks.min(ROUND), Vec::new);
        for slots in &mut self.slots {
            slots.resize_with(parts.len(), GradientContribution::default);
            slots.iter_mut().zip(&*parts).for_each(|(slot, part)| slot.gradient.resize(part.parameters.len(), 0.0));
        }
        for part in &mut *parts {
            part.objective.set(part.parameters);
            part.gradient.fill(0.0);
        }
        let parameters: usize = parts.iter().map(|part| part.parameters.len()).sum();
        let spread = count.saturating_mul(parameters) >= LEAST_TO_SPREAD && rayon::current_num_threads() > 1;
        let mut sums = vec![(0.0, 0.0); parts.len()];
        for round in (0..blocks).step_by(ROUND) {
            let slots = &mut self.slots[..ROUND.min(blocks - round)];
            let objectives: Vec<(&TrainingObjective<'_>, Option<u64>)> =
                parts.iter().map(|part| (&*part.objective, part.dropout)).collect();
            let work = |(number, slots): (usize, &mut Vec<GradientContribution>)| {
                let block = round + number;
                let range = block * BLOCK..count.min((block + 1) * BLOCK);
                let taken = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
                let mut gathered = taken.unwrap_or_default();
                if let Some((first, _)) = objectives.first() {
                    let x = first.inputs(rows, &range, &mut gathered);
                    for ((objective, seed), slot) in objectives.iter().zip(slots) {
                        let seed = seed.map(|seed| derived_seed(seed, &[block as u64]));
                        let dropout = seed.map(|seed| Dropout { probability: objective.training.dropout, seed });
                        objective.block(x, &GradientBlock { rows, range: range.clone(), count, dropout }, slot);
                    }
                }
                self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(gathered);
            };
            if slots.len() > 1 && spread {
                slots.par_iter_mut().enumerate().for_each(work);
            } else {
                slots.iter_mut().enumerate().for_each(work);
            }
            for ((part, (loss, physics)), place) in parts.iter_mut().zip(&mut sums).zip(0..) {
                for slot in slots.iter().map(|slots: &Vec<GradientContribution>| &slots[place]) {
                    *loss += slot.loss;
                    *physics += slot.physics;
                    part.gradient.iter_mut().zip(&slot.gradient).for_each(|(sum, part)| *sum += part);
                }
            }
        }
        let mean = |(part, (loss, physics)): (&mut GradientRequest<'_, '_>, (f64, f64))| {
            let TrainingObjective { training, model, .. } = part.objective;
            training.pull_back(*model, part.gradient);
            let loss = loss / count as f64;
            let lasso = training.sparse_group_lasso;
            let penalty = lasso.map_or(0.0, |lasso| lasso.add(*model, part.parameters, part.gradient));
            ObjectiveMean { loss, objective: loss + physics / count as f64 + penalty }
        };
        parts.iter_mut().zip(sums).map(mean).collect()
    }
}

impl<'a> TrainingObjective<'a> {
    pub fn new(
        model: NetworkArchitecture<'a>,
        training: &'a NetworkTraining,
        samples: NetworkSamples<'a>,
        first: Vec<u32>,
        tolles_lawson: &[f64],
    ) -> Self {
        Self {
            model,
            training,
            samples,
            first,
            tolles_lawson: tolles_lawson.to_vec(),
            products: None,
            network: PackedNetwork::new(model.head),
            of_body: vec![],
            phase: None,
            idle: Mutex::default(),
        }
    }

    /// If training does not change the linear coefficients, stores the sums of the terms times these coefficients for
    /// all later calls. The terms are then not read again.
    pub fn hold_fixed(&mut self, parameters: &[f64]) {
        let head = self.model.head;
        let linear = self.samples.terms(head);
        if head.form == NetworkForm::FixedLinear && linear > 0 && self.training.physics == 0.0 {
            let b = &parameters[self.model.head_start() + head.linear_start()..];
            self.products = Some(self.samples.a.par_chunks_exact(linear).map(|terms| dot(terms, b)).collect());
        }
    }

    /// The mean over rows and its gradient with respect to the parameters. `dropout` is the seed of dropout.
    pub fn at(
        &mut self,
        parameters: &[f64],
        rows: BatchRows<'_>,
        dropout: Option<u64>,
        gradient: &mut [f64],
    ) -> ObjectiveMean {
        let part = GradientRequest { objective: self, parameters, dropout, gradient };
        GradientPass::default().means(&mut [part], rows).pop().unwrap_or_default()
    }

    fn set(&mut self, parameters: &[f64]) {
        let parameters = self.training.plain(self.model, self.phase, parameters);
        let (of_body, of_head) = parameters.split_at(self.model.head_start());
        self.network.set(of_head);
        self.of_body.clear();
        self.of_body.extend_from_slice(of_body);
    }

    /// Inputs of a block of rows; for a network over a window, the inputs of each row's window.
    fn inputs<'x>(&'x self, rows: BatchRows<'_>, range: &Range<usize>, gathered: &'x mut Vec<f64>) -> &'x [f64] {
        let (x, inputs) = (self.samples.x, self.model.inputs());
        gathered.clear();
        match (self.model.windowed, rows) {
            (Some(windowed), BatchRows::All) => windowed.gather(x, &self.first, range.clone(), gathered),
            (Some(windowed), BatchRows::These(rows)) => {
                let rows = rows[range.clone()].iter().map(|row| *row as usize);
                windowed.gather(x, &self.first, rows, gathered);
            }
            (None, BatchRows::All) => return &x[range.start * inputs..range.end * inputs],
            (None, BatchRows::These(rows)) => gather(x, inputs, &rows[range.clone()], gathered),
        }
        gathered
    }

    fn block(&self, x: &[f64], block: &GradientBlock<'_>, slot: &mut GradientContribution) {
        let GradientBlock { rows, range, count, dropout } = block;
        let taken = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut work = taken.unwrap_or_else(|| ObjectiveWorkspace {
            buffers: BlockWorkspace::new(self.model.head),
            // For a network over a whole window, the inputs of the window are the features.
            body: self.model.windowed.filter(|w| w.memory != MemoryLayers::Window).map(WindowedNetworkShape::body),
            features: vec![],
            d_features: vec![],
            factors: vec![],
            a: vec![],
            y: vec![],
            by_prediction: vec![],
        });
        let ObjectiveWorkspace { buffers, body, features, d_features, factors, a, y, by_prediction } = &mut work;
        let linear = self.samples.terms(self.model.head);
        let rows_of_block = range.len();
        let (linear_of, width) = match &self.products {
            Some(products) => (products.as_slice(), 1),
            None => (self.samples.a, linear),
        };
        let (a, y) = match rows {
            BatchRows::All => (&linear_of[range.start * width..range.end * width], &self.samples.y[range.clone()]),
            BatchRows::These(rows) => {
                a.clear();
                y.clear();
                let rows = &rows[range.clone()];
                gather(linear_of, width, rows, a);
                gather(self.samples.y, 1, rows, y);
                (a.as_slice(), y.as_slice())
            }
        };
        let terms = if self.products.is_some() { NetworkLinearTerms::Products(a) } else { NetworkLinearTerms::Rows(a) };
        let of_head = match body {
            None => x,
            Some(body) => {
                features.resize(rows_of_block * self.model.head.inputs, 0.0);
                body.set(&self.of_body);
                body.forward(x, rows_of_block, features);
                factors.clear();
                if let Some(Dropout { probability, seed }) = *dropout {
                    let mut bits = SplitMix64::new(derived_seed(seed, &[u64::MAX]));
                    let mut factor = || {
                        if unit_uniform(bits.draw()) < probability { 0.0 } else { 1.0 / (1.0 - probability) }
                    };
                    factors.extend(features.iter().map(|_| factor()));
                    features.iter_mut().zip(factors.iter()).for_each(|(feature, factor)| *feature *= factor);
                }
                features.as_slice()
            }
        };
        buffers.forward(&self.network, of_head, terms, true, *dropout);
        (slot.loss, slot.physics) = (0.0, 0.0);
        by_prediction.clear();
        let per_row = 1.0 / *count as f64;
        for (predicted, y) in buffers.predicted.iter().zip(y) {
            let (loss, slope) = self.training.loss.at(predicted - y);
            slot.loss += loss;
            by_prediction.push(slope * per_row);
        }
        let physics = self.training.physics;
        if physics > 0.0 {
            let rows = buffers.predicted.iter().zip(a.chunks_exact(linear.max(1)));
            for ((predicted, terms), by) in rows.zip(by_prediction.iter_mut()) {
                let tolles_lawson: f64 = terms.iter().zip(&self.tolles_lawson).map(|(a, b)| a * b).sum();
                let distance = predicted - tolles_lawson;
                slot.physics += physics * distance * distance;
                *by += 2.0 * physics * distance * per_row;
            }
        }
        let (of_body, of_head_gradient) = slot.gradient.split_at_mut(self.of_body.len());
        buffers.backward(&self.network, of_head, terms, by_prediction, of_head_gradient);
        if let Some(body) = body {
            d_features.resize(of_head.len(), 0.0);
            buffers.step_to_inputs(&self.network, rows_of_block, d_features);
            d_features.iter_mut().zip(factors.iter()).for_each(|(d, factor)| *d *= factor);
            body.backward(x, rows_of_block, d_features, of_body);
        }
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(work);
    }
}

impl SparseGroupLasso {
    /// Adds the gradient of the penalty on the first layer and returns the penalty. At 0, where the penalty is not
    /// differentiable, the gradient is 0.
    fn add(&self, model: NetworkArchitecture<'_>, parameters: &[f64], gradient: &mut [f64]) -> f64 {
        let Some(layer) = model.layers().first().copied() else { return 0.0 };
        let (weights, gradient) = (layer.weights(parameters), &mut gradient[layer.range()]);
        // In a convolution, an input has one weight for each of several samples.
        let inputs = model.inputs();
        let mut penalty = 0.0;
        for input in 0..inputs {
            let column = || weights.iter().skip(input).step_by(inputs);
            let norm = column().map(|w| w * w).sum::<f64>().sqrt();
            let absolute: f64 = column().map(|w| w.abs()).sum();
            penalty += (1.0 - self.alpha) * absolute + self.alpha * norm;
            for (gradient, w) in gradient.iter_mut().skip(input).step_by(inputs).zip(column()) {
                let sign = if *w == 0.0 { 0.0 } else { w.signum() };
                let direction = if norm > 0.0 { w / norm } else { 0.0 };
                *gradient += self.strength * ((1.0 - self.alpha) * sign + self.alpha * direction);
            }
        }
        self.strength * penalty
    }
}

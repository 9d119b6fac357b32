//! What training makes small, and its gradient, over many rows.

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use numerics::random::SplitMix64;

use super::gathering::gather;
use super::passes::{BLOCK, Buffers, Dropout, Packed};
use super::shape::{derived_seed, unit_uniform};
use super::training::{Samples, SparseGroupLasso, Training};
use super::windowed::{Body, Model};

/// Blocks whose gradients are held at the same time.
const ROUND: usize = 64;
/// Products of rows and parameters below which a second thread costs more than it gives.
const LEAST_TO_SPREAD: usize = 200_000;

/// The rows of a mean.
#[derive(Clone, Copy)]
pub(super) enum Rows<'a> {
    /// All rows, in their order.
    All,
    /// These.
    These(&'a [u32]),
}

/// A mean over rows.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Mean {
    /// The loss of the errors alone.
    pub loss: f64,
    /// With the distance from Tolles-Lawson and the penalty on weights: what the gradient is of.
    pub objective: f64,
}

/// The objective of a training.
pub(super) struct Objective<'a> {
    model: Model<'a>,
    training: &'a Training,
    samples: &'a Samples<'a>,
    /// The first row of the run of each row, for a network over a window.
    first: &'a [u32],
    tolles_lawson: Vec<f64>,
    network: Packed<'a>,
    of_body: Vec<f64>,
    idle: Mutex<Vec<Work>>,
    slots: Vec<Slot>,
}

/// What a thread works in.
struct Work {
    buffers: Buffers,
    body: Option<Box<dyn Body>>,
    features: Vec<f64>,
    d_features: Vec<f64>,
    /// What dropout multiplies the features by.
    factors: Vec<f64>,
    x: Vec<f64>,
    a: Vec<f64>,
    y: Vec<f64>,
    by_prediction: Vec<f64>,
}

/// What a block adds.
struct Slot {
    loss: f64,
    physics: f64,
    gradient: Vec<f64>,
}

impl<'a> Objective<'a> {
    pub fn new(
        model: Model<'a>,
        training: &'a Training,
        samples: &'a Samples<'a>,
        first: &'a [u32],
        tolles_lawson: &[f64],
    ) -> Self {
        Self {
            model,
            training,
            samples,
            first,
            tolles_lawson: tolles_lawson.to_vec(),
            network: Packed::new(model.head),
            of_body: vec![],
            idle: Mutex::default(),
            slots: vec![],
        }
    }

    /// The mean over rows and its gradient by the parameters. `dropout` is the seed of what is left out.
    pub fn at(&mut self, parameters: &[f64], rows: Rows<'_>, dropout: Option<u64>, gradient: &mut [f64]) -> Mean {
        let (of_body, of_head) = parameters.split_at(self.model.head_start());
        self.network.set(of_head);
        self.of_body.clear();
        self.of_body.extend_from_slice(of_body);
        let count = match rows {
            Rows::All => self.samples.y.len(),
            Rows::These(rows) => rows.len(),
        };
        let blocks = count.div_ceil(BLOCK);
        while self.slots.len() < blocks.min(ROUND) {
            self.slots.push(Slot { loss: 0.0, physics: 0.0, gradient: vec![0.0; parameters.len()] });
        }
        let mut slots = std::mem::take(&mut self.slots);
        gradient.fill(0.0);
        let (mut loss, mut physics) = (0.0, 0.0);
        for round in (0..blocks).step_by(ROUND) {
            let slots = &mut slots[..ROUND.min(blocks - round)];
            let work = |(number, slot): (usize, &mut Slot)| {
                let block = round + number;
                let range = block * BLOCK..count.min((block + 1) * BLOCK);
                let dropout = dropout.map(|seed| Dropout {
                    probability: self.training.dropout,
                    seed: derived_seed(seed, &[block as u64]),
                });
                self.block(rows, range, count, dropout, slot);
            };
            if slots.len() > 1
                && count.saturating_mul(parameters.len()) >= LEAST_TO_SPREAD
                && rayon::current_num_threads() > 1
            {
                slots.par_iter_mut().enumerate().for_each(work);
            } else {
                slots.iter_mut().enumerate().for_each(work);
            }
            for slot in slots {
                loss += slot.loss;
                physics += slot.physics;
                gradient.iter_mut().zip(&slot.gradient).for_each(|(sum, part)| *sum += part);
            }
        }
        self.slots = slots;
        let loss = loss / count as f64;
        let penalty = self.training.sparse_group_lasso.map_or(0.0, |lasso| lasso.add(self.model, parameters, gradient));
        Mean { loss, objective: loss + physics / count as f64 + penalty }
    }

    fn block(
        &self,
        rows: Rows<'_>,
        range: std::ops::Range<usize>,
        count: usize,
        dropout: Option<Dropout>,
        slot: &mut Slot,
    ) {
        let taken = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut work = taken.unwrap_or_else(|| Work {
            buffers: Buffers::new(self.model.head),
            body: self.model.windowed.map(|windowed| windowed.body()),
            features: vec![],
            d_features: vec![],
            factors: vec![],
            x: vec![],
            a: vec![],
            y: vec![],
            by_prediction: vec![],
        });
        let Work { buffers, body, features, d_features, factors, x, a, y, by_prediction } = &mut work;
        let (inputs, linear) = (self.model.inputs(), self.samples.terms(self.model.head));
        if let Some(windowed) = self.model.windowed {
            x.clear();
            match rows {
                Rows::All => windowed.gather(self.samples.x, self.first, range.clone(), x),
                Rows::These(rows) => {
                    let rows = rows[range.clone()].iter().map(|row| *row as usize);
                    windowed.gather(self.samples.x, self.first, rows, x);
                }
            }
        }
        let rows_of_block = range.len();
        let (x, a, y) = match rows {
            Rows::All => (
                if body.is_some() { x.as_slice() } else { &self.samples.x[range.start * inputs..range.end * inputs] },
                &self.samples.a[range.start * linear..range.end * linear],
                &self.samples.y[range],
            ),
            Rows::These(rows) => {
                a.clear();
                y.clear();
                if body.is_none() {
                    x.clear();
                }
                let rows = &rows[range];
                if body.is_none() {
                    gather(self.samples.x, inputs, rows, x);
                }
                gather(self.samples.a, linear, rows, a);
                gather(self.samples.y, 1, rows, y);
                (x.as_slice(), a.as_slice(), y.as_slice())
            }
        };
        let of_head = match body {
            None => x,
            Some(body) => {
                features.resize(rows_of_block * self.model.head.inputs, 0.0);
                body.set(&self.of_body);
                body.forward(x, rows_of_block, features);
                factors.clear();
                if let Some(Dropout { probability, seed }) = dropout {
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
        buffers.forward(&self.network, of_head, a, true, dropout);
        (slot.loss, slot.physics) = (0.0, 0.0);
        by_prediction.clear();
        let per_row = 1.0 / count as f64;
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
        buffers.backward(&self.network, of_head, a, by_prediction, of_head_gradient);
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
    /// Adds the gradient of the penalty on the first layer, which is returned. At 0, where it has a corner, it is 0.
    fn add(&self, model: Model<'_>, parameters: &[f64], gradient: &mut [f64]) -> f64 {
        let Some(layer) = model.layers().first().copied() else { return 0.0 };
        let (weights, gradient) = (layer.weights(parameters), &mut gradient[layer.range()]);
        // A convolution has weights for an input of more than one sample.
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

//! What training makes small, and its gradient, over many rows.

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::passes::{BLOCK, Buffers, Dropout, Packed};
use super::shape::{Shape, derived_seed};
use super::training::{Samples, SparseGroupLasso, Training};

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
    shape: &'a Shape,
    training: &'a Training,
    samples: &'a Samples<'a>,
    tolles_lawson: Vec<f64>,
    network: Packed<'a>,
    idle: Mutex<Vec<Work>>,
    slots: Vec<Slot>,
}

/// What a thread works in.
struct Work {
    buffers: Buffers,
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
    pub fn new(shape: &'a Shape, training: &'a Training, samples: &'a Samples<'a>, tolles_lawson: &[f64]) -> Self {
        let network = Packed::new(shape);
        let tolles_lawson = tolles_lawson.to_vec();
        Self { shape, training, samples, tolles_lawson, network, idle: Mutex::default(), slots: vec![] }
    }

    /// The mean over rows and its gradient by the parameters. `dropout` is the seed of what is left out.
    pub fn at(&mut self, parameters: &[f64], rows: Rows<'_>, dropout: Option<u64>, gradient: &mut [f64]) -> Mean {
        self.network.set(parameters);
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
            if slots.len() > 1 && count * parameters.len() >= LEAST_TO_SPREAD && rayon::current_num_threads() > 1 {
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
        let penalty = self.training.sparse_group_lasso.map_or(0.0, |lasso| lasso.add(self.shape, parameters, gradient));
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
            buffers: Buffers::new(self.shape),
            x: vec![],
            a: vec![],
            y: vec![],
            by_prediction: vec![],
        });
        let Work { buffers, x, a, y, by_prediction } = &mut work;
        let (inputs, linear) = (self.shape.inputs, self.samples.terms(self.shape));
        let (x, a, y) = match rows {
            Rows::All => (
                &self.samples.x[range.start * inputs..range.end * inputs],
                &self.samples.a[range.start * linear..range.end * linear],
                &self.samples.y[range],
            ),
            Rows::These(rows) => {
                x.clear();
                a.clear();
                y.clear();
                for row in &rows[range] {
                    let row = *row as usize;
                    x.extend_from_slice(&self.samples.x[row * inputs..][..inputs]);
                    a.extend_from_slice(&self.samples.a[row * linear..][..linear]);
                    y.push(self.samples.y[row]);
                }
                (x.as_slice(), a.as_slice(), y.as_slice())
            }
        };
        buffers.forward(&self.network, x, a, true, dropout);
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
        buffers.backward(&self.network, x, a, by_prediction, &mut slot.gradient);
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(work);
    }
}

impl SparseGroupLasso {
    /// Adds the gradient of the penalty on the first layer, which is returned. At 0, where it has a corner, it is 0.
    fn add(&self, shape: &Shape, parameters: &[f64], gradient: &mut [f64]) -> f64 {
        let Some(layer) = shape.layers().first().copied() else { return 0.0 };
        let weights = layer.weights(parameters);
        let (gradient, _) = layer.split_mut(gradient);
        let mut penalty = 0.0;
        for input in 0..layer.inputs {
            let column = || weights.iter().skip(input).step_by(layer.inputs);
            let norm = column().map(|w| w * w).sum::<f64>().sqrt();
            let absolute: f64 = column().map(|w| w.abs()).sum();
            penalty += (1.0 - self.alpha) * absolute + self.alpha * norm;
            for (gradient, w) in gradient.iter_mut().skip(input).step_by(layer.inputs).zip(column()) {
                let sign = if *w == 0.0 { 0.0 } else { w.signum() };
                let direction = if norm > 0.0 { w / norm } else { 0.0 };
                *gradient += self.strength * ((1.0 - self.alpha) * sign + self.alpha * direction);
            }
        }
        self.strength * penalty
    }
}

//! Shapley values of linear models, and of any model by sampling.

use std::ops::Range;

use numerics::random::{SplitMix64, seed_of};
use rayon::prelude::*;

use super::{
    AttributionSampling, Attributions, ImportanceError, PredictionFunction, RowAttributions, TOGETHER, answers,
    attributions, both_rows, check_groups, group_of,
};
use crate::{
    draws,
    rows::{entries, finite_rows, setting},
};

/// The Shapley values of the prediction of each row. The value of a group is the mean change of the prediction when the
/// group's columns change from the values of the background row to the values of the row. The mean is over all orders
/// of the groups and all background rows [Strumbelj and Kononenko 2014; the background: Lundberg and Lee 2017,
/// (9)-(12)]. Orders are drawn anew for each background row, each together with its reverse [Mitchell et al. 2022,
/// "Sampling permutations for Shapley value estimation"]. The values of a row therefore always add up to its prediction
/// minus the base. For up to two groups the values are exact.
///
/// Cost: 2 `samples` (groups − 1) predictions for each row and background row.
///
/// # Errors
/// Fails for values that are not finite, a column that is not in exactly one group, or fewer than two samples. Also
/// fails if the model fails or returns anything but one finite number per row.
pub fn shapley_sampled<E: Send>(
    model: &PredictionFunction<'_, E>,
    rows: &[f64],
    background: &[f64],
    width: usize,
    groups: &[Vec<usize>],
    sampling: &AttributionSampling,
) -> Result<Attributions, ImportanceError<E>> {
    let (explained, count) = both_rows(rows, background, width)?;
    group_of::<E>(width, groups)?;
    setting("the number of samples", sampling.samples as f64, "at least 2", sampling.samples > 1)?;
    let (of_rows, of_background) = (answers(model, rows, width, 1)?, answers(model, background, width, 1)?);
    let base = of_background.iter().sum::<f64>() / count as f64;
    let all = ShapleySampler { model, background, width, groups, sampling, of_background: &of_background };
    let one = |row: usize| all.row(row, &rows[row * width..(row + 1) * width], of_rows[row]);
    attributions(base, (0..explained).into_par_iter().map(one).collect())
}

struct ShapleySampler<'a, E> {
    model: &'a PredictionFunction<'a, E>,
    background: &'a [f64],
    width: usize,
    groups: &'a [Vec<usize>],
    sampling: &'a AttributionSampling,
    of_background: &'a [f64],
}

impl<E> ShapleySampler<'_, E> {
    /// The Shapley values of a row and their errors; `found` is the prediction of the row.
    fn row(&self, number: usize, x: &[f64], found: f64) -> RowAttributions<E> {
        let (count, groups, samples) = (self.of_background.len(), self.groups.len(), self.sampling.samples);
        let each = 2 * samples * groups.saturating_sub(1);
        let step = (TOGETHER / each.max(1)).max(1);
        let (mut values, mut variances) = (vec![0.0; groups], vec![0.0; groups]);
        for first in (0..count).step_by(step) {
            let some = first..count.min(first + step);
            let orders: Vec<Vec<usize>> = some.clone().flat_map(|b| self.orders(number, b)).collect();
            let between = answers(self.model, &self.mixed(x, some.clone(), &orders), self.width, 1)?;
            for (at, b) in some.enumerate() {
                let orders = &orders[at * samples..(at + 1) * samples];
                let between = &between[at * each..(at + 1) * each];
                let parts = self.parts(orders, between, self.of_background[b], found);
                for (g, (value, variance)) in values.iter_mut().zip(&mut variances).enumerate() {
                    let mean = parts.iter().map(|p| p[g]).sum::<f64>() / samples as f64;
                    *value += mean;
                    *variance += parts.iter().map(|p| (p[g] - mean).powi(2)).sum::<f64>() / (samples as f64 - 1.0);
                }
            }
        }
        let n = count as f64;
        let errors = variances.iter().map(|v| (v / samples as f64).sqrt() / n).collect();
        Ok((values.iter().map(|v| v / n).collect(), errors))
    }

    fn orders(&self, number: usize, b: usize) -> Vec<Vec<usize>> {
        let seed = seed_of(self.sampling.seed, &["shapley", &number.to_string(), &b.to_string()]);
        let mut bits = SplitMix64::new(seed);
        (0..self.sampling.samples).map(|_| draws::shuffled(&mut bits, self.groups.len())).collect()
    }

    /// For each order, the rows on the path from the background row to `x`, followed by the rows on the path in the
    /// reverse order.
    fn mixed(&self, x: &[f64], some: Range<usize>, orders: &[Vec<usize>]) -> Vec<f64> {
        let mut out = vec![];
        for (b, orders) in some.zip(orders.chunks(self.sampling.samples)) {
            let background = &self.background[b * self.width..(b + 1) * self.width];
            for order in orders {
                self.way(x, background, order.iter(), &mut out);
                self.way(x, background, order.iter().rev(), &mut out);
            }
        }
        out
    }

    fn way<'g>(&self, x: &[f64], b: &[f64], order: impl ExactSizeIterator<Item = &'g usize>, out: &mut Vec<f64>) {
        let mut row = b.to_vec();
        let between = order.len().saturating_sub(1);
        for &group in order.take(between) {
            self.groups[group].iter().for_each(|&j| row[j] = x[j]);
            out.extend(&row);
        }
    }

    /// Contribution of each pair of orders to each group.
    fn parts(&self, orders: &[Vec<usize>], between: &[f64], from: f64, to: f64) -> Vec<Vec<f64>> {
        let steps = self.groups.len().saturating_sub(1);
        let pair = |(k, order): (usize, &Vec<usize>)| {
            let ways = &between[2 * k * steps..2 * (k + 1) * steps];
            let (there, back) = ways.split_at(steps);
            let mut parts = vec![0.0; self.groups.len()];
            let mut add = |order: &mut dyn Iterator<Item = &usize>, way: &[f64]| {
                let mut last = from;
                for (at, &group) in order.enumerate() {
                    let next = way.get(at).copied().unwrap_or(to);
                    parts[group] += 0.5 * (next - last);
                    last = next;
                }
            };
            add(&mut order.iter(), there);
            add(&mut order.iter().rev(), back);
            parts
        };
        orders.iter().enumerate().map(pair).collect()
    }
}

/// Shapley values of a linear model with the given coefficients, for independent features. The value of a group is the
/// sum over its columns of the coefficient times (value − mean), where `means` holds the means of the columns over the
/// background [Lundberg and Lee 2017, corollary 1]. Groups may overlap, and columns may be in no group.
///
/// # Errors
/// Fails for values that are not finite, the wrong number of values, or invalid groups.
pub fn shapley_linear(
    coefficients: &[f64],
    rows: &[f64],
    means: &[f64],
    groups: &[Vec<usize>],
) -> Result<Attributions, ImportanceError> {
    let width = coefficients.len();
    finite_rows("the coefficients", coefficients, width)?;
    finite_rows("the matrix of rows to explain", rows, width)?;
    entries("the means of the background", means.len(), width)?;
    finite_rows("the means of the background", means, width)?;
    check_groups(width, groups)?;
    let part =
        |x: &[f64], group: &Vec<usize>| -> f64 { group.iter().map(|&j| coefficients[j] * (x[j] - means[j])).sum() };
    let values: Vec<f64> = rows.chunks_exact(width).flat_map(|x| groups.iter().map(move |g| part(x, g))).collect();
    let base = coefficients.iter().zip(means).map(|(c, m)| c * m).sum();
    Ok(Attributions { base, errors: vec![0.0; values.len()], values })
}

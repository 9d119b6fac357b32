//! Sobol indices: shares of the variance of a prediction.

use numerics::random::{SplitMix64, seed_of};
use rayon::prelude::*;

use super::ranges::UnitCube;
use super::{ImportanceError, PredictionFunction};
use crate::{
    draws,
    rows::{entries, setting},
};

/// Number of bootstrap samples from which an interval is computed.
const RESAMPLES: usize = 1000;

/// Sampling of Sobol indices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SobolDesign {
    /// Number N of rows of each of the two matrices, at least 2. The model predicts (groups + 2) N rows.
    pub points: usize,
    /// Seed of the matrices and of the bootstrap.
    pub seed: u64,
}

/// An index with its bootstrap distribution over the rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SobolIndex {
    /// Share of the variance.
    pub value: f64,
    /// Standard deviation of the bootstrap distribution.
    pub error: f64,
    /// 2.5th and 97.5th percentile of the bootstrap distribution.
    pub interval: [f64; 2],
}

/// Indices of one group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SobolIndices {
    /// First-order index: share of the variance from the group alone.
    pub first: SobolIndex,
    /// Total index: share from the group and from all its interactions with other groups.
    pub total: SobolIndex,
}

/// Predictions of a sample of Sobol indices.
#[derive(Debug, Clone, PartialEq)]
pub struct SobolPredictions {
    /// Predictions of the matrix A.
    pub a: Vec<f64>,
    /// Predictions of the matrix B, independent of A.
    pub b: Vec<f64>,
    /// For each group, predictions of A with the columns of the group from B.
    pub mixed: Vec<Vec<f64>>,
}

/// Sobol indices of groups of columns that are uniform and independent over their `ranges` (lower and upper bound)
/// [Sobol 2001]. Let y_A and y_B be the predictions for the rows of the matrices A and B, and y_ABi the predictions for
/// A with the columns of group i from B. The indices are
///
/// ```text
/// S_i = mean(y_B (y_ABi − y_A))/V,     T_i = mean((y_A − y_ABi)²)/2V,     V = variance of y_A and y_B
/// ```
///
/// [Saltelli et al. 2010; Jansen 1999]. The mean of all predictions is subtracted first. The rows of A and B are
/// random, so the bootstrap over the rows gives the sampling error. An index may be slightly negative by chance.
///
/// # Errors
/// Fails for invalid ranges, groups or settings. Also fails with [`ImportanceError::Constant`] if the predictions are
/// equal. Also fails if the model fails or returns anything but one finite number per row.
pub fn sobol<E: Send>(
    model: &PredictionFunction<'_, E>,
    ranges: &[[f64; 2]],
    groups: &[Vec<usize>],
    design: &SobolDesign,
) -> Result<Vec<SobolIndices>, ImportanceError<E>> {
    let cube = UnitCube { model, ranges };
    cube.check(groups)?;
    setting("the number of points", design.points as f64, "at least 2", design.points >= 2)?;
    let (width, mut bits) = (ranges.len(), SplitMix64::new(seed_of(design.seed, &["sobol matrices"])));
    let [a, b] = [(); 2].map(|()| (0..design.points * width).map(|_| draws::uniform(&mut bits)).collect::<Vec<f64>>());
    let mixed = |group: &Vec<usize>| {
        let mut points = a.clone();
        for (to, from) in points.chunks_exact_mut(width).zip(b.chunks_exact(width)) {
            group.iter().for_each(|&column| to[column] = from[column]);
        }
        cube.predict(&points)
    };
    let mixed = groups.iter().map(mixed).collect::<Result<_, _>>()?;
    sobol_indices(&SobolPredictions { a: cube.predict(&a)?, b: cube.predict(&b)?, mixed }, design.seed)
}

/// Indices from predictions, with a seed of the bootstrap.
///
/// # Errors
/// Fails for predictions of different lengths. Also fails with [`ImportanceError::Constant`] if they are equal.
pub fn sobol_indices<E>(predictions: &SobolPredictions, seed: u64) -> Result<Vec<SobolIndices>, ImportanceError<E>> {
    let SobolPredictions { a, b, mixed } = predictions;
    let rows = a.len();
    entries("the predictions of B", b.len(), rows)?;
    mixed.iter().try_for_each(|mixed| entries("the predictions of a mixed matrix", mixed.len(), rows))?;
    setting("the number of rows", rows as f64, "at least 2", rows >= 2)?;
    let all = || [a, b].into_iter().chain(mixed).flatten();
    let mean = all().sum::<f64>() / all().count() as f64;
    if all().all(|y| *y == a[0]) {
        return Err(ImportanceError::Constant);
    }
    let whole: Vec<usize> = (0..rows).collect();
    let samples: Vec<Vec<usize>> = (0..RESAMPLES).map(|sample| resampled(seed, sample, rows)).collect();
    let one = |mixed: &Vec<f64>| {
        let of = |rows: &Vec<usize>| estimates([a, b, mixed], mean, rows);
        let [first, total] = of(&whole);
        let drawn: Vec<[f64; 2]> = samples.iter().map(of).collect();
        let index = |value: f64, which: usize| SobolIndex::new(value, drawn.iter().map(|pair| pair[which]).collect());
        SobolIndices { first: index(first, 0), total: index(total, 1) }
    };
    Ok(mixed.par_iter().map(one).collect())
}

/// First-order and total index, computed from a selection of rows.
fn estimates([a, b, mixed]: [&Vec<f64>; 3], mean: f64, rows: &[usize]) -> [f64; 2] {
    let count = rows.len() as f64;
    let (mut sum, mut squares, mut first, mut total) = (0.0, 0.0, 0.0, 0.0);
    for &row in rows {
        let [a, b, mixed] = [a[row] - mean, b[row] - mean, mixed[row] - mean];
        sum += a + b;
        squares += a * a + b * b;
        first += b * (mixed - a);
        total += (a - mixed) * (a - mixed);
    }
    let variance = squares / (2.0 * count) - (sum / (2.0 * count)).powi(2);
    [first / count / variance, 0.5 * total / count / variance]
}

/// Rows of a bootstrap sample.
fn resampled(seed: u64, sample: usize, rows: usize) -> Vec<usize> {
    let mut bits = SplitMix64::new(seed_of(seed, &["sobol bootstrap", &sample.to_string()]));
    (0..rows).map(|_| draws::below(&mut bits, rows)).collect()
}

impl SobolIndex {
    fn new(value: f64, mut drawn: Vec<f64>) -> Self {
        let count = drawn.len() as f64;
        let mean = drawn.iter().sum::<f64>() / count;
        let error = (drawn.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
        drawn.sort_by(f64::total_cmp);
        let at = |part: f64| drawn[(part * (count - 1.0)).round() as usize];
        Self { value, error, interval: [at(0.025), at(0.975)] }
    }
}

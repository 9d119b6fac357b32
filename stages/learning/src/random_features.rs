//! Random Fourier features of a Gaussian kernel with ridge regression: a Gaussian process of reduced rank, and a strong
//! classical baseline for networks.
//!
//! With frequencies w drawn from the spectrum of the kernel, N(0, 1/length²) in each column, consider the features
//! cos(w·x)/√k and sin(w·x)/√k of k frequencies. The expected inner product of the features of two rows is the kernel
//! exp(−|x − x'|²/(2 length²)) [Rahimi and Recht 2007; the pair instead of one cosine with a random phase: Sutherland
//! and Schneider 2015]. Frequencies are drawn in blocks, each with as many frequencies as there are columns. The
//! frequencies of a block are orthogonal, which reduces the error of the kernel [Yu et al. 2016]. If `linear` is above
//! 0, the columns are features too: this adds `linear`² x·x' to the kernel, a linear model plus the Gaussian process.
//!
//! The model is y = c + φ(x)·w + e, with independent weights of variance s², errors of variance σ², and a flat prior on
//! the constant c. With centred Φ and y, Φᵀ Φ = V D Vᵀ and λ = σ²/s²,
//!
//! ```text
//! w = (ΦᵀΦ + λ I)⁻¹ Φᵀ y        σ² = (yᵀy - yᵀΦ w)/(n - 1)
//! ln p(y|λ) = -½ ((n - 1) ln σ² + Σ ln(1 + dᵢ/λ)) + a constant
//! var f(x) = σ² (1/n + φ(x)ᵀ (ΦᵀΦ + λ I)⁻¹ φ(x))
//! ```
//!
//! The constant is integrated out, and σ² takes its most likely value for each λ [Rasmussen and Williams 2006, (2.11),
//! (2.30), section 5.4.1; the restricted likelihood: Patterson and Thompson 1971]. Correlated errors of successive
//! samples make both standard deviations too small.
//!
//! Between training rows and near the limits of their range, the standard deviation of the prediction grows to the
//! standard deviation of the prior. Far outside the range the features are periodic, and the mean does not return to
//! the constant.

mod spectrum;
#[cfg(test)]
mod tests;

use faer::{Accum, Mat, MatMut, MatRef, Par, linalg::matmul::matmul};
use numerics::{
    random::{NormalGenerator, SplitMix64, seed_of},
    regression::statistics::median,
};
use rayon::prelude::*;

use self::spectrum::{FeatureSpectrum, FeatureSums};
use crate::{
    draws,
    rows::{RowsError, entries, finite_rows, setting},
};

/// Rows per product.
const BLOCK: usize = 512;

/// Maximum number of rows for the comparison of lengths.
const COMPARED: usize = 4000;

/// Number of row pairs whose median distance is the middle of the candidate lengths.
const PAIRS: usize = 2000;

/// Candidate lengths, in median distances.
const LENGTHS: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];

/// Settings of a random-feature fit.
#[derive(Debug, Clone, PartialEq)]
pub struct RandomFeatureSettings {
    /// Number of random features: a cosine and a sine per frequency. An odd number is increased by one.
    pub features: usize,
    /// The length scale, in the unit of the columns. `None`: the most likely of 1/4, 1/2, 1, 2 and 4 times the median
    /// distance between rows, on up to 4000 rows.
    pub length: Option<f64>,
    /// Prior standard deviation of each column's coefficient, in standard deviations of the Gaussian process per unit
    /// of the column; 0 omits the columns.
    pub linear: f64,
    /// Ratio λ of the variances of the errors and of the Gaussian process; `None` for the most likely ratio.
    pub lambda: Option<f64>,
    /// The seed of the frequencies.
    pub seed: u64,
}

impl Default for RandomFeatureSettings {
    /// 500 features and the columns themselves, with the most likely length and λ.
    fn default() -> Self {
        Self { features: 500, length: None, linear: 1.0, lambda: None, seed: 0 }
    }
}

/// Fitted random-feature model.
#[derive(Debug, Clone, PartialEq)]
pub struct RandomFeatures {
    /// The number of columns.
    pub width: usize,
    /// The frequencies, row-major, one row per frequency, in radians per unit of each column.
    pub frequencies: Vec<f64>,
    /// The factor of the columns among the features; 0 if they are omitted.
    pub linear: f64,
    /// The mean of each feature over the training rows: cosines, sines, columns.
    pub means: Vec<f64>,
    /// The weight of each centred feature, in the unit of the target.
    pub weights: Vec<f64>,
    /// The mean of the target.
    pub intercept: f64,
    /// F, a square matrix with one row per feature, row-major: (ΦᵀΦ + λ I)⁻¹ = Fᵀ F.
    pub factor: Vec<f64>,
    /// σ², the variance of the errors, in the square of the target's unit.
    pub noise_variance: f64,
    /// The number of training rows.
    pub rows: usize,
    /// The length scale that was used.
    pub length: f64,
    /// The λ that was used.
    pub lambda: f64,
    /// ln p(y), up to a constant that depends only on the number of rows.
    pub log_likelihood: f64,
}

/// Error of a random-feature fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RandomFeatureError {
    /// Rows or settings are invalid.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// There are fewer than three rows.
    #[error("{rows} rows are too few; the variance of the errors requires at least 3")]
    TooFewRows {
        /// Number of rows.
        rows: usize,
    },
    /// The target does not vary.
    #[error("the target is constant")]
    ConstantTarget,
    /// All columns are constant.
    #[error("all rows are equal, so the length scale cannot be estimated; set it")]
    ConstantRows,
    /// The eigendecomposition of the products of features did not converge.
    #[error("the eigendecomposition of the products of features did not converge")]
    NotConverged,
}

/// Fits a model to rows `x` of `width` columns each and their targets `y`. The columns must be standardised or have the
/// same scale.
///
/// Cost for n rows and m features (with the columns): 2 n m² operations, and memory of a few times m² numbers.
///
/// # Errors
/// Fails for values that are not finite, settings out of range, fewer than three rows, a constant target, or equal rows
/// if the length is estimated. Also fails if the decomposition does not converge.
pub fn fit(
    x: &[f64],
    width: usize,
    y: &[f64],
    how: &RandomFeatureSettings,
) -> Result<RandomFeatures, RandomFeatureError> {
    let rows = finite_rows("the matrix", x, width)?;
    entries("the target", y.len(), rows)?;
    finite_rows("the target", y, 1)?;
    how.check()?;
    if rows < 3 {
        return Err(RandomFeatureError::TooFewRows { rows });
    }
    let intercept = crate::trees::mean(y);
    let y: Vec<f64> = y.iter().map(|y| y - intercept).collect();
    if y.iter().all(|y| y.abs() <= 1e-14 * intercept.abs()) {
        return Err(RandomFeatureError::ConstantTarget);
    }
    let directions = directions(width, how.features.div_ceil(2), how.seed);
    let length = match how.length {
        Some(length) => length,
        None => most_likely_length(x, width, &y, &directions, how)?,
    };
    let map = RandomFeatureMap::new(width, &directions, length, how.linear);
    let spectrum = FeatureSpectrum::from_sums(&FeatureSums::from_rows(&map, x, &y))?;
    let lambda = how.lambda.unwrap_or_else(|| spectrum.most_likely());
    let (weights, factor) = spectrum.solution(lambda);
    let (noise_variance, log_likelihood) = (spectrum.noise(lambda), spectrum.log_likelihood(lambda));
    let (frequencies, means) = (map.frequencies, spectrum.means);
    let linear = how.linear;
    Ok(RandomFeatures {
        width,
        frequencies,
        linear,
        means,
        weights,
        intercept,
        factor,
        noise_variance,
        rows,
        length,
        lambda,
        log_likelihood,
    })
}

impl RandomFeatureSettings {
    fn check(&self) -> Result<(), RowsError> {
        let above = |x: f64| x > 0.0 && x.is_finite();
        let count = self.features as f64;
        setting("the number of features", count, "2 to 10,000", (2..=10_000).contains(&self.features))?;
        self.length.map_or(Ok(()), |x| setting("the length scale", x, "above 0 and finite", above(x)))?;
        self.lambda.map_or(Ok(()), |x| setting("lambda", x, "above 0 and finite", above(x)))?;
        setting(
            "the prior standard deviation of the coefficients of the columns",
            self.linear,
            "at least 0 and finite",
            self.linear == 0.0 || above(self.linear),
        )
    }
}

impl RandomFeatures {
    /// Predictions of rows of `width` columns each, and the standard deviations of the function at these rows, both in
    /// the unit of the target. For the variance of a new reading, add `noise_variance`. NaN for rows that are not
    /// finite.
    ///
    /// # Errors
    /// Fails for an incomplete row. Also fails if the sizes of the model's parts do not match.
    pub fn predict(&self, x: &[f64]) -> Result<(Vec<f64>, Vec<f64>), RowsError> {
        let m = self.check(x)?;
        entries("the covariance factor", self.factor.len(), m * m)?;
        let factor = MatRef::from_row_major_slice(&self.factor, m, m);
        let least = 1.0 / self.rows.max(1) as f64;
        let made = self.blocks(x, |features, _| {
            let count = features.len() / m;
            let mut along = vec![0.0; count * m];
            let to = MatMut::from_row_major_slice_mut(&mut along, count, m);
            matmul(
                to,
                Accum::Replace,
                MatRef::from_row_major_slice(features, count, m),
                factor.transpose(),
                1.0,
                Par::Seq,
            );
            let deviation = |u: &[f64]| (self.noise_variance * (least + dot(u, u))).sqrt();
            (self.means_of(features), along.chunks_exact(m).map(deviation).collect::<Vec<_>>())
        });
        let (means, deviations): (Vec<_>, Vec<_>) = made.into_iter().unzip();
        Ok((means.concat(), deviations.concat()))
    }

    /// Predictions without standard deviations, which take less time.
    ///
    /// # Errors
    /// Returns the errors of [`RandomFeatures::predict`].
    pub fn mean(&self, x: &[f64]) -> Result<Vec<f64>, RowsError> {
        self.check(x)?;
        Ok(self.blocks(x, |features, _| self.means_of(features)).concat())
    }

    /// The derivatives of the predictions with respect to the columns, row by row, in the unit of the target per unit
    /// of the column.
    ///
    /// # Errors
    /// Returns the errors of [`RandomFeatures::predict`].
    pub fn gradient(&self, x: &[f64]) -> Result<Vec<f64>, RowsError> {
        self.check(x)?;
        let k = self.frequencies.len() / self.width;
        let (cosines, rest) = self.weights.split_at(k);
        let (sines, columns) = rest.split_at(k);
        let scale = 1.0 / (k as f64).sqrt();
        let made = self.blocks(x, |_, phases| {
            let count = phases.len() / k;
            let slope = |(phase, (c, s)): (&f64, (&f64, &f64))| {
                let (sin, cos) = phase.sin_cos();
                scale * (s * cos - c * sin)
            };
            let weights = || cosines.iter().zip(sines);
            let slopes: Vec<f64> =
                phases.chunks_exact(k).flat_map(|row| row.iter().zip(weights()).map(slope)).collect();
            let mut out = vec![0.0; count * self.width];
            let to = MatMut::from_row_major_slice_mut(&mut out, count, self.width);
            let frequencies = MatRef::from_row_major_slice(&self.frequencies, k, self.width);
            matmul(to, Accum::Replace, MatRef::from_row_major_slice(&slopes, count, k), frequencies, 1.0, Par::Seq);
            for row in out.chunks_exact_mut(self.width) {
                row.iter_mut().zip(columns).for_each(|(out, w)| *out += self.linear * w);
            }
            out
        });
        Ok(made.concat())
    }

    /// Checks the sizes and returns the number of features.
    fn check(&self, x: &[f64]) -> Result<usize, RowsError> {
        let width = self.width.max(1);
        entries("the matrix", x.len(), x.len() / width * width)?;
        let k = self.frequencies.len() / width;
        setting("the number of frequencies", k as f64, "at least 1", k > 0)?;
        entries("the frequencies", self.frequencies.len(), k * width)?;
        let m = 2 * k + if self.linear > 0.0 { self.width } else { 0 };
        entries("the means of the features", self.means.len(), m)?;
        entries("the weights", self.weights.len(), m)?;
        Ok(m)
    }

    fn means_of(&self, features: &[f64]) -> Vec<f64> {
        let rows = features.chunks_exact(self.weights.len().max(1));
        rows.map(|features| self.intercept + dot(features, &self.weights)).collect()
    }

    /// Applies `of` to the centred features and the phases, a block of rows at a time.
    fn blocks<T: Send>(&self, x: &[f64], of: impl Fn(&[f64], &[f64]) -> T + Sync) -> Vec<T> {
        let map = RandomFeatureMap { width: self.width, frequencies: self.frequencies.clone(), linear: self.linear };
        let block = |x: &[f64]| {
            let (mut features, phases) = map.features(x);
            for row in features.chunks_exact_mut(self.means.len().max(1)) {
                row.iter_mut().zip(&self.means).for_each(|(feature, mean)| *feature -= mean);
            }
            of(&features, &phases)
        };
        x.par_chunks(BLOCK * self.width.max(1)).map(block).collect()
    }
}

/// Random Fourier features of rows.
struct RandomFeatureMap {
    width: usize,
    frequencies: Vec<f64>,
    linear: f64,
}

impl RandomFeatureMap {
    fn new(width: usize, directions: &[f64], length: f64, linear: f64) -> Self {
        Self { width, frequencies: directions.iter().map(|w| w / length).collect(), linear }
    }

    fn count(&self) -> usize {
        2 * self.frequencies.len() / self.width + if self.linear > 0.0 { self.width } else { 0 }
    }

    /// Cosines, sines and columns row by row, and the phases w·x.
    fn features(&self, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (rows, k) = (x.len() / self.width, self.frequencies.len() / self.width);
        let mut phases = vec![0.0; rows * k];
        let to = MatMut::from_row_major_slice_mut(&mut phases, rows, k);
        let frequencies = MatRef::from_row_major_slice(&self.frequencies, k, self.width);
        let x_matrix = MatRef::from_row_major_slice(x, rows, self.width);
        matmul(to, Accum::Replace, x_matrix, frequencies.transpose(), 1.0, Par::Seq);
        let scale = 1.0 / (k as f64).sqrt();
        let m = self.count();
        let mut out = vec![0.0; rows * m];
        for ((out, phases), x) in out.chunks_exact_mut(m).zip(phases.chunks_exact(k)).zip(x.chunks_exact(self.width)) {
            let (cosines, rest) = out.split_at_mut(k);
            let (sines, columns) = rest.split_at_mut(k);
            for ((c, s), phase) in cosines.iter_mut().zip(sines).zip(phases) {
                let (sin, cos) = phase.sin_cos();
                (*c, *s) = (scale * cos, scale * sin);
            }
            columns.iter_mut().zip(x).for_each(|(out, x)| *out = self.linear * x);
        }
        (out, phases)
    }
}

/// Frequencies of a kernel of length 1, row by row: orthogonal in blocks of `width`, with the lengths of normal
/// vectors.
fn directions(width: usize, count: usize, seed: u64) -> Vec<f64> {
    let mut normals = NormalGenerator::new(seed_of(seed, &["frequencies"]));
    let mut out = Vec::with_capacity(count * width);
    while out.len() < count * width {
        let drawn = Mat::from_fn(width, width, |_, _| normals.draw());
        let q = drawn.qr().compute_thin_Q();
        for i in 0..width.min(count - out.len() / width) {
            let length = (0..width).map(|_| normals.draw().powi(2)).sum::<f64>().sqrt();
            out.extend((0..width).map(|j| length * q[(j, i)]));
        }
    }
    out
}

fn most_likely_length(
    x: &[f64],
    width: usize,
    y: &[f64],
    directions: &[f64],
    how: &RandomFeatureSettings,
) -> Result<f64, RandomFeatureError> {
    let rows = y.len();
    let mut bits = SplitMix64::new(seed_of(how.seed, &["pairs"]));
    let mut row = || {
        let at = draws::below(&mut bits, rows) * width;
        &x[at..at + width]
    };
    let distance = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    let mut distances: Vec<f64> = (0..PAIRS).map(|_| distance(row(), row())).filter(|d| *d > 0.0).collect();
    let middle = median(&mut distances);
    if !(middle > 0.0 && middle.is_finite()) {
        return Err(RandomFeatureError::ConstantRows);
    }
    let some = rows.min(COMPARED);
    let picked = || (0..some).map(|k| (k as u128 * rows as u128 / some as u128) as usize);
    let few: Vec<f64> = picked().flat_map(|i| x[i * width..(i + 1) * width].iter().copied()).collect();
    let targets: Vec<f64> = picked().map(|i| y[i]).collect();
    let targets = about_mean(&targets);
    let likelihood = |factor: f64| {
        let map = RandomFeatureMap::new(width, directions, factor * middle, how.linear);
        let spectrum = FeatureSpectrum::from_sums(&FeatureSums::from_rows(&map, &few, &targets))?;
        let lambda = how.lambda.unwrap_or_else(|| spectrum.most_likely());
        Ok((factor * middle, spectrum.log_likelihood(lambda)))
    };
    let tried: Vec<Result<(f64, f64), RandomFeatureError>> = LENGTHS.into_par_iter().map(likelihood).collect();
    let tried: Vec<(f64, f64)> = tried.into_iter().collect::<Result<_, _>>()?;
    let best = tried.into_iter().reduce(|a, b| if b.1 > a.1 { b } else { a });
    best.map(|(length, _)| length).ok_or(RandomFeatureError::ConstantRows)
}

fn about_mean(y: &[f64]) -> Vec<f64> {
    let mean = crate::trees::mean(y);
    y.iter().map(|y| y - mean).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

//! Sums of random features over rows, their eigendecomposition, and the most likely ratio of the variances.

use std::ops::Range;

use faer::{
    Accum, Mat, MatRef, Par, Side,
    linalg::matmul::triangular::{BlockStructure, matmul as triangular},
};
use rayon::prelude::*;

use super::{BLOCK, RandomFeatureError, RandomFeatureMap};
use crate::rows::sum_of;

/// Number of row ranges with separate sums; fixed, so that sums do not depend on the number of threads.
const LANES: usize = 4;

/// Sums over rows of the features, their products, and their products with the centred target.
pub(super) struct FeatureSums {
    rows: usize,
    /// The sum of the products of two features; the lower triangle.
    products: Mat<f64>,
    /// The sum of the products of each feature with the target.
    along: Vec<f64>,
    features: Vec<f64>,
    squares: f64,
}

impl FeatureSums {
    pub(super) fn from_rows(map: &RandomFeatureMap, x: &[f64], y: &[f64]) -> Self {
        let rows = y.len();
        let lane = |l: usize| Self::lane(map, x, y, l * rows / LANES..(l + 1) * rows / LANES);
        let lanes: Vec<(Mat<f64>, Vec<f64>, Vec<f64>)> = (0..LANES).into_par_iter().map(lane).collect();
        let m = map.count();
        let (mut products, mut along, mut features) = (Mat::zeros(m, m), vec![0.0; m], vec![0.0; m]);
        for (p, a, f) in lanes {
            products += p;
            along.iter_mut().zip(a).for_each(|(sum, a)| *sum += a);
            features.iter_mut().zip(f).for_each(|(sum, f)| *sum += f);
        }
        Self { rows, products, along, features, squares: sum_of(rows, |i| y[i] * y[i]) }
    }

    fn lane(map: &RandomFeatureMap, x: &[f64], y: &[f64], range: Range<usize>) -> (Mat<f64>, Vec<f64>, Vec<f64>) {
        let m = map.count();
        let (mut products, mut along, mut sums) = (Mat::zeros(m, m), vec![0.0; m], vec![0.0; m]);
        let (lower, whole) = (BlockStructure::TriangularLower, BlockStructure::Rectangular);
        let (x, y) = (&x[range.start * map.width..range.end * map.width], &y[range]);
        for (x, y) in x.chunks(BLOCK * map.width).zip(y.chunks(BLOCK)) {
            let (features, _) = map.features(x);
            let phi = MatRef::from_row_major_slice(&features, y.len(), m);
            triangular(&mut products, lower, Accum::Add, phi.transpose(), whole, phi, whole, 1.0, Par::Seq);
            for (row, y) in features.chunks_exact(m).zip(y) {
                along.iter_mut().zip(row).for_each(|(sum, f)| *sum += f * y);
                sums.iter_mut().zip(row).for_each(|(sum, f)| *sum += f);
            }
        }
        (products, along, sums)
    }
}

/// Eigendecomposition of the centred products of the features.
pub(super) struct FeatureSpectrum {
    rows: usize,
    pub(super) means: Vec<f64>,
    vectors: Mat<f64>,
    values: Vec<f64>,
    /// Vᵀ Φᵀ y.
    along: Vec<f64>,
    squares: f64,
}

impl FeatureSpectrum {
    pub(super) fn from_sums(sums: &FeatureSums) -> Result<Self, RandomFeatureError> {
        let n = sums.rows as f64;
        let means: Vec<f64> = sums.features.iter().map(|f| f / n).collect();
        let about = Mat::from_fn(means.len(), means.len(), |i, j| {
            if i >= j { sums.products[(i, j)] - n * means[i] * means[j] } else { 0.0 }
        });
        let found = about.self_adjoint_eigen(Side::Lower).map_err(|_| RandomFeatureError::NotConverged)?;
        let values: Vec<f64> = found.S().column_vector().iter().map(|d| d.max(0.0)).collect();
        let vectors = found.U().to_owned();
        // The target is centred, so the features need not be.
        let along =
            (0..means.len()).map(|j| vectors.col(j).iter().zip(&sums.along).map(|(v, a)| v * a).sum()).collect();
        Ok(Self { rows: sums.rows, means, vectors, values, along, squares: sums.squares })
    }

    /// (yᵀy − yᵀΦ w)/(n − 1), but at least the level of rounding.
    pub(super) fn noise(&self, lambda: f64) -> f64 {
        let explained: f64 = self.along.iter().zip(&self.values).map(|(c, d)| c * c / (d + lambda)).sum();
        (self.squares - explained).max(f64::EPSILON * self.squares) / (self.rows as f64 - 1.0)
    }

    pub(super) fn log_likelihood(&self, lambda: f64) -> f64 {
        let volume: f64 = self.values.iter().map(|d| (d / lambda).ln_1p()).sum();
        -0.5 * ((self.rows as f64 - 1.0) * self.noise(lambda).ln() + volume)
    }

    /// The most likely λ between 1e-12 and 1e3 of the largest eigenvalue: the best point of a grid, refined.
    pub(super) fn most_likely(&self) -> f64 {
        let largest = self.values.iter().copied().fold(f64::MIN_POSITIVE.sqrt(), f64::max);
        let (low, high) = ((1e-12 * largest).ln(), (1e3 * largest).ln());
        let step = (high - low) / 100.0;
        let of = |ln: f64| self.log_likelihood(ln.exp());
        let grid = (0..=100).map(|k| low + step * f64::from(k)).map(|ln| (ln, of(ln)));
        let best = grid.reduce(|a, b| if b.1 > a.1 { b } else { a }).map_or(low, |(ln, _)| ln);
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        let (mut a, mut b) = (best - step, best + step);
        while b - a > 1e-6 {
            let (left, right) = (b - golden * (b - a), a + golden * (b - a));
            if of(left) < of(right) { a = left } else { b = right }
        }
        (0.5 * (a + b)).exp()
    }

    /// The weights, and a factor of the covariance of the weights.
    pub(super) fn solution(&self, lambda: f64) -> (Vec<f64>, Vec<f64>) {
        let m = self.means.len();
        let scaled: Vec<f64> = self.along.iter().zip(&self.values).map(|(c, d)| c / (d + lambda)).collect();
        let weight = |i: usize| (0..m).map(|j| self.vectors[(i, j)] * scaled[j]).sum();
        let roots: Vec<f64> = self.values.iter().map(|d| (d + lambda).sqrt().recip()).collect();
        let factor = (0..m).flat_map(|j| (0..m).map(move |i| (i, j)));
        ((0..m).map(weight).collect(), factor.map(|(i, j)| self.vectors[(i, j)] * roots[j]).collect())
    }
}

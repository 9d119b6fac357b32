//! Scaling of a model's inputs: subtraction of the mean, division by the standard deviation, and optional whitened
//! principal components. [Gnadt 2022, section 4.9]

use numerics::regression::least_squares::{ColumnScaling, LeastSquaresError, RegressionMoments};
use numerics::regression::principal_components::{ComponentCount, PrincipalComponents};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Rows per partial sum; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;
/// A column varies only by the rounding of its mean if its standard deviation is at most this fraction of the mean.
pub(crate) const LEAST_DEVIATION: f64 = 1e-12;
/// A component is rounding error if its standard deviation is at most this fraction of the largest standard deviation.
pub(crate) const LEAST_COMPONENT: f64 = 1e-7;

/// Error of columns that cannot be inputs.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InputScalingError {
    /// There are too few rows for a standard deviation.
    #[error("standardising the inputs requires at least two rows, but there are {rows}")]
    TooFewRows {
        /// The number of rows.
        rows: usize,
    },
    /// The number of values is not a multiple of the number of columns.
    #[error("{given} values are not a whole number of rows of {width} columns")]
    Shape {
        /// The number of values.
        given: usize,
        /// The number of columns.
        width: usize,
    },
    /// A value is NaN or infinite.
    #[error("the value of input column {column} in row {row} (both from 0) is not finite; remove such rows")]
    NotFinite {
        /// The row, from 0.
        row: usize,
        /// The column, from 0.
        column: usize,
    },
    /// Columns are constant.
    #[error("input columns {columns:?} (counted from 0) are constant; remove them")]
    Constant {
        /// The columns, from 0.
        columns: Vec<usize>,
    },
    /// The number of components, or the fraction of the variance, is out of range.
    #[error(
        "the number of components must be 1 to {width}, or a fraction of the variance between 0 and 1, but is {given}"
    )]
    Keep {
        /// Requested value.
        given: f64,
        /// The number of columns.
        width: usize,
    },
    /// The decomposition fails.
    #[error(transparent)]
    Components(#[from] LeastSquaresError),
}

/// Whitened principal components of standardised columns.
#[derive(Debug, Clone, PartialEq)]
pub struct WhitenedComponents {
    /// The number of components.
    pub count: usize,
    /// The weights of the standardised columns, `count` by columns, row-major. The weights include the whitening: each
    /// component has a variance of 1 over the rows from which the weights are computed.
    pub weights: Vec<f64>,
    /// Fraction of the variance of the standardised columns that the components contain.
    pub explained: f64,
}

/// Standardisation of columns, and the principal components computed from them.
#[derive(Debug, Clone, PartialEq)]
pub struct InputScaling {
    /// The mean of each column, in its unit.
    pub mean: Vec<f64>,
    /// The standard deviation of each column (n − 1), in its unit.
    pub scale: Vec<f64>,
    /// The components, if the inputs of the model are components.
    pub components: Option<WhitenedComponents>,
}

impl InputScaling {
    /// Scaling by mean and standard deviation (n − 1) of rows of `width` columns, row-major.
    ///
    /// # Errors
    /// Fails for an incomplete row, fewer than two rows, values that are not finite, or constant columns.
    pub fn standardised(x: &[f64], width: usize) -> Result<Self, InputScalingError> {
        if width == 0 || !x.len().is_multiple_of(width) {
            return Err(InputScalingError::Shape { given: x.len(), width });
        }
        let rows = x.len() / width;
        if rows < 2 {
            return Err(InputScalingError::TooFewRows { rows });
        }
        if let Some(place) = x.par_iter().position_first(|x| !x.is_finite()) {
            return Err(InputScalingError::NotFinite { row: place / width, column: place % width });
        }
        // Sums are relative to the first row, so that a large mean does not reduce the precision.
        let first = &x[..width];
        let offset = column_sums(x, width, |x, j| x - first[j]);
        let mean: Vec<f64> = offset.iter().zip(first).map(|(sum, first)| first + sum / rows as f64).collect();
        let squares = column_sums(x, width, |x, j| (x - mean[j]) * (x - mean[j]));
        let scale: Vec<f64> = squares.iter().map(|sum| (sum / (rows as f64 - 1.0)).sqrt()).collect();
        let varies = |j: &usize| scale[*j] > LEAST_DEVIATION * mean[*j].abs() && scale[*j].is_finite();
        let columns: Vec<usize> = (0..width).filter(|j| !varies(j)).collect();
        if columns.is_empty() {
            Ok(Self { mean, scale, components: None })
        } else {
            Err(InputScalingError::Constant { columns })
        }
    }

    /// This scaling, followed by whitened principal components of `x`. `x` must be the rows from which the scaling was
    /// computed. A `keep` of at least 1 is the number of components; below 1 it is the minimum fraction of the
    /// variance. Components with a standard deviation below 1e-7 of the largest are rounding errors and are always
    /// omitted.
    ///
    /// # Errors
    /// Fails for an invalid `keep`, or for more components than columns. Also fails if the decomposition does not
    /// converge.
    pub fn whitened(self, x: &[f64], keep: f64) -> Result<Self, InputScalingError> {
        let width = self.mean.len();
        let counted = keep >= 1.0 && keep <= width as f64 && keep.fract() == 0.0;
        if !(counted || (keep > 0.0 && keep < 1.0)) {
            return Err(InputScalingError::Keep { given: keep, width });
        }
        let kept = if counted { ComponentCount::Count(keep as usize) } else { ComponentCount::Variance(keep) };
        let found = PrincipalComponents::from_moments(
            &RegressionMoments::from_matrix(x, width, &[])?,
            ColumnScaling::Standardise,
            kept,
            true,
        )?;
        let largest = found.variances.first().copied().unwrap_or(0.0);
        let real = |variance: &&f64| **variance > LEAST_COMPONENT * LEAST_COMPONENT * largest;
        let count = found.variances.iter().take_while(real).count();
        let of = |(direction, variance): (&Vec<f64>, &f64)| -> Vec<f64> {
            direction.iter().map(|d| d / variance.sqrt()).collect()
        };
        let weights = found.directions.iter().zip(&found.variances).take(count).flat_map(of).collect();
        Ok(Self { components: Some(WhitenedComponents { count, weights, explained: found.explained }), ..self })
    }

    /// The number of inputs of a row after [`apply`](Self::apply).
    pub fn width(&self) -> usize {
        self.components.as_ref().map_or(self.mean.len(), |components| components.count)
    }

    /// Model inputs computed from rows of column values, row-major. A value that is not finite in a row gives NaN in
    /// every input that depends on the value. Values after the last whole row are ignored.
    pub fn apply(&self, x: &[f64]) -> Vec<f64> {
        let (columns, width) = (self.mean.len().max(1), self.width().max(1));
        let rows = x.len() / columns;
        let mut out = vec![0.0; rows * width];
        // The loop is over columns, so that a SIMD vector holds a column of weights and the sums are in column order.
        let weights: Option<Vec<f64>> = self.components.as_ref().map(|components| {
            (0..columns * width).map(|k| components.weights[k % width * columns + k / width]).collect()
        });
        let chunks = x[..rows * columns].par_chunks(CHUNK * columns).zip(out.par_chunks_mut(CHUNK * width));
        chunks.for_each(|(x, out)| {
            pulp::Arch::new().dispatch(InputScalingKernel {
                mean: &self.mean,
                scale: &self.scale,
                weights: weights.as_deref(),
                x,
                out,
            });
        });
        out
    }
}

/// Vectorised computation of rows of inputs from rows of column values.
struct InputScalingKernel<'a> {
    mean: &'a [f64],
    scale: &'a [f64],
    /// The weights of the components, a row for each column.
    weights: Option<&'a [f64]>,
    x: &'a [f64],
    out: &'a mut [f64],
}

// This is a struct, because a closure of this size would not be inlined and compiled for wide vectors.
impl WithSimd for InputScalingKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { mean, scale, weights, x, out } = self;
        let columns = mean.len().max(1);
        let width = weights.map_or(columns, |weights| weights.len() / columns);
        let mut scaled = vec![0.0; columns];
        for (row, out) in x.chunks_exact(columns).zip(out.chunks_exact_mut(width.max(1))) {
            for (z, (x, (mean, scale))) in scaled.iter_mut().zip(row.iter().zip(mean.iter().zip(scale))) {
                *z = (x - mean) / scale;
            }
            let Some(weights) = weights else {
                out.copy_from_slice(&scaled);
                continue;
            };
            // A sum that starts from -0 instead of 0 is bit-identical to the sum of the terms alone, even if these are
            // -0.
            out.fill(-0.0);
            for (x, weights) in scaled.iter().zip(weights.chunks_exact(width.max(1))) {
                for (out, w) in out.iter_mut().zip(weights) {
                    *out += w * x;
                }
            }
        }
    }
}

/// Sums a function of each value and its column over the rows, and returns one sum per column.
fn column_sums(x: &[f64], width: usize, of: impl Fn(f64, usize) -> f64 + Sync) -> Vec<f64> {
    let part = |rows: &[f64]| {
        let mut sums = vec![0.0; width];
        for row in rows.chunks_exact(width) {
            sums.iter_mut().zip(row).enumerate().for_each(|(j, (sum, x))| *sum += of(*x, j));
        }
        sums
    };
    let parts: Vec<Vec<f64>> = x.par_chunks(CHUNK * width).map(part).collect();
    let mut sums = vec![0.0; width];
    parts.iter().for_each(|part| sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += part));
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of three columns of unequal size. The third is the sum of the others plus a small independent part.
    fn rows(count: usize, own: f64) -> Vec<f64> {
        let row = |i: usize| {
            let t = i as f64;
            let (a, b) = ((0.37 * t).sin(), (1.7 * t).cos() + 0.1 * (0.37 * t).sin());
            [50_000.0 + 30.0 * a, 1e-3 * b, a + b + own * (2.9 * t).sin()]
        };
        (0..count).flat_map(row).collect()
    }

    fn variance(x: &[f64], width: usize, j: usize, k: usize) -> f64 {
        let rows = (x.len() / width) as f64;
        let mean = |j: usize| x.iter().skip(j).step_by(width).sum::<f64>() / rows;
        let (a, b) = (mean(j), mean(k));
        x.chunks_exact(width).map(|row| (row[j] - a) * (row[k] - b)).sum::<f64>() / (rows - 1.0)
    }

    #[test]
    fn law_standardised_columns_have_unit_variance_and_whitened_ones_no_covariance() {
        let x = rows(10_000, 0.1);
        let inputs = InputScaling::standardised(&x, 3).unwrap();
        let z = inputs.apply(&x);
        for j in 0..3 {
            assert!((variance(&z, 3, j, j) - 1.0).abs() < 1e-10);
            assert!(z.iter().skip(j).step_by(3).sum::<f64>().abs() < 1e-6);
        }
        let whitened = inputs.whitened(&x, 3.0).unwrap();
        let z = whitened.apply(&x);
        for j in 0..3 {
            for k in 0..3 {
                let expected = if j == k { 1.0 } else { 0.0 };
                assert!((variance(&z, 3, j, k) - expected).abs() < 1e-8, "{j} {k}");
            }
        }
    }

    #[test]
    fn unit_kept_components_are_a_number_or_a_fraction_of_the_variance() {
        let x = rows(5_000, 0.1);
        let inputs = InputScaling::standardised(&x, 3).unwrap();
        assert_eq!(inputs.clone().whitened(&x, 2.0).unwrap().width(), 2);
        let most = inputs.clone().whitened(&x, 0.99).unwrap();
        assert_eq!(most.width(), 2);
        assert!(most.components.unwrap().explained >= 0.99);
        for keep in [0.0, -1.0, 2.5, 4.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(inputs.clone().whitened(&x, keep), Err(InputScalingError::Keep { .. })), "{keep}");
        }
        let dependent = rows(5_000, 0.0);
        let inputs = InputScaling::standardised(&dependent, 3).unwrap();
        assert_eq!(inputs.whitened(&dependent, 3.0).unwrap().width(), 2);
    }

    #[test]
    fn unit_constant_columns_are_reported() {
        let mut x = rows(100, 0.1);
        x.chunks_exact_mut(3).for_each(|row| (row[0], row[2]) = (51_234.567, 0.0));
        assert_eq!(InputScaling::standardised(&x, 3), Err(InputScalingError::Constant { columns: vec![0, 2] }));
        x[7] = f64::NAN;
        assert_eq!(InputScaling::standardised(&x, 3), Err(InputScalingError::NotFinite { row: 2, column: 1 }));
        assert_eq!(InputScaling::standardised(&x[..3], 3), Err(InputScalingError::TooFewRows { rows: 1 }));
        assert_eq!(InputScaling::standardised(&[], 3), Err(InputScalingError::TooFewRows { rows: 0 }));
        assert!(matches!(InputScaling::standardised(&x[..4], 3), Err(InputScalingError::Shape { .. })));
        assert!(matches!(InputScaling::standardised(&x, 0), Err(InputScalingError::Shape { .. })));
    }

    #[test]
    fn unit_results_are_bit_identical_on_one_and_three_threads() {
        let x = rows(20_000, 0.1);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let inputs = InputScaling::standardised(&x, 3).unwrap().whitened(&x, 0.999).unwrap();
                let z = inputs.apply(&x);
                (inputs, z)
            })
        };
        assert_eq!(on(1), on(3));
    }
}

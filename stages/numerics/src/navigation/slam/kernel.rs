//! Gaussian process of the anomaly along a path, and its prediction from a few samples.

use crate::navigation::ins_error::{ParameterError, require};
use params::{Rule, choice};

/// Maximum number of samples in a prediction.
pub const MOST_NEIGHBOURS: usize = 24;
/// Rows of the bordered system: the samples, the predicted point, and the values.
const ROWS: usize = MOST_NEIGHBOURS + 2;
/// Standard deviation of the unknown mean about the mean of the samples, in standard deviations of the process.
const MEAN_SIGMAS: f64 = 10.0;

choice! {
    /// Covariance function of the anomaly over distance.
    #[derive(Default)]
    pub enum CovarianceFunction {
        /// σ² (1 + √5 d/l + 5d²/3l²) exp(−√5 d/l): twice differentiable, with the roughness of fields near their
        /// sources.
        #[default]
        Matern52 = "matern_5_2",
        /// σ² (1 + √3 d/l) exp(−√3 d/l): once differentiable.
        Matern32 = "matern_3_2",
        /// σ² exp(−d²/2l²): smoother than any field with sources. [Lee 2019, (43)]
        SquaredExponential = "squared_exponential",
    }
}

/// Covariance of the anomaly, with white noise. [Lee 2019, (45)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnomalyKernel {
    /// Covariance function.
    pub covariance: CovarianceFunction,
    /// Standard deviation of the anomaly about its mean, in nT.
    pub sigma_se_nt: f64,
    /// Correlation length l, in metres.
    pub length_m: f64,
    /// Standard deviation of the white part of the anomaly, in addition to the measurement noise, in nT.
    pub sigma_n_nt: f64,
}

impl Default for AnomalyKernel {
    /// Kernel of the Louisa flight. [Lee 2019, appendix A.1.2]
    fn default() -> Self {
        Self { covariance: CovarianceFunction::default(), sigma_se_nt: 50.0, length_m: 150.0, sigma_n_nt: 1.0 }
    }
}

impl AnomalyKernel {
    /// Rejects an invalid kernel.
    ///
    /// # Errors
    /// Fails if the standard deviation of the process or the length is not above 0, or if the noise is negative or not
    /// finite.
    pub fn check(&self) -> Result<(), ParameterError> {
        require("sigma_se_nt", self.sigma_se_nt, Rule::Positive)?;
        require("length_m", self.length_m, Rule::Positive)?;
        require("sigma_n_nt", self.sigma_n_nt, Rule::NotNegative)
    }

    /// Covariance of the anomaly at two points as a function of their squared distance, in nT².
    #[inline(always)]
    pub fn anomaly_nt2(&self, distance2_m2: f64) -> f64 {
        let (power, squared) = (self.sigma_se_nt * self.sigma_se_nt, distance2_m2 / (self.length_m * self.length_m));
        match self.covariance {
            CovarianceFunction::SquaredExponential => power * (-0.5 * squared).exp(),
            CovarianceFunction::Matern52 => {
                let d = (5.0 * squared).sqrt();
                power * (1.0 + d + d * d / 3.0) * (-d).exp()
            }
            CovarianceFunction::Matern32 => {
                let d = (3.0 * squared).sqrt();
                power * (1.0 + d) * (-d).exp()
            }
        }
    }

    /// Derivatives of the covariance with respect to the vector d between the two points. The gradient is −`first` d,
    /// the matrix of second derivatives is `second` d dᵀ − `first` I, and the derivative with respect to the logarithm
    /// of the length is `first` |d|².
    #[inline(always)]
    pub(super) fn bends(&self, distance2_m2: f64) -> DistanceDerivatives {
        let (power, per_m2) = (self.sigma_se_nt * self.sigma_se_nt, 1.0 / (self.length_m * self.length_m));
        let squared = distance2_m2 * per_m2;
        match self.covariance {
            CovarianceFunction::SquaredExponential => {
                let first = power * per_m2 * (-0.5 * squared).exp();
                DistanceDerivatives { first, second: first * per_m2 }
            }
            CovarianceFunction::Matern52 => {
                let d = (5.0 * squared).sqrt();
                let fallen = 5.0 / 3.0 * power * per_m2 * (-d).exp();
                DistanceDerivatives { first: fallen * (1.0 + d), second: 5.0 * fallen * per_m2 }
            }
            CovarianceFunction::Matern32 => {
                let d = (3.0 * squared).sqrt();
                let first = 3.0 * power * per_m2 * (-d).exp();
                // `second` d dᵀ is 0 at zero distance, where `second` has no limit.
                let second = if d > 0.0 { 3.0 * first * per_m2 / d } else { 0.0 };
                DistanceDerivatives { first, second }
            }
        }
    }

    /// Variance of a sample due to a difference in height, in nT².
    ///
    /// The anomaly is a potential field, so its vertical derivative has the factor |k| in the spectrum. The variance of
    /// the derivative is E|k|² σ², which is the negative Laplacian of the covariance at zero distance: 2σ²/l² for the
    /// squared exponential, 10σ²/3l² for `Matern52` and 6σ²/l² for `Matern32`.
    pub fn height_nt2(&self, height_m: f64) -> f64 {
        let laplacian = match self.covariance {
            CovarianceFunction::SquaredExponential => 2.0,
            CovarianceFunction::Matern52 => 10.0 / 3.0,
            CovarianceFunction::Matern32 => 6.0,
        };
        laplacian * (self.sigma_se_nt * height_m / self.length_m).powi(2)
    }

    /// Variance of the unknown mean, in nT².
    #[inline(always)]
    pub fn mean_nt2(&self) -> f64 {
        (MEAN_SIGMAS * self.sigma_se_nt).powi(2)
    }
}

/// Factors of the derivatives of the covariance with respect to the distance vector.
#[derive(Clone, Copy, Debug)]
pub(super) struct DistanceDerivatives {
    /// In nT²/m².
    pub(super) first: f64,
    /// In nT²/m⁴.
    pub(super) second: f64,
}

/// Prediction at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KrigingPrediction {
    /// Mean, in nT.
    pub value_nt: f64,
    /// Variance of the field at the point, without measurement noise, in nT².
    pub variance_nt2: f64,
}

/// Covariances of a few samples and a point, bordered by the samples' values. After elimination of the samples, the
/// diagonal holds the variance of the point, and the off-diagonal entry holds its negative mean. Only the lower
/// triangle is used, stored by columns.
pub struct BorderedCovariance {
    columns: [[f64; ROWS]; ROWS],
    samples: usize,
}

impl BorderedCovariance {
    /// Problem with at most [`MOST_NEIGHBOURS`] samples; further samples are ignored.
    pub fn new(samples: usize) -> Self {
        Self { columns: [[0.0; ROWS]; ROWS], samples: samples.min(MOST_NEIGHBOURS) }
    }

    /// Sets the covariances of all pairs of samples. An index equal to the number of samples denotes the point.
    pub fn fill(&mut self, covariance: impl Fn(usize, usize) -> f64, value: impl Fn(usize) -> f64) {
        let n = self.samples;
        for column in 0..=n {
            for row in column..=n {
                self.columns[column][row] = covariance(row, column);
            }
            self.columns[column][n + 1] = if column < n { value(column) } else { 0.0 };
        }
    }

    /// Mean and variance of the point, by elimination without square roots; `None` if the covariance of the samples is
    /// not positive. [Lee 2019, (51), (52)]
    pub fn solve(mut self) -> Option<KrigingPrediction> {
        let n = self.samples;
        for pivot in 0..n {
            let (done, rest) = self.columns.split_at_mut(pivot + 1);
            let column = &done[pivot];
            let scale = 1.0 / column[pivot];
            // The comparison is also false for NaN.
            let positive = column[pivot] > 0.0;
            if !positive || !scale.is_finite() {
                return None;
            }
            for (target, offset) in rest[..n - pivot].iter_mut().zip(pivot + 1..) {
                let factor = column[offset] * scale;
                for (entry, from) in target[offset..n + 2].iter_mut().zip(&column[offset..n + 2]) {
                    *entry -= factor * from;
                }
            }
        }
        let (value_nt, variance_nt2) = (-self.columns[n][n + 1], self.columns[n][n]);
        (value_nt.is_finite() && variance_nt2.is_finite())
            .then_some(KrigingPrediction { value_nt, variance_nt2: variance_nt2.max(0.0) })
    }
}

//! Likelihood of all measurements given the path, with the map integrated out, and its derivatives.

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::{Accum, Mat, MatRef, Par, Side};
use rayon::prelude::*;

use crate::navigation::slam::kernel::AnomalyKernel;

/// Number of matrix columns per task. The order of sums does not depend on the number of threads.
const BLOCK: usize = 64;

/// Measurement, averaged over a short distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlamMeasurement {
    /// Mean time, in seconds.
    pub tt_s: f64,
    /// Mean position of the INS, north and east, in metres.
    pub at_m: [f64; 2],
    /// Measurement minus the core field at the INS, in nT.
    pub value_nt: f64,
    /// Variance of the white noise of the measurement, in nT², including the contribution of its height and excluding
    /// the noise of the kernel.
    pub variance_nt2: f64,
    /// Gradient of the core field north and east, in nT/m.
    pub core_nt_per_m: [f64; 2],
}

/// Measurements of a line, and the quantities that do not depend on the path.
pub struct SlamProblem {
    /// Measurements, in the order of time.
    pub measured: Vec<SlamMeasurement>,
    /// Basis functions at the measurements, with 2 rows per measurement, north and east; the product of the functions
    /// with the weights is the displacement in metres.
    pub functions: Mat<f64>,
    /// Standard deviation (nT) and time constant (s) of the temporal variation.
    pub temporal: (f64, f64),
    /// Variance of the field's unknown mean about `centre_nt`, in nT².
    pub mean_nt2: f64,
    /// Constant subtracted from all measurements, in nT.
    pub centre_nt: f64,
}

/// Cholesky factor of the covariance of the measurements along a path.
pub struct PathCovarianceFactor {
    positions_m: Vec<[f64; 2]>,
    residual_nt: Vec<f64>,
    factor: Llt<f64>,
    /// Minus the logarithm of the likelihood, up to a constant.
    pub cost: f64,
    /// rᵀ C⁻¹ r, whose expected value is the number of measurements.
    pub square: f64,
}

/// Derivatives of the cost.
pub struct CostDerivatives {
    /// Gradient with respect to the weights.
    pub gradient: Vec<f64>,
    /// Second derivatives with respect to the weights.
    pub hessian: Mat<f64>,
}

/// Derivatives with respect to the logarithms of the kernel's standard deviation, length and noise, and their Fisher
/// information.
pub struct KernelDerivatives {
    /// First derivatives of the log-likelihood.
    pub gradient: [f64; 3],
    /// Fisher information.
    pub information: [[f64; 3]; 3],
}

impl SlamProblem {
    /// Displacements north and east at the measurements, in metres.
    pub fn displacements_m(&self, weights: &[f64]) -> Vec<[f64; 2]> {
        let u = MatRef::from_column_major_slice(weights, weights.len(), 1);
        let moved = &self.functions * u;
        (0..self.measured.len()).map(|i| [moved[(2 * i, 0)], moved[(2 * i + 1, 0)]]).collect()
    }

    /// Cholesky factor of the covariance along the path; `None` if the covariance is not positive.
    pub fn factored(&self, kernel: &AnomalyKernel, weights: &[f64]) -> Option<PathCovarianceFactor> {
        let n = self.measured.len();
        let moved = self.displacements_m(weights);
        let mut positions_m = Vec::with_capacity(n);
        let mut residual_nt = Vec::with_capacity(n);
        for (measured, moved) in self.measured.iter().zip(&moved) {
            positions_m.push([0, 1].map(|axis| measured.at_m[axis] + moved[axis]));
            let core_nt: f64 = measured.core_nt_per_m.iter().zip(moved).map(|(slope, moved)| slope * moved).sum();
            residual_nt.push(measured.value_nt - core_nt - self.centre_nt);
        }
        let (sigma_nt, tau_s) = self.temporal;
        let white_nt2 = kernel.sigma_n_nt.powi(2);
        let entry = |i: usize, j: usize| {
            let (a, b) = (&self.measured[i], &self.measured[j]);
            let temporal = sigma_nt * sigma_nt * (-(a.tt_s - b.tt_s).abs() / tau_s).exp();
            let white = if i == j { a.variance_nt2 + white_nt2 } else { 0.0 };
            kernel.anomaly_nt2(distance2(positions_m[i], positions_m[j])) + self.mean_nt2 + temporal + white
        };
        let covariance = by_columns(n, |j, column| {
            for (i, to) in column.iter_mut().enumerate().skip(j) {
                *to = entry(i, j);
            }
        });
        let factor = covariance.llt(Side::Lower).ok()?;
        let r = MatRef::from_column_major_slice(&residual_nt, n, 1);
        let solved = factor.solve(&r);
        let square: f64 = residual_nt.iter().enumerate().map(|(i, r)| r * solved[(i, 0)]).sum();
        let logarithm: f64 = (0..n).map(|i| factor.L()[(i, i)].ln()).sum();
        let cost = 0.5 * square + logarithm;
        cost.is_finite().then_some(PathCovarianceFactor { positions_m, residual_nt, factor, cost, square })
    }
}

impl PathCovarianceFactor {
    /// C⁻¹ and α = C⁻¹ r.
    fn inverse(&self) -> (Mat<f64>, Vec<f64>) {
        let inverse = self.factor.inverse();
        let r = MatRef::from_column_major_slice(&self.residual_nt, self.residual_nt.len(), 1);
        let solved = self.factor.solve(&r);
        (inverse, (0..self.residual_nt.len()).map(|i| solved[(i, 0)]).collect())
    }

    /// Half of the logarithm of |C|.
    pub fn logarithm(&self) -> f64 {
        self.cost - 0.5 * self.square
    }

    /// Squared leave-one-out residual of each measurement over the variance of the residual.
    pub fn left_out(&self) -> Vec<f64> {
        let (inverse, alpha) = self.inverse();
        alpha.iter().enumerate().map(|(i, a)| a * a / inverse[(i, i)]).collect()
    }

    /// Derivatives with respect to the weights of the functions.
    pub fn derivatives(&self, problem: &SlamProblem, kernel: &AnomalyKernel) -> CostDerivatives {
        let n = self.positions_m.len();
        let (inverse, alpha) = self.inverse();
        let apart = |i: usize, j: usize| -> [f64; 2] {
            [0, 1].map(|axis: usize| self.positions_m[i][axis] - self.positions_m[j][axis])
        };
        // Derivative of the covariance of i and j with respect to the position of i.
        let slopes = [0, 1].map(|axis: usize| {
            by_columns(n, |j, column| {
                for (i, to) in column.iter_mut().enumerate() {
                    let apart = apart(i, j);
                    *to = -kernel.bends(apart[0].powi(2) + apart[1].powi(2)).first * apart[axis];
                }
            })
        });
        let moved = slopes.each_ref().map(|slopes| product(slopes, &inverse));
        let a = MatRef::from_column_major_slice(&alpha, n, 1);
        // Slope of the expected field at each position, including the core field.
        let field: [Vec<f64>; 2] = [0, 1].map(|axis: usize| {
            let of = &slopes[axis] * a;
            (0..n).map(|i| of[(i, 0)] + problem.measured[i].core_nt_per_m[axis]).collect()
        });
        let count = problem.functions.ncols();
        let mut gradient = vec![0.0; count];
        for i in 0..n {
            for axis in 0..2 {
                // (C⁻¹ ∘ D) 1 is the diagonal of D C⁻¹.
                let by_place = moved[axis][(i, i)] - alpha[i] * field[axis][i];
                for (to, k) in gradient.iter_mut().zip(0..count) {
                    *to += by_place * problem.functions[(2 * i + axis, k)];
                }
            }
        }
        let part = |axis: usize| Mat::from_fn(n, count, |i, k| problem.functions[(2 * i + axis, k)]);
        let parts = [part(0), part(1)];
        // Part of the second derivative with respect to one position, from all covariances with this position.
        let own: Vec<[f64; 3]> = (0..n)
            .into_par_iter()
            .map(|i| {
                let mut sums = [0.0; 3];
                for j in (0..n).filter(|j| *j != i) {
                    let weight = inverse[(j, i)] - alpha[i] * alpha[j];
                    for (sum, (a, b)) in sums.iter_mut().zip(PAIRS) {
                        *sum += weight * bend(kernel, apart(i, j), a, b);
                    }
                }
                sums
            })
            .collect();
        let mut hessian = Mat::<f64>::zeros(count, count);
        for (pair, (a, b)) in PAIRS.into_iter().enumerate() {
            let block = |first: usize| -> Mat<f64> {
                let columns = BLOCK.min(n - first);
                let mut all = Mat::<f64>::zeros(n, columns);
                // D C⁻¹ Dᵀ, as D is antisymmetric.
                let right = slopes[b].as_ref().subcols(first, columns);
                matmul(all.as_mut(), Accum::Replace, moved[a].as_ref(), right, -1.0, Par::Seq);
                for place in 0..columns {
                    let j = first + place;
                    for i in 0..n {
                        let both = all[(i, place)];
                        let (to, back) = (moved[a][(i, j)], moved[b][(j, i)]);
                        let w = inverse[(i, j)];
                        let fisher = to * back + w * both;
                        let observed = field[a][i] * field[b][j] * w
                            + field[a][i] * alpha[j] * back
                            + alpha[i] * field[b][j] * to
                            + alpha[i] * alpha[j] * both;
                        let second = match i == j {
                            true => own[i][pair],
                            false => -(w - alpha[i] * alpha[j]) * bend(kernel, apart(i, j), a, b),
                        };
                        all[(i, place)] = observed - fisher + second;
                    }
                }
                let left = parts[a].transpose() * &all;
                left * parts[b].as_ref().subrows(first, columns)
            };
            let blocks: Vec<Mat<f64>> = (0..n).step_by(BLOCK).collect::<Vec<_>>().into_par_iter().map(block).collect();
            for block in blocks {
                hessian += &block;
                if a != b {
                    hessian += block.transpose();
                }
            }
        }
        CostDerivatives { gradient, hessian }
    }

    /// Derivatives with respect to the parameters of the kernel.
    pub fn by_kernel(&self, kernel: &AnomalyKernel) -> KernelDerivatives {
        let n = self.positions_m.len();
        let (inverse, alpha) = self.inverse();
        let white_nt2 = 2.0 * kernel.sigma_n_nt.powi(2);
        let distance2 = |i: usize, j: usize| distance2(self.positions_m[i], self.positions_m[j]);
        let by_sigma = by_columns(n, |j, column| {
            for (i, to) in column.iter_mut().enumerate() {
                *to = 2.0 * kernel.anomaly_nt2(distance2(i, j));
            }
        });
        // k is a function of the ratio of distance to length.
        let by_length = by_columns(n, |j, column| {
            for (i, to) in column.iter_mut().enumerate() {
                let squared = distance2(i, j);
                *to = kernel.bends(squared).first * squared;
            }
        });
        let moved = [&by_sigma, &by_length].map(|by| product(by, &inverse));
        let a = MatRef::from_column_major_slice(&alpha, n, 1);
        let square = |by: &Mat<f64>| -> f64 {
            let of = by * a;
            alpha.iter().enumerate().map(|(i, alpha)| alpha * of[(i, 0)]).sum()
        };
        let of = |which: usize, i: usize, j: usize| match which {
            2 => white_nt2 * inverse[(i, j)],
            _ => moved[which][(i, j)],
        };
        let squares = [square(&by_sigma), square(&by_length), white_nt2 * alpha.iter().map(|a| a * a).sum::<f64>()];
        let gradient = std::array::from_fn(|which| {
            let trace: f64 = (0..n).map(|i| of(which, i, i)).sum();
            0.5 * (trace - squares[which])
        });
        let mut information = [[0.0; 3]; 3];
        for (row, to) in information.iter_mut().enumerate() {
            for (column, to) in to.iter_mut().enumerate() {
                let sums: Vec<f64> = (0..n)
                    .into_par_iter()
                    .map(|j| (0..n).map(|i| of(row, i, j) * of(column, j, i)).sum::<f64>())
                    .collect();
                *to = 0.5 * sums.iter().sum::<f64>();
            }
        }
        KernelDerivatives { gradient, information }
    }
}

/// Pairs of axes: north-north, north-east, east-east.
const PAIRS: [(usize, usize); 3] = [(0, 0), (0, 1), (1, 1)];

/// Second derivative of the covariance of two positions that are `apart`, with respect to the coordinates a and b of
/// one of them.
fn bend(kernel: &AnomalyKernel, apart: [f64; 2], a: usize, b: usize) -> f64 {
    let bends = kernel.bends(apart[0].powi(2) + apart[1].powi(2));
    bends.second * apart[a] * apart[b] - if a == b { bends.first } else { 0.0 }
}

fn distance2(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

/// Square matrix assembled by columns on all threads.
fn by_columns(n: usize, fill: impl Fn(usize, &mut [f64]) + Sync) -> Mat<f64> {
    let mut all = vec![0.0; n * n];
    all.par_chunks_mut(n.max(1)).enumerate().for_each(|(j, column)| fill(j, column));
    MatRef::from_column_major_slice(&all, n, n).to_owned()
}

/// Product on all threads, bit-identical for any number of threads.
fn product(a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let (rows, n) = (a.nrows(), b.ncols());
    let firsts: Vec<usize> = (0..n).step_by(BLOCK).collect();
    let block = |first: &usize| {
        let columns = BLOCK.min(n - first);
        let mut part = Mat::<f64>::zeros(rows, columns);
        matmul(part.as_mut(), Accum::Replace, a.as_ref(), b.as_ref().subcols(*first, columns), 1.0, Par::Seq);
        part
    };
    let parts: Vec<Mat<f64>> = firsts.par_iter().map(block).collect();
    let mut out = Mat::<f64>::zeros(rows, n);
    for (part, first) in parts.iter().zip(firsts) {
        out.as_mut().subcols_mut(first, part.ncols()).copy_from(part);
    }
    out
}

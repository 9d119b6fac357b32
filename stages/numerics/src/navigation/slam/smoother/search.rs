//! Most probable weights of the motion, and maximum-likelihood hyper-parameters.

use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::{Mat, MatRef, Side};

use super::likelihood::{PathCovarianceFactor, SlamProblem};
use crate::navigation::slam::kernel::AnomalyKernel;

/// Maximum number of halvings of a step.
const MOST_HALVINGS: usize = 10;
/// Largest change of the logarithm of a hyper-parameter in one step.
const LARGEST_LOG: f64 = 1.0;
/// Damping added to the information on the logarithms of the hyper-parameters. A logarithm without influence remains
/// constant.
const DAMPING: f64 = 0.1;
/// The hyper-parameters have converged if their logarithms change by at most this.
const STILL_LOG: f64 = 0.02;
/// Fraction of the measurement noise below which the white part of the kernel is negligible.
const LEAST_NOISE: f64 = 0.1;

/// Prior of the weights without the field. The negative log-density is uᵀ M u/2 − fᵀ u.
pub struct SlamWeightPrior {
    /// M.
    pub information: Mat<f64>,
    /// f.
    pub force: Vec<f64>,
}

impl SlamWeightPrior {
    fn cost(&self, weights: &[f64]) -> f64 {
        let moved = self.times(weights);
        weights.iter().zip(moved.iter().zip(&self.force)).map(|(u, (moved, force))| u * (0.5 * moved - force)).sum()
    }

    fn times(&self, weights: &[f64]) -> Vec<f64> {
        let of = &self.information * MatRef::from_column_major_slice(weights, weights.len(), 1);
        (0..weights.len()).map(|k| of[(k, 0)]).collect()
    }
}

/// Parameters of the search.
#[derive(Clone, Copy, Debug)]
pub struct SlamSearchParameters {
    /// Maximum number of linearisations.
    pub passes: usize,
    /// Position change of a measurement, in metres, below which the search ends.
    pub tolerance_m: f64,
    /// Whether the kernel is also fitted.
    pub fits: bool,
    /// Smallest and largest length of a fitted kernel, in metres.
    pub lengths_m: (f64, f64),
}

/// State of the search.
pub struct SlamSearch<'a> {
    problem: &'a SlamProblem,
    prior: &'a SlamWeightPrior,
    rules: SlamSearchParameters,
    /// Weights.
    pub weights: Vec<f64>,
    /// Kernel.
    pub kernel: AnomalyKernel,
    factored: PathCovarianceFactor,
    /// Number of passes.
    pub passes: usize,
    /// Largest change of the position of a measurement in the last full step, in metres.
    pub last_step_m: f64,
    /// Whether path and kernel have converged.
    pub converged: bool,
}

impl<'a> SlamSearch<'a> {
    /// Search with initial weights and kernel; `None` if the covariance of the measurements is not positive at this
    /// point.
    pub fn from(
        problem: &'a SlamProblem,
        prior: &'a SlamWeightPrior,
        rules: SlamSearchParameters,
        weights: Vec<f64>,
        kernel: AnomalyKernel,
    ) -> Option<Self> {
        let factored = problem.factored(&kernel, &weights)?;
        let last_step_m = f64::INFINITY;
        Some(Self { problem, prior, rules, weights, kernel, factored, passes: 0, last_step_m, converged: false })
    }

    /// Negative log-density of path and measurements, up to a constant.
    pub fn cost(&self) -> f64 {
        self.factored.cost + self.prior.cost(&self.weights)
    }

    /// Negative log-likelihood of the measurements, up to a constant.
    pub fn likelihood_cost(&self) -> f64 {
        self.factored.cost
    }

    /// Mean of the normalised squared residuals, rᵀ C⁻¹ r divided by the number of measurements.
    pub fn misfit(&self) -> f64 {
        self.factored.square / self.problem.measured.len() as f64
    }

    /// See [`PathCovarianceFactor::left_out`].
    pub fn left_out(&self) -> Vec<f64> {
        self.factored.left_out()
    }

    /// Fits the most probable kernel for the present path, if the kernel is to be fitted.
    pub fn settle_kernel(&mut self) {
        let mut passes = if self.rules.fits { self.rules.passes } else { 0 };
        while passes > 0 && !self.fit() {
            passes -= 1;
        }
    }

    /// Iterates until path and kernel have converged.
    pub fn run(&mut self) -> Option<()> {
        while self.passes < self.rules.passes && !self.converged {
            let kernel_is_still = !self.rules.fits || self.fit();
            let whole = self.step()?;
            self.passes += 1;
            self.last_step_m = self.largest_m(&whole);
            let taken = self.descend(&whole);
            let is_still = self.last_step_m < self.rules.tolerance_m || !taken;
            self.converged = is_still && kernel_is_still && self.last_step_m < 10.0 * self.rules.tolerance_m;
            if !taken && kernel_is_still {
                break;
            }
        }
        Some(())
    }

    /// Laplace approximation of the covariance of the weights.
    pub fn covariance(&self) -> Option<Mat<f64>> {
        Some(self.curvature().0?.inverse())
    }

    /// Cholesky factor of the information on the weights, and the gradient of the cost.
    ///
    /// Far from the optimum, the likelihood may have negative curvature along some weights; only the prior then gives
    /// information on these weights.
    fn curvature(&self) -> (Option<Llt<f64>>, Vec<f64>) {
        let found = self.factored.derivatives(self.problem, &self.kernel);
        let mut gradient = found.gradient;
        for (to, (moved, force)) in
            gradient.iter_mut().zip(self.prior.times(&self.weights).iter().zip(&self.prior.force))
        {
            *to += moved - force;
        }
        let n = gradient.len();
        let symmetric = Mat::from_fn(n, n, |i, j| 0.5 * (found.hessian[(i, j)] + found.hessian[(j, i)]));
        let Ok(eigen) = symmetric.self_adjoint_eigen(Side::Lower) else { return (None, gradient) };
        let (vectors, values) = (eigen.U(), eigen.S());
        let scaled = Mat::from_fn(n, n, |i, k| vectors[(i, k)] * values[k].max(0.0));
        let information = &self.prior.information + &scaled * vectors.transpose();
        (information.llt(Side::Lower).ok(), gradient)
    }

    /// Step to the minimum of the quadratic approximation.
    fn step(&self) -> Option<Vec<f64>> {
        let (factor, gradient) = self.curvature();
        let solved = factor?.solve(&MatRef::from_column_major_slice(&gradient, gradient.len(), 1));
        let step: Vec<f64> = (0..gradient.len()).map(|k| -solved[(k, 0)]).collect();
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    fn largest_m(&self, step: &[f64]) -> f64 {
        self.problem.displacements_m(step).iter().map(|[n, e]| n.hypot(*e)).fold(0.0, f64::max)
    }

    /// Takes a step, halved until the cost does not rise; false if no step is accepted.
    fn descend(&mut self, whole: &[f64]) -> bool {
        let before = self.cost();
        let mut part = 1.0;
        for _ in 0..=MOST_HALVINGS {
            let weights: Vec<f64> = self.weights.iter().zip(whole).map(|(u, step)| u + part * step).collect();
            if let Some(factored) = self.problem.factored(&self.kernel, &weights)
                && factored.cost + self.prior.cost(&weights) <= before
            {
                (self.weights, self.factored) = (weights, factored);
                return true;
            }
            part *= 0.5;
        }
        false
    }

    /// Takes one step of Fisher scoring of the kernel. Returns whether the kernel has converged.
    fn fit(&mut self) -> bool {
        let by = self.factored.by_kernel(&self.kernel);
        let information = Mat::from_fn(3, 3, |i, j| by.information[i][j] + if i == j { DAMPING } else { 0.0 });
        let Ok(factor) = information.llt(Side::Lower) else { return true };
        let solved = factor.solve(&MatRef::from_column_major_slice(&by.gradient, 3, 1));
        let step: [f64; 3] = std::array::from_fn(|k| -solved[(k, 0)]);
        let largest = step.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        if !largest.is_finite() {
            return true;
        }
        let mut part = (LARGEST_LOG / largest).min(1.0);
        for _ in 0..=MOST_HALVINGS {
            let kernel = self.moved_kernel(step.map(|step| part * step));
            if let Some(factored) = self.problem.factored(&kernel, &self.weights)
                && factored.cost <= self.factored.cost
            {
                let ratio = |a: f64, b: f64| if a > 0.0 && b > 0.0 { (a / b).ln().abs() } else { 0.0 };
                let still = ratio(kernel.sigma_se_nt, self.kernel.sigma_se_nt) < STILL_LOG
                    && ratio(kernel.length_m, self.kernel.length_m) < STILL_LOG
                    && ratio(kernel.sigma_n_nt, self.kernel.sigma_n_nt) < STILL_LOG;
                (self.kernel, self.factored) = (kernel, factored);
                return still;
            }
            part *= 0.5;
        }
        true
    }

    /// Kernel after steps in the logarithms of its standard deviation, length and noise, within the bounds of the
    /// kernel.
    fn moved_kernel(&self, [sigma, length, noise]: [f64; 3]) -> AnomalyKernel {
        let measured = &self.problem.measured;
        let mean_nt2 = measured.iter().map(|of| of.variance_nt2).sum::<f64>() / measured.len() as f64;
        let (shortest, longest) = self.rules.lengths_m;
        AnomalyKernel {
            covariance: self.kernel.covariance,
            sigma_se_nt: self.kernel.sigma_se_nt * sigma.exp(),
            length_m: (self.kernel.length_m * length.exp()).clamp(shortest, longest),
            sigma_n_nt: (self.kernel.sigma_n_nt * noise.exp()).max(LEAST_NOISE * mean_nt2.sqrt()),
        }
    }
}

//! Coefficients from the triangular factor, for all targets and ridge parameters together.

use faer::Mat;

use super::LeastSquaresError;

/// A direction is not excited if its singular value is at most this fraction of the largest singular value. All columns
/// are first scaled to the same length. Rounding in a zero-phase filter over 50,000 nT gives dependent columns singular
/// values of about 1e-13; real calibration flights have more than 1e-6.
pub const RANK_TOLERANCE: f64 = 1e-12;

/// A term is listed if its component in the directions without excitation is at least this large.
const NAMED_FROM: f64 = 1e-4;

/// The triangular factor of [A | Y] and statistics of its rows.
pub(super) struct RidgeFactor {
    pub(super) rows: usize,
    pub(super) terms: usize,
    pub(super) targets: usize,
    pub(super) upper: Vec<f64>,
    /// Residual sum of squares of each target.
    pub(super) unexplained: Vec<f64>,
    pub(super) means: Vec<f64>,
    pub(super) centred: bool,
}

impl RidgeFactor {
    fn at(&self, row: usize, column: usize) -> f64 {
        self.upper[row * (self.terms + self.targets) + column]
    }
}

/// The fits of all targets for one ridge parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct RidgeSolution {
    /// The ridge parameter.
    pub lambda: f64,
    /// For each target, one coefficient per term: unit of the target over unit of the term.
    pub coefficients: Vec<Vec<f64>>,
    /// For each target, the constant added to the sum of the terms: 0 unless the fit subtracts means.
    pub intercepts: Vec<f64>,
    /// The effective number of fitted parameters, Σ s²/(s² + λ), including the intercept.
    pub degrees_of_freedom: f64,
    /// For each target, the sum of squared residuals.
    pub residual_squares: Vec<f64>,
    /// For each target, the sum of squared residuals divided by (rows − degrees of freedom); NaN without degrees of
    /// freedom.
    pub residual_variances: Vec<f64>,
}

/// The fits for a list of ridge parameters, and the conditioning of the matrix.
#[derive(Debug, Clone, PartialEq)]
pub struct RidgePath {
    /// The names of the terms, in the order of the coefficients.
    pub terms: Vec<String>,
    /// The number of fitted rows.
    pub rows: usize,
    /// The mean of each term.
    pub term_means: Vec<f64>,
    /// The mean of each target.
    pub target_means: Vec<f64>,
    /// The singular values of the (optionally centred) matrix, largest first.
    pub singular_values: Vec<f64>,
    /// Ratio of the largest singular value to the smallest; infinite if all values of a term are zero.
    pub condition: f64,
    /// The rank of the columns after scaling each to the same length.
    pub rank: usize,
    /// Terms that are zero in every row (or constant, if the fit subtracts means).
    pub unexcited: Vec<String>,
    /// Terms with a linear dependence on other terms.
    pub dependent: Vec<String>,
    /// One solution for each lambda, in the requested order.
    pub solutions: Vec<RidgeSolution>,
    /// Right singular vectors, row-major, one row per term.
    right: Vec<f64>,
    /// The divisors by which the columns were scaled before the decomposition.
    scales: Vec<f64>,
}

impl RidgePath {
    /// Covariance of a solution's coefficients for one target, row-major, one row per term: σ² V diag(s²/(s² + λ)²) Vᵀ
    /// with the residual variance σ². It is the sampling covariance for independent residuals and excludes the bias of
    /// the ridge. For correlated residuals, see [`cross_spectra`](crate::regression::cross_spectra). `None` if the
    /// solution or target does not exist.
    pub fn covariance(&self, solution: usize, target: usize) -> Option<Vec<f64>> {
        let solution = self.solutions.get(solution)?;
        let variance = *solution.residual_variances.get(target)?;
        let weights: Vec<f64> =
            self.singular_values.iter().map(|s| variance * shrink(*s, solution.lambda).powi(2)).collect();
        Some(self.of_directions(&weights))
    }

    /// The matrix G of a solution b = G Aᵀ y, row-major: V diag(1/(s² + λ)) Vᵀ, in the units of the columns. `None` if
    /// the solution does not exist.
    pub fn gain(&self, solution: usize) -> Option<Vec<f64>> {
        let lambda = self.solutions.get(solution)?.lambda;
        let weights: Vec<f64> = self
            .singular_values
            .iter()
            .map(|s| if s * s + lambda == 0.0 { 0.0 } else { 1.0 / (s * s + lambda) })
            .collect();
        Some(self.of_directions(&weights))
    }

    /// V diag(`weights`) Vᵀ in the units of the columns, row-major.
    fn of_directions(&self, weights: &[f64]) -> Vec<f64> {
        let p = self.terms.len();
        let entry = |i: usize, j: usize| {
            let (one, other) = (&self.right[i * p..], &self.right[j * p..]);
            (0..p).map(|k| one[k] * weights[k] * other[k]).sum::<f64>() / (self.scales[i] * self.scales[j])
        };
        (0..p * p).map(|ij| entry(ij / p, ij % p)).collect()
    }

    /// Converts coefficients of columns divided by `scales` to coefficients of the columns themselves.
    pub(super) fn unscale(&mut self, scales: &[f64]) {
        for coefficients in self.solutions.iter_mut().flat_map(|solution| &mut solution.coefficients) {
            coefficients.iter_mut().zip(scales).for_each(|(b, s)| *b /= s);
        }
        self.scales = scales.to_vec();
    }
}

/// s/(s² + λ), and 0 for a direction without excitation.
fn shrink(s: f64, lambda: f64) -> f64 {
    let denominator = s * s + lambda;
    if denominator == 0.0 { 0.0 } else { s / denominator }
}

/// Singular values, left vectors by column and right vectors by row of the terms' triangle.
struct TriangleSvd {
    s: Vec<f64>,
    u: Mat<f64>,
    v: Mat<f64>,
}

fn decompose(p: usize, at: impl Fn(usize, usize) -> f64) -> Result<TriangleSvd, LeastSquaresError> {
    let svd = Mat::from_fn(p, p, at).svd().map_err(|_| LeastSquaresError::NoConvergence)?;
    Ok(TriangleSvd {
        s: svd.S().column_vector().iter().copied().collect(),
        u: svd.U().to_owned(),
        v: svd.V().to_owned(),
    })
}

/// Solves for all lambdas. `names` has one name per term.
pub(super) fn solve(factor: RidgeFactor, lambdas: &[f64], names: Vec<String>) -> Result<RidgePath, LeastSquaresError> {
    let p = factor.terms;
    let excitation = excitation(&factor, &names)?;
    if excitation.rank < p && lambdas.contains(&0.0) {
        return Err(LeastSquaresError::RankDeficient {
            rank: excitation.rank,
            terms: p,
            rows: factor.rows,
            unexcited: excitation.unexcited,
            dependent: excitation.dependent,
        });
    }
    let svd = decompose(p, |i, j| factor.at(i, j))?;
    let projections: Vec<Vec<f64>> = (0..factor.targets)
        .map(|target| {
            let along = |k: usize| (0..p).map(|i| svd.u[(i, k)] * factor.at(i, p + target)).sum();
            (0..p).map(along).collect()
        })
        .collect();
    let solutions = lambdas.iter().map(|&lambda| solution(&factor, &svd, &projections, lambda)).collect();
    let smallest = svd.s.last().copied().unwrap_or(f64::NAN);
    Ok(RidgePath {
        terms: names,
        rows: factor.rows,
        term_means: factor.means[..p].to_vec(),
        target_means: factor.means[p..].to_vec(),
        condition: svd.s.first().copied().unwrap_or(f64::NAN) / smallest,
        rank: excitation.rank,
        unexcited: excitation.unexcited,
        dependent: excitation.dependent,
        solutions,
        right: (0..p * p).map(|ij| svd.v[(ij / p, ij % p)]).collect(),
        scales: vec![1.0; p],
        singular_values: svd.s,
    })
}

fn solution(factor: &RidgeFactor, svd: &TriangleSvd, projections: &[Vec<f64>], lambda: f64) -> RidgeSolution {
    let p = factor.terms;
    let fitted: f64 = svd.s.iter().map(|s| s * shrink(*s, lambda)).sum();
    let degrees_of_freedom = fitted + f64::from(u8::from(factor.centred));
    let left_over = factor.rows as f64 - degrees_of_freedom;
    let mut solution = RidgeSolution {
        lambda,
        coefficients: Vec::with_capacity(projections.len()),
        intercepts: Vec::with_capacity(projections.len()),
        degrees_of_freedom,
        residual_squares: Vec::with_capacity(projections.len()),
        residual_variances: Vec::with_capacity(projections.len()),
    };
    for (target, projection) in projections.iter().enumerate() {
        let scaled: Vec<f64> = (0..p).map(|k| shrink(svd.s[k], lambda) * projection[k]).collect();
        let coefficient = |i: usize| (0..p).map(|k| svd.v[(i, k)] * scaled[k]).sum::<f64>();
        let coefficients: Vec<f64> = (0..p).map(coefficient).collect();
        let given_up = |k: usize| (projection[k] - svd.s[k] * scaled[k]).powi(2);
        let squares = factor.unexplained[target] + (0..p).map(given_up).sum::<f64>();
        let explained: f64 = coefficients.iter().zip(&factor.means).map(|(b, m)| b * m).sum();
        let intercept = factor.means[p + target] - explained;
        solution.coefficients.push(coefficients);
        solution.intercepts.push(if factor.centred { intercept } else { 0.0 });
        solution.residual_squares.push(squares);
        solution.residual_variances.push(if left_over > 0.0 { squares / left_over } else { f64::NAN });
    }
    solution
}

struct TermRank {
    rank: usize,
    unexcited: Vec<String>,
    dependent: Vec<String>,
}

/// Rank of the columns scaled to the same length, and the terms that reduce the rank.
///
/// The component of a term in the directions without excitation is the term's diagonal entry of the projector onto
/// these directions. This entry is independent of the basis of the decomposition.
fn excitation(factor: &RidgeFactor, names: &[String]) -> Result<TermRank, LeastSquaresError> {
    let p = factor.terms;
    let length = |j: usize| (0..=j).map(|i| factor.at(i, j).powi(2)).sum::<f64>().sqrt();
    let lengths: Vec<f64> = (0..p).map(length).collect();
    let longest = lengths.iter().copied().fold(0.0, f64::max);
    // After subtraction of its mean, a constant term contains only rounding errors.
    let roots = (factor.rows as f64).sqrt();
    let zero = |j: usize| {
        let mean = if factor.centred { factor.means[j].abs() } else { 0.0 };
        lengths[j] <= 1e-13 * (longest + mean * roots)
    };
    let scaled = |i: usize, j: usize| {
        if zero(j) { 0.0 } else { factor.at(i, j) / lengths[j] }
    };
    let svd = decompose(p, scaled)?;
    let threshold = RANK_TOLERANCE * svd.s.first().copied().unwrap_or(0.0);
    let rank = svd.s.iter().filter(|s| **s > threshold).count();
    let part = |j: usize| (rank..p).map(|k| svd.v[(j, k)].powi(2)).sum::<f64>().sqrt();
    let named = |j: usize| names.get(j).cloned().unwrap_or_default();
    Ok(TermRank {
        rank,
        unexcited: (0..p).filter(|&j| zero(j)).map(named).collect(),
        dependent: (0..p).filter(|&j| !zero(j) && part(j) > NAMED_FROM).map(named).collect(),
    })
}

/// Message for a fit without a unique solution.
pub(super) fn deficient(rank: usize, terms: usize, rows: usize, unexcited: &[String], dependent: &[String]) -> String {
    let quoted = |names: &[String]| {
        let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
        names.join(", ")
    };
    let mut why = Vec::new();
    if !unexcited.is_empty() {
        why.push(format!("{} are constant", quoted(unexcited)));
    }
    if !dependent.is_empty() {
        why.push(format!("{} are linearly dependent", quoted(dependent)));
    }
    format!(
        "with lambda = 0 the solution is not unique: {rows} rows contain only {rank} independent \
         combinations of {terms} terms; {}. Use lambda > 0, omit a term, or fit over more manoeuvres",
        why.join(" and ")
    )
}

//! Least squares and ridge regression with more rows than fit in memory, for many targets and many ridge parameters.
//!
//! The rows of [A | Y] are folded into the triangular factor of a QR factorisation, one panel at a time (tall-skinny QR
//! [Demmel et al. 2012, "Communication-optimal parallel and sequential QR and LU factorizations", SIAM J. Sci. Comput.
//! 34(1)]). Memory depends only on the number of columns. The normal equations, which square the condition number, are
//! never formed. One singular value decomposition of the p x p factor then gives the solution for all targets and all
//! lambdas: β = V diag(s/(s² + λ)) Uᵀ Qᵀ y, the minimum of |y − A β|² + λ |β|². λ is absolute (not divided by the
//! number of rows) and penalises every term uniformly, as in MagNav.jl.
//!
//! ```
//! use numerics::regression::least_squares::QrAccumulator;
//!
//! let a = [1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 1.0]; // four rows of two terms
//! let y: Vec<f64> = a.chunks(2).map(|row| 3.0 * row[0] - row[1]).collect();
//! let mut qr = QrAccumulator::new(2, 1);
//! qr.push(&a, &[&y])?;
//! let path = qr.solve(&[0.0, 0.025], &["x", "y"])?;
//! assert!((path.solutions[0].coefficients[0][0] - 3.0).abs() < 1e-12);
//! # Ok::<(), numerics::regression::least_squares::LeastSquaresError>(())
//! ```

mod moments;
mod panel;
mod prepared;
mod ridge;
mod triangular;

use rayon::prelude::*;

pub use moments::{
    LineScoreMeasure, LineScores, LinearFit, MomentsAccumulator, RegressionMoments, ResidualStatistics, leave_line_out,
};
use panel::QrTriangle;
pub use prepared::{ColumnScaling, ScaledFactor, ScaledFactorSvd};
pub use ridge::{RANK_TOLERANCE, RidgePath, RidgeSolution};
pub(crate) use triangular::TriangularSystem;

/// Number of rows that one thread folds before the factors are merged. It is fixed, so that the result does not depend
/// on the number of threads.
const CHUNK: usize = 16_384;

/// Error of a least-squares fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LeastSquaresError {
    /// The number of columns or names does not match the matrix.
    #[error("{what} has {given} entries, but {expected} are required")]
    Shape {
        /// Name of the argument.
        what: &'static str,
        /// Number of entries of the argument.
        given: usize,
        /// The number of entries needed.
        expected: usize,
    },
    /// A value is NaN or infinite.
    #[error("the value in row {row} of {column} is not finite; remove such rows")]
    NotFinite {
        /// The row, from 0, counted over all rows that were pushed.
        row: usize,
        /// `term` or `target` and its number from 0.
        column: String,
    },
    /// A ridge parameter is negative or not finite.
    #[error("lambda must be a finite number of at least 0, but is {lambda}")]
    Lambda {
        /// The given parameter.
        lambda: f64,
    },
    /// There are no rows.
    #[error("there are no rows to fit")]
    NoRows,
    /// The terms are linearly dependent and lambda is 0.
    #[error("{}", ridge::deficient(*rank, *terms, *rows, unexcited, dependent))]
    RankDeficient {
        /// The number of independent combinations of terms in the rows.
        rank: usize,
        /// The number of terms.
        terms: usize,
        /// The number of rows.
        rows: usize,
        /// Terms that are zero in every row (or constant, if the fit subtracts means).
        unexcited: Vec<String>,
        /// Terms with a linear dependence on other terms.
        dependent: Vec<String>,
    },
    /// A requested term or target does not exist.
    #[error("{what} {number} does not exist: there are {count}, numbered from 0")]
    NoSuch {
        /// `term` or `target`.
        what: &'static str,
        /// The requested index.
        number: usize,
        /// The number of terms or targets.
        count: usize,
    },
    /// There are too few lines for cross-validation.
    #[error("cross-validation requires at least two lines, but the number of lines is {given}")]
    TooFewLines {
        /// The number of lines.
        given: usize,
    },
    /// A line to be omitted and predicted has no rows.
    #[error("line {line} (counted from 0) has no rows to predict; remove it from the cross-validation")]
    EmptyLine {
        /// The index of the line.
        line: usize,
    },
    /// A setting of a model is out of its valid range.
    #[error("{what} must be {wanted}, but is {given}")]
    Setting {
        /// The setting.
        what: &'static str,
        /// Valid range of the setting.
        wanted: &'static str,
        /// The given value.
        given: f64,
    },
    /// An elastic net did not reach its tolerance.
    #[error(
        "the elastic net with alpha {alpha} did not converge in {sweeps} sweeps: its duality gap is {gap:e} of the \
         target's sum of squares; allow more sweeps or a larger tolerance"
    )]
    Sweeps {
        /// The strength of the penalty.
        alpha: f64,
        /// The number of sweeps.
        sweeps: usize,
        /// The remaining duality gap, as a fraction of the target's sum of squares.
        gap: f64,
    },
    /// The singular value decomposition did not converge.
    #[error("the singular value decomposition did not converge")]
    NoConvergence,
}

/// The triangular QR factor of [1 | A | Y], built up row by row.
///
/// The leading column of ones provides the means and the centred fit without a second pass.
#[derive(Debug, Clone)]
pub struct QrAccumulator {
    terms: usize,
    targets: usize,
    rows: usize,
    triangle: QrTriangle,
    /// Buffer for one row: a 1, the terms, the targets, and zeros up to a whole number of cache lines.
    row: Vec<f64>,
}

impl QrAccumulator {
    /// Creates an empty factor for `terms` columns of A and `targets` columns of Y.
    pub fn new(terms: usize, targets: usize) -> Self {
        let triangle = QrTriangle::new(1 + terms, targets);
        let mut row = vec![0.0; triangle.padded()];
        row[0] = 1.0;
        Self { terms, targets, rows: 0, triangle, row }
    }

    /// Factor of a whole matrix, computed in parallel (rayon).
    ///
    /// The rows are split at fixed positions and the blocks merged in order. The result is the same for any number of
    /// threads, but differs in the last bits from the result of a single [`push`](Self::push).
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] unless matrix and targets have the same whole number of rows, or with
    /// [`LeastSquaresError::NotFinite`] for a value that is not finite.
    pub fn from_matrix(a: &[f64], terms: usize, targets: &[&[f64]]) -> Result<Self, LeastSquaresError> {
        let mut whole = Self::new(terms, targets.len());
        let rows = whole.check(a, targets)?;
        let pieces: Vec<Self> = (0..rows.div_ceil(CHUNK))
            .into_par_iter()
            .map(|piece| {
                let range = piece * CHUNK..((piece + 1) * CHUNK).min(rows);
                let mut factor = Self::new(terms, targets.len());
                let targets: Vec<&[f64]> = targets.iter().map(|y| &y[range.clone()]).collect();
                factor
                    .push(&a[range.start * terms..range.end * terms], &targets)
                    .map_err(|error| error.further_down(range.start))?;
                Ok(factor)
            })
            .collect::<Result<_, LeastSquaresError>>()?;
        for piece in pieces {
            whole.merge(piece)?;
        }
        Ok(whole)
    }

    /// Folds in rows: `a` is row-major with one column per term; `targets` has one slice per target.
    ///
    /// Pushing in blocks and pushing all rows together give bit-identical results. On an error the factor is unchanged.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] for a wrong number of targets. Also fails unless matrix and targets have
    /// the same whole number of rows. Also fails with [`LeastSquaresError::NotFinite`] for a value that is not finite.
    pub fn push(&mut self, a: &[f64], targets: &[&[f64]]) -> Result<(), LeastSquaresError> {
        let rows = self.check_finite(a, targets)?;
        for i in 0..rows {
            self.fill_row(a, targets, i);
            self.triangle.push(&self.row);
        }
        self.rows += rows;
        Ok(())
    }

    /// Folds in rows as [`push`](Self::push) does, with a weight of at least 0 for each row's squared residual. The
    /// means are then also weighted, including the means of a fit with an intercept.
    ///
    /// # Errors
    /// Returns the errors of [`push`](Self::push). Also fails with [`LeastSquaresError::Shape`] if the numbers of
    /// weights and rows differ, or with [`LeastSquaresError::Setting`] for a weight that is not a finite number of at
    /// least 0.
    pub fn push_weighted(&mut self, a: &[f64], targets: &[&[f64]], weights: &[f64]) -> Result<(), LeastSquaresError> {
        let rows = self.check_finite(a, targets)?;
        expect("the list of weights", weights.len(), rows)?;
        let bad = weights.iter().find(|w| !(**w >= 0.0 && w.is_finite()));
        setting("a weight", bad.copied().unwrap_or_default(), "a finite number of at least 0", bad.is_none())?;
        for (i, weight) in weights.iter().enumerate() {
            self.fill_row(a, targets, i);
            let root = weight.sqrt();
            self.row.iter_mut().for_each(|x| *x *= root);
            self.triangle.push(&self.row);
            self.row[0] = 1.0;
        }
        self.rows += rows;
        Ok(())
    }

    #[inline(always)]
    fn fill_row(&mut self, a: &[f64], targets: &[&[f64]], i: usize) {
        let terms = self.terms;
        self.row[1..=terms].copy_from_slice(&a[i * terms..(i + 1) * terms]);
        for (value, target) in self.row[1 + terms..].iter_mut().zip(targets) {
            *value = target[i];
        }
    }

    /// Folds in the rows of another factor, after the present rows. The last bits of the result depend on the order of
    /// merging: merge in the order of the lines.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] for a factor with a different number of terms or targets.
    pub fn merge(&mut self, mut other: Self) -> Result<(), LeastSquaresError> {
        expect("the other factor's targets", other.targets, self.targets)?;
        expect("the other factor's terms", other.terms, self.terms)?;
        other.triangle.flush();
        let width = self.width();
        self.triangle.add_squares(other.triangle.squares());
        for row in other.triangle.upper().chunks_exact(width) {
            self.triangle.push(row);
        }
        self.triangle.flush();
        self.rows += other.rows;
        Ok(())
    }

    /// The factor of [1 | A | y] for the targets `chosen` only, bit-identical to a factor that was built with these
    /// targets only. An index without a target is ignored.
    pub fn select(&self, chosen: &[usize]) -> Self {
        let chosen: Vec<usize> = chosen.iter().copied().filter(|c| *c < self.targets).collect();
        let mut out = Self::new(self.terms, chosen.len());
        out.triangle = self.triangle.clone().select(&chosen);
        out.rows = self.rows;
        out
    }

    /// The number of rows folded in.
    pub fn rows(&self) -> usize {
        self.rows
    }

    fn width(&self) -> usize {
        1 + self.terms + self.targets
    }

    /// Ridge fits of every target for every lambda; all terms are penalised, without an intercept.
    ///
    /// `names` are the names of the terms, used in messages and in the returned path. For a lambda of 0, linearly
    /// dependent terms cause an error that names them; for a lambda above 0 they are fitted and listed in the path.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] if the numbers of names and terms differ, with
    /// [`LeastSquaresError::Lambda`] for a lambda that is not a finite number of at least 0, with
    /// [`LeastSquaresError::NoRows`], with [`LeastSquaresError::RankDeficient`] for a lambda of 0 with dependent terms,
    /// or with [`LeastSquaresError::NoConvergence`].
    pub fn solve<S: AsRef<str>>(&self, lambdas: &[f64], names: &[S]) -> Result<RidgePath, LeastSquaresError> {
        self.path(lambdas, names, false)
    }

    /// Solves as [`solve`](Self::solve), after subtraction of the means of terms and targets: a fit with an unpenalised
    /// intercept.
    ///
    /// # Errors
    /// Returns the errors of [`solve`](Self::solve).
    pub fn solve_centred<S: AsRef<str>>(&self, lambdas: &[f64], names: &[S]) -> Result<RidgePath, LeastSquaresError> {
        self.path(lambdas, names, true)
    }

    fn path<S: AsRef<str>>(&self, lambdas: &[f64], names: &[S], centred: bool) -> Result<RidgePath, LeastSquaresError> {
        expect("the list of term names", names.len(), self.terms)?;
        check_lambdas(lambdas)?;
        if self.rows == 0 {
            return Err(LeastSquaresError::NoRows);
        }
        let width = self.width();
        let mut triangle = self.triangle.clone();
        triangle.flush();
        let unexplained = triangle.squares().to_vec();
        let upper = triangle.upper();
        let means: Vec<f64> = upper[1..width].iter().map(|sum| sum / upper[0]).collect();
        // Without its first row and column, the factor of [1 | A | Y] is the factor of the centred [A | Y].
        let skipped = usize::from(centred);
        let mut factor = QrTriangle::new(self.terms, self.targets);
        factor.add_squares(&unexplained);
        for row in upper.chunks_exact(width).skip(skipped) {
            factor.push(&row[1..]);
        }
        factor.flush();
        let names = names.iter().map(|name| name.as_ref().to_owned()).collect();
        ridge::solve(
            ridge::RidgeFactor {
                rows: self.rows,
                terms: self.terms,
                targets: self.targets,
                unexplained: factor.squares().to_vec(),
                upper: factor.upper(),
                means,
                centred,
            },
            lambdas,
            names,
        )
    }

    fn check(&self, a: &[f64], targets: &[&[f64]]) -> Result<usize, LeastSquaresError> {
        expect("the list of targets", targets.len(), self.targets)?;
        let rows = match (targets.first(), self.terms) {
            (Some(target), _) => target.len(),
            (None, 0) => 0,
            (None, terms) => a.len() / terms,
        };
        expect("the matrix of terms", a.len(), rows * self.terms)?;
        for target in targets {
            expect("a target", target.len(), rows)?;
        }
        Ok(rows)
    }

    fn check_finite(&self, a: &[f64], targets: &[&[f64]]) -> Result<usize, LeastSquaresError> {
        let rows = self.check(a, targets)?;
        if !all_finite(a) {
            return Err(self.not_finite("term", a.iter().position(|x| !x.is_finite()), self.terms));
        }
        for (number, target) in targets.iter().enumerate() {
            if !all_finite(target) {
                let row = target.iter().position(|x| !x.is_finite()).unwrap_or_default();
                let at = row * self.targets + number;
                return Err(self.not_finite("target", Some(at), self.targets));
            }
        }
        Ok(rows)
    }

    fn not_finite(&self, kind: &str, at: Option<usize>, columns: usize) -> LeastSquaresError {
        let at = at.unwrap_or_default();
        LeastSquaresError::NotFinite {
            row: self.rows + at / columns.max(1),
            column: format!("{kind} {}", at % columns.max(1)),
        }
    }
}

impl LeastSquaresError {
    fn further_down(self, rows: usize) -> Self {
        match self {
            Self::NotFinite { row, column } => Self::NotFinite { row: row + rows, column },
            other => other,
        }
    }
}

/// Whether all values are finite. There is no early exit, so that the speed is limited by memory only.
fn all_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |finite, value| finite & value.is_finite())
}

fn check_lambdas(lambdas: &[f64]) -> Result<(), LeastSquaresError> {
    match lambdas.iter().find(|l| !(**l >= 0.0 && l.is_finite())) {
        Some(&lambda) => Err(LeastSquaresError::Lambda { lambda }),
        None => Ok(()),
    }
}

/// Rejects a setting that is not in its valid range.
pub(crate) fn setting(
    what: &'static str,
    given: f64,
    wanted: &'static str,
    fits: bool,
) -> Result<(), LeastSquaresError> {
    if fits { Ok(()) } else { Err(LeastSquaresError::Setting { what, wanted, given }) }
}

pub(crate) fn expect(what: &'static str, given: usize, expected: usize) -> Result<(), LeastSquaresError> {
    if given == expected {
        return Ok(());
    }
    Err(LeastSquaresError::Shape { what, given, expected })
}

#[cfg(test)]
mod moments_tests;
#[cfg(test)]
mod tests;

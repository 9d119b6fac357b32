//! Sufficient statistics of a line for many linear models: the factor of [1 | A | Y], without its rows.
//!
//! A [`RegressionMoments`] is small (p x p). Moments can be merged in the order of the lines, reduced to some of their
//! terms and targets, and evaluated with any coefficients, without reading a row again. Scaling their columns gives a
//! [`ScaledFactor`], from which every model is computed.

use rayon::prelude::*;

use super::panel::QrTriangle;
use super::{ColumnScaling, LeastSquaresError, QrAccumulator, ScaledFactor, expect};

/// Accumulator of rows for the moments of a regression.
#[derive(Debug, Clone)]
pub struct MomentsAccumulator {
    qr: QrAccumulator,
    least: Vec<f64>,
    greatest: Vec<f64>,
}

impl MomentsAccumulator {
    /// An empty accumulator for `terms` columns of A and `targets` columns of Y.
    pub fn new(terms: usize, targets: usize) -> Self {
        Self {
            qr: QrAccumulator::new(terms, targets),
            least: vec![f64::INFINITY; terms],
            greatest: vec![f64::NEG_INFINITY; terms],
        }
    }

    /// Folds in rows as [`QrAccumulator::push`] does: `a` row-major, one slice per target.
    ///
    /// # Errors
    /// Returns the errors of [`QrAccumulator::push`].
    pub fn push(&mut self, a: &[f64], targets: &[&[f64]]) -> Result<(), LeastSquaresError> {
        self.qr.push(a, targets)?;
        let terms = self.least.len();
        for row in a.chunks_exact(terms.max(1)) {
            for ((least, greatest), &x) in self.least.iter_mut().zip(&mut self.greatest).zip(row) {
                *least = if x < *least { x } else { *least };
                *greatest = if x > *greatest { x } else { *greatest };
            }
        }
        Ok(())
    }

    /// Accumulator for the targets `chosen` only, bit-identical to one that was filled with these targets only. An
    /// index without a target is ignored.
    pub fn select(&self, chosen: &[usize]) -> Self {
        Self { qr: self.qr.select(chosen), least: self.least.clone(), greatest: self.greatest.clone() }
    }

    /// The moments of all rows pushed.
    pub fn finish(self) -> RegressionMoments {
        let (terms, targets, rows) = (self.qr.terms, self.qr.targets, self.qr.rows);
        let (upper, unexplained) = taken(self.qr.triangle);
        RegressionMoments { rows, terms, targets, upper, unexplained, least: self.least, greatest: self.greatest }
    }
}

/// The triangular factor, and the residual sums of squares of the carried columns.
fn taken(mut triangle: QrTriangle) -> (Vec<f64>, Vec<f64>) {
    triangle.flush();
    let squares = triangle.squares().to_vec();
    (triangle.upper(), squares)
}

/// The statistics of rows [A | Y] for linear models: sizes, means, extremes and the triangular factor
/// of [1 | A | Y].
#[derive(Debug, Clone, PartialEq)]
pub struct RegressionMoments {
    rows: usize,
    terms: usize,
    targets: usize,
    /// Row-major; 1 + terms rows of 1 + terms + targets columns.
    upper: Vec<f64>,
    unexplained: Vec<f64>,
    least: Vec<f64>,
    greatest: Vec<f64>,
}

/// A linear model of one target in the units of the columns: y = intercept + Σ coefficient · term.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearFit {
    /// One coefficient per term: unit of the target over unit of the term.
    pub coefficients: Vec<f64>,
    /// Constant added to the sum of the terms, in the unit of the target.
    pub intercept: f64,
}

impl LinearFit {
    /// The model's values for rows of terms, row-major.
    pub fn predict(&self, a: &[f64]) -> Vec<f64> {
        let dot = |row: &[f64]| row.iter().zip(&self.coefficients).map(|(a, b)| a * b).sum::<f64>();
        a.chunks_exact(self.coefficients.len().max(1)).map(|row| self.intercept + dot(row)).collect()
    }
}

/// Statistics of a model's residuals from a target over some rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualStatistics {
    /// The number of rows.
    pub rows: usize,
    /// The sum of squared residuals.
    pub squares: f64,
    /// Sum of squared residuals after subtracting their mean.
    pub squares_about_mean: f64,
}

impl RegressionMoments {
    /// The moments of rows in memory: `a` row-major, one slice per target.
    ///
    /// # Errors
    /// Returns the errors of [`QrAccumulator::from_matrix`].
    pub fn from_matrix(a: &[f64], terms: usize, targets: &[&[f64]]) -> Result<Self, LeastSquaresError> {
        let mut accumulator = MomentsAccumulator::new(terms, targets.len());
        accumulator.push(a, targets)?;
        Ok(accumulator.finish())
    }

    fn none_like(&self) -> Self {
        MomentsAccumulator::new(self.terms, self.targets).finish()
    }

    /// Moments of the rows of `self` and `other` together. The last bits of the result depend on the order of merging:
    /// merge in the order of the lines.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] for moments with a different number of terms or targets.
    pub fn merge(&self, other: &Self) -> Result<Self, LeastSquaresError> {
        expect("the other line's terms", other.terms, self.terms)?;
        expect("the other line's targets", other.targets, self.targets)?;
        let mut triangle = QrTriangle::new(1 + self.terms, self.targets);
        for part in [self, other] {
            triangle.add_squares(&part.unexplained);
            part.upper.chunks_exact(self.width()).for_each(|row| triangle.push(row));
            triangle.flush();
        }
        let (upper, unexplained) = taken(triangle);
        let both = |one: &[f64], other: &[f64], of: fn(f64, f64) -> f64| {
            one.iter().zip(other).map(|(a, b)| of(*a, *b)).collect()
        };
        Ok(Self {
            rows: self.rows + other.rows,
            terms: self.terms,
            targets: self.targets,
            upper,
            unexplained,
            least: both(&self.least, &other.least, f64::min),
            greatest: both(&self.greatest, &other.greatest, f64::max),
        })
    }

    /// The moments of all lines together, in the order of the lines.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::NoRows`] without lines. Also returns the errors of [`Self::merge`].
    pub fn merged(lines: &[Self]) -> Result<Self, LeastSquaresError> {
        let (first, rest) = lines.split_first().ok_or(LeastSquaresError::NoRows)?;
        rest.iter().try_fold(first.clone(), |sum, line| sum.merge(line))
    }

    /// For each line, the moments of all other lines, with about three merges per line.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::TooFewLines`] for fewer than two lines. Also returns the errors of
    /// [`Self::merge`].
    pub fn leave_one_out(lines: &[Self]) -> Result<Vec<Self>, LeastSquaresError> {
        let first = lines.first().filter(|_| lines.len() > 1);
        let first = first.ok_or(LeastSquaresError::TooFewLines { given: lines.len() })?;
        // The moments of the lines after each line are computed first. The moments of the lines before each line are
        // computed within the loop.
        let mut behind = vec![first.none_like()];
        for line in lines.iter().skip(1).rev() {
            let next = line.merge(&behind[behind.len() - 1])?;
            behind.push(next);
        }
        let mut before = first.none_like();
        let mut others = Vec::with_capacity(lines.len());
        for (line, behind) in lines.iter().zip(behind.iter().rev()) {
            others.push(before.merge(behind)?);
            before = before.merge(line)?;
        }
        Ok(others)
    }

    /// The moments of a selection of terms and targets, in the requested order.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::NoSuch`] for an unknown term or target.
    pub fn select(&self, terms: &[usize], targets: &[usize]) -> Result<Self, LeastSquaresError> {
        let known = |what, chosen: &[usize], count| match chosen.iter().find(|c| **c >= count) {
            Some(&number) => Err(LeastSquaresError::NoSuch { what, number, count }),
            None => Ok(()),
        };
        known("term", terms, self.terms)?;
        known("target", targets, self.targets)?;
        let columns: Vec<usize> = std::iter::once(0)
            .chain(terms.iter().map(|t| 1 + t))
            .chain(targets.iter().map(|t| 1 + self.terms + t))
            .collect();
        let mut triangle = QrTriangle::new(1 + terms.len(), targets.len());
        let left: Vec<f64> = targets.iter().map(|&t| self.unexplained[t]).collect();
        triangle.add_squares(&left);
        for row in self.upper.chunks_exact(self.width()) {
            let row: Vec<f64> = columns.iter().map(|&c| row[c]).collect();
            triangle.push(&row);
        }
        let (upper, unexplained) = taken(triangle);
        Ok(Self {
            rows: self.rows,
            terms: terms.len(),
            targets: targets.len(),
            upper,
            unexplained,
            least: terms.iter().map(|&t| self.least[t]).collect(),
            greatest: terms.iter().map(|&t| self.greatest[t]).collect(),
        })
    }

    /// Moments of other columns that are linear combinations of these: column c is Σⱼ `weights`\[c\]\[j\] term j, minus
    /// `offsets`\[c\]; the targets are unchanged. The extremes of the new columns are unknown, so scaling by extremes
    /// has no effect.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] if the numbers of offsets and new columns differ. Also fails if the
    /// number of weights of a column differs from the number of terms.
    pub fn combined(&self, weights: &[Vec<f64>], offsets: &[f64]) -> Result<Self, LeastSquaresError> {
        expect("the list of offsets", offsets.len(), weights.len())?;
        for column in weights {
            expect("a column's list of weights", column.len(), self.terms)?;
        }
        let mut triangle = QrTriangle::new(1 + weights.len(), self.targets);
        triangle.add_squares(&self.unexplained);
        for row in self.upper.chunks_exact(self.width()) {
            let (own, targets) = row[1..].split_at(self.terms);
            let sum =
                |(w, offset): (&Vec<f64>, &f64)| w.iter().zip(own).map(|(w, x)| w * x).sum::<f64>() - offset * row[0];
            let new = weights.iter().zip(offsets).map(sum);
            let row: Vec<f64> = std::iter::once(row[0]).chain(new).chain(targets.iter().copied()).collect();
            triangle.push(&row);
        }
        let (upper, unexplained) = taken(triangle);
        let unknown = vec![f64::NAN; weights.len()];
        Ok(Self {
            rows: self.rows,
            terms: weights.len(),
            targets: self.targets,
            upper,
            unexplained,
            least: unknown.clone(),
            greatest: unknown,
        })
    }

    /// The moments of the same rows with each term multiplied by a factor above 0.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] if the numbers of factors and terms differ.
    pub fn scaled(&self, factors: &[f64]) -> Result<Self, LeastSquaresError> {
        expect("the list of factors", factors.len(), self.terms)?;
        let all: Vec<f64> =
            std::iter::once(1.0).chain(factors.iter().copied()).chain(std::iter::repeat_n(1.0, self.targets)).collect();
        let each = |values: &[f64]| values.iter().zip(factors).map(|(x, factor)| x * factor).collect();
        Ok(Self {
            upper: self.upper.iter().zip(all.iter().cycle()).map(|(x, factor)| x * factor).collect(),
            least: each(&self.least),
            greatest: each(&self.greatest),
            ..self.clone()
        })
    }

    /// The number of rows folded in.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The number of terms.
    pub fn terms(&self) -> usize {
        self.terms
    }

    /// The number of targets.
    pub fn targets(&self) -> usize {
        self.targets
    }

    /// The mean of each term, in the unit of the term; NaN without rows.
    pub fn term_means(&self) -> Vec<f64> {
        self.upper[1..=self.terms].iter().map(|sum| sum / self.upper[0]).collect()
    }

    /// The mean of each target, in the unit of the target; NaN without rows.
    pub fn target_means(&self) -> Vec<f64> {
        self.upper[1 + self.terms..self.width()].iter().map(|sum| sum / self.upper[0]).collect()
    }

    /// The standard deviation (divisor n − 1) of each term, in its unit.
    pub fn term_deviations(&self) -> Vec<f64> {
        let left = self.rows as f64 - 1.0;
        (0..self.terms).map(|j| (self.squares_about_mean(1 + j) / left).sqrt()).collect()
    }

    /// The standard deviation (divisor n − 1) of each target, in its unit.
    pub fn target_deviations(&self) -> Vec<f64> {
        let left = self.rows as f64 - 1.0;
        let squares = |t: usize| self.squares_about_mean(1 + self.terms + t) + self.unexplained[t];
        (0..self.targets).map(|t| (squares(t) / left).sqrt()).collect()
    }

    fn squares_about_mean(&self, column: usize) -> f64 {
        self.upper.chunks_exact(self.width()).skip(1).map(|row| row[column] * row[column]).sum()
    }

    /// Residual statistics of `fit` for one target over these rows (3.26), computed without reading a row.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] if the numbers of coefficients and terms differ, or with
    /// [`LeastSquaresError::NoSuch`] for an unknown target.
    pub fn residuals(&self, target: usize, fit: &LinearFit) -> Result<ResidualStatistics, LeastSquaresError> {
        expect("the list of coefficients", fit.coefficients.len(), self.terms)?;
        let unexplained = *self.unexplained.get(target).ok_or(LeastSquaresError::NoSuch {
            what: "target",
            number: target,
            count: self.targets,
        })?;
        let mut rows = self.upper.chunks_exact(self.width()).map(|row| {
            let explained: f64 = row[1..].iter().zip(&fit.coefficients).map(|(r, b)| r * b).sum();
            row[1 + self.terms + target] - row[0] * fit.intercept - explained
        });
        let of_mean = rows.next().unwrap_or_default();
        let about_mean = unexplained + rows.map(|r| r * r).sum::<f64>();
        Ok(ResidualStatistics {
            rows: self.rows,
            squares: about_mean + of_mean * of_mean,
            squares_about_mean: about_mean,
        })
    }

    /// The scaled columns, from which models are computed.
    ///
    /// With `intercept`, the means of terms and targets are subtracted. Without it, columns are divided by their scale
    /// but not shifted.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::NoRows`] without rows.
    pub fn prepare(&self, scaling: ColumnScaling, intercept: bool) -> Result<ScaledFactor, LeastSquaresError> {
        if self.rows == 0 {
            return Err(LeastSquaresError::NoRows);
        }
        let (p, width) = (self.terms, self.width());
        let (upper, unexplained) = if intercept {
            let below = self.upper.chunks_exact(width).skip(1);
            (below.flat_map(|row| row[1..].to_vec()).collect(), self.unexplained.clone())
        } else {
            let mut triangle = QrTriangle::new(p, self.targets);
            triangle.add_squares(&self.unexplained);
            self.upper.chunks_exact(width).for_each(|row| triangle.push(&row[1..]));
            taken(triangle)
        };
        let constant: Vec<bool> = self.least.iter().zip(&self.greatest).map(|(a, b)| a == b).collect();
        let scales = self.scales(scaling, &constant);
        Ok(ScaledFactor::new(
            self.rows,
            self.targets,
            upper,
            unexplained,
            self.term_means(),
            self.target_means(),
            scales,
            constant,
            intercept,
        ))
    }

    fn scales(&self, scaling: ColumnScaling, constant: &[bool]) -> Vec<f64> {
        let scales = match scaling {
            ColumnScaling::None => vec![1.0; self.terms],
            ColumnScaling::Standardise => self.term_deviations(),
            ColumnScaling::MaxAbs => self.extremes(|least, greatest| least.abs().max(greatest.abs())),
            ColumnScaling::MinMax => self.extremes(|least, greatest| greatest - least),
        };
        let usable = |(scale, constant): (f64, &bool)| {
            if *constant || !(scale > 0.0 && scale.is_finite()) { 1.0 } else { scale }
        };
        scales.into_iter().zip(constant).map(usable).collect()
    }

    fn extremes(&self, of: fn(f64, f64) -> f64) -> Vec<f64> {
        self.least.iter().zip(&self.greatest).map(|(a, b)| of(*a, *b)).collect()
    }

    fn width(&self) -> usize {
        1 + self.terms + self.targets
    }
}

/// Measure of the error at an omitted line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LineScoreMeasure {
    /// The mean squared error.
    #[default]
    MeanSquare,
    /// The variance (divisor n) of the error: a bias of the line is ignored, as in the error that Gnadt 2022 reports.
    Variance,
}

/// The leave-one-line-out scores of a list of candidates.
#[derive(Debug, Clone, PartialEq)]
pub struct LineScores {
    /// For each candidate, the score of each omitted line, in the square of the target's unit.
    pub scores: Vec<Vec<f64>>,
    /// For each candidate, the mean over the lines, with equal weights.
    pub mean: Vec<f64>,
    /// For each candidate, the standard deviation of the scores (n − 1) divided by the square root of the number of
    /// scores.
    pub standard_error: Vec<f64>,
    /// Index of the candidate with the smallest mean. Of several equal means, the first is used.
    pub best: usize,
    /// Index of the first candidate whose mean is within one standard error of the smallest mean.
    pub within_one_error: usize,
}

impl LineScores {
    fn new(scores: Vec<Vec<f64>>) -> Self {
        let lines = scores.first().map_or(0.0, |s| s.len() as f64);
        let mean: Vec<f64> = scores.iter().map(|s| s.iter().sum::<f64>() / lines).collect();
        let error = |(s, m): (&Vec<f64>, &f64)| {
            let squares: f64 = s.iter().map(|x| (x - m) * (x - m)).sum();
            (squares / (lines - 1.0) / lines).sqrt()
        };
        let standard_error: Vec<f64> = scores.iter().zip(&mean).map(error).collect();
        let best = (0..mean.len()).fold(0, |best, k| if mean[k] < mean[best] { k } else { best });
        let limit = mean.get(best).zip(standard_error.get(best)).map_or(f64::NAN, |(m, e)| m + e);
        let within_one_error = mean.iter().position(|m| *m <= limit).unwrap_or(best);
        Self { scores, mean, standard_error, best, within_one_error }
    }
}

/// Scores a list of candidates by omitting each line once. `fits` computes the candidates from the moments of all other
/// lines. It must always return the same number of candidates, from the simplest to the most complex.
///
/// Runs in parallel (rayon), one line per task; the result does not depend on the number of threads.
///
/// # Errors
/// Fails with [`LeastSquaresError::EmptyLine`] for a line without rows. Also returns the errors of
/// [`RegressionMoments::leave_one_out`], of `fits`, and of [`RegressionMoments::residuals`] for the candidates.
pub fn leave_line_out<F>(
    lines: &[RegressionMoments],
    target: usize,
    score: LineScoreMeasure,
    fits: F,
) -> Result<LineScores, LeastSquaresError>
where
    F: Fn(&RegressionMoments) -> Result<Vec<LinearFit>, LeastSquaresError> + Sync,
{
    if let Some(line) = lines.iter().position(|line| line.rows == 0) {
        return Err(LeastSquaresError::EmptyLine { line });
    }
    let others = RegressionMoments::leave_one_out(lines)?;
    let by_line: Vec<Vec<f64>> = lines
        .par_iter()
        .zip(&others)
        .map(|(line, others)| {
            let scored = |fit: &LinearFit| {
                let left = line.residuals(target, fit)?;
                let squares = match score {
                    LineScoreMeasure::MeanSquare => left.squares,
                    LineScoreMeasure::Variance => left.squares_about_mean,
                };
                Ok(squares / left.rows as f64)
            };
            fits(others)?.iter().map(scored).collect()
        })
        .collect::<Result<_, LeastSquaresError>>()?;
    let candidates = by_line.iter().map(Vec::len).min().unwrap_or(0);
    let of = |k: usize| by_line.iter().map(|scores| scores[k]).collect();
    Ok(LineScores::new((0..candidates).map(of).collect()))
}

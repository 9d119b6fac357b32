//! Robust regression: M-estimates by iteratively reweighted least squares.
//!
//! Each pass over the rows weights every row by its residual r over the scale σ, and solves a weighted least-squares
//! problem on the triangular factor. With Huber's loss, the weight is 1 up to the threshold ε, and ε σ/|r| beyond
//! [Huber 1981, "Robust Statistics"]. With Student's t and ν degrees of freedom, the weight is (ν + 1)/(ν + r²/σ²)
//! [Lange, Little & Taylor 1989], so the influence of outliers decreases with their distance.

use rayon::prelude::*;

use crate::regression::least_squares::{LeastSquaresError, LinearFit, QrAccumulator, expect, setting};

/// Upper quartile of the standard normal distribution: the median of |r|/σ.
const MEDIAN_OF_NORMALS: f64 = 0.674_489_750_196_081_7;

/// Loss function of residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ResidualLoss {
    /// Quadratic up to `threshold` standard deviations, linear beyond.
    Huber {
        /// Threshold ε. For normal noise, the estimate with 1.345 has 95 % of the efficiency of least squares.
        threshold: f64,
    },
    /// The likelihood of Student's t distribution.
    StudentT {
        /// ν, degrees of freedom: 3 to 5 for spikes, ∞ for least squares.
        degrees: f64,
    },
}

/// Estimator of the residuals' scale σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ResidualScaleEstimator {
    /// The median of |r| divided by 0.6745, recomputed in each pass, as in statsmodels' `RLM`.
    Mad,
    /// Estimation together with the coefficients. Huber: the minimum of n σ + Σ σ H(r/σ) + λ |β|², with H(z) = z² up to
    /// the threshold ε and 2 ε |z| − ε² beyond, as in scikit-learn's `HuberRegressor` (where ε is above 1). Student-t:
    /// the most likely σ.
    Joint,
    /// A given value, in the unit of the target.
    Fixed(f64),
}

/// The settings of a robust fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobustOptions {
    /// The loss.
    pub loss: ResidualLoss,
    /// The scale.
    pub scale: ResidualScaleEstimator,
    /// Ridge parameter λ: the penalty is λ |β|², or λ σ |β|² for Huber with a joint scale.
    pub lambda: f64,
    /// Whether there is an unpenalised intercept.
    pub intercept: bool,
    /// The iteration ends if the model's values and the scale change by less than this fraction of the scale.
    pub tolerance: f64,
    /// The maximum number of passes over the rows.
    pub passes: usize,
}

impl Default for RobustOptions {
    /// Defaults: Huber's loss with ε = 1.345, σ from the median of |r|, no ridge, an intercept.
    fn default() -> Self {
        Self {
            loss: ResidualLoss::Huber { threshold: 1.345 },
            scale: ResidualScaleEstimator::Mad,
            lambda: 0.0,
            intercept: true,
            tolerance: 1e-8,
            passes: 500,
        }
    }
}

/// Terms and targets of one line.
#[derive(Debug, Clone, Copy)]
pub struct LineRows<'a> {
    /// Row-major, one column per term.
    pub a: &'a [f64],
    /// The target of each row.
    pub y: &'a [f64],
}

/// The result of a robust fit.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustFit {
    /// The model.
    pub fit: LinearFit,
    /// σ, in the unit of the target.
    pub scale: f64,
    /// For each line, the weight of each row; below 1 for down-weighted rows.
    pub weights: Vec<Vec<f64>>,
    /// The number of passes.
    pub passes: usize,
    /// Whether the tolerance was reached.
    pub converged: bool,
}

impl RobustOptions {
    /// The fit to all lines. The fit allocates a weight and a residual per row. A pass runs in parallel (rayon), one
    /// line per task, with the same result for any number of threads.
    ///
    /// # Errors
    ///
    /// Fails for settings out of range, for rows that are not finite (numbered within their line), or for dependent
    /// terms without a ridge.
    pub fn fit<S: AsRef<str>>(&self, lines: &[LineRows<'_>], names: &[S]) -> Result<RobustFit, LeastSquaresError> {
        self.check()?;
        let rows: usize = lines.iter().map(|line| line.y.len()).sum();
        let mut weights: Vec<Vec<f64>> = lines.iter().map(|line| vec![1.0; line.y.len()]).collect();
        let (mut fit, mut left) = (self.weighted(lines, &weights, self.lambda, names)?, Vec::new());
        left.extend(residuals(lines, &fit));
        let mut scale = self.first_scale(&left);
        for pass in 2..=self.passes {
            if scale == 0.0 {
                return Ok(RobustFit { fit, scale, weights, passes: pass - 1, converged: true });
            }
            weights = left.iter().map(|left| left.iter().map(|r| self.weight(r / scale)).collect()).collect();
            let lambda = if self.penalty_by_scale() { self.lambda * scale } else { self.lambda };
            fit = self.weighted(lines, &weights, lambda, names)?;
            let now = residuals(lines, &fit);
            let moved: f64 = now.iter().flatten().zip(left.iter().flatten()).map(|(a, b)| (a - b) * (a - b)).sum();
            let (before, size) = (scale, (moved / rows as f64).sqrt());
            left = now;
            scale = self.next_scale(&left, scale);
            if size <= self.tolerance * scale && (scale - before).abs() <= self.tolerance * scale {
                return Ok(RobustFit { fit, scale, weights, passes: pass, converged: true });
            }
        }
        Ok(RobustFit { fit, scale, weights, passes: self.passes, converged: false })
    }

    fn check(&self) -> Result<(), LeastSquaresError> {
        match self.loss {
            ResidualLoss::Huber { threshold } => {
                let least = if self.scale == ResidualScaleEstimator::Joint { 1.0 } else { 0.0 };
                let wanted = "above 0, and above 1 with a joint scale";
                setting("Huber's threshold", threshold, wanted, threshold > least && threshold.is_finite())?;
            }
            ResidualLoss::StudentT { degrees } => setting("the degrees of freedom", degrees, "above 0", degrees > 0.0)?,
        }
        if let ResidualScaleEstimator::Fixed(scale) = self.scale {
            setting("the scale", scale, "above 0", scale > 0.0 && scale.is_finite())?;
        }
        setting("the tolerance", self.tolerance, "above 0", self.tolerance > 0.0)?;
        setting("the number of passes", self.passes as f64, "at least 2", self.passes >= 2)
    }

    fn penalty_by_scale(&self) -> bool {
        self.scale == ResidualScaleEstimator::Joint && matches!(self.loss, ResidualLoss::Huber { .. })
    }

    fn weight(&self, z: f64) -> f64 {
        match self.loss {
            ResidualLoss::Huber { threshold } if z.abs() <= threshold => 1.0,
            ResidualLoss::Huber { threshold } => threshold / z.abs(),
            ResidualLoss::StudentT { degrees } if degrees.is_infinite() => 1.0,
            ResidualLoss::StudentT { degrees } => (degrees + 1.0) / (degrees + z * z),
        }
    }

    fn first_scale(&self, left: &[Vec<f64>]) -> f64 {
        match self.scale {
            ResidualScaleEstimator::Fixed(scale) => scale,
            ResidualScaleEstimator::Mad | ResidualScaleEstimator::Joint => mad(left),
        }
    }

    fn next_scale(&self, left: &[Vec<f64>], scale: f64) -> f64 {
        match (self.scale, self.loss) {
            (ResidualScaleEstimator::Fixed(scale), _) => scale,
            (ResidualScaleEstimator::Mad, _) => mad(left),
            (ResidualScaleEstimator::Joint, ResidualLoss::Huber { threshold }) => huber_scale(left, threshold),
            (ResidualScaleEstimator::Joint, ResidualLoss::StudentT { .. }) => {
                let rows = left.iter().map(Vec::len).sum::<usize>() as f64;
                let squares: f64 = left.iter().flatten().map(|r| self.weight(r / scale) * r * r).sum();
                (squares / rows).sqrt()
            }
        }
    }

    fn weighted<S: AsRef<str>>(
        &self,
        lines: &[LineRows<'_>],
        weights: &[Vec<f64>],
        lambda: f64,
        names: &[S],
    ) -> Result<LinearFit, LeastSquaresError> {
        let terms = names.len();
        let factors: Vec<QrAccumulator> = lines
            .par_iter()
            .zip(weights)
            .map(|(line, weights)| {
                let mut factor = QrAccumulator::new(terms, 1);
                factor.push_weighted(line.a, &[line.y], weights)?;
                Ok(factor)
            })
            .collect::<Result<_, LeastSquaresError>>()?;
        let mut all = QrAccumulator::new(terms, 1);
        factors.into_iter().try_for_each(|factor| all.merge(factor))?;
        let path = if self.intercept { all.solve_centred(&[lambda], names)? } else { all.solve(&[lambda], names)? };
        let mut solution = path.solutions.into_iter().next().ok_or(LeastSquaresError::NoRows)?;
        expect("the list of targets", solution.coefficients.len(), 1)?;
        Ok(LinearFit { coefficients: solution.coefficients.swap_remove(0), intercept: solution.intercepts[0] })
    }
}

fn residuals(lines: &[LineRows<'_>], fit: &LinearFit) -> Vec<Vec<f64>> {
    let of = |line: &LineRows<'_>| fit.predict(line.a).iter().zip(line.y).map(|(fit, y)| y - fit).collect();
    lines.par_iter().map(of).collect()
}

/// Median of |r| divided by the median of |x| for standard normal x.
fn mad(left: &[Vec<f64>]) -> f64 {
    let mut sizes: Vec<f64> = left.iter().flatten().map(|r| r.abs()).collect();
    let half = sizes.len() / 2;
    if sizes.is_empty() {
        return 0.0;
    }
    let even = sizes.len().is_multiple_of(2);
    let (below, middle, _) = sizes.select_nth_unstable_by(half, f64::total_cmp);
    let middle = if even { 0.5 * (*middle + below.iter().copied().fold(0.0, f64::max)) } else { *middle };
    middle / MEDIAN_OF_NORMALS
}

/// σ with Σ min(r²/σ², ε²) = n: the minimum of the joint objective with respect to σ.
///
/// The sum is concave and piecewise linear in 1/σ². Newton's method from below therefore never overshoots and ends
/// after finitely many steps.
fn huber_scale(left: &[Vec<f64>], threshold: f64) -> f64 {
    let rows = left.iter().map(Vec::len).sum::<usize>() as f64;
    let limit = threshold * threshold;
    let mut inverse = 0.0;
    loop {
        let (mut inside, mut outside) = (0.0, 0.0);
        for square in left.iter().flatten().map(|r| r * r) {
            if square * inverse <= limit {
                inside += square;
            } else {
                outside += limit;
            }
        }
        let next = (rows - outside) / inside;
        if !next.is_finite() || next <= 0.0 {
            return 0.0;
        }
        if next <= inverse * (1.0 + 4.0 * f64::EPSILON) {
            return next.sqrt().recip();
        }
        inverse = next;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::random::NormalGenerator;
    use crate::reference_csv::{TERMS, columns, model_lines};

    fn lines() -> Vec<(Vec<f64>, Vec<f64>)> {
        model_lines().into_iter().map(|line| (line.a, line.y1)).collect()
    }

    fn rows(lines: &[(Vec<f64>, Vec<f64>)]) -> Vec<LineRows<'_>> {
        lines.iter().map(|(a, y)| LineRows { a, y }).collect()
    }

    #[test]
    fn val_huber_and_student_equal_scikit_learn_statsmodels_and_scipy() {
        let lines = lines();
        let table = columns(include_str!("../../reference/models/robust.csv"));
        assert_eq!(table["kind"].len(), 5);
        for (row, &tuning) in table["tuning"].iter().enumerate() {
            let (loss, scale) = match table["kind"][row] {
                0.0 => (ResidualLoss::Huber { threshold: tuning }, ResidualScaleEstimator::Joint),
                1.0 => (ResidualLoss::Huber { threshold: tuning }, ResidualScaleEstimator::Mad),
                _ => (ResidualLoss::StudentT { degrees: tuning }, ResidualScaleEstimator::Joint),
            };
            let lambda = table["penalty"][row];
            let robust =
                RobustOptions { loss, scale, lambda, tolerance: 1e-11, passes: 5000, ..RobustOptions::default() };
            let fit = robust.fit(&rows(&lines), &TERMS).unwrap();
            assert!(fit.converged, "{}", fit.passes);
            // BFGS ends when the objective no longer changes; then only half of the digits of the coefficients are
            // correct.
            let near = |ours: f64, theirs: f64| {
                assert!((ours - theirs).abs() <= 2e-5 * (theirs.abs() + 1e-2), "row {row}: {ours} {theirs}");
            };
            near(fit.scale, table["scale"][row]);
            near(fit.fit.intercept, table["intercept"][row]);
            for (ours, name) in fit.fit.coefficients.iter().zip(TERMS) {
                near(*ours, table[name][row]);
            }
        }
    }

    #[test]
    fn law_spikes_move_least_squares_and_not_the_robust_fit() {
        let mut normals = NormalGenerator::new(7);
        let a: Vec<f64> = (0..1000).map(|_| normals.draw()).collect();
        let spike = |i: usize| if i.is_multiple_of(20) { 500.0 } else { 0.0 };
        let y: Vec<f64> = a.iter().enumerate().map(|(i, a)| 2.0 * a + 1.0 + 0.1 * normals.draw() + spike(i)).collect();
        let lines = [LineRows { a: &a, y: &y }];
        for loss in [ResidualLoss::Huber { threshold: 1.345 }, ResidualLoss::StudentT { degrees: 3.0 }] {
            let fit = RobustOptions { loss, ..RobustOptions::default() }.fit(&lines, &["a"]).unwrap();
            // 950 good rows with noise of 0.1 give an error of 0.003; the spikes shift Huber's fit by 0.1 · 5 % in
            // addition.
            assert!((fit.fit.coefficients[0] - 2.0).abs() < 0.015, "{:?} {}", fit.fit, fit.passes);
            assert!((fit.fit.intercept - 1.0).abs() < 0.03, "{:?}", fit.fit);
            assert!(fit.weights[0][20] < 1e-2 && fit.scale < 0.15);
        }
        let squares = RobustOptions { loss: ResidualLoss::Huber { threshold: 1e9 }, ..RobustOptions::default() }
            .fit(&lines, &["a"])
            .unwrap();
        assert!((squares.fit.intercept - 26.0).abs() < 0.5);
    }

    #[test]
    fn law_a_wide_threshold_without_outliers_gives_least_squares() {
        let lines = lines();
        let robust =
            RobustOptions { loss: ResidualLoss::Huber { threshold: 1e6 }, lambda: 2.0, ..RobustOptions::default() };
        let fit = robust.fit(&rows(&lines), &TERMS).unwrap();
        let (mut a, mut y) = (Vec::new(), Vec::new());
        for (line, target) in &lines {
            a.extend(line);
            y.extend(target);
        }
        let squares = QrAccumulator::from_matrix(&a, 8, &[&y]).unwrap().solve_centred(&[2.0], &TERMS).unwrap();
        for (ours, theirs) in fit.fit.coefficients.iter().zip(&squares.solutions[0].coefficients[0]) {
            assert!((ours - theirs).abs() < 1e-9 * (theirs.abs() + 1e-3), "{ours} {theirs}");
        }
        assert_eq!(fit.passes, 2);
    }

    #[test]
    fn law_an_exact_fit_ends_with_a_scale_of_zero() {
        let a: Vec<f64> = (0..20).map(f64::from).collect();
        let y = vec![0.0; 20];
        let fit = RobustOptions::default().fit(&[LineRows { a: &a, y: &y }], &["a"]).unwrap();
        assert_eq!((fit.scale, fit.fit.coefficients[0], fit.converged), (0.0, 0.0, true));
    }

    #[test]
    fn unit_settings_out_of_range_are_rejected() {
        let lines = [LineRows { a: &[1.0, 2.0], y: &[1.0, 3.0] }];
        let message = |robust: RobustOptions| robust.fit(&lines, &["a"]).unwrap_err().to_string();
        let joint = RobustOptions {
            loss: ResidualLoss::Huber { threshold: 0.9 },
            scale: ResidualScaleEstimator::Joint,
            ..RobustOptions::default()
        };
        assert!(message(joint).contains("above 1 with a joint scale, but is 0.9"));
        assert!(
            message(RobustOptions { loss: ResidualLoss::StudentT { degrees: 0.0 }, ..RobustOptions::default() })
                .contains("degrees")
        );
        assert!(
            message(RobustOptions { scale: ResidualScaleEstimator::Fixed(-1.0), ..RobustOptions::default() })
                .contains("but is -1")
        );
        assert!(message(RobustOptions { passes: 1, ..RobustOptions::default() }).contains("at least 2"));
        let bad = [LineRows { a: &[1.0, f64::NAN], y: &[1.0, 3.0] }];
        assert!(RobustOptions::default().fit(&bad, &["a"]).unwrap_err().to_string().contains("row 1 of term 0"));
    }
}

//! Choice of the ridge parameter: generalised cross-validation, L-curve and cross-validation over lines.
//!
//! One singular value decomposition R = U S Vᵀ of the (scaled) factor is sufficient for a whole grid of λ. With c = Uᵀ
//! z, ‖r‖² = ‖z − R b‖² + unexplained = Σ (λ c/(s² + λ))² + unexplained, ‖b‖² = Σ (s c/(s² + λ))², and the number of
//! parameters is Σ s²/(s² + λ).

use crate::regression::l_curve::log_curvature;
use crate::regression::least_squares::{
    ColumnScaling, LeastSquaresError, LineScoreMeasure, LineScores, LinearFit, RegressionMoments, ScaledFactor,
    leave_line_out, setting,
};

/// If the logarithms of misfit and norm change by less than this over two steps of λ, the curvature of the curve is
/// dominated by rounding.
const STANDS_STILL: f64 = 1e-6;

/// The scores of a fit with one λ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LambdaPoint {
    /// The ridge parameter of the scaled columns, absolute (not divided by the number of rows).
    pub lambda: f64,
    /// ‖y − A β‖², in the target's unit squared.
    pub residual_squares: f64,
    /// ‖b‖ for the coefficients of the scaled columns.
    pub size: f64,
    /// The effective number of parameters, including the intercept.
    pub degrees_of_freedom: f64,
    /// n ‖r‖²/(n − degrees of freedom)²: the expected mean squared error at unseen rows, if the noise is uncorrelated.
    /// NaN if no degrees of freedom remain. [Golub, Heath & Wahba 1979]
    pub generalised: f64,
    /// The curvature of log ‖b‖ as a function of log ‖r‖; 0 at the first and last λ.
    pub curvature: f64,
}

/// `count` values from `first` to `last`, evenly spaced in the logarithm.
///
/// # Errors
/// Fails with [`LeastSquaresError::Setting`] for an end that is not a finite number above 0.
pub fn grid(first: f64, last: f64, count: usize) -> Result<Vec<f64>, LeastSquaresError> {
    for end in [first, last] {
        setting("the first or last lambda of a grid", end, "above 0", end > 0.0 && end.is_finite())?;
    }
    let steps = count.saturating_sub(1).max(1) as f64;
    Ok((0..count).map(|k| first * (last / first).powf(k as f64 / steps)).collect())
}

/// Misfit, solution norm and scores of one target for each of `lambdas`, which ascend evenly in their logarithm
/// ([`grid`]).
///
/// # Errors
///
/// Fails for an uneven grid, an unknown target, or a decomposition that does not converge.
pub fn curve(prepared: &ScaledFactor, target: usize, lambdas: &[f64]) -> Result<Vec<LambdaPoint>, LeastSquaresError> {
    let wanted = "in a list whose logarithms ascend in equal steps";
    let first = lambdas.first().copied().unwrap_or(1.0);
    setting("lambda", first, wanted, first > 0.0 && first.is_finite())?;
    let ratio = lambdas.get(1).map_or(2.0, |second| second / first);
    for pair in lambdas.windows(2) {
        let even = (pair[1] / pair[0] / ratio - 1.0).abs() < 1e-6 && pair[1] > pair[0];
        setting("lambda", pair[1], wanted, even)?;
    }
    prepared.along(target)?;
    let singular = prepared.singular()?;
    let (values, along) = (&singular.values, &singular.projections[target]);
    let mut points: Vec<LambdaPoint> =
        lambdas.iter().map(|&lambda| point(prepared, values, along, prepared.unexplained(target), lambda)).collect();
    let curvatures: Vec<f64> = points.windows(3).map(curvature).collect();
    points.iter_mut().skip(1).zip(curvatures).for_each(|(point, curvature)| point.curvature = curvature);
    Ok(points)
}

fn point(prepared: &ScaledFactor, values: &[f64], along: &[f64], unexplained: f64, lambda: f64) -> LambdaPoint {
    let (mut squares, mut size, mut fitted) = (unexplained, 0.0, 0.0);
    for (s, c) in values.iter().zip(along) {
        let damped = s * s + lambda;
        squares += (lambda * c / damped).powi(2);
        size += (s * c / damped).powi(2);
        fitted += s * s / damped;
    }
    let (n, degrees) = (prepared.rows() as f64, fitted + f64::from(u8::from(prepared.intercept())));
    let over = n - degrees;
    let generalised = if over > 0.0 { n * squares / (over * over) } else { f64::NAN };
    LambdaPoint {
        lambda,
        residual_squares: squares,
        size: size.sqrt(),
        degrees_of_freedom: degrees,
        generalised,
        curvature: 0.0,
    }
}

fn curvature(points: &[LambdaPoint]) -> f64 {
    let misfit = [0, 1, 2].map(|k| points[k].residual_squares.sqrt());
    let size = [0, 1, 2].map(|k| points[k].size);
    let moved = (misfit[2] / misfit[0]).ln().hypot((size[2] / size[0]).ln());
    if moved < STANDS_STILL { 0.0 } else { log_curvature(misfit, size) }
}

/// Index of the point with the smallest expected error; `None` if no score is defined.
pub fn by_generalised_cross_validation(points: &[LambdaPoint]) -> Option<usize> {
    let defined = (0..points.len()).filter(|&k| points[k].generalised.is_finite());
    defined.min_by(|&a, &b| points[a].generalised.total_cmp(&points[b].generalised))
}

/// Index of the point at the corner, as chosen by van der Meer 2025; `None` if the curve has no corner. If the true
/// coefficients are smooth, this ridge is weaker than the best ridge by one or two decades of λ.
pub fn by_l_curve(points: &[LambdaPoint]) -> Option<usize> {
    let bent = (0..points.len()).filter(|&k| points[k].curvature > 0.0);
    bent.max_by(|&a, &b| points[a].curvature.total_cmp(&points[b].curvature))
}

/// The leave-one-line-out prediction error of each λ. The candidates are in the order of `lambdas`. If `lambdas`
/// descend, the choice within one standard error is the strongest ridge.
///
/// # Errors
/// Fails with [`LeastSquaresError::Setting`] for a lambda that is not a finite number above 0. Also returns the errors
/// of [`leave_line_out`] and [`fits`].
pub fn by_lines(
    lines: &[RegressionMoments],
    target: usize,
    lambdas: &[f64],
    scaling: ColumnScaling,
    intercept: bool,
    score: LineScoreMeasure,
) -> Result<LineScores, LeastSquaresError> {
    let bad = lambdas.iter().find(|l| !(**l > 0.0 && l.is_finite()));
    setting("lambda", bad.copied().unwrap_or(1.0), "above 0", bad.is_none())?;
    leave_line_out(lines, target, score, |others| fits(&others.prepare(scaling, intercept)?, target, lambdas))
}

/// The ridge fits of one target for lambdas above 0, from one decomposition.
///
/// # Errors
/// Fails for an unknown target. Also fails if the decomposition does not converge.
pub fn fits(prepared: &ScaledFactor, target: usize, lambdas: &[f64]) -> Result<Vec<LinearFit>, LeastSquaresError> {
    prepared.along(target)?;
    let singular = prepared.singular()?;
    let along = &singular.projections[target];
    let fit = |lambda: &f64| {
        let mut b = vec![0.0; prepared.terms()];
        for ((s, c), v) in singular.values.iter().zip(along).zip(&singular.right) {
            let size = s * c / (s * s + lambda);
            b.iter_mut().zip(v).for_each(|(b, v)| *b += size * v);
        }
        prepared.original(target, &b)
    };
    Ok(lambdas.iter().map(fit).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::random::NormalGenerator;
    use crate::reference_csv::{TERMS, model_lines};
    use nalgebra::{DMatrix, DVector};

    fn lines() -> Vec<(Vec<f64>, Vec<f64>)> {
        model_lines().into_iter().map(|line| (line.a, line.y0)).collect()
    }

    fn moments() -> Vec<RegressionMoments> {
        lines().iter().map(|(a, y)| RegressionMoments::from_matrix(a, 8, &[y]).unwrap()).collect()
    }

    fn near(one: f64, other: f64, relative: f64) {
        assert!((one - other).abs() <= relative * other.abs(), "{one} {other}");
    }

    #[test]
    fn law_generalised_cross_validation_is_that_of_the_hat_matrix() {
        let (a, y): (Vec<f64>, Vec<f64>) = {
            let lines = lines();
            (lines.iter().flat_map(|l| l.0.clone()).collect(), lines.iter().flat_map(|l| l.1.clone()).collect())
        };
        let n = y.len();
        let a = DMatrix::from_row_slice(n, 8, &a);
        let means = a.row_mean();
        let centred = DMatrix::from_fn(n, 8, |i, j| a[(i, j)] - means[j]);
        let scaled = DMatrix::from_fn(n, 8, |i, j| centred[(i, j)] / (centred.column(j).norm() / 119f64.sqrt()));
        let y = DVector::from_vec(y);
        let prepared =
            RegressionMoments::merged(&moments()).unwrap().prepare(ColumnScaling::Standardise, true).unwrap();
        let lambdas = grid(1e-2, 1e4, 7).unwrap();
        for point in curve(&prepared, 0, &lambdas).unwrap() {
            let inner = scaled.transpose() * &scaled + DMatrix::identity(8, 8) * point.lambda;
            let hat = &scaled * inner.try_inverse().unwrap() * scaled.transpose();
            let hat = hat.add_scalar(1.0 / n as f64);
            let left = &y - &hat * &y;
            let over = n as f64 - hat.trace();
            near(point.generalised, n as f64 * left.norm_squared() / (over * over), 1e-9);
            near(point.residual_squares, left.norm_squared(), 1e-9);
            near(point.degrees_of_freedom, hat.trace(), 1e-10);
        }
    }

    #[test]
    fn law_generalised_cross_validation_finds_the_prediction_error() {
        // Over 200 draws of the noise, the mean score at each lambda equals the mean error on new noise, within the
        // scatter of the score.
        let (rows, p) = (60, 12);
        let mut normals = NormalGenerator::new(3);
        let a: Vec<f64> = (0..rows * p).map(|_| normals.draw()).collect();
        let truth: Vec<f64> = (0..p).map(|_| 0.3 * normals.draw()).collect();
        let clean: Vec<f64> = a.chunks(p).map(|r| r.iter().zip(&truth).map(|(a, b)| a * b).sum()).collect();
        let lambdas = grid(0.1, 1000.0, 9).unwrap();
        let (mut told, mut met) = (vec![0.0; 9], vec![0.0; 9]);
        for _ in 0..200 {
            let y: Vec<f64> = clean.iter().map(|c| c + normals.draw()).collect();
            let moments = RegressionMoments::from_matrix(&a, p, &[&y]).unwrap();
            let prepared = moments.prepare(ColumnScaling::None, false).unwrap();
            let fits = fits(&prepared, 0, &lambdas).unwrap();
            for (k, point) in curve(&prepared, 0, &lambdas).unwrap().iter().enumerate() {
                told[k] += point.generalised / 200.0;
                let off: f64 = fits[k].predict(&a).iter().zip(&clean).map(|(f, c)| (f - c).powi(2)).sum();
                met[k] += (1.0 + off / rows as f64) / 200.0;
            }
        }
        for (told, met) in told.iter().zip(&met) {
            // A variance over 60 rows and 200 draws has a scatter of 1.3 %; the score itself is too large by (p/n)² = 4
            // %.
            assert!((told / met - 1.0).abs() < 0.08, "{told} {met}");
        }
    }

    #[test]
    fn law_scores_of_omitted_lines_equal_those_of_refits() {
        let (lines, moments) = (lines(), moments());
        let lambdas = [50.0, 0.5];
        let scores =
            by_lines(&moments, 0, &lambdas, ColumnScaling::MaxAbs, true, LineScoreMeasure::MeanSquare).unwrap();
        for (out, (a, y)) in lines.iter().enumerate() {
            let kept: Vec<RegressionMoments> = (0..4).filter(|&l| l != out).map(|l| moments[l].clone()).collect();
            let prepared = RegressionMoments::merged(&kept).unwrap().prepare(ColumnScaling::MaxAbs, true).unwrap();
            let path = prepared.ridge(&lambdas, &TERMS).unwrap();
            for (k, solution) in path.solutions.iter().enumerate() {
                let fit =
                    LinearFit { coefficients: solution.coefficients[0].clone(), intercept: solution.intercepts[0] };
                let squares: f64 = fit.predict(a).iter().zip(y).map(|(f, y)| (y - f) * (y - f)).sum();
                near(scores.scores[k][out], squares / y.len() as f64, 1e-9);
            }
        }
    }

    /// Phillips' problem of 1962, an integral equation with a smooth kernel: 200 rows and 24 unknowns.
    fn phillips(seed: u64) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let at = |k: usize, n: usize| -6.0 + 12.0 * (k as f64 + 0.5) / n as f64;
        let phi = |x: f64| if x.abs() < 3.0 { 1.0 + (std::f64::consts::PI * x / 3.0).cos() } else { 0.0 };
        let entry = |ij: usize| 0.5 * phi(at(ij / 24, 200) - at(ij % 24, 24));
        let a: Vec<f64> = (0..200 * 24).map(entry).collect();
        let truth: Vec<f64> = (0..24).map(|k| phi(at(k, 24))).collect();
        let mut normals = NormalGenerator::new(seed);
        let mut noisy = |r: &[f64]| r.iter().zip(&truth).map(|(a, b)| a * b).sum::<f64>() + 0.1 * normals.draw();
        let y = a.chunks(24).map(&mut noisy).collect();
        (a, truth, y)
    }

    #[test]
    fn law_the_corner_of_a_known_tikhonov_problem_is_near_its_best_lambda() {
        let lambdas = grid(1e-8, 1e2, 81).unwrap();
        let (mut by_score, mut by_corner) = (Vec::new(), Vec::new());
        for seed in 0..8 {
            let (a, truth, y) = phillips(seed);
            let prepared =
                RegressionMoments::from_matrix(&a, 24, &[&y]).unwrap().prepare(ColumnScaling::None, false).unwrap();
            let points = curve(&prepared, 0, &lambdas).unwrap();
            let error = |fit: &LinearFit| {
                let off: f64 = fit.coefficients.iter().zip(&truth).map(|(b, t)| (b - t).powi(2)).sum();
                (off / truth.iter().map(|t| t * t).sum::<f64>()).sqrt()
            };
            let errors: Vec<f64> = fits(&prepared, 0, &lambdas).unwrap().iter().map(error).collect();
            let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
            let corner = errors[by_l_curve(&points).unwrap()];
            by_score.push(errors[by_generalised_cross_validation(&points).unwrap()] / best);
            by_corner.push(corner / best);
            assert!(corner < 0.1 * errors[0] && corner < 0.5 * errors[80], "{seed} {corner}");
            assert!(points.windows(2).all(|p| p[1].size < p[0].size && p[1].residual_squares >= p[0].residual_squares));
        }
        // From a computation in numpy with other draws: the error of the corner is 1.5 to 4 times the smallest error,
        // because its lambda is too small for a smooth truth [Hanke 1996]. The error of cross-validation is 1.1 to 2
        // times the smallest error, but occasionally it fits noise; medians are therefore compared. The errors at the
        // two ends of the grid are 60 and 9 times the smallest error.
        by_score.sort_by(f64::total_cmp);
        by_corner.sort_by(f64::total_cmp);
        assert!(by_score[4] < 2.5 && by_corner[4] < 4.0, "{by_score:?} {by_corner:?}");
    }

    #[test]
    fn unit_uneven_and_zero_lambdas_are_rejected() {
        let prepared = moments()[0].prepare(ColumnScaling::None, true).unwrap();
        for lambdas in [vec![0.0, 1.0], vec![1.0, 2.0, 3.0], vec![2.0, 1.0]] {
            let error = curve(&prepared, 0, &lambdas).unwrap_err().to_string();
            assert!(error.contains("ascend in equal steps"), "{error}");
        }
        assert!(grid(0.0, 1.0, 3).is_err() && curve(&prepared, 5, &[1.0]).is_err());
        assert!(by_lines(&moments(), 0, &[0.0], ColumnScaling::None, true, LineScoreMeasure::MeanSquare).is_err());
        assert_eq!((by_l_curve(&[]), by_generalised_cross_validation(&[])), (None, None));
    }
}

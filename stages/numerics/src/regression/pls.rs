//! Partial least squares: regression on the few combinations of terms that have the largest covariance with the
//! targets.
//!
//! Gnadt 2022 (3.33)-(3.43), for standardised columns: u is the leading left singular vector of the covariances with
//! the targets (3.34). The loadings p and q (3.37)-(3.38) deflate columns and targets (3.41)-(3.42). After k
//! components, β = U (Pᵀ U)⁻¹ Qᵀ (3.43). scikit-learn's `PLSRegression(scale=True)` gives the same results as this
//! module, for one target and for several.
//!
//! The computation uses the p x p triangular factor. The factor has the same scores as the rows, and avoids
//! covariances, which would square the condition number. The inverse of Pᵀ U, which is unit upper triangular, is never
//! formed. Each component adds r qᵀ to β, where r is u minus Σ (pᵀ u) r over the earlier components [de Jong 1993,
//! "SIMPLS"]. A single pass therefore gives the fits for all numbers of components.

use faer::Mat;

use crate::inner_product::dot;
use crate::regression::least_squares::{
    ColumnScaling, LeastSquaresError, LineScoreMeasure, LineScores, LinearFit, RegressionMoments, leave_line_out,
    setting,
};

/// The remaining covariance with the targets is treated as rounding error if it is below this fraction of the initial
/// covariance.
const NOTHING_LEFT: f64 = 1e-13;

/// The fits with 1, 2, ... components.
#[derive(Debug, Clone, PartialEq)]
pub struct PlsPath {
    /// For each number of components, from 1, the model of each target in the columns' own units.
    pub fits: Vec<Vec<LinearFit>>,
    /// For each number of components, the sum of squared residuals of each target.
    pub residual_squares: Vec<Vec<f64>>,
    /// Each component's weights u of the scaled terms, of length 1, defined up to their sign.
    pub weights: Vec<Vec<f64>>,
    /// Each component's loadings p of the scaled terms.
    pub loadings: Vec<Vec<f64>>,
    /// Each component's loadings q of the scaled targets.
    pub target_loadings: Vec<Vec<f64>>,
}

/// Joint fits of all `targets` with 1 to `components` components.
///
/// `scaling` applies to the terms; the targets are always divided by their standard deviation (n − 1), which matters
/// for several targets. The means of terms and targets are subtracted. The path is shorter than requested if no
/// covariance remains.
///
/// # Errors
///
/// Fails for zero components or an unknown target, or if there are no rows.
pub fn fit(
    moments: &RegressionMoments,
    targets: &[usize],
    components: usize,
    scaling: ColumnScaling,
) -> Result<PlsPath, LeastSquaresError> {
    setting("the number of components", components as f64, "at least 1", components > 0)?;
    let terms: Vec<usize> = (0..moments.terms()).collect();
    let moments = moments.select(&terms, targets)?;
    let prepared = moments.prepare(scaling, true)?;
    let deviations: Vec<f64> =
        moments.target_deviations().iter().map(|s| if *s > 0.0 && s.is_finite() { *s } else { 1.0 }).collect();
    let (p, m) = (prepared.terms(), targets.len());
    let mut x: Vec<Vec<f64>> = prepared.factor().chunks_exact(p.max(1)).map(<[f64]>::to_vec).collect();
    let along: Vec<&[f64]> = (0..m).map(|t| prepared.along(t)).collect::<Result<_, _>>()?;
    let mut y: Vec<Vec<f64>> = (0..p).map(|i| (0..m).map(|t| along[t][i] / deviations[t]).collect()).collect();
    let mut path =
        PlsPath { fits: vec![], residual_squares: vec![], weights: vec![], loadings: vec![], target_loadings: vec![] };
    let mut rotations: Vec<Vec<f64>> = Vec::new();
    let mut beta = vec![vec![0.0; p]; m];
    let first = covariance_size(&x, &y);
    while path.weights.len() < components.min(p) {
        let covariance = products(&x, &y);
        if frobenius(&covariance) <= NOTHING_LEFT * first {
            break;
        }
        let u = leading(&covariance)?;
        let score: Vec<f64> = x.iter().map(|row| dot(row, &u)).collect();
        let square = dot(&score, &score);
        let (loading, target_loading) = (against(&x, &score, square), against(&y, &score, square));
        deflate(&mut x, &score, &loading);
        deflate(&mut y, &score, &target_loading);
        let mut rotation = u.clone();
        for (earlier, loading) in rotations.iter().zip(&path.loadings) {
            let part = dot(loading, &u);
            rotation.iter_mut().zip(earlier).for_each(|(r, e)| *r -= part * e);
        }
        for (beta, q) in beta.iter_mut().zip(&target_loading) {
            beta.iter_mut().zip(&rotation).for_each(|(b, r)| *b += r * q);
        }
        let scaled: Vec<Vec<f64>> =
            beta.iter().zip(&deviations).map(|(b, s)| b.iter().map(|b| b * s).collect()).collect();
        path.fits.push(scaled.iter().enumerate().map(|(t, b)| prepared.original(t, b)).collect());
        let squares = scaled.iter().enumerate().map(|(t, b)| prepared.residual_squares(t, b));
        path.residual_squares.push(squares.collect::<Result<_, _>>()?);
        path.weights.push(u);
        path.loadings.push(loading);
        path.target_loadings.push(target_loading);
        rotations.push(rotation);
    }
    Ok(path)
}

/// Leave-one-line-out scores of `target` for 1 to `components` components, from joint fits of `targets`. `target` is an
/// element of `targets`. If the other lines support fewer components, the fit with the largest possible number of
/// components is scored in place of each larger number.
///
/// # Errors
/// Fails with [`LeastSquaresError::NoSuch`] if `target` is not an element of `targets`. Also returns the errors of
/// [`fit`] and [`leave_line_out`].
pub fn choose_components(
    lines: &[RegressionMoments],
    targets: &[usize],
    target: usize,
    components: usize,
    scaling: ColumnScaling,
    score: LineScoreMeasure,
) -> Result<LineScores, LeastSquaresError> {
    let place = targets.iter().position(|t| *t == target).ok_or(LeastSquaresError::NoSuch {
        what: "target",
        number: target,
        count: targets.len(),
    })?;
    let fits = |others: &RegressionMoments| {
        let mut path: Vec<LinearFit> =
            fit(others, targets, components, scaling)?.fits.into_iter().map(|mut f| f.swap_remove(place)).collect();
        let last = path.last().cloned();
        path.extend(last.into_iter().cycle().take(components - path.len()));
        Ok(path)
    };
    leave_line_out(lines, target, score, fits)
}

/// Xᵀ Y, one row per term.
fn products(x: &[Vec<f64>], y: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let (p, m) = (x.first().map_or(0, Vec::len), y.first().map_or(0, Vec::len));
    let mut out = vec![vec![0.0; m]; p];
    for (x, y) in x.iter().zip(y) {
        for (row, x) in out.iter_mut().zip(x) {
            row.iter_mut().zip(y).for_each(|(sum, y)| *sum += x * y);
        }
    }
    out
}

fn frobenius(matrix: &[Vec<f64>]) -> f64 {
    matrix.iter().map(|row| dot(row, row)).sum::<f64>().sqrt()
}

fn covariance_size(x: &[Vec<f64>], y: &[Vec<f64>]) -> f64 {
    frobenius(&products(x, y))
}

/// The leading left singular vector.
fn leading(matrix: &[Vec<f64>]) -> Result<Vec<f64>, LeastSquaresError> {
    let (p, m) = (matrix.len(), matrix.first().map_or(0, Vec::len));
    if m == 1 {
        let length = frobenius(matrix);
        return Ok(matrix.iter().map(|row| row[0] / length).collect());
    }
    let svd = Mat::from_fn(p, m, |i, j| matrix[i][j]).thin_svd().map_err(|_| LeastSquaresError::NoConvergence)?;
    Ok((0..p).map(|i| svd.U()[(i, 0)]).collect())
}

/// Xᵀ t/(tᵀ t).
fn against(x: &[Vec<f64>], score: &[f64], square: f64) -> Vec<f64> {
    let mut out = vec![0.0; x.first().map_or(0, Vec::len)];
    for (row, t) in x.iter().zip(score) {
        out.iter_mut().zip(row).for_each(|(sum, x)| *sum += x * t);
    }
    out.iter().map(|sum| sum / square).collect()
}

fn deflate(x: &mut [Vec<f64>], score: &[f64], loading: &[f64]) {
    for (row, t) in x.iter_mut().zip(score) {
        row.iter_mut().zip(loading).for_each(|(x, p)| *x -= t * p);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::reference_csv::{TERMS, columns, model_lines};

    fn lines() -> Vec<RegressionMoments> {
        model_lines()
            .iter()
            .map(|line| RegressionMoments::from_matrix(&line.a, 8, &[&line.y0, &line.y1]).unwrap())
            .collect()
    }

    fn near(one: f64, other: f64, relative: f64) {
        assert!((one - other).abs() <= relative * (other.abs() + 1e-3), "{one} {other}");
    }

    #[test]
    fn val_all_numbers_of_components_equal_scikit_learn() {
        let all = RegressionMoments::merged(&lines()).unwrap();
        let table = columns(include_str!("../../reference/models/pls.csv"));
        let paths = [&[0][..], &[0, 1]].map(|targets| fit(&all, targets, 8, ColumnScaling::Standardise).unwrap());
        assert_eq!(table["targets"].len(), 24);
        for row in 0..24 {
            let path = &paths[table["targets"][row] as usize - 1];
            let fit = &path.fits[table["components"][row] as usize - 1][table["target"][row] as usize];
            // scikit-learn uses covariances of terms with a condition number of 1e3, which gives errors of some 1e-10.
            for (ours, name) in fit.coefficients.iter().zip(TERMS) {
                near(*ours, table[name][row], 1e-8);
            }
            near(fit.intercept, table["intercept"][row], 1e-8);
        }
    }

    #[test]
    fn val_scores_of_omitted_lines_equal_scikit_learn() {
        let table = columns(include_str!("../../reference/models/pls_cv.csv"));
        let scores =
            choose_components(&lines(), &[0], 0, 8, ColumnScaling::Standardise, LineScoreMeasure::MeanSquare).unwrap();
        for (k, ours) in scores.scores.iter().enumerate() {
            for (line, ours) in ours.iter().enumerate() {
                near(*ours, table[format!("line{line}").as_str()][k], 1e-8);
            }
        }
    }

    #[test]
    fn law_all_components_are_least_squares() {
        let all = RegressionMoments::merged(&lines()).unwrap();
        let path = fit(&all, &[1], 8, ColumnScaling::Standardise).unwrap();
        let squares = all.prepare(ColumnScaling::None, true).unwrap().ridge(&[0.0], &TERMS).unwrap();
        for (ours, theirs) in path.fits[7][0].coefficients.iter().zip(&squares.solutions[0].coefficients[1]) {
            near(*ours, *theirs, 1e-9);
        }
        assert!(path.residual_squares.windows(2).all(|pair| pair[1][0] <= pair[0][0] * (1.0 + 1e-12)));
    }

    #[test]
    fn law_scores_of_different_components_are_uncorrelated() {
        // (3.39)-(3.41): tᵢᵀ tⱼ = 0, computed by applying the rotations to the factor before deflation.
        let all = RegressionMoments::merged(&lines()).unwrap();
        let path = fit(&all, &[0, 1], 8, ColumnScaling::Standardise).unwrap();
        let prepared = all.prepare(ColumnScaling::Standardise, true).unwrap();
        let mut scores: Vec<Vec<f64>> = Vec::new();
        let mut x: Vec<Vec<f64>> = prepared.factor().chunks_exact(8).map(<[f64]>::to_vec).collect();
        for (u, p) in path.weights.iter().zip(&path.loadings) {
            let score: Vec<f64> = x.iter().map(|row| dot(row, u)).collect();
            deflate(&mut x, &score, p);
            scores.push(score);
        }
        let size = |k: usize| dot(&scores[k], &scores[k]).sqrt();
        for i in 0..8 {
            assert!((dot(&path.weights[i], &path.weights[i]) - 1.0).abs() < 1e-12);
            for j in 0..i {
                assert!(dot(&scores[i], &scores[j]).abs() < 1e-10 * size(i) * size(j), "{i} {j}");
            }
        }
    }

    #[test]
    fn law_a_path_ends_where_no_covariance_remains() {
        let a: Vec<f64> = (0..60).map(|i| f64::from(i * i % 17) - 3.0 * f64::from(i % 5)).collect();
        let y: Vec<f64> = a.chunks(3).map(|row| 2.0 * row[0]).collect();
        let doubled: Vec<f64> = a.chunks(3).flat_map(|row| [row[0], 2.0 * row[0], row[0], 0.0]).collect();
        let path =
            fit(&RegressionMoments::from_matrix(&doubled, 4, &[&y]).unwrap(), &[0], 4, ColumnScaling::Standardise)
                .unwrap();
        assert_eq!(path.fits.len(), 1);
        assert!(path.residual_squares[0][0] < 1e-18 && path.fits[0][0].coefficients[3] == 0.0);
    }

    #[test]
    fn unit_zero_components_and_unknown_targets_are_rejected() {
        let lines = lines();
        assert!(fit(&lines[0], &[0], 0, ColumnScaling::None).unwrap_err().to_string().contains("at least 1"));
        assert!(
            fit(&lines[0], &[2], 1, ColumnScaling::None).unwrap_err().to_string().contains("target 2 does not exist")
        );
        assert!(choose_components(&lines, &[0], 1, 2, ColumnScaling::None, LineScoreMeasure::Variance).is_err());
    }
}

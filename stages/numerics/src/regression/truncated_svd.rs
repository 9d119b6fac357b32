//! Regression on the principal components of the terms. Directions that the flight barely excites are omitted; ridge
//! regression only shrinks them.
//!
//! With the singular value decomposition R = U S Vᵀ of the (scaled) factor, b = Σᵢ vᵢ (uᵢᵀ z)/sᵢ over the k largest
//! singular values. [Hansen 1987, "The truncated SVD as a method for regularization", BIT 27; principal component
//! analysis of the Tolles-Lawson terms: Gnadt 2022, section 3.5, ref. 58]

use crate::regression::least_squares::{
    LeastSquaresError, LineScoreMeasure, LineScores, LinearFit, RegressionMoments, ScaledFactor, leave_line_out,
};

/// A least-squares fit by truncated singular value decomposition.
#[derive(Debug, Clone, PartialEq)]
pub struct TruncatedSvdFit {
    /// The number of singular values used.
    pub components: usize,
    /// The model in the columns' own units.
    pub fit: LinearFit,
    /// The sum of squared residuals.
    pub residual_squares: f64,
}

/// Fits of `target` with 1, 2, ... components, up to the number of nonzero singular values.
///
/// # Errors
///
/// Fails for an unknown target. Also fails if the decomposition does not converge.
pub fn path(prepared: &ScaledFactor, target: usize) -> Result<Vec<TruncatedSvdFit>, LeastSquaresError> {
    prepared.along(target)?;
    let singular = prepared.singular()?;
    let rounding = singular.values.first().copied().unwrap_or(0.0) * f64::EPSILON;
    let mut b = vec![0.0; prepared.terms()];
    let mut fits = Vec::new();
    for (k, value) in singular.values.iter().enumerate().take_while(|(_, s)| **s > rounding) {
        let size = singular.projections[target][k] / value;
        b.iter_mut().zip(&singular.right[k]).for_each(|(b, v)| *b += size * v);
        fits.push(TruncatedSvdFit {
            components: k + 1,
            fit: prepared.original(target, &b),
            residual_squares: prepared.residual_squares(target, &b)?,
        });
    }
    Ok(fits)
}

/// The leave-one-line-out scores of 1 to `components` components.
///
/// # Errors
/// Returns the errors of [`path`] and [`leave_line_out`].
pub fn choose_components(
    lines: &[RegressionMoments],
    target: usize,
    components: usize,
    scaling: crate::regression::least_squares::ColumnScaling,
    intercept: bool,
    score: LineScoreMeasure,
) -> Result<LineScores, LeastSquaresError> {
    leave_line_out(lines, target, score, |others| {
        let path = path(&others.prepare(scaling, intercept)?, target)?;
        Ok(path.into_iter().take(components).map(|fit| fit.fit).collect())
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::random::NormalGenerator;
    use crate::regression::least_squares::ColumnScaling;

    fn near(one: f64, other: f64, relative: f64) {
        assert!((one - other).abs() <= relative * (other.abs() + 1e-3), "{one} {other}");
    }

    fn moments(seed: u64, rows: usize) -> RegressionMoments {
        let mut normals = NormalGenerator::new(seed);
        let a: Vec<f64> = (0..rows)
            .flat_map(|_| {
                let [x, y, z] = [normals.draw(), normals.draw(), normals.draw()];
                [x, y, x + 1e-3 * z, 2.0 * x - y]
            })
            .collect();
        let y: Vec<f64> = a.chunks(4).map(|r| 2.0 * r[0] - r[1] + 5.0 + 0.1 * normals.draw()).collect();
        RegressionMoments::from_matrix(&a, 4, &[&y]).unwrap()
    }

    #[test]
    fn law_all_components_of_independent_terms_are_least_squares() {
        let moments = moments(1, 300).select(&[0, 1, 2], &[0]).unwrap();
        let prepared = moments.prepare(ColumnScaling::Standardise, true).unwrap();
        let ridge = prepared.ridge(&[0.0], &["a", "b", "c"]).unwrap();
        let last = path(&prepared, 0).unwrap().pop().unwrap();
        assert_eq!(last.components, 3);
        for (ours, theirs) in last.fit.coefficients.iter().zip(&ridge.solutions[0].coefficients[0]) {
            near(*ours, *theirs, 1e-9);
        }
        near(last.fit.intercept, ridge.solutions[0].intercepts[0], 1e-10);
        near(last.residual_squares, ridge.solutions[0].residual_squares[0], 1e-10);
    }

    #[test]
    fn law_two_components_are_regression_on_two_scores() {
        // The orthogonal scores t = R v of the first two components, regressed one by one.
        let prepared = moments(2, 300).prepare(ColumnScaling::None, true).unwrap();
        let singular = prepared.singular().unwrap();
        let fit = path(&prepared, 0).unwrap().swap_remove(1);
        assert_eq!(fit.components, 2);
        let mut b = vec![0.0; 4];
        for v in &singular.right[..2] {
            let score: Vec<f64> = prepared.left_of(&[0.0; 4], v).iter().map(|x| -x).collect();
            let along: f64 = score.iter().zip(prepared.along(0).unwrap()).map(|(t, z)| t * z).sum();
            let size = along / score.iter().map(|t| t * t).sum::<f64>();
            b.iter_mut().zip(v).for_each(|(b, v)| *b += size * v);
        }
        for (ours, theirs) in fit.fit.coefficients.iter().zip(&b) {
            near(*ours, *theirs, 1e-10);
        }
        assert!(path(&prepared, 1).is_err());
    }

    #[test]
    fn law_the_number_that_predicts_other_lines_best_is_the_true_one() {
        let lines: Vec<RegressionMoments> = (10..15).map(|seed| moments(seed, 40)).collect();
        let scores =
            choose_components(&lines, 0, 3, ColumnScaling::Standardise, true, LineScoreMeasure::MeanSquare).unwrap();
        assert_eq!(scores.within_one_error, 1, "{:?}", scores.mean);
    }
}

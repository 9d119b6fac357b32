//! Principal components of many columns, with whitening.

use crate::regression::least_squares::{ColumnScaling, LeastSquaresError, LinearFit, RegressionMoments, setting};

/// The number of components to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ComponentCount {
    /// The first n components.
    Count(usize),
    /// The smallest number of components that together explain at least this fraction of the variance, above 0 and at
    /// most 1.
    Variance(f64),
}

/// Directions of largest variance of centred and scaled columns.
#[derive(Debug, Clone, PartialEq)]
pub struct PrincipalComponents {
    /// One direction of length 1 per component, with one entry per column. The entry of largest magnitude is positive.
    pub directions: Vec<Vec<f64>>,
    /// The variance (n − 1) of each component, largest first.
    pub variances: Vec<f64>,
    /// Fraction of the total variance that the components explain.
    pub explained: f64,
    means: Vec<f64>,
    scales: Vec<f64>,
    whiten: bool,
}

impl PrincipalComponents {
    /// The components of the columns of `moments`. With `whiten`, each component is scaled to a variance of 1.
    ///
    /// Components without variance are never kept.
    ///
    /// # Errors
    ///
    /// Fails if there are no rows or if the decomposition does not converge. Also fails if no component would be kept.
    pub fn from_moments(
        moments: &RegressionMoments,
        scaling: ColumnScaling,
        kept: ComponentCount,
        whiten: bool,
    ) -> Result<Self, LeastSquaresError> {
        let prepared = moments.prepare(scaling, true)?;
        let singular = prepared.singular()?;
        let left = moments.rows() as f64 - 1.0;
        let all: Vec<f64> = singular.values.iter().map(|s| s * s / left).collect();
        let total: f64 = all.iter().sum();
        let largest = all.first().copied().unwrap_or(0.0);
        let varies = all.iter().filter(|v| **v > largest * f64::EPSILON * f64::EPSILON).count();
        let count = match kept {
            ComponentCount::Count(count) => {
                setting("the number of components", count as f64, "at least 1", count > 0)?;
                count
            }
            ComponentCount::Variance(part) => {
                setting("the fraction of the variance", part, "above 0 and at most 1", part > 0.0 && part <= 1.0)?;
                let held = |k: usize| all[..k].iter().sum::<f64>() >= part * total * (1.0 - 1e-12);
                (1..=varies).find(|&k| held(k)).unwrap_or(varies)
            }
        };
        let count = count.min(varies);
        let mut directions = singular.right[..count].to_vec();
        for direction in &mut directions {
            let largest = direction.iter().fold(0.0f64, |most, x| if x.abs() > most.abs() { *x } else { most });
            direction.iter_mut().for_each(|x| *x *= largest.signum());
        }
        Ok(Self {
            directions,
            explained: all[..count].iter().sum::<f64>() / total,
            variances: all[..count].to_vec(),
            means: moments.term_means(),
            scales: prepared.scales().to_vec(),
            whiten,
        })
    }

    /// The number of components.
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// Whether there are no components.
    pub fn is_empty(&self) -> bool {
        self.directions.is_empty()
    }

    /// Weights of each component in the columns' own units, and the offset: a component is Σⱼ weight · column − offset.
    pub fn as_sums(&self) -> (Vec<Vec<f64>>, Vec<f64>) {
        let of = |(direction, variance): (&Vec<f64>, &f64)| -> Vec<f64> {
            let size = if self.whiten { variance.sqrt() } else { 1.0 };
            direction.iter().zip(&self.scales).map(|(d, s)| d / s / size).collect()
        };
        let weights: Vec<Vec<f64>> = self.directions.iter().zip(&self.variances).map(of).collect();
        let offset = |w: &Vec<f64>| w.iter().zip(&self.means).map(|(w, m)| w * m).sum();
        let offsets = weights.iter().map(offset).collect();
        (weights, offsets)
    }

    /// Converts a model of the components to a model of the columns.
    pub fn original(&self, fit: &LinearFit) -> LinearFit {
        let (weights, offsets) = self.as_sums();
        let mut coefficients = vec![0.0; self.means.len()];
        let mut intercept = fit.intercept;
        for ((b, weights), offset) in fit.coefficients.iter().zip(&weights).zip(&offsets) {
            coefficients.iter_mut().zip(weights).for_each(|(c, w)| *c += b * w);
            intercept -= b * offset;
        }
        LinearFit { coefficients, intercept }
    }

    /// Components of rows, given row-major with the same number of columns as the moments; dimensionless if whitened.
    ///
    /// # Errors
    /// Fails with [`LeastSquaresError::Shape`] for values that are not a whole number of rows.
    pub fn transform(&self, a: &[f64]) -> Result<Vec<f64>, LeastSquaresError> {
        let columns = self.means.len();
        let rows = a.len() / columns.max(1);
        crate::regression::least_squares::expect("the matrix of columns", a.len(), rows * columns)?;
        let mut out = Vec::with_capacity(rows * self.len());
        for row in a.chunks_exact(columns.max(1)) {
            let scaled: Vec<f64> =
                row.iter().zip(&self.means).zip(&self.scales).map(|((x, m), s)| (x - m) / s).collect();
            for (direction, variance) in self.directions.iter().zip(&self.variances) {
                let score: f64 = scaled.iter().zip(direction).map(|(x, d)| x * d).sum();
                out.push(if self.whiten { score / variance.sqrt() } else { score });
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::reference_csv::columns;

    fn near(one: f64, other: f64, tolerance: f64) {
        assert!((one - other).abs() <= tolerance, "{one} {other}");
    }

    #[test]
    fn val_whitened_components_equal_scikit_learn() {
        let samples = columns(include_str!("../../reference/models/samples.csv"));
        let table = columns(include_str!("../../reference/models/pca.csv"));
        let names = ["a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7"];
        let a: Vec<f64> = (0..120).flat_map(|i| names.map(|name| samples[name][i])).collect();
        let moments = RegressionMoments::from_matrix(&a, 8, &[]).unwrap();
        let found =
            PrincipalComponents::from_moments(&moments, ColumnScaling::Standardise, ComponentCount::Count(3), true)
                .unwrap();
        let scores = found.transform(&a).unwrap();
        for k in 0..3 {
            near(found.variances[k], table[format!("variance{k}").as_str()][0], 1e-12);
            let theirs = &table[format!("c{k}").as_str()];
            let sign = (scores[k] * theirs[0]).signum();
            for (row, theirs) in theirs.iter().enumerate() {
                near(sign * scores[3 * row + k], *theirs, 1e-11);
            }
            // Whitened components have a variance of 1 over the rows from which they were computed.
            let square: f64 = scores.iter().skip(k).step_by(3).map(|x| x * x).sum();
            near(square / 119.0, 1.0, 1e-12);
        }
        let most = PrincipalComponents::from_moments(
            &moments,
            ColumnScaling::Standardise,
            ComponentCount::Variance(0.9),
            false,
        )
        .unwrap();
        let one_less: f64 = most.variances[..most.len() - 1].iter().sum::<f64>() / 8.0;
        assert!(most.explained >= 0.9 && one_less < 0.9);
        assert!(
            PrincipalComponents::from_moments(&moments, ColumnScaling::None, ComponentCount::Count(0), true).is_err()
        );
        assert!(found.transform(&a[1..]).is_err());
    }

    #[test]
    fn law_components_of_moments_are_those_of_rows() {
        let samples = columns(include_str!("../../reference/models/samples.csv"));
        let names = ["a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7"];
        let a: Vec<f64> = (0..120).flat_map(|i| names.map(|name| samples[name][i])).collect();
        let y = &samples["y0"];
        let moments = RegressionMoments::from_matrix(&a, 8, &[y]).unwrap();
        let found =
            PrincipalComponents::from_moments(&moments, ColumnScaling::Standardise, ComponentCount::Count(4), true)
                .unwrap();
        let (weights, offsets) = found.as_sums();
        let by_moments = moments.combined(&weights, &offsets).unwrap();
        let by_rows = RegressionMoments::from_matrix(&found.transform(&a).unwrap(), 4, &[y]).unwrap();
        let fit = |m: &RegressionMoments| {
            let path = m.prepare(ColumnScaling::None, true).unwrap().ridge(&[0.3], &["a", "b", "c", "d"]).unwrap();
            path.solutions[0].coefficients[0].clone()
        };
        for (one, other) in fit(&by_moments).iter().zip(fit(&by_rows)) {
            near(*one, other, 1e-9 * other.abs());
        }
        // Ridge regression on whitened components equals least squares on the same components, with each coefficient
        // shrunk by (n - 1) / (n - 1 + lambda).
        let plain =
            crate::regression::truncated_svd::path(&moments.prepare(ColumnScaling::Standardise, true).unwrap(), 0)
                .unwrap();
        let drawn = found.original(&LinearFit { coefficients: fit(&by_moments), intercept: 0.0 });
        for (one, other) in drawn.coefficients.iter().zip(&plain[3].fit.coefficients) {
            near(*one, other * 119.0 / 119.3, 1e-9 * other.abs());
        }
    }
}

//! Least squares row by row, with exponential forgetting of older rows.
//!
//! After each row the coefficients minimise Σᵢ φ^(n−i) (yᵢ − aᵢ β)² + φⁿ Σⱼ ((βⱼ − β₀ⱼ)/σⱼ)² with the forgetting factor
//! φ. Without forgetting this is ridge regression with λ = 1/σ². The state is the square root of the information
//! matrix. Givens rotations merge each row into this root [Haykin 2002, "Adaptive Filter Theory", QR-RLS; Bierman 1977,
//! square-root information filter]. The update uses no subtraction, so the covariance cannot become indefinite. With
//! the textbook recursion, the covariance becomes indefinite after about 1e5 rows.

use crate::regression::least_squares::{LeastSquaresError, expect, setting};

/// Coefficients that are updated row by row.
#[derive(Debug, Clone)]
pub struct RecursiveLeastSquares {
    terms: usize,
    forgetting: f64,
    keep_prior: bool,
    /// 1/σ of the prior.
    prior: Vec<f64>,
    /// Upper triangle followed by the target's column: `terms` rows of `terms` + 1.
    root: Vec<f64>,
    rows: usize,
}

impl RecursiveLeastSquares {
    /// Initial state without rows: `initial` coefficients with standard deviations `sigma`, relative to the standard
    /// deviation of the noise.
    ///
    /// `forgetting` φ: each new row multiplies the weights of the earlier rows by φ, so that the effective number of
    /// rows is about 1/(1 − φ). With `keep_prior`, the variance along any direction never exceeds the initial variance,
    /// even after a long time without excitation; the coefficients keep their values along a direction without
    /// excitation. Without `keep_prior`, the information along such a direction decays, and the first disturbance
    /// changes the values arbitrarily.
    ///
    /// # Errors
    ///
    /// Fails if φ is not between 0 and 1, or if a σ is not above 0.
    pub fn new(initial: &[f64], sigma: &[f64], forgetting: f64, keep_prior: bool) -> Result<Self, LeastSquaresError> {
        let terms = initial.len();
        expect("the list of initial standard deviations", sigma.len(), terms)?;
        setting("the forgetting factor", forgetting, "above 0 and at most 1", forgetting > 0.0 && forgetting <= 1.0)?;
        let bad = sigma.iter().find(|s| !(**s > 0.0 && s.is_finite()));
        setting("an initial standard deviation", bad.copied().unwrap_or(1.0), "above 0", bad.is_none())?;
        let wild = initial.iter().find(|b| !b.is_finite());
        setting("an initial coefficient", wild.copied().unwrap_or(0.0), "finite", wild.is_none())?;
        let mut root = vec![0.0; terms * (terms + 1)];
        for j in 0..terms {
            root[j * (terms + 1) + j] = 1.0 / sigma[j];
            root[j * (terms + 1) + terms] = initial[j] / sigma[j];
        }
        let prior = sigma.iter().map(|s| 1.0 / s).collect();
        Ok(Self { terms, forgetting, keep_prior, prior, root, rows: 0 })
    }

    /// Adds a row and its target, and returns the innovation: the target minus its prediction, in the target's unit.
    ///
    /// # Errors
    ///
    /// Fails for a row of another length or with a value that is not finite; the state is then unchanged.
    pub fn update(&mut self, row: &[f64], target: f64) -> Result<f64, LeastSquaresError> {
        expect("the row of terms", row.len(), self.terms)?;
        if let Some(j) = row.iter().position(|x| !x.is_finite()) {
            return Err(LeastSquaresError::NotFinite { row: self.rows, column: format!("term {j}") });
        }
        if !target.is_finite() {
            return Err(LeastSquaresError::NotFinite { row: self.rows, column: "target 0".to_owned() });
        }
        let before = self.coefficients();
        let missed = target - row.iter().zip(&before).map(|(a, b)| a * b).sum::<f64>();
        self.forget(&before);
        let mut own = [row, &[target]].concat();
        self.rotate_in(&mut own, 0);
        self.rows += 1;
        Ok(missed)
    }

    fn forget(&mut self, coefficients: &[f64]) {
        if self.forgetting == 1.0 {
            return;
        }
        let root = self.forgetting.sqrt();
        self.root.iter_mut().for_each(|r| *r *= root);
        if self.keep_prior {
            // The information lost by forgetting is replaced by the prior, centred on the current coefficients.
            let back = (1.0 - self.forgetting).sqrt();
            for j in 0..self.terms {
                let mut row = vec![0.0; self.terms + 1];
                row[j] = back * self.prior[j];
                row[self.terms] = row[j] * coefficients[j];
                self.rotate_in(&mut row, j);
            }
        }
    }

    /// Rotates a row, which is zero before column `first`, into the triangle.
    fn rotate_in(&mut self, row: &mut [f64], first: usize) {
        let width = self.terms + 1;
        for j in first..self.terms {
            if row[j] == 0.0 {
                continue;
            }
            let own = &mut self.root[j * width..(j + 1) * width];
            let length = own[j].hypot(row[j]);
            let (cos, sin) = (own[j] / length, row[j] / length);
            for (r, x) in own[j..].iter_mut().zip(&mut row[j..]) {
                (*r, *x) = (cos * *r + sin * *x, cos * *x - sin * *r);
            }
        }
    }

    /// Coefficients after all rows so far: unit of the target over unit of the term.
    pub fn coefficients(&self) -> Vec<f64> {
        let (p, width) = (self.terms, self.terms + 1);
        let mut b = vec![0.0; p];
        for i in (0..p).rev() {
            let row = &self.root[i * width..(i + 1) * width];
            let known: f64 = (i + 1..p).map(|k| row[k] * b[k]).sum();
            b[i] = (row[p] - known) / row[i];
        }
        b
    }

    /// Covariance of the coefficients divided by the variance of the noise, row-major: (Rᵀ R)⁻¹.
    pub fn covariance(&self) -> Vec<f64> {
        let (p, width) = (self.terms, self.terms + 1);
        let mut inverse = vec![0.0; p * p];
        for column in 0..p {
            for i in (0..=column).rev() {
                let row = &self.root[i * width..(i + 1) * width];
                let known: f64 = (i + 1..=column).map(|k| row[k] * inverse[k * p + column]).sum();
                inverse[i * p + column] = (f64::from(u8::from(i == column)) - known) / row[i];
            }
        }
        let entry = |i: usize, j: usize| (i.max(j)..p).map(|k| inverse[i * p + k] * inverse[j * p + k]).sum();
        (0..p * p).map(|ij| entry(ij / p, ij % p)).collect()
    }

    /// The number of rows added.
    pub fn rows(&self) -> usize {
        self.rows
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::random::NormalGenerator;
    use crate::regression::least_squares::QrAccumulator;

    fn near(one: &[f64], other: &[f64], relative: f64) {
        for (one, other) in one.iter().zip(other) {
            assert!((one - other).abs() <= relative * (other.abs() + 1e-3), "{one} {other}");
        }
    }

    fn samples(rows: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut normals = NormalGenerator::new(seed);
        let a: Vec<f64> = (0..rows)
            .flat_map(|_| {
                let [x, y, z] = [normals.draw(), normals.draw(), normals.draw()];
                [x, x + 1e-3 * y, 10.0 * z]
            })
            .collect();
        let y = a.chunks(3).map(|r| 5.0 * r[0] - 2.0 * r[1] + 0.3 * r[2] + 0.1 * normals.draw()).collect();
        (a, y)
    }

    #[test]
    fn law_without_forgetting_the_estimate_is_ridge() {
        let (a, y) = samples(2000, 1);
        let sigma = 20.0;
        let mut recursive = RecursiveLeastSquares::new(&[0.0; 3], &[sigma; 3], 1.0, true).unwrap();
        for (row, y) in a.chunks(3).zip(&y) {
            recursive.update(row, *y).unwrap();
        }
        let batch =
            QrAccumulator::from_matrix(&a, 3, &[&y]).unwrap().solve(&[sigma.powi(-2)], &["a", "b", "c"]).unwrap();
        near(&recursive.coefficients(), &batch.solutions[0].coefficients[0], 1e-8);
        assert_eq!(recursive.rows(), 2000);
    }

    #[test]
    fn law_with_forgetting_the_estimate_is_weighted_least_squares() {
        let (rows, forgetting) = (150_usize, 0.97_f64);
        let (a, y) = samples(rows, 2);
        let (initial, sigma) = ([1.0, 0.0, -1.0], [3.0, 4.0, 5.0]);
        let mut recursive = RecursiveLeastSquares::new(&initial, &sigma, forgetting, false).unwrap();
        let mut weighted = QrAccumulator::new(3, 1);
        for j in 0..3 {
            let mut row = [0.0; 3];
            row[j] = forgetting.powi(rows as i32).sqrt() / sigma[j];
            weighted.push(&row, &[&[row[j] * initial[j]]]).unwrap();
        }
        for (i, (row, y)) in a.chunks(3).zip(&y).enumerate() {
            recursive.update(row, *y).unwrap();
            let weight = forgetting.powi((rows - 1 - i) as i32).sqrt();
            weighted.push(&[row[0] * weight, row[1] * weight, row[2] * weight], &[&[y * weight]]).unwrap();
        }
        let batch = weighted.solve(&[0.0], &["a", "b", "c"]).unwrap();
        near(&recursive.coefficients(), &batch.solutions[0].coefficients[0], 1e-9);
        let covariance = batch.covariance(0, 0).unwrap();
        let told: Vec<f64> =
            recursive.covariance().iter().map(|c| c * batch.solutions[0].residual_variances[0]).collect();
        near(&told, &covariance, 1e-6);
    }

    #[test]
    fn law_unexcited_coefficients_keep_their_value_and_prior_deviation() {
        let mut held = RecursiveLeastSquares::new(&[0.0; 2], &[2.0; 2], 0.9, true).unwrap();
        let mut free = RecursiveLeastSquares::new(&[0.0; 2], &[2.0; 2], 0.9, false).unwrap();
        for k in 0..3000 {
            let second = if k < 50 { f64::from(k % 3) } else { 0.0 };
            let row = [1.0 + f64::from(k % 7), second];
            for recursive in [&mut held, &mut free] {
                recursive.update(&row, 3.0 * row[0] - 4.0 * row[1]).unwrap();
            }
        }
        near(&held.coefficients(), &[3.0, -4.0], 1e-2);
        assert!((held.covariance()[3] - 4.0).abs() < 1e-6, "{:?}", held.covariance());
        assert!(free.covariance()[3] > 1e10);
    }

    #[test]
    fn law_a_change_is_followed_with_innovations_of_the_noise() {
        let (a, _) = samples(4000, 3);
        let mut normals = NormalGenerator::new(4);
        let mut recursive = RecursiveLeastSquares::new(&[0.0; 3], &[100.0; 3], 0.98, true).unwrap();
        let mut missed = Vec::new();
        for (i, row) in a.chunks(3).enumerate() {
            let slope = if i < 2000 { 1.0 } else { 2.0 };
            missed.push(recursive.update(row, slope * row[2] + 0.5 * normals.draw()).unwrap());
        }
        assert!((recursive.coefficients()[2] - 2.0).abs() < 0.02);
        let late: f64 = missed[3000..].iter().map(|e| e * e).sum::<f64>() / 1000.0;
        // Three terms estimated from 1/(1 − φ) = 50 rows add some 3 · 0.5/50 of the noise variance; 1000 innovations
        // determine the variance to 4.5 %.
        assert!((late / 0.25 - 1.03).abs() < 0.15, "{late}");
    }

    #[test]
    fn unit_invalid_settings_and_rows_are_rejected() {
        let message = |r: Result<RecursiveLeastSquares, LeastSquaresError>| r.unwrap_err().to_string();
        assert!(message(RecursiveLeastSquares::new(&[0.0], &[1.0], 1.5, true)).contains("but is 1.5"));
        assert!(message(RecursiveLeastSquares::new(&[0.0], &[0.0], 1.0, true)).contains("deviation must be above 0"));
        assert!(
            message(RecursiveLeastSquares::new(&[0.0], &[], 1.0, true)).contains("has 0 entries, but 1 are required")
        );
        let mut recursive = RecursiveLeastSquares::new(&[0.0], &[1.0], 1.0, true).unwrap();
        assert!(recursive.update(&[f64::NAN], 1.0).unwrap_err().to_string().contains("term 0"));
        assert!(recursive.update(&[1.0], f64::INFINITY).unwrap_err().to_string().contains("target 0"));
        assert_eq!((recursive.rows(), recursive.coefficients()), (0, vec![0.0]));
    }
}

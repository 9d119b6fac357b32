//! Values and derivatives of the polynomials of best fit to a moving window of evenly spaced samples.
//!
//! [Savitzky & Golay 1964, "Smoothing and differentiation of data by simplified least squares procedures", Analytical
//! Chemistry 36(8)]

use nalgebra::{DMatrix, DVector};

/// Error of a Savitzky-Golay window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SavitzkyGolayError {
    /// The window has no middle sample.
    #[error("a window must have an odd number of samples, 3 to {MOST_WINDOW}, but has {window}")]
    Window {
        /// The number of samples of the window.
        window: usize,
    },
    /// The window has too few samples for the polynomial, or the polynomial has no such derivative.
    #[error("a polynomial of degree {degree} over {window} samples has no derivative of order {derivative}")]
    Degree {
        /// The number of samples of the window.
        window: usize,
        /// The degree of the polynomial.
        degree: usize,
        /// The order of the derivative.
        derivative: usize,
    },
}

/// The longest window, in samples.
pub const MOST_WINDOW: usize = 10_001;

/// Highest degree; with a higher degree the fit becomes inaccurate.
const MOST_DEGREE: usize = 8;

/// Savitzky-Golay weights of a window's samples, for each position in the window.
#[derive(Debug, Clone, PartialEq)]
pub struct SavitzkyGolay {
    /// Weights for the positions 0 to 2 `half`, counted from the first sample of the window.
    weights: Vec<Vec<f64>>,
    half: usize,
    derivative: usize,
}

impl SavitzkyGolay {
    /// Weights for the derivative of order `derivative` (0 for the value) of the polynomial of degree `degree` through
    /// `window` samples. The derivative is per sample, to the power `derivative`.
    ///
    /// # Errors
    /// Fails for a window whose number of samples is even or outside 3 to [`MOST_WINDOW`]. Also fails for a degree that
    /// is above 8, not below the number of samples, or below the derivative.
    pub fn new(window: usize, degree: usize, derivative: usize) -> Result<Self, SavitzkyGolayError> {
        if window.is_multiple_of(2) || !(3..=MOST_WINDOW).contains(&window) {
            return Err(SavitzkyGolayError::Window { window });
        }
        let wrong = SavitzkyGolayError::Degree { window, degree, derivative };
        if degree > MOST_DEGREE || degree >= window || derivative > degree {
            return Err(wrong);
        }
        let half = window / 2;
        // Positions are in units of half the window, so that their powers are at most 1.
        let place = |k: usize| (k as f64 - half as f64) / half as f64;
        let powers = DMatrix::from_fn(window, degree + 1, |row, power| place(row).powi(power as i32));
        let qr = powers.qr();
        let Some(inverse) = qr.r().try_inverse() else { return Err(wrong) };
        let coefficients = inverse * qr.q().transpose();
        let scale = (half as f64).powi(derivative as i32);
        let at = |k: usize| {
            let factor = |power: usize| (power + 1 - derivative..=power).map(|p| p as f64).product::<f64>();
            let row = DVector::from_fn(degree + 1, |power, _| {
                if power < derivative {
                    0.0
                } else {
                    factor(power) * place(k).powi((power - derivative) as i32) / scale
                }
            });
            (row.transpose() * &coefficients).iter().copied().collect()
        };
        Ok(Self { weights: (0..window).map(at).collect(), half, derivative })
    }

    /// Number of samples of a window, the minimum length of a run.
    pub fn window(&self) -> usize {
        2 * self.half + 1
    }

    /// Derivative at every sample of `x`, which must be finite and evenly sampled. The result has the unit of `x` per
    /// sample to the power `derivative`. In the first half window, the polynomial of the first window is used, and in
    /// the last half window that of the last window. `None` for fewer samples than a window.
    pub fn apply(&self, x: &[f64]) -> Option<Vec<f64>> {
        let (n, window) = (x.len(), self.window());
        let last = n.checked_sub(window)?;
        let one = |i: usize| {
            let first = i.saturating_sub(self.half).min(last);
            let weights = self.weights.get(i - first)?;
            // Values are relative to the sample itself, to preserve small changes of a large value.
            let sum: f64 = weights.iter().zip(&x[first..first + window]).map(|(w, other)| w * (other - x[i])).sum();
            Some(if self.derivative == 0 { x[i] + sum } else { sum })
        };
        (0..n).map(one).collect()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::reference_csv::columns;

    #[test]
    fn val_values_and_derivatives_equal_scipy() {
        let table = columns(include_str!("../../reference/signal/savitzky_golay.csv"));
        for (name, window, degree, derivative) in
            [("value_7_2", 7, 2, 0), ("first_5_2", 5, 2, 1), ("first_11_4", 11, 4, 1), ("second_9_3", 9, 3, 2)]
        {
            let ours = SavitzkyGolay::new(window, degree, derivative).unwrap().apply(&table["x"]).unwrap();
            let worst = ours.iter().zip(&table[name]).fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
            // The rounding error of 50,000 is 7e-12; the weights at the ends have magnitudes of a few units at most.
            assert!(worst < 1e-9, "{name}: {worst:e}");
        }
    }

    #[test]
    fn law_a_polynomial_of_the_degree_has_its_own_derivatives() {
        let of = |t: f64| 50_000.0 + 3.0 * t - 0.2 * t * t + 0.01 * t.powi(3);
        let x: Vec<f64> = (0..40).map(|k| of(f64::from(k))).collect();
        for (derivative, exact) in [
            (0, &of as &dyn Fn(f64) -> f64),
            (1, &|t: f64| 3.0 - 0.4 * t + 0.03 * t * t),
            (2, &|t: f64| -0.4 + 0.06 * t),
            (3, &|_: f64| 0.06),
        ] {
            let made = SavitzkyGolay::new(9, 3, derivative).unwrap().apply(&x).unwrap();
            for (k, y) in made.iter().enumerate() {
                assert!((y - exact(k as f64)).abs() < 1e-9, "{derivative} {k}: {y}");
            }
        }
    }

    #[test]
    fn unit_windows_and_degrees_that_cannot_be_fitted_are_rejected() {
        for (window, degree, derivative) in [(4, 2, 1), (1, 0, 0), (5, 5, 1), (5, 1, 2), (20_001, 2, 1), (11, 9, 1)] {
            assert!(SavitzkyGolay::new(window, degree, derivative).is_err(), "{window} {degree} {derivative}");
        }
        let five = SavitzkyGolay::new(5, 2, 1).unwrap();
        assert_eq!(five.apply(&[1.0; 4]), None);
        assert_eq!(five.apply(&[1.0; 5]), Some(vec![0.0; 5]));
    }
}

//! Linear models and their statistics: least squares, shrinkage, components, robust losses, recursive fits.
//!
//! Rows are read once: [`QrAccumulator`] or [`RegressionMoments`] folds them into the triangular factor of a QR
//! factorisation, from which every linear model in this folder is computed. Only the robust fit reads the rows more
//! than once.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`least_squares`] | least squares and ridge for many targets and ridge parameters; cross-validation by omitting
//! lines |
//! | [`cross_spectra`] | standard errors of coefficients if the residual is correlated, for example by a filter |
//! | [`choose_lambda`] | selection of the ridge parameter by generalised cross-validation, the L-curve, or omitted
//! lines |
//! | [`truncated_svd`] | regression on the principal components of the terms |
//! | [`elastic_net`] | least squares with a penalty on the size and on the number of coefficients |
//! | [`pls`] | partial least squares |
//! | [`principal_components`] | principal components of many columns, with whitening |
//! | [`robust`] | Huber's and Student's M-estimates for data with outliers |
//! | [`recursive_least_squares`] | least squares row by row, with exponential forgetting |
//! | [`statistics`] | means, deviations, and the scores of compensation and navigation |
//! | [`bootstrap`] | confidence intervals by resampling flight lines |
//! | [`l_curve`] | the curvature of an L-curve |
//!
//! # Equations
//!
//! Let A = U S Vᵀ be the singular value decomposition. The ridge solution, its effective number of parameters and its
//! generalised cross-validation over n rows are [Golub, Heath & Wahba 1979]
//!
//! ```text
//! β(λ)   = argmin ‖y − A β‖² + λ ‖β‖² = V diag(s/(s² + λ)) Uᵀ y
//! d(λ)   = Σ s²/(s² + λ)
//! GCV(λ) = n ‖y − A β‖²/(n − d)²
//! ```
//!
//! λ is absolute. Gnadt 2022 (3.26) computes the same solution from normal equations, which square the condition number
//! and are not formed here. The objectives of the other models are
//!
//! ```text
//! elastic net   ‖y − A b‖²/(2n) + α ρ ‖b‖₁ + α (1 − ρ) ‖b‖²/2       [Friedman, Hastie & Tibshirani 2010]
//! Huber         weight 1 for |r| ≤ ε σ, ε σ/|r| beyond              [Huber 1981]
//! Student-t     weight (ν + 1)/(ν + r²/σ²)                          [Lange, Little & Taylor 1989]
//! recursive     Σᵢ φ^(n−i) (yᵢ − aᵢ β)² + φⁿ Σⱼ ((βⱼ − β₀ⱼ)/σⱼ)²    [Haykin 2002]
//! ```
//!
//! Gnadt 2022 (3.31) writes the elastic net with λ₁ = 2 n α ρ and λ₂ = n α (1 − ρ).
//!
//! # Example
//!
//! ```
//! use numerics::regression::{LeastSquaresError, QrAccumulator};
//!
//! // Two orthogonal terms over n = 8 rows: a ridge multiplies each coefficient by n/(n + λ).
//! let sign = |negative: bool| if negative { -1.0 } else { 1.0 };
//! let a: Vec<f64> = (0..8).flat_map(|k| [sign(k % 2 == 1), sign(k >= 4)]).collect();
//! let y: Vec<f64> = a.chunks(2).map(|row| 3.0 * row[0] - 5.0 * row[1]).collect();
//! let mut qr = QrAccumulator::new(2, 1);
//! qr.push(&a, &[&y])?;
//! let path = qr.solve(&[0.0, 2.0], &["first", "second"])?;
//! for (solution, factor) in path.solutions.iter().zip([1.0, 0.8]) {
//!     let b = &solution.coefficients[0];
//!     assert!((b[0] - 3.0 * factor).abs() < 1e-12 && (b[1] + 5.0 * factor).abs() < 1e-12);
//!     assert!((solution.degrees_of_freedom - 2.0 * factor).abs() < 1e-12);
//! }
//!
//! // Dependent terms have no least squares solution: rank 1 of 2.
//! let mut qr = QrAccumulator::new(2, 1);
//! qr.push(&[1.0, 2.0, 2.0, 4.0, 3.0, 6.0], &[&[1.0, 2.0, 3.0]])?;
//! let refused = qr.solve(&[0.0], &["x", "twice_x"]);
//! assert!(matches!(refused, Err(LeastSquaresError::RankDeficient { rank: 1, terms: 2, .. })));
//! # Ok::<(), LeastSquaresError>(())
//! ```

pub mod bootstrap;
pub mod choose_lambda;
pub mod consistency;
pub mod cross_spectra;
pub mod elastic_net;
pub mod l_curve;
pub mod least_squares;
pub mod pls;
pub mod principal_components;
pub mod recursive_least_squares;
pub mod robust;
pub mod statistics;
pub mod truncated_svd;

pub use elastic_net::ElasticNetOptions;
pub use least_squares::{
    ColumnScaling, LeastSquaresError, LinearFit, QrAccumulator, RegressionMoments, RidgePath, ScaledFactor,
};
pub use principal_components::PrincipalComponents;
pub use recursive_least_squares::RecursiveLeastSquares;
pub use robust::RobustOptions;
pub use statistics::{SampleStatistic, SeriesMoments};

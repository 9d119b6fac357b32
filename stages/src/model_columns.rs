//! Names in a model table that other stages read.

/// Term of the constant.
pub const INTERCEPT: &str = "intercept";

/// Residual noise of a model: white noise per sample (nT), first-order Gauss-Markov noise (nT) and its time constant
/// (s).
pub const RESIDUAL: [&str; 3] = ["residual_sigma", "residual_fogm_sigma", "residual_fogm_tau"];

/// Sample rate of the lines of a fit, in Hz. Coefficients of terms that are differences
/// between successive samples are valid only at this rate.
pub const RATE: &str = "rate_hz";

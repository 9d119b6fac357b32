//! The names in the table of a model that other stages read.

/// The term of the constant.
pub const INTERCEPT: &str = "intercept";

/// The noise that a model leaves: its white part (nT, a sample), its Gauss-Markov part (nT) and the time constant of that (s).
pub const RESIDUAL: [&str; 3] = ["residual_sigma", "residual_fogm_sigma", "residual_fogm_tau"];

/// The rate of the lines of a fit, Hz: its coefficients of differences per sample hold at this rate.
pub const RATE: &str = "rate_hz";

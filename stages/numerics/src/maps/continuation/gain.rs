//! Continuation factor in the wavenumber domain.

/// Continuation factor at the wavenumber `k` in rad/m for a level `up_m` above the map: e^(−k h)/(1 + α k² e^(−k h)). α
/// applies only below the map.
pub(super) fn gain(k: f64, up_m: f64, alpha_m2: f64) -> f64 {
    if up_m >= 0.0 {
        return (-k * up_m).exp();
    }
    // Numerator and denominator are divided by the growing exponential to avoid overflow.
    1.0 / ((k * up_m).exp() + alpha_m2 * k * k)
}

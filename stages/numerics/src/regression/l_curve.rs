//! Corner of an L-curve, at which more regularisation begins to increase the misfit.
//!
//! The curve is the logarithm of the solution norm as a function of the logarithm of the misfit; the corner is the
//! point of largest curvature. [Hansen & O'Leary 1993, "The use of the L-curve in the regularization of discrete
//! ill-posed problems", SIAM J. Sci. Comput. 14(6)]

/// Curvature at the middle of three points that are evenly spaced in the logarithm of the parameter. Positive at a
/// corner that points to the origin; 0 if the curvature is undefined. `misfit` and `size` are norms (not squared) above
/// 0, in ascending order of the parameter.
pub fn log_curvature(misfit: [f64; 3], size: [f64; 3]) -> f64 {
    let of = |values: [f64; 3]| {
        let [a, b, c] = values.map(f64::ln);
        (0.5 * (c - a), a - 2.0 * b + c)
    };
    let ((x, xx), (y, yy)) = (of(misfit), of(size));
    let curvature = (x * yy - y * xx) / (x * x + y * y).powf(1.5);
    if curvature.is_finite() { curvature } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_circle_has_the_curvature_of_its_radius() {
        // The quarter of a circle that is below and to the left of its centre, with a radius of 0.2 in logarithms,
        // traversed evenly.
        let at = |angle: f64| ((2.0 - 0.2 * angle.cos()).exp(), (3.0 - 0.2 * angle.sin()).exp());
        let points = [0.799, 0.8, 0.801].map(at);
        let curvature = log_curvature(points.map(|p| p.0), points.map(|p| p.1));
        // Differences over 1e-3 have a truncation error of 1e-6 and a rounding error of 1e-9.
        assert!((curvature * 0.2 - 1.0).abs() < 1e-5, "{curvature}");
        assert_eq!(log_curvature([1.0; 3], [1.0; 3]), 0.0);
    }
}

//! Error ellipse of a position.

/// Region of a horizontal position, with a scale of `sigmas` standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Semi-major axis, in metres.
    pub major_m: f64,
    /// Semi-minor axis, in metres.
    pub minor_m: f64,
    /// Direction of the major axis, in degrees east of north, from 0 to below 180.
    pub azimuth_deg: f64,
}

impl Ellipse {
    /// Ellipse from the standard deviations north and east, in metres, and their covariance, in m²: the offsets e with
    /// eᵀ P⁻¹ e at most the square of `sigmas`. `None` if a value is unknown, or the values are not a covariance.
    pub fn new(sd_n: f64, sd_e: f64, cov_ne: f64, sigmas: f64) -> Option<Ellipse> {
        let (nn, ee) = (sd_n * sd_n, sd_e * sd_e);
        let root = (0.5 * (nn - ee)).hypot(cov_ne);
        let (large, small) = (0.5 * (nn + ee) + root, 0.5 * (nn + ee) - root);
        // A correlation of 1 is accepted despite rounding.
        let known = large.is_finite() && large > 0.0 && small >= -1e-9 * large;
        let azimuth_deg = (0.5 * (2.0 * cov_ne).atan2(nn - ee)).to_degrees().rem_euclid(180.0);
        known.then(|| Ellipse { major_m: sigmas * large.sqrt(), minor_m: sigmas * small.max(0.0).sqrt(), azimuth_deg })
    }

    /// Offsets of `corners` points on the ellipse, north and east of its centre, in metres.
    pub fn outline(self, corners: usize) -> impl Iterator<Item = (f64, f64)> {
        let (along_e, along_n) = self.azimuth_deg.to_radians().sin_cos();
        (0..corners).map(move |k| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / corners as f64).sin_cos();
            let (u, v) = (self.major_m * cos, self.minor_m * sin);
            (u * along_n - v * along_e, u * along_e + v * along_n)
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn law_outline_has_constant_mahalanobis_distance() {
        for (n, e, rho) in [(10.0, 3.0, 0.0), (3.0, 10.0, 0.4), (5.0, 5.0, -0.9), (7.0, 7.0, 0.0)] {
            let cov = rho * n * e;
            let found = Ellipse::new(n, e, cov, 3.0).unwrap();
            let det = n * n * e * e - cov * cov;
            for (north, east) in found.outline(36) {
                let nees = (e * e * north * north - 2.0 * cov * north * east + n * n * east * east) / det;
                assert!((nees - 9.0).abs() < 1e-9, "{n} {e} {rho}: {nees}");
            }
        }
    }

    #[test]
    fn unit_major_axis_points_along_the_largest_error() {
        let of = |n, e, cov| Ellipse::new(n, e, cov, 1.0).map(|e| (e.major_m, e.minor_m, e.azimuth_deg));
        assert_eq!(of(10.0, 3.0, 0.0), Some((10.0, 3.0, 0.0)));
        assert_eq!(of(3.0, 10.0, 0.0), Some((10.0, 3.0, 90.0)));
        let (major, _, azimuth) = of(4.0, 4.0, 8.0).unwrap();
        assert!((azimuth - 45.0).abs() < 1e-12 && (major - 24f64.sqrt()).abs() < 1e-12, "to the north-east");
        assert!((of(4.0, 4.0, -8.0).unwrap().2 - 135.0).abs() < 1e-12);
        // Full correlation gives a line; a larger covariance is invalid.
        assert!(of(4.0, 4.0, 16.0).unwrap().1 < 1e-6);
        assert_eq!((of(4.0, 4.0, 17.0), of(f64::NAN, 4.0, 0.0), of(0.0, 0.0, 0.0)), (None, None, None));
    }
}

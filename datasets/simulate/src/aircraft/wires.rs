//! The field of currents in wires and small coils, by the law of Biot and Savart.

use nalgebra::Vector3;

use super::spec::Wire;

/// μ0 / 4π, in nT m/A.
const K_NT_M_PER_A: f64 = 100.0;

impl Wire {
    /// The field at a position for one ampere, in nT; the position and the wire in metres, in the body frame.
    pub(super) fn nt_per_a(&self, at_m: &Vector3<f64>) -> Vector3<f64> {
        if let Some((place_m, moment_m2)) = &self.dipole {
            return self.turns * dipole_nt_per_a(place_m, moment_m2, at_m);
        }
        let sides = self.path_m.windows(2).map(|side| segment_nt_per_a(&side[0], &side[1], at_m));
        let back = match (self.path_m.last(), self.path_m.first()) {
            (Some(last), Some(first)) if self.closed => segment_nt_per_a(last, first, at_m),
            _ => Vector3::zeros(),
        };
        self.turns * (sides.sum::<Vector3<f64>>() + back)
    }
}

/// The field of one ampere from `a_m` to `b_m` along a straight line, in nT: with r1 and r2 the vectors from the ends
/// of the line, μ0/4π (r1 × r2) (|r1| + |r2|) / (|r1| |r2| (|r1| |r2| + r1·r2)). On the line itself, where the field is
/// undefined, the result is zero. [Hanson & Hirshman 2002, eq. 8]
pub(super) fn segment_nt_per_a(a_m: &Vector3<f64>, b_m: &Vector3<f64>, at_m: &Vector3<f64>) -> Vector3<f64> {
    let (r1, r2) = (at_m - a_m, at_m - b_m);
    let (n1, n2, across) = (r1.norm(), r2.norm(), r1.cross(&r2));
    let below = n1 * n2 * (n1 * n2 + r1.dot(&r2));
    if across.norm() <= 1e-9 * (b_m - a_m).norm_squared() || below <= 0.0 {
        return Vector3::zeros();
    }
    across * (K_NT_M_PER_A * (n1 + n2) / below)
}

/// The field of a small coil of `moment_m2` (A m² per ampere), in nT; at the position of the coil, the result is zero.
fn dipole_nt_per_a(place_m: &Vector3<f64>, moment_m2: &Vector3<f64>, at_m: &Vector3<f64>) -> Vector3<f64> {
    let r = at_m - place_m;
    let distance = r.norm();
    if distance <= 0.0 {
        return Vector3::zeros();
    }
    let along = r / distance;
    (along * (3.0 * along.dot(moment_m2)) - moment_m2) * (K_NT_M_PER_A / distance.powi(3))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;

    fn wire(path: &[[f64; 3]], closed: bool) -> Wire {
        let path_m = path.iter().map(|p| Vector3::from(*p)).collect();
        Wire { current: 0, path_m, closed, turns: 1.0, onset_a: 0.0, dipole: None }
    }

    #[test]
    fn law_a_long_wire_has_the_field_of_an_infinite_one() {
        // Along x, seen from 2 m to the right (y): B = μ0 I / 2 π r = 100 nT; by the right-hand rule, the field points
        // down (z).
        let b = wire(&[[-1e4, 0.0, 0.0], [1e4, 0.0, 0.0]], false).nt_per_a(&Vector3::new(3.0, 2.0, 0.0));
        // A finite wire has a smaller field by the fraction r²/2l² = 2e-8.
        assert!((b - Vector3::new(0.0, 0.0, 100.0)).norm() < 1e-5, "{b}");
    }

    #[test]
    fn law_a_half_wire_has_half_the_field_at_its_end() {
        let b = wire(&[[0.0, 0.0, 0.0], [1e5, 0.0, 0.0]], false).nt_per_a(&Vector3::new(0.0, 1.0, 0.0));
        assert!((b.z - 100.0).abs() < 2e-3, "{b}");
    }

    #[test]
    fn law_the_field_on_the_axis_of_a_square_and_a_circle_is_exact() {
        let square = wire(&[[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]], true);
        let circle: Vec<[f64; 3]> = (0..20_000)
            .map(|k| (f64::from(k) / 20_000.0 * std::f64::consts::TAU).sin_cos())
            .map(|(sin, cos)| [cos, sin, 0.0])
            .collect();
        let circle = wire(&circle, true);
        for z in [0.0_f64, 0.4, 3.0] {
            let at = Vector3::new(0.0, 0.0, z);
            // Half side a: B = 2 μ0 I a² / (π (a² + z²) sqrt(2 a² + z²)); μ0 = 400 π nT m/A.
            let expected = 800.0 / ((1.0 + z * z) * (2.0 + z * z).sqrt());
            assert!((square.nt_per_a(&at) - Vector3::new(0.0, 0.0, expected)).norm() < 1e-9, "{z}");
            // Radius a: B = μ0 I a² / 2 (a² + z²)^1.5; the field of the polygon is smaller by a fraction of at most
            // π²/3n² = 1e-8.
            let expected = 200.0 * std::f64::consts::PI / (1.0 + z * z).powf(1.5);
            assert!((circle.nt_per_a(&at) - Vector3::new(0.0, 0.0, expected)).norm() < 1e-4, "{z}");
        }
    }

    #[test]
    fn law_a_small_loop_is_a_dipole_at_a_distance() {
        let h = 0.005;
        let loop_ = wire(&[[h, h, 0.0], [-h, h, 0.0], [-h, -h, 0.0], [h, -h, 0.0]], true);
        let moment = Vector3::new(0.0, 0.0, 4.0 * h * h);
        let coil = Wire { dipole: Some((Vector3::zeros(), moment)), path_m: vec![], ..loop_.clone() };
        let at = Vector3::new(0.7, -0.5, 0.9);
        // Higher-order terms: (h/r)² = 2e-5.
        assert!((loop_.nt_per_a(&at) - coil.nt_per_a(&at)).norm() < 1e-4 * coil.nt_per_a(&at).norm());
        let twice = Wire { turns: 2.0, ..loop_.clone() };
        assert!((twice.nt_per_a(&at) - 2.0 * loop_.nt_per_a(&at)).norm() < 1e-12);
    }

    #[test]
    fn law_the_field_round_a_wire_has_no_divergence() {
        let bent = wire(&[[0.0, 0.0, 0.0], [2.0, 0.3, 0.0], [2.0, 1.5, 0.7], [-1.0, 1.0, 1.0]], true);
        let (at, h) = (Vector3::new(0.5, -0.8, 0.4), 1e-4);
        let d = |axis: usize| {
            let step = Vector3::ith(axis, h);
            (bent.nt_per_a(&(at + step))[axis] - bent.nt_per_a(&(at - step))[axis]) / (2.0 * h)
        };
        // Rounding of the differences: 1e-13 of 100 nT over 1e-4 m.
        assert!((d(0) + d(1) + d(2)).abs() < 1e-5);
        assert!(d(0).abs() > 1.0);
        assert_eq!(wire(&[[0.0; 3], [1.0, 0.0, 0.0]], false).nt_per_a(&Vector3::new(0.5, 0.0, 0.0)), Vector3::zeros());
    }
}

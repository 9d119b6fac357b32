//! Attitude: Euler angles, direction cosine matrices and the tilt error between two of them.
//!
//! Navigation frame north-east-down, body frame nose-right-down. A matrix named `body_to_ned` transforms the body
//! components of a vector to north, east and down components.

use nalgebra::{Matrix3, Vector3};

/// Direction cosine matrix from body to north-east-down for roll, pitch and yaw in radians, applied in the order yaw,
/// pitch, roll. [Gnadt 2022, C_b^n; Titterton & Weston 3.47]
pub fn body_to_ned(roll_rad: f64, pitch_rad: f64, yaw_rad: f64) -> Matrix3<f64> {
    let (sr, cr) = roll_rad.sin_cos();
    let (sp, cp) = pitch_rad.sin_cos();
    let (sy, cy) = yaw_rad.sin_cos();
    Matrix3::new(
        cp * cy,
        sr * sp * cy - cr * sy,
        cr * sp * cy + sr * sy,
        cp * sy,
        sr * sp * sy + cr * cy,
        cr * sp * sy - sr * cy,
        -sp,
        sr * cp,
        cr * cp,
    )
}

/// Roll, pitch and yaw, in radians, of a body-to-ned matrix. If the nose points straight up or down, only yaw minus
/// roll or yaw plus roll is defined; rounding then determines roll.
pub fn euler_rad(body_to_ned: &Matrix3<f64>) -> (f64, f64, f64) {
    let roll = body_to_ned[(2, 1)].atan2(body_to_ned[(2, 2)]);
    let pitch = -body_to_ned[(2, 0)].clamp(-1.0, 1.0).asin();
    let yaw = body_to_ned[(1, 0)].atan2(body_to_ned[(0, 0)]);
    (roll, pitch, yaw)
}

/// The matrix whose product with a vector is the cross product `v × ·`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Body-to-ned matrix rotated by the tilt error Ψ (north, east, down; rad): exp(-Ψ×) C, to first order (I - Ψ×) C. This
/// is the convention of the Pinson tilt states. The result is a rotation for any tilt. MagNav.jl's `correct_Cnb`
/// differs in second order (wrong sign) and is not orthogonal.
pub fn tilted(body_to_ned: &Matrix3<f64>, tilt_rad: &Vector3<f64>) -> Matrix3<f64> {
    let angle = tilt_rad.norm();
    let cross = skew(tilt_rad);
    // sin(m)/m and (1-cos m)/m². The second factor is computed from the half angle to avoid cancellation.
    let first = sinc(angle);
    let second = 0.5 * sinc(0.5 * angle).powi(2);
    (Matrix3::identity() - cross * first + cross * cross * second) * body_to_ned
}

/// The tilt (north, east, down; rad) that rotates `reference` into `other`: the inverse of [`tilted`] for rotations
/// below half a turn.
pub fn tilt_between(reference: &Matrix3<f64>, other: &Matrix3<f64>) -> Vector3<f64> {
    let turn = other * reference.transpose();
    let axis =
        Vector3::new(turn[(1, 2)] - turn[(2, 1)], turn[(2, 0)] - turn[(0, 2)], turn[(0, 1)] - turn[(1, 0)]) * 0.5;
    let sine = axis.norm();
    let angle = sine.atan2(0.5 * (turn.trace() - 1.0));
    if sine == 0.0 { axis } else { axis * (angle / sine) }
}

/// sin(x)/x, 1 at zero.
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-8 { 1.0 } else { x.sin() / x }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden() -> Matrix3<f64> {
        // MagNav.jl 1.3.3, euler2dcm(0.1, -0.2, 2.5, :body2nav).
        Matrix3::new(
            -0.785_174_081_648_442_6,
            -0.579_592_523_439_760_3,
            0.218_115_034_512_193_86,
            0.586_542_546_205_275,
            -0.809_011_234_054_376_5,
            -0.038_323_160_945_410_2,
            0.198_669_330_795_061_22,
            0.097_843_395_007_255_71,
            0.975_170_327_201_816,
        )
    }

    #[test]
    fn val_magnav_direction_cosines() {
        let computed = body_to_ned(0.1, -0.2, 2.5);
        assert!((computed - golden()).abs().max() < 1e-15);
    }

    #[test]
    fn law_euler_angles_are_recovered() {
        for (roll, pitch, yaw) in [(0.1, -0.2, 2.5), (-3.0, 1.4, -1.0), (0.0, 0.0, 0.0)] {
            let (r, p, y) = euler_rad(&body_to_ned(roll, pitch, yaw));
            let worst = (r - roll).abs().max((p - pitch).abs()).max((y - yaw).abs());
            assert!(worst < 1e-14, "{worst}");
        }
    }

    #[test]
    fn law_tilting_is_a_rotation_with_its_opposite_as_inverse() {
        let tilt = Vector3::new(0.3, -0.2, 0.5);
        let turned = tilted(&golden(), &tilt);
        assert!((turned * turned.transpose() - Matrix3::identity()).abs().max() < 1e-14);
        assert!((turned.determinant() - 1.0).abs() < 1e-14);
        assert!((tilted(&turned, &-tilt) - golden()).abs().max() < 1e-14);
        assert!((tilt_between(&golden(), &turned) - tilt).norm() < 1e-14);
        assert_eq!(tilted(&golden(), &Vector3::zeros()), golden());
    }

    #[test]
    fn unit_magnav_correct_cnb_has_the_wrong_sign_in_second_order() {
        let tilt = Vector3::new(0.001, -0.002, 0.003);
        // MagNav.jl 1.3.3, correct_Cnb of the matrix above.
        let theirs = Matrix3::new(
            -0.783_021_935_468_517_5,
            -0.581_828_588_267_654_9,
            0.219_950_318_070_401_3,
            0.589_099_475_364_680_2,
            -0.807_178_948_487_951_6,
            -0.037_999_384_463_569_28,
            0.199_656_568_174_689_68,
            0.099_810_273_660_837_22,
            0.974_774_417_003_640_8,
        );
        let second_order = skew(&tilt) * skew(&tilt) * golden();
        // Our result minus MagNav.jl's is Ψ×Ψ× C, with an error of fourth order: |Ψ|⁴/12 with |Ψ|⁴ = 2e-10.
        let difference = tilted(&golden(), &tilt) - theirs;
        assert!((difference - second_order).abs().max() < 1e-10);
        assert!((theirs * theirs.transpose() - Matrix3::identity()).abs().max() > 1e-6);
    }
}

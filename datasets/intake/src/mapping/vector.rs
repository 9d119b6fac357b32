//! Sensor axes relative to body axes, and quaternions as roll, pitch and yaw.

use numerics::earth::attitude::body_to_ned;

use super::declare::{QuaternionFrames, QuaternionOrder};

/// The matrix, row by row, that turns a sensor's x, y and z into the body's nose, right wing and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorMounting(pub [[f64; 3]; 3]);

/// Parses `+x -y -z`: the sensor axes along the nose, the right wing and down.
pub fn read_axes(text: &str) -> Option<[[f64; 3]; 3]> {
    let mut rows = [[0.0; 3]; 3];
    let words: Vec<&str> = text.split([' ', ',']).filter(|w| !w.is_empty()).collect();
    if words.len() != 3 {
        return None;
    }
    let mut taken = [false; 3];
    for (row, word) in rows.iter_mut().zip(words) {
        let (sign, axis) = match word.split_at_checked(1)? {
            ("+", axis) => (1.0, axis),
            ("-", axis) => (-1.0, axis),
            _ => (1.0, word),
        };
        let at = ["x", "y", "z"].iter().position(|a| *a == axis)?;
        if std::mem::replace(taken.get_mut(at)?, true) {
            return None;
        }
        *row.get_mut(at)? = sign;
    }
    Some(rows)
}

impl SensorMounting {
    /// Mounting of a sensor whose axes are first permuted, then rotated by roll, pitch and yaw, in degrees.
    pub fn new(axes: [[f64; 3]; 3], [roll, pitch, yaw]: [f64; 3]) -> SensorMounting {
        if [roll, pitch, yaw] == [0.0; 3] {
            return SensorMounting(axes);
        }
        let turn = body_to_ned(roll.to_radians(), pitch.to_radians(), yaw.to_radians());
        let mut out = [[0.0; 3]; 3];
        for (i, row) in out.iter_mut().enumerate() {
            for (j, cell) in row.iter_mut().enumerate() {
                *cell = axes.iter().enumerate().map(|(k, of)| turn[(i, k)] * of[j]).sum();
            }
        }
        SensorMounting(out)
    }

    /// Whether the matrix is a reflection, which is impossible for a right-handed sensor.
    pub fn is_mirror(&self) -> bool {
        let [[a, b, c], [d, e, f], [g, h, i]] = self.0;
        a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0
    }

    /// Body components of a sensor vector. A NaN on one sensor axis affects only the body components that depend on
    /// this axis.
    pub fn apply(&self, v: [f64; 3]) -> [f64; 3] {
        self.0.map(|row| {
            let parts = row.iter().zip(v).filter(|(m, _)| **m != 0.0);
            parts
                .map(|(m, x)| if *m == 1.0 { x } else { m * x })
                .fold(None, |sum: Option<f64>, x| Some(sum.map_or(x, |s| s + x)))
                .unwrap_or(0.0)
        })
    }
}

/// Roll, pitch and yaw of a quaternion, in degrees; NaN for an invalid quaternion. Yaw is from 0 to 360.
///
/// The rotation converts the components of a vector from the body frame to the navigation frame. The length of the
/// quaternion has no effect.
pub fn roll_pitch_yaw_deg(q: [f64; 4], order: QuaternionOrder, frames: QuaternionFrames) -> [f64; 3] {
    let [w, x, y, z] = match order {
        QuaternionOrder::Wxyz => q,
        QuaternionOrder::Xyzw => [q[3], q[0], q[1], q[2]],
    };
    let size = (w * w + x * x + y * y + z * z).sqrt();
    if !(size.is_finite() && size > 0.0) {
        return [f64::NAN; 3];
    }
    let [w, x, y, z] = [w, x, y, z].map(|part| part / size);
    let m = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let m = match frames {
        QuaternionFrames::FrdToNed => m,
        // In east-north-up, north is the second axis and down the negative third. In nose-left-up, right and down are
        // the negative second and third axes.
        QuaternionFrames::FluToEnu => {
            [[m[1][0], -m[1][1], -m[1][2]], [m[0][0], -m[0][1], -m[0][2]], [-m[2][0], m[2][1], m[2][2]]]
        }
    };
    let roll = m[2][1].atan2(m[2][2]);
    let pitch = -m[2][0].clamp(-1.0, 1.0).asin();
    let yaw = m[1][0].atan2(m[0][0]).to_degrees();
    // A tiny negative angle plus 360 rounds to 360.
    let turned = if yaw < 0.0 { yaw + 360.0 } else { yaw };
    [roll.to_degrees(), pitch.to_degrees(), if turned >= 360.0 { 0.0 } else { turned }]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use numerics::earth::attitude::euler_rad;

    use super::*;

    fn close(a: [f64; 3], b: [f64; 3]) -> bool {
        a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-12)
    }

    #[test]
    fn law_axes_map_to_the_nose_the_right_wing_and_down() {
        let body = |axes: &str, v| SensorMounting::new(read_axes(axes).unwrap(), [0.0; 3]).apply(v);
        assert_eq!(body("+x +y +z", [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
        assert_eq!(body("x -y -z", [1.0, 2.0, 3.0]), [1.0, -2.0, -3.0]);
        assert_eq!(body("-y, +x, +z", [1.0, 2.0, 3.0]), [-2.0, 1.0, 3.0]);
        // A broken axis does not affect the others.
        let [x, y, z] = body("+x -y -z", [1.0, f64::NAN, 3.0]);
        assert!(x == 1.0 && y.is_nan() && z == -3.0);
        for wrong in ["+x +x +z", "+x +y", "+x +y +z +x", "a b c", "", "+x +y +", "é"] {
            assert_eq!(read_axes(wrong), None, "{wrong}");
        }
        assert!(SensorMounting::new(read_axes("+x +y -z").unwrap(), [0.0; 3]).is_mirror());
        assert!(!SensorMounting::new(read_axes("+x -y -z").unwrap(), [10.0, 20.0, 30.0]).is_mirror());
    }

    #[test]
    fn law_mounting_rotations_equal_rotations_of_attitude_angles() {
        let identity = read_axes("+x +y +z").unwrap();
        // A sensor turned by 90 degrees of yaw has its x axis along the right wing.
        assert!(close(SensorMounting::new(identity, [0.0, 0.0, 90.0]).apply([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]));
        // With 90 degrees of roll its y axis points down; with 90 degrees of pitch its x axis points up.
        assert!(close(SensorMounting::new(identity, [90.0, 0.0, 0.0]).apply([0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]));
        assert!(close(SensorMounting::new(identity, [0.0, 90.0, 0.0]).apply([1.0, 0.0, 0.0]), [0.0, 0.0, -1.0]));
        // 180 degrees of roll is `+x -y -z`.
        let axes = SensorMounting::new(read_axes("+x -y -z").unwrap(), [0.0; 3]).apply([1.0, 2.0, 3.0]);
        assert!(close(SensorMounting::new(identity, [180.0, 0.0, 0.0]).apply([1.0, 2.0, 3.0]), axes));
        // The axes come before the rotation.
        let both = SensorMounting::new(read_axes("-y +x +z").unwrap(), [0.0, 0.0, 90.0]).apply([1.0, 0.0, 0.0]);
        assert!(close(both, [-1.0, 0.0, 0.0]), "{both:?}");
    }

    #[test]
    fn ref_quaternions_agree_with_direction_cosines() {
        for (roll, pitch, yaw) in [(0.1, -0.2, 2.5), (-3.0, 1.4, 4.0), (0.0, 0.0, 0.0), (1.0, 0.5, 6.0)] {
            // Titterton & Weston (3.66): the quaternion of roll, pitch and yaw.
            let ((sr, cr), (sp, cp), (sy, cy)) =
                ((roll / 2.0_f64).sin_cos(), (pitch / 2.0_f64).sin_cos(), (yaw / 2.0_f64).sin_cos());
            let q = [
                cr * cp * cy + sr * sp * sy,
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
            ];
            let (r, p, y) = euler_rad(&body_to_ned(roll, pitch, yaw));
            let expected = [r, p, y.rem_euclid(std::f64::consts::TAU)].map(f64::to_degrees);
            assert!(close(roll_pitch_yaw_deg(q, QuaternionOrder::Wxyz, QuaternionFrames::FrdToNed), expected));
            // Neither the length nor the sign of the quaternion has an effect.
            assert!(close(
                roll_pitch_yaw_deg(q.map(|x| -3.0 * x), QuaternionOrder::Wxyz, QuaternionFrames::FrdToNed),
                expected
            ));
            assert!(close(
                roll_pitch_yaw_deg([q[1], q[2], q[3], q[0]], QuaternionOrder::Xyzw, QuaternionFrames::FrdToNed),
                expected
            ));
        }
        // East-north-up: without rotation the nose (x) points east; after a turn by +90 degrees about up, it points
        // north.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(close(
            roll_pitch_yaw_deg([1.0, 0.0, 0.0, 0.0], QuaternionOrder::Wxyz, QuaternionFrames::FluToEnu),
            [0.0, 0.0, 90.0]
        ));
        assert!(close(
            roll_pitch_yaw_deg([half, 0.0, 0.0, half], QuaternionOrder::Wxyz, QuaternionFrames::FluToEnu),
            [0.0, 0.0, 0.0]
        ));
        // A rotation about the nose is roll in both conventions.
        let turned = [0.15_f64.cos(), 0.15_f64.sin(), 0.0, 0.0];
        let [roll, ..] = roll_pitch_yaw_deg(turned, QuaternionOrder::Wxyz, QuaternionFrames::FluToEnu);
        assert!((roll - 0.3_f64.to_degrees()).abs() < 1e-12);
        assert!(
            roll_pitch_yaw_deg([0.0; 4], QuaternionOrder::Wxyz, QuaternionFrames::FrdToNed).iter().all(|x| x.is_nan())
        );
    }
}

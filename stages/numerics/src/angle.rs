//! Periodic angles.

use std::f64::consts::{PI, TAU};

/// Angle in degrees wrapped to -180 (included) to 180 (excluded). An angle that is already in the range is returned
/// unchanged.
pub fn wrap_deg(angle_deg: f64) -> f64 {
    if (-180.0..180.0).contains(&angle_deg) {
        return angle_deg;
    }
    let wrapped = (angle_deg + 180.0).rem_euclid(360.0) - 180.0;
    // The remainder of an angle just below -180 rounds up to a full turn.
    if wrapped >= 180.0 { -180.0 } else { wrapped }
}

/// Angle in radians wrapped to within half a turn of 0.
pub fn wrap_rad(angle_rad: f64) -> f64 {
    if angle_rad.abs() <= PI { angle_rad } else { angle_rad - TAU * (angle_rad / TAU).round() }
}

/// Angles in degrees, unwrapped by whole turns so that each step is at most half a turn. Values that are not finite are
/// unchanged and skipped.
pub fn unwrapped_deg(angles_deg: &[f64]) -> Vec<f64> {
    let mut last: Option<f64> = None;
    let unwrapped = angles_deg.iter().map(|&angle| {
        if !angle.is_finite() {
            return angle;
        }
        let turns = last.map_or(0.0, |last| ((last - angle) / 360.0).round());
        last = Some(angle + 360.0 * turns);
        angle + 360.0 * turns
    });
    unwrapped.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_wrapped_angle_is_the_same_rotation_within_its_range() {
        assert_eq!(wrap_deg(540.0), -180.0);
        assert_eq!(wrap_deg(-35.25), -35.25);
        assert_eq!(wrap_deg(-180.0 - 1e-14), -180.0);
        for k in -50..50 {
            let angle = 0.37 + 33.0 * f64::from(k);
            let wrapped = wrap_deg(angle);
            assert!((-180.0..180.0).contains(&wrapped) && ((angle - wrapped) / 360.0).fract().abs() < 1e-12, "{angle}");
            assert!((wrap_rad(angle.to_radians()) - wrapped.to_radians()).abs() < 1e-12, "{angle}");
        }
    }

    #[test]
    fn law_unwrapped_angles_step_by_less_than_half_a_turn() {
        assert_eq!(unwrapped_deg(&[350.0, f64::NAN, 10.0, -10.0])[2..], [370.0, 350.0]);
        assert_eq!(unwrapped_deg(&[179.0, -179.0, -178.0, 179.5]), [179.0, 181.0, 182.0, 179.5]);
    }
}

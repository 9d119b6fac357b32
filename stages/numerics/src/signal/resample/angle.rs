//! Angles in degrees, periodic after a full turn.

/// The range of a column of angles: one of the two usual ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AngleRange {
    /// From −180 to 180, 180 included.
    Signed,
    /// From 0 to 360, 360 excluded.
    Full,
}

impl AngleRange {
    /// The range of a column: signed if any angle is negative or none is above 180.
    pub fn of(degrees: &[f64]) -> Self {
        let negative = degrees.iter().any(|angle| *angle < 0.0);
        let above = degrees.iter().any(|angle| *angle > 180.0);
        if above && !negative { Self::Full } else { Self::Signed }
    }

    /// The same angle inside the range.
    pub fn wrap(self, degrees: f64) -> f64 {
        match self {
            Self::Signed if degrees > -180.0 && degrees <= 180.0 => degrees,
            Self::Full if (0.0..360.0).contains(&degrees) => degrees,
            Self::Signed => -shortest(-degrees),
            // The remainder of a tiny negative angle rounds up to 360.
            Self::Full => match degrees.rem_euclid(360.0) {
                whole if whole >= 360.0 => 0.0,
                angle => angle,
            },
        }
    }
}

/// The same rotation by the shorter way, −180 included and 180 excluded.
pub(super) fn shortest(degrees: f64) -> f64 {
    if (-180.0..180.0).contains(&degrees) {
        return degrees;
    }
    let turn = (degrees + 180.0).rem_euclid(360.0) - 180.0;
    if turn >= 180.0 { -180.0 } else { turn }
}

/// Angles without jumps: whole turns are added so that each step is the shorter one. Values that
/// are not finite are unchanged and skipped.
pub fn unwrap_degrees(degrees: &[f64]) -> Vec<f64> {
    let mut last: Option<f64> = None;
    let unwrapped = degrees.iter().map(|&angle| {
        if !angle.is_finite() {
            return angle;
        }
        let turns = last.map_or(0.0, |last| ((last - angle) / 360.0).round());
        last = Some(angle + 360.0 * turns);
        angle + 360.0 * turns
    });
    unwrapped.collect()
}

//! Range of a column of angles.

use crate::angle::wrap_deg;

/// One of the two common ranges of a column of angles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AngleRange {
    /// Range from −180 to 180, 180 included.
    Signed,
    /// Range from 0 to 360, 360 excluded.
    Full,
}

impl AngleRange {
    /// The range of a column: signed if any angle is negative or none is above 180.
    pub fn from_degrees(degrees: &[f64]) -> Self {
        let negative = degrees.iter().any(|angle| *angle < 0.0);
        let above = degrees.iter().any(|angle| *angle > 180.0);
        if above && !negative { Self::Full } else { Self::Signed }
    }

    /// Equivalent angle within the range.
    pub fn wrap(self, degrees: f64) -> f64 {
        match self {
            Self::Signed if degrees > -180.0 && degrees <= 180.0 => degrees,
            Self::Full if (0.0..360.0).contains(&degrees) => degrees,
            Self::Signed => -wrap_deg(-degrees),
            // The remainder of a very small negative angle may round up to 360.
            Self::Full => match degrees.rem_euclid(360.0) {
                whole if whole >= 360.0 => 0.0,
                angle => angle,
            },
        }
    }
}

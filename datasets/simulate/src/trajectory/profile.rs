//! The height along a route.

/// Heights at distances along a route, joined by straight climbs whose corners are rounded off.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct RouteHeightProfile {
    /// Distance (m) and height (m), in order of distance.
    knots: Vec<(f64, f64)>,
    /// Half of the length over which a corner is rounded off, in metres.
    rounding_m: f64,
}

/// A climb steeper than the aircraft allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ExcessiveClimb {
    /// Index of the knot at the start of the segment.
    pub(super) knot: usize,
    /// Slope of the segment, height over distance.
    pub(super) slope: f64,
}

impl RouteHeightProfile {
    pub(super) fn level(alt_m: f64) -> Self {
        Self { knots: vec![(0.0, alt_m)], rounding_m: 1.0 }
    }

    /// Straight climbs between heights.
    ///
    /// # Errors
    /// Fails for a climb steeper than `steepest`.
    pub(super) fn climbs(mut knots: Vec<(f64, f64)>, steepest: f64, rounding_m: f64) -> Result<Self, ExcessiveClimb> {
        knots.dedup_by(|b, a| b.0 <= a.0);
        for (knot, pair) in knots.windows(2).enumerate() {
            let slope = (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0);
            if slope.abs() > steepest {
                return Err(ExcessiveClimb { knot, slope });
            }
        }
        Ok(Self { knots, rounding_m })
    }

    /// The lowest profile that stays above a surface and has a slope of at most `steepest`. A climb can therefore begin
    /// before the surface rises. The surface is straight between its heights.
    pub(super) fn drape(surface: &[(f64, f64)], steepest: f64, rounding_m: f64) -> Self {
        let given = Self { knots: surface.to_vec(), rounding_m };
        let end_m = surface.last().map_or(0.0, |k| k.0);
        let steps = (end_m / (0.25 * rounding_m)).ceil().clamp(1.0, 100_000.0);
        let over = |step: usize| {
            let s = end_m * step as f64 / steps;
            let least = given.corners(s).0;
            let reached = surface.iter().map(|(at, alt)| alt - steepest * (s - at).abs());
            (s, reached.fold(least, f64::max))
        };
        Self { knots: (0..=steps as usize).map(over).collect(), rounding_m }
    }

    /// Height (m) and slope at a distance (m), without rounding of the corners.
    fn corners(&self, s: f64) -> (f64, f64) {
        match self.knots.as_slice() {
            [] => (0.0, 0.0),
            [(_, alt)] => (*alt, 0.0),
            knots => {
                let next = knots.partition_point(|k| k.0 <= s).clamp(1, knots.len() - 1);
                let slope = self.slope(next - 1);
                (knots[next - 1].1 + slope * (s - knots[next - 1].0), slope)
            }
        }
    }

    fn slope(&self, knot: usize) -> f64 {
        let (a, b) = (self.knots[knot], self.knots[knot + 1]);
        (b.1 - a.1) / (b.0 - a.0)
    }

    /// Height (m) and slope at a distance (m): the climbs averaged with the weight 15/16 (1 - u²)², so that the slope
    /// never exceeds the slope of the climbs and has a continuous second derivative.
    pub(super) fn at(&self, s: f64) -> (f64, f64) {
        let (mut alt, mut slope) = self.corners(s);
        let n = self.knots.len();
        if n < 3 {
            return (alt, slope);
        }
        let w = self.rounding_m;
        let first = self.knots.partition_point(|k| k.0 <= s - w).max(1);
        for k in first..n - 1 {
            let u = (s - self.knots[k].0) / w;
            if u <= -1.0 {
                break;
            }
            let change = self.slope(k) - self.slope(k - 1);
            let u2 = u * u;
            let ramp = 0.15625 + 0.5 * u + 0.9375 * u2 * (0.5 - u2 * (1.0 / 6.0 - u2 / 30.0));
            let step = 0.5 + 0.9375 * u * (1.0 - u2 * (2.0 / 3.0 - 0.2 * u2));
            alt += change * w * (ramp - u.max(0.0));
            slope += change * (step - if u >= 0.0 { 1.0 } else { 0.0 });
        }
        (alt, slope)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn jac_the_slope_is_the_derivative_of_the_height() {
        let knots = vec![(0.0, 100.0), (1000.0, 150.0), (1400.0, 150.0), (4000.0, 50.0)];
        let profile = RouteHeightProfile::climbs(knots, 0.1, 300.0).unwrap();
        for i in 0..400 {
            let s = 10.0 * f64::from(i) + 0.3;
            let differenced = (profile.at(s + 1e-3).0 - profile.at(s - 1e-3).0) / 2e-3;
            // Rounding: 1e-14 m over 2e-3 m.
            assert!((differenced - profile.at(s).1).abs() < 1e-8, "{s}");
        }
        for corner in [700.0, 1000.0, 1300.0, 1400.0] {
            let step = profile.at(corner + 1e-9).0 - profile.at(corner - 1e-9).0;
            assert!(step.abs() < 1e-9, "no step at {corner}: {step}");
        }
        assert!((profile.at(500.0).0 - 125.0).abs() < 1e-9 && (profile.at(3000.0).1 + 100.0 / 2600.0).abs() < 1e-12);
        let steep = RouteHeightProfile::climbs(vec![(0.0, 0.0), (10.0, 0.0), (20.0, 2.0)], 0.1, 5.0);
        assert_eq!(steep, Err(ExcessiveClimb { knot: 1, slope: 0.2 }));
    }

    #[test]
    fn law_a_drape_stays_above_its_surface_and_within_its_slope() {
        let surface = [(0.0, 100.0), (5000.0, 100.0), (5500.0, 300.0), (6000.0, 120.0), (12_000.0, 150.0)];
        let (steepest, rounding) = (0.05, 300.0);
        let drape = RouteHeightProfile::drape(&surface, steepest, rounding);
        let given = RouteHeightProfile { knots: surface.to_vec(), rounding_m: rounding };
        for i in 0..1200 {
            let s = 10.0 * f64::from(i);
            let (alt, slope) = drape.at(s);
            assert!(slope.abs() <= steepest + 1e-12, "{s}: {slope}");
            // Rounding off a crest lowers the crest by 5/32 of its change of slope times the half length; elsewhere the
            // change is smaller.
            assert!(alt > given.corners(s).0 - 0.15625 * 2.0 * steepest * rounding - 0.5, "{s}: {alt}");
        }
        assert!((drape.at(2500.0).0 - 150.0).abs() < 1.0, "the climb begins 3000 m before the crest");
    }
}

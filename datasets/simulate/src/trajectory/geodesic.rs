//! Geodesics of the WGS-84 ellipsoid: the shortest path between two positions, and the course of a curved track
//! over the surface.

use std::f64::consts::TAU;

use numerics::earth::geodesy::{FLATTENING, SEMI_MAJOR_AXIS_M, meridian_radius_m, transverse_radius_m};

/// A position on the ellipsoid and the direction of the track there, in radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RoutePosition {
    pub(super) lat_rad: f64,
    pub(super) lon_rad: f64,
    /// Clockwise from north; not wrapped.
    pub(super) course_rad: f64,
}

impl RoutePosition {
    pub(super) fn new((lat_deg, lon_deg): (f64, f64), course_rad: f64) -> Self {
        Self { lat_rad: lat_deg.to_radians(), lon_rad: lon_deg.to_radians(), course_rad }
    }

    /// Latitude and longitude, in degrees.
    pub(super) fn degrees(&self) -> (f64, f64) {
        (self.lat_rad.to_degrees(), self.lon_rad.to_degrees())
    }

    /// Change of latitude, longitude and course for each metre of a track with this curvature (1/m). A
    /// track without curvature is a geodesic.
    pub(super) fn rate(&self, curvature_per_m: f64) -> [f64; 3] {
        let (sin, cos) = self.course_rad.sin_cos();
        let (sin_lat, cos_lat) = self.lat_rad.sin_cos();
        let transverse_m = transverse_radius_m(self.lat_rad);
        [
            cos / meridian_radius_m(self.lat_rad),
            sin / (transverse_m * cos_lat),
            curvature_per_m + sin * sin_lat / (cos_lat * transverse_m),
        ]
    }

    fn moved(&self, rate: &[f64; 3], by_m: f64) -> Self {
        Self {
            lat_rad: self.lat_rad + by_m * rate[0],
            lon_rad: self.lon_rad + by_m * rate[1],
            course_rad: self.course_rad + by_m * rate[2],
        }
    }

    /// Position `length_m` further along a track whose curvature is a function of the distance from this position. The
    /// track is integrated by the fourth-order Runge-Kutta method in steps of at most `step_m`.
    pub(super) fn along(&self, length_m: f64, step_m: f64, curvature_per_m: impl Fn(f64) -> f64) -> Self {
        let steps = (length_m.abs() / step_m).ceil().max(1.0);
        let h = length_m / steps;
        let mut place = *self;
        for step in 0..steps as usize {
            let s = h * step as f64;
            let middle = curvature_per_m(s + 0.5 * h);
            let k1 = place.rate(curvature_per_m(s));
            let k2 = place.moved(&k1, 0.5 * h).rate(middle);
            let k3 = place.moved(&k2, 0.5 * h).rate(middle);
            let k4 = place.moved(&k3, h).rate(curvature_per_m(s + h));
            let mean = std::array::from_fn(|i| (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]) / 6.0);
            place = place.moved(&mean, h);
        }
        place
    }

    /// Position after `ahead_m` along the geodesic from this position, then `right_m` at a right angle to the right.
    /// The course at that position is parallel to the present course.
    pub(super) fn offset(&self, ahead_m: f64, right_m: f64) -> Self {
        const STEP_M: f64 = 1000.0;
        let quarter = TAU / 4.0;
        let ahead = self.along(ahead_m, STEP_M, |_| 0.0);
        let turned = Self { course_rad: ahead.course_rad + quarter, ..ahead };
        let moved_right = turned.along(right_m, STEP_M, |_| 0.0);
        Self { course_rad: moved_right.course_rad - quarter, ..moved_right }
    }
}

/// The geodesic between two positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Geodesic {
    pub(super) length_m: f64,
    /// Azimuth at the beginning of the geodesic, clockwise from north, in radians.
    pub(super) leaves_rad: f64,
    /// Azimuth at the end of the geodesic.
    pub(super) arrives_rad: f64,
}

impl Geodesic {
    /// The geodesic between two positions in degrees; `None` where the iteration does not converge, for nearly
    /// antipodal positions. [Vincenty 1975, Survey Review 23(176)]
    pub(super) fn between(from_deg: (f64, f64), to_deg: (f64, f64)) -> Option<Self> {
        let reduced = |lat_deg: f64| ((1.0 - FLATTENING) * lat_deg.to_radians().tan()).atan().sin_cos();
        let ((sin1, cos1), (sin2, cos2)) = (reduced(from_deg.0), reduced(to_deg.0));
        let turn = (to_deg.1 - from_deg.1).to_radians();
        let turn = turn - TAU * (turn / TAU).round();
        let mut lambda = turn;
        for _ in 0..100 {
            let (sin_l, cos_l) = lambda.sin_cos();
            let (east, north) = (cos2 * sin_l, cos1 * sin2 - sin1 * cos2 * cos_l);
            let (sin_arc, cos_arc) = (east.hypot(north), sin1 * sin2 + cos1 * cos2 * cos_l);
            if sin_arc == 0.0 {
                return Some(Self { length_m: 0.0, leaves_rad: 0.0, arrives_rad: 0.0 });
            }
            let arc = sin_arc.atan2(cos_arc);
            let sin_a = cos1 * cos2 * sin_l / sin_arc;
            let cos2_a = 1.0 - sin_a * sin_a;
            let middle = if cos2_a > 0.0 { cos_arc - 2.0 * sin1 * sin2 / cos2_a } else { 0.0 };
            let c = FLATTENING / 16.0 * cos2_a * (4.0 + FLATTENING * (4.0 - 3.0 * cos2_a));
            let bent = arc + c * sin_arc * (middle + c * cos_arc * (2.0 * middle * middle - 1.0));
            let next = turn + (1.0 - c) * FLATTENING * sin_a * bent;
            if (next - lambda).abs() < 1e-14 {
                let length_m = length_m(arc, cos2_a, middle);
                let arrives = cos1 * sin_l;
                let arrives_rad = arrives.atan2(cos1 * sin2 * cos_l - sin1 * cos2);
                return Some(Self { length_m, leaves_rad: east.atan2(north), arrives_rad });
            }
            lambda = next;
        }
        None
    }
}

fn length_m(arc: f64, cos2_a: f64, middle: f64) -> f64 {
    let polar_m = SEMI_MAJOR_AXIS_M * (1.0 - FLATTENING);
    let u2 = cos2_a * (SEMI_MAJOR_AXIS_M * SEMI_MAJOR_AXIS_M / (polar_m * polar_m) - 1.0);
    let a = 1.0 + u2 / 16384.0 * (4096.0 + u2 * (-768.0 + u2 * (320.0 - 175.0 * u2)));
    let b = u2 / 1024.0 * (256.0 + u2 * (-128.0 + u2 * (74.0 - 47.0 * u2)));
    let (sin, cos) = arc.sin_cos();
    let m2 = middle * middle;
    let last = b / 6.0 * middle * (4.0 * sin * sin - 3.0) * (4.0 * m2 - 3.0);
    polar_m * a * (arc - b * sin * (middle + b / 4.0 * (cos * (2.0 * m2 - 1.0) - last)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_flinders_peak_to_buninyong() {
        // Geoscience Australia, GDA Technical Manual: 54 972.271 m, 306°52'05.37" and back 127°10'25.07",
        // on GRS80, whose flattening differs by 2e-11.
        let dms = |d: f64, m: f64, s: f64| d + m / 60.0 + s / 3600.0;
        let flinders = (-dms(37.0, 57.0, 3.72030), dms(144.0, 25.0, 29.52440));
        let buninyong = (-dms(37.0, 39.0, 10.15610), dms(143.0, 55.0, 35.38390));
        let found = Geodesic::between(flinders, buninyong).unwrap_or(Geodesic {
            length_m: 0.0,
            leaves_rad: 0.0,
            arrives_rad: 0.0,
        });
        assert!((found.length_m - 54_972.271).abs() < 1e-3, "{}", found.length_m);
        let arcsec =
            |rad: f64, deg: f64| ((rad.to_degrees() - deg).rem_euclid(360.0) * 3600.0 + 648e3) % 1296e3 - 648e3;
        assert!(arcsec(found.leaves_rad, dms(306.0, 52.0, 5.37)).abs() < 0.01);
        assert!(arcsec(found.arrives_rad, dms(127.0, 10.0, 25.07) + 180.0).abs() < 0.01);
    }

    #[test]
    fn law_a_track_without_curvature_is_the_geodesic() {
        for (from, to) in
            [((45.0, 179.5), (46.5, -178.0)), ((-22.0, 140.0), (-21.0, 140.1)), ((10.0, 5.0), (60.0, 70.0))]
        {
            let way =
                Geodesic::between(from, to).unwrap_or(Geodesic { length_m: 0.0, leaves_rad: 0.0, arrives_rad: 0.0 });
            let end = RoutePosition::new(from, way.leaves_rad).along(way.length_m, 1000.0, |_| 0.0);
            let (lat, lon) = end.degrees();
            let lon_error = (lon - to.1 + 180.0).rem_euclid(360.0) - 180.0;
            // The error of Vincenty's series is 1e-4 m or 1e-9 degrees; the integration is more accurate.
            assert!((lat - to.0).abs() < 2e-9 && lon_error.abs() < 4e-9, "{lat} {lon}");
            assert!((end.course_rad - way.arrives_rad).abs() < 1e-9);
        }
    }
}

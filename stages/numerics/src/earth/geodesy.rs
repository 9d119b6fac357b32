//! The WGS-84 ellipsoid and conversions between metres and radians.

use crate::angle::wrap_deg;
use std::f64::consts::FRAC_PI_2;

/// Semi-major axis of WGS-84, in metres; also the radius of the spherical Pinson model.
pub const SEMI_MAJOR_AXIS_M: f64 = 6_378_137.0;
/// Flattening of WGS-84.
pub const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Square of the first eccentricity of WGS-84.
pub const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);
/// Rotation rate of the earth, in rad/s.
pub const EARTH_RATE_RADPS: f64 = 7.292_115_146_7e-5;
/// Standard gravity, in m/s²; the specific force of a body at rest.
pub const STANDARD_GRAVITY_MPS2: f64 = 9.806_65;

/// Earth radii for the conversion between metres on the ground and radians of latitude and longitude.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EarthModel {
    /// The ellipsoid: meridian radius for north and transverse radius for east, each plus the height.
    #[default]
    Wgs84,
    /// Radii of MagNav.jl 1.3.3: the transverse radius for both directions, without the height. A northward distance
    /// differs by 0.33 % at 45°. Use these radii for comparison with MagNav.jl.
    Compatible,
}

/// Radius of curvature along the meridian at geodetic latitude `lat_rad`, in metres.
pub fn meridian_radius_m(lat_rad: f64) -> f64 {
    let w_squared = 1.0 - ECCENTRICITY_SQUARED * lat_rad.sin().powi(2);
    SEMI_MAJOR_AXIS_M * (1.0 - ECCENTRICITY_SQUARED) / (w_squared * w_squared.sqrt())
}

/// Radius of curvature across the meridian (prime vertical) at `lat_rad`, in metres.
pub fn transverse_radius_m(lat_rad: f64) -> f64 {
    SEMI_MAJOR_AXIS_M / (1.0 - ECCENTRICITY_SQUARED * lat_rad.sin().powi(2)).sqrt()
}

impl EarthModel {
    /// Metres north per radian of latitude at `lat_rad` and `alt_m` above the ellipsoid.
    pub fn north_m_per_rad(self, lat_rad: f64, alt_m: f64) -> f64 {
        match self {
            Self::Wgs84 => meridian_radius_m(lat_rad) + alt_m,
            Self::Compatible => transverse_radius_m(lat_rad),
        }
    }

    /// Metres east per radian of longitude at `lat_rad` and `alt_m` above the ellipsoid.
    pub fn east_m_per_rad(self, lat_rad: f64, alt_m: f64) -> f64 {
        let radius_m = match self {
            Self::Wgs84 => transverse_radius_m(lat_rad) + alt_m,
            Self::Compatible => transverse_radius_m(lat_rad),
        };
        radius_m * lat_rad.cos()
    }

    /// Metres north and east per radian of latitude and longitude, computed from one sine and one root.
    pub fn north_east_m_per_rad(self, lat_rad: f64, alt_m: f64) -> (f64, f64) {
        let (sin_lat, cos_lat) = lat_rad.sin_cos();
        let w_squared = 1.0 - ECCENTRICITY_SQUARED * (sin_lat * sin_lat);
        let transverse_m = SEMI_MAJOR_AXIS_M / w_squared.sqrt();
        match self {
            Self::Wgs84 => {
                let meridian_m = transverse_m * (1.0 - ECCENTRICITY_SQUARED) / w_squared;
                (meridian_m + alt_m, (transverse_m + alt_m) * cos_lat)
            }
            Self::Compatible => (transverse_m, transverse_m * cos_lat),
        }
    }

    /// Radians of latitude that correspond to `north_m` metres.
    pub fn north_m_to_lat_rad(self, north_m: f64, lat_rad: f64, alt_m: f64) -> f64 {
        north_m / self.north_m_per_rad(lat_rad, alt_m)
    }

    /// Radians of longitude that correspond to `east_m` metres; unbounded towards the poles.
    pub fn east_m_to_lon_rad(self, east_m: f64, lat_rad: f64, alt_m: f64) -> f64 {
        east_m / self.east_m_per_rad(lat_rad, alt_m)
    }

    /// Metres north that correspond to `dlat_rad` radians of latitude.
    pub fn lat_rad_to_north_m(self, dlat_rad: f64, lat_rad: f64, alt_m: f64) -> f64 {
        dlat_rad * self.north_m_per_rad(lat_rad, alt_m)
    }

    /// Metres east that correspond to `dlon_rad` radians of longitude.
    pub fn lon_rad_to_east_m(self, dlon_rad: f64, lat_rad: f64, alt_m: f64) -> f64 {
        dlon_rad * self.east_m_per_rad(lat_rad, alt_m)
    }

    /// Offset (north, east), in metres, of one position from another, both in degrees. The radii are evaluated midway,
    /// and the shorter way around the earth is taken.
    pub fn offset_ne_m(self, from_deg: (f64, f64), to_deg: (f64, f64), alt_m: f64) -> (f64, f64) {
        let middle_rad = (0.5 * (from_deg.0 + to_deg.0)).to_radians();
        let dlat_rad = (to_deg.0 - from_deg.0).to_radians();
        let dlon_rad = wrap_deg(to_deg.1 - from_deg.1).to_radians();
        (self.lat_rad_to_north_m(dlat_rad, middle_rad, alt_m), self.lon_rad_to_east_m(dlon_rad, middle_rad, alt_m))
    }
}

/// Earth-centred, earth-fixed position in metres of geodetic latitude and longitude (rad) and
/// height above the ellipsoid (m).
pub fn ecef_m(lat_rad: f64, lon_rad: f64, alt_m: f64) -> [f64; 3] {
    let transverse_m = transverse_radius_m(lat_rad);
    let (sin_lat, cos_lat) = lat_rad.sin_cos();
    let (sin_lon, cos_lon) = lon_rad.sin_cos();
    let axis_distance_m = (transverse_m + alt_m) * cos_lat;
    [
        axis_distance_m * cos_lon,
        axis_distance_m * sin_lon,
        (transverse_m * (1.0 - ECCENTRICITY_SQUARED) + alt_m) * sin_lat,
    ]
}

/// Whether a latitude in degrees is valid.
pub fn is_latitude_deg(lat_deg: f64) -> bool {
    lat_deg.to_radians().abs() <= FRAC_PI_2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn val_magnav_conversions_in_the_compatible_form() {
        // MagNav.jl 1.3.3: dn2dlat, de2dlon, dlat2dn, dlon2de of 100 m and 1e-5 rad at 0.7 rad.
        let earth = EarthModel::Compatible;
        let computed = [
            earth.north_m_to_lat_rad(100.0, 0.7, 5000.0),
            earth.east_m_to_lon_rad(100.0, 0.7, 5000.0),
            earth.lat_rad_to_north_m(1e-5, 0.7, 5000.0),
            earth.lon_rad_to_east_m(1e-5, 0.7, 5000.0),
        ];
        let expected =
            [1.565_676_458_449_491_6e-5, 2.047_058_183_346_687_2e-5, 63.870_156_225_655_47, 48.850_589_989_832_32];
        for (computed, expected) in computed.iter().zip(expected) {
            // MagNav.jl's eccentricity has 12 digits: 1e-12 of e² is 1e-14 of the radius.
            assert!((computed / expected - 1.0).abs() < 1e-13, "{computed} {expected}");
        }
    }

    #[test]
    fn jac_radii_are_the_derivative_of_the_position() {
        let (lat, lon, alt, step) = (0.9, -0.4, 1200.0, 1e-6);
        let earth = EarthModel::Wgs84;
        let distance =
            |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt() / (2.0 * step);
        let north = distance(ecef_m(lat + step, lon, alt), ecef_m(lat - step, lon, alt));
        let east = distance(ecef_m(lat, lon + step, alt), ecef_m(lat, lon - step, alt));
        let (north_too, east_too) = earth.north_east_m_per_rad(lat, alt);
        assert!((north_too / earth.north_m_per_rad(lat, alt) - 1.0).abs() < 1e-15);
        assert!((east_too / earth.east_m_per_rad(lat, alt) - 1.0).abs() < 1e-15);
        // The cancellation leaves a rounding error of 1e-9 m over a chord of 13 m.
        assert!((north / earth.north_m_per_rad(lat, alt) - 1.0).abs() < 1e-9);
        assert!((east / earth.east_m_per_rad(lat, alt) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn ref_radii_at_the_equator_and_the_pole() {
        // Meridian radius at the equator a(1-e²) and polar radius a²/b, NGA TR8350.2, table 3.5.
        assert!((meridian_radius_m(0.0) - 6_335_439.327_3).abs() < 1e-3);
        assert!((meridian_radius_m(FRAC_PI_2) - 6_399_593.625_8).abs() < 1e-3);
        assert!((transverse_radius_m(FRAC_PI_2) - 6_399_593.625_8).abs() < 1e-3);
    }

    #[test]
    fn law_offset_takes_the_short_way_over_the_date_line() {
        let (north, east) = EarthModel::Wgs84.offset_ne_m((10.0, 179.999), (10.0, -179.999), 0.0);
        assert!(north.abs() < 1e-9 && (east - 219.3).abs() < 0.5, "{north} {east}");
        assert_eq!(wrap_deg(540.0), -180.0);
        assert_eq!(wrap_deg(-35.25), -35.25);
        assert!(is_latitude_deg(90.0) && !is_latitude_deg(90.01) && !is_latitude_deg(f64::NAN));
    }
}

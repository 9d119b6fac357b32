//! Dipoles and prisms in the ground, at their positions on the ellipsoid: an exact crustal field at any height.

use nalgebra::{Matrix3, Vector3};
use numerics::{
    earth::{core_field::CoreField, geodesy::ecef_m},
    maps::magnetic_sources::{Dipole, MagneticBody, Prism, direction},
};

use super::spec::{BuriedBody, BuriedSource};

/// Matrix whose rows are the directions east, north and up in earth-centred components, at a position in degrees.
fn east_north_up(lat_deg: f64, lon_deg: f64) -> Matrix3<f64> {
    let ((sin_lat, cos_lat), (sin_lon, cos_lon)) = (lat_deg.to_radians().sin_cos(), lon_deg.to_radians().sin_cos());
    Matrix3::new(
        -sin_lon,
        cos_lon,
        0.0,
        -sin_lat * cos_lon,
        -sin_lat * sin_lon,
        cos_lat,
        cos_lat * cos_lon,
        cos_lat * sin_lon,
        sin_lat,
    )
}

fn earth_centred(lat_deg: f64, lon_deg: f64, alt_m: f64) -> Vector3<f64> {
    Vector3::from(ecef_m(lat_deg.to_radians(), lon_deg.to_radians(), alt_m))
}

/// Dipole or prism in the ground, in its own Cartesian frame.
pub(super) struct LocalFrameSource {
    origin: Vector3<f64>,
    /// Rotation from earth-centred components to the source's frame.
    turn: Matrix3<f64>,
    source: MagneticBody,
}

impl LocalFrameSource {
    /// Computes the local frame and the magnetisation of a source. Without a given direction, the source is magnetised
    /// along the core field.
    pub(super) fn new(buried: &BuriedSource, core: &CoreField) -> LocalFrameSource {
        let BuriedSource { lat_deg, lon_deg, alt_m, .. } = *buried;
        let along = match buried.inclination_declination_deg {
            Some((inclination, declination)) => Vector3::from(direction(inclination, declination)),
            None => {
                let [north, east, down] = core.field_ned_nt(lat_deg, lon_deg, alt_m);
                Vector3::new(east, north, -down).normalize()
            }
        };
        let (turned, source) = match buried.body {
            BuriedBody::Dipole { moment_am2 } => {
                let moment_am2 = (along * moment_am2).into();
                (Matrix3::identity(), MagneticBody::Dipole(Dipole { at_m: [0.0; 3], moment_am2 }))
            }
            BuriedBody::Prism { magnetisation_apm, size_m: [length, width, thickness], azimuth_deg } => {
                let (sin, cos) = azimuth_deg.to_radians().sin_cos();
                let turned = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
                let prism = Prism {
                    low_m: [-0.5 * width, -0.5 * length, -thickness],
                    high_m: [0.5 * width, 0.5 * length, 0.0],
                    magnetisation_apm: (turned * along * magnetisation_apm).into(),
                };
                (turned, MagneticBody::Prism(prism))
            }
        };
        let turn = turned * east_north_up(lat_deg, lon_deg);
        LocalFrameSource { origin: earth_centred(lat_deg, lon_deg, alt_m), turn, source }
    }

    /// The field in nT at an earth-centred position, in earth-centred components.
    fn field_nt(&self, place: &Vector3<f64>) -> Vector3<f64> {
        let local = self.turn * (place - self.origin);
        self.turn.transpose() * Vector3::from(self.source.field_nt(local.into()))
    }
}

/// The field of all sources (north, east, down; nT) at a position in degrees and metres above the ellipsoid.
pub(super) fn field_ned_nt(sources: &[LocalFrameSource], lat_deg: f64, lon_deg: f64, alt_m: f64) -> Vector3<f64> {
    let place = earth_centred(lat_deg, lon_deg, alt_m);
    let sum = sources.iter().fold(Vector3::zeros(), |sum, source| sum + source.field_nt(&place));
    let local = east_north_up(lat_deg, lon_deg) * sum;
    Vector3::new(local.y, local.x, -local.z)
}

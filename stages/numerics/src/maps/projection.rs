//! Map projections by their PROJ definition: WGS-84 degrees to eastings and northings, and back.

use proj4rs::{Proj, errors::Error, transform::transform};

/// A coordinate system, to and from WGS-84 degrees.
pub struct Projection {
    own: Proj,
    wgs84: Proj,
}

impl Projection {
    /// Coordinate system of a definition such as `+proj=utm +zone=54 +south +datum=WGS84`.
    ///
    /// # Errors
    /// Fails for an unknown projection or datum.
    pub fn new(definition: &str) -> Result<Projection, Error> {
        let wgs84 = Proj::from_proj_string("+proj=longlat +datum=WGS84 +no_defs")?;
        Ok(Projection { own: Proj::from_proj_string(definition)?, wgs84 })
    }

    /// Whether its coordinates are degrees.
    pub fn is_geographic(&self) -> bool {
        self.own.is_latlong()
    }

    /// Metres per unit of its coordinates: 1 for metres, 0.3048 for feet; 1 for degrees.
    pub fn unit_m(&self) -> f64 {
        if self.is_geographic() { 1.0 } else { self.own.to_meter() }
    }

    /// Easting and northing of a WGS-84 latitude and longitude in degrees; longitude and latitude if the system uses
    /// degrees. `None` where the projection is undefined.
    pub fn project(&self, lat_deg: f64, lon_deg: f64) -> Option<(f64, f64)> {
        let mut point = (lon_deg.to_radians(), lat_deg.to_radians(), 0.0);
        transform(&self.wgs84, &self.own, &mut point).ok()?;
        let degrees = |x: f64| if self.is_geographic() { x.to_degrees() } else { x };
        finite(degrees(point.0), degrees(point.1))
    }

    /// WGS-84 latitude and longitude, in degrees, of an easting and northing (or of a longitude and latitude).
    pub fn unproject(&self, easting: f64, northing: f64) -> Option<(f64, f64)> {
        let radians = |x: f64| if self.is_geographic() { x.to_radians() } else { x };
        let mut point = (radians(easting), radians(northing), 0.0);
        transform(&self.own, &self.wgs84, &mut point).ok()?;
        finite(point.1.to_degrees(), point.0.to_degrees())
    }
}

fn finite(a: f64, b: f64) -> Option<(f64, f64)> {
    (a.is_finite() && b.is_finite()).then_some((a, b))
}

//! Coordinate reference systems by EPSG code.

use std::path::Path;

use proj4rs::{Proj, transform::transform};

use crate::ReadError;

/// A coordinate reference system, to and from WGS-84 degrees.
pub struct Crs {
    code: u16,
    system: Proj,
    wgs84: Proj,
}

impl Crs {
    /// The system with an EPSG code. Datum shifts are the seven-parameter ones of the EPSG register
    /// (for the British National Grid within about 3 m of the national grid-shift file).
    ///
    /// # Errors
    /// A code that is unknown, or whose projection is.
    pub fn from_epsg(path: &Path, code: u16) -> Result<Crs, ReadError> {
        let unknown = |why: String| {
            ReadError::options(path, format!("the coordinate system EPSG:{code} {why}"))
                .help("project the map to a UTM zone or to latitude and longitude before")
        };
        let known = crs_definitions::from_code(code).ok_or_else(|| unknown("is not known".to_owned()))?;
        let made = |text: &str| Proj::from_proj_string(text).map_err(|e| unknown(format!("cannot be used: {e}")));
        Ok(Crs { code, system: made(known.proj4)?, wgs84: made("+proj=longlat +datum=WGS84 +no_defs")? })
    }

    /// The EPSG code.
    pub fn code(&self) -> u16 {
        self.code
    }

    /// Whether its coordinates are degrees already.
    pub fn is_geographic(&self) -> bool {
        self.system.is_latlong()
    }

    /// Easting and northing of a latitude and longitude in degrees; `None` where the projection has none.
    pub fn project(&self, lat_deg: f64, lon_deg: f64) -> Option<(f64, f64)> {
        let mut point = (lon_deg.to_radians(), lat_deg.to_radians(), 0.0);
        transform(&self.wgs84, &self.system, &mut point).ok()?;
        let degrees = |x: f64| if self.is_geographic() { x.to_degrees() } else { x };
        finite(degrees(point.0), degrees(point.1))
    }

    /// Latitude and longitude in degrees of an easting and northing.
    pub fn unproject(&self, easting: f64, northing: f64) -> Option<(f64, f64)> {
        let radians = |x: f64| if self.is_geographic() { x.to_radians() } else { x };
        let mut point = (radians(easting), radians(northing), 0.0);
        transform(&self.system, &self.wgs84, &mut point).ok()?;
        finite(point.1.to_degrees(), point.0.to_degrees())
    }
}

fn finite(a: f64, b: f64) -> Option<(f64, f64)> {
    (a.is_finite() && b.is_finite()).then_some((a, b))
}

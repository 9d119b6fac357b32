//! Coordinate reference systems by EPSG code.

use std::{fmt, path::Path, sync::Arc};

use proj4rs::{Proj, transform::transform};

use crate::ReadError;

/// The code of WGS-84 latitude and longitude in degrees.
pub const WGS84: u16 = 4326;

/// A coordinate reference system, to and from WGS-84 degrees. Two are equal that have one code.
#[derive(Clone)]
pub struct Crs {
    code: u16,
    wkt: &'static str,
    systems: Arc<Systems>,
}

struct Systems {
    own: Proj,
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
        let systems = Systems { own: made(known.proj4)?, wgs84: made("+proj=longlat +datum=WGS84 +no_defs")? };
        Ok(Crs { code, wkt: known.wkt, systems: Arc::new(systems) })
    }

    /// WGS-84 latitude and longitude in degrees, EPSG:4326.
    ///
    /// # Errors
    /// None: the code is known.
    pub fn wgs84() -> Result<Crs, ReadError> {
        Crs::from_epsg(Path::new("EPSG:4326"), WGS84)
    }

    /// The UTM zone of WGS-84 that a place lies in, by the zone's meridians alone (no exception for Norway).
    ///
    /// # Errors
    /// A place beyond 84 degrees north or south, where UTM ends.
    pub fn utm_zone_of(lat_deg: f64, lon_deg: f64) -> Result<Crs, ReadError> {
        let nowhere = Path::new("UTM");
        if !(lat_deg.abs() <= 84.0 && lon_deg.is_finite()) {
            let what = format!("there is no UTM zone at latitude {lat_deg}, longitude {lon_deg}");
            return Err(ReadError::options(nowhere, what).help("give `epsg`"));
        }
        let zone = (((lon_deg + 180.0).rem_euclid(360.0) / 6.0).floor() as u16).min(59) + 1;
        Crs::from_epsg(nowhere, if lat_deg < 0.0 { 32700 } else { 32600 } + zone)
    }

    /// The EPSG code.
    pub fn code(&self) -> u16 {
        self.code
    }

    /// Its name in the EPSG register, such as `WGS 84 / UTM zone 54S`.
    pub fn name(&self) -> &'static str {
        self.wkt.split('"').nth(1).unwrap_or_default()
    }

    /// Its definition as well-known text (WKT 1).
    pub fn wkt(&self) -> &'static str {
        self.wkt
    }

    /// Whether its coordinates are degrees already.
    pub fn is_geographic(&self) -> bool {
        self.systems.own.is_latlong()
    }

    /// Metres to a unit of its coordinates: 1 for metres, 0.3048 for feet; 1 for degrees.
    pub fn unit_m(&self) -> f64 {
        if self.is_geographic() { 1.0 } else { self.systems.own.to_meter() }
    }

    /// Easting and northing (or, of degrees, longitude and latitude) of a WGS-84 latitude and longitude in
    /// degrees; `None` where the projection has none.
    pub fn project(&self, lat_deg: f64, lon_deg: f64) -> Option<(f64, f64)> {
        let mut point = (lon_deg.to_radians(), lat_deg.to_radians(), 0.0);
        transform(&self.systems.wgs84, &self.systems.own, &mut point).ok()?;
        let degrees = |x: f64| if self.is_geographic() { x.to_degrees() } else { x };
        finite(degrees(point.0), degrees(point.1))
    }

    /// WGS-84 latitude and longitude in degrees of an easting and northing (or longitude and latitude).
    pub fn unproject(&self, easting: f64, northing: f64) -> Option<(f64, f64)> {
        let radians = |x: f64| if self.is_geographic() { x.to_radians() } else { x };
        let mut point = (radians(easting), radians(northing), 0.0);
        transform(&self.systems.own, &self.systems.wgs84, &mut point).ok()?;
        finite(point.1.to_degrees(), point.0.to_degrees())
    }

    /// Whether its coordinates at a place are degrees of WGS-84 within about a metre.
    pub(crate) fn is_wgs84_at(&self, lat_deg: f64, lon_deg: f64) -> bool {
        const METRE_DEG: f64 = 1e-5;
        let same = |(lat, lon): (f64, f64)| {
            let round = (lon - lon_deg) - 360.0 * ((lon - lon_deg) / 360.0).round();
            (lat - lat_deg).abs() < METRE_DEG && round.abs() < METRE_DEG
        };
        self.code == WGS84 || self.is_geographic() && self.unproject(lon_deg, lat_deg).is_some_and(same)
    }
}

fn finite(a: f64, b: f64) -> Option<(f64, f64)> {
    (a.is_finite() && b.is_finite()).then_some((a, b))
}

impl PartialEq for Crs {
    fn eq(&self, other: &Crs) -> bool {
        self.code == other.code
    }
}

impl fmt::Debug for Crs {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "EPSG:{}", self.code)
    }
}

impl fmt::Display for Crs {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "EPSG:{} ({})", self.code, self.name())
    }
}

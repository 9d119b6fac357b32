//! Geometries of a GeoPackage: a header and well-known binary. [OGC 12-128r19, 2.1.3; OGC 06-103r4]

/// Identifier of WGS 84 with latitude and longitude in degrees.
pub const WGS84: i32 = 4326;

/// Smallest rectangle around positions, in degrees: longitude and latitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// West and south.
    pub low: [f64; 2],
    /// East and north.
    pub high: [f64; 2],
}

impl Default for Extent {
    fn default() -> Extent {
        Extent { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] }
    }
}

impl Extent {
    /// Includes a position.
    pub fn add(&mut self, place: [f64; 2]) {
        for (at, x) in place.into_iter().enumerate() {
            self.low[at] = self.low[at].min(x);
            self.high[at] = self.high[at].max(x);
        }
    }

    /// Whether the rectangle has no position.
    pub fn is_empty(&self) -> bool {
        self.low[0] > self.high[0]
    }
}

/// Header of a geometry; `flags` has the byte order and the kind of the rectangle that follows.
fn header(flags: u8) -> Vec<u8> {
    let mut bytes = vec![b'G', b'P', 0, flags];
    bytes.extend(WGS84.to_le_bytes());
    bytes
}

/// Byte order of numbers: the least significant byte first.
const LITTLE: u8 = 1;

/// A point at a longitude and latitude, in degrees.
pub fn point(place: [f64; 2]) -> Vec<u8> {
    let mut bytes = header(LITTLE);
    bytes.push(LITTLE);
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(place.iter().flat_map(|x| x.to_le_bytes()));
    bytes
}

/// A track through longitudes and latitudes, in degrees, with the rectangle around it.
pub fn track(places: &[[f64; 2]]) -> Vec<u8> {
    let mut extent = Extent::default();
    places.iter().for_each(|place| extent.add(*place));
    let mut bytes = header(LITTLE | 1 << 1);
    let around = [extent.low[0], extent.high[0], extent.low[1], extent.high[1]];
    bytes.extend(around.iter().flat_map(|x| x.to_le_bytes()));
    bytes.push(LITTLE);
    bytes.extend(2u32.to_le_bytes());
    bytes.extend(u32::try_from(places.len()).unwrap_or(u32::MAX).to_le_bytes());
    bytes.extend(places.iter().flatten().flat_map(|x| x.to_le_bytes()));
    bytes
}

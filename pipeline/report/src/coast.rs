//! Coastlines of Natural Earth at the scale 1:50,000,000.
//!
//! The vendored file holds polylines: their number, then for each polyline the number of its points and the differences
//! of longitude and latitude between consecutive points, in steps of 0.005°. All numbers are stored with 7 bits per
//! byte, the least significant bits first; differences are zigzag coded. `datasets/reference/make_coastline.py` makes
//! the file.

/// The polylines.
const COASTLINE: &[u8] = include_bytes!("html/web/vendor/coastline.bin");
/// Steps per degree.
const STEPS: f64 = 200.0;

/// Region of longitude and latitude, in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeographicRegion {
    /// Western longitude, in degrees.
    pub west: f64,
    /// Eastern longitude in degrees, not below the western longitude.
    pub east: f64,
    /// Southern latitude, in degrees.
    pub south: f64,
    /// Northern latitude, in degrees.
    pub north: f64,
}

impl GeographicRegion {
    /// Smallest region around some positions (latitude and longitude in degrees); `None` without a finite position.
    pub fn around(positions: impl Iterator<Item = (f64, f64)>) -> Option<GeographicRegion> {
        positions.filter(|(lat, lon)| lat.is_finite() && lon.is_finite()).fold(None, |known, (lat, lon)| {
            let own = GeographicRegion { west: lon, east: lon, south: lat, north: lat };
            Some(known.map_or(own, |r: GeographicRegion| GeographicRegion {
                west: r.west.min(lon),
                east: r.east.max(lon),
                south: r.south.min(lat),
                north: r.north.max(lat),
            }))
        })
    }

    /// Region with a margin on each side. Each margin is as wide as the region, but at least `least` degrees.
    pub fn widened(self, least: f64) -> GeographicRegion {
        let (wide, high) = ((self.east - self.west).max(least), (self.north - self.south).max(least));
        GeographicRegion {
            west: self.west - wide,
            east: self.east + wide,
            south: self.south - high,
            north: self.north + high,
        }
    }

    /// Whether the box around two points touches the region.
    fn touches(&self, a: [f64; 2], b: [f64; 2]) -> bool {
        a[0].min(b[0]) <= self.east
            && a[0].max(b[0]) >= self.west
            && a[1].min(b[1]) <= self.north
            && a[1].max(b[1]) >= self.south
    }
}

/// Parts of the coastlines in a region, each as the longitudes and latitudes of its points, in degrees. Longitudes are
/// in the range of the region, which may be shifted by a full turn.
fn coastlines(region: GeographicRegion) -> Vec<Vec<[f64; 2]>> {
    let mut found = vec![];
    for turn in [-360.0, 0.0, 360.0] {
        for line in polylines() {
            let mut part: Vec<[f64; 2]> = vec![];
            let shifted: Vec<[f64; 2]> = line.iter().map(|[lon, lat]| [lon + turn, *lat]).collect();
            for pair in shifted.windows(2) {
                if region.touches(pair[0], pair[1]) {
                    if part.is_empty() {
                        part.push(pair[0]);
                    }
                    part.push(pair[1]);
                } else if !part.is_empty() {
                    found.push(std::mem::take(&mut part));
                }
            }
            if !part.is_empty() {
                found.push(part);
            }
        }
    }
    found
}

/// Coastlines in a region, each as a list of alternating longitudes and latitudes, in degrees.
pub fn flat_coastlines(region: GeographicRegion) -> Vec<Vec<f64>> {
    coastlines(region).into_iter().map(|line| line.into_iter().flatten().collect()).collect()
}

/// All polylines, as longitudes and latitudes in degrees.
fn polylines() -> Vec<Vec<[f64; 2]>> {
    let mut bytes = COASTLINE.iter().copied();
    let mut next = move || -> u64 {
        let (mut value, mut shift) = (0, 0);
        for byte in bytes.by_ref() {
            value |= u64::from(byte & 0x7f) << shift;
            shift += 7;
            if byte < 0x80 {
                break;
            }
        }
        value
    };
    let degrees = |steps: i64| steps as f64 / STEPS;
    let zigzag = |coded: u64| (coded >> 1) as i64 ^ -((coded & 1) as i64);
    let count = next();
    let one = |_| {
        let points = next();
        let (mut lon, mut lat) = (0i64, 0i64);
        let mut line = vec![];
        for _ in 0..points {
            lon += zigzag(next());
            lat += zigzag(next());
            line.push([degrees(lon), degrees(lat)]);
        }
        line
    };
    (0..count).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn val_the_file_holds_natural_earths_coastlines() {
        let all = polylines();
        // Counts of `make_coastline.py`.
        assert_eq!((all.len(), all.iter().map(Vec::len).sum::<usize>()), (1429, 44_020));
        assert!(all.iter().flatten().all(|[lon, lat]| lon.abs() <= 180.0 && lat.abs() <= 90.0));
        // The southern tip of Africa, Cape Agulhas: 34.833 S, 20.0 E. The tolerance is the resolution of the scale.
        let cape = coastlines(GeographicRegion { west: 19.5, east: 20.5, south: -35.2, north: -34.0 });
        let south = cape.iter().flatten().map(|p| p[1]).fold(f64::INFINITY, f64::min);
        assert!((south + 34.83).abs() < 0.06, "{south}");
    }

    #[test]
    fn unit_only_parts_in_the_region_are_kept() {
        let region = GeographicRegion { west: 139.0, east: 142.0, south: -23.0, north: -21.0 };
        assert!(coastlines(region).is_empty(), "inland Queensland");
        let tasmania = GeographicRegion { west: 144.0, east: 149.0, south: -44.0, north: -40.0 };
        let found = coastlines(tasmania);
        let near = |p: &&[f64; 2]| p[0] > 140.0 && p[0] < 153.0 && p[1] > -48.0 && p[1] < -36.0;
        assert!(!found.is_empty() && found.iter().flatten().all(|p| near(&p)));
        // The same region, shifted by a full turn.
        let turned = coastlines(GeographicRegion { west: 504.0, east: 509.0, ..tasmania });
        assert_eq!(turned.len(), found.len());
        assert_eq!(turned[0][0], [found[0][0][0] + 360.0, found[0][0][1]]);
    }

    #[test]
    fn unit_a_region_holds_its_positions() {
        assert_eq!(GeographicRegion::around([(f64::NAN, 1.0)].into_iter()), None);
        let found = GeographicRegion::around([(1.0, 10.0), (3.0, 9.0), (f64::NAN, 0.0)].into_iter());
        let wanted = GeographicRegion { west: 9.0, east: 10.0, south: 1.0, north: 3.0 };
        assert_eq!(found, Some(wanted));
        assert_eq!(wanted.widened(0.5), GeographicRegion { west: 8.0, east: 11.0, south: -1.0, north: 5.0 });
    }
}

//! Rectangles around tracks, and distances between tracks.

use figures::raster::Bounds;
use numerics::{angle::wrap_deg, earth::geodesy::EarthModel};

use super::super::track::{DegreeTrack, LineTracks};

/// The rectangle around all tracks, with a margin.
pub fn around(tracks: &[DegreeTrack]) -> Option<Bounds> {
    let places = || tracks.iter().flat_map(DegreeTrack::places).filter(|(a, b)| a.is_finite() && b.is_finite());
    let first = places().next()?;
    let mut b = Bounds { lat: (first.0, first.0), lon: (first.1, first.1) };
    for (lat, lon) in places() {
        let lon = first.1 + wrap_deg(lon - first.1);
        b.lat = (b.lat.0.min(lat), b.lat.1.max(lat));
        b.lon = (b.lon.0.min(lon), b.lon.1.max(lon));
    }
    // The rectangle is at least a kilometre long, for a stationary flight. It is widened in its narrow direction, to
    // show some of the map.
    let shrink = b.lat.0.to_radians().cos().max(0.05);
    let (high, wide) = (b.lat.1 - b.lat.0, (b.lon.1 - b.lon.0) * shrink);
    let side = 1.12 * high.max(wide).max(0.01);
    let grow = |ends: (f64, f64), by: f64| (ends.0 - 0.5 * by, ends.1 + 0.5 * by);
    let missing = |length: f64| (0.8 * side - length).max(0.12 * high.max(wide)).max(0.01);
    Some(Bounds { lat: grow(b.lat, missing(high)), lon: grow(b.lon, missing(wide) / shrink) })
}

/// The distance between INS and truth at row `k`, in metres; without truth, between INS and estimate.
pub(super) fn separation(line_tracks: &LineTracks, k: usize) -> Option<f64> {
    apart(line_tracks.ins.as_ref()?, line_tracks.truth.as_ref().unwrap_or(&line_tracks.estimate), k)
}

pub(super) fn own_error(line_tracks: &LineTracks, k: usize) -> Option<f64> {
    apart(&line_tracks.estimate, line_tracks.truth.as_ref()?, k)
}

/// The distance between two tracks at row `k`, in metres.
pub fn apart(a: &DegreeTrack, b: &DegreeTrack, k: usize) -> Option<f64> {
    let at = |t: &DegreeTrack| Some((*t.lat.get(k)?, *t.lon.get(k)?));
    let (north, east) = EarthModel::default().offset_ne_m(at(b)?, at(a)?, 0.0);
    Some(north.hypot(east)).filter(|d| d.is_finite())
}

pub(super) fn worst_place(line_tracks: &LineTracks) -> Option<usize> {
    let all = (0..line_tracks.tt.len()).filter_map(|k| separation(line_tracks, k).map(|d| (k, d)));
    all.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))).map(|(k, _)| k)
}

/// Square around the tracks at row `k`, a few times as wide as the distance between the tracks.
pub(super) fn zoom_bounds(line_tracks: &LineTracks, k: usize) -> Bounds {
    let centre = line_tracks.truth.as_ref().unwrap_or(&line_tracks.estimate);
    let (lat, lon) = (centre.lat.get(k).copied().unwrap_or(0.0), centre.lon.get(k).copied().unwrap_or(0.0));
    square((lat, lon), (1.4 * separation(line_tracks, k).unwrap_or(0.0)).max(250.0))
}

/// The square around a position, with half a side of `half_m` metres.
pub(super) fn square((lat, lon): (f64, f64), half_m: f64) -> Bounds {
    let (earth, lat_rad) = (EarthModel::default(), lat.to_radians());
    let (north, east) = (earth.north_m_to_lat_rad(half_m, lat_rad, 0.0), earth.east_m_to_lon_rad(half_m, lat_rad, 0.0));
    let (north, east) = (north.to_degrees(), east.to_degrees());
    Bounds { lat: (lat - north, lat + north), lon: (lon - east, lon + east) }
}

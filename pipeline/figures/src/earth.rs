//! Geometry on the globe for KML: maps are divided into parts that do not cross the date line, and tracks are thinned
//! to within a metre.

use numerics::angle::wrap_deg;
use numerics::earth::geodesy::EarthModel;

use super::{
    sheet::MapWindow,
    thin::{kept, to_stretch},
};

/// Part of a map and its position on the globe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GlobePatch {
    /// Edges in the map's own longitudes, which may exceed 180 degrees.
    pub window: MapWindow,
    /// West and east, within -180 to 180 degrees.
    pub lon: (f64, f64),
}

/// Parts of a map with these edges: one part, or more parts if the map crosses the date line. Areas beyond a pole or a
/// full turn are omitted.
pub fn patches(window: &MapWindow) -> Vec<GlobePatch> {
    let south_north = (window.y.0.max(-90.0), window.y.1.min(90.0));
    let (west, east) = (window.x.0, window.x.1.min(window.x.0 + 360.0));
    let mut out = vec![];
    let mut from = west;
    while from < east && south_north.0 < south_north.1 {
        let turns = ((from + 180.0) / 360.0).floor();
        let to = east.min(360.0 * turns + 180.0);
        // A sliver that is due to rounding is ignored.
        if to - from > 1e-9 * (east - west) {
            let lon = (from - 360.0 * turns, to - 360.0 * turns);
            out.push(GlobePatch { window: MapWindow { x: (from, to), y: south_north }, lon });
        }
        from = to;
    }
    out
}

/// Sample of a track: latitude, longitude, height and, if known, time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackFix {
    /// Latitude, in degrees.
    pub lat: f64,
    /// Longitude, in degrees.
    pub lon: f64,
    /// Height, in metres.
    pub alt: f64,
    /// Seconds since 1970 UTC.
    pub time_s: Option<f64>,
}

/// Parts of an unbroken track that do not cross the date line, longitudes within -180 to 180 degrees. At a crossing of
/// the date line, both parts include the position on the date line.
pub fn parts(run: &[TrackFix]) -> Vec<Vec<TrackFix>> {
    let mut out: Vec<Vec<TrackFix>> = vec![vec![]];
    let mut before: Option<TrackFix> = None;
    for fix in run {
        let here = TrackFix { lon: wrap_deg(fix.lon), ..*fix };
        if let Some(last) = before
            && (here.lon - last.lon).abs() > 180.0
        {
            let (ends, starts) = crossing(&last, &here);
            if let Some(part) = out.last_mut() {
                part.push(ends);
            }
            out.push(vec![starts]);
        }
        if let Some(part) = out.last_mut() {
            part.push(here);
        }
        before = Some(here);
    }
    out
}

/// Position where the straight line from `a` to `b` crosses the date line, from either side.
fn crossing(a: &TrackFix, b: &TrackFix) -> (TrackFix, TrackFix) {
    let side = if a.lon > 0.0 { 180.0 } else { -180.0 };
    let beyond = b.lon + 2.0 * side;
    let part = if beyond == a.lon { 0.0 } else { (side - a.lon) / (beyond - a.lon) };
    let mix = |p: f64, q: f64| p + part * (q - p);
    let at = |lon: f64| TrackFix {
        lat: mix(a.lat, b.lat),
        lon,
        alt: mix(a.alt, b.alt),
        time_s: a.time_s.zip(b.time_s).map(|(p, q)| mix(p, q)),
    };
    (at(side), at(-side))
}

/// Thins an unbroken track: dropped samples are within `tolerance_m` of the straight line between their kept
/// neighbours. With known times, the tolerance applies to the position on the line at the time of the sample.
pub fn thinned(run: &[TrackFix], tolerance_m: f64) -> Vec<TrackFix> {
    let Some(first) = run.first() else { return vec![] };
    let earth = EarthModel::default();
    let metres: Vec<[f64; 3]> = run
        .iter()
        .map(|f| {
            let (north, east) = earth.offset_ne_m((first.lat, first.lon), (f.lat, f.lon), 0.0);
            [north, east, f.alt]
        })
        .collect();
    let timed = run.iter().all(|f| f.time_s.is_some());
    let distance = |a: usize, b: usize, k: usize| {
        let ends = [a, b, k].map(|i| metres.get(i).copied().unwrap_or_default());
        if !timed {
            return to_stretch(&ends[0], &ends[1], &ends[2]);
        }
        let [from, to, at] = [a, b, k].map(|i| run.get(i).and_then(|f| f.time_s).unwrap_or_default());
        let part = if to > from { (at - from) / (to - from) } else { 0.0 };
        let off = |i: usize| ends[2][i] - ends[0][i] - part * (ends[1][i] - ends[0][i]);
        (off(0).powi(2) + off(1).powi(2) + off(2).powi(2)).sqrt()
    };
    kept(run.len(), tolerance_m, distance).into_iter().filter_map(|k| run.get(k).copied()).collect()
}

/// Instant in XML notation, to the millisecond.
pub fn instant(unix_s: f64) -> String {
    let millis = (unix_s * 1000.0).round() as i64;
    let (days, of_day) = (millis.div_euclid(86_400_000), millis.rem_euclid(86_400_000));
    let (year, month, day) = civil(days);
    let (hour, minute, second) = (of_day / 3_600_000, of_day / 60_000 % 60, of_day / 1000 % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{:03}Z", of_day % 1000)
}

/// Year, month and day of a number of days since 1 January 1970. [H. Hinnant, chrono-compatible low-level date
/// algorithms]
fn civil(days: i64) -> (i64, i64, i64) {
    // Years begin in March, so that the leap day is the last day; eras have 400 years, 146,097 days.
    let shifted = days + 719_468;
    let (era, of_era) = (shifted.div_euclid(146_097), shifted.rem_euclid(146_097));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let (month, later) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    (400 * era + year + later, month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(lat: f64, lon: f64, time_s: Option<f64>) -> TrackFix {
        TrackFix { lat, lon, alt: 300.0, time_s }
    }

    fn lons(x: (f64, f64)) -> Vec<(f64, f64)> {
        patches(&MapWindow { x, y: (-95.0, 10.0) }).into_iter().map(|p| p.lon).collect()
    }

    #[test]
    fn unit_maps_are_cut_at_the_date_line() {
        assert_eq!(lons((140.0, 150.0)), [(140.0, 150.0)]);
        assert_eq!(lons((170.0, 190.0)), [(170.0, 180.0), (-180.0, -170.0)]);
        assert_eq!(lons((-190.0, -170.0)), [(170.0, 180.0), (-180.0, -170.0)]);
        assert_eq!(lons((-0.5, 360.5)), [(-0.5, 180.0), (-180.0, -0.5)]);
        assert_eq!(lons((190.0, 200.0)), [(-170.0, -160.0)]);
        assert_eq!(lons((-180.0, 180.0)), [(-180.0, 180.0)]);
        let south = patches(&MapWindow { x: (0.0, 1.0), y: (-95.0, 95.0) })[0].window.y;
        assert_eq!(south, (-90.0, 90.0));
    }

    #[test]
    fn unit_tracks_are_cut_at_date_line_crossings() {
        let cut = parts(&[fix(10.0, 179.0, Some(0.0)), fix(12.0, -179.0, Some(20.0)), fix(12.0, 181.5, Some(25.0))]);
        assert_eq!(cut.len(), 2);
        assert_eq!(cut[0], [fix(10.0, 179.0, Some(0.0)), fix(11.0, 180.0, Some(10.0))]);
        assert_eq!(cut[1][..2], [fix(11.0, -180.0, Some(10.0)), fix(12.0, -179.0, Some(20.0))]);
        assert_eq!(cut[1][2].lon, -178.5);
    }

    #[test]
    fn unit_thinned_tracks_stay_within_a_metre() {
        let circle = |k: i32| (f64::from(k) / 500.0).sin_cos();
        let run: Vec<TrackFix> = (0..3000).map(|k| fix(50.0 + 0.02 * circle(k).0, 0.02 * circle(k).1, None)).collect();
        let few = thinned(&run, 1.0);
        // On a circle of radius 2.2 km, a chord that deviates by 1 m is 133 m long, so a path of 10 km needs 80 to 160
        // points.
        assert!((80..160).contains(&few.len()), "{}", few.len());
        assert_eq!((few[0], few[few.len() - 1]), (run[0], run[2999]));
    }

    #[test]
    fn unit_stop_on_a_straight_line_is_kept_with_known_times() {
        let way = |timed: bool| -> Vec<TrackFix> {
            let lat = |k: i32| 0.001 * f64::from(k.min(50) + (k - 80).max(0));
            (0..150).map(|k| fix(lat(k), 0.0, timed.then(|| f64::from(k)))).collect()
        };
        assert_eq!(thinned(&way(false), 1.0).len(), 2);
        let times: Vec<f64> = thinned(&way(true), 1.0).into_iter().filter_map(|f| f.time_s).collect();
        assert_eq!(times, [0.0, 50.0, 80.0, 149.0]);
    }

    #[test]
    fn ref_instants() {
        // `date -u -d @... +%FT%T.%3NZ` of GNU coreutils.
        for (unix_s, written) in [
            (0.0, "1970-01-01T00:00:00.000Z"),
            (951_782_400.0, "2000-02-29T00:00:00.000Z"),
            (1_593_453_781.25, "2020-06-29T18:03:01.250Z"),
            (-1.5, "1969-12-31T23:59:58.500Z"),
            (4_107_542_400.0, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(instant(unix_s), written);
        }
    }
}

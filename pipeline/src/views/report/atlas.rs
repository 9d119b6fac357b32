//! The map with the tracks on it: the whole line, and a close look where the INS error is largest.

use figures::{
    canvas::{Canvas, LEFT, SIDE},
    chart::{path, px},
    decimate::{MOST, thinned},
    palette::{Palette, hex},
    png_file::data_url,
    raster::{Bounds, Raster, raster},
    ticks::fixed,
};
use maud::{Markup, html};
use numerics::angle::wrap_deg;
use numerics::earth::geodesy::EarthModel;
use schemas::Fault;

use super::{
    source::Source,
    track::{Flown, Track},
};
use crate::{plan::Ref, views::text::number};

/// Radius of the ellipse that holds 95 % of a two-dimensional normal distribution, in sigma.
const ELLIPSE_95: f64 = 2.447_746_8;

/// The data that all maps of the page share: the visible part of the map and its picture, which is in the page once.
pub struct Atlas {
    bounds: Bounds,
    picture: Option<Raster>,
}

impl Atlas {
    /// The part of the map `map` that `tracks` lie on; `None` where there is no place.
    ///
    /// # Errors
    /// When the store is damaged.
    pub fn new(source: &Source, map: Option<Ref>, tracks: &[Track]) -> Result<Option<Atlas>, Fault> {
        let Some(around) = around(tracks) else { return Ok(None) };
        let picture = match map.map(|r| source.map(r)).transpose()?.flatten() {
            Some(grid) => {
                // Maps may count longitudes from 0 to 360.
                let middle = 0.5 * (grid.lon().first_deg() + grid.lon().last_deg());
                let turns = 360.0 * ((middle - around.lon.0) / 360.0).round();
                let turned = Bounds { lon: (around.lon.0 + turns, around.lon.1 + turns), ..around };
                raster(&grid, &turned)?.map(|r| Raster {
                    bounds: Bounds { lon: (r.bounds.lon.0 - turns, r.bounds.lon.1 - turns), ..r.bounds },
                    ..r
                })
            }
            None => None,
        };
        Ok(Some(Atlas { bounds: around, picture }))
    }

    /// The picture and the colour scale, for references.
    pub fn defs(&self) -> Markup {
        let Some(picture) = &self.picture else { return html! {} };
        html! {
            svg.defs width="0" height="0" aria-hidden="true" { defs {
                image id="map" width=(picture.size.0) height=(picture.size.1) preserveAspectRatio="none" href=(data_url(&picture.png)) {}
                linearGradient id="scale" { @for k in 0..=10 {
                    stop offset=(format!("{}%", 10 * k)) stop-color=(hex(Palette::Viridis.colour(f64::from(k) / 10.0))) {}
                } }
            } }
        }
    }

    /// Both maps of one line.
    pub fn plots(&self, flown: &Flown) -> Markup {
        let place = worst_place(flown);
        let zoom = place.map(|k| zoom_bounds(flown, k));
        html! {
            div.maps {
                (self.whole(flown, zoom.as_ref()))
                @if let (Some(k), Some(zoom)) = (place, zoom) { (self.close(flown, k, &zoom)) }
            }
        }
    }

    fn whole(&self, flown: &Flown, zoom: Option<&Bounds>) -> Markup {
        let canvas = Canvas::new(self.bounds);
        let extra = html! { @if let Some(zoom) = zoom { (frame_of(&canvas, zoom)) } };
        let caption = match &self.picture {
            Some(_) => {
                "Anomaly map with the tracks; each colour covers the same area. The dot is the start, the square the end, the frame the part shown beside it."
            }
            None => {
                "The tracks; there is no map under them. The dot is the start, the square the end, the frame the part shown beside it."
            }
        };
        html! {
            figure {
                h4 { "Tracks" @if self.picture.is_some() { " on the anomaly map" } }
                (legend(flown))
                (self.drawn(&canvas, flown, "Tracks on the map", extra))
                @if let Some(picture) = &self.picture { (colour_bar(picture)) }
                figcaption { (caption) }
            }
        }
    }

    fn close(&self, flown: &Flown, k: usize, zoom: &Bounds) -> Markup {
        let canvas = Canvas::new(*zoom);
        let outline = ellipse(&canvas, flown, k);
        let extra = html! { @if let Some(d) = &outline { path.halo d=(d) {} path.ellipse d=(d) {} } };
        let of = if flown.truth.is_some() { "from the truth" } else { "from the estimate" };
        let minute = (flown.tt.get(k).copied().unwrap_or(0.0) - flown.tt.first().copied().unwrap_or(0.0)) / 60.0;
        let mut caption =
            format!("Where the INS is farthest {of}, {} m, at {minute:.1} min.", number(separation(flown, k)));
        if let (Some(error), true) = (own_error(flown, k), flown.ins.is_some()) {
            caption.push_str(&format!(" The estimate is {} m off there.", number(Some(error))));
        }
        if outline.is_some() {
            caption.push_str(" The ellipse is the 95 % region of the filter at that moment.");
        }
        html! {
            figure {
                h4 { "A close look" }
                (legend(flown))
                (self.drawn(&canvas, flown, "Tracks, a close look", extra))
                figcaption { (caption) }
            }
        }
    }

    fn drawn(&self, canvas: &Canvas, flown: &Flown, label: &str, extra: Markup) -> Markup {
        let tracks = [flown.ins.as_ref(), flown.truth.as_ref(), Some(&flown.estimate)];
        let spots: Vec<(f64, f64)> =
            tracks.into_iter().flatten().flat_map(Track::places).filter_map(|p| canvas.spot(p)).collect();
        canvas.framed(
            label,
            html! {
                @if let Some(picture) = &self.picture { (placed(canvas, picture)) }
                @if let Some(ins) = &flown.ins { (line(canvas, ins, "ins")) }
                @if let Some(truth) = &flown.truth { (line(canvas, truth, "truth")) }
                (line(canvas, &flown.estimate, if flown.truth.is_some() { "estimate over" } else { "estimate" }))
                (ends(canvas, flown.truth.as_ref().or(flown.ins.as_ref()).unwrap_or(&flown.estimate)))
                (extra)
                (canvas.furniture(&spots))
            },
        )
    }
}

/// The rectangle around all tracks, with a margin.
fn around(tracks: &[Track]) -> Option<Bounds> {
    let places = || tracks.iter().flat_map(Track::places).filter(|(a, b)| a.is_finite() && b.is_finite());
    let first = places().next()?;
    let mut b = Bounds { lat: (first.0, first.0), lon: (first.1, first.1) };
    for (lat, lon) in places() {
        let lon = first.1 + wrap_deg(lon - first.1);
        b.lat = (b.lat.0.min(lat), b.lat.1.max(lat));
        b.lon = (b.lon.0.min(lon), b.lon.1.max(lon));
    }
    // A kilometre at least, for a flight on the spot; and the narrow direction also shows some of the map.
    let shrink = b.lat.0.to_radians().cos().max(0.05);
    let (high, wide) = (b.lat.1 - b.lat.0, (b.lon.1 - b.lon.0) * shrink);
    let side = 1.12 * high.max(wide).max(0.01);
    let grow = |ends: (f64, f64), by: f64| (ends.0 - 0.5 * by, ends.1 + 0.5 * by);
    let missing = |length: f64| (0.8 * side - length).max(0.12 * high.max(wide)).max(0.01);
    Some(Bounds { lat: grow(b.lat, missing(high)), lon: grow(b.lon, missing(wide) / shrink) })
}

/// The distance of INS and truth (without truth: INS and estimate) at row `k`, m.
fn separation(flown: &Flown, k: usize) -> Option<f64> {
    apart(flown.ins.as_ref()?, flown.truth.as_ref().unwrap_or(&flown.estimate), k)
}

fn own_error(flown: &Flown, k: usize) -> Option<f64> {
    apart(&flown.estimate, flown.truth.as_ref()?, k)
}

fn apart(a: &Track, b: &Track, k: usize) -> Option<f64> {
    let at = |t: &Track| Some((*t.lat.get(k)?, *t.lon.get(k)?));
    let (north, east) = EarthModel::default().offset_ne_m(at(b)?, at(a)?, 0.0);
    Some(north.hypot(east)).filter(|d| d.is_finite())
}

fn worst_place(flown: &Flown) -> Option<usize> {
    let all = (0..flown.tt.len()).filter_map(|k| separation(flown, k).map(|d| (k, d)));
    all.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))).map(|(k, _)| k)
}

/// A square around the tracks at row `k`, a few times as wide as they are apart.
fn zoom_bounds(flown: &Flown, k: usize) -> Bounds {
    let centre = flown.truth.as_ref().unwrap_or(&flown.estimate);
    let (lat, lon) = (centre.lat.get(k).copied().unwrap_or(0.0), centre.lon.get(k).copied().unwrap_or(0.0));
    let half_m = (1.4 * separation(flown, k).unwrap_or(0.0)).max(250.0);
    let (earth, lat_rad) = (EarthModel::default(), lat.to_radians());
    let (north, east) = (earth.north_m_to_lat_rad(half_m, lat_rad, 0.0), earth.east_m_to_lon_rad(half_m, lat_rad, 0.0));
    let (north, east) = (north.to_degrees(), east.to_degrees());
    Bounds { lat: (lat - north, lat + north), lon: (lon - east, lon + east) }
}

fn placed(canvas: &Canvas, picture: &Raster) -> Markup {
    let b = &picture.bounds;
    let (x, y) = (canvas.x(b.lon.0), canvas.y(b.lat.1));
    let wide = (b.lon.1 - b.lon.0) * canvas.per_degree_east();
    let (sx, sy) = (wide / picture.size.0 as f64, (canvas.y(b.lat.0) - y) / picture.size.1 as f64);
    html! { use href="#map" transform=(format!("translate({x:.2} {y:.2}) scale({sx:.5} {sy:.5})")) {} }
}

fn line(canvas: &Canvas, track: &Track, class: &str) -> Markup {
    // Positions that coincide on the picture are drawn once.
    let spots: Vec<Option<(f64, f64)>> = track.places().map(|p| canvas.spot(p)).collect();
    let inside = spots.iter().flatten().count();
    let d = if inside > MOST {
        path(thinned(&spots, MOST * spots.len() / inside).into_iter())
    } else {
        path(spots.into_iter())
    };
    // The estimate lies on the true track, which is wider, so that both are seen.
    html! {
        @if !class.ends_with("over") { path.halo d=(&d) {} }
        path class=(format!("track {class}")) d=(d) {}
    }
}

fn ends(canvas: &Canvas, track: &Track) -> Markup {
    let there = || track.places().filter(|p| p.0.is_finite()).map(|p| canvas.spot(p));
    let (first, last) = (there().next().flatten(), there().last().flatten());
    html! {
        @if let Some((x, y)) = first { circle.mark cx=(px(x)) cy=(px(y)) r="4.5" {} }
        @if let Some((x, y)) = last { rect.mark x=(px(x - 4.0)) y=(px(y - 4.0)) width="8" height="8" {} }
    }
}

fn frame_of(canvas: &Canvas, zoom: &Bounds) -> Markup {
    let (x, y) = (canvas.x(zoom.lon.0), canvas.y(zoom.lat.1));
    let (w, h) = (canvas.x(zoom.lon.1) - x, canvas.y(zoom.lat.0) - y);
    // A smaller frame would not be visible.
    let (w2, h2) = (w.max(12.0), h.max(12.0));
    let (x, y) = (px(x - 0.5 * (w2 - w)), px(y - 0.5 * (h2 - h)));
    html! { rect.halo x=(x) y=(y) width=(px(w2)) height=(px(h2)) {} rect.window x=(x) y=(y) width=(px(w2)) height=(px(h2)) {} }
}

fn ellipse(canvas: &Canvas, flown: &Flown, k: usize) -> Option<String> {
    let [sd_n, sd_e, cov] = flown.sigma.as_ref()?;
    let (sn, se, ne) = (*sd_n.get(k)?, *sd_e.get(k)?, *cov.get(k)?);
    let (lat, lon) = (*flown.estimate.lat.get(k)?, *flown.estimate.lon.get(k)?);
    // The Cholesky factor of the covariance turns a circle into the ellipse.
    let (a, b) = (sn, ne / sn);
    let c = (se * se - b * b).max(0.0).sqrt();
    let (x, y) = canvas.spot((lat, lon))?;
    let metres = canvas.metres_per_px();
    let at = |step: i32| {
        let (sin, cos) = (f64::from(step) * std::f64::consts::TAU / 48.0).sin_cos();
        let (north, east) = (ELLIPSE_95 * a * cos, ELLIPSE_95 * (b * cos + c * sin));
        Some((x + east / metres, y - north / metres)).filter(|s| s.0.is_finite() && s.1.is_finite())
    };
    Some(path((0..=48).map(at)))
}

fn legend(flown: &Flown) -> Markup {
    html! {
        p.legend {
            @if flown.truth.is_some() { span { i class="key truth" {} "true" } }
            @if flown.ins.is_some() { span { i class="key ins" {} "INS alone" } }
            span { i class="key estimate" {} "estimate" }
        }
    }
}

fn colour_bar(picture: &Raster) -> Markup {
    let (left, wide) = (LEFT, SIDE - LEFT - 26.0);
    html! {
        svg.colours viewBox=(format!("0 0 {SIDE} 46")) role="img" aria-label="Colour scale of the anomaly" {
            rect x=(left) y="2" width=(wide) height="11" fill="url(#scale)" {}
            @for k in [0u8, 2, 4, 6, 8, 10] {
                @let x = px(left + wide * f64::from(k) / 10.0);
                line.stroke x1=(x) x2=(x) y1="13" y2="17" {}
                @if let Some(value) = picture.scale.get(usize::from(k)) {
                    text.tick x=(x) y="28" text-anchor="middle" { (nanotesla(*value)) }
                }
            }
            text.name x=(px(left + 0.5 * wide)) y="43" text-anchor="middle" { "anomaly, nT, at 0, 20 … 100 % of the area" }
        }
    }
}

fn nanotesla(value: f64) -> String {
    fixed(value, if value.abs() < 10.0 { 1 } else { 0 })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn flown() -> Flown {
        let track = |shift: f64| Track {
            lat: (0..100).map(|k| -22.0 + f64::from(k) * 1e-3).collect(),
            lon: (0..100).map(|k| 140.0 + shift * f64::from(k)).collect(),
        };
        let sigma = Some([vec![10.0; 100], vec![10.0; 100], vec![0.0; 100]]);
        let tt = (0..100).map(f64::from).collect();
        Flown {
            tt,
            truth: Some(track(0.0)),
            ins: Some(track(1e-5)),
            estimate: track(2e-6),
            sigma,
            residual: None,
            nis: None,
        }
    }

    #[test]
    fn unit_the_close_look_is_where_the_ins_is_farthest_off() {
        let flown = flown();
        assert_eq!(worst_place(&flown), Some(99));
        // 0.00099 degrees of longitude at 22 degrees south.
        assert!((separation(&flown, 99).unwrap() - 102.2).abs() < 0.5);
        let zoom = zoom_bounds(&flown, 99);
        assert!(zoom.lat.0 < -21.901 && zoom.lat.1 > -21.901);
    }

    #[test]
    fn unit_the_ellipse_of_a_round_covariance_is_a_circle() {
        let flown = flown();
        let canvas = Canvas::new(zoom_bounds(&flown, 99));
        let d = ellipse(&canvas, &flown, 99).unwrap();
        let (x, y) = canvas.spot((flown.estimate.lat[99], flown.estimate.lon[99])).unwrap();
        let radius = ELLIPSE_95 * 10.0 / canvas.metres_per_px();
        for spot in d.split(['M', 'L']).filter(|s| !s.is_empty()) {
            let (a, b) = spot.split_once(' ').unwrap();
            let (a, b): (f64, f64) = (a.parse().unwrap(), b.parse().unwrap());
            // Positions are written to a tenth.
            assert!(((a - x).hypot(b - y) - radius).abs() < 0.15);
        }
    }

    #[test]
    fn unit_tracks_across_the_date_line_stay_together() {
        let track = Track { lat: vec![0.0, 0.0], lon: vec![179.9, -179.9] };
        let b = around(&[track]).unwrap();
        assert!(b.lon.1 - b.lon.0 < 0.3, "{b:?}");
        let canvas = Canvas::new(b);
        assert!(canvas.x(-179.9) > canvas.x(179.9));
        assert!(around(&[]).is_none());
    }
}

//! The map with the tracks and their error ellipses: the whole line, and a detail view where the INS error is largest.

mod extent;

use std::rc::Rc;

use figures::{
    canvas::{Canvas, LEFT, SIDE},
    chart::{path, px},
    decimate::{MOST, thinned},
    ellipse::Ellipse,
    palette::{Palette, hex},
    png_file::data_url,
    raster::{Bounds, Raster, raster},
    ticks::{fixed, round_below},
};
use maud::{Markup, html};
use plan::TableRef;
use results::text::number;
use schemas::Fault;

use super::{
    source::ReportSource,
    track::{DegreeTrack, LineTracks},
};
pub use extent::{apart, around};
use extent::{own_error, separation, square, worst_place, zoom_bounds};

/// Scale of the ellipses in standard deviations: 98.9 % of a two-dimensional normal distribution are inside.
const SIGMAS: f64 = 3.0;
/// Number of error ellipses along a line, and number of ellipses in the detail view. The detail view surrounds the
/// middle ellipse.
const ELLIPSES: usize = 16;
const CLOSE: usize = 6;
/// Ellipses whose longest semi-axis on the picture is shorter than this are enlarged or shown in a detail view.
const SMALLEST_PX: f64 = 6.0;
/// Longest semi-axis of enlarged ellipses.
const ENLARGED_PX: f64 = 18.0;

/// Map image below tracks, embedded once per page.
struct AtlasImage {
    id: String,
    raster: Raster,
}

/// Map data shared by all plots of a navigation: the visible bounds and the image.
pub struct Atlas {
    bounds: Bounds,
    picture: Option<Rc<AtlasImage>>,
}

/// Tracks, and the map on which they were navigated.
pub type AtlasTracks = (Option<TableRef>, Vec<DegreeTrack>);

/// The atlas of each group of tracks (`None` without positions), and the pictures of the maps, to which the atlases
/// refer. Groups over the same map share the picture of the map.
///
/// # Errors
/// Fails if the store is damaged.
pub fn atlases(source: &ReportSource, groups: &[AtlasTracks]) -> Result<(Vec<Option<Atlas>>, Markup), Fault> {
    let bounds: Vec<Option<Bounds>> = groups.iter().map(|(_, tracks)| around(tracks)).collect();
    let mut drawn: Vec<(TableRef, Option<Rc<AtlasImage>>)> = vec![];
    for (map, _) in groups {
        let Some(map) = map.filter(|m| !drawn.iter().any(|(known, _)| known == m)) else { continue };
        let here = groups.iter().zip(&bounds).filter(|((m, _), _)| *m == Some(map)).filter_map(|(_, b)| *b);
        let Some(all) = here.reduce(together) else { continue };
        let id = format!("map-{}", source.graph.plan.name_of(map));
        drawn.push((map, raster_of(source, map, &all)?.map(|raster| Rc::new(AtlasImage { id, raster }))));
    }
    let picture = |map: Option<TableRef>| drawn.iter().find(|(m, _)| Some(*m) == map).and_then(|(_, p)| p.clone());
    let atlas = |((map, _), bounds): (&AtlasTracks, Option<Bounds>)| {
        bounds.map(|b| Atlas { bounds: b, picture: picture(*map) })
    };
    let all = groups.iter().zip(bounds).map(atlas).collect();
    Ok((all, defs(drawn.iter().filter_map(|(_, p)| p.as_deref()))))
}

/// The part of the map within `around`.
fn raster_of(source: &ReportSource, map: TableRef, around: &Bounds) -> Result<Option<Raster>, Fault> {
    let Some(grid) = source.map(map)? else { return Ok(None) };
    // Maps may count longitudes from 0 to 360.
    let middle = 0.5 * (grid.lon().first_deg() + grid.lon().last_deg());
    let turns = 360.0 * ((middle - around.lon.0) / 360.0).round();
    let turned = Bounds { lon: (around.lon.0 + turns, around.lon.1 + turns), ..*around };
    let back = |r: Raster| Raster {
        bounds: Bounds { lon: (r.bounds.lon.0 - turns, r.bounds.lon.1 - turns), ..r.bounds },
        ..r
    };
    Ok(raster(&grid, &turned)?.map(back))
}

/// Rectangle around two rectangles, the shorter way around the earth.
fn together(a: Bounds, b: Bounds) -> Bounds {
    let middle = |b: &Bounds| 0.5 * (b.lon.0 + b.lon.1);
    let turns = 360.0 * ((middle(&a) - middle(&b)) / 360.0).round();
    Bounds {
        lat: (a.lat.0.min(b.lat.0), a.lat.1.max(b.lat.1)),
        lon: (a.lon.0.min(b.lon.0 + turns), a.lon.1.max(b.lon.1 + turns)),
    }
}

/// SVG definitions: the pictures of the maps, and the colour scale.
fn defs<'a>(pictures: impl Iterator<Item = &'a AtlasImage>) -> Markup {
    let pictures: Vec<&AtlasImage> = pictures.collect();
    html! {
        @if !pictures.is_empty() { svg.defs width="0" height="0" aria-hidden="true" { defs {
            @for AtlasImage { id, raster } in pictures {
                image id=(id) width=(raster.size.0) height=(raster.size.1) preserveAspectRatio="none"
                    href=(data_url(&raster.png)) {}
            }
            linearGradient id="scale" { @for k in 0..=10 {
                stop offset=(format!("{}%", 10 * k)) stop-color=(hex(Palette::Viridis.colour(f64::from(k) / 10.0))) {}
            } }
        } } }
    }
}

impl Atlas {
    /// The maps of one line: the whole line, the detail view and, if it does not show the largest ellipse, a view of
    /// that ellipse.
    pub fn plots(&self, line_tracks: &LineTracks) -> Markup {
        let place = worst_place(line_tracks);
        let zoom = place.map(|k| zoom_bounds(line_tracks, k));
        html! {
            div.maps {
                (self.whole(line_tracks, zoom.as_ref()))
                @if let (Some(k), Some(zoom)) = (place, zoom) { (self.close(line_tracks, k, &zoom)) }
                @let seen = |ellipse: &Ellipse| is_seen(line_tracks, place.zip(zoom.as_ref()), ellipse);
                @if let Some(near) = widest(line_tracks).filter(|(_, e)| !seen(e)) {
                    (self.near(line_tracks, near))
                }
            }
        }
    }

    fn whole(&self, line_tracks: &LineTracks, zoom: Option<&Bounds>) -> Markup {
        let canvas = Canvas::new(self.bounds);
        let rings = ellipses(line_tracks, &spaced(0..line_tracks.tt.len(), ELLIPSES));
        let times = enlargement(&canvas, &rings);
        let under = outlines(&canvas, line_tracks, &rings, times);
        let over = html! { @if let Some(zoom) = zoom { (frame_of(&canvas, zoom)) } };
        let what = match &self.picture {
            Some(_) => {
                "Tracks on the anomaly map, with hill shading from the north-west. Each colour covers an equal share \
                 of the area."
            }
            None => "Tracks without a map.",
        };
        let every =
            line_tracks.tt.last().zip(line_tracks.tt.first()).map(|(b, a)| (b - a) / 60.0 / (ELLIPSES - 1) as f64);
        let sizes = || rings.iter().map(|(_, e)| e.major_m);
        let about = match rings.len() {
            0 => String::new(),
            _ => format!(
                " The ellipses show the 3σ region of the estimate at intervals of {} min{}. Their semi-major axes are \
                 {} to {} m.",
                number(every),
                if times > 1.0 { format!(", enlarged {times} times") } else { String::new() },
                number(sizes().reduce(f64::min)),
                number(sizes().reduce(f64::max)),
            ),
        };
        html! {
            figure {
                h4 { "Tracks" @if self.picture.is_some() { " on the anomaly map" } }
                (legend(line_tracks, (!rings.is_empty()).then_some(times)))
                (self.drawn(&canvas, line_tracks, "Tracks on the map", under, over))
                @if let Some(picture) = &self.picture { (colour_bar(&picture.raster)) }
                figcaption { (what) (about) " The dot marks the start, the square marks the end, and the frame marks \
                    the enlarged part." }
            }
        }
    }

    fn close(&self, line_tracks: &LineTracks, k: usize, zoom: &Bounds) -> Markup {
        let canvas = Canvas::new(*zoom);
        let rings = ellipses(line_tracks, &in_sight(&canvas, line_tracks, k));
        let of = if line_tracks.truth.is_some() { "from the truth" } else { "from the estimate" };
        let minute =
            (line_tracks.tt.get(k).copied().unwrap_or(0.0) - line_tracks.tt.first().copied().unwrap_or(0.0)) / 60.0;
        let mut caption = format!(
            "The largest distance of the INS {of} is {} m, at {minute:.1} min.",
            number(separation(line_tracks, k))
        );
        if let (Some(error), true) = (own_error(line_tracks, k), line_tracks.ins.is_some()) {
            caption.push_str(&format!(" The error of the estimate there is {} m.", number(Some(error))));
        }
        if let Some((_, e)) = rings.iter().find(|(i, _)| *i == k) {
            caption.push_str(&format!(
                " The ellipses are the 3σ region of the filter. At that time, it is {} m by {} m, with the longer \
                 axis at an azimuth of {:.0}°.",
                number(Some(e.major_m)),
                number(Some(e.minor_m)),
                e.azimuth_deg,
            ));
        }
        html! {
            figure {
                h4 { "Enlarged: the largest error of the INS" }
                (legend(line_tracks, (!rings.is_empty()).then_some(1.0)))
                (self.drawn(&canvas, line_tracks, "Tracks near the largest error of the \
                                             INS", html! {}, outlines(&canvas, line_tracks, &rings, 1.0)))
                figcaption { (caption) }
            }
        }
    }

    /// Detail view of the largest ellipse, with a separate scale.
    fn near(&self, line_tracks: &LineTracks, (k, widest): (usize, Ellipse)) -> Markup {
        let canvas =
            Canvas::new(square(line_tracks.estimate.at(k).unwrap_or_default(), (4.0 * widest.major_m).max(50.0)));
        let rings = ellipses(line_tracks, &in_sight(&canvas, line_tracks, k));
        let minute =
            (line_tracks.tt.get(k).copied().unwrap_or(0.0) - line_tracks.tt.first().copied().unwrap_or(0.0)) / 60.0;
        let error =
            own_error(line_tracks, k).map(|e| format!(" The error of the estimate there is {} m.", number(Some(e))));
        html! {
            figure {
                h4 { "Enlarged: largest error ellipse" }
                (legend(line_tracks, Some(1.0)))
                (self.drawn(&canvas, line_tracks, "Tracks near the largest error \
                                             ellipse", html! {}, outlines(&canvas, line_tracks, &rings, 1.0)))
                figcaption {
                    "The largest 3σ ellipse of the line, " (number(Some(widest.major_m))) " m by "
                    (number(Some(widest.minor_m)))
                    " m, at " (format!("{minute:.1}")) " min, with the neighbouring ellipses. The ellipses are drawn \
                        to scale." (error.unwrap_or_default())
                }
            }
        }
    }

    fn drawn(&self, canvas: &Canvas, line_tracks: &LineTracks, label: &str, under: Markup, over: Markup) -> Markup {
        let tracks = [line_tracks.ins.as_ref(), line_tracks.truth.as_ref(), Some(&line_tracks.estimate)];
        let spots: Vec<(f64, f64)> =
            tracks.into_iter().flatten().flat_map(DegreeTrack::places).filter_map(|p| canvas.spot(p)).collect();
        canvas.framed(
            label,
            html! {
                @if let Some(picture) = &self.picture { (placed(canvas, picture)) }
                (under)
                @if let Some(ins) = &line_tracks.ins { (line(canvas, ins, "ins")) }
                @if let Some(truth) = &line_tracks.truth { (line(canvas, truth, "truth")) }
                @let class = if line_tracks.truth.is_some() { "estimate over" } else { "estimate" };
                (line(canvas, &line_tracks.estimate, class))
                (ends(canvas, line_tracks.truth.as_ref().or(line_tracks.ins.as_ref()).unwrap_or(&line_tracks.estimate)))
                (over)
                (canvas.furniture(&spots))
            },
        )
    }
}

/// Whether the detail view has a visible ellipse that is about as large as `widest`, the largest ellipse of the line.
fn is_seen(line_tracks: &LineTracks, close: Option<(usize, &Bounds)>, widest: &Ellipse) -> bool {
    let Some((k, zoom)) = close else { return false };
    let there = line_tracks.ellipse(k, SIGMAS).map_or(0.0, |e| e.major_m);
    there >= SMALLEST_PX * Canvas::new(*zoom).metres_per_px() && there >= 0.6 * widest.major_m
}

/// The largest ellipse of a line, and the row of the ellipse.
fn widest(line_tracks: &LineTracks) -> Option<(usize, Ellipse)> {
    let there = (0..line_tracks.tt.len()).filter(|k| line_tracks.estimate.at(*k).is_some());
    let all = there.filter_map(|k| line_tracks.ellipse(k, SIGMAS).map(|e| (k, e)));
    all.max_by(|a, b| a.1.major_m.total_cmp(&b.1.major_m).then(b.0.cmp(&a.0)))
}

fn placed(canvas: &Canvas, AtlasImage { id, raster }: &AtlasImage) -> Markup {
    let b = &raster.bounds;
    let (x, y) = (canvas.x(b.lon.0), canvas.y(b.lat.1));
    let wide = (b.lon.1 - b.lon.0) * canvas.per_degree_east();
    let (sx, sy) = (wide / raster.size.0 as f64, (canvas.y(b.lat.0) - y) / raster.size.1 as f64);
    html! { use href=(format!("#{id}")) transform=(format!("translate({x:.2} {y:.2}) scale({sx:.5} {sy:.5})")) {} }
}

fn line(canvas: &Canvas, track: &DegreeTrack, class: &str) -> Markup {
    // Positions that coincide on the picture are drawn once.
    let spots: Vec<Option<(f64, f64)>> = track.places().map(|p| canvas.spot(p)).collect();
    let inside = spots.iter().flatten().count();
    let d = if inside > MOST {
        path(thinned(&spots, MOST * spots.len() / inside).into_iter())
    } else {
        path(spots.into_iter())
    };
    // The estimate is drawn over the true track, which is wider, so that both are visible.
    html! {
        @if !class.ends_with("over") { path.halo d=(&d) {} }
        path class=(format!("track {class}")) d=(d) {}
    }
}

fn ends(canvas: &Canvas, track: &DegreeTrack) -> Markup {
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
    html! {
        rect.halo x=(x) y=(y) width=(px(w2)) height=(px(h2)) {}
        rect.window x=(x) y=(y) width=(px(w2)) height=(px(h2)) {}
    }
}

/// At most `most` values of `range`, evenly spaced, with both ends.
pub fn spaced(range: std::ops::Range<usize>, most: usize) -> Vec<usize> {
    let last = range.len().saturating_sub(1);
    let mut all: Vec<usize> =
        (0..most).map(|k| range.start + k * last / (most - 1)).filter(|k| range.contains(k)).collect();
    all.dedup();
    all
}

/// Row `k`, and some other rows whose estimated position is in the picture.
fn in_sight(canvas: &Canvas, line_tracks: &LineTracks, k: usize) -> Vec<usize> {
    let on_it = |i: &usize| line_tracks.estimate.at(*i).is_some_and(|p| canvas.holds(p));
    let inside: Vec<usize> = (0..line_tracks.tt.len()).filter(on_it).collect();
    let mut rows: Vec<usize> = spaced(0..inside.len(), CLOSE).into_iter().map(|i| inside[i]).chain([k]).collect();
    rows.sort_unstable();
    rows.dedup();
    rows
}

/// The ellipses of the estimate at `rows`.
fn ellipses(line_tracks: &LineTracks, rows: &[usize]) -> Vec<(usize, Ellipse)> {
    rows.iter().filter_map(|k| Some((*k, line_tracks.ellipse(*k, SIGMAS)?))).collect()
}

/// Enlargement that makes the ellipses visible: 1, 2, 5, 10 and so on.
fn enlargement(canvas: &Canvas, rings: &[(usize, Ellipse)]) -> f64 {
    let largest = rings.iter().map(|(_, e)| e.major_m).fold(0.0, f64::max) / canvas.metres_per_px();
    if largest >= SMALLEST_PX || largest <= 0.0 { 1.0 } else { round_below(ENLARGED_PX / largest) }
}

/// Ellipses, enlarged by the factor `times`.
fn outlines(canvas: &Canvas, line_tracks: &LineTracks, rings: &[(usize, Ellipse)], times: f64) -> Markup {
    let metres = canvas.metres_per_px() / times;
    let places = rings.iter().filter_map(|(k, e)| Some((canvas.spot(line_tracks.estimate.at(*k)?)?, e)));
    html! { @for ((x, y), e) in places {
        // North is up, and a positive turn is clockwise.
        ellipse.region rx=(px(e.minor_m / metres)) ry=(px(e.major_m / metres))
        transform=(format!("translate({} {}) rotate({})", px(x), px(y), px(e.azimuth_deg))) {}
    } }
}

/// Legend of the map. `ellipses` is the enlargement of the ellipses; `None` without ellipses.
fn legend(line_tracks: &LineTracks, ellipses: Option<f64>) -> Markup {
    html! {
        p.legend {
            @if line_tracks.truth.is_some() { span { i class="key truth" {} "true" } }
            @if line_tracks.ins.is_some() { span { i class="key ins" {} "INS alone" } }
            span { i class="key estimate" {} "estimate" }
            @if let Some(times) = ellipses {
                span { i class="key region" {} "3σ of the estimate" @if times > 1.0 { ", × " (times) } }
            }
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
            text.name x=(px(left + 0.5 * wide)) y="43" text-anchor="middle" {
                "percentiles 0, 20 … 100 of the anomaly over the area, nT"
            }
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

    fn example_tracks() -> LineTracks {
        let track = |shift: f64| DegreeTrack {
            lat: (0..100).map(|k| -22.0 + f64::from(k) * 1e-3).collect(),
            lon: (0..100).map(|k| 140.0 + shift * f64::from(k)).collect(),
        };
        let sigma = Some([vec![10.0; 100], vec![10.0; 100], vec![0.0; 100]]);
        let tt = (0..100).map(f64::from).collect();
        LineTracks {
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
    fn unit_the_detail_view_is_at_the_largest_ins_error() {
        let line_tracks = example_tracks();
        assert_eq!(worst_place(&line_tracks), Some(99));
        // 0.00099 degrees of longitude at 22 degrees south.
        assert!((separation(&line_tracks, 99).unwrap() - 102.2).abs() < 0.5);
        let zoom = zoom_bounds(&line_tracks, 99);
        assert!(zoom.lat.0 < -21.901 && zoom.lat.1 > -21.901);
    }

    #[test]
    fn unit_ellipses_are_three_sigma_and_turned_clockwise() {
        let mut line_tracks = example_tracks();
        // Towards the north-east: 30 m in each direction, with a correlation of 0.5.
        line_tracks.sigma = Some([vec![30.0; 100], vec![30.0; 100], vec![450.0; 100]]);
        let canvas = Canvas::new(zoom_bounds(&line_tracks, 99));
        let drawn = outlines(&canvas, &line_tracks, &ellipses(&line_tracks, &[99]), 1.0).into_string();
        let number = |name: &str| -> f64 {
            drawn.split(&format!(" {name}=\"")).nth(1).and_then(|d| d.split('"').next()).unwrap().parse().unwrap()
        };
        let metres = canvas.metres_per_px();
        // Lengths are written to a tenth.
        assert!((number("ry") - 3.0 * 1350f64.sqrt() / metres).abs() < 0.06, "{drawn}");
        assert!((number("rx") - 3.0 * 450f64.sqrt() / metres).abs() < 0.06, "{drawn}");
        let (x, y) = canvas.spot(line_tracks.estimate.at(99).unwrap()).unwrap();
        assert!(drawn.contains(&format!("translate({} {}) rotate(45)", px(x), px(y))), "{drawn}");
        line_tracks.sigma = None;
        assert!(ellipses(&line_tracks, &[99]).is_empty());
    }

    #[test]
    fn unit_small_ellipses_are_enlarged_with_a_note() {
        let mut line_tracks = example_tracks();
        // The largest ellipse is at row 40. Its size is 30 m, less than a pixel on 12 km of track.
        line_tracks.sigma.as_mut().unwrap()[0][40] = 10.5;
        assert_eq!(widest(&line_tracks).map(|(k, e)| (k, e.major_m)), Some((40, 31.5)));
        let atlas = Atlas { bounds: around(std::slice::from_ref(&line_tracks.estimate)).unwrap(), picture: None };
        let canvas = Canvas::new(atlas.bounds);
        let rings = ellipses(&line_tracks, &[0, 40, 99]);
        let (times, px) = (enlargement(&canvas, &rings), 31.5 / canvas.metres_per_px());
        assert!([10.0, 20.0, 50.0].contains(&times) && (6.0..=18.0).contains(&(times * px)), "{times} {px}");
        let whole = atlas.whole(&line_tracks, None).into_string();
        assert!(whole.contains(&format!("3σ of the estimate, × {times}")), "{whole}");
        let near = Canvas::new(square(line_tracks.estimate.at(40).unwrap(), 126.0));
        assert_eq!(enlargement(&near, &rings), 1.0);
        // The detail view has one visible ellipse of 30 m; a larger ellipse elsewhere is shown separately.
        assert_eq!(atlas.plots(&line_tracks).into_string().matches("<figure>").count(), 2);
        line_tracks.sigma.as_mut().unwrap()[0][40] = 21.0;
        assert!(atlas.plots(&line_tracks).into_string().contains("63.00 m by 30.00 m"));
    }

    #[test]
    fn unit_ellipses_are_spread_over_the_line() {
        assert_eq!(spaced(0..101, 5), [0, 25, 50, 75, 100]);
        assert_eq!(spaced(0..3, 16), [0, 1, 2]);
        assert_eq!((spaced(0..0, 16), spaced(0..1, 16)), (vec![], vec![0]));
    }

    #[test]
    fn unit_groups_over_one_map_have_one_picture() {
        let bounds = |west: f64| Bounds { lat: (0.0, 1.0), lon: (west, west + 1.0) };
        assert_eq!(together(bounds(179.5), bounds(-179.0)).lon, (179.5, 182.0));
        assert_eq!(together(bounds(10.0), bounds(12.0)).lon, (10.0, 13.0));
    }

    #[test]
    fn unit_tracks_across_the_date_line_stay_together() {
        let track = DegreeTrack { lat: vec![0.0, 0.0], lon: vec![179.9, -179.9] };
        let b = around(&[track]).unwrap();
        assert!(b.lon.1 - b.lon.0 < 0.3, "{b:?}");
        let canvas = Canvas::new(b);
        assert!(canvas.x(-179.9) > canvas.x(179.9));
        assert!(around(&[]).is_none());
    }
}

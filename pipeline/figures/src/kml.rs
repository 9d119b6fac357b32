//! Map and tracks for Google Earth.

use std::io::{Cursor, Write};

use maud::{Markup, html};
use schemas::Fault;
use zip::{CompressionMethod, DateTime, ZipWriter, write::SimpleFileOptions};

use super::{
    AxisQuantity, MapPicture, MapStyle,
    bar::ColourBar,
    check, check_lengths,
    colours::{ColouredMap, colour_scale, shrink},
    earth::{GlobePatch, TrackFix, instant, parts, patches, thinned},
    pixels,
    scale::ColourScale,
    scene::{FigureScene, Ink, Rect, SceneMark},
    sheet::MapWindow,
    svg::{XML, clean},
    thin::runs,
    track_colour,
};
use crate::png_file::{PixelFormat, encode};

/// Track for Google Earth. NaN in any column interrupts the track.
#[derive(Clone, Copy, Debug)]
pub struct EarthTrack<'a> {
    /// Name.
    pub name: &'a str,
    /// Latitudes, in degrees.
    pub lat_deg: &'a [f64],
    /// Longitudes, in degrees; they may be off by full turns.
    pub lon_deg: &'a [f64],
    /// Heights, in metres. KML interprets them as above mean sea level; heights above the ellipsoid are off by the
    /// geoid's height.
    pub alt_m: &'a [f64],
    /// Times, s since 1970 UTC, if the date is known: the track can then be played.
    pub time_unix_s: Option<&'a [f64]>,
    /// Colour; `None` for the next colour of a fixed order.
    pub colour: Option<[u8; 3]>,
}

/// KML document, and the pictures that it refers to.
#[derive(Clone, Debug, PartialEq)]
pub struct Kml {
    /// The document.
    pub document: String,
    /// Name and bytes of each picture; the files belong in the folder of the document.
    pub files: Vec<(String, Vec<u8>)>,
}

impl Kml {
    /// Document and pictures in one file.
    ///
    /// # Errors
    /// Fails if the files do not fit into a zip file.
    pub fn kmz(&self) -> Result<Vec<u8>, Fault> {
        let zipped = || {
            let mut zip = ZipWriter::new(Cursor::new(vec![]));
            // Files do not depend on the clock: all are dated 1 January 1980.
            let stored = SimpleFileOptions::default()
                .compression_method(CompressionMethod::Stored)
                .last_modified_time(DateTime::default());
            let document = ("doc.kml", self.document.as_bytes());
            let files = self.files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice()));
            for (name, bytes) in std::iter::once(document).chain(files) {
                zip.start_file(name, stored)?;
                zip.write_all(bytes)?;
            }
            zip.finish()
        };
        let made: zip::result::ZipResult<Cursor<Vec<u8>>> = zipped();
        made.map(Cursor::into_inner).map_err(|e| Fault::machine(format!("cannot write the kmz: {e}")))
    }
}

/// Maximum number of pixels per side of an overlay: the limit of common viewers.
const MOST_PIXELS: f64 = 4096.0;
/// Tolerance of a thinned track, in metres.
const TOLERANCE_M: f64 = 1.0;

/// Map as a ground overlay, its colour bar on the screen, and the tracks at their heights. The pictures are named
/// `<stem>_map.png` (`_map_1`, `_map_2` if the map crosses the date line) and `<stem>_bar.png`.
///
/// # Errors
/// Fails if the map is not geographic or has nothing to draw, or columns of a track have different lengths.
pub fn kml(picture: &MapPicture, look: &MapStyle, tracks: &[EarthTrack], stem: &str) -> Result<Kml, Fault> {
    let mut files = vec![];
    let mut features = map(picture, look, look.colour_bar, stem, &mut files)?;
    for (k, track) in tracks.iter().enumerate() {
        features.push(placemark(track, k)?);
    }
    Ok(Kml { document: document(picture.title, &features), files })
}

/// Map as a ground overlay, with its colour bar on the screen if `with_bar`.
pub(super) fn map(
    picture: &MapPicture,
    look: &MapStyle,
    with_bar: bool,
    stem: &str,
    files: &mut Vec<(String, Vec<u8>)>,
) -> Result<Vec<Markup>, Fault> {
    check(picture, look)?;
    if picture.plane != AxisQuantity::Degrees {
        return Err(Fault::new("Google Earth needs a map in latitude and longitude, but this map is in metres")
            .help("give the map with its coordinate system, or plot it as PNG or SVG"));
    }
    let scale = colour_scale(picture, look)?;
    let mut features = overlays(picture, look, &scale, stem, files)?;
    if with_bar {
        let name = format!("{stem}_bar.png");
        files.push((name.clone(), bar(picture, &scale)?));
        features.push(on_screen(&name));
    }
    Ok(features)
}

/// Document of `features`.
pub(super) fn document(title: &str, features: &[Markup]) -> String {
    let document = html! {
        kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2" {
            Document {
                name { (clean(title)) }
                @for feature in features { "\n" (feature) }
                "\n"
            }
        }
    };
    format!("{XML}{}\n", document.into_string())
}

fn overlays(
    picture: &MapPicture,
    look: &MapStyle,
    scale: &ColourScale,
    stem: &str,
    files: &mut Vec<(String, Vec<u8>)>,
) -> Result<Vec<Markup>, Fault> {
    let whole = MapWindow::from_picture(picture);
    let shape = shrink(picture) * (whole.x.1 - whole.x.0) / (whole.y.1 - whole.y.0);
    let wide = (look.width_px as f64).min(MOST_PIXELS).min(MOST_PIXELS * shape).max(1.0);
    let dense = (wide / (whole.x.1 - whole.x.0), wide / shape / (whole.y.1 - whole.y.0));
    let size = |w: &MapWindow| {
        let pixels = |ends: (f64, f64), dense: f64| ((ends.1 - ends.0) * dense).round().max(1.0) as usize;
        (pixels(w.x, dense.0), pixels(w.y, dense.1))
    };
    let coloured = ColouredMap::new(picture, look, scale, size(&whole));
    let parts = patches(&whole);
    let mut out = vec![];
    for (k, patch) in parts.iter().enumerate() {
        let number = if parts.len() > 1 { format!("_{}", k + 1) } else { String::new() };
        let name = format!("{stem}_map{number}.png");
        let size = size(&patch.window);
        files.push((name.clone(), encode(&PixelFormat::Rgba, size, &coloured.pixels(&patch.window, size))?));
        out.push(overlay(patch, &name, &bar_name(picture)));
    }
    Ok(out)
}

fn bar_name(picture: &MapPicture) -> String {
    let what = if picture.quantity.trim().is_empty() { "map" } else { picture.quantity };
    clean(what)
}

fn overlay(patch: &GlobePatch, file: &str, name: &str) -> Markup {
    let (south, north) = patch.window.y;
    html! {
        GroundOverlay {
            name { (name) }
            color { "e6ffffff" }
            Icon { href { (file) } }
            LatLonBox {
                north { (degrees(north)) } south { (degrees(south)) }
                east { (degrees(patch.lon.1)) } west { (degrees(patch.lon.0)) }
            }
        }
    }
}

fn on_screen(file: &str) -> Markup {
    html! {
        ScreenOverlay {
            name { "colours" }
            Icon { href { (file) } }
            overlayXY x="0" y="0" xunits="fraction" yunits="fraction" {}
            screenXY x="0.02" y="0.06" xunits="fraction" yunits="fraction" {}
            size x="0" y="0" xunits="pixels" yunits="pixels" {}
        }
    }
}

/// Colour bar on a partly transparent plate.
fn bar(picture: &MapPicture, scale: &ColourScale) -> Result<Vec<u8>, Fault> {
    const PAD: f64 = 10.0;
    let unit = picture.unit.trim();
    let name = if unit.is_empty() { picture.quantity.trim() } else { unit };
    let bar = ColourBar { scale, name: name.to_owned(), upward: true };
    let place = Rect { x: PAD, y: PAD, w: bar.breadth(), h: 260.0 };
    let plate = place.grown(PAD);
    let mut marks = vec![SceneMark::Fill { points: plate.corners(), ink: Ink { rgb: [255; 3], opacity: 0.85 } }];
    marks.extend(bar.marks(&place));
    pixels::png(&FigureScene {
        name: String::new(),
        width: plate.w.ceil(),
        height: plate.h,
        scale: 1.0,
        paper: false,
        marks,
    })
}

pub(super) fn placemark(track: &EarthTrack, index: usize) -> Result<Markup, Fault> {
    let n = track.lat_deg.len();
    check_lengths(track.name, &[n, track.lon_deg.len(), track.alt_m.len(), track.time_unix_s.map_or(n, <[f64]>::len)])?;
    let [r, g, b] = track_colour(track.colour, index);
    let runs: Vec<Vec<TrackFix>> = runs((0..n).map(|k| fix(track, k)))
        .into_iter()
        .flat_map(|run| parts(&run))
        .map(|part| thinned(&part, TOLERANCE_M))
        .filter(|part| part.len() > 1)
        .collect();
    Ok(html! {
        Placemark {
            name { (clean(track.name)) }
            Style {
                IconStyle { scale { "0" } }
                LineStyle { color { (format!("ff{b:02x}{g:02x}{r:02x}")) } width { "2.5" } }
            }
            @if track.time_unix_s.is_some() {
                gx:MultiTrack {
                    altitudeMode { "absolute" }
                    gx:interpolate { "0" }
                    @for run in &runs { (timed(run)) }
                }
            } @else {
                MultiGeometry { @for run in &runs { (line(run)) } }
            }
        }
    })
}

/// Sample; `None` if the point interrupts the track.
fn fix(track: &EarthTrack, k: usize) -> Option<TrackFix> {
    let at = |column: &[f64]| column.get(k).copied().filter(|v| v.is_finite());
    let time_s = match track.time_unix_s {
        Some(times) => Some(at(times)?),
        None => None,
    };
    Some(TrackFix { lat: at(track.lat_deg)?, lon: at(track.lon_deg)?, alt: at(track.alt_m)?, time_s })
}

fn line(run: &[TrackFix]) -> Markup {
    let places = run.iter().map(|f| format!("{},{},{}", degrees(f.lon), degrees(f.lat), metres(f.alt)));
    let places: Vec<String> = places.collect();
    html! { LineString { altitudeMode { "absolute" } coordinates { (places.join(" ")) } } }
}

fn timed(run: &[TrackFix]) -> Markup {
    html! {
        gx:Track {
            altitudeMode { "absolute" }
            @for fix in run { when { (fix.time_s.map(instant).unwrap_or_default()) } }
            @for fix in run { gx:coord { (format!("{} {} {}", degrees(fix.lon), degrees(fix.lat), metres(fix.alt))) } }
        }
    }
}

/// Degrees with a resolution of a centimetre.
pub(super) fn degrees(value: f64) -> String {
    trimmed(format!("{value:.7}"))
}

pub(super) fn metres(value: f64) -> String {
    trimmed(format!("{value:.2}"))
}

fn trimmed(text: String) -> String {
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

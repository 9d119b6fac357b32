//! Drawing: an anomaly map as a figure (PNG or SVG) and for Google Earth (KML or KMZ), a flight and its parts, and the
//! charts of a report. The crate is independent of plans and stores.
//!
//! A figure is laid out once, as marks on a sheet of paper. Two painters draw the marks, one painter in pixels, the
//! other as SVG. A picture does not depend on a clock, a font of the system or the number of threads.

mod bar;
pub mod canvas;
pub mod chart;
mod colours;
mod contours;
mod curve;
pub mod decimate;
mod earth;
pub mod ellipse;
mod figure;
mod flight;
mod folders;
mod footer;
mod frame;
mod glyphs;
mod kml;
pub mod palette;
mod pixels;
pub mod png_file;
pub mod raster;
mod relief;
mod scale;
mod scene;
mod sheet;
mod svg;
mod thin;
pub mod ticks;
mod tracks;

use numerics::maps::plane_grid::EvenAxis;
use schemas::Fault;

pub use curve::{CurveLabels, curve_svg};
pub use flight::{FlightPart, FlightPicture, TimePanel, flight_png, flight_svg};
pub use folders::{EarthArea, EarthFolder, folders_kml};
pub use kml::{EarthTrack, Kml, kml};
pub use palette::Palette;
pub use relief::HillShading;
pub use scale::ColourMapping;

/// Quantity of the axes of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisQuantity {
    /// Longitude and latitude, in degrees.
    Degrees,
    /// Easting and northing, in metres.
    Metres,
}

/// Map to draw.
#[derive(Clone, Copy, Debug)]
pub struct MapPicture<'a> {
    /// Longitudes or eastings of the columns. A map over the date line continues past 180 degrees.
    pub x: EvenAxis,
    /// Latitudes or northings of the rows.
    pub y: EvenAxis,
    /// Values by rows, the southernmost row first, each from west to east; NaN if unknown.
    pub values: &'a [f64],
    /// The quantity of the axes.
    pub plane: AxisQuantity,
    /// Title; long titles are broken into lines.
    pub title: &'a str,
    /// Quantity, such as `Magnetic anomaly`: the label of the colour bar before the unit.
    pub quantity: &'a str,
    /// Unit of the values, such as `nT`.
    pub unit: &'a str,
    /// Label of the horizontal axis; `None` for longitudes (shown by the ticks) and `Easting (km)`.
    pub x_label: Option<&'a str>,
    /// Label of the vertical axis; `None` for latitudes (shown by the ticks) and `Northing (km)`.
    pub y_label: Option<&'a str>,
}

/// Style of a drawn map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapStyle {
    /// Width of the picture in pixels, 200 to 10,000. Above 800 pixels, the size of the letters grows with the width.
    pub width_px: usize,
    /// Colours.
    pub palette: Palette,
    /// The mapping of values to colours.
    pub scale: ColourMapping,
    /// Hill-shading; `None` for flat colours.
    pub shade: Option<HillShading>,
    /// Interval of contour lines, in the map's unit; `None` for no contours.
    pub contours: Option<f64>,
    /// Whether there is a colour bar.
    pub colour_bar: bool,
    /// Whether there is a scale bar.
    pub scale_bar: bool,
    /// Whether there is a north arrow.
    pub north: bool,
    /// Whether cells larger than a pixel are interpolated bilinearly; otherwise each has one colour.
    pub blend: bool,
}

impl Default for MapStyle {
    fn default() -> Self {
        Self {
            width_px: 1600,
            palette: Palette::Turbo,
            scale: ColourMapping::Equalised,
            shade: Some(HillShading::default()),
            contours: None,
            colour_bar: true,
            scale_bar: true,
            north: true,
            blend: true,
        }
    }
}

/// Flown line over the map, in the map's coordinates. NaN breaks it.
#[derive(Clone, Copy, Debug)]
pub struct TrackLine<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// Longitudes or eastings; a longitude may be a full turn away from the map's.
    pub x: &'a [f64],
    /// Latitudes or northings, one per x.
    pub y: &'a [f64],
    /// Colour; `None` for the next colour of a fixed order.
    pub colour: Option<[u8; 3]>,
}

/// Default colours of tracks: distinguishable without red-green vision, and on every palette, since each line has a
/// white rim.
const TRACK_COLOURS: [[u8; 3]; 6] =
    [[0, 0, 0], [214, 39, 160], [0, 114, 110], [110, 60, 230], [168, 84, 0], [0, 140, 210]];

fn track_colour(given: Option<[u8; 3]>, index: usize) -> [u8; 3] {
    given.unwrap_or(TRACK_COLOURS[index % TRACK_COLOURS.len()])
}

/// Map as a PNG file.
///
/// # Errors
/// Fails if the map has no known value, the sizes of its parts disagree, or `look` cannot be satisfied.
pub fn png(picture: &MapPicture, look: &MapStyle, tracks: &[TrackLine]) -> Result<Vec<u8>, Fault> {
    let scene = figure::scene(picture, look, tracks)?;
    pixels::png(&scene)
}

/// Map as an SVG file: real text and lines, the colours as an embedded picture.
///
/// # Errors
/// Returns the errors of [`png()`].
pub fn svg(picture: &MapPicture, look: &MapStyle, tracks: &[TrackLine]) -> Result<String, Fault> {
    let scene = figure::scene(picture, look, tracks)?;
    svg::document(&scene)
}

/// Checks that a picture and its tracks can be drawn.
fn check(picture: &MapPicture, look: &MapStyle) -> Result<(), Fault> {
    let (x, y) = (&picture.x, &picture.y);
    for (axis, name) in [(x, "columns"), (y, "rows")] {
        let (from, to) = (axis.at(-0.5), axis.at(axis.len as f64 - 0.5));
        if !(axis.step > 0.0 && axis.len > 0 && from < to && (to - from).is_finite()) {
            return Err(Fault::data(format!("the {name} of the map do not form an evenly spaced, ascending axis")));
        }
    }
    if x.len.checked_mul(y.len) != Some(picture.values.len()) {
        let (n, rows, columns) = (picture.values.len(), y.len, x.len);
        return Err(Fault::data(format!("the map has {n} values for {rows} rows of {columns} columns")));
    }
    if !picture.values.iter().any(|v| v.is_finite()) {
        return Err(Fault::data("the map has no known value and cannot be drawn"));
    }
    if !(200..=10_000).contains(&look.width_px) {
        return Err(Fault::new(format!("a picture {} pixels wide cannot be drawn", look.width_px))
            .help("give a width of 200 to 10000 pixels"));
    }
    let lit = |s: HillShading| {
        s.azimuth_deg.is_finite()
            && s.elevation_deg > 0.0
            && s.elevation_deg <= 90.0
            && (0.0..=1.0).contains(&s.strength)
    };
    match look.shade.filter(|s| !lit(*s)) {
        Some(HillShading { azimuth_deg, elevation_deg, strength }) => {
            let light = format!("azimuth {azimuth_deg}, elevation {elevation_deg}, strength {strength}");
            Err(Fault::new(format!("hill-shading with {light} cannot be drawn"))
                .help("give an elevation above 0 up to 90 degrees and a strength of 0 to 1"))
        }
        None => Ok(()),
    }
}

fn check_lengths(name: &str, lengths: &[usize]) -> Result<(), Fault> {
    if lengths.windows(2).all(|w| w[0] == w[1]) {
        return Ok(());
    }
    Err(Fault::data(format!("the coordinates of track `{name}` have different lengths: {lengths:?}")))
}

#[cfg(test)]
mod tests;

//! Tracks and areas in folders, over maps, for Google Earth.

use maud::{Markup, html};
use schemas::Fault;

use super::{
    MapPicture, MapStyle, check_lengths,
    kml::{EarthTrack, Kml, degrees, document, map, metres, placemark},
    svg::clean,
};

/// Area at one height, such as the error ellipse of a position.
#[derive(Clone, Debug)]
pub struct EarthArea {
    /// Name.
    pub name: String,
    /// Text shown on a click.
    pub about: String,
    /// Latitudes of the corners, degrees, counterclockwise; the first is not repeated.
    pub lat_deg: Vec<f64>,
    /// Longitudes of the corners, in degrees.
    pub lon_deg: Vec<f64>,
    /// Height, in metres, as in [`EarthTrack`].
    pub alt_m: f64,
    /// Colour.
    pub colour: [u8; 3],
}

/// Tracks, areas and further folders under one name.
#[derive(Clone, Debug, Default)]
pub struct EarthFolder<'a> {
    /// Name.
    pub name: String,
    /// Tracks.
    pub tracks: Vec<EarthTrack<'a>>,
    /// Areas.
    pub areas: Vec<EarthArea>,
    /// Subfolders.
    pub folders: Vec<EarthFolder<'a>>,
}

/// Folders over any number of maps; a single map has its colour bar on the screen. Pictures are named as in
/// [`crate::kml()`]; pictures of several maps are named `<stem>_1_map.png` and so on.
///
/// # Errors
/// Fails if a map is not geographic or has nothing to draw, or columns of a track or an area have different lengths.
pub fn folders_kml(
    title: &str,
    maps: &[MapPicture],
    look: &MapStyle,
    folders: &[EarthFolder],
    stem: &str,
) -> Result<Kml, Fault> {
    let (mut files, mut features) = (vec![], vec![]);
    for (k, picture) in maps.iter().enumerate() {
        let stem = if maps.len() > 1 { format!("{stem}_{}", k + 1) } else { stem.to_owned() };
        features.extend(map(picture, look, look.colour_bar && maps.len() == 1, &stem, &mut files)?);
    }
    for each in folders {
        features.push(folder(each)?);
    }
    Ok(Kml { document: document(title, &features), files })
}

fn folder(it: &EarthFolder) -> Result<Markup, Fault> {
    let mut inside = vec![];
    for (k, track) in it.tracks.iter().enumerate() {
        inside.push(placemark(track, k)?);
    }
    for each in &it.areas {
        inside.push(area(each)?);
    }
    for each in &it.folders {
        inside.push(folder(each)?);
    }
    Ok(html! { Folder { name { (clean(&it.name)) } @for each in &inside { "\n" (each) } "\n" } })
}

fn area(it: &EarthArea) -> Result<Markup, Fault> {
    check_lengths(&it.name, &[it.lat_deg.len(), it.lon_deg.len()])?;
    let [r, g, b] = it.colour;
    let corner = |(lat, lon): (&f64, &f64)| format!("{},{},{}", degrees(*lon), degrees(*lat), metres(it.alt_m));
    let ring: Vec<String> = it.lat_deg.iter().zip(&it.lon_deg).map(corner).collect();
    let ring = ring.iter().chain(ring.first()).map(String::as_str).collect::<Vec<_>>().join(" ");
    Ok(html! {
        Placemark {
            name { (clean(&it.name)) }
            @if !it.about.is_empty() { description { (clean(&it.about)) } }
            Style {
                LineStyle { color { (format!("ff{b:02x}{g:02x}{r:02x}")) } width { "1.5" } }
                PolyStyle { color { (format!("40{b:02x}{g:02x}{r:02x}")) } }
            }
            Polygon {
                altitudeMode { "absolute" }
                outerBoundaryIs { LinearRing { coordinates { (ring) } } }
            }
        }
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::tests::well_formed;

    fn square() -> EarthArea {
        EarthArea {
            name: "1 & 2".into(),
            about: "30 m < 50 m".into(),
            lat_deg: vec![0.0, 0.0, 1.0, 1.0],
            lon_deg: vec![10.0, 11.0, 11.0, 10.0],
            alt_m: 500.0,
            colour: [255, 79, 208],
        }
    }

    #[test]
    fn unit_folders_contain_tracks_areas_and_folders() {
        let track = EarthTrack {
            name: "truth",
            lat_deg: &[0.0, 1.0],
            lon_deg: &[10.0, 11.0],
            alt_m: &[500.0, 510.0],
            time_unix_s: None,
            colour: Some([255; 3]),
        };
        let ellipses = EarthFolder { name: "3σ".into(), areas: vec![square()], ..EarthFolder::default() };
        let line = EarthFolder {
            name: "line 1.02".into(),
            tracks: vec![track],
            folders: vec![ellipses],
            ..EarthFolder::default()
        };
        let made = folders_kml("held", &[], &MapStyle::default(), &[line], "held").unwrap();
        well_formed(&made.document).unwrap();
        assert!(made.files.is_empty() && made.document.matches("<Folder>").count() == 2, "{}", made.document);
        // The ring is closed, and its colour has the order opacity, blue, green, red.
        for part in [
            "<coordinates>10,0,500 11,0,500 11,1,500 10,1,500 10,0,500</coordinates>",
            "<color>40d04fff</color>",
            "<coordinates>10,0,500 11,1,510</coordinates>",
            "<name>1 &amp; 2</name><description>30 m &lt; 50 m</description>",
        ] {
            assert!(made.document.contains(part), "{part}: {}", made.document);
        }
        let broken =
            EarthFolder { areas: vec![EarthArea { lat_deg: vec![0.0], ..square() }], ..EarthFolder::default() };
        assert!(folders_kml("", &[], &MapStyle::default(), &[broken], "a").is_err());
    }
}

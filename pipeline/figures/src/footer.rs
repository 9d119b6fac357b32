//! Legend below the map: scale bar, north arrow, lines and hatching.

use super::{
    scene::{BLACK, Ink, PaperPoint, Rect, SceneMark, TextAnchor, shortened, text_width},
    tracks,
};
use crate::ticks;

/// Letter size.
const SIZE: f64 = 12.0;
/// Height of a row.
pub const ROW: f64 = 21.0;
/// Gap between two entries.
const BETWEEN: f64 = 22.0;
/// Maximum number of tracks listed by name.
const NAMED: usize = 24;

/// Entry of the legend.
#[derive(Clone, Debug, PartialEq)]
pub enum LegendEntry {
    /// Scale bar: length on the paper, and length on the ground in metres.
    Scale(f64, f64),
    /// North arrow.
    North,
    /// Line of a track.
    Track([u8; 3], String),
    /// Number of further tracks.
    More(usize),
    /// Hatching of unknown areas.
    Unknown,
    /// Contour lines, with their description.
    Contours(String),
}

impl LegendEntry {
    /// Scale bar with a round length on the ground, at most `most` long on the paper.
    pub fn scale(metres_per_unit: f64, most: f64) -> LegendEntry {
        let metres = ticks::round_below(most * metres_per_unit);
        LegendEntry::Scale(metres / metres_per_unit, metres)
    }

    /// Entries of the tracks; the first tracks are listed by name.
    pub fn tracks(drawn: &[tracks::TrackDrawing]) -> impl Iterator<Item = LegendEntry> + '_ {
        let named = if drawn.len() > NAMED { NAMED - 1 } else { drawn.len() };
        let more = (drawn.len() > named).then(|| LegendEntry::More(drawn.len() - named));
        drawn.iter().take(named).map(|d| LegendEntry::Track(d.colour, d.name.clone())).chain(more)
    }

    fn text(&self) -> String {
        match self {
            LegendEntry::Scale(_, metres) if *metres >= 1000.0 => format!("{} km", metres / 1000.0),
            LegendEntry::Scale(_, metres) => format!("{metres} m"),
            LegendEntry::North => "N".to_owned(),
            LegendEntry::Track(_, name) | LegendEntry::Contours(name) => name.clone(),
            LegendEntry::More(count) => format!("and {count} more"),
            LegendEntry::Unknown => "no data".to_owned(),
        }
    }

    fn key_width(&self) -> f64 {
        match self {
            LegendEntry::Scale(length, _) => *length,
            LegendEntry::North => 9.0,
            LegendEntry::More(_) => 0.0,
            _ => 26.0,
        }
    }

    /// Width of the symbol before the text.
    fn before_text(&self) -> f64 {
        let key = self.key_width();
        if key > 0.0 { key + 7.0 } else { 0.0 }
    }

    /// Symbol next to the text, in a row with its middle at `y`.
    fn key(&self, (x, y): PaperPoint) -> Vec<SceneMark> {
        let line = |width: f64, ink: Ink| SceneMark::Stroke {
            lines: vec![vec![(x, y), (x + self.key_width(), y)]],
            width,
            ink,
            within: None,
        };
        match self {
            LegendEntry::Scale(length, _) => scale_bar(x, y, *length),
            LegendEntry::North => vec![SceneMark::Fill {
                points: vec![(x + 4.5, y - 8.0), (x + 9.0, y + 7.0), (x + 4.5, y + 3.5), (x, y + 7.0)],
                ink: BLACK,
            }],
            LegendEntry::Track(colour, _) => {
                let start = SceneMark::Disc {
                    at: (x + tracks::START, y),
                    radius: tracks::START,
                    fill: super::scene::WHITE,
                    rim: Ink::full(*colour),
                };
                vec![line(tracks::WIDTH, Ink::full(*colour)), start]
            }
            LegendEntry::More(_) => vec![],
            LegendEntry::Unknown => {
                let swatch = Rect { x, y: y - 6.0, w: self.key_width(), h: 12.0 };
                SceneMark::hatch(swatch).into_iter().chain([SceneMark::frame(&swatch, 0.75)]).collect()
            }
            LegendEntry::Contours(_) => vec![line(0.8, BLACK)],
        }
    }
}

fn scale_bar(x: f64, y: f64, length: f64) -> Vec<SceneMark> {
    let bar = Rect { x, y: y - 3.0, w: length, h: 6.0 };
    let half = Rect { w: 0.5 * length, ..bar };
    vec![SceneMark::Fill { points: half.corners(), ink: BLACK }, SceneMark::frame(&bar, 1.0)]
}

/// Position of the legend.
#[derive(Clone, Copy, Debug)]
pub struct LegendPosition {
    /// Left end of its rows.
    pub left: f64,
    /// Right limit of its rows.
    pub right: f64,
    /// Upper edge.
    pub top: f64,
    /// Centre of its rows, if they are centred.
    pub centre: Option<f64>,
}

/// Entries in rows, and their total height.
pub fn footer(entries: &[LegendEntry], place: &LegendPosition) -> (Vec<SceneMark>, f64) {
    let rows = rows(entries, place.right - place.left);
    let mut out = vec![];
    for (k, (row, width)) in rows.iter().enumerate() {
        let middle = place.top + ROW * (k as f64 + 0.5);
        let centred = |centre: f64| (centre - 0.5 * width).min(place.right - width).max(place.left);
        let from = place.centre.map_or(place.left, centred);
        for (entry, text, at) in row {
            out.extend(entry.key((from + at, middle)));
            let at = from + at + entry.before_text();
            out.push(SceneMark::text((at, middle + 0.36 * SIZE), text.clone(), SIZE, TextAnchor::Start));
        }
    }
    (out, ROW * rows.len() as f64)
}

/// Entries of a row, each with its text and left end; and the width of the row.
type LegendRow<'a> = (Vec<(&'a LegendEntry, String, f64)>, f64);

fn rows(entries: &[LegendEntry], room: f64) -> Vec<LegendRow<'_>> {
    let mut rows: Vec<LegendRow> = vec![];
    for entry in entries {
        let text = shortened(&entry.text(), SIZE, room - entry.before_text());
        let width = entry.before_text() + text_width(&text, SIZE);
        match rows.last_mut().filter(|row| row.1 + BETWEEN + width <= room) {
            Some(row) => {
                let at = row.1 + BETWEEN;
                row.0.push((entry, text, at));
                row.1 = at + width;
            }
            None => rows.push((vec![(entry, text, 0.0)], width)),
        }
    }
    rows
}

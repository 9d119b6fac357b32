//! Tracks on the map.

use numerics::angle::wrap_deg;
use schemas::Fault;

use super::{
    AxisQuantity, TrackLine, check_lengths,
    frame::MapFrame,
    scene::{Ink, PaperPoint, SceneMark, WHITE, clipped},
    thin::{kept, runs, to_stretch},
    track_colour,
};

/// Width of a line.
pub const WIDTH: f64 = 1.8;
/// Total width of the rim on both sides, for contrast with the map.
pub const RIM: f64 = 1.8;
/// Radius of the mark at the start.
pub const START: f64 = 4.2;

/// Track drawn on the map.
pub struct TrackDrawing {
    /// Marks.
    pub marks: Vec<SceneMark>,
    /// Colour.
    pub colour: [u8; 3],
    /// Text in the legend.
    pub name: String,
}

/// Track, thinned to within `tolerance` on the paper and clipped at the frame; its index gives the colour.
///
/// # Errors
/// Fails if its coordinates have different lengths.
pub fn drawn(track: &TrackLine, index: usize, frame: &MapFrame, tolerance: f64) -> Result<TrackDrawing, Fault> {
    check_lengths(track.name, &[track.x.len(), track.y.len()])?;
    let colour = track_colour(track.colour, index);
    let runs = runs(spots(track, frame).into_iter());
    let start = runs.first().and_then(|run| run.first()).copied().filter(|s| frame.rect.holds(*s));
    let near = frame.rect.grown(4.0);
    let lines: Vec<Vec<PaperPoint>> = runs.iter().flat_map(|run| clipped(&thinned(run, tolerance), &near)).collect();
    let name = if lines.is_empty() && start.is_none() {
        format!("{} (off the map)", track.name)
    } else {
        track.name.to_owned()
    };
    let stroke =
        |width: f64, ink: Ink| SceneMark::Stroke { lines: lines.clone(), width, ink, within: Some(frame.rect) };
    let mut marks = vec![];
    if !lines.is_empty() {
        marks.push(stroke(WIDTH + RIM, Ink { opacity: 0.85, ..WHITE }));
        marks.push(stroke(WIDTH, Ink::full(colour)));
    }
    marks.extend(start.map(|at| SceneMark::Disc { at, radius: START, fill: WHITE, rim: Ink::full(colour) }));
    Ok(TrackDrawing { marks, colour, name })
}

/// Positions of a track on the paper. A longitude is shifted by a full turn towards the map; where consecutive shifted
/// longitudes jump to the other side of the earth, the line is broken.
fn spots(track: &TrackLine, frame: &MapFrame) -> Vec<Option<PaperPoint>> {
    let middle = 0.5 * (frame.window.x.0 + frame.window.x.1);
    let mut out = Vec::with_capacity(track.x.len());
    let mut before = f64::NAN;
    for (x, y) in track.x.iter().zip(track.y) {
        let x = if frame.picture.plane == AxisQuantity::Degrees { middle + wrap_deg(x - middle) } else { *x };
        if frame.picture.plane == AxisQuantity::Degrees && (x - before).abs() > 180.0 {
            out.push(None);
        }
        before = x;
        out.push((x.is_finite() && y.is_finite()).then(|| frame.spot(x, *y)));
    }
    out
}

fn thinned(run: &[PaperPoint], tolerance: f64) -> Vec<PaperPoint> {
    let pair = |k: usize| run.get(k).map_or([0.0; 2], |s| [s.0, s.1]);
    let kept = kept(run.len(), tolerance, |a, b, k| to_stretch(&pair(a), &pair(b), &pair(k)));
    kept.into_iter().filter_map(|k| run.get(k).copied()).collect()
}

//! Picture of a flight and its parts: the track over the ground, coloured by kind, and below it quantities over time
//! with the limits of the parts.

use schemas::Fault;

use super::{
    decimate::{MOST, extremes},
    footer::{LegendEntry, LegendPosition, footer},
    frame::{NAME, TICK},
    pixels,
    scene::{BLACK, FigureScene, Ink, PaperPoint, Rect, SceneMark, TextAnchor, WHITE, shortened, text_width, wrapped},
    svg,
    thin::runs,
    ticks,
};

/// Part of a flight with a name.
#[derive(Clone, Debug)]
pub struct FlightPart {
    /// Name.
    pub name: String,
    /// Kind, an index of [`FlightPicture::kinds`].
    pub kind: usize,
    /// First and last time, in the unit of [`FlightPicture::time`].
    pub time: (f64, f64),
}

/// Quantities over time that share an axis.
#[derive(Clone, Debug)]
pub struct TimePanel<'a> {
    /// Quantity and unit.
    pub label: &'a str,
    /// Value of a full turn, such as 360, if the quantity is an angle. A line is broken where its value changes by more
    /// than half a turn from one sample to the next.
    pub turn: Option<f64>,
    /// Name, colour and values of each line, one value per time; NaN breaks a line. A single line needs no name.
    pub lines: Vec<(&'a str, [u8; 3], &'a [f64])>,
}

/// Flight to draw.
#[derive(Clone, Debug)]
pub struct FlightPicture<'a> {
    /// The title.
    pub title: &'a str,
    /// Ascending times of the samples.
    pub time: &'a [f64],
    /// Label of the time axis.
    pub time_label: &'a str,
    /// Position east of a reference point, in metres, one per time; NaN breaks the track. Empty without positions.
    pub east_m: &'a [f64],
    /// Position north of the reference point, in metres, one per time.
    pub north_m: &'a [f64],
    /// Kind of each sample, an index of [`FlightPicture::kinds`].
    pub kind: &'a [usize],
    /// Name and colour of each kind, the last kinds on top.
    pub kinds: &'a [(&'a str, [u8; 3])],
    /// Parts with names, in the order of time.
    pub parts: &'a [FlightPart],
    /// Panels, from top to bottom.
    pub panels: &'a [TimePanel<'a>],
}

/// Width of the paper, and white margin.
const WIDTH: f64 = 800.0;
const PAD: f64 = 14.0;
/// Space to the left of the frames, for coordinates and the name of the axis.
const LEFT: f64 = 78.0;
/// Maximum size of the frame of the track.
const TRACK: (f64, f64) = (680.0, 520.0);
/// Height of a panel, and gap between two panels.
const PANEL: f64 = 104.0;
const BETWEEN: f64 = 12.0;
/// Letter size and line spacing of the title.
const TITLE: (f64, f64) = (16.0, 21.0);
/// Letter size of the names of parts.
const PART: f64 = 11.0;
/// Minimum width of a part whose name is written above the panels.
const NARROW: f64 = 8.0;

/// Picture as a PNG file, `width_px` pixels wide, 200 to 10,000.
///
/// # Errors
/// Fails if there are fewer than two times, lengths differ, or the width is out of range.
pub fn flight_png(picture: &FlightPicture, width_px: usize) -> Result<Vec<u8>, Fault> {
    pixels::png(&scene(picture, width_px)?)
}

/// Picture as an SVG file.
///
/// # Errors
/// Returns the errors of [`flight_png`].
pub fn flight_svg(picture: &FlightPicture) -> Result<String, Fault> {
    svg::document(&scene(picture, WIDTH as usize)?)
}

fn scene(picture: &FlightPicture, width_px: usize) -> Result<FigureScene, Fault> {
    check(picture)?;
    if !(200..=10_000).contains(&width_px) {
        let fault = Fault::new(format!("a picture {width_px} pixels wide cannot be drawn"));
        return Err(fault.help("give a width of 200 to 10000 pixels"));
    }
    let mut marks = vec![];
    let mut top = PAD;
    for line in wrapped(picture.title, TITLE.0, WIDTH - 2.0 * PAD, 3) {
        marks.push(SceneMark::text((0.5 * WIDTH, top + TITLE.0), line, TITLE.0, TextAnchor::Middle));
        top += TITLE.1;
    }
    top += 8.0;
    if let Some((track, bottom)) = track(picture, top) {
        marks.extend(track);
        top = bottom;
    }
    let entries: Vec<LegendEntry> =
        used(picture).map(|(name, colour)| LegendEntry::Track(*colour, (*name).to_owned())).collect();
    let (legend, high) = footer(&entries, &LegendPosition { left: LEFT, right: WIDTH - PAD, top, centre: None });
    marks.extend(legend);
    top += high + BETWEEN;
    let (panels, bottom) = panels(picture, top);
    marks.extend(panels);
    Ok(FigureScene {
        name: picture.title.to_owned(),
        width: WIDTH,
        height: (bottom + PAD).round(),
        scale: width_px as f64 / WIDTH,
        paper: true,
        marks,
    })
}

fn check(picture: &FlightPicture) -> Result<(), Fault> {
    let n = picture.time.len();
    let track = [picture.east_m.len(), picture.north_m.len(), picture.kind.len()];
    let even = picture.east_m.is_empty() && picture.north_m.is_empty() || track == [n; 3];
    let lines = picture.panels.iter().flat_map(|p| &p.lines).all(|(_, _, values)| values.len() == n);
    let kinds = picture.kind.iter().chain(picture.parts.iter().map(|p| &p.kind)).all(|k| *k < picture.kinds.len());
    if !(even && lines && kinds) {
        return Err(Fault::bug("the columns of a flight's picture have different lengths"));
    }
    let ends = picture.time.first().zip(picture.time.last());
    if ends.is_none_or(|(a, b)| !(b > a && (b - a).is_finite())) {
        return Err(Fault::data("a flight with fewer than two samples cannot be drawn"));
    }
    Ok(())
}

/// Kinds that occur.
fn used<'a>(picture: &'a FlightPicture) -> impl Iterator<Item = &'a (&'a str, [u8; 3])> {
    let occurs = |k: usize| picture.kind.contains(&k) || picture.parts.iter().any(|p| p.kind == k);
    picture.kinds.iter().enumerate().filter(move |(k, _)| occurs(*k)).map(|(_, kind)| kind)
}

fn ends(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let both =
        values.filter(|x| x.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    (both.0 <= both.1).then_some(both)
}

/// Range with a margin, never empty.
fn around((low, high): (f64, f64), part: f64, least: f64) -> (f64, f64) {
    let by = (part * (high - low)).max(0.5 * (least - (high - low))).max(0.0);
    (low - by, high + by)
}

/// Track in its frame with coordinates and names, and the lower edge of the frame; `None` without positions.
fn track(picture: &FlightPicture, top: f64) -> Option<(Vec<SceneMark>, f64)> {
    let east = around(ends(picture.east_m.iter().copied())?, 0.04, 10.0);
    let north = around(ends(picture.north_m.iter().copied())?, 0.04, 10.0);
    let scale = (TRACK.0 / (east.1 - east.0)).min(TRACK.1 / (north.1 - north.0));
    // The frame has a minimum size, for a track along a straight line.
    let size = ((scale * (east.1 - east.0)).max(160.0), (scale * (north.1 - north.0)).max(120.0));
    let middle = (0.5 * (east.0 + east.1), 0.5 * (north.0 + north.1));
    let rect = Rect { x: LEFT + 0.5 * (TRACK.0 - size.0), y: top, w: size.0, h: size.1 };
    let spot = |e: f64, n: f64| -> PaperPoint {
        (rect.x + 0.5 * rect.w + scale * (e - middle.0), rect.y + 0.5 * rect.h - scale * (n - middle.1))
    };
    let mut marks = vec![];
    for (k, (_, colour)) in picture.kinds.iter().enumerate() {
        let mut points: Vec<Option<PaperPoint>> = vec![];
        for (row, kind) in picture.kind.iter().enumerate() {
            let (e, n) = (picture.east_m.get(row), picture.north_m.get(row));
            let place = e.zip(n).filter(|(e, n)| e.is_finite() && n.is_finite());
            // The line of a part begins at the sample before it, so that the track has no gap.
            let next = picture.kind.get(row + 1) == Some(&k);
            points.push(place.filter(|_| *kind == k || next).map(|(e, n)| spot(*e, *n)));
        }
        let lines: Vec<Vec<PaperPoint>> =
            runs(points.into_iter()).into_iter().map(|run| spaced(&run)).filter(|l| l.len() > 1).collect();
        if !lines.is_empty() {
            marks.push(SceneMark::Stroke { lines, width: 1.7, ink: Ink::full(*colour), within: Some(rect) });
        }
    }
    let range = |middle: f64, px: f64| (middle - 0.5 * px / scale, middle + 0.5 * px / scale);
    marks.extend(coordinates(&rect, range(middle.0, rect.w), range(middle.1, rect.h)));
    let mut names: Vec<Rect> = vec![];
    for part in picture.parts {
        let from = picture.time.partition_point(|t| *t < part.time.0);
        let to = picture.time.partition_point(|t| *t <= part.time.1);
        let row = from + (to.saturating_sub(from)) / 2;
        let Some((e, n)) =
            picture.east_m.get(row).zip(picture.north_m.get(row)).filter(|(e, n)| e.is_finite() && n.is_finite())
        else {
            continue;
        };
        let (at, width) = (spot(*e, *n), text_width(&part.name, PART));
        let x = (at.0 + 4.0).min(rect.right() - width - 3.0);
        let plate = Rect { x: x - 1.5, y: at.1 - PART - 1.0, w: width + 3.0, h: PART + 4.0 };
        // If there is not enough space for all names, the first names are drawn.
        let covers =
            |o: &Rect| o.x < plate.right() && plate.x < o.right() && o.y < plate.bottom() && plate.y < o.bottom();
        if names.iter().any(covers) {
            continue;
        }
        marks.push(SceneMark::Fill { points: plate.corners(), ink: Ink { opacity: 0.8, ..WHITE } });
        marks.push(SceneMark::text((x, at.1), part.name.clone(), PART, TextAnchor::Start));
        names.push(plate);
    }
    Some((marks, rect.bottom() + TICK + 34.0))
}

/// The points of a line that are at least a fraction of a pixel apart, and always its first and last point.
fn spaced(run: &[PaperPoint]) -> Vec<PaperPoint> {
    const LEAST: f64 = 0.5;
    let mut out: Vec<PaperPoint> = vec![];
    for (i, at) in run.iter().enumerate() {
        let far = out.last().is_none_or(|last| (at.0 - last.0).hypot(at.1 - last.1) >= LEAST);
        if far || i + 1 == run.len() {
            out.push(*at);
        }
    }
    out
}

/// Frame, ticks and names of the two axes of the track; in km if the track is larger than 2 km.
fn coordinates(rect: &Rect, east: (f64, f64), north: (f64, f64)) -> Vec<SceneMark> {
    let km = (east.1 - east.0).max(north.1 - north.0) >= 2000.0;
    let (unit, factor) = if km { ("km", 1000.0) } else { ("m", 1.0) };
    let mut out = vec![SceneMark::frame(rect, 1.0)];
    let mut lines = vec![];
    let most = |length: f64| ((length / 70.0) as usize).clamp(2, 8);
    for tick in ticks::linear(east.0 / factor, east.1 / factor, most(rect.w)) {
        let x = rect.x + (tick.at * factor - east.0) / (east.1 - east.0) * rect.w;
        lines.push(vec![(x, rect.bottom()), (x, rect.bottom() + 5.0)]);
        out.push(SceneMark::text((x, rect.bottom() + 5.0 + TICK), tick.label, TICK, TextAnchor::Middle));
    }
    let mut widest = 0.0_f64;
    for tick in ticks::linear(north.0 / factor, north.1 / factor, most(rect.h)) {
        let y = rect.bottom() - (tick.at * factor - north.0) / (north.1 - north.0) * rect.h;
        lines.push(vec![(rect.x - 5.0, y), (rect.x, y)]);
        widest = widest.max(text_width(&tick.label, TICK));
        out.push(SceneMark::text((rect.x - 9.0, y + 0.36 * TICK), tick.label, TICK, TextAnchor::End));
    }
    out.push(SceneMark::Stroke { lines, width: 1.0, ink: BLACK, within: None });
    let below = (rect.x + 0.5 * rect.w, rect.bottom() + TICK + 22.0);
    out.push(SceneMark::text(below, format!("east ({unit})"), NAME, TextAnchor::Middle));
    out.push(turned(
        (rect.x - 16.0 - widest, rect.y + 0.5 * rect.h),
        &format!("north ({unit})"),
        NAME,
        TextAnchor::Middle,
    ));
    out
}

fn turned(at: PaperPoint, text: &str, size: f64, anchor: TextAnchor) -> SceneMark {
    SceneMark::Text { at, text: text.to_owned(), size, anchor, turned: true }
}

/// Panels below each other, with the parts in their background, and the lower edge of the last panel.
fn panels(picture: &FlightPicture, top: f64) -> (Vec<SceneMark>, f64) {
    let mut marks = vec![];
    let time = (picture.time.first().copied().unwrap_or(0.0), picture.time.last().copied().unwrap_or(1.0));
    let (left, right) = (LEFT, WIDTH - PAD);
    let across = |t: f64| left + (t - time.0) / (time.1 - time.0) * (right - left);
    let colour = |part: &FlightPart| picture.kinds.get(part.kind).map_or(BLACK.rgb, |k| k.1);
    let wide = |part: &FlightPart| across(part.time.1) - across(part.time.0) >= NARROW;
    let highest = picture.parts.iter().filter(|p| wide(p)).map(|p| text_width(&p.name, PART)).fold(0.0, f64::max);
    let mut y = top + highest + 6.0;
    for part in picture.parts.iter().filter(|p| wide(p)) {
        let middle = 0.5 * (across(part.time.0) + across(part.time.1));
        marks.push(turned((middle + 0.36 * PART, y - 4.0), &part.name, PART, TextAnchor::Start));
    }
    let first = y;
    for panel in picture.panels {
        let rect = Rect { x: left, y, w: right - left, h: PANEL };
        for part in picture.parts {
            let (from, to) = (across(part.time.0), across(part.time.1));
            let band = Rect { x: from, y, w: (to - from).max(0.5), h: PANEL };
            marks.push(SceneMark::Fill { points: band.corners(), ink: Ink { rgb: colour(part), opacity: 0.16 } });
            let cuts = [from, to].map(|x| vec![(x, y), (x, y + PANEL)]).to_vec();
            marks.push(SceneMark::Stroke { lines: cuts, width: 0.7, ink: Ink::full(colour(part)), within: Some(rect) });
        }
        marks.extend(curves(panel, picture.time, &rect, &across));
        y += PANEL + BETWEEN;
    }
    let bottom = if y > first { y - BETWEEN } else { y };
    let mut lines = vec![];
    for tick in ticks::linear(time.0, time.1, 8) {
        let x = across(tick.at);
        lines.push(vec![(x, bottom), (x, bottom + 5.0)]);
        marks.push(SceneMark::text((x, bottom + 5.0 + TICK), tick.label, TICK, TextAnchor::Middle));
    }
    marks.push(SceneMark::Stroke { lines, width: 1.0, ink: BLACK, within: None });
    let below = bottom + TICK + 22.0;
    marks.push(SceneMark::text((0.5 * (left + right), below), picture.time_label, NAME, TextAnchor::Middle));
    (marks, below + 4.0)
}

/// Lines of one panel, with its frame, ticks and names.
fn curves(panel: &TimePanel, time: &[f64], rect: &Rect, across: &dyn Fn(f64) -> f64) -> Vec<SceneMark> {
    let mut marks = vec![SceneMark::frame(rect, 1.0)];
    let label = shortened(panel.label, NAME, rect.h + 10.0);
    marks.push(turned((NAME + 6.0, rect.y + 0.5 * rect.h), &label, NAME, TextAnchor::Middle));
    let Some(range) = ends(panel.lines.iter().flat_map(|(_, _, values)| values.iter().copied())) else {
        marks.push(SceneMark::text(
            (rect.x + 0.5 * rect.w, rect.y + 0.5 * rect.h),
            "not known",
            TICK,
            TextAnchor::Middle,
        ));
        return marks;
    };
    let (low, high) = around(range, 0.06, 1e-3);
    let up = |value: f64| rect.bottom() - (value - low) / (high - low) * rect.h;
    let mut small = vec![];
    for tick in ticks::linear(low, high, 4) {
        small.push(vec![(rect.x - 5.0, up(tick.at)), (rect.x, up(tick.at))]);
        marks.push(SceneMark::text((rect.x - 8.0, up(tick.at) + 0.36 * TICK), tick.label, TICK, TextAnchor::End));
    }
    marks.push(SceneMark::Stroke { lines: small, width: 1.0, ink: BLACK, within: None });
    let mut at = rect.right() - 6.0;
    for (name, colour, values) in &panel.lines {
        let mut last = f64::NAN;
        let mut spots = vec![];
        for (t, v) in extremes(time, values, MOST) {
            if panel.turn.is_some_and(|turn| (v - last).abs() > 0.5 * turn) {
                spots.push(None);
            }
            spots.push(v.is_finite().then(|| (across(t), up(v))));
            last = v;
        }
        let lines: Vec<Vec<PaperPoint>> = runs(spots.into_iter()).into_iter().filter(|line| line.len() > 1).collect();
        if !lines.is_empty() {
            marks.push(SceneMark::Stroke { lines, width: 1.1, ink: Ink::full(*colour), within: Some(*rect) });
        }
        if panel.lines.len() > 1 {
            let width = text_width(name, PART);
            let key = vec![vec![(at - width - 20.0, rect.y + 9.0), (at - width - 5.0, rect.y + 9.0)]];
            marks.push(SceneMark::Stroke { lines: key, width: 2.0, ink: Ink::full(*colour), within: None });
            marks.push(SceneMark::text((at, rect.y + 9.0 + 0.36 * PART), *name, PART, TextAnchor::End));
            at -= width + 34.0;
        }
    }
    marks
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn drawn(east: &[f64], kind: &[usize], name: &str) -> Result<String, Fault> {
        let time: Vec<f64> = (0..east.len()).map(|k| 45_000.0 + k as f64).collect();
        let north: Vec<f64> = east.iter().map(|e| 0.5 * e).collect();
        let parts = [FlightPart { name: name.to_owned(), kind: 1, time: (45_100.0, 45_300.0) }];
        let kinds = [("between", [150, 150, 150]), ("line", [0, 90, 200])];
        let panels = [TimePanel { label: "course, deg", turn: None, lines: vec![("", [0, 0, 0], east)] }];
        let picture = FlightPicture {
            title: "A flight",
            time: &time,
            time_label: "tt, s",
            east_m: east,
            north_m: &north,
            kind,
            kinds: &kinds,
            parts: &parts,
            panels: &panels,
        };
        flight_png(&picture, 400)?;
        flight_svg(&picture)
    }

    #[test]
    fn unit_parts_are_labelled_on_track_and_panels() {
        let east: Vec<f64> = (0..500).map(|k| f64::from(k) * 60.0).collect();
        let kind: Vec<usize> = (0..500).map(|k| usize::from((100..=300).contains(&k))).collect();
        let text = drawn(&east, &kind, "line <1>").unwrap();
        assert_eq!(text.matches("line &lt;1&gt;").count(), 2);
        for word in ["east (km)", "course, deg", "45200", "between", "#005ac8"] {
            assert!(text.contains(word), "{word}");
        }
    }

    #[test]
    fn unit_undrawable_input_is_skipped_or_rejected() {
        // Cases: a constant position, then an unknown position.
        assert!(drawn(&[5.0; 400], &[1; 400], "a").is_ok());
        let nowhere = drawn(&[f64::NAN; 400], &[1; 400], "a").unwrap();
        assert!(nowhere.contains("not known") && !nowhere.contains("east ("));
        assert!(drawn(&[5.0], &[1], "a").is_err());
        assert!(drawn(&[5.0; 400], &[7; 400], "a").is_err(), "a kind that there is not");
    }
}

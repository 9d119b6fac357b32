//! Layout of a figure: title, map, colour bar, legend.

use schemas::Fault;

use super::{
    MapPicture, MapStyle, TrackLine,
    bar::ColourBar,
    check,
    colours::{ColouredMap, colour_scale, shrink},
    contours,
    footer::{LegendEntry, LegendPosition, ROW, footer},
    frame::{MapFrame, bottom_margin, left_margin},
    scale::ColourScale,
    scene::{FigureScene, Rect, SceneMark, TextAnchor, text_width, wrapped},
    sheet::MapWindow,
    tracks,
};

/// Maximum width of the paper; more pixels give a finer picture of the same paper.
const WIDEST: f64 = 800.0;
/// White margin.
const PAD: f64 = 14.0;
/// Letter size and line spacing of the title.
const TITLE: (f64, f64) = (16.0, 21.0);
/// Maximum number of lines of a title.
const TITLE_LINES: usize = 4;
/// Gap between the frame and the colour bar.
const TO_BAR: f64 = 18.0;
/// Height of the frame below which the colour bar is placed under the map.
const LOW: f64 = 150.0;
/// Minimum width of the frame; maps that would be narrower are drawn out of proportion.
const NARROWEST: f64 = 30.0;
/// Maximum height of the frame, in widths of the paper.
const HIGHEST: f64 = 1.3;

/// Layout of a figure.
struct FigureLayout {
    width: f64,
    frame: Rect,
    bar: Option<Rect>,
    title: Vec<String>,
    /// Upper edge of the legend.
    footer: f64,
}

/// Figure of a map.
///
/// # Errors
/// Fails if there is nothing to draw, sizes disagree, or `look` cannot be satisfied.
pub fn scene(picture: &MapPicture, look: &MapStyle, lines: &[TrackLine]) -> Result<FigureScene, Fault> {
    check(picture, look)?;
    let scale = colour_scale(picture, look)?;
    let width = WIDEST.min(look.width_px as f64);
    let fine = look.width_px as f64 / width;
    let (layout, bar) = layout(picture, look, &scale, (width, fine));
    let frame = MapFrame { picture, window: MapWindow::from_picture(picture), rect: layout.frame };
    let drawn: Result<Vec<tracks::TrackDrawing>, Fault> =
        lines.iter().enumerate().map(|(k, track)| tracks::drawn(track, k, &frame, 0.4 / fine)).collect();
    let drawn = drawn?;
    let (map, holes) = map(&frame, look, &scale, fine);
    let mut marks = title(&layout);
    let mut entries = furniture(&frame, look);
    entries.extend(LegendEntry::tracks(&drawn));
    marks.extend(map);
    if let Some(step) = look.contours {
        let (lines, entry) = contours::marks(&frame, step)?;
        marks.extend(lines);
        entries.push(entry);
    }
    marks.extend(drawn.into_iter().flat_map(|d| d.marks));
    marks.extend(frame.marks());
    marks.extend(layout.bar.iter().flat_map(|place| bar.marks(place)));
    if holes {
        entries.push(LegendEntry::Unknown);
    }
    // The legend is centred below a narrow map, and aligned with the left edge of other maps.
    let narrow = layout.frame.w < 0.5 * width;
    let centre = narrow.then_some(layout.frame.x + 0.5 * layout.frame.w);
    let left = if narrow { PAD } else { layout.frame.x };
    let (legend, high) = footer(&entries, &LegendPosition { left, right: width - PAD, top: layout.footer, centre });
    marks.extend(legend);
    let height = ((layout.footer + high + PAD) * fine).round() / fine;
    Ok(FigureScene { name: picture.title.to_owned(), width, height, scale: fine, paper: true, marks })
}

fn layout<'a>(
    picture: &MapPicture,
    look: &MapStyle,
    scale: &'a ColourScale,
    (width, fine): (f64, f64),
) -> (FigureLayout, ColourBar<'a>) {
    let window = MapWindow::from_picture(picture);
    let shape = shrink(picture) * (window.x.1 - window.x.0) / (window.y.1 - window.y.0);
    let title = wrapped(picture.title, TITLE.0, width - 2.0 * PAD, TITLE_LINES);
    let top = PAD + TITLE.1 * title.len() as f64 + if title.is_empty() { 6.0 } else { 4.0 };
    let bar = |upward| ColourBar { scale, name: bar_name(picture), upward };
    let right = |at_right: bool| if at_right { TO_BAR + bar(true).breadth() + PAD } else { PAD + 24.0 };
    let (frame, at_right) = match fit(picture, shape, width, right(look.colour_bar)) {
        // A colour bar at the side of a low map would be too short to read.
        (_, size) if look.colour_bar && size.1 < LOW => (fit(picture, shape, width, right(false)), false),
        fits => (fits, look.colour_bar),
    };
    let (left, (w, h)) = frame;
    let whole = |length: f64| (length * fine).round() / fine;
    let slack = (width - left - right(at_right) - w).max(0.0);
    let frame = Rect { x: whole(left + 0.5 * slack), y: whole(top), w: whole(w), h: whole(h) };
    let below = frame.bottom() + bottom_margin(picture);
    let bar = bar(at_right);
    let place = match (look.colour_bar, at_right) {
        (false, _) => None,
        (_, true) => Some(Rect { x: frame.right() + TO_BAR, y: frame.y, w: bar.breadth(), h: frame.h }),
        (_, false) => {
            let long = frame.w.clamp(240f64.min(width - 6.0 * PAD), 480.0);
            let x = (frame.x + 0.5 * (frame.w - long)).max(2.0 * PAD);
            Some(Rect { x, y: below + 8.0, w: long, h: bar.breadth() })
        }
    };
    let under = place.filter(|_| !at_right).map_or(below, |p| p.bottom());
    (FigureLayout { width, frame, bar: place, title, footer: under + 0.4 * ROW }, bar)
}

/// Left margin, frame width and frame height for a map of that shape.
fn fit(picture: &MapPicture, shape: f64, width: f64, right: f64) -> (f64, (f64, f64)) {
    let window = MapWindow::from_picture(picture);
    let size = |left: f64| {
        let w = (width - PAD - left - right).max(NARROWEST);
        let h = (w / shape).min(HIGHEST * width);
        ((h * shape).clamp(NARROWEST, w), h.max(NARROWEST))
    };
    // Label width and frame height depend on each other, so the labels of the highest frame determine the margin.
    let left = (0..2).fold(0.0f64, |left, _| left.max(left_margin(picture, &window, size(left).1)));
    (PAD + left, size(left))
}

fn bar_name(picture: &MapPicture) -> String {
    match (picture.quantity.trim(), picture.unit.trim()) {
        (quantity, "") => quantity.to_owned(),
        ("", unit) => unit.to_owned(),
        (quantity, unit) => format!("{quantity} ({unit})"),
    }
}

fn title(layout: &FigureLayout) -> Vec<SceneMark> {
    let line = |(k, text): (usize, &String)| {
        let half = 0.5 * text_width(text, TITLE.0);
        let (least, most) = (PAD + half, layout.width - PAD - half);
        let x = (layout.frame.x + 0.5 * layout.frame.w).min(most).max(least);
        SceneMark::text((x, PAD + TITLE.0 + TITLE.1 * k as f64 - 2.0), text.clone(), TITLE.0, TextAnchor::Middle)
    };
    layout.title.iter().enumerate().map(line).collect()
}

/// Marks of the map over the hatching, and whether any hatching is visible.
fn map(frame: &MapFrame, look: &MapStyle, scale: &ColourScale, fine: f64) -> (Vec<SceneMark>, bool) {
    let size = ((frame.rect.w * fine).round() as usize, (frame.rect.h * fine).round() as usize);
    let pixels = ColouredMap::new(frame.picture, look, scale, size).pixels(&frame.window, size);
    let holes = pixels.iter().skip(3).step_by(4).any(|opacity| *opacity == 0);
    let mut marks = if holes { SceneMark::hatch(frame.rect).to_vec() } else { vec![] };
    marks.push(SceneMark::Picture { rect: frame.rect, size, pixels });
    (marks, holes)
}

fn furniture(frame: &MapFrame, look: &MapStyle) -> Vec<LegendEntry> {
    let scale = frame
        .metres_per_unit()
        .filter(|_| look.scale_bar)
        .map(|m| LegendEntry::scale(m, (0.3 * frame.rect.w).clamp(48.0, 160.0)));
    scale.into_iter().chain(look.north.then_some(LegendEntry::North)).collect()
}

//! Position of the map on the paper, and the coordinates around it.

use numerics::angle::wrap_deg;
use numerics::earth::geodesy::EarthModel;

use super::{
    AxisQuantity, MapPicture,
    scene::{BLACK, PaperPoint, Rect, SceneMark, TextAnchor, shortened, text_width},
    sheet::MapWindow,
};
use crate::ticks::{self, AxisTick};

/// Letter size at ticks.
pub const TICK: f64 = 12.0;
/// Letter size of the names of axes.
pub const NAME: f64 = 13.0;
/// Length of a tick.
const LENGTH: f64 = 5.0;

/// Axis of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapAxis {
    /// West to east.
    Across,
    /// South to north.
    Up,
}

/// Frame of the map and its window.
pub struct MapFrame<'a> {
    /// The map.
    pub picture: &'a MapPicture<'a>,
    /// Part of the map in the frame.
    pub window: MapWindow,
    /// Position on the paper.
    pub rect: Rect,
}

impl MapFrame<'_> {
    /// Position of a point of the map on the paper; north is up.
    pub fn spot(&self, x: f64, y: f64) -> PaperPoint {
        let (across, up) = (self.window.x, self.window.y);
        (
            self.rect.x + (x - across.0) / (across.1 - across.0) * self.rect.w,
            self.rect.y + (up.1 - y) / (up.1 - up.0) * self.rect.h,
        )
    }

    /// Metres per unit of length on the paper, along x in the middle of the map. `None` if the scale differs by more
    /// than a tenth from south to north.
    pub fn metres_per_unit(&self) -> Option<f64> {
        let across = self.window.x.1 - self.window.x.0;
        if self.picture.plane == AxisQuantity::Metres {
            return Some(across / self.rect.w);
        }
        let (south, north) = self.window.y;
        let degree = |lat: f64| EarthModel::default().offset_ne_m((lat, 0.0), (lat, 1.0), 0.0).1;
        let (a, b, middle) = (degree(south), degree(north), degree(0.5 * (south + north)));
        let even = middle > 0.0 && (a.max(b).max(middle) - a.min(b)) <= 0.1 * middle;
        even.then(|| across * middle / self.rect.w)
    }

    /// Ticks, coordinates and names of the axes, and the frame itself.
    pub fn marks(&self) -> Vec<SceneMark> {
        let (rect, labels) = (&self.rect, labels(self.picture, self.rect.h));
        let mut out = vec![];
        let mut lines = vec![];
        let below = rect.bottom() + LENGTH;
        for tick in ticks(self.picture, &self.window, MapAxis::Across, rect.w) {
            let (x, _) = self.spot(tick.at, self.window.y.0);
            lines.push(vec![(x, rect.bottom()), (x, below)]);
            out.push(SceneMark::text((x, below + TICK), tick.label, TICK, TextAnchor::Middle));
        }
        let left = rect.x - LENGTH;
        for tick in ticks(self.picture, &self.window, MapAxis::Up, rect.h) {
            let (_, y) = self.spot(self.window.x.0, tick.at);
            lines.push(vec![(left, y), (rect.x, y)]);
            out.push(SceneMark::text((left - 4.0, y + 0.36 * TICK), tick.label, TICK, TextAnchor::End));
        }
        out.push(SceneMark::Stroke { lines, width: 1.0, ink: BLACK, within: None });
        out.push(SceneMark::frame(rect, 1.0));
        if let Some(name) = labels.0 {
            let name = shortened(&name, NAME, rect.w.max(120.0));
            out.push(SceneMark::text((rect.x + 0.5 * rect.w, below + TICK + 19.0), name, NAME, TextAnchor::Middle));
        }
        if let Some(text) = labels.1 {
            let at = (rect.x - left_margin(self.picture, &self.window, rect.h) + NAME, rect.y + 0.5 * rect.h);
            out.push(SceneMark::Text { at, text, size: NAME, anchor: TextAnchor::Middle, turned: true });
        }
        out
    }
}

/// Space to the left of the frame for the coordinates and the names of the axes.
pub fn left_margin(picture: &MapPicture, window: &MapWindow, height: f64) -> f64 {
    let widths = ticks(picture, window, MapAxis::Up, height).into_iter().map(|t| text_width(&t.label, TICK));
    let name = if labels(picture, height).1.is_some() { NAME + 8.0 } else { 0.0 };
    LENGTH + 4.0 + widths.fold(0.0, f64::max) + name
}

/// Space below the frame for coordinates and names.
pub fn bottom_margin(picture: &MapPicture) -> f64 {
    LENGTH + TICK + 4.0 + if labels(picture, 0.0).0.is_some() { 20.0 } else { 0.0 }
}

/// Names of the axes: the given names, if any. Otherwise an axis in metres is named by its quantity and unit; an axis
/// in degrees has no name, because its ticks include the unit. The vertical name is omitted if the frame is too low for
/// it.
fn labels(picture: &MapPicture, height: f64) -> (Option<String>, Option<String>) {
    let named = |given: Option<&str>, axis: &str, range: (f64, f64)| match (given, picture.plane) {
        (Some(given), _) => Some(given.to_owned()).filter(|g| !g.trim().is_empty()),
        (None, AxisQuantity::Degrees) => None,
        (None, AxisQuantity::Metres) => Some(format!("{axis} ({})", if in_km(range) { "km" } else { "m" })),
    };
    let window = MapWindow::from_picture(picture);
    let up = named(picture.y_label, "Northing", window.y).map(|n| shortened(&n, NAME, height.max(120.0)));
    (named(picture.x_label, "Easting", window.x), up.filter(|n| text_width(n, NAME) <= height + 10.0))
}

fn in_km(range: (f64, f64)) -> bool {
    range.1 - range.0 >= 2000.0
}

/// Round coordinates for an axis of `length` on the paper.
pub fn ticks(picture: &MapPicture, window: &MapWindow, side: MapAxis, length: f64) -> Vec<AxisTick> {
    let range = if side == MapAxis::Across { window.x } else { window.y };
    let made = |most: usize| match picture.plane {
        AxisQuantity::Degrees => degrees(range, most, side),
        AxisQuantity::Metres if in_km(range) => {
            let km = ticks::linear(range.0 / 1000.0, range.1 / 1000.0, most).into_iter();
            km.map(|t| AxisTick { at: 1000.0 * t.at, label: t.label }).collect()
        }
        AxisQuantity::Metres => ticks::linear(range.0, range.1, most),
    };
    // Space that a label needs along the axis: its height on a vertical axis, the width of the widest label on a
    // horizontal axis.
    let label = match side {
        MapAxis::Up => TICK,
        MapAxis::Across => made(8).iter().map(|t| text_width(&t.label, TICK)).fold(20.0, f64::max),
    };
    let few = if length > 2.0 * (label + 6.0) { 2 } else { 1 };
    made(((length / (label + 1.6 * TICK)) as usize).clamp(few, 8))
}

/// Degrees with N, S, E or W instead of a sign; longitudes are wrapped to a full turn.
fn degrees(range: (f64, f64), most: usize, side: MapAxis) -> Vec<AxisTick> {
    let ticks = ticks::linear(range.0, range.1, most);
    let label = |tick: AxisTick| {
        let decimals = tick.label.split_once('.').map_or(0, |(_, d)| d.len());
        let angle = if side == MapAxis::Across { wrap_deg(tick.at) } else { tick.at };
        let text = ticks::fixed(angle.abs(), decimals);
        let bare = text.chars().all(|c| c == '0' || c == '.') || (side == MapAxis::Across && angle <= -180.0);
        let letter = match (side, angle > 0.0) {
            _ if bare => "",
            (MapAxis::Across, true) => "E",
            (MapAxis::Across, false) => "W",
            (MapAxis::Up, true) => "N",
            (MapAxis::Up, false) => "S",
        };
        AxisTick { at: tick.at, label: format!("{text}\u{b0}{letter}") }
    };
    ticks.into_iter().map(label).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gold_degrees_are_written_with_their_side() {
        let written =
            |range, most, side| -> Vec<String> { degrees(range, most, side).into_iter().map(|t| t.label).collect() };
        assert_eq!(written((-1.2, 1.2), 4, MapAxis::Up), ["1\u{b0}S", "0\u{b0}", "1\u{b0}N"]);
        assert_eq!(written((178.9, 181.1), 5, MapAxis::Across)[..2], ["179.0\u{b0}E", "179.5\u{b0}E"]);
        assert_eq!(written((178.9, 181.1), 5, MapAxis::Across)[2..], ["180.0\u{b0}", "179.5\u{b0}W", "179.0\u{b0}W"]);
    }
}

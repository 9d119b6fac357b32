//! Colour bar of a map.

use super::{
    frame::{NAME, TICK},
    scale::ColourScale,
    scene::{BLACK, Ink, PaperPoint, Rect, SceneMark, TextAnchor, shortened, text_width},
};

/// Thickness of the bar.
pub const THICK: f64 = 15.0;
/// Length of the pointed end of a bar, for values beyond the scale.
const POINT: f64 = 9.0;
/// Gap between the bar and its numbers.
const GAP: f64 = 7.0;
/// The number of colour stops; the painters interpolate between them.
const STOPS: usize = 129;

/// Colour bar with its name.
pub struct ColourBar<'a> {
    /// Colour scale of the bar.
    pub scale: &'a ColourScale,
    /// Quantity and unit.
    pub name: String,
    /// Direction: bottom to top if true, otherwise left to right.
    pub upward: bool,
}

impl ColourBar<'_> {
    /// Total breadth of the bar, its numbers and its name.
    pub fn breadth(&self) -> f64 {
        let apart = if self.upward { 8.0 } else { 4.0 };
        let name = if self.name.is_empty() { 0.0 } else { NAME + apart };
        let widths = self.scale.ticks(11).into_iter().map(|t| text_width(&t.label, TICK));
        THICK + GAP + name + if self.upward { widths.fold(0.0, f64::max) } else { TICK }
    }

    /// Marks of the bar within `place`, whose shorter side is [`ColourBar::breadth`].
    pub fn marks(&self, place: &Rect) -> Vec<SceneMark> {
        let rect = self.strip(place);
        let colours = (0..STOPS).map(|k| self.scale.colour_at(k as f64 / (STOPS - 1) as f64)).collect();
        let mut out = vec![SceneMark::Fade { rect, colours, upward: self.upward }];
        out.extend(self.points(&rect));
        out.push(SceneMark::Stroke { lines: vec![self.outline(&rect)], width: 1.0, ink: BLACK, within: None });
        out.extend(self.numbers(&rect));
        out.extend(self.title(&rect, place));
        out
    }

    /// Strip of colours, without the pointed ends of the bar.
    fn strip(&self, place: &Rect) -> Rect {
        let (below, above) = self.ends();
        match self.upward {
            true => Rect { x: place.x, y: place.y + above, w: THICK, h: place.h - above - below },
            false => Rect { x: place.x + below, y: place.y, w: place.w - above - below, h: THICK },
        }
    }

    fn ends(&self) -> (f64, f64) {
        let (below, above) = self.scale.beyond;
        (if below { POINT } else { 0.0 }, if above { POINT } else { 0.0 })
    }

    /// Position on the paper of the fraction `along` the bar (0 to 1) and the fraction `across` it (0 on the side
    /// without numbers).
    fn at(&self, rect: &Rect, along: f64, across: f64) -> PaperPoint {
        match self.upward {
            true => (rect.x + across * rect.w, rect.bottom() - along * rect.h),
            false => (rect.x + along * rect.w, rect.y + across * rect.h),
        }
    }

    fn outline(&self, rect: &Rect) -> Vec<PaperPoint> {
        let length = if self.upward { rect.h } else { rect.w };
        let (below, above) = self.ends();
        let mut around = vec![self.at(rect, 0.0, 0.0)];
        around.push(self.at(rect, 1.0, 0.0));
        around.push(self.at(rect, 1.0 + above / length, 0.5));
        around.push(self.at(rect, 1.0, 1.0));
        around.push(self.at(rect, 0.0, 1.0));
        around.push(self.at(rect, -below / length, 0.5));
        around.push(self.at(rect, 0.0, 0.0));
        around.dedup();
        around
    }

    /// Pointed ends in the colours beyond the scale.
    fn points(&self, rect: &Rect) -> Vec<SceneMark> {
        let length = if self.upward { rect.h } else { rect.w };
        let (below, above) = self.ends();
        let point = |end: f64, tip: f64| SceneMark::Fill {
            points: vec![self.at(rect, end, 0.0), self.at(rect, end + tip / length, 0.5), self.at(rect, end, 1.0)],
            ink: Ink::full(self.scale.colour_at(end)),
        };
        let ends = [(0.0, -below), (1.0, above)];
        ends.into_iter().filter(|(_, tip)| *tip != 0.0).map(|(end, tip)| point(end, tip)).collect()
    }

    fn numbers(&self, rect: &Rect) -> Vec<SceneMark> {
        let widest = self.scale.ticks(11).iter().map(|t| text_width(&t.label, TICK)).fold(0.0, f64::max);
        let most = if self.upward { rect.h / 30.0 } else { rect.w / (widest + 12.0) };
        let ticks = self.scale.ticks((most as usize).clamp(2, 11));
        let length = if self.upward { rect.w } else { rect.h };
        let along = |k: usize, at: f64| {
            // Labels of an equalised scale are evenly spaced, even where values repeat.
            if self.scale.by_rank() { k as f64 / (ticks.len() - 1) as f64 } else { self.scale.along(at) }
        };
        let mut out = vec![];
        let mut lines = vec![];
        for (k, tick) in ticks.iter().enumerate() {
            let along = along(k, tick.at);
            lines.push(vec![self.at(rect, along, 1.0), self.at(rect, along, 1.0 + 4.0 / length)]);
            let (x, y) = self.at(rect, along, 1.0 + GAP / length);
            let (at, anchor) = match self.upward {
                true => ((x, y + 0.36 * TICK), TextAnchor::Start),
                false => ((x, y + 0.8 * TICK), TextAnchor::Middle),
            };
            out.push(SceneMark::text(at, tick.label.clone(), TICK, anchor));
        }
        out.push(SceneMark::Stroke { lines, width: 1.0, ink: BLACK, within: None });
        out
    }

    fn title(&self, rect: &Rect, place: &Rect) -> Option<SceneMark> {
        let at = match self.upward {
            true => (place.right() - 2.0, rect.y + 0.5 * rect.h),
            false => (rect.x + 0.5 * rect.w, place.bottom() - 1.0),
        };
        let text = shortened(&self.name, NAME, place.w.max(place.h) + 24.0);
        (!text.is_empty()).then_some(SceneMark::Text {
            at,
            text,
            size: NAME,
            anchor: TextAnchor::Middle,
            turned: self.upward,
        })
    }
}

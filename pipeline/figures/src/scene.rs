//! Figure as marks on a sheet of paper, which both painters draw in the same order.

/// Position on the paper, from its upper left corner.
pub type PaperPoint = (f64, f64);

/// A rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    /// Left edge.
    pub x: f64,
    /// Upper edge.
    pub y: f64,
    /// Width.
    pub w: f64,
    /// Height.
    pub h: f64,
}

impl Rect {
    /// Right edge.
    pub fn right(&self) -> f64 {
        self.x + self.w
    }

    /// Lower edge.
    pub fn bottom(&self) -> f64 {
        self.y + self.h
    }

    /// Corners, in order, without repetition.
    pub fn corners(&self) -> Vec<PaperPoint> {
        vec![(self.x, self.y), (self.right(), self.y), (self.right(), self.bottom()), (self.x, self.bottom())]
    }

    /// Whether a position is within the rectangle or on its edge.
    pub fn holds(&self, (x, y): PaperPoint) -> bool {
        (self.x..=self.right()).contains(&x) && (self.y..=self.bottom()).contains(&y)
    }

    /// Rectangle enlarged by `by` on all sides.
    pub fn grown(&self, by: f64) -> Rect {
        Rect { x: self.x - by, y: self.y - by, w: self.w + 2.0 * by, h: self.h + 2.0 * by }
    }
}

/// A colour and its opacity, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ink {
    /// Red, green, blue.
    pub rgb: [u8; 3],
    /// The opacity.
    pub opacity: f64,
}

impl Ink {
    /// An opaque colour.
    pub const fn full(rgb: [u8; 3]) -> Ink {
        Ink { rgb, opacity: 1.0 }
    }
}

/// Colour of letters, frames and ticks.
pub const BLACK: Ink = Ink::full([26, 26, 26]);
/// Colour of the paper.
pub const WHITE: Ink = Ink::full([255, 255, 255]);

/// Part of a text that is placed at the text's position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextAnchor {
    /// Beginning.
    Start,
    /// Middle.
    Middle,
    /// End.
    End,
}

/// Mark of a figure.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneMark {
    /// Filled outline.
    Fill {
        /// Corners.
        points: Vec<PaperPoint>,
        /// Colour.
        ink: Ink,
    },
    /// Lines of one pen.
    Stroke {
        /// Lines, each with at least two positions.
        lines: Vec<Vec<PaperPoint>>,
        /// Width of the pen.
        width: f64,
        /// Colour.
        ink: Ink,
        /// The clipping rectangle.
        within: Option<Rect>,
    },
    /// Circle with a rim.
    Disc {
        /// Centre.
        at: PaperPoint,
        /// Radius, to the middle of the rim.
        radius: f64,
        /// Colour inside.
        fill: Ink,
        /// Colour of the rim, which is 1.5 wide.
        rim: Ink,
    },
    /// A picture.
    Picture {
        /// Position, on whole pixels.
        rect: Rect,
        /// Size in pixels.
        size: (usize, usize),
        /// Red, green, blue and opacity (0 or 255) of each pixel, rows from the top.
        pixels: Vec<u8>,
    },
    /// A colour gradient.
    Fade {
        /// Position.
        rect: Rect,
        /// Evenly spaced colours, from the bottom or from the left.
        colours: Vec<[u8; 3]>,
        /// Direction: bottom to top if true, otherwise left to right.
        upward: bool,
    },
    /// A line of text.
    Text {
        /// Position of the text's anchor, which is on the base line.
        at: PaperPoint,
        /// Text.
        text: String,
        /// Size of its letters.
        size: f64,
        /// Part of the text that is placed at `at`.
        anchor: TextAnchor,
        /// Whether it is rotated to read upwards.
        turned: bool,
    },
}

impl SceneMark {
    /// Outline of a rectangle.
    pub fn frame(rect: &Rect, width: f64) -> SceneMark {
        let corners = rect.corners();
        let sides = (0..4).map(|k| vec![corners[k], corners[(k + 1) % 4]]).collect();
        SceneMark::Stroke { lines: sides, width, ink: BLACK, within: None }
    }

    /// Upright text.
    pub fn text(at: PaperPoint, text: impl Into<String>, size: f64, anchor: TextAnchor) -> SceneMark {
        SceneMark::Text { at, text: text.into(), size, anchor, turned: false }
    }

    /// Light grey with slanted lines, for unknown areas.
    pub fn hatch(rect: Rect) -> [SceneMark; 2] {
        const EVERY: f64 = 7.0;
        let count = ((rect.w + rect.h) / EVERY) as usize;
        let from = |k: usize| rect.x - rect.h + EVERY * (k as f64 + 0.5);
        let lines = (0..=count).map(|k| vec![(from(k), rect.bottom()), (from(k) + rect.h, rect.y)]);
        let grey = Ink::full([204, 204, 204]);
        [
            SceneMark::Fill { points: rect.corners(), ink: Ink::full([243, 243, 243]) },
            SceneMark::Stroke { lines: lines.collect(), width: 1.0, ink: grey, within: Some(rect) },
        ]
    }
}

/// A figure.
#[derive(Clone, Debug, PartialEq)]
pub struct FigureScene {
    /// Description, for screen readers.
    pub name: String,
    /// Width of the paper.
    pub width: f64,
    /// Height.
    pub height: f64,
    /// Pixels per unit of length.
    pub scale: f64,
    /// Whether the background is white paper.
    pub paper: bool,
    /// Marks, from the lowest to the uppermost.
    pub marks: Vec<SceneMark>,
}

/// Width of a letter of size 1 in the pixel painter, slightly larger than in the fonts of most viewers.
const LETTER: f64 = 7.0 / 12.0;

/// Width of a line of text.
pub fn text_width(text: &str, size: f64) -> f64 {
    text.chars().count() as f64 * LETTER * size
}

/// Breaks `text` into at most `most` lines of at most `width`, at spaces if possible; an ellipsis replaces the rest.
pub fn wrapped(text: &str, size: f64, width: f64, most: usize) -> Vec<String> {
    let letters = ((width / (LETTER * size)) as usize).max(4);
    let mut lines: Vec<String> = vec![];
    for word in text.split_whitespace() {
        let mut rest: Vec<char> = word.chars().collect();
        while !rest.is_empty() {
            let room = lines.last().map_or(0, |l| letters.saturating_sub(l.chars().count() + 1));
            if let Some(line) = lines.last_mut().filter(|_| rest.len() <= room) {
                line.push(' ');
                line.extend(rest.drain(..));
            } else {
                lines.push(rest.drain(..rest.len().min(letters)).collect());
            }
        }
    }
    if lines.len() > most {
        lines.truncate(most);
        if let Some(last) = lines.last_mut() {
            *last = shortened(&format!("{last} \u{2026}"), size, width);
        }
    }
    lines
}

/// Cuts `text` to `width`, with an ellipsis if the text is longer.
pub fn shortened(text: &str, size: f64, width: f64) -> String {
    let letters = ((width / (LETTER * size)) as usize).max(4);
    if text.chars().count() <= letters {
        return text.to_owned();
    }
    let kept: String = text.chars().take(letters - 1).collect();
    format!("{}\u{2026}", kept.trim_end_matches([' ', '\u{2026}']))
}

/// Parts of a line within a rectangle. [Liang and Barsky 1984]
pub fn clipped(line: &[PaperPoint], rect: &Rect) -> Vec<Vec<PaperPoint>> {
    let mut out: Vec<Vec<PaperPoint>> = vec![];
    let mut joined = false;
    for ends in line.windows(2) {
        let Some((from, to)) = clip(ends[0], ends[1], rect) else {
            joined = false;
            continue;
        };
        match out.last_mut().filter(|part| joined && part.last() == Some(&from)) {
            Some(part) => part.push(to),
            None => out.push(vec![from, to]),
        }
        joined = to == ends[1];
    }
    out
}

fn clip(a: PaperPoint, b: PaperPoint, rect: &Rect) -> Option<(PaperPoint, PaperPoint)> {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let sides = [(-dx, a.0 - rect.x), (dx, rect.right() - a.0), (-dy, a.1 - rect.y), (dy, rect.bottom() - a.1)];
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for (outward, room) in sides {
        if outward == 0.0 && room < 0.0 {
            return None;
        }
        if outward < 0.0 {
            from = from.max(room / outward);
        } else if outward > 0.0 {
            to = to.min(room / outward);
        }
    }
    let at = |t: f64| (a.0 + t * dx, a.1 + t * dy);
    (from <= to).then(|| (if from == 0.0 { a } else { at(from) }, if to == 1.0 { b } else { at(to) }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_titles_are_broken_at_spaces_and_end_in_an_ellipsis() {
        let width = 10.0 * LETTER * 12.0 + 0.1;
        assert_eq!(wrapped("one two three four", 12.0, width, 9), ["one two", "three four"]);
        assert_eq!(wrapped("abcdefghijklmnop qr", 12.0, width, 9), ["abcdefghij", "klmnop qr"]);
        assert_eq!(wrapped("one two three four five six", 12.0, width, 2), ["one two", "three fou\u{2026}"]);
        assert!(wrapped("  ", 12.0, width, 2).is_empty());
        assert_eq!(shortened("abcdefghijk", 12.0, width), "abcdefghi\u{2026}");
    }

    #[test]
    fn unit_a_clipped_line_is_the_part_inside() {
        let rect = Rect { x: 0.0, y: 0.0, w: 10.0, h: 10.0 };
        let through = clipped(&[(-10.0, 5.0), (5.0, 5.0), (5.0, 20.0), (8.0, 20.0), (8.0, 9.0)], &rect);
        assert_eq!(through, [vec![(0.0, 5.0), (5.0, 5.0), (5.0, 10.0)], vec![(8.0, 10.0), (8.0, 9.0)]]);
        assert!(clipped(&[(-1.0, -1.0), (-1.0, 12.0), (12.0, 12.0)], &rect).is_empty());
        assert_eq!(clipped(&[(1.0, 1.0), (2.0, 2.0)], &rect), [[(1.0, 1.0), (2.0, 2.0)]]);
    }
}

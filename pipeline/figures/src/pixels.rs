//! Painter in pixels.

use schemas::Fault;
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Mask, Paint, Path, PathBuilder, Pixmap, Rect as SkiaRect, Stroke, Transform,
};

use super::{
    glyphs,
    scene::{FigureScene, Ink, PaperPoint, Rect, SceneMark},
};
use crate::png_file::{PixelFormat, encode};

/// Maximum number of pixels of a picture.
const MOST: f64 = 200e6;

/// Scene as a PNG, opaque on paper.
///
/// # Errors
/// Fails if it has too many pixels.
pub fn png(scene: &FigureScene) -> Result<Vec<u8>, Fault> {
    let pixmap = paint(scene)?;
    let size = (pixmap.width() as usize, pixmap.height() as usize);
    let plain = pixmap.pixels().iter().map(|p| p.demultiply());
    if scene.paper {
        return encode(
            &PixelFormat::Rgb,
            size,
            &plain.flat_map(|p| [p.red(), p.green(), p.blue()]).collect::<Vec<u8>>(),
        );
    }
    let pixels: Vec<u8> = plain.flat_map(|p| [p.red(), p.green(), p.blue(), p.alpha()]).collect();
    encode(&PixelFormat::Rgba, size, &pixels)
}

fn paint(scene: &FigureScene) -> Result<Pixmap, Fault> {
    let (width, height) = ((scene.width * scene.scale).round(), (scene.height * scene.scale).round());
    let pixmap = (width * height <= MOST).then(|| Pixmap::new(width as u32, height as u32)).flatten();
    let Some(mut pixmap) = pixmap else {
        return Err(
            Fault::new(format!("a picture of {width} by {height} pixels cannot be drawn")).help("give a smaller width")
        );
    };
    if scene.paper {
        pixmap.fill(Color::WHITE);
    }
    let mut painter = Painter { pixmap, scale: scene.scale };
    scene.marks.iter().for_each(|mark| painter.put(mark));
    Ok(painter.pixmap)
}

struct Painter {
    pixmap: Pixmap,
    scale: f64,
}

impl Painter {
    fn put(&mut self, mark: &SceneMark) {
        match mark {
            SceneMark::Fill { points, ink } => self.fill(outline(std::slice::from_ref(points), true), *ink),
            SceneMark::Stroke { lines, width, ink, within } => self.stroke(lines, *width, *ink, within.as_ref()),
            SceneMark::Disc { at, radius, fill, rim } => {
                let circle = PathBuilder::from_circle(at.0 as f32, at.1 as f32, *radius as f32);
                self.fill(circle.clone(), *fill);
                self.line(circle, 1.5, *rim, None);
            }
            SceneMark::Picture { rect, size, pixels } => self.picture(rect, *size, pixels),
            SceneMark::Fade { rect, colours, upward } => self.fade(rect, colours, *upward),
            SceneMark::Text { at, text, size, anchor, turned } => {
                let at = (at.0 * self.scale, at.1 * self.scale);
                glyphs::text(&mut self.pixmap, at, text, size * self.scale, *anchor, *turned);
            }
        }
    }

    fn transform(&self) -> Transform {
        Transform::from_scale(self.scale as f32, self.scale as f32)
    }

    fn fill(&mut self, path: Option<Path>, ink: Ink) {
        let Some(path) = path else { return };
        let transform = self.transform();
        self.pixmap.fill_path(&path, &paint_of(ink), FillRule::Winding, transform, None);
    }

    fn stroke(&mut self, lines: &[Vec<PaperPoint>], width: f64, ink: Ink, within: Option<&Rect>) {
        let level =
            |line: &&Vec<PaperPoint>| matches!(line[..], [a, b] if within.is_none() && (a.0 == b.0 || a.1 == b.1));
        let (level, free): (Vec<&Vec<PaperPoint>>, Vec<&Vec<PaperPoint>>) = lines.iter().partition(level);
        for line in level {
            self.level(line, width, ink);
        }
        let free: Vec<Vec<PaperPoint>> = free.into_iter().cloned().collect();
        self.line(outline(&free, false), width, ink, within);
    }

    /// Draws a horizontal or vertical line, which covers whole pixels.
    fn level(&mut self, line: &[PaperPoint], width: f64, ink: Ink) {
        let [a, b] = line else { return };
        let pen = (width * self.scale).round().max(1.0);
        let side = |from: f64, to: f64| {
            let (low, high) = (from.min(to) * self.scale, from.max(to) * self.scale);
            let middle = if from == to { 0.5 * pen } else { 0.0 };
            let start = (low - middle).round();
            (start as f32, if from == to { (start + pen) as f32 } else { high.round() as f32 })
        };
        let ((left, right), (top, bottom)) = (side(a.0, b.0), side(a.1, b.1));
        if let Some(rect) = SkiaRect::from_ltrb(left, top, right, bottom) {
            self.pixmap.fill_rect(rect, &paint_of(ink), Transform::identity(), None);
        }
    }

    fn line(&mut self, path: Option<Path>, width: f64, ink: Ink, within: Option<&Rect>) {
        let Some(path) = path else { return };
        let mask = within.and_then(|rect| self.mask(rect));
        let stroke =
            Stroke { width: width as f32, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
        let transform = self.transform();
        self.pixmap.stroke_path(&path, &paint_of(ink), &stroke, transform, mask.as_ref());
    }

    fn mask(&self, rect: &Rect) -> Option<Mask> {
        let mut mask = Mask::new(self.pixmap.width(), self.pixmap.height())?;
        mask.fill_path(&outline(&[rect.corners()], true)?, FillRule::Winding, false, self.transform());
        Some(mask)
    }

    fn picture(&mut self, rect: &Rect, size: (usize, usize), pixels: &[u8]) {
        let (left, top) = ((rect.x * self.scale).round() as usize, (rect.y * self.scale).round() as usize);
        for (row, line) in pixels.chunks_exact(4 * size.0).enumerate() {
            for (column, pixel) in line.chunks_exact(4).enumerate().filter(|(_, p)| p[3] == 255) {
                self.set(left + column, top + row, pixel);
            }
        }
    }

    fn fade(&mut self, rect: &Rect, colours: &[[u8; 3]], upward: bool) {
        let edge = |at: f64| (at * self.scale).round() as usize;
        let (left, right, top, bottom) = (edge(rect.x), edge(rect.right()), edge(rect.y), edge(rect.bottom()));
        for y in top..bottom {
            for x in left..right {
                let along = match upward {
                    true => (bottom - 1 - y) as f64 / (bottom - top).max(2).saturating_sub(1) as f64,
                    false => (x - left) as f64 / (right - left).max(2).saturating_sub(1) as f64,
                };
                let [r, g, b] = faded(colours, along);
                self.set(x, y, &[r, g, b, 255]);
            }
        }
    }

    fn set(&mut self, x: usize, y: usize, pixel: &[u8]) {
        let width = self.pixmap.width() as usize;
        let at = 4 * (y * width + x);
        if let Some(place) = self.pixmap.data_mut().get_mut(at..at + 4).filter(|_| x < width) {
            place.copy_from_slice(pixel);
        }
    }
}

/// Colour at `along`, 0 to 1, between evenly spaced stops.
fn faded(colours: &[[u8; 3]], along: f64) -> [u8; 3] {
    let place = along.clamp(0.0, 1.0) * colours.len().saturating_sub(1) as f64;
    let at = |k: f64| colours.get(k as usize).copied().unwrap_or_default().map(f64::from);
    let (a, b) = (at(place.floor()), at(place.ceil()));
    let part = place - place.floor();
    std::array::from_fn(|k| (a[k] + part * (b[k] - a[k])).round() as u8)
}

fn paint_of(ink: Ink) -> Paint<'static> {
    let mut paint = Paint::default();
    let [r, g, b] = ink.rgb;
    paint.set_color_rgba8(r, g, b, (255.0 * ink.opacity).round() as u8);
    paint.anti_alias = true;
    paint
}

fn outline(lines: &[Vec<PaperPoint>], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for line in lines {
        for (k, (x, y)) in line.iter().enumerate() {
            if k == 0 { path.move_to(*x as f32, *y as f32) } else { path.line_to(*x as f32, *y as f32) }
        }
        if closed {
            path.close();
        }
    }
    path.finish()
}

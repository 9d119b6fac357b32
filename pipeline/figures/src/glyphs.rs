//! Letters of the pixel painter: a font of 7 by 16 pixels, enlarged with smooth edges to any size.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster};
use tiny_skia::Pixmap;

use super::scene::{BLACK, PaperPoint, TextAnchor};

/// Width and height of a letter's cell.
const CELL: (usize, usize) = (7, 16);
/// Row of the cell that contains the base line.
const BASE: f64 = 13.0;
/// Letter size at which the cell has its original height.
const SIZE: f64 = 12.0;

/// Line of text as coverages, 0 to 1, in rows of `width`.
struct TextBitmap {
    width: usize,
    ink: Vec<f32>,
}

/// Draws a line of text. The font has basic Latin letters, the degree sign, minus and dashes. Accents of western
/// European letters are dropped, other characters are boxes.
pub fn text(pixmap: &mut Pixmap, at_px: PaperPoint, text: &str, size_px: f64, anchor: TextAnchor, turned: bool) {
    let strip = strip(text);
    let enlarge = size_px / SIZE;
    let back = match anchor {
        TextAnchor::Start => 0.0,
        TextAnchor::Middle => 0.5,
        TextAnchor::End => 1.0,
    };
    let (long, high) = (strip.width as f64 * enlarge, CELL.1 as f64 * enlarge);
    // Origin of the text, on whole pixels: the upper left corner of its first cell when the text is upright.
    let (from_x, from_y) = match turned {
        false => ((at_px.0 - back * long).round(), (at_px.1 - BASE * enlarge).round()),
        true => ((at_px.0 - BASE * enlarge).round(), (at_px.1 + back * long).round()),
    };
    let (wide, tall) = if turned { (high, long) } else { (long, high) };
    let top = if turned { from_y - tall } else { from_y };
    for dy in 0..tall.ceil() as i64 {
        for dx in 0..wide.ceil() as i64 {
            let (x, y) = (dx as f64 + 0.5, dy as f64 + 0.5);
            let (along, down) = if turned { (tall - y, x) } else { (x, y) };
            let cover = strip.smooth(along / enlarge - 0.5, down / enlarge - 0.5, enlarge);
            if cover > 0.0 {
                blend(pixmap, from_x as i64 + dx, top as i64 + dy, cover);
            }
        }
    }
}

impl TextBitmap {
    fn get(&self, x: i64, y: i64) -> f32 {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width;
        let ink = inside.then(|| self.ink.get(y as usize * self.width + x as usize)).flatten();
        ink.copied().unwrap_or(0.0)
    }

    /// Coverage between pixels, interpolated by a cubic (Catmull and Rom 1974), with edges as steep as in the original
    /// size.
    fn smooth(&self, x: f64, y: f64, enlarge: f64) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (across, down) = (cubic((x - left) as f32), cubic((y - top) as f32));
        let mut sum = 0.0;
        for (j, dj) in down.iter().enumerate() {
            for (i, di) in across.iter().enumerate() {
                sum += dj * di * self.get(left as i64 - 1 + i as i64, top as i64 - 1 + j as i64);
            }
        }
        let steep = enlarge.max(1.0) as f32;
        (0.5 + (sum - 0.5) * steep).clamp(0.0, 1.0)
    }
}

fn cubic(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [0.5 * (-t3 + 2.0 * t2 - t), 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0), 0.5 * (-3.0 * t3 + 4.0 * t2 + t), 0.5 * (t3 - t2)]
}

/// Blends ink into a pixel, whose colours are premultiplied by the opacity.
fn blend(pixmap: &mut Pixmap, x: i64, y: i64, cover: f32) {
    if x < 0 || y < 0 || x >= i64::from(pixmap.width()) || y >= i64::from(pixmap.height()) {
        return;
    }
    let at = 4 * (y as usize * pixmap.width() as usize + x as usize);
    let Some(pixel) = pixmap.data_mut().get_mut(at..at + 4) else { return };
    let [r, g, b] = BLACK.rgb;
    for (old, new) in pixel.iter_mut().zip([r, g, b, 255]) {
        *old = (f32::from(new) * cover + f32::from(*old) * (1.0 - cover)).round() as u8;
    }
}

fn strip(text: &str) -> TextBitmap {
    let letters: Vec<char> = text.chars().flat_map(plain).collect();
    let width = CELL.0 * letters.len();
    let mut ink = vec![0.0; width * CELL.1];
    for (k, letter) in letters.iter().enumerate() {
        for (row, coverage) in glyph(*letter).iter().enumerate() {
            let from = row * width + k * CELL.0;
            if let Some(place) = ink.get_mut(from..from + CELL.0) {
                place.copy_from_slice(coverage);
            }
        }
    }
    TextBitmap { width, ink }
}

/// Substitute for a character that the font lacks.
fn plain(letter: char) -> Vec<char> {
    const ACCENTED: [(&str, char); 16] = [
        ("àáâãäå", 'a'),
        ("ÀÁÂÃÄÅ", 'A'),
        ("èéêë", 'e'),
        ("ÈÉÊË", 'E'),
        ("ìíîï", 'i'),
        ("ÌÍÎÏ", 'I'),
        ("òóôõöø", 'o'),
        ("ÒÓÔÕÖØ", 'O'),
        ("ùúûü", 'u'),
        ("ÙÚÛÜ", 'U'),
        ("ç", 'c'),
        ("Ç", 'C'),
        ("ñ", 'n'),
        ("Ñ", 'N'),
        ("µμ", 'u'),
        ("‐‑–—", '-'),
    ];
    match letter {
        '\u{2026}' => vec!['.'; 3],
        'ß' => vec!['s'; 2],
        '\u{2018}' | '\u{2019}' => vec!['\''],
        '\u{201c}' | '\u{201d}' => vec!['"'],
        _ => vec![ACCENTED.iter().find(|(all, _)| all.contains(letter)).map_or(letter, |(_, plain)| *plain)],
    }
}

fn glyph(letter: char) -> [[f32; CELL.0]; CELL.1] {
    match letter {
        '\u{b0}' => drawn(|x, y| 1.0 - ((x - 3.5).hypot(y - 6.0) - 1.9).abs() / 0.9),
        '\u{2212}' => minus(),
        _ => font(letter).unwrap_or_else(|| {
            // An empty box, as in fonts.
            drawn(|x, y| {
                if (x - 3.5).abs().max((y - 8.5).abs() * 0.6) > 1.9
                    && (1.0..6.0).contains(&x)
                    && (4.0..13.0).contains(&y)
                {
                    1.0
                } else {
                    0.0
                }
            })
        }),
    }
}

fn font(letter: char) -> Option<[[f32; CELL.0]; CELL.1]> {
    let raster = get_raster(letter, FontWeight::Regular, RasterHeight::Size16)?;
    let mut out = [[0.0; CELL.0]; CELL.1];
    for (to, from) in out.iter_mut().zip(raster.rows()) {
        to.iter_mut().zip(from).for_each(|(a, b)| *a = f32::from(*b) / 255.0);
    }
    Some(out)
}

/// Plus sign without the vertical stroke.
fn minus() -> [[f32; CELL.0]; CELL.1] {
    let mut out = font('+').unwrap_or_default();
    for row in &mut out {
        let bar = row[1];
        row.iter_mut().skip(1).take(CELL.0 - 2).for_each(|c| *c = bar);
    }
    out
}

fn drawn(cover: impl Fn(f32, f32) -> f32) -> [[f32; CELL.0]; CELL.1] {
    std::array::from_fn(|y| std::array::from_fn(|x| cover(x as f32 + 0.5, y as f32 + 0.5).clamp(0.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paper() -> Pixmap {
        let mut pixmap = Pixmap::new(80, 40).unwrap();
        pixmap.fill(tiny_skia::Color::WHITE);
        pixmap
    }

    fn dark(pixmap: &Pixmap, x: usize, y: usize) -> bool {
        pixmap.data()[4 * (y * 80 + x)] < 128
    }

    #[test]
    fn unit_letters_are_drawn_at_their_anchor() {
        let mut p = paper();
        text(&mut p, (10.0, 30.0), "H", 12.0, TextAnchor::Start, false);
        let rows: Vec<usize> = (0..40).filter(|y| (0..80).any(|x| dark(&p, x, *y))).collect();
        assert_eq!((rows.first(), rows.last()), (Some(&21), Some(&29)));
        let columns: Vec<usize> = (0..80).filter(|x| (0..40).any(|y| dark(&p, *x, y))).collect();
        assert_eq!((columns.first(), columns.last()), (Some(&11), Some(&15)));
        let mut end = paper();
        text(&mut end, (17.0, 30.0), "H", 12.0, TextAnchor::End, false);
        assert_eq!(p, end);
    }

    #[test]
    fn unit_turned_text_has_the_same_pixels_turned() {
        let (mut flat, mut turned) = (paper(), paper());
        text(&mut flat, (2.0, 20.0), "Fg7", 12.0, TextAnchor::Start, false);
        text(&mut turned, (20.0, 38.0), "Fg7", 12.0, TextAnchor::Start, true);
        for along in 0..30 {
            for down in -12i32..5 {
                let (a, b) = ((2 + along, (20 + down) as usize), ((20 + down) as usize, 37 - along));
                assert_eq!(dark(&flat, a.0, a.1), dark(&turned, b.0, b.1), "{along} {down}");
            }
        }
    }

    #[test]
    fn unit_minus_degree_and_unknown_letters_are_drawn() {
        let inked = |letter: char| glyph(letter).iter().flatten().sum::<f32>();
        assert!(inked('\u{2212}') > 4.0 && inked('\u{b0}') > 5.0 && inked('\u{4e2d}') > 10.0);
        assert_eq!(glyph('\u{2212}')[8][3], glyph('\u{2212}')[8][2]);
        assert_eq!(plain('é'), ['e']);
        assert_eq!(plain('\u{2026}').len(), 3);
    }
}

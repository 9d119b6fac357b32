//! Painter in SVG.

use maud::{Markup, html};
use schemas::Fault;

use super::scene::{BLACK, FigureScene, Ink, PaperPoint, Rect, SceneMark, TextAnchor};
use crate::{
    chart,
    palette::hex,
    png_file::{PixelFormat, data_url, encode},
};

/// Scene as an SVG file.
///
/// # Errors
/// Fails if its picture cannot be encoded.
pub fn document(scene: &FigureScene) -> Result<String, Fault> {
    let marks: Result<Vec<Markup>, Fault> = scene.marks.iter().enumerate().map(|(k, mark)| element(mark, k)).collect();
    let (width, height) = (px(scene.width), px(scene.height));
    let svg = html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(width) height=(height) viewBox=(format!("0 0 {width} {height}"))
            font-family="'Helvetica Neue', Helvetica, Arial, 'Noto Sans', 'DejaVu Sans', sans-serif"
            fill=(hex(BLACK.rgb)) {
            title { (clean(&scene.name)) }
            @if scene.paper { rect width=(width) height=(height) fill="#fff" {} }
            @for mark in marks? { "\n" (mark) }
            "\n"
        }
    };
    Ok(format!("{XML}{}\n", svg.into_string()))
}

/// The XML declaration.
pub const XML: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n";

/// Text without the characters that XML cannot represent.
pub fn clean(text: &str) -> String {
    text.chars().filter(|c| !c.is_control() && !matches!(c, '\u{fffe}' | '\u{ffff}')).collect()
}

fn element(mark: &SceneMark, index: usize) -> Result<Markup, Fault> {
    Ok(match mark {
        SceneMark::Fill { points, ink } => {
            html! { path d=(closed(points)) fill=(hex(ink.rgb)) fill-opacity=[opacity(*ink)] {} }
        }
        SceneMark::Stroke { lines, width, ink, within } => stroke(lines, *width, *ink, within.as_ref(), index),
        SceneMark::Disc { at, radius, fill, rim } => html! {
            circle cx=(px(at.0)) cy=(px(at.1)) r=(px(*radius)) fill=(hex(fill.rgb)) stroke=(hex(rim.rgb))
                stroke-width="1.5" {}
        },
        SceneMark::Picture { rect, size, pixels } => {
            let png = encode(&PixelFormat::Rgba, *size, pixels)?;
            html! {
                image x=(px(rect.x)) y=(px(rect.y)) width=(px(rect.w)) height=(px(rect.h)) preserveAspectRatio="none"
                    href=(data_url(&png)) {}
            }
        }
        SceneMark::Fade { rect, colours, upward } => fade(rect, colours, *upward, index),
        SceneMark::Text { at, text, size, anchor, turned } => self::text(*at, text, *size, *anchor, *turned),
    })
}

fn stroke(lines: &[Vec<PaperPoint>], width: f64, ink: Ink, within: Option<&Rect>, index: usize) -> Markup {
    let d: String = lines.iter().map(|line| chart::path(line.iter().copied().map(Some))).collect();
    let clip = within.map(|_| format!("url(#clip{index})"));
    html! {
        @if let Some(rect) = within {
            clipPath id=(format!("clip{index}")) {
                rect x=(px(rect.x)) y=(px(rect.y)) width=(px(rect.w)) height=(px(rect.h)) {}
            }
        }
        path d=(d) fill="none" stroke=(hex(ink.rgb)) stroke-opacity=[opacity(ink)] stroke-width=(px(width))
            stroke-linejoin="round" stroke-linecap=(if within.is_some() { "round" } else { "square" })
            clip-path=[clip] {}
    }
}

fn fade(rect: &Rect, colours: &[[u8; 3]], upward: bool, index: usize) -> Markup {
    let (x2, y1) = if upward { ("0", "1") } else { ("1", "0") };
    let steps = colours.len().saturating_sub(1).max(1) as f64;
    html! {
        linearGradient id=(format!("fade{index}")) x1="0" y1=(y1) x2=(x2) y2="0" {
            @for (k, colour) in colours.iter().enumerate() {
                stop offset=(px(k as f64 / steps)) stop-color=(hex(*colour)) {}
            }
        }
        rect x=(px(rect.x)) y=(px(rect.y)) width=(px(rect.w)) height=(px(rect.h)) fill=(format!("url(#fade{index})")) {}
    }
}

fn text(at: PaperPoint, text: &str, size: f64, anchor: TextAnchor, turned: bool) -> Markup {
    let anchor = match anchor {
        TextAnchor::Start => None,
        TextAnchor::Middle => Some("middle"),
        TextAnchor::End => Some("end"),
    };
    let (x, y) = (px(at.0), px(at.1));
    let turn = turned.then(|| format!("rotate(-90 {x} {y})"));
    html! { text x=(x) y=(y) font-size=(px(size)) text-anchor=[anchor] transform=[turn] { (clean(text)) } }
}

fn opacity(ink: Ink) -> Option<String> {
    (ink.opacity < 1.0).then(|| px(ink.opacity))
}

fn closed(points: &[PaperPoint]) -> String {
    format!("{}Z", chart::path(points.iter().copied().map(Some)))
}

/// Length, to a thousandth of its unit.
fn px(value: f64) -> String {
    let text = format!("{value:.3}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

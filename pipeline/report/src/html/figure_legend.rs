//! The legend of a figure as part of its SVG file: on the page it is text with styled boxes.

use std::collections::BTreeMap;

use figures::chart::px;
use maud::html;

use super::plain_text::plain_text;

/// Height of a row, and the width of a key and of a character at 11.5 px, in pixels.
const ROW: f64 = 18.0;
const KEY: f64 = 22.0;
const CHARACTER: f64 = 6.4;
/// Space between a key and its name, and between entries, in pixels.
const GAP: f64 = 6.0;
const BETWEEN: f64 = 18.0;

/// Entry of a legend: the classes of its key, and its name as plain text.
pub struct LegendEntry {
    classes: Vec<String>,
    name: String,
}

/// The entries of the legend in the markup between the start of a figure and its plot.
pub fn entries(markup: &str) -> Vec<LegendEntry> {
    let Some(legend) = markup.rfind("<p class=\"legend\"").and_then(|at| markup.get(at..)) else { return vec![] };
    let legend = legend.split("</p>").next().unwrap_or_default();
    let entry = |part: &str| {
        let (key, text) = part.split_once("</i>")?;
        let classes = key.split("class=\"").nth(1)?.split('"').next()?;
        let classes = classes.split_whitespace().map(str::to_owned).collect();
        let name = plain_text(text.split("</span>").next().unwrap_or_default());
        (!name.is_empty()).then_some(LegendEntry { classes, name })
    };
    legend.split("<span").skip(1).filter_map(entry).collect()
}

/// The legend below a figure `wide` px wide whose lower left corner is (`x`, `y`), and its height, in pixels. `rules`
/// are the selectors and declarations of the page.
pub fn drawn(entries: &[LegendEntry], (x, y, wide): (f64, f64, f64), rules: &[(&str, &str)]) -> (String, f64) {
    let (mut text, mut left, mut row) = ("<g>".to_owned(), x, 0.0);
    for entry in entries {
        let length = KEY + GAP + CHARACTER * entry.name.chars().count() as f64;
        if left > x && left + length > x + wide {
            (left, row) = (x, row + 1.0);
        }
        let middle = y + ROW * (row + 0.5);
        let name = html! { (entry.name) }.into_string();
        text += &key(&style(&entry.classes, rules), left, middle);
        text += &format!("<text x=\"{}\" y=\"{}\">{name}</text>", px(left + KEY + GAP), px(middle + 4.0));
        left += length + BETWEEN;
    }
    let height = if entries.is_empty() { 0.0 } else { ROW * (row + 1.0) };
    (text + "</g>", height)
}

/// The declarations for a key with these classes; later rules replace earlier ones.
fn style<'a>(classes: &[String], rules: &[(&'a str, &'a str)]) -> BTreeMap<&'a str, &'a str> {
    let mut found = BTreeMap::new();
    for (selectors, declarations) in rules {
        let applies = selectors.split(',').any(|selector| {
            let own = selector.trim().rsplit(' ').next().unwrap_or_default();
            own.starts_with(".key") && own.split('.').skip(1).all(|class| classes.iter().any(|c| c == class))
        });
        if applies {
            found.extend(declarations.split(';').filter_map(|d| d.split_once(':')).map(|(n, v)| (n.trim(), v.trim())));
        }
    }
    found
}

/// A key: a line, a box or a disc.
fn key(style: &BTreeMap<&str, &str>, x: f64, y: f64) -> String {
    let get = |name: &str| style.get(name).copied();
    let opacity = get("opacity").map_or(String::new(), |o| format!(" opacity=\"{o}\""));
    let color =
        |text: &str| text.split_whitespace().find(|w| w.starts_with('#') || w.starts_with("var(")).map(str::to_owned);
    let number = |text: &str| text.trim_end_matches("px").parse::<f64>().ok();
    let side = get("width").and_then(number).unwrap_or(KEY).min(KEY);
    let round = get("border-radius").is_some();
    let border = get("border").filter(|b| *b != "0");
    if get("height").and_then(number).is_some_and(|h| h > 0.0) {
        let fill = get("background").and_then(color).unwrap_or("none".to_owned());
        let edge = border.and_then(color).map_or(String::new(), |c| format!(" stroke=\"{c}\" stroke-width=\"1.5\""));
        let fill = format!("fill=\"{fill}\"{edge}{opacity}");
        return if round {
            format!("<circle cx=\"{}\" cy=\"{}\" r=\"5.5\" {fill}/>", px(x + 0.5 * KEY), px(y))
        } else {
            format!("<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"11\" {fill}/>", px(x), px(y - 5.5), px(side))
        };
    }
    let top = get("border-top").unwrap_or_default();
    let stroke = get("border-color").and_then(color).or(color(top)).unwrap_or("var(--soft)".to_owned());
    let width = get("border-top-width").and_then(number).or(top.split_whitespace().find_map(number)).unwrap_or(2.5);
    let pattern = get("border-top-style").unwrap_or(top);
    let dash = match pattern {
        p if p.contains("dotted") => " stroke-dasharray=\"2 3\"",
        p if p.contains("dashed") => " stroke-dasharray=\"6 4\"",
        _ => "",
    };
    format!(
        "<line x1=\"{}\" x2=\"{}\" y1=\"{y}\" y2=\"{y}\" stroke=\"{stroke}\" stroke-width=\"{width}\"{dash}/>",
        px(x),
        px(x + KEY),
        y = px(y)
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_a_legend_has_the_keys_and_names_of_the_page() {
        let markup = "<figure><h4>t</h4><p class=\"legend\"><span><i class=\"key before\"></i>raw &lt;b&gt;</span>\
                      <span><i class=\"key area\"></i>band</span></p>";
        let found = entries(markup);
        assert_eq!(found.len(), 2);
        let rules = [
            (".key", "width: 22px; height: 0; border-top: 2.5px solid var(--soft)"),
            (".key.before", "border-color: #d55e00"),
            (".key.area, .key.stretch", "height: 11px; border: 0; background: #0072b2; opacity: 0.25"),
        ];
        let (text, height) = drawn(&found, (0.0, 100.0, 300.0), &rules);
        assert!(
            text.contains("stroke=\"#d55e00\" stroke-width=\"2.5\"") && text.contains(">raw &lt;b&gt;</text>"),
            "{text}"
        );
        assert!(text.contains("fill=\"#0072b2\" opacity=\"0.25\""), "{text}");
        assert_eq!(height, ROW);
        assert_eq!(drawn(&found, (0.0, 0.0, 60.0), &rules).1, 2.0 * ROW, "a narrow figure has two rows");
        assert_eq!(drawn(&[], (0.0, 0.0, 60.0), &rules).1, 0.0);
    }
}

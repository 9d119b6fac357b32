//! The figures of a report as SVG files, for papers and slides.
//!
//! Each file has the styles and definitions that it uses, with the colours of the light theme as plain values, because
//! the programs in which papers and slides are written support neither variables nor media queries.

use std::collections::{BTreeMap, BTreeSet};

use figures::chart::px;

use super::{
    figure_legend::{self, LegendEntry},
    plain_text::{plain_text, unescaped},
};

/// A figure as a file.
#[derive(Clone, Debug)]
pub struct FigureFile {
    /// File name: a number in the order of the page, and its title.
    pub name: String,
    /// The document.
    pub svg: String,
    /// Text for screen readers, followed by the caption on the page.
    pub caption: String,
}

/// Maximum length of the words in a file name.
const NAME: usize = 60;

/// All figures of a page that [`report`](super::report) made.
pub fn figure_files(page: &str) -> Vec<FigureFile> {
    let text = without_comments(include_str!("style.css"));
    let sheet = StyleSheet::new(&text);
    let mut found: Vec<FigureFile> = vec![];
    let mut rest = page;
    while let Some(start) = rest.find("<svg") {
        rest = &rest[start..];
        let Some(end) = end_of(rest, "svg") else { break };
        let (figure, after) = rest.split_at(end);
        rest = after;
        let (opening, inner) = figure.split_once('>').unwrap_or((figure, ""));
        // Only figures have a text for screen readers; pictures in definitions and in table cells have none.
        let Some(label) = attribute(opening, "aria-label").filter(|_| opening.contains("role=\"img\"")) else {
            continue;
        };
        let label = unescaped(label);
        let title = label.split(": ").next().unwrap_or_default();
        let name = format!("{:03}-{}.svg", found.len() + 1, words(title));
        let caption = caption(after).map_or(label.clone(), |text| format!("{label}. {text}"));
        let before = &page[..page.len() - rest.len() - end];
        let markup = before.rfind("<figure").map_or("", |at| &before[at..]);
        let legend = if markup.contains("</figure>") { vec![] } else { figure_legend::entries(markup) };
        found.push(FigureFile { name, svg: document(page, (opening, inner), &legend, &sheet), caption });
    }
    found
}

/// A list of the figures with their captions, as Markdown.
pub fn figure_list(title: &str, figures: &[FigureFile]) -> String {
    let mut text = format!("# Figures of {}\n", escaped(title));
    for figure in figures {
        text += &format!("\n**{}** {}\n", figure.name, escaped(&figure.caption));
    }
    text
}

/// A string as Markdown: characters with a meaning are escaped.
fn escaped(text: &str) -> String {
    let special = |c: char| "\\`*_{}[]<>#|!".contains(c);
    text.chars().flat_map(|c| special(c).then_some('\\').into_iter().chain([c])).collect()
}

/// Position after the element with which `text` begins; `None` if the element is not closed.
fn end_of(text: &str, element: &str) -> Option<usize> {
    let (opening, closing) = (format!("<{element}"), format!("</{element}>"));
    let (mut at, mut depth) = (0, 0_usize);
    loop {
        let next = text.get(at..)?;
        let close = next.find(&closing)?;
        match next.find(&opening).filter(|open| *open < close) {
            Some(open) => {
                depth += 1;
                at += open + opening.len();
            }
            None => {
                depth = depth.checked_sub(1)?;
                at += close + closing.len();
                if depth == 0 {
                    return Some(at);
                }
            }
        }
    }
}

/// Value of an attribute of a tag, as written.
fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
    let start = tag.find(&format!(" {name}=\""))? + name.len() + 3;
    tag.get(start..)?.split('"').next()
}

/// The caption after a figure, without tags.
fn caption(after: &str) -> Option<String> {
    let end = after.find("</figure>")?;
    let within = &after[..end];
    if within.contains("<svg") {
        return None;
    }
    let start = within.find("<figcaption")?;
    let text = within[start..].split_once('>')?.1.split("</figcaption>").next()?;
    Some(plain_text(text)).filter(|text| !text.is_empty())
}

/// The first words of a title, for a file name.
fn words(label: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { ' ' };
    let text: String = label.chars().map(plain).collect();
    let mut name = String::new();
    for word in text.split_whitespace() {
        if name.len() + word.len() >= NAME {
            break;
        }
        if !name.is_empty() {
            name.push('-');
        }
        name += word;
    }
    if name.is_empty() { "figure".to_owned() } else { name }
}

/// A figure as a separate document.
fn document(page: &str, (opening, inner): (&str, &str), legend: &[LegendEntry], sheet: &StyleSheet<'_>) -> String {
    let figure = format!("{opening}>{inner}");
    let definitions: String = references(&figure)
        .into_iter()
        .filter(|id| !figure.contains(&format!("id=\"{id}\"")))
        .filter_map(|id| definition(page, id))
        .collect();
    // The size of the figure applies only to the page, so it is removed.
    let style = attribute(opening, "style").map(|style| format!(" style=\"{style}\"")).unwrap_or_default();
    let opening = opening.replacen(&style, "", 1);
    let view = attribute(&opening, "viewBox").unwrap_or_default();
    let sides: Vec<f64> = view.split(' ').filter_map(|side| side.parse().ok()).collect();
    let (mut size, mut paper, mut keys) = (String::new(), String::new(), String::new());
    let mut opening = opening.clone();
    if let [x, y, wide, high] = sides[..] {
        let (drawn, more) = figure_legend::drawn(legend, (x + 8.0, y + high, wide - 16.0), &sheet.rules);
        let (wide, high) = (px(wide), px(high + more));
        opening = opening.replacen(view, &format!("{} {} {wide} {high}", px(x), px(y)), 1);
        size = format!(" width=\"{wide}\" height=\"{high}\"");
        paper = format!("<rect x=\"{}\" y=\"{}\" width=\"{wide}\" height=\"{high}\" fill=\"#fff\"/>", px(x), px(y));
        keys = drawn;
    }
    let rules = sheet.rules_of(&format!("{figure}{definitions}"));
    let text = format!(
        "{opening} xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\"{size}>\n\
         <style>{rules}</style>\n<defs>{definitions}</defs>\n{paper}{keys}{inner}\n"
    );
    sheet.resolved(&text)
}

/// The names in `href="#NAME"` and `url(#NAME)`.
fn references(figure: &str) -> BTreeSet<&str> {
    let ends = |c: char| !(c.is_alphanumeric() || c == '-' || c == '_');
    let after = |mark: &str| figure.match_indices(mark).map(|(at, mark)| at + mark.len()).collect::<Vec<_>>();
    let starts = after("href=\"#").into_iter().chain(after("url(#"));
    starts.filter_map(|at| figure.get(at..)?.split(ends).next()).filter(|id| !id.is_empty()).collect()
}

/// The element of the page that has this id.
fn definition<'a>(page: &'a str, id: &str) -> Option<&'a str> {
    let at = page.find(&format!(" id=\"{id}\""))?;
    let start = page[..at].rfind('<')?;
    let text = &page[start..];
    let element: &str = text.get(1..)?.split(|c: char| !c.is_ascii_alphanumeric()).next()?;
    text.get(..end_of(text, element)?)
}

/// The style sheet of the page for the light theme.
struct StyleSheet<'a> {
    /// Selector and declarations of each rule.
    rules: Vec<(&'a str, &'a str)>,
    variables: BTreeMap<&'a str, &'a str>,
}

/// A style sheet without its comments.
fn without_comments(text: &str) -> String {
    let mut parts = text.split("/*");
    let first = parts.next().unwrap_or_default();
    let rest = parts.filter_map(|part| part.split_once("*/")).map(|(_, after)| after);
    std::iter::once(first).chain(rest).collect()
}

impl<'a> StyleSheet<'a> {
    fn new(text: &'a str) -> StyleSheet<'a> {
        let mut rules = vec![];
        let mut rest = text;
        while let Some((selector, after)) = rest.split_once('{') {
            let selector = selector.trim();
            if selector.starts_with('@') {
                rest = after_block(after);
                continue;
            }
            let Some((declarations, after)) = after.split_once('}') else { break };
            rules.push((selector, declarations.trim()));
            rest = after;
        }
        let root = rules.iter().find(|(selector, _)| *selector == ":root").map_or("", |(_, text)| text);
        let variables =
            root.split(';').filter_map(|one| one.split_once(':')).map(|(n, v)| (n.trim(), v.trim())).collect();
        StyleSheet { rules, variables }
    }

    /// The rules for SVG elements and for the classes of a figure.
    fn rules_of(&self, figure: &str) -> String {
        let classes: BTreeSet<&str> = figure
            .split(" class=\"")
            .skip(1)
            .filter_map(|t| t.split('"').next())
            .flat_map(str::split_whitespace)
            .collect();
        let applies = |selector: &str| {
            selector.split(',').any(|one| {
                let names =
                    one.split('.').skip(1).filter_map(|t| t.split(|c: char| !(c.is_alphanumeric() || c == '-')).next());
                let names: Vec<&str> = names.collect();
                let is_svg = one.trim().split([' ', '.', ':']).next() == Some("svg");
                (is_svg || !names.is_empty()) && names.iter().all(|name| classes.contains(name))
            })
        };
        let mut text = String::new();
        for (selector, declarations) in self.rules.iter().filter(|(selector, _)| applies(selector)) {
            // On the page, a figure is as wide as its column.
            let kept: Vec<&str> = declarations
                .split(';')
                .map(str::trim)
                .filter(|d| {
                    !d.is_empty()
                        && !["width", "height", "max-width", "min-width"]
                            .iter()
                            .any(|k| d.starts_with(&format!("{k}:")))
                })
                .collect();
            text += &format!("{selector} {{ {} }}\n", kept.join("; "));
        }
        text
    }

    /// The text with each variable replaced by its value.
    fn resolved(&self, text: &str) -> String {
        self.variables.iter().fold(text.to_owned(), |text, (name, value)| text.replace(&format!("var({name})"), value))
    }
}

/// The text after a block whose opening brace was read.
fn after_block(text: &str) -> &str {
    let mut depth = 1_usize;
    for (at, c) in text.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return &text[at + 1..];
        }
    }
    ""
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const PAGE: &str = "\
        <svg class=\"defs\" aria-hidden=\"true\">\
        <defs><g id=\"m1\"><rect fill=\"var(--ink)\"></rect></g></defs></svg>\
        <figure><h3>x</h3>\
        <svg viewBox=\"0 0 10 5\" role=\"img\" aria-label=\"a &lt;b&gt; ../c\" style=\"max-width: 3px\">\
        <use href=\"#m1\"></use><svg><text class=\"name\">n</text></svg></svg>\
        <figcaption>Two <b>words</b> &amp; more.</figcaption></figure>\
        <td><svg class=\"whisker\" aria-hidden=\"true\"></svg></td>";

    #[test]
    fn unit_a_figure_is_complete_without_its_page() {
        let found = figure_files(PAGE);
        assert_eq!(found.len(), 1);
        let one = &found[0];
        assert_eq!(one.name, "001-a-b-c.svg");
        assert_eq!(one.caption, "a <b> ../c. Two words & more.");
        assert!(one.svg.contains("<g id=\"m1\">") && one.svg.contains("width=\"10\" height=\"5\""), "{}", one.svg);
        assert!(
            !one.svg.contains("var(") && !one.svg.contains("@media") && !one.svg.contains("max-width"),
            "{}",
            one.svg
        );
        assert_eq!(one.svg.matches("<svg").count(), one.svg.matches("</svg>").count());
        assert!(figure_list("p", &found).contains("a \\<b\\> ../c. Two words & more."));
    }
}

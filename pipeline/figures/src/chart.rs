//! One plot: lines and bands over two axes, as SVG.

use maud::{Markup, html};

use super::ticks::{self, AxisTick};

const WIDTH: f64 = 940.0;
/// Width of each chart in a row of two; the letters keep their size.
const HALF: f64 = 466.0;
/// Minimum width of the labels of the vertical axis, and width of a digit.
const LEFT: f64 = 64.0;
const DIGIT: f64 = 6.6;
const RIGHT: f64 = 14.0;
const TOP: f64 = 8.0;
const BOTTOM: f64 = 40.0;

/// Label, scaling and range of an axis of a plot.
#[derive(Clone, Debug, Default)]
pub struct ChartAxis {
    /// Quantity and unit.
    pub label: String,
    /// Whether the axis is logarithmic.
    pub log: bool,
    /// Ends of the axis; `None` for the range of the data.
    pub range: Option<(f64, f64)>,
}

impl ChartAxis {
    /// Linear axis.
    pub fn new(label: impl Into<String>) -> ChartAxis {
        ChartAxis { label: label.into(), ..ChartAxis::default() }
    }

    /// The same axis with a logarithmic scale.
    pub fn log(self) -> ChartAxis {
        ChartAxis { log: true, ..self }
    }
}

/// Line through points; NaN interrupts it.
#[derive(Clone, Debug)]
pub struct ChartLine {
    /// Name.
    pub name: String,
    /// Class in the style sheet, which gives the colour.
    pub class: &'static str,
    /// Points.
    pub points: Vec<(f64, f64)>,
}

/// Area between two curves.
#[derive(Clone, Debug)]
pub struct ChartBand {
    /// Name.
    pub name: String,
    /// Abscissa, lower and upper ordinate.
    pub points: Vec<(f64, f64, f64)>,
}

/// A plot.
#[derive(Clone, Debug, Default)]
pub struct LineChart {
    /// Title.
    pub title: String,
    /// Caption.
    pub caption: String,
    /// Horizontal axis.
    pub x: ChartAxis,
    /// Vertical axis.
    pub y: ChartAxis,
    /// Areas, below the lines.
    pub bands: Vec<ChartBand>,
    /// Lines, the first at the bottom.
    pub lines: Vec<ChartLine>,
    /// Reference values: name and value.
    pub levels: Vec<(String, f64)>,
    /// Highlighted interval of the horizontal axis: name and ends.
    pub stretch: Option<(String, f64, f64)>,
    /// Highlighted points: name and coordinates.
    pub marks: Vec<(String, f64, f64)>,
    /// Height of the picture, in pixels.
    pub height: f64,
    /// Whether the chart has half the width, for a row of two charts.
    pub half: bool,
}

/// Axis of the picture: data range and pixel range.
struct PixelAxis {
    low: f64,
    high: f64,
    log: bool,
    from_px: f64,
    to_px: f64,
}

impl PixelAxis {
    fn at(&self, value: f64) -> f64 {
        let part = if self.log {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        // Coordinates far outside are clipped by the frame; huge coordinates break some viewers.
        self.from_px + part.clamp(-2.0, 3.0) * (self.to_px - self.from_px)
    }

    fn ticks(&self, most: usize) -> Vec<AxisTick> {
        if self.log { ticks::logarithmic(self.low, self.high) } else { ticks::linear(self.low, self.high, most) }
    }
}

impl LineChart {
    /// Plot with title, legend and caption; `None` without data.
    pub fn draw(&self) -> Option<Markup> {
        let (x, y) = self.sides()?;
        Some(html! {
            figure {
                h4 { (self.title) }
                (self.legend())
                (self.picture(&x, &y, None))
                figcaption { (self.caption) }
            }
        })
    }

    /// Plot as a part of a figure, with its title, legend and caption; `None` without data.
    pub fn part(&self) -> Option<Markup> {
        let (x, y) = self.sides()?;
        Some(html! {
            div { h5 { (self.title) } (self.legend()) (self.picture(&x, &y, None)) p.caption { (self.caption) } }
        })
    }

    /// Plot as a separate file with its style sheet; `None` without data.
    pub fn file(&self, style: &str) -> Option<Markup> {
        let (x, y) = self.sides()?;
        Some(self.picture(&x, &y, Some(style)))
    }

    /// Both axes; the labels of the vertical axis determine the left margin.
    fn sides(&self) -> Option<(PixelAxis, PixelAxis)> {
        let y = self.side(&self.y, (self.height - BOTTOM, TOP), false)?;
        let longest = y.ticks(6).iter().map(|tick| tick.label.chars().count()).max().unwrap_or(0);
        let left_px = LEFT.max(30.0 + DIGIT * longest as f64);
        let x = self.side(&self.x, (left_px, self.width() - RIGHT), true)?;
        Some((x, y))
    }

    fn width(&self) -> f64 {
        if self.half { HALF } else { WIDTH }
    }

    fn picture(&self, x: &PixelAxis, y: &PixelAxis, style: Option<&str>) -> Markup {
        let label = format!("{}: {} over {}", self.title, self.y.label, self.x.label);
        let left = x.from_px;
        let (wide, high) = (self.width() - left - RIGHT, self.height - TOP - BOTTOM);
        // The script of the page needs these values to zoom.
        let data = |axis: &PixelAxis| format!("{} {} {}", axis.low, axis.high, u8::from(axis.log));
        html! {
            svg.plot data-x=(data(x)) data-y=(data(y)) data-x-name=(self.x.label) data-y-name=(self.y.label)
                xmlns=[style.map(|_| "http://www.w3.org/2000/svg")]
                viewBox=(format!("0 0 {} {}", self.width(), self.height)) role="img" aria-label=(label) {
                @if let Some(style) = style { style { (style) } }
                (self.grid(x, y))
                svg x=(left) y=(TOP) width=(wide) height=(high) viewBox=(format!("{left} {TOP} {wide} {high}"))
                    preserveAspectRatio="none" {
                    (self.inside(x, y))
                }
                rect class="frame" x=(left) y=(TOP) width=(wide) height=(high) {}
                (self.marked(x, y))
            }
        }
    }

    fn marked(&self, x: &PixelAxis, y: &PixelAxis) -> Markup {
        let places = self.marks.iter().filter_map(|(name, at, value)| Some((name, spot(x, y, *at, *value)?)));
        html! {
            @for (name, (left, top)) in places {
                // The label is next to the mark, on the side with more space.
                @let (by, anchor) = if left < 0.5 * self.width() { (12.0, "start") } else { (-12.0, "end") };
                circle.mark cx=(px(left)) cy=(px(top)) r="5" {}
                text.mark x=(px(left + by)) y=(px(top - 8.0)) text-anchor=(anchor) { (name) }
            }
        }
    }

    fn side(&self, dim: &ChartAxis, (from_px, to_px): (f64, f64), across: bool) -> Option<PixelAxis> {
        let side = |low, high| PixelAxis { low, high, log: dim.log, from_px, to_px };
        if let Some((low, high)) = dim.range {
            return (low < high).then(|| side(low, high));
        }
        let of_lines = self.lines.iter().flat_map(|l| l.points.iter()).map(|p| if across { p.0 } else { p.1 });
        let of_bands =
            self.bands.iter().flat_map(|b| b.points.iter()).flat_map(|p| if across { [p.0; 2] } else { [p.1, p.2] });
        let of_levels = self.levels.iter().filter(|_| !across).map(|l| l.1);
        let usable = |v: &f64| v.is_finite() && (!dim.log || *v > 0.0);
        let ends = of_lines.chain(of_bands).chain(of_levels).filter(usable);
        let (low, high) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        if low > high {
            return None;
        }
        let (low, high) = padded(low, high, dim.log, if across { 0.0 } else { 0.05 });
        Some(side(low, high))
    }

    fn legend(&self) -> Markup {
        html! {
            p.legend {
                @for line in &self.lines {
                    @if !line.name.is_empty() { span { i class=(format!("key {}", line.class)) {} (line.name) } }
                }
                @for band in &self.bands { span { i class="key area" {} (band.name) } }
                @for (name, _) in self.levels.iter().filter(|l| !l.0.is_empty()) {
                    span { i class="key level" {} (name) }
                }
                @if let Some((name, ..)) = &self.stretch { span { i class="key stretch" {} (name) } }
            }
        }
    }

    fn grid(&self, x: &PixelAxis, y: &PixelAxis) -> Markup {
        let (bottom, right, left) = (self.height - BOTTOM, self.width() - RIGHT, x.from_px);
        let middle = 0.5 * (TOP + bottom);
        html! { g class="ticks" {
            @for tick in x.ticks(if self.half { 5 } else { 9 }) {
                @let at = px(x.at(tick.at));
                line.grid x1=(at) x2=(at) y1=(TOP) y2=(bottom) {}
                text.tick x=(at) y=(bottom + 16.0) text-anchor="middle" { (tick.label) }
            }
            @for tick in y.ticks(6) {
                @let at = y.at(tick.at);
                line.grid x1=(left) x2=(right) y1=(px(at)) y2=(px(at)) {}
                text.tick x=(left - 7.0) y=(px(at + 4.0)) text-anchor="end" { (tick.label) }
            }
            text.name x=(px(0.5 * (left + right))) y=(self.height - 5.0) text-anchor="middle" { (self.x.label) }
            text.name transform=(format!("translate(13 {}) rotate(-90)", px(middle))) text-anchor="middle" {
                (self.y.label)
            }
        } }
    }

    fn inside(&self, x: &PixelAxis, y: &PixelAxis) -> Markup {
        let left = x.from_px;
        html! {
            @if let Some((_, from, to)) = &self.stretch {
                rect.stretch x=(px(x.at(*from))) width=(px(x.at(*to) - x.at(*from))) y=(TOP)
                    height=(self.height - TOP - BOTTOM) {}
            }
            @for band in &self.bands { path.area d=(area(band, x, y)) {} }
            @if !y.log && y.low < 0.0 && y.high > 0.0 {
                line.zero x1=(left) x2=(self.width() - RIGHT) y1=(px(y.at(0.0))) y2=(px(y.at(0.0))) {}
            }
            @for (_, height) in &self.levels {
                line.level x1=(left) x2=(self.width() - RIGHT) y1=(px(y.at(*height))) y2=(px(y.at(*height))) {}
            }
            @for line in &self.lines {
                path class=(format!("line {}", line.class)) data-name=(line.name)
                    d=(path(line.points.iter().map(|p| spot(x, y, p.0, p.1)))) {}
            }
        }
    }
}

/// Ends of an axis with a margin, never equal.
fn padded(low: f64, high: f64, log: bool, margin: f64) -> (f64, f64) {
    if log {
        let factor = (high / low).powf(margin).max(1.0 + 1e-6);
        return (low / factor, high * factor);
    }
    let span = high - low;
    if span <= 1e-12 * high.abs().max(low.abs()) {
        let around = if high == 0.0 { 1.0 } else { 0.1 * high.abs() };
        return (low - around, high + around);
    }
    (low - margin * span, high + margin * span)
}

/// Position in the picture; `None` if undefined.
fn spot(x: &PixelAxis, y: &PixelAxis, at: f64, value: f64) -> Option<(f64, f64)> {
    let there = at.is_finite() && value.is_finite() && !(x.log && at <= 0.0) && !(y.log && value <= 0.0);
    there.then(|| (x.at(at), y.at(value)))
}

/// Length in the picture, to a tenth of a px.
pub fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    let short = text.strip_suffix(".0").unwrap_or(&text);
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

/// Path through `spots`, broken at missing points.
pub fn path(spots: impl Iterator<Item = Option<(f64, f64)>>) -> String {
    let mut out = String::new();
    let mut pen = 'M';
    for spot in spots {
        let Some((x, y)) = spot else {
            pen = 'M';
            continue;
        };
        out.push(pen);
        out.push_str(&px(x));
        out.push(' ');
        out.push_str(&px(y));
        pen = 'L';
    }
    out
}

/// Outline of a band: one closed shape for each interval without a gap.
fn area(band: &ChartBand, x: &PixelAxis, y: &PixelAxis) -> String {
    let whole = |p: &(f64, f64, f64)| Some((spot(x, y, p.0, p.1)?, spot(x, y, p.0, p.2)?));
    let spots: Vec<Option<_>> = band.points.iter().map(whole).collect();
    let mut out = String::new();
    for part in spots.split(Option::is_none).filter(|p| p.len() > 1) {
        let there = part.iter().flatten();
        let around = there.clone().map(|p| p.0).chain(there.rev().map(|p| p.1));
        out.push_str(&path(around.map(Some)));
        out.push('Z');
    }
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn chart(points: Vec<(f64, f64)>) -> LineChart {
        let lines = vec![ChartLine { name: "a & b".into(), class: "after", points }];
        LineChart {
            x: ChartAxis::new("time, min"),
            y: ChartAxis::new("error, nT"),
            lines,
            height: 240.0,
            ..LineChart::default()
        }
    }

    #[test]
    fn unit_a_plot_without_a_finite_value_is_none() {
        assert!(chart(vec![(0.0, f64::NAN)]).draw().is_none());
        assert!(chart(vec![]).draw().is_none());
        let log = LineChart { y: ChartAxis::new("density").log(), ..chart(vec![(1.0, 0.0), (2.0, -1.0)]) };
        assert!(log.draw().is_none());
    }

    #[test]
    fn unit_a_gap_breaks_the_line_and_text_is_escaped() {
        let drawn =
            chart(vec![(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 1.0), (4.0, 5.0)]).draw().unwrap().into_string();
        let line = drawn.split("class=\"line after\"").nth(1).unwrap();
        let d = line.split(" d=\"").nth(1).and_then(|s| s.split('"').next()).unwrap();
        assert_eq!(d.matches('M').count(), 2);
        assert_eq!(d.matches('L').count(), 2);
        assert!(drawn.contains("a &amp; b"));
    }

    #[test]
    fn unit_axis_surrounds_a_single_value() {
        assert_eq!(padded(5.0, 5.0, false, 0.05), (4.5, 5.5));
        assert_eq!(padded(0.0, 0.0, false, 0.05), (-1.0, 1.0));
        assert!(chart(vec![(0.0, 3.0), (1.0, 3.0)]).draw().is_some());
    }

    #[test]
    fn bug_the_label_of_the_axis_overlapped_wide_tick_labels() {
        let left = |height: f64| chart(vec![(0.0, -height), (1.0, height)]).sides().unwrap().0.from_px;
        assert_eq!(left(50.0), LEFT);
        // "\u{2212}1000000" has 8 characters; the rotated label ends at 17 px.
        assert!(left(1e6) > 7.0 + 8.0 * DIGIT + 17.0);
    }

    #[test]
    fn unit_logarithmic_axis_spaces_decades_evenly() {
        let side = PixelAxis { low: 1.0, high: 100.0, log: true, from_px: 0.0, to_px: 200.0 };
        assert!((side.at(10.0) - 100.0).abs() < 1e-9);
        assert_eq!(px(-0.04), "0");
        assert_eq!(px(12.34), "12.3");
    }

    #[test]
    fn unit_band_has_one_shape_per_interval() {
        let side = |to_px| PixelAxis { low: 0.0, high: 10.0, log: false, from_px: 0.0, to_px };
        let nan = f64::NAN;
        let points = vec![(0.0, 1.0, 2.0), (1.0, 1.0, 2.0), (2.0, nan, nan), (3.0, 0.0, 1.0), (4.0, 0.0, 1.0)];
        let drawn = area(&ChartBand { name: String::new(), points }, &side(10.0), &side(10.0));
        assert_eq!(drawn, "M0 1L1 1L1 2L0 2ZM3 0L4 0L4 1L3 1Z");
    }
}

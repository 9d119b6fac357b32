//! Faulty samples of a flight over time: a row for each column.

use figures::{chart::px, ticks};
use intake::checks::QualityFigure;
use maud::{Markup, html};

/// Timeline of one column over a flight, times in seconds.
#[derive(Clone, Debug, Default)]
pub struct TimelineLane {
    /// Name.
    pub name: String,
    /// First and last time of each line.
    pub lines: Vec<(f64, f64)>,
    /// Gaps in the samples.
    pub gaps: Vec<(f64, f64)>,
    /// Faults, each with its first and last time.
    pub parts: Vec<(QualityFigure, f64, f64)>,
}

/// Timeline of the columns of a flight.
pub struct Timeline<'a> {
    /// The flight.
    pub flight: &'a str,
    /// Columns.
    pub lanes: Vec<TimelineLane>,
    /// Number of hidden columns.
    pub hidden: usize,
}

const WIDTH: f64 = 940.0;
const LEFT: f64 = 150.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 6.0;
const LANE: f64 = 18.0;
const BOTTOM: f64 = 40.0;
/// Height of a bar.
const BAR: f64 = 11.0;
/// Minimum width of a bar.
const LEAST: f64 = 1.6;

impl Timeline<'_> {
    /// The picture; `None` without samples.
    pub fn draw(&self) -> Option<Markup> {
        let times = || self.lanes.iter().flat_map(|lane| &lane.lines);
        let start = times().map(|t| t.0).fold(f64::INFINITY, f64::min);
        let end = times().map(|t| t.1).fold(f64::NEG_INFINITY, f64::max);
        if end <= start {
            return None;
        }
        let across = |t: f64| LEFT + (t - start) / (end - start) * (WIDTH - LEFT - RIGHT);
        let height = TOP + LANE * self.lanes.len() as f64 + BOTTOM;
        let bottom = height - BOTTOM;
        let occurs = |figure: QualityFigure| self.lanes.iter().any(|l| l.parts.iter().any(|p| p.0 == figure));
        let kinds: Vec<(QualityFigure, &str, &str)> = KINDS.into_iter().filter(|kind| occurs(kind.0)).collect();
        let gaps = self.lanes.iter().any(|lane| !lane.gaps.is_empty());
        let title = format!("Flight {}: flagged samples over time", self.flight);
        Some(html! {
            figure {
                h3 { (title) }
                p.legend {
                    span { i class="key lane" {} "samples" }
                    @if gaps { span { i class="key gap" {} "gap" } }
                    @for (_, class, name) in &kinds { span { i class=(format!("key {class}")) {} (name) } }
                }
                svg.timeline viewBox=(format!("0 0 {WIDTH} {height}")) role="img" aria-label=(title) {
                    @for tick in ticks::linear(0.0, (end - start) / 60.0, 9) {
                        @let x = px(across(start + 60.0 * tick.at));
                        line.grid x1=(x) x2=(x) y1=(TOP) y2=(px(bottom)) {}
                        text.tick x=(x) y=(px(bottom + 16.0)) text-anchor="middle" { (tick.label) }
                    }
                    @for (i, lane) in self.lanes.iter().enumerate() {
                        @let y = TOP + LANE * i as f64;
                        text.name x=(px(LEFT - 8.0)) y=(px(y + 0.5 * LANE + 4.0)) text-anchor="end" {
                            (shortened(&lane.name))
                        }
                        path.lane d=(bars(&lane.lines, &across, y)) {}
                        path.gap d=(bars(&lane.gaps, &across, y)) {}
                        @for (figure, class, _) in &kinds {
                            @let parts: Vec<(f64, f64)> =
                                lane.parts.iter().filter(|p| p.0 == *figure).map(|p| (p.1, p.2)).collect();
                            @if !parts.is_empty() { path class=(class) d=(bars(&parts, &across, y)) {} }
                        }
                    }
                    text.name x=(px(0.5 * (LEFT + WIDTH - RIGHT))) y=(px(height - 5.0)) text-anchor="middle" {
                        "time since the start of the flight, min"
                    }
                }
                @if self.hidden > 0 { figcaption { (self.hidden) " more flagged columns are in the table." } }
            }
        })
    }
}

/// Quality figures that are drawn, each with its class in the style sheet and its name. The narrowest marks are drawn
/// last.
const KINDS: [(QualityFigure, &str, &str); 4] = [
    (QualityFigure::Saturation, "saturated", "saturated"),
    (QualityFigure::Stuck, "stuck", "stuck"),
    (QualityFigure::Dropouts, "missing", "missing values"),
    (QualityFigure::Spikes, "spike", "spike"),
];

/// A name shortened to the available width.
fn shortened(name: &str) -> String {
    const MOST: usize = 20;
    if name.chars().count() <= MOST {
        return name.to_owned();
    }
    name.chars().take(MOST - 1).chain(['\u{2026}']).collect()
}

/// Bars from first to last time; bars that touch on the picture are merged.
fn bars(times: &[(f64, f64)], across: &dyn Fn(f64) -> f64, y: f64) -> String {
    let mut spans: Vec<(f64, f64)> =
        times.iter().map(|(a, b)| (across(*a), across(*b).max(across(*a) + LEAST))).collect();
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut joined: Vec<(f64, f64)> = vec![];
    for (from, to) in spans {
        match joined.last_mut() {
            Some(last) if from <= last.1 + 0.2 => last.1 = last.1.max(to),
            _ => joined.push((from, to)),
        }
    }
    let (top, bottom) = (px(y + 0.5 * (LANE - BAR)), px(y + 0.5 * (LANE + BAR)));
    joined.iter().map(|(a, b)| format!("M{} {top}H{}V{bottom}H{}Z", px(*a), px(*b), px(*a))).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_touching_bars_are_merged_and_short_bars_are_visible() {
        let across = |t: f64| 10.0 * t;
        assert_eq!(bars(&[(2.0, 3.0), (0.0, 1.0), (1.0, 1.5)], &across, 0.0), "M0 3.5H15V14.5H0ZM20 3.5H30V14.5H20Z");
        assert_eq!(bars(&[(1.0, 1.0)], &across, 0.0), "M10 3.5H11.6V14.5H10Z");
    }

    #[test]
    fn unit_each_part_is_in_the_lane_of_its_column() {
        let lane = TimelineLane {
            name: "mag_1_uc".into(),
            lines: vec![(0.0, 600.0)],
            gaps: vec![(100.0, 130.0)],
            parts: vec![(QualityFigure::Stuck, 300.0, 360.0)],
        };
        let text = Timeline { flight: "7", lanes: vec![lane], hidden: 0 }.draw().unwrap().into_string();
        for part in ["Flight 7", "class=\"stuck\"", "class=\"gap\"", "mag_1_uc", "key stuck"] {
            assert!(text.contains(part), "{part} in {text}");
        }
        // The bar begins at half of the width between the margins and spans a tenth of this width.
        assert!(text.contains("M538 9.5H615.6"), "{text}");
        assert!(!text.contains("key spike"));
        assert!(Timeline { flight: "7", lanes: vec![], hidden: 0 }.draw().is_none());
    }
}

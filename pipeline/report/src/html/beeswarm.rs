//! Beeswarm plot of contributions to predictions, as in the SHAP package: a row for each input, a dot for each sample.
//! The position of a dot is its contribution; its colour is the input's value.

use std::collections::BTreeMap;

use figures::{chart::px, ticks};
use maud::{Markup, html};

/// Maximum number of groups, and of dots per group.
const GROUPS: usize = 20;
const DOTS: usize = 400;
/// Dimensions of the picture.
const LABEL: f64 = 210.0;
const WIDTH: f64 = 720.0;
const BAR: f64 = 70.0;
const ROW: f64 = 28.0;
const AXIS: f64 = 36.0;
const RADIUS: f64 = 2.4;
/// Number of bins of a row's range; the dots of a bin are drawn one above the other.
const BINS: f64 = 100.0;
/// Fraction of the input values beyond each end of the colour scale.
const BEYOND: f64 = 0.05;
/// The colours from low to high values: red and blue of one lightness, as in the SHAP package.
const COLOURS: [[f64; 3]; 6] = [
    [0.0, 139.0, 251.0],
    [64.0, 122.0, 251.0],
    [164.0, 96.0, 230.0],
    [220.0, 58.0, 190.0],
    [251.0, 0.0, 138.0],
    [255.0, 0.0, 81.0],
];
/// Colour of dots without a value on the colour scale.
const GREY: &str = "#777777";

/// The samples of one model, by group: the contribution, and the value of the input, NaN for a group of several inputs.
#[derive(Default)]
pub struct BeeswarmSamples {
    groups: BTreeMap<String, Vec<(f64, f64)>>,
}

impl BeeswarmSamples {
    /// Adds the samples of a group on a line; samples without a contribution are skipped.
    pub fn add(&mut self, group: &str, parts: &[f64], inputs: &[f64]) {
        let samples = parts.iter().copied().zip(inputs.iter().copied()).filter(|(part, _)| part.is_finite());
        self.groups.entry(group.to_owned()).or_default().extend(samples);
    }

    /// The picture; `None` without samples.
    pub fn drawn(&self, title: &str, unit: &str) -> Option<Markup> {
        let mut groups: Vec<(&String, &Vec<(f64, f64)>)> = self.groups.iter().filter(|(_, s)| !s.is_empty()).collect();
        groups.sort_by(|a, b| size(b.1).total_cmp(&size(a.1)).then_with(|| a.0.cmp(b.0)));
        let more = groups.len().saturating_sub(GROUPS);
        groups.truncate(GROUPS);
        let parts = || groups.iter().flat_map(|(_, samples)| samples.iter().map(|(part, _)| *part));
        let (low, high) = (parts().fold(0.0, f64::min), parts().fold(0.0, f64::max));
        if groups.is_empty() {
            return None;
        }
        let span = if high > low { high - low } else { 1.0 };
        let at = |part: f64| LABEL + (WIDTH - LABEL - BAR) * (part - low) / span;
        let bottom = ROW * groups.len() as f64;
        let height = bottom + AXIS;
        let axis = ticks::linear(low, high, 6);
        let label = format!("contribution to the prediction, {unit}");
        let words = format!(
            "{title}: one dot per sample, placed by its contribution to the prediction and coloured by the value of \
             the input"
        );
        Some(html! {
            figure {
                figcaption { strong { (title) } " (one dot per sample)" }
                svg.intervals viewBox=(format!("0 0 {WIDTH} {}", px(height))) role="img" aria-label=(words)
                    style="max-width: 720px" {
                    line x1=(px(at(0.0))) x2=(px(at(0.0))) y1="0" y2=(px(bottom)) stroke="var(--ink)"
                        stroke-opacity="0.4" {}
                    @for (row, (name, samples)) in groups.iter().enumerate() {
                        @let middle = ROW * (row as f64 + 0.5);
                        text.value x=(px(LABEL - 8.0)) y=(px(middle + 4.0)) text-anchor="end" font-size="12" { (name) }
                        @for dot in dots(samples) {
                            circle cx=(px(at(dot.part))) cy=(px(middle - 0.42 * ROW * dot.up)) r=(px(RADIUS))
                                fill=(dot.colour) fill-opacity="0.85" {}
                        }
                    }
                    @for tick in &axis {
                        line x1=(px(at(tick.at))) x2=(px(at(tick.at))) y1=(px(bottom)) y2=(px(bottom + 4.0))
                            stroke="var(--ink)" {}
                        text.value x=(px(at(tick.at))) y=(px(bottom + 16.0)) text-anchor="middle" font-size="11" {
                            (tick.label)
                        }
                    }
                    text.value x=(px(0.5 * (LABEL + WIDTH - BAR))) y=(px(bottom + 31.0)) text-anchor="middle"
                        font-size="12" {
                        (label)
                    }
                    (colour_bar(bottom))
                }
                @if more > 0 { p.note { (more) " less important groups are not shown." } }
            }
        })
    }
}

/// The mean absolute contribution.
fn size(samples: &[(f64, f64)]) -> f64 {
    samples.iter().map(|(part, _)| part.abs()).sum::<f64>() / samples.len().max(1) as f64
}

/// Plot point: its contribution, its vertical offset from -1 to 1, its colour.
struct BeeswarmDot {
    part: f64,
    up: f64,
    colour: String,
}

/// The dots of a group; dots of similar contribution lie alternately above and below each other.
fn dots(samples: &[(f64, f64)]) -> Vec<BeeswarmDot> {
    let shown = samples.len().min(DOTS);
    let samples: Vec<(f64, f64)> = (0..shown).map(|k| samples[(2 * k + 1) * samples.len() / (2 * shown)]).collect();
    let low = samples.iter().fold(f64::INFINITY, |low, (part, _)| low.min(*part));
    let high = samples.iter().fold(f64::NEG_INFINITY, |high, (part, _)| high.max(*part));
    let bin = |part: f64| (BINS * (part - low) / (high - low + 1e-8)).round() as i64;
    let mut layers: BTreeMap<i64, i64> = BTreeMap::new();
    let mut up = vec![];
    for (part, _) in &samples {
        let layer = layers.entry(bin(*part)).or_default();
        // 0, 1, -1, 2, -2 and so on.
        let steps = (*layer + 1) / 2;
        let side = if *layer % 2 == 1 { 1.0 } else { -1.0 };
        up.push(side * steps as f64);
        *layer += 1;
    }
    let most = up.iter().fold(0.0_f64, |most, up| most.max(up.abs())) + 1.0;
    let ends = ends(&samples);
    let dot = |((part, input), up): ((f64, f64), f64)| BeeswarmDot { part, up: up / most, colour: colour(input, ends) };
    samples.into_iter().zip(up).map(dot).collect()
}

/// The values of the input at the ends of the colour scale.
fn ends(samples: &[(f64, f64)]) -> (f64, f64) {
    let mut inputs: Vec<f64> = samples.iter().map(|(_, input)| *input).filter(|x| x.is_finite()).collect();
    inputs.sort_by(f64::total_cmp);
    let last = inputs.len().saturating_sub(1) as f64;
    let at = |share: f64| inputs.get((share * last).round() as usize).copied().unwrap_or(f64::NAN);
    let within = (at(BEYOND), at(1.0 - BEYOND));
    // If nearly all samples have the same value, as for a switch that is seldom on, the scale covers all values.
    if within.0 < within.1 { within } else { (at(0.0), at(1.0)) }
}

fn colour(input: f64, (low, high): (f64, f64)) -> String {
    if !(input.is_finite() && low < high) {
        return GREY.to_owned();
    }
    shade((input - low) / (high - low))
}

/// The colour at a position from low (0) to high (1).
fn shade(along: f64) -> String {
    let last = COLOURS.len() - 1;
    let along = along.clamp(0.0, 1.0) * last as f64;
    let first = (along.floor() as usize).min(last - 1);
    let part = along - first as f64;
    let (a, b) = (COLOURS[first], COLOURS[first + 1]);
    let [r, g, b] = [0, 1, 2].map(|k| (a[k] + part * (b[k] - a[k])).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn colour_bar(bottom: f64) -> Markup {
    const STEPS: usize = 24;
    let (left, top, height) = (WIDTH - BAR + 22.0, 14.0, (bottom - 28.0).max(20.0));
    let step = height / STEPS as f64;
    html! {
        @for k in 0..STEPS {
            @let along = 1.0 - (k as f64 + 0.5) / STEPS as f64;
            rect x=(px(left)) y=(px(top + step * k as f64)) width="8" height=(px(step + 0.3)) fill=(shade(along)) {}
        }
        text.value x=(px(left + 4.0)) y=(px(top - 4.0)) text-anchor="middle" font-size="11" { "high" }
        text.value x=(px(left + 4.0)) y=(px(top + height + 12.0)) text-anchor="middle" font-size="11" { "low" }
        text.value transform=(format!("translate({},{}) rotate(90)", px(left + 14.0), px(top + 0.5 * height)))
            text-anchor="middle" font-size="11" {
            "value of the input"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_dots_show_their_contribution_and_input() {
        let samples: Vec<(f64, f64)> = (0..101).map(|k| (f64::from(k) / 50.0 - 1.0, f64::from(k))).collect();
        let made = dots(&samples);
        assert!(made.iter().all(|dot| dot.up == 0.0), "parts that differ require no offset");
        assert_eq!((made[0].colour.as_str(), made[100].colour.as_str()), ("#008bfb", "#ff0051"));
        assert_eq!(made[2].colour, made[0].colour, "the colour scale ends at the outer 5 of 100 values");
        let same = dots(&[(1.0, 0.0), (1.0, 1.0), (1.0, 2.0), (2.0, f64::NAN)]);
        let up: Vec<f64> = same.iter().map(|dot| dot.up).collect();
        assert_eq!(up, [0.0, 0.5, -0.5, 0.0]);
        assert_eq!(same[3].colour, GREY);
        // A switch that is on in one sample of a hundred.
        let switch: Vec<(f64, f64)> = (0..100).map(|k| (f64::from(k), f64::from(u8::from(k == 7)))).collect();
        let made = dots(&switch);
        assert_eq!((made[7].colour.as_str(), made[8].colour.as_str()), ("#ff0051", "#008bfb"));
        assert!(dots(&[(0.5, 3.0)])[0].colour == GREY, "one value has no colour");
    }

    #[test]
    fn unit_rows_are_in_the_order_of_the_mean_absolute_contribution() {
        let mut swarm = BeeswarmSamples::default();
        swarm.add("small", &[0.1, -0.1, f64::NAN], &[1.0, 2.0, 3.0]);
        swarm.add("large", &[-3.0, 3.0], &[1.0, 2.0]);
        swarm.add("none", &[f64::NAN], &[1.0]);
        let drawn = swarm.drawn("importance", "nT").map(|page| page.0).unwrap_or_default();
        let places: Vec<usize> = [">large<", ">small<"].iter().filter_map(|name| drawn.find(name)).collect();
        assert!(places.len() == 2 && places.is_sorted() && !drawn.contains(">none<"), "{drawn}");
        assert_eq!(drawn.matches("<circle").count(), 4);
        assert!(drawn.contains("contribution to the prediction, nT"));
        assert!(BeeswarmSamples::default().drawn("importance", "nT").is_none());
    }
}

//! The values of `summary`: a dot for each sweep point, with its confidence interval.

use arrow_array::{
    Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use figures::{chart::px, ticks};
use maud::{Markup, html};
use plan::PlanUnit;
use results::text::number;
use schemas::{
    Fault, StageRole,
    metric::{Metric, MetricLimit, PoolingRule},
};

use super::source::ReportSource;

/// The maximum number of points of a plot.
const MOST: usize = 40;
/// Minimum width of a plot, and width of its dots and values without the names of the points.
const LEAST: f64 = 460.0;
const VALUES_WIDTH: f64 = 300.0;
/// Maximum number of drawn characters of a name, and the width of a character.
const NAME: usize = 60;
const CHARACTER: f64 = 6.8;
const ROW: f64 = 20.0;
const BOTTOM: f64 = 22.0;

/// One metric over the points of a sweep.
#[derive(Debug)]
struct IntervalRow {
    metric: Metric,
    dots: Vec<IntervalDot>,
}

/// A pooled value.
#[derive(Debug)]
struct IntervalDot {
    point: String,
    value: f64,
    /// `None` for a single line.
    interval: Option<(f64, f64)>,
    lines: i64,
}

/// A section for each table of `summary`.
///
/// # Errors
/// Fails if the store is damaged.
pub fn sections(source: &ReportSource) -> Result<Vec<Markup>, Fault> {
    let plan = source.graph.plan;
    let mut out = vec![];
    for table in plan.tables_of(StageRole::PoolsScores) {
        let node = &plan.tables[table];
        let mut metrics: Vec<IntervalRow> = vec![];
        for (instance, it) in plan.instances(table).enumerate() {
            let unit = PlanUnit { table, instance, line: None };
            let columns = ["metric", "value", "low", "high", "lines"];
            let Some(batch) = source.tidy(unit, &columns)? else { continue };
            let point = node.axis_columns(&it, &plan.spec).iter().map(|(_, v)| v.to_string()).collect::<Vec<_>>();
            add(&mut metrics, &point.join(", "), &batch, |name| plan.metric(name).copied());
        }
        if !metrics.is_empty() {
            let axes: Vec<&str> =
                node.axes.iter().filter_map(|i| plan.spec.axes.get(*i)).map(|a| a.name.as_str()).collect();
            out.push(section(&node.name, &axes, &metrics));
        }
    }
    Ok(out)
}

/// Adds the values of the `declared` metrics at one point, except numbers of samples, which are not scores.
fn add(metrics: &mut Vec<IntervalRow>, point: &str, batch: &RecordBatch, declared: impl Fn(&str) -> Option<Metric>) {
    let text = |name: &str| batch.column_by_name(name).and_then(|a| a.as_string_opt::<i32>());
    let floats = |name: &str| batch.column_by_name(name).and_then(|a| a.as_primitive_opt::<Float64Type>());
    let lines = batch.column_by_name("lines").and_then(|a| a.as_primitive_opt::<Int64Type>());
    let (Some(names), Some(values), Some(lines)) = (text("metric"), floats("value"), lines) else { return };
    let end = |name: &str, i: usize| floats(name).filter(|a| a.is_valid(i)).map(|a| a.value(i));
    for i in (0..batch.num_rows()).filter(|i| values.is_valid(*i) && values.value(*i).is_finite()) {
        let Some(metric) = declared(names.value(i)).filter(|m| m.pool != PoolingRule::Sum) else { continue };
        let interval = end("low", i).zip(end("high", i)).filter(|(a, b)| a.is_finite() && b.is_finite());
        let dot = IntervalDot { point: point.to_owned(), value: values.value(i), interval, lines: lines.value(i) };
        match metrics.iter_mut().find(|row| row.metric.name == metric.name) {
            Some(row) => row.dots.push(dot),
            None => metrics.push(IntervalRow { metric, dots: vec![dot] }),
        }
    }
}

fn section(name: &str, axes: &[&str], metrics: &[IntervalRow]) -> Markup {
    let longest = metrics.iter().map(|m| m.dots.len()).max().unwrap_or(0);
    html! {
        section id=(format!("summary-{name}")) {
            h2 { "Summary" @if name != "summary" { ": " (name) } }
            p.lead { "Each dot is a score pooled over the held-out lines, or over the in-sample lines if there are no \
                      others. The bar is the bootstrap confidence interval from resampling whole lines. A single line \
                      has no interval."
                @if !axes.is_empty() { " Rows are the points of " (axes.join(", ")) "." }
                @if longest > MOST { " The first " (MOST) " of " (longest) " points are drawn; "
                    code { "magline sql" } " shows all." } }
            div.heat { @for row in metrics { (row.drawn()) } }
        }
    }
}

impl IntervalRow {
    /// Expected value of the metric for a consistent filter.
    fn expected(&self) -> Option<f64> {
        self.metric.target().filter(|_| matches!(self.metric.limit, Some(MetricLimit::Factor(_))))
    }

    fn drawn(&self) -> Markup {
        let Metric { name, unit, .. } = self.metric;
        let dots = &self.dots[..self.dots.len().min(MOST)];
        let expected = self.expected();
        let ends = dots
            .iter()
            .flat_map(|d| d.interval.map_or([d.value; 2], |(low, high)| [low.min(d.value), high.max(d.value)]));
        let ends = ends.chain(expected);
        let (low, high) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        let pad = if high > low { 0.06 * (high - low) } else { 0.1 * high.abs().max(1e-9) };
        let (low, high) = (low - pad, high + pad);
        let longest = dots.iter().map(|d| d.point.chars().count().min(NAME)).max().unwrap_or(0);
        let left = 12.0 + CHARACTER * longest as f64;
        let width = (left + VALUES_WIDTH).max(LEAST);
        let at = |v: f64| left + (width - 90.0 - left) * (v - low) / (high - low);
        let bottom = ROW * dots.len() as f64 + 6.0;
        let row = |i: usize| 3.0 + ROW * (i as f64 + 0.5);
        html! {
            figure {
                h3 { (name) @if unit != "1" { ", " (unit) } }
                svg.intervals style=(format!("max-width: {}px", px(1.17 * width)))
                    viewBox=(format!("0 0 {} {}", px(width), px(bottom + BOTTOM))) role="img"
                    aria-label=(format!("{name}: pooled values with their intervals")) {
                    @for tick in ticks::linear(low, high, 6) {
                        line.grid x1=(px(at(tick.at))) x2=(px(at(tick.at))) y1="0" y2=(px(bottom)) {}
                        text.tick x=(px(at(tick.at))) y=(px(bottom + 15.0)) text-anchor="middle" { (tick.label) }
                    }
                    @if let Some(mean) = expected {
                        line.level x1=(px(at(mean))) x2=(px(at(mean))) y1="0" y2=(px(bottom)) {}
                    }
                    @for (i, dot) in dots.iter().enumerate() {
                        g.bad[expected.is_some() && self.metric.is_flagged(dot.value)] {
                            title { (dot.words()) }
                            text x=(px(left - 8.0)) y=(px(row(i) + 4.0)) text-anchor="end" { (shortened(&dot.point)) }
                            @if let Some((low, high)) = dot.interval {
                                line.arm x1=(px(at(low))) x2=(px(at(high))) y1=(px(row(i))) y2=(px(row(i))) {}
                            }
                            circle.dot cx=(px(at(dot.value))) cy=(px(row(i))) r="3.5" {}
                            text.value x=(px(width - 4.0)) y=(px(row(i) + 4.0)) text-anchor="end" {
                                (number(Some(dot.value)))
                            }
                        }
                    }
                }
            }
        }
    }
}

impl IntervalDot {
    fn words(&self) -> String {
        let lines = if self.lines == 1 { "one line".to_owned() } else { format!("{} lines", self.lines) };
        let value = number(Some(self.value));
        match self.interval {
            Some((low, high)) => {
                format!("{}: {value}, {} to {}, {lines}", self.point, number(Some(low)), number(Some(high)))
            }
            None => format!("{}: {value}, {lines}", self.point),
        }
    }
}

fn shortened(point: &str) -> String {
    if point.chars().count() <= NAME { point.to_owned() } else { point.chars().take(NAME - 1).chain(['…']).collect() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array, Int64Array, StringArray};

    use super::*;
    use crate::html::tests::declared;

    fn batch(nees: f64) -> RecordBatch {
        let text = |v: [&str; 3]| Arc::new(StringArray::from(v.to_vec())) as ArrayRef;
        let float = |v: [Option<f64>; 3]| Arc::new(Float64Array::from(v.to_vec())) as ArrayRef;
        RecordBatch::try_from_iter_with_nullable([
            ("metric", text(["drms", "nees", "samples_used"]), true),
            ("value", float([Some(20.0), Some(nees), Some(9.0)]), true),
            ("low", float([Some(15.0), None, None]), true),
            ("high", float([Some(30.0), None, None]), true),
            ("unit", text(["m", "1", "1"]), true),
            ("lines", Arc::new(Int64Array::from(vec![4, 1, 4])) as ArrayRef, true),
        ])
        .unwrap()
    }

    #[test]
    fn unit_a_summary_is_dots_with_their_intervals() {
        let known = |name: &str| Some(declared([name])[0]);
        let mut metrics = vec![];
        add(&mut metrics, "mag_4_uc", &batch(2.0), known);
        add(&mut metrics, "mag_5_uc", &batch(400.0), known);
        assert_eq!(metrics.iter().map(|row| row.metric.name).collect::<Vec<_>>(), ["drms", "nees"]);
        let drms = metrics[0].drawn().into_string();
        assert_eq!((drms.matches("class=\"arm\"").count(), drms.matches("class=\"dot\"").count()), (2, 2), "{drms}");
        assert!(drms.contains("<title>mag_4_uc: 20.00, 15.00 to 30.00, 4 lines</title>"), "{drms}");
        // A single line has no interval. A value far from its expected value is flagged, and the expected value is
        // drawn.
        let nees = metrics[1].drawn().into_string();
        assert_eq!(
            (nees.matches("class=\"arm\"").count(), nees.matches("<g class=\"bad\">").count()),
            (0, 1),
            "{nees}"
        );
        assert!(nees.contains("class=\"level\""), "{nees}");
    }
}

//! The answer of each score table: its best point in one sentence and one figure.

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use figures::{chart::px, ticks};
use maud::{Markup, html};
use plan::{PlanUnit, TableRef};
use results::text::number;
use schemas::{
    Fault, StageRole,
    metric::{Metric, MetricBaseline},
};

use super::{board::ScoreBoard, source::ReportSource, warnings::Warning};

/// Maximum number of lines in a figure.
const LINES: usize = 8;
const WIDTH: f64 = 720.0;
const LEFT: f64 = 190.0;
const RIGHT: f64 = 110.0;
const ROW: f64 = 22.0;

/// The value of one line, and of its baseline.
struct AnswerLine {
    name: String,
    value: f64,
    baseline: Option<f64>,
}

/// The section; `None` without scores.
///
/// # Errors
/// Fails if the store is damaged.
pub fn section(
    source: &ReportSource,
    boards: &[ScoreBoard],
    warnings: &[Warning],
    failures: usize,
) -> Result<Option<Markup>, Fault> {
    let mut parts = vec![];
    for board in boards {
        parts.extend(of_board(source, board)?);
    }
    if parts.is_empty() {
        return Ok(None);
    }
    Ok(Some(html! {
        section.answer id="answer" {
            @for part in &parts { (part) }
            @if failures > 0 || !warnings.is_empty() {
                p.note {
                    @if failures > 0 { a href="#failures" { (failures) " failed" } ". " }
                    @if !warnings.is_empty() {
                        a href="#warnings" {
                            (warnings.len()) (if warnings.len() == 1 { " warning" } else { " warnings" })
                        }
                        "."
                    }
                }
            }
        }
    }))
}

fn of_board(source: &ReportSource, board: &ScoreBoard) -> Result<Option<Markup>, Fault> {
    let Some(metric) = board.headline() else { return Ok(None) };
    let best = board.scores.best(metric);
    let Some(row) = best.or_else(|| board.ranked(metric).first().copied()) else { return Ok(None) };
    let Some(value) = board.value(row, metric) else { return Ok(None) };
    let declared = board.scores.metrics[metric];
    let name = &source.graph.plan.tables[board.table].name;
    let lines = lines(source, board, row, metric)?;
    let interval = interval(source, board, row, declared.name)?;
    let over = declared.baseline.and_then(|b| Some((b, board.scores.metric(b.metric)?)));
    let over = over.and_then(|(b, metric)| Some((b, board.value(row, metric)?)));
    let point = board.point(row);
    let several = board.scores.rows.len() > 1;
    let held_out = board.scores.in_sample.get(row).map_or(board.scores.lines, |seen| seen.held_out);
    Ok(Some(html! {
        div.verdict data-table=(name) {
            h2 {
                (if best.is_some() { "Result" } else { "No trustworthy result" }) @if name != "scores" { ": " (name) }
            }
            p.sentence {
                @if best.is_some() && several {
                    "Best point" @if point.is_empty() { ": " } @else { " " b { bdi { (point) } } ": " }
                }
                @if best.is_none() && several {
                    "Closest point" @if point.is_empty() { ": " } @else { " " b { bdi { (point) } } ": " }
                }
                @if !several && !point.is_empty() { b { bdi { (point) } } ": " }
                code { (declared.name) } " " strong { (with_unit(Some(value), declared.unit)) }
                @if let Some((low, high)) = interval {
                    " (bootstrap interval " (number(Some(low))) " to " (with_unit(Some(high), declared.unit)) ")"
                }
                @if let Some((other, other_value)) = over {
                    ", against " (with_unit(Some(other_value), declared.unit)) " (" (other.label) ")"
                }
                (place(held_out, board.scores.lines))
                @if let Some(nees) = board.scores.metric("nees").and_then(|m| board.value(row, m)) {
                    ". NEES " (number(Some(nees))) ", expected value 2"
                }
                "."
            }
            @if let Some(reason) = excluded(board, row, metric).filter(|_| best.is_none()) { p.warning { (reason) } }
            @for remark in board.scores.at_edges() { p.note { "Note: " (remark) "." } }
            (figure(declared, value, over, &lines))
        }
    }))
}

/// A value with its unit, as text.
pub fn with_unit(value: Option<f64>, unit: &str) -> String {
    let unit = if unit == "1" { String::new() } else { format!(" {unit}") };
    number(value) + &unit
}

/// Description of the lines from which a value is computed.
fn place(held_out: usize, all: usize) -> String {
    match (held_out, all) {
        (0, 1) => ", on one line in sample".to_owned(),
        (0, n) => format!(", over {n} in-sample lines"),
        (1, _) => ", on one held-out line".to_owned(),
        (n, _) => format!(", over {n} held-out lines"),
    }
}

/// The reason why a point cannot be the best.
fn excluded(board: &ScoreBoard, row: usize, metric: usize) -> Option<String> {
    if board.scores.is_in_sample(row, metric) {
        return Some(
            "In sample: a model, noise estimate or map was made from these lines, or they were used to choose a \
             parameter. This value does not show how well the result holds on other lines."
                .to_owned(),
        );
    }
    let marked = board.marked(row);
    (marked > 0).then(|| format!("Flagged on {marked} of {} lines; see the warnings.", board.scores.lines))
}

/// The confidence interval of a metric at a point, from the first table of `summary` that was made from this table of
/// scores.
fn interval(source: &ReportSource, board: &ScoreBoard, row: usize, metric: &str) -> Result<Option<(f64, f64)>, Fault> {
    let plan = source.graph.plan;
    let here = TableRef::Stage(board.table, board.instances.get(row).copied().unwrap_or(0));
    for table in plan.tables_of(StageRole::PoolsScores) {
        for instance in 0..plan.tables[table].len() {
            if plan.upstream(&plan.instance(table, instance).inputs(), StageRole::Scores) != Some(here) {
                continue;
            }
            let unit = PlanUnit { table, instance, line: None };
            let Some(batch) = source.tidy(unit, &["metric", "low", "high"])? else { continue };
            let floats = |i: usize| batch.column(i).as_primitive_opt::<Float64Type>();
            let (Some(names), Some(low), Some(high)) = (batch.column(0).as_string_opt::<i32>(), floats(1), floats(2))
            else {
                continue;
            };
            let at = names.iter().position(|n| n == Some(metric));
            let at = at.filter(|i| low.is_valid(*i) && high.is_valid(*i));
            if let Some(i) = at.filter(|i| low.value(*i).is_finite() && high.value(*i).is_finite()) {
                return Ok(Some((low.value(i), high.value(i))));
            }
        }
    }
    Ok(None)
}

/// The values of the lines from which a value is computed, worst first: the held-out lines, or all lines if every line
/// is in sample.
fn lines(source: &ReportSource, board: &ScoreBoard, row: usize, metric: usize) -> Result<Vec<AnswerLine>, Fault> {
    let instance = board.instances.get(row).copied().unwrap_or(0);
    let seen = source.graph.seen(board.table)?;
    let declared = board.scores.metrics[metric];
    let all = board.scores.is_in_sample(row, metric);
    let mut found = vec![];
    for line in source.graph.lines_of(board.table, instance) {
        if !all && seen.has(instance, *line) {
            continue;
        }
        let unit = PlanUnit { table: board.table, instance, line: Some(*line) };
        let Some(batch) = source.tidy(unit, &["metric", "value"])? else { continue };
        let (Some(words), Some(values)) =
            (batch.column(0).as_string_opt::<i32>(), batch.column(1).as_primitive_opt::<Float64Type>())
        else {
            continue;
        };
        let of = |name: &str| {
            let at = words.iter().position(|w| w == Some(name)).filter(|i| values.is_valid(*i))?;
            Some(values.value(at)).filter(|v| v.is_finite())
        };
        let (Some(value), Some((flight, line))) = (of(declared.name), source.graph.lines.get(*line)) else { continue };
        let name = format!("{flight} / {line}");
        found.push(AnswerLine { name, value, baseline: declared.baseline.and_then(|b| of(b.metric)) });
    }
    let cost = |line: &AnswerLine| declared.better.cost(line.value).unwrap_or(f64::INFINITY);
    found.sort_by(|a, b| cost(b).total_cmp(&cost(a)));
    Ok(found)
}

/// Values and baselines as dots: the pooled value, then the worst lines.
fn figure(metric: Metric, value: f64, over: Option<(MetricBaseline, f64)>, lines: &[AnswerLine]) -> Markup {
    let mut rows: Vec<(String, f64, Option<f64>)> = vec![("pooled".to_owned(), value, over.map(|o| o.1))];
    if lines.len() > 1 {
        rows.extend(lines.iter().take(LINES).map(|l| (l.name.clone(), l.value, l.baseline)));
    }
    let all = rows.iter().flat_map(|r| std::iter::once(r.1).chain(r.2));
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    let log = low > 0.0 && high / low > 10.0;
    let (low, high) = if log { (low / 1.3, high * 1.3) } else { (low.min(0.0), high.max(0.0) * 1.05 + 1e-12) };
    let at = |v: f64| {
        let part = if log { (v / low).ln() / (high / low).ln() } else { (v - low) / (high - low) };
        LEFT + part * (WIDTH - LEFT - RIGHT)
    };
    let bottom = ROW * rows.len() as f64 + 4.0;
    let middle = |i: usize| ROW * (i as f64 + 0.5) + 2.0;
    let ticks = if log { ticks::logarithmic(low, high) } else { ticks::linear(low, high, 6) };
    let label = format!("{}: pooled over the lines, and for the worst lines", metric.name);
    html! {
        figure {
            p.legend {
                span { i class="key dotted after" {} (metric.name) @if metric.unit != "1" { ", " (metric.unit) } }
                @if let Some((other, _)) = over { span { i class="key dotted ins" {} (other.label) } }
            }
            svg.dots viewBox=(format!("0 0 {WIDTH} {}", px(bottom + 22.0))) role="img" aria-label=(label) {
                @for tick in &ticks {
                    line.grid x1=(px(at(tick.at))) x2=(px(at(tick.at))) y1="0" y2=(px(bottom)) {}
                    text.tick x=(px(at(tick.at))) y=(px(bottom + 15.0)) text-anchor="middle" { (tick.label) }
                }
                @for (i, (name, value, other)) in rows.iter().enumerate() {
                    @let y = px(middle(i));
                    text.name x=(px(LEFT - 12.0)) y=(px(middle(i) + 4.0)) text-anchor="end" { (shortened(name)) }
                    @if let Some(other) = other {
                        line.arm x1=(px(at(*value))) x2=(px(at(*other))) y1=(y) y2=(y) {}
                        circle.base cx=(px(at(*other))) cy=(y) r="5" {}
                    }
                    circle.dot cx=(px(at(*value))) cy=(y) r=(if i == 0 { "7" } else { "5" }) {}
                    text.value x=(px(WIDTH - RIGHT + 14.0)) y=(px(middle(i) + 4.0)) {
                        (with_unit(Some(*value), metric.unit))
                    }
                }
            }
            figcaption {
                "The pooled value"
                @if lines.len() > 1 {
                    " and the " @if lines.len() > LINES { (LINES) " worst of " (lines.len()) } @else { (lines.len()) }
                    " lines, worst first"
                }
                @if log { ", on a logarithmic scale" } "."
            }
        }
    }
}

/// A name, shortened to fit next to the picture.
fn shortened(name: &str) -> String {
    const MOST: usize = 24;
    if name.chars().count() <= MOST {
        return name.to_owned();
    }
    name.chars().take(MOST - 1).chain(['\u{2026}']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::html::{board::tests::example, tests::declared};

    #[test]
    fn unit_the_figure_has_the_pooled_value_and_the_worst_lines() {
        let [drms] = declared(["drms"]);
        let line = |i: usize| AnswerLine { name: format!("1 / {i}"), value: 40.0 - i as f64, baseline: Some(900.0) };
        let lines: Vec<AnswerLine> = (0..20).map(line).collect();
        let text = figure(drms, 29.0, Some((drms.baseline.unwrap(), 967.0)), &lines).into_string();
        assert_eq!((text.matches("circle class=\"dot\"").count(), text.matches("class=\"base\"").count()), (9, 9));
        assert!(text.contains("29.00 m") && text.contains("8 worst of 20 lines") && text.contains("logarithmic"));
        assert!(text.contains("INS alone"), "{text}");
    }

    #[test]
    fn unit_a_point_that_is_not_the_best_has_a_reason() {
        let mut board = example();
        board.scores.marks = vec![1; 4];
        assert_eq!(excluded(&board, 0, 1).as_deref(), Some("Flagged on 1 of 6 lines; see the warnings."));
        board.scores.marks = vec![0; 4];
        assert_eq!(excluded(&board, 0, 1), None);
        assert_eq!((place(0, 1), place(3, 4)), (", on one line in sample".into(), ", over 3 held-out lines".into()));
    }
}

//! A search: its trials as a table, and the goal against the trial and against each axis.

use std::collections::BTreeMap;

use arrow_array::{
    Array, RecordBatch, StringArray,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_cast::cast;
use arrow_schema::DataType;
use figures::chart::{ChartAxis, ChartLine, LineChart};
use learning::search::SearchDimension;
use maud::{Markup, html};
use plan::spec::{RungOutcome, SearchAxis, SearchSpec};
use results::{text::number, trials::short};
use schemas::{Fault, Literal, metric::Metric};
use store::published;

use super::source::ReportSource;

const HEIGHT: f64 = 280.0;
/// Maximum number of trials that are listed and drawn.
const MOST: usize = 1000;
/// The axis is logarithmic if the ratio of the largest to the smallest goal exceeds this.
const WIDE: f64 = 8.0;

/// One row of the table of trials.
struct TrialTableRow {
    number: f64,
    words: Vec<String>,
    values: Vec<Option<f64>>,
    goal: Option<f64>,
    cost: Option<f64>,
    state: String,
}

/// The section of the search of the plan, from the table of trials; `None` without a search.
///
/// # Errors
/// Fails if the table cannot be read.
pub fn section(source: &ReportSource) -> Result<Option<Markup>, Fault> {
    let plan = source.graph.plan;
    let (Some(search), Some(goal)) = (&plan.spec.search, plan.goal()?) else { return Ok(None) };
    let names: Vec<&str> = search.columns().into_iter().map(|(name, _)| name).collect();
    let wanted: Vec<&str> = names.iter().copied().chain(["generation", "rung", "goal", "state"]).collect();
    let Some(batch) = published(&source.store.table(&plan.spec.name, "trials"), &wanted)? else { return Ok(None) };
    let trials = read(&batch, &names, |value| goal.cost(value))?;
    if trials.is_empty() {
        return Ok(None);
    }
    Ok(Some(drawn(search, &goal.metric, &names, &trials)))
}

fn read(batch: &RecordBatch, names: &[&str], cost: impl Fn(f64) -> Option<f64>) -> Result<Vec<TrialTableRow>, Fault> {
    let column = |name: &str, kind: &DataType| {
        let lacking = || Fault::machine(format!("the table of trials has no column `{name}` of {kind}"));
        cast(batch.column_by_name(name).ok_or_else(lacking)?, kind).map_err(|_| lacking())
    };
    let text = |name: &str| Ok::<StringArray, Fault>(column(name, &DataType::Utf8)?.as_string::<i32>().clone());
    let words = names.iter().map(|n| text(n)).collect::<Result<Vec<_>, _>>()?;
    let numbers = column("trial", &DataType::Int64)?;
    let numbers = numbers.as_primitive::<Int64Type>();
    let goals = column("goal", &DataType::Float64)?;
    let goals = goals.as_primitive::<Float64Type>();
    let states = text("state")?;
    let one = |i: usize| {
        let words: Vec<String> =
            words.iter().map(|w| if w.is_null(i) { String::new() } else { w.value(i).to_owned() }).collect();
        let goal = goals.is_valid(i).then(|| goals.value(i));
        TrialTableRow {
            number: numbers.value(i) as f64,
            values: words.iter().map(|w| w.parse().ok()).collect(),
            words,
            goal,
            cost: goal.and_then(&cost),
            state: states.value(i).to_owned(),
        }
    };
    Ok((0..batch.num_rows()).map(one).collect())
}

fn drawn(search: &SearchSpec, metric: &Metric, names: &[&str], trials: &[TrialTableRow]) -> Markup {
    let done = |t: &&TrialTableRow| t.state == RungOutcome::Done.as_str();
    let best = trials
        .iter()
        .filter(done)
        .filter_map(|t| Some((t.cost?, t)))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, t)| t);
    let label = if metric.unit == "1" { metric.name.to_owned() } else { format!("{}, {}", metric.name, metric.unit) };
    let scale = GoalScale::from_trials(trials, label);
    let mut plots: Vec<Option<Markup>> = vec![over_trials(trials, &scale)];
    plots.extend(search.axes.iter().map(|axis| over_axis(search, axis, names, trials, &scale)));
    let many = trials.iter().map(|t| t.words.first()).collect::<std::collections::BTreeSet<_>>().len();
    html! {
        section id="search" {
            h2 { "Search" }
            p.lead {
                (many) " trials by " code { (search.named.word()) } " for the best "
                code { (search.table) "." (search.metric) } "."
                @if let Some(best) = best {
                    " The best is trial " (best.words.first().map_or("", String::as_str)) ", with " (number(best.goal))
                    @if metric.unit != "1" { " " (metric.unit) } "."
                }
            }
            div.heat { @for plot in plots { @if let Some(plot) = plot { (plot) } } }
            details { summary { "All trials" }
                div.scroll.wide { table.sortable.scores {
                    thead { tr {
                        @for name in names { th scope="col" { button { (name) } } }
                        th.n scope="col" { button { "goal" } }
                        th scope="col" { button { "state" } }
                    } }
                    tbody { @for t in trials.iter().take(MOST) {
                        tr.bad[t.state == RungOutcome::Failed.as_str()] {
                            @for (word, value) in t.words.iter().zip(&t.values) {
                                td data-v=[value.map(|v| v.to_string())] { (shown(word)) }
                            }
                            td.n data-v=[t.goal.map(|v| v.to_string())] { (number(t.goal)) }
                            td { (t.state) }
                        }
                    } }
                } }
                @if trials.len() > MOST { p.note { "The first " (MOST) " of " (trials.len()) " are \
                    shown; " code { "magline sql" } " shows all." } }
            }
        }
    }
}

/// A value of an axis; a number is shortened to at most six significant digits.
fn shown(word: &str) -> String {
    match word.parse::<f64>() {
        Ok(x) => short(&Literal::Float(x)),
        Err(_) => word.to_owned(),
    }
}

/// The vertical axis, which is common to all plots.
struct GoalScale {
    dim: ChartAxis,
}

impl GoalScale {
    /// Logarithmic if the goals are above 0 and far apart.
    fn from_trials(trials: &[TrialTableRow], label: String) -> GoalScale {
        let goals = || trials.iter().filter_map(|t| t.goal);
        let (low, high) = goals().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        let log = low > 0.0 && high > WIDE * low;
        let pad = if log { 1.1 } else { 0.05 * (high - low).max(1e-9 * high.abs()).max(f64::MIN_POSITIVE) };
        let range = if log { (low / pad, high * pad) } else { (low - pad, high + pad) };
        let range = (low <= high).then_some(range);
        GoalScale { dim: ChartAxis { label, log, range } }
    }
}

fn marks(points: impl Iterator<Item = (f64, f64)>) -> Vec<(String, f64, f64)> {
    points.take(MOST).map(|(x, y)| (String::new(), x, y)).collect()
}

/// The goal of each trial, and the best so far.
fn over_trials(trials: &[TrialTableRow], scale: &GoalScale) -> Option<Markup> {
    let top = |t: &&TrialTableRow| t.state == RungOutcome::Done.as_str();
    let mut best: Option<(f64, f64)> = None;
    let mut points = vec![];
    for t in trials.iter().filter(top) {
        if let (Some(cost), Some(goal)) = (t.cost, t.goal)
            && best.is_none_or(|(least, _)| cost < least)
        {
            best = Some((cost, goal));
        }
        points.extend(best.map(|(_, goal)| (t.number, goal)));
    }
    let last = trials.iter().map(|t| t.number).fold(1.0, f64::max);
    let chart = LineChart {
        title: "Goal of each trial".into(),
        caption: "Each circle is a trial at one completed rung. The line is the best goal so far.".into(),
        x: ChartAxis { range: Some((0.5, last + 0.5)), ..ChartAxis::new("trial") },
        y: scale.dim.clone(),
        lines: vec![ChartLine { name: "best so far".into(), class: "after", points }],
        marks: marks(trials.iter().filter_map(|t| Some((t.number, t.goal?)))),
        height: HEIGHT,
        half: true,
        ..LineChart::default()
    };
    scale.dim.range.and_then(|_| chart.draw())
}

/// The goal against one axis; for a choice among words, the best and the mean for each word.
fn over_axis(
    search: &SearchSpec,
    axis: &SearchAxis,
    names: &[&str],
    trials: &[TrialTableRow],
    scale: &GoalScale,
) -> Option<Markup> {
    let at = names.iter().position(|n| *n == axis.name)?;
    let (low, high, log) = match axis.dimension {
        SearchDimension::Real { low, high, log } => (low, high, log),
        SearchDimension::Whole { low, high, log } => (low as f64, high as f64, log),
        SearchDimension::Choice(_) => return by_choice(axis, at, trials),
    };
    let pad = if log { (high / low).powf(0.03) } else { 0.03 * (high - low) };
    let range = if log { (low / pad, high * pad) } else { (low - pad, high + pad) };
    let rungs = if search.rungs() > 1 { " at one completed rung" } else { "" };
    let chart = LineChart {
        title: format!("Goal over {}", axis.name),
        caption: format!("Each circle is a trial{rungs}."),
        x: ChartAxis { label: axis.name.clone(), log, range: Some(range) },
        y: scale.dim.clone(),
        marks: marks(trials.iter().filter_map(|t| Some(((*t.values.get(at)?)?, t.goal?)))),
        height: HEIGHT,
        half: true,
        ..LineChart::default()
    };
    scale.dim.range.and_then(|_| chart.draw())
}

fn by_choice(axis: &SearchAxis, at: usize, trials: &[TrialTableRow]) -> Option<Markup> {
    let mut groups: BTreeMap<&str, Vec<&TrialTableRow>> = BTreeMap::new();
    for t in trials {
        groups.entry(t.words.get(at)?.as_str()).or_default().push(t);
    }
    let rows = axis.choices.iter().map(ToString::to_string).filter_map(|word| {
        let all = groups.get(word.as_str())?;
        let goals: Vec<f64> = all.iter().filter_map(|t| t.goal).collect();
        let best =
            all.iter().filter_map(|t| Some((t.cost?, t.goal?))).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, g)| g);
        let mean = (!goals.is_empty()).then(|| goals.iter().sum::<f64>() / goals.len() as f64);
        Some((word, all.len(), best, mean))
    });
    let rows: Vec<_> = rows.collect();
    Some(html! {
        figure {
            h3 { "Goal over " (axis.name) }
            div.scroll { table.scores {
                thead {
                    tr {
                        th scope="col" { (axis.name) } th.n scope="col" { "trials" } th.n scope="col" { "best" }
                        th.n scope="col" { "mean" }
                    }
                }
                tbody {
                    @for (word, n, best, mean) in &rows {
                        tr { td { (word) } td.n { (n) } td.n { (number(*best)) } td.n { (number(*mean)) } }
                    }
                }
            } }
            figcaption { "Trials without a goal are omitted." }
        }
    })
}

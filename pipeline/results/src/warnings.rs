//! Warnings of a run about its own results: filters that are worse than their INS, covariances that are far from the
//! errors, maps at the wrong height, weak fits. Each warning is one row of the table `warnings`.

mod cause;
mod kind;
pub mod limits;
mod remedy;
mod row;
mod written;

use std::collections::BTreeMap;

use arrow_array::{Array, cast::AsArray};
use plan::{LineId, Plan, PlanGraph, PlanUnit, SweepPoint, TableRef};
use rayon::prelude::*;
use schemas::{Fault, Grain, StageRole, TableKind, metric::Metric};
use stages::score::{signal, track};
use store::Store;

use crate::text::number;
pub use cause::{LineFacts, NavigationSettings, NavigationSide};
pub use kind::WarningKind;
pub use remedy::{Improvement, Remedy, improvement, remedies};
pub use row::LineMetrics;
pub use written::written;

/// Warning about an unreliable result.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// The table of scores or models.
    pub stage: String,
    /// The sweep point.
    pub point: SweepPoint,
    /// Flight and line; empty for a fit.
    pub line: Option<(String, String)>,
    /// Subject of the warning.
    pub kind: WarningKind,
    /// The flagged figure.
    pub value: Option<f64>,
    /// Limit of the figure.
    pub limit: Option<f64>,
    /// The unit of the figure and the limit.
    pub unit: &'static str,
    /// Description of the fault, in one sentence.
    pub text: String,
    /// Likely cause, from known facts.
    pub cause: Option<String>,
}

impl Warning {
    /// Ratio of the figure to its limit, at least 1; 1 without a figure.
    pub fn excess(&self) -> f64 {
        match (self.value, self.limit) {
            (Some(value), Some(limit)) if value / limit > 0.0 => (value / limit).ln().abs().exp(),
            (Some(_), Some(_)) => f64::INFINITY,
            _ => 1.0,
        }
    }

    /// Place of the warning: axis values, flight and line; empty for the fit of a pipeline without axes.
    pub fn place(&self) -> String {
        let point = self.point.iter().map(|(name, value)| format!("{name} = {value}"));
        let line = self.line.iter().map(|(flight, line)| format!("flight {flight}, line {line}"));
        point.chain(line).collect::<Vec<_>>().join(", ")
    }
}

/// The warnings of all units of scores, fits, maps and other survey stages that `done` accepts. Score tables come
/// first, then fits, then maps, then other tables; each group is in the order of the plan, the sweep and the lines.
///
/// # Errors
/// Fails if the store cannot be read.
pub fn find(graph: &PlanGraph, store: &Store, done: &(dyn Fn(PlanUnit) -> bool + Sync)) -> Result<Vec<Warning>, Fault> {
    let plan = graph.plan;
    let units =
        |role| plan.tables_of(role).flat_map(|t| graph.units(t)).filter(|u| done(*u)).collect::<Vec<PlanUnit>>();
    let scores = units(StageRole::Scores).into_par_iter().map(|unit| of_score(graph, store, unit));
    let fits = units(StageRole::FitsModel).into_par_iter().map(|unit| of_fit(graph, store, unit));
    let made = |kind: WarningKind, tables: Vec<usize>| {
        let units: Vec<PlanUnit> = tables.into_iter().flat_map(|t| graph.units(t)).filter(|u| done(*u)).collect();
        units.into_par_iter().map(move |unit| of_remarks(graph, store, unit, kind))
    };
    let is_map = |t: &usize| plan.tables[*t].entry.yields == TableKind::Map;
    let is_other = |t: &usize| {
        let entry = &plan.tables[*t].entry;
        entry.grain == Grain::Survey && !is_map(t) && entry.role != Some(StageRole::FitsModel)
    };
    let maps = made(WarningKind::Map, (0..plan.tables.len()).filter(is_map).collect());
    let others = made(WarningKind::Stage, (0..plan.tables.len()).filter(is_other).collect());
    let found: Vec<Vec<Warning>> = scores.chain(fits).chain(maps).chain(others).collect::<Result<_, Fault>>()?;
    Ok(found.into_iter().flatten().collect())
}

/// Warnings of the results that are in the store now, independent of the outcome of the last run.
///
/// # Errors
/// Fails if the store cannot be read.
pub fn present(graph: &PlanGraph, store: &Store) -> Result<Vec<Warning>, Fault> {
    find(graph, store, &|unit| graph.key(unit).is_ok_and(|key| store.has(key)))
}

/// The warnings of one line's scores.
fn of_score(graph: &PlanGraph, store: &Store, unit: PlanUnit) -> Result<Vec<Warning>, Fault> {
    let batch = store.get(graph.key(unit)?, &LineMetrics::COLUMNS)?;
    let row = LineMetrics::read(&batch);
    let Some(line) = unit.line else { return Ok(vec![]) };
    let inputs = graph.plan.instance(unit.table, unit.instance).inputs();
    let facts = LineFacts::gather(graph, store, &inputs, line, &row)?;
    let judged = judge(&facts).into_iter().map(|found| found.at(graph, unit));
    Ok(judged.chain(of_whole(graph, unit, WarningKind::Metric, row::left_out(&batch))).collect())
}

/// The warnings about the scores `row` of one line, for a navigation with these settings. The warnings lack stage,
/// point and line.
pub fn of_navigation(row: &LineMetrics, settings: NavigationSettings) -> Vec<Warning> {
    let facts = LineFacts { row, settings: Some(settings) };
    judge(&facts).into_iter().map(|found| found.in_place((String::new(), SweepPoint::new(), None))).collect()
}

/// Warning without stage, point and line.
struct WarningDraft {
    kind: WarningKind,
    value: f64,
    limit: f64,
    unit: &'static str,
    text: String,
    cause: Option<String>,
}

/// Stage, sweep point, and flight with line.
type WarningPlace = (String, SweepPoint, Option<(String, String)>);

impl WarningDraft {
    fn at(self, graph: &PlanGraph, unit: PlanUnit) -> Warning {
        self.in_place(place(graph, unit))
    }

    fn in_place(self, (stage, point, line): WarningPlace) -> Warning {
        let WarningDraft { kind, value, limit, unit, text, cause } = self;
        Warning { stage, point, line, kind, value: Some(value), limit: Some(limit), unit, text, cause }
    }
}

fn place(graph: &PlanGraph, unit: PlanUnit) -> WarningPlace {
    let node = &graph.plan.tables[unit.table];
    let line = unit.line.and_then(|l: LineId| graph.lines.get(l).cloned());
    (node.name.clone(), graph.plan.instance(unit.table, unit.instance).point(), line)
}

/// Compares the scores of one line with their limits.
fn judge(facts: &LineFacts) -> Vec<WarningDraft> {
    let (row, shown) = (facts.row, |x: f64| number(Some(x)));
    let mut found = vec![];
    let mut add = |kind: WarningKind, (value, limit, unit): (f64, f64, &'static str), text: String| {
        found.push(WarningDraft { kind, value, limit, unit, text, cause: facts.cause(kind) });
    };
    if let (Some(drms), Some(ins)) = (row.get(&track::DRMS), row.get(&track::INS_DRMS))
        && drms > ins
    {
        let text = format!("the filter is worse than the INS alone: drms {} m against {} m", shown(drms), shown(ins));
        add(WarningKind::WorseThanIns, (drms, ins, "m"), text);
    }
    // A track that equals the truth, such as a bound, has no error to compare.
    let is_bound = row.get(&track::DRMS) == Some(0.0);
    let consistency = [
        (&track::NEES, WarningKind::NeesLow, WarningKind::NeesHigh),
        (&track::NIS, WarningKind::NisLow, WarningKind::NisHigh),
    ];
    for (scorer, low, high) in consistency {
        let Metric { name, .. } = scorer.metric;
        let (Some(value), false) = (row.get(scorer), is_bound) else { continue };
        let (Some((least, most)), Some(mean)) = (scorer.metric.accepted(), scorer.metric.target()) else { continue };
        let (kind, limit) = if value > most {
            (high, most)
        } else if value < least {
            (low, least)
        } else {
            continue;
        };
        let text = format!("{}: {name} {}, expected value {mean}", kind.of_many(), shown(value));
        add(kind, (value, limit, "1"), text);
    }
    let correlated = row.get(&track::CORRELATED_NIS);
    if let (Some(white), Some((least, _)), false) =
        (row.get(&track::WHITENESS), track::WHITENESS.metric.accepted(), is_bound)
        && white < least
        && correlated.is_none_or(|nis| track::CORRELATED_NIS.metric.is_flagged(nis))
    {
        let more = correlated.map_or(String::new(), |nis| format!("; correlated_nis {}, expected value 1", shown(nis)));
        let text =
            format!("{}: whiteness {}, expected value 0.95{more}", WarningKind::NotWhite.of_many(), shown(white));
        add(WarningKind::NotWhite, (white, least, "1"), text);
    }
    if let Some((sigma_m, limit_m)) = facts.wide_start_m() {
        let text = format!(
            "{}: its standard deviation is {sigma_m:.0} m, but the map is linear only over {limit_m:.0} m",
            WarningKind::WideStart.of_many()
        );
        add(WarningKind::WideStart, (sigma_m, limit_m, "m"), text);
    }
    if let Some((lag_s, sigma_s)) = facts.lag_s() {
        let (by_s, what) = (lag_s.abs(), if lag_s > 0.0 { "late" } else { "early" });
        let text = format!(
            "the time stamps of the magnetometer are {by_s:.2} s {what} (standard deviation {sigma_s:.2} s); the \
             filter corrects its own measurements; other stages use the time stamps as they are"
        );
        add(WarningKind::Late, (by_s, limits::lag_s(sigma_s), "s"), text);
    }
    if let Some((bias_m, sigma_m)) = facts.height_bias_m() {
        let (by_m, what) = (bias_m.abs(), if bias_m > 0.0 { "above" } else { "below" });
        let text = format!(
            "the measured field fits the map at a height {by_m:.0} m {what} the height of the INS (standard deviation \
             {sigma_m:.0} m); the filter corrects its own prediction, but not `alt`"
        );
        add(WarningKind::HeightBias, (by_m, limits::height_bias_m(sigma_m), "m"), text);
    }
    if let Some(share) = row.gated()
        && share > limits::GATED
    {
        let text = format!("{}: {:.0} % of the measurements are rejected", WarningKind::Gated.of_many(), 100.0 * share);
        add(WarningKind::Gated, (share, limits::GATED, "1"), text);
    }
    if let Some((count, fixes)) = row.counted(&track::GNSS_REJECTED).filter(|(count, _)| *count > 0.0) {
        let first = facts
            .gnss_rejected_s()
            .map_or(String::new(), |at| format!(", the first one {at:.0} s after the start of the line"));
        let text = format!("{count:.0} of {fixes} GNSS positions contradict the INS and are rejected{first}");
        add(WarningKind::Gnss, (count, 0.0, "1"), text);
    }
    if let Some(share) = row.off_map()
        && share > limits::OFF_MAP
    {
        let text = format!("{:.0} % of the measurements are off the map and are not used", 100.0 * share);
        add(WarningKind::OffMap, (share, limits::OFF_MAP, "1"), text);
    }
    if let Some(share) = row.flat()
        && share > limits::FLAT
    {
        let text =
            format!("at {:.0} % of the measurements, the map is too flat to correct the position", 100.0 * share);
        add(WarningKind::Flat, (share, limits::FLAT, "1"), text);
    }
    if let Some((error_nt, limit)) = facts.map_height_nt() {
        let what = "the map is at a different height from the flight and is not continued to the height of the flight; \
                    the expected error is";
        add(WarningKind::MapHeight, (error_nt, limit, "nT"), format!("{what} {} nT rms", shown(error_nt)));
    }
    if let (Some(kept), Some(error)) = (row.get(&signal::ANOMALY_RETENTION), row.get(&signal::ANOMALY_RETENTION_SE))
        && let Some((least, _)) = signal::ANOMALY_RETENTION.metric.accepted()
        && kept + limits::RETENTION_ERRORS * error < least
    {
        let text = format!(
            "compensation removed part of the anomaly: the anomaly retention is {}, with a standard error of {}",
            shown(kept),
            shown(error)
        );
        add(WarningKind::Retention, (kept, least, "1"), text);
    }
    found
}

/// The warning of one fit. Every row of the model contains the same warning; it is reported once.
fn of_fit(graph: &PlanGraph, store: &Store, unit: PlanUnit) -> Result<Vec<Warning>, Fault> {
    if graph.plan.instance(unit.table, unit.instance).makes("warning").is_none() {
        return Ok(vec![]);
    }
    let batch = store.get(graph.key(unit)?, &["warning"])?;
    let texts = batch.column_by_name("warning").and_then(|a| a.as_string_opt::<i32>());
    let mut distinct: Vec<String> = vec![];
    for text in texts.iter().flat_map(|a| (0..a.len()).filter(|i| a.is_valid(*i)).map(|i| a.value(i))) {
        if !text.is_empty() && !distinct.iter().any(|t| t == text) {
            distinct.push(text.to_owned());
        }
    }
    Ok(of_whole(graph, unit, WarningKind::Fit, distinct))
}

/// The warnings that a stage returned with a map or another table.
fn of_remarks(graph: &PlanGraph, store: &Store, unit: PlanUnit, kind: WarningKind) -> Result<Vec<Warning>, Fault> {
    let key = graph.key(unit)?;
    // A result that is not kept is not in the store.
    let texts = if store.has(key) { store.remarks(key)?.warnings } else { vec![] };
    Ok(of_whole(graph, unit, kind, texts))
}

/// Warnings without a figure.
fn of_whole(graph: &PlanGraph, unit: PlanUnit, kind: WarningKind, texts: Vec<String>) -> Vec<Warning> {
    let (stage, point, line) = place(graph, unit);
    let one = |text| Warning {
        stage: stage.clone(),
        point: point.clone(),
        line: line.clone(),
        kind,
        value: None,
        limit: None,
        unit: "",
        text,
        cause: None,
    };
    texts.into_iter().map(one).collect()
}

/// Maximum number of kinds listed one by one.
const MAX_GROUPS: usize = 10;

/// Text of all warnings at the end of a run, grouped by kind and table, with the place and cause of the worst warning
/// of each group. `table` is the name of the table that holds all warnings.
pub fn summary_lines(warnings: &[Warning], table: &str) -> Vec<String> {
    let groups = groups(warnings);
    let mut out: Vec<String> = groups.iter().take(MAX_GROUPS).map(|group| group_text(warnings, group)).collect();
    if groups.len() > MAX_GROUPS {
        out.push(format!("and {} more kinds of warnings", groups.len() - MAX_GROUPS));
    }
    if !out.is_empty() {
        let n = warnings.len();
        out.push(format!("{n} {}; the table `{table}` lists all", if n == 1 { "warning" } else { "warnings" }));
    }
    out
}

/// Positions of the warnings, grouped by table of scores and by kind. The groups are sorted by table, then by kind; no
/// group is empty.
fn groups(warnings: &[Warning]) -> Vec<Vec<usize>> {
    let mut groups: BTreeMap<(&str, WarningKind), Vec<usize>> = BTreeMap::new();
    for (i, warning) in warnings.iter().enumerate() {
        groups.entry((&warning.stage, warning.kind)).or_default().push(i);
    }
    groups.into_values().collect()
}

/// Position of the first of the worst warnings of a group.
fn worst_of(warnings: &[Warning], group: &[usize]) -> Option<usize> {
    group.iter().copied().reduce(|a, b| if warnings[b].excess() > warnings[a].excess() { b } else { a })
}

/// Position of the worst warning of each kind in each table of scores.
pub fn worst(warnings: &[Warning]) -> Vec<usize> {
    groups(warnings).iter().filter_map(|group| worst_of(warnings, group)).collect()
}

/// The first of the worst warnings represents its group.
fn group_text(warnings: &[Warning], group: &[usize]) -> String {
    let Some(worst) = worst_of(warnings, group).map(|i| &warnings[i]) else { return String::new() };
    let place = if worst.place().is_empty() { String::new() } else { format!(" ({})", worst.place()) };
    let mut text = match group.len() {
        1 => format!("{}{place}: {}", worst.stage, worst.text),
        n => {
            let which = if worst.value.is_some() { "worst" } else { "first" };
            let what = worst.kind.of_many();
            // The text that all warnings of the group share is not repeated for the worst one.
            let figures = worst.text.strip_prefix(what).and_then(|t| t.strip_prefix(": ")).unwrap_or(&worst.text);
            format!("{}: {what} at {n} places, {which}{place}: {figures}", worst.stage)
        }
    };
    if let Some(cause) = &worst.cause {
        text.push_str(&format!("\n  likely cause: {cause}"));
    }
    text
}

/// The navigation from which some tables were computed, if any.
pub fn navigation(plan: &Plan, inputs: &[TableRef]) -> Option<(usize, usize)> {
    match plan.upstream(inputs, StageRole::EstimatesTrack) {
        Some(TableRef::Stage(t, i)) => Some((t, i)),
        _ => None,
    }
}

#[cfg(test)]
mod tests;

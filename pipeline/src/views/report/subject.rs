//! Which sweep points and which lines are shown in detail.

use std::collections::BTreeSet;

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use schemas::Fault;

use super::{
    board::{Board, better},
    source::Source,
};
use crate::{
    plan::{LineId, Ref, Unit},
    views::scores::number,
};

/// A sweep point that is shown in detail: the stages that it went through.
pub struct Subject {
    /// `best`, `worst` or nothing, for anchors.
    pub id: &'static str,
    /// The heading.
    pub title: String,
    /// The point in words; empty without axes.
    pub point: String,
    /// The figure it was chosen by.
    pub why: String,
    /// The table with the compensated signal.
    pub compensate: Option<Ref>,
    /// The table with the track.
    pub navigate: Option<Ref>,
    /// The model.
    pub fit: Option<Ref>,
    /// The column of the true field, where the scores name one.
    pub truth: Option<String>,
}

/// A line that is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// The line.
    pub line: LineId,
    /// Flight, line and why it was chosen.
    pub label: String,
}

/// The best point and the worst one; the first one where nothing was scored.
pub fn subjects(source: &Source, boards: &[Board]) -> Vec<Subject> {
    let Some((board, metric)) = ranking(boards) else { return unscored(source).into_iter().collect() };
    let ranked = board.ranked(metric);
    let (Some(best), Some(worst)) = (ranked.first(), ranked.last()) else { return vec![] };
    let one = |id, title: &str, row: usize| subject(source, board, metric, id, title, row);
    if best == worst {
        return vec![one(
            "best",
            if board.scores.axes.is_empty() { "In detail" } else { "The point in detail" },
            *best,
        )];
    }
    vec![one("best", "The best point in detail", *best), one("worst", "The worst point in detail", *worst)]
}

/// The board and metric that points are ranked by.
fn ranking(boards: &[Board]) -> Option<(&Board, usize)> {
    boards.iter().find_map(|b| b.headline().map(|m| (b, m)))
}

fn subject(source: &Source, board: &Board, metric: usize, id: &'static str, title: &str, row: usize) -> Subject {
    let instance = board.instances.get(row).copied().unwrap_or(0);
    let it = source.graph.plan.instance(board.table, instance);
    let (name, unit) = &board.scores.metrics[metric];
    let unit = if unit == "1" { String::new() } else { format!(" {unit}") };
    let why = format!("{name} {}{unit}, pooled over {} lines", number(board.value(row, metric)), board.scores.lines);
    let truth = it.params.iter().find(|(n, _)| *n == "truth").and_then(|(_, v)| word(v));
    Subject { id, title: title.to_owned(), point: board.point(row), why, ..stages_of(source, &it.inputs, truth) }
}

/// Without scores: the first point of the last table of lines.
fn unscored(source: &Source) -> Option<Subject> {
    let plan = source.graph.plan;
    let (t, node) = plan.tables.iter().enumerate().rev().find(|(_, n)| !n.is_tidy())?;
    let it = node.instances.first()?;
    let words = node.axis_columns(it, &plan.spec).into_iter().map(|(a, v)| format!("{a} = {v}"));
    let point = words.collect::<Vec<_>>().join(", ");
    let title = if point.is_empty() { "In detail" } else { "The first point in detail" };
    let why = "nothing was scored".to_owned();
    Some(Subject { id: "first", title: title.to_owned(), point, why, ..stages_of(source, &[Ref::Stage(t, 0)], None) })
}

fn stages_of(source: &Source, from: &[Ref], truth: Option<String>) -> Subject {
    let find = |stage: &str| upstream(source, from, stage);
    let compensate = find("compensate");
    // The model of this compensation, not one that some other branch fitted.
    let model = compensate.and_then(|r| upstream(source, &[r], "fit"));
    let fit = model.or_else(|| find("fit"));
    let navigate = find("navigate");
    Subject { id: "", title: String::new(), point: String::new(), why: String::new(), compensate, navigate, fit, truth }
}

/// The nearest table above `from`, itself among them, that `stage` made.
fn upstream(source: &Source, from: &[Ref], stage: &str) -> Option<Ref> {
    let plan = source.graph.plan;
    let mut queue: Vec<Ref> = from.to_vec();
    let mut seen: BTreeSet<Ref> = BTreeSet::new();
    let mut next = 0;
    while let Some(r) = queue.get(next).copied() {
        next += 1;
        let Ref::Stage(t, i) = r else { continue };
        if !seen.insert(r) {
            continue;
        }
        if plan.tables[t].entry.name == stage {
            return Some(r);
        }
        queue.extend(plan.instance(t, i).inputs.iter().copied());
    }
    None
}

/// The text in the one spelling that parameters have.
pub fn word(canonical: &str) -> Option<String> {
    let inner = canonical.strip_prefix('"')?.strip_suffix('"')?;
    Some(inner.to_owned())
}

/// The lines to show: by the headline score at the best point the median line first, then the best and the worst; the
/// longest where nothing was scored.
///
/// # Errors
/// When the store is damaged.
pub fn lines(source: &Source, boards: &[Board], subject: &Subject) -> Result<Vec<Shown>, Fault> {
    let scored = match ranking(boards) {
        Some((board, metric)) => scored_lines(source, board, metric)?,
        None => vec![],
    };
    if scored.is_empty() {
        return Ok(longest(source, subject));
    }
    let last = scored.len() - 1;
    let picks: &[(usize, &str)] = match last {
        0 => &[(0, "")],
        1 => &[(0, "better line: "), (1, "worse line: ")],
        _ => &[(last / 2, "median line: "), (0, "best line: "), (last, "worst line: ")],
    };
    let shown = |(i, what): &(usize, &str)| {
        let (line, value) = scored.get(*i)?;
        Some(Shown { line: *line, label: format!("{}, {what}{value}", self::name(source, *line)) })
    };
    Ok(picks.iter().filter_map(shown).collect())
}

/// Flight and line as people say them.
fn name(source: &Source, line: LineId) -> String {
    source.graph.lines.get(line).map(|(f, l)| format!("Flight {f}, line {l}")).unwrap_or_default()
}

/// The lines of the best point by the headline metric, best first, with the figure in words.
fn scored_lines(source: &Source, board: &Board, metric: usize) -> Result<Vec<(LineId, String)>, Fault> {
    let (Some(row), Some((name, unit))) = (board.ranked(metric).first().copied(), board.scores.metrics.get(metric))
    else {
        return Ok(vec![]);
    };
    let instance = board.instances.get(row).copied().unwrap_or(0);
    let mut found: Vec<(f64, LineId, String)> = vec![];
    for line in source.graph.lines_of(board.table, instance) {
        let unit_of = Unit { table: board.table, instance, line: Some(*line) };
        let Some(batch) = source.tidy(unit_of, &["metric", "value"])? else { continue };
        let (Some(names), Some(values)) =
            (batch.column(0).as_string_opt::<i32>(), batch.column(1).as_primitive_opt::<Float64Type>())
        else {
            continue;
        };
        let at = names.iter().position(|n| n == Some(name));
        let value = at.filter(|i| values.is_valid(*i)).map(|i| values.value(i));
        if let Some((cost, value)) = value.and_then(|v| better(name).cost(v).map(|c| (c, v))) {
            let unit = if unit == "1" { String::new() } else { format!(" {unit}") };
            found.push((cost, *line, format!("{name} {}{unit}", number(Some(value)))));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Ok(found.into_iter().map(|(_, line, words)| (line, words)).collect())
}

/// The line with the most samples.
fn longest(source: &Source, subject: &Subject) -> Vec<Shown> {
    let Some(Ref::Stage(t, i)) = subject.navigate.or(subject.compensate) else { return vec![] };
    let rows = |l: &LineId| source.graph.records.iter().filter_map(|r| r.get(l)).map(|r| r.rows).max().unwrap_or(0);
    let lines = source.graph.lines_of(t, i).iter();
    let best = lines.copied().max_by_key(|l| (rows(l), std::cmp::Reverse(*l)));
    best.map(|line| Shown { line, label: format!("{}, the longest", name(source, line)) }).into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_only_text_is_a_word() {
        assert_eq!(word("\"mag_1_c\"").as_deref(), Some("mag_1_c"));
        assert_eq!(word("none"), None);
    }
}

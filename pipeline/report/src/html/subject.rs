//! The sweep points and the lines that are shown in detail.

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use plan::{LineId, PlanUnit, TableRef};
use schemas::{Fault, StageRole, metric::Metric};

use super::{answer::with_unit, board::ScoreBoard, source::ReportSource};

/// A sweep point that is shown in detail, with its stages.
pub struct ReportSubject {
    /// Identifier in the page's links: `best`, `worst`, `first`, or `table-` and the name of a table.
    pub id: String,
    /// The heading.
    pub title: String,
    /// The point as text; empty without axes.
    pub point: String,
    /// The score by which the point was chosen, as text.
    pub why: String,
    /// The table with the compensated signal.
    pub compensate: Option<TableRef>,
    /// The table with the track.
    pub navigate: Option<TableRef>,
    /// The table with the map's values along the line.
    pub map_value: Option<TableRef>,
    /// The model.
    pub fit: Option<TableRef>,
    /// The column of the true field, if the scores name this column.
    pub truth: Option<String>,
    /// The score by which the point was chosen.
    pub chosen: Option<SubjectScore>,
}

/// Line shown in detail.
#[derive(Clone, Debug, PartialEq)]
pub struct ReportLine {
    /// The line.
    pub line: LineId,
    /// The reason why this line was chosen.
    pub why: &'static str,
}

/// Score by which a sweep point was chosen.
pub struct SubjectScore {
    /// The score table and its instance at the point.
    at: (usize, usize),
    metric: Metric,
}

impl SubjectScore {
    /// A value of the metric as text.
    fn words(&self, value: Option<f64>) -> String {
        let Metric { name, unit, .. } = self.metric;
        format!("{name} {}", with_unit(value, unit))
    }
}

/// The best and the worst point; without scores, the first point.
pub fn subjects(source: &ReportSource, boards: &[ScoreBoard]) -> Vec<ReportSubject> {
    let Some((board, metric)) = ranking(boards) else { return unscored(source).into_iter().collect() };
    let ranked = board.ranked(metric);
    let (Some(best), Some(worst)) = (ranked.first(), ranked.last()) else { return vec![] };
    let one = |id: &str, title: &str, row: usize| subject(source, (board, metric), id, title, row);
    if best == worst {
        return vec![one(
            "best",
            if board.scores.axes.is_empty() { "In detail" } else { "The point in detail" },
            *best,
        )];
    }
    // Points that cannot be the best are ranked last: if the first point cannot be the best, no point can.
    let first = match (board.scores.is_in_sample(*best, metric), board.marked(*best)) {
        (true, _) => "The closest fit in detail: every point is in sample",
        (false, 0) => "The best point in detail",
        (false, _) => "The best of the flagged points in detail: every point is flagged",
    };
    vec![one("best", first, *best), one("worst", "The worst point in detail", *worst)]
}

/// Maximum number of lines shown for each further table of `navigate`, so that all tables fit on one page.
const LINES: usize = 2;

/// The score table and the metric by which points are ranked.
fn ranking(boards: &[ScoreBoard]) -> Option<(&ScoreBoard, usize)> {
    boards.iter().find_map(|b| b.headline().map(|m| (b, m)))
}

/// Further tables of `navigate` that have results, at most `most`, and the number of omitted tables. Each table is
/// shown at its best point or, if it has no scores, at its first point.
pub fn navigations(
    source: &ReportSource,
    boards: &[ScoreBoard],
    shown: &[ReportSubject],
    most: usize,
) -> (Vec<ReportSubject>, usize) {
    let plan = source.graph.plan;
    let table_of = |r: &TableRef| match r {
        TableRef::Stage(t, _) => Some(*t),
        TableRef::Flights(_) | TableRef::Map(_) => None,
    };
    let taken: Vec<usize> = shown.iter().filter_map(|s| table_of(s.navigate.as_ref()?)).collect();
    let others = plan.tables_of(StageRole::EstimatesTrack).filter(|t| !taken.contains(t));
    let mut others: Vec<usize> = others.filter(|t| source.present(*t).0 > 0).collect();
    let more = others.len().saturating_sub(most);
    others.truncate(most);
    let scored = |table: usize| {
        let made_of = |b: &&ScoreBoard| {
            let track = plan.upstream(&plan.instance(b.table, 0).inputs(), StageRole::EstimatesTrack);
            track.and_then(|r| table_of(&r)) == Some(table)
        };
        let (board, metric) = boards.iter().filter(made_of).find_map(|b| b.headline().map(|m| (b, m)))?;
        board.ranked(metric).first().map(|row| (board, metric, *row))
    };
    let one = |table: usize| {
        let (name, at) = (&plan.tables[table].name, TableRef::Stage(table, 0));
        let (id, title) = (format!("table-{name}"), format!("Navigation: table {name}"));
        let found = match scored(table) {
            Some((board, metric, row)) => subject(source, (board, metric), &id, &title, row),
            None => {
                let point =
                    plan.instance(table, 0).point().iter().map(|(k, v)| format!("{k} = {v}")).collect::<Vec<_>>();
                let stages = stages_of(source, &[at], None);
                ReportSubject { id, title, point: point.join(", "), why: "without scores".to_owned(), ..stages }
            }
        };
        // The stages before the navigation are shown only with the first score table.
        ReportSubject { compensate: None, map_value: None, fit: None, ..found }
    };
    (others.into_iter().map(one).collect(), more)
}

/// The point of a row of scores, with its stages.
pub fn subject(
    source: &ReportSource,
    (board, metric): (&ScoreBoard, usize),
    id: &str,
    title: &str,
    row: usize,
) -> ReportSubject {
    let instance = board.instances.get(row).copied().unwrap_or(0);
    let it = source.graph.plan.instance(board.table, instance);
    let chosen = SubjectScore { at: (board.table, instance), metric: board.scores.metrics[metric] };
    let lines = board.scores.lines;
    let pooled = if lines > 1 { format!(", {}", board.scores.over()) } else { String::new() };
    let marked = match board.marked(row) {
        0 => String::new(),
        n => format!("; flagged on {n} of {lines} lines, see the warnings"),
    };
    let why = chosen.words(board.value(row, metric)) + &pooled + &marked;
    let truth = it.params().iter().find(|(n, _)| *n == "truth").and_then(|(_, v)| word(v));
    let stages = stages_of(source, &it.inputs(), truth);
    ReportSubject {
        id: id.to_owned(),
        title: title.to_owned(),
        point: board.point(row),
        why,
        chosen: Some(chosen),
        ..stages
    }
}

/// The subject of a plan without scores: the first point of every table. Its stages are looked up from the last table
/// to the first.
fn unscored(source: &ReportSource) -> Option<ReportSubject> {
    let plan = source.graph.plan;
    let from: Vec<TableRef> = (0..plan.tables.len()).rev().map(|t| TableRef::Stage(t, 0)).collect();
    let first = plan.spec.axes.iter().filter_map(|a| a.values.first().map(|v| format!("{} = {v}", a.name)));
    let point = first.collect::<Vec<_>>().join(", ");
    let title = if point.is_empty() { "In detail" } else { "The first point in detail" }.to_owned();
    let subject = ReportSubject {
        id: "first".to_owned(),
        title,
        point,
        why: "without scores".to_owned(),
        ..stages_of(source, &from, None)
    };
    (!from.is_empty()).then_some(subject)
}

fn stages_of(source: &ReportSource, from: &[TableRef], truth: Option<String>) -> ReportSubject {
    let plan = source.graph.plan;
    let find = |role: StageRole| plan.upstream(from, role);
    let compensate = find(StageRole::Compensates);
    // Only the model of this compensation is shown, not a model of another branch.
    let model = compensate.and_then(|r| plan.upstream(&[r], StageRole::FitsModel));
    let fit = model.or_else(|| find(StageRole::FitsModel));
    let navigate = find(StageRole::EstimatesTrack);
    // A table of map values is shown even if no scores refer to it.
    let elsewhere = || plan.tables_of(StageRole::ReadsMap).next().map(|t| TableRef::Stage(t, 0));
    let map_value = find(StageRole::ReadsMap).or_else(elsewhere);
    let (title, point, why) = (String::new(), String::new(), String::new());
    ReportSubject { id: String::new(), title, point, why, compensate, navigate, map_value, fit, truth, chosen: None }
}

/// The text in a parameter's canonical spelling; `None` if the parameter is not text.
pub fn word(canonical: &str) -> Option<String> {
    let inner = canonical.strip_prefix('"')?.strip_suffix('"')?;
    Some(inner.to_owned())
}

/// Lines to show. With scores, these are the lines with the median, the best and the worst score at the point of
/// `subject`. Without scores, only the longest line is shown.
///
/// # Errors
/// Fails if the store is damaged.
pub fn lines(source: &ReportSource, subject: &ReportSubject) -> Result<Vec<ReportLine>, Fault> {
    let scored = scored_lines(source, subject)?;
    let picks: &[(usize, &'static str)] = match scored.len() {
        0 => return Ok(longest(source, subject)),
        1 => &[(0, "")],
        2 => &[(0, "the better line"), (1, "the worse line")],
        n => &[(n / 2, "the median line"), (0, "the best line"), (n - 1, "the worst line")],
    };
    let shown = |(i, why): &(usize, &'static str)| scored.get(*i).map(|line| ReportLine { line: *line, why });
    Ok(picks.iter().filter_map(shown).collect())
}

/// Further lines of a navigation: the median and the worst of [`lines`].
///
/// # Errors
/// Fails if the store is damaged.
pub fn few_lines(source: &ReportSource, subject: &ReportSubject) -> Result<Vec<ReportLine>, Fault> {
    let mut all = lines(source, subject)?;
    if all.len() > LINES {
        all.drain(1..=all.len() - LINES);
    }
    Ok(all)
}

/// Flight and line as text.
pub fn named(source: &ReportSource, line: LineId) -> String {
    source.graph.lines.get(line).map(|(f, l)| format!("flight {f}, line {l}")).unwrap_or_default()
}

/// Table, flight and line, and point of `subject`, as text.
pub fn place(source: &ReportSource, subject: &ReportSubject, line: LineId) -> String {
    let table = subject.navigate.map(|r| source.graph.plan.name_of(r)).unwrap_or_default();
    let words = [table, &named(source, line), &subject.point].map(str::to_owned);
    words.into_iter().filter(|w| !w.is_empty()).collect::<Vec<_>>().join(", ")
}

/// Flight, line, score of the line at the point of `subject`, and the reason why the line was chosen. The lines were
/// chosen by their scores at the point `best`.
///
/// # Errors
/// Fails if the store is damaged.
pub fn label(
    source: &ReportSource,
    subject: &ReportSubject,
    shown: &ReportLine,
    best: &ReportSubject,
) -> Result<String, Fault> {
    let mut label =
        source.graph.lines.get(shown.line).map(|(f, l)| format!("Flight {f}, line {l}")).unwrap_or_default();
    if let Some(chosen) = &subject.chosen {
        label.push_str(&format!(": {}", chosen.words(score(source, chosen, shown.line)?)));
    }
    if !shown.why.is_empty() {
        let elsewhere = if subject.id == best.id { "" } else { " of the best point" };
        label.push_str(&format!(" ({}{elsewhere})", shown.why));
    }
    Ok(label)
}

/// Score of the subject on one line.
fn score(source: &ReportSource, chosen: &SubjectScore, line: LineId) -> Result<Option<f64>, Fault> {
    let (table, instance) = chosen.at;
    let batch = source.tidy(PlanUnit { table, instance, line: Some(line) }, &["metric", "value"])?;
    let Some(batch) = batch else { return Ok(None) };
    let (Some(names), Some(values)) =
        (batch.column(0).as_string_opt::<i32>(), batch.column(1).as_primitive_opt::<Float64Type>())
    else {
        return Ok(None);
    };
    let at = names.iter().position(|n| n == Some(chosen.metric.name));
    Ok(at.filter(|i| values.is_valid(*i)).map(|i| values.value(i)))
}

/// The lines that have a score at the subject's point, best first.
///
/// # Errors
/// Fails if the store is damaged.
pub fn scored_lines(source: &ReportSource, subject: &ReportSubject) -> Result<Vec<LineId>, Fault> {
    let Some(chosen) = &subject.chosen else { return Ok(vec![]) };
    let mut found: Vec<(f64, LineId)> = vec![];
    for line in source.graph.lines_of(chosen.at.0, chosen.at.1) {
        let value = score(source, chosen, *line)?;
        found.extend(value.and_then(|v| chosen.metric.better.cost(v)).map(|cost| (cost, *line)));
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Ok(found.into_iter().map(|(_, line)| line).collect())
}

/// The line with the most samples.
fn longest(source: &ReportSource, subject: &ReportSubject) -> Vec<ReportLine> {
    let Some(TableRef::Stage(t, i)) = subject.navigate.or(subject.compensate).or(subject.map_value) else {
        return vec![];
    };
    let rows = |l: &LineId| source.graph.records.iter().filter_map(|r| r.get(l)).map(|r| r.rows).max().unwrap_or(0);
    let lines = source.graph.lines_of(t, i).iter();
    let best = lines.copied().max_by_key(|l| (rows(l), std::cmp::Reverse(*l)));
    best.map(|line| ReportLine { line, why: "the longest line" }).into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_only_text_is_a_word() {
        assert_eq!(word("\"mag_1_c\"").as_deref(), Some("mag_1_c"));
        assert_eq!(word("none"), None);
    }
}

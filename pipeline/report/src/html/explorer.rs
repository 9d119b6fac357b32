//! The scores of one table as a block of JSON, from which the script of the page draws the explorer.
//!
//! Values are written column by column, each in its shortest form that reads back as the same number. A missing value
//! is `null`. `<` is written as an escape, so that no name can close the block.

use std::collections::{BTreeMap, BTreeSet};

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use maud::{Markup, PreEscaped, html};
use plan::{LineId, PlanUnit};
use schemas::{
    Fault,
    metric::{Metric, MetricPreference},
};
use serde_json::json;

use super::{board::ScoreBoard, source::ReportSource, warnings::Warning};

/// Size of all blocks of a page, in bytes. Scores of single lines are omitted first, then points with high ranks.
pub const BUDGET: usize = 10_000_000;
/// Assumed size of one number, in bytes.
const NUMBER: usize = 20;

/// The explorer of one score table. Subtracts the size of the explorer's block from `left`, in bytes.
///
/// # Errors
/// Fails if the store is damaged.
pub fn section(
    source: &ReportSource,
    board: &ScoreBoard,
    warnings: &[Warning],
    left: &mut usize,
) -> Result<Markup, Fault> {
    let name = &source.graph.plan.tables[board.table].name;
    let rows = rows(board, *left);
    let entries = rows.iter().map(|r| source.graph.lines_of(board.table, board.instance(*r)).len()).sum();
    let read = |metrics| LineScores::read(source, board, &rows, warnings, metrics).map(Some);
    let block = block(board, &source.graph.plan.spec.name, name, &rows, entries, *left, read)?;
    *left = left.saturating_sub(block.len());
    Ok(html! {
        section.explorer id=(format!("explore-{name}")) data-table=(name) {
            h2 { "Explore" @if name != "scores" { ": " (name) } }
            noscript { p.note { "The explorer needs JavaScript. All figures below are complete without JavaScript." } }
            script type="application/json" { (PreEscaped(escaped(&block))) }
        }
    })
}

/// The block of the points `rows`, at most `left` bytes. `lines` reads the scores of single lines for some metrics;
/// there are `entries` pairs of a point and a line.
///
/// # Errors
/// Fails if the scores of lines cannot be read.
pub fn block(
    board: &ScoreBoard,
    pipeline: &str,
    table: &str,
    rows: &[usize],
    entries: usize,
    left: usize,
    lines: impl FnOnce(Vec<usize>) -> Result<Option<LineScores>, Fault>,
) -> Result<String, Fault> {
    let pooled = pooled(board, rows, pipeline, table)?;
    let metrics = affordable(board, entries, left.saturating_sub(pooled.len()));
    let lines = metrics.map_or(Ok(None), lines)?;
    let omitted = omitted(board, rows, lines.as_ref());
    let lines = lines.map_or_else(|| "null".to_owned(), |lines| lines.json());
    Ok(format!("{{{pooled},\"omitted\":{},\"lines\":{lines}}}", json!(omitted)))
}

/// JSON in which the character that opens a tag is escaped.
pub fn escaped(json: &str) -> String {
    json.replace('<', "\\u003c")
}

/// The points of the block: all, or the best that fit into `left` bytes.
pub fn rows(board: &ScoreBoard, left: usize) -> Vec<usize> {
    let all = board.scores.rows.len();
    let words = board.scores.rows.first().map_or(0, |(key, _)| key.iter().map(|k| k.len() + 8).sum());
    let each = words + NUMBER * (board.scores.metrics.len() + board.more.len() + 2);
    let most = (left / 2) / each.max(1);
    if all <= most {
        return (0..all).collect();
    }
    let mut rows = board.headline().map_or_else(|| (0..all).collect(), |m| board.ranked(m));
    rows.truncate(most);
    rows.sort_unstable();
    rows
}

/// Descriptions of the parts that the budget excludes.
fn omitted(board: &ScoreBoard, rows: &[usize], lines: Option<&LineScores>) -> Vec<String> {
    let mut out = vec![];
    if rows.len() < board.scores.rows.len() {
        out.push(format!("{} of {} points: the best", rows.len(), board.scores.rows.len()));
    }
    match lines {
        None => out.push("no scores of single lines".to_owned()),
        Some(lines) if lines.metrics.len() < board.scores.metrics.len() => {
            let names: Vec<&str> = lines.metrics.iter().map(|m| board.scores.metrics[*m].name).collect();
            out.push(format!("scores of single lines: {} only", names.join(", ")));
        }
        Some(_) => {}
    }
    out
}

/// A metric as JSON: name, unit, preference, meaning, pooling rule and baseline.
pub fn metric_json(metric: &Metric) -> serde_json::Value {
    let (better, target) = match metric.better {
        MetricPreference::Lower => ("lower", None),
        MetricPreference::Higher => ("higher", None),
        MetricPreference::Near(target) => ("near", Some(target)),
        MetricPreference::Neither => ("none", None),
    };
    json!({
        "name": metric.name, "unit": metric.unit, "better": better, "target": target, "meaning": metric.meaning,
        "pool": metric.pool.words(), "baseline": metric.baseline.map(|baseline| baseline.metric),
    })
}

/// The pooled scores of `rows`, as members of an object.
fn pooled(board: &ScoreBoard, rows: &[usize], pipeline: &str, table: &str) -> Result<String, Fault> {
    let scores = &board.scores;
    let metrics: Vec<_> =
        scores.metrics.iter().chain(board.more.iter().map(|more| &more.metric)).map(metric_json).collect();
    let mut axes = vec![];
    let mut places = vec![];
    for (a, name) in scores.axes.iter().enumerate() {
        let (values, at) = coded(rows.iter().map(|r| scores.rows[*r].0.get(a).map_or("", String::as_str)));
        let numeric = values.iter().all(|v| v.parse::<f64>().is_ok_and(f64::is_finite));
        axes.push(json!({ "name": name, "numeric": numeric, "values": values }));
        places.push(written(&at)?);
    }
    let mut values = vec![];
    let mut in_sample = vec![];
    for m in 0..scores.metrics.len() {
        values.push(floats(rows.iter().map(|r| board.value(*r, m)))?);
        in_sample.push(written(&positions(rows, |r| scores.is_in_sample(r, m)))?);
    }
    for more in &board.more {
        values.push(floats(rows.iter().map(|r| more.values.get(*r).copied().flatten()))?);
        in_sample.push(written(&positions(rows, |r| more.in_sample.get(r) == Some(&true)))?);
    }
    let held_out = |r: &usize| scores.in_sample.get(*r).map_or(scores.lines, |row| row.held_out);
    let seen = |r: &usize| scores.in_sample.get(*r).map_or(0, |row| row.lines);
    let members = [
        ("pipeline", json!(pipeline).to_string()),
        ("table", json!(table).to_string()),
        ("points", rows.len().to_string()),
        ("headline", json!(board.headline()).to_string()),
        ("over", json!(scores.over()).to_string()),
        ("axes", json!(axes).to_string()),
        ("metrics", json!(metrics).to_string()),
        ("at", format!("[{}]", places.join(","))),
        ("values", format!("[{}]", values.join(","))),
        ("in_sample", format!("[{}]", in_sample.join(","))),
        ("flagged", written(&rows.iter().map(|r| board.marked(*r)).collect::<Vec<_>>())?),
        ("cautious", written(&positions(rows, |r| scores.is_cautious(r)))?),
        ("bounds", written(&positions(rows, |r| scores.is_bound(r)))?),
        ("held_out", written(&rows.iter().map(held_out).collect::<Vec<_>>())?),
        ("seen", written(&rows.iter().map(seen).collect::<Vec<_>>())?),
    ];
    Ok(members.map(|(name, value)| format!("\"{name}\":{value}")).join(","))
}

/// Positions in `rows` of the rows that `is` accepts.
fn positions(rows: &[usize], is: impl Fn(usize) -> bool) -> Vec<usize> {
    rows.iter().enumerate().filter(|(_, r)| is(**r)).map(|(i, _)| i).collect()
}

/// The distinct words in order of appearance, and for each word its position among them.
fn coded<'a>(words: impl Iterator<Item = &'a str>) -> (Vec<&'a str>, Vec<usize>) {
    let mut known: BTreeMap<&str, usize> = BTreeMap::new();
    let (mut values, mut at) = (vec![], vec![]);
    for word in words {
        at.push(*known.entry(word).or_insert_with(|| {
            values.push(word);
            values.len() - 1
        }));
    }
    (values, at)
}

fn written(numbers: &[usize]) -> Result<String, Fault> {
    serde_json::to_string(numbers).map_err(|e| Fault::bug(e.to_string()))
}

fn floats(values: impl Iterator<Item = Option<f64>>) -> Result<String, Fault> {
    let values: Vec<Option<f64>> = values.map(|v| v.filter(|v| v.is_finite())).collect();
    serde_json::to_string(&values).map_err(|e| Fault::bug(e.to_string()))
}

/// Scores of single lines: one entry for each point and line.
#[derive(Debug, Default)]
pub struct LineScores {
    /// Flight and line.
    pub names: Vec<(String, String)>,
    /// The metrics of the values, as positions among the metrics of the board.
    pub metrics: Vec<usize>,
    /// Point of each entry.
    pub points: Vec<usize>,
    /// Line of each entry.
    pub lines: Vec<usize>,
    /// Positions of the entries that are in sample.
    pub in_sample: Vec<usize>,
    /// Positions of the flagged entries.
    pub flagged: Vec<usize>,
    /// A column for each metric.
    pub values: Vec<Vec<Option<f64>>>,
}

impl LineScores {
    /// Reads the scores of `metrics`, positions among the metrics of the board.
    fn read(
        source: &ReportSource,
        board: &ScoreBoard,
        rows: &[usize],
        warnings: &[Warning],
        metrics: Vec<usize>,
    ) -> Result<LineScores, Fault> {
        let instance = |row: usize| board.instance(row);
        let marked = board.scores.marked_lines(&source.graph.plan.tables[board.table].name, warnings);
        let seen = source.graph.seen(board.table)?;
        let mut found = LineScores { values: vec![vec![]; metrics.len()], metrics, ..LineScores::default() };
        let mut known: BTreeMap<LineId, usize> = BTreeMap::new();
        for (point, row) in rows.iter().enumerate() {
            for line in source.graph.lines_of(board.table, instance(*row)) {
                let unit = PlanUnit { table: board.table, instance: instance(*row), line: Some(*line) };
                let Some(batch) = source.tidy(unit, &["metric", "value"])? else { continue };
                let (Some(words), Some(values)) =
                    (batch.column(0).as_string_opt::<i32>(), batch.column(1).as_primitive_opt::<Float64Type>())
                else {
                    continue;
                };
                let Some(name) = source.graph.lines.get(*line) else { continue };
                let at = *known.entry(*line).or_insert_with(|| {
                    found.names.push(name.clone());
                    found.names.len() - 1
                });
                let entry = found.points.len();
                found.points.push(point);
                found.lines.push(at);
                if seen.has(instance(*row), *line) {
                    found.in_sample.push(entry);
                }
                if marked.get(*row).is_some_and(|lines: &BTreeSet<&(String, String)>| lines.contains(name)) {
                    found.flagged.push(entry);
                }
                for (metric, column) in found.metrics.iter().zip(&mut found.values) {
                    let wanted = board.scores.metrics[*metric].name;
                    let at = words.iter().position(|w| w == Some(wanted)).filter(|i| values.is_valid(*i));
                    column.push(at.map(|i| values.value(i)).filter(|v| v.is_finite()));
                }
            }
        }
        Ok(found)
    }

    fn json(&self) -> String {
        let names: Vec<[&str; 2]> = self.names.iter().map(|(flight, line)| [flight.as_str(), line.as_str()]).collect();
        let values: Vec<String> = self.values.iter().map(|column| json!(column).to_string()).collect();
        format!(
            "{{\"names\":{},\"metrics\":{},\"points\":{},\"lines\":{},\"in_sample\":{},\"flagged\":{},\
             \"values\":[{}]}}",
            json!(names),
            json!(self.metrics),
            json!(self.points),
            json!(self.lines),
            json!(self.in_sample),
            json!(self.flagged),
            values.join(",")
        )
    }
}

/// The metrics whose scores of `entries` lines fit into `left` bytes: all metrics of the board, or the metric that
/// ranks the points, together with its baseline. `None` if these scores do not fit, or there is no line.
fn affordable(board: &ScoreBoard, entries: usize, left: usize) -> Option<Vec<usize>> {
    let fits = |metrics: &usize| entries.saturating_mul(NUMBER * metrics + 14) <= left;
    let all: Vec<usize> = (0..board.scores.metrics.len()).collect();
    let headline = board.headline()?;
    let baseline = board.scores.metrics[headline].baseline.and_then(|baseline| board.scores.metric(baseline.metric));
    let few: Vec<usize> = std::iter::once(headline).chain(baseline).collect();
    [all, few].into_iter().find(|metrics| entries > 0 && fits(&metrics.len()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::html::board::tests::example;
    use results::scores::InSampleScores;
    use serde_json::Value;

    fn read(board: &ScoreBoard, rows: &[usize]) -> Value {
        let text = format!("{{{}}}", pooled(board, rows, "a", "scores").unwrap());
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn unit_values_read_back_as_the_same_numbers() {
        let mut board = example();
        let odd = [0.1 + 0.2, 1e-300, f64::MAX, -0.0];
        for (row, value) in board.scores.rows.iter_mut().zip(odd) {
            row.1[0] = Some(value);
        }
        let block = read(&board, &[0, 1, 2, 3]);
        for (i, value) in odd.iter().enumerate() {
            assert_eq!(block["values"][0][i].as_f64().unwrap().to_bits(), value.to_bits());
        }
        assert_eq!((&block["values"][1][2], block["metrics"][1]["unit"].as_str()), (&Value::Null, Some("m")));
        assert_eq!(block["axes"][1]["values"], json!(["0", "0.025"]));
        assert_eq!((&block["axes"][1]["numeric"], &block["axes"][0]["numeric"]), (&json!(true), &json!(false)));
        assert_eq!(block["at"], json!([[0, 0, 1, 1], [0, 1, 0, 1]]));
        assert_eq!((&block["metrics"][2]["better"], &block["metrics"][2]["target"]), (&json!("near"), &json!(2.0)));
    }

    #[test]
    fn unit_flagged_and_in_sample_points_have_their_marks() {
        let mut board = example();
        board.scores.marks = vec![0, 2, 0, 0];
        let of = |seen: bool| InSampleScores {
            lines: usize::from(seen),
            held_out: 3,
            metrics: vec![seen, false, false],
            values: vec![None; 3],
        };
        board.scores.in_sample = [false, true, false, true].map(of).to_vec();
        let block = read(&board, &[1, 3]);
        assert_eq!((&block["flagged"], &block["in_sample"]), (&json!([2, 0]), &json!([[0, 1], [], []])));
        assert_eq!((&block["held_out"], &block["seen"]), (&json!([3, 3]), &json!([1, 1])));
    }

    #[test]
    fn unit_a_hostile_name_cannot_close_the_block() {
        let mut board = example();
        let hostile = "</script><script>alert(1)</script><!-- \"'\\ \u{1b}[31m \u{202e}";
        board.scores.rows[0].0[0] = hostile.to_owned();
        let text = escaped(&format!("{{{}}}", pooled(&board, &[0, 1], hostile, "scores").unwrap()));
        assert!(!text.contains('<') && !text.contains('\u{1b}'), "{text}");
        let block: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(block["axes"][0]["values"][0], json!(hostile));
        assert_eq!(block["pipeline"], json!(hostile));
    }

    #[test]
    fn unit_lines_are_omitted_before_points() {
        let board = example();
        assert_eq!(affordable(&board, 100, 100 * (3 * NUMBER + 14)), Some(vec![0, 1, 2]));
        // `drms` ranks the points; the example has no `ins_drms`.
        assert_eq!(affordable(&board, 100, 100 * (3 * NUMBER + 14) - 1), Some(vec![1]));
        assert_eq!((affordable(&board, 100, 100), affordable(&board, 0, 1000)), (None, None));
        assert_eq!(rows(&board, 100_000), [0, 1, 2, 3]);
        // The block keeps the better of two points.
        let kept = rows(&board, 500);
        assert_eq!(kept, [1, 3]);
        let words = omitted(&board, &kept, None).join("; ");
        assert_eq!(words, "2 of 4 points: the best; no scores of single lines");
    }
}

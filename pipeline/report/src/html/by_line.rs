//! The leading score line by line: a row for each line, a column for each value of an axis, as theses print the errors
//! of methods over flight lines. [Gnadt 2022, Tables 6.2, 6.4 and 6.6]

use std::collections::BTreeSet;

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use maud::{Markup, html};
use plan::{InSampleLines, LineId, PlanUnit};
use results::text::number;
use schemas::{Fault, metric::Metric};

use super::{board::ScoreBoard, source::ReportSource, warnings::Warning};

/// Maximum numbers of tables, columns and rows of a page.
const TABLES: usize = 3;
const COLUMNS: usize = 12;
const ROWS: usize = 200;
/// Number of rows above which a table is folded.
const OPEN: usize = 30;
/// Metric of a track.
const DRMS: &str = "drms";

/// Table of one metric by line and sweep point.
struct LineScoreTable {
    metric: Metric,
    /// The axis with one value for each column; `None` if there is only one point.
    axis: Option<String>,
    /// Values of the other axes.
    others: String,
    columns: Vec<LineScoreColumn>,
    /// Flight and line of each row.
    lines: Vec<(String, String)>,
    /// The baseline of the metric, if it is the same for all columns: a value for each line, and the pooled value.
    baseline: Option<(Vec<Option<f64>>, Option<f64>)>,
    /// Total numbers of lines and columns; only the first lines and columns are shown.
    all: (usize, usize),
}

/// Table column: one sweep point.
struct LineScoreColumn {
    name: String,
    cells: Vec<LineScoreCell>,
    pooled: Option<f64>,
    /// The number of flagged lines.
    marks: usize,
    /// Whether the pooled value is from in-sample lines only.
    in_sample: bool,
}

/// The score of one line at one point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct LineScoreCell {
    value: Option<f64>,
    baseline: Option<f64>,
    marked: bool,
    in_sample: bool,
}

/// One table for each axis with several values, at the best point of the other axes; no table for a single line.
///
/// # Errors
/// Fails if the store is damaged.
pub fn tables(source: &ReportSource, board: &ScoreBoard, warnings: &[Warning]) -> Result<Vec<Markup>, Fault> {
    let Some(metric) = board.scores.metric(DRMS).or_else(|| board.headline()) else { return Ok(vec![]) };
    let Some(best) = board.ranked(metric).first().copied() else { return Ok(vec![]) };
    let plan = source.graph.plan;
    let (node, spec) = (&plan.tables[board.table], &plan.spec);
    let instance = board.instances.get(best).copied().unwrap_or(0);
    // The first axis represents all axes that are searched together.
    let several =
        node.grid().sides().map(|side| side.start).filter(|a| spec.axes.get(*a).is_some_and(|a| a.values.len() > 1));
    let mut axes: Vec<Option<usize>> = several.take(TABLES).map(Some).collect();
    if axes.is_empty() {
        axes.push(None);
    }
    let marked = board.scores.marked_lines(&node.name, warnings);
    let seen = source.graph.seen(board.table)?;
    let mut out = vec![];
    for axis in axes {
        let along: Vec<usize> = axis.map_or_else(|| vec![instance], |a| node.grid().along(instance, a).collect());
        let lines: BTreeSet<LineId> =
            along.iter().flat_map(|i| source.graph.lines_of(board.table, *i)).copied().collect();
        if lines.len() < 2 {
            continue;
        }
        let all = (lines.len(), along.len());
        let lines: Vec<LineId> = lines.into_iter().take(ROWS).collect();
        let mut columns = vec![];
        for i in along.into_iter().take(COLUMNS) {
            columns.push(column(source, board, (metric, axis, i), &lines, (&marked, seen))?);
        }
        let name = |l: &LineId| source.graph.lines.get(*l).cloned().unwrap_or_default();
        let point = plan.instance(board.table, instance).point();
        let of_axis = axis.and_then(|a| spec.axes.get(a)).map(|a| a.name.clone());
        let others = point.iter().filter(|(k, _)| Some(*k) != of_axis.as_ref()).map(|(k, v)| format!("{k} = {v}"));
        let others = others.collect::<Vec<_>>().join(", ");
        let of = board.scores.metrics[metric].baseline.and_then(|baseline| board.scores.metric(baseline.metric));
        let pooled_baseline = of.and_then(|m| board.value(best, m));
        let table = LineScoreTable {
            metric: board.scores.metrics[metric],
            axis: of_axis,
            others,
            baseline: same_baseline(&columns, lines.len()).map(|each| (each, pooled_baseline)),
            columns,
            lines: lines.iter().map(name).collect(),
            all,
        };
        out.push(table.drawn());
    }
    Ok(out)
}

fn column(
    source: &ReportSource,
    board: &ScoreBoard,
    (metric, axis, instance): (usize, Option<usize>, usize),
    lines: &[LineId],
    (marked, seen): (&[BTreeSet<&(String, String)>], &InSampleLines),
) -> Result<LineScoreColumn, Fault> {
    let plan = source.graph.plan;
    let row = board.instances.binary_search(&instance).ok();
    let spoilt = row.and_then(|r| marked.get(r));
    let mut cells = vec![];
    for line in lines {
        let unit = PlanUnit { table: board.table, instance, line: Some(*line) };
        let Metric { name, baseline, .. } = board.scores.metrics[metric];
        let [value, baseline] = match source.tidy(unit, &["metric", "value"])? {
            Some(batch) => {
                let words = batch.column(0).as_string_opt::<i32>();
                let values = batch.column(1).as_primitive_opt::<Float64Type>();
                [Some(name), baseline.map(|b| b.metric)].map(|wanted| {
                    let (words, values) = (words?, values?);
                    let wanted = wanted?;
                    let at = words.iter().position(|w| w == Some(wanted)).filter(|i| values.is_valid(*i))?;
                    Some(values.value(at)).filter(|v| v.is_finite())
                })
            }
            None => [None, None],
        };
        let marked = source.graph.lines.get(*line).is_some_and(|l| spoilt.is_some_and(|s| s.contains(l)));
        cells.push(LineScoreCell { value, baseline, marked, in_sample: seen.has(instance, *line) });
    }
    let value_of = |a: usize| plan.tables[board.table].grid().place(instance).find(|(axis, _)| *axis == a);
    let name = axis.and_then(value_of).and_then(|(a, at)| plan.spec.axes.get(a)?.values.get(at));
    Ok(LineScoreColumn {
        name: name.map(ToString::to_string).unwrap_or_default(),
        cells,
        pooled: row.and_then(|r| board.value(r, metric)),
        marks: row.map_or(0, |r| board.marked(r)),
        in_sample: row.is_some_and(|r| board.scores.is_in_sample(r, metric)),
    })
}

/// The baseline of each line, if it is the same for all columns.
fn same_baseline(columns: &[LineScoreColumn], lines: usize) -> Option<Vec<Option<f64>>> {
    let mut each = vec![None; lines];
    for column in columns {
        for (known, cell) in each.iter_mut().zip(&column.cells) {
            match (*known, cell.baseline) {
                (Some(a), Some(b)) if a != b => return None,
                (None, Some(b)) => *known = Some(b),
                (_, _) => {}
            }
        }
    }
    each.iter().any(Option::is_some).then_some(each)
}

impl LineScoreTable {
    fn drawn(&self) -> Markup {
        let title = self.title();
        html! {
            @if self.lines.len() > OPEN {
                details { summary { (title) } (self.rows()) }
            } @else {
                h3.lines { (title) }
                (self.rows())
            }
        }
    }

    fn baseline_name(&self) -> &'static str {
        self.metric.baseline.map(|baseline| baseline.label).unwrap_or_default()
    }

    fn title(&self) -> String {
        let Metric { name, unit, .. } = self.metric;
        let unit = if unit == "1" { String::new() } else { format!(" [{unit}]") };
        let over = self.axis.as_ref().map(|a| format!(" over {a}")).unwrap_or_default();
        format!("{name}{unit} line by line{over}")
    }

    fn rows(&self) -> Markup {
        let several = self.columns.len() > 1;
        let pooled = |c: &LineScoreColumn| LineScoreCell {
            value: c.pooled,
            baseline: None,
            marked: c.marks > 0,
            in_sample: c.in_sample,
        };
        let pooled: Vec<LineScoreCell> = self.columns.iter().map(pooled).collect();
        html! {
            div.scroll.wide {
                table.sortable.lines {
                    thead { tr {
                        @for name in ["flight", "line"] { th scope="col" { button { (name) } } }
                        @for column in &self.columns {
                            th.n scope="col" { button { (if several { &column.name } else { self.metric.name }) } }
                        }
                        @if self.baseline.is_some() { th.n scope="col" { button { (self.baseline_name()) } } }
                    } }
                    tbody { @for (i, (flight, line)) in self.lines.iter().enumerate() {
                        @let cells: Vec<LineScoreCell> =
                            self.columns.iter().filter_map(|c| c.cells.get(i)).copied().collect();
                        tr { td { (flight) } td { (line) }
                            (self.cells(&cells))
                            @if let Some((each, _)) = &self.baseline {
                                td.n { (number(each.get(i).copied().flatten())) }
                            }
                        }
                    } }
                    tfoot { tr { th colspan="2" scope="row" { "all " (self.all.0) " lines, pooled" }
                        (self.cells(&pooled))
                        @if let Some((_, pooled)) = &self.baseline { td.n { (number(*pooled)) } }
                    } }
                }
            }
            p.note { (self.words()) }
        }
    }

    fn cells(&self, cells: &[LineScoreCell]) -> Markup {
        let cost =
            |c: &LineScoreCell| c.value.filter(|_| !c.marked && !c.in_sample).and_then(|v| self.metric.better.cost(v));
        let best = (0..cells.len()).filter_map(|i| cost(&cells[i]).map(|c| (i, c))).min_by(|a, b| a.1.total_cmp(&b.1));
        let best = best.map(|b| b.0).filter(|_| cells.len() > 1);
        html! { @for (i, cell) in cells.iter().enumerate() {
            @let marked = cell.marked && cell.value.is_some();
            td.n.best[best == Some(i)].bad[marked] data-v=[cell.value.map(|v| v.to_string())]
                title=[marked.then_some("flagged")] {
                @if marked { "! " } (number(cell.value)) @if cell.in_sample && cell.value.is_some() { " ~" }
            }
        } }
    }

    fn words(&self) -> String {
        let mut words = vec![];
        if !self.others.is_empty() && self.axis.is_some() {
            words.push(format!("The other axes are at the best point, {}.", self.others));
        }
        if self.columns.len() > 1 {
            words.push("The best value of each row is coloured.".to_owned());
        }
        if self.columns.iter().any(|c| c.marks > 0) {
            words.push(
                "Values with a ! are flagged: the filter is worse than the INS alone, its NEES or NIS is far from the \
                 expected value, or its innovations are correlated. A pooled value is flagged if any of its lines is \
                 flagged."
                    .to_owned(),
            );
        }
        let seen = |column: &LineScoreColumn| column.cells.iter().any(|c| c.in_sample);
        if self.columns.iter().any(seen) {
            let what = "Values with a ~ are in sample: a model, noise estimate or map was made from the line, or it \
                        was used to choose a parameter.";
            words.push(what.to_owned());
        }
        if self.columns.iter().any(|c| seen(c) && !c.in_sample) {
            words.push("In-sample lines are pooled only if there are no other lines.".to_owned());
        }
        if self.columns.iter().flat_map(|c| &c.cells).any(|c| c.value.is_none()) {
            words.push("Lines without a value are not pooled.".to_owned());
        }
        let (lines, columns) = self.all;
        if lines > self.lines.len() || columns > self.columns.len() {
            words.push(format!(
                "The table shows {} of {lines} lines and {} of {columns} columns; `magline sql` shows all.",
                self.lines.len(),
                self.columns.len()
            ));
        }
        words.join(" ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::html::tests::declared;

    fn cell(value: f64, marked: bool) -> LineScoreCell {
        LineScoreCell { value: Some(value), baseline: Some(300.0), marked, in_sample: false }
    }

    fn example() -> LineScoreTable {
        let column = |name: &str, cells: Vec<LineScoreCell>, pooled, marks| LineScoreColumn {
            name: name.into(),
            cells,
            pooled,
            marks,
            in_sample: false,
        };
        let columns = vec![
            column("ekf", vec![cell(40.0, false), cell(12.0, true)], Some(29.5), 1),
            column("mpf", vec![cell(25.0, false), cell(30.0, false)], Some(27.6), 0),
            column("slam", vec![cell(90.0, false), LineScoreCell::default()], Some(90.0), 0),
        ];
        LineScoreTable {
            metric: declared(["drms"])[0],
            axis: Some("filter".into()),
            others: "mag = mag_4_uc".into(),
            baseline: same_baseline(&columns, 2).map(|each| (each, Some(301.0))),
            columns,
            lines: vec![("1003".into(), "1003.10".into()), ("1007".into(), "1007.06".into())],
            all: (2, 3),
        }
    }

    #[test]
    fn unit_lines_are_rows_methods_are_columns_and_the_last_row_is_pooled() {
        let text = example().drawn().into_string();
        assert!(text.contains("drms [m] line by line over filter"), "{text}");
        assert_eq!((text.matches("<tr>").count(), text.matches("INS alone</button>").count()), (4, 1), "{text}");
        assert!(text.contains("<td>1003</td><td>1003.10</td><td class=\"n\" data-v=\"40\">40.00</td>"), "{text}");
        let foot = text.split("<tfoot>").nth(1).unwrap_or_default();
        assert!(foot.contains("all 2 lines, pooled") && foot.contains("27.60") && foot.contains("301.0"), "{text}");
        assert!(text.contains("the best point, mag = mag_4_uc"), "{text}");
    }

    #[test]
    fn unit_a_flagged_line_is_shown_and_never_the_best() {
        let text = example().drawn().into_string();
        // 12 m is the smallest value of its row. The pooled 29.5 m includes a flagged line and is also flagged.
        assert!(text.contains("<td class=\"n bad\" data-v=\"12\" title=\"flagged\">! 12.00</td>"), "{text}");
        assert!(text.contains("data-v=\"29.5\" title=\"flagged\">! 29.50</td>"), "{text}");
        assert!(text.contains("<td class=\"n best\" data-v=\"30\">30.00</td>"), "{text}");
        assert_eq!(text.matches("n best").count(), 3, "one a row: {text}");
        assert!(text.contains("<td class=\"n\">-</td>") && text.contains("Lines without a value"), "{text}");
    }

    #[test]
    fn unit_a_line_in_sample_is_shown_as_such_and_never_the_best() {
        let mut table = example();
        table.columns[1].cells[0].in_sample = true;
        let text = table.drawn().into_string();
        assert!(text.contains("<td class=\"n\" data-v=\"25\">25.00 ~</td>"), "{text}");
        assert!(text.contains("<td class=\"n best\" data-v=\"40\">40.00</td>"), "{text}");
        assert!(text.contains("Values with a ~ are in sample"), "{text}");
    }

    #[test]
    fn unit_an_ins_that_differs_between_columns_has_no_column() {
        let mut table = example();
        table.columns[1].cells[0].baseline = Some(299.0);
        assert_eq!(same_baseline(&table.columns, 2), None);
        table.baseline = None;
        assert!(!table.drawn().into_string().contains("INS alone</button>"));
        assert!(same_baseline(&[], 2).is_none());
    }

    #[test]
    fn bug_a_table_in_nt_had_a_column_of_the_ins_in_metres() {
        let mut table = example();
        table.metric = declared(["std_error"])[0];
        let text = table.drawn().into_string();
        assert!(text.contains("uncompensated</button>") && !text.contains("INS alone</button>"), "{text}");
    }

    #[test]
    fn unit_many_lines_are_folded() {
        let mut table = example();
        table.lines = vec![("1".into(), "1.01".into()); OPEN + 1];
        assert!(table.drawn().into_string().starts_with("<details>"));
    }
}

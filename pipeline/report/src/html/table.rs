//! The pooled scores as a table, and over two axes as heat maps; below them the scores line by line.

use figures::palette::{Palette, hex, ink_on};
use maud::{Markup, html};
use results::text::number;
use schemas::metric::{Metric, MetricPreference};

use super::{board::ScoreBoard, source::ReportSource};

/// Maximum number of rows of the table.
const MOST: usize = 1000;
/// Maximum number of rows of a table that is not folded.
const OPEN: usize = 12;

/// Section of one score table: the pooled scores, their heat maps, and the tables `by_line` with the scores of single
/// lines.
pub fn section(source: &ReportSource, board: &ScoreBoard, by_line: Vec<Markup>) -> Markup {
    let name = &source.graph.plan.tables[board.table].name;
    let points = board.scores.rows.len();
    let spec = &source.graph.plan.spec;
    let searched: Vec<&str> = spec.axes.iter().skip(spec.searched.start).map(|a| a.name.as_str()).collect();
    let scores = &board.scores;
    let over = scores.over();
    let in_sample = scores.in_sample.iter().any(|row| row.lines > 0);
    let cautious = (0..points).any(|r| scores.is_cautious(r));
    html! {
        section id=(format!("scores-{name}")) {
            h2 { "Scores" @if name != "scores" { ": " (name) } }
            p.lead { (points) (if points == 1 { " point of the sweep, " } else { " points of the sweep, " }) (over)
                ". Errors are pooled as root mean squares, ratios as means, both weighted by the number of samples."
                @if in_sample { " Values with a " strong { "~" } " are in sample: the lines were used to make a model, \
                                                                  noise estimate or map, or to choose a parameter. \
                                                                  They are never the best." }
                @if points > 1 { " The best value of each metric is coloured. Click a heading to sort." }
                @if (0..points).any(|r| board.marked(r) > 0 && !scores.is_cautious(r)) { " Rows with \
                    a " strong { "!" } " are flagged; the numbers show how many of their lines are flagged. On these \
                                        lines, the filter is worse than the INS alone, its NEES or NIS is far from the \
                                        expected value, or its innovations are correlated: " code { "whiteness" }
                    " is below 0.8 and " code { "correlated_nis" } " is above 1.5. Flagged rows are never the best." }
                @if cautious { " In a row labelled cautious, the covariance of the filter is too large for its \
                                errors." }
                @for remark in scores.at_edges() { " Note: " (remark) "." } }
            @if points > OPEN {
                details { summary { "All scores as a table" } (table(board)) }
            } @else {
                (table(board))
            }
            @if points > MOST { p.note { "The best " (MOST) " of " (points) " points are shown; "
                code { "magline sql" } " shows all." } }
            (glossary(board))
            div.heat { @for map in heat_maps(board, &searched) { (map) } }
            @for table in by_line { (table) }
        }
    }
}

fn table(board: &ScoreBoard) -> Markup {
    let best: Vec<Option<usize>> = (0..board.scores.metrics.len()).map(|m| board.scores.best(m)).collect();
    let marked = (0..board.scores.rows.len()).any(|r| board.marked(r) > 0);
    let in_sample = board.scores.in_sample.iter().any(|row| row.lines > 0);
    let several = board.scores.rows.len() > 1;
    html! {
        div.scroll.wide {
            table.sortable.scores {
                thead { tr {
                    @for axis in &board.scores.axes { th scope="col" { button { (axis) } } }
                    @if marked { th scope="col" { button { "flagged" } } }
                    @if in_sample { th scope="col" { button { "in sample" } } }
                    @for metric in &board.scores.metrics {
                        th.n scope="col" {
                            button { (spaced(metric.name)) @if metric.unit != "1" { " [" (metric.unit) "]" } }
                        }
                    }
                } }
                tbody { @for row in shown(board) {
                    @let (key, values) = &board.scores.rows[row];
                    @let marks = board.marked(row);
                    tr.bad[marks > 0] {
                        @for word in key { td { (word) } }
                        @if marked {
                            td data-v=(marks) {
                                @if marks > 0 {
                                    (if board.scores.is_cautious(row) { "cautious " } else { "! " }) (marks) " of "
                                    (board.scores.lines)
                                }
                            }
                        }
                        @if in_sample { @let seen = board.scores.in_sample.get(row).cloned().unwrap_or_default();
                            td data-v=(seen.lines) { (seen.lines) " of " (seen.lines + seen.held_out) } }
                        @for (m, value) in values.iter().enumerate() {
                            @let wins = several && best.get(m).copied().flatten() == Some(row);
                            td.n.best[wins] data-v=[value.map(|v| v.to_string())] title=[wins.then_some("best")] {
                                (number(*value)) @if board.scores.is_in_sample(row, m) { " ~" }
                            }
                        }
                    }
                } }
            }
        }
    }
}

/// The rows of the table: all, or the best if there are too many.
fn shown(board: &ScoreBoard) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..board.scores.rows.len()).collect();
    if rows.len() > MOST
        && let Some(metric) = board.headline()
    {
        rows = board.ranked(metric);
        rows.truncate(MOST);
        rows.sort_unstable();
    }
    rows.truncate(MOST);
    rows
}

/// A name that the browser may break at underscores.
fn spaced(name: &str) -> Markup {
    html! { @for (i, part) in name.split('_').enumerate() { @if i > 0 { "_" wbr; } (part) } }
}

/// Meaning of each metric, folded.
fn glossary(board: &ScoreBoard) -> Markup {
    html! {
        details { summary { "Meaning of the columns" }
            dl { @for metric in &board.scores.metrics { dt { (metric.name) } dd { (spelt(metric.meaning))
                (match metric.better {
                    MetricPreference::Lower => "; smaller is better",
                    MetricPreference::Higher => "; larger is better",
                    MetricPreference::Near(_) | MetricPreference::Neither => "",
                }) } } }
        }
    }
}

/// A text in which the parts between backticks are shown as code.
pub fn spelt(text: &str) -> Markup {
    html! { @for (i, part) in text.split('`').enumerate() { @if i % 2 == 1 { code { (part) } } @else { (part) } } }
}

/// Heat map of a metric over two axes: each cell is the best over the other axes.
struct HeatMap {
    metric: usize,
    /// Positions of the two axes in the spec.
    axes: (usize, usize),
    /// The values of each axis.
    values: (Vec<String>, Vec<String>),
    /// Row of the scores that each cell shows, as a position; the cells are ordered row by row.
    cells: Vec<Option<usize>>,
}

fn heat_maps(board: &ScoreBoard, searched: &[&str]) -> Vec<Markup> {
    let worth = (0..board.scores.metrics.len()).filter(|m| board.scores.metrics[*m].shown.heat_map);
    worth.filter_map(|m| heat(board, m, searched)).map(|h| drawn(board, &h)).collect()
}

/// Heat map over the first two axes with several values. The axes `searched` are excluded, because each of their values
/// occurs only once.
fn heat(board: &ScoreBoard, metric: usize, searched: &[&str]) -> Option<HeatMap> {
    const SIDE: usize = 40;
    let values = |axis: usize| {
        let mut seen: Vec<String> = vec![];
        for (key, _) in &board.scores.rows {
            if let Some(v) = key.get(axis).filter(|v| !seen.contains(v)) {
                seen.push(v.clone());
            }
            // There are too many values for a heat map, and counting the rest would take too long.
            if seen.len() > SIDE {
                break;
            }
        }
        seen
    };
    let listed = |a: &usize| !searched.contains(&board.scores.axes[*a].as_str());
    let mut several = (0..board.scores.axes.len()).filter(listed).map(|a| (a, values(a))).filter(|(_, v)| v.len() > 1);
    let ((a, rows), (b, columns)) = (several.next()?, several.next()?);
    if rows.len() > SIDE || columns.len() > SIDE {
        return None;
    }
    let mut cells = vec![None; rows.len() * columns.len()];
    for row in board.ranked(metric).into_iter().rev() {
        let (key, _) = &board.scores.rows[row];
        let place = |axis: usize, of: &[String]| key.get(axis).and_then(|v| of.iter().position(|o| o == v));
        if let (Some(i), Some(k)) = (place(a, &rows), place(b, &columns)) {
            cells[i * columns.len() + k] = Some(row);
        }
    }
    Some(HeatMap { metric, axes: (a, b), values: (rows, columns), cells })
}

fn drawn(board: &ScoreBoard, heat: &HeatMap) -> Markup {
    let Metric { name, unit, .. } = board.scores.metrics[heat.metric];
    let axis = |i: usize| board.scores.axes[i].as_str();
    let others: Vec<&str> =
        (0..board.scores.axes.len()).filter(|i| *i != heat.axes.0 && *i != heat.axes.1).map(axis).collect();
    let in_sample = |row: usize| board.scores.is_in_sample(row, heat.metric);
    let good = heat.cells.iter().flatten().filter(|r| board.marked(**r) == 0 && !in_sample(**r));
    let (low, high) = ends(good.filter_map(|r| board.value(*r, heat.metric)));
    let marked = heat.cells.iter().flatten().any(|r| board.marked(*r) > 0);
    let seen = heat.cells.iter().flatten().any(|r| in_sample(*r));
    let width = heat.values.1.len();
    html! {
        figure {
            h3 { (name) ", " (unit) ", over " (axis(heat.axes.0)) " and " (axis(heat.axes.1)) }
            div.scroll { table.heat {
                thead {
                    tr { td {} th.over colspan=(width) scope="colgroup" { (axis(heat.axes.1)) } }
                    tr {
                        th.corner scope="col" { (axis(heat.axes.0)) }
                        @for v in &heat.values.1 { th scope="col" { (v) } }
                    }
                }
                tbody { @for (v, cells) in heat.values.0.iter().zip(heat.cells.chunks(width.max(1))) {
                    tr { th scope="row" { (v) } @for cell in cells { (tile(board, heat.metric, *cell, (low, high))) } }
                } }
            } }
            figcaption {
                @if low <= high {
                    "Yellow is good, purple is bad, on a logarithmic scale from " (number(Some(low))) " to "
                    (number(Some(high))) " " (unit) "."
                }
                @if seen { " Hatched cells with a ~ are in sample and have no colour." }
                @if marked { " Hatched cells with a ! are flagged and have no colour." }
                @if !others.is_empty() { " Each cell is the best over " (others.join(" and ")) "." }
            }
        }
    }
}

fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.filter(|v| *v > 0.0).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
}

fn tile(board: &ScoreBoard, metric: usize, cell: Option<usize>, (low, high): (f64, f64)) -> Markup {
    let Some((row, value)) = cell.and_then(|r| board.value(r, metric).map(|v| (r, v))) else {
        return html! { td { "-" } };
    };
    if board.marked(row) > 0 {
        return html! { td.bad title="flagged" { "! " (number(Some(value))) } };
    }
    if board.scores.is_in_sample(row, metric) {
        return html! { td.bad title="in sample" { (number(Some(value))) " ~" } };
    }
    let part = if high > low { 1.0 - (value / low).ln() / (high / low).ln() } else { 1.0 };
    let shade = Palette::Viridis.colour(part);
    html! { td style=(format!("background:{};color:{}", hex(shade), ink_on(shade))) { (number(Some(value))) } }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::html::board::tests::example;
    use results::scores::InSampleScores;

    #[test]
    fn unit_the_best_of_each_metric_is_highlighted_once() {
        let text = table(&example()).into_string();
        assert_eq!(text.matches("class=\"n best\"").count(), 3);
        assert!(text.contains("<td class=\"n best\" data-v=\"12\" title=\"best\">12.00</td>"), "{text}");
        assert!(text.contains("<td class=\"n\">-</td>"), "a metric without a value has none to sort by");
    }

    #[test]
    fn unit_a_cell_is_the_best_over_the_other_axes() {
        let mut board = example();
        board.scores.axes.insert(0, "twice".into());
        let mut more = board.scores.rows.clone();
        board.scores.rows.iter_mut().for_each(|r| r.0.insert(0, "a".into()));
        more.iter_mut().for_each(|r| {
            r.0.insert(0, "b".into());
            r.1[1] = r.1[1].map(|v| v / 2.0);
        });
        board.scores.rows.extend(more);
        board.scores.marks = vec![0; board.scores.rows.len()];
        // The first two axes with several values are `twice` and `mag`; each cell is the best over `lambda`.
        let heat = heat(&board, 1, &[]).unwrap();
        assert_eq!(heat.axes, (0, 1));
        let values: Vec<_> = heat.cells.iter().map(|r| r.and_then(|r| board.value(r, 1))).collect();
        assert_eq!(values, [Some(12.0), Some(30.0), Some(6.0), Some(15.0)]);
    }

    #[test]
    fn unit_a_flagged_row_is_neither_coloured_nor_best() {
        let mut board = example();
        board.scores.marks[1] = 2;
        let text = table(&board).into_string();
        assert_eq!(text.matches("<tr class=\"bad\">").count(), 1);
        assert!(text.contains("<td data-v=\"2\">! 2 of 6</td>"), "{text}");
        // The flagged row has the smallest drms, so the best of the other rows is highlighted.
        assert!(!text.contains("data-v=\"12\" title=\"best\""), "{text}");
        assert!(text.contains("data-v=\"30\" title=\"best\""), "{text}");
        let map = drawn(&board, &heat(&board, 1, &[]).unwrap()).into_string();
        assert!(map.contains("<td class=\"bad\" title=\"flagged\">! 12.00</td>"), "{map}");
        assert_eq!(map.matches("<td style=").count(), 2, "{map}");
        board.scores.marks = vec![1; 4];
        let (text, map) = (table(&board).into_string(), drawn(&board, &heat(&board, 1, &[]).unwrap()).into_string());
        assert!(!text.contains("best") && !map.contains("style="), "{text} {map}");
    }

    #[test]
    fn unit_a_value_in_sample_is_neither_coloured_nor_best() {
        let mut board = example();
        let of = |seen: bool| InSampleScores {
            lines: if seen { 2 } else { 0 },
            held_out: if seen { 0 } else { 2 },
            metrics: vec![seen; 3],
            values: vec![None; 3],
        };
        board.scores.in_sample = [false, true, false, false].map(of).to_vec();
        let text = table(&board).into_string();
        assert!(text.contains(">12.00 ~</td>") && text.contains("<td data-v=\"2\">2 of 2</td>"), "{text}");
        assert!(text.contains("data-v=\"30\" title=\"best\"") && !text.contains("data-v=\"12\" title"), "{text}");
        let map = drawn(&board, &heat(&board, 1, &[]).unwrap()).into_string();
        assert!(map.contains("<td class=\"bad\" title=\"in sample\">12.00 ~</td>"), "{map}");
    }

    #[test]
    fn unit_one_axis_has_no_heat_map() {
        let mut board = example();
        board.scores.axes.truncate(1);
        board.scores.rows.iter_mut().for_each(|r| r.0.truncate(1));
        assert!(heat(&board, 0, &[]).is_none());
    }
}

//! The plan as a drawing: tables as boxes from left to right, an arrow for each input.

use figures::chart::px;
use maud::{Markup, html};
use plan::TableRef;

use super::source::ReportSource;

const BOX_W: f64 = 140.0;
const BOX_H: f64 = 89.0;
const GAP_X: f64 = 30.0;
const GAP_Y: f64 = 18.0;
/// Height of the lane of an arrow past other boxes.
const LANE_H: f64 = 12.0;

/// Box of the flow chart: its text, and the boxes from which its arrows come.
struct FlowNode {
    name: String,
    lines: Vec<String>,
    inputs: Vec<usize>,
    source: bool,
    incomplete: bool,
}

/// Slot in a column of the flow chart: a box, or a lane for a passing arrow.
struct FlowSlot {
    node: Option<usize>,
    /// The slots of the previous column from which arrows come.
    from: Vec<usize>,
    y: f64,
}

/// The plan's drawing.
pub fn drawing(source: &ReportSource) -> Markup {
    drawn(&nodes(source))
}

fn nodes(source: &ReportSource) -> Vec<FlowNode> {
    let plan = source.graph.plan;
    let mut nodes = vec![];
    for (flights, records) in plan.flights.iter().zip(&source.graph.records) {
        let rows: usize = records.values().map(|r| r.rows).sum();
        let lines = vec!["flights".to_owned(), plural(records.len(), "line"), plural(rows, "sample")];
        nodes.push(FlowNode { name: flights.name.clone(), lines, inputs: vec![], source: true, incomplete: false });
    }
    for map in &plan.maps {
        nodes.push(FlowNode {
            name: map.name.clone(),
            lines: vec![map.word().to_owned()],
            inputs: vec![],
            source: true,
            incomplete: false,
        });
    }
    let (flights, sources) = (plan.flights.len(), nodes.len());
    let position = |r: &TableRef| match r {
        TableRef::Flights(i) => *i,
        TableRef::Map(i) => flights + i,
        TableRef::Stage(t, _) => sources + t,
    };
    for (t, table) in plan.tables.iter().enumerate() {
        let mut inputs: Vec<usize> = table.sources().iter().map(position).collect();
        inputs.sort_unstable();
        inputs.dedup();
        let axes: Vec<&str> =
            table.axes.iter().filter_map(|i| plan.spec.axes.get(*i)).map(|a| a.name.as_str()).collect();
        let (there, all) = source.present(t);
        let mut lines = vec![table.entry.name.to_owned()];
        lines.extend((!axes.is_empty()).then(|| plural(table.len(), "point") + " of"));
        lines.extend((!axes.is_empty()).then(|| axes.join(", ")));
        lines.push(format!("{there} of {all} computed"));
        nodes.push(FlowNode { name: table.name.clone(), lines, inputs, source: false, incomplete: there < all });
    }
    nodes
}

fn plural(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// The column of each node: one after the rightmost column of its inputs; a source is in the column before its first
/// reader.
fn columns_of(nodes: &[FlowNode]) -> Vec<usize> {
    let mut column = vec![0usize; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        column[i] = node.inputs.iter().map(|k| column[*k] + 1).max().unwrap_or(0);
    }
    for i in (0..nodes.len()).filter(|i| nodes[*i].source) {
        let readers = (0..nodes.len()).filter(|k| nodes[*k].inputs.contains(&i));
        column[i] = readers.map(|k| column[k] - 1).min().unwrap_or(0);
    }
    column
}

/// Boxes and lanes, column by column, each column in the order of the sources of its boxes.
fn layout(nodes: &[FlowNode]) -> Vec<Vec<FlowSlot>> {
    let column = columns_of(nodes);
    let last = column.iter().copied().max().unwrap_or(0);
    let mut columns: Vec<Vec<FlowSlot>> = vec![];
    // Slot of each node in the previous column: its box, or the lane of its arrow.
    let mut held: Vec<Option<usize>> = vec![None; nodes.len()];
    for c in 0..=last {
        let mut places: Vec<(FlowSlot, usize)> = vec![];
        for (i, node) in nodes.iter().enumerate() {
            let is_box = column[i] == c;
            let passes = column[i] < c && (0..nodes.len()).any(|k| nodes[k].inputs.contains(&i) && column[k] > c);
            if is_box {
                let from = node.inputs.iter().filter_map(|k| held[*k]).collect();
                places.push((FlowSlot { node: Some(i), from, y: 0.0 }, i));
            } else if passes {
                places.push((FlowSlot { node: None, from: held[i].into_iter().collect(), y: 0.0 }, i));
            }
        }
        let before: Vec<f64> = columns.last().map(|p| p.iter().map(|p| p.y).collect()).unwrap_or_default();
        let weight = |p: &FlowSlot| {
            let ys: Vec<f64> = p.from.iter().filter_map(|k| before.get(*k).copied()).collect();
            if ys.is_empty() { f64::MAX } else { ys.iter().sum::<f64>() / ys.len() as f64 }
        };
        places.sort_by(|a, b| weight(&a.0).total_cmp(&weight(&b.0)).then(a.1.cmp(&b.1)));
        stack(&mut places, &before);
        held = vec![None; nodes.len()];
        places.iter().enumerate().for_each(|(k, (_, i))| held[*i] = Some(k));
        columns.push(places.into_iter().map(|p| p.0).collect());
    }
    let low = columns.iter().flatten().map(|p| p.y - 0.5 * height(p)).fold(f64::INFINITY, f64::min);
    columns.iter_mut().flatten().for_each(|p| p.y -= low);
    columns
}

fn height(place: &FlowSlot) -> f64 {
    if place.node.is_some() { BOX_H } else { LANE_H }
}

/// Stacks the slots of a column, about the middle of the previous column.
fn stack(places: &mut [(FlowSlot, usize)], before: &[f64]) {
    let total: f64 = places.iter().map(|p| height(&p.0) + GAP_Y).sum::<f64>() - GAP_Y;
    let ends = before.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), y| (a.min(*y), b.max(*y)));
    let middle = if before.is_empty() { 0.0 } else { 0.5 * (ends.0 + ends.1) };
    let mut top = middle - 0.5 * total;
    for (place, _) in places {
        place.y = top + 0.5 * height(place);
        top += height(place) + GAP_Y;
    }
}

fn drawn(nodes: &[FlowNode]) -> Markup {
    let columns = layout(nodes);
    let x = |c: usize| 4.0 + c as f64 * (BOX_W + GAP_X);
    let bottom = columns.iter().flatten().map(|p| p.y + 0.5 * height(p)).fold(0.0, f64::max);
    let wide = x(columns.len()) - GAP_X + 4.0;
    html! {
        div.scroll {
            svg.flow viewBox=(format!("0 -4 {} {}", px(wide), px(bottom + 8.0)))
                style=(format!("min-width:{}px;max-width:{}px", px(0.72 * wide), px(1.1 * wide)))
                role="img" aria-label="The plan: tables and their inputs" {
                @for (c, places) in columns.iter().enumerate() { @for place in places {
                    @let before = c.checked_sub(1).and_then(|b| columns.get(b));
                    @for from in &place.from { @if let Some(before) = before.and_then(|p| p.get(*from)) {
                        path.arrow d=(arrow(x(c - 1) + BOX_W, before.y, x(c), place.y)) {}
                    } }
                    @match place.node {
                        Some(i) => { (boxed(&nodes[i], x(c), place)) }
                        None => { path.arrow d=(format!("M{} {}h{}", px(x(c)), px(place.y), px(BOX_W))) {} }
                    }
                } }
            }
        }
    }
}

fn arrow(x0: f64, y0: f64, x1: f64, y1: f64) -> String {
    let middle = px(0.5 * (x0 + x1));
    format!("M{} {}C{middle} {} {middle} {} {} {}", px(x0), px(y0), px(y0), px(y1), px(x1), px(y1))
}

fn boxed(node: &FlowNode, x: f64, place: &FlowSlot) -> Markup {
    let top = place.y - 0.5 * BOX_H;
    let fit = |text: &str, most: usize| {
        if text.chars().count() > most { text.chars().take(most - 1).chain(['…']).collect() } else { text.to_owned() }
    };
    html! {
        g.box.source[node.source].incomplete[node.incomplete] {
            title { (node.name) ": " (node.lines.join("; ")) }
            rect x=(px(x)) y=(px(top)) width=(BOX_W) height=(BOX_H) rx="6" {}
            text.title x=(px(x + 9.0)) y=(px(top + 18.0)) { (fit(&node.name, 18)) }
            @for (k, text) in node.lines.iter().enumerate() {
                text x=(px(x + 9.0)) y=(px(top + 34.0 + 15.0 * k as f64)) { (fit(text, 22)) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(name: &str, inputs: &[usize], source: bool) -> FlowNode {
        FlowNode { name: name.into(), lines: vec![], inputs: inputs.to_vec(), source, incomplete: false }
    }

    /// flights, map, even, terms, coefficients, clean, track, scores.
    fn example() -> Vec<FlowNode> {
        vec![
            node("flights", &[], true),
            node("anomaly", &[], true),
            node("even", &[0], false),
            node("terms", &[2], false),
            node("coefficients", &[3], false),
            node("clean", &[3, 4], false),
            node("track", &[1, 5], false),
            node("scores", &[5, 6], false),
        ]
    }

    #[test]
    fn unit_a_table_is_right_of_its_inputs() {
        // The map is just before the track, its only reader.
        assert_eq!(columns_of(&example()), [0, 4, 1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn unit_long_arrows_have_a_lane_and_nothing_overlaps() {
        let columns = layout(&example());
        let lanes = columns.iter().flatten().filter(|p| p.node.is_none()).count();
        // The arrow from `terms` passes the box `coefficients`, and the arrow from `clean` passes the box `track`.
        assert_eq!(lanes, 2);
        for places in &columns {
            for pair in places.windows(2) {
                assert!(pair[1].y - pair[0].y >= 0.5 * (height(&pair[0]) + height(&pair[1])));
            }
        }
        assert!(columns.iter().flatten().all(|p| p.y >= 0.0));
    }
}

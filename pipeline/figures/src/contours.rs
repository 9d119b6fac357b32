//! Contour lines.

use std::collections::BTreeMap;

use schemas::Fault;

use super::{
    footer::LegendEntry,
    frame::MapFrame,
    scene::{Ink, PaperPoint, SceneMark},
    sheet::{DisplayGrid, sheet},
};
use crate::ticks;

/// Maximum number of contour levels.
const MOST: f64 = 400.0;
/// Number of contour steps between heavier lines.
const HEAVY: i64 = 5;
/// Cell length on the paper for contouring; finer cells are averaged, so that noise gives no lines.
const CELL: f64 = 2.5;

/// Lines at multiples of `step`, and their entry in the legend.
///
/// # Errors
/// Fails if `step` is not positive or gives too many lines.
pub fn marks(frame: &MapFrame, step: f64) -> Result<(Vec<SceneMark>, LegendEntry), Fault> {
    if !(step > 0.0 && step.is_finite()) {
        return Err(
            Fault::new(format!("contours at intervals of {step} cannot be drawn")).help("give a step above zero")
        );
    }
    let size = ((frame.rect.w / CELL).ceil() as usize, (frame.rect.h / CELL).ceil() as usize);
    let sheet = sheet(frame.picture, &frame.window, size);
    let known = || sheet.values.iter().copied().filter(|v| v.is_finite());
    let (low, high) = known().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    let (first, last) = ((low / step).ceil(), (high / step).floor());
    if last - first >= MOST {
        let unit = frame.picture.unit;
        return Err(Fault::new(format!(
            "contours at intervals of {step} {unit} would give {} lines",
            last - first + 1.0
        ))
        .help(format!("the values run from {low:.1} to {high:.1} {unit}; the limit is {MOST} lines")));
    }
    let (mut light, mut heavy) = (vec![], vec![]);
    for k in first as i64..=last as i64 {
        let lines = lines(&sheet, k as f64 * step).into_iter();
        let lines = lines.map(|line| line.into_iter().map(|(x, y)| frame.spot(x, y)).collect());
        if k % HEAVY == 0 { heavy.extend(lines) } else { light.extend::<Vec<Vec<PaperPoint>>>(lines.collect()) }
    }
    let pen = |lines: Vec<Vec<PaperPoint>>, width: f64, opacity: f64| {
        let ink = Ink { rgb: [0, 0, 0], opacity };
        (!lines.is_empty()).then_some(SceneMark::Stroke { lines, width, ink, within: Some(frame.rect) })
    };
    let marks = [pen(light, 0.5, 0.5), pen(heavy, 1.0, 0.65)].into_iter().flatten().collect();
    Ok((marks, LegendEntry::Contours(name(step, frame.picture.unit))))
}

fn name(step: f64, unit: &str) -> String {
    let heavy = ticks::fixed(step * HEAVY as f64, 6);
    let heavy = heavy.trim_end_matches('0').trim_end_matches('.');
    format!("contours every {step} {unit}, heavy lines every {heavy}")
}

/// Lines of one value, in the map's coordinates, by marching squares; the mean of a saddle cell determines which lines
/// are connected in it.
fn lines(sheet: &DisplayGrid, level: f64) -> Vec<Vec<PaperPoint>> {
    let mut links: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for row in 0..sheet.y.len.saturating_sub(1) {
        for column in 0..sheet.x.len.saturating_sub(1) {
            for (a, b) in cuts(sheet, row, column, level) {
                links.entry(a).or_default().push(b);
                links.entry(b).or_default().push(a);
            }
        }
    }
    let mut out = vec![];
    // Open lines are followed from an end, closed lines from any edge.
    let ends: Vec<usize> = links.iter().filter(|(_, to)| to.len() == 1).map(|(at, _)| *at).collect();
    let all: Vec<usize> = links.keys().copied().collect();
    for start in ends.into_iter().chain(all) {
        let line = walk(&mut links, start);
        if line.len() > 1 {
            out.push(line.into_iter().map(|edge| crossing(sheet, edge, level)).collect());
        }
    }
    out
}

/// Follows a line from the edge `start`, removes its links, and returns its edges.
fn walk(links: &mut BTreeMap<usize, Vec<usize>>, start: usize) -> Vec<usize> {
    let mut line = vec![start];
    let mut at = start;
    while let Some(next) = links.get_mut(&at).and_then(Vec::pop) {
        if let Some(back) = links.get_mut(&next)
            && let Some(k) = back.iter().position(|b| *b == at)
        {
            back.remove(k);
        }
        line.push(next);
        at = next;
    }
    line
}

/// Pairs of edges of a cell, each joined by a contour line. Edge 2k runs from node k to the east, edge 2k + 1 from node
/// k to the north.
fn cuts(sheet: &DisplayGrid, row: usize, column: usize, level: f64) -> Vec<(usize, usize)> {
    let width = sheet.x.len;
    let node = row * width + column;
    let corners =
        [node, node + 1, node + width + 1, node + width].map(|k| sheet.values.get(k).copied().unwrap_or(f64::NAN));
    if corners.iter().any(|v| !v.is_finite()) {
        return vec![];
    }
    let above = corners.map(|v| v >= level);
    let edges = [2 * node, 2 * (node + 1) + 1, 2 * (node + width), 2 * node + 1];
    let crossed: Vec<usize> = (0..4).filter(|k| above[*k] != above[(k + 1) % 4]).map(|k| edges[k]).collect();
    match crossed[..] {
        [a, b] => vec![(a, b)],
        [south, east, north, west] => {
            let mean_above = corners.iter().sum::<f64>() >= 4.0 * level;
            // The south-west corner is cut off if it and the middle of the cell are on different sides of the level.
            if above[0] == mean_above { vec![(south, east), (north, west)] } else { vec![(south, west), (east, north)] }
        }
        _ => vec![],
    }
}

/// Crossing of the level and an edge.
fn crossing(sheet: &DisplayGrid, edge: usize, level: f64) -> PaperPoint {
    let (node, upward) = (edge / 2, edge % 2 == 1);
    let other = node + if upward { sheet.x.len } else { 1 };
    let value = |k: usize| sheet.values.get(k).copied().unwrap_or(f64::NAN);
    let part = (level - value(node)) / (value(other) - value(node));
    let (row, column) = ((node / sheet.x.len) as f64, (node % sheet.x.len) as f64);
    if upward { (sheet.x.at(column), sheet.y.at(row + part)) } else { (sheet.x.at(column + part), sheet.y.at(row)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{sheet::MapWindow, tests::picture};

    fn drawn(columns: usize, values: &[f64], level: f64) -> Vec<Vec<PaperPoint>> {
        let map = picture(columns, values.len() / columns, values);
        lines(&sheet(&map, &MapWindow::from_picture(&map), (1000, 1000)), level)
    }

    #[test]
    fn unit_a_cone_has_circles_and_a_plane_straight_lines() {
        let cone: Vec<f64> = (0..41 * 41).map(|k| f64::from(k % 41 - 20).hypot(f64::from(k / 41 - 20))).collect();
        let circle = drawn(41, &cone, 12.5);
        assert_eq!(circle.len(), 1);
        assert_eq!(circle[0].first(), circle[0].last());
        // Linear interpolation of the cone between nodes has an error of at most 1/8 of its curvature, which is about
        // 1/12.
        assert!(circle[0].iter().all(|(x, y)| ((x - 20.0).hypot(y - 20.0) - 12.5).abs() < 0.02));
        let plane: Vec<f64> = (0..30).map(|k| f64::from(k % 6) + 0.25).collect();
        let line = drawn(6, &plane, 2.0);
        assert_eq!(line.len(), 1);
        assert!(line[0].len() == 5 && line[0].iter().all(|(x, _)| (x - 1.75).abs() < 1e-12));
    }

    #[test]
    fn unit_saddle_is_resolved_by_its_mean() {
        let saddle = [1.0, 0.0, 0.0, 1.0];
        let joined = |level: f64| {
            let mut ends: Vec<PaperPoint> = drawn(2, &saddle, level).into_iter().map(|l| l[0]).collect();
            ends.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
            (drawn(2, &saddle, level).len(), ends)
        };
        // At a level below the mean, the two high corners belong to one area. The two low corners, south-east and
        // north-west, are cut off.
        let (count, _) = joined(0.4);
        assert_eq!(count, 2);
        for line in drawn(2, &saddle, 0.4) {
            let (x, y) = (0.5 * (line[0].0 + line[1].0), 0.5 * (line[0].1 + line[1].1));
            assert!((x - 0.5) * (y - 0.5) < 0.0, "{line:?}");
        }
        for line in drawn(2, &saddle, 0.6) {
            let (x, y) = (0.5 * (line[0].0 + line[1].0), 0.5 * (line[0].1 + line[1].1));
            assert!((x - 0.5) * (y - 0.5) > 0.0, "{line:?}");
        }
    }

    #[test]
    fn unit_lines_end_at_gaps() {
        let mut plane: Vec<f64> = (0..35).map(|k| f64::from(k % 5)).collect();
        plane[17] = f64::NAN;
        let broken = drawn(5, &plane, 1.5);
        assert_eq!(broken.iter().map(Vec::len).collect::<Vec<_>>(), [3, 3]);
    }

    #[test]
    fn gold_legend_of_contours() {
        assert_eq!(name(25.0, "nT"), "contours every 25 nT, heavy lines every 125");
        assert_eq!(name(0.1, "nT"), "contours every 0.1 nT, heavy lines every 0.5");
    }
}

//! Crossings of survey lines.

use crate::{maps::gridding::SurveyPoints, regression::statistics::median};
use rayon::prelude::*;

/// Criteria for crossovers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrossoverOptions {
    /// Limit in metres: if two successive points of a line are farther apart, the gap between them is not interpolated.
    /// `None` is twenty times the median distance between points.
    pub gap_m: Option<f64>,
    /// Minimum angle of a crossing, in degrees; the position of shallower crossings is uncertain.
    pub least_angle_deg: f64,
    /// Maximum difference in height of two crossing lines, in metres.
    pub most_height_m: f64,
    /// Vertical gradient, nT/m upward, with which values are reduced to the mean height of the two lines; zero leaves
    /// them unchanged.
    pub vertical_gradient_nt_per_m: f64,
}

impl Default for CrossoverOptions {
    /// Angles of at least 20 degrees, heights within 50 m, no gradient.
    fn default() -> Self {
        Self { gap_m: None, least_angle_deg: 20.0, most_height_m: 50.0, vertical_gradient_nt_per_m: 0.0 }
    }
}

/// A crossing of two lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossover {
    /// The two lines.
    pub lines: [usize; 2],
    /// Index, for each line, of the last point before the crossing.
    pub points: [usize; 2],
    /// Position of the crossing in each line, as a fraction, 0 to 1, of the step to the next point.
    pub parts: [f64; 2],
    /// Easting and northing, in metres.
    pub at_m: [f64; 2],
    /// Heights of the two lines at the crossing, in metres.
    pub height_m: [f64; 2],
    /// Values of the two lines at the crossing, in nT.
    pub value_nt: [f64; 2],
    /// Magnitude of the horizontal gradient of the field at the crossing, from the slopes along both lines, in nT/m.
    pub gradient_nt_per_m: f64,
}

/// Number of points on either side of a crossing that determine the slope along a line.
const BESIDE: usize = 3;

impl Crossover {
    /// Value of the first line minus value of the second line, in nT.
    pub fn difference_nt(&self) -> f64 {
        self.value_nt[0] - self.value_nt[1]
    }
}

/// Finds the crossings of a survey's lines, in the order of the points before the crossing.
///
/// Segments between points are sorted into square cells, and only segments in the same cell are compared. Points that
/// are not finite end a segment.
pub fn find_crossovers(points: SurveyPoints, options: &CrossoverOptions) -> Vec<Crossover> {
    let all: Vec<usize> = (0..points.len().saturating_sub(1)).filter(|&i| joined(points, i)).collect();
    let mut lengths: Vec<f64> = all.iter().map(|&i| length(points, i)).collect();
    let usual = median(&mut lengths);
    let gap = options.gap_m.unwrap_or(20.0 * usual);
    let cell_m = (4.0 * usual).max(1e-3);
    let mut cells: Vec<([i64; 2], usize)> = Vec::new();
    for &i in all.iter().filter(|&&i| length(points, i) <= gap) {
        let [e, n] = [points.easting_m, points.northing_m].map(|axis| {
            let ends = [axis[i], axis[i + 1]].map(|x| (x / cell_m).floor() as i64);
            [ends[0].min(ends[1]), ends[0].max(ends[1])]
        });
        cells.extend((n[0]..=n[1]).flat_map(|r| (e[0]..=e[1]).map(move |c| ([r, c], i))));
    }
    cells.par_sort_unstable();
    let groups: Vec<&[([i64; 2], usize)]> = cells.chunk_by(|a, b| a.0 == b.0).collect();
    let mut found: Vec<Crossover> = groups
        .par_iter()
        .flat_map_iter(|group| pairs(group).filter_map(|(i, j)| crossing(points, [i, j], gap, options)))
        .collect();
    found.sort_by_key(|c| c.points);
    found.dedup_by_key(|c| c.points);
    found
}

fn pairs(group: &[([i64; 2], usize)]) -> impl Iterator<Item = (usize, usize)> + '_ {
    group.iter().enumerate().flat_map(|(k, a)| group[k + 1..].iter().map(|b| (a.1, b.1)))
}

fn joined(points: SurveyPoints, i: usize) -> bool {
    let finite =
        |i: usize| (points.easting_m[i] + points.northing_m[i] + points.height_m[i] + points.value_nt[i]).is_finite();
    points.line[i] == points.line[i + 1] && finite(i) && finite(i + 1) && length(points, i) > 0.0
}

fn way(points: SurveyPoints, i: usize) -> [f64; 2] {
    [points.easting_m[i + 1] - points.easting_m[i], points.northing_m[i + 1] - points.northing_m[i]]
}

fn length(points: SurveyPoints, i: usize) -> f64 {
    let [e, n] = way(points, i);
    e.hypot(n)
}

/// Slope of the field along a line around the segment that begins at point `i`, in nT/m, from points at most `gap_m`
/// apart.
fn slope(points: SurveyPoints, i: usize, gap_m: f64) -> f64 {
    let linked = |k: &usize| *k + 1 < points.len() && joined(points, *k) && length(points, *k) <= gap_m;
    let before = (i.saturating_sub(BESIDE)..i).rev().take_while(linked).count();
    let after = (i + 1..i + 1 + BESIDE).take_while(linked).count();
    let (from, to) = (i - before, i + 1 + after);
    let apart_m = (from..to).map(|k| length(points, k)).sum::<f64>();
    (points.value_nt[to] - points.value_nt[from]) / apart_m
}

/// Magnitude of a gradient from its slopes along two directions that are not parallel.
fn gradient_size(ways: [[f64; 2]; 2], slopes: [f64; 2]) -> f64 {
    let [a, b] = ways.map(|[e, n]| [e / e.hypot(n), n / e.hypot(n)]);
    let sine = a[0] * b[1] - a[1] * b[0];
    let [east, north] = [(slopes[0] * b[1] - slopes[1] * a[1]) / sine, (slopes[1] * a[0] - slopes[0] * b[0]) / sine];
    east.hypot(north)
}

fn crossing(points: SurveyPoints, [i, j]: [usize; 2], gap_m: f64, options: &CrossoverOptions) -> Option<Crossover> {
    if points.line[i] == points.line[j] {
        return None;
    }
    let (a, b) = (way(points, i), way(points, j));
    let sine = a[0] * b[1] - a[1] * b[0];
    if sine.abs() < options.least_angle_deg.to_radians().sin() * a[0].hypot(a[1]) * b[0].hypot(b[1]) {
        return None;
    }
    let from = [points.easting_m[j] - points.easting_m[i], points.northing_m[j] - points.northing_m[i]];
    let parts = [(from[0] * b[1] - from[1] * b[0]) / sine, (from[0] * a[1] - from[1] * a[0]) / sine];
    // A crossing at a point belongs to the segment that starts there.
    if !parts.iter().all(|p| (0.0..1.0).contains(p)) {
        return None;
    }
    let between =
        |column: &[f64]| [(i, parts[0]), (j, parts[1])].map(|(k, p)| column[k] + p * (column[k + 1] - column[k]));
    let (height_m, value) = (between(points.height_m), between(points.value_nt));
    let above = 0.5 * (height_m[0] - height_m[1]);
    if (2.0 * above).abs() > options.most_height_m {
        return None;
    }
    let raise = options.vertical_gradient_nt_per_m * above;
    Some(Crossover {
        lines: [points.line[i], points.line[j]],
        points: [i, j],
        parts,
        at_m: [points.easting_m[i] + parts[0] * a[0], points.northing_m[i] + parts[0] * a[1]],
        height_m,
        value_nt: [value[0] - raise, value[1] + raise],
        gradient_nt_per_m: gradient_size([a, b], [i, j].map(|k| slope(points, k, gap_m))),
    })
}

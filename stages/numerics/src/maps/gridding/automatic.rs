//! Gridding parameters derived from the survey's own spacing.

use super::layer::SourceLayer;
use super::nearest::{PointCellIndex, range};
use super::survey::SurveyPoints;
use crate::regression::statistics::median;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Target number of points at which the distance to the next line is computed; the actual number is below twice the
/// target.
const PROBES: usize = 4000;

/// The cosine of 30 degrees.
const PARALLEL: f64 = 0.866;

/// Median distance in metres from a point to the nearest line parallel to the point's own line: the headings differ by
/// less than 30 degrees, and the other line is sideways rather than ahead. For a single line, the square root of the
/// mean area per point.
pub fn line_spacing_m(points: SurveyPoints) -> f64 {
    let count = points.len();
    let near = PointCellIndex::new(&points.easting_m[..count], &points.northing_m[..count]);
    let headings = headings(points);
    let heading = |i: usize| headings.get(&points.line[i]).copied().unwrap_or([1.0, 0.0]);
    let beside = |i: usize, j: usize| {
        let (a, b) = (heading(i), heading(j));
        let way = [points.easting_m[j] - points.easting_m[i], points.northing_m[j] - points.northing_m[i]];
        let [ahead, across] = [a[0] * way[0] + a[1] * way[1], a[0] * way[1] - a[1] * way[0]];
        points.line[i] != points.line[j] && (a[0] * b[0] + a[1] * b[1]).abs() > PARALLEL && across.abs() > ahead.abs()
    };
    let mut apart: Vec<f64> = (0..count)
        .into_par_iter()
        .step_by((count / PROBES).max(1))
        .filter_map(|i| {
            let at = [points.easting_m[i], points.northing_m[i]];
            near.nearest(at, 1, f64::INFINITY, |j| beside(i, j)).first().map(|found| found.0.sqrt())
        })
        .collect();
    let [e, n] = [points.easting_m, points.northing_m].map(|axis| range(&axis[..count]));
    let alone = ((e[1] - e[0]).max(1.0) * (n[1] - n[0]).max(1.0) / count.max(1) as f64).sqrt();
    let spacing = if apart.is_empty() { alone } else { median(&mut apart) };
    spacing.max(1.0)
}

/// Unit vectors from the first to the last point of each line.
fn headings(points: SurveyPoints) -> BTreeMap<usize, [f64; 2]> {
    let of = |run: std::ops::Range<usize>| {
        let (a, b) = (run.start, run.end - 1);
        let way = [points.easting_m[b] - points.easting_m[a], points.northing_m[b] - points.northing_m[a]];
        let length = way[0].hypot(way[1]).max(f64::MIN_POSITIVE);
        (points.line[a], way.map(|w| w / length))
    };
    points.runs().into_iter().map(of).collect()
}

/// Block side for lines `spacing_m` apart: a quarter of the spacing, but at most 200 m. A hundred or a few hundred
/// metres above its sources, the field changes over such distances at any line spacing.
pub fn block_m(spacing_m: f64) -> f64 {
    (0.25 * spacing_m).min(200.0)
}

/// Layers of sources for blocks of `block_m` on lines `spacing_m` apart in a survey that is `extent_m` across.
///
/// The shallowest layer is two blocks deep, which keeps the detail along a line. Each further layer is twice as deep,
/// up to a quarter of the survey's extent. Sources are 0.7 depths apart: the field of a finer arrangement would be
/// attenuated by 99 % at the measurements. A layer shallower than the distance between lines extends one depth beyond
/// the measurements, so that deeper layers fill the gap between lines. The other layers extend two depths beyond the
/// measurements.
pub fn layers(block_m: f64, spacing_m: f64, extent_m: f64) -> Vec<SourceLayer> {
    let shallowest = (2.0 * block_m).max(1.0);
    let depths = (0..24).map(|k| shallowest * f64::from(1 << k));
    let mut layers: Vec<SourceLayer> = depths
        .enumerate()
        .take_while(|(k, depth_m)| *k == 0 || *depth_m <= 0.25 * extent_m)
        .map(|(_, depth_m)| SourceLayer {
            depth_m,
            spacing_m: 0.7 * depth_m,
            reach_m: if depth_m < spacing_m { depth_m } else { 2.0 * depth_m },
        })
        .collect();
    layers.reverse();
    layers
}

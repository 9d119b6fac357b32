//! The surface of minimum curvature through the data, optionally under tension.
//!
//! Briggs (1974), "Machine contouring using minimum curvature", with the tension of Smith & Wessel (1990), "Gridding
//! with continuous curvature splines in tension": (1 - T) ∇²(∇²u) - T ∇²u = 0 away from data, natural edges. A datum
//! that is not on a node enters the curvature at the nearest node through a second-order expansion. Grids are nested:
//! each spacing starts from the surface with twice the spacing.

use super::plane::RegionalPlane;
use super::sheet::{GridDatum, RelaxationGrid, RelaxationOptions, RelaxationReport};
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

/// Grids values in nT at eastings and northings in metres onto the nodes of two axes; data outside the nodes' cells
/// are ignored.
///
/// Several data in a node's cell are replaced by their mean value at their mean position.
pub fn minimum_curvature(
    at_m: [&[f64]; 2],
    value_nt: &[f64],
    axes: [EvenAxis; 2],
    relaxation: &RelaxationOptions,
) -> (PlaneGrid, RelaxationReport) {
    let [east_m, north_m] = axes;
    let plane = RegionalPlane::fitted(at_m, value_nt);
    let rest: Vec<f64> = (0..value_nt.len()).map(|i| value_nt[i] - plane.at(at_m[0][i], at_m[1][i])).collect();
    let coarsest = (0..16).rev().find(|k| east_m.len.min(north_m.len) > (4 << k)).unwrap_or(0);
    let mut sheet: Option<RelaxationGrid> = None;
    let mut relaxed = RelaxationReport { passes: 0, left_nt: 0.0 };
    for scale in (0..=coarsest).rev() {
        let [east, north] = axes.map(|axis| wider(axis, 1 << scale));
        let mut next =
            sheet.map_or_else(|| RelaxationGrid::flat(east.len, north.len), |s| s.refined(east.len, north.len));
        next.constrain(constraints(at_m, &rest, [east, north]), relaxation.tension);
        relaxed = next.relax(relaxation);
        sheet = Some(next);
    }
    let heights = sheet.map(|s| s.values()).unwrap_or_default();
    let at = |k: usize| plane.at(east_m.at((k % east_m.len) as f64), north_m.at((k / east_m.len) as f64));
    let values = heights.iter().enumerate().map(|(k, v)| v + at(k)).collect();
    (PlaneGrid { east_m, north_m, values }, relaxed)
}

fn wider(axis: EvenAxis, times: usize) -> EvenAxis {
    EvenAxis { first: axis.first, step: axis.step * times as f64, len: axis.len.saturating_sub(1).div_ceil(times) + 1 }
}

/// One datum per node.
fn constraints(at_m: [&[f64]; 2], rest: &[f64], [east, north]: [EvenAxis; 2]) -> Vec<GridDatum> {
    let nodes: Vec<[f64; 3]> = (0..rest.len())
        .map(|i| [east.node(at_m[0][i]), north.node(at_m[1][i]), rest[i]])
        .filter(|[c, r, _]| {
            let inside = |x: f64, n: usize| x >= -0.5 && x < n as f64 - 0.5;
            inside(*c, east.len) && inside(*r, north.len)
        })
        .collect();
    let mut by_cell: Vec<([i64; 2], usize)> =
        nodes.iter().enumerate().map(|(i, [c, r, _])| ([r, c].map(|x| (x + 0.5).floor() as i64), i)).collect();
    by_cell.sort_unstable();
    let mean = |run: &[([i64; 2], usize)]| {
        [0, 1, 2].map(|k| run.iter().map(|r| nodes[r.1][k]).sum::<f64>() / run.len() as f64)
    };
    by_cell.chunk_by(|a, b| a.0 == b.0).map(|run| GridDatum::from_point(mean(run))).collect()
}

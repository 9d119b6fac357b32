//! Preconditioner for the normal equations of a layer: exact solutions in small overlapping windows.

use super::clusters::{ClusterTree, PointPositions};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, Mat, Par, Side};
use rayon::prelude::*;

/// Maximum number of sources of a window, without the overlap.
const CORE: usize = 256;

/// Overlap of the windows' sources, in depths; measurements are included up to twice this distance.
const OVERLAP: f64 = 1.5;

/// Overlapping-window (Schwarz) preconditioner of a layer.
pub(super) struct SchwarzPreconditioner {
    windows: Vec<SchwarzWindow>,
    /// Reciprocal square root of the number of windows that contain a source.
    share: Vec<f64>,
}

struct SchwarzWindow {
    sources: Vec<usize>,
    /// Rows of the Cholesky factor's lower triangle. Single precision is enough for a preconditioner.
    factor: Vec<f32>,
}

impl SchwarzPreconditioner {
    /// Windows over `sources` at `depth_m`, with the measurements at `data`, for `damping`.
    pub fn new(sources: &ClusterTree, data: &ClusterTree, depth_m: f64, damping: f64) -> Self {
        let cores = ClusterTree::new(&sources.points, CORE);
        let windows: Vec<SchwarzWindow> = cores
            .leaves()
            .into_par_iter()
            .map(|core| {
                let around = |reach: f64| {
                    [0, 1].map(|a| [core.centre[a] - core.half[a] - reach, core.centre[a] + core.half[a] + reach])
                };
                let members = inside(sources, around(OVERLAP * depth_m));
                let seen = inside(data, around(2.0 * OVERLAP * depth_m));
                let factor = factor(sources.points.pick(&members), data.points.pick(&seen), depth_m, damping);
                SchwarzWindow { sources: members, factor }
            })
            .collect();
        let mut share = vec![0.0; sources.points.len()];
        windows.iter().flat_map(|w| &w.sources).for_each(|&i| share[i] += 1.0);
        share.iter_mut().for_each(|s: &mut f64| *s = 1.0 / s.max(1.0).sqrt());
        Self { windows, share }
    }

    /// Solves the normal equations of the windows for a right-hand side.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let parts: Vec<Vec<f64>> = self
            .windows
            .par_iter()
            .map(|w| {
                let mut x: Vec<f64> = w.sources.iter().map(|&i| self.share[i] * right[i]).collect();
                solve(&w.factor, &mut x);
                x
            })
            .collect();
        let mut sum = vec![0.0; right.len()];
        for (window, part) in self.windows.iter().zip(parts) {
            window.sources.iter().zip(part).for_each(|(&i, x)| sum[i] += self.share[i] * x);
        }
        sum
    }
}

/// Indices, ascending, of the sorted points between two eastings and two northings.
fn inside(clusters: &ClusterTree, [east, north]: [[f64; 2]; 2]) -> Vec<usize> {
    let (mut open, mut found) = (vec![0], Vec::new());
    let points = &clusters.points;
    while let Some(at) = open.pop() {
        let b = &clusters.boxes[at];
        let apart = |a: usize, [low, high]: [f64; 2]| b.centre[a] - b.half[a] > high || b.centre[a] + b.half[a] < low;
        if apart(0, east) || apart(1, north) {
            continue;
        }
        match b.children {
            Some(children) => open.extend(children),
            None => found.extend((b.start..b.end).filter(|&i| {
                (east[0]..=east[1]).contains(&points.east[i]) && (north[0]..=north[1]).contains(&points.north[i])
            })),
        }
    }
    found.sort_unstable();
    found
}

/// Cholesky factor of KᵀK + damping. If no factor exists, the result is empty, which represents the unit matrix.
fn factor(sources: PointPositions, data: PointPositions, depth_m: f64, damping: f64) -> Vec<f32> {
    let scale = depth_m * depth_m;
    let kernel = Mat::from_fn(data.len(), sources.len(), |i, j| {
        let up = data.up[i] - sources.up[j];
        let (de, dn) = (data.east[i] - sources.east[j], data.north[i] - sources.north[j]);
        let inverse = 1.0 / (de * de + dn * dn + up * up);
        scale * up * inverse * inverse.sqrt()
    });
    let n = sources.len();
    let mut normal = Mat::<f64>::from_fn(n, n, |i, j| if i == j { damping } else { 0.0 });
    let (lower, whole) = (BlockStructure::TriangularLower, BlockStructure::Rectangular);
    matmul(&mut normal, lower, Accum::Add, kernel.transpose(), whole, &kernel, whole, 1.0, Par::Seq);
    let Ok(llt) = normal.llt(Side::Lower) else { return Vec::new() };
    let l = llt.L();
    (0..n).flat_map(|i| (0..=i).map(move |j| l[(i, j)] as f32)).collect()
}

fn solve(factor: &[f32], x: &mut [f64]) {
    if factor.is_empty() {
        return;
    }
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            let mut start = 0;
            for i in 0..x.len() {
                let row = &factor[start..start + i];
                let (done, rest) = x.split_at_mut(i);
                rest[0] = (rest[0] - dot(row, done)) / f64::from(factor[start + i]);
                start += i + 1;
            }
            for i in (0..x.len()).rev() {
                start -= i + 1;
                let row = &factor[start..start + i];
                let (before, rest) = x.split_at_mut(i);
                rest[0] /= f64::from(factor[start + i]);
                let v = rest[0];
                before.iter_mut().zip(row).for_each(|(b, l)| *b -= v * f64::from(*l));
            }
        },
    );
}

/// Dot product in eight partial sums, which are computed in parallel lanes.
#[inline(always)]
fn dot(row: &[f32], x: &[f64]) -> f64 {
    let mut strands = [0.0; 8];
    let (rows, xs) = (row.chunks_exact(8), x.chunks_exact(8));
    let rest: f64 = rows.remainder().iter().zip(xs.remainder()).map(|(l, x)| f64::from(*l) * x).sum();
    for (l, x) in rows.zip(xs) {
        for k in 0..8 {
            strands[k] += f64::from(l[k]) * x[k];
        }
    }
    rest + strands.iter().sum::<f64>()
}

//! Sums over all sources at all targets, with far fewer kernel evaluations than there are pairs of source and target.
//!
//! Boxes whose distance is large compared with their size interact through Chebyshev points. The sources are projected
//! onto the Chebyshev points of their box, and the kernel is evaluated between the points of the two boxes. The sum is
//! interpolated to the targets. [Wang, Tlupova & Krasny 2020, "A kernel-independent treecode based on barycentric
//! Lagrange interpolation"] The order of each sum is the same for any number of threads.

use super::clusters::{ClusterBox, ClusterTree, PROXIES, PointPositions};
use super::kernel::{PointSources, add_gradients, add_values};
use rayon::prelude::*;

/// Sources in boxes, with equivalent strengths at the boxes' Chebyshev points for distant evaluation.
pub(super) struct ProxySources<'a> {
    clusters: &'a ClusterTree,
    strength: &'a [f64],
    proxies: &'a [PointPositions],
    spread: Vec<Vec<f64>>,
    /// Two boxes are far apart if the sum of their radii is less than this fraction of their distance.
    far: f64,
}

/// The Chebyshev points of all boxes.
pub(super) fn all_proxies(clusters: &ClusterTree) -> Vec<PointPositions> {
    clusters.boxes.par_iter().map(ClusterBox::proxies).collect()
}

impl<'a> ProxySources<'a> {
    /// Proxies for the sources; `strength` is in the sorted order of the clusters.
    pub fn new(clusters: &'a ClusterTree, proxies: &'a [PointPositions], strength: &'a [f64], far: f64) -> Self {
        let mut spread: Vec<Vec<f64>> =
            clusters.boxes.par_iter().map(|b| spread_points(clusters, b, strength)).collect();
        for at in (0..clusters.boxes.len()).rev() {
            if let Some(children) = clusters.boxes[at].children {
                let mut sum = vec![0.0; PROXIES];
                for child in children {
                    spread_proxies(&clusters.boxes[at], &proxies[child], &spread[child], &mut sum);
                }
                spread[at] = sum;
            }
        }
        Self { clusters, strength, proxies, spread, far }
    }

    fn points(&self, cluster: &ClusterBox) -> PointSources<'_> {
        let part = cluster.start..cluster.end;
        PointSources { at: self.clusters.points.part(part.clone()), strength: &self.strength[part] }
    }

    fn stand_ins(&self, at: usize) -> PointSources<'_> {
        PointSources { at: self.proxies[at].part(0..PROXIES), strength: &self.spread[at] }
    }

    /// Calls `visit` for boxes that together contain all sources, with the sources of the box and whether the box is
    /// far; proxies may replace the sources of a far box.
    fn each(&self, target: &ClusterBox, mut visit: impl FnMut(PointSources, bool)) {
        let mut open = vec![0];
        while let Some(at) = open.pop() {
            let cluster = &self.clusters.boxes[at];
            let count = cluster.end - cluster.start;
            if count == 0 {
                continue;
            }
            let apart: f64 = (0..3).map(|a| (cluster.centre[a] - target.centre[a]).powi(2)).sum::<f64>().sqrt();
            let far = cluster.radius + target.radius < self.far * apart;
            match cluster.children {
                _ if far && count > PROXIES => visit(self.stand_ins(at), true),
                _ if far => visit(self.points(cluster), true),
                Some(children) => open.extend(children),
                None => visit(self.points(cluster), false),
            }
        }
    }

    /// Sum of strength · h / r³ at the targets, in their sorted order; see `add_values` for `sign`.
    pub fn values(&self, targets: &ClusterTree, sign: f64) -> Vec<f64> {
        let parts: Vec<(usize, Vec<f64>)> =
            targets.leaves().into_par_iter().map(|leaf| (leaf.start, self.values_in(targets, leaf, sign))).collect();
        joined(parts, targets.points.len())
    }

    fn values_in(&self, targets: &ClusterTree, leaf: &ClusterBox, sign: f64) -> Vec<f64> {
        let count = leaf.end - leaf.start;
        let at = targets.points.part(leaf.start..leaf.end);
        let proxies = leaf.proxies();
        let stand_ins = proxies.part(0..PROXIES);
        let mut sum = vec![0.0; count];
        let mut far_sum = vec![0.0; PROXIES];
        self.each(leaf, |sources, far| {
            if far && count > PROXIES {
                add_values(stand_ins, sources, sign, &mut far_sum);
            } else {
                add_values(at, sources, sign, &mut sum);
            }
        });
        if count > PROXIES {
            interpolate(leaf, at, &far_sum, &mut sum);
        }
        sum
    }

    /// Value, east, north and upward derivative of the sum at the targets, in their sorted order.
    pub fn gradients(&self, targets: &ClusterTree) -> [Vec<f64>; 4] {
        let parts: Vec<(usize, [Vec<f64>; 4])> =
            targets.leaves().into_par_iter().map(|leaf| (leaf.start, self.gradients_in(targets, leaf))).collect();
        [0, 1, 2, 3].map(|field| {
            joined(parts.iter().map(|(start, fields)| (*start, fields[field].clone())).collect(), targets.points.len())
        })
    }

    fn gradients_in(&self, targets: &ClusterTree, leaf: &ClusterBox) -> [Vec<f64>; 4] {
        let count = leaf.end - leaf.start;
        let at = targets.points.part(leaf.start..leaf.end);
        let proxies = leaf.proxies();
        let mut sums = [0; 4].map(|_| vec![0.0; count]);
        let mut far_sums = [0; 4].map(|_| vec![0.0; PROXIES]);
        self.each(leaf, |sources, far| {
            if far && count > PROXIES {
                add_gradients(proxies.part(0..PROXIES), sources, &mut far_sums);
            } else {
                add_gradients(at, sources, &mut sums);
            }
        });
        if count > PROXIES {
            far_sums.iter().zip(&mut sums).for_each(|(far, sum)| interpolate(leaf, at, far, sum));
        }
        sums
    }
}

fn spread_points(clusters: &ClusterTree, cluster: &ClusterBox, strength: &[f64]) -> Vec<f64> {
    if cluster.children.is_some() {
        return Vec::new();
    }
    let mut sum = vec![0.0; PROXIES];
    let part = cluster.start..cluster.end;
    let [east, north, up] = clusters.points.part(part.clone());
    for (((e, n), u), q) in east.iter().zip(north).zip(up).zip(&strength[part]) {
        let weights = cluster.weights([*e, *n, *u]);
        sum.iter_mut().zip(weights).for_each(|(s, w)| *s += w * q);
    }
    sum
}

fn spread_proxies(parent: &ClusterBox, child: &PointPositions, strength: &[f64], sum: &mut [f64]) {
    for (i, q) in strength.iter().enumerate() {
        let weights = parent.weights([child.east[i], child.north[i], child.up[i]]);
        sum.iter_mut().zip(weights).for_each(|(s, w)| *s += w * q);
    }
}

fn interpolate(leaf: &ClusterBox, at: [&[f64]; 3], far: &[f64], sum: &mut [f64]) {
    for (i, s) in sum.iter_mut().enumerate() {
        let weights = leaf.weights([at[0][i], at[1][i], at[2][i]]);
        *s += weights.iter().zip(far).map(|(w, f)| w * f).sum::<f64>();
    }
}

fn joined(parts: Vec<(usize, Vec<f64>)>, count: usize) -> Vec<f64> {
    let mut all = vec![0.0; count];
    for (start, part) in parts {
        all[start..start + part.len()].copy_from_slice(&part);
    }
    all
}

//! A layer of equivalent sources: positions, settings of the fit, and sums over columns.

use super::clusters::{ClusterTree, PointPositions};
use super::far_field::all_proxies;

/// Maximum number of points in a box of the far-field sums.
pub(super) const LEAF: usize = 64;

/// Opening criterion for the summation of distant boxes in the fit, where errors only cost iterations.
pub(super) const FIT_FAR: f64 = 0.6;

/// A layer of equivalent sources.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceLayer {
    /// The depth of the sources beneath the measurements, in metres.
    pub depth_m: f64,
    /// The distance between sources, in metres.
    pub spacing_m: f64,
    /// Maximum horizontal distance from a source to its nearest measurement, in metres.
    pub reach_m: f64,
}

/// Settings of the fit of equivalent sources.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceFitOptions {
    /// The layers, deepest first.
    pub layers: Vec<SourceLayer>,
    /// Damping: weight of the squared strengths of the sources relative to the squared misfits, both in nT². The
    /// strength of a source is its field directly above it, at a distance of the layer's depth.
    pub damping: f64,
    /// The maximum number of iterations of a layer.
    pub iterations: usize,
    /// A layer is solved if an iteration reduces the cost by less than this fraction.
    pub tolerance: f64,
}

/// A layer with the strengths of its sources.
pub(super) struct FittedSourceLayer {
    pub depth_m: f64,
    pub clusters: ClusterTree,
    pub proxies: Vec<PointPositions>,
    pub strength: Vec<f64>,
    pub report: SourceLayerReport,
}

/// Statistics of the fit of a layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceLayerReport {
    /// The layer.
    pub layer: SourceLayer,
    /// Number of sources of the layer.
    pub sources: usize,
    /// Number of iterations.
    pub iterations: usize,
    /// The root mean square of the residual after the layer's fit, in nT.
    pub rms_nt: f64,
}

impl FittedSourceLayer {
    /// A layer at these positions, before its fit.
    pub fn at(places: &PointPositions, layer: SourceLayer) -> Self {
        let clusters = ClusterTree::new(places, LEAF);
        let proxies = all_proxies(&clusters);
        let strength = vec![0.0; places.len()];
        let report = SourceLayerReport { layer, sources: places.len(), iterations: 0, rms_nt: f64::NAN };
        Self { depth_m: layer.depth_m, clusters, proxies, strength, report }
    }

    /// Factor that scales the sources, so that a source of strength 1 gives 1 nT at `depth_m` above it.
    pub fn scale(&self) -> f64 {
        self.depth_m * self.depth_m
    }
}

pub(super) fn squares(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum()
}

pub(super) fn add(sum: &mut [f64], values: &[f64], factor: f64) {
    sum.iter_mut().zip(values).for_each(|(s, v)| *s += factor * v);
}

pub(super) fn scaled(mut values: Vec<f64>, factor: f64) -> Vec<f64> {
    values.iter_mut().for_each(|v| *v *= factor);
    values
}

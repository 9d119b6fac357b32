//! The damped normal equations of a layer of sources, solved by preconditioned conjugate gradients.

use super::clusters::{ClusterTree, PointPositions};
use super::far_field::ProxySources;
use super::layer::{FIT_FAR, FittedSourceLayer, SourceFitOptions, add, scaled, squares};
use super::windows::SchwarzPreconditioner;
use crate::inner_product::dot;

/// Damped normal equations of a layer of sources.
pub(super) struct LayerNormalEquations<'a> {
    pub layer: &'a FittedSourceLayer,
    pub data: &'a ClusterTree,
    pub data_proxies: Vec<PointPositions>,
}

impl LayerNormalEquations<'_> {
    fn forward(&self, strength: &[f64]) -> Vec<f64> {
        let spread = ProxySources::new(&self.layer.clusters, &self.layer.proxies, strength, FIT_FAR);
        scaled(spread.values(self.data, 1.0), self.layer.scale())
    }

    fn backward(&self, rest: &[f64]) -> Vec<f64> {
        let spread = ProxySources::new(self.data, &self.data_proxies, rest, FIT_FAR);
        scaled(spread.values(&self.layer.clusters, -1.0), self.layer.scale())
    }

    /// Computes, by conjugate gradients, the strengths that explain `rest`. Also returns the number of iterations.
    pub fn solve(
        &self,
        mut rest: Vec<f64>,
        windows: &SchwarzPreconditioner,
        options: &SourceFitOptions,
    ) -> (Vec<f64>, usize) {
        let mut strength = vec![0.0; self.layer.strength.len()];
        let mut gradient = self.backward(&rest);
        let mut better = windows.solve(&gradient);
        let mut direction = better.clone();
        let mut steep = dot(&gradient, &better);
        let mut cost = squares(&rest);
        let mut taken = 0;
        while taken < options.iterations && steep > 0.0 {
            let moved = self.forward(&direction);
            let step = steep / (squares(&moved) + options.damping * squares(&direction));
            add(&mut strength, &direction, step);
            add(&mut rest, &moved, -step);
            taken += 1;
            let now = squares(&rest) + options.damping * squares(&strength);
            if cost - now < options.tolerance * cost {
                break;
            }
            cost = now;
            gradient = self.backward(&rest);
            add(&mut gradient, &strength, -options.damping);
            better = windows.solve(&gradient);
            let next = dot(&gradient, &better);
            direction.iter_mut().zip(&better).for_each(|(d, b)| *d = b + next / steep * *d);
            steep = next;
        }
        (strength, taken)
    }
}

//! What is wrong with a map where it is looked up: at another height than its own, and between its nodes.

use arrow_array::RecordBatch;
use numerics::maps::{continuation::RadialPower, plane_grid::PlaneGrid};
use schemas::Fault;

use crate::{
    columns::{data, floats},
    maps::plane,
};

/// The errors of a map that are known from the map itself.
pub struct MapErrors {
    /// Its own height and its mean square by wavenumber, where it is taken at its own height.
    height: Option<(f64, RadialPower)>,
    /// The rms error of bilinear interpolation, in nT, where that is used, and the length of a cell, in metres.
    bilinear: Option<(f64, f64)>,
}

impl MapErrors {
    /// Of the table of a map, which is or is not continued to the heights flown, and is or is not interpolated bilinearly.
    ///
    /// # Errors
    /// A table that is no grid.
    pub fn of(map: &RecordBatch, continued: bool, bilinear: bool) -> Result<Self, Fault> {
        let plane = plane(map)?;
        let height = if continued {
            None
        } else {
            let known: Vec<f64> = floats(map, "alt")?.iter().copied().filter(|a| a.is_finite()).collect();
            Some((known.iter().sum::<f64>() / known.len() as f64, RadialPower::of(&plane).map_err(data)?))
        };
        let cell_m = plane.east_m.step.max(plane.north_m.step);
        Ok(Self { height, bilinear: bilinear.then(|| (bilinear_error_nt(&plane), cell_m)) })
    }

    /// The root mean square error to expect, in nT, of the map at the heights `alt_m`, above the ellipsoid: that over the
    /// whole map, at the mean of these heights. 0 for a continued map; NaN where either height is unknown.
    pub fn of_height_nt(&self, alt_m: &[f64]) -> f64 {
        let Some((own_m, power)) = &self.height else { return 0.0 };
        let up_m = alt_m.iter().sum::<f64>() / alt_m.len() as f64 - own_m;
        if up_m.is_finite() { power.height_error_nt(up_m) } else { f64::NAN }
    }

    /// The white noise, in nT a sample, that weighs as much as the error between nodes, which lasts for the crossing of a
    /// cell, at samples `step_m` apart.
    pub fn of_interpolation_nt(&self, step_m: f64) -> f64 {
        self.bilinear.map_or(0.0, |(error_nt, cell_m)| error_nt * (cell_m / step_m.min(cell_m)).sqrt())
    }
}

/// The rms error of bilinear interpolation over the known cells: in a cell's middle it is what the cubic convolution of
/// Keys (1981) has more, and over the cell it falls to nothing at the nodes.
fn bilinear_error_nt(map: &PlaneGrid) -> f64 {
    const WEIGHTS: [f64; 4] = [-1.0 / 16.0, 9.0 / 16.0, 9.0 / 16.0, -1.0 / 16.0];
    let (mut sum, mut cells) = (0.0, 0.0);
    for row in 1..map.rows().saturating_sub(2) {
        for column in 1..map.columns().saturating_sub(2) {
            let node = |r: usize, c: usize| map.get(row - 1 + r, column - 1 + c);
            let cubic: f64 = (0..16).map(|i| WEIGHTS[i / 4] * WEIGHTS[i % 4] * node(i / 4, i % 4)).sum();
            let linear = 0.25 * (node(1, 1) + node(1, 2) + node(2, 1) + node(2, 2));
            if cubic.is_finite() {
                sum += (cubic - linear).powi(2);
                cells += 1.0;
            }
        }
    }
    // Along one direction the error goes as 4t(1 - t), whose mean square is 8/15.
    if cells > 0.0 { (8.0 / 15.0 * sum / cells).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use numerics::maps::plane_grid::EvenAxis;

    #[test]
    fn law_bilinear_interpolation_misses_the_curvature_of_a_wave() {
        let axis = EvenAxis { first: 0.0, step: 100.0, len: 200 };
        let k = std::f64::consts::TAU / 2000.0;
        let wave = |east_m: f64| 10.0 * (k * east_m).sin();
        let values = (0..40_000).map(|i| wave(f64::from(i % 200) * 100.0)).collect();
        let map = PlaneGrid { east_m: axis, north_m: axis, values };
        let (mut sum, mut n) = (0.0, 0.0);
        for i in 0..20_000 {
            let east_m = 0.9 * f64::from(i) + 100.0;
            let (node, part) = ((east_m / 100.0).floor() * 100.0, (east_m / 100.0).fract());
            sum += (wave(node) * (1.0 - part) + wave(node + 100.0) * part - wave(east_m)).powi(2);
            n += 1.0;
        }
        let truth = (sum / n).sqrt();
        // The cubic convolution is itself off by a few parts in a hundred of what the straight line misses.
        assert!((bilinear_error_nt(&map) / truth - 1.0).abs() < 0.1, "{} {truth}", bilinear_error_nt(&map));
        let errors = MapErrors { height: None, bilinear: Some((0.5, 100.0)) };
        assert_eq!(errors.of_interpolation_nt(6.25), 2.0);
        assert_eq!(errors.of_interpolation_nt(500.0), 0.5);
    }
}

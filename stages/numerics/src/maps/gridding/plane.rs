//! The plane of best fit to values.

use nalgebra::{Matrix3, Vector3};

/// A plane over eastings and northings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RegionalPlane {
    centre: [f64; 2],
    value: f64,
    /// Slope towards east and north, per metre.
    pub slope: [f64; 2],
}

impl RegionalPlane {
    /// The least-squares plane.
    pub fn fitted(at_m: [&[f64]; 2], value: &[f64]) -> Self {
        let count = value.len().max(1) as f64;
        let centre = at_m.map(|axis| axis.iter().sum::<f64>() / count);
        let reach = [0, 1].map(|a| at_m[a].iter().fold(1.0, |m: f64, x| m.max((x - centre[a]).abs())));
        let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
        for (i, v) in value.iter().enumerate() {
            let [e, n] = [0, 1].map(|a| (at_m[a][i] - centre[a]) / reach[a]);
            let row = Vector3::new(1.0, e, n);
            normal += row * row.transpose();
            right += row * *v;
        }
        // Points on one straight line do not determine the slope across it: the singular part is zero.
        let plane = normal.svd(true, true).solve(&right, 1e-9 * count).unwrap_or_else(|_| Vector3::zeros());
        Self { centre, value: plane[0], slope: [plane[1] / reach[0], plane[2] / reach[1]] }
    }

    /// The plane's value at a position.
    pub fn at(&self, east: f64, north: f64) -> f64 {
        self.value + self.slope[0] * (east - self.centre[0]) + self.slope[1] * (north - self.centre[1])
    }
}

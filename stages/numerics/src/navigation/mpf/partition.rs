//! Partition of the particles into cells of neighbours, for kernels that follow the shape of the cloud.

/// Smallest effective number of particles in each half of a cell, sufficient for a covariance.
const LEAST_EFFECTIVE: f64 = 16.0;

/// Cells of weighted points in the plane.
#[derive(Clone, Debug, Default)]
pub(super) struct ParticlePartition {
    /// Cell of each point, from 0.
    pub(super) labels: Vec<u32>,
    /// Number of cells.
    pub(super) count: usize,
    order: Vec<u32>,
}

impl ParticlePartition {
    /// Divides the points repeatedly at the weighted median along the longer side, until the standard deviation of each
    /// cell is at most `size`. [Bentley 1975]
    ///
    /// `points` returns coordinates in the unit of `size`.
    pub(super) fn divide(&mut self, weights: &[f64], size: f64, points: impl Fn(usize) -> [f64; 2]) {
        self.labels.clear();
        self.labels.resize(weights.len(), 0);
        self.count = 0;
        self.order.clear();
        self.order.extend(0..weights.len() as u32);
        let mut open = vec![(0, weights.len())];
        while let Some((start, end)) = open.pop() {
            let cell = &mut self.order[start..end];
            let Some(axis) = longer_side(cell, weights, size, &points) else {
                cell.iter().for_each(|point| self.labels[*point as usize] = self.count as u32);
                self.count += 1;
                continue;
            };
            let coordinate = |point: &u32| points(*point as usize)[axis];
            cell.sort_unstable_by(|a, b| coordinate(a).total_cmp(&coordinate(b)).then_with(|| a.cmp(b)));
            let half = 0.5 * cell.iter().map(|point| weights[*point as usize]).sum::<f64>();
            let mut below = 0.0;
            let middle = cell.iter().position(|point| {
                below += weights[*point as usize];
                below >= half
            });
            let middle = start + middle.unwrap_or(0).clamp(1, cell.len() - 1);
            open.push((middle, end));
            open.push((start, middle));
        }
    }
}

/// Axis with the larger variance, for a cell that must be divided; `None` if the cell is small enough or has too few
/// effective points.
fn longer_side(cell: &[u32], weights: &[f64], size: f64, points: impl Fn(usize) -> [f64; 2]) -> Option<usize> {
    let (mut weight, mut squares, mut sum) = (0.0, 0.0, [0.0; 2]);
    for point in cell {
        let (w, at) = (weights[*point as usize], points(*point as usize));
        weight += w;
        squares += w * w;
        sum = [sum[0] + w * at[0], sum[1] + w * at[1]];
    }
    let mean = sum.map(|sum| sum / weight);
    let mut variances = [0.0; 2];
    for point in cell {
        let (w, at) = (weights[*point as usize], points(*point as usize));
        variances = [0, 1].map(|axis| variances[axis] + w * (at[axis] - mean[axis]).powi(2));
    }
    let wide = variances[0].max(variances[1]) > size * size * weight;
    (wide && weight * weight >= 2.0 * LEAST_EFFECTIVE * squares).then_some(if variances[0] >= variances[1] {
        0
    } else {
        1
    })
}

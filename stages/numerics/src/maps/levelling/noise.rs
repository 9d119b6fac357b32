//! Expected differences at crossings of lines without level errors.

use super::Crossover;
use crate::regression::statistics::median;

/// The resolution of differences, in nT: the lower limit of their standard deviation.
const RESOLUTION_NT: f64 = 0.01;
/// Reciprocal of the mean absolute value of a normal error with standard deviation 1.
const MEAN_SIZE: f64 = 1.253_314_137_315_5;
/// The largest difference that is used in the estimate, in standard deviations.
const FAR: f64 = 4.0;

/// Noise of the difference of two level lines at a crossing. The noise consists of the error of the values and of the
/// position error, which a gradient converts into a difference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CrossoverNoise {
    /// Standard deviation of a difference where the field is flat, in nT.
    pub sigma_nt: f64,
    /// Distance that represents errors of position, height and timing, in metres. The standard deviation of a
    /// difference increases by this distance times the horizontal gradient.
    pub position_m: f64,
}

impl CrossoverNoise {
    /// Most likely noise of the remaining differences. The errors are assumed to have exponential tails, because large
    /// differences are frequent in steep fields. `spent` is the number of degrees of freedom of the fit.
    pub(super) fn fitted(crossovers: &[Crossover], left_nt: &[f64], spent: f64) -> Self {
        let mut sizes: Vec<f64> = left_nt.iter().map(|d| d.abs()).collect();
        let usual = median(&mut sizes).max(RESOLUTION_NT);
        let mut best = (f64::INFINITY, Self { sigma_nt: usual, position_m: 0.0 });
        for position in 0..=32 {
            let position_m = if position == 0 { 0.0 } else { 0.25 * 2f64.powf(0.4 * f64::from(position)) };
            for share in 0..=20 {
                let sigma_nt = (2.0 * usual * 2f64.powf(-0.4 * f64::from(share))).max(RESOLUTION_NT);
                let noise = Self { sigma_nt, position_m };
                let cost = |(c, d): (&Crossover, &f64)| {
                    let size = noise.difference_sigma_nt(c) / MEAN_SIZE;
                    d.abs() / size + size.ln()
                };
                let cost: f64 = crossovers.iter().zip(left_nt).map(cost).sum();
                if cost < best.0 {
                    best = (cost, noise);
                }
            }
        }
        let n = left_nt.len() as f64;
        let sizes = crossovers.iter().zip(left_nt).map(|(c, d)| (d.abs() / best.1.difference_sigma_nt(c)).min(FAR));
        let free = (n / (n - spent).max(1.0)).sqrt();
        let scale = free * MEAN_SIZE * sizes.sum::<f64>() / n.max(1.0);
        let Self { sigma_nt, position_m } = best.1;
        Self { sigma_nt: (scale * sigma_nt).max(RESOLUTION_NT), position_m: scale * position_m }
    }

    /// The standard deviation of the difference at a crossing, in nT. The gradient term includes the effect of a height
    /// difference in the vertical gradient, because the vertical gradient is on average as large as the horizontal
    /// gradient.
    pub fn difference_sigma_nt(&self, crossover: &Crossover) -> f64 {
        let above_m = crossover.height_m[0] - crossover.height_m[1];
        self.sigma_nt.hypot(self.position_m.hypot(above_m) * crossover.gradient_nt_per_m)
    }
}

//! Number of particles by KLD-sampling.
//!
//! The number of particles follows from the number of cells that the positions of the cloud occupy. If the true density
//! is constant in each of k cells, n samples have a maximum-likelihood density whose Kullback-Leibler distance from the
//! true one exceeds ε with probability δ, where [Fox 2003, (7)]
//!
//! ```text
//! n = (k − 1)/(2 ε) [1 − 2/(9 (k − 1)) + √(2/(9 (k − 1))) z]³
//! ```
//!
//! and z is the upper δ quantile of a standard normal. A cell is a square over which the map is nearly linear.

use std::collections::BTreeSet;

use super::draws::ParticleDraws;
use super::parameters::MpfParameters;

/// ε. [Fox 2003, section 5]
const DISTANCE: f64 = 0.05;
/// z for δ = 0.01.
const NORMAL: f64 = 2.326_347_874_040_841;

/// Limits of the number of particles, and size of a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParticleCount {
    least: usize,
    cell_m: f64,
}

impl ParticleCount {
    /// Limits of these parameters; `None` for a constant number.
    pub(super) fn new(parameters: &MpfParameters) -> Option<Self> {
        parameters.adapt.then_some(Self { least: parameters.particles, cell_m: parameters.smooth_over_m })
    }

    /// Number of particles for a cloud whose particles, with equal weights, are at these positions, in metres.
    pub(super) fn of_cloud(&self, places: impl Iterator<Item = [f64; 2]>) -> usize {
        let cells: BTreeSet<[i64; 2]> = places.map(|place| self.cell(place)).collect();
        self.within(for_cells(cells.len()))
    }

    /// Number of particles of the first cloud. Draws particles until their number suffices for the cells that they
    /// occupy. `spread` contains the factors that convert the normals to latitude and longitude.
    pub(super) fn of_start(&self, m_per_rad: [f64; 2], spread: [[f64; 2]; 2], draws: ParticleDraws) -> usize {
        let mut cells = BTreeSet::new();
        let most = self.within(usize::MAX);
        for particle in 0..most {
            if particle >= self.within(for_cells(cells.len())) {
                return particle;
            }
            let [a, b] = draws.normals(particle);
            cells.insert(self.cell([0, 1].map(|axis| m_per_rad[axis] * (spread[axis][0] * a + spread[axis][1] * b))));
        }
        most
    }

    fn cell(&self, place_m: [f64; 2]) -> [i64; 2] {
        place_m.map(|m| (m / self.cell_m).floor() as i64)
    }

    fn within(&self, count: usize) -> usize {
        count.clamp(self.least, MpfParameters::MOST_ADAPTED.max(self.least))
    }
}

/// Number of particles for a number of occupied cells.
fn for_cells(cells: usize) -> usize {
    if cells < 2 {
        return 1;
    }
    let freedom = (cells - 1) as f64;
    let part = 2.0 / (9.0 * freedom);
    (freedom / (2.0 * DISTANCE) * (1.0 - part + part.sqrt() * NORMAL).powi(3)).ceil() as usize
}

#[cfg(test)]
mod tests {
    use super::super::draws::DrawPurpose;
    use super::*;

    #[test]
    fn ref_numbers_are_half_the_chi_square_quantiles_over_the_distance() {
        // Upper 1 % quantiles of chi-square with 1, 10, 30 and 100 degrees of freedom [Abramowitz & Stegun 1964, table
        // 26.8]. The formula of Wilson and Hilferty is accurate to 1 % from ten degrees on, and to 6 % at one.
        for (freedom, quantile, tolerance) in
            [(1, 6.6349, 0.06), (10, 23.2093, 0.01), (30, 50.8922, 0.01), (100, 135.807, 0.01)]
        {
            let expected = quantile / (2.0 * DISTANCE);
            let found = for_cells(freedom + 1) as f64;
            assert!((found / expected - 1.0).abs() < tolerance + 1.0 / expected, "{freedom}: {found} {expected}");
        }
        assert_eq!([for_cells(0), for_cells(1)], [1, 1]);
    }

    #[test]
    fn law_the_first_number_grows_with_the_area_of_the_start() {
        let count = ParticleCount { least: 500, cell_m: 200.0 };
        let of = |sigma_m: f64| {
            let draws = ParticleDraws::new(3, DrawPurpose::Start, 0);
            count.of_start([1.0, 1.0], [[sigma_m, 0.0], [0.0, sigma_m]], draws)
        };
        assert_eq!(of(10.0), 500);
        let [one, two, three] = [500.0, 1000.0, 2000.0].map(of);
        // The area in which a normal density exceeds one particle per cell grows faster than the variance.
        for (wider, narrower) in [(two, one), (three, two)] {
            assert!((3.0..6.0).contains(&(wider as f64 / narrower as f64)), "{one} {two} {three}");
        }
        assert_eq!(of(30_000.0), MpfParameters::MOST_ADAPTED);
        let cloud = (0..4000).map(|k| [f64::from(k % 40) * 200.0 + 1.0, f64::from(k / 40) * 0.1]);
        assert_eq!(count.of_cloud(cloud), for_cells(40).max(500));
    }
}

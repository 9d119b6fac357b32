//! Systematic resampling from the particles or from their kernel density.

use crate::navigation::pinson::{LAT, LON};

use super::cloud::{BLOCK, ParticleBlock, ParticleCloud, add_outer};
use super::count::ParticleCount;
use super::covariance::{ParticleMatrix, ParticleSpread, condition_on_position};
use super::draws::{DrawPurpose, ParticleDraws};
use super::modes::ModeClusters;
use super::partition::ParticlePartition;

/// Resampling method.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParticleResampling {
    pub(super) seed: u64,
    pub(super) regularise: bool,
    pub(super) roughening: f64,
    pub(super) smooth_over_m: f64,
    /// Metres per radian of latitude and of longitude.
    pub(super) m_per_rad: [f64; 2],
    /// Number of particles after the resampling; `None` keeps the present number.
    pub(super) count: Option<ParticleCount>,
}

/// Buffers shared by all resamplings.
#[derive(Clone, Debug, Default)]
pub(super) struct ParticleResampler<const N: usize> {
    ancestors: Vec<u32>,
    weights: Vec<f64>,
    blocks: Vec<ParticleBlock<N>>,
    cells: ParticlePartition,
    clusters: ModeClusters,
}

impl<const N: usize> ParticleResampler<N> {
    /// Draws particles with probabilities equal to the weights, then makes all weights equal. With kernels, adds the
    /// covariance of the linear states' kernels to the common covariance `p`.
    pub(super) fn resample(
        &mut self,
        how: ParticleResampling,
        row: usize,
        cloud: &mut ParticleCloud<N>,
        p: &mut ParticleMatrix<N>,
    ) {
        let [uniform, _] = ParticleDraws::new(how.seed, DrawPurpose::Resampling, row).uniforms(0);
        self.weights.clear();
        self.weights.extend(cloud.weights.as_flattened().iter().take(cloud.particles));
        systematic(&self.weights, cloud.particles, uniform, &mut self.ancestors);
        if let Some(count) = how.count {
            let places = self.ancestors.iter().map(|ancestor| {
                let [lat, lon] = position(cloud, *ancestor as usize);
                [how.m_per_rad[0] * lat, how.m_per_rad[1] * lon]
            });
            let wanted = count.of_cloud(places);
            if wanted != cloud.particles {
                systematic(&self.weights, wanted, uniform, &mut self.ancestors);
            }
        }
        let kernels = how.regularise.then(|| self.kernels(how, cloud));
        self.blocks.clone_from(&cloud.blocks);
        self.blocks.resize(self.ancestors.len().div_ceil(BLOCK), [[0.0; BLOCK]; N]);
        let draws = ParticleDraws::new(how.seed, DrawPurpose::Kernel, row);
        for (index, ancestor) in self.ancestors.iter().map(|ancestor| *ancestor as usize).enumerate() {
            let mut x = cloud.particle(ancestor);
            if let Some((cells, modes)) = &kernels {
                let (cell, mode) = (self.cells.labels[ancestor] as usize, self.clusters.labels[ancestor] as usize);
                x = modes[mode].follow(&x, cells[cell].draw([x[LAT], x[LON]], draws.normals(index)));
            }
            let (block, lane) = (&mut self.blocks[index / BLOCK], index % BLOCK);
            x.iter().zip(block).for_each(|(x, state)| state[lane] = *x);
        }
        cloud.replace(self.ancestors.len(), &mut self.blocks);
        for kernel in kernels.iter().flat_map(|(_, modes)| modes) {
            kernel.add_rest(p);
        }
        if how.roughening > 0.0 {
            roughen(cloud, how.roughening, ParticleDraws::new(how.seed, DrawPurpose::Roughening, row));
        }
    }

    /// Kernels of the position, one per cell, and of the linear states, one per mode.
    fn kernels(
        &mut self,
        how: ParticleResampling,
        cloud: &ParticleCloud<N>,
    ) -> (Vec<PositionKernel>, Vec<LinearKernel<N>>) {
        let Self { weights, cells, clusters, .. } = self;
        let at = |index: usize| {
            let [lat, lon] = position(cloud, index);
            [how.m_per_rad[0] * lat, how.m_per_rad[1] * lon]
        };
        cells.divide(weights, how.smooth_over_m, at);
        clusters.find(weights, at);
        let of_cells = moments::<2>(weights, &cells.labels, cells.count, |index| position(cloud, index));
        let of_modes = moments::<N>(weights, &clusters.labels, clusters.count, |index| cloud.particle(index));
        let cells = of_cells.iter().map(PositionKernel::new).collect();
        (cells, of_modes.into_iter().map(LinearKernel::new).collect())
    }
}

/// Moments of a subset of the particles.
pub(super) struct ParticleMoments<const N: usize> {
    pub(super) weight: f64,
    /// Effective number of particles.
    effective: f64,
    pub(super) mean: [f64; N],
    pub(super) covariance: [[f64; N]; N],
}

/// Moments of the particles of each label.
pub(super) fn moments<const N: usize>(
    weights: &[f64],
    labels: &[u32],
    count: usize,
    of: impl Fn(usize) -> [f64; N],
) -> Vec<ParticleMoments<N>> {
    let none = || ParticleMoments { weight: 0.0, effective: 0.0, mean: [0.0; N], covariance: [[0.0; N]; N] };
    let mut all: Vec<ParticleMoments<N>> = (0..count).map(|_| none()).collect();
    for (index, (weight, label)) in weights.iter().zip(labels).enumerate() {
        let own = &mut all[*label as usize];
        own.weight += weight;
        own.effective += weight * weight;
        own.mean.iter_mut().zip(of(index)).for_each(|(sum, x)| *sum += weight * x);
    }
    for own in &mut all {
        own.mean = own.mean.map(|sum| sum / own.weight);
        own.effective = own.weight * own.weight / own.effective;
    }
    for (index, (weight, label)) in weights.iter().zip(labels).enumerate() {
        let own = &mut all[*label as usize];
        let mut off = of(index);
        off.iter_mut().zip(&own.mean).for_each(|(x, mean)| *x -= mean);
        add_outer(&mut own.covariance, weight / own.weight, &off);
    }
    all
}

/// Kernel of the position in one cell.
struct PositionKernel {
    mean: [f64; 2],
    /// Cholesky factor of the cell's covariance, by rows.
    root: [f64; 3],
    width: f64,
    closer: f64,
}

impl PositionKernel {
    fn new(of: &ParticleMoments<2>) -> Self {
        let [[a, b], [_, c]] = of.covariance;
        let l11 = a.sqrt();
        let l21 = if l11 > 0.0 { b / l11 } else { 0.0 };
        let width = bandwidth(of.effective);
        let root = [l11, l21, (c - l21 * l21).max(0.0).sqrt()];
        Self { mean: of.mean, root, width, closer: (1.0 - width * width).sqrt() }
    }

    /// Draws from the kernel of a position.
    fn draw(&self, at: [f64; 2], normals: [f64; 2]) -> [f64; 2] {
        let [l11, l21, l22] = self.root;
        let [a, b] = normals.map(|normal| self.width * normal);
        let off = [0, 1].map(|axis| self.closer * (at[axis] - self.mean[axis]));
        [self.mean[0] + off[0] + l11 * a, self.mean[1] + off[1] + (l21 * a + l22 * b)]
    }
}

/// Kernel of the linear states in one mode. It is not drawn from: its covariance is added to the common covariance.
struct LinearKernel<const N: usize> {
    weight: f64,
    mean: [f64; N],
    /// First two columns of the Cholesky factor of the mode's covariance: the regression on the position.
    spread: ParticleSpread<N>,
    /// Conditional covariance given the position.
    rest: ParticleMatrix<N>,
    width: f64,
}

impl<const N: usize> LinearKernel<N> {
    fn new(of: ParticleMoments<N>) -> Self {
        let mut rest = of.covariance;
        let spread = condition_on_position(&mut rest);
        Self { weight: of.weight, mean: of.mean, spread, rest, width: bandwidth(of.effective) }
    }

    /// Expected linear states at a position, from the regression.
    fn expected(&self, at: [f64; 2]) -> [f64; N] {
        let over = |off: f64, root: f64| if root > 0.0 { off / root } else { 0.0 };
        let north = over(at[0] - self.mean[LAT], self.spread[LAT][0]);
        let east = over(at[1] - self.mean[LON] - self.spread[LON][0] * north, self.spread[LON][1]);
        std::array::from_fn(|state| self.mean[state] + (self.spread[state][0] * north + self.spread[state][1] * east))
    }

    /// Moves a particle to another position and adjusts its linear states.
    fn follow(&self, x: &[f64; N], to: [f64; 2]) -> [f64; N] {
        let closer = (1.0 - self.width * self.width).sqrt();
        let (here, there) = (self.expected([x[LAT], x[LON]]), self.expected(to));
        let mut moved: [f64; N] = std::array::from_fn(|state| there[state] + closer * (x[state] - here[state]));
        (moved[LAT], moved[LON]) = (to[0], to[1]);
        moved
    }

    /// Adds the kernel's covariance.
    fn add_rest(&self, p: &mut ParticleMatrix<N>) {
        let part = self.weight * self.width * self.width;
        for (p, rest) in p.as_flattened_mut().iter_mut().zip(self.rest.as_flattened()) {
            *p += part * rest;
        }
    }
}

/// Optimal bandwidth of a Gaussian kernel in a plane, N^(-1/6) standard deviations [Musso, Oudjane & Le Gland 2001;
/// Silverman 1986, (4.14)]. The width is limited to [`WIDEST`], because a wider kernel would dominate.
fn bandwidth(effective: f64) -> f64 {
    effective.max(1.0).powf(-1.0 / 6.0).min(WIDEST)
}

/// Widest kernel, in standard deviations.
const WIDEST: f64 = 0.7;

/// Latitude and longitude of a particle.
pub(super) fn position<const N: usize>(cloud: &ParticleCloud<N>, index: usize) -> [f64; 2] {
    let (block, lane) = (&cloud.blocks[index / BLOCK], index % BLOCK);
    [block[LAT][lane], block[LON][lane]]
}

/// Systematic resampling of N = `count` particles with one uniform random number: draw k selects the particle whose
/// interval of the cumulative weight contains (k + u)/N. [Kitagawa 1996]
fn systematic(weights: &[f64], count: usize, uniform: f64, ancestors: &mut Vec<u32>) {
    ancestors.clear();
    let sum: f64 = weights.iter().sum();
    let (mut own, mut reached) = (0, weights.first().copied().unwrap_or(0.0));
    for k in 0..count {
        let at = (k as f64 + uniform) / count as f64 * sum;
        while reached < at && own + 1 < weights.len() {
            own += 1;
            reached += weights[own];
        }
        ancestors.push(own as u32);
    }
}

/// Adds independent normal noise to the positions. Its standard deviation on each axis is `factor` times the range of
/// the particles, divided by the square root of their number.
fn roughen<const N: usize>(cloud: &mut ParticleCloud<N>, factor: f64, draws: ParticleDraws) {
    let mut ranges = [(f64::INFINITY, f64::NEG_INFINITY); 2];
    for index in 0..cloud.particles {
        for (range, x) in ranges.iter_mut().zip(position(cloud, index)) {
            *range = (range.0.min(x), range.1.max(x));
        }
    }
    let sigmas = ranges.map(|(least, most)| factor * (most - least) / (cloud.particles as f64).sqrt());
    cloud.jitter(sigmas, draws);
}

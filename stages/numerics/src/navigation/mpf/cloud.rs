//! Particles, in blocks of structures of arrays, and operations on all of them.
//!
//! The order of sums over the particles depends neither on the width of the vector unit nor on threads. Products and
//! sums are not fused.

use crate::navigation::pinson::{ALT, LAT, LON, STATES, StateMatrix};
use rayon::prelude::*;

use super::covariance::{GaussMarkovStep, ParticleMatrix, ParticleSpread};
use super::draws::ParticleDraws;

/// Number of particles per block: their states are 5 to 7 kB, which fits the innermost cache.
pub(super) const BLOCK: usize = 32;
/// One value for each particle of a block.
pub(super) type ParticleLanes = [f64; BLOCK];
/// The `N` states of a block: the 18 states of the INS, and the states of further measurements.
pub(super) type ParticleBlock<const N: usize> = [ParticleLanes; N];
/// Number of particles whose sums are kept in registers.
const WIDE: usize = 16;
/// Number of separate sums, which are independent of each other in the processor's pipeline.
const SUMS: usize = 8;
/// Number of particles below which one thread is faster than several.
const LEAST_TO_SPREAD: usize = 8192;
/// Number of blocks per thread task.
const SHARE: usize = 64;

/// Particles with their weights. Unused lanes of the last block have zero weight.
#[derive(Clone, Debug)]
pub(super) struct ParticleCloud<const N: usize> {
    /// Number of particles.
    pub(super) particles: usize,
    /// States of the particles.
    pub(super) blocks: Vec<ParticleBlock<N>>,
    /// Logarithms of the weights of the particles.
    pub(super) log_weights: Vec<ParticleLanes>,
    /// Weights, which add up to 1.
    pub(super) weights: Vec<ParticleLanes>,
}

/// Nonzero entries of a transition matrix, by rows.
pub(super) struct SparseTransition<const N: usize> {
    entries: Vec<(usize, f64)>,
    /// End of the entries of each row.
    ends: [usize; N],
}

impl<const N: usize> SparseTransition<N> {
    /// Transition of the 18 states and of each further state.
    pub(super) fn new(phi: &StateMatrix, further: &[GaussMarkovStep]) -> Self {
        let (mut entries, mut ends) = (Vec::with_capacity(STATES * STATES), [0; N]);
        for (state, end) in ends.iter_mut().enumerate() {
            match phi.get(state) {
                Some(row) => entries.extend(row.iter().copied().enumerate().filter(|(_, entry)| *entry != 0.0)),
                None => entries.extend(further.get(state - STATES).map(|lasting| (state, lasting.decay))),
            }
            *end = entries.len();
        }
        Self { entries, ends }
    }
}

impl<const N: usize> ParticleCloud<N> {
    /// Particles about zero error: x = spread·ξ.
    pub(super) fn new(particles: usize, spread: &ParticleSpread<N>, draws: ParticleDraws) -> Self {
        let count = particles.div_ceil(BLOCK);
        let mut cloud = Self {
            particles,
            blocks: vec![[[0.0; BLOCK]; N]; count],
            log_weights: vec![[0.0; BLOCK]; count],
            weights: vec![[0.0; BLOCK]; count],
        };
        for (number, block) in cloud.blocks.iter_mut().enumerate() {
            for (lane, particle) in (number * BLOCK..(number + 1) * BLOCK).enumerate() {
                let [a, b] = draws.normals(particle);
                for (state, [first, second]) in block.iter_mut().zip(spread) {
                    state[lane] = first * a + second * b;
                }
            }
        }
        cloud.make_equal();
        cloud
    }

    /// Replaces the particles by others of any number, with equal weights. `blocks` receives the replaced particles.
    pub(super) fn replace(&mut self, particles: usize, blocks: &mut Vec<ParticleBlock<N>>) {
        std::mem::swap(&mut self.blocks, blocks);
        self.particles = particles;
        self.log_weights.resize(self.blocks.len(), [f64::NEG_INFINITY; BLOCK]);
        self.weights.resize(self.blocks.len(), [0.0; BLOCK]);
        self.make_equal();
    }

    /// Adds independent normals of these standard deviations to the position of each particle.
    pub(super) fn jitter(&mut self, sigmas: [f64; 2], draws: ParticleDraws) {
        for (number, block) in self.blocks.iter_mut().enumerate() {
            for (lane, particle) in (number * BLOCK..(number + 1) * BLOCK).enumerate() {
                let [a, b] = draws.normals(particle);
                block[LAT][lane] += sigmas[0] * a;
                block[LON][lane] += sigmas[1] * b;
            }
        }
    }

    /// Sets equal weights.
    pub(super) fn make_equal(&mut self) {
        let weight = 1.0 / self.particles as f64;
        let log_weight = -(self.particles as f64).ln();
        for (number, (logs, weights)) in self.log_weights.iter_mut().zip(&mut self.weights).enumerate() {
            for lane in 0..BLOCK {
                let real = number * BLOCK + lane < self.particles;
                (logs[lane], weights[lane]) = if real { (log_weight, weight) } else { (f64::NEG_INFINITY, 0.0) };
            }
        }
    }

    /// Effective number of particles, 1/Σq². [Kong, Liu & Wong 1994]
    pub(super) fn effective(&self) -> f64 {
        let mut squares = [0.0; SUMS];
        for weights in &self.weights {
            accumulate(&mut squares, |lane| weights[lane] * weights[lane]);
        }
        1.0 / total(&squares)
    }

    /// Weighted mean of the states.
    pub(super) fn mean(&self) -> [f64; N] {
        pulp::Arch::new().dispatch(CloudMean(self))
    }

    /// Weighted covariance of the position about a mean: variance of latitude, covariance with longitude, variance of
    /// longitude.
    pub(super) fn position_covariance(&self, mean: &[f64; N]) -> [f64; 3] {
        let mut sums = [[0.0; SUMS]; 3];
        for (block, weights) in self.blocks.iter().zip(&self.weights) {
            let (lat, lon) = (&block[LAT], &block[LON]);
            accumulate(&mut sums[0], |lane| weights[lane] * (lat[lane] - mean[LAT]).powi(2));
            accumulate(&mut sums[1], |lane| weights[lane] * ((lat[lane] - mean[LAT]) * (lon[lane] - mean[LON])));
            accumulate(&mut sums[2], |lane| weights[lane] * (lon[lane] - mean[LON]).powi(2));
        }
        sums.each_ref().map(total)
    }

    /// Weighted covariance of all states about a mean, excluding the common covariance.
    pub(super) fn covariance(&self, mean: &[f64; N]) -> ParticleMatrix<N> {
        let mut sum = [[0.0; N]; N];
        for (block, weights) in self.blocks.iter().zip(&self.weights) {
            for lane in 0..BLOCK {
                let off: [f64; N] = std::array::from_fn(|state| block[state][lane] - mean[state]);
                add_outer(&mut sum, weights[lane], &off);
            }
        }
        sum
    }

    /// Propagates every particle: x ← Φ x + spread·ξ.
    pub(super) fn propagate(&mut self, phi: &SparseTransition<N>, spread: &ParticleSpread<N>, draws: ParticleDraws) {
        let particles = self.particles;
        let share = |(number, blocks): (usize, &mut [ParticleBlock<N>])| {
            let first = number * SHARE * BLOCK;
            pulp::Arch::new().dispatch(CloudPropagation { blocks, first, phi, spread, draws });
        };
        if particles < LEAST_TO_SPREAD {
            self.blocks.chunks_mut(SHARE).enumerate().for_each(share);
        } else {
            self.blocks.par_chunks_mut(SHARE).enumerate().for_each(share);
        }
    }

    /// Corrects the linear states of every particle by the gain of the particle: x ← x + (P_alt·slope + P u) r. `r` is
    /// the residual over its variance, and `of_common` is P u with the common part u of H.
    pub(super) fn correct(
        &mut self,
        p: &ParticleMatrix<N>,
        of_common: &[f64; N],
        slopes: &[ParticleLanes],
        residuals: &[ParticleLanes],
    ) {
        pulp::Arch::new().dispatch(CloudCorrection { blocks: &mut self.blocks, p, of_common, slopes, residuals });
    }

    /// State of one particle.
    #[inline(always)]
    pub(super) fn particle(&self, index: usize) -> [f64; N] {
        let (block, lane) = (&self.blocks[index / BLOCK], index % BLOCK);
        std::array::from_fn(|state| block[state][lane])
    }
}

/// Adds to the separate sums, lane by lane.
#[inline(always)]
pub(super) fn accumulate(sums: &mut [f64; SUMS], of: impl Fn(usize) -> f64) {
    for first in (0..BLOCK).step_by(SUMS) {
        for (k, sum) in sums.iter_mut().enumerate() {
            *sum += of(first + k);
        }
    }
}

/// Total of the separate sums.
pub(super) fn total(sums: &[f64; SUMS]) -> f64 {
    let [a, b, c, d, e, f, g, h] = *sums;
    ((a + e) + (b + f)) + ((c + g) + (d + h))
}

/// Initial value of the sums.
pub(super) const NO_SUMS: [f64; SUMS] = [0.0; SUMS];

/// Adds weight·x xᵀ.
#[inline(always)]
pub(super) fn add_outer<const N: usize>(sum: &mut [[f64; N]; N], weight: f64, x: &[f64; N]) {
    for (row, a) in sum.iter_mut().zip(x) {
        let factor = weight * a;
        row.iter_mut().zip(x).for_each(|(sum, b)| *sum += factor * b);
    }
}

struct CloudMean<'a, const N: usize>(&'a ParticleCloud<N>);

impl<const N: usize> pulp::NullaryFnOnce for CloudMean<'_, N> {
    type Output = [f64; N];

    #[inline(always)]
    fn call(self) -> [f64; N] {
        let mut sums = [[0.0; SUMS]; N];
        for (block, weights) in self.0.blocks.iter().zip(&self.0.weights) {
            for (sums, x) in sums.iter_mut().zip(block) {
                accumulate(sums, |lane| weights[lane] * x[lane]);
            }
        }
        sums.each_ref().map(total)
    }
}

struct CloudPropagation<'a, const N: usize> {
    blocks: &'a mut [ParticleBlock<N>],
    /// Index of the first particle.
    first: usize,
    phi: &'a SparseTransition<N>,
    spread: &'a ParticleSpread<N>,
    draws: ParticleDraws,
}

impl<const N: usize> pulp::NullaryFnOnce for CloudPropagation<'_, N> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { blocks, first, phi, spread, draws } = self;
        let mut normals = [[0.0; BLOCK]; 2];
        for (number, block) in blocks.iter_mut().enumerate() {
            let [first_normals, second_normals] = &mut normals;
            for (lane, (first_normal, second_normal)) in first_normals.iter_mut().zip(second_normals).enumerate() {
                [*first_normal, *second_normal] = draws.normals(first + number * BLOCK + lane);
            }
            let before = *block;
            for wide in (0..BLOCK).step_by(WIDE) {
                let mut start = 0;
                for (state, end) in phi.ends.into_iter().enumerate() {
                    let [a, b] = spread[state];
                    let mut sum = [0.0; WIDE];
                    for (k, sum) in sum.iter_mut().enumerate() {
                        *sum = a * normals[0][wide + k] + b * normals[1][wide + k];
                    }
                    for (column, entry) in &phi.entries[start..end] {
                        let x = &before[*column];
                        for (k, sum) in sum.iter_mut().enumerate() {
                            *sum += entry * x[wide + k];
                        }
                    }
                    block[state][wide..wide + WIDE].copy_from_slice(&sum);
                    start = end;
                }
            }
        }
    }
}

struct CloudCorrection<'a, const N: usize> {
    blocks: &'a mut [ParticleBlock<N>],
    p: &'a ParticleMatrix<N>,
    of_common: &'a [f64; N],
    slopes: &'a [ParticleLanes],
    residuals: &'a [ParticleLanes],
}

impl<const N: usize> pulp::NullaryFnOnce for CloudCorrection<'_, N> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (block, (slopes, residuals)) in self.blocks.iter_mut().zip(self.slopes.iter().zip(self.residuals)) {
            // The rows of latitude and longitude of the covariance are zero.
            for ((x, p), of_common) in block.iter_mut().zip(self.p).zip(self.of_common).skip(ALT) {
                let of_alt = p[ALT];
                for lane in 0..BLOCK {
                    x[lane] += (of_alt * slopes[lane] + of_common) * residuals[lane];
                }
            }
        }
    }
}

//! Kernel of a resampling, and the variance that a resampling removes.
//!
//! A resampling converts the fraction 1/N of the variance of N equally weighted particles into an error of their mean,
//! like genetic drift in a population. With a map, a later measurement would correct the error. Without a map, all
//! measurements are relative to the particles' own paths, whose variance decreases in the same way. The lost variance
//! is therefore stored, for the present states and at up to 64 samples of the flight. A resampling adds to each of
//! these the local covariance of the particles times Σw²/(1 − Σw²). A revisit reduces the variance of the particles by
//! a fraction κ. The same fraction of the present lost variance is then replaced by the lost variance of the revisited
//! samples. For two errors with covariances A and B and any correlation, the covariance of such a mixture is at most (1
//! − κ) A + κ B. The lost variance is an expectation over seeds, not the loss of one run, and it excludes errors of the
//! likelihood.

use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix};

use super::history::ParticleHistory;

/// Maximum number of samples of the flight for which the lost variance is stored.
const MOST_MARKS: usize = 64;
/// Maximum number of revisited map samples for which the lost variance is looked up.
const LOOKED_AT: usize = 32;
/// Widest kernel, in standard deviations, as in the marginalised particle filter with a map.
const WIDEST: f64 = 0.7;

/// Optimal bandwidth of a Gaussian kernel in a plane, in standard deviations: N^(-1/6). [Silverman 1986, (4.14); Musso,
/// Oudjane & Le Gland 2001]
pub fn bandwidth(effective: f64) -> f64 {
    effective.max(1.0).powf(-1.0 / 6.0).min(WIDEST)
}

/// Maximum relative excess: if one particle has the whole weight, there is no variance to scale.
const LARGEST_EXCESS: f64 = 50.0;

/// Excess of the unbiased covariance of weighted draws over the plain covariance, relative to the plain covariance:
/// with s = Σw² the excess is s/(1 − s), at most 50.
pub fn excess(weights: &[f64]) -> f64 {
    let part: f64 = weights.iter().map(|weight| weight * weight).sum();
    (part / (1.0 - part).max(f64::MIN_POSITIVE)).min(LARGEST_EXCESS)
}

/// Sample of the flight with the variance of its position that resampling has removed from the particles' paths.
#[derive(Clone, Copy, Debug)]
struct LostVarianceSample {
    sample: usize,
    /// Variances north and east, and the covariance of both, in m².
    lost_m2: [f64; 3],
}

/// Variance that resampling has removed from the particles.
#[derive(Clone, Debug)]
pub struct LostVariance {
    /// Lost variance of the present states.
    pub now: StateMatrix,
    marks: Vec<LostVarianceSample>,
    stride: usize,
    m_per_rad: [f64; 2],
}

impl LostVariance {
    /// Zero lost variance.
    pub fn new(m_per_rad: [f64; 2]) -> Self {
        Self { now: [[0.0; STATES]; STATES], marks: vec![], stride: 1, m_per_rad }
    }

    /// Adds a sample of the map.
    pub fn push(&mut self, sample: usize) {
        if !sample.is_multiple_of(self.stride) {
            return;
        }
        let [n, e] = self.m_per_rad;
        let now = &self.now;
        let lost_m2 = [now[LAT][LAT] * n * n, now[LON][LON] * e * e, now[LAT][LON] * n * e];
        self.marks.push(LostVarianceSample { sample, lost_m2 });
        if self.marks.len() > MOST_MARKS {
            self.stride *= 2;
            let stride = self.stride;
            self.marks.retain(|mark| mark.sample.is_multiple_of(stride));
        }
    }

    /// Adds the part of the covariance of the particles (`spread`) and of their paths that a resampling is about to
    /// remove.
    pub fn bank(&mut self, weights: &[f64], spread: &StateMatrix, history: &ParticleHistory) {
        let part = excess(weights);
        for (lost, of) in self.now.as_flattened_mut().iter_mut().zip(spread.as_flattened()) {
            *lost += part * of;
        }
        for mark in &mut self.marks {
            let Some(then) = history.at(mark.sample) else { continue };
            let mut sums = [0.0; 5];
            for (particle, weight) in weights.iter().enumerate() {
                let [n, e] = then.displacement(particle);
                for (sum, of) in sums.iter_mut().zip([n, e, n * n, e * e, n * e]) {
                    *sum += weight * of;
                }
            }
            let [n, e, nn, ee, ne] = sums;
            let covariance = [(nn - n * n).max(0.0), (ee - e * e).max(0.0), ne - n * e];
            for (lost, of) in mark.lost_m2.iter_mut().zip(covariance) {
                *lost += part * of;
            }
        }
    }

    /// Propagates the lost variance by the transition matrix of a step.
    pub fn shift(&mut self, phi: &StateMatrix) {
        let moved = product(phi, &self.now);
        self.now = std::array::from_fn(|row| {
            std::array::from_fn(|column| moved[row].iter().zip(&phi[column]).map(|(a, b)| a * b).sum())
        });
    }

    /// Resets the present lost variance after an aiding position, whose Kalman update includes this variance. The lost
    /// variance of the map is unchanged.
    pub fn found(&mut self) {
        self.now = [[0.0; STATES]; STATES];
    }

    /// Replaces the part `gain` of the present lost variance by the lost variance of the map. This function is called
    /// after a measurement that compared the present with earlier samples and reduced the particles' variance by
    /// `gain`.
    pub fn revisit(&mut self, samples: &[u32], gain: f64) {
        let stride = samples.len().div_ceil(LOOKED_AT).max(1);
        let (mut sums, mut count) = ([0.0; 3], 0.0);
        for sample in samples.iter().step_by(stride) {
            let after = self.marks.partition_point(|mark| mark.sample <= *sample as usize);
            if let Some(mark) = self.marks.get(after.saturating_sub(1)) {
                count += 1.0;
                for (sum, of) in sums.iter_mut().zip(mark.lost_m2) {
                    *sum += of;
                }
            }
        }
        if count == 0.0 {
            return;
        }
        let gain = gain.clamp(0.0, 1.0);
        for entry in self.now.as_flattened_mut() {
            *entry *= 1.0 - gain;
        }
        let [n, e] = self.m_per_rad;
        let [nn, ee, ne] = sums.map(|sum| gain * sum / count);
        self.now[LAT][LAT] += nn / (n * n);
        self.now[LON][LON] += ee / (e * e);
        self.now[LAT][LON] += ne / (n * e);
        self.now[LON][LAT] += ne / (n * e);
    }
}

/// Product of two matrices.
pub fn product(a: &StateMatrix, b: &StateMatrix) -> StateMatrix {
    let mut out = [[0.0; STATES]; STATES];
    for (out, row) in out.iter_mut().zip(a) {
        for (factor, of_row) in row.iter().zip(b) {
            for (entry, from) in out.iter_mut().zip(of_row) {
                *entry += factor * from;
            }
        }
    }
    out
}

//! Aiding positions in the particle filter.

use crate::navigation::pinson::ALT;
use crate::navigation::position_fixes::StateFix;

use super::cloud::{BLOCK, NO_SUMS, ParticleBlock, ParticleCloud, ParticleLanes, accumulate, total};
use super::covariance::correct;
use super::filter::{CorrectionSource, LEAST_LEFT, MOST_PARTS, MarginalisedParticleFilter};

/// Smallest fraction of the remaining information of a fix that is used in one part, for a cloud of kilometres and a
/// fix of metres.
const LEAST_PART: f64 = 1e-12;

/// Updated weights of the particles before they replace the weights of the cloud.
struct TentativeWeights {
    log_weights: Vec<ParticleLanes>,
    weights: Vec<ParticleLanes>,
    effective: f64,
}

impl<const N: usize> MarginalisedParticleFilter<'_, N> {
    /// Corrects weights, linear states and their covariance with the aiding positions of a row.
    pub(super) fn aid(&mut self, row: usize) {
        let [lat, lon, alt] = self.line.fixes_at(row);
        if let Some(fix) = alt {
            self.fix_height(fix);
        }
        let horizontal: Vec<StateFix> = [lat, lon].into_iter().flatten().collect();
        if !horizontal.is_empty() {
            self.fix_position(row, &horizontal);
        }
        let fixed = alt.is_some() || !horizontal.is_empty();
        if fixed {
            self.resample_where_few(CorrectionSource::Fixes, row, MOST_PARTS - 1);
        }
    }

    /// Updates with the height, which is linear given the position: one gain for all particles.
    fn fix_height(&mut self, StateFix { error, variance, .. }: StateFix) {
        let total = self.p[ALT][ALT] + variance;
        let gain: [f64; N] = std::array::from_fn(|state| self.p[state][ALT] / total);
        let mut logs = vec![[0.0; BLOCK]; self.cloud.blocks.len()];
        for (block, logs) in self.cloud.blocks.iter_mut().zip(&mut logs) {
            for (lane, log) in logs.iter_mut().enumerate() {
                let residual = error - block[ALT][lane];
                *log = -0.5 * residual * residual / total;
                for (state, gain) in block.iter_mut().zip(gain) {
                    state[lane] += gain * residual;
                }
            }
        }
        let weighed = weighed(&self.cloud, &logs, 1.0);
        self.accept(weighed);
        correct(&mut self.p, &[(ALT, 1.0)], variance);
    }

    /// Updates the weights with latitude and longitude at once. If too few particles would remain effective, splits the
    /// position into several fixes whose inverse variances add up to the original inverse variance, with a resampling
    /// between them.
    fn fix_position(&mut self, row: usize, fixes: &[StateFix]) {
        let enough = LEAST_LEFT * self.cloud.particles as f64;
        let mut left = 1.0_f64;
        for part_of_row in 0..MOST_PARTS - 1 {
            let logs = log_likelihoods(&self.cloud, fixes);
            let mut part = left;
            let mut next = weighed(&self.cloud, &logs, part);
            let in_parts = self.parameters.regularise && part_of_row + 2 < MOST_PARTS;
            while in_parts && next.effective < enough && part > left * LEAST_PART {
                part *= 0.5;
                next = weighed(&self.cloud, &logs, part);
            }
            self.accept(next);
            left -= part;
            if left <= 0.0 {
                break;
            }
            self.resample(CorrectionSource::Fixes, row, part_of_row);
        }
    }

    fn accept(&mut self, weighed: TentativeWeights) {
        (self.cloud.weights, self.cloud.log_weights) = (weighed.weights, weighed.log_weights);
    }
}

/// Logarithm of the likelihood of each particle's position, up to a constant.
fn log_likelihoods<const N: usize>(cloud: &ParticleCloud<N>, fixes: &[StateFix]) -> Vec<ParticleLanes> {
    let of = |lane: usize, block: &ParticleBlock<N>| -> f64 {
        fixes.iter().map(|fix| -0.5 * (fix.error - block[fix.state][lane]).powi(2) / fix.variance).sum()
    };
    cloud.blocks.iter().map(|block| std::array::from_fn(|lane| of(lane, block))).collect()
}

/// Weights of a cloud multiplied by a power of the likelihoods.
fn weighed<const N: usize>(cloud: &ParticleCloud<N>, logs: &[ParticleLanes], part: f64) -> TentativeWeights {
    let mut log_weights = cloud.log_weights.clone();
    let mut most = f64::NEG_INFINITY;
    for (weights, logs) in log_weights.iter_mut().zip(logs) {
        for (weight, log) in weights.iter_mut().zip(logs) {
            // A lane without a particle keeps zero weight regardless of its states.
            if *weight > f64::NEG_INFINITY {
                *weight += part * log;
                most = most.max(*weight);
            }
        }
    }
    let mut weights: Vec<ParticleLanes> = log_weights.iter().map(|lanes| lanes.map(|log| (log - most).exp())).collect();
    let mut sum = NO_SUMS;
    weights.iter().for_each(|lanes| accumulate(&mut sum, |lane| lanes[lane]));
    let whole = total(&sum);
    let log_whole = most + whole.ln();
    let mut squares = NO_SUMS;
    for (weights, logs) in weights.iter_mut().zip(&mut log_weights) {
        weights.iter_mut().for_each(|weight| *weight /= whole);
        logs.iter_mut().for_each(|log| *log -= log_whole);
        accumulate(&mut squares, |lane| weights[lane] * weights[lane]);
    }
    TentativeWeights { log_weights, weights, effective: 1.0 / total(&squares) }
}

//! A measurement evaluated at all particles.

use crate::navigation::pinson::ALT;

use super::cloud::{BLOCK, NO_SUMS, ParticleCloud, ParticleLanes, accumulate, total};
use super::covariance::{InformationSums, ParticleMatrix, dot, times};

/// Smallest share of the weight on the map for which a measurement is used. With a smaller share, the particles on the
/// map do not represent the cloud.
const LEAST_ON_MAP: f64 = 0.1;

/// Scalar measurement z = v(position) + u·x + white noise. v is specific to each particle; the row u is common.
#[derive(Clone, Debug)]
pub(super) struct CloudMeasurement {
    /// z.
    pub(super) value: f64,
    /// Variance of the white noise.
    pub(super) variance: f64,
    /// Entries of u, over linear states.
    pub(super) common: Vec<(usize, f64)>,
}

impl CloudMeasurement {
    /// The same measurement with a fraction of its information.
    pub(super) fn part(&self, part: f64) -> Self {
        Self { variance: self.variance / part, ..self.clone() }
    }
}

/// Prediction of a measurement at every particle, and the result of the measurement.
#[derive(Clone, Debug)]
pub(super) struct CloudPrediction {
    /// v at each particle; NaN off the map.
    pub(super) values: Vec<ParticleLanes>,
    /// Change of v with height.
    pub(super) d_alt: Vec<ParticleLanes>,
    /// Change of the field with height at each particle, in nT/m; 0 off the map.
    pub(super) slopes: Vec<ParticleLanes>,
    /// Residual divided by its variance at each particle, in 1/nT; 0 off the map.
    pub(super) residuals: Vec<ParticleLanes>,
    /// Inverse variance of the residual, in 1/nT²; 0 off the map.
    inverses: Vec<ParticleLanes>,
    /// Logarithm of the likelihood; not used for particles off the map.
    log_likelihoods: Vec<ParticleLanes>,
    /// Weights multiplied by the likelihoods, before they replace the weights of the cloud.
    weights: Vec<ParticleLanes>,
    log_weights: Vec<ParticleLanes>,
}

/// Residual of the cloud.
#[derive(Clone, Copy, Debug)]
pub(super) struct CloudResidual {
    /// Fraction of the weight on the map.
    pub(super) on_map: f64,
    /// Weighted mean of the residuals on the map, in nT.
    pub(super) residual_nt: f64,
    /// Variance of the residual: the variance between the particles plus the mean variance within a particle.
    pub(super) variance_nt2: f64,
    /// Smallest NIS among all particles with weight.
    pub(super) best: f64,
}

impl CloudPrediction {
    pub(super) fn new(blocks: usize) -> Self {
        let lanes = || vec![[0.0; BLOCK]; blocks];
        Self {
            values: lanes(),
            d_alt: lanes(),
            slopes: lanes(),
            residuals: lanes(),
            inverses: lanes(),
            log_likelihoods: lanes(),
            weights: lanes(),
            log_weights: lanes(),
        }
    }

    /// Changes the number of blocks. The next measurement computes all values again.
    pub(super) fn resize(&mut self, blocks: usize) {
        let Self { values, d_alt, slopes, residuals, inverses, log_likelihoods, weights, log_weights } = self;
        for lanes in [values, d_alt, slopes, residuals, inverses, log_likelihoods, weights, log_weights] {
            lanes.resize(blocks, [0.0; BLOCK]);
        }
    }

    /// Compares every particle with a measurement whose values have been computed. `None` if less than [`LEAST_ON_MAP`]
    /// of the weight has a value.
    pub(super) fn fit_of<const N: usize>(
        &mut self,
        cloud: &ParticleCloud<N>,
        p: &ParticleMatrix<N>,
        measured: &CloudMeasurement,
    ) -> Option<CloudResidual> {
        self.compare_all(cloud, p, measured);
        let fit = self.fit(cloud);
        (fit.on_map >= LEAST_ON_MAP).then_some(fit)
    }

    /// Residuals, their variances and likelihoods for a measurement whose values have been computed.
    pub(super) fn compare_all<const N: usize>(
        &mut self,
        cloud: &ParticleCloud<N>,
        p: &ParticleMatrix<N>,
        measured: &CloudMeasurement,
    ) {
        let CloudMeasurement { value, variance, common } = measured;
        let of_common = times(p, common);
        let (puu, pau, paa) = (dot(common, &of_common), of_common[ALT], p[ALT][ALT]);
        for (number, block) in cloud.blocks.iter().enumerate() {
            let (values, d_alt) = (&self.values[number], &self.d_alt[number]);
            let (slopes, residuals) = (&mut self.slopes[number], &mut self.residuals[number]);
            let (inverses, logs) = (&mut self.inverses[number], &mut self.log_likelihoods[number]);
            let mut own = [0.0; BLOCK];
            for (state, entry) in common {
                own.iter_mut().zip(&block[*state]).for_each(|(own, x)| *own += entry * x);
            }
            for lane in 0..BLOCK {
                let slope = d_alt[lane];
                let residual = value - (values[lane] + own[lane]);
                let total = variance + puu + slope * (2.0 * pau + slope * paa);
                let inverse = 1.0 / total;
                let known = residual.is_finite() && inverse.is_finite();
                slopes[lane] = if known { slope } else { 0.0 };
                residuals[lane] = if known { residual * inverse } else { 0.0 };
                inverses[lane] = if known { inverse } else { 0.0 };
                logs[lane] = if known { -0.5 * (residual * residual * inverse + total.ln()) } else { f64::NAN };
            }
        }
    }

    /// Residual of the cloud with its current weights.
    fn fit<const N: usize>(&self, cloud: &ParticleCloud<N>) -> CloudResidual {
        let (mut on_map, mut first, mut second, mut own) = (NO_SUMS, NO_SUMS, NO_SUMS, NO_SUMS);
        let mut best = f64::INFINITY;
        for (number, weights) in cloud.weights.iter().enumerate() {
            let (residuals, inverses) = (&self.residuals[number], &self.inverses[number]);
            let known = |lane: usize| inverses[lane] > 0.0;
            let weight = |lane: usize| if known(lane) { weights[lane] } else { 0.0 };
            let variance = |lane: usize| if known(lane) { 1.0 / inverses[lane] } else { 0.0 };
            accumulate(&mut on_map, weight);
            accumulate(&mut first, |lane| weight(lane) * (residuals[lane] * variance(lane)));
            accumulate(&mut second, |lane| weight(lane) * (residuals[lane] * variance(lane)).powi(2));
            accumulate(&mut own, |lane| weight(lane) * variance(lane));
            let squares =
                (0..BLOCK).filter(|lane| weight(*lane) > 0.0).map(|lane| residuals[lane].powi(2) * variance(lane));
            best = squares.fold(best, f64::min);
        }
        let share = total(&on_map);
        let residual_nt = total(&first) / share;
        let between = (total(&second) / share - residual_nt * residual_nt).max(0.0);
        CloudResidual { on_map: share, residual_nt, variance_nt2: between + total(&own) / share, best }
    }

    /// Multiplies the weights by the likelihoods. Weights of particles off the map are multiplied by the mean
    /// likelihood of the others, so the fraction of the weight off the map stays constant. Returns the effective number
    /// of particles.
    pub(super) fn weigh<const N: usize>(&mut self, cloud: &ParticleCloud<N>, on_map: f64) -> f64 {
        let mut most = f64::NEG_INFINITY;
        for (logs, likelihoods) in cloud.log_weights.iter().zip(&self.log_likelihoods) {
            // `max` of a number and NaN returns the number.
            most = logs.iter().zip(likelihoods).fold(most, |most, (log, likelihood)| most.max(log + likelihood));
        }
        let mut sum = NO_SUMS;
        for (number, inverses) in self.inverses.iter().enumerate() {
            let (logs, weights) = (&mut self.log_weights[number], &mut self.weights[number]);
            (*logs, *weights) = (cloud.log_weights[number], cloud.weights[number]);
            for lane in 0..BLOCK {
                if inverses[lane] > 0.0 {
                    logs[lane] += self.log_likelihoods[number][lane] - most;
                    weights[lane] = logs[lane].exp();
                }
            }
            accumulate(&mut sum, |lane| if inverses[lane] > 0.0 { weights[lane] } else { 0.0 });
        }
        let factor = on_map / total(&sum);
        let log_factor = factor.ln();
        let mut squares = NO_SUMS;
        for (number, inverses) in self.inverses.iter().enumerate() {
            let (logs, weights) = (&mut self.log_weights[number], &mut self.weights[number]);
            for lane in 0..BLOCK {
                if inverses[lane] > 0.0 {
                    logs[lane] += log_factor;
                    weights[lane] *= factor;
                }
            }
            accumulate(&mut squares, |lane| weights[lane] * weights[lane]);
        }
        1.0 / total(&squares)
    }

    /// Replaces the weights of the cloud by the weights from [`Self::weigh`]. Returns the sums for the common
    /// covariance.
    pub(super) fn accept<const N: usize>(&mut self, cloud: &mut ParticleCloud<N>) -> InformationSums {
        std::mem::swap(&mut cloud.weights, &mut self.weights);
        std::mem::swap(&mut cloud.log_weights, &mut self.log_weights);
        let (mut common, mut alt_common, mut alt) = (NO_SUMS, NO_SUMS, NO_SUMS);
        for (weights, (inverses, slopes)) in cloud.weights.iter().zip(self.inverses.iter().zip(&self.slopes)) {
            accumulate(&mut common, |lane| weights[lane] * inverses[lane]);
            accumulate(&mut alt_common, |lane| weights[lane] * inverses[lane] * slopes[lane]);
            accumulate(&mut alt, |lane| weights[lane] * inverses[lane] * slopes[lane] * slopes[lane]);
        }
        InformationSums { common: total(&common), alt_common: total(&alt_common), alt: total(&alt) }
    }
}

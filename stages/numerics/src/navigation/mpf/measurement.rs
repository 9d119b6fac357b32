//! A measurement as all particles see it.

use crate::maps::map_stack::FieldMap;
use crate::maps::map_surface::FieldColumns;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::pinson::{ALT, LAT, LON, S, StateMatrix, StateVector};

use super::cloud::{BLOCK, Block, Cloud, Lanes, NO_SUMS, accumulate, total};
use super::core_expansion::CoreExpansion;
use super::covariance::Information;

/// Less of the weight than this on the map, and the measurement is not used: what the few would say of it is not the
/// cloud's.
const LEAST_ON_MAP: f64 = 0.1;

/// The field at every particle, and what a measurement makes of it.
#[derive(Clone, Debug)]
pub(super) struct Predictor<'a> {
    map: &'a FieldMap,
    core: Option<CoreExpansion>,
    places: [Vec<f64>; 3],
    field: FieldColumns,
    /// The change of the field with height at each particle, in nT/m; 0 off the map.
    pub(super) slopes: Vec<Lanes>,
    /// Residual over its variance at each particle, in 1/nT; 0 off the map.
    pub(super) residuals: Vec<Lanes>,
    /// One over the variance of the residual, in 1/nT²; 0 off the map.
    inverses: Vec<Lanes>,
    /// The logarithm of the likelihood; that of particles off the map follows from the others'.
    log_likelihoods: Vec<Lanes>,
    /// Weights and their logarithms with the likelihoods, not yet the cloud's.
    weights: Vec<Lanes>,
    log_weights: Vec<Lanes>,
}

/// The residual of the cloud.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// The part of the weight that is on the map.
    pub(super) on_map: f64,
    /// The weighted mean of the residuals on the map, in nT.
    pub(super) residual_nt: f64,
    /// Their variance: between the particles and of each.
    pub(super) variance_nt2: f64,
    /// The smallest squared residual over its variance among all particles of any weight.
    pub(super) best: f64,
}

impl<'a> Predictor<'a> {
    pub(super) fn new(line: &NavigationLine<'a>, cloud: &Cloud) -> Self {
        let lanes = || vec![[0.0; BLOCK]; cloud.blocks.len()];
        let column = || vec![0.0; cloud.blocks.len() * BLOCK];
        Self {
            map: line.map,
            core: line.core.map(|core| CoreExpansion::new(core.clone())),
            places: [column(), column(), column()],
            field: FieldColumns::default(),
            slopes: lanes(),
            residuals: lanes(),
            inverses: lanes(),
            log_likelihoods: lanes(),
            weights: lanes(),
            log_weights: lanes(),
        }
    }

    /// Looks a measurement up at every particle; `middle` is the mean state. `None` where less than [`LEAST_ON_MAP`] of
    /// the weight has a value.
    pub(super) fn look(
        &mut self,
        ins: &InsSeries<'_>,
        row: usize,
        cloud: &Cloud,
        middle: &StateVector,
        p: &StateMatrix,
        (measured_nt, variance_nt2): (f64, f64),
    ) -> Option<Fit> {
        let origin = [ins.lat_deg[row], ins.lon_deg[row], ins.alt_m[row]];
        self.place(&cloud.blocks, origin);
        let [lat_deg, lon_deg, alt_m] = &self.places;
        // Three columns of one length are never refused.
        self.map.at_many(lat_deg, lon_deg, alt_m, &mut self.field).ok()?;
        if let Some(core) = &mut self.core {
            let [lat, lon, alt] = origin;
            core.follow(lat + middle[LAT].to_degrees(), lon + middle[LON].to_degrees(), alt + middle[ALT]);
        }
        self.compare_all(cloud, p, (measured_nt, variance_nt2));
        let fit = self.fit(cloud);
        (fit.on_map >= LEAST_ON_MAP).then_some(fit)
    }

    /// Residuals, their variances and likelihoods for a measurement and its variance, at the places last looked up.
    pub(super) fn compare_all(&mut self, cloud: &Cloud, p: &StateMatrix, (measured_nt, variance_nt2): (f64, f64)) {
        for (number, block) in cloud.blocks.iter().enumerate() {
            self.compare(number, block, p, measured_nt, variance_nt2);
        }
    }

    /// The positions of the particles.
    fn place(&mut self, blocks: &[Block], origin: [f64; 3]) {
        let [lats, lons, alts] = &mut self.places;
        let columns = lats.chunks_exact_mut(BLOCK).zip(lons.chunks_exact_mut(BLOCK)).zip(alts.chunks_exact_mut(BLOCK));
        for (block, ((lat, lon), alt)) in blocks.iter().zip(columns) {
            for lane in 0..BLOCK {
                lat[lane] = origin[0] + block[LAT][lane].to_degrees();
                lon[lane] = origin[1] + block[LON][lane].to_degrees();
                alt[lane] = origin[2] + block[ALT][lane];
            }
        }
    }

    /// Residuals, their variances and likelihoods in a block.
    fn compare(&mut self, number: usize, block: &Block, p: &StateMatrix, measured_nt: f64, variance_nt2: f64) {
        let Self { core, places: [lats, lons, alts], field, .. } = self;
        let (slopes, residuals) = (&mut self.slopes[number], &mut self.residuals[number]);
        let (inverses, logs) = (&mut self.inverses[number], &mut self.log_likelihoods[number]);
        for lane in 0..BLOCK {
            let index = number * BLOCK + lane;
            let (core_nt, core_slope) =
                core.as_ref().map_or((0.0, 0.0), |core| core.at(lats[index], lons[index], alts[index]));
            let (value, slope) = (field.value_nt[index] + core_nt, field.d_alt_nt_per_m[index] + core_slope);
            let residual = measured_nt - (value + block[S][lane]);
            let variance = variance_nt2 + p[S][S] + slope * (2.0 * p[ALT][S] + slope * p[ALT][ALT]);
            let inverse = 1.0 / variance;
            let known = residual.is_finite() && inverse.is_finite();
            slopes[lane] = if known { slope } else { 0.0 };
            residuals[lane] = if known { residual * inverse } else { 0.0 };
            inverses[lane] = if known { inverse } else { 0.0 };
            logs[lane] = if known { -0.5 * (residual * residual * inverse + variance.ln()) } else { f64::NAN };
        }
    }

    /// The residual of the cloud as its weights are.
    fn fit(&self, cloud: &Cloud) -> Fit {
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
        Fit { on_map: share, residual_nt, variance_nt2: between + total(&own) / share, best }
    }

    /// The weights times the likelihoods; those of particles off the map times the mean likelihood of the others, so
    /// that the part of the weight that is off the map stays as it is. Hands back the effective number of particles.
    pub(super) fn weigh(&mut self, cloud: &Cloud, on_map: f64) -> f64 {
        let mut most = f64::NEG_INFINITY;
        for (logs, likelihoods) in cloud.log_weights.iter().zip(&self.log_likelihoods) {
            // The maximum of a number and NaN is the number.
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

    /// Makes the weights of [`Self::weigh`] those of the cloud; the sums that the common covariance needs.
    pub(super) fn accept(&mut self, cloud: &mut Cloud) -> Information {
        std::mem::swap(&mut cloud.weights, &mut self.weights);
        std::mem::swap(&mut cloud.log_weights, &mut self.log_weights);
        let (mut s, mut alt_s, mut alt) = (NO_SUMS, NO_SUMS, NO_SUMS);
        for (weights, (inverses, slopes)) in cloud.weights.iter().zip(self.inverses.iter().zip(&self.slopes)) {
            accumulate(&mut s, |lane| weights[lane] * inverses[lane]);
            accumulate(&mut alt_s, |lane| weights[lane] * inverses[lane] * slopes[lane]);
            accumulate(&mut alt, |lane| weights[lane] * inverses[lane] * slopes[lane] * slopes[lane]);
        }
        Information { s: total(&s), alt_s: total(&alt_s), alt: total(&alt) }
    }
}

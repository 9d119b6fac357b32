//! Confidence intervals by resampling groups: flight lines are drawn with replacement, so that errors shared by the
//! samples of a line are not treated as independent evidence. [Efron & Tibshirani 1993, "An Introduction to the
//! Bootstrap", ch. 13; Davison & Hinkley 1997, 3.8]

use crate::{random::SplitMix64, regression::statistics::quantile};

/// A percentile interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PercentileInterval {
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Bootstrap draws of groups, shared by several statistics.
#[derive(Clone, Debug)]
pub struct BootstrapResamples {
    draws: Vec<Vec<u32>>,
}

impl BootstrapResamples {
    /// Draws `groups` groups with replacement, `draws` times. The same seed gives the same draws on every machine.
    pub fn new(groups: usize, draws: usize, seed: u64) -> Self {
        let mut bits = SplitMix64::new(seed);
        // The upper half of the 128-bit product is uniform from 0 to `groups` − 1, to one part in 2^64.
        let one = |bits: u64| ((u128::from(bits) * groups as u128) >> 64) as u32;
        let draws = (0..draws).map(|_| (0..groups).map(|_| one(bits.draw())).collect()).collect();
        Self { draws }
    }

    /// The value of `statistic` for each draw; the argument of `statistic` iterates over the indices of the drawn
    /// groups.
    pub fn values(&self, statistic: impl Fn(&mut dyn Iterator<Item = usize>) -> f64) -> Vec<f64> {
        self.draws.iter().map(|draw| statistic(&mut draw.iter().map(|i| *i as usize))).collect()
    }
}

impl PercentileInterval {
    /// The central interval of drawn values at confidence level `level`, by percentiles; values that are not finite are
    /// excluded. `None` without values.
    pub fn central(mut values: Vec<f64>, level: f64) -> Option<PercentileInterval> {
        values.retain(|v| v.is_finite());
        values.sort_by(f64::total_cmp);
        let tail = 0.5 * (1.0 - level);
        (!values.is_empty())
            .then(|| PercentileInterval { low: quantile(&values, tail), high: quantile(&values, 1.0 - tail) })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::random::NormalGenerator;

    #[test]
    fn law_the_interval_of_a_mean_is_the_normal_one() {
        let mut normals = NormalGenerator::new(3);
        let x: Vec<f64> = (0..200).map(|_| 5.0 + 2.0 * normals.draw()).collect();
        let n = x.len() as f64;
        let mean = x.iter().sum::<f64>() / n;
        let sigma = (x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
        let found = BootstrapResamples::new(x.len(), 4000, 1).values(|chosen| chosen.map(|i| x[i]).sum::<f64>() / n);
        let found = PercentileInterval::central(found, 0.95).unwrap();
        // A 95 % quantile of 4000 draws is accurate to 0.04 standard deviations of the mean; the limit is five times
        // this error.
        let (half, error) = (1.96 * sigma / n.sqrt(), 0.2 * sigma / n.sqrt());
        assert!((found.low - (mean - half)).abs() < error && (found.high - (mean + half)).abs() < error, "{found:?}");
    }

    #[test]
    fn unit_groups_are_drawn_uniformly_and_repeatably() {
        let draws = BootstrapResamples::new(7, 5000, 9);
        let mut counts = [0usize; 7];
        draws.draws.iter().flatten().for_each(|i| counts[*i as usize] += 1);
        // The expected number is 5000, with a standard deviation of 65.
        assert!(counts.iter().all(|c| c.abs_diff(5000) < 330), "{counts:?}");
        assert_eq!(draws.draws, BootstrapResamples::new(7, 5000, 9).draws);
        assert_ne!(draws.draws, BootstrapResamples::new(7, 5000, 10).draws);
    }

    #[test]
    fn unit_a_single_group_repeats_and_no_values_give_no_interval() {
        assert_eq!(
            BootstrapResamples::new(1, 100, 1).values(|chosen| chosen.map(|i| i as f64 + 7.0).sum()),
            [7.0; 100]
        );
        assert_eq!(PercentileInterval::central(vec![f64::NAN; 100], 0.95), None);
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.75), 3.0);
    }
}

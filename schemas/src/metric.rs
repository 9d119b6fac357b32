//! The declaration of a metric: a score of one line, and its pooling and display.
//!
//! Pooling over lines, the columns of a table of scores, the ranking of a sweep, its heat maps and the reference are
//! all derived from it.

/// One metric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// The name in a spec and in a table of scores.
    pub name: &'static str,
    /// The unit of its values.
    pub unit: &'static str,
    /// Meaning, as a sentence without a full stop.
    pub meaning: &'static str,
    /// Pooling rule over lines.
    pub pool: PoolingRule,
    /// Preferred values.
    pub better: MetricPreference,
    /// Places where it is shown, in addition to the table of scores.
    pub shown: MetricDisplay,
    /// Baseline: the metric of the same quantity without navigation or compensation.
    pub baseline: Option<MetricBaseline>,
    /// Limit beyond which a value is flagged by a warning.
    pub limit: Option<MetricLimit>,
}

impl Metric {
    /// The preferred value of [`MetricPreference::Near`].
    pub const fn target(&self) -> Option<f64> {
        match self.better {
            MetricPreference::Near(target) => Some(target),
            MetricPreference::Lower | MetricPreference::Higher | MetricPreference::Neither => None,
        }
    }

    /// Whether `value` is beyond the limit; false without a limit.
    pub fn is_flagged(&self, value: f64) -> bool {
        self.accepted().is_some_and(|(low, high)| value < low || value > high)
    }

    /// The smallest and the largest value within the limit; `None` without a limit.
    pub const fn accepted(&self) -> Option<(f64, f64)> {
        match (self.limit, self.better) {
            (Some(MetricLimit::Factor(factor)), MetricPreference::Near(target)) => {
                Some((target / factor, target * factor))
            }
            (Some(MetricLimit::AtLeast(low)), _) => Some((low, f64::INFINITY)),
            (Some(MetricLimit::AtMost(high)), _) => Some((f64::NEG_INFINITY, high)),
            (Some(MetricLimit::Factor(_)) | None, _) => None,
        }
    }
}

/// The metric of the same quantity without navigation or compensation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MetricBaseline {
    /// Name of the metric.
    pub metric: &'static str,
    /// Name of the baseline in a figure or a table.
    pub label: &'static str,
}

/// Limit beyond which a value of a metric is flagged by a warning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MetricLimit {
    /// Largest accepted factor by which a value is above or below the target of [`MetricPreference::Near`].
    Factor(f64),
    /// Smallest accepted value.
    AtLeast(f64),
    /// Largest accepted value.
    AtMost(f64),
}

/// Pooling rule over lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoolingRule {
    /// Root mean square weighted by the number of samples, for errors.
    Rms,
    /// Mean weighted by the number of samples, for ratios, rates and signed means.
    Mean,
    /// Sum, for numbers of samples.
    Sum,
    /// Standard error of a weighted mean of independent values, with the weights of the mean.
    Error,
    /// Quantile, in percent, of the samples of all lines together, for radii.
    Quantile(u8),
}

/// The score of one line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedScore<'a> {
    /// The value, in the metric's unit.
    pub value: f64,
    /// Weight: number of samples or pairs.
    pub n: f64,
    /// For [`PoolingRule::Quantile`]: sorted values, each of which represents an equal share of the samples; see
    /// [`spread`]. Empty for other rules.
    pub spread: &'a [f64],
}

impl From<(f64, f64)> for WeightedScore<'_> {
    /// A value and its weight, without a spread.
    fn from((value, n): (f64, f64)) -> Self {
        Self { value, n, spread: &[] }
    }
}

/// Maximum number of values of a [`spread`].
pub const SPREAD: usize = 100;

/// The minimum number of samples that a value of a [`spread`] represents, so that no value discloses a single sample.
pub const SHARE: usize = 10;

/// Quantiles that represent sorted samples: the middles of at most [`SPREAD`] equal groups, each of at least [`SHARE`]
/// samples. For fewer than 20 samples, the only value is the median.
pub fn spread(sorted: &[f64]) -> Vec<f64> {
    let Some(last) = sorted.len().checked_sub(1) else { return vec![] };
    let shares = (sorted.len() / SHARE).clamp(1, SPREAD);
    let middle = |share: usize| {
        // Rank of the middle of the group. The first sample has rank 0 and covers -0.5 to 0.5.
        let at = (share as f64 + 0.5) / shares as f64 * sorted.len() as f64 - 0.5;
        between(at, |i| sorted[i.min(last)])
    };
    (0..shares).map(middle).collect()
}

/// Linear interpolation between the values at the two ranks around `at`.
fn between(at: f64, value: impl Fn(usize) -> f64) -> f64 {
    let below = value(at.floor() as usize);
    below + (at - at.floor()) * (value(at.ceil() as usize) - below)
}

impl PoolingRule {
    /// Value pooled over all lines. NaN without lines, and for a quantile if a line has no spread.
    pub fn value<'a>(self, lines: impl Iterator<Item = WeightedScore<'a>>) -> f64 {
        if let Self::Quantile(percent) = self {
            return quantile_of_all(f64::from(percent) / 100.0, &lines.collect::<Vec<_>>());
        }
        let (mut sum, mut weight) = (0.0, 0.0);
        for WeightedScore { value, n, .. } in lines {
            weight += n;
            sum += match self {
                Self::Rms => n * value * value,
                Self::Mean => n * value,
                Self::Sum | Self::Quantile(_) => value,
                Self::Error => (n * value).powi(2),
            };
        }
        match self {
            _ if weight == 0.0 => f64::NAN,
            Self::Rms => (sum / weight).sqrt(),
            Self::Mean => sum / weight,
            Self::Sum | Self::Quantile(_) => sum,
            Self::Error => sum.sqrt() / weight,
        }
    }

    /// The rule in words.
    pub fn words(self) -> String {
        match self {
            Self::Rms => "root mean square".to_owned(),
            Self::Mean => "mean".to_owned(),
            Self::Sum => "sum".to_owned(),
            Self::Quantile(50) => "median of all samples".to_owned(),
            Self::Quantile(percent) => format!("{percent} % quantile of all samples"),
            Self::Error => "standard error of the mean".to_owned(),
        }
    }
}

/// The quantile at `part` of the samples of several lines, from their spreads: linear between order statistics, as
/// numpy's default.
fn quantile_of_all(part: f64, lines: &[WeightedScore]) -> f64 {
    let lines: Vec<&WeightedScore> = lines.iter().filter(|line| line.n > 0.0).collect();
    if let [one] = lines.as_slice() {
        return one.value;
    }
    if lines.iter().any(|line| line.spread.is_empty()) {
        return f64::NAN;
    }
    // Each value with the number of samples that it represents.
    let weighed = |line: &&WeightedScore| {
        let weight = line.n / line.spread.len() as f64;
        line.spread.iter().map(move |x| (*x, weight)).collect::<Vec<_>>()
    };
    let mut all: Vec<(f64, f64)> = lines.iter().flat_map(weighed).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = all.iter().map(|(_, weight)| weight).sum();
    let wanted = part * (total - 1.0);
    let (mut below, mut before): (f64, Option<(f64, f64)>) = (0.0, None);
    for (value, weight) in all {
        // Rank of the middle sample among those that the value represents.
        let rank = below + (weight - 1.0) / 2.0;
        if rank >= wanted {
            return match before {
                Some((last, at)) if rank > at => last + (wanted - at) / (rank - at) * (value - last),
                _ => value,
            };
        }
        below += weight;
        before = Some((value, rank));
    }
    before.map_or(f64::NAN, |(value, _)| value)
}

/// Preferred values of a metric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MetricPreference {
    /// Small values.
    Lower,
    /// Large values.
    Higher,
    /// Values near a target, compared by ratio.
    Near(f64),
    /// No preference: the metric describes the data, not the result.
    Neither,
}

impl MetricPreference {
    /// Cost of a value; the better of two values has the smaller cost. `None` without a preference.
    pub fn cost(self, value: f64) -> Option<f64> {
        let cost = match self {
            MetricPreference::Lower => value,
            MetricPreference::Higher => -value,
            MetricPreference::Near(target) => (value / target).ln().abs(),
            MetricPreference::Neither => return None,
        };
        cost.is_finite().then_some(cost)
    }

    /// The preferred values in words; empty for [`MetricPreference::Neither`].
    pub fn words(self) -> String {
        match self {
            MetricPreference::Lower => "smaller".to_owned(),
            MetricPreference::Higher => "larger".to_owned(),
            MetricPreference::Near(target) => format!("near {target}"),
            MetricPreference::Neither => String::new(),
        }
    }
}

/// Places where a metric is shown. Positions are multiples of ten, so that new metrics can be inserted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MetricDisplay {
    /// Position among the columns of pooled scores, from the left; `None` if it is not shown there.
    pub column: Option<u16>,
    /// Weight of the column. On a narrow terminal, the columns with the smallest weight are omitted first.
    pub weight: u16,
    /// Position among the metrics that rank the points of a sweep. The first metric that has a value ranks the points.
    /// `None` for a metric that never ranks.
    pub rank: Option<u16>,
    /// Whether a heat map over two axes of a sweep is drawn.
    pub heat_map: bool,
}

impl MetricDisplay {
    /// Shown only in the table of scores.
    pub const NOWHERE: Self = Self { column: None, weight: 0, rank: None, heat_map: false };

    /// Adds a column of the pooled scores.
    pub const fn column(place: u16, weight: u16) -> Self {
        Self { column: Some(place), weight, ..Self::NOWHERE }
    }

    /// Adds the ranking of the points of a sweep.
    pub const fn rank(self, place: u16) -> Self {
        Self { rank: Some(place), ..self }
    }

    /// Adds the heat map over two axes of a sweep.
    pub const fn heat_map(self) -> Self {
        Self { heat_map: true, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_each_pooling_rule_gives_its_mean_or_sum() {
        let lines = || [(3.0, 100.0), (4.0, 300.0)].into_iter().map(WeightedScore::from);
        assert_eq!(PoolingRule::Rms.value(lines()), ((9.0 * 100.0 + 16.0 * 300.0) / 400.0f64).sqrt());
        assert_eq!((PoolingRule::Mean.value(lines()), PoolingRule::Sum.value(lines())), (3.75, 7.0));
        // For equal errors, the standard error of the mean is inversely proportional to the square root of their
        // number.
        assert_eq!(PoolingRule::Error.value([(0.4, 9.0); 4].into_iter().map(WeightedScore::from)), 0.2);
        let all = [PoolingRule::Rms, PoolingRule::Mean, PoolingRule::Sum, PoolingRule::Quantile(50)];
        assert!(all.iter().all(|p| p.value(std::iter::empty()).is_nan()));
    }

    /// The quantile of sorted samples, linear between order statistics.
    fn quantile(sorted: &[f64], part: f64) -> f64 {
        between(part * (sorted.len() - 1) as f64, |i| sorted[i])
    }

    #[test]
    fn law_pooled_quantiles_equal_those_of_all_samples() {
        let line = |from: usize, n: usize, far: f64| (from..from + n).map(|i| far * i as f64).collect::<Vec<f64>>();
        // A rank is accurate to a tenth of a group: 1 % for a long line, 10 % for a line of a hundred samples.
        for (lines, tolerance) in [
            (vec![line(0, 100, 1.0), line(3, 900, 0.3)], 1e-2),
            (vec![line(0, 5000, 0.01), line(1000, 300, 0.4), line(0, 1000, 0.2)], 2e-3),
        ] {
            let spreads: Vec<Vec<f64>> = lines.iter().map(|samples| spread(samples)).collect();
            let mut all: Vec<f64> = lines.concat();
            all.sort_by(f64::total_cmp);
            for percent in [50, 95] {
                let part = f64::from(percent) / 100.0;
                let scored = lines.iter().zip(&spreads).map(|(samples, spread)| WeightedScore {
                    value: quantile(samples, part),
                    n: samples.len() as f64,
                    spread,
                });
                let (pooled, exact) = (PoolingRule::Quantile(percent).value(scored), quantile(&all, part));
                assert!((pooled / exact - 1.0).abs() < tolerance, "{percent}: {pooled} {exact}");
            }
        }
        assert_eq!(PoolingRule::Quantile(50).value(std::iter::once((3.0, 7.0).into())), 3.0);
        // A spread discloses no single sample.
        assert_eq!((spread(&[1.0, 2.0, 9.0]), spread(&[]).len(), spread(&line(0, 57, 1.0)).len()), (vec![2.0], 0, 5));
        let unknown = [(3.0, 7.0), (4.0, 7.0)].into_iter().map(WeightedScore::from);
        assert!(PoolingRule::Quantile(50).value(unknown).is_nan(), "no spread, no quantile");
    }

    #[test]
    fn unit_cost_is_symmetric_in_the_ratio_to_the_target() {
        assert_eq!(MetricPreference::Near(2.0).cost(8.0), MetricPreference::Near(2.0).cost(0.5));
        assert!(MetricPreference::Higher.cost(3.0) < MetricPreference::Higher.cost(2.0));
        assert_eq!((MetricPreference::Neither.cost(1.0), MetricPreference::Lower.cost(f64::NAN)), (None, None));
    }
}

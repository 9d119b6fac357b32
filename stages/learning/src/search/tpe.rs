//! The tree-structured Parzen estimator: proposes trials where the density of good trials is high and the density of
//! other trials is low (Bergstra et al. 2011).
//!
//! Both densities are mixtures of one kernel per trial, over all dimensions together (Falkner et al. 2018), and of one
//! wide kernel. Candidates are drawn from the density of good trials. The candidate with the largest ratio of the two
//! densities is proposed, because its expected improvement is largest.

use numerics::random::SplitMix64;

use super::{SearchDimension, TrialOutcome, TrialValue, uniform};

/// Fraction of the trials that count as good, and the maximum number of good trials.
const GOOD: f64 = 0.1;
const MOST_GOOD: usize = 25;
/// Number of draws from the density of good trials.
const CANDIDATES: usize = 24;
/// Maximum number of redraws of a repeated proposal.
const AGAIN: usize = 20;
/// Standard deviation of the wide kernel, as a fraction of the scale.
const WIDE: f64 = 1.0;

/// The next trial after `outcomes`. The running trials `proposed` count as bad, so that trials of one call are far
/// apart.
pub fn propose(
    dimensions: &[SearchDimension],
    bits: &mut SplitMix64,
    outcomes: &[TrialOutcome],
    proposed: &[Vec<TrialValue>],
) -> Vec<TrialValue> {
    let mut order: Vec<&TrialOutcome> = outcomes.iter().collect();
    // The sort is stable, so the first of several equal trials ranks higher.
    order.sort_by(|a, b| {
        let cost = |o: &TrialOutcome| o.cost.unwrap_or(f64::INFINITY);
        b.rung.cmp(&a.rung).then(cost(a).total_cmp(&cost(b)))
    });
    let good = ((GOOD * order.len() as f64).ceil() as usize).min(MOST_GOOD);
    let (good, bad) = order.split_at(good.min(order.len()));
    // A trial without a cost attracts no proposals.
    let good = good.iter().filter(|o| o.cost.is_some()).map(|o| o.values.as_slice());
    let bad = bad.iter().map(|o| o.values.as_slice()).chain(proposed.iter().map(Vec::as_slice));
    let (good, bad) = (ParzenDensity::new(dimensions, good.collect()), ParzenDensity::new(dimensions, bad.collect()));
    let known = |values: &Vec<TrialValue>| proposed.contains(values) || outcomes.iter().any(|o| o.values == *values);
    let fresh = |bits: &mut SplitMix64| {
        let mut drawn = good.draw(bits);
        for _ in 0..AGAIN {
            if !known(&drawn) {
                break;
            }
            drawn = good.draw(bits);
        }
        drawn
    };
    let scored = |values: Vec<TrialValue>| {
        let gain = good.log_density(&values) - bad.log_density(&values);
        // Repeated candidates rank after all new candidates.
        (!known(&values), gain, values)
    };
    let mut best = scored(fresh(bits));
    for _ in 1..CANDIDATES {
        let next = scored(fresh(bits));
        if (next.0, next.1) > (best.0, best.1) {
            best = next;
        }
    }
    match best {
        (true, _, values) => values,
        // All values nearby have been proposed, so a new value from the whole range is used, if one exists.
        (false, _, values) => {
            let anything = || dimensions.iter().map(|d| d.at(uniform(bits))).collect::<Vec<TrialValue>>();
            std::iter::repeat_with(anything).take(1000).find(|v| !known(v)).unwrap_or(values)
        }
    }
}

/// Parzen density over all dimensions: mean of one kernel about each trial and one wide kernel.
struct ParzenDensity<'a> {
    dimensions: &'a [SearchDimension],
    /// The centre of each trial's cell, on the scale of each dimension.
    centres: Vec<Vec<f64>>,
    /// Kernel width of numbers, as a fraction of the scale.
    width: f64,
}

impl<'a> ParzenDensity<'a> {
    fn new(dimensions: &'a [SearchDimension], trials: Vec<&[TrialValue]>) -> ParzenDensity<'a> {
        let middle = |(d, v): (&SearchDimension, &TrialValue)| {
            let (from, to) = d.cell(*v);
            0.5 * (from + to)
        };
        let centres: Vec<Vec<f64>> = trials.iter().map(|t| dimensions.iter().zip(*t).map(middle).collect()).collect();
        let n = centres.len().max(1) as f64;
        // Scott's rule, with a factor of 0.2 for a scale of length 1. The lower limit prevents gaps between the kernels
        // of a few trials.
        let scott = 0.2 * n.powf(-1.0 / (dimensions.len() as f64 + 4.0));
        let width = scott.max(1.0 / (n + 2.0).min(100.0));
        ParzenDensity { dimensions, centres, width }
    }

    fn kernels(&self) -> f64 {
        self.centres.len() as f64 + 1.0
    }

    fn draw(&self, bits: &mut SplitMix64) -> Vec<TrialValue> {
        let kernel = (uniform(bits) * self.kernels()) as usize;
        let centres = self.centres.get(kernel);
        let each = self.dimensions.iter().enumerate().map(|(k, d)| {
            let centre = centres.and_then(|c| c.get(k)).copied();
            match (d, centre) {
                (SearchDimension::Choice(n), Some(centre)) => {
                    let own = 1.0 / self.share(*n);
                    if uniform(bits) < own { d.at(centre) } else { d.at(uniform(bits)) }
                }
                (SearchDimension::Choice(_), None) => d.at(uniform(bits)),
                (SearchDimension::Real { .. } | SearchDimension::Whole { .. }, Some(centre)) => {
                    d.at(normal(bits, centre, self.width))
                }
                (SearchDimension::Real { .. } | SearchDimension::Whole { .. }, None) => d.at(normal(bits, 0.5, WIDE)),
            }
        });
        each.collect()
    }

    /// Total weight of the kernel of an unordered choice: 1 for the trial's own choice, plus 1/k for each possible
    /// choice, where k is the number of kernels.
    fn share(&self, choices: usize) -> f64 {
        1.0 + choices as f64 / self.kernels()
    }

    fn log_density(&self, values: &[TrialValue]) -> f64 {
        let cells: Vec<(f64, f64)> = self.dimensions.iter().zip(values).map(|(d, v)| d.cell(*v)).collect();
        let log = |centres: Option<&Vec<f64>>| {
            let each = self.dimensions.iter().zip(&cells).enumerate().map(|(k, (d, cell))| {
                let centre = centres.and_then(|c| c.get(k)).copied();
                match (d, centre) {
                    (SearchDimension::Choice(n), Some(centre)) => {
                        let own = if (cell.0..cell.1).contains(&centre) { 1.0 } else { 0.0 };
                        ((own + 1.0 / self.kernels()) / self.share(*n)).ln()
                    }
                    (SearchDimension::Choice(n), None) => -(*n as f64).ln(),
                    (SearchDimension::Real { .. } | SearchDimension::Whole { .. }, Some(centre)) => {
                        log_normal(*cell, centre, self.width)
                    }
                    (SearchDimension::Real { .. } | SearchDimension::Whole { .. }, None) => {
                        log_normal(*cell, 0.5, WIDE)
                    }
                }
            });
            each.sum::<f64>()
        };
        let logs: Vec<f64> = self.centres.iter().map(Some).chain([None]).map(log).collect();
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        most + logs.iter().map(|l| (l - most).exp()).sum::<f64>().ln() - self.kernels().ln()
    }
}

/// A draw from the normal distribution about `centre`, truncated to 0 to 1.
fn normal(bits: &mut SplitMix64, centre: f64, width: f64) -> f64 {
    loop {
        // Never 0, which has no logarithm.
        let radius = (-2.0 * (1.0 - uniform(bits)).ln()).sqrt();
        let x = centre + width * radius * (std::f64::consts::TAU * uniform(bits)).cos();
        // The centre is within the range, so at least a third of the draws are within the range.
        if (0.0..=1.0).contains(&x) {
            return x;
        }
    }
}

/// The logarithm of the density of the truncated normal distribution at a point, or of the mean density over a cell.
fn log_normal((from, to): (f64, f64), centre: f64, width: f64) -> f64 {
    let z = |x: f64| (x - centre) / width;
    let within = between(z(0.0), z(1.0));
    let density = if to > from {
        between(z(from), z(to)) / (to - from)
    } else {
        (-0.5 * z(from).powi(2)).exp() / (width * std::f64::consts::TAU.sqrt())
    };
    // Far from its centre the kernel underflows to 0, which has no logarithm.
    (density / within).max(f64::MIN_POSITIVE).ln()
}

/// The probability of the standard normal distribution between two values.
fn between(from: f64, to: f64) -> f64 {
    let tail = |z: f64| 0.5 * libm::erfc(z / std::f64::consts::SQRT_2);
    // Differences of small tail probabilities avoid cancellation.
    if from > 0.0 { tail(from) - tail(to) } else { tail(-to) - tail(-from) }
}

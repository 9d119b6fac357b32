//! Search for the best values of hyper-parameters: at random, by Sobol's sequence, and by the tree-structured Parzen
//! estimator; and selection of trials by successive halving.
//!
//! Trial `i` depends only on the seed, on `i` and on the given results. The result depends neither on threads nor on
//! proposals of an earlier process.

mod sobol;
mod tpe;

use numerics::random::{SplitMix64, seed_of};

pub use sobol::MOST_DIMENSIONS;

/// Dimension of a search space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SearchDimension {
    /// A number from `low` to `high`.
    Real {
        /// The lower end.
        low: f64,
        /// The upper end, above the lower end.
        high: f64,
        /// Whether the scale is logarithmic; `low` is then above 0.
        log: bool,
    },
    /// A whole number from `low` to `high`, both included.
    Whole {
        /// The lower end.
        low: i64,
        /// The upper end, not below the lower end.
        high: i64,
        /// Whether the scale is logarithmic; `low` is then above 0.
        log: bool,
    },
    /// An unordered choice; the number is the number of choices, at least one.
    Choice(usize),
}

/// A value of a [`SearchDimension`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrialValue {
    /// Value of [`SearchDimension::Real`].
    Real(f64),
    /// Value of [`SearchDimension::Whole`].
    Whole(i64),
    /// Position of the choice of [`SearchDimension::Choice`], from 0.
    Choice(usize),
}

/// Method that proposes trials.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProposalMethod {
    /// Uniformly at random.
    Random,
    /// Sobol's sequence, scrambled by the seed or plain. The plain sequence begins at the lower ends.
    Sobol {
        /// Whether the sequence is scrambled.
        scramble: bool,
    },
    /// The tree-structured Parzen estimator (Bergstra et al. 2011), after `start` trials of a scrambled Sobol sequence.
    Tpe {
        /// Number of initial trials, at least one.
        start: usize,
    },
}

/// Result of a finished trial.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialOutcome {
    /// Values, in the order of the dimensions.
    pub values: Vec<TrialValue>,
    /// The rung that the trial reached, from 0. Trials of a higher rung rank before trials of a lower rung.
    pub rung: usize,
    /// Cost, to be minimised; `None` for a trial without a cost, which ranks last in its rung.
    pub cost: Option<f64>,
}

/// Proposes `count` trials, numbered from `first` on, of the search with `seed` over `dimensions`, given all of
/// `outcomes`. Trials of one call do not use each other's results.
///
/// [`ProposalMethod::Tpe`] repeats an earlier trial only if it finds no new one.
pub fn propose(
    method: ProposalMethod,
    dimensions: &[SearchDimension],
    seed: u64,
    first: usize,
    count: usize,
    outcomes: &[TrialOutcome],
) -> Vec<Vec<TrialValue>> {
    let mut proposed: Vec<Vec<TrialValue>> = vec![];
    for trial in first..first.saturating_add(count) {
        let next = match method {
            ProposalMethod::Random => random(dimensions, seed, trial),
            ProposalMethod::Sobol { scramble } => evenly(dimensions, scramble.then_some(seed), trial),
            ProposalMethod::Tpe { start } if trial < start.max(1) => evenly(dimensions, Some(seed), trial),
            ProposalMethod::Tpe { .. } => {
                tpe::propose(dimensions, &mut bits(seed, "tpe", trial as u64), outcomes, &proposed)
            }
        };
        proposed.push(next);
    }
    proposed
}

/// Positions of the trials that successive halving (Jamieson and Talwalkar 2016) keeps for the next rung, ascending:
/// the trials with the best 1/`eta` of these costs, at least one trial. A trial without a cost is never kept. Of
/// several equal costs, the first are kept.
pub fn kept(costs: &[Option<f64>], eta: usize) -> Vec<usize> {
    let mut order: Vec<(f64, usize)> = costs.iter().enumerate().filter_map(|(i, c)| Some(((*c)?, i))).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<usize> = order.into_iter().take((costs.len() / eta.max(1)).max(1)).map(|(_, i)| i).collect();
    kept.sort_unstable();
    kept
}

/// Generator of random bits for one purpose and one number, such as the number of a trial.
fn bits(seed: u64, of: &str, number: u64) -> SplitMix64 {
    SplitMix64::new(seed_of(seed, &["search", of, &number.to_string()]))
}

/// A number in [0, 1).
fn uniform(bits: &mut SplitMix64) -> f64 {
    (bits.draw() >> 11) as f64 / (1_u64 << 53) as f64
}

fn random(dimensions: &[SearchDimension], seed: u64, trial: usize) -> Vec<TrialValue> {
    let mut bits = bits(seed, "random", trial as u64);
    dimensions.iter().map(|d| d.at(uniform(&mut bits))).collect()
}

/// A point of the Sobol sequence. Beyond 2^32 trials or [`MOST_DIMENSIONS`] dimensions, where the sequence ends, the
/// point is random.
fn evenly(dimensions: &[SearchDimension], seed: Option<u64>, trial: usize) -> Vec<TrialValue> {
    let point = u32::try_from(trial).ok().and_then(|i| sobol::point(i, dimensions.len(), seed));
    match point {
        Some(point) => dimensions.iter().zip(point).map(|(d, u)| d.at(u)).collect(),
        None => random(dimensions, seed.unwrap_or(0), trial),
    }
}

impl SearchDimension {
    /// The ends of the dimension's scale. For a whole number, they are extended by half a step.
    fn ends(&self) -> (f64, f64) {
        let scaled = |x: f64, log: bool| if log { x.ln() } else { x };
        match *self {
            SearchDimension::Real { low, high, log } => (scaled(low, log), scaled(high, log)),
            SearchDimension::Whole { low, high, log } => {
                (scaled(low as f64 - 0.5, log), scaled(high as f64 + 0.5, log))
            }
            SearchDimension::Choice(n) => (0.0, n as f64),
        }
    }

    /// The value at the fraction `u` (from 0 to 1) of the dimension's scale.
    fn at(&self, u: f64) -> TrialValue {
        let (from, to) = self.ends();
        // Rounding of the logarithm may change the lower end.
        if let SearchDimension::Real { low, .. } = *self
            && u <= 0.0
        {
            return TrialValue::Real(low);
        }
        let x = from + u * (to - from);
        match *self {
            SearchDimension::Real { low, high, log } => {
                TrialValue::Real(if log { x.exp() } else { x }.clamp(low, high))
            }
            SearchDimension::Whole { low, high, log } => {
                TrialValue::Whole((if log { x.exp() } else { x }.round() as i64).clamp(low, high))
            }
            SearchDimension::Choice(n) => TrialValue::Choice((x as usize).min(n.saturating_sub(1))),
        }
    }

    /// The interval of the dimension's scale that corresponds to a value: a point for a real number, a cell for a whole
    /// number or a choice.
    fn cell(&self, value: TrialValue) -> (f64, f64) {
        let (from, to) = self.ends();
        let part = |x: f64| (x - from) / (to - from);
        match (*self, value) {
            (SearchDimension::Real { log, .. }, TrialValue::Real(x)) => {
                let at = part(if log { x.ln() } else { x });
                (at, at)
            }
            (SearchDimension::Whole { log, .. }, TrialValue::Whole(n)) => {
                let edge = |x: f64| part(if log { x.ln() } else { x });
                (edge(n as f64 - 0.5), edge(n as f64 + 0.5))
            }
            (SearchDimension::Choice(_), TrialValue::Choice(i)) => (part(i as f64), part(i as f64 + 1.0)),
            // A value of another kind of dimension has no position on this scale and covers the whole scale.
            _ => (0.0, 1.0),
        }
    }
}

#[cfg(test)]
mod tests;

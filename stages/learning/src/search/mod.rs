//! The search for the best values of some quantities: at random, by Sobol's sequence, and by the tree-structured Parzen
//! estimator; and which trials successive halving keeps.
//!
//! The trial `i` depends on the seed, on `i` and on the results that it is handed, and on nothing else: neither on threads
//! nor on what was proposed in an earlier process.

mod sobol;
mod tpe;

use numerics::random::{SplitMix64, seed_of};

pub use sobol::MOST_DIMENSIONS;

/// A quantity that is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dimension {
    /// A number from `low` to `high`.
    Real {
        /// The lower end.
        low: f64,
        /// The upper end, above it.
        high: f64,
        /// Whether equal ratios count alike, rather than equal differences; `low` is above 0 then.
        log: bool,
    },
    /// A whole number from `low` to `high`, both included.
    Whole {
        /// The lower end.
        low: i64,
        /// The upper end, not below it.
        high: i64,
        /// Whether equal ratios count alike; `low` is above 0 then.
        log: bool,
    },
    /// One of this number of unordered choices, at least one.
    Choice(usize),
}

/// A value of a [`Dimension`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// Value of [`Dimension::Real`].
    Real(f64),
    /// Value of [`Dimension::Whole`].
    Whole(i64),
    /// Position of the choice of [`Dimension::Choice`], from 0.
    Choice(usize),
}

/// Method that proposes trials.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Uniformly at random.
    Random,
    /// Sobol's sequence, scrambled by the seed or plain. Plain, it begins at the lower ends.
    Sobol {
        /// Whether it is scrambled.
        scramble: bool,
    },
    /// The tree-structured Parzen estimator (Bergstra et al. 2011), after `start` trials of a scrambled Sobol sequence.
    Tpe {
        /// The number of trials that it starts from, at least one.
        start: usize,
    },
}

/// A trial that is over.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Its values, in the order of the dimensions.
    pub values: Vec<Value>,
    /// The rung that it got to, from 0; those of a higher one come before all others.
    pub rung: usize,
    /// Its cost, to be made small; `None` for a trial without one, which is worse than any other of its rung.
    pub cost: Option<f64>,
}

/// The trials from `first` on, `count` of them, of the search with `seed` over `dimensions`, after all of `outcomes`. Trials
/// that were proposed together do not know of each other's results.
///
/// With [`Method::Tpe`] a trial that was proposed before is not proposed again, as long as there are others.
pub fn propose(
    method: Method,
    dimensions: &[Dimension],
    seed: u64,
    first: usize,
    count: usize,
    outcomes: &[Outcome],
) -> Vec<Vec<Value>> {
    let mut proposed: Vec<Vec<Value>> = vec![];
    for trial in first..first.saturating_add(count) {
        let next = match method {
            Method::Random => random(dimensions, seed, trial),
            Method::Sobol { scramble } => evenly(dimensions, scramble.then_some(seed), trial),
            Method::Tpe { start } if trial < start.max(1) => evenly(dimensions, Some(seed), trial),
            Method::Tpe { .. } => tpe::propose(dimensions, &mut bits(seed, "tpe", trial as u64), outcomes, &proposed),
        };
        proposed.push(next);
    }
    proposed
}

/// The positions of the trials that successive halving (Jamieson and Talwalkar 2016) keeps for the next rung: of these
/// costs the best 1/`eta`, at least one, in ascending order. A trial without a cost is never kept; of equal ones the first
/// are.
pub fn kept(costs: &[Option<f64>], eta: usize) -> Vec<usize> {
    let mut order: Vec<(f64, usize)> = costs.iter().enumerate().filter_map(|(i, c)| Some(((*c)?, i))).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<usize> = order.into_iter().take((costs.len() / eta.max(1)).max(1)).map(|(_, i)| i).collect();
    kept.sort_unstable();
    kept
}

/// A source of random bits for one trial, or another number, of one use.
fn bits(seed: u64, of: &str, number: u64) -> SplitMix64 {
    SplitMix64::new(seed_of(seed, &["search", of, &number.to_string()]))
}

/// A number from 0 to 1, 1 excluded.
fn uniform(bits: &mut SplitMix64) -> f64 {
    (bits.draw() >> 11) as f64 / (1_u64 << 53) as f64
}

fn random(dimensions: &[Dimension], seed: u64, trial: usize) -> Vec<Value> {
    let mut bits = bits(seed, "random", trial as u64);
    dimensions.iter().map(|d| d.at(uniform(&mut bits))).collect()
}

/// Beyond 2^32 trials, or of more than [`MOST_DIMENSIONS`] dimensions, there is no Sobol sequence: these are at random.
fn evenly(dimensions: &[Dimension], seed: Option<u64>, trial: usize) -> Vec<Value> {
    let point = u32::try_from(trial).ok().and_then(|i| sobol::point(i, dimensions.len(), seed));
    match point {
        Some(point) => dimensions.iter().zip(point).map(|(d, u)| d.at(u)).collect(),
        None => random(dimensions, seed.unwrap_or(0), trial),
    }
}

impl Dimension {
    /// The ends of its scale: of a whole number half a step beyond its own.
    fn ends(&self) -> (f64, f64) {
        let scaled = |x: f64, log: bool| if log { x.ln() } else { x };
        match *self {
            Dimension::Real { low, high, log } => (scaled(low, log), scaled(high, log)),
            Dimension::Whole { low, high, log } => (scaled(low as f64 - 0.5, log), scaled(high as f64 + 0.5, log)),
            Dimension::Choice(n) => (0.0, n as f64),
        }
    }

    /// The value at the part `u` of its scale, from 0 to 1.
    fn at(&self, u: f64) -> Value {
        let (from, to) = self.ends();
        // The logarithm of an end need not lead back to it.
        if let Dimension::Real { low, .. } = *self
            && u <= 0.0
        {
            return Value::Real(low);
        }
        let x = from + u * (to - from);
        match *self {
            Dimension::Real { low, high, log } => Value::Real(if log { x.exp() } else { x }.clamp(low, high)),
            Dimension::Whole { low, high, log } => {
                Value::Whole((if log { x.exp() } else { x }.round() as i64).clamp(low, high))
            }
            Dimension::Choice(n) => Value::Choice((x as usize).min(n.saturating_sub(1))),
        }
    }

    /// The part of its scale that belongs to a value: a point for a number, the cell of a whole one or of a choice.
    fn cell(&self, value: Value) -> (f64, f64) {
        let (from, to) = self.ends();
        let part = |x: f64| (x - from) / (to - from);
        match (*self, value) {
            (Dimension::Real { log, .. }, Value::Real(x)) => {
                let at = part(if log { x.ln() } else { x });
                (at, at)
            }
            (Dimension::Whole { log, .. }, Value::Whole(n)) => {
                let edge = |x: f64| part(if log { x.ln() } else { x });
                (edge(n as f64 - 0.5), edge(n as f64 + 0.5))
            }
            (Dimension::Choice(_), Value::Choice(i)) => (part(i as f64), part(i as f64 + 1.0)),
            // A value of another dimension has no place: it counts as being anywhere.
            _ => (0.0, 1.0),
        }
    }
}

#[cfg(test)]
mod tests;

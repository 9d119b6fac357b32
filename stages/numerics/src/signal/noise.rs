//! Noise of a line: standard deviation and correlation time, as a white part and a first-order Gauss-Markov part.
//!
//! The noise is estimated from its Allan variance: half the mean square of the difference between the means over two
//! neighbouring intervals. The Allan variance is independent of a constant offset, and a gap only ends a run. The two
//! returned parts are the smallest parts whose Allan variance is nowhere below the line's Allan variance, within the
//! uncertainty of the line's Allan variance. Two parts cannot represent noise with further time scales. Such noise is
//! therefore overestimated and never underestimated.
//!
//! [Allan 1966, Proc. IEEE 54(2); IEEE Std 952-1997, annex C; Brown & Hwang 2012, section 3.8; Langel, García Crespillo
//! & Joerger 2021, NAVIGATION 68(2), on models that bound a process of unknown correlation]

use std::ops::Range;

use crate::signal::gauss_markov::GaussMarkov;
use thiserror::Error;

mod fit;

pub use fit::{NoiseFitError, NoiseFitStatistic, fit};

/// Approximate length, in seconds, of the blocks over which samples are averaged. Faster noise is estimated from the
/// steps between samples.
const BLOCK_S: f64 = 1.0;
/// Minimum number of independent differences for the Allan variance of an interval.
const LEAST_PAIRS: f64 = 3.0;
/// Number of trial correlation times.
const TAUS: usize = 60;
/// Lower limit of the noise of a magnetometer, in nT.
const FLOOR_NT: f64 = 0.01;

/// Noise of a measurement at the sample rate of the line from which it was estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineNoiseModel {
    /// Standard deviation of the white part of each sample, in nT.
    pub white_nt: f64,
    /// The correlated part, in nT and s. A correlation time longer than a line cannot be resolved. The returned time is
    /// then at most the length of the longest line, and only the growth of the variance with time, 2 sigma²/tau, is
    /// known.
    pub lasting: GaussMarkov,
}

/// Error of a noise estimate.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoiseError {
    /// No run is long enough.
    #[error(
        "the noise estimate requires a run of at least {least_s} s without a gap, but the longest is {longest_s:.1} s"
    )]
    TooShort {
        /// The required length, in seconds.
        least_s: f64,
        /// The longest run, in seconds.
        longest_s: f64,
    },
}

/// Statistics of one or several lines: means over blocks of about a second, run by run, and steps between neighbouring
/// samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BlockMeans {
    /// The length of a block, in seconds.
    pub block_s: f64,
    /// The time between samples, in seconds.
    pub step_s: f64,
    /// The means over the blocks of each run, in nT.
    pub runs: Vec<Vec<f64>>,
    /// Differences of neighbouring samples, in nT; empty if a block is one sample.
    pub steps: Vec<f64>,
}

/// The number of samples of a block.
pub fn samples_a_block(rate_hz: f64) -> usize {
    ((BLOCK_S * rate_hz).round() as usize).max(1)
}

impl BlockMeans {
    /// Blocks of the rows `runs` of `x` (nT, evenly sampled at `rate_hz` within a run). Samples after the last complete
    /// block of a run are not used.
    pub fn from_runs(x: &[f64], runs: &[Range<usize>], rate_hz: f64) -> Self {
        let n = samples_a_block(rate_hz);
        let run = |r: &Range<usize>| x.get(r.clone()).unwrap_or_default();
        let mean = |block: &[f64]| block.iter().sum::<f64>() / n as f64;
        Self {
            block_s: n as f64 / rate_hz,
            step_s: 1.0 / rate_hz,
            runs: runs.iter().map(|r| run(r).chunks_exact(n).map(mean).collect()).collect(),
            steps: match n {
                1 => vec![],
                _ => runs.iter().flat_map(|r| run(r).windows(2).map(|pair| pair[1] - pair[0])).collect(),
            },
        }
    }

    fn longest_s(&self) -> f64 {
        self.runs.iter().map(Vec::len).max().unwrap_or(0) as f64 * self.block_s
    }
}

/// The Allan variance for one interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AllanPoint {
    /// Length of the interval over which means are taken, in seconds.
    pub span_s: f64,
    /// The variance, in nT².
    pub variance_nt2: f64,
    /// The number of independent differences.
    pub pairs: f64,
    /// Whether the point is computed from single samples instead of means.
    sampled: bool,
}

/// Allan variance of all lines together, for the step between samples and for intervals of 1, 2, 4, ... blocks, as long
/// as there are three independent differences. All lines must have the same sample rate; the rate of the first is used.
pub fn allan_variance(lines: &[BlockMeans]) -> Vec<AllanPoint> {
    let Some(first) = lines.first() else { return vec![] };
    let mut points = vec![];
    let steps = || lines.iter().flat_map(|l| &l.steps);
    let count = steps().count() as f64;
    if count >= LEAST_PAIRS {
        let variance_nt2 = 0.5 * steps().map(|s| s * s).sum::<f64>() / count;
        points.push(AllanPoint { span_s: first.step_s, variance_nt2, pairs: count, sampled: true });
    }
    let mut m = 1;
    loop {
        let (mut sum, mut terms, mut pairs) = (0.0, 0.0, 0.0);
        for run in lines.iter().flat_map(|l| &l.runs).filter(|run| run.len() >= 2 * m) {
            let mean = |at: usize| run[at..at + m].iter().sum::<f64>() / m as f64;
            // Intervals overlap, with at most thirty-two starts per interval length, because more starts add no
            // information.
            let stride = m.div_ceil(32);
            for at in (0..=run.len() - 2 * m).step_by(stride) {
                sum += 0.5 * (mean(at + m) - mean(at)).powi(2);
                terms += 1.0;
            }
            pairs += run.len() as f64 / m as f64 - 1.0;
        }
        if pairs < LEAST_PAIRS {
            return points;
        }
        let sampled = first.steps.is_empty() && m == 1;
        points.push(AllanPoint { span_s: m as f64 * first.block_s, variance_nt2: sum / terms, pairs, sampled });
        m *= 2;
    }
}

/// Allan variance of a stationary Gauss-Markov process divided by its variance, for means over `span_s`. [IEEE Std
/// 952-1997, (C.20)]
pub fn gauss_markov_allan(span_s: f64, tau_s: f64) -> f64 {
    let u = span_s / tau_s;
    if u < 1e-3 {
        // For small u the terms of the formula below cancel; the result is 2u/3 - u²/2 + ...
        return u * (2.0 / 3.0 - 0.5 * u);
    }
    2.0 / u * (1.0 - (3.0 - 4.0 * (-u).exp() + (-2.0 * u).exp()) / (2.0 * u))
}

/// The smallest white and Gauss-Markov noise that bounds the Allan variance of the lines.
///
/// # Errors
/// Fails if all lines are too short to resolve a Gauss-Markov process, that is, if every run has fewer than sixteen
/// blocks.
pub fn noise(lines: &[BlockMeans]) -> Result<LineNoiseModel, NoiseError> {
    let block_s = lines.iter().map(|l| l.block_s).fold(BLOCK_S, f64::max);
    let longest_s = lines.iter().map(BlockMeans::longest_s).fold(0.0, f64::max);
    let least_s = 16.0 * block_s;
    let points = allan_variance(lines);
    if longest_s < least_s || points.len() < 4 {
        return Err(NoiseError::TooShort { least_s, longest_s });
    }
    let step_s = lines.first().map_or(block_s, |l| l.step_s);
    let tau = |i: usize| 2.0 * block_s * (longest_s / (2.0 * block_s)).powf(i as f64 / (TAUS - 1) as f64);
    let bounds = (0..TAUS).map(|i| (tau(i), bound(&points, step_s, tau(i))));
    let best = bounds.min_by(|a, b| a.1.excess.total_cmp(&b.1.excess));
    let (tau_s, best) = best.unwrap_or((longest_s, AllanBound::default()));
    Ok(LineNoiseModel {
        white_nt: best.white_nt2.max(FLOOR_NT * FLOOR_NT).sqrt(),
        lasting: GaussMarkov { sigma: best.lasting_nt2.sqrt(), tau_s },
    })
}

/// White and correlated variances whose Allan variance bounds that of the lines, and the mean ratio of the two.
#[derive(Clone, Copy, Debug, Default)]
struct AllanBound {
    white_nt2: f64,
    lasting_nt2: f64,
    excess: f64,
}

/// Variances that bound the points for one correlation time and have the smallest mean ratio to the points. This is a
/// linear programme in two unknowns, whose solution is a vertex.
fn bound(points: &[AllanPoint], step_s: f64, tau_s: f64) -> AllanBound {
    // For each point: the Allan variance of each part with a variance of 1, the bound, and the value of the lines.
    let row = |p: &AllanPoint| {
        let lasting = match p.sampled {
            true => -(-p.span_s / tau_s).exp_m1(),
            false => gauss_markov_allan(p.span_s, tau_s),
        };
        let value = p.variance_nt2.max(FLOOR_NT * FLOOR_NT * step_s / p.span_s);
        ([step_s / p.span_s, lasting], value / (1.0 + (2.0 / p.pairs).sqrt()), value)
    };
    let rows: Vec<([f64; 2], f64, f64)> = points.iter().map(row).collect();
    let mut best = AllanBound { excess: f64::INFINITY, ..AllanBound::default() };
    let mut corner = |white_nt2: f64, lasting_nt2: f64| {
        let of = |unit: &[f64; 2]| white_nt2 * unit[0] + lasting_nt2 * unit[1];
        // A vertex is on two of the bounds, up to rounding.
        let holds = rows.iter().all(|(unit, least, _)| of(unit) >= least * (1.0 - 1e-9));
        let excess = rows.iter().map(|(unit, _, value)| of(unit) / value).sum::<f64>() / rows.len() as f64;
        if white_nt2 >= 0.0 && lasting_nt2 >= 0.0 && holds && excess < best.excess {
            best = AllanBound { white_nt2, lasting_nt2, excess };
        }
    };
    for (i, (unit, least, _)) in rows.iter().enumerate() {
        corner(least / unit[0], 0.0);
        corner(0.0, least / unit[1]);
        for (other, bound, _) in &rows[..i] {
            let determinant = unit[0] * other[1] - unit[1] * other[0];
            if determinant != 0.0 {
                corner(
                    (least * other[1] - bound * unit[1]) / determinant,
                    (bound * unit[0] - least * other[0]) / determinant,
                );
            }
        }
    }
    best
}

#[cfg(test)]
mod tests;

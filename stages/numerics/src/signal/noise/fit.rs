//! White and Gauss-Markov noise, estimated by a fit to a record's structure function or Allan variance.

use params::choice;
use thiserror::Error;

use super::{BlockMeans, FLOOR_NT, LineNoiseModel, allan_variance, gauss_markov_allan};
use crate::signal::gauss_markov::GaussMarkov;

/// Number of trial correlation times; the best of them is then refined.
const TAUS: usize = 48;
/// Number of times that the weights are recomputed from the fit.
const ROUNDS: usize = 4;
/// Minimum number of samples of a record.
const LEAST_SAMPLES: usize = 64;
/// Minimum total duration of the runs, and minimum duration of the longest run, in correlation times.
const LEAST_TAUS: [f64; 2] = [20.0, 8.0];
/// The correlated part is significant if it reduces the deviance by at least this amount: the limit for three
/// parameters at a level of 0.7 %.
const LEAST_GAIN: f64 = 12.0;

choice! {
    /// Statistic of a record to which the noise is fitted.
    pub enum NoiseFitStatistic {
        /// Autocorrelation, as half the mean square of the change over a lag. It equals the variance minus the
        /// autocovariance, and is independent of the mean, which a short record does not determine.
        Autocorrelation = "autocorrelation",
        /// Allan variance.
        Allan = "allan",
    }
}

/// Error of a noise fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoiseFitError {
    /// There are too few samples.
    #[error(
        "the noise fit requires a run of at least {LEAST_SAMPLES} samples without a gap, but the longest has {longest}"
    )]
    TooShort {
        /// Number of samples of the longest run.
        longest: usize,
    },
    /// The record does not change.
    #[error("the record is constant and contains no noise")]
    Constant,
    /// The correlation time is too long for the record.
    #[error(
        "the record is too short for its correlation time of about {tau_s:.0} s: the runs last {total_s:.0} s in \
         total, but must last at least 20 correlation times; the longest run lasts {longest_s:.0} s, but must last at \
         least 8 correlation times"
    )]
    Unresolved {
        /// Correlation time of the best fit, in seconds.
        tau_s: f64,
        /// The duration of all runs, in seconds.
        total_s: f64,
        /// Duration of the longest run, in seconds.
        longest_s: f64,
    },
}

/// Statistic of the record at one lag or interval. Its response to a Gauss-Markov part depends on the correlation time.
struct NoiseFitPoint {
    /// Statistic of white noise of variance 1.
    white: f64,
    /// Lag or interval of the statistic, in seconds.
    span_s: f64,
    /// Whether the statistic is computed from single samples at a lag instead of means over neighbouring intervals.
    sampled: bool,
    value: f64,
    /// Number of independent squares.
    pairs: f64,
}

impl NoiseFitPoint {
    /// Statistic of a Gauss-Markov process of variance 1.
    fn lasting(&self, tau_s: f64) -> f64 {
        match self.sampled {
            true => -(-self.span_s / tau_s).exp_m1(),
            false => gauss_markov_allan(self.span_s, tau_s),
        }
    }
}

/// Best fit of white and first-order Gauss-Markov noise to the `runs` of a record, in nT, evenly sampled at `rate_hz`
/// within a run. The mean of each run is assumed unknown. The white part is at least 0.01 nT, because a filter cannot
/// use a measurement without noise.
///
/// The statistics of each lag or interval are fitted by maximum likelihood, as independent gamma variates. Their
/// degrees of freedom are the number of separate pairs in the record. If the correlated part is not significant, its
/// standard deviation is 0 and its correlation time is the step between samples. For a record of duration T, the
/// relative error of the standard deviation is about √(τ/2T), and the relative error of the correlation time is about
/// √(4τ/T).
///
/// Unlike [`noise`](super::noise), the result is a best fit and not a bound: noise with more than one time scale is
/// partly missed. [Cressie 1993, section 2.6; IEEE Std 952-1997, annex C; Brown & Hwang 2012, section 3.8]
///
/// # Errors
/// Fails for a record that is constant, has too few samples, or is too short for its correlation time.
pub fn fit(runs: &[&[f64]], rate_hz: f64, by: NoiseFitStatistic) -> Result<LineNoiseModel, NoiseFitError> {
    let longest = runs.iter().map(|run| run.len()).max().unwrap_or(0);
    if longest < LEAST_SAMPLES {
        return Err(NoiseFitError::TooShort { longest });
    }
    let points = match by {
        NoiseFitStatistic::Autocorrelation => structure(runs, rate_hz, longest),
        NoiseFitStatistic::Allan => allan(runs, rate_hz),
    };
    if points.iter().all(|p| p.value == 0.0) {
        return Err(NoiseFitError::Constant);
    }
    let step_s = 1.0 / rate_hz;
    let [total_s, longest_s] = [runs.iter().map(|run| run.len()).sum(), longest].map(|n: usize| n as f64 * step_s);
    // The number of independent squares at a lag depends on the noise, so the second fit uses the noise of the first.
    let (tau_s, rough) = best(&points, 0.5 * step_s, longest_s);
    let points = match by {
        NoiseFitStatistic::Autocorrelation => weighed(points, &rough, tau_s, total_s, step_s),
        NoiseFitStatistic::Allan => points,
    };
    let (tau_s, best) = best(&points, 0.5 * step_s, longest_s);
    if white_alone(&points).deviance - best.deviance < LEAST_GAIN {
        let white = white_alone(&points).white.sqrt().max(FLOOR_NT);
        return Ok(LineNoiseModel { white_nt: white, lasting: GaussMarkov { sigma: 0.0, tau_s: step_s } });
    }
    if total_s < LEAST_TAUS[0] * tau_s || longest_s < LEAST_TAUS[1] * tau_s {
        return Err(NoiseFitError::Unresolved { tau_s, total_s, longest_s });
    }
    Ok(LineNoiseModel {
        white_nt: best.white.sqrt().max(FLOOR_NT),
        lasting: GaussMarkov { sigma: best.lasting.sqrt(), tau_s },
    })
}

/// Half the mean square of the change over lags of 1, 2, ... samples, at increasing intervals, up to a quarter of the
/// longest run.
fn structure(runs: &[&[f64]], rate_hz: f64, longest: usize) -> Vec<NoiseFitPoint> {
    let mut points = vec![];
    let mut lag = 1;
    while lag <= longest / 4 {
        let (mut sum, mut terms, mut pairs) = (0.0, 0.0, 0.0);
        for run in runs.iter().filter(|run| run.len() > lag) {
            sum += run.iter().zip(&run[lag..]).map(|(a, b)| 0.5 * (b - a).powi(2)).sum::<f64>();
            terms += (run.len() - lag) as f64;
            pairs += (run.len() - lag) as f64 / lag as f64;
        }
        points.push(NoiseFitPoint {
            white: 1.0,
            span_s: lag as f64 / rate_hz,
            sampled: true,
            value: sum / terms,
            pairs,
        });
        lag = (lag + 1).max((1.2 * lag as f64) as usize);
    }
    points
}

/// Points with the number of independent squares, if the noise has these parts. This number is the number of samples
/// divided by the sum of the squared autocorrelations of the changes over a lag. For white noise, a change is
/// correlated only with the two changes that share a sample (1 + 2/4). For the correlated part, changes are correlated
/// over the lag (2/3 of it, because of the triangular shape), or over the correlation time, whichever is shorter.
fn weighed(
    points: Vec<NoiseFitPoint>,
    parts: &NoiseFitVariances,
    tau_s: f64,
    total_s: f64,
    step_s: f64,
) -> Vec<NoiseFitPoint> {
    let one = |p: NoiseFitPoint| {
        let (white, lasting) = (parts.white, parts.lasting * p.lasting(tau_s));
        let overlap = (p.span_s / 1.5).min(1.5 * tau_s).max(step_s) / step_s;
        let sum = (white + lasting).powi(2) + 0.5 * white * white + (overlap - 1.0) * lasting * lasting;
        let pairs = (total_s - p.span_s) / step_s * (white + lasting).powi(2) / sum;
        NoiseFitPoint { pairs: if pairs.is_finite() { pairs } else { p.pairs }, ..p }
    };
    points.into_iter().map(one).collect()
}

fn allan(runs: &[&[f64]], rate_hz: f64) -> Vec<NoiseFitPoint> {
    let blocks: Vec<BlockMeans> =
        runs.iter().map(|run| BlockMeans::from_runs(run, std::slice::from_ref(&(0..run.len())), rate_hz)).collect();
    let point = |p: super::AllanPoint| NoiseFitPoint {
        white: 1.0 / (rate_hz * p.span_s),
        span_s: p.span_s,
        sampled: p.sampled,
        value: p.variance_nt2,
        pairs: p.pairs,
    };
    allan_variance(&blocks).into_iter().map(point).collect()
}

/// Variances of the white and the correlated part, and the deviance of their fit.
#[derive(Clone, Copy)]
struct NoiseFitVariances {
    white: f64,
    lasting: f64,
    deviance: f64,
}

fn white_alone(points: &[NoiseFitPoint]) -> NoiseFitVariances {
    parts(points, |_| 0.0)
}

/// Best correlation time between two limits, and its parts.
fn best(points: &[NoiseFitPoint], least_s: f64, most_s: f64) -> (f64, NoiseFitVariances) {
    let of = |tau_s: f64| parts(points, |p| p.lasting(tau_s));
    let ratio = (most_s / least_s).powf(1.0 / (TAUS - 1) as f64);
    let tau = |i: usize| least_s * ratio.powi(i as i32);
    let deviances: Vec<f64> = (0..TAUS).map(|i| of(tau(i)).deviance).collect();
    let at = (0..TAUS).min_by(|a, b| deviances[*a].total_cmp(&deviances[*b])).unwrap_or(0);
    // Golden-section search between the neighbours of the best trial time.
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let (mut low, mut high) = (tau(at.saturating_sub(1)).ln(), tau((at + 1).min(TAUS - 1)).ln());
    for _ in 0..30 {
        let (a, b) = (high - golden * (high - low), low + golden * (high - low));
        if of(a.exp()).deviance <= of(b.exp()).deviance { high = b } else { low = a }
    }
    // At the flat minimum, the search is limited by rounding. A parabola through points 0.001 apart in ln τ is hardly
    // affected by rounding.
    const STEP: f64 = 1e-3;
    let middle = 0.5 * (low + high);
    let [before, here, after] = [middle - STEP, middle, middle + STEP].map(|log_tau| of(log_tau.exp()).deviance);
    let shift = 0.5 * STEP * (before - after) / (before - 2.0 * here + after);
    let tau_s = (middle + if shift.abs() < STEP { shift } else { 0.0 }).exp();
    (tau_s, of(tau_s))
}

/// Variances of the white part and of the part with the given response: least squares with the weights of the fit,
/// which converges to the maximum of the gamma likelihood.
fn parts(points: &[NoiseFitPoint], lasting: impl Fn(&NoiseFitPoint) -> f64) -> NoiseFitVariances {
    let rows: Vec<[f64; 4]> = points.iter().map(|p| [p.white, lasting(p), p.value, p.pairs]).collect();
    let mut fitted: Vec<f64> = rows.iter().map(|row| row[2]).collect();
    let floor = 1e-12 * fitted.iter().copied().fold(0.0, f64::max);
    let (mut white, mut other) = (0.0, 0.0);
    for _ in 0..ROUNDS {
        let (mut aa, mut ab, mut bb, mut ay, mut by) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for ([a, b, y, pairs], fitted) in rows.iter().zip(&fitted) {
            let weight = pairs / fitted.max(floor).powi(2);
            aa += weight * a * a;
            ab += weight * a * b;
            bb += weight * b * b;
            ay += weight * a * y;
            by += weight * b * y;
        }
        let determinant = aa * bb - ab * ab;
        (white, other) = ((bb * ay - ab * by) / determinant, (aa * by - ab * ay) / determinant);
        // Variances are not negative; a part whose response equals that of white noise is not a separate part.
        if determinant <= 1e-12 * aa * bb || other < 0.0 {
            (white, other) = (ay / aa, 0.0);
        } else if white < 0.0 {
            (white, other) = (0.0, by / bb);
        }
        fitted = rows.iter().map(|[a, b, ..]| (white * a + other * b).max(floor)).collect();
    }
    let term = |([_, _, y, pairs], fitted): (&[f64; 4], &f64)| {
        let ratio = (y / fitted).max(1e-12);
        pairs * (ratio - 1.0 - ratio.ln())
    };
    NoiseFitVariances { white, lasting: other, deviance: rows.iter().zip(&fitted).map(term).sum() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::random::NormalGenerator;
    use crate::regression::statistics::median;

    const RATE_HZ: f64 = 10.0;
    const BOTH: [NoiseFitStatistic; 2] = [NoiseFitStatistic::Autocorrelation, NoiseFitStatistic::Allan];

    fn record(process: GaussMarkov, white: f64, seconds: f64, seed: u64) -> Vec<f64> {
        let tt: Vec<f64> = (0..(seconds * RATE_HZ) as usize).map(|k| k as f64 / RATE_HZ).collect();
        let mut normals = NormalGenerator::new(seed);
        let lasting = process.realisation(&tt, || normals.draw());
        lasting.into_iter().map(|x| 300.0 + x + white * normals.draw()).collect()
    }

    #[test]
    fn law_known_noise_is_recovered() {
        for (process, white, seconds) in [
            (GaussMarkov { sigma: 5.0, tau_s: 30.0 }, 1.5, 3600.0),
            (GaussMarkov { sigma: 1.0, tau_s: 60.0 }, 3.0, 7200.0),
            (GaussMarkov { sigma: 3.0, tau_s: 5.0 }, 0.0, 1200.0),
        ] {
            for by in BOTH {
                let found: Vec<LineNoiseModel> =
                    (0..40).map(|seed| fit(&[&record(process, white, seconds, seed)], RATE_HZ, by).unwrap()).collect();
                let of = |part: fn(&LineNoiseModel) -> f64| found.iter().map(part).collect::<Vec<f64>>();
                let (mut whites, mut sigmas, mut taus) =
                    (of(|n| n.white_nt), of(|n| n.lasting.sigma), of(|n| n.lasting.tau_s));
                let rms = |x: &[f64], truth: f64| {
                    (x.iter().map(|x| (x / truth - 1.0).powi(2)).sum::<f64>() / x.len() as f64).sqrt()
                };
                let spread = [rms(&sigmas, process.sigma), rms(&taus, process.tau_s)];
                let middle = [median(&mut whites), median(&mut sigmas), median(&mut taus)];
                println!("{} {process:?} {white}: {middle:.3?}, rms errors {spread:.3?}", by.word());
                // A record of length T determines sigma to √(τ/2T) and tau to √(4τ/T); the median of 40 records has a
                // fifth of that error. White noise that is weaker than the correlated part increases the estimate by at
                // most half.
                let [of_sigma, of_tau] = [0.5, 4.0].map(|x| (x * process.tau_s / seconds).sqrt());
                assert!((middle[0] - white).abs() < 0.02 * white.max(process.sigma), "{middle:?}");
                assert!((middle[1] / process.sigma - 1.0).abs() < 0.5 * of_sigma + 0.02, "{middle:?}");
                assert!((middle[2] / process.tau_s - 1.0).abs() < 0.5 * of_tau + 0.02, "{middle:?}");
                assert!(spread[0] < 2.0 * of_sigma && spread[1] < 2.0 * of_tau, "{spread:?} {of_sigma} {of_tau}");
            }
        }
    }

    #[test]
    fn law_white_noise_has_no_correlated_part() {
        let none = GaussMarkov { sigma: 0.0, tau_s: 1.0 };
        for by in BOTH {
            for seed in 0..20 {
                let found = fit(&[&record(none, 2.0, 600.0, seed)], RATE_HZ, by).unwrap();
                // For 6000 samples, one standard deviation is 0.9 %.
                assert!((found.white_nt / 2.0 - 1.0).abs() < 0.04 && found.lasting.sigma < 0.3, "{seed}: {found:?}");
            }
        }
    }

    #[test]
    fn unit_a_record_too_short_for_its_correlation_time_is_rejected() {
        let slow = GaussMarkov { sigma: 5.0, tau_s: 300.0 };
        for by in BOTH {
            let refused = (0..40).filter(|seed| {
                let of = fit(&[&record(slow, 0.5, 900.0, *seed)], RATE_HZ, by);
                matches!(of, Err(NoiseFitError::Unresolved { .. }))
            });
            let n = refused.count();
            println!("{}: {n} of 40 records of three correlation times are refused", by.word());
            assert!(n >= 36, "{}: {n} of 40", by.word());
            // A record of three correlation times does not determine tau. Ten lines of twenty correlation times each
            // determine tau to 14 % (one standard deviation).
            let lines: Vec<Vec<f64>> = (0..10).map(|seed| record(slow, 0.5, 6000.0, seed)).collect();
            let found = fit(&lines.iter().map(Vec::as_slice).collect::<Vec<_>>(), RATE_HZ, by).unwrap();
            assert!((found.lasting.sigma / 5.0 - 1.0).abs() < 0.2, "{found:?}");
            assert!((found.lasting.tau_s / 300.0 - 1.0).abs() < 0.4, "{found:?}");
        }
    }

    #[test]
    fn unit_few_samples_and_a_constant_are_rejected() {
        for by in BOTH {
            assert_eq!(fit(&[], RATE_HZ, by), Err(NoiseFitError::TooShort { longest: 0 }));
            assert_eq!(fit(&[&[1.0; 63], &[2.0; 10]], RATE_HZ, by), Err(NoiseFitError::TooShort { longest: 63 }));
            assert_eq!(fit(&[&[1.0; 200]], RATE_HZ, by), Err(NoiseFitError::Constant));
        }
    }
}

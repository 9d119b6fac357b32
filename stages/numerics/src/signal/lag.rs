//! Lag of one signal relative to another, from the peak of their cross-correlation.

/// Minimum number of pairs of samples for a lag.
pub const LEAST_PAIRS: usize = 16;

/// Error of the estimation of a lag.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LagError {
    /// The two signals have different lengths.
    #[error("one signal has {one} samples, but the other has {other}")]
    Lengths {
        /// Number of samples of the first signal.
        one: usize,
        /// Number of samples of the second signal.
        other: usize,
    },
    /// The sample rate or the range of lags is not a number above 0.
    #[error("the sample rate ({rate_hz} Hz) and the largest lag ({most_s} s) must be above 0")]
    Range {
        /// The sample rate, in Hz.
        rate_hz: f64,
        /// The largest lag, in seconds.
        most_s: f64,
    },
    /// Too few pairs of samples overlap.
    #[error("{pairs} pairs of samples overlap at the largest lag; at least {LEAST_PAIRS} are required")]
    TooShort {
        /// Smallest number of pairs at any lag.
        pairs: usize,
    },
    /// One of the signals is constant.
    #[error("one of the signals is constant")]
    Constant,
    /// The correlation is greatest at the end of the range.
    #[error("the correlation has no peak within the range of lags; it is largest at the end, {lag_s} s")]
    AtEnd {
        /// The lag at that end, in seconds.
        lag_s: f64,
    },
}

/// Lag between two signals, and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignalLag {
    /// Lag of the signal relative to the reference, in seconds: signal(t) = reference(t - `lag_s`).
    pub lag_s: f64,
    /// Standard error, in seconds, if the part not common to both signals is white noise; a lower bound if that part is
    /// correlated.
    pub sd_s: f64,
    /// The correlation coefficient at the peak, -1 to 1.
    pub correlation: f64,
    /// Ratio of the absolute values of the second highest and the highest peak; 0 without another peak. If the ratio is
    /// near 1, the lag is ambiguous, as for periodic signals.
    pub next_peak: f64,
    /// Number of pairs of samples.
    pub pairs: usize,
}

/// Lag of `signal` relative to `reference`, at most `most_s` in either direction. Both are sampled evenly at `rate_hz`
/// at the same times. Samples that are not finite are excluded together with their partners.
///
/// The correlation coefficient r is computed from the overlapping pairs, each signal minus its mean over these pairs.
/// The peak is located between lags of whole samples by the polynomial through the five values around the highest
/// value. With `either_sign` the largest |r| is used, for a signal that may be inverted. The standard error is √((1 -
/// r²)/(n r² b²)). b² is the curvature of r at the peak divided by r: the mean square rate of change of the reference
/// divided by its variance. [Carter 1987, "Coherence and time delay estimation", Proc. IEEE 75(2)]
///
/// # Errors
/// Fails for signals of different lengths, for a rate or range that is not above 0, for fewer than [`LEAST_PAIRS`]
/// pairs at some lag, or for a constant signal. Also fails if r is greatest at an end of the range.
pub fn lag_of(
    reference: &[f64],
    signal: &[f64],
    rate_hz: f64,
    most_s: f64,
    either_sign: bool,
) -> Result<SignalLag, LagError> {
    if reference.len() != signal.len() {
        return Err(LagError::Lengths { one: reference.len(), other: signal.len() });
    }
    if !(rate_hz > 0.0 && rate_hz.is_finite() && most_s > 0.0 && most_s.is_finite()) {
        return Err(LagError::Range { rate_hz, most_s });
    }
    // Two additional lags on either side, so that a peak at the end of the range has neighbours.
    let most = (most_s * rate_hz).floor() as usize + 2;
    if reference.len() < most + LEAST_PAIRS {
        return Err(LagError::TooShort { pairs: reference.len().saturating_sub(most) });
    }
    let (reference, signal) = (about_mean(reference), about_mean(signal));
    let all: Vec<LagCorrelation> =
        (0..=2 * most).map(|k| pearson(&reference, &signal, k as isize - most as isize)).collect();
    if let Some(pairs) = all.iter().map(|p| p.pairs).min().filter(|pairs| *pairs < LEAST_PAIRS) {
        return Err(LagError::TooShort { pairs });
    }
    if all.iter().all(|p| p.r.is_nan()) {
        return Err(LagError::Constant);
    }
    // If one of the two signals is constant over the pairs of a lag, the correlation at this lag is undefined.
    let size: Vec<f64> = all
        .iter()
        .map(|p| {
            if p.r.is_nan() {
                0.0
            } else if either_sign {
                p.r.abs()
            } else {
                p.r
            }
        })
        .collect();
    let best = (2..size.len() - 2).max_by(|a, b| size[*a].total_cmp(&size[*b])).unwrap_or(most);
    let is_peak = |k: usize| k > 0 && k + 1 < size.len() && size[k] >= size[k - 1] && size[k] >= size[k + 1];
    if !is_peak(best) || size[best] <= 0.0 {
        return Err(LagError::AtEnd { lag_s: (best as f64 - most as f64) / rate_hz });
    }
    let around: [f64; 5] = std::array::from_fn(|j| size[best + j - 2]);
    let (offset, peak, curvature) = top(&around);
    let r = peak.min(1.0);
    let next = (0..size.len()).filter(|k| *k != best && is_peak(*k) && size[*k] > 0.0).map(|k| size[k]);
    let next_peak = next.fold(0.0, f64::max) / size[best];
    let pairs = all[best].pairs;
    let rate_squared = -curvature * rate_hz * rate_hz / r;
    let sd_s = ((1.0 - r * r).max(0.0) / (pairs as f64 * r * r * rate_squared)).sqrt();
    let correlation = if all[best].r < 0.0 { -r } else { r };
    Ok(SignalLag { lag_s: (best as f64 - most as f64 + offset) / rate_hz, sd_s, correlation, next_peak, pairs })
}

/// Pearson correlation of two signals at one lag.
struct LagCorrelation {
    r: f64,
    pairs: usize,
}

/// Signal minus its mean, with NaN for values that are not finite.
fn about_mean(x: &[f64]) -> Vec<f64> {
    let finite = x.iter().filter(|x| x.is_finite());
    let mean = finite.clone().sum::<f64>() / finite.count().max(1) as f64;
    x.iter().map(|x| if x.is_finite() { x - mean } else { f64::NAN }).collect()
}

/// Correlation coefficient of reference(i) with signal(i + lag); NaN if a signal is constant.
fn pearson(reference: &[f64], signal: &[f64], lag: isize) -> LagCorrelation {
    let by = lag.unsigned_abs().min(signal.len());
    let (a, b) = match lag >= 0 {
        true => (&reference[..reference.len() - by], &signal[by..]),
        false => (&reference[by..], &signal[..signal.len() - by]),
    };
    let mut s = [0.0f64; 6];
    for (a, b) in a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite()) {
        for (sum, x) in s.iter_mut().zip([1.0, *a, *b, a * a, a * b, b * b]) {
            *sum += x;
        }
    }
    let [n, a, b, aa, ab, bb] = s;
    let (va, vb) = (aa - a * a / n, bb - b * b / n);
    // The sum of the squares of a constant contains a rounding error.
    let varies = |v: f64, squares: f64| v > 1e-13 * squares;
    let r = if n > 1.0 && varies(va, aa) && varies(vb, bb) { (ab - a * b / n) / (va * vb).sqrt() } else { f64::NAN };
    LagCorrelation { r, pairs: n as usize }
}

/// Position (in steps from the middle value), height and second derivative (per step squared) of the peak of the
/// polynomial through five values, the highest in the middle. If that polynomial has no peak nearby, the parabola
/// through three values is used.
fn top(y: &[f64; 5]) -> (f64, f64, f64) {
    let [a, b, c, d, e] = *y;
    // Derivatives at the middle by central differences, which are exact for a polynomial of degree 4.
    let first = (a - 8.0 * b + 8.0 * d - e) / 12.0;
    let second = (-a + 16.0 * b - 30.0 * c + 16.0 * d - e) / 12.0;
    let third = (-a + 2.0 * b - 2.0 * d + e) / 2.0;
    let fourth = a - 4.0 * b + 6.0 * c - 4.0 * d + e;
    let slope = |u: f64| first + u * (second + u * (third / 2.0 + u * fourth / 6.0));
    let bend = |u: f64| second + u * (third + u * fourth / 2.0);
    let mut u = 0.0;
    for _ in 0..30 {
        u -= slope(u) / bend(u);
    }
    if u.is_finite() && u.abs() <= 1.0 && bend(u) < 0.0 && slope(u).abs() < 1e-9 {
        let height = c + u * (first + u * (second / 2.0 + u * (third / 6.0 + u * fourth / 24.0)));
        return (u, height, bend(u));
    }
    let (slope, bend) = (0.5 * (d - b), b - 2.0 * c + d);
    let u = if bend < 0.0 { (-slope / bend).clamp(-0.5, 0.5) } else { 0.0 };
    (u, c + u * (slope + 0.5 * u * bend), bend.min(-f64::MIN_POSITIVE))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::{random::NormalGenerator, reference_csv::columns};

    const RATE_HZ: f64 = 10.0;

    /// Sum of waves of up to 1 Hz at the time `t`, in seconds.
    fn waves(t: f64) -> f64 {
        let one = |(k, hz): (usize, f64)| (5.0 - k as f64) * (TAU * hz * t + 1.3 * k as f64).sin();
        [0.043, 0.127, 0.31, 0.57, 0.93].into_iter().enumerate().map(one).sum()
    }

    fn sampled(of: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..3000).map(|k| of(f64::from(k) / RATE_HZ)).collect()
    }

    #[test]
    fn law_a_known_lag_is_recovered() {
        let reference = sampled(waves);
        for lag_s in [0.0, 0.06, -0.06, 0.137, 0.5, -1.2345] {
            let signal = sampled(|t| 45_000.0 - 3.0 * waves(t - lag_s));
            let found = lag_of(&reference, &signal, RATE_HZ, 2.0, true).unwrap();
            // Error of a polynomial through five samples of a correlation that decreases within 0.3 s.
            assert!((found.lag_s - lag_s).abs() < 2e-4, "{lag_s}: {found:?}");
            assert!(found.correlation < -0.999 && found.sd_s < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn law_the_scatter_of_the_lag_in_noise_equals_its_standard_error() {
        let reference = sampled(waves);
        let mut normals = NormalGenerator::new(11);
        let lags: Vec<SignalLag> = (0..60)
            .map(|_| {
                let signal: Vec<f64> = sampled(|t| waves(t - 0.06)).iter().map(|x| x + 4.0 * normals.draw()).collect();
                lag_of(&reference, &signal, RATE_HZ, 1.0, false).unwrap()
            })
            .collect();
        let square = lags.iter().map(|l| (l.lag_s - 0.06).powi(2)).sum::<f64>() / lags.len() as f64;
        let sd = lags.iter().map(|l| l.sd_s).sum::<f64>() / lags.len() as f64;
        // Sixty draws determine a standard deviation to 9 %.
        assert!((square.sqrt() / sd - 1.0).abs() < 0.3, "{} {sd}", square.sqrt());
    }

    #[test]
    fn val_the_correlation_at_whole_lags_equals_numpy() {
        let samples = columns(include_str!("../../reference/signal/lag_samples.csv"));
        let table = columns(include_str!("../../reference/signal/lag.csv"));
        let (a, b) = (about_mean(&samples["reference"]), about_mean(&samples["signal"]));
        for (lag, expected) in table["lag"].iter().zip(&table["r"]) {
            let found = pearson(&a, &b, *lag as isize);
            assert!((found.r - expected).abs() < 1e-12, "{lag}: {} {expected}", found.r);
        }
    }

    #[test]
    fn unit_signals_without_a_lag_are_rejected_with_the_reason() {
        let reference = sampled(waves);
        let of = |signal: &[f64], most_s: f64| lag_of(&reference, signal, RATE_HZ, most_s, false);
        assert_eq!(of(&[1.0], 1.0), Err(LagError::Lengths { one: 3000, other: 1 }));
        assert_eq!(of(&vec![7.0; 3000], 1.0), Err(LagError::Constant));
        assert_eq!(of(&vec![f64::NAN; 3000], 1.0), Err(LagError::TooShort { pairs: 0 }));
        assert!(matches!(of(&reference, 299.0), Err(LagError::TooShort { .. })));
        assert!(matches!(of(&reference, 0.0), Err(LagError::Range { .. })));
        assert!(matches!(of(&sampled(|t| waves(t - 0.5)), 0.2), Err(LagError::AtEnd { .. })));
        // A gap excludes only the pairs of samples that contain it.
        let mut gap = sampled(|t| waves(t - 0.06));
        gap[1000..1200].fill(f64::NAN);
        let found = of(&gap, 1.0).unwrap();
        assert!((found.lag_s - 0.06).abs() < 2e-4 && found.pairs == 2800 - 1, "{found:?}");
    }

    #[test]
    fn law_a_periodic_signal_is_ambiguous() {
        let wave = |t: f64| (TAU * t).sin();
        let found = lag_of(&sampled(wave), &sampled(|t| wave(t - 0.06)), RATE_HZ, 3.0, false).unwrap();
        assert!(found.next_peak > 0.99, "{found:?}");
        let found = lag_of(&sampled(waves), &sampled(|t| waves(t - 0.06)), RATE_HZ, 3.0, false).unwrap();
        assert!(found.next_peak < 0.9, "{found:?}");
    }
}

//! Consistency of a filter's covariance with its errors: chi-square bounds of the normalised squared errors, and the
//! whiteness of the innovations.
//!
//! [Bar-Shalom, Li and Kirubarajan 2001, section 5.4; Mehra 1970]

use super::statistics::SampleStatistic;

/// A long series is reduced to the means of at most this number of blocks before its autocorrelations are summed.
const BLOCKS: usize = 2048;
/// Minimum number of samples of a test.
const LEAST: usize = 10;

/// Effective number of independent samples of `x`: the variance of a sample divided by the variance of the mean.
/// Autocorrelations are summed in pairs of neighbouring lags until the sum of a pair is not above 0; each sum is
/// limited to the sum of the previous pair. The result is at least 1 and at most the number of samples; NaN for a
/// constant or fewer than ten samples. Values that are not finite are excluded, and their neighbours are treated as
/// adjacent. [Geyer 1992, section 3.3]
///
/// For a series of only a few correlation times, the result is too large.
pub fn effective_samples(x: &[f64]) -> f64 {
    let known: Vec<f64> = x.iter().copied().filter(|x| x.is_finite()).collect();
    let n = known.len();
    if n < LEAST {
        return f64::NAN;
    }
    let variance = |x: &[f64]| {
        let mean = x.iter().sum::<f64>() / x.len() as f64;
        x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / x.len() as f64
    };
    let size = n.div_ceil(BLOCKS);
    let blocks: Vec<f64> = known.chunks_exact(size).map(|b| b.iter().sum::<f64>() / size as f64).collect();
    let (of_sample, of_block) = (variance(&known), variance(&blocks));
    if of_sample.is_nan() || of_sample <= 0.0 || of_block <= 0.0 {
        return f64::NAN;
    }
    let of_mean = of_block * inefficiency(&blocks, of_block) / blocks.len() as f64;
    (of_sample / of_mean).clamp(1.0, n as f64)
}

/// Statistical inefficiency, 1 plus twice the sum of the autocorrelations: the variance of the mean divided by the
/// variance of the mean of independent samples.
fn inefficiency(x: &[f64], variance: f64) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    let at = |lag: usize| {
        let products = x.iter().zip(&x[lag..]).map(|(a, b)| (a - mean) * (b - mean));
        products.sum::<f64>() / (x.len() as f64 * variance)
    };
    let (mut sum, mut before) = (0.0, f64::INFINITY);
    for lag in (0..x.len() - 1).step_by(2) {
        let pair = (at(lag) + at(lag + 1)).min(before);
        if pair <= 0.0 {
            break;
        }
        (sum, before) = (sum + pair, pair);
    }
    (2.0 * sum - 1.0).max(1.0 / x.len() as f64)
}

/// Probability that a consistent filter has a smaller mean of `squares` than the given value. `squares` are the
/// normalised squares of errors or innovations with `freedom` components each. The probability is near 0 for a cautious
/// filter and near 1 for an overconfident one. The mean times the number of independent samples ([`effective_samples`])
/// is chi-square with `freedom` degrees of freedom per independent sample. NaN if that number is NaN.
pub fn chi_square_probability(squares: &[f64], freedom: f64) -> SampleStatistic {
    let known = || squares.iter().filter(|x| x.is_finite());
    let n = known().count();
    let mean = known().sum::<f64>() / n as f64;
    let independent = effective_samples(squares);
    SampleStatistic { value: gamma_p(0.5 * freedom * independent, 0.5 * independent * mean), n }
}

/// Whether the mean of normalised squares is within the 95 % band of a consistent filter, by
/// [`chi_square_probability`]: 1 within, 0 outside, NaN if the probability is NaN.
pub fn within_chi_square_band(squares: &[f64], freedom: f64) -> SampleStatistic {
    let SampleStatistic { value, n } = chi_square_probability(squares, freedom);
    let within = if (0.025..=0.975).contains(&value) { 1.0 } else { 0.0 };
    SampleStatistic { value: if value.is_nan() { f64::NAN } else { within }, n }
}

/// Autocorrelation of `x` at a lag in samples, divided by the mean square of `x`, and the number of pairs. The mean is
/// not subtracted. Pairs with a value that is not finite are excluded. NaN for a lag without a pair, and for a series
/// of zeros.
pub fn autocorrelation(x: &[f64], lag: usize) -> SampleStatistic {
    let products = || x.iter().zip(x.iter().skip(lag)).map(|(a, b)| a * b).filter(|p| p.is_finite());
    let pairs = products().count();
    SampleStatistic { value: products().sum::<f64>() / (pairs as f64 * mean_square(x)), n: pairs }
}

/// The mean square of the finite values.
fn mean_square(x: &[f64]) -> f64 {
    let squares = || x.iter().filter(|x| x.is_finite()).map(|x| x * x);
    squares().sum::<f64>() / squares().count() as f64
}

/// Smallest distance, in samples, from one finite value to the next. It exceeds 1 for thinned measurements, which have
/// innovations only at some samples.
fn stride(x: &[f64]) -> usize {
    let rows: Vec<usize> = (0..x.len()).filter(|row| x[*row].is_finite()).collect();
    rows.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap_or(1)
}

/// Share of the autocorrelations of `x`, at lags of 1 to `lags` strides, that are within ±1.96/√n, where n is the
/// number of pairs of a lag. A stride is the smallest distance between finite values. The expected value is 0.95 for
/// white noise of mean 0. Autocorrelations are computed without subtracting the mean, so that a bias is not treated as
/// white noise. Pairs with a value that is not finite are excluded. NaN for fewer samples than twice the lags, and for
/// a series of zeros.
pub fn whiteness(x: &[f64], lags: usize) -> SampleStatistic {
    let n = x.iter().filter(|x| x.is_finite()).count();
    if n < 2 * lags.max(1) || mean_square(x) <= 0.0 {
        return SampleStatistic { value: f64::NAN, n };
    }
    let stride = stride(x);
    let within = |lag: &usize| {
        let SampleStatistic { value, n } = autocorrelation(x, stride * lag);
        value.abs() <= 1.96 / (n as f64).sqrt()
    };
    SampleStatistic { value: (1..=lags).filter(within).count() as f64 / lags as f64, n }
}

/// Regularised lower incomplete gamma function P(a, x) for a above 0: the distribution of chi-square with 2a degrees of
/// freedom at 2x. It is computed by its series for x below a + 1, and by its continued fraction above. [Abramowitz &
/// Stegun 1964, 6.5.29 and 6.5.31]
fn gamma_p(a: f64, x: f64) -> f64 {
    if a.is_nan() || x.is_nan() || a <= 0.0 {
        return f64::NAN;
    }
    if x <= 0.0 {
        return 0.0;
    }
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    // Series and continued fraction converge within about √a terms for x near a.
    let most = 200 + (20.0 * a.sqrt()) as usize;
    if x < a + 1.0 {
        let (mut term, mut sum) = (1.0 / a, 1.0 / a);
        for k in 1..most {
            term *= x / (a + k as f64);
            sum += term;
            if term < sum * f64::EPSILON {
                break;
            }
        }
        return (front * sum).min(1.0);
    }
    // Lentz's method.
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1e300, 1.0 / b);
    let mut fraction = d;
    for k in 1..most {
        let numerator = -(k as f64) * (k as f64 - a);
        b += 2.0;
        d = 1.0 / (numerator * d + b);
        c = b + numerator / c;
        fraction *= c * d;
        if (c * d - 1.0).abs() < f64::EPSILON {
            break;
        }
    }
    (1.0 - front * fraction).max(0.0)
}

/// ln Γ(a) for a above 0, accurate to 1e-13, by Stirling's series above 10 and the recurrence below. [Abramowitz &
/// Stegun 1964, 6.1.41]
fn ln_gamma(a: f64) -> f64 {
    let (mut shift, mut a) = (0.0, a);
    while a < 10.0 {
        shift += a.ln();
        a += 1.0;
    }
    let r = 1.0 / (a * a);
    let series = (1.0 / 12.0 - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r * (1.0 / 1680.0 - r / 1188.0)))) / a;
    (a - 0.5) * a.ln() - a + 0.5 * std::f64::consts::TAU.ln() + series - shift
}

/// Innovations divided by their predicted standard deviations, from the innovations and their normalised squares.
pub fn normalised_innovations(residual: &[f64], nis: &[f64]) -> Vec<f64> {
    residual.iter().zip(nis).map(|(residual, nis)| nis.sqrt().copysign(*residual)).collect()
}

/// Statistical inefficiency of `x`: its number of finite values divided by [`effective_samples`], at least 1. NaN for a
/// constant or fewer than ten samples.
pub fn statistical_inefficiency(x: &[f64]) -> f64 {
    x.iter().filter(|x| x.is_finite()).count() as f64 / effective_samples(x)
}

/// Mean of the squared normalised innovations times the [`statistical_inefficiency`] of the innovations, which is 1
/// plus twice the sum of their autocorrelations. The product is the ratio of the variance of averages of `x` to the
/// variance of averages of independent values of variance 1. The expected value is 1 for a consistent filter. Averages
/// of innovations correct the position. Values above 1 therefore mean that the covariance is too small, because the
/// innovations are too large or too correlated. NaN for a constant or fewer than ten samples.
pub fn correlated_nis(x: &[f64]) -> SampleStatistic {
    let n = x.iter().filter(|x| x.is_finite()).count();
    SampleStatistic { value: mean_square(x) * n as f64 / effective_samples(x), n }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::NormalGenerator;

    /// A stationary series of variance 1, with the autocorrelation `decay` from sample to sample.
    fn coloured(n: usize, decay: f64, seed: u64) -> Vec<f64> {
        let mut normals = NormalGenerator::new(seed);
        let mut x = normals.draw();
        let step = (1.0 - decay * decay).sqrt();
        (0..n)
            .map(|_| {
                x = decay * x + step * normals.draw();
                x
            })
            .collect()
    }

    fn share(of: usize, yes: impl Fn(u64) -> bool) -> f64 {
        (0..of as u64).filter(|seed| yes(*seed)).count() as f64 / of as f64
    }

    #[test]
    fn ref_chi_square_quantiles_of_printed_tables() {
        // Quantiles at 0.025, 0.5 and 0.975 [Abramowitz & Stegun 1964, table 26.8].
        for (freedom, at, p) in [
            (1.0, 5.023_89, 0.975),
            (2.0, 0.050_635_6, 0.025),
            (2.0, 1.386_29, 0.5),
            (10.0, 3.246_97, 0.025),
            (10.0, 20.483_2, 0.975),
            (100.0, 74.221_9, 0.025),
            (100.0, 129.561, 0.975),
        ] {
            // The tables have six digits; the density is at most 0.5.
            assert!(
                (gamma_p(0.5 * freedom, 0.5 * at) - p).abs() < 3e-6,
                "{freedom} {at}: {}",
                gamma_p(freedom / 2.0, at / 2.0)
            );
        }
        // With a shape parameter of 10,000 the distribution is nearly normal.
        assert!((gamma_p(1e4, 1e4 + 1.96e2) - 0.975).abs() < 2e-3);
        assert!((ln_gamma(0.5) - 0.5 * std::f64::consts::PI.ln()).abs() < 1e-12 && ln_gamma(1.0).abs() < 1e-12);
        assert!((ln_gamma(20.0) - 121_645_100_408_832_000f64.ln()).abs() < 1e-12);
    }

    #[test]
    fn law_correlated_samples_have_their_effective_number() {
        // The mean of a series with decay d has the variance of the mean of n (1 - d)/(1 + d) independent samples.
        for (decay, n) in [(0.0, 4000), (0.5, 4000), (0.9, 20_000), (0.99, 50_000)] {
            let expected = f64::from(n) * (1.0 - decay) / (1.0 + decay);
            let all: Vec<f64> = (0..20).map(|seed| effective_samples(&coloured(n as usize, decay, seed))).collect();
            let mean = all.iter().sum::<f64>() / 20.0;
            // A truncated sum of autocorrelations is accurate to some 15 %, and the mean of twenty sums to 4 %. Pairs
            // that are positive by chance make the result slightly too small.
            assert!((0.8..1.1).contains(&(mean / expected)), "{decay}: {mean} {expected}");
        }
        assert!(effective_samples(&[1.0; 50]).is_nan() && effective_samples(&[1.0, 2.0]).is_nan());
        let mut gappy = coloured(500, 0.0, 1);
        gappy[100..200].fill(f64::NAN);
        assert!(effective_samples(&gappy) <= 400.0);
    }

    #[test]
    fn law_a_consistent_filter_is_within_the_band_for_any_correlation() {
        for decay in [0.0, 0.9] {
            let nees = |scale: f64, seed: u64| -> Vec<f64> {
                let (north, east) = (coloured(2000, decay, seed), coloured(2000, decay, seed + 1000));
                north.iter().zip(&east).map(|(n, e)| scale * (n * n + e * e)).collect()
            };
            let within = |scale: f64| share(200, |seed| within_chi_square_band(&nees(scale, seed), 2.0).value == 1.0);
            let (fair, proud, shy) = (within(1.0), within(2.0), within(0.5));
            println!("decay {decay}: consistent {fair}, half the covariance {proud}, twice {shy}");
            // The expected share is 0.95 of 200, with a standard deviation of 1.5 %; estimating the number of
            // independent samples adds a few per cent.
            assert!((0.87..=1.0).contains(&fair), "{fair}");
            assert!(proud < 0.02 && shy < 0.02, "{proud} {shy}");
        }
        let innovations: Vec<f64> = coloured(1000, 0.0, 5).iter().map(|x| x * x).collect();
        assert_eq!(within_chi_square_band(&innovations, 1.0), SampleStatistic { value: 1.0, n: 1000 });
        assert!(within_chi_square_band(&[0.5; 100], 1.0).value.is_nan(), "a constant has no spread to judge by");
        assert!(chi_square_probability(&innovations.iter().map(|x| 2.0 * x).collect::<Vec<_>>(), 1.0).value > 0.999);
    }

    #[test]
    fn law_whiteness_separates_white_noise_from_correlation_and_bias() {
        let mean = |decay: f64, bias: f64, spread: f64| {
            let of = |seed| {
                let x: Vec<f64> = coloured(1000, decay, seed).iter().map(|x| spread * x + bias).collect();
                whiteness(&x, 20).value
            };
            (0..50).map(of).sum::<f64>() / 50.0
        };
        // For 1000 lags of fifty series, one standard deviation is 0.7 %.
        let (white, coloured_one, biased) = (mean(0.0, 0.0, 1.0), mean(0.9, 0.0, 1.0), mean(0.0, 0.5, 1.0));
        println!("white {white:.3}, decay of 0.9 {coloured_one:.3}, bias of half a sigma {biased:.3}");
        assert!((white - 0.95).abs() < 0.025, "{white}");
        assert!(coloured_one < 0.3 && biased < 0.05, "{coloured_one} {biased}");
        assert_eq!(mean(0.0, 0.0, 1e-3), white, "the size does not matter");
    }

    #[test]
    fn law_correlated_nis_is_the_variance_of_averages() {
        let mean = |decay: f64, spread: f64| {
            let of = |seed| {
                let x: Vec<f64> = coloured(4000, decay, seed).iter().map(|x| spread * x).collect();
                correlated_nis(&x).value
            };
            (0..50).map(of).sum::<f64>() / 50.0
        };
        // The expected value is (1 + a)/(1 - a) for a first-order autoregression with decay a.
        for (decay, spread, expected) in
            [(0.0, 1.0, 1.0), (0.0, 2.0, 4.0), (0.5, 1.0, 3.0), (0.5, 3f64.sqrt().recip(), 1.0)]
        {
            let got = mean(decay, spread);
            println!("decay {decay}, spread {spread:.2}: {got:.3}, expected {expected}");
            assert!((got / expected - 1.0).abs() < 0.1, "{got} {expected}");
        }
        assert!(correlated_nis(&[0.5; 100]).value.is_nan() && correlated_nis(&[]).n == 0);
    }

    #[test]
    fn unit_gaps_and_short_series() {
        let mut x = coloured(400, 0.0, 3);
        x[50..70].fill(f64::NAN);
        let figure = whiteness(&x, 20);
        assert!(figure.n == 380 && figure.value > 0.7, "{figure:?}");
        assert!(whiteness(&x[..39], 20).value.is_nan() && whiteness(&[0.0; 100], 20).value.is_nan());
        assert!(whiteness(&[f64::NAN; 100], 20).value.is_nan() && whiteness(&[], 20).n == 0);
    }

    #[test]
    fn law_gaps_between_values_do_not_change_whiteness() {
        let mut normals = crate::random::NormalGenerator::new(3);
        let dense: Vec<f64> = (0..800).map(|_| normals.draw()).collect();
        let mut sparse = vec![f64::NAN; 8000];
        dense.iter().enumerate().for_each(|(row, value)| sparse[10 * row] = *value);
        assert_eq!(whiteness(&sparse, 20).value, whiteness(&dense, 20).value);
        assert!(whiteness(&sparse, 20).value > 0.8);
    }
}

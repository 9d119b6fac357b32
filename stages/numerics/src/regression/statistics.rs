//! Means, deviations and the scores derived from them.
//!
//! Rows that are not finite are excluded. Every result includes the number of used rows. Sums run in row order and in
//! two passes, the second pass about the mean of the first pass. This preserves deviations of picotesla in a field of
//! 50,000 nT.

/// A statistic and the number of samples from which it is computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleStatistic {
    /// The statistic, in the unit of the samples; NaN if `n` is too small for the statistic.
    pub value: f64,
    /// Number of samples used.
    pub n: usize,
}

/// Count, mean, standard deviation and root mean square of a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesMoments {
    /// The number of finite samples.
    pub n: usize,
    /// Number of samples that are not finite and are excluded.
    pub left_out: usize,
    /// The mean; NaN without samples.
    pub mean: f64,
    /// The standard deviation (divisor n − 1); NaN for fewer than two samples.
    pub std: f64,
    /// The root mean square; NaN without samples.
    pub rms: f64,
}

/// The moments of `x`, in the unit of `x`.
pub fn summary(x: &[f64]) -> SeriesMoments {
    summarise(x.iter().copied())
}

/// Moments of `estimate − truth`, in their unit; rows where either is not finite are excluded.
pub fn error_summary(estimate: &[f64], truth: &[f64]) -> SeriesMoments {
    summarise(estimate.iter().zip(truth).map(|(estimate, truth)| estimate - truth))
}

fn summarise(x: impl Iterator<Item = f64> + Clone) -> SeriesMoments {
    let total = x.clone().count();
    let finite = || x.clone().filter(|x| x.is_finite());
    let n = finite().count();
    let count = n as f64;
    let rough = finite().sum::<f64>() / count;
    // The mean of the residuals corrects the rounding of the first sum.
    let mean = rough + finite().map(|x| x - rough).sum::<f64>() / count;
    let squares: f64 = finite().map(|x| (x - mean) * (x - mean)).sum();
    let std = if n > 1 { (squares / (count - 1.0)).sqrt() } else { f64::NAN };
    SeriesMoments { n, left_out: total - n, mean, std, rms: (mean * mean + squares / count).sqrt() }
}

/// Median: the middle value, or the mean of the two middle values; NaN for an empty slice. Reorders the values.
pub fn median(values: &mut [f64]) -> f64 {
    let n = values.len();
    if n == 0 {
        return f64::NAN;
    }
    let (below, &mut upper, _) = values.select_nth_unstable_by(n / 2, f64::total_cmp);
    if n % 2 == 1 {
        return upper;
    }
    let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    0.5 * (lower + upper)
}

/// Quantile of sorted values at `part`, 0 to 1, linear between order statistics (numpy's default); NaN for an empty
/// slice.
pub fn quantile(sorted: &[f64], part: f64) -> f64 {
    let at = part.clamp(0.0, 1.0) * sorted.len().saturating_sub(1) as f64;
    let value = |i: f64| sorted.get(i as usize).copied().unwrap_or(f64::NAN);
    let (below, above) = (value(at.floor()), value(at.ceil()));
    below + (at - at.floor()) * (above - below)
}

/// The mean of `x`.
pub fn mean(x: &[f64]) -> SampleStatistic {
    let SeriesMoments { n, mean, .. } = summary(x);
    SampleStatistic { value: mean, n }
}

/// The standard deviation (divisor n − 1) of `x`, as in all of MagNav.jl.
pub fn std(x: &[f64]) -> SampleStatistic {
    let SeriesMoments { n, std, .. } = summary(x);
    SampleStatistic { value: std, n }
}

/// The root mean square of `x`.
pub fn rms(x: &[f64]) -> SampleStatistic {
    let SeriesMoments { n, rms, .. } = summary(x);
    SampleStatistic { value: rms, n }
}

/// Lower bound, in metres, on the root mean square horizontal error of an estimate of a track's constant offset from a
/// map. The map has the slopes `north` and `east` (nT/m) at the samples. Each sample of the measurement has an
/// independent error of `sigma_nt`; a constant bias of the measurement is also unknown. The bound is √ trace(J⁻¹),
/// where the Fisher information J is the covariance of the slopes times n/σ². NaN if the slopes are constant or vary
/// only along one line in the plane of `north` and `east`. [Cramér-Rao bound; Kay 1993, 3.7]
///
/// Rows with a value that is not finite are excluded.
pub fn offset_bound(north: &[f64], east: &[f64], sigma_nt: f64) -> SampleStatistic {
    let known = || north.iter().zip(east).filter(|(n, e)| n.is_finite() && e.is_finite());
    let n = known().count();
    let mean = |of: fn((&f64, &f64)) -> f64| known().map(of).sum::<f64>() / n as f64;
    let (mean_n, mean_e) = (mean(|(n, _)| *n), mean(|(_, e)| *e));
    let (mut nn, mut ne, mut ee) = (0.0, 0.0, 0.0);
    for (n, e) in known().map(|(n, e)| (n - mean_n, e - mean_e)) {
        nn += n * n;
        ne += n * e;
        ee += e * e;
    }
    let determinant = nn * ee - ne * ne;
    let singular = determinant <= 1e-12 * nn * ee || n < 3;
    let value = if singular { f64::NAN } else { sigma_nt * ((nn + ee) / determinant).sqrt() };
    SampleStatistic { value, n }
}

/// Distance root mean square √(mean(north² + east²)) of position errors, in metres.
///
/// Errors are relative to the truth, not to their mean: a constant offset is included. Rows with a value that is not
/// finite are excluded.
pub fn drms(north_m: &[f64], east_m: &[f64]) -> SampleStatistic {
    let pairs = north_m.iter().zip(east_m);
    let squares = pairs.map(|(north, east)| north * north + east * east);
    let SeriesMoments { n, mean, .. } = summarise(squares);
    SampleStatistic { value: mean.sqrt(), n }
}

/// The improvement ratio of compensation: σ(uncompensated)/σ(compensated) over the rows
/// where both are finite. [van der Meer 2025, (2.40)]
///
/// For band-passed signals, this is the band improvement ratio (2.41). The thesis divides by N in (2.39); the divisor
/// cancels in the ratio.
pub fn improvement_ratio(uncompensated: &[f64], compensated: &[f64]) -> SampleStatistic {
    ratio_of_deviations(uncompensated, compensated)
}

/// Signal-to-noise ratio σ(anomaly)/σ(estimate − truth) of a magnetic measurement, over the rows where all are finite.
/// `anomaly` is the signal part of the truth: the truth minus core field and temporal variation. The gradient of the
/// core field is excluded from the signal, because it increases with the length of the line. [Gnadt 2022, (3.46)]
pub fn signal_to_noise(estimate: &[f64], truth: &[f64], anomaly: &[f64]) -> SampleStatistic {
    let error: Vec<f64> = estimate.iter().zip(truth).map(|(a, b)| a - b).collect();
    ratio_of_deviations(anomaly, &error)
}

/// `x` minus the least-squares straight line in `t` fitted to the rows where both are finite. With fewer than two such
/// rows, `x` is unchanged.
pub fn less_straight_line(t: &[f64], x: &[f64]) -> Vec<f64> {
    let known = || t.iter().zip(x).filter(|(t, x)| t.is_finite() && x.is_finite());
    let n = known().count() as f64;
    let (mean_t, mean_x) = (known().map(|(t, _)| t).sum::<f64>() / n, known().map(|(_, x)| x).sum::<f64>() / n);
    let squares: f64 = known().map(|(t, _)| (t - mean_t).powi(2)).sum();
    let products: f64 = known().map(|(t, x)| (t - mean_t) * (x - mean_x)).sum();
    if n < 2.0 || squares == 0.0 {
        return x.to_vec();
    }
    let slope = products / squares;
    t.iter().zip(x).map(|(t, x)| x - mean_x - slope * (t - mean_t)).collect()
}

/// Normalised estimation error squared of a horizontal position, e' P⁻¹ e, sample by sample. The expected value is 2
/// for a consistent filter. [Bar-Shalom, Li and Kirubarajan 2001, section 5.4]
///
/// `north_m` and `east_m` are the errors, `sd_n_m` and `sd_e_m` their standard deviations, `cov_ne_m2` their
/// covariance.
pub fn position_nees(north_m: &[f64], east_m: &[f64], sd_n_m: &[f64], sd_e_m: &[f64], cov_ne_m2: &[f64]) -> Vec<f64> {
    let errors = north_m.iter().zip(east_m);
    let sigmas = sd_n_m.iter().zip(sd_e_m).zip(cov_ne_m2);
    let one = |((n, e), ((sd_n, sd_e), ne))| {
        let (n, e, ne): (&f64, &f64, &f64) = (n, e, ne);
        let (nn, ee): (f64, f64) = (sd_n * sd_n, sd_e * sd_e);
        (ee * n * n - 2.0 * ne * n * e + nn * e * e) / (nn * ee - ne * ne)
    };
    errors.zip(sigmas).map(one).collect()
}

fn ratio_of_deviations(above: &[f64], below: &[f64]) -> SampleStatistic {
    let both = || {
        let pairs = above.iter().zip(below);
        pairs.filter(|(above, below)| above.is_finite() && below.is_finite())
    };
    let above = summarise(both().map(|(above, _)| *above));
    let below = summarise(both().map(|(_, below)| *below));
    SampleStatistic { value: above.std / below.std, n: above.n }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn law_nees_equals_values_by_hand() {
        assert_eq!(position_nees(&[3.0], &[0.0], &[3.0], &[4.0], &[0.0]), [1.0]);
        // For P = [4 2; 2 4], the inverse is [4 -2; -2 4]/12. For e = (1, 2), the result is (4 - 8 + 16)/12.
        let nees = position_nees(&[1.0], &[2.0], &[2.0], &[2.0], &[2.0]);
        assert!((nees[0] - 1.0).abs() < 1e-15, "{nees:?}");
    }

    #[test]
    fn law_moments_of_a_short_series_by_hand() {
        let s = summary(&[1.0, f64::NAN, 2.0, 3.0, f64::INFINITY, 6.0]);
        assert_eq!((s.n, s.left_out, s.mean), (4, 2, 3.0));
        // Σ(x − 3)² = 14, Σx² = 50: exact except for the final square root.
        assert_eq!(s.std, (14.0f64 / 3.0).sqrt());
        assert!((s.rms - 12.5f64.sqrt()).abs() < 1e-15);
        assert_eq!(rms(&[3.0, -3.0]).value, 3.0);
    }

    #[test]
    fn law_a_small_deviation_on_a_large_field_is_kept() {
        let x: Vec<f64> = (0..100_000).map(|k| 50_000.0 + 1e-6 * f64::from(k % 2)).collect();
        // Half of the samples are higher by 1e-6, so σ is 0.5e-6 except for a factor due to the divisor n − 1. The
        // spacing of doubles near 50,000 is 7e-12, so the error is 1e-5 of the result.
        assert!((std(&x).value / 0.5e-6 - 1.0).abs() < 2e-5, "{:e}", std(&x).value);
    }

    #[test]
    fn unit_too_few_samples_give_nan() {
        assert!(std(&[4.0]).value.is_nan());
        assert_eq!(mean(&[4.0]), SampleStatistic { value: 4.0, n: 1 });
        let none = summary(&[f64::NAN]);
        assert!(none.mean.is_nan() && none.rms.is_nan() && none.std.is_nan());
        assert_eq!(none.n, 0);
        assert!(drms(&[], &[]).value.is_nan());
    }

    #[test]
    fn law_drms_includes_a_constant_offset_and_excludes_nan() {
        let figure = drms(&[3.0, 3.0, f64::NAN], &[4.0, 4.0, 0.0]);
        assert_eq!(figure, SampleStatistic { value: 5.0, n: 2 });
    }

    #[test]
    fn law_a_least_squares_offset_reaches_the_bound() {
        let n = 400;
        let north: Vec<f64> = (0..n).map(|k| 0.03 * (0.11 * f64::from(k)).sin()).collect();
        let east: Vec<f64> = (0..n).map(|k| 0.02 * (0.07 * f64::from(k)).cos() + 0.01).collect();
        let bound = offset_bound(&north, &east, 5.0);
        let design = nalgebra::DMatrix::from_fn(n as usize, 3, |k, j| [north[k], east[k], 1.0][j]);
        let covariance = (design.transpose() * &design).try_inverse().unwrap() * 25.0;
        let drms = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
        assert!((bound.value / drms - 1.0).abs() < 1e-10, "{bound:?} {drms}");
        assert_eq!(bound.n, 400);
        // Neither a constant slope nor slopes along one direction determine an offset.
        assert!(offset_bound(&[0.1; 9], &[0.2; 9], 5.0).value.is_nan());
        assert!(offset_bound(&north, &north, 5.0).value.is_nan());
    }

    #[test]
    fn law_a_straight_line_less_itself_is_zero() {
        let t: Vec<f64> = (0..9).map(|k| 54_000.0 + 0.1 * f64::from(k)).collect();
        let mut x: Vec<f64> = t.iter().map(|t| 3.0 * t - 7.0).collect();
        x[4] = f64::NAN;
        for (k, left) in less_straight_line(&t, &x).iter().enumerate() {
            // The limit exceeds the rounding errors of values of 1.6e5.
            assert!(if k == 4 { left.is_nan() } else { left.abs() < 1e-9 }, "{k} {left}");
        }
        assert_eq!(less_straight_line(&t[..1], &x[..1]), x[..1]);
    }

    #[test]
    fn law_ratios_scale_with_the_signals_and_ignore_offsets() {
        let x: Vec<f64> = (0..50).map(|k| (f64::from(k) * 0.7).sin()).collect();
        let quieter: Vec<f64> = x.iter().map(|x| 7.0 - 0.125 * x).collect();
        assert!((improvement_ratio(&x, &quieter).value - 8.0).abs() < 1e-12);
        let estimate: Vec<f64> = x.iter().map(|x| x * 1.25 + 3.0).collect();
        assert!((signal_to_noise(&estimate, &x, &x).value - 4.0).abs() < 1e-12);
        // A ramp added to the anomaly in both estimate and truth is not signal.
        let ramp = |x: &[f64]| x.iter().enumerate().map(|(k, x)| x + 50.0 * k as f64).collect::<Vec<f64>>();
        assert!((signal_to_noise(&ramp(&estimate), &ramp(&x), &x).value - 4.0).abs() < 1e-9);
        let mut gap = quieter.clone();
        gap[7] = f64::NAN;
        assert_eq!(improvement_ratio(&x, &gap).n, 49);
        let s = error_summary(&estimate, &x);
        assert!((s.mean - (3.0 + 0.25 * mean(&x).value)).abs() < 1e-14);
    }
}

//! Measurements of the smoother, thinned to limit the size of their covariance matrix.

use super::likelihood::SlamMeasurement;
use crate::navigation::slam::kernel::AnomalyKernel;
use crate::navigation::slam::samples::SlamSample;

/// Samples within this fraction of the kernel length from the middle of their group are averaged. Within this distance,
/// the field is linear to about a thousandth of its standard deviation.
const AVERAGED: f64 = 0.05;

/// Averages neighbouring samples, in time order, to at most `most` measurements, each with the mean displacement
/// according to the filter, in metres.
///
/// If there are more samples, they are divided into groups whose sizes differ by at most one. In each group the samples
/// near the middle are averaged and the others are skipped, because a mean over a longer stretch would smooth the
/// field.
pub fn thinned(
    samples: &[(SlamSample, [f64; 2])],
    kernel: &AnomalyKernel,
    most: usize,
) -> Vec<(SlamMeasurement, [f64; 2])> {
    let alt_m = samples.iter().map(|(sample, _)| sample.alt_m).sum::<f64>() / samples.len().max(1) as f64;
    let (all, groups) = (samples.len(), samples.len().min(most));
    let group = |k: usize| &samples[k * all / groups..(k + 1) * all / groups];
    (0..groups).filter_map(|k| mean(near_middle(group(k), AVERAGED * kernel.length_m), kernel, alt_m)).collect()
}

/// Samples of a group near its middle sample.
fn near_middle(group: &[(SlamSample, [f64; 2])], within_m: f64) -> &[(SlamSample, [f64; 2])] {
    let middle = group.len() / 2;
    let Some((at, _)) = group.get(middle) else { return group };
    let is_near = |(sample, _): &&(SlamSample, [f64; 2])| {
        (sample.at_m[0] - at.at_m[0]).hypot(sample.at_m[1] - at.at_m[1]) <= within_m
    };
    let before = group[..middle].iter().rev().take_while(is_near).count();
    let after = group[middle + 1..].iter().take_while(is_near).count();
    &group[middle - before..=middle + after]
}

/// Mean of samples weighted by their inverse variances.
fn mean(samples: &[(SlamSample, [f64; 2])], kernel: &AnomalyKernel, alt_m: f64) -> Option<(SlamMeasurement, [f64; 2])> {
    let mut weights = 0.0;
    let mut sums = [0.0; 9];
    for (sample, moved) in samples {
        let weight = 1.0 / sample.variance_nt2;
        let [north, east] = sample.at_m;
        let [slope_n, slope_e] = sample.core_nt_per_m;
        // Times are relative to the first time, to preserve precision.
        let of = [sample.tt_s - samples[0].0.tt_s, north, east, sample.alt_m, sample.value_nt, slope_n, slope_e];
        for (sum, value) in sums.iter_mut().zip(of.into_iter().chain(*moved)) {
            *sum += weight * value;
        }
        weights += weight;
    }
    let (first, _) = samples.first()?;
    // The comparison is also false for NaN.
    let sound = weights > 0.0 && weights.is_finite();
    if !sound {
        return None;
    }
    let [time, north, east, height_m, value_nt, slope_n, slope_e, moved_n, moved_e] = sums.map(|sum| sum / weights);
    let measured = SlamMeasurement {
        tt_s: first.tt_s + time,
        at_m: [north, east],
        value_nt,
        variance_nt2: 1.0 / weights + kernel.height_nt2(height_m - alt_m),
        core_nt_per_m: [slope_n, slope_e],
    };
    Some((measured, [moved_n, moved_e]))
}

//! Evenly spaced over-represented values of a sensor.
//!
//! On all flights of a real drone, a third of the samples of the scalar magnetometers lie close to evenly spaced
//! values, so the histogram has sharp peaks [van der Meer 2025, section 3.2.4, figures 3.7 to 3.9]. This is not
//! quantisation, because the other samples lie between these values. The check looks for evenly spaced peaks of the
//! histogram.

use std::ops::Range;

use numerics::regression::statistics::median;

/// Over-represented values of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreferredValues {
    /// The spacing of the values.
    pub step: f64,
    /// Number of samples at over-represented values, minus the number expected without over-representation.
    pub samples: usize,
}

/// Numbers of bins of the histograms, as exponents of two, and minimum mean number of samples per bin. Several numbers
/// of bins are tried, because a peak must be narrower than a few bins and have enough samples.
const BINS: Range<u32> = 7..15;
const LEAST_A_BIN: f64 = 4.0;
/// Minimum ratio of a peak to the median of the bins around it. Number of bins on either side that determine this
/// median. Minimum number of samples of a peak.
const HIGHER: f64 = 4.0;
const AROUND: usize = 12;
const LEAST: f64 = 8.0;
/// Maximum width of a peak, and minimum distance between peaks, in bins.
const WIDEST: usize = 3;
const CLOSEST: f64 = 4.0;
/// Minimum number of peaks. Minimum share of occupied multiples of the spacing between the first and the last peak.
/// Maximum root mean square distance from these multiples, in spacings; it is 0.29 for arbitrary values.
const PEAKS: usize = 10;
const FILLED: f64 = 0.5;
const OFF: f64 = 0.08;
/// Minimum share of the samples.
const SHARE: f64 = 0.05;

/// The evenly spaced over-represented values of a column; `None` if no values are over-represented. `values` must be
/// finite.
pub fn preferred(values: &[f64]) -> Option<PreferredValues> {
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
    if high <= low {
        return None;
    }
    let sizes = BINS.map(|bits| 1_usize << bits).filter(|bins| values.len() as f64 >= LEAST_A_BIN * *bins as f64);
    let found = sizes.filter_map(|bins| of_bins(values, low, (high - low) / bins as f64, bins));
    found.max_by_key(|p| p.samples)
}

fn of_bins(values: &[f64], low: f64, width: f64, bins: usize) -> Option<PreferredValues> {
    let mut histogram = vec![(0.0_f64, 0.0_f64); bins];
    for x in values {
        if let Some((count, sum)) = histogram.get_mut((((x - low) / width) as usize).min(bins - 1)) {
            *count += 1.0;
            *sum += x - low;
        }
    }
    let usual: Vec<f64> = (0..bins)
        .map(|i| {
            let around = histogram.iter().take(i + AROUND + 1).skip(i.saturating_sub(AROUND));
            median(&mut around.map(|bin| bin.0).collect::<Vec<f64>>())
        })
        .collect();
    let is_high = |i: usize| histogram[i].0 >= LEAST && histogram[i].0 >= HIGHER * (usual[i] + 1.0);
    let mut peaks: Vec<Range<usize>> = vec![];
    for i in (0..bins).filter(|i| is_high(*i)) {
        match peaks.last_mut() {
            Some(peak) if peak.end == i => peak.end = i + 1,
            _ => peaks.push(i..i + 1),
        }
    }
    peaks.retain(|peak| peak.len() <= WIDEST);
    if peaks.len() < PEAKS {
        return None;
    }
    let of_peak = |peak: &Range<usize>| {
        let bins = histogram.get(peak.clone()).unwrap_or_default();
        let (count, sum) = bins.iter().fold((0.0, 0.0), |(n, s), bin| (n + bin.0, s + bin.1));
        (sum / count, count - usual.get(peak.clone()).unwrap_or_default().iter().sum::<f64>())
    };
    let (centres, excess): (Vec<f64>, Vec<f64>) = peaks.iter().map(of_peak).unzip();
    let samples = excess.iter().sum::<f64>();
    let step = spacing(&centres).filter(|step| *step >= CLOSEST * width)?;
    (samples >= SHARE * values.len() as f64).then_some(PreferredValues { step, samples: samples as usize })
}

/// The spacing of evenly spaced centres, of which some may be missing.
fn spacing(centres: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = centres.windows(2).map(|w| w[1] - w[0]).collect();
    let sorted = {
        steps.sort_by(f64::total_cmp);
        steps
    };
    let candidates = [0.1, 0.25, 0.5].map(|part| sorted.get((part * sorted.len() as f64) as usize).copied());
    candidates.into_iter().flatten().find_map(|guess| {
        let mut step = guess;
        for _ in 0..3 {
            // The multiple of each centre is counted from the multiple of the adjacent centre, so that errors do not
            // accumulate.
            let mut number = 0.0;
            let numbers: Vec<f64> = std::iter::once(0.0)
                .chain(centres.windows(2).map(|w| {
                    number += ((w[1] - w[0]) / step).round().max(1.0);
                    number
                }))
                .collect();
            let (slope, off) = line_through(&numbers, centres);
            if centres.len() as f64 >= FILLED * (number + 1.0) && off <= OFF * slope {
                return Some(slope);
            }
            step = slope;
        }
        None
    })
}

/// Slope of the best-fitting line through points, and the root mean square of the residual.
fn line_through(x: &[f64], y: &[f64]) -> (f64, f64) {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let sums =
        x.iter().zip(y).fold((0.0, 0.0), |(xx, xy), (x, y)| (xx + (x - mx) * (x - mx), xy + (x - mx) * (y - my)));
    let slope = sums.1 / sums.0;
    let left = x.iter().zip(y).map(|(x, y)| (y - my - slope * (x - mx)).powi(2)).sum::<f64>();
    (slope, (left / n).sqrt())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use numerics::random::NormalGenerator;

    use super::*;

    /// A field along a flight, in nT, with noise.
    fn field(normals: &mut NormalGenerator, k: usize) -> f64 {
        let t = k as f64 * 0.01;
        48_600.0 + 60.0 * (0.11 * t).sin() + 25.0 * (0.53 * t).cos() + 4.0 * (3.1 * t).sin() + 0.1 * normals.draw()
    }

    #[test]
    fn unit_evenly_spaced_values_of_a_third_of_the_samples_are_found() {
        let mut normals = NormalGenerator::new(11);
        for step in [2.0, 3.7] {
            // A third of all samples are near a preferred value; for these, the sensor gives that value plus some
            // noise.
            let stuck = |x: f64, noise: f64| {
                let near = (x / step).round() * step;
                if (x - near).abs() < step / 6.0 { near + 0.01 * noise } else { x }
            };
            let values: Vec<f64> = (0..60_000)
                .map(|k| {
                    let x = field(&mut normals, k);
                    stuck(x, normals.draw())
                })
                .collect();
            let found = preferred(&values).unwrap();
            assert!((found.step / step - 1.0).abs() < 0.005, "{found:?} {step}");
            let share = found.samples as f64 / 60_000.0;
            assert!((share - 1.0 / 3.0).abs() < 0.06, "{found:?}");
        }
    }

    #[test]
    fn unit_a_sensor_without_preferred_values_has_none() {
        let mut normals = NormalGenerator::new(13);
        let values: Vec<f64> = (0..60_000).map(|k| field(&mut normals, k)).collect();
        assert_eq!(preferred(&values), None);
        // Each line is at one level, so the values cluster at a few levels that are not evenly spaced.
        let levels = [0.0, 11.0, 27.0, 31.0, 52.0, 58.0, 83.0, 90.0, 104.0, 131.0, 139.0, 160.0, 171.0, 199.0];
        let still: Vec<f64> = (0..56_000).map(|k| levels[k / 4000] + 0.2 * normals.draw()).collect();
        assert_eq!(preferred(&still), None);
        assert_eq!(preferred(&[7.0; 5000]), None);
        assert_eq!(preferred(&[]), None);
    }
}

//! Isolated outliers of single samples, detected by their fourth differences.

use numerics::regression::statistics::median;

use super::quantisation::ValueResolution;

/// The spikes of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spikes {
    /// Number of spikes.
    pub samples: usize,
    /// The row of the first spike.
    pub first: usize,
    /// The height of the largest spike: a sixth of the fourth difference at the spike.
    pub largest: f64,
}

/// Threshold of a spike in robust standard deviations of the fourth difference. Normally distributed noise exceeds this
/// limit once in 10^15 samples.
const SIGMAS: f64 = 8.0;
/// Number of surrounding samples that determine the scale, so that a manoeuvre is not a spike.
const BLOCK: usize = 64;

/// The spikes of a column from its fourth differences; `None` if there are no spikes. A deviation below the
/// quantisation step is not a spike.
pub fn spikes(fourth: &[f64], resolution: &ValueResolution) -> Option<Spikes> {
    let found = peaks(fourth, resolution);
    let largest = found.iter().map(|(_, height)| *height).fold(0.0, f64::max);
    found.first().map(|(first, _)| Spikes { samples: found.len(), first: *first, largest })
}

/// Row and height of each spike.
pub fn peaks(fourth: &[f64], resolution: &ValueResolution) -> Vec<(usize, f64)> {
    let scale = |part: &[f64]| {
        let mut sizes: Vec<f64> = part.iter().filter(|d| d.is_finite()).map(|d| d.abs()).collect();
        if sizes.is_empty() { 0.0 } else { 1.4826 * median(&mut sizes) }
    };
    let shown = scale(fourth);
    if shown <= resolution.rounding() {
        return vec![];
    }
    let all = shown.max(resolution.fourth_difference_sigma());
    let blocks: Vec<f64> = fourth.chunks(BLOCK).map(scale).collect();
    let around = |block: usize| {
        let from = block.saturating_sub(1);
        blocks.iter().skip(from).take(block + 2 - from).fold(all, |a, b| a.max(*b))
    };
    let mut found = vec![];
    for (i, d) in fourth.iter().enumerate() {
        let size = d.abs();
        if size.is_nan() || size <= SIGMAS * around(i / BLOCK) {
            continue;
        }
        // At the neighbours of a spike, the fourth difference is four sixths of the difference at the spike.
        let near = fourth.iter().skip(i.saturating_sub(2)).take(5.min(i + 3));
        let is_peak = near.filter(|n| n.is_finite()).all(|n| n.abs() <= size);
        if is_peak {
            found.push((i, size / 6.0));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{super::noise::fourth_differences, *};

    fn detect(x: &[f64]) -> Option<Spikes> {
        let resolution = ValueResolution::new(x, super::super::quantisation::step(x));
        spikes(&fourth_differences(x, &vec![false; x.len()]), &resolution)
    }

    /// Noise of some pseudo-random pattern.
    fn wave(i: usize) -> f64 {
        (i as f64 * 1.7).sin() + (i as f64 * 2.9 + 0.3).cos() * 0.7
    }

    #[test]
    fn unit_each_spike_is_found_once_with_its_height() {
        let mut x: Vec<f64> = (0..2000).map(wave).collect();
        assert_eq!(detect(&x), None);
        x[500] += 400.0;
        x[1200] -= 1000.0;
        let found = detect(&x).unwrap();
        assert_eq!((found.samples, found.first), (2, 500));
        assert!((found.largest / 1000.0 - 1.0).abs() < 0.02, "{found:?}");
    }

    #[test]
    fn unit_the_steps_of_a_smooth_column_are_no_spikes() {
        // Variation of the earth's field at 10 Hz with a step of 0.01 nT: slow, and then fast enough that most samples
        // differ.
        for period_s in [43_200.0, 7200.0, 600.0, 60.0] {
            let variation = |i: usize| 20.0 * (std::f64::consts::TAU * i as f64 / (10.0 * period_s)).sin();
            let mut x: Vec<f64> = (0..36_000).map(|i| (variation(i) * 100.0).round() / 100.0).collect();
            assert_eq!(detect(&x), None, "{period_s}");
            x[20_000] += 5.0;
            let shows = period_s < 1000.0;
            assert_eq!(detect(&x).map(|s| (s.samples, s.first)), shows.then_some((1, 20_000)), "{period_s}");
        }
    }

    #[test]
    fn unit_a_manoeuvre_is_no_spike() {
        let x: Vec<f64> = (0..2000).map(|i| wave(i) * if (900..1100).contains(&i) { 60.0 } else { 1.0 }).collect();
        let found = detect(&x);
        assert!(found.is_none(), "{found:?}");
        assert_eq!(detect(&[1.0; 100]), None);
        assert_eq!(detect(&[]), None);
    }
}

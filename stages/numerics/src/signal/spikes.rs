//! Spikes: samples that contradict the signal around them.
//!
//! Both searches process one run of finite samples and return a flag per sample; the caller decides how to treat the
//! spikes. Their noise estimate is robust, 1.4826 times the median absolute deviation, and at least one step of the
//! quantisation. The step of the quantisation is the smallest difference between neighbours that exceeds the rounding
//! error. Changes of the last digit of a quiet sensor are therefore not flagged as spikes. In a column with held,
//! interpolated or coarse values, more than half of the deviations in a run may be mere rounding errors. The median is
//! then computed from the other samples. Steps and corners of such a column are therefore not flagged, but larger
//! deviations are. In a run that is constant except for its spikes, the noise cannot be estimated, and no spikes are
//! found.

use crate::regression::statistics::median;

/// Ratio of the standard deviation to the median absolute deviation for normally distributed values, 1/0.67449.
const SIGMA_OF_MAD: f64 = 1.482_602_218_505_602;

/// The variance of the fourth difference of white noise of variance 1: 1 + 16 + 36 + 16 + 1.
const FOURTH_DIFFERENCE_GAIN: f64 = 70.0;

/// Upper bound of the rounding error of a fourth difference in double precision, for values of magnitude 1. The
/// magnitudes of the coefficients of a fourth difference add up to 16.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Maximum number of passes of the fourth difference.
const MOST_PASSES: usize = 20;

/// Flags the samples of `x` that deviate from the median of their window, `half` samples to either side, by more than
/// `threshold` times the noise. The noise is the largest of three values: the noise of the window, the noise of the
/// whole run about its running median, and the quantisation. At the ends the window is truncated. Returns one entry per
/// sample. [Hampel 1974, "The influence curve and its role in robust estimation", J. Am. Stat. Assoc. 69; Pearson 2002,
/// "Outliers in process modeling and identification", IEEE Trans. Control Systems Technology 10(1)]
///
/// Groups of up to `half` neighbouring spikes are detected. `x` must be finite; a run of fewer than 3 samples has no
/// spikes.
pub fn hampel(x: &[f64], half: usize, threshold: f64) -> Vec<bool> {
    if x.len() < 3 || half == 0 {
        return vec![false; x.len()];
    }
    let mut window: Vec<f64> = Vec::with_capacity(2 * half + 1);
    let (off, noise): (Vec<f64>, Vec<f64>) = (0..x.len())
        .map(|i| {
            let around = &x[i.saturating_sub(half)..(i + half + 1).min(x.len())];
            window.clear();
            window.extend_from_slice(around);
            let middle = median(&mut window);
            window.iter_mut().for_each(|x| *x = (*x - middle).abs());
            (x[i] - middle, SIGMA_OF_MAD * median(&mut window))
        })
        .unzip();
    let sizes: Vec<f64> = off.iter().map(|x| x.abs()).collect();
    let least = noise_of_run(x, &sizes, |_| true);
    off.iter().zip(&noise).map(|(off, noise)| off.abs() > threshold * noise.max(least)).collect()
}

/// Flags single samples of `x` by their fourth difference, divided by √70 so that its noise is the noise of `x`. The
/// magnitude of this quotient must exceed `threshold` times its noise, and must not be less than the magnitudes at the
/// two samples to either side.
///
/// At a single sample with an error of `a` the quotient is 6 a/√70 = 0.72 a; for a smooth signal it is almost 0. A
/// detected sample is replaced by the value of the cubic through its neighbours, and the search is repeated until no
/// spike remains. Two neighbouring samples with a common error cannot be distinguished from their neighbours: use
/// [`hampel`]. `x` must be finite and evenly sampled; the first and last two samples are not tested. Returns one entry
/// per sample. [Reeves 1993, "Practical aeromagnetic surveys", on the fourth difference as a measure of noise]
pub fn fourth_difference(x: &[f64], threshold: f64) -> Vec<bool> {
    let mut found = vec![false; x.len()];
    if x.len() < 5 {
        return found;
    }
    let mut x = x.to_vec();
    let mut sizes = fourth_differences(&x);
    // A corner of the signal also appears in the adjacent differences, but the difference at the corner itself is the
    // largest.
    let least = noise_of_run(&x, &sizes, |i| is_peak(&sizes, i));
    for _ in 0..MOST_PASSES {
        let above = |i: &usize| sizes[*i] > threshold * least && is_peak(&sizes, *i);
        let spikes: Vec<usize> = (0..sizes.len()).filter(above).map(|i| i + 2).collect();
        if spikes.is_empty() {
            break;
        }
        for i in spikes {
            found[i] = true;
            x[i] += (-x[i - 2] + 4.0 * x[i - 1] - 6.0 * x[i] + 4.0 * x[i + 1] - x[i + 2]) / 6.0;
        }
        sizes = fourth_differences(&x);
    }
    found
}

/// Absolute fourth difference over √70 at each sample except the first and last two.
fn fourth_differences(x: &[f64]) -> Vec<f64> {
    let of = |w: &[f64]| ((w[0] + w[4]) - 4.0 * (w[1] + w[3]) + 6.0 * w[2]).abs() / FOURTH_DIFFERENCE_GAIN.sqrt();
    x.windows(5).map(of).collect()
}

/// Whether the difference at `i` is at least as large as those at the two samples to either side.
fn is_peak(sizes: &[f64], i: usize) -> bool {
    sizes[i.saturating_sub(2)..(i + 3).min(sizes.len())].iter().all(|other| *other <= sizes[i])
}

/// Noise of a run, from its deviations. If most deviations are rounding errors, only rows for which `counts` is true
/// are used.
fn noise_of_run(x: &[f64], sizes: &[f64], counts: impl Fn(usize) -> bool) -> f64 {
    // The rounding error is computed from the median magnitude, because the largest value may be a spike.
    let rounding = ROUNDING * median(&mut x.iter().map(|x| x.abs()).collect::<Vec<_>>());
    let steps = x.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > rounding);
    let quantisation = steps.min_by(f64::total_cmp).unwrap_or(rounding);
    let mut middle = median(&mut sizes.to_vec());
    if middle <= rounding {
        let more = |i: &usize| sizes[*i] > rounding && counts(*i);
        let mut others: Vec<f64> = (0..sizes.len()).filter(more).map(|i| sizes[i]).collect();
        middle = if others.is_empty() { 0.0 } else { median(&mut others) };
    }
    (SIGMA_OF_MAD * middle).max(quantisation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{random::NormalGenerator, reference_csv::columns};

    fn places(found: &[bool]) -> Vec<usize> {
        found.iter().enumerate().filter(|(_, f)| **f).map(|(i, _)| i).collect()
    }

    /// A field with a slope, a wave and noise of 0.05 nT.
    fn field(rows: usize) -> Vec<f64> {
        let mut normals = NormalGenerator::new(5);
        (0..rows).map(|k| 50_000.0 + 0.3 * k as f64 + 20.0 * (0.05 * k as f64).sin() + 0.05 * normals.draw()).collect()
    }

    #[test]
    fn val_the_running_median_finds_the_same_spikes_as_numpy() {
        let table = columns(include_str!("../../reference/signal/hampel.csv"));
        for (name, half, threshold) in [("spike_5_3", 5, 3.0), ("spike_2_6", 2, 6.0)] {
            let expected: Vec<bool> = table[name].iter().map(|flag| *flag == 1.0).collect();
            assert!(expected.iter().filter(|x| **x).count() > 3, "the reference has spikes");
            assert_eq!(places(&hampel(&table["x"], half, threshold)), places(&expected), "{name}");
        }
    }

    #[test]
    fn unit_inserted_spikes_are_found_and_nothing_else() {
        let clean = field(2000);
        assert!(!hampel(&clean, 5, 8.0).contains(&true));
        assert!(!fourth_difference(&clean, 8.0).contains(&true));
        let mut x = clean.clone();
        let at = [100, 103, 700, 1500, 1990];
        at.iter().zip([4.0, -3.0, 50.0, -2.5, 900.0]).for_each(|(i, a)| x[*i] += a);
        assert_eq!(places(&fourth_difference(&x, 8.0)), at);
        assert_eq!(places(&hampel(&x, 5, 12.0)), [700, 1990], "a slope widens the window's own deviation");
        // Four adjacent samples.
        (900..904).for_each(|i| x[i] += 300.0);
        assert_eq!(places(&hampel(&x, 7, 12.0)), [700, 900, 901, 902, 903, 1990]);
    }

    #[test]
    fn unit_the_last_digit_of_a_quiet_sensor_and_a_constant_are_not_spikes() {
        let mut x = vec![50_000.0; 400];
        assert!(places(&hampel(&x, 5, 3.0)).is_empty() && places(&fourth_difference(&x, 3.0)).is_empty());
        (0..400).filter(|k| k % 37 == 0).for_each(|k| x[k] += 0.01);
        assert!(places(&hampel(&x, 5, 3.0)).is_empty(), "{:?}", places(&hampel(&x, 5, 3.0)));
        assert!(places(&fourth_difference(&x, 3.0)).is_empty());
        x[200] += 1.0;
        assert_eq!((places(&hampel(&x, 5, 3.0)), places(&fourth_difference(&x, 3.0))), (vec![200], vec![200]));
    }

    /// A record in hundredths of a nanotesla, with one value per `every` samples and straight lines in between.
    fn interpolated(every: usize, rows: usize) -> Vec<f64> {
        let mut normals = NormalGenerator::new(9);
        let knots: Vec<f64> = (0..rows / every + 2)
            .scan(50_000.0, |x, _| {
                *x += normals.draw();
                Some((*x * 100.0_f64).round() / 100.0)
            })
            .collect();
        (0..rows)
            .map(|i| {
                let (k, part) = (i / every, (i % every) as f64 / every as f64);
                knots[k] + (knots[k + 1] - knots[k]) * part
            })
            .collect()
    }

    #[test]
    fn unit_the_corners_of_an_interpolated_column_are_not_spikes() {
        for every in [7, 10, 50, 600] {
            let mut x = interpolated(every, 20_000);
            assert!(places(&fourth_difference(&x, 6.0)).is_empty(), "{every}");
            assert!(places(&hampel(&x, 5, 6.0)).is_empty(), "{every}");
            for spike in [100.0, 1e30] {
                x[7777] = x[7776] + spike;
                assert_eq!(places(&fourth_difference(&x, 6.0)), [7777], "{every}, {spike}");
                assert_eq!(places(&hampel(&x, 5, 6.0)), [7777], "{every}, {spike}");
            }
        }
    }

    #[test]
    fn unit_the_last_digit_between_two_samples_is_not_a_spike() {
        // A quiet sensor with a resolution of 0.01 nT at 160 Hz, resampled to the times of another clock: a change of
        // the last digit may be divided between two samples in any proportion.
        let quiet = |i: usize| 50_000.0 + if i.is_multiple_of(37) { 0.01 } else { 0.0 };
        let mut x: Vec<f64> = (0..4000)
            .map(|i| {
                let at = i as f64 * 1.003;
                let part = at.fract();
                quiet(at as usize) * (1.0 - part) + quiet(at as usize + 1) * part
            })
            .collect();
        assert!(places(&hampel(&x, 5, 6.0)).is_empty() && places(&fourth_difference(&x, 6.0)).is_empty());
        x[2000] += 1.0;
        assert_eq!((places(&hampel(&x, 5, 6.0)), places(&fourth_difference(&x, 6.0))), (vec![2000], vec![2000]));
    }

    #[test]
    fn unit_a_short_run_has_no_spikes() {
        for rows in 0..5 {
            let x = vec![1.0; rows];
            assert_eq!((hampel(&x, 5, 3.0).len(), fourth_difference(&x, 3.0).len()), (rows, rows));
        }
        assert_eq!(places(&hampel(&[1.0, 2.0, 900.0, 2.0, 1.0], 5, 3.0)), [2]);
    }
}

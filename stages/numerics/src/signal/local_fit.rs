//! Smoothing by local parabolas of samples at arbitrary times.

use nalgebra::{Matrix3, Vector3};

/// `values` smoothed at their times `tt_s` (s, ascending, evenly spaced or not), in the same unit. The result at each
/// sample is the value of the parabola fitted by least squares to the samples within half of `window_s`. The weights
/// are (1 - |u|³)³, where u is the distance in time divided by half of the window. Values on a parabola are unchanged.
/// Samples are also unchanged for a window of 0, and if there are fewer than three other samples in the window.
/// [Cleveland 1979; Fan & Gijbels 1996, chapter 3]
///
/// A value that is not finite makes all results within its window NaN.
pub fn smoothed(tt_s: &[f64], values: &[f64], window_s: f64) -> Vec<f64> {
    let n = tt_s.len().min(values.len());
    let half_s = 0.5 * window_s;
    let (mut first, mut end) = (0, 0);
    let one = |i: usize| {
        while tt_s[i] - tt_s[first] >= half_s && first < i {
            first += 1;
        }
        end = end.max(i + 1);
        while end < n && tt_s[end] - tt_s[i] < half_s {
            end += 1;
        }
        if end - first < 4 { values[i] } else { parabola(tt_s, values, first..end, i, half_s) }
    };
    (0..n).map(one).collect()
}

/// Value at the sample `i` of the parabola through the samples `window`, at least four.
fn parabola(tt_s: &[f64], values: &[f64], window: std::ops::Range<usize>, i: usize, half_s: f64) -> f64 {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for k in window {
        let u = (tt_s[k] - tt_s[i]) / half_s;
        let terms = Vector3::new(1.0, u, u * u);
        let weight = (1.0 - u.abs().powi(3)).powi(3);
        normal += weight * terms * terms.transpose();
        // Values are relative to the sample itself, to preserve small changes of a large value.
        right += weight * (values[k] - values[i]) * terms;
    }
    // If too many weights are near 0, the parabola is undetermined.
    let solved = normal.cholesky().map(|factor| factor.solve(&right).x);
    values[i] + solved.filter(|x| !x.is_infinite()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::NormalGenerator;

    fn uneven(n: u32) -> Vec<f64> {
        (0..n).map(|k| 50_000.0 + 0.1 * f64::from(k) + 0.03 * (1.7 * f64::from(k)).sin()).collect()
    }

    #[test]
    fn law_a_parabola_at_uneven_times_is_unchanged() {
        let tt = uneven(200);
        let x: Vec<f64> = tt.iter().map(|t| 45.0 + 1e-3 * (t - 50_005.0) - 2e-5 * (t - 50_005.0).powi(2)).collect();
        for window_s in [0.0, 0.15, 1.0, 5.0, 1000.0] {
            for (x, y) in x.iter().zip(smoothed(&tt, &x, window_s)) {
                // The rounding error of 45 is 7e-15; normal equations with a condition number of 1e4 amplify it.
                assert!((x - y).abs() < 1e-11, "{window_s}: {x} {y}");
            }
        }
    }

    #[test]
    fn law_white_noise_is_reduced_as_by_the_equivalent_kernel() {
        let (tt, mut normals) = ((0..20_000).map(|k| 0.1 * f64::from(k)).collect::<Vec<_>>(), NormalGenerator::new(4));
        let x: Vec<f64> = tt.iter().map(|_| normals.draw()).collect();
        let y = smoothed(&tt, &x, 4.0);
        let inside = &y[100..19_900];
        let variance = inside.iter().map(|y| y * y).sum::<f64>() / inside.len() as f64;
        // The equivalent kernel of a local parabola, on the grid of 39 weights: w (m4 - m2 u²)/(m0 m4 - m2²).
        let us: Vec<f64> = (-19..=19).map(|k| f64::from(k) / 20.0).collect();
        let weight = |u: f64| (1.0 - u.abs().powi(3)).powi(3);
        let moment = |p: i32| us.iter().map(|u| weight(*u) * u.powi(p)).sum::<f64>();
        let (m0, m2, m4) = (moment(0), moment(2), moment(4));
        let kernel = |u: f64| weight(u) * (m4 - m2 * u * u) / (m0 * m4 - m2 * m2);
        let expected: f64 = us.iter().map(|u| kernel(*u).powi(2)).sum();
        // About 1000 of the 19,800 samples are independent, so one standard deviation is 4.5 %.
        assert!((variance / expected - 1.0).abs() < 0.15, "{variance} {expected}");
    }

    #[test]
    fn unit_few_samples_are_unchanged_and_a_missing_one_stays_in_its_window() {
        assert_eq!(smoothed(&[0.0, 1.0, 2.0], &[1.0, 5.0, 2.0], 100.0), [1.0, 5.0, 2.0]);
        assert_eq!(smoothed(&[3.0], &[1.0], 2.0), [1.0]);
        assert!(smoothed(&[], &[], 2.0).is_empty());
        let tt: Vec<f64> = (0..40).map(f64::from).collect();
        let mut x = vec![1.0; 40];
        x[20] = f64::NAN;
        let y = smoothed(&tt, &x, 6.0);
        let missing: Vec<usize> = (0..40).filter(|k| y[*k].is_nan()).collect();
        assert_eq!(missing, [18, 19, 20, 21, 22]);
        assert!(y.iter().all(|y| y.is_nan() || (y - 1.0).abs() < 1e-12));
    }
}

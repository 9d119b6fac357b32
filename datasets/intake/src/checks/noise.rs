//! The noise floor of a column, from its fourth differences.
//!
//! The fourth difference `x[i-2] - 4 x[i-1] + 6 x[i] - 4 x[i+1] + x[i+2]` of a cubic is 0. For white noise, the
//! variance of the fourth difference is 1 + 16 + 36 + 16 + 1 = 70 times the variance of the noise. Surveyors judge a
//! magnetometer by this difference divided by 16. [Reeves 2005, Aeromagnetic Surveys, section 3; Coyle et al. 2014, GSC
//! Open File 7617]

use numerics::regression::statistics::median;

use super::quantisation::ValueResolution;

/// The fourth difference centred at each row; NaN at the ends, at missing values and across gaps. `breaks` marks the
/// rows that follow a gap.
pub fn fourth_differences(x: &[f64], breaks: &[bool]) -> Vec<f64> {
    let one = |i: usize| {
        let (Some(w), Some(gaps)) =
            (i.checked_sub(2).and_then(|from| x.get(from..i + 3)), breaks.get(i.saturating_sub(1)..i + 3))
        else {
            return f64::NAN;
        };
        if gaps.iter().any(|b| *b) {
            return f64::NAN;
        }
        w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4]
    };
    (0..x.len()).map(one).collect()
}

/// Minimum number of fourth differences for an estimate.
const LEAST: usize = 20;

/// Standard deviation of the white noise of a column from its fourth differences, robust against spikes and short
/// manoeuvres. `None` if there are too few differences, or most differences are 0 within rounding: the values are held,
/// interpolated, or too coarse to show their noise.
pub fn noise(fourth: &[f64], resolution: &ValueResolution) -> Option<f64> {
    let mut sizes: Vec<f64> = fourth.iter().filter(|d| d.is_finite()).map(|d| d.abs()).collect();
    if sizes.len() < LEAST {
        return None;
    }
    let middle = median(&mut sizes);
    (middle > resolution.rounding()).then(|| 1.4826 * middle / 70.0_f64.sqrt())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// An approximately normal deviate: the sum of twelve uniform deviates.
    fn normal(state: &mut u64) -> f64 {
        let mut even = || {
            *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (*state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| even()).sum::<f64>() - 6.0
    }

    #[test]
    fn law_white_noise_on_a_cubic_is_found_despite_spikes() {
        let mut state = 1;
        let mut x: Vec<f64> = (0..20_000)
            .map(|i| {
                let t = f64::from(i) / 1000.0;
                50_000.0 + 3.0 * t - 0.5 * t * t + 0.01 * t * t * t + 0.2 * normal(&mut state)
            })
            .collect();
        let no_gaps = vec![false; x.len()];
        let resolution = ValueResolution::new(&x, None);
        let found = noise(&fourth_differences(&x, &no_gaps), &resolution).unwrap();
        // The tolerance for a median of 20,000 correlated values is 2 %.
        assert!((found / 0.2 - 1.0).abs() < 0.03, "{found}");
        (0..x.len()).step_by(100).for_each(|i| x[i] += 500.0);
        let spiky = noise(&fourth_differences(&x, &no_gaps), &resolution).unwrap();
        assert!((spiky / 0.2 - 1.0).abs() < 0.12, "{spiky}");
    }

    #[test]
    fn unit_held_and_interpolated_values_have_no_noise() {
        let hundredths = |x: f64| (2000.0 * x.sin()).round() / 100.0;
        let held: Vec<f64> = (0..36_000).map(|i| hundredths(f64::from(i) / 70_000.0)).collect();
        let between = |i: i32| {
            let (from, part) = (f64::from(i / 10), f64::from(i % 10) / 10.0);
            let [before, after] = [from, from + 1.0].map(|second| hundredths(second / 700.0));
            before + part * (after - before)
        };
        let interpolated: Vec<f64> = (0..36_000).map(between).collect();
        for x in [held, interpolated] {
            let fourth = fourth_differences(&x, &vec![false; x.len()]);
            assert!(fourth.iter().any(|d| d.abs() > 1e-3));
            assert_eq!(noise(&fourth, &ValueResolution::new(&x, None)), None);
        }
    }

    #[test]
    fn law_a_cubic_has_no_noise_and_gaps_are_not_crossed() {
        let x: Vec<f64> = (0..40).map(|i| f64::from(i * i * i)).collect();
        let mut breaks = vec![false; 40];
        assert_eq!(noise(&fourth_differences(&x, &breaks), &ValueResolution::new(&x, None)), None);
        let mut jumped = x;
        jumped.iter_mut().skip(20).for_each(|v| *v += 1e6);
        breaks[20] = true;
        let fourth = fourth_differences(&jumped, &breaks);
        assert!(fourth.iter().filter(|d| d.is_finite()).all(|d| *d == 0.0), "{fourth:?}");
        assert_eq!(fourth.iter().filter(|d| d.is_nan()).count(), 8);
        assert!(fourth_differences(&[1.0; 3], &[false; 3]).iter().all(|d| d.is_nan()));
    }
}

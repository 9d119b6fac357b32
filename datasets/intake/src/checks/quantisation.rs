//! The step of a column whose values lie on a grid.

/// Maximum number of compared values; more add no information.
const MOST: usize = 20_000;
/// Minimum number of steps between distinct values.
const LEAST: usize = 8;
/// Maximum distance of a value from the grid, in steps. The tolerance permits rounding to decimals and to single
/// precision.
const TOLERANCE: f64 = 0.05;

/// The quantisation step: the largest step that divides nearly all differences between neighbouring distinct values.
/// `None` if the values are not on a grid.
pub fn step(values: &[f64]) -> Option<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).take(MOST).collect();
    sorted.sort_by(f64::total_cmp);
    let size = sorted.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
    // Values that differ only by rounding in double precision count as equal.
    let same = 8.0 * f64::EPSILON * size;
    let steps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > same).collect();
    if steps.len() < LEAST {
        return None;
    }
    let mut ordered = steps.clone();
    ordered.sort_by(f64::total_cmp);
    let least = *ordered.first()?;
    // The smallest step has a rounding error; the mean over all similar steps is more accurate.
    let like: Vec<f64> = ordered.iter().copied().take_while(|d| *d < least * 1.2).collect();
    let step = like.iter().sum::<f64>() / like.len() as f64;
    let on_grid = |d: &&f64| {
        let n = (**d / step).round();
        // Beyond a thousand steps, any value is near a multiple.
        n < 1000.0 && (**d / step - n).abs() < TOLERANCE
    };
    let on = steps.iter().filter(on_grid).count();
    // A step that occurs only once or twice may be chance.
    (like.len() >= 3 && on as f64 >= 0.98 * steps.len() as f64).then_some(step)
}

/// Resolution of the values of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueResolution {
    /// The quantisation step; 0 if the values are not on a grid.
    step: f64,
    /// Maximum fourth difference caused by rounding values of this size to double precision.
    rounding: f64,
}

impl ValueResolution {
    /// Resolution of values on a grid of `step`. `step` is `None` for values that are not on a grid.
    pub fn new(values: &[f64], step: Option<f64>) -> Self {
        let size = values.iter().filter(|x| x.is_finite()).fold(0.0_f64, |a, x| a.max(x.abs()));
        // The absolute coefficients of the fourth difference add up to 16.
        Self { step: step.unwrap_or(0.0), rounding: 16.0 * f64::EPSILON * size }
    }

    /// Fourth difference below which all variation is rounding.
    pub fn rounding(&self) -> f64 {
        self.rounding
    }

    /// Standard deviation of the fourth difference due to the step alone: errors uniform within a step have the
    /// variance step²/12, and the difference has 70 times this variance.
    pub fn fourth_difference_sigma(&self) -> f64 {
        self.step * (70.0_f64 / 12.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn signal(i: usize) -> f64 {
        let t = i as f64 / 50.0;
        50_000.0 + 310.0 * (0.31 * t).sin() + 47.0 * (1.7 * t).cos() + 3.0 * (17.3 * t).sin()
    }

    #[test]
    fn unit_a_rounded_signal_has_the_step_of_its_rounding() {
        for step in [1.0, 0.25, 7.5, 100.0 / 3.0] {
            let x: Vec<f64> = (0..3000).map(|i| (signal(i) / step).round() * step).collect();
            let found = super::step(&x).unwrap_or_else(|| panic!("no step at {step}"));
            assert!((found / step - 1.0).abs() < 1e-6, "{found} {step}");
        }
    }

    #[test]
    fn unit_single_precision_and_unit_conversions_keep_the_step() {
        // Values in whole milligauss, stored as single-precision gauss and converted to nT, have a step of 100 nT.
        let x: Vec<f64> = (0..3000).map(|i| f64::from((signal(i) / 100.0).round() as f32 / 1000.0) * 1e5).collect();
        let found = super::step(&x).unwrap();
        assert!((found - 100.0).abs() < 0.5, "{found}");
    }

    #[test]
    fn unit_a_signal_of_full_precision_has_no_step() {
        assert_eq!(step(&(0..3000).map(signal).collect::<Vec<_>>()), None);
        assert_eq!(step(&[1.0, 2.0, 3.0]), None);
        assert_eq!(step(&[]), None);
        assert_eq!(step(&[f64::NAN; 50]), None);
    }
}

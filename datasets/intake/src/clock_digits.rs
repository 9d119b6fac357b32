//! Clock times written as digits, `hhmmss.s` or `hhmm`, in a column that should hold seconds.

use numerics::regression::statistics;

const DAY_S: f64 = 86_400.0;
/// Maximum deviation of a regular clock step, relative to the median step.
const USUAL: f64 = 0.25;
/// Minimum jump of the digits at the end of a minute, minus the step.
const SKIPPED: f64 = 30.0;

/// The first row after the end of a minute or an hour, if the numbers are clock times written as digits; `None` for
/// seconds.
///
/// All last and second last pairs of digits are below 60. The numbers jump by 40 or more to the next minute or hour,
/// while the clock keeps its usual step. Missing numbers (NaN) are ignored.
pub fn minute_after(numbers: &[f64]) -> Option<usize> {
    let mut known: Vec<(usize, f64, f64)> = vec![];
    for (row, x) in numbers.iter().enumerate().filter(|(_, x)| x.is_finite()) {
        known.push((row, *x, seconds(*x)?));
    }
    let step = |pair: &[(usize, f64, f64)]| (pair[1].1 - pair[0].1, (pair[1].2 - pair[0].2).rem_euclid(DAY_S));
    let steps: Vec<(f64, f64)> = known.windows(2).map(step).collect();
    let mut jumps: Vec<f64> = steps.iter().map(|(jump, _)| *jump).filter(|jump| *jump > 0.0).collect();
    let mut real: Vec<f64> = steps.iter().map(|(_, real)| *real).filter(|real| *real > 0.0).collect();
    // With steps of half a minute, the numbers jump by 30 and 70 alternately.
    jumps.sort_by(f64::total_cmp);
    let least = jumps.get(jumps.len() / 4).copied()?;
    let usual = statistics::median(&mut real);
    let ends_minute = |(jump, real): &(f64, f64)| {
        let skips = *jump > least + SKIPPED || *jump < -DAY_S;
        skips && (real - usual).abs() <= USUAL * usual && *jump != *real
    };
    let at = steps.iter().position(ends_minute)?;
    known.get(at + 1).map(|(row, ..)| *row)
}

/// Seconds past midnight of a clock time written as digits; `None` if the number is not a time.
fn seconds(x: f64) -> Option<f64> {
    let whole = x.floor();
    let (hours, minutes, s) = ((whole / 1e4).floor(), (whole / 100.0).floor() % 100.0, whole % 100.0);
    let fits = x >= 0.0 && hours < 24.0 && minutes < 60.0 && s < 60.0;
    fits.then_some(3600.0 * hours + 60.0 * minutes + s + (x - whole))
}

/// The possible values of the key `format` for the numbers, as text for a message. They include `%H%M` if all numbers
/// are whole and below 2400.
pub fn formats(numbers: &[f64]) -> &'static str {
    let minutes = numbers.iter().filter(|x| x.is_finite()).all(|x| *x < 2400.0 && x.fract() == 0.0);
    if minutes { "`%H%M` for hhmm, `%H%M%S` for hhmmss" } else { "`%H%M%S%.f`" }
}

/// The message about a column of clock times written as digits.
pub const WHAT: &str = "the times are clock times written as digits (hhmmss), not seconds: no pair of digits reaches \
                        60, and the numbers jump at the end of each minute";

#[cfg(test)]
mod tests {
    use super::*;

    /// Clock times written as digits: `n` times in steps of `step_s`, the first at `from_s`.
    fn digits(from_s: f64, step_s: f64, n: usize) -> Vec<f64> {
        let one = |i: usize| {
            let s = ((from_s + step_s * i as f64) * 10.0).round() / 10.0 % DAY_S;
            let (hours, minutes) = ((s / 3600.0).floor(), (s / 60.0).floor() % 60.0);
            ((1e4 * hours + 100.0 * minutes + s % 60.0) * 10.0).round() / 10.0
        };
        (0..n).map(one).collect()
    }

    #[test]
    fn unit_clock_times_in_digits_are_recognised_at_any_hour_and_rate() {
        for (from_s, step_s, n, row) in [
            (36_000.0, 0.1, 1_800, 600),
            (401.5, 0.1, 600, 185),
            (36_000.0, 1.0, 100, 60),
            (36_000.0, 10.0, 30, 6),
            (36_000.0, 30.0, 30, 2),
            (36_000.0, 60.0, 90, 60),
            (86_390.0, 0.1, 200, 100),
        ] {
            assert_eq!(minute_after(&digits(from_s, step_s, n)), Some(row), "{from_s} {step_s}");
        }
        // Times in hours and minutes, such as those of a base station.
        let hhmm: Vec<f64> = (0..90).map(|i| f64::from(1000 + i / 60 * 100 + i % 60)).collect();
        assert_eq!((minute_after(&hhmm), formats(&hhmm)), (Some(60), "`%H%M` for hhmm, `%H%M%S` for hhmmss"));
        let mut holes = digits(36_000.0, 0.1, 1_800);
        holes.drain(300..500);
        holes[10] = f64::NAN;
        assert_eq!(minute_after(&holes), Some(400));
    }

    #[test]
    fn unit_seconds_are_not_recognised_as_digits() {
        for (from, step, n) in [
            (36_000.0, 0.1, 1_800),
            (100_000.0, 0.1, 500),
            (0.0, 50.0, 100),
            (0.0, 100.0, 59),
            (0.0, 30.0, 3),
            (0.0, 3600.0, 24),
        ] {
            let numbers: Vec<f64> = (0..n).map(|i| from + step * f64::from(i)).collect();
            assert_eq!(minute_after(&numbers), None, "{from} {step}");
        }
        // 40 samples at intervals of 1 s, with a gap of 100 s.
        let gap: Vec<f64> = (0..40).map(|i| 36_000.0 + f64::from(i) + if i > 20 { 100.0 } else { 0.0 }).collect();
        assert_eq!(minute_after(&gap), None);
        assert_eq!(minute_after(&[]), None);
    }
}

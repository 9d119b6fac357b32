//! Round values on an axis, and their labels.

/// Position on an axis and its label; minor ticks of a logarithmic axis have no label.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisTick {
    /// The value.
    pub at: f64,
    /// Label.
    pub label: String,
}

/// Ticks in steps of 1, 2 or 5 times a power of ten: at most `most` within `low` to `high`.
pub fn linear(low: f64, high: f64, most: usize) -> Vec<AxisTick> {
    let span = high - low;
    if !(span > 0.0 && span.is_finite()) || most == 0 {
        return vec![];
    }
    let rough = span / most as f64;
    let power = 10f64.powi(rough.log10().floor() as i32);
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough * (1.0 - 1e-9));
    let step = step.unwrap_or(10.0 * power);
    let decimals = decimals_of(step);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|k| k as f64 * step).map(|at| AxisTick { at, label: fixed(at, decimals) }).collect()
}

/// Decimals that distinguish multiples of `step`.
fn decimals_of(step: f64) -> usize {
    let needed = -(step.log10() + 1e-9).floor();
    needed.clamp(0.0, 12.0) as usize
}

/// Number with this number of decimals, with a true minus sign and without a negative zero.
pub fn fixed(x: f64, decimals: usize) -> String {
    let text = format!("{x:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.to_owned(),
        Some(rest) => format!("\u{2212}{rest}"),
        None => text,
    }
}

/// Powers of ten within `low` to `high`, which are positive. If there are fewer than three powers, their multiples by 2
/// and 5 are included.
pub fn logarithmic(low: f64, high: f64) -> Vec<AxisTick> {
    if !(low > 0.0 && high > low && high.is_finite()) {
        return vec![];
    }
    let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let inside = |x: &f64| *x >= low * (1.0 - 1e-9) && *x <= high * (1.0 + 1e-9);
    let decades: Vec<i32> = (first..=last).filter(|k| inside(&10f64.powi(*k))).collect();
    if decades.len() >= 3 {
        let every = decades.len().div_ceil(8) as i32;
        let shown: Vec<i32> = decades.into_iter().filter(|k| k % every == 0).collect();
        let plain = shown.iter().all(|k| (-3..=4).contains(k));
        let label = |k: i32| if plain { fixed(10f64.powi(k), (-k).max(0) as usize) } else { power_of_ten(k) };
        return shown.into_iter().map(|k| AxisTick { at: 10f64.powi(k), label: label(k) }).collect();
    }
    let all = (first..=last).flat_map(|k| [1.0, 2.0, 5.0].map(|m| (m * 10f64.powi(k), k)));
    all.filter(|(x, _)| inside(x))
        .map(|(at, k)| AxisTick { at, label: fixed(at, (-k).clamp(0, 12) as usize) })
        .collect()
}

/// Label of a power of ten with its exponent: the format on an axis that extends below 0.001 or above 10000.
fn power_of_ten(k: i32) -> String {
    if k == 0 || k == 1 {
        return fixed(10f64.powi(k), 0);
    }
    let raised = |c: char| match c {
        '-' => '\u{207b}',
        '1' => '\u{b9}',
        '2' => '\u{b2}',
        '3' => '\u{b3}',
        '0' => '\u{2070}',
        c => char::from_u32(0x2070 + c as u32 - '0' as u32).unwrap_or(c),
    };
    format!("10{}", k.to_string().chars().map(raised).collect::<String>())
}

/// Largest length of 1, 2 or 5 times a power of ten that is at most `most`.
pub fn round_below(most: f64) -> f64 {
    let power = 10f64.powi(most.log10().floor() as i32);
    [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|x| *x <= most).unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &[AxisTick]) -> Vec<&str> {
        ticks.iter().map(|t| t.label.as_str()).collect()
    }

    #[test]
    fn gold_ticks_are_round() {
        assert_eq!(labels(&linear(-0.31, 0.52, 5)), ["\u{2212}0.2", "0.0", "0.2", "0.4"]);
        assert_eq!(labels(&linear(0.0, 12.0, 6)), ["0", "2", "4", "6", "8", "10", "12"]);
        assert_eq!(labels(&linear(140.551, 140.799, 5)), ["140.60", "140.65", "140.70", "140.75"]);
        assert_eq!(labels(&logarithmic(2e-4, 300.0)), ["0.001", "0.01", "0.1", "1", "10", "100"]);
        assert_eq!(labels(&logarithmic(0.3, 6.0)), ["0.5", "1", "2", "5"]);
        assert_eq!(labels(&logarithmic(0.5, 2e5)), ["1", "10", "10\u{b2}", "10\u{b3}", "10\u{2074}", "10\u{2075}"]);
        assert_eq!(power_of_ten(-6), "10\u{207b}\u{2076}");
        assert_eq!(round_below(7.3), 5.0);
    }

    #[test]
    fn unit_empty_range_has_no_ticks() {
        assert!(linear(1.0, 1.0, 5).is_empty() && linear(f64::NAN, 1.0, 5).is_empty());
        assert!(logarithmic(0.0, 1.0).is_empty() && logarithmic(2.0, 1.0).is_empty());
    }
}

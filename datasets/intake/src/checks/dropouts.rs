//! Missing values.

use std::ops::Range;

/// The missing samples of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropouts {
    /// Number of missing samples.
    pub samples: usize,
    /// The row of the first missing sample.
    pub first: usize,
    /// The longest time without a value: from the last value before the gap to the first value after it, or to the
    /// line's ends.
    pub longest_s: f64,
}

/// The missing samples; `None` if no sample is missing.
pub fn dropouts(values: &[f64], tt: &[f64]) -> Option<Dropouts> {
    let first = values.iter().position(|x| !x.is_finite())?;
    let samples = values.iter().filter(|x| !x.is_finite()).count();
    let at = |row: usize| tt.get(row).copied();
    let (mut longest_s, mut start) = (0.0_f64, None);
    for row in 0..=values.len() {
        let missing = values.get(row).is_some_and(|x| !x.is_finite());
        match (missing, start) {
            (true, None) => start = Some(row),
            (false, Some(from)) => {
                let (before, after) = (from.saturating_sub(1), row.min(values.len().saturating_sub(1)));
                longest_s = longest_s.max(at(after).zip(at(before)).map_or(0.0, |(b, a)| b - a));
                start = None;
            }
            (true, Some(_)) | (false, None) => {}
        }
    }
    Some(Dropouts { samples, first, longest_s })
}

/// The runs of missing samples.
pub fn stretches(values: &[f64]) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = vec![];
    for (row, _) in values.iter().enumerate().filter(|(_, x)| !x.is_finite()) {
        match found.last_mut() {
            Some(run) if run.end == row => run.end = row + 1,
            _ => found.push(row..row + 1),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_dropouts_last_from_the_value_before_to_the_value_after() {
        let tt: Vec<f64> = (0..10).map(f64::from).collect();
        let mut x = vec![1.0; 10];
        assert_eq!(dropouts(&x, &tt), None);
        (x[2], x[6], x[7]) = (f64::NAN, f64::NAN, f64::INFINITY);
        assert_eq!(dropouts(&x, &tt), Some(Dropouts { samples: 3, first: 2, longest_s: 3.0 }));
        assert_eq!(dropouts(&[f64::NAN; 10], &tt), Some(Dropouts { samples: 10, first: 0, longest_s: 9.0 }));
        assert_eq!(dropouts(&[], &[]), None);
    }
}

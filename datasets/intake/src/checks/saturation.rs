//! Values at the end of a sensor's range.

use std::ops::Range;

/// Samples at the largest or smallest value of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saturation {
    /// Number of samples.
    pub samples: usize,
    /// The row of the first sample at the limit.
    pub first: usize,
    /// The value.
    pub value: f64,
}

/// Minimum length of a run of equal samples at an end of the range.
const RUN: usize = 4;
/// Minimum ratio of the number of samples at the end to the number of samples at any neighbouring value.
const EXCESS: usize = 5;
/// Number of neighbouring values that are compared with the end.
const NEXT: usize = 3;

/// The samples at the end of the range, if they are far more frequent than the values next to it and form runs. `None`
/// without a sign of saturation.
pub fn saturation(values: &[f64]) -> Option<Saturation> {
    let mut counts: Vec<(f64, usize)> = vec![];
    let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    for x in sorted {
        match counts.last_mut() {
            Some((known, n)) if *known == x => *n += 1,
            _ => counts.push((x, 1)),
        }
    }
    // In a column with few distinct values, such as the states of a switch, frequent end values do not indicate
    // saturation.
    if counts.len() < 2 * NEXT + 2 {
        return None;
    }
    let at = |counts: &mut dyn Iterator<Item = &(f64, usize)>| {
        let (value, samples) = *counts.next()?;
        let next = counts.take(NEXT).map(|(_, n)| *n).max()?;
        let first = values.iter().position(|x| *x == value)?;
        let run = longest_run(values, value);
        (run >= RUN && samples >= EXCESS * next).then_some(Saturation { samples, first, value })
    };
    at(&mut counts.iter().rev()).or_else(|| at(&mut counts.iter()))
}

/// The runs of samples at the saturated end.
pub fn stretches(values: &[f64]) -> Vec<Range<usize>> {
    let Some(Saturation { value, .. }) = saturation(values) else { return vec![] };
    let mut found: Vec<Range<usize>> = vec![];
    for (row, _) in values.iter().enumerate().filter(|(_, x)| **x == value) {
        match found.last_mut() {
            Some(run) if run.end == row => run.end = row + 1,
            _ => found.push(row..row + 1),
        }
    }
    found
}

fn longest_run(values: &[f64], value: f64) -> usize {
    let (mut longest, mut run) = (0, 0);
    for x in values {
        run = if *x == value { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    longest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_only_a_clipped_wave_is_saturated() {
        let wave: Vec<f64> = (0..2000).map(|i| (70.0 * (f64::from(i) * 0.013).sin()).round()).collect();
        assert_eq!(saturation(&wave.iter().map(|x| x + 0.001 * x * x).collect::<Vec<_>>()), None);
        let clipped: Vec<f64> = wave.iter().map(|x| x.min(40.0)).collect();
        let found = saturation(&clipped);
        let samples = wave.iter().filter(|x| **x >= 40.0).count();
        let first = wave.iter().position(|x| *x >= 40.0).unwrap_or(0);
        assert_eq!(found, Some(Saturation { samples, first, value: 40.0 }));
        let low: Vec<f64> = wave.iter().map(|x| x.max(-40.0)).collect();
        assert_eq!(saturation(&low).map(|s| s.value), Some(-40.0));
        assert_eq!(saturation(&[0.0, 1.0, 1.0, 1.0, 1.0, 1.0]), None);
    }
}

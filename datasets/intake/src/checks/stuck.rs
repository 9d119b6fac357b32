//! Stuck sensors: values that stay constant for a while.

use std::ops::Range;

/// Longest run of equal values in a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantRun {
    /// Number of samples of that run.
    pub samples: usize,
    /// First row.
    pub first: usize,
    /// Duration.
    pub longest_s: f64,
}

/// Minimum length of a long run in samples, and minimum ratio of its length to the 90th percentile of the other runs.
const LEAST: usize = 20;
const LONGER: usize = 10;

/// The longest run of equal values, if it is far longer than the others. A column whose values are always held or
/// coarse is not stuck. `None` without such a run.
pub fn stuck(values: &[f64], tt: &[f64]) -> Option<ConstantRun> {
    let longest = stretches(values).into_iter().max_by_key(|run| (run.len(), std::cmp::Reverse(run.start)))?;
    let longest_s = tt.get(longest.end.checked_sub(1)?)? - tt.get(longest.start)?;
    Some(ConstantRun { samples: longest.len(), first: longest.start, longest_s })
}

/// All runs of equal values that are far longer than the others.
pub fn stretches(values: &[f64]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = vec![];
    for (row, x) in values.iter().enumerate() {
        match runs.last_mut() {
            Some(run) if values.get(run.start) == Some(x) => run.end = row + 1,
            _ => runs.push(row..row + 1),
        }
    }
    if runs.iter().all(|run| run.len() < LEAST) {
        return vec![];
    }
    let mut lengths: Vec<usize> = runs.iter().map(ExactSizeIterator::len).collect();
    lengths.sort_unstable();
    let usual = lengths.get(lengths.len() * 9 / 10).copied().unwrap_or(1);
    runs.retain(|run| run.len() >= LEAST && run.len() >= LONGER * usual);
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_stopped_sensors_are_found_and_held_values_are_not() {
        let tt: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.1).collect();
        let mut x: Vec<f64> = (0..1000).map(|i| (f64::from(i) * 0.37).sin()).collect();
        assert_eq!(stuck(&x, &tt), None);
        let value = x[300];
        x[300..360].fill(value);
        let found = stuck(&x, &tt).unwrap_or(ConstantRun { samples: 0, first: 0, longest_s: 0.0 });
        assert_eq!((found.samples, found.first), (60, 300));
        assert!((found.longest_s - 5.9).abs() < 1e-9);
        // Positions at 1 Hz among rows at 50 Hz.
        let held: Vec<f64> = (0..1000).map(|i| f64::from(i / 50)).collect();
        assert_eq!(stuck(&held, &tt), None);
        assert_eq!(stuck(&[], &[]), None);
        // Missing values are not equal values.
        assert_eq!(stuck(&[f64::NAN; 100], &tt), None);
    }
}

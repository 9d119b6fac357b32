//! Stuck sensors: values that stay constant for a while.

use std::ops::Range;

use numerics::regression::statistics::median;

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

/// Minimum length of a long run in samples, and minimum ratio to the 90th percentile of the other runs.
const LEAST: usize = 20;
const LONGER: usize = 10;
/// A sensor of coarse resolution was stuck if its value then changes by more than this multiple of the median change.
const JUMP: f64 = 3.0;

/// The longest run of equal values, if it is far longer than the others. A column whose values are always held or
/// coarse is not stuck. `None` without such a run.
pub fn stuck(values: &[f64], tt: &[f64]) -> Option<ConstantRun> {
    let longest = stretches(values).into_iter().max_by_key(|run| (run.len(), std::cmp::Reverse(run.start)))?;
    let longest_s = tt.get(longest.end.checked_sub(1)?)? - tt.get(longest.start)?;
    Some(ConstantRun { samples: longest.len(), first: longest.start, longest_s })
}

/// All runs of equal values that are far longer than the others.
///
/// A sensor of coarse resolution also repeats a value for a long time while the field hardly changes, and then changes
/// by one step. If repeated values are usual, only runs that end with a jump count.
pub fn stretches(values: &[f64]) -> Vec<Range<usize>> {
    let same = |a: &f64, b: &f64| a == b;
    if values.chunk_by(same).all(|run| run.len() < LEAST) {
        return vec![];
    }
    let mut start = 0;
    let run = |run: &[f64]| {
        let first = start;
        start += run.len();
        first..start
    };
    let mut runs: Vec<Range<usize>> = values.chunk_by(same).map(run).collect();
    let mut lengths: Vec<usize> = runs.iter().map(ExactSizeIterator::len).collect();
    lengths.sort_unstable();
    let usual = lengths.get(lengths.len() * 9 / 10).copied().unwrap_or(1);
    let mut changes: Vec<f64> =
        values.windows(2).map(|x| (x[1] - x[0]).abs()).filter(|d| *d > 0.0 && d.is_finite()).collect();
    let jump = if usual > 1 && !changes.is_empty() { JUMP * median(&mut changes) } else { 0.0 };
    let jumps = |run: &Range<usize>| values.get(run.end).is_some_and(|next| (next - values[run.start]).abs() > jump);
    runs.retain(|run| run.len() >= LEAST && run.len() >= LONGER * usual && (usual == 1 || jumps(run)));
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
        // Steps of 0.5 nT on a ramp, on a level of 40 samples, and on a ramp: the sensor is coarse, not stuck.
        let field = |i: i32| 0.4 * f64::from(i.min(500) + (i - 540).max(0));
        let mut coarse: Vec<f64> = (0..1000).map(|i| (2.0 * field(i)).round() / 2.0).collect();
        assert_eq!(stuck(&coarse, &tt), None);
        coarse.iter_mut().skip(540).for_each(|x| *x += 5.0);
        let found = stuck(&coarse, &tt).unwrap_or(ConstantRun { samples: 0, first: 0, longest_s: 0.0 });
        assert!(found.samples >= 40 && found.first <= 500 && found.first > 490, "{found:?}");
        assert_eq!(stuck(&[], &[]), None);
        // Missing values are not equal values.
        assert_eq!(stuck(&[f64::NAN; 100], &tt), None);
    }
}

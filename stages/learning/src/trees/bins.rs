//! Columns divided into at most 256 bins.

use rayon::prelude::*;

/// Maximum number of bins of a column.
pub(super) const BINS: usize = 256;

/// Number of columns whose bins are stored together, so that one load fetches four columns.
pub(super) const TOGETHER: usize = 4;

/// Maximum number of rows for quantiles, spread evenly over all rows.
const SAMPLED: usize = 200_000;

/// Bins of the values of all columns.
pub(super) struct ColumnBins {
    pub rows: usize,
    pub width: usize,
    /// Per group of four columns, the four bins of every row. Padding columns have bin 0.
    packed: Vec<Vec<[u8; TOGETHER]>>,
    /// The upper limit of each bin except the last, per column, ascending.
    thresholds: Vec<Vec<f64>>,
}

impl ColumnBins {
    /// The bins of finite rows, at least one.
    pub fn from_rows(x: &[f64], width: usize) -> Self {
        let rows = x.len() / width;
        let made: Vec<_> =
            (0..width.div_ceil(TOGETHER)).into_par_iter().map(|k| four(x, width, k * TOGETHER)).collect();
        let (packed, thresholds): (Vec<_>, Vec<_>) = made.into_iter().unzip();
        Self { rows, width, packed, thresholds: thresholds.into_iter().flatten().collect() }
    }

    /// The bins of columns 4 k to 4 k + 3 of every row.
    pub fn packed(&self, k: usize) -> &[[u8; TOGETHER]] {
        self.packed.get(k).map_or(&[], Vec::as_slice)
    }

    /// The number of bins of a column.
    pub fn count(&self, column: usize) -> usize {
        self.thresholds.get(column).map_or(1, |t| t.len() + 1)
    }

    /// The upper limit of a bin.
    pub fn threshold(&self, column: usize, bin: usize) -> f64 {
        self.thresholds.get(column).and_then(|t| t.get(bin)).copied().unwrap_or(f64::INFINITY)
    }
}

fn four(x: &[f64], width: usize, first: usize) -> (Vec<[u8; TOGETHER]>, Vec<Vec<f64>>) {
    let columns: Vec<usize> = (first..width.min(first + TOGETHER)).collect();
    let thresholds: Vec<Vec<f64>> = columns.iter().map(|&j| thresholds(x, width, j)).collect();
    let padded: Vec<[f64; BINS]> = thresholds.iter().map(|t| padded(t)).collect();
    let bins = |row: &[f64]| {
        let mut four = [0; TOGETHER];
        for ((bin, t), &j) in four.iter_mut().zip(&padded).zip(&columns) {
            *bin = bin_of(t, row[j]);
        }
        four
    };
    (x.chunks_exact(width).map(bins).collect(), thresholds)
}

fn padded(thresholds: &[f64]) -> [f64; BINS] {
    let mut all = [f64::INFINITY; BINS];
    all.iter_mut().zip(thresholds).for_each(|(all, t)| *all = *t);
    all
}

/// The number of thresholds below `x`: a branch-free search, because the branches would be unpredictable.
fn bin_of(thresholds: &[f64; BINS], x: f64) -> u8 {
    let mut at = 0;
    for step in [128, 64, 32, 16, 8, 4, 2, 1] {
        at += step * usize::from(thresholds[at + step - 1] < x);
    }
    at as u8
}

/// Midpoints between all distinct values; for more than [`BINS`] values, midpoints at the quantiles of [`BINS`] parts.
fn thresholds(x: &[f64], width: usize, column: usize) -> Vec<f64> {
    let rows = x.len() / width;
    let sampled = rows.min(SAMPLED);
    let row = |k: usize| (k as u128 * rows as u128 / sampled as u128) as usize;
    let mut values: Vec<f64> = (0..sampled).map(|k| x[row(k) * width + column]).collect();
    values.sort_unstable_by(f64::total_cmp);
    let mut distinct = values.clone();
    distinct.dedup();
    if distinct.len() <= BINS {
        return distinct.windows(2).map(|pair| middle(pair[0], pair[1])).collect();
    }
    let edge = |k: usize| {
        let at = k * values.len() / BINS;
        middle(values[at - 1], values[at])
    };
    let mut edges: Vec<f64> = (1..BINS).map(edge).collect();
    edges.dedup();
    edges
}

/// A number that is at least `lower` and, if the two limits differ, below `upper`.
fn middle(lower: f64, upper: f64) -> f64 {
    let middle = 0.5 * lower + 0.5 * upper;
    if middle >= lower && middle < upper { middle } else { lower }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_a_bin_equals_the_number_of_smaller_thresholds() {
        let x: Vec<f64> = (0..5000).map(|k| f64::from(k * 7919 % 5000) * 0.01 - 3.0).collect();
        let bins = ColumnBins::from_rows(&x, 1);
        assert_eq!(bins.count(0), BINS);
        for (value, bin) in x.iter().zip(bins.packed(0)) {
            let below = (0..BINS - 1).filter(|&b| bins.threshold(0, b) < *value).count();
            assert_eq!(below, usize::from(bin[0]));
        }
        // The numbers of rows in the bins differ by at most one.
        let mut rows = [0; BINS];
        bins.packed(0).iter().for_each(|bin| rows[usize::from(bin[0])] += 1);
        assert!(rows.iter().all(|n| (19..=20).contains(n)), "{rows:?}");
    }

    #[test]
    fn unit_adjacent_repeated_and_constant_values_are_binned() {
        let up = f64::from_bits(1.0_f64.to_bits() + 1);
        let bins = ColumnBins::from_rows(&[1.0, 5.0, up, 5.0, -0.0, 5.0, 0.0, 5.0], 2);
        let column = |j: usize| bins.packed(0).iter().map(|b| b[j]).collect::<Vec<_>>();
        assert_eq!(column(0), [1, 2, 0, 0]);
        assert_eq!((column(1), bins.count(1)), (vec![0; 4], 1));
        // Nine of ten rows have the same value. This value has a separate bin, and the other values keep their bins.
        let x: Vec<f64> = (0..10_000).map(|k| if k % 10 == 0 { f64::from(k) } else { 0.5 }).collect();
        let bins = ColumnBins::from_rows(&x, 1);
        assert!(bins.count(0) > 20 && bins.count(0) < 40, "{}", bins.count(0));
        assert!((0..bins.count(0) - 2).all(|b| bins.threshold(0, b) < bins.threshold(0, b + 1)));
        assert!(middle(-f64::MAX, f64::MAX) == 0.0 && middle(f64::MIN_POSITIVE, f64::MIN_POSITIVE) > 0.0);
    }
}

//! Correlation coefficients.

use numerics::regression::{SampleStatistic, statistics::summary};

use crate::rows::sum_of;

/// Pearson's correlation coefficient of two columns, and the number of rows in which both are finite; other rows are
/// ignored. NaN if a column is constant or there are fewer than two rows.
pub fn pearson(a: &[f64], b: &[f64]) -> SampleStatistic {
    let (a, b) = finite(a, b);
    coefficient(&a, &b)
}

/// Spearman's rank correlation of two columns: Pearson's coefficient of the ranks. Equal values have the mean of their
/// ranks. Rows are ignored as in [`pearson`].
pub fn spearman(a: &[f64], b: &[f64]) -> SampleStatistic {
    let (a, b) = finite(a, b);
    coefficient(&ranks(&a), &ranks(&b))
}

fn finite(a: &[f64], b: &[f64]) -> (Vec<f64>, Vec<f64>) {
    a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite()).unzip()
}

fn coefficient(a: &[f64], b: &[f64]) -> SampleStatistic {
    let n = a.len();
    // Rounding can make the computed mean of a constant column differ from its value. The differences of two such
    // columns would appear correlated.
    let constant = |x: &[f64]| x.windows(2).all(|pair| pair[0] == pair[1]);
    if n < 2 || constant(a) || constant(b) {
        return SampleStatistic { value: f64::NAN, n };
    }
    let (of_a, of_b) = (summary(a), summary(b));
    let product = sum_of(n, |i| (a[i] - of_a.mean) / of_a.std * ((b[i] - of_b.mean) / of_b.std));
    SampleStatistic { value: (product / (n as f64 - 1.0)).clamp(-1.0, 1.0), n }
}

/// The rank of each value, from 1; equal values have the mean of their ranks.
fn ranks(x: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|&i, &j| x[i].total_cmp(&x[j]));
    let mut ranks = vec![0.0; x.len()];
    let mut first = 0;
    for equal in order.chunk_by(|&i, &j| x[i] == x[j]) {
        let rank = first as f64 + 0.5 * (equal.len() as f64 + 1.0);
        equal.iter().for_each(|&i| ranks[i] = rank);
        first += equal.len();
    }
    ranks
}

//! Reduction of the number of points without a change in appearance.

/// Maximum number of points of one drawn line.
pub const MOST: usize = 2000;

/// Line of at most `most` points: the smallest and the largest value of each interval, in their order, so that a single
/// spike is kept. An interval without a finite value is a break, kept as a NaN.
pub fn extremes(x: &[f64], y: &[f64], most: usize) -> Vec<(f64, f64)> {
    let all: Vec<(f64, f64)> = x.iter().copied().zip(y.iter().copied()).collect();
    if all.len() <= most {
        return all;
    }
    let mut out = Vec::with_capacity(most);
    for part in stretches(&all, most / 2) {
        let finite = || part.iter().enumerate().filter(|(_, p)| p.1.is_finite());
        let lowest = finite().min_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let highest = finite().max_by(|a, b| a.1.1.total_cmp(&b.1.1));
        match (lowest, highest) {
            (Some((i, a)), Some((k, b))) if i < k => out.extend([*a, *b]),
            (Some((i, a)), Some((k, b))) if i > k => out.extend([*b, *a]),
            (Some((_, a)), _) => out.push(*a),
            _ => out.extend(part.first().map(|p| (p.0, f64::NAN))),
        }
    }
    out
}

/// Half-widths of a band at no more than `most` points: the largest half-width of each interval.
pub fn envelope(x: &[f64], half: &[f64], most: usize) -> Vec<(f64, f64)> {
    let all: Vec<(f64, f64)> = x.iter().copied().zip(half.iter().copied()).collect();
    let largest = |part: &[(f64, f64)]| {
        let finite = part.iter().map(|p| p.1).filter(|h| h.is_finite());
        part.get(part.len() / 2).map(|middle| (middle.0, finite.fold(f64::NAN, f64::max)))
    };
    stretches(&all, most).filter_map(largest).collect()
}

/// Divides `all` into at most `count` parts of nearly equal length.
fn stretches<T>(all: &[T], count: usize) -> impl Iterator<Item = &[T]> {
    let count = count.clamp(1, all.len().max(1));
    (0..count).filter_map(move |k| all.get(k * all.len() / count..(k + 1) * all.len() / count))
}

/// Every n-th point of `points`, and the last point; at most `most` + 1 points in total.
pub fn thinned<T: Clone>(points: &[T], most: usize) -> Vec<T> {
    let every = points.len().div_ceil(most.max(1)).max(1);
    let last = points.len().checked_sub(1).filter(|n| n % every != 0).and_then(|n| points.get(n));
    points.iter().step_by(every).chain(last).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_spike_is_kept() {
        let x: Vec<f64> = (0..100_000).map(f64::from).collect();
        let mut y = vec![0.0; x.len()];
        // The first value of one interval is its largest; the first value of the other interval is its smallest.
        (y[54_321], y[54_330], y[7], y[9]) = (9.0, -9.0, -4.0, 4.0);
        let few = extremes(&x, &y, 2000);
        assert!(few.len() <= 2000);
        for spike in [(54_321.0, 9.0), (54_330.0, -9.0), (7.0, -4.0), (9.0, 4.0)] {
            assert!(few.contains(&spike), "{spike:?}");
        }
        assert!(few.windows(2).all(|w| w[0].0 < w[1].0), "the order in time is kept");
    }

    #[test]
    fn unit_gap_is_kept() {
        let x: Vec<f64> = (0..10_000).map(f64::from).collect();
        let y: Vec<f64> = x.iter().map(|x| if (4000.0..5000.0).contains(x) { f64::NAN } else { *x }).collect();
        let few = extremes(&x, &y, 1000);
        assert!(few.iter().any(|p| p.1.is_nan()));
        assert!(few.iter().filter(|p| p.1.is_finite()).all(|p| p.0 == p.1));
        assert_eq!(extremes(&x[..10], &y[..10], 1000).len(), 10);
    }

    #[test]
    fn unit_thinning_keeps_both_ends() {
        let points: Vec<usize> = (0..1001).collect();
        let few = thinned(&points, 100);
        assert!(few.len() <= 101);
        assert_eq!((few.first(), few.last()), (Some(&0), Some(&1000)));
        assert_eq!(envelope(&[0.0, 1.0, 2.0, 3.0], &[1.0, 5.0, 2.0, f64::NAN], 2), [(1.0, 5.0), (3.0, 2.0)]);
    }
}

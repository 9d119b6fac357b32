//! Reduction of the points of a line within a tolerance.

/// Ascending indices of the points to keep among `count` points, including the first and the last. A point is dropped
/// only if its `distance(from, to, point)` to the segment between its kept neighbours is at most `tolerance`. [Douglas
/// and Peucker 1973]
pub fn kept(count: usize, tolerance: f64, distance: impl Fn(usize, usize, usize) -> f64) -> Vec<usize> {
    let Some(last) = count.checked_sub(1) else { return vec![] };
    let mut keep = vec![false; count];
    (keep[0], keep[last]) = (true, true);
    let mut stretches = vec![(0, last)];
    while let Some((from, to)) = stretches.pop() {
        let inner = (from + 1..to).map(|k| (distance(from, to, k), k));
        let farthest = inner.fold((tolerance, None), |best, (d, k)| if d > best.0 { (d, Some(k)) } else { best });
        if let (_, Some(k)) = farthest {
            keep[k] = true;
            stretches.extend([(from, k), (k, to)]);
        }
    }
    (0..count).filter(|k| keep[*k]).collect()
}

/// Distance of `point` to the segment from `a` to `b`.
pub fn to_stretch<const N: usize>(a: &[f64; N], b: &[f64; N], point: &[f64; N]) -> f64 {
    let dot = |u: &[f64; N], v: &[f64; N]| u.iter().zip(v).map(|(p, q)| p * q).sum::<f64>();
    let minus = |u: &[f64; N], v: &[f64; N]| std::array::from_fn::<f64, N, _>(|k| u[k] - v[k]);
    let (along, off) = (minus(b, a), minus(point, a));
    let length = dot(&along, &along);
    let part = if length > 0.0 { (dot(&off, &along) / length).clamp(0.0, 1.0) } else { 0.0 };
    let rest: [f64; N] = std::array::from_fn(|k| off[k] - part * along[k]);
    dot(&rest, &rest).sqrt()
}

/// Runs of `points` between missing points.
pub fn runs<T: Copy>(points: impl Iterator<Item = Option<T>>) -> Vec<Vec<T>> {
    let mut runs: Vec<Vec<T>> = vec![vec![]];
    for point in points {
        match (point, runs.last_mut()) {
            (Some(p), Some(run)) => run.push(p),
            (None, Some(run)) if !run.is_empty() => runs.push(vec![]),
            _ => {}
        }
    }
    runs.retain(|run| !run.is_empty());
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thinned(points: &[[f64; 2]], tolerance: f64) -> Vec<usize> {
        kept(points.len(), tolerance, |a, b, k| to_stretch(&points[a], &points[b], &points[k]))
    }

    #[test]
    fn unit_thinning_keeps_line_ends_and_corners() {
        let corner: Vec<[f64; 2]> =
            (0..100).map(|k| if k < 60 { [f64::from(k), 0.0] } else { [59.0, f64::from(k - 59)] }).collect();
        assert_eq!(thinned(&corner, 0.1), [0, 59, 99]);
        assert_eq!(thinned(&corner[..50], 0.1), [0, 49]);
        assert_eq!(thinned(&corner[..1], 0.1), [0]);
        assert!(thinned(&[], 0.1).is_empty());
    }

    #[test]
    fn unit_dropped_points_are_within_the_tolerance() {
        let wave: Vec<[f64; 2]> = (0..5000).map(|k| f64::from(k) / 100.0).map(|x| [x, 3.0 * x.sin()]).collect();
        let few = thinned(&wave, 0.05);
        assert!(few.len() < 150, "{}", few.len());
        for ends in few.windows(2) {
            for k in ends[0]..=ends[1] {
                assert!(to_stretch(&wave[ends[0]], &wave[ends[1]], &wave[k]) <= 0.05);
            }
        }
    }

    #[test]
    fn unit_reversal_on_a_line_is_kept() {
        let there_and_back = [[0.0, 0.0], [5.0, 0.0], [10.0, 0.0], [4.0, 0.0]];
        assert_eq!(thinned(&there_and_back, 0.1), [0, 2, 3]);
        assert_eq!(to_stretch(&[1.0, 1.0], &[1.0, 1.0], &[4.0, 5.0]), 5.0);
    }

    #[test]
    fn unit_gaps_break_runs() {
        let points = [None, Some(1), Some(2), None, None, Some(3), None];
        assert_eq!(runs(points.into_iter()), [vec![1, 2], vec![3]]);
        assert!(runs(std::iter::empty::<Option<u8>>()).is_empty());
    }
}
